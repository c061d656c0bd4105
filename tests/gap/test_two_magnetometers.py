"""A second magnetometer separates what both share (clock, orbit, field, attitude) from what one of them has.

The witness is the simulator: effects of the sensor reach the first alone, those of clock and orbit both. The names are
ones that a nadir-pointing record confuses: a lag of the sensor and a position ahead of the true one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from worlds import scenario_text

import fluxtwin
from fluxtwin.diagnosis_page import diagnosis_page
from fluxtwin.gap.channels.two_magnetometers import apart
from fluxtwin.gap.detectors.random_walk import worth_of_a_walk
from fluxtwin.gap.posterior.where import where
from fluxtwin.gap.problem.problem import pose
from fluxtwin.gap.records.diagnosis import Place
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = [pytest.mark.closure, pytest.mark.usefixtures("lawless")]
NOISE_NT, LSB_NT = 20.0, 10.0
SECOND = {"b_nT": [-4000.0, 2500.0, 900.0], "noise_nT": NOISE_NT, "lsb_nT": LSB_NT, "spacecraft_field_factor": 0.3}
WANDERING = {"kind": "gauss_markov", "rms_nT": 60.0, "tau_s": 900.0}
FIRST = {"b_nT": [1500.0, -800.0, 300.0], "noise_nT": NOISE_NT, "lsb_nT": LSB_NT}
SEGMENT = {"start_utc": "2026-03-01T00:00:00Z", "duration_min": 300.0}
SHARED, OWN = {"time", "orbit", "field", "attitude"}, {"sensor", "spacecraft"}


def flown(step_s: float = 40.0, **changes: Any) -> Telemetry:
    scenario = fluxtwin.load_scenario("cubesat")
    everything: dict[str, Any] = {"seed": 5, "torquers": None, "magnetometer": FIRST, "magnetometer_2": SECOND}
    everything["schedule.segments"] = [SEGMENT | {"step_s": step_s}]
    return fluxtwin.simulate(scenario.updated(everything | changes))[0]


@pytest.fixture(scope="module")
def ahead() -> Telemetry:
    return flown(effects={"along_track_error": {"ahead_km": 40.0}})


def test_what_both_share_is_no_fault_of_the_sensor(ahead: Telemetry) -> None:
    alone, both = fluxtwin.diagnose(ahead.replace(mag2_B_nT=None)), fluxtwin.diagnose(ahead)
    assert "sensor_lag" in alone.effects[0].group
    assert "along_track_error" in both.effects[0].group
    assert "sensor_lag" not in both.effects[0].group
    assert both.untestable["sensor_lag"].endswith("the difference between the two magnetometers does not show it")
    assert "sensor_lag" not in both.would_settle
    assert sum(both.where.probabilities["stage"][name] for name in OWN) < 0.05
    assert set(both.where.equivalent) <= SHARED


@pytest.fixture(scope="module")
def late() -> Telemetry:
    return flown(20.0, effects={"sensor_lag": {"lag_s": 2.0}})


def test_a_fault_of_the_sensor_is_nothing_that_both_share(late: Telemetry) -> None:
    alone, both = fluxtwin.diagnose(late.replace(mag2_B_nT=None)), fluxtwin.diagnose(late)
    assert {"along_track_error", "time_tag_offset"} <= set(alone.effects[0].group)
    assert both.effects[0].group == ("sensor_lag",)
    assert both.where.stage == "sensor"
    assert sum(both.where.probabilities["stage"][name] for name in SHARED) < 0.05
    assert any("time_tag_offset" in note and "ruled out" in note for note in both.notes)


def test_a_response_of_many_parameters_is_not_denied_for_what_readings_cannot_fit() -> None:
    bent = flown(effects={"cubic_nonlinearity": {"c_z_xxz_nT": 400.0}})
    found = fluxtwin.diagnose(bent)
    assert [one.name for one in found.effects] == ["cubic_nonlinearity"]


def test_what_nothing_explains_lies_where_one_magnetometer_alone_has_it() -> None:
    found = fluxtwin.diagnose(flown(magnetometer=FIRST | {"unknown": WANDERING | {"tau_s": 200.0}}))
    assert found.verdict == "unknown"
    assert found.where.stage in OWN
    assert set(found.where.equivalent) <= OWN


def test_the_second_s_own_disturbance_is_said_and_is_no_gap_of_the_first() -> None:
    found = fluxtwin.diagnose(flown(magnetometer_2=SECOND | {"unknown": WANDERING}))
    assert found.verdict == "no_gap"
    assert "The two magnetometers differ" in found.sentence
    assert "magnetometer=2" in found.sentence
    assert "--magnetometer 2" in diagnosis_page(found, "t").next_step


def test_a_difference_is_said_beside_a_cause_that_both_share() -> None:
    """A spinner without attitude: a lag hardly changes the size of the field, and 2 km along the orbit do as much."""
    text = scenario_text(
        "[attitude]\nmode = 'tumble'\nrate_deg_s = [0.5, 0.3, 12.0]\n[magnetometer]\nnoise_nT = 20.0\nlsb_nT = 10.0\n"
        "[magnetometer_2]\nnoise_nT = 20.0\nlsb_nT = 10.0\n[effects.sensor_lag]\nlag_s = 0.3\n",
        seed=4,
        inertia_kg_m2=[[0.08, 0.0, 0.0], [0.0, 0.08, 0.0], [0.0, 0.0, 0.09]],
        segment="duration_min = 150.0, step_s = 10.0",
    )
    found = fluxtwin.diagnose(fluxtwin.simulate(parse_scenario(text))[0].replace(q_NB=None))
    assert found.effects and not {find_effect(name).stage for name in found.effects[0].group} & OWN
    assert "The two magnetometers differ" in found.sentence


def test_a_step_that_both_have_is_not_the_sensor_s(monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[Place] = []  # of the first look too, in which the difference alone denies the sensor

    def seen(*given: Any, **named: Any) -> Place:
        places.append(where(*given, **named))
        return places[-1]

    monkeypatch.setattr("fluxtwin.gap.diagnose.where", seen)
    good = flown()
    step_nT = np.where(np.arange(len(good))[:, None] < len(good) // 2, 0.0, [120.0, -60.0, 30.0])
    found = fluxtwin.diagnose(good.replace(mag_B_nT=good.mag_B_nT + step_nT, mag2_B_nT=good.mag2_B_nT + step_nT))
    assert found.verdict != "no_gap"
    assert found.where.stage != "sensor" and "sensor" not in found.where.equivalent
    assert places and not any("sensor" in (place.stage, *place.equivalent) for place in places)


@pytest.mark.parametrize("number", [1, 2])
def test_a_step_that_the_other_alone_has_is_called_a_step(number: int) -> None:
    """At the middle row of 451, to a row: 225 rows of 40 s."""
    good = flown()
    step_nT = np.where(np.arange(len(good))[:, None] < 225, 0.0, [150.0, -100.0, 80.0])
    name = {1: "mag2_B_nT", 2: "mag_B_nT"}[number]
    stepped = good.replace(**{name: getattr(good, name) + step_nT})
    found = fluxtwin.diagnose(stepped, magnetometer=number)
    assert found.verdict == "no_gap"
    assert "a step 9000 s after the first sample" in found.sentence
    assert f"To diagnose the other one, add magnetometer={3 - number}." in found.sentence


def test_two_good_magnetometers_differ_by_the_noise_of_both() -> None:
    good = flown()
    found = fluxtwin.diagnose(good)
    assert found.verdict == "no_gap"
    assert "differ" not in found.sentence
    expected_nT = np.sqrt(2.0 * (NOISE_NT**2 + LSB_NT**2 / 12.0))
    spread_nT = expected_nT / np.sqrt(2.0 * 3.0 * len(good))  # 1 sigma of a standard deviation
    assert abs(found.provenance["two_magnetometers"]["apart_nT"] - expected_nT) < 4.0 * spread_nT


def test_a_second_magnetometer_that_hardly_reads_says_nothing(ahead: Telemetry) -> None:
    second = np.array(ahead.mag2_B_nT)
    second[40:] = np.nan
    assert apart(pose(ahead.replace(mag2_B_nT=second), load_field("igrf14"))) is None
    assert apart(pose(ahead.replace(mag2_B_nT=None), load_field("igrf14"))) is None
    assert apart(pose(ahead, load_field("igrf14"))) is not None


def test_a_second_magnetometer_that_is_none_is_left_out_and_said(late: Telemetry) -> None:
    few = late.select(slice(0, 360))
    first, second = np.array(few.mag_B_nT), np.array(few.mag2_B_nT)
    rounded = (first / 7.0).astype(np.float32) * 7.0 + 100.0
    for none in (np.full_like(second, 123.0), second * [1.0, 1.0, 0.0], first, rounded):
        assert apart(pose(few.replace(mag2_B_nT=none), load_field("igrf14"))) is None
    alone, found = (fluxtwin.diagnose(few.replace(mag2_B_nT=other)) for other in (None, first))
    assert found.sentence == alone.sentence
    assert found.where == alone.where
    assert any("second magnetometer is not used" in note for note in found.notes)
    assert not any("second magnetometer" in note for note in alone.notes)


@pytest.mark.parametrize("step_nT", [30.0, 100.0])
def test_a_coarser_copy_counts_as_one_magnetometer(late: Telemetry, step_nT: float) -> None:
    """The noise of the first is in the difference from an independent second, and not in that from a copy."""
    coarse = step_nT * np.rint((late.mag_B_nT + 150.0) / step_nT)
    noisy = late.mag_B_nT + step_nT * np.random.default_rng(1).standard_normal(late.mag_B_nT.shape)
    for copy in (coarse, noisy):
        assert apart(pose(late.replace(mag2_B_nT=copy), load_field("igrf14"))) is None
        assert apart(pose(late.replace(mag_B_nT=copy, mag2_B_nT=late.mag_B_nT), load_field("igrf14"))) is None
    for noise_nT in (1.0, 20.0, 300.0):
        own = flown(20.0, magnetometer_2=SECOND | {"noise_nT": noise_nT, "lsb_nT": step_nT})
        assert apart(pose(own, load_field("igrf14"))) is not None


def test_stages_of_the_names_that_are_left_are_equivalent(late: Telemetry) -> None:
    found = fluxtwin.diagnose(late.replace(q_NB=None).select(slice(None, None, 2)))
    stages = {find_effect(name).stage for name in found.effects[0].group}
    assert len(stages) > 1 and stages <= {found.where.stage, *found.where.equivalent}


def test_the_second_s_axes_may_be_turned(late: Telemetry) -> None:
    """The difference is in the first one's axes: what is its own is in it as it stands."""
    third_of_a_turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    straight, turned = (
        apart(pose(late.replace(mag2_B_nT=second), load_field("igrf14")))
        for second in (np.array(late.mag2_B_nT), np.array(late.mag2_B_nT) @ third_of_a_turn)
    )
    assert straight is not None and turned is not None
    np.testing.assert_allclose(turned.left.residual, straight.left.residual, rtol=0.0, atol=0.1)  # of unit variance


def test_a_difference_that_is_no_slower_than_noise_is_not_compared_with_it() -> None:
    good = flown()
    every_third = np.repeat(np.array(good.mag2_B_nT)[::3], 3, axis=0)[: len(good)]
    said = fluxtwin.diagnose(good.replace(mag2_B_nT=every_third)).sentence
    assert "The two magnetometers differ" in said and "with structure that noise does not have" in said


def test_a_walk_is_in_the_difference_or_is_none() -> None:
    rate = 3.0  # nT a root second: 400 nT after five hours

    def worth(record: Telemetry) -> float:
        problem = pose(record, load_field("igrf14"))
        difference = apart(problem)
        assert difference is not None
        return worth_of_a_walk(problem.setting.seconds, difference.left, rate)

    assert worth(flown(effects={"bias_random_walk": {"rate_nT_per_sqrt_s": rate}})) > 100.0
    assert worth(flown()) < -100.0
