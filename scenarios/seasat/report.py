"""What the study of Seasat says: its words and claims with the numbers they need, its figures, its summary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.calibration_records import NAMES, calibration_summary, rms_mG, vector
from fluxtwin.scenarios.claims import Claim
from fluxtwin.scenarios.motion import Motion
from fluxtwin.scenarios.report import Report, matrix, plus_minus
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.accuracy_study import AccuracyStudy
from fluxtwin.scenarios.seasat.calibration_study import CalibrationStudy
from fluxtwin.scenarios.seasat.check_day import SEEDS
from fluxtwin.scenarios.seasat.error_study import ErrorStudy
from fluxtwin.scenarios.seasat.identities import Identities
from fluxtwin.scenarios.seasat.mission import DATA_SETS, PAPER_COLUMN, printed_value
from fluxtwin.scenarios.seasat.yaw_study import STEP_S, YawStudy
from fluxtwin.scenarios.yaw_comparison import NEAR_NODE_DEG
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2
from fluxtwin.sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    scenario: Scenario
    motion: Motion
    """Of the flight that is calibrated."""
    calibration: CalibrationStudy
    errors: ErrorStudy
    yaw: YawStudy
    accuracy: AccuracyStudy
    identities: Identities
    nodes: geometry.NodeScan
    heads: geometry.HeadScan


def pulls(r: Results) -> FloatArray:
    """(12,) (estimate - truth) / sigma of the base of 325 samples; sigma is the scatter of the Monte Carlo."""
    return np.asarray((vector(r.calibration.fits["all"]) - r.calibration.truth) / r.calibration.scatter("all"))


def judge_claims(r: Results) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without words."""
    return words().judge(mission.PRINTED, r=r)


@cache
def words() -> Report:
    """The sections of `words.md`."""
    return Report(
        "fluxtwin.scenarios.seasat",
        data_sets=list(DATA_SETS),
        distance_from=lambda value, low, high: np.maximum(np.maximum(low - value, value - high), 0.0),
        geometry=geometry,
        matrix=matrix,
        names=NAMES,
        near_node_deg=NEAR_NODE_DEG,
        period_min=_period_min,
        plus_minus=plus_minus,
        print_of=_print_of,
        printed=printed_value,
        pulls=pulls,
        quantity=mission.quantity,
        rms_mG=rms_mG,
        samples_by_day=lambda study: tuple(len(study.fits[day].time) for day in ("205", "219", "225", "227")),
        seeds=SEEDS,
        size=lambda source: next(row["magnitude"] for row in mission.read_table("errors") if row["source"] == source),
        step_s=STEP_S,
        sums_of=lambda days: {sum(chosen) for count in range(1, 5) for chosen in combinations(days, count)},
        triple=lambda *quantities: np.array([printed_value("yaw", "value", quantity=name) for name in quantities]),
        vector=vector,
    )


def _period_min(config: Scenario) -> float:
    """Of a circular orbit about a point mass."""
    assert config.orbit is not None and config.orbit.altitude_km is not None
    radius_km = config.orbit.altitude_km + EARTH_RADIUS_KM
    return float(2 * np.pi * np.sqrt(radius_km**3 / GM_EARTH_KM3_S2) / 60.0)


def _print_of(parameter: str, data_set: str) -> float:
    """Table 1; only its last column has signs for S."""
    return printed_value("calibration", "value", parameter=parameter, data_set=PAPER_COLUMN[data_set])


def figures(r: Results) -> dict[str, Callable[[], Figure]]:
    """All of them, by the names in `words.md`."""
    study, e, y = r.calibration, r.errors, r.yaw
    printed = np.array([[_print_of(name, data_set) for name in NAMES[:9]] for data_set in DATA_SETS])
    signed = np.array([name == "all" for name in DATA_SETS])
    scatter = calibration_plots.ParameterScatter(
        NAMES[:9], list(DATA_SETS), study.estimates[:, :, :9], study.truth[:9], printed, signed
    )
    sources = list(e.paper_rule)
    budget = calibration_plots.ErrorBudget(
        ["LSB", *sources[1:]], np.array([e.simulated[s] for s in sources]), np.array(list(e.paper_rule.values()))
    )
    node = calibration_plots.NodeMisfit(r.nodes.raan_deg, r.nodes.misfit, r.nodes.chosen_deg, r.nodes.launch_deg)
    day = np.datetime_as_string(geometry.day(geometry.DATA_DAYS[0]), unit="D") + " (day 205)"
    observed = printed_value("errors", "rms_mG", source="observed rms")
    return {
        "table_1_scatter": lambda: calibration_plots.draw_scatter(
            scatter, title="S by data set: simulated, and as printed"
        ),
        "table_2_errors": lambda: calibration_plots.draw_budget(budget, title="Sources of the residual"),
        "node_scan": lambda: calibration_plots.draw_node_misfit(node, title="Which node fits the sun-sensor record"),
        "figure_1": lambda: yaw_plots.draw_mean_bias(
            y.figure_1, title=f"Figure 1, simulated: {day}, mean bias for the orbit"
        ),
        "figure_2": lambda: yaw_plots.draw_full(y.figure_2, title=f"Figure 2, simulated: {day}, full calibration"),
        "yaw_sigma": lambda: yaw_plots.draw_sigma(r.accuracy.figure, title=f"Expected yaw error at {observed:.1f} mG"),
        "yaw_sweep": lambda: yaw_plots.draw_sweep(y.sweep, title="When is yaw = 0 the better estimate?"),
    }


def summary(r: Results, claims: list[Claim]) -> dict[str, Any]:
    """The content of `summary.json`."""
    study, a, y, e = r.calibration, r.accuracy, r.yaw, r.errors
    fits = {
        name: {
            **calibration_summary(fit.calibration),
            "residual_rms_mG": rms_mG(fit),
            "sigma_monte_carlo": dict(zip(NAMES, study.scatter(name).tolist(), strict=True)),
        }
        for name, fit in study.fits.items()
    }
    fits["all"]["errors_in_variables_corrected"] = calibration_summary(study.corrected["all"].calibration)
    fits["all"]["pulls"] = dict(zip(NAMES, pulls(r).tolist(), strict=True))
    return {
        "study": "seasat",
        "seed": r.scenario.seed,
        "calibration": {
            "days": {name: fits[name] for name in ("205", "219", "225", "227")},
            "combined": {"193": fits["193"]},
            "all": fits["all"],
            "sigma": "sigma_S and sigma_b_mG are the regression's own (errors longer than its blocks are not in them); "
            "sigma_monte_carlo is the scatter over many runs, holds all errors, and is what claims are judged by",
        },
        "truth": {"S": study.truth[:9].reshape(3, 3).tolist(), "b_mG": study.truth[9:].tolist()},
        "motion": r.motion.summary(),
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
        "errors_mG": {
            name: {"simulated": e.simulated[name], "paper_rule": rule} for name, rule in e.paper_rule.items()
        },
        "residual_mG": {
            "fit_known": e.fit_known,
            "fit_all": e.fit_all,
            "unknown_for_printed_residual": e.unknown_for_paper,
            "fit_with_that": e.fit_with_that,
        },
        "geometry": {
            "raan_deg": r.nodes.chosen_deg,
            "raan_from_launch_deg": r.nodes.launch_deg,
            "head_azimuth_deg": list(r.heads.azimuth_deg),
            "head_elevation_deg": r.heads.elevation_deg,
            "head_half_fov_deg": r.heads.half_fov_deg,
        },
        "claims": [claim.to_dict() for claim in claims],
    }
