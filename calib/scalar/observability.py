"""What |B| determines, and what it does not, in words; and the second solution that a field in a plane leaves.

Parameters are scaled so that one is a change of the size of the field. Along a unit vector v of that space v'Fv, F the
information of the rows, is one over the variance of the combination v. What the noise of the readings contributes to F
is no information. A combination that is less certain than 30 % of the field, or that only noise moves, is refused.

Readings in a plane with normal n leave a mirror solution: with b' = b + 2 (n.(<B> - b)) n each |B - b| is the same
(Alonso & Shuster 2003, J. Astronaut. Sci. 51, 71). It is found and refined, and the costs of both are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fluxtwin.calib.common.observability import PART, ROUNDING, WORST_SIGMA, direction_words, listed
from fluxtwin.calib.common.records import LARGE_S
from fluxtwin.calib.common.robust import find_outliers
from fluxtwin.calib.scalar.model import ScalarData, Solved, Sums, residual, solve, unpack
from fluxtwin.calib.scalar.rows import ScalarProblem
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray

_THREE_SIGMA = 9.0
_FARTHEST = 3.0
"""A bias of more fields than that is a search that ran away."""
_APART = 5.0
"""Sigmas between two solutions that are not one."""


def require_observed(sums: Sums, problem: ScalarProblem, inflation: float = 1.0, *, over_noise: float = 1.0) -> None:
    """Raises NoAnswer naming the parameters of a combination that the rows do not determine.

    inflation: variance of the residual over what the noise gives. over_noise: so many times the share of the noise
    must the signal be.
    """
    signal = sums.information - sums.from_noise
    values, vectors = np.linalg.eigh(0.5 * (signal + signal.T))
    whole = np.einsum("ik,ij,jk->k", vectors, sums.information, vectors)
    sigma = np.sqrt(inflation / np.maximum(values, 1e-300))
    only_noise = values < over_noise * (whole - values)
    poor = np.flatnonzero((values < ROUNDING * values[-1]) | only_noise | (sigma > WORST_SIGMA))
    if poor.size:
        k, v = poor[0], vectors[:, poor[0]]
        also = [name for other in poor[1:] for name in _named(vectors[:, other], problem.names)]
        said = _refusal(v, problem, float(sigma[k]), bool(only_noise[k]), also)
        raise NoAnswer(said, evidence=_evidence(v, problem, float(sigma[k])))


def refuse_thin(sums: Sums, problem: ScalarProblem) -> None:
    """Raises NoAnswer with the least determined direction where the readings keep to a line, a plane or a cone."""
    if problem.geometry.words():
        v = np.linalg.eigh(sums.information)[1][:, 0]
        raise NoAnswer(_refusal(v, problem, np.inf, False), evidence=_evidence(v, problem, np.inf))


def _refusal(v: FloatArray, problem: ScalarProblem, sigma: float, only_noise: bool, also: Sequence[str] = ()) -> str:
    """also: names of further directions that are no better."""
    names, thin = problem.names, problem.geometry.words()
    named = _named(v, names)
    mixture = _mixture(v, names)
    kind = "does not determine" if sigma > 1e3 or only_noise else "hardly determines"
    reason = thin or ("only its noise moves them" if only_noise else "the field varies too little")
    what = listed(named)
    more = [name for name in names if name in also and name not in named]
    others = f"; further directions with {listed(more)} are no better" if more else ""
    mixed = f" (null direction {mixture})" if len(named) > 1 else ""
    # Readings that keep to a plane or a cone leave a component of b free, or what S does goes into it.
    free_bias = bool(thin) or any(name[0] == "b" for name in [*named, *more])
    several = any(name[0] == "S" for name in names) and not free_bias
    less = ", fewer parameters (--parameters b)" if several else ""
    return (
        f"|B| {kind} {what} in these data{mixed}{others}: {reason}. Add attitudes or orbits in which the field takes other "
        f"directions in the body{less}, or give the attitude (--method linear)"
    )


def _evidence(v: FloatArray, problem: ScalarProblem, sigma: float) -> dict[str, Any]:
    how = problem.geometry
    return {
        "null_direction": {name: float(part) for name, part in zip(problem.names, v, strict=True)},
        "parameters": _named(v, problem.names),
        "relative_sigma": sigma if sigma < 1e6 else None,
        "moves_nT": how.moves_nT.tolist(),
        "geometry": how.words(),
    }


def require_meaning(solved: Solved, problem: ScalarProblem, *, robust: bool) -> None:
    """Raises NoAnswer for a matrix that no magnetometer has.

    Where the readings hardly go the sums may hold such a combination to be known: errors that repeat with the spin, of
    attitude-free data the most usual ones, move the residual as a signal would. Elsewhere it comes of bit errors, of
    a wrong unit or orbit; a fit without outliers that converged is returned, with a warning.
    """
    D, _, _ = unpack(solved.p, problem.data)
    values, vectors = np.linalg.eigh(D)
    worst, thin = int(np.argmax(np.abs(values))), problem.geometry.words()
    if abs(values[worst]) <= LARGE_S or (robust and not thin):
        return
    r = residual(solved.p, problem.data)
    left_nT = float(np.std(r)) * problem.scale_nT
    null = np.linalg.eigh(solved.sums.information)[1][:, 0]
    raise NoAnswer(
        f"the fit leaves {left_nT:.3g} nT and means nothing: S comes out as {values[worst]:+.2g} along "
        f"{direction_words(vectors[:, worst])}, and no magnetometer is that wrong; "
        + _why_meaningless(thin, int(find_outliers(r[:, None]).sum()), len(r), _mixture(null, problem.names)),
        evidence=_evidence(null, problem, np.inf),
    )


def _why_meaningless(thin: str, outlying: int, rows: int, mixture: str) -> str:
    if thin:
        return (
            f"{thin}. There errors of the model look like signal; least determined is {mixture}. Add attitudes in "
            "which the field leaves the plane, or give the attitude (--method linear)"
        )
    if outlying:
        return (
            f"{outlying} of {rows} rows are outliers (bit errors?): set them aside with --method scalar "
            "--robust tukey, or leave those readings empty"
        )
    return (
        "bit errors (--method scalar --robust tukey sets them aside), unit, axes, position or time may be wrong (run "
        f"`fluxtwin check`), or the stretch is too short: least determined is {mixture}"
    )


def _named(v: FloatArray, names: tuple[str, ...]) -> list[str]:
    return [name for name, part in zip(names, v, strict=True) if abs(part) > PART * np.abs(v).max()]


def _mixture(v: FloatArray, names: tuple[str, ...]) -> str:
    """The larger parts of a direction in the names of the parameters."""
    at = np.abs(v) > PART * np.abs(v).max()
    return " ".join(f"{part:+.2f} {name}" for part, name, there in zip(v, names, at, strict=True) if there)


def other_solution(solved: Solved, data: ScalarData, a: FloatArray | None) -> Solved | None:
    """The polished mirror of a solution in the plane that the readings keep closest to; None where it is the same."""
    D, b, _ = unpack(solved.p, data)
    straight = data.B @ (np.eye(3) + D)
    n = np.linalg.eigh(np.cov(straight.T))[1][:, 0]
    start = solved.p.copy()
    at = slice(6, 9) if data.with_D else slice(0, 3)
    start[at] = b + 2.0 * float(n @ (straight.mean(axis=0) - b)) * n
    mirrored = solve(start, data, a)
    if not mirrored.converged or float(np.linalg.norm(mirrored.p[at])) > _FARTHEST:
        return None
    step = mirrored.p - solved.p
    return mirrored if float(step @ solved.sums.information @ step) > _APART**2 else None


def choose(solved: Solved, mirrored: Solved, problem: ScalarProblem, inflation: float) -> tuple[Solved, str]:
    """The better of two solutions and a sentence; raises NoAnswer where neither is better by three sigma.

    The difference of the costs is compared with its own scatter from row to row (Vuong 1989, Econometrica 57, 307): noise
    out of the plane makes one of the two look better by chance.
    """
    data, names = problem.data, problem.names
    better, worse = sorted((solved, mirrored), key=lambda one: one.sums.cost)
    steps = residual(worse.p, data) ** 2 - residual(better.p, data) ** 2
    chance = float(np.std(steps) * np.sqrt(len(steps)))
    gain = (worse.sums.cost - better.sums.cost) / inflation
    ours, theirs = (-unpack(one.p, data)[1] * problem.scale_nT for one in (better, worse))
    between = worse.p - better.p
    if gain < _THREE_SIGMA or steps.sum() < 3.0 * chance:
        raise NoAnswer(
            f"two solutions fit equally well, mirrors of each other: b = {_three(ours)} nT and b = {_three(theirs)} "
            f"nT, {_mixture(between / np.linalg.norm(between), names)} apart in parts of the field; "
            f"{problem.geometry.words() or 'the readings keep close to a plane'}. Add attitudes in which the field leaves "
            "that plane, or give the attitude (--method linear)",
            evidence={
                "parameters": _named(between, names),
                "b_nT": [ours.tolist(), theirs.tolist()],
                "cost_difference": float(gain),
            },
        )
    return better, (
        f"a mirror solution with b = {_three(theirs)} nT fits worse, by {gain:.3g} in the sum of squares over noise; "
        "it is not taken"
    )


def _three(values: FloatArray) -> str:
    return "(" + ", ".join(f"{v:.5g}" for v in values) + ")"
