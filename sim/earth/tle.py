"""Two-line elements: read, propagated by SGP4, taken to GCRS.

SGP4 answers in TEME (true equator, mean equinox of date). TEME is turned by the mean sidereal time of 1982
into the Earth-fixed frame without polar motion (Vallado et al. 2006, AIAA 2006-6753, appendix C), and from
there to GCRS by the inverse of `frames.rotation_EN`; UT1 = UTC cancels between the two steps.

Elements age: expect 1-3 km at their epoch in low orbit and 1-3 km more each day (Vallado 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import erfa
import numpy as np
from scipy.spatial.transform import Rotation
from sgp4.api import SGP4_ERRORS, Satrec
from sgp4.io import compute_checksum

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.limits import text_of
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames

_OLD_DAYS = 30.0
_FORMAT = "a two-line element set of one satellite: an optional name line, then lines 1 and 2 of 69 characters"
_NS_PER_UNIT = 864_000  # the epoch of a line counts in 1e-8 day


@dataclass(frozen=True)
class Tle:
    """One element set. `propagate` and `notices` are what the readers of telemetry need."""

    line1: str
    line2: str
    name: str = ""
    where: str = "TLE"
    """The file, for messages."""

    def __post_init__(self) -> None:
        for number, line in ((1, self.line1), (2, self.line2)):
            _check_line(number, line, self.where)
        if self.line1[2:7] != self.line2[2:7]:
            raise BadInput(
                f"line 1 is of satellite {self.line1[2:7].strip()}, line 2 of {self.line2[2:7].strip()}",
                where=self.where,
                wanted=_FORMAT,
            )
        if error := self._satellite().error:
            raise BadInput(f"SGP4 refuses these elements: {SGP4_ERRORS[error]}", where=self.where)

    @property
    def epoch_utc(self) -> np.datetime64:
        """Epoch of the elements; two-digit years 57-99 are 1957-1999. Exact: a line counts in 864 us."""
        year = int(self.line1[18:20])
        year += 1900 if year >= 57 else 2000
        day, _, fraction = self.line1[20:32].strip().partition(".")
        units = (int(day) - 1) * 10**8 + int(fraction.ljust(8, "0")[:8])
        return np.datetime64(f"{year:04d}-01-01", "ns") + np.timedelta64(units * _NS_PER_UNIT, "ns")

    def notices(self, time: TimeArray | np.datetime64) -> tuple[str, ...]:
        """What a user should know about using these elements at `time`: empty, or one sentence."""
        days = epoch.seconds_since(time, self.epoch_utc) / 86400.0
        farthest = float(days[np.argmax(np.abs(days))])
        if abs(farthest) <= _OLD_DAYS:
            return ()
        side = "after" if farthest > 0 else "before"
        return (
            f"{Path(self.where).name}: the data reach {abs(farthest):.1f} days {side} the epoch of the elements,"
            f" {epoch.iso(self.epoch_utc)} (past {_OLD_DAYS:g} days expect errors of tens of km)",
        )

    def propagate_TEME(self, time: TimeArray | np.datetime64) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """SGP4's error codes (N,) (0 is good), position [km] and velocity [km/s] in TEME, each (N, 3).

        WGS 72 constants, "improved" mode. Elapsed time counts leap seconds. Rows with an error are NaN.
        """
        days = epoch.seconds_since(time, self.epoch_utc) / 86400.0
        satellite = self._satellite()
        whole = np.floor(days)
        codes, r_km, v_km_s = satellite.sgp4_array(satellite.jdsatepoch + whole, satellite.jdsatepochF + (days - whole))
        return codes, r_km, v_km_s

    def propagate(self, time: TimeArray | np.datetime64) -> tuple[FloatArray, FloatArray]:
        """Position [km] and velocity [km/s] in GCRS, each (N, 3).

        Raises OutOfRange with SGP4's own words where it gives no answer (decayed, elements out of bounds).
        """
        stamps = epoch.as_times(time)
        codes, r_km, v_km_s = self.propagate_TEME(stamps)
        bad = np.flatnonzero(codes)
        if bad.size:
            code = int(codes[bad[0]])
            raise OutOfRange(
                f"SGP4 gives no position at {epoch.iso(stamps[bad[0]])} (row {bad[0] + 1}, {bad.size} such"
                f" rows; elements of {epoch.iso(self.epoch_utc)}): {SGP4_ERRORS.get(code, f'error {code}')}",
                where=self.where,
                wanted="elements closer in time, or positions in the telemetry itself",
            )
        R_N_TEME = rotation_N_TEME(stamps)
        return R_N_TEME.apply(r_km), R_N_TEME.apply(v_km_s)

    def _satellite(self) -> Satrec:
        return Satrec.twoline2rv(self.line1, self.line2)


@dataclass(frozen=True)
class TleSeries:
    """Element sets of one satellite in the order of their epochs; at each instant the nearest in time counts."""

    sets: tuple[Tle, ...]

    def propagate(self, time: TimeArray | np.datetime64) -> tuple[FloatArray, FloatArray]:
        """As `Tle.propagate`, by the nearest set."""
        stamps = epoch.as_times(time)
        nearest = self._nearest(stamps)
        r_km, v_km_s = np.empty((stamps.size, 3)), np.empty((stamps.size, 3))
        for number in np.unique(nearest):
            rows = nearest == number
            r_km[rows], v_km_s[rows] = self.sets[number].propagate(stamps[rows])
        return r_km, v_km_s

    def age_days(self, time: TimeArray | np.datetime64) -> FloatArray:
        """(N,) days from the epoch of the set that counts, absolute."""
        stamps = epoch.as_times(time)
        epochs = np.array([one.epoch_utc for one in self.sets])[self._nearest(stamps)]
        return np.asarray(np.abs((stamps - epochs).astype("int64")) / 86_400e9)

    def notices(self, time: TimeArray | np.datetime64) -> tuple[str, ...]:
        """As those of a single set: what a user should know about the age of the elements, one sentence or two."""
        stamps = epoch.as_times(time)
        age = self.age_days(stamps)
        low, high = (along_track_sigma_km(float(days)) for days in (age.min(), age.max()))
        span = f"{age.min():.1f} to {age.max():.1f}" if age.max() - age.min() >= 0.05 else f"{age.max():.1f}"
        error = f"{low:.0f} to {high:.0f}" if round(low) != round(high) else f"{high:.0f}"
        said = [
            f"the elements are {span} days from their epochs: positions may be {error} km off along the track (1 sigma, in "
            "low orbit), and each km changes the field by some 10 nT; diagnose tests for this as along_track_error"
        ]
        nearest = self._nearest(stamps)
        for number in np.unique(nearest):
            said += self.sets[number].notices(stamps[nearest == number])
        return tuple(said)

    def _nearest(self, stamps: TimeArray) -> np.ndarray:
        epochs = np.array([one.epoch_utc for one in self.sets]).astype("int64")
        halfway = epochs[:-1] + np.diff(epochs) // 2
        return np.searchsorted(halfway, stamps.astype("int64"))


def along_track_sigma_km(age_days: float) -> float:
    """Error along the track [km] of elements of low orbits at that age: 2 km, and 2 km a day (Vallado 2006: 1-3 km each)."""
    return 2.0 + 2.0 * abs(age_days)


def rotation_N_TEME(time: TimeArray | np.datetime64) -> Rotation:
    """TEME to GCRS at each stamp. Batch of N. TEME turns at 8e-12 rad/s, so velocities turn alike."""
    sidereal: FloatArray = erfa.gmst82(*epoch.jd_ut1(time))
    # As an active rotation, R_E_TEME turns vectors by minus the sidereal time about z.
    return frames.rotation_EN(time).inv() * Rotation.from_euler("z", -sidereal[:, None])


def read_tle(path: Path | str) -> Tle:
    """Read a file with the elements of one satellite, two lines with or without a name line before them.

    Raises BadInput that names what is wrong: file, line, length, checksum, or several satellites.
    """
    return parse_tle(text_of(path, wanted=_FORMAT), where=str(path))


def read_elements(path: Path | str) -> TleSeries:
    """Read a file with one element set of one satellite or many, names between them allowed. Errors as `read_tle`."""
    text = text_of(path, wanted=_FORMAT)
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    starts = [place for place, line in enumerate(lines) if line.startswith("1 ") and len(line) > 60]
    if len(starts) < 2:
        return TleSeries((parse_tle(text, where=str(path)),))
    sets = [Tle(lines[place], (lines[place + 1 : place + 2] or [""])[0], where=str(path)) for place in starts]
    satellites = list(dict.fromkeys(one.line1[2:7].strip() for one in sets))
    if len(satellites) > 1:
        wanted = "element sets of one satellite"
        raise BadInput(
            f"holds elements of {len(satellites)} satellites ({_listed(satellites)})", where=str(path), wanted=wanted
        )
    return TleSeries(tuple(sorted(sets, key=lambda one: one.epoch_utc)))


def parse_tle(text: str, *, where: str = "TLE") -> Tle:
    """The element set in `text`; see `read_tle`."""
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    first = sum(line.startswith("1 ") and len(line) > 60 for line in lines)
    if first > 1:
        satellites = list(dict.fromkeys(line[2:7].strip() for line in lines if line.startswith("1 ")))
        raise BadInput(f"holds {first} element sets (satellites {_listed(satellites)})", where=where, wanted=_FORMAT)
    if len(lines) not in (2, 3):
        raise BadInput(f"holds {len(lines)} lines that are not blank", where=where, wanted=_FORMAT)
    name = lines[0].removeprefix("0 ").strip() if len(lines) == 3 else ""
    return Tle(line1=lines[-2], line2=lines[-1], name=name, where=where)


def _listed(satellites: list[str]) -> str:
    return ", ".join(satellites[:5]) + (", ..." if len(satellites) > 5 else "")


def _check_line(number: int, line: str, where: str) -> None:
    place = f"{where}, line {number}"
    if not line.startswith(f"{number} "):
        raise BadInput(f"starts with {line[:10]!r}", where=place, wanted=_FORMAT)
    if len(line) != 69 or not (line.isascii() and line.isprintable()):
        raise BadInput(f"has {len(line)} characters", where=place, wanted="69 plain characters")
    if not line[68].isdigit() or int(line[68]) != compute_checksum(line):
        raise BadInput(
            f"the checksum is {line[68]!r} but the line adds up to {compute_checksum(line)}",
            where=place,
            wanted="the line as it was published; one character or more has changed",
        )
    for label, start, stop in _FIELDS[number]:
        if not _is_number(line[start:stop], label):
            raise BadInput(
                f"{label} is {line[start:stop]!r}",
                where=f"{place}, columns {start + 1}-{stop}",
                wanted="a number",
            )


_FIELDS = {
    1: (("epoch year", 18, 20), ("epoch day", 20, 32), ("first derivative of mean motion", 33, 43)),
    2: (
        ("inclination", 8, 16),
        ("right ascension of the node", 17, 25),
        ("eccentricity", 26, 33),
        ("argument of perigee", 34, 42),
        ("mean anomaly", 43, 51),
        ("mean motion", 52, 63),
    ),
}


def _is_number(text: str, label: str) -> bool:
    try:
        value = float(text)
    except ValueError:
        return False
    if label in ("eccentricity", "epoch year"):
        return text.strip().isdigit()
    return bool(np.isfinite(value)) and (label != "epoch day" or 1.0 <= value < 367.0)
