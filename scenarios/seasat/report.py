"""What the study of Seasat says: its words and claims with the numbers they need, its figures, its summary."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.calibration_records import NAMES, calibration_summary, rms_mG, vector
from fluxtwin.scenarios.claims import Claim
from fluxtwin.scenarios.flights import day
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.report import Report, matrix, plus_minus
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.check_day import SEEDS
from fluxtwin.scenarios.seasat.mission import DATA_SETS, PAPER_COLUMN, printed_value
from fluxtwin.scenarios.seasat.yaw_study import STEP_S
from fluxtwin.scenarios.yaw_comparison import NEAR_NODE_DEG
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2
from fluxtwin.sim.scenario.scenario import Scenario


def pulls(r: Numbers) -> FloatArray:
    """(12,) (estimate - truth) / sigma of the base of 325 samples; sigma is the scatter of the Monte Carlo."""
    return np.asarray((vector(r.calibration.fits["all"]) - r.calibration.truth) / r.calibration.scatter("all"))


def judge_claims(r: Numbers) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without words."""
    return words().judge(mission.PRINTED, r=r)


@cache
def words() -> Report:
    """The sections of `words.md`."""
    return Report(
        "fluxtwin.scenarios.seasat",
        calibration_summary=calibration_summary,
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
        some=lambda parts, *names: {name: parts[name] for name in names},
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


def figures(r: Numbers) -> dict[str, Callable[[], Figure]]:
    """All of them, by the names in `words.md`."""
    study, e, y = r.calibration, r.errors, r.yaw
    sources = list(e.paper_rule)
    date = np.datetime_as_string(day(geometry.DATA_DAYS[0]), unit="D") + " (day 205)"
    observed = printed_value("errors", "rms_mG", source="observed rms")
    return {
        "table_1_scatter": partial(
            calibration_plots.draw_scatter,
            names=NAMES[:9],
            data_sets=list(DATA_SETS),
            estimates=study.estimates[:, :, :9],
            truth=study.truth[:9],
            printed=np.array([[_print_of(name, data_set) for name in NAMES[:9]] for data_set in DATA_SETS]),
            signed=np.array([name == "all" for name in DATA_SETS]),
            title="S by data set: simulated, and as printed",
        ),
        "table_2_errors": partial(
            calibration_plots.draw_budget,
            sources=["LSB", *sources[1:]],
            simulated_mG=np.array([e.simulated[source] for source in sources]),
            paper_rule_mG=np.array(list(e.paper_rule.values())),
            title="Sources of the residual",
        ),
        "node_scan": partial(
            calibration_plots.draw_node_misfit,
            raan_deg=r.nodes.raan_deg,
            misfit=r.nodes.misfit,
            chosen_deg=r.nodes.chosen_deg,
            witness_deg=r.nodes.launch_deg,
            title="Which node fits the sun-sensor record",
        ),
        "figure_1": lambda: yaw_plots.draw_mean_bias(
            y.figure_1, title=f"Figure 1, simulated: {date}, mean bias for the orbit"
        ),
        "figure_2": lambda: yaw_plots.draw_full(y.figure_2, title=f"Figure 2, simulated: {date}, full calibration"),
        "yaw_sigma": lambda: yaw_plots.draw_sigma(r.accuracy.figure, title=f"Expected yaw error at {observed:.1f} mG"),
        "yaw_sweep": lambda: yaw_plots.draw_sweep(y.sweep, title="When is yaw = 0 the better estimate?"),
    }


def summary(r: Numbers, claims: list[Claim]) -> dict[str, Any]:
    """The content of `summary.json`."""
    return {**words().summary(r=r), "claims": [claim.to_dict() for claim in claims]}
