"""The rival: stepwise regression by an information criterion, as a plain statistician would do it.

It has what the diagnosis has: the same Jacobians, the same choice of noise and whitening (outliers cut), the
calibration always in. It is linear. An effect goes in or out as a whole, by its best alternative; forward and backward
steps are taken in turn until neither helps. It has no gate, no refit, no look at what is left. Names that do as well as
the one it took are a group, as in the diagnosis. It answers twice, by BIC and by EBIC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import gammaln

from fluxtwin.gap.hypotheses.blocks import blocks
from fluxtwin.gap.hypotheses.candidates import Candidate, candidates
from fluxtwin.gap.linear.projection import least_share, orthonormal
from fluxtwin.gap.noise.choice import choose_noise, whitener_of
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, Budget, Problem, pose
from fluxtwin.gap.selection.refit import settled
from fluxtwin.gap.selection.score import ALIKE
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

MOST_ROWS = 5_000
"""Longer records are thinned evenly, as the diagnosis does for what is slow."""
_MOST_STEPS = 40
_LARGEST, _IN_GROUP = 3, 0.05


def installed() -> bool:
    """It needs nothing beyond the product."""
    return True


@dataclass(frozen=True, eq=False)
class Regression:
    """Whitened regression beside the calibration, P directions of K candidates."""

    names: tuple[str, ...]
    """(K,) effect of each candidate; alternatives share a name."""
    gram: FloatArray
    """(P, P) inner products; each candidate's own block is the unit matrix."""
    score: FloatArray
    """(P,) residual along each direction."""
    owner: FloatArray
    """(P,) number of the candidate that a direction belongs to."""
    chi2: float
    """Of the residual beside the calibration."""
    samples: int
    """Readings of one axis that are not cut, less those that the calibration takes."""
    least: float
    """Of its length squared that a direction must have beside others."""

    def explained(self, chosen: Sequence[int]) -> tuple[float, int]:
        """Drop of chi-square by these candidates together, and how many directions they are."""
        inside = np.isin(self.owner, chosen)
        if not inside.any():
            return 0.0, 0
        values, vectors = np.linalg.eigh(self.gram[np.ix_(inside, inside)])
        good = values > self.least
        return float(np.sum((vectors[:, good].T @ self.score[inside]) ** 2 / values[good])), int(good.sum())

    def share(self, one: int, other: int) -> float:
        """Of the directions of one candidate, what another can imitate."""
        mine = self.owner == one
        return float(np.sum(self.gram[np.ix_(mine, self.owner == other)] ** 2)) / max(int(mine.sum()), 1)


@dataclass(frozen=True)
class Criterion:
    """Schwarz's criterion (1978) or its extension for many candidates (Chen and Chen 2008)."""

    variance: str = "free"
    """free: of the rows, profiled out as in every textbook; model: 1, what the whitening has."""
    gamma: float = 0.0
    """Weight of the number of ways to choose: 0 is BIC, 1 EBIC."""

    def cost(self, problem: Regression, chosen: Sequence[int]) -> float:
        """Lower is better."""
        drop, rank = problem.explained(chosen)
        left, n = max(problem.chi2 - drop, 1e-12), float(problem.samples)
        fit = n * np.log(left / n) if self.variance == "free" else left
        many, taken = len(problem.names), len(chosen)
        ways = gammaln(many + 1) - gammaln(taken + 1) - gammaln(many - taken + 1)
        return float(fit + rank * np.log(n) + 2.0 * self.gamma * ways)


BIC = Criterion(gamma=0.0)
EBIC = Criterion(gamma=1.0)
"""Sees as many as plain BIC and adds less that is not there."""
CRITERIA = {"BIC": BIC, "EBIC": EBIC}


def answer(
    path: Path | str,
    *,
    noise_nT: float | None = None,
    lsb_nT: float | None = None,
    attitude_sigma_deg: float | None = None,
    modelled: Sequence[str] = DEFAULT_MODELLED,
    degree: int | None = None,
) -> dict[str, list[list[str]]]:
    """By criterion, the groups of the effects that stay in the regression, in the order in which they went in."""
    sigma = None if attitude_sigma_deg is None else float(np.radians(attitude_sigma_deg))
    budget = Budget(noise_nT=noise_nT, lsb_nT=lsb_nT, attitude_sigma_rad=sigma)
    problem = regression(read_telemetry(Path(path)), modelled=modelled, budget=budget, degree=degree)
    return {name: grouped(problem, criterion) for name, criterion in CRITERIA.items()}


def stepwise(problem: Regression, criterion: Criterion = EBIC) -> list[str]:
    """Names of what `chosen_by` leaves in."""
    return [problem.names[number] for number in chosen_by(problem, criterion)]


def grouped(problem: Regression, criterion: Criterion) -> list[list[str]]:
    """Of each effect that stays in, its name and at most two that these data do not tell from it."""
    chosen = chosen_by(problem, criterion)
    return [[problem.names[number], *alike(problem, criterion, chosen, number)][:_LARGEST] for number in chosen]


def alike(problem: Regression, criterion: Criterion, chosen: Sequence[int], number: int) -> list[str]:
    """Names that each imitate 0.98 of an effect, then those that have 5 % of the weight exp(-cost / 2) in its place."""
    kept = [one for one in chosen if one != number]
    taken = {problem.names[one] for one in chosen}
    weights: dict[str, float] = {}
    imitated: list[str] = []
    own = criterion.cost(problem, chosen)
    for other, name in enumerate(problem.names):
        if name not in taken:
            worse = criterion.cost(problem, [*kept, other]) - own
            weights[name] = max(weights.get(name, 0.0), float(np.exp(-0.5 * np.clip(worse, 0.0, 1400.0))))
            if min(problem.share(number, other), problem.share(other, number)) >= ALIKE:
                imitated.append(name)
    total = 1.0 + sum(weights.values())
    likely = [n for n, w in sorted(weights.items(), key=lambda pair: -pair[1]) if w >= _IN_GROUP * total]
    return list(dict.fromkeys([*imitated, *likely]))


def chosen_by(problem: Regression, criterion: Criterion) -> list[int]:
    """One effect in or out, whichever lowers the criterion most, until none does."""
    chosen: list[int] = []
    best = criterion.cost(problem, chosen)
    for _ in range(_MOST_STEPS):
        taken = {problem.names[number] for number in chosen}
        free = [number for number, name in enumerate(problem.names) if name not in taken]
        trials = [[*chosen, number] for number in free]
        trials += [[one for one in chosen if one != number] for number in chosen]
        costs = [criterion.cost(problem, trial) for trial in trials]
        if not costs or min(costs) >= best - 1e-9:
            break
        best = min(costs)
        chosen = trials[int(np.argmin(costs))]
    return chosen


def regression(
    record: Telemetry, *, modelled: Sequence[str] = DEFAULT_MODELLED, budget: Budget, degree: int | None = None
) -> Regression:
    """The whitened regression of a record."""
    every = max(1, int(np.ceil(len(record) / MOST_ROWS)))
    thinned = record if every == 1 else record.select(slice(None, None, every))
    problem = settled(pose(thinned, load_field("igrf14", degree), modelled=modelled, budget=budget))
    found, _ = candidates(problem)
    noise, robust = choose_noise(problem, _saturated(problem, found))
    whitener = whitener_of(problem, noise, robust.weights)
    calibration = orthonormal(whitener.apply(problem.nuisance))
    residual = _beside(calibration, whitener.apply(problem.residual_nT)[:, :, None])[:, 0]
    least, live = least_share(whitener), [candidate.jacobian[:, :, candidate.live] for candidate in found]
    parts = [_directions(calibration, whitener.apply(jacobian), least) for jacobian in live]
    columns = np.concatenate([*parts, np.zeros((residual.size, 0))], axis=1)
    owner = np.concatenate([*(np.full(part.shape[1], k) for k, part in enumerate(parts)), np.zeros(0, dtype=int)])
    return Regression(
        tuple(candidate.name for candidate in found),
        columns.T @ columns,
        columns.T @ residual,
        owner,
        float(residual @ residual),
        whitener.measured - calibration.shape[1],
        least,
    )


def _saturated(problem: Problem, found: Sequence[Candidate]) -> FloatArray:
    """(N, 3, P) Jacobians of all candidates and smooth structure, as far as the rows can bear them."""
    columns = [candidate.jacobian for candidate in found]
    room = int(problem.measured.sum()) // 3 - sum(part.shape[2] for part in columns)
    for block in blocks(problem):
        made = block.make()
        if made.shape[2] <= room and problem.rows * 3 * made.shape[2] <= 5e7:
            columns.append(made)
            room -= made.shape[2]
    return np.concatenate(columns, axis=2) if columns else np.zeros((problem.rows, 3, 0))


def _beside(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """(3N, P) columns (N, 3, P) less what an orthonormal basis (3N, c) makes up; twice, for the rounding."""
    flat = columns.reshape(-1, columns.shape[2])
    for _ in range(2):
        flat = flat - basis @ (basis.T @ flat)
    return np.asarray(flat)


def _directions(calibration: FloatArray, white: FloatArray, least: float) -> FloatArray:
    """(3N, r) orthonormal directions of one candidate (N, 3, p) beside the calibration."""
    length = np.linalg.norm(white.reshape(-1, white.shape[2]), axis=0)
    seen = length > 0
    columns = _beside(calibration, white[:, :, seen] / length[seen])
    values, vectors = np.linalg.eigh(columns.T @ columns)
    good = values > least
    return np.asarray(columns @ (vectors[:, good] / np.sqrt(values[good])))
