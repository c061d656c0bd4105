"""The flight record: nine zones of readings with the field in spin axes, the clock's slips, and the day's sunlight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.earth.frames import rotation_from_N
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

Lags = tuple[tuple[float, ...], ...]
"""The lags of each thermal state, those of one state in series [s]."""
MAP = "preset:elfin"
"""The column map of the record."""
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

    @property
    def late_s(self) -> FloatArray:
        """(N,) time from the middle."""
        return np.asarray(self.seconds - self.seconds.mean())

    @property
    def share(self) -> FloatArray:
        """(N,) the same over its last value."""
        return np.asarray(self.late_s / self.late_s[-1])

    @property
    def sunlit(self) -> float:
        """Mean share of the sun in view."""
        return float(self.lit.mean())


@dataclass(frozen=True)
class Day:
    """Sunlight of the whole day along the orbit, M rows."""

    seconds: FloatArray
    """(M,) from the first row of the record."""
    lit: FloatArray

    def lagged(self, seconds: FloatArray, *lags_s: float) -> FloatArray:
        """(N,) sunlight behind one or more first-order lags in series, minus its mean of the day."""
        state = self.lit
        for lag_s in lags_s:
            kept, goal = np.exp(-np.diff(self.seconds) / lag_s), state
            state = np.full_like(goal, goal.mean())
            for row, between in enumerate(0.5 * (goal[1:] + goal[:-1])):
                state[row + 1] = between + kept[row] * (state[row] - between)
        found: FloatArray = np.interp(seconds, self.seconds, state) - float(state.mean())
        return found

    def states(self, seconds: FloatArray, lags_s: Lags) -> FloatArray:
        """(N, J) one state for each entry of lags_s."""
        return np.array([self.lagged(seconds, *series) for series in lags_s]).reshape(len(lags_s), seconds.size).T

    def shadow_s(self, at_s: float) -> tuple[float, float]:
        """The last entry into shadow before a moment, and how long that shadow lasts."""
        dark = self.lit < 0.5
        entries = self.seconds[1:][dark[1:] & ~dark[:-1]]
        entry = float(entries[entries < at_s][-1])
        return entry, float(self.seconds[(self.seconds > entry) & (self.lit > 0.5)][0]) - entry


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
    with NetcdfFile(path) as source:
        axis, number = source.numbers("spin_axis_gei"), source.numbers("zone")
        sigma_deg = float(np.mean(source.raw("spin_axis_uncertainty")))
    axis_N = _unit(rotation_from_N("J2000", whole.time).apply(axis, inverse=True))
    assert whole.r_N_km is not None
    field_N = field_N_nT(model, whole.time, whole.r_N_km)
    lit = sun.illumination(whole.r_N_km, sun.sun_N_km(whole.time))
    seconds = epoch.seconds_since(whole.time, whole.time[0])
    zones = []
    for one in np.unique(number):
        rows = np.flatnonzero(number == one)
        t, e3 = seconds[rows], axis_N[rows]
        e1 = _unit(np.array([0.0, 0.0, 1.0]) - e3 * e3[:, 2:])
        frame = np.stack([e1, np.cross(e3, e1), e3], axis=1)
        field_S = np.einsum("nij,nj->ni", frame, field_N[rows])
        slips = clock_slips(t, settings.packet_rows)
        used = usable(t, slips, settings)
        zones.append(Zone(int(one), whole.select(rows), t, frame, field_S, lit[rows], slips, *used))
    with NetcdfFile(folder / settings.state_file) as source:
        time, position = source.times(), source.numbers("position_gei")
    r_N_km = rotation_from_N("J2000", time).apply(position, inverse=True)
    day = Day(epoch.seconds_since(time, whole.time[0]), sun.illumination(r_N_km, sun.sun_N_km(time)))
    return Flight(tuple(zones), day, float(np.radians(sigma_deg)))


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


def usable(seconds: FloatArray, slips: tuple[Slip, ...], settings: Settings) -> tuple[BoolArray, dict[str, int]]:
    """(N,) which rows are used, and how many are left out, by reason."""
    starting = seconds < seconds[0] + settings.switch_on_s
    slipped = np.zeros(seconds.size, dtype=np.bool_)
    for slip in slips:
        slipped[slip.first : slip.last + 1] = True
    words = {"switching on": int(starting.sum()), "clock slip": int((slipped & ~starting).sum())}
    return ~starting & ~slipped, {reason: count for reason, count in words.items() if count}


def _unit(vectors: FloatArray) -> FloatArray:
    lengths: FloatArray = np.linalg.norm(vectors, axis=1)[:, None]
    return vectors / lengths
