"""Geomagnetic field models: what they are, where they come from, when they hold.

A model is a set of Schmidt semi-normalised Gauss coefficients g, h [nT] at the reference radius 6371.2 km,
in the order g10 g11 h11 g20 g21 h21 g22 h22 ...: the g of degree n and order m is element
n**2 - 1 + max(2 m - 1, 0), its h the next one.

Time convention: between knots at 1 January 0 h UTC the coefficients of IGRF are linear in *UTC days* (not in
decimal years: half a leap year is not half a five-year interval), as ppigrf and ChaosMagPy read them. A CHAOS
file brings its own knots and splines. Epochs outside the knots are an error: no model is extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM

_NO_TIME = np.timedelta64(0, "ns")
_DATA = Path(__file__).parent / "data"
_TITLES = {
    "igrf14": "IGRF-14 (definitive 1945-2020), degree 13, 1900-2030",
    "igrf1975": "IGRF 1975 as issued, degree 8 with its secular variation, 1975-1980",
}


@dataclass(frozen=True, eq=False)
class FieldModel:
    """An internal field model: Gauss coefficients that are polynomials of time between knots.

    knots: datetime64[ns] UTC, shape (P + 1,), increasing; the model is valid from the first to the last.
    polynomial_nT: shape (P, J, K'); in piece p the coefficients are sum_j polynomial_nT[p, j] tau**j, with
    tau running from 0 to 1, linear in UTC days. static_nT: shape (K,) with K >= K', added at every epoch.
    """

    name: str
    title: str
    degree: int
    knots: TimeArray = field(repr=False)
    polynomial_nT: FloatArray = field(repr=False)
    static_nT: FloatArray = field(repr=False)
    margin: np.timedelta64 = _NO_TIME
    """So far beyond its ends the first and the last polynomial go on; see `lasting`."""

    @property
    def valid_from(self) -> np.datetime64:
        """First epoch at which the model holds, UTC."""
        return np.datetime64(self.knots[0], "ns")

    @property
    def valid_to(self) -> np.datetime64:
        """Last epoch at which the model holds, UTC."""
        return np.datetime64(self.knots[-1], "ns")

    def pieces(self, time: TimeArray | np.datetime64) -> tuple[np.ndarray, FloatArray]:
        """Index of the knot interval and tau in it, each (N,), for epochs (N,) in any order.

        Raises OutOfRange, naming the range, for an epoch at which the model does not hold.
        """
        stamps = epoch.as_times(time).astype("int64")
        knots = self.knots.astype("int64")
        first, last = (int(stamps.min()), int(stamps.max())) if stamps.size else (knots[0], knots[0])
        margin = int(self.margin.astype("timedelta64[ns]").astype("int64"))
        if first < knots[0] - margin or last > knots[-1] + margin:
            self._refuse(stamps)
        ends = self._piece(np.array([first, last]))
        if ends[0] == ends[1]:  # a trajectory rarely crosses a knot
            piece = np.full(stamps.shape, ends[0])
            return piece, (stamps - knots[ends[0]]) / (knots[ends[0] + 1] - knots[ends[0]])
        piece = self._piece(stamps)
        return piece, (stamps - knots[piece]) / (knots[piece + 1] - knots[piece])

    def _piece(self, stamps: np.ndarray) -> np.ndarray:
        piece = np.searchsorted(self.knots.astype("int64"), stamps, side="right") - 1
        return np.clip(piece, 0, self.knots.size - 2)

    def _refuse(self, stamps: np.ndarray) -> None:
        times = stamps.astype("datetime64[ns]")
        outside = (times < self.knots[0]) | (times > self.knots[-1])
        row = int(np.argmax(outside))
        raise OutOfRange(
            f"{epoch.iso(times[row])} in row {row + 1} is outside the field model {self.name} "
            f"({int(outside.sum())} of {times.size} epochs are)",
            where="time",
            wanted=f"{epoch.iso(self.valid_from)} to {epoch.iso(self.valid_to)}",
        )

    def coefficients_nT(self, time: TimeArray | np.datetime64) -> FloatArray:
        """Gauss coefficients at each epoch, shape (N, K); for a few epochs, not for a long trajectory.

        Raises OutOfRange as `pieces` does.
        """
        piece, tau = self.pieces(time)
        moving = np.zeros((tau.size, self.polynomial_nT.shape[2]))
        for j in reversed(range(self.polynomial_nT.shape[1])):
            moving = moving * tau[:, None] + self.polynomial_nT[piece, j]
        whole = np.repeat(self.static_nT[None, :], tau.size, axis=0)
        whole[:, : moving.shape[1]] += moving
        return whole

    def lasting(self, margin: np.timedelta64) -> FieldModel:
        """The same model with its first and last polynomials going on for a while beyond its ends.

        For trials of other stamps (a clock that is late) of a record which lies within the model: secular variation
        changes the field by less than 1 nT a day.
        """
        return replace(self, margin=margin)

    def truncated(self, degree: int) -> FieldModel:
        """The same model without the degrees above `degree`; raises OutOfRange outside 1..self.degree."""
        if not 1 <= degree <= self.degree:
            raise OutOfRange(
                f"degree {degree} is not in the field model {self.name}",
                where="degree",
                wanted=f"1 to {self.degree}",
            )
        size = degree * (degree + 2)
        return replace(
            self,
            degree=degree,
            polynomial_nT=self.polynomial_nT[:, :, :size],
            static_nT=self.static_nT[:size],
        )


def load_field(name: str = "igrf14", degree: int | None = None) -> FieldModel:
    """The field model of that name, whole or cut at `degree`.

    name: "igrf14", "igrf1975", or "chaos:FILE" with a CHAOS file (.mat or .shc; internal field only).
    Raises BadInput for an unknown name or an unusable file, OutOfRange for a degree the model lacks.
    """
    if name.startswith("chaos:"):
        from fluxtwin.sim.earth.field_files import read_chaos

        model = read_chaos(Path(name.removeprefix("chaos:")))
    elif name in _TITLES:
        model = _packaged(name)
    else:
        known = ", ".join([*_TITLES, "chaos:FILE"])
        raise BadInput(f"{name!r} is no field model", where="field model", wanted=known)
    return model if degree is None else model.truncated(degree)


def linear_model(name: str, title: str, knots: TimeArray, coefficients_nT: FloatArray) -> FieldModel:
    """A model that is linear in UTC days between knots (P + 1,), from its coefficients there (P + 1, K)."""
    values = np.asarray(coefficients_nT, dtype=np.float64)
    polynomial = np.stack([values[:-1], np.diff(values, axis=0)], axis=1)
    degree = degree_of(values.shape[1])
    return FieldModel(name, title, degree, np.asarray(knots, "datetime64[ns]"), polynomial, np.zeros(values.shape[1]))


def degree_of(coefficients: int) -> int:
    """Degree n of a set of n (n + 2) Gauss coefficients; raises BadInput if there is none."""
    degree = int(np.sqrt(coefficients + 1)) - 1
    if degree < 1 or degree * (degree + 2) != coefficients:
        raise BadInput(f"{coefficients} Gauss coefficients", where="field model", wanted="n (n + 2) of them")
    return degree


@cache
def _packaged(name: str) -> FieldModel:
    with np.load(_DATA / f"{name}.npz", allow_pickle=False) as data:
        years = data["years"].astype("int64")
        values = data["coefficients_nT"].astype(np.float64)
    knots = (years - 1970).astype("datetime64[Y]").astype("datetime64[ns]")
    return linear_model(name, _TITLES[name], knots, values)


__all__ = ["FIELD_RADIUS_KM", "FieldModel", "degree_of", "linear_model", "load_field"]
