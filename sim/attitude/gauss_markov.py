"""First-order Gauss-Markov noise: random errors that are correlated in time."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock


def gauss_markov(
    time: TimeArray, sigma: FloatArray | float, tau_s: float, rng: np.random.Generator, *, columns: int = 1
) -> FloatArray:
    """Stationary process with covariance sigma^2 exp(-|dt| / tau_s), columns independent. Shape (N, columns).

    sigma: standard deviation, one number or one per column, in the unit wanted. tau_s 0 gives white noise.
    Exact at any spacing of the stamps: x' = a x + sigma sqrt(1 - a^2) w, a = exp(-dt / tau_s) (Gelb 1974,
    section 4.5).
    """
    scale = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (columns,))
    scale = scale[0] if np.ndim(sigma) == 0 else scale  # a plain number takes an eighth of the time
    from fluxtwin.sim.base.recursion_kernels import recursion

    stamps = clock.as_times(time)
    white = rng.standard_normal((stamps.size, columns))
    if tau_s == 0.0:
        return white * scale
    exponent = np.diff(clock.seconds_since(stamps, stamps[0])) / tau_s
    keep = np.concatenate([[0.0], np.exp(-exponent)])
    driven = white * np.sqrt(np.concatenate([[1.0], -np.expm1(-2.0 * exponent)]))[:, None]
    return recursion(keep, driven, white, np.arange(stamps.size) == 0) * scale
