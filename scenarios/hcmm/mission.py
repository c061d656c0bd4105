"""HCMM's runs: the scenario, its days, and the printed tables."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from fluxtwin.scenarios.flights import Flight, Mission, day, fly
from fluxtwin.sim.scenario.scenario import Scenario

__all__ = ["Flight", "day", "fly"]

PRINTED = Mission(
    "fluxtwin.scenarios.hcmm",
    {
        "lsb": {"magnetometer.lsb_mG": 0.0},
        "attitude": {
            "attitude.reference.source": "error_model",
            "attitude.reference.needs_sun": True,
            "horizon_scanner.noise_deg": 0.0,
        },
        "torquer": {"torquers.compensation": 1.0},
        "field": {"field.truth": "igrf1975"},
    },
)
scenario, scenario_text, only = PRINTED.scenario, PRINTED.scenario_text, PRINTED.only
read_table, printed_value, quantity = PRINTED.table, PRINTED.value, PRINTED.quantity
SOURCES = tuple(PRINTED.off)
CASES: Mapping[str, Mapping[str, Any]] = tomllib.loads(PRINTED.text("cases.toml"))
"""What is flown with something added: `scans`, `earth`, `hypothesis`, `fault`, each by name."""

DAYS: Mapping[str, tuple[int, ...]] = {"A": (284, 285, 287, 289), "B": (279, 290, 292, 298, 300, 302)}
"""Days of 1978 in each set of Table 3. The scan shows 285 before 284, so one digit of it may be wrong."""
SAMPLES: Mapping[str, int] = {"A": 135, "B": 308}
"""132 and 308 in the scan, 443 together; 135 makes the sum right."""


def on_days(config: Scenario) -> Scenario:
    """The same spacecraft over all days of Table 3, in view of the stations."""
    days = sorted(DAYS["A"] + DAYS["B"])
    segments = [{"start_utc": f"{day(number)}Z", "duration_min": 1439.0, "step_s": 60.0} for number in days]
    return config.updated({"schedule.segments": segments, "sun_sensor.1.misalignment_deg": None})
