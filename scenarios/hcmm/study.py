"""The HCMM study: the orbit from the record, a test against what flew, then the calibration as in 1979."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fluxtwin.scenarios.claims import Claim, claims_table, counted, whys_table
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.accuracy_study import run_accuracy
from fluxtwin.scenarios.hcmm.calibration_study import RUNS, SETS, run_calibrations
from fluxtwin.scenarios.hcmm.dawn_study import run_dawn
from fluxtwin.scenarios.hcmm.error_study import RUNS as ERROR_RUNS
from fluxtwin.scenarios.hcmm.error_study import run_errors
from fluxtwin.scenarios.hcmm.field_evidence import weigh_field_error
from fluxtwin.scenarios.hcmm.figures import figures, gallery_figures
from fluxtwin.scenarios.hcmm.gallery_study import GROUND, run_gallery
from fluxtwin.scenarios.hcmm.horizon_study import run_horizon
from fluxtwin.scenarios.hcmm.missing_study import FLIGHTS, run_missing
from fluxtwin.scenarios.hcmm.pass_study import run_passes
from fluxtwin.scenarios.hcmm.real_passes import ask
from fluxtwin.scenarios.hcmm.report import judge_claims, summary, words
from fluxtwin.scenarios.hcmm.scanner_study import run_scanner
from fluxtwin.scenarios.hcmm.yaw_study import run_yaw
from fluxtwin.scenarios.hcmm_orbit.fit import fit_orbit
from fluxtwin.scenarios.hcmm_orbit.flight_test import run_flight_test, windows_of
from fluxtwin.scenarios.hcmm_orbit.nadir_field import weigh_ideas
from fluxtwin.scenarios.hcmm_orbit.record import read_passes
from fluxtwin.scenarios.motion import ATTITUDES, is_dynamic, motion_of
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.page import Page, StudyResult, Table
from fluxtwin.scenarios.study_files import provenance, write_flight
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import load_field

TABLES = (
    "orbit",
    "flight_test",
    "ideas_place",
    "ideas_count",
    "calibration",
    "sigmas",
    "errors",
    "strength",
    "angles",
    "dawn",
    "figure_3",
    "yaw",
    "scanner",
    "horizon",
    "missing",
    "motion",
    "real_passes",
    "overview",
)
"""Those of the terminal, in order."""


def run(
    out: Path, data: Path | None = None, progress: Progress = silent, *, attitude: str = ATTITUDES[0]
) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibration. `data` is not used.

    attitude: how the vehicle moves, one of `motion.ATTITUDES`.
    """
    results = compute(progress, attitude=attitude)
    claims = judge_claims(results)
    calibration = results.calibration.fits["AB"].calibration
    telemetry = mission.fly(results.scenario).telemetry
    line = words().say("status", r=results, counted=counted(claims))
    made = tables(results)
    return StudyResult(
        name="hcmm",
        status_line=line,
        summary=summary(results, claims),
        tables=[*(made[name] for name in TABLES), claims_table(claims), whys_table(claims)],
        page=page(results, claims, line),
        more_pages={"gallery": gallery_page(results.gallery, results.scenario.seed, results.gallery_law)},
        written=write_flight(out, mission.scenario_text(attitude), telemetry, calibration),
    )


def compute(
    progress: Progress = silent,
    *,
    runs: int = RUNS,
    only: Sequence[str] = ("a", "b", "c", "d"),
    attitude: str = ATTITUDES[0],
) -> Numbers:
    """All the numbers. `runs`: size of the Monte Carlo, `only`: cases of the gallery, both for quick looks.

    attitude: as in `run`.
    """
    config = mission.scenario(attitude)
    ground = load_field(config.field.model)
    whole, progress = progress, part_of(progress, 0.0, 0.5)
    progress("orbit from the record", 0.0)
    orbit = fit_orbit()
    windows = windows_of(read_passes(), orbit.orbit, as_scanned=False)
    progress("the test against flight", 0.05)
    flight_test, nadir_field = run_flight_test(orbit), weigh_ideas(orbit, windows)
    evidence = weigh_field_error(orbit, windows, config.seed)
    days = mission.fly(mission.on_days(config))
    calibration = run_calibrations(days, ground, part_of(progress, 0.10, 0.75), runs)
    full = calibration.fits["AB"].calibration
    errors = run_errors(config, ground, part_of(progress, 0.75, 0.88), min(runs, ERROR_RUNS))
    progress("the 43 passes", 0.88)
    flight = mission.fly(config)
    passes = run_passes(flight, full, ground, windows, calibration.estimates[:, SETS.index("AB")])
    return Numbers(
        scenario=config,
        motion=motion_of(config, flight.telemetry, flight.truth),
        orbit=orbit,
        windows=windows,
        flight_test=flight_test,
        nadir_field=nadir_field,
        evidence=evidence,
        calibration=calibration,
        errors=errors,
        passes=passes,
        dawn=run_dawn(config, windows),
        yaw=run_yaw(config, full, ground, part_of(progress, 0.90, 0.95)),
        accuracy=run_accuracy(config, flight, full, calibration.bias_only.b_mG.mean(axis=0) * NT_PER_MG, ground),
        scanner=run_scanner(days, flight, ground, part_of(progress, 0.96, 1.0)),
        horizon=run_horizon(days, flight, ground, windows, part_of(whole, 0.5, 0.55)),
        missing=run_missing(
            config,
            ground,
            windows,
            evidence,
            part_of(whole, 0.55, 0.65),
            flights=min(runs, FLIGHTS),
            diagnose=bool(only),
        ),
        real_passes=ask(read_passes(), evidence, config.seed),
        gallery=run_gallery(config, part_of(whole, 0.65, 0.92), only=only),
        gallery_law=(
            run_gallery(config, part_of(whole, 0.92, 1.0), only=("c",), by_law=True)[0]
            if "c" in only and is_dynamic(config)
            else None
        ),
    )


def tables(results: Numbers) -> dict[str, Table]:
    """All of the report but the claims."""
    named = [name for name in TABLES if name not in ("motion", "overview")]
    return {
        **words().tables([*named, "nadir_field"], r=results),
        "motion": results.motion.table(words().say("pointing", r=results)),
        "overview": words("gallery.md").table("overview", answers=results.gallery),
    }


def page(results: Numbers, claims: list[Claim], verdict: str) -> Page:
    """The report."""
    return words().page(
        "page",
        verdict,
        {**tables(results), "claims": claims_table(claims, with_why=True)},
        figures(results),
        provenance(results.scenario),
        {"Four faults, found from telemetry: the gallery": "gallery.html"},
        r=results,
    )


def gallery_page(answers: Sequence[Numbers], seed: int, law: Numbers | None = None) -> Page:
    """The four diagnosed cases. law: case (c) with the coils driven by the control law of the study."""
    said = words("gallery.md")
    shown = {f"compared_{one.case.key}": said.table("compared", answer=one) for one in answers}
    return said.page(
        "page",
        said.say("verdict", answers=answers),
        {**shown, "overview": said.table("overview", answers=answers)},
        gallery_figures(answers),
        {"seed": str(seed), "field of the diagnosis": GROUND},
        {"Back to the report": "report.html"},
        answers=answers,
        law=law,
    )
