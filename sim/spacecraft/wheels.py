"""Reaction and momentum wheels: speeds from the momentum that they have to hold."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.types import FloatArray

RPM_PER_RAD_S = 60.0 / (2.0 * np.pi)


def wheel_speed_rpm(
    momentum_B_Nms: FloatArray,
    axes_B: FloatArray,
    inertia_kg_m2: float,
    bias_rpm: FloatArray | float = 0.0,
) -> FloatArray:
    """Speeds (N, W) of W wheels with spin axes axes_B (W, 3) and the moment inertia_kg_m2 each.

    momentum_B_Nms (N, 3) is held besides the bias speeds' own momentum, shared with the least sum of squared
    speeds (pseudo-inverse). Components that the axes do not span are left to other actuators.
    """
    axes = np.atleast_2d(np.asarray(axes_B, dtype=np.float64))
    share = np.linalg.pinv((axes / np.linalg.norm(axes, axis=1)[:, None]).T)
    spin_rad_s = np.atleast_2d(momentum_B_Nms) @ share.T / inertia_kg_m2
    return np.asarray(spin_rad_s * RPM_PER_RAD_S + np.asarray(bias_rpm, dtype=np.float64))


def periodic_momentum_B_Nms(phase_rad: FloatArray, amplitude_B_Nms: tuple[float, float, float]) -> FloatArray:
    """Momentum (N, 3) that swings with an angle such as the argument of latitude, one amplitude an axis.

    Cyclic torques (gravity gradient, aerodynamic) are absorbed and given back once or twice an orbit; pass
    twice the argument of latitude for the latter.
    """
    return np.asarray(amplitude_B_Nms, dtype=np.float64) * np.sin(np.asarray(phase_rad))[:, None]
