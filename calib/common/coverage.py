"""Which directions in the body the field has had, and what to fly to halve the worst sigma.

The sphere is cut into 80 equal areas, the cells nearest to the points of Fibonacci's spiral; that is the number of
ArduPilot's MAGFit, which calls more than 30 % good. A spacecraft that points at the Earth has the field in a band.

What a manoeuvre would give is predicted from the Jacobian of the fit, J = d[(I+S) B + b] / d(S, b), or its part along the
field where only |B| is compared:

    C(t) = (C^-1 + t N <J' J> / k)^-1

with C the covariance of the fit, N its rows, t the length of the manoeuvre in records like this one, and k the ratio of the
worst variance in C to that of N <J' J>: errors are taken to be as they are here.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.direction import ROWS, even_directions, of_parameters, spread_rows
from fluxtwin.calib.common.records import Calibration, parameter_unit
from fluxtwin.sim.base.types import FloatArray, IntArray
from fluxtwin.sim.telemetry.record import Telemetry

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit

BINS = 80
GOOD = 0.3
"""Share of the bins from which MAGFit calls the coverage good."""
_TURNS = 24  # of a slew about an axis, and the fewest rows that one needs
_LONGEST, _SHORTEST = 100.0, 1e-3  # records: beyond, a manoeuvre does not help; below, it is not worth saying
RANK = 1e-10
"""Of an eigenvalue of a scaled covariance: below, a parameter was not estimated, or follows from others (a symmetric S)."""


@dataclass(frozen=True)
class Plan:
    """One way of getting more data."""

    words: str
    ratio: float | None
    """How many records of this length halve the worst sigma; None: more than a hundred."""
    rows: int | None
    """The same in rows."""


@dataclass(frozen=True)
class Coverage:
    """The field's directions in body axes, and what would help most."""

    counts: IntArray
    """(80,) rows in each bin."""
    directions_B: FloatArray
    """(80, 3) their middles, unit vectors in body axes."""
    worst: str
    """Name of the parameter that is known worst, S counted in parts of the field; empty where there are no sigmas."""
    sigma: float
    """In its own unit."""
    plans: tuple[Plan, ...]
    """The same attitudes again, slews about each axis, a tumble; best first."""

    @property
    def share(self) -> float:
        """Of the bins that have a row."""
        return float((self.counts > 0).mean())

    @property
    def lines(self) -> tuple[str, ...]:
        """In sentences."""
        occupied = int((self.counts > 0).sum())
        said = f"The field was in {occupied} of {BINS} equal areas of directions in the body, {100 * self.share:.0f} %"
        verdict = "." if self.share >= GOOD else f"; {100 * GOOD:.0f} % and more is good."
        if not self.worst:
            return (said + verdict,)
        best = [plan for plan in self.plans if plan.ratio is not None]
        sigma = f"{self.sigma:.2g} {parameter_unit(self.worst)}".removesuffix(" 1")
        if not best:
            return (
                said + verdict,
                f"The worst sigma is that of {self.worst}, {sigma}; none of the manoeuvres tried halves it.",
            )
        options = ", or ".join(f"{plan.rows} rows of {plan.words}" for plan in best[:2])
        again = next((plan for plan in best[2:] if plan.words == _AGAIN), None)
        more = "" if again is None else f" ({_AGAIN} would take {again.rows} rows)"
        return (said + verdict, f"The worst sigma is that of {self.worst}, {sigma}. To halve it: {options}{more}.")

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        return {
            "bins": BINS,
            "share": self.share,
            "counts": self.counts.tolist(),
            "directions_B": self.directions_B.tolist(),
            "worst": {"name": self.worst, "sigma": self.sigma} if self.worst else None,
            "to_halve_it": [{"plan": p.words, "records": p.ratio, "rows": p.rows} for p in self.plans],
            "lines": list(self.lines),
        }


_AGAIN = "the same attitudes again"


def coverage_of(fit: Fit, telemetry: Telemetry) -> Coverage:
    """Of the rows with weight of a fit of a record (joined, as it was fitted)."""
    rows = fit.rows[fit.kept]
    used = telemetry.select(rows)
    columns = fit.calibration.columns_of(telemetry, rows, fitted=True)
    field_nT = fit.calibration.apply(used.mag_B_nT, used.dipole_B_Am2, columns)
    return coverage(fit.calibration, used.mag_B_nT, field_nT, size_only=fit.residuals_nT.shape[1] == 1)


def counted(field_nT: FloatArray) -> tuple[FloatArray, IntArray]:
    """The middles (80, 3) of equal areas of directions, unit vectors, and the rows (80,) of a field (N, 3) in each."""
    directions = even_directions(BINS)
    unit = field_nT / np.linalg.norm(field_nT, axis=1)[:, None]
    return directions, np.bincount(np.argmax(unit @ directions.T, axis=1), minlength=BINS)


def coverage(calibration: Calibration, reading_nT: FloatArray, field_nT: FloatArray, *, size_only: bool) -> Coverage:
    """From readings and calibrated fields (N, 3) of the rows that were fitted, body axes.

    size_only: whether only |B| was compared.
    """
    directions, counts = counted(field_nT)
    strength_nT = float(np.sqrt((field_nT**2).sum(axis=1).mean()))
    scale = np.concatenate([np.full(9, strength_nT), np.ones(3)])
    C = calibration.covariance[:12, :12] * np.outer(scale, scale)
    sigma_nT = np.sqrt(np.diag(C))
    if not sigma_nT.any():
        return Coverage(counts, directions, "", 0.0, ())
    worst = int(sigma_nT.argmax())
    plans = _plans(C, reading_nT, field_nT, scale, worst, size_only=size_only)
    return Coverage(counts, directions, calibration.names[worst], float(calibration.sigmas[worst]), plans)


def _plans(
    C: FloatArray, reading_nT: FloatArray, field_nT: FloatArray, scale: FloatArray, worst: int, *, size_only: bool
) -> tuple[Plan, ...]:
    values, vectors = np.linalg.eigh(C)
    U = vectors[:, values > RANK * values[-1]]
    inside = U.T @ C @ U
    inverse = np.linalg.inv(inside)
    some = spread_rows(len(field_nT))
    B, true = reading_nT[some], field_nT[some]

    def information(B: FloatArray, true: FloatArray) -> FloatArray:
        return np.asarray(U.T @ _information(B, true, scale, size_only=size_only) @ U * len(field_nT))

    alone = np.linalg.solve(information(B, true), U[worst])
    k = float(C[worst, worst] / (U[worst] @ alone))
    flown = {_AGAIN: inverse}
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        turn = Rotation.from_rotvec(np.outer(2.0 * np.pi * np.arange(_TURNS) / _TURNS, axis))
        turned = np.concatenate([one.apply(true[:: max(1, len(true) // 40)]) for one in turn])
        flown[f"a slew about body {name} through all angles"] = information(turned, turned) / k
    even = even_directions(ROWS) * float(np.sqrt((true**2).sum(axis=1).mean()))
    flown["a tumble through all directions"] = information(even, even) / k
    found = []
    for words, more in flown.items():
        records = _to_halve(inverse, more, U[worst])
        rows = None if records is None else max(_TURNS, round(records * len(field_nT)))
        found.append(Plan(words, records, rows))
    return tuple(sorted(found, key=lambda plan: np.inf if plan.ratio is None else plan.ratio))


def _information(B: FloatArray, true: FloatArray, scale: FloatArray, *, size_only: bool) -> FloatArray:
    """(12, 12) J' J a row, in units of `scale`."""
    J = of_parameters(B) / scale
    if size_only:
        unit = true / np.linalg.norm(true, axis=1)[:, None]
        J = np.einsum("ni,nip->np", unit, J)[:, None, :]
    rows = J.reshape(-1, 12)
    return np.asarray(rows.T @ rows) / len(B)


def _to_halve(inverse: FloatArray, more: FloatArray, row: FloatArray) -> float | None:
    """t for which the variance of `row` in (inverse + t more)^-1 is a quarter; None where that takes too long."""
    wanted = 0.25 * float(row @ np.linalg.solve(inverse, row))
    t = np.geomspace(_SHORTEST, _LONGEST, 400).tolist()
    # More data never widen a sigma: what is reached once stays reached.
    place = bisect_left(t, True, key=lambda x: bool(row @ np.linalg.solve(inverse + x * more, row) <= wanted))
    return t[place] if place < len(t) else None
