"""The content of `summary.json` of the HCMM study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fluxtwin.scenarios.calibration_records import NAMES, calibration_summary, rms_mG
from fluxtwin.scenarios.claims import Claim
from fluxtwin.scenarios.hcmm.calibration_study import KINDS, SETS
from fluxtwin.scenarios.hcmm.gallery_study import Answer
from fluxtwin.scenarios.hcmm.real_passes import RealPasses
from fluxtwin.scenarios.hcmm.report import Results
from fluxtwin.sim.earth import epoch


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
        "real_passes": _real_passes(results.real_passes),
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


def gallery_summary(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """For `summary.json`."""
    return [
        {
            "case": answer.case.key,
            "title": answer.case.title,
            "verdict": answer.diagnosis.verdict,
            "named": answer.name,
            "right": answer.right,
            "where": {name: getattr(answer.diagnosis.where, name) for name in ("stage", "axis", "frame", "condition")},
            "located": answer.located,
            "parameters": [
                {"name": c.name, "put_in": c.put_in, "found": c.found, "sigma": c.sigma, "unit": c.unit}
                for c in answer.compared
            ],
            "passes_not_used": None if answer.later is None else {
                "unit": answer.later.unit, "before": answer.later.rms[0], "after": answer.later.rms[1],
                "floor": answer.later.floor, "concerned": int(answer.later.concerned.sum()),
                "passes": len(answer.later.labels),
            },
        }
        for answer in answers
    ]  # fmt: skip


def _real_passes(real: RealPasses) -> dict[str, Any]:
    """For `summary.json`."""
    return {
        "overflights": int(real.overflight.max()) + 1,
        "tests": len(real.questions),
        "explained_by_igrf1975": real.explained,
        "slope": real.slope,
        "questions": [
            {
                "question": one.name, "model_error_out": one.corrected, "passes": list(one.passes), "ratio": one.ratio,
                "p": one.p_value, "p_counted": one.p_counted,
                "detectable_ratio": None if np.isnan(one.detectable) else one.detectable,
            }
            for one in real.questions
        ],
    }  # fmt: skip
