"""Many vehicles together: what adds up, what differs, and what is nothing, from scores that are drawn by their law."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from worlds import TUMBLING, tumbling

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.fleet import Fleet, _apart, fleet
from fluxtwin.gap.linear.projection import explained_in_units
from fluxtwin.gap.records.diagnosis import Diagnosis, EffectParameter, FoundEffect, Score
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario

pytestmark = pytest.mark.closure

LATE, AHEAD = find_effect("time_tag_offset"), find_effect("along_track_error")
SIGMA_S = 0.1


def asked(sections: str) -> Diagnosis:
    return diagnose(simulate(parse_scenario(tumbling(sections)))[0], load_field("igrf14"))


@pytest.fixture(scope="module")
def perfect() -> Diagnosis:
    return asked(TUMBLING)


def vehicle(perfect: Diagnosis, rng: np.random.Generator, late_s: float) -> Diagnosis:
    """A record of which only the scores of two effects are kept: a late clock known to 0.1 s, and an orbit whose image is
    nothing like it."""
    information = np.array([[SIGMA_S**-2]])
    drawn = information @ np.array([late_s]) + rng.normal(size=1) / SIGMA_S
    other = Score("along_track_error", AHEAD, rng.normal(size=1), np.array([[1.0]]))
    both = (Score("time_tag_offset", LATE, drawn, information), other)
    return replace(perfect, scores=(both, both))


def named_as(*group: str) -> FoundEffect:
    where = {"stage": "timing", "axis": None, "frame": None, "condition": None}
    support = {"rivals": (), "probability": 0.97, "significance": 1e-9, "visible_nT": 5.0}
    return FoundEffect(name=group[0], group=group, parameters={}, settings={}, **where, **support)  # type: ignore[arg-type]


def together(perfect: Diagnosis, seed: int, sizes: np.ndarray) -> Fleet:
    rng = np.random.default_rng(seed)
    return fleet([f"v{k}" for k in range(len(sizes))], [vehicle(perfect, rng, size) for size in sizes])


def test_what_no_vehicle_shows_is_plain_in_all(perfect: Diagnosis) -> None:
    """Two sigma in each of twenty: 80 of chi-square together."""
    found = together(perfect, 1, np.full(20, 0.2))
    common = found.common
    assert common is not None and common.group == ("time_tag_offset",) and common.probability > 0.95
    assert common.mean_sigma[0] == pytest.approx(SIGMA_S / np.sqrt(20.0)) and common.spread[0] == 0.0
    assert abs(common.mean[0] - 0.2) < 4.0 * common.mean_sigma[0]
    assert found.faults == () and "of the design: time_tag_offset" in found.lines[0]
    json.dumps(found.to_dict(), allow_nan=False)


def test_nothing_is_said_of_nothing(perfect: Diagnosis) -> None:
    """A common effect is wanted to be six above the penalty, odd ones at 1 % of a fleet: of 300 fleets at most seven."""
    said = [together(perfect, seed, np.zeros(12)) for seed in range(300)]
    assert sum(one.common is not None for one in said) <= 7
    assert sum(bool(one.faults) for one in said) <= 9  # 1 % of 300, and three sigma
    assert any(one.faults for one in (together(perfect, seed, np.zeros(12)) for seed in range(300, 1300)))


def test_the_odd_one_is_found_and_the_spread_measured(perfect: Diagnosis) -> None:
    sizes = np.full(12, 0.3)
    sizes[4] = 1.5
    found = together(perfect, 3, sizes)
    assert [(fault.vehicle, fault.name, fault.odd) for fault in found.faults] == [(4, "time_tag_offset", True)]
    spread = np.random.default_rng(4).normal(1.0, 0.5, 40)
    common = together(perfect, 5, spread).common
    assert (
        common is not None and abs(np.log(common.spread[0] / 0.5)) < 0.4
    )  # of 40: 0.11 in the logarithm, and the error's
    shrunk = np.sqrt(np.mean((common.each[:, 0] - spread) ** 2))
    assert shrunk < SIGMA_S * 1.2 and common.each_sigma[:, 0].mean() == pytest.approx(SIGMA_S, rel=0.1)


def test_a_name_that_one_vehicle_has_for_it_hides_nothing_of_the_others(perfect: Diagnosis) -> None:
    """Each diagnosis takes what it names out of its further scores, under whatever name; the sum needs all of it."""
    rng, fleet_of = np.random.default_rng(6), []
    for number in range(12):
        one = vehicle(perfect, rng, 0.3)
        if number < 4:
            one = replace(
                one, scores=(one.scores[0], one.scores[0][1:]), effects=[named_as("time_tag_offset", "sensor_lag")]
            )
        elif number == 4:
            one = replace(
                one, scores=(one.scores[0], one.scores[0][1:]), effects=[named_as("sensor_lag", "time_tag_offset")]
            )
        fleet_of.append(one)
    found = fleet([f"v{k}" for k in range(12)], fleet_of)
    assert found.common is not None and found.common.name == "time_tag_offset" and found.faults == ()
    assert found.common.mean_sigma[0] == pytest.approx(SIGMA_S / np.sqrt(12.0))


def test_a_fault_of_one_is_not_the_mean_of_all(perfect: Diagnosis) -> None:
    """Ninety sigma in one of three: 2,700 of chi-square together, and all of it in one."""
    rng, fault = np.random.default_rng(7), named_as("time_tag_offset")
    odd = vehicle(perfect, rng, 9.0)
    odd = replace(odd, scores=(odd.scores[0], odd.scores[0][1:]), effects=[fault])
    found = fleet(["a", "b", "c"], [vehicle(perfect, rng, 0.0), odd, vehicle(perfect, rng, 0.0)])
    assert found.common is None and [(one.vehicle, one.name) for one in found.faults] == [(1, "time_tag_offset")]
    chance = replace(odd, effects=[replace(fault, significance=0.5 * 0.01 / 3 * 1.01)], scores=perfect.scores)
    assert fleet(["a", "b", "c"], [perfect, chance, perfect]).faults == ()


def test_sizes_that_vary_as_their_noise_cost_no_power(perfect: Diagnosis) -> None:
    """Cochran's Q is 15.9 with 11 degrees of freedom, exceeded by chance in one of seven: chi-square is 13.2, not 9.2."""
    fleet_of = []
    for number in range(12):
        pull = 1.05 + (1.15 if number % 2 else -1.15)
        late = Score("time_tag_offset", LATE, np.array([pull / SIGMA_S]), np.array([[SIGMA_S**-2]]))
        other = Score("along_track_error", AHEAD, np.zeros(1), np.array([[1.0]]))
        fleet_of.append(replace(perfect, scores=((late, other), (late, other))))
    found = fleet([f"v{k}" for k in range(12)], fleet_of)
    assert found.common is not None and found.common.name == "time_tag_offset" and found.common.spread[0] == 0.0


def test_each_is_apart_from_the_mean_of_the_others_in_sigmas_of_their_scatter() -> None:
    """Four sizes of one sigma: the difference's variance is 1 + 1/3, and that of the three others by their own mean."""
    sizes = np.array([4.0, 6.0, -6.0, 1.0])
    scores = [
        Score("time_tag_offset", LATE, np.array([x / SIGMA_S**2]), np.array([[SIGMA_S**-2]])) for x in SIGMA_S * sizes
    ]
    others = [np.delete(sizes, k) for k in range(4)]
    assert all(chi2.sf(2.0 * one.var(ddof=1), 2) < 0.01 for one in others), "more than chance, whichever is left out"
    expected = [(x - one.mean()) ** 2 / (4.0 / 3.0) / one.var(ddof=1) for x, one in zip(sizes, others, strict=True)]
    assert [apart for apart, _ in _apart(scores)] == pytest.approx(expected, rel=1e-9)


def test_scores_are_those_of_least_squares(perfect: Diagnosis) -> None:
    """Of a record with a late clock: the estimate of its score alone is that of the diagnosis, within what is not linear."""
    found = asked(TUMBLING + "[effects.time_tag_offset]\noffset_s = 0.4\n")
    assert [one.name for one in found.effects] == ["time_tag_offset"]
    score = next(one for one in found.scores[0] if one.label == "time_tag_offset(course=constant)")
    value = found.effects[0].parameters["offset"]
    assert value.sigma is not None
    assert abs(score.score[0] / score.information[0, 0] - value.value) < 0.5 * value.sigma
    assert score.information[0, 0] ** -0.5 == pytest.approx(value.sigma, rel=0.1)
    assert "time_tag_offset" not in {one.label for one in found.scores[1]}
    has = replace(perfect, effects=[replace(found.effects[0], name="yaw_drift", group=("yaw_drift",))])
    faults = fleet(["a", "b", "c", "d"], [has, has, perfect, perfect]).faults  # two of four: most others have it not
    assert [(fault.vehicle, fault.name) for fault in faults] == [(0, "yaw_drift"), (1, "yaw_drift")]
    assert {one.label for one in perfect.scores[0]} >= {
        "time_tag_offset(course=constant)",
        "along_track_error(course=constant)",
    }


def test_what_scores_explain_does_not_hang_on_units() -> None:
    information, score = np.diag([1e6, 1e-9]), np.array([2e3, 3e-5 * np.sqrt(1e-1)])
    drop, rank = explained_in_units(information, score)
    assert (drop, rank) == (pytest.approx(4.0 + 0.09), 2)


def test_two_vehicles_are_no_fleet(perfect: Diagnosis) -> None:
    with pytest.raises(BadInput, match="2 vehicles"):
        fleet(["a", "b"], [perfect, perfect])
    three = fleet(["a", "b", "<c>"], [perfect] * 3)
    assert three.vehicles == ("a", "b", "<c>")
    assert "No vehicle stands out" in three.report() and "No vehicle stands out" in three._repr_html_()


def fitted(one: Diagnosis, late_s: float) -> Diagnosis:
    """With the effect named by the vehicle itself, at a size that is known to 0.1 s."""
    size = EffectParameter(late_s, SIGMA_S, "s")
    cause = replace(
        named_as("time_tag_offset"), parameters={"offset": size}, effect=LATE, covariance=np.array([[SIGMA_S**2]])
    )
    return replace(one, effects=(cause,))


def test_a_large_effect_has_the_size_that_each_vehicle_has_fitted(perfect: Diagnosis) -> None:
    """A step from nothing is off by 5 % of an effect of a hundred sigma: five sigma."""
    rng, sizes = np.random.default_rng(8), np.full(4, 10.0)
    vehicles = [fitted(vehicle(perfect, rng, 1.05 * size), size + rng.normal() * SIGMA_S) for size in sizes]
    found = fleet([f"v{k}" for k in range(4)], vehicles)
    assert found.common is not None and found.common.name == "time_tag_offset"
    assert abs(found.common.mean[0] - 10.0) < 4.0 * found.common.mean_sigma[0]
    assert found.common.spread[0] == 0.0
    assert found.faults == ()


def test_a_vehicle_that_lacks_what_the_others_share_is_not_counted_among_them(perfect: Diagnosis) -> None:
    rng = np.random.default_rng(9)
    vehicles = [fitted(vehicle(perfect, rng, 10.0), 10.0 + rng.normal() * SIGMA_S) for _ in range(7)]
    found = fleet([f"v{k}" for k in range(8)], [*vehicles, replace(vehicle(perfect, rng, 0.0), effects=())])
    assert found.common is not None
    assert abs(found.common.mean[0] - 10.0) < 4.0 * found.common.mean_sigma[0]
    assert found.lines[0].startswith("Common to 7 of the 8 vehicles")
    assert found.lines[-1].startswith("v7: time_tag_offset") and found.lines[-1].endswith("does not show it.")
