"""What a detector proposes: a cause with a waveform or a distribution of its own; and whether a waveform is all there is.

A line or an on/off sequence is found because it fits, and so may a piece of something else: one side band of an
error of the clock, the passes through a region. What tells them apart is that a wheel or a heater has one field in
body axes, whatever the orbit, the ambient field and its slope do. So the found columns are multiplied by each of
these, and what the products explain has to stand out of the noise and of the error that the waveform may have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.gap.hypotheses.blocks import BlockFit
from fluxtwin.gap.linear.projection import SHARE_LEFT, ProjectedResidual
from fluxtwin.gap.selection import criterion
from fluxtwin.gap.selection.criterion import SHAPE, THRESHOLD, worth
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.signal import Setting


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that a detector found, its worth, and what in the data the effect would not make."""

    effect: Effect
    """With its discrete settings."""
    theta: FloatArray
    """(p,) its parameters."""
    sigma: FloatArray
    worth: float = 0.0
    """Twice the log of the Bayes factor against nothing, by the criterion."""
    what: str = ""
    """What was found, in words."""
    faults: tuple[str, ...] = ()
    hidden_nT: float = 0.0
    """rms per component of what wrong readings have that the noise hides, and that are therefore not excluded."""
    chance: float = 1.0
    """Probability of as much by chance, where the distribution of what was measured is known."""

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def is_signal(self) -> bool:
        """Whether it has a course that a fit can have; else it is known by its distribution."""
        return isinstance(self.effect, SignalEffect)

    @property
    def is_noise(self) -> bool:
        """Whether it is new in every row, and so stands beside something unknown, which a signal or a walk would be."""
        return not self.is_signal and self.effect.follows is None

    @property
    def confirmed(self) -> bool:
        return bool(criterion.stands_out(self.p_value, self.worth)) and not self.faults

    @property
    def words(self) -> str:
        """What was found, and what speaks against the effect."""
        return f"{self.what}; but {', '.join(self.faults)}" if self.faults else self.what

    @property
    def p_value(self) -> float:
        """By chance; a Bayes factor of k against nothing at most once in k times (Markov's inequality)."""
        return min(self.chance, float(np.exp(-0.5 * max(self.worth, 0.0))))

    @property
    def probability(self) -> float:
        """That this effect is present: 1 - p, at least 0.5."""
        return max(0.5, 1.0 - self.p_value)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Columns fitted to a whitened residual, given what was fitted before."""

    size: FloatArray
    """(k,) coefficients."""
    covariance: FloatArray
    """(k, k) of the coefficients, with the noise that is left."""
    drop: float
    """Of chi-square, in units of the noise that is left."""
    rank: int
    variance: float
    """Of the noise that is left."""
    samples: float
    """Readings in time: a third of the degrees of freedom."""

    def worth(self, log_tried: float, further: int = 0) -> float:
        """By the criterion. further: parameters that were searched for besides the coefficients."""
        return worth(self.drop, self.rank + further, self.samples, log_tried)

    @property
    def energy(self) -> float:
        """What the columns explain, in units of the whitening."""
        return self.drop * self.variance

    @property
    def sigma(self) -> FloatArray:
        """(k,) of the coefficients."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def fitted(left: ProjectedResidual, columns: FloatArray, further: int = 0) -> Fitted:
    """Fit columns (N, 3, k). further: parameters that were searched for besides the coefficients."""
    white = left.whitener.apply(np.ascontiguousarray(columns)).reshape(left.residual.size, -1)
    known, gram = left.basis.T @ white, white.T @ white
    # The rounding of these products is far below the share that a direction must have left.
    values, vectors = np.linalg.eigh(gram - known.T @ known)
    live = values > SHARE_LEFT * float(np.diag(gram).max())
    along = vectors[:, live].T @ (white.T @ left.residual)
    gain, rank = float(np.sum(along**2 / values[live])), int(live.sum())
    variance = max((left.energy - gain) / max(left.degrees - rank - further, 1), 1e-300)
    inverse = (vectors[:, live] / values[live]) @ vectors[:, live].T
    size = (vectors[:, live] / values[live]) @ along
    return Fitted(size, variance * inverse, gain / variance, rank, variance, left.degrees / 3.0)


def in_parts(columns: FloatArray, count: int) -> list[FloatArray]:
    """Columns (N, 3, k) with nothing outside each of so many parts of the record."""
    rows = np.arange(len(columns))
    return [np.where(np.isin(rows, part)[:, None, None], columns, 0.0) for part in np.array_split(rows, count)]


def stands_out(left: ProjectedResidual, columns: FloatArray, others: FloatArray, log_tried: float = 0.0) -> bool:
    """Whether others (N, 3, m) explain more, given the columns (N, 3, k), than noise and the error of their shape."""
    few, many = fitted(left, columns), fitted(left, np.concatenate([columns, others], axis=2))
    rank = many.rank - few.rank
    if rank <= 0:
        return False
    explained = few.energy / many.variance
    more = (many.drop - explained) / (1.0 + SHAPE * explained)
    return worth(more, rank, many.samples, log_tried) > THRESHOLD


def varies(left: ProjectedResidual, columns: FloatArray, drivers: Mapping[str, FloatArray]) -> list[str]:
    """Which drivers, (N, m) by name, the size or direction of columns (N, 3, k) changes with."""
    found = []
    for name, driver in drivers.items():
        products = columns[:, :, :, None] * driver[:, None, None, :]
        if stands_out(left, columns, products.reshape(*columns.shape[:2], -1), float(np.log(len(drivers)))):
            found.append(f"its field changes with {name}")
    return found


def drivers(setting: Setting) -> dict[str, FloatArray]:
    """(N, m) what a field of the spacecraft's own knows nothing of: orbit phase, ambient field, its slope; unit rms."""
    (r, _, R_BN), u = setting.given, setting.orbit_phase_rad
    field_N = field_N_nT(setting.model, setting.time, r) if setting.field_N_nT is None else setting.field_N_nT
    field_B = R_BN.apply(field_N)
    rate_B, along_N = setting.rates(0.0)
    slope_B = R_BN.apply(along_N) - np.cross(rate_B, field_B)
    waves = np.stack([np.cos(u), np.sin(u), np.cos(2 * u), np.sin(2 * u)], axis=1)
    return {"the orbit phase": waves, "the ambient field": _unit(field_B), "the slope of the field": _unit(slope_B)}


def _unit(columns: FloatArray) -> FloatArray:
    return np.asarray(columns / max(float(np.sqrt(np.mean(columns**2))), 1e-12))


def does_as_well(own: float, given: Fitted, rivals: Sequence[BlockFit]) -> list[str]:
    """The first block whose worth is at least a waveform's own, in the noise that the waveform leaves."""
    log_tried = float(np.log(max(len(rivals), 1)))
    for one in rivals:
        gain, rank = one.explained()
        if worth(gain / given.variance, rank, given.samples, log_tried) >= own:
            return [f"{one.block.label} does as well"]
    return []


def gaussian(values: FloatArray) -> bool:
    """Whether values of mean zero have the tails of a Gaussian: the kurtosis of n of them scatters by sqrt(24 / n), and real
    noise is not quite Gaussian."""
    kurtosis = float(np.mean(values**4) / np.mean(values**2) ** 2) - 3.0
    return abs(kurtosis) <= max(4.0 * float(np.sqrt(24.0 / values.size)), 0.5)
