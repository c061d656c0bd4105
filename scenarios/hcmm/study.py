"""The HCMM study: the orbit from the record, a test against what flew, then the calibration as in 1979."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.scenarios.claims import Claim, claims_table, counted, whys_table
from fluxtwin.scenarios.hcmm import mission, pass_tables, residual_tables, tables
from fluxtwin.scenarios.hcmm.accuracy_study import run_accuracy
from fluxtwin.scenarios.hcmm.calibration_study import KINDS, NAMES, RUNS, SETS, rms_mG, run_calibrations
from fluxtwin.scenarios.hcmm.claims import Results, judge_claims
from fluxtwin.scenarios.hcmm.dawn_study import run_dawn
from fluxtwin.scenarios.hcmm.error_study import RUNS as ERROR_RUNS
from fluxtwin.scenarios.hcmm.error_study import run_errors
from fluxtwin.scenarios.hcmm.field_evidence import weigh_field_error
from fluxtwin.scenarios.hcmm.gallery_page import FILE as GALLERY_FILE
from fluxtwin.scenarios.hcmm.gallery_page import (
    gallery_page,
    gallery_summary,
    overview_table,
    real_passes_summary,
    real_passes_table,
)
from fluxtwin.scenarios.hcmm.gallery_study import Answer, run_gallery
from fluxtwin.scenarios.hcmm.horizon_study import run_horizon
from fluxtwin.scenarios.hcmm.missing_study import FLIGHTS, run_missing
from fluxtwin.scenarios.hcmm.pass_study import run_passes
from fluxtwin.scenarios.hcmm.real_passes import ask
from fluxtwin.scenarios.hcmm.report import page
from fluxtwin.scenarios.hcmm.scanner_study import run_scanner
from fluxtwin.scenarios.hcmm.yaw_study import run_yaw
from fluxtwin.scenarios.hcmm_orbit.fit import fit_orbit
from fluxtwin.scenarios.hcmm_orbit.flight_test import run_flight_test, windows_of
from fluxtwin.scenarios.hcmm_orbit.nadir_field import weigh_ideas
from fluxtwin.scenarios.hcmm_orbit.record import read_passes
from fluxtwin.scenarios.motion import ATTITUDES, is_dynamic, motion_of
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.seasat.judges_calibration import calibration_summary
from fluxtwin.scenarios.study_files import write_flight
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.scenario.scenario import Scenario


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
    written = write_flight(out, mission.scenario_text(attitude), telemetry, calibration)
    t = results.flight_test
    line = (
        f"HCMM: sun-field angles of {len(t.error_deg)} real passes predicted with a median error of {t.median_deg:.2f} deg "
        f"over the {int(t.untouched.sum())} ends whose digits nobody touched ({t.median_as_scanned_deg:.2f} over all 48 as "
        f"scanned); {counted(claims)}."
    )
    shown = [
        tables.orbit_table(results), tables.flight_test_table(results), *tables.ideas_tables(results),
        tables.calibration_table(results), tables.sigma_table(results),
        tables.error_table(results), pass_tables.strength_table(results),
        pass_tables.angles_table(results), pass_tables.dawn_table(results), pass_tables.figure_3_table(results),
        tables.yaw_table(results), tables.scanner_table(results), residual_tables.horizon_table(results.horizon),
        residual_tables.missing_table(results.missing), results.motion.table(tables.POINTING),
        real_passes_table(results.real_passes), overview_table(results.gallery), claims_table(claims), whys_table(claims),
    ]  # fmt: skip
    return StudyResult(
        name="hcmm",
        status_line=line,
        summary=summary(results, claims),
        tables=shown,
        page=page(results, claims, line),
        more_pages={GALLERY_FILE: gallery_page(results.gallery, results.scenario.seed, results.gallery_law)},
        written=written,
    )


def compute(
    progress: Progress = silent,
    *,
    runs: int = RUNS,
    only: Sequence[str] = ("a", "b", "c", "d"),
    attitude: str = ATTITUDES[0],
) -> Results:
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
    calibration = run_calibrations(config, ground, part_of(progress, 0.10, 0.75), runs)
    full = calibration.fits["AB"].calibration
    errors = run_errors(config, ground, part_of(progress, 0.75, 0.88), min(runs, ERROR_RUNS))
    progress("the 43 passes", 0.88)
    flight = mission.fly(config)
    passes = run_passes(flight, full, ground, windows, calibration.estimates[:, SETS.index("AB")])
    return Results(
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
        scanner=run_scanner(config, ground, part_of(progress, 0.96, 1.0)),
        horizon=run_horizon(config, flight, ground, windows, part_of(whole, 0.5, 0.55)),
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
        gallery_law=_under_the_law(config, part_of(whole, 0.92, 1.0)) if "c" in only else None,
    )


def _under_the_law(config: Scenario, progress: Progress) -> Answer | None:
    """Case (c) as the scenario drives its coils."""
    return run_gallery(config, progress, only=("c",), by_law=True)[0] if is_dynamic(config) else None


def summary(results: Results, claims: list[Claim]) -> dict[str, Any]:
    """The content of `summary.json`."""
    t, study, f = results.flight_test, results.calibration, results.orbit
    return {
        "study": "hcmm",
        "seed": results.scenario.seed,
        "motion": results.motion.summary(),
        "orbit": {
            "epoch_utc": epoch.iso(f.orbit.epoch_utc),
            **dict(zip(f.names, f.values.tolist(), strict=True)),
            "inclination_deg": float(np.degrees(f.orbit.inclination_rad)),
            "sigma": dict(zip(f.names, f.sigmas.tolist(), strict=True)),
            "covariance": f.covariance.tolist(),
            "node_local_apparent_time_h": f.node_apparent_h,
            "nodal_period_min": f.orbit.nodal_period_s / 60.0,
            "rise_less_printed_rms_min": float(np.sqrt(np.mean(f.rise_min**2))),
            "first_datum_after_acquisition_min": f.start_offset_min,
        },
        "theta_sm": {
            "median_error_deg": t.median_deg,
            "untouched_ends": int(t.untouched.sum()),
            "median_error_corrected_deg": t.median_corrected_deg,
            "median_error_as_scanned_deg": t.median_as_scanned_deg,
            "nulls": dict(t.nulls_deg),
            "ends_within_1_deg": t.ends_within(1.0),
            "ends_within_1_deg_as_scanned": t.ends_within(1.0, as_scanned=True),
            "ends": int(t.error_deg.size),
        },
        "theta_em": _theta_em(results),
        "field_model_error": _field_evidence(results),
        "calibration": {
            name: {
                **calibration_summary(study.fits[name].calibration),
                "residual_rms_mG": rms_mG(study.fits[name]),
                "passes": study.passes[name],
                "sigma_white": dict(zip(NAMES, study.white_sigma[name].tolist(), strict=True)),
                "sigma_by_pass": dict(zip(NAMES, study.pass_sigma[name].tolist(), strict=True)),
                "rms_error_monte_carlo": dict(zip(NAMES, study.rms_error(name).tolist(), strict=True)),
                "error_over_sigma": {kind: study.sigma_ratio(name, kind) for kind in KINDS},
            }
            for name in SETS
        },
        "bias_only": {
            "half_range_mG": study.bias_only.half_range_mG.tolist(),
            "explained_by_S": study.bias_only.explained,
            "explained_by_S11": study.bias_only.explained_by_scale,
            "passes": len(study.bias_only.b_mG),
        },
        "truth": {"S": study.truth[:9].reshape(3, 3).tolist(), "b_mG": study.truth[9:].tolist()},
        "errors_mG": {
            name: {"simulated": results.errors.simulated[name], "paper_rule": list(rule)}
            for name, rule in results.errors.paper_rule.items()
        },
        "passes": _passes(results),
        "dawn": {
            "flights": len(results.dawn.residual_deg),
            "sun_nadir_rms_deg": results.dawn.by_label(),
            "together_deg": list(results.dawn.together_deg),
        },
        "yaw": _yaw(results),
        "horizon_scanner": _scanner(results),
        "horizon": results.horizon.to_dict(),
        "missing_residual": results.missing.to_dict(),
        "real_passes": real_passes_summary(results.real_passes),
        "gallery": gallery_summary(results.gallery),
        "gallery_by_control_law": None if results.gallery_law is None else gallery_summary([results.gallery_law])[0],
        "claims": [claim.to_dict() for claim in claims],
    }


def _theta_em(results: Results) -> dict[str, Any]:
    n = results.nadir_field
    return {
        "ideas": {
            idea.name: {
                "ends_explained": idea.explained,
                "with_one_confused_digit": idea.explained_with_digits,
                "by_chance": list(idea.by_chance),
                **{
                    f"median_{'poleward' if p else 'equatorward'}_{'sunlit' if s else 'night'}_deg": n.median_abs(
                        idea, poleward=p, sunlit=s
                    )
                    for p in (True, False)
                    for s in (True, False)
                },
            }
            for idea in n.ideas
        },
        "ends": 86,
        "fitted_dipole_pole_deg": list(n.pole_deg),
        "model_dipole_pole_deg": list(n.model_pole_deg),
        "dipole_against_main_field_rms_deg": n.dipole_wrong_deg,
    }


def _field_evidence(results: Results) -> dict[str, Any]:
    e = results.evidence
    return {
        "rank_correlation": e.correlation,
        "rank_correlation_without_the_four": e.correlation_without_four,
        "rank_correlation_night": e.correlation_night,
        "rank_correlation_sunlit": e.correlation_sunlit,
        "chance": e.chance,
        "largest_ten_shared": e.top_shared,
        "turned_east_deg": e.turns_deg.tolist(),
        "turned_rank_correlation": e.turned_correlation.tolist(),
    }


def _passes(results: Results) -> list[dict[str, Any]]:
    r, w = results, results.windows
    out = []
    for k, (item, ours) in enumerate(zip(r.passes.passes, r.passes.rows, strict=True)):
        out.append(
            {
                "n": item.number, "aos_utc": epoch.iso(item.aos), "station": item.station, "sunlit": item.sunlit,
                "dawn": item.dawn, "window_min": [float(w.start_min[k]), float(w.end_min[k])],
                "highest_deg": float(r.orbit.highest_deg[k]), "rise_less_printed_min": float(r.orbit.rise_min[k]),
                "samples": ours.samples, "eps_M_mG": ours.eps_M_mG, "eps_M_range_mG": r.passes.eps_range_mG[k].tolist(),
                "field_model_error_mG": float(r.passes.field_model_eps_mG[k]),
                "theta_sm_deg": _list(ours.sun_field), "theta_em_deg": list(ours.nadir_field),
                "theta_se_deg": list(ours.sun_nadir), "delta_sm_deg": ours.delta_sun_field,
                "delta_em_deg": ours.delta_nadir_field, "delta_se_deg": ours.delta_sun_nadir,
                "printed": {
                    "eps_M_mG": item.eps_M_mG, "theta_sm_deg": _list(item.sun_field),
                    "theta_sm_as_scanned_deg": _list(item.sun_field_read),
                    "theta_em_as_scanned_deg": list(item.nadir_field_read), "theta_se_deg": list(item.sun_nadir),
                    "theta_se_as_scanned_deg": list(item.sun_nadir_read), "delta_sm_deg": item.delta_sun_field_deg,
                    "delta_em_deg": item.delta_nadir_field_deg, "delta_se_deg": item.delta_sun_nadir_deg,
                },
            }
        )  # fmt: skip
    return out


def _yaw(results: Results) -> dict[str, Any]:
    y = results.yaw
    return {
        "stations": {
            s.station: {"equation_11_deg": s.dipole, "printed_deg": s.printed, "field_of_1978_deg": s.main_field}
            for s in y.stations
        },
        "figure_3": {
            "rise_utc": epoch.iso(y.contact.rise),
            "theta_se_deg": list(y.sun_nadir_deg),
            "error_bar_deg": y.error_bar_deg,
            "rms_against_truth_deg": y.magnetometer_yaw_rms_deg,
            "rms_against_sun_sensor_deg": y.yaw_rms_deg,
        },
    }


def _scanner(results: Results) -> dict[str, Any]:
    s = results.scanner
    return {
        "bias_deg": np.degrees(s.found.bias_rad).tolist(),
        "sigma_deg": np.degrees(s.found.sigmas_rad).tolist(),
        "put_in_deg": list(s.bias_deg),
        "sun_nadir_rms_deg": {"before": s.rms_before_deg, "after": s.rms_after_deg},
        "turn_of_S_deg": {
            "before": s.tilt_biased_deg, "after": s.tilt_corrected_deg, "without_bias": s.tilt_unbiased_deg,
        },
        "head_1_deg": {"found": s.head_1_deg, "put_in": s.head_1_truth_deg},
        "sun_nadir_channel": {"head_1_turned": s.channel.to_dict(), "head_1_right": s.turned_magnetometer.to_dict()},
    }  # fmt: skip


def _list(pair: tuple[float, float] | None) -> list[float] | None:
    return None if pair is None else list(pair)
