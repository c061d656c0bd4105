"""[sampling.NAME] of a scenario: sensors that are read less often than the telemetry has rows, each at its own rate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self, get_args

import numpy as np
from pydantic import create_model, model_validator

from fluxtwin.sim.base.section_types import NonNegative, Positive, Section
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.scenario.sections import ScheduleSection
from fluxtwin.sim.telemetry.quantities import DRIVERS, Part, columns_of
from fluxtwin.sim.telemetry.record import Telemetry


class RateSection(Section):
    """Read in the rows `offset_s` after the start of a segment, and every `every_s` from there on."""

    every_s: Positive
    offset_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _within(self) -> Self:
        if self.offset_s >= self.every_s:
            raise ValueError("offset_s is to be less than every_s")
        return self


class SamplingBase(Section):
    """Who is read when; without a section in every row."""

    @property
    def rates(self) -> dict[str, RateSection]:
        given = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: rate for name, rate in given.items() if rate is not None}

    def check(self, schedule: ScheduleSection) -> None:
        """ValueError unless each rate is a whole number of each segment's steps."""
        for name, rate in self.rates.items():
            for step_s in {segment.step_s for segment in schedule.segments}:
                steps = np.array([rate.every_s, rate.offset_s]) / step_s
                if (np.abs(steps - np.rint(steps)) > 1e-6).any():
                    raise ValueError(
                        f"[sampling.{name}]: every_s = {rate.every_s:g} and offset_s = {rate.offset_s:g} must be whole "
                        f"multiples of the rows' step_s, {step_s:g}"
                    )


if TYPE_CHECKING:
    SamplingSection = SamplingBase
else:
    SamplingSection = create_model(
        "SamplingSection", __base__=SamplingBase, **dict.fromkeys(get_args(Part), (RateSection | None, None))
    )
    """[sampling] with [sampling.NAME] for each part that writes columns of telemetry."""


def sampled_rows(
    sampling: SamplingSection, schedule: ScheduleSection, time: TimeArray, segment: FloatArray
) -> dict[str, BoolArray]:
    """(N,) rows in which each part with a rate is read; time (N,), segment (N,) as in `World`."""
    starts = np.array([epoch.parse_time(part.start_utc) for part in schedule.segments], dtype="datetime64[ns]")
    steps = np.array([part.step_s for part in schedule.segments])
    number = segment.astype(np.int64)
    elapsed = epoch.seconds_since(time, starts[0]) - epoch.seconds_since(starts, starts[0])[number]
    rows = {}
    for name, rate in sampling.rates.items():
        phase = (elapsed - rate.offset_s) / rate.every_s
        away_s = np.abs(phase - np.rint(phase)) * rate.every_s
        rows[name] = np.asarray((away_s < 1e-3 * steps[number]) & (np.rint(phase) >= 0.0))
    return rows


def interleaved(telemetry: Telemetry, rows: dict[str, BoolArray], *, attitude_from_sensors: bool) -> Telemetry:
    """The record with blanks where a part was not read. An attitude made from sun and nadir wants both in its row."""
    taken = dict(rows)
    if attitude_from_sensors:
        every = np.ones(len(telemetry), dtype=np.bool_)
        taken["attitude"] = np.logical_and.reduce(
            [rows.get(name, every) for name in ("attitude", "sun_sensor", "horizon_scanner")]
        )
    changes: dict[str, object] = {}
    for name, read in taken.items():
        for column in columns_of(name):
            value = getattr(telemetry, column)
            if value is not None:
                changes[column] = np.where(read if value.ndim == 1 else read[:, None], value, np.nan)
        if name == DRIVERS.part:
            changes[DRIVERS.field] = {one: np.where(read, value, np.nan) for one, value in telemetry.drivers.items()}
    return telemetry.replace(**changes) if changes else telemetry
