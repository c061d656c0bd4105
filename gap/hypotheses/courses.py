"""What each stage could do if its quantity went its own way: any course in time that is smooth on one of a few scales.

A block is the likeness of a cause that follows a known condition. A cause that follows none (a load that nobody logs, a
clock that runs by the day, rows out of order) still has its stage's image: a late stamp lies along dB/dt, a turn across the
field, and a field of the body is steady in the body while it turns. So each stage's quantity is a Gaussian process: values
at evenly spaced knots, independent and of one variance, with straight lines between them; or a value of its own in each
row. Its evidence at the likeliest variance is that of a random effect (Harville 1977, J. Am. Stat. Assoc. 72, 320).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.criterion import penalty
from fluxtwin.gap.hypotheses.blocks import DEFAULT_BODY, Carrier
from fluxtwin.gap.hypotheses.conditions import always
from fluxtwin.gap.linear.projection import SHARE_LEFT, ProjectedResidual
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import FloatArray

_PARTS = (8, 32, 128)
"""Into which the knots cut a record. Of 60 gaps of unknown cause on a tuning seed (docs/design/ablation.md) the likeliest
stage is the true one in 27 without courses, in 39 with them."""
_LARGEST = 12.0
"""Logarithm of the largest size of a course over the noise, and of the noise over the smallest: far beyond what is seen."""


@dataclass(frozen=True, eq=False)
class CourseFit:
    """A course of one stage against a residual."""

    stages: Mapping[str, float]
    """The stages it may belong to, with their prior shares."""
    frame: str | None
    energy: FloatArray
    """(k,) of each independent direction of its columns, whitened and with the fitted columns out of them."""
    square: FloatArray
    """(k,) of the product of each direction with the residual."""

    def worth(self, variance: float, samples: float) -> tuple[float, float, float]:
        """Twice the log of its Bayes factor against noise of that variance, the drop of chi-square, and the parameters
        that bring it, counted by how free they are."""
        sizes = np.exp(np.arange(-_LARGEST, _LARGEST, 0.5))[:, None]
        free = sizes * self.energy / (1.0 + sizes * self.energy)
        drops = (self.square / self.energy * free).sum(axis=1) / variance
        values = drops - np.log1p(sizes * self.energy).sum(axis=1)
        best = int(np.argmax(values))
        gain = float(values[best])
        return gain - float(penalty(1, max(gain, 0.0), samples)), float(drops[best]), float(free[best].sum())


def courses(problem: Problem, left: ProjectedResidual) -> list[CourseFit]:
    """A course at each stage, in each frame, on each scale."""
    carrier, steady, seconds = Carrier(problem), always(problem.setting), problem.setting.seconds
    late = carrier.late(steady)
    carried: list[tuple[Mapping[str, float], str | None, FloatArray]] = [
        (DEFAULT_BODY, "body", carrier.additive(steady, "body")),
        ({"sensor": 1.0}, "body", carrier.gain(steady)),
        ({"orbit": 1.0}, "orbital", carrier.moved(steady)),
        ({"time": 1.0}, None, late),
        ({"field": 1.0}, "earth", carrier.additive(steady, "local")),
        *(({"field": 1.0}, frame, carrier.additive(steady, frame)) for frame in ("orbital", "inertial", "earth")),
        *(({"attitude": 1.0}, frame, carrier.turned(steady, frame)) for frame in ("body", "orbital", "inertial")),
    ]
    spacings = [float(seconds[-1] - seconds[0]) / parts for parts in _PARTS]
    scales = [_hats(seconds, one) for one in spacings if one > 2.0 * float(np.median(np.diff(seconds)))]
    smooth = [_smooth(left, *one, scale) for scale in scales for one in carried]
    # A clock does not jump to and fro from row to row; rows that are repeated or out of order do.
    rows_apart = [_of_each_row(left, {"telemetry": 0.5, "time": 0.5}, None, late)]
    rows_apart += [_of_each_row(left, *one) for one in carried if "attitude" in one[0] and one[1] == "body"]
    return [*smooth, *rows_apart]


def _smooth(
    left: ProjectedResidual, stages: Mapping[str, float], frame: str | None, image: FloatArray, scale: FloatArray
) -> CourseFit:
    """image (N, 3, m) of the quantity; scale (N, k) of its course at each knot."""
    columns = (image[:, :, None, :] * scale[:, None, :, None]).reshape(len(image), 3, -1)
    free, size = left.project(columns)
    free /= np.sqrt(np.mean(size))
    energy, direction = np.linalg.eigh(free.T @ free)
    seen = energy > SHARE_LEFT * energy[-1]
    return CourseFit(stages, frame, energy[seen], (direction[:, seen].T @ (free.T @ left.residual)) ** 2)


def _of_each_row(
    left: ProjectedResidual, stages: Mapping[str, float], frame: str | None, image: FloatArray
) -> CourseFit:
    """A value of its own in each row. What the fitted columns take of it is left in: they are few beside the rows."""
    white = left.whitener.apply(np.ascontiguousarray(image))
    direction, size, _ = np.linalg.svd(white / np.sqrt(np.mean(white**2)), full_matrices=False)
    square = (size * np.einsum("nik,ni->nk", direction, left.residual.reshape(-1, 3))) ** 2
    seen = size**2 > SHARE_LEFT  # not where a row is cut
    return CourseFit(stages, frame, size[seen] ** 2, square[seen])


def _hats(seconds: FloatArray, spacing: float) -> FloatArray:
    """(N, k) of a straight line between knots, by its values at those that have rows beside them."""
    place = (seconds - seconds[0]) / spacing
    before = np.floor(place).astype(np.intp)
    knots = np.unique(np.concatenate([before, before + 1]))
    found, rows = np.zeros((seconds.size, knots.size)), np.arange(seconds.size)
    found[rows, np.searchsorted(knots, before)] = before + 1 - place
    found[rows, np.searchsorted(knots, before + 1)] += place - before
    return found
