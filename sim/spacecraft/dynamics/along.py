"""The torques along a known motion: what the momentum's balance is made of."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics import layout
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle


def torques_B_Nm(
    vehicle: Vehicle, motion: Attitude, surroundings: FloatArray, dipole_B_Am2: FloatArray | None = None
) -> FloatArray:
    """(N, 3) the sum of the vehicle's torques, in B, at each stamp of a motion (simulated or recorded).

    surroundings (N, 14): columns as in `Environment.nodes`, for instance `Environment.at`. dipole_B_Am2 (N, 3): what
    the torquers did. Raises BadInput for numbers of rows that differ.
    """
    from fluxtwin.sim.spacecraft.dynamics.kernels import add_torques

    rows = len(motion)
    dipole = np.zeros((rows, 3)) if dipole_B_Am2 is None else np.asarray(dipole_B_Am2, dtype=np.float64)
    if surroundings.shape != (rows, layout.FIELD - layout.POSITION) or dipole.shape != (rows, 3):
        raise BadInput(
            f"{rows} attitudes, surroundings {surroundings.shape}, dipole {dipole.shape}",
            where="torques along a motion",
            wanted=f"({rows}, {layout.FIELD - layout.POSITION}) and ({rows}, 3)",
        )
    stages = np.zeros((rows, layout.STAGE_SIZE))
    stages[:, layout.ROTATION : layout.RATE] = motion.R_BN.as_matrix().reshape(-1, 9)
    stages[:, layout.RATE : layout.POSITION] = motion.rate_B_rad_s
    stages[:, layout.POSITION : layout.FIELD] = surroundings
    stages[:, layout.FIELD : layout.DIPOLE] = motion.R_BN.apply(surroundings[:, 6:9])
    stages[:, layout.DIPOLE : layout.TORQUE] = dipole
    packed, slots = vehicle.packed()
    add_torques(packed, slots, stages)
    return stages[:, layout.TORQUE : layout.TORQUE + 3].copy()
