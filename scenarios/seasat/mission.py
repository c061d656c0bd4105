"""Seasat's runs: the scenario, its data sets, and other hours of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fluxtwin.scenarios.flights import Flight, Mission, day, fly
from fluxtwin.scenarios.seasat import geometry
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

__all__ = ["Flight", "fly"]

PRINTED = Mission(
    "fluxtwin.scenarios.seasat",
    {
        "lsb": {"magnetometer.lsb_mG": 0.0},
        "attitude": {"attitude.reference.source": "error_model"},
        "torquer": {"torquers.compensation": 1.0},
        "field": {"field.truth": "igrf1975"},
        "unknown": {"magnetometer.unknown": None},
    },
)
scenario, scenario_text, only = PRINTED.scenario, PRINTED.scenario_text, PRINTED.only
printed_value, quantity = PRINTED.value, PRINTED.quantity

DATA_SETS: Mapping[str, tuple[int, ...]] = {
    "205": (0,),
    "219": (1,),
    "225": (2,),
    "227": (3,),
    "193": (0, 2),
    "all": (0, 1, 2, 3),
}
"""Segments of the schedule in each data set. 193 samples are days 205 and 225; the published base of 210
samples is no sum of these days and is left out."""


def record_of(flight: Flight, data_set: str) -> Telemetry:
    """The telemetry of one of DATA_SETS."""
    return flight.telemetry.select(np.isin(flight.world.segment, DATA_SETS[data_set]))


def with_random_hours(config: Scenario, seed: int) -> Scenario:
    """The same days with another seed and start hours drawn at random, so that longitudes differ as well."""
    hours = stream(seed, "seasat.start_hours").uniform(0.0, 24.0, size=len(geometry.DATA_DAYS))
    segments = [
        {"start_utc": f"{day(number, float(hour))}Z", "samples": samples, "step_s": 60.0}
        for number, samples, hour in zip(geometry.DATA_DAYS, geometry.DATA_MINUTES, hours, strict=True)
    ]
    return config.updated({"seed": seed, "schedule.segments": segments})


def with_schedule(config: Scenario, start: np.datetime64, samples: int, step_s: float) -> Scenario:
    """The same spacecraft over another stretch of time."""
    segment = {"start_utc": f"{start}Z", "samples": samples, "step_s": step_s}
    return config.updated({"schedule.segments": [segment]})
