"""Numbers behind the papers' definitions (claims 1-6): each equation evaluated against an independent route."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.design import assemble
from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.seasat.mission import Flight
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel


def check_identities(flight: Flight, ground: FieldModel) -> Numbers:
    """Evaluate all of them on one flight; each number should be at rounding level."""
    truth = flight.truth
    stray = truth.dipole_B_Am2 @ truth.T_nT_per_Am2.T
    back = truth.ideal_B_nT @ (np.eye(3) + truth.S).T + truth.b_nT + stray
    fit = calibrate_linear(flight.telemetry, ground, errors_in_variables=False, robust="none")
    design = assemble(flight.telemetry, ground, with_dipole=False)
    H, B = design.H_nT, design.B_nT
    S, b = fit.calibration.S, fit.calibration.b_nT
    centred_B, centred_h = B - B.mean(axis=0), (H - B) - (H - B).mean(axis=0)
    BB, hB = centred_B.T @ centred_B / len(B), centred_h.T @ centred_B / len(B)
    explicit = hB @ np.linalg.inv(BB)
    normal = np.abs(S @ BB - hB).max() / np.abs(hB).max()
    mean = np.abs((H - B).mean(axis=0) - S @ B.mean(axis=0) - b).max() / np.abs(b).max()
    return Numbers(
        # Largest error of (I+S) B + b + T D = A B0 on readings without noise and rounding.
        equation_1_nT=np.abs(back - truth.field_B_nT - truth.unknown_B_nT).max(),
        # Largest departure of the orbital axes from z = nadir, y = -orbit normal, x = y cross z.
        frame_error=_frame_error(flight),
        # Smallest relative growth of the loss (2) when a parameter is moved by a hundredth of its sigma; > 0.
        loss_excess=_loss_excess(H, B, S, b, fit.calibration.sigmas),
        # Largest relative violation of (5a)-(5c) by the fit.
        normal_equations=max(normal, mean),
        # Largest difference between the fit's S and the explicit equation 9.
        equation_8_difference=np.abs(explicit - S).max(),
        # A pure misalignment of 1 deg as I+S: departure from orthogonality and from 1 deg.
        rotation_error_deg=_rotation_error_deg(),
    )


def _frame_error(flight: Flight) -> float:
    world = flight.world
    nadir = -world.r_N_km / np.linalg.norm(world.r_N_km, axis=1)[:, None]
    normal = np.cross(world.r_N_km, world.v_N_km_s)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    axes = [world.R_ON.apply(v) for v in (np.cross(-normal, nadir), -normal, nadir)]
    return float(max(np.abs(axis - np.eye(3)[k]).max() for k, axis in enumerate(axes)))


def _loss_excess(H: FloatArray, B: FloatArray, S: FloatArray, b: FloatArray, sigmas: FloatArray) -> float:
    def loss(S_try: FloatArray, b_try: FloatArray) -> float:
        return float(np.mean(np.sum((H - B - b_try - B @ S_try.T) ** 2, axis=1)))

    least = loss(S, b)
    excess = []
    for number, sigma in enumerate(sigmas[:12]):
        for sign in (-0.01, 0.01):
            step = np.zeros(12)
            step[number] = sign * sigma
            excess.append(loss(S + step[:9].reshape(3, 3), b + step[9:]) / least - 1.0)
    return min(excess)


def _rotation_error_deg() -> float:
    turn = frames.rotation_BO(np.radians([1.0]), np.zeros(1), np.zeros(1)).as_matrix()[0]
    S = turn - np.eye(3)
    orthogonal = np.abs((np.eye(3) + S).T @ (np.eye(3) + S) - np.eye(3)).max()
    misalignment = np.linalg.norm(Rotation.from_matrix(np.eye(3) + S).as_rotvec())
    return float(np.degrees(abs(misalignment - np.radians(1.0)) + orthogonal))
