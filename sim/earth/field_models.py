"""Geomagnetic field models: what they are, where they come from, when they hold.

A model is a set of Schmidt semi-normalised Gauss coefficients g, h [nT] at the reference radius 6371.2 km,
in the order g10 g11 h11 g20 g21 h21 g22 h22 ...: the g of degree n and order m is element
n**2 - 1 + max(2 m - 1, 0), its h the next one.

Time convention: between knots at 1 January 0 h UTC the coefficients of IGRF are linear in *UTC days* (not in
decimal years: half a leap year is not half a five-year interval), as ppigrf and ChaosMagPy read them. A CHAOS
file brings its own knots and splines. Epochs outside the knots are an error: no model is extrapolated.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.limits import MODEL_BYTES
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, mat_reader
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM

_NS_PER_DAY = 86400 * 1_000_000_000
_CHAOS = "a CHAOS file, .mat or .shc"
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
        return np.searchsorted(self.knots[1:-1].astype("int64"), stamps, side="right")

    def _refuse(self, stamps: np.ndarray) -> None:
        times = stamps.astype("datetime64[ns]")
        outside = (times < self.knots[0]) | (times > self.knots[-1])
        row, count = int(np.argmax(outside)), int(outside.sum())
        at, so = (f" in row {row + 1}", f" ({count} of {times.size} rows are)") if times.size > 1 else ("", "")
        raise OutOfRange(
            f"{epoch.iso(times[row])}{at} is outside the field model {self.name}{so}",
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
        if isinstance(degree, bool | float) or degree not in range(1, self.degree + 1):
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


def read_chaos(path: Path) -> FieldModel:
    """The internal field of a CHAOS file, .mat (any MATLAB version) or .shc; raises BadInput for a file that is not one.

    Read is the time-dependent core (degree 20, splines of order 6) and, from a .mat file, the static crust (to degree 185;
    cut it with `truncated`, at 400 km degree 110 is ample). Not read: the external field (magnetospheric and its induced
    part), Euler angles, calibration parameters.
    """
    if not path.is_file():
        raise BadInput("no such file", where=str(path), wanted=_CHAOS)
    if path.stat().st_size > MODEL_BYTES:
        raise BadInput(f"is larger than {MODEL_BYTES} bytes", where=str(path), wanted="a CHAOS file, a few MB")
    readers = {".mat": _read_mat, ".shc": _read_shc}
    if path.suffix.lower() not in readers:
        raise BadInput(f"suffix {path.suffix!r}", where=str(path), wanted=_CHAOS)
    try:
        knots, polynomial, static = readers[path.suffix.lower()](path)
    except BadInput:
        raise
    except Exception as error:  # a foreign file may raise anything in the readers
        raise BadInput(f"cannot be read ({error})", where=str(path), wanted="a CHAOS field model") from None
    if not (np.isfinite(polynomial).all() and np.isfinite(static).all()):
        raise BadInput("a coefficient is not finite", where=str(path), wanted="numbers in nT")
    if knots.size < 2 or not (np.diff(knots) > np.timedelta64(0, "ns")).all():
        raise BadInput("the knots do not increase", where=str(path), wanted="increasing epochs")
    if polynomial.shape[0] != knots.size - 1 or static.size < polynomial.shape[2]:
        raise BadInput("knots and coefficients do not fit together", where=str(path))
    core, whole = degree_of(polynomial.shape[2]), degree_of(static.size)
    crust = f"static crust to degree {whole}" if whole > core else "no crust"
    title = f"{path.stem}: core to degree {core}, {crust}; no external field"
    return FieldModel(f"chaos:{path}", title, whole, knots, polynomial, static)


def _read_mat(path: Path) -> tuple[TimeArray, FloatArray, FloatArray]:
    """MATLAB's piecewise polynomial `pp` (highest power first, days since 2000) and the static `g`."""
    found = mat_variables(path, [f"pp.{key}" for key in ("order", "pieces", "dim", "breaks", "coefs")], ["g"])
    order, pieces, dim = (int(found[f"pp.{key}"].flat[0]) for key in ("order", "pieces", "dim"))
    breaks = np.ravel(found["pp.breaks"])
    coefficients = found["pp.coefs"].reshape(pieces, dim, order)
    days = np.diff(breaks)[:, None, None]
    polynomial = coefficients[:, :, ::-1].transpose(0, 2, 1) * days ** np.arange(order)[:, None]
    return stamps_mjd2000(breaks), np.ascontiguousarray(polynomial), np.ravel(found.get("g", np.zeros(dim)))


def stamps_mjd2000(days_mjd2000: FloatArray) -> TimeArray:
    """Stamps of days since 2000-01-01 0 h UTC."""
    return epoch.MJD2000 + np.rint(days_mjd2000 * _NS_PER_DAY).astype("int64").astype("timedelta64[ns]")


def mat_variables(path: Path | str, needed: Sequence[str], optional: Sequence[str] = ()) -> dict[str, FloatArray]:
    """Variables of a MATLAB file as float64, by name, a field of a structure as `pp.breaks`; optional: those that may lack.

    Raises BadInput for a file that is none, is damaged or has none of that name.
    """
    where = str(path)
    command = [sys.executable, "-P", mat_reader.__file__, os.path.abspath(path), *needed, *optional]
    alone = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, capture_output=True, timeout=2 * mat_reader.SECONDS, env=alone, check=False)
    except subprocess.TimeoutExpired:
        raise BadInput(f"is not read in {2 * mat_reader.SECONDS} s", where=where, wanted=_CHAOS) from None
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip() if done.returncode == 1 else "its reader broke down"
        raise BadInput(f"cannot be read: damaged, or no model ({said})", where=where, wanted=_CHAOS)
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as held:
        found = {name: np.asarray(held[name], dtype=np.float64) for name in held.files}
    lacking = next((name for name in needed if name not in found), None)
    if lacking is not None:
        raise BadInput(f"has no variable '{lacking.partition('.')[0]}'", where=where, wanted=_CHAOS)
    return found


def _read_shc(path: Path) -> tuple[TimeArray, FloatArray, FloatArray]:
    """Coefficients at sampled epochs: `order` samples span each knot interval and fix its polynomial.

    CHAOS counts the years of this format as 365.25 days from 2000.0 (as ChaosMagPy's CHAOS.from_shc).
    """
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    rows = [words for words in lines if words and not words[0].startswith("#")]
    n_min, n_max, samples, order, step = (int(word) for word in rows[0][:5])
    years = np.array(rows[1], dtype=np.float64)
    body = np.array(rows[2:], dtype=np.float64)
    if n_min != 1 or years.size != samples or step != order - 1 or (samples - 1) % step:
        raise BadInput("an SHC header this reader does not know", where=str(path), wanted="degrees from 1, whole knots")
    n, m = body[:, 0], body[:, 1]
    place = np.argsort(n**2 + np.where(m > 0, 2 * m - 1, np.where(m < 0, -2 * m, 0)))
    if body.shape != (n_max * (n_max + 2), samples + 2):
        raise BadInput(f"{body.shape} numbers", where=str(path), wanted=f"degree {n_max} at {samples} epochs")
    values = body[place, 2:].T
    stamps = stamps_mjd2000((years - 2000.0) * 365.25)
    knots = stamps[::step]
    polynomial = np.empty((knots.size - 1, order, values.shape[1]))
    for p in range(knots.size - 1):
        span = slice(p * step, p * step + order)
        tau = (stamps[span] - knots[p]).astype("int64") / (knots[p + 1] - knots[p]).astype("int64")
        polynomial[p] = np.linalg.solve(np.vander(tau, increasing=True), values[span])
    return knots, polynomial, np.zeros(values.shape[1])


__all__ = ["FIELD_RADIUS_KM", "FieldModel", "degree_of", "linear_model", "load_field"]
