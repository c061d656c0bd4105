"""The HCMM study: the orbit from the record, a test against what flew, then the calibration as in 1979; and its words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.calib.common.digits import with_sigma
from fluxtwin.gap.channels.sun_nadir import open_channel
from fluxtwin.gap.report.words import located
from fluxtwin.scenarios.flights import ATTITUDES, Numbers, is_dynamic, motion_of, provenance, rms_along, write_flight
from fluxtwin.scenarios.hcmm import calibration, mission, scanner, strength, yaw
from fluxtwin.scenarios.hcmm.calibration import BUDGET_RUNS, RUNS, run_calibrations, run_errors
from fluxtwin.scenarios.hcmm.gallery import FAULTS, GROUND, REGION_DEG, run_gallery
from fluxtwin.scenarios.hcmm.passes import ANOMALOUS, column_of, rms_of, run_dawn, run_passes
from fluxtwin.scenarios.hcmm.scanner import run_horizon, run_scanner
from fluxtwin.scenarios.hcmm.strength import FLIGHTS, ask, run_missing, weigh_field_error
from fluxtwin.scenarios.hcmm.yaw import run_accuracy, run_yaw
from fluxtwin.scenarios.hcmm_orbit import predictions
from fluxtwin.scenarios.hcmm_orbit.fit import fit_orbit
from fluxtwin.scenarios.hcmm_orbit.predictions import run_flight_test, weigh_ideas, windows_of
from fluxtwin.scenarios.hcmm_orbit.record import read_passes
from fluxtwin.scenarios.page import Page, StudyResult
from fluxtwin.scenarios.regression import NAMES, calibration_summary, rms_mG, vector, vector_sigma
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.horizon import INFRARED_SOURCE
from fluxtwin.sim.effects.region import outline_deg
from fluxtwin.sim.effects.switched_field import SwitchedField


def pulls(r: Numbers) -> FloatArray:
    """(12,) estimate of both sets less truth, over its rms error in many runs."""
    c = r.calibration
    return np.asarray((vector(c.fits["AB"]) - c.truth) / c.many.rms_error("AB"))


def gallery_summary(answers: Sequence[Numbers]) -> list[dict[str, Any]]:
    """For `summary.json`."""
    return [
        {
            "case": answer.case.key,
            "title": answer.case.title,
            "verdict": answer.diagnosis.verdict,
            "named": answer.name,
            "right": answer.right,
            "where": {name: getattr(answer.diagnosis.where, name) for name in ("stage", "axis", "frame", "condition")},
            "located": words().say("located_in", found=answer.diagnosis),
            "parameters": [vars(one) for one in answer.compared],
            "passes_not_used": answer.later
            and {
                "unit": answer.later.unit,
                "before": answer.later.rms[0],
                "after": answer.later.rms[1],
                "floor": answer.later.floor,
                "concerned": int(answer.later.concerned.sum()),
                "passes": len(answer.later.labels),
            },
        }
        for answer in answers
    ]


@cache
def words() -> Words:
    """The sections of the study's files."""
    return Words(
        mission.PRINTED.package,
        "words.md",
        "../studies.md",
        "claims.md",
        "gallery.md",
        known=(
            *(calibration, predictions, scanner, strength, yaw),
            *(calibration_summary, column_of, epoch.iso, epoch.seconds_since, located, mission.quantity),
            *(SwitchedField, outline_deg, tuple),
            *(open_channel, pulls, rms_along, rms_mG, rms_of, vector, vector_sigma),
        ),
        clock=lambda time: epoch.iso(time)[11:19],
        days=mission.DAYS,
        four=[number - 1 for number in ANOMALOUS],
        infrared_source=INFRARED_SOURCE,
        gallery=gallery_summary,
        names=NAMES,
        printed=mission.printed_value,
        region_deg=REGION_DEG,
        rounded=lambda value, sigma: with_sigma(value, sigma)[0],
        size=mission.PRINTED.size,
    )


def run(
    out: Path, data: Path | None = None, progress: Progress = silent, *, attitude: str = ATTITUDES[0]
) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibration. `data` is not used.

    attitude: how the vehicle moves, one of ATTITUDES.
    """
    results = compute(progress, attitude=attitude)
    calibration = results.calibration.fits["AB"].calibration
    written = write_flight(out, mission.scenario_text(attitude), results.flight.telemetry, calibration)
    return replace(present(results), written=written)


def present(results: Numbers) -> StudyResult:
    """What the study says of its numbers."""
    said, config = words(), results.scenario
    return said.result(
        "hcmm",
        provenance(config),
        claims=said.judge(r=results),
        links={"Four faults, found from telemetry: the gallery": "gallery.html"},
        more_pages={"gallery": gallery_page(results.gallery, config.seed, results.gallery_law)},
        r=results,
        answers=results.gallery,
    )


def gallery_page(answers: Sequence[Numbers], seed: int, law: Numbers | None = None) -> Page:
    """The four diagnosed cases. law: case (c) with the coils driven by the control law of the study."""
    values = {"answers": answers, "by_key": {one.case.key: one for one in answers}, "law": law}
    return words().page(
        words().say("verdict", answers=answers),
        words().figures("gallery.toml", **values),
        {"seed": str(seed), "field of the diagnosis": GROUND},
        {"Back to the report": "report.html"},
        name="gallery",
        **values,
    )


def compute(
    progress: Progress = silent,
    *,
    runs: int = RUNS,
    only: Sequence[str] = tuple(FAULTS),
    attitude: str = ATTITUDES[0],
) -> Numbers:
    """All the numbers. `runs`: size of the Monte Carlo, `only`: cases of the gallery, both for quick looks.

    attitude: as in `run`.
    """
    config = mission.scenario(attitude)
    ground = load_field(config.field.model)
    progress("orbit from the record", 0.0)
    passes, orbit = read_passes(), fit_orbit()
    windows = windows_of(passes, orbit.orbit, as_scanned=False)
    progress("the test against flight", 0.03)
    flight_test, nadir_field = run_flight_test(orbit), weigh_ideas(orbit, windows)
    evidence = weigh_field_error(orbit, windows, config.seed)
    days = mission.fly(mission.on_days(config))
    calibration = run_calibrations(days, ground, part_of(progress, 0.05, 0.38), runs)
    full = calibration.fits["AB"].calibration
    errors = run_errors(config, ground, part_of(progress, 0.38, 0.44), min(runs, BUDGET_RUNS))
    progress("the 43 passes", 0.44)
    flight = mission.fly(config)
    bias_nT = calibration.bias_only.b_mG.mean(axis=0) * NT_PER_MG
    law = "c" in only and is_dynamic(config)
    return Numbers(
        scenario=config,
        flight=flight,
        motion=motion_of(flight),
        orbit=orbit,
        windows=windows,
        flight_test=flight_test,
        nadir_field=nadir_field,
        evidence=evidence,
        calibration=calibration,
        errors=errors,
        passes=run_passes(flight, full, ground, windows, calibration.many.of("AB")),
        dawn=run_dawn(config, windows),
        yaw=run_yaw(config, full, ground, part_of(progress, 0.45, 0.47)),
        accuracy=run_accuracy(config, flight, full, bias_nT, ground),
        scanner=run_scanner(days, flight, ground, part_of(progress, 0.48, 0.5)),
        horizon=run_horizon(days, flight, ground, windows, part_of(progress, 0.5, 0.55)),
        missing=run_missing(
            config,
            ground,
            windows,
            evidence,
            part_of(progress, 0.55, 0.65),
            flights=min(runs, FLIGHTS),
            diagnose=bool(only),
        ),
        real_passes=ask(passes, evidence, config.seed),
        gallery=run_gallery(config, part_of(progress, 0.65, 0.92), only=only),
        gallery_law=run_gallery(config, part_of(progress, 0.92, 1.0), only=("c",), by_law=True)[0] if law else None,
    )
