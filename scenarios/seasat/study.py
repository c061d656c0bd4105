"""The Seasat study: fly 1978, calibrate as in 1979, and set our numbers beside the papers'."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.claims import Claim, claims_table, counted, whys_table
from fluxtwin.scenarios.motion import ATTITUDES, motion_of
from fluxtwin.scenarios.page import Page, Section, StudyResult
from fluxtwin.scenarios.seasat import geometry, mission, tables
from fluxtwin.scenarios.seasat.accuracy_study import run_accuracy
from fluxtwin.scenarios.seasat.calibration_study import NAMES, rms_mG, run_calibrations
from fluxtwin.scenarios.seasat.claims import Results, judge_claims
from fluxtwin.scenarios.seasat.error_study import run_errors
from fluxtwin.scenarios.seasat.identities import check_identities
from fluxtwin.scenarios.seasat.judges_calibration import calibration_summary, pulls
from fluxtwin.scenarios.seasat.yaw_study import run_yaw
from fluxtwin.scenarios.study_files import provenance, write_flight
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import load_field

ERRATA = (
    "Journal equation 11 shows S12 = +0.016 in the scan; the conference text says -0.016, and the mean bias of "
    "figure 1 needs the minus.",
    "Journal equation 12 prints B2 where B3 stands; the pseudo-inverse of its equation 13 and conference equation 10 "
    "have B3.",
    "Conference, day 279: the formula printed for the overall residual is a plain root sum of squares (5.04 mG); the "
    "printed 2.9 mG is that divided by sqrt 3.",
    "Conference Table 1: signs and decimal points of the day columns are lost in the scan, and the last column counts "
    "125 samples for 325.",
    "Conference text: a combined base of 210 samples is not the sum of any of 92, 88, 101 and 44.",
    "Tables of error sources: 1.7 mG for the torquers is the largest possible field, used as an rms value.",
    "Journal: 11 deg is called the largest possible yaw error; the conference paper calls it the largest of its data "
    "base, which is what it can be.",
)


def run(
    out: Path, data: Path | None = None, progress: Progress = silent, *, attitude: str = ATTITUDES[0]
) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibration. `data` is not used.

    attitude: how the vehicle moves, one of `motion.ATTITUDES`.
    """
    results = compute(progress, attitude=attitude)
    claims = judge_claims(results)
    telemetry = mission.fly(results.scenario).telemetry
    written = write_flight(out, mission.scenario_text(attitude), telemetry, _with_monte_carlo(results))
    line = (
        f"Seasat: {counted(claims)}; residual {results.errors.simulated['all']:.1f} mG where the papers print "
        f"{mission.printed_value('errors', 'rms_mG', source='observed rms'):.1f} mG."
    )
    shown = [
        tables.calibration_table(results.calibration),
        tables.scatter_table(results.calibration),
        tables.attenuation_table(results),
        tables.error_table(results),
        tables.yaw_table(results),
        results.motion.table(tables.POINTING),
        claims_table(claims),
        whys_table(claims),
    ]
    return StudyResult(
        name="seasat",
        status_line=line,
        summary=summary(results, claims),
        tables=shown,
        page=page(results, claims, line),
        written=written,
    )


def _with_monte_carlo(results: Results) -> Calibration:
    """The calibration of all days with the covariance of the Monte Carlo, which holds errors that last an orbit."""
    found = results.calibration.fits["all"].calibration
    scale = np.repeat([1.0, NT_PER_MG], [9, 3])
    estimates = results.calibration.estimates[:, results.calibration.index("all")]
    covariance = np.cov(estimates[np.isfinite(estimates).all(axis=1)].T) * np.outer(scale, scale)
    method = f"{found.method}; covariance from a Monte Carlo of {len(estimates)} runs"
    return dataclasses.replace(found, covariance=covariance, covariance_kind="blocks", method=method)


def compute(progress: Progress = silent, *, runs: int | None = None, attitude: str = ATTITUDES[0]) -> Results:
    """All the numbers. `runs`: size of the Monte Carlo, for quick looks; attitude: as in `run`."""
    config = mission.scenario(attitude)
    ground = load_field(config.field.model)
    progress("flying the mission", 0.0)
    flight = mission.fly(config)
    extra = {} if runs is None else {"runs": runs}
    calibration = run_calibrations(flight, ground, part_of(progress, 0.02, 0.60), **extra)
    full = calibration.fits["all"].calibration
    residual_mG = rms_mG(calibration.fits["all"])
    progress("geometry of the orbit", 0.60)
    nodes = geometry.scan_node()
    return Results(
        scenario=config,
        motion=motion_of(config, flight.telemetry, flight.truth),
        calibration=calibration,
        errors=run_errors(config, ground, part_of(progress, 0.62, 0.80)),
        yaw=run_yaw(config, full, ground, part_of(progress, 0.80, 0.93)),
        accuracy=run_accuracy(config, ground, residual_mG, part_of(progress, 0.93, 0.99)),
        identities=check_identities(flight, ground),
        nodes=nodes,
        heads=geometry.scan_heads(nodes.chosen_deg),
    )


def summary(results: Results, claims: list[Claim]) -> dict[str, Any]:
    """The content of `summary.json`."""
    study, a, y, e = results.calibration, results.accuracy, results.yaw, results.errors
    parts = {name: calibration_summary(study.fits[name].calibration) for name in mission.DATA_SETS if name != "all"}
    everything = calibration_summary(study.fits["all"].calibration)
    everything["residual_rms_mG"] = rms_mG(study.fits["all"])
    everything["errors_in_variables_corrected"] = calibration_summary(study.corrected["all"].calibration)
    everything["sigma_monte_carlo"] = dict(zip(NAMES, study.scatter("all").tolist(), strict=True))
    everything["pulls"] = dict(zip(NAMES, pulls(results).tolist(), strict=True))
    for name, entry in parts.items():
        entry["residual_rms_mG"] = rms_mG(study.fits[name])
        entry["sigma_monte_carlo"] = dict(zip(NAMES, study.scatter(name).tolist(), strict=True))
    truth = {"S": study.truth[:9].reshape(3, 3).tolist(), "b_mG": study.truth[9:].tolist()}
    rows = {
        name: {"simulated": e.simulated[name], "paper_rule": e.paper_rule[name]}
        for name in ("lsb", "attitude", "torquer", "field", "known", "unknown", "all")
    }
    return {
        "study": "seasat",
        "seed": results.scenario.seed,
        "calibration": {
            "days": {name: entry for name, entry in parts.items() if name != "193"},
            "combined": {"193": parts["193"]},
            "all": everything,
            "sigma": "sigma_S and sigma_b_mG are the regression's own (errors longer than its blocks are not in them); "
            "sigma_monte_carlo is the scatter over many runs, holds all errors, and is what claims are judged by",
        },
        "truth": truth,
        "motion": results.motion.summary(),
        "yaw": {
            "sigma_equator_deg": a.sigma_equator_deg,
            "sigma_equator_at_our_residual_deg": a.sigma_equator_ours_deg,
            "sigma_worst_deg": a.worst_quantiles_deg,
            "sigma_worst_printed_percentile": a.printed_percentile,
            "rms_deg": {
                "mean_bias": y.bias_errors.rms_deg,
                "full": y.full_errors.rms_deg,
                "zero": y.full_errors.zero_rms_deg,
            },
            "zero_wins": {"mean_bias": y.bias_errors.zero_wins, "full": y.full_errors.zero_wins},
            "zero_wins_up_to_amplitude_deg": y.sweep.crossover_deg,
            "zero_wins_up_to_amplitude_white_unknown_deg": y.sweep.crossover_white_deg,
            "check_day_279_mG": y.check.rms_mG.mean(axis=0).tolist(),
        },
        "errors_mG": rows,
        "residual_mG": {
            "fit_known": e.fit_known,
            "fit_all": e.fit_all,
            "unknown_for_printed_residual": e.unknown_for_paper,
            "fit_with_that": e.fit_with_that,
        },
        "geometry": {
            "raan_deg": results.nodes.chosen_deg,
            "raan_from_launch_deg": results.nodes.launch_deg,
            "head_azimuth_deg": list(results.heads.azimuth_deg),
            "head_elevation_deg": results.heads.elevation_deg,
            "head_half_fov_deg": results.heads.half_fov_deg,
        },
        "claims": [claim.to_dict() for claim in claims],
    }  # fmt: skip


def page(results: Results, claims: list[Claim], verdict: str) -> Page:
    """The report."""
    study = results.calibration
    figures = tables.calibration_figures(results)
    return Page(
        title="Seasat-1: in-flight magnetometer calibration, 1978",
        verdict=verdict,
        sections=[
            Section(
                "What was done",
                [
                    "The spacecraft is flown with the papers' final S and b as truth in the field that is known of 1978 "
                    "today (DGRF); the ground calibrates with IGRF 1975 from telemetry alone. C is AIAA 79-1695, J is "
                    "AIAA 79-1695R.",
                    "What the papers do not give is assumed and marked so in scenario.toml: hours of the data, "
                    "correlation times, mounting, body, wheels and gains. The node is chosen from the sun-sensor record.",
                ],
                [results.motion.table(tables.POINTING)],
                [figures[2]],
            ),
            Section(
                "Calibration",
                [
                    "What the regression itself says of one orbit (day 205): "
                    + "; ".join(study.fits["205"].calibration.unobservable[:3])
                    + "."
                ],
                [
                    tables.calibration_table(study),
                    tables.scatter_table(study),
                    tables.attenuation_table(results),
                ],
                [figures[0]],
            ),
            Section("Sources of the residual", [], [tables.error_table(results)], [figures[1]]),
            Section("Yaw", [], [tables.yaw_table(results)], tables.yaw_figures(results)),
            Section("Claim by claim", [], [claims_table(claims, with_why=True)]),
        ],
        errata=ERRATA,
        provenance=provenance(results.scenario),
    )
