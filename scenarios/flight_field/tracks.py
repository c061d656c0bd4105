"""Measured field along an orbit, and the geomagnetic indices of those days, read strictly from recorded files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.scenarios.recorded_files import ORBIT_KM, increasing, none_wrong, numbers, opened
from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.telemetry.time_stamps import parse_iso

_POSITION = ("x_ecef_km", "y_ecef_km", "z_ecef_km")
_GEODETIC = ("lat_geod_deg", "lon_deg", "alt_geod_km")
_MAGSAT_FIELD = ("B_north_geoc_nT", "B_east_geoc_nT", "B_down_geoc_nT")
_SWARM_FIELD = ("B_N_nT", "B_E_nT", "B_C_nT")
_WEAKEST_nT, _STRONGEST_nT = 8_000.0, 70_000.0  # what the geomagnetic field can be at those altitudes
_RC_STEP = np.timedelta64(60, "m")


@dataclass(frozen=True)
class Track:
    """A calibrated vector magnetometer along its orbit; N samples."""

    name: str
    source: str
    """File name and SHA-256."""
    time: TimeArray
    r_E_km: FloatArray
    """(N, 3) Earth-fixed position."""
    latitude_deg: FloatArray
    """(N,) geodetic, as the file gives it."""
    longitude_deg: FloatArray
    b_NEC_nT: FloatArray
    """(N, 3) measured field: geocentric north, east, centre."""
    attitude_good: BoolArray
    """(N,) the source's own flag; all true where it has none."""


@dataclass(frozen=True)
class RingCurrentIndex:
    """The hourly RC index: external and induced part."""

    time: TimeArray
    external_nT: FloatArray
    induced_nT: FloatArray

    def at(self, time: TimeArray) -> tuple[FloatArray, FloatArray]:
        """External and induced part (N,) at the stamps, linear between adjacent hours.

        Half an hour before the first or after the last value of a day the nearest value holds. Raises OutOfRange
        for a stamp further than that from any value.
        """
        after = np.clip(np.searchsorted(self.time, time), 1, self.time.size - 1)
        before = after - 1
        span = self.time[after] - self.time[before]
        share = np.clip((time - self.time[before]).astype("int64") / span.astype("int64"), 0.0, 1.0)
        share = np.where(span > _RC_STEP, np.rint(share), share)
        far = np.abs(time - np.where(share < 0.5, self.time[before], self.time[after])) > _RC_STEP // 2
        if far.any():
            when = epoch.iso(time[int(np.argmax(far))])
            raise OutOfRange(f"no RC index near {when}", where="RC index", wanted="hourly values")
        external, induced = (
            np.asarray((1.0 - share) * part[before] + share * part[after])
            for part in (self.external_nT, self.induced_nT)
        )
        return external, induced

    def nearest(self, time: np.datetime64) -> float:
        """External plus induced part of the hour nearest to the stamp [nT]."""
        row = int(np.argmin(np.abs(self.time - time)))
        return float(self.external_nT[row] + self.induced_nT[row])


def read_magsat(path: Path) -> Track:
    """MAGSAT's file: ECEF position, geodetic coordinates, geocentric north, east, down, attitude flag (0 good).

    Raises BadInput naming the file and what is wrong in it.
    """
    return _read(path, "MAGSAT 1980-01-01", _MAGSAT_FIELD, flag="attitude_flag")


def read_swarm(path: Path) -> Track:
    """Swarm's file: ECEF position, geodetic coordinates, F, and geocentric north, east, centre.

    Raises BadInput naming the file and what is wrong in it, as a vector that does not have the magnitude F.
    """
    track, table = _read(path, "Swarm A 2016-01-01", _SWARM_FIELD), opened(path, ())
    if "F_nT" in table.names:
        apart = np.abs(np.linalg.norm(track.b_NEC_nT, axis=1) - table.numbers(["F_nT"])["F_nT"])
        what = "differs from F_nT by {:.6g} nT"
        none_wrong(apart > 5.0, table.where, apart, what, "a vector whose length is F_nT")
    return track


def read_ring_current(path: Path) -> RingCurrentIndex:
    """The hourly RC index of single days in any order. Raises BadInput naming the file and what is wrong in it."""
    table = opened(path, ("time_utc", "RC_external_nT", "RC_induced_nT"))
    values = numbers(table, ("RC_external_nT", "RC_induced_nT"))
    stamps = [epoch.parse_time(text.decode(), where=table.where) for text in table.text("time_utc").tolist()]
    time = np.array(stamps, dtype="datetime64[ns]")
    order = np.argsort(time)
    increasing(time[order], f"{table.where}, sorted by time")
    return RingCurrentIndex(time[order], values[order, 0], values[order, 1])


def read_kp(path: Path, day: np.datetime64) -> FloatArray:
    """The eight Kp of that UTC day. Raises BadInput naming the file and what is wrong in it."""
    names = tuple(f"Kp10_{hour:02d}h" for hour in range(0, 24, 3))
    table = opened(path, ("date", *names))
    wanted = epoch.iso(day, "D")[:10].encode()
    rows = np.flatnonzero(table.text("date") == wanted)
    if rows.size != 1:
        raise BadInput(f"{rows.size} rows for {wanted.decode()}", where=table.where, wanted="one row for each day")
    tenths: FloatArray = numbers(table, names)[rows[0]]
    # Kp comes in thirds, written in tenths cut off: 23 is 2+, 2 1/3.
    return np.rint(tenths * 0.3) / 3.0


def _read(path: Path, name: str, field: tuple[str, ...], flag: str | None = None) -> Track:
    table = opened(path, ("time_utc", *_POSITION, *_GEODETIC, *field, *((flag,) if flag else ())))
    time = increasing(parse_iso(table.text("time_utc"), table.where), table.where)
    r_E_km, geodetic, b_NEC_nT = (numbers(table, names) for names in (_POSITION, _GEODETIC, field))
    radius = np.linalg.norm(r_E_km, axis=1)
    wanted = f"kilometres, {ORBIT_KM[0]:.0f} to {ORBIT_KM[1]:.0f} from the centre of the Earth"
    outside = (radius < ORBIT_KM[0]) | (radius > ORBIT_KM[1])
    none_wrong(outside, table.where, radius, "has a position of length {:.6g} km", wanted)
    other_km = frames.from_geodetic(np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1]), geodetic[:, 2])
    apart = np.linalg.norm(other_km - r_E_km, axis=1)
    wanted = "x, y, z_ecef_km at lat_geod_deg, lon_deg, alt_geod_km (WGS 84)"
    none_wrong(apart > 1.0, table.where, apart, "has its two positions apart by {:.6g} km", wanted)
    size = np.linalg.norm(b_NEC_nT, axis=1)
    wrong = (size < _WEAKEST_nT) | (size > _STRONGEST_nT)
    none_wrong(wrong, table.where, size, "has |B| = {:.6g} nT", f"{_WEAKEST_nT:.0f} to {_STRONGEST_nT:.0f} nT")
    good = table.numbers([flag])[flag] == 0 if flag else np.ones(time.size, dtype=bool)
    source = f"{Path(path).name}, SHA-256 {table.sha256}"
    return Track(name, source, time, r_E_km, geodetic[:, 0], geodetic[:, 1], b_NEC_nT, good)
