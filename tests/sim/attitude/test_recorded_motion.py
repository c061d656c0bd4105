"""The motion between stamps comes from attitudes that have errors: what that does to causes that live between stamps.

The seeds are the first that were tried.
"""

from __future__ import annotations

import numpy as np
import pytest
from worlds import COARSE_MAGNETOMETER, scenario_text

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import Budget, pose
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

FAST = """yaw_rms_deg = 4.0
roll_rms_deg = 4.0
pitch_rms_deg = 4.0
shortest_period_min = 10.0
longest_period_min = 10.0"""
SPIN = 'mode = "spin"\nspin_axis_N = [0.36, 0.48, 0.8]\nspin_rate_rpm = 1.6\nnutation_deg = 3.0'


def flown(
    attitude: str,
    *,
    seed: int,
    effects: str = "",
    samples: int = 500,
    step_s: float = 30.0,
    tau_s: float = 150.0,
    sigma_deg: float = 0.12,
) -> Telemetry:
    """Telemetry of a scenario."""
    reference = f"[attitude.reference]\nsigma_deg = {sigma_deg}\ntau_s = {tau_s}\n"
    text = scenario_text(
        f"[attitude]\n{attitude}\n{reference}{COARSE_MAGNETOMETER}{effects}\n",
        seed=seed,
        inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
        segment=f"samples = {samples}, step_s = {step_s}",
    )
    return simulate(parse_scenario(text))[0]


def diagnosed(telemetry: Telemetry, frozen: list[Active] | None = None) -> Diagnosis:
    budget = Budget(100.0, 100.0, np.radians(0.12), None)
    return diagnose(telemetry, load_field("igrf14"), budget=budget, frozen=frozen or [])


@pytest.mark.parametrize(("offset_s", "tau_s"), [(15.0, 150.0), (100.0, 0.0)])
def test_a_time_tag_of_a_fast_libration_is_found_and_closes(offset_s: float, tau_s: float) -> None:
    """Half a spacing and more than three: within three sigma, and with the true one in the scenario nothing is left.

    A rate of a straight line through nine attitudes is 5 % low here, which makes 15 s into 15.8 s.
    """
    effects = f"[effects.time_tag_offset]\noffset_s = {offset_s}"
    telemetry = flown(FAST, seed=1, effects=effects, tau_s=tau_s)
    found = diagnosed(telemetry)
    assert [entry.name for entry in found.effects] == ["time_tag_offset"]
    value = found.effects[0].parameters["offset"]
    assert value.sigma is not None
    assert value.sigma < 0.005 * offset_s + 0.3
    assert abs(value.value - offset_s) < 3.0 * value.sigma
    loop = diagnosed(telemetry, [(find_effect("time_tag_offset"), np.array([offset_s]))])
    assert loop.verdict == "no_gap"


def test_white_attitude_errors_in_a_spin_are_no_cause() -> None:
    """Offset and lag that nearly cancel would average the errors of neighbouring attitudes, if the prediction used them.

    Of the first ten seeds this is the one whose answer was `unknown`, and resembled the two, when it did.
    """
    telemetry = flown(SPIN, seed=4, samples=700, step_s=1.5, tau_s=0.0)
    found = diagnosed(telemetry)
    assert found.verdict == "no_gap", found.sentence


@pytest.mark.parametrize(
    ("name", "theta", "most"),
    [("sensor_lag", [1.5], 0.15), ("hysteresis", [300.0, 300.0, 300.0], 0.03), ("time_tag_offset", [1.5], 0.15)],
)
def test_what_looks_back_does_not_see_the_errors_of_the_rows_before(name: str, theta: list[float], most: float) -> None:
    """What attitude errors add to an effect's image is no image of the errors themselves.

    The change by errors theta of all rows, along theta x B: 1.0 is the baseline's own. A low-pass over recorded
    attitudes gives -0.6 at a lag of one spacing, a loop of hysteresis over them -0.05.
    """
    bare, perturbed = (flown(SPIN, seed=5, samples=700, step_s=1.5, tau_s=0.0, sigma_deg=s) for s in (0.0, 0.12))
    predicted = []
    for telemetry in (bare, perturbed):
        problem = pose(telemetry, load_field("igrf14"))
        active = [(find_effect(name), np.array(theta))]
        predicted.append((problem.chain.reading_nT(), problem.chain.reading_nT(active)))
    own = predicted[1][0] - predicted[0][0]
    added = (predicted[1][1] - predicted[0][1]) - own
    inside = slice(20, -20)
    assert np.sqrt(np.mean(own**2)) > 30.0
    share = float(np.sum(added[inside] * own[inside]) / np.sum(own[inside] ** 2))
    assert abs(share) < most
