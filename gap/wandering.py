"""A bias that wanders: is it a random walk, or something that only looks slow?

The residual is reduced to a few dozen steps an axis (any slow signal is nearly a sum of them). Under a walk the
steps are independent and Gaussian with one variance; the same columns with other priors (independent levels, a
smooth curve, one single step) are its rivals with the same degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats
from scipy.special import logsumexp

from fluxtwin.gap.blocks import Block
from fluxtwin.gap.evidence import Dictionary, Leftover
from fluxtwin.gap.flexible import FlexibleFinding
from fluxtwin.sim.effects.bias_random_walk import BiasRandomWalk
from fluxtwin.sim.types import FloatArray

_MOST_KNOTS = 48
_ROWS_A_KNOT = 8
_LOG_SIZES = np.linspace(np.log(0.003), np.log(100.0), 40)
_MARGIN = 3.0  # in log evidence: a factor of 20
_SHAPE_P = 0.005
_SETTLED = 10  # rows until the filter has forgotten where it began
_LEAST_TAIL = 0.5  # excess kurtosis that is passed over, as in the test of white noise


def random_walk(seconds: FloatArray, left: Leftover, found: Sequence[Block], sigma_nT: float) -> FlexibleFinding | None:
    """Judge a walk in a whitened residual; None where there is nothing slow at all.

    found: the blocks of the design, none of which may explain what the walk does. sigma_nT: the noise unit.
    """
    rows = seconds.size
    knots = min(_MOST_KNOTS, rows // _ROWS_A_KNOT)
    if knots < 12:
        return None
    at = np.linspace(0, rows, knots + 1).astype(int)[:-1]
    steps = (np.arange(rows)[:, None] >= at[None, 1:]).astype(float)
    columns, _ = left.project(sigma_nT * _three_axes(steps))
    gram, moment = columns.T @ columns, columns.T @ left.residual
    _, q, _ = _modes(gram, moment)
    # The noise level is that of what no step explains: a level that was declared wrong is no walk.
    variance = (left.energy - float(q @ q)) / max(left.degrees - q.size, 1)
    gram, moment = gram / variance, moment / variance
    size, walk = _evidence(gram, moment)
    if walk < 6.0:
        return None
    rivals = _rivals(gram, moment, knots - 1)
    faults = [f"{name} does as well" for name, value in rivals.items() if value > walk - _MARGIN]
    faults += _not_a_walk(gram, moment, size, knots - 1)
    reduced = _reduced(gram, moment, size)
    label, p_block = _follows(left, columns / variance, reduced, found)
    if p_block < 0.01:
        faults.append(f"it follows {label}")
    spacing = float(seconds[-1] - seconds[0]) / knots
    # Levels that are means over a spacing differ by two thirds of what the walk gains in it (in variance).
    rate = size * sigma_nT / np.sqrt(spacing * 2.0 / 3.0)
    if jumps(seconds, left, float(rate) / sigma_nT, float(variance)):
        faults.append("it jumps between levels")
    live = reduced[0].size
    words = "the bias wanders like a random walk" + (f"; but {', '.join(faults)}" if faults else "")
    parameters = {"rate": (float(rate), float(rate / np.sqrt(2 * max(live / 2, 1))), "nT/sqrt(s)")}
    p = float(np.exp(-max(walk, 0.0)))
    return FlexibleFinding("bias_random_walk", parameters, p, not faults, words, BiasRandomWalk())


def _three_axes(shapes: FloatArray) -> FloatArray:
    """(N, 3, 3k): each shape in each axis, axes fastest."""
    spread = np.eye(3)[None, :, None, :] * shapes[:, None, :, None]
    return np.asarray(spread.reshape(shapes.shape[0], 3, -1))


def _modes(gram: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    value, vector = np.linalg.eigh(gram)
    live = value > 1e-7 * value[-1]
    return value[live], (vector[:, live].T @ moment) / np.sqrt(value[live]), vector[:, live]


def _evidence(gram: FloatArray, moment: FloatArray) -> tuple[float, float]:
    """Likeliest size of the coefficients and the log evidence with the size integrated out."""
    value, q, _ = _modes(gram, moment)
    scaled = np.exp(2 * _LOG_SIZES)[:, None] * value
    logs = np.sum(-0.5 * np.log1p(scaled) + 0.5 * q**2 * scaled / (1 + scaled), axis=1)
    return float(np.exp(_LOG_SIZES[np.argmax(logs)])), float(logsumexp(logs) - np.log(logs.size))


def _rivals(gram: FloatArray, moment: FloatArray, steps: int) -> dict[str, float]:
    """Log evidences of other priors on the same columns."""
    levels = np.eye(steps) - np.eye(steps, k=-1)
    curve = np.tril(np.ones((steps, steps)))
    out = {}
    for name, change in (("independent levels", levels), ("a smooth curve", curve)):
        whole = np.kron(change, np.eye(3))
        out[name] = _evidence(whole.T @ gram @ whole, whole.T @ moment)[1]
    single = []
    for step in range(steps):
        pick = slice(3 * step, 3 * step + 3)
        single.append(_evidence(gram[pick, pick], moment[pick])[1])
    out["one step"] = max(single) - float(np.log(steps))
    return out


def _not_a_walk(gram: FloatArray, moment: FloatArray, size: float, steps: int) -> list[str]:
    faults = []
    value, q, vector = _modes(gram, moment)
    z = q / np.sqrt(1 + size**2 * value)
    informed = size**2 * value > 0.3
    thirds = np.array_split(z[informed], 3)
    p = [2 * min(stats.chi2.sf(np.sum(t**2), t.size), stats.chi2.cdf(np.sum(t**2), t.size)) for t in thirds if t.size]
    if p and min(p) * len(p) < _SHAPE_P:
        faults.append("its spectrum is not that of a walk")
    # Posterior increments over their spread under the model: one that stands out is a step, not a walk.
    shrink = size**2 * np.sqrt(value) / (1 + size**2 * value)
    increments = vector @ (shrink * q)
    spread = np.sqrt(np.einsum("ij,j->i", vector**2, shrink**2 * (1 + size**2 * value)))
    largest = float(np.max(np.abs(increments) / np.maximum(spread, 1e-12)))
    if 2 * stats.norm.sf(largest) * 3 * steps < _SHAPE_P:
        faults.append("one of its steps stands out")
    return faults


def jumps(seconds: FloatArray, left: Leftover, rate: float, variance: float) -> bool:
    """Whether single rows move further than a walk of that rate (noise units per root second) does.

    A walk seen through white noise has Gaussian innovations at every row (Harvey 1989, Forecasting, structural time
    series models and the Kalman filter, section 5.4); levels that are switched between have a few large ones.
    """
    series = left.residual.reshape(-1, 3)
    level, spread, found = np.zeros(3), 1e6 * variance, []
    for value, since in zip(series, np.diff(seconds, prepend=seconds[0]), strict=True):
        spread += rate**2 * since
        found.append((value - level) / np.sqrt(spread + variance))
        gain = spread / (spread + variance)
        level = level + gain * (value - level)
        spread *= 1.0 - gain
    z = np.array(found)[_SETTLED:]
    z = z[np.any(series[_SETTLED:] != 0, axis=1)]
    kurtosis = float(np.mean(z**4) / np.mean(z**2) ** 2 - 3.0)
    return bool(kurtosis > max(4.0 * float(np.sqrt(24.0 / z.size)), _LEAST_TAIL))


def _reduced(gram: FloatArray, moment: FloatArray, size: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Modes as data: values z with unit variance under the walk, their scale, and the map from columns to modes."""
    value, q, vector = _modes(gram, moment)
    scale = np.sqrt(1 + size**2 * value)
    return q / scale, scale, vector / np.sqrt(value)


def _follows(
    left: Leftover,
    columns: FloatArray,
    reduced: tuple[FloatArray, FloatArray, FloatArray],
    found: Sequence[Block],
) -> tuple[str, float]:
    """The block that explains most of what the walk left of itself, and its p-value after the price of them all."""
    z, scale, into = reduced
    best, tests = ("", 1.0), 0
    dictionary = found if isinstance(found, Dictionary) else Dictionary(found, left.residual.size // 3)
    # The columns are free of what was fitted, so their products with the blocks are those with the blocks freed of it.
    for block, product in zip(found, dictionary.products(left, columns @ into), strict=True):
        if len(block.axes) > 12 or block.condition in ("time", "after_time"):
            continue
        x = product.T / scale[:, None]
        u, s, _ = np.linalg.svd(x, full_matrices=False)
        live = s > 1e-5 * s[0] if s[0] > 0 else s > 0
        if not live.any():
            continue
        tests += 1
        p = float(stats.chi2.sf(np.sum((u[:, live].T @ z) ** 2), int(live.sum())))
        best = min(best, (block.label, p), key=lambda item: item[1])
    return best[0], min(best[1] * max(tests, 1), 1.0)
