"""Torque of eddy currents in a body that turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect, Parameter
from fluxtwin.sim.effects.with_torque import torque_of, with_torque
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques.eddy_currents import EddyCurrents


@dataclass(frozen=True)
class EddyTorque(DynamicsEffect):
    """Torque of eddy currents in a body that turns."""

    name: ClassVar[str] = "eddy_torque"
    stage: ClassVar[str] = "dynamics"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "rate"
    settled_by: ClassVar[str] = "a spin of several rpm"
    about: ClassVar[str] = (
        "braking torque (K (w x B)) x B of eddy currents, K diagonal in body axes (Wertz 1978, section 17.2.4; a thin "
        "spherical shell has 2 pi / 3 r^4 s d about each axis)"
    )

    parameters = tuple(Parameter(f"K_{axis}", "A m2 s/T", 1000.0, low=0.0) for axis in "xyz")

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        known = torque_of(vehicle, EddyCurrents)
        K = np.diag(theta) + (np.zeros((3, 3)) if known is None else np.array(known.K_Am2_s_per_T))
        rows = tuple(tuple(float(value) for value in row) for row in K)
        return with_torque(vehicle, EddyCurrents.model_validate({"K_Am2_s_per_T": rows}))
