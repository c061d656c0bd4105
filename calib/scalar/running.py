"""Calibration without attitude as the data come in: TWOSTEP in running sums.

Everything TWOSTEP needs of the past are weighted moments of L and z; new rows are added to them, and older ones fade
with a memory where b is known to drift. The answer at any time is that of the batch over the same rows, so that
nothing hangs on a first guess, as a filter on (b, D) would, and the centred half alone, which fails where |H| is
constant, is never the answer. Innovations |y| - |H|, taken before the rows are added, say when it is finished.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.fit_warnings import LARGE_S
from fluxtwin.calib.common.noise import per_axis
from fluxtwin.calib.scalar.model import PAIRS, ScalarData, pack, terms
from fluxtwin.calib.scalar.twostep import (
    Moments,
    Twostep,
    information,
    merged,
    moments_of,
    solve_moments,
    theta_of,
    twostep,
)
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.types import FloatArray

_REFERENCE_NT = 30_000.0
_WORST_SIGMA = 0.3
_INNOVATIONS = 500.0
"""Rows that the running mean of the innovations remembers."""
_NEWS = 0.02
"""The sums are solved again when so large a part of the rows is new."""


class RunningAnswer(NamedTuple):
    """What is known so far, in journal eq. 1: A B0 = O [(I+S) B + b], O unknown."""

    S: FloatArray
    """(3, 3) symmetric; zero for b alone."""
    b_nT: FloatArray
    """(3,)."""
    covariance: FloatArray
    """(p, p) of S11 S22 S33 S12 S13 S23 b1 b2 b3, or of b1 b2 b3, for white noise."""
    rows: float
    """Effective number, after fading."""


class RunningScalar:
    """Running TWOSTEP. Not to be shared between threads."""

    def __init__(self, noise_nT: float | FloatArray, *, parameters: str = "b,S", memory_s: float | None = None) -> None:
        """noise_nT: of the reading, an axis. parameters: `b` or `b,S`. memory_s: rows fade by e in that time.

        Raises BadInput for noise that is not positive, other parameters or a memory that is not positive.
        """
        noise = per_axis(noise_nT, "noise_nT")
        if not (noise > 0).all():
            raise BadInput(f"{noise_nT!r}", where="noise_nT", wanted="nT, positive")
        if parameters not in ("b", "b,S"):
            raise BadInput(f"{parameters!r}", where="parameters", wanted="'b' or 'b,S'")
        if memory_s is not None and not memory_s > 0:
            raise BadInput(f"{memory_s!r}", where="memory_s", wanted="seconds, positive")
        self._Sigma = np.diag(noise**2) / _REFERENCE_NT**2
        self._with_D = parameters == "b,S"
        self._memory_s = memory_s
        self._moments: Moments | None = None
        self._bias: Moments | None = None
        self._known = Twostep(np.zeros((3, 3)), np.zeros(3), 1.0, False)
        self._last_s: float | None = None
        self._squares, self._counted, self._rows, self._waiting = 0.0, 0.0, 0.0, 0

    def add(self, seconds: float, B_nT: FloatArray, H_nT: float | FloatArray) -> FloatArray:
        """Take in one row or several: readings (3,) or (n, 3) and |H|, at `seconds` on any clock (of the last of them).

        Returns the innovations (n,) nT, |y| - |H| as known before; NaN while nothing is known. Rows that are not
        finite are passed over. Raises BadInput when time goes back.
        """
        B = np.atleast_2d(np.asarray(B_nT, dtype=np.float64)) / _REFERENCE_NT
        H = np.atleast_1d(np.asarray(H_nT, dtype=np.float64)) / _REFERENCE_NT
        if self._last_s is not None and seconds < self._last_s:
            raise BadInput(f"{seconds} s after {self._last_s} s", where="seconds", wanted="time that does not go back")
        finite = np.isfinite(B).all(axis=1) & np.isfinite(H)
        innovation = np.full(len(H), np.nan)
        data = ScalarData(B[finite], H[finite], np.zeros((int(finite.sum()), 0)), self._Sigma, self._with_D)
        self._fade(seconds)
        if len(data.H):
            innovation[finite] = self._innovate(data)
            self._take(data)
        return innovation * _REFERENCE_NT

    def _fade(self, seconds: float) -> None:
        if self._memory_s is not None and self._last_s is not None:
            share = float(np.exp(-(seconds - self._last_s) / self._memory_s))
            self._rows *= share
            for name in ("_moments", "_bias"):
                held: Moments | None = getattr(self, name)
                if held is not None:
                    setattr(self, name, held.faded(share))
        self._last_s = seconds

    def _innovate(self, data: ScalarData) -> FloatArray:
        if not self._known.converged:
            return np.full(len(data.H), np.nan)
        of = terms(pack(self._known.D, self._known.b, data), data)
        fade = float(np.exp(-len(data.H) / _INNOVATIONS))
        self._squares = fade * self._squares + float((of.r**2 / of.q).sum())
        self._counted = fade * self._counted + len(data.H)
        return of.r

    def _take(self, data: ScalarData) -> None:
        if not self._known.converged and len(data.H) > 3 * data.size:
            self._known = twostep(data)  # the weights of these rows hang on it
        # An early answer may be far off; rows weighed by it would spoil the sums for good.
        sound = float(np.abs(self._known.D).max()) < LARGE_S and float(np.linalg.norm(self._known.b)) < 1.0
        D, b = (self._known.D, self._known.b) if sound else (np.zeros((3, 3)), np.zeros(3))
        new = moments_of(data, D, b)
        alone = new if not self._with_D else moments_of(data._replace(with_D=False), D, b)
        self._moments = new if self._moments is None else merged(self._moments, new)
        self._bias = alone if self._bias is None else merged(self._bias, alone)
        self._rows += len(data.H)
        self._waiting += len(data.H)
        if self._rows > 3 * data.size and self._waiting >= _NEWS * self._rows:
            self._solve()

    def _solve(self) -> None:
        assert self._moments is not None and self._bias is not None
        self._waiting = 0
        start = solve_moments(self._bias, False, np.zeros(3))
        self._known = solve_moments(self._moments, self._with_D, start.b)

    @property
    def innovation_ratio(self) -> float:
        """Mean square of recent innovations over what the noise gives: 1 when finished; NaN while nothing is known."""
        return self._squares / self._counted if self._counted > 0 else float("nan")

    def answer(self) -> RunningAnswer:
        """What is known now. Raises NoAnswer, naming the worst combination, where that is not enough."""
        if self._moments is not None and self._waiting and self._rows > 3 * (9 if self._with_D else 3):
            self._solve()
        few = "too few rows yet, or |B| and |H| do not fit together"
        if self._moments is None or self._rows <= 3 * (9 if self._with_D else 3):
            raise NoAnswer(few, evidence={"rows": self._rows})
        known = self._known if self._known.converged else Twostep(np.zeros((3, 3)), np.zeros(3), 1.0, False)
        theta = theta_of(known.D, known.b, self._with_D)
        jacobian = _theta_jacobian(known, self._with_D)
        information_p = jacobian.T @ information(self._moments, theta, self._with_D) @ jacobian
        from_noise = jacobian.T @ self._moments.noise_LL @ jacobian
        names = [*(["S11", "S22", "S33", "S12", "S13", "S23"] if self._with_D else []), "b1", "b2", "b3"]
        _require_known(information_p, from_noise, names)
        if not known.converged:
            raise NoAnswer(few, evidence={"rows": self._rows})
        scale = np.concatenate([np.ones(len(names) - 3), np.full(3, -_REFERENCE_NT)])
        inverse = np.linalg.inv(information_p)
        inverse = inverse + inverse @ from_noise @ inverse  # the noise scatters the sums all the same
        covariance = np.asarray(inverse * np.outer(scale, scale), dtype=np.float64)
        return RunningAnswer(known.D, -known.b * _REFERENCE_NT, covariance, self._rows)


def _require_known(information_p: FloatArray, from_noise: FloatArray, names: list[str]) -> None:
    """Raises NoAnswer for a combination that is less certain than 30 % of the field, or that only noise moves."""
    values, vectors = np.linalg.eigh(information_p)
    worst = vectors[:, 0]
    if values[0] >= max(1.0 / _WORST_SIGMA**2, float(worst @ from_noise @ worst)):
        return
    named = [n for n, part in zip(names, worst, strict=True) if abs(part) > 0.2 * np.abs(worst).max()]
    raise NoAnswer(
        f"|B| does not determine {', '.join(named)} yet: the field has not moved enough in the body",
        evidence={"null_direction": dict(zip(names, worst.tolist(), strict=True))},
    )


def _theta_jacobian(known: Twostep, with_D: bool) -> FloatArray:
    """d theta / d(D, b): dc = (I+D) db + dD b, dE = 2 dD + D dD + dD D."""
    if not with_D:
        return np.eye(3)
    P = np.eye(3) + known.D
    jacobian = np.zeros((9, 9))
    for k, (i, j) in enumerate(PAIRS):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = 1.0
        dE = P @ unit + unit @ P
        jacobian[:3, k] = unit @ known.b
        jacobian[3:, k] = [dE[m, n] for m, n in PAIRS]
    jacobian[:3, 6:] = P
    return jacobian
