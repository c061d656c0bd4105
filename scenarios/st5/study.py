"""The ST5 study: a spinning spacecraft's magnetometer calibrated without being told its attitude."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from fluxtwin.calib.common.calibration_file import write_calibration
from fluxtwin.scenarios.claims import Claim, claims_table, counted
from fluxtwin.scenarios.page import Page, Section, StudyResult
from fluxtwin.scenarios.st5 import mission, tables
from fluxtwin.scenarios.st5.calibration_study import Hour, Solved, run_hour
from fluxtwin.scenarios.st5.claims import judge_claims
from fluxtwin.scenarios.st5.monte_carlo import (
    RUNS,
    STARTS,
    MonteCarlo,
    Starts,
    run_monte_carlo,
    run_starts,
    truth_terms,
)
from fluxtwin.scenarios.st5.open_settings import Setting
from fluxtwin.scenarios.st5.terms import terms_of
from fluxtwin.sim.base import files
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

ERRATA = (
    'The scan reads brackets as digits: "[l; -2; 31" is [1; -2; 3], "[-2; 1.5; 13" is [-2; 1.5; 1], "1.121 kg-m2" is '
    '"1.12] kg-m2", "3.0091" is "3.009]" and "0.891" is "0.89]" before its unit. These are readings of the scan, ours: as '
    "printed in digits the last could as well be 0.891, a thousandth of a degree away.",
)


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    hour: Hour
    many: MonteCarlo
    starts: Starts


def run(out: Path, data: Path | None = None, progress: Progress = silent) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibrations. `data` is not used."""
    results = compute(progress)
    hour = results.hour
    claims = judge_claims(hour)
    assert hour.iterative.fit is not None and hour.batch.fit is not None
    written = [
        files.write_text(out / "scenario.toml", mission.scenario_text()),
        write_telemetry(hour.flight.telemetry, out / "telemetry.nc"),
        write_calibration(hour.batch.fit.calibration, out / "calibration.toml"),
        write_calibration(hour.iterative.fit.calibration, out / "calibration-iterative.toml"),
    ]
    line = (
        f"ST5: attitude RSS {hour.before.rss_deg:.2f} deg before (abstract {mission.published()['pre_rss_deg']:g}; it chose "
        f"two settings), {hour.steps_alone.rss_deg:.3f} deg by the abstract's steps "
        f"({mission.published()['post_rss_deg']:g}); with our regression {hour.iterative.rss_deg:.4f} deg, by the batch "
        f"{hour.batch.rss_deg:.4f} deg; "
        f"{results.starts.found} of {results.starts.tried} blind starts find the motion; "
        f"{counted(claims)}."
    )
    return StudyResult(
        name="st5",
        status_line=line,
        summary=summary(results, claims),
        tables=_tables(results, claims),
        page=page(results, claims, line),
        written=written,
    )


def compute(progress: Progress = silent, *, runs: int = RUNS, starts: int = STARTS, **grid: Sequence[float]) -> Results:
    """All the numbers. `runs`, `starts`: sizes of the Monte Carlo; `grid`: of the search; for quick looks."""
    config = mission.scenario()
    ground = load_field(config.field.model)
    progress("flying the hour", 0.0)
    world = mission.world_of(config)
    hour = run_hour(mission.fly(config, world), ground, part_of(progress, 0.02, 0.3), **grid)
    many = run_monte_carlo(config, world, ground, part_of(progress, 0.3, 0.55), runs)
    return Results(hour, many, run_starts(config, world, ground, part_of(progress, 0.55, 1.0), starts))


def meaning() -> str:
    """What a comparison with the abstract's two attitude errors can mean."""
    printed = mission.published()
    return (
        f"What a comparison with {printed['pre_rss_deg']:g} and {printed['post_rss_deg']:g} deg can mean: the abstract "
        "gives neither orbit nor epoch, spin axis, start of the filter, its process noise, nor the weight of the sun. "
        "The last two alone move both figures by more than a factor of two. The hour's place on the orbit was chosen for "
        f"the mean field of which {printed['noise_mG']:g} mG are the stated {printed['noise_equivalent_deg']:g} deg. "
        "Two settings were searched, the random walk of the momentum and the weight of the sun; orbit plane, epoch, spin "
        "axis, slit and start are left as assumed. Two settings can meet two figures whatever is true, so only a figure "
        "that had no part in the choice is judged. Scale factors and non-orthogonality are zero in our truth because the "
        "abstract states none."
    )


def like_for_like(hour: Hour) -> str:
    """Which of our figures stands beside the abstract's, and which goes further."""
    return (
        f"Like for like with the abstract's {mission.published()['post_rss_deg']:g} deg are its steps alone, with the "
        f"settings of the filter that its errors before calibration choose: {hour.steps_alone.rss_deg:.3f} deg here. Nearly "
        "all of that is the filter's process noise, for a perfect calibration changes it in the fourth digit. Without "
        f"process noise and with our regression after them the steps give {hour.iterative.rss_deg:.4f} deg, the batch "
        f"{hour.batch.rss_deg:.4f} deg; both are ours and not in the abstract."
    )


def worst_parameter(hour: Hour) -> str:
    """The largest error of the batch in its own sigmas, and how often chance gives as much."""
    assert hour.batch.fit is not None
    found = terms_of(hour.batch.fit.calibration)
    error = np.asarray(found.values) - truth_terms()
    pull = np.abs(error / found.sigma)
    k = int(np.argmax(pull))
    chance = 1.0 - float(chi2.cdf(pull[k] ** 2, 1)) ** len(pull)
    return (
        f"The worst of the six parameters of the batch is {tables.NAMES[k]}: off by {error[k]:.4f}, {pull[k]:.1f} of its "
        f"sigma. Chance alone gives so much or more in one of six in {chance:.1%} of hours; whether the sigmas are right is "
        "for the many runs to say."
    )


def summary(results: Results, claims: list[Claim]) -> dict[str, Any]:
    """The content of `summary.json`; b and misalignment in the abstract's terms, raw = R A H + b."""
    hour, many, starts = results.hour, results.many, results.starts
    printed = mission.published()
    low, high = many.nees_band
    return {
        "study": "st5",
        "seed": hour.flight.scenario.seed,
        "convention": "raw = R A H + b, R = exp(-[misalignment x]); the calibration files keep A B0 = (I+S) B + b + T D",
        "truth": {"b_mG": printed["b_mG"], "misalignment_deg": printed["misalignment_deg"]},
        "pre_rss_deg": hour.before.rss_deg,
        "pre_rms_deg": hour.before.rms_deg.tolist(),
        "steps_alone": {
            "post_rss_deg": hour.steps_alone.rss_deg,
            "b_mG": terms_of(hour.alone).b_mG.tolist(),
            "misalignment_deg": terms_of(hour.alone).misalignment_deg.tolist(),
        },
        "iterative": _way(hour.iterative),
        "batch": _way(hour.batch),
        "abstract": {
            key: printed[key]
            for key in ("pre_rms_deg", "pre_rss_deg", "post_rss_deg", "b_estimated_mG", "misalignment_estimated_deg")
        },
        "monte_carlo": {
            "runs": len(many.nees),
            "pull_mean": many.pulls.mean(axis=0).tolist(),
            "pull_rms": many.pulls.std(axis=0, ddof=1).tolist(),
            "error_rms": np.sqrt((many.errors_mG_deg**2).mean(axis=0)).tolist(),
            "nees_mean": float(many.nees.mean()),
            "nees_band_95": [low, high],
            "attitude_rss_deg": float(many.attitude_rss_deg.mean()),
        },
        "blind_start": {"tried": starts.tried, "found": starts.found},
        "settings": {
            "searched": [_setting(row) for row in hour.search.grid],
            "by_rms_before": _setting(hour.search.by_axes),
            "by_both_rss": _setting(hour.search.by_rss),
        },
        "claims": [claim.to_dict() for claim in claims],
    }  # fmt: skip


def _setting(row: Setting) -> dict[str, Any]:
    return {
        "walk_rad_s": row.walk_rad_s, "sun_factor": row.sun_factor, "pre_rms_deg": row.pre_deg.tolist(),
        "pre_rss_deg": row.pre_rss_deg, "post_rms_deg": row.post_deg.tolist(), "post_rss_deg": row.post_rss_deg,
    }  # fmt: skip


def _way(solved: Solved) -> dict[str, Any]:
    assert solved.fit is not None
    return {
        "post_rss_deg": solved.rss_deg,
        "post_rms_deg": solved.rms_deg.tolist(),
        **terms_of(solved.fit.calibration).to_dict(),
        "squared_over_noise": solved.nis,
        "motion": dict(solved.fit.motion),
        "steps_deg": list(solved.fit.steps_deg),
    }


def _tables(results: Results, claims: list[Claim]) -> list[Any]:
    hour = results.hour
    return [
        tables.attitude_table(hour),
        tables.parameter_table(hour),
        tables.settings_table(hour),
        tables.monte_carlo_table(results.many),
        tables.starts_table(results.starts),
        claims_table(claims, with_why=True),
    ]


def page(results: Results, claims: list[Claim], verdict: str) -> Page:
    """The report."""
    shown = _tables(results, claims)
    hour = results.hour
    assert hour.iterative.fit is not None and hour.batch.fit is not None
    return Page(
        title="ST5: a spinning spacecraft's magnetometer, calibrated without attitude",
        verdict=verdict,
        sections=[
            Section(
                "What was done",
                [
                    "One hour at 26 rpm and 2 deg of nutation is flown with the abstract's bias and misalignment; the "
                    "ground gets the readings, the orbit and one sun pulse a spin. What the abstract does not give is "
                    "assumed and marked so in scenario.toml.",
                    "The iteration is the abstract's: TWOSTEP, filter for spinning spacecraft, alignment of magnetometer "
                    "and sun sensor, repeated; then ours, linear regression and filter in turn. The batch solves motion and "
                    "magnetometer at once, without inertia. Both begin blind.",
                    meaning(),
                ],
            ),
            Section(
                "Attitude and calibration",
                [like_for_like(hour), worst_parameter(hour)],
                [shown[0], shown[1]],
                tables.figures(hour),
            ),
            Section("Settings of the filter", [], [shown[2]], [tables.settings_figure(hour)]),
            Section("Many runs", [], [shown[3], shown[4]]),
            Section("What the estimators say", [*hour.iterative.fit.messages, *hour.batch.fit.messages]),
            Section("Claim by claim", [], [shown[5]]),
        ],
        errata=ERRATA,
        provenance={
            "seed": str(hour.flight.scenario.seed),
            "field": hour.flight.scenario.field.truth,
            "fluxtwin": metadata.version("fluxtwin"),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    )
