"""A bias that wanders: is it a random walk, or something that only looks slow?

The residual is reduced to the Karhunen-Loeve modes of a walk (any slow signal is nearly a sum of them). Under a walk
their coefficients are independent and Gaussian, with the variances of a walk; levels that come back have the same modes
with other variances. A step, and levels that are switched between, have increments that no Gaussian has.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from fluxtwin.calib.common.criterion import FALSE_ALARM
from fluxtwin.gap.detectors.finding import Finding, gaussian
from fluxtwin.gap.hypotheses.blocks import in_body
from fluxtwin.gap.linear.projection import SHARE_LEFT, ProjectedResidual
from fluxtwin.gap.noise.whitening import RMS
from fluxtwin.gap.selection.criterion import THRESHOLD
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.calibration import BiasRandomWalk

_COME_BACK = (8.0, 16.0)  # half periods over the record


def random_walk(
    seconds: FloatArray, left: ProjectedResidual, walking: ProjectedResidual, sigma_nT: float
) -> Finding | None:
    """A walk in a whitened residual; None where there is nothing slow at all.

    walking: the same residual, whitened with a walk in the noise. What is left of each row is what those before it do not
    foretell: Gaussian under a walk (Harvey 1989, Forecasting, structural time series models and the Kalman filter, section
    5.4), with a few large ones where levels are switched between. sigma_nT: the noise unit.
    """
    knots = 48  # increments of the walk that are looked at
    if seconds.size < 2 * knots:
        return None
    shapes = modes_of_a_walk(seconds)
    columns, _ = left.project(in_body(shapes))
    gram, moment = columns.T @ columns, columns.T @ left.residual
    _, q, _ = _modes(gram, moment)
    # The noise level is that of what no walk explains: a level that was declared wrong is no walk.
    variance = (left.energy - float(q @ q)) / max(left.degrees - q.size, 1)
    gram, moment = gram / variance, moment / variance
    sizes = np.geomspace(*RMS, 60) * sigma_nT / np.sqrt(float(seconds[-1] - seconds[0]))
    rate, value = _evidence(gram, moment, sizes)
    if value <= THRESHOLD:
        return None
    faults = [
        f"levels that come back ({k:.0f}) does as well"
        for k in _COME_BACK
        if _evidence(*_returning(gram, moment, k), sizes)[1] > value - THRESHOLD
    ]
    at = np.linspace(0, seconds.size - 1, knots + 1).astype(int)
    if _one_stands_out(gram, moment, rate, np.diff(shapes[at], axis=0)):
        faults.append("one of its steps stands out")
    innovations = walking.residual.reshape(-1, 3)
    largest = np.argmax(np.abs(innovations).max(axis=1))  # one alone is a step, or a wrong reading
    innovations = np.delete(innovations, largest, axis=0)
    if not gaussian(innovations[innovations != 0]):  # one that was left out is zero
        faults.append("it jumps between levels")
    size, what = np.array([rate]), "the bias wanders like a random walk"
    return Finding(BiasRandomWalk(), size, size / np.sqrt(max(q.size, 2)), value, what, tuple(faults))


def worth_of_a_walk(seconds: FloatArray, left: ProjectedResidual, rate: float) -> float:
    """Twice the log of the Bayes factor of a walk of that rate [nT/sqrt(s)] in a whitened residual, against none."""
    columns, _ = left.project(in_body(modes_of_a_walk(seconds)))
    variance = left.energy / left.degrees
    return _evidence(columns.T @ columns / variance, columns.T @ left.residual / variance, np.array([rate]))[1]


def _modes(gram: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    value, vector = np.linalg.eigh(gram)
    live = value > SHARE_LEFT * value[-1]
    return value[live], (vector[:, live].T @ moment) / np.sqrt(value[live]), vector[:, live]


def _evidence(gram: FloatArray, moment: FloatArray, sizes: FloatArray) -> tuple[float, float]:
    """Likeliest size of the coefficients, and twice the log of the Bayes factor against none, the size integrated out."""
    value, q, _ = _modes(gram, moment)
    scaled = sizes[:, None] ** 2 * value
    logs = np.sum(-0.5 * np.log1p(scaled) + 0.5 * q**2 * scaled / (1 + scaled), axis=1)
    return float(sizes[np.argmax(logs)]), 2.0 * float(np.logaddexp.reduce(logs) - np.log(logs.size))


def _returning(gram: FloatArray, moment: FloatArray, bend: float) -> tuple[FloatArray, FloatArray]:
    """Gram matrix and moments of the same modes with the spectrum of levels that come back (a random telegraph too): flat
    below the inverse of their memory, a walk above; of the same variance in all."""
    waves = np.arange(moment.size // 3) + 0.5
    walk, spread = 1.0 / waves, 1.0 / np.hypot(waves, bend)
    weight = np.repeat(spread / walk * np.sqrt(np.sum(walk**2) / np.sum(spread**2)), 3)
    return gram * np.outer(weight, weight), moment * weight


def _one_stands_out(gram: FloatArray, moment: FloatArray, size: float, between: FloatArray) -> bool:
    """Whether one increment is too large for a walk: it is a step. between: (m, k) what each mode gains in each.

    Posterior increments over their spread under the model.
    """
    value, q, vector = _modes(gram, moment)
    shrink = size**2 * np.sqrt(value) / (1 + size**2 * value)
    paths = np.kron(between, np.eye(3)) @ vector
    increments = paths @ (shrink * q)
    spread = np.sqrt(np.einsum("ij,j->i", paths**2, shrink**2 * (1 + size**2 * value)))
    largest = float(np.max(np.abs(increments) / np.maximum(spread, 1e-12)))
    return bool(2 * stats.norm.sf(largest) * increments.size < FALSE_ALARM)


def modes_of_a_walk(seconds: FloatArray) -> FloatArray:
    """(N, k) Karhunen-Loeve modes of a walk of 1 nT/sqrt(s) that begins with the record, times their spread [sqrt(s)].

    Sines of k - 1/2 half periods over the record, of variance falling with the square of that number (Loeve 1978,
    Probability theory II, section 37.5).
    """
    begin = float(seconds[0])
    span = float(seconds[-1]) - begin
    # Beyond four times the root of the rows a walk of three times the noise is below it.
    count = int(min(4.0 * np.sqrt(seconds.size), 160, seconds.size // 2))
    waves = np.pi * (np.arange(count) + 0.5)
    return np.asarray(np.sqrt(2.0 * span) * np.sin(waves * (seconds - begin)[:, None] / span) / waves)
