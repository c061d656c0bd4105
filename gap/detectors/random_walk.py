"""A bias that wanders: is it a random walk, or something that only looks slow?

The residual is reduced to the Karhunen-Loeve modes of a walk (any slow signal is nearly a sum of them). Under a walk
their coefficients are independent and Gaussian, with the variances of a walk; the same modes with the variances of
independent levels or of a smooth curve, and one single step, are its rivals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from fluxtwin.gap.detectors.flexible import FlexibleFinding
from fluxtwin.gap.hypotheses.blocks import Block
from fluxtwin.gap.hypotheses.evidence import Dictionary
from fluxtwin.gap.linear.leftover import Leftover
from fluxtwin.gap.noise.walk import LOG_RMS, modes_of_a_walk, three_axes
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.calibration import BiasRandomWalk

_MOST_KNOTS = 48
_ROWS_A_KNOT = 8
_STEPS = np.exp(np.linspace(np.log(0.003), np.log(100.0), 40))  # noise units
_COME_BACK = (8.0, 16.0)  # half periods over the record
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
    shapes = modes_of_a_walk(seconds)
    columns, _ = left.project(three_axes(shapes))
    gram, moment = columns.T @ columns, columns.T @ left.residual
    _, q, _ = _modes(gram, moment)
    # The noise level is that of what no walk explains: a level that was declared wrong is no walk.
    variance = (left.energy - float(q @ q)) / max(left.degrees - q.size, 1)
    gram, moment = gram / variance, moment / variance
    sizes = np.exp(LOG_RMS) * sigma_nT / np.sqrt(float(seconds[-1] - seconds[0]))
    rate, walk = _evidence(gram, moment, sizes)
    if walk < 6.0:
        return None
    rivals = _rivals(gram, moment, sizes)
    rivals["one step"] = _one_step(left, seconds, knots, variance)
    faults = [f"{name} does as well" for name, value in rivals.items() if value > walk - _MARGIN]
    at = np.linspace(0, rows - 1, knots + 1).astype(int)
    faults += _not_a_walk(gram, moment, rate, np.diff(shapes[at], axis=0))
    reduced = _reduced(gram, moment, rate)
    label, p_block = _follows(left, columns / variance, reduced, found)
    if p_block < 0.01:
        faults.append(f"it follows {label}")
    if jumps(seconds, left, rate, float(variance)):
        faults.append("it jumps between levels")
    live = reduced[0].size
    words = "the bias wanders like a random walk" + (f"; but {', '.join(faults)}" if faults else "")
    parameters = {"rate": (rate, float(rate / np.sqrt(2 * max(live / 2, 1))), "nT/sqrt(s)")}
    p = float(np.exp(-max(walk, 0.0)))
    return FlexibleFinding("bias_random_walk", parameters, p, not faults, words, BiasRandomWalk())


def _modes(gram: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    value, vector = np.linalg.eigh(gram)
    live = value > 1e-7 * value[-1]
    return value[live], (vector[:, live].T @ moment) / np.sqrt(value[live]), vector[:, live]


def _evidence(gram: FloatArray, moment: FloatArray, sizes: FloatArray) -> tuple[float, float]:
    """Likeliest size of the coefficients and the log evidence with the size integrated out."""
    value, q, _ = _modes(gram, moment)
    scaled = sizes[:, None] ** 2 * value
    logs = np.sum(-0.5 * np.log1p(scaled) + 0.5 * q**2 * scaled / (1 + scaled), axis=1)
    return float(sizes[np.argmax(logs)]), float(np.logaddexp.reduce(logs) - np.log(logs.size))


def _rivals(gram: FloatArray, moment: FloatArray, sizes: FloatArray) -> dict[str, float]:
    """Log evidences of other spectra on the same modes, of the same spread in all."""
    waves = np.arange(moment.size // 3) + 0.5
    walk, out = 1.0 / waves, {}
    others = {"independent levels": np.ones_like(waves), "a smooth curve": walk**2}
    # Levels that come back (a random telegraph too): flat below the inverse of their memory, a walk above.
    others |= {f"levels that come back ({k:.0f})": 1.0 / np.hypot(waves, k) for k in _COME_BACK}
    for name, spread in others.items():
        weight = np.repeat(spread / walk * np.sqrt(np.sum(walk**2) / np.sum(spread**2)), 3)
        out[name] = _evidence(gram * np.outer(weight, weight), moment * weight, sizes)[1]
    return out


def _one_step(left: Leftover, seconds: FloatArray, knots: int, variance: float) -> float:
    """Log evidence of one step between two of some knots."""
    at = np.linspace(0, seconds.size, knots + 1).astype(int)[1:-1]
    columns, size = left.project(three_axes((np.arange(seconds.size)[:, None] >= at).astype(float)))
    unit = np.sqrt(np.median(size) / seconds.size)  # one noise unit a reading
    gram, moment = columns.T @ columns / (variance * unit**2), columns.T @ left.residual / (variance * unit)
    picks = [slice(3 * step, 3 * step + 3) for step in range(at.size)]
    return max(_evidence(gram[one, one], moment[one], _STEPS)[1] for one in picks) - float(np.log(at.size))


def _not_a_walk(gram: FloatArray, moment: FloatArray, size: float, between: FloatArray) -> list[str]:
    """between: (m, k) what each mode gains from one knot to the next."""
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
    paths = np.kron(between, np.eye(3)) @ vector
    increments = paths @ (shrink * q)
    spread = np.sqrt(np.einsum("ij,j->i", paths**2, shrink**2 * (1 + size**2 * value)))
    largest = float(np.max(np.abs(increments) / np.maximum(spread, 1e-12)))
    if 2 * stats.norm.sf(largest) * increments.size < _SHAPE_P:
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
    """The block that explains most of what the walk left of itself, and its p-value corrected for their number."""
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
