"""The rival of the withheld-effect benchmark: it finds what is plain to see, and is as often wrong as BIC allows."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from withheld_cases import of_place, of_sensor, rival
from withheld_cases.chain import Truth, fly
from withheld_cases.worlds import OPTIONAL, World, draw_world

from fluxtwin.gap.problem.problem import Budget
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

pytestmark = pytest.mark.property

BIC = rival.BIC


def flight(regime: str = "slews") -> World:
    """A flight of four hundred rows with every column recorded."""
    world = draw_world(np.random.default_rng(3), regime)
    world = dataclasses.replace(world, time=world.time[:400], missing=np.zeros(400, dtype=bool))
    return dataclasses.replace(world, recorded=frozenset(OPTIONAL))


def declared(world: World) -> dict[str, float]:
    """What a user would declare."""
    budget = world.budget
    return {
        "noise_nT": budget.noise_nT,
        "lsb_nT": budget.lsb_nT,
        "attitude_sigma_deg": float(np.degrees(budget.attitude_sigma_rad)),
    }


def independent(rng: np.random.Generator, ranks: list[int], samples: int, signal: float = 0.0) -> rival.Regression:
    """White noise of unit variance and orthogonal candidates, the first one with a signal of that many sigma."""
    score = rng.standard_normal(sum(ranks))
    score[0] += signal
    rest = float(rng.chisquare(samples - score.size))
    owner = np.repeat(np.arange(len(ranks)), ranks)
    names = tuple(f"effect {k}" for k in range(len(ranks)))
    return rival.Regression(names, np.eye(score.size), score, owner, float(score @ score) + rest, samples, 1e-6)


@pytest.mark.parametrize("name", ["cubic_nonlinearity", "time_tag_offset"])
def test_an_obvious_single_is_found(name: str, tmp_path: Path) -> None:
    world = flight()
    maker = {"cubic_nonlinearity": of_sensor.cubic_nonlinearity, "time_tag_offset": of_place.time_tag_offset}[name]
    draft = maker(world, np.random.default_rng(11))
    assert draft is not None
    truth: Truth = draft.at(draft.start * 20.0)
    write_telemetry(fly(draft.world, [truth]), tmp_path / "flight.csv")
    found = rival.answer(tmp_path / "flight.csv", **declared(draft.world))
    assert sorted(found) == ["BIC", "EBIC"]
    for groups in found.values():
        assert groups and name in groups[0], "the first, or in its group"
        assert all(len(group) <= 3 for group in groups)


def test_a_plain_null_is_white_and_alarms_no_more_often_than_bic_allows() -> None:
    world = flight()
    said = declared(world)
    budget = Budget(said["noise_nT"], said["lsb_nT"], float(np.radians(said["attitude_sigma_deg"])))
    found = rival.regression(fly(world, ()), budget=budget)
    spread = np.sqrt(2.0 / found.samples)
    assert found.chi2 / found.samples == pytest.approx(1.0, abs=4.0 * spread), "whitened to unit variance"
    # The same design under white noise drawn afresh: the first step alarms when any candidate's drop passes its price.
    rng, runs = np.random.default_rng(21), 200
    values, vectors = np.linalg.eigh(found.gram)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    price = [rank * np.log(found.samples) for rank in np.bincount(found.owner) if rank]
    most = sum(float(chi2.sf(one, one / np.log(found.samples))) for one in price)  # Bonferroni
    drawn = [dataclasses.replace(found, score=root @ rng.standard_normal(values.size)) for _ in range(runs)]
    alarms = sum(bool(rival.stepwise(dataclasses.replace(one, chi2=float(found.samples)), BIC)) for one in drawn)
    assert alarms / runs <= most + 3.0 * np.sqrt(most * (1.0 - min(most, 0.99)) / runs)
    assert most < 0.6, "else the bound says little"


def test_false_alarms_are_as_frequent_as_bic_has_them() -> None:
    rng, ranks, samples, runs = np.random.default_rng(8), [1] * 12 + [3] * 6, 1200, 1000
    alarms = sum(bool(rival.stepwise(independent(rng, ranks, samples), BIC)) for _ in range(runs))
    quiet = np.prod([chi2.cdf(rank * np.log(samples), rank) for rank in ranks])
    wanted = 1.0 - float(quiet)  # independent candidates: each goes in when its own drop exceeds rank log n
    assert alarms / runs == pytest.approx(wanted, abs=4.0 * np.sqrt(wanted * (1.0 - wanted) / runs))


def test_the_extended_criterion_is_wrong_less_often_and_still_sees() -> None:
    rng, ranks = np.random.default_rng(9), [1] * 30
    nulls = [independent(rng, ranks, 1200) for _ in range(300)]
    extended = dataclasses.replace(BIC, gamma=1.0)
    plain, strict = (sum(bool(rival.stepwise(one, c)) for one in nulls) for c in (BIC, extended))
    assert strict < 0.1 * plain + 5
    assert rival.stepwise(independent(rng, ranks, 1200, signal=12.0), extended) == ["effect 0"]


def test_a_wrong_first_pick_goes_out_again_and_alternatives_are_one_name() -> None:
    # The third column is nearly the sum of the other two, which are the truth.
    columns = np.array([[1.0, 0.0, np.sqrt(0.49)], [0.0, 1.0, np.sqrt(0.49)], [0.0, 0.0, np.sqrt(0.02)]])
    score = columns.T @ np.array([300.0, 300.0, 0.0])
    total = float(300.0**2 * 2 + 1200)
    both = rival.Regression(("a", "b", "c"), columns.T @ columns, score, np.arange(3), total, 1200, 1e-6)
    assert sorted(rival.stepwise(both)) == ["a", "b"], "c was first"
    alike = dataclasses.replace(both, names=("a", "b", "c"), score=columns.T @ np.array([300.0, 0.0, 0.0]))
    for names in (("a", "b", "c"), ("a", "a", "c"), ("a", "b", "a")):
        assert rival.stepwise(dataclasses.replace(alike, names=names)) == ["a"]


def test_the_rival_has_groups_too() -> None:
    # The second imitates all of the first, the third 0.9 of it; the fourth is something else.
    columns = np.array([[1.0, 1.0, np.sqrt(0.9), 0.0], [0.0, 0.0, np.sqrt(0.1), 0.0], [0.0, 0.0, 0.0, 1.0]])
    score = columns.T @ np.array([100.0, 0.0, 0.0])
    names = ("a", "b", "c", "d")
    found = rival.Regression(names, columns.T @ columns, score, np.arange(4), 100.0**2 + 1200, 1200, 1e-6)
    assert rival.grouped(found, BIC) == [["a", "b"]]
    faint = dataclasses.replace(found, score=score / 20.0, chi2=25.0 + 1200.0)
    assert set(rival.grouped(faint, BIC)[0]) == {"a", "b", "c"}, "too faint to tell the third apart"
