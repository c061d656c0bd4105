"""What the missing residual of field strength may be: hypotheses flown, judged by what is printed, and diagnosed.

The simulated 39 quiet passes leave less than the flight's did. Each hypothesis adds one error to the simulation, of the
size that brings those 39 passes to the printed level; that one number is used up. What else is printed judges: the pass
with the least residual, the largest, the four that stand out, the residual of the calibrations weeks before. The diagnosis
is then given the telemetry, which for the real flight nobody has, and says whether it would have known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.scenarios.calibration_records import rms_mG
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.calibration_study import SETS, choose_rows, fit_rows
from fluxtwin.scenarios.hcmm.field_evidence import rank_correlation
from fluxtwin.scenarios.hcmm.gallery_study import GROUND, diagnosed
from fluxtwin.scenarios.hcmm.mission import printed_value
from fluxtwin.scenarios.hcmm.pass_study import LIMIT_MG, QUIET_ROWS, rows_of_passes
from fluxtwin.scenarios.hcmm_orbit.record import read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows
from fluxtwin.scenarios.motion import prescribed
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import FieldModel, load_field
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario

FLIGHTS = 10
SURE = 0.01
"""Probability below which a printed number excludes a hypothesis, all numbers counted."""
_ROUNDING_MG = 0.03
"""Of the last number, rms: 2.2 mG is good to 0.05. The residuals are printed to 0.01."""
NOTHING = "nothing more"
HYPOTHESES: Mapping[str, Mapping[str, Any]] = {
    NOTHING: {},
    "white noise, 1.2 mG per axis": {"effects.excess_noise": {"rms_nT": 120.0}},
    "drifting bias, 2.0 mG in 56 days": {"effects.bias_random_walk": {"rate_nT_per_sqrt_s": 0.092}},
    "field model, 2.0 years of secular variation": {"effects.field_epoch": {"ahead_yr": 2.0}},
    "torquers, 2.4 mG left of 20 (print: below 1)": {"torquers.compensation": 0.88},
}
"""Magnetometer, field, torquers. Sizes to two digits at which the 39 passes leave what was printed: the table shows how
near they come."""
NUMBERS = (
    "rms of 39 passes [mG]",
    "rms of 43 passes [mG]",
    "least of 43 [mG]",
    "greatest of 43 [mG]",
    "passes above 3 mG",
    "spread of the logarithm",
    "correlation with the field model's error",
    "calibration A and B, rms [mG]",
)
"""What is compared; the first has set the size."""


@dataclass(frozen=True)
class Hypothesis:
    """One error added."""

    name: str
    values: FloatArray
    """(FLIGHTS, NUMBERS) each flight's; other seeds, the same orbit."""
    diagnosis: Diagnosis | None
    """Of the three days of Table 5 in one flight, the field known as it is today; None where it was not asked."""

    @property
    def mean(self) -> FloatArray:
        """(NUMBERS,)."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def spread(self) -> FloatArray:
        """(NUMBERS,) standard deviation of one flight."""
        return np.asarray(self.values.std(axis=0, ddof=1))

    def excluded_by(self, printed: FloatArray) -> list[str]:
        """Names of the printed numbers, the first left out, that one more flight would hardly reach (Student's t)."""
        flights = len(self.values)
        rounding = np.append(np.zeros(len(NUMBERS) - 1), _ROUNDING_MG)
        away = np.abs(self.mean - printed) / np.hypot(self.spread * np.sqrt(1.0 + 1.0 / flights), rounding)
        limit = student_t.ppf(1.0 - 0.5 * SURE / (len(NUMBERS) - 1), flights - 1)
        return [name for name, far in list(zip(NUMBERS, away > limit, strict=True))[1:] if far]


def run_missing(
    config: Scenario,
    ground: FieldModel,
    windows: PassWindows,
    evidence: Numbers,
    progress: Progress,
    *,
    flights: int = FLIGHTS,
    diagnose: bool = True,
) -> Numbers:
    """Fly each hypothesis over the days of Table 3 and the three of Table 5, in the prescribed motion."""
    days = mission.on_days(config)
    assert days.schedule is not None and config.schedule is not None
    segments = [s.model_dump(exclude_none=True) for s in (*days.schedule.segments, *config.schedule.segments)]
    whole = prescribed(days.updated({"schedule.segments": segments}))
    world, today = build_world(whole), load_field(GROUND)
    first = epoch.parse_time(config.schedule.segments[0].start_utc)
    found = []
    for number, (name, changes) in enumerate(HYPOTHESES.items()):
        progress(f"missing residual: {name}", number / len(HYPOTHESES))
        flown = [mission.fly(whole.updated({**changes, "seed": config.seed + k}), world) for k in range(flights)]
        values = np.array([_numbers(flight, ground, windows, evidence) for flight in flown])
        record = flown[0].telemetry
        asked = (
            diagnosed(record.select(record.time >= first), today, config, ("bias", "scale_misalignment"))
            if diagnose
            else None
        )
        found.append(Hypothesis(name, values, asked))
    printed = np.array([p.eps_M_mG for p in read_passes()])
    calibration_mG = printed_value("calibration", "AB", parameter="rms")
    return Numbers(printed=np.array([*_of_residuals(printed, evidence), calibration_mG]), hypotheses=tuple(found))


def _numbers(flight: mission.Flight, ground: FieldModel, windows: PassWindows, evidence: Numbers) -> list[float]:
    fit = fit_rows(flight, choose_rows(flight, SETS[-1]), ground, "white")
    rows = rows_of_passes(flight.telemetry, fit.calibration, ground, windows)
    return [*_of_residuals(np.array([row.eps_M_mG for row in rows]), evidence), rms_mG(fit)]


def _of_residuals(eps_mG: FloatArray, evidence: Numbers) -> list[float]:
    """All NUMBERS but the last, from the 43 residuals of field strength."""
    quiet = eps_mG[[number - 1 for number in QUIET_ROWS]]
    return [
        float(np.sqrt(np.mean(quiet**2))),
        float(np.sqrt(np.mean(eps_mG**2))),
        float(eps_mG.min()),
        float(eps_mG.max()),
        float((eps_mG > LIMIT_MG).sum()),
        float(np.log(eps_mG).std()),
        rank_correlation(eps_mG, evidence.predicted_mG),
    ]
