"""The flight record: nine zones of readings with the field in spin axes, the clock's slips, and the day's sunlight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5netcdf
import numpy as np
from numpy.typing import NDArray

from fluxtwin.scenarios.elfin.settings import MAP, Settings
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.earth.frames_of_date import rotation_from_N
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

_IRREGULAR_S = 1e-3
_STEP_S = 0.1
_LOST_S = 1.0
"""A pause that long is a packet that was not sent, not a clock that slipped."""


@dataclass(frozen=True)
class Slip:
    """Rows of one zone whose stamps are off, by the spacing of the stamps alone."""

    first: int
    last: int
    late_s: float
    """How much later the stamps are than the regular ones before; negative: the stamps that follow are."""


@dataclass(frozen=True)
class Zone:
    """One stretch of readings, N rows."""

    number: int
    telemetry: Telemetry
    seconds: FloatArray
    """(N,) from the first row of the record."""
    spin_N: FloatArray
    """(N, 3, 3) rows e1, e2, e3 in GCRS: e3 the spin axis as reported, e1 towards north of it."""
    field_S_nT: FloatArray
    """(N, 3) model field in those axes."""
    lit: FloatArray
    """(N,) share of the sun in view, from geometry."""
    slips: tuple[Slip, ...]
    used: BoolArray
    """(N,) False where rows are left out."""
    left_out: dict[str, int]

    @property
    def reading_nT(self) -> FloatArray:
        """(N, 3) sensor axes."""
        return np.asarray(self.telemetry.mag_B_nT)


@dataclass(frozen=True)
class Day:
    """Sunlight of the whole day along the orbit, M rows."""

    seconds: FloatArray
    """(M,) from the first row of the record."""
    lit: FloatArray

    def lagged(self, seconds: FloatArray, *lags_s: float) -> FloatArray:
        """(N,) sunlight behind one or more first-order lags in series, less its mean of the day."""
        state = self.lit
        for lag_s in lags_s:
            state = _followed(self.seconds, state, lag_s)
        found: FloatArray = np.interp(seconds, self.seconds, state) - float(state.mean())
        return found

    def shadow_entry_s(self, at_s: float) -> float:
        """The last entry into shadow before a moment."""
        dark = self.lit < 0.5
        entries = self.seconds[1:][dark[1:] & ~dark[:-1]]
        return float(entries[entries < at_s][-1])


@dataclass(frozen=True)
class Flight:
    """All that was read."""

    zones: tuple[Zone, ...]
    day: Day
    axis_sigma_rad: float
    """Of the spin axis, as its product states it (mean)."""


def read_flight(folder: Path, settings: Settings, model: FieldModel) -> Flight:
    """Both files; raises BadInput for what cannot be used."""
    path = folder / settings.file
    whole = read_telemetry(path, column_map=MAP)
    with h5netcdf.File(path, "r") as source:
        axis = np.asarray(source.variables["spin_axis_gei"][...], dtype=np.float64)
        number = np.asarray(source.variables["zone"][...])
        sigma_deg = float(np.mean(source.variables["spin_axis_uncertainty"][...]))
    axis_N = _unit(rotation_from_N("J2000", whole.time).apply(axis, inverse=True))
    assert whole.r_N_km is not None
    field_N = field_N_nT(model, whole.time, whole.r_N_km)
    lit = sun.illumination(whole.r_N_km, sun.sun_N_km(whole.time))
    seconds = epoch.seconds_since(whole.time, whole.time[0])
    zones = []
    for one in np.unique(number):
        rows = np.flatnonzero(number == one)
        frame = _spin_axes(axis_N[rows])
        slips = clock_slips(seconds[rows], settings.packet_rows)
        used, left_out = _usable(seconds[rows], slips, settings)
        zones.append(
            Zone(
                int(one), whole.select(rows), seconds[rows], frame, np.einsum("nij,nj->ni", frame, field_N[rows]),
                lit[rows], slips, used, left_out,
            )
        )  # fmt: skip
    return Flight(tuple(zones), _day(folder / settings.state_file, whole.time[0]), float(np.radians(sigma_deg)))


def clock_slips(seconds: FloatArray, packet_rows: int) -> tuple[Slip, ...]:
    """Stretches between two irregular steps no further apart than a packet; else the packet before a single one."""
    step = np.diff(seconds)
    odd = np.flatnonzero((np.abs(step - _STEP_S) > _IRREGULAR_S) & (step < _LOST_S))
    slips, place = [], 0
    while place < odd.size:
        row = int(odd[place])
        if place + 1 < odd.size and odd[place + 1] - row <= packet_rows:
            slips.append(Slip(row + 1, int(odd[place + 1]), float(step[row] - _STEP_S)))
            place += 2
        else:
            slips.append(Slip(max(row - packet_rows + 1, 0), row, float(_STEP_S - step[row])))
            place += 1
    return tuple(slips)


def _usable(seconds: FloatArray, slips: tuple[Slip, ...], settings: Settings) -> tuple[BoolArray, dict[str, int]]:
    starting = seconds < seconds[0] + settings.switch_on_s
    slipped = np.zeros(seconds.size, dtype=np.bool_)
    for slip in slips:
        slipped[slip.first : slip.last + 1] = True
    words = {"switching on": int(starting.sum()), "clock slip": int((slipped & ~starting).sum())}
    return ~starting & ~slipped, {reason: count for reason, count in words.items() if count}


def _spin_axes(axis_N: FloatArray) -> FloatArray:
    north = np.array([0.0, 0.0, 1.0])
    e1 = _unit(north - axis_N * (axis_N @ north)[:, None])
    return np.stack([e1, np.cross(axis_N, e1), axis_N], axis=1)


def _unit(vectors: FloatArray) -> FloatArray:
    lengths: FloatArray = np.linalg.norm(vectors, axis=1)[:, None]
    return vectors / lengths


def _day(path: Path, start: np.datetime64) -> Day:
    with h5netcdf.File(path, "r") as source:
        stored = source.variables["time"]
        time = _times(np.asarray(stored[...]), str(stored.attrs["units"]))
        position = np.asarray(source.variables["position_gei"][...], dtype=np.float64)
    r_N_km = rotation_from_N("J2000", time).apply(position, inverse=True)
    return Day(epoch.seconds_since(time, start), sun.illumination(r_N_km, sun.sun_N_km(time)))


def _times(values: NDArray[np.generic], units: str) -> NDArray[np.datetime64]:
    """UTC stamps of a variable with CF units such as "seconds since 2022-01-12"."""
    step, _, since = units.partition(" since ")
    scale = {"nanoseconds": 1, "microseconds": 10**3, "milliseconds": 10**6, "seconds": 10**9, "minutes": 60 * 10**9}
    if step not in scale or not since:
        raise BadInput(f"units {units!r}", where="time of the state file", wanted="seconds since a date")
    origin = np.datetime64(since.strip().replace(" ", "T").removesuffix("Z"), "ns")
    whole = np.asarray(values, dtype=np.int64) * scale[step]
    return np.asarray(origin + whole.astype("timedelta64[ns]"))


def _followed(seconds: FloatArray, goal: FloatArray, lag_s: float) -> FloatArray:
    kept = np.exp(-np.diff(seconds) / lag_s)
    state = np.empty_like(goal)
    state[0] = goal.mean()
    for row in range(1, goal.size):
        between = 0.5 * (goal[row] + goal[row - 1])
        state[row] = between + kept[row - 1] * (state[row - 1] - between)
    return state
