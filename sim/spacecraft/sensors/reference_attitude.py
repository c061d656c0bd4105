"""The reference attitude that the ground is given: an error model, or sun and nadir measurements."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.references import triad_matrices

_LEAST_SEPARATION_RAD = np.radians(3.0)


def attitude_with_error(
    time: TimeArray, R_BN: Rotation, sigma_rad: FloatArray | float, tau_s: float, rng: np.random.Generator
) -> Rotation:
    """Reported attitude: the true R_BN (batch of N) turned by a small random rotation about the body axes.

    R_reported = exp([theta x]) R_BN, theta per body axis a stationary first-order Gauss-Markov process with
    standard deviation sigma_rad (one number, or three) and time constant tau_s (0: white), exact for uneven
    stamps. A field v_B is thus predicted as v_B + theta x v_B.
    """
    theta_B_rad = gauss_markov(time, sigma_rad, tau_s, rng, columns=3)
    return frames.product(Rotation.from_rotvec(theta_B_rad), R_BN)


def attitude_from_sun_and_nadir(
    sun_B: FloatArray, nadir_B: FloatArray, sun_N: FloatArray, nadir_N: FloatArray
) -> FloatArray:
    """Attitude as q_NB (N, 4), textbook quaternion, scalar last, by the algebraic method (TRIAD).

    Nadir is matched exactly; the sun gives the turn about it (Wertz 1978, section 12.2.2). All arguments
    (N, 3); lengths do not matter. Rows are NaN where a vector is NaN, or where sun and nadir, or their
    opposites, are less than three degrees apart in either frame: there the turn is not known.
    """
    sines = [np.sin(frames.angle_between(*pair)) for pair in ((nadir_B, sun_B), (nadir_N, sun_N))]
    q, known = np.full((len(sun_B), 4), np.nan), np.min(sines, axis=0) > np.sin(_LEAST_SEPARATION_RAD)
    if known.any():
        B, N = triad_matrices(nadir_B[known], sun_B[known]), triad_matrices(nadir_N[known], sun_N[known])
        q[known] = frames.q_from_rotation(Rotation.from_matrix(np.swapaxes(B, 1, 2) @ N))
    return q
