"""The rows of a spinning spacecraft: readings with the model field in N, and sun pulses with the sun in N."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.calib.common.design import joined
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.earth.sun import sun_direction_N
from fluxtwin.sim.telemetry.record import Telemetry

_FEWEST_PULSES = 5


@dataclass(frozen=True)
class SpinRows:
    """Usable rows in order of time; N readings, M pulses. Seconds count from the first of either."""

    start: np.datetime64
    time: TimeArray
    """(N,) UTC of the readings."""
    t_s: FloatArray
    """(N,)."""
    B_nT: FloatArray
    """(N, 3) reading, nominal body axes."""
    H_N_nT: FloatArray
    """(N, 3) model field, GCRS."""
    pulse_s: FloatArray
    """(M,)."""
    sun_B: FloatArray
    """(M, 3) measured unit vectors, body."""
    sun_N: FloatArray
    """(M, 3) unit vectors to the sun, GCRS."""
    rows: np.ndarray
    """(N,) indices of the readings in the joined telemetry."""
    left_out: Mapping[str, int]

    def __len__(self) -> int:
        return int(self.t_s.size)

    def select(self, readings: np.ndarray, pulses: np.ndarray | slice = slice(None)) -> SpinRows:
        """Some of the readings, and of the pulses; masks or indices."""
        of_reading = {name: getattr(self, name)[readings] for name in ("time", "t_s", "B_nT", "H_N_nT", "rows")}
        return replace(
            self, **of_reading, **{name: getattr(self, name)[pulses] for name in ("pulse_s", "sun_B", "sun_N")}
        )

    def within(self, first_s: float, last_s: float) -> SpinRows:
        """Readings and pulses of a stretch of time."""
        return self.select(*((first_s <= t_s) & (t_s <= last_s) for t_s in (self.t_s, self.pulse_s)))


def assemble_spin(records: Telemetry | Sequence[Telemetry], model: FieldModel) -> SpinRows:
    """Readings and sun pulses of telemetry; a row may hold either or both.

    Raises BadInput without a sun column, NoAnswer for too few readings or pulses.
    """
    telemetry = joined(records)
    if telemetry.sun_B is None:
        raise BadInput(
            "the telemetry has no measured sun",
            where="sun_x sun_y sun_z",
            wanted="the sun's unit vector in body axes at the rows where the sensor gave one: it holds the spin phase",
        )
    reading, position = telemetry.has_reading, telemetry.has_position
    seen = np.isfinite(telemetry.sun_B).all(axis=1)
    used, pulses = np.flatnonzero(reading & position), np.flatnonzero(seen & position)
    if used.size < 40 or pulses.size < _FEWEST_PULSES:
        raise NoAnswer(
            f"{used.size} readings with a position and {pulses.size} sun pulses: at least 40 and {_FEWEST_PULSES} are "
            "needed",
            evidence={"readings": int(used.size), "pulses": int(pulses.size)},
        )
    assert telemetry.r_N_km is not None
    start = min(telemetry.time[used[0]], telemetry.time[pulses[0]])
    left_out = {"no reading": int((~reading & ~seen).sum()), "no position": int((reading & ~position).sum())}
    sun_B = telemetry.sun_B[pulses]
    return SpinRows(
        start=start,
        time=telemetry.time[used],
        t_s=epoch.seconds_since(telemetry.time[used], start),
        B_nT=telemetry.mag_B_nT[used],
        H_N_nT=field_N_nT(model, telemetry.time[used], telemetry.r_N_km[used]),
        pulse_s=epoch.seconds_since(telemetry.time[pulses], start),
        sun_B=sun_B / np.linalg.norm(sun_B, axis=1)[:, None],
        sun_N=sun_direction_N(telemetry.time[pulses], telemetry.r_N_km[pulses]),
        rows=used,
        left_out={reason: count for reason, count in left_out.items() if count},
    )
