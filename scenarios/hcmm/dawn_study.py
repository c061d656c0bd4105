"""The dawn passes over Orroral, many times: the sun-nadir residual that a turned head 1 leaves in so few samples.

Only the end of such a pass is sunlit, a minute or three, so one flight's residual scatters by a sixth. The windows are
flown again with other seeds of sensors and motion; the claim is judged by the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.pass_study import rows_of
from fluxtwin.scenarios.hcmm_orbit.geometry import angle_between
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows
from fluxtwin.scenarios.motion import prescribed
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

FLIGHTS = 40


@dataclass(frozen=True)
class DawnStudy:
    """D dawn passes, FLIGHTS flights; deg."""

    labels: tuple[str, ...]
    """(D,)."""
    samples: tuple[int, ...]
    """(D,) with the sun in view; 0 where the sun rises as the window ends."""
    residual_deg: FloatArray
    """(FLIGHTS, D) rms of measured less computed sun-nadir angle; NaN where there is no sample."""

    @property
    def seen(self) -> FloatArray:
        """(FLIGHTS, S) the columns of passes that see the sun."""
        return self.residual_deg[:, np.array(self.samples) > 0]

    @property
    def mean_deg(self) -> FloatArray:
        """(S,) mean over the flights."""
        return np.asarray(self.seen.mean(axis=0))

    @property
    def standard_error_deg(self) -> FloatArray:
        """(S,) of these means."""
        return np.asarray(self.seen.std(axis=0, ddof=1) / np.sqrt(len(self.seen)))

    def by_label(self) -> dict[str, float | None]:
        """The means by pass; None where the sun is not seen."""
        means = iter(self.mean_deg.tolist())
        return {label: next(means) if count else None for label, count in zip(self.labels, self.samples, strict=True)}

    @property
    def together_deg(self) -> tuple[float, float]:
        """rms over the passes of one flight: mean and standard deviation over the flights."""
        each = np.sqrt(np.mean(self.seen**2, axis=1))
        return float(each.mean()), float(each.std(ddof=1))


def run_dawn(config: Scenario, windows: PassWindows, flights: int = FLIGHTS) -> DawnStudy:
    """Fly the windows of the dawn passes again and again, in the prescribed motion; every row sees what it can."""
    passes = read_passes()
    dawn = [k for k, item in enumerate(passes) if item.dawn]
    assert config.schedule is not None
    step_s = config.schedule.segments[0].step_s
    segments = [_segment(passes[k], windows, k, step_s) for k in dawn]
    plain = prescribed(config).updated({"schedule.segments": segments, "schedule.in_view_of_stations": None})
    residual, samples, world = np.full((flights, len(dawn)), np.nan), [0] * len(dawn), build_world(plain)
    for number in range(flights):
        telemetry = mission.fly(plain.updated({"seed": config.seed + 1 + number}), world).telemetry
        away = _away_rad(telemetry)
        for place, k in enumerate(dawn):
            inside = away[rows_of(telemetry, passes[k], windows, k)]
            known = inside[np.isfinite(inside)]
            samples[place] = known.size
            if known.size:
                residual[number, place] = np.degrees(np.sqrt(np.mean(known**2)))
    return DawnStudy(tuple(passes[k].label for k in dawn), tuple(samples), residual)


def _segment(item: Pass, windows: PassWindows, k: int, step_s: float) -> dict[str, object]:
    start = epoch.add_seconds(item.aos, 60.0 * windows.start_min[k])[0]
    return {
        "start_utc": f"{start}Z",
        "duration_min": float(windows.end_min[k] - windows.start_min[k]),
        "step_s": step_s,
    }


def _away_rad(telemetry: Telemetry) -> FloatArray:
    """(N,) measured less computed angle between sun and nadir."""
    assert telemetry.r_N_km is not None and telemetry.nadir_B is not None and telemetry.sun_B is not None
    r_N_km = np.array(telemetry.r_N_km)
    computed = angle_between(-r_N_km, sun.sun_direction_N(telemetry.time, r_N_km))
    return np.asarray(angle_between(telemetry.sun_B, telemetry.nadir_B) - computed)
