"""The worlds of the laws, each held to facts that are written down without its maker, and the score of made-up answers."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from withheld_cases import laws, laws_judged, spacecraft
from withheld_cases.chain import noise_free
from withheld_cases.judged import Judged
from withheld_cases.worlds import World, shift
from withheld_worlds import small_world

pytestmark = pytest.mark.property


def drawn(label: str, world: World) -> tuple[dict[str, laws.Column], laws.Drawn]:
    columns = laws.draw_columns(np.random.default_rng(4))
    found = laws.FORMS[label](world, columns, np.random.default_rng(5))
    assert found is not None
    return columns, found


def added(world: World, found: laws.Drawn) -> np.ndarray:
    """(N, 3) what a law adds to the field at the sensor, by equation 1."""
    truth = laws.truth_of(found, 100.0)
    change = noise_free(world, [truth]).reading_nT - noise_free(world, ()).reading_nT
    return change @ (np.eye(3) + world.S).T


def test_eight_columns_of_which_the_law_has_those_it_says() -> None:
    world = small_world("tumble")
    for label in laws.FORMS:
        columns, found = drawn(label, world)
        assert len(columns) == 8 and {n for n in found.columns if n.startswith("driver_")} <= set(columns), label
        for name in found.columns:
            if name not in columns:
                continue
            held = dict(columns) | {name: laws.Column("load", lambda w, t: np.full(t.size, 0.3))}
            again = laws.FORMS[label](
                world, held | {name: dataclasses.replace(held[name], kind=columns[name].kind)}, np.random.default_rng(5)
            )
            assert again is not None and np.abs(added(world, again) - added(world, found)).max() > 1.0, (label, name)


def test_in_shadow_there_is_nothing_and_in_sunlight_the_load_of_before() -> None:
    world = small_world("nadir")
    columns, found = drawn("late_in_sunlight", world)
    field, lit = added(world, found), world.sun(world.time)[1] > 0.5
    assert 0.2 < lit.mean() < 0.85
    assert np.abs(field[~lit]).max() < 1e-6
    load = columns[found.columns[0]].course(world, shift(world.time, -found.form["late_s"]))
    ratio = field[lit] / load[lit][:, None]
    assert np.ptp(ratio, axis=0).max() < 1e-6


def test_the_payloads_law_is_off_with_its_flag_and_the_square_has_one_sign() -> None:
    world = small_world("slews")
    _, found = drawn("while_payload", world)
    assert np.abs(added(world, found)[spacecraft.payload_on(world, world.time) < 0.5]).max() < 1e-6
    _, found = drawn("squared", world)
    field = added(world, found)
    assert all(np.all(field[:, k] * np.sign(field[0, k]) >= -1e-6) for k in range(3))


def test_along_the_stars_the_direction_stays_there() -> None:
    world = small_world("tumble")
    _, found = drawn("along_the_stars", world)
    there = world.attitude(world.time).R_BN.inv().apply(added(world, found))
    unit = there / np.linalg.norm(there, axis=1)[:, None]
    assert np.abs(unit - unit[0]).max() < 1e-6


def test_columns_are_recorded_as_they_are_coarsely_or_through_another() -> None:
    world = small_world("nadir")
    columns, found = drawn("in_sunlight", world)
    name = found.columns[0]
    key = name.removeprefix("driver_")
    exact, coarse, other = (
        laws.recorded(world, columns, found, how)[key] for how in ("exact", "coarse", "through another")
    )
    assert np.unique(coarse).size < 20 < np.unique(exact).size or np.unique(coarse).size < np.unique(exact).size
    assert 0.97 < np.corrcoef(exact, other)[0, 1] < 0.999
    for same in set(columns) - {name}:
        key = same.removeprefix("driver_")
        assert np.array_equal(
            laws.recorded(world, columns, found, "coarse")[key], columns[same].course(world, world.time)
        )


def answered(terms: list[dict[str, Any]], effects: tuple[str, ...] = (), instead: tuple[str, ...] = ()) -> Judged:
    sealed = {
        "population": "laws",
        "label": "late_in_sunlight",
        "columns": ["driver_A", "sunlit"],
        "form": {"late_s": 100.0},
        "step_s": 10.0,
        "how": "exact",
        "truths": [{"name": "law", "stage": "spacecraft", "visible": 2.0, "signal": True}],
    }
    law = {"terms": terms, "instead_of": list(instead)}
    return Judged(sealed, {"verdict": "unknown", "effects": [{"name": name} for name in effects], "law": law})


def term(*of: str, delay_s: float = 0.0, lag_s: float = 0.0, axes: str = "body") -> dict[str, Any]:
    return {"of": list(of), "axes": axes, "delay_s": delay_s, "lag_s": lag_s}


def test_the_score_tells_right_columns_and_forms_from_wrong_ones() -> None:
    right = term("driver_A", "sunlit", delay_s=110.0)
    assert laws_judged.right_form(answered([right]))
    assert laws_judged.right_form(answered([right, term("sunlit")]))
    assert laws_judged.right_form(answered([right], ("driver.A",), ("driver.A",)))
    for wrong in (
        term("driver_A", "sunlit"),
        term("driver_A", "not sunlit", delay_s=110.0, axes="orbital"),
        term("driver_A", delay_s=110.0),
        term("driver_A>0.3", "sunlit", delay_s=110.0),
    ):
        case = answered([wrong])
        assert laws_judged.right_columns(case) and not laws_judged.right_form(case), wrong
    for case in (answered([]), answered([term("driver_B", "sunlit")]), answered([right], ("driver.B",))):
        assert not laws_judged.right_columns(case)
    assert not laws_judged.right_form(answered([right], ("solar_array_current",)))


def test_a_false_column_is_one_that_the_cause_has_nothing_to_do_with() -> None:
    cases = [answered([term("driver_B")]), answered([term("temperature_degC^2")]), answered([term("flag_payload")])]
    for case in cases:
        case.sealed.update(
            {"population": "laws_catalogue", "truths": [{"name": "switched_field", "stage": "spacecraft"}]}
        )
        case.sealed["truths"][0].update({"visible": 1.0, "signal": True})
    nulls = [answered([term("driver_B")]), answered([])]
    for case in nulls:
        case.sealed.update({"population": "laws_nulls", "truths": []})
    rows = [row for row in laws_judged.rows([*cases, *nulls]) if row["figure"].endswith("false column")]
    assert [(row["right"], row["of"]) for row in rows] == [(1, 2), (1, 3)]
