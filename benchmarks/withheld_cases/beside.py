"""Rows beside the main ones: what turns the body, sun and nadir or a second magnetometer in the record, and a field richer
than the ground's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from withheld_cases.cases import TWO
from withheld_cases.judged import Judged, names_of
from withheld_cases.rows import Test, distributional, expressible, number_row, of, share_row
from withheld_cases.statistics import median

SENSORS = ("sun_sensor_head_misalignment", "horizon_scanner_bias")
"""Effects that are faults of the sensors of sun and nadir."""
COMPARED = "compared"
"""Reach of a row that is there to be compared with another."""


def torques(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """What turns the body, which the momentum shows."""
    alone, mixed = of(cases, "torques", least=0.65), of(cases, "torque_pairs", least=0.65)
    closed = [float(gap["closed"]) for c in alone if (gap := c.said.get("momentum")) and gap["closed"] is not None]
    middle = median(closed)
    return [
        share_row(
            "perfect flight of a modelled vehicle: no gap",
            ">= 99 %",
            of(cases, "torque_nulls"),
            lambda c: c.verdict == "no_gap",
            0.99,
        ),
        share_row("torque, visible >= 0.7: first name", ">= 95 %", alone, lambda c: c.first_right, 0.95),
        share_row("the same: list exactly right", ">= 90 %", alone, lambda c: c.list_right, 0.90),
        share_row("torque: false extra", "<= 5 %", alone, lambda c: c.extra, 0.0, 0.05),
        share_row("torque: stage right", ">= 95 %", alone, lambda c: c.stage_right, 0.95),
        number_row("torque, closed in attitude: median", ">= 0.90", middle, len(closed), middle >= 0.90),
        share_row(
            "torque and sensor, each visible >= 0.7: both exactly", ">= 80 %", mixed, lambda c: c.list_right, 0.80
        ),
        share_row("torque and sensor: false extra", "<= 5 %", mixed, lambda c: c.extra, 0.0, 0.05),
    ]


def has_channel(case: Judged) -> bool:
    """Whether sun and nadir as measured are in the record."""
    return case.sealed.get("sensors_deg") is not None


def second_channel(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """Records that point to the Earth with sun and nadir in them, and without; `sensed` has the same ones both ways."""
    nulls = of(cases, "nulls", names=lambda c: c.sealed["regime"] == "nadir")
    singles = of(cases, "singles", least=0.2, names=lambda c: _plain(c) and c.sealed["regime"] == "nadir")
    faults = of(cases, "sensed", names=lambda c: c.truths[0] in SENSORS)
    others = of(cases, "sensed", names=lambda c: c.truths[0] not in SENSORS)
    return [
        *_both(nulls, "no gap on a perfect simulation", ">= 99 %", lambda c: c.quiet, 0.99),
        *_both(
            singles, "single, with a Jacobian, visible >= 0.2: list exactly right", COMPARED, lambda c: c.list_right
        ),
        *_both(
            faults, "fault of an attitude sensor, visible >= 0.2: list exactly right", COMPARED, lambda c: c.list_right
        ),
        *_both(
            faults,
            "fault of an attitude sensor: the same, and no other name in the group",
            COMPARED,
            lambda c: c.list_right and len(names_of(c.effects[0])) == 1,
        ),
        *_both(others, "another cause, visible >= 0.2: list exactly right", COMPARED, lambda c: c.list_right),
        *_both(others, "another cause: a fault of an attitude sensor named", "<= 5 %", _blamed, 0.0, 0.05),
    ]


def _both(
    cases: Sequence[Judged],
    title: str,
    reach: str,
    test: Test,
    least: float = 0.0,
    most: float = 1.0,
    *,
    has: Test = has_channel,
    words: tuple[str, str] = ("sun and nadir measured: ", "sun and nadir not measured: "),
) -> list[dict[str, Any]]:
    """The row with what more is measured, held to its reach, and beside it the one without, for comparison."""
    there = [case for case in cases if has(case)]
    absent = [case for case in cases if not has(case)]
    return [
        share_row(f"{words[0]}{title}", reach, there, test, least, most),
        share_row(f"{words[1]}{title}", COMPARED, absent, test, 0.0),
    ]


def _blamed(case: Judged) -> bool:
    return any(entry["name"] in SENSORS for entry in case.effects)


def two_magnetometers(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """Flights with a second magnetometer, and the same ones without where these were asked too."""

    def both(mine: Sequence[Judged], title: str, reach: str, test: Test, *limits: float) -> list[dict[str, Any]]:
        numbers = {c.sealed["number"] for c in mine if _has_two(c)}
        same = [c for c in mine if c.sealed["number"] in numbers]
        words = ("two magnetometers, ", "the same flights with one, ")
        return _both(same, title, reach, test, *limits, has=_has_two, words=words)

    beyond = of(cases, "outside_two", "outside", least=0.95)
    singles = of(cases, "singles_two", "singles", least=0.2, names=_plain)
    return [
        *both(
            beyond, "outside the catalogue, visible >= 1: unknown", ">= 97 %", lambda c: c.verdict == "unknown", 0.97
        ),
        *both(beyond, "outside the catalogue: wrongly confirmed", "<= 3 %", lambda c: bool(c.effects), 0.0, 0.03),
        *both(beyond, "outside the catalogue: stage right", ">= 90 %", lambda c: c.stage_right, 0.90),
        *both(singles, "single, visible >= 0.2: first name", ">= 98 %", lambda c: c.first_right, 0.98),
        *both(singles, "single, visible >= 0.2: list exactly right", ">= 95 %", lambda c: c.list_right, 0.95),
        *both(singles, "single, visible >= 0.2: stage right", ">= 95 %", lambda c: c.stage_right, 0.95),
    ]


def _has_two(case: Judged) -> bool:
    return case.population in TWO


def is_richer(case: Judged) -> bool:
    """Whether the real field has more in it than the ground's model."""
    return str(case.sealed.get("real_model", "")) == "chaos"


def richer_field(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """Singles whose field is richer than the model, and those whose field is the model's; none in a run without."""
    if not any(map(is_richer, cases)):
        return []
    singles = of(cases, "singles", least=0.2, names=_plain)
    rows = []
    for words, mine in (
        ("field richer than the model", [case for case in singles if is_richer(case)]),
        ("field of the model", [case for case in singles if not is_richer(case)]),
    ):
        rows += [
            share_row(f"{words}, single, visible >= 0.2: first name", COMPARED, mine, lambda c: c.first_right, 0.0),
            share_row(f"{words}: list exactly right", COMPARED, mine, lambda c: c.list_right, 0.0),
            share_row(f"{words}: false extra", COMPARED, mine, lambda c: c.extra, 0.0),
            share_row(f"{words}: verdict unknown", COMPARED, mine, lambda c: c.verdict == "unknown", 0.0),
        ]
    return rows


def _plain(case: Judged) -> bool:
    return not distributional(case) and expressible(case)
