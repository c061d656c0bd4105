"""The next experiment: the power of a manoeuvre, the limits that it keeps, and the choice between manoeuvres."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from worlds import PARTS, scenario_text

from fluxtwin.gap.planning import power
from fluxtwin.gap.planning.designs import Design, LimitsSection, base_tree, designs
from fluxtwin.gap.planning.power import Cause, Flown, probability_of
from fluxtwin.gap.planning.questions import Open, _answers, _rank, ambiguous, apart, choose, signal, to_place, typical
from fluxtwin.gap.records.plan import Course, Plan, Question
from fluxtwin.gap.selection.score import board
from fluxtwin.plan_page import answers_table, plan_table
from fluxtwin.planning import View, sentence
from fluxtwin.sim.base.toml_input import validate
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError, TimeTagOffset
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.world import ephemeris
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

SECTIONS = """
[attitude]
yaw_rms_deg = 1.0
[attitude.reference]
sigma_deg = 0.05
tau_s = 100.0
[magnetometer]
noise_nT = 50.0
lsb_nT = 10.0
"""
START = np.datetime64("2020-03-02T00:00:00", "ns")


@pytest.fixture(scope="module")
def base() -> Scenario:
    return parse_scenario(scenario_text(SECTIONS + PARTS, seed=4, segment="duration_min = 100.0, step_s = 20.0"))


@pytest.mark.reference
@pytest.mark.parametrize("share", [0.0, 0.5, 0.8])
def test_power_of_two_lone_columns_is_that_of_the_bivariate_normal(
    monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """Two candidates with one column each, that share `share` of their energy, and a signal of length 8 along the first. The
    drops are squares of two normal deviates with that correlation; the second is outside the group of the first where it
    loses by more than 2 log 19, and the first passes the gate where its two-sided p-value is below 0.001."""
    cosine = np.sqrt(share)
    white = np.zeros((40, 3, 2))
    white[0, 0] = [1.0, cosine]
    white[1, 1] = [0.0, np.sqrt(1.0 - share)]
    one = [SimpleNamespace(name=name, live=np.ones(1, dtype=bool), label=name) for name in "ab"]
    signal = np.zeros((40, 3))
    signal[0, 0] = 8.0
    scored = board(one, white, signal, np.zeros((40, 3, 0)), 120)  # type: ignore[arg-type]
    monkeypatch.setattr(power, "_DRAWS", 100_000)
    found = probability_of("a", ["b"], scored)
    # By quadrature: x along the first, y across it.
    x, y = np.meshgrid(np.linspace(0.0, 14.0, 1401), np.linspace(-6.0, 6.0, 1201), indexing="ij")
    own, other = x**2, (cosine * x + np.sqrt(1.0 - share) * y) ** 2
    named = (own - other) / (1.0 + 0.0015 * own) > 2.0 * np.log(19.0)
    wanted = np.sum(norm.pdf(x - 8.0) * norm.pdf(y) * (named & (x > norm.isf(0.0005)))) * 0.01 * 0.01
    # Four sigma of a share among 100,000 draws are 0.005 at 0.81; penalties, alike for both, move it by less than 0.002.
    assert abs(found - wanted) < 0.007
    assert abs(probability_of("b", ["a"], scored)) < 0.05
    dead = SimpleNamespace(name="c", live=np.ones(1, dtype=bool), label="c")  # of no rank: it counts for nothing
    more = np.concatenate([white, np.zeros((40, 3, 1))], axis=2)
    signal[0, 0] = 4.0
    boards = (
        board(each, columns, signal, np.zeros((40, 3, 0)), 120)  # type: ignore[arg-type]
        for each, columns in ((one, white), ([*one, dead], more))
    )
    alone, beside = (probability_of("a", ["b"], each) for each in boards)
    assert alone == beside


def test_designs_keep_the_limits(base: Scenario) -> None:
    """Rate and tilt of what is really flown, and that larger limits are made use of."""

    def worst(**limits: object) -> tuple[float, float]:
        rates, tilts = [], []
        for design in designs(base, LimitsSection.model_validate(limits), 1.0, 20.0, START):
            _, truth = simulate(design.scenario)
            rates.append(np.degrees(np.linalg.norm(truth.rate_B_rad_s, axis=1)).max())
            nadir_B = frames.rotation_from_q(truth.q_NB).apply(-truth.r_N_km)
            tilts.append(np.degrees(np.arccos(nadir_B[:, 2] / np.linalg.norm(nadir_B, axis=1))).max())
        return max(rates), max(tilts)

    rate, tilt = worst(max_rate_deg_s=0.2, max_off_nadir_deg=25.0)
    # The body turns with the orbit by 0.061 deg/s besides; a nutating body of other moments turns some percent faster.
    assert 0.15 < rate < 0.2 + 0.07 and 24.0 < tilt < 25.5
    rate, tilt = worst(max_rate_deg_s=0.4)
    assert 0.3 < rate < 0.47 and tilt > 90.0


def test_tests_and_seasons_are_flown_only_where_allowed(base: Scenario) -> None:
    everything = designs(base, LimitsSection(), 1.0, 20.0, START)
    assert any(one.tests for one in everything) and {one.wait_days for one in everything} == {0.0, 90.0}
    few = LimitsSection(torquer_test=False, load_test=False, wait_days=(), attitudes=("nadir", "spin"))
    plain = designs(base, few, 1.0, 20.0, START)
    assert [one.kind for one in plain] == ["nadir", "spin"] and not any(one.tests for one in plain)


@pytest.fixture(scope="module")
def flown(base: Scenario) -> dict[str, tuple[Design, Flown]]:
    found = {}
    allowed = LimitsSection(attitudes=("nadir", "inertial_hold", "tumble"), torquer_test=False, load_test=False)
    for design in designs(base, allowed, 1.6, 20.0, START):
        assert design.step_h == 20.0 / 3600.0
        record, _ = simulate(design.scenario)
        found[design.words] = (design, View(design.scenario).flown(record, design.scenario))
    return found


def test_a_body_rate_tells_a_clock_from_an_orbit(flown: dict[str, tuple[Design, Flown]]) -> None:
    """Share of a clock error that an error along the orbit imitates: 0.95 at nadir, 0.998 in inertial hold, below 0.2 in a
    tumble of 0.25 deg/s. So the tumble is chosen, and more of the same and the inertial hold are not; without the tumble
    nothing settles it."""
    one, other = Cause(TimeTagOffset(), np.array([3.0])), Cause(AlongTrackError(), np.array([-22.0]))
    question = Open((one.name, other.name), (one, other), "which it is")
    best = choose(question, list(flown.values())).best
    assert best is not None and best.words.startswith("tumble") and best.power > 0.95 and best.hours < 1.7
    still = [pair for words, pair in flown.items() if not words.startswith("tumble")]
    courses = choose(question, still).courses
    assert len(best.curve) > 3 and (best.hours, best.power) in best.curve
    assert best.hours * 180.0 == pytest.approx(round(best.hours * 180.0))  # a row every 20 s
    assert max((course.power for course in courses), default=0.0) < 0.6


def test_of_courses_that_are_enough_the_shortest_comes_first() -> None:
    design = SimpleNamespace(step_h=0.01, wait_days=0.0, tests=True)
    three = ((150, 1.0), (149, 1.0), (20, 0.1))
    long, short, weak = (SimpleNamespace(design=design, rows=rows, power=power) for rows, power in three)
    every: Any = [weak, long, short]
    assert sorted(every, key=_rank) == [short, long, weak] and _rank(every[1])[2] == 1.5


def test_an_unknown_field_is_placed_by_what_it_has_beyond_the_floor() -> None:
    """50 nT where 30 nT were expected: (50^2 - 30^2) / 30^2 of the noise, in three components of each row."""
    asked: list[Any] = []
    problem = SimpleNamespace(rows=90)
    flown: Any = SimpleNamespace(problem=problem, place=lambda *about: asked.append(about))
    where = {"condition": None, "probabilities": {"frame": {"body": 0.6, "orbital": 0.4}}}
    assert to_place({"where": where, "gap": {"before_nT": 50.0, "floor_nT": 30.0}}, flown) == []
    assert asked == [(None, ["body", "orbital"], pytest.approx(3 * 90 * 16.0 / 9.0))]


@pytest.mark.parametrize(("power", "sure"), [(1.0, "> 99"), (0.997, "> 99"), (0.98, "98")])
def test_certainty_is_not_on_offer(power: float, sure: str) -> None:
    """In the sentence, in the tables, and in what an answer would mean."""
    view: Any = SimpleNamespace(shown=lambda rows: {"eddy_current": power})
    (answer,) = _answers(Open(("eddy_current",), (), "what it is"), view, 9)
    course = Course("spin of 2 rpm", 2.0, 0.0, power, [answer], [])
    asked = Question("show", ["eddy_current"], "what it is", [course])
    assert sentence(asked).endswith(f"right with a probability of {sure} %.")
    assert answer.means.endswith(f"with {sure} % confidence")
    assert plan_table(Plan(sentence(asked), [asked], {}, {}, [])).rows[0][-1] == sure
    assert answers_table(asked).rows[0][3] == sure


def test_of_one_cause_nothing_is_ambiguous() -> None:
    flown: Any = SimpleNamespace(imitating=lambda first, name: None)
    assert ambiguous(["along_track_error"], flown, Cause(TimeTagOffset(), np.array([3.0]))) == []


def test_of_two_steps_that_are_over_no_flight_tells_which_it_was(flown: dict[str, tuple[Design, Flown]]) -> None:
    """A diagnosis that was read from its JSON has only later flights to look at: the question is asked all the same, and
    first. A drift goes on, so beside a drift a later flight on which nothing is named shows that it was the step."""
    (step, drift), view = (signal(name) for name in ("bias_step", "linear_drift")), next(iter(flown.values()))[1]
    first = Cause(dataclasses.replace(step, at="2020-02-28T00:00:00Z"), np.array([200.0, 0.0, 0.0]))
    (both,) = ambiguous(["bias_step", "mounting_step"], view, first)
    assert set(both.names) == {"bias_step", "mounting_step"}
    found = choose(both, list(flown.values()))
    assert found.best is None and found.instead == step.settled_by
    assert [one.power for one in _answers(both, view, 100)] == [0.0, 0.0]
    alone, _ = _answers(apart([first, typical(drift.name)]), view, 100)
    assert alone.power > 0.99 and "bias_step, which has ended" in alone.means


def test_power_grows_with_size_and_time(flown: dict[str, tuple[Design, Flown]]) -> None:
    view = next(view for words, (_, view) in flown.items() if words.startswith("tumble"))
    names = ("time_tag_offset", "along_track_error")
    power = [
        view.distinguishing(Cause(TimeTagOffset(), np.array([size])), names, view.problem.rows)
        for size in (0.02, 0.6, 3.0)
    ]
    assert power[0] < 0.05 and power[-1] > 0.99 and power == sorted(power)
    rows = [
        view.distinguishing(Cause(TimeTagOffset(), np.array([0.8])), names, rows) for rows in (20, view.problem.rows)
    ]
    assert rows[0] < rows[1]


def test_a_tumble_tells_the_axes_of_something_unknown(flown: dict[str, tuple[Design, Flown]]) -> None:
    """A field that follows the orbit and is steady in the body, or about the orbit: at nadir the two are the same axes."""
    nadir, tumble = (next(v for w, (_, v) in flown.items() if w.startswith(word)) for word in ("nadir", "tumble"))
    place = nadir.place("orbit_phase", ["body", "orbital"], 200.0)
    assert place is not None and nadir.place("head", ["body", "orbital"], 200.0) is None
    for frame in place.sizes:
        assert nadir.placed(place, frame, nadir.problem.rows) < 0.1
        assert tumble.placed(place, frame, tumble.problem.rows) > 0.9


@pytest.mark.parametrize("eccentricity", [0.0, 0.02, 0.2])
def test_the_orbit_of_a_record_is_found(base: Scenario, eccentricity: float) -> None:
    """A day later within 150 km: two hundredths of a radian, which no manoeuvre's power notices."""
    changes = {"orbit.eccentricity": eccentricity, "orbit.altitude_km": 650.0 + 9000.0 * eccentricity}
    scenario = base.updated({**changes, "schedule.segments": [_segment(300.0)]})
    record, _ = simulate(scenario)
    tree = base_tree(_closure(View(scenario).flown(record, scenario)), 10.0, "igrf14")
    again = validate(tree, Scenario, where="base")
    when = record.time[-1] + np.arange(0, 86400, 600) * np.timedelta64(1, "s")
    away = np.linalg.norm(ephemeris(scenario, when)[0] - ephemeris(again, when)[0], axis=1)
    assert away.max() < 150.0
    assert again.torquers is not None and again.torquers.dipole_Am2 == 50.0 and again.power is not None


def _segment(minutes: float) -> dict[str, object]:
    return {"start_utc": "2020-03-01T00:00:00Z", "duration_min": minutes, "step_s": 20.0}


def _closure(view: Flown) -> FloatArray:
    found = SimpleNamespace(problem=view.problem, whitener=view.whitener, modelled=view.problem.modelled_active)
    return found  # type: ignore[return-value]


def test_the_likeliest_of_alike_causes_pays_for_each_parameter_the_log_of_the_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two more parameters cost 2 ln 1000 = 13.8 of chi-square where 3000 components were read: 8 are not worth it."""
    fits = {None: (900.0, 0), "one": (600.0, 1), "three": (592.0, 3)}

    def refit(_: Any, chosen: Any = ()) -> Any:
        chi2, rank = fits[chosen[0][0] if chosen else None]
        return SimpleNamespace(chi2=chi2, rank_chosen=rank, chosen=chosen)

    monkeypatch.setattr(power, "refit", refit)
    known = [SimpleNamespace(name=name, effect=name, live=np.ones(1)) for name in ("one", "three")]
    view: Any = SimpleNamespace(found=known, plausible=lambda cause: cause)
    for measured, wanted in ((3000, "one"), (30, "three")):
        readings: Any = SimpleNamespace(measured=measured)
        assert Flown._best(view, readings, ["one", "three"]).effect == wanted
