"""The law of what no effect of the catalogue explains: found, flown, frozen; and not found where there is none.

The truths are put into the record as plain arrays: nothing of the grammar that finds them makes them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from scipy.spatial.transform import Rotation
from worlds import scenario_text

from fluxtwin import diagnosing
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.law import words
from fluxtwin.gap.law.found import _Search
from fluxtwin.gap.law.search import RATIOS, Grammar, Regression
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.records.diagnosis import Diagnosis, Law, LawTerm, diagnosis_schema
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects import law as effect
from fluxtwin.sim.effects.spacecraft_field import TYPICAL_NT
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

pytestmark = pytest.mark.closure

STEP_S = 20.0
SECTIONS = """
[attitude]
yaw_rms_deg = 8.0
roll_rms_deg = 8.0
pitch_rms_deg = 8.0
[attitude.reference]
sigma_deg = 0.05
tau_s = 300.0
[magnetometer]
noise_nT = 10.0
[drivers.payload]
pattern = "square"
high = 1.2
period_s = 1700.0
duty = 0.4
[drivers.transmitter]
pattern = "random"
high = 30.0
duty = 0.3
dwell_s = 300.0
[drivers.heat]
pattern = "ramp"
high = 3.0
low = 1.0
period_s = 2900.0
"""
BUDGET = Budget(10.0, 0.0, float(np.radians(0.05)), None)
K_NT = np.array([40.0, -20.0, 10.0])


def scenario(seed: int = 5) -> Scenario:
    return parse_scenario(scenario_text(SECTIONS, seed=seed, segment=f"samples = 700, step_s = {STEP_S}"))


@cache
def flown(seed: int = 5) -> Telemetry:
    return simulate(scenario(seed))[0]


def added(record: Telemetry, field_B_nT: FloatArray) -> Telemetry:
    return record.replace(mag_B_nT=record.mag_B_nT + field_B_nT)


def before(values: FloatArray, seconds: float) -> FloatArray:
    """A column so many seconds before, in whole rows."""
    rows = round(seconds / STEP_S)
    return np.concatenate([np.full(rows, values[0]), values[: values.size - rows]])


@cache
def gated() -> tuple[Telemetry, Diagnosis]:
    """The payload's field, 40 s late, in sunlight only."""
    record = flown()
    product = before(record.drivers["payload"], 40.0) * np.asarray(record.sunlit)
    record = added(record, np.outer(product, K_NT))
    return record, diagnose(record, load_field(), budget=BUDGET)


def test_a_product_that_is_late_is_found_with_its_coefficients() -> None:
    _, found = gated()
    assert found.verdict == "unknown" and not found.effects
    assert found.law is not None
    (term,) = found.law.terms
    assert (set(term.of), term.axes, term.lag_s) == ({"driver_payload", "sunlit"}, "body", 0.0)
    # Of two values, between rows of 20 s the last one holds: 20 to 40 s late are the same rows.
    assert STEP_S < term.delay_s <= 40.0
    for axis, k in zip("xyz", K_NT, strict=True):
        value, sigma = term.coefficients[axis]
        assert sigma is not None and abs(value - k) < 4.0 * sigma < 12.0, axis
    assert found.law.closed is not None and found.law.closed > 0.6
    assert "driver_payload" in found.sentence and "in sunlight only" in found.sentence


def test_a_load_that_acts_from_an_unrecorded_time_on_is_found_with_the_time() -> None:
    record, first, last = flown(), 190, 533
    rows = np.arange(len(record))
    on = (rows >= first) & (rows < last)
    heat = record.drivers["heat"]
    found = diagnose(added(record, np.outer(heat * on, 0.5 * K_NT)), load_field(), budget=BUDGET)
    assert found.law is not None and found.law.terms, found.sentence
    (term,) = [one for one in found.law.terms if "driver_heat" in one.of]
    times = {sense: np.datetime64(text[:-1]) for sense, _, text in (one.partition(" ") for one in term.of[1:])}
    # The residual of a row is three times the noise there: a row or two either way look alike.
    for sense, row in (("since", first), ("until", last)):
        off_s = (times[sense] - record.time[row]) / np.timedelta64(1, "s")
        assert abs(off_s) <= 3 * STEP_S, (sense, off_s)
    for axis, k in zip("xyz", 0.5 * K_NT, strict=True):
        value, sigma = term.coefficients[axis]
        assert sigma is not None and abs(value - k) < 4.0 * sigma, axis


def test_the_json_keeps_the_schema_and_says_nothing_where_there_is_no_gap() -> None:
    answer = gated()[1].to_dict()
    Draft202012Validator(diagnosis_schema()).validate(answer)
    assert answer["law"]["tried"] > 500 and answer["law"]["terms"][0]["unit"] == "nT/unit"
    quiet = diagnose(flown(), load_field(), budget=BUDGET)
    assert quiet.verdict == "no_gap" and "law" not in quiet.to_dict()


def test_the_closed_scenario_flies_the_law_and_frozen_it_leaves_no_gap(tmp_path: Path) -> None:
    record, found = gated()
    path = write_telemetry(record, tmp_path / "flight.nc")
    answer, closed = diagnosing.close(
        found, scenario=None, telemetry=str(path), declared=diagnosing.Declared(10.0, 0.0, 0.05)
    )
    assert closed is not None and list(closed.effects.law) == ["payload_sunlit"]
    assert answer.transfers is not None and {one.effect for one in answer.transfers} == {"law.payload_sunlit"}
    again = diagnosing.diagnose(path, scenario=parse_scenario(closed.to_toml()))
    assert again.verdict == "no_gap"
    quiet = closed.updated({"magnetometer.noise_nT": 0.0, "attitude.reference": None})
    law = simulate(quiet)[0].mag_B_nT - simulate(quiet.updated({"effects": None}))[0].mag_B_nT
    truth = np.outer(before(flown().drivers["payload"], 40.0) * np.asarray(flown().sunlit), K_NT)
    # Sigmas of 1.8, 2.7 and 1.1 nT of 46 nT are 7.5 %; three of them.
    assert np.sqrt(np.mean((law - truth) ** 2)) < 0.22 * np.sqrt(np.mean(truth**2))


def test_a_square_in_the_orbits_frame_is_told_from_one_in_the_bodys() -> None:
    record = flown()
    R_BN = Rotation.from_quat(np.asarray(record.q_NB))  # v_N = R v_B
    up_N = np.asarray(record.r_N_km) / np.linalg.norm(np.asarray(record.r_N_km), axis=1)[:, None]
    field_N = 30.0 * (record.drivers["heat"] ** 2)[:, None] * up_N
    found = diagnose(added(record, R_BN.inv().apply(field_N)), load_field(), budget=BUDGET)
    assert found.law is not None and found.law.terms
    assert {term.axes for term in found.law.terms} == {"orbital"}
    assert {name for term in found.law.terms for name in term.of} <= {"driver_heat", "driver_heat^2", "driver_heat^3"}


def test_what_a_driver_leaves_is_none_of_its_shape_but_the_law_s() -> None:
    """The heat is nearly steady, so that the payload alone closes most of their product."""
    record = flown()
    heat = 6.0 + record.drivers["heat"]
    record = record.replace(drivers={**record.drivers, "heat": heat})
    found = diagnose(added(record, np.outer(heat * record.drivers["payload"], K_NT / 6.0)), load_field(), budget=BUDGET)
    assert found.law is not None
    assert {name for term in found.law.terms for name in term.of} == {"driver_heat", "driver_payload"}
    if found.verdict == "effect":
        assert tuple(found.law.instead_of) == ("driver.payload",) and found.sentence.startswith(found.law.sentence)
    assert found.closure is not None and {one.name for one, _ in found.closure.chosen} == {
        f"law.{term.name}" for term in found.law.terms
    }


@pytest.mark.parametrize(("held", "levels", "late_s"), [(1, 1000, 0.0), (3, 12, 0.0), (3, 12, 200.0)])
def test_a_proportion_is_named_though_its_column_is_coarse_or_early(held: int, levels: int, late_s: float) -> None:
    """Recorded in every third row and held, in steps of a twelfth of its range; the field follows later."""
    record = flown()
    heat = record.drivers["heat"]
    field = np.outer(before(heat, late_s), 2.0 * K_NT)
    step = np.ptp(heat) / levels
    coarse = step * np.rint(heat[np.arange(heat.size) // held * held] / step)
    record = record.replace(drivers={**record.drivers, "heat": coarse})
    found = diagnose(added(record, field), load_field(), budget=BUDGET)
    assert [one.name for one in found.effects] == ["driver.heat"]
    assert found.verdict == "effect" and found.law is None


@pytest.mark.parametrize("seed", [1, 3, 8])
def test_where_no_column_does_it_none_is_named(seed: int) -> None:
    """Steps to random levels at random times, which nothing has recorded. Among a thousand terms some follow them for most
    of the record, but not with the same coefficients in each part of it."""
    record, rng = flown(), np.random.default_rng(seed)
    ends = np.sort(rng.choice(np.arange(20, 680), 9, replace=False))
    levels = 60.0 * rng.standard_normal((10, 3))
    field = levels[np.searchsorted(ends, np.arange(700), side="right")]
    found = diagnose(added(record, field), load_field(), budget=BUDGET)
    assert found.verdict == "unknown" and found.law is not None
    assert not found.law.terms and found.law.why_none
    assert {"driver_payload", "driver_heat", "sun_x"} <= {one.quantity for one in found.law.looked_at}
    assert all(one.visible_nT > 0.0 for one in found.law.looked_at)
    assert "No law" in found.sentence


def test_the_usual_size_of_a_coefficient_is_that_of_its_largest_swing() -> None:
    for values, swing in (([10.0, 12.0], 12.0), ([-10.0, 12.0], 22.0)):
        grammar: Any = SimpleNamespace(values=lambda law, values=values: np.array(values))
        assert Grammar.usual(grammar, effect.Law()).typical_nT_per_unit == TYPICAL_NT / swing


def test_a_law_is_charged_for_its_own_coefficients_alone() -> None:
    """Three of a term, beside two that are re-estimated with it or without; it explains the square of what it makes."""
    unit = np.eye(30).reshape(10, 3, 30)
    whitener = SimpleNamespace(apply=lambda columns: columns, measured=30)
    residual_nT, fitted_nT = unit @ np.array([0.0, 0.0, 3.0, 4.0, *np.zeros(26)]), unit[:, :, :2]
    search: Any = SimpleNamespace(
        answer=SimpleNamespace(whitener=whitener, result=SimpleNamespace(tested=7)),
        base=SimpleNamespace(named=()),
        alone=SimpleNamespace(residual_nT=residual_nT, fitted_nT=fitted_nT),
        regression=SimpleNamespace(log_tried=np.log(500.0)),
    )
    found = _Search.weighed(search, residual_nT, unit[:, :, :5], 1)
    assert (found.rank, found.causes) == (3, 1)
    assert (found.explained, found.log_tried) == (pytest.approx(25.0), pytest.approx(np.log(500.0)))


def test_only_the_best_eight_of_different_quantities_have_their_settings_moved() -> None:
    """Of ten quantities, each as it stands and squared."""
    terms = [(effect.Law(of=(f"driver_{name}{power}",)),) for name in "abcdefghij" for power in ("", "^2")]
    fits = [SimpleNamespace(explained=lambda drop=100.0 - place: (drop, 3)) for place in range(len(terms))]
    moved: list[str] = []
    regression: Any = SimpleNamespace(
        terms=terms, pool=SimpleNamespace(fits=lambda left: fits), _count=lambda terms: None
    )
    regression.order = lambda one, left, wider=1.0: one.drop
    regression.moved = lambda one, left: moved.append(one.law.of[0]) or one
    nothing: Any = None
    Regression.best(regression, nothing)
    assert moved == [f"driver_{name}" for name in "abcdefgh"]


@pytest.mark.parametrize(("explained", "needed"), [(300.0, ["a", "b"]), (1e6, ["a"])])
def test_what_a_term_leaves_for_its_own_shape_is_no_further_term(explained: float, needed: list[str]) -> None:
    """A second term is worth its drop of 100 beside noise, and not beside the shape error of a first of 1e6."""
    drops = {"a": explained, "b": 100.0}
    search: Any = SimpleNamespace(trial=lambda terms, left: SimpleNamespace(drop=drops[terms[0].of[0]], rank=3))
    bare, left = (SimpleNamespace(energy=energy, degrees=900) for energy in (explained + 900.0, 900.0))
    laws = [effect.Law(of=(name,)) for name in drops]
    found = Regression._needed(search, laws, bare, lambda others: left)
    assert [law.of[0] for law in found] == needed


def test_a_delay_and_a_lag_are_moved_by_ratios() -> None:
    tried: list[tuple[float, float]] = []

    def better(best: Any, laws: list[effect.Law], left: Any) -> Any:
        tried.extend((one.delay_s, one.lag_s) for one in laws)
        return best

    search: Any = SimpleNamespace(_better=better, grammar=SimpleNamespace(variants=lambda law: [], halves=list))
    start: Any = SimpleNamespace(law=effect.Law(of=("a",), delay_s=40.0, lag_s=10.0))
    Regression.moved(search, start, search)
    ways = [way for ratio in RATIOS for way in (ratio, 1.0 / ratio)]
    assert tried == [(40.0, 10.0), *(at for way in ways for at in ((40.0 * way, 10.0), (40.0, 10.0 * way)))]


def test_a_wave_comes_with_its_quarter_and_a_column_with_the_rest() -> None:
    grammar: Any = SimpleNamespace(recorded=["a"], switches=[], values=lambda law: 1.0)
    found = {one.of for one in Grammar.with_lower(grammar, effect.Law(of=("a", "cos orbit")))}
    assert {("a", "cos orbit"), ("a", "sin orbit"), ("cos orbit",)} <= found
    found = {one.of for one in Grammar.with_lower(grammar, effect.Law(of=("cos orbit", "a")))}
    assert found == {("cos orbit", "a"), ("sin orbit", "a"), ("cos orbit",)}


def test_a_time_is_moved_by_as_many_rows_to_either_side() -> None:
    time = np.datetime64("2020-03-01T00:00:00", "ns") + np.arange(100) * np.timedelta64(1, "s")
    grammar = SimpleNamespace(setting=SimpleNamespace(time=time))
    grammar._timed = lambda sense, row: Grammar._timed(grammar, sense, row)
    found = Grammar.retimed(grammar, effect.Law(of=("a", "since 2020-03-01T00:00:50Z")), 8)  # type: ignore[arg-type]
    assert [one.of[1][-3:-1] for one in found] == ["42", "58"]


def test_a_law_without_a_recorded_column_says_that_it_describes() -> None:
    term = LawTerm(
        "by_height", ("sun_height",), "earth", 0.0, 0.0, "nT", {"x": (40.0, 1.0), "y": (0.5, 1.0), "z": (0.2, 1.0)}
    )
    law = Law((term,), (), 9.0, 3.0, 2.0, 0.9, (0.8, 1.0), 500, (), "", (), "")
    assert "over 1.5 orbits it describes the gap" in words.sentence(law, False, 1.5)
    assert "40.0 ± 1.0 nT on x of Earth-fixed axes" in words.sentence(law, False, 1.5)
    driven = replace(law, terms=(replace(term, of=("sun_height", "flag_pump")),))
    assert "does not explain" not in words.sentence(driven, False, 1.5)
    assert "while flag_pump is 1" in words.sentence(driven, False, 1.5)


SINCE, UNTIL = "since 2026-03-01T01:06:40Z", "until 2026-03-01T02:41:20Z"


def test_names_are_short_and_each_its_own() -> None:
    """Neither levels nor times are in them; in a scenario they are keys without quotes."""
    factors = [
        ("temperature_degC^3", SINCE, UNTIL),
        ("temperature_degC^3", "since 2026-03-01T03:00:00Z"),
        ("driver_payload", "sunlit"),
        ("not sunlit", "temperature_degC>-21.5"),
        (SINCE, UNTIL),
        ("one", SINCE),
        *[("sin2 latitude", f"{SINCE[:-6]}{minute}:00Z") for minute in range(10, 22)],
    ]
    laws = [effect.Law(of=of) for of in factors]
    names = [one.term for one in words.with_names(laws)]
    assert names[:3] == ["temperature_degC_cubed", "temperature_degC_cubed_2", "payload_sunlit"]
    assert names[3:6] == ["not_sunlit_temperature_degC_high", "constant", "constant_2"]
    assert names[-1] == "sin2_latitude_12" and len(set(names)) == len(names)
    had = [replace(laws[1], term="temperature_degC_cubed")]
    assert [one.term for one in words.with_names(laws[:2], had)] == [
        "temperature_degC_cubed_2",
        "temperature_degC_cubed",
    ]


@pytest.mark.parametrize(
    ("of", "label"),
    [
        (("array_current_A", "sunlit"), "array current times sunlight [A], 40 s late"),
        (("temperature_degC",), "temperature [degC], 40 s late"),
        (("sunlit",), "sunlight, 40 s late"),
        (("driver_payload", "array_current_A"), "driver_payload times array current [unit A], 40 s late"),
    ],
)
def test_the_axis_of_a_figure_has_the_unit_of_what_the_law_follows(of: tuple[str, ...], label: str) -> None:
    assert words.axis_label(effect.Law(of=of, delay_s=40.0)) == label


def test_a_switch_in_time_is_no_factor_to_read() -> None:
    sizes = {"x": (40.0, 1.0), "y": (0.5, 1.0), "z": (0.2, 1.0)}

    def said(*of: str) -> str:
        return words.term(LawTerm("a", of, "body", 0.0, 0.0, "nT", sizes))

    when = "from 2026-03-01T01:06:40Z on, until 2026-03-01T02:41:20Z"
    assert said(SINCE, UNTIL) == said("one", SINCE, UNTIL) == f"40.0 ± 1.0 nT on x, {when}"
    for of in (("sunlit", SINCE, UNTIL), (SINCE, UNTIL, "sunlit")):
        assert said(*of) == f"40.0 ± 1.0 nT on x, times sunlight, {when}"
        assert words.product(of) == f"sunlight, {when}"
    assert words.made_of([LawTerm("a", (SINCE,), "body", 0.0, 0.0, "nT", sizes)]) == "a switch at 2026-03-01T01:06:40Z"
