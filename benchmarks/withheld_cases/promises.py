"""Rows of what an answer promises: silence only below the size it prints, names as sure as stated, few of them, soon; what
it says of effects that join the table, of perfect flights of each regime, and of each kind outside the catalogue."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from withheld_cases import defaults, null_regimes
from withheld_cases.judged import Judged, names_of
from withheld_cases.outside import WHY
from withheld_cases.rows import counted_row, distributional, number_row, of, share_row

FAINT = (0.1, 0.2)
SURE = 0.95
COMPARED = "compared"


def rows(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """All of them."""
    return [*_regimes(cases), *_joining(cases), *_faint(cases), *_stated(cases), _time(cases)]


def _regimes(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    nulls = of(cases, "nulls")
    there = [name for name in null_regimes.REGIMES if any(c.sealed["label"] == name for c in nulls)]
    return [
        share_row(
            f"false alarms on perfect flights: {null_regimes.WORDS[name]}",
            "<= 1 %",
            [c for c in nulls if c.sealed["label"] == name],
            lambda c: not c.quiet,
            0.0,
            0.01,
        )
        for name in there
    ]


def _joining(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    mine = of(cases, "new_singles", least=0.2)
    signals, noises = [c for c in mine if not distributional(c)], [c for c in mine if distributional(c)]
    title = "effects that join the table, visible >= 0.2"
    return [
        share_row(f"{title}: first name", ">= 98 %", signals, lambda c: c.first_right, 0.98),
        share_row("the same: list exactly right", ">= 95 %", signals, lambda c: c.list_right, 0.95),
        share_row("the same: stage right", ">= 95 %", signals, lambda c: c.stage_right, 0.95),
        share_row("the same, known by distribution: list exactly right", COMPARED, noises, lambda c: c.list_right, 0.0),
    ]


def _faint(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    low, high = FAINT
    mine = [c for c in of(cases, "faint", "singles", least=low) if c.visible < high and not distributional(c)]
    title = "single, with a Jacobian, visible 0.1-0.2"
    return [
        share_row(
            f"{title}: first name, or no gap while the printed detectable size is larger",
            ">= 95 %",
            mine,
            lambda c: c.first_right or honest_silence(c),
            0.95,
        ),
        share_row("the same: first name", COMPARED, mine, lambda c: c.first_right, 0.0),
        share_row("the same: wrong name", "<= 2 %", mine, lambda c: c.extra, 0.0, 0.02),
    ]


def honest_silence(case: Judged) -> bool:
    """Whether nothing is claimed, and the answer says that it could not have seen this effect.

    Either it holds the effect to be untestable, or the smallest detectable size that it prints makes more nT rms, as it
    is printed beside that size, than the truth leaves after the re-estimation.
    """
    name = case.truths[0]
    if case.verdict != "no_gap":
        return False
    if name in (case.said.get("untestable") or {}):
        return True
    printed = (case.said.get("minimum_detectable") or {}).get(name)
    return printed is not None and case.visible * float(case.sealed["noise_rms_nT"]) < float(printed["nT"])


def _stated(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    mine = [case for case in cases if case.population not in defaults.POPULATIONS]
    hits = [hit for case in mine for p, hit in case.stated() if p >= SURE]
    sizes = [len(names_of(entry)) for case in mine if case.truths for entry in case.effects]
    mean = float(np.mean(sizes)) if sizes else None
    return [
        counted_row("names stated at 95 % or more: present", ">= 97 %", sum(hits), len(hits), 0.97),
        number_row("mean group size, all names in records with a cause", COMPARED, mean, len(sizes), None),
    ]


def _time(cases: Sequence[Judged]) -> dict[str, Any]:
    """The time that one diagnosis in a hundred exceeds."""
    times = [float(case.said.get("seconds", 0.0)) for case in cases]
    worst = float(np.quantile(times, 0.99)) if times else None
    return number_row("processor time of a diagnosis, worst of 100 [s]", COMPARED, worst, len(times), None)


def outside_list(cases: Sequence[Judged]) -> str:
    """Each kind that the catalogue does not have: what was said of it, and why no entry can express it. Markdown."""
    mine = of(cases, "outside")
    tests: tuple[Callable[[Judged], bool], ...] = (
        lambda c: c.verdict == "unknown",
        lambda c: c.stage_right,
        lambda c: c.verdict == "no_gap",
    )
    why = "what happens, and why no effect of the catalogue expresses it"
    lines = [f"| kind | of | unknown | stage right | no gap | wrongly named | {why} |", "|---|---|---|---|---|---|---|"]
    for name, why in WHY.items():
        own = [c for c in mine if c.sealed["label"] == name]
        said = [str(entry["name"]) for c in own for entry in c.effects]
        named = ", ".join(f"{one} x{said.count(one)}" if said.count(one) > 1 else one for one in dict.fromkeys(said))
        counts = " | ".join(str(sum(map(test, own))) for test in tests)
        lines.append(f"| `{name}` | {len(own)} | {counts} | {named} | {why} |")
    return "\n".join(lines)
