"""The recorded files that have a layout of their own, read strictly: residual days and an aircraft's compensation.

The full vectors of MAGSAT and Swarm are read by `flight_field.tracks`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.scenarios.recorded_files import numbers, opened
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile
from fluxtwin.sim.telemetry.time_stamps import parse_iso

_RESIDUAL = ("N_res", "E_res", "C_res")
_PLACE = ("Latitude", "Longitude", "Radius")
_LOWEST_KM, _HIGHEST_KM = 6480.0, 8400.0
_MINUTE = 60  # samples of DMSP from one position to the next


@dataclass(frozen=True)
class ResidualDay:
    """A day of measured less modelled field along an orbit; N rows."""

    time: TimeArray
    r_E_km: FloatArray
    """(N, 3)."""
    NEC_nT: FloatArray
    """(N, 3) geocentric north, east, centre."""
    kp: FloatArray
    """(N,) the planetary index of those hours."""


@dataclass(frozen=True)
class BodyResiduals:
    """Measured less modelled field in spacecraft axes, with a position now and then; N rows, M positions."""

    time: TimeArray
    body_nT: FloatArray
    """(N, 3)."""
    position_time: TimeArray
    """(M,)."""
    r_E_km: FloatArray
    """(M, 3)."""


@dataclass(frozen=True)
class Compensation:
    """An aircraft's fluxgate and scalar magnetometer and what the published compensation takes off; N rows."""

    fluxgate_B_nT: FloatArray
    """(N, 3)."""
    raw_nT: FloatArray
    """(N,) scalar magnetometer."""
    taken_nT: FloatArray
    """(N,) the compensation: raw less compensated."""


def read_residual_day(path: Path) -> ResidualDay:
    """Swarm's residual file: geocentric degrees and metres, N, E, C in nT. Raises BadInput naming file and fault."""
    table = opened(path, ("time_utc", *_PLACE, *_RESIDUAL, "Kp"))
    place, residual = numbers(table, _PLACE), numbers(table, _RESIDUAL)
    radius_km = place[:, 2] / 1e3
    if not ((radius_km > _LOWEST_KM) & (radius_km < _HIGHEST_KM)).all():
        raise BadInput("a Radius is no orbit's", where=table.where, wanted="metres from the centre of the Earth")
    r_E_km = frames.from_geocentric(np.radians(place[:, 0]), np.radians(place[:, 1]), radius_km)
    time = parse_iso(table.text("time_utc"), table.where)
    _increasing(time, table.where)
    return ResidualDay(time, r_E_km, residual, numbers(table, ("Kp",))[:, 0])


def read_body_residuals(path: Path) -> BodyResiduals:
    """DMSP's residual file: dB in spacecraft axes, a position for every 60th sample. Raises BadInput."""
    with NetcdfFile(path) as opened:
        missing = [name for name in ("time", "dB", "position_ecef_60") if name not in opened.names()]
        if missing:
            raise BadInput(f"no variable {', '.join(missing)}", where=opened.where, wanted="dB and position_ecef_60")
        time, body, r_E_km = opened.times(), opened.numbers("dB"), opened.numbers("position_ecef_60")
    if body.shape != (time.size, 3) or r_E_km.shape != (-(-time.size // _MINUTE), 3):
        raise BadInput(
            f"shapes {body.shape} and {r_E_km.shape} with {time.size} stamps",
            where=str(path),
            wanted="dB (N, 3) and a position for every 60th of N samples",
        )
    _increasing(time, str(path))
    return BodyResiduals(time, body, time[::_MINUTE], r_E_km)


def read_compensation(path: Path) -> Compensation:
    """The aircraft's file. Raises BadInput naming the fault, as raw less compensation that is not the compensated."""
    names = ("flux_a_x", "flux_a_y", "flux_a_z", "mag_1_uc", "mag_1_comp", "mag_1_c")
    table = opened(path, names)
    values = numbers(table, names)
    apart = np.abs(values[:, 3] - values[:, 4] - values[:, 5])
    if apart.max() > 1e-3:
        raise BadInput(
            f"mag_1_uc - mag_1_comp differs from mag_1_c by {apart.max():.3g} nT", where=table.where, wanted="0.001 nT"
        )
    return Compensation(values[:, :3], values[:, 3], values[:, 4])


def _increasing(time: TimeArray, where: str) -> None:
    if time.size < 2 or np.isnat(time).any() or (np.diff(time) <= np.timedelta64(0, "ns")).any():
        first = epoch.iso(time[0]) if time.size else "nothing"
        raise BadInput(f"the time does not increase throughout (it begins with {first})", where=where, wanted="UTC")
