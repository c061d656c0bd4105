"""Rows of what a new user meets: no flag of noise given, null records of other regimes, the printed smallest sizes, and
records that determine nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from withheld_cases import limits, null_regimes, undetermined
from withheld_cases.beside import COMPARED
from withheld_cases.judged import Judged, names_of
from withheld_cases.rows import distributional, expressible, of, share_row

POPULATIONS = ("nulls_undeclared", "singles_undeclared", *null_regimes.UNDECLARED, "limits", "undetermined")
BEYOND_DECLARED = ("excess_noise", "coarse_quantization")
"""More than was declared: where nothing was, there is nothing to be more than."""
TURNS = ("sun_sensor_head_misalignment", "horizon_scanner_bias", "yaw_drift", "boom_bending", "scale_misalignment")
"""Turns of the attitude or of the sensor lie across the field, where an attitude error of unknown size lies too."""
DETECTED = (0.85, 0.95)
"""90 % is promised; of 100 records the binomial sigma is 3 %."""


def rows(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """All of them; none for a population that was not run."""
    return [*_nulls(cases), *_singles(cases), *_limits(cases), *_undetermined(cases)]


def _nulls(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    def quiet(title: str, reach: str, mine: Sequence[Judged], least: float) -> dict[str, Any]:
        return share_row(title, reach, mine, lambda c: c.verdict == "no_gap", least)

    plain = of(cases, "nulls_undeclared")
    found = [
        quiet("nothing declared, perfect flights: no gap", ">= 98 %", plain, 0.98),
        quiet("nothing declared: of these the scenario of the README", COMPARED, [c for c in plain if _readme(c)], 0.0),
        quiet("nothing declared: of these the usual worlds", COMPARED, [c for c in plain if not _readme(c)], 0.0),
    ]
    for regime in null_regimes.UNDECLARED:
        title = f"{null_regimes.WORDS[regime]}, nothing declared: no gap"
        found.append(quiet(title, ">= 99 %", of(cases, regime), 0.99))
    return found if any(c.population in ("nulls_undeclared", *null_regimes.UNDECLARED) for c in cases) else []


def _readme(case: Judged) -> bool:
    return bool(case.sealed["label"] == null_regimes.README_LABEL)


def _singles(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    everything = of(cases, "singles_undeclared", least=0.45)
    if not everything:
        return []
    asked = [c for c in everything if c.truths[0] not in BEYOND_DECLARED and expressible(c)]
    across = [c for c in asked if c.truths[0] in TURNS]
    noises = [c for c in everything if distributional(c)]
    return [
        share_row(
            "nothing declared, single other than noise and steps, visible >= 0.5: first name",
            ">= 85 %",
            asked,
            lambda c: c.first_right,
            0.85,
        ),
        share_row("nothing declared, the same: list exactly right", COMPARED, asked, lambda c: c.list_right, 0.0),
        share_row("nothing declared, the same: false extra", COMPARED, asked, lambda c: c.extra, 0.0),
        share_row("nothing declared, the same: no gap", COMPARED, asked, lambda c: c.verdict == "no_gap", 0.0),
        share_row(
            "nothing declared, turns of attitude or sensor alone: first name",
            COMPARED,
            across,
            lambda c: c.first_right,
            0.0,
        ),
        share_row(
            "nothing declared, known by distribution: first name", COMPARED, noises, lambda c: c.first_right, 0.0
        ),
        share_row("nothing declared, every single: first name", COMPARED, everything, lambda c: c.first_right, 0.0),
    ]


def _limits(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    mine = [c for c in of(cases, "limits") if c.limit is not None and c.limit["said"] is not None]
    found = []
    for name in limits.SIZED:
        own = [c for c in mine if c.truths[0] == name]
        if own:
            found += [
                share_row(f"printed smallest size of {name}, flown: detected", "85 to 95 %", own, detected, *DETECTED),
                share_row(f"the same, {name}: named or in the group", COMPARED, own, _flown_named, 0.0),
            ]
    if mine:
        found.append(share_row("printed smallest size, all of them: detected", "85 to 95 %", mine, detected, *DETECTED))
        found.append(share_row("the same, all of them: named or in the group", COMPARED, mine, _flown_named, 0.0))
    return found


def detected(case: Judged) -> bool:
    """Whether the flight with the printed size is any verdict but no gap (an exception is none)."""
    return _flown(case).verdict in ("effect", "unknown")


def _flown_named(case: Judged) -> bool:
    return _flown(case).in_group


def _flown(case: Judged) -> Judged:
    """The second flight with its own answer."""
    return Judged(case.sealed, (case.limit or {})["said"])


def _undetermined(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    mine = of(cases, "undetermined")
    open_ = [c for c in mine if is_open(c)]
    quiet = [c for c in mine if not is_open(c) and not c.sealed["drifts"]]
    found = [
        ("an answer or a refusal in words", "100 %", mine, lambda c: c.verdict != "error" or refused(c), 1.0),
        ("no false name", "100 %", mine, lambda c: not named_falsely(c), 1.0),
        ("b open: says what is missing", "100 %", open_, says_missing, 1.0),
        ("b determined, no drift: no gap", COMPARED, quiet, lambda c: c.verdict == "no_gap", 0.0),
    ]
    prefix = "fast spin without attitude, a gauss of its own"
    return [
        share_row(f"{prefix}: {words}", reach, some, test, least) for words, reach, some, test, least in found if mine
    ]


def is_open(case: Judged) -> bool:
    """Whether |B| leaves b open on this record."""
    return float(case.sealed["weakest_b_nT"]) > undetermined.OPEN_NT


def named_falsely(case: Judged) -> bool:
    """Whether a name is given: a drift may be named where b is determined, by its name in the group."""
    true = {"thermal_bias_drift"} if case.sealed["drifts"] and not is_open(case) else set()
    return any(not names_of(entry) & true for entry in case.effects)


def refused(case: Judged) -> bool:
    """Whether the data do not allow an answer, and the words say so: exit status 1."""
    return case.verdict == "error" and str(case.said.get("error")).startswith("NoAnswer: ")


def says_missing(case: Judged) -> bool:
    """A refusal, or an answer that holds what is modelled to be untestable on this record."""
    modelled = set(case.said.get("modelled") or case.sealed["modelled"])
    return refused(case) or bool(modelled & set(case.said.get("untestable") or {}))


def undetermined_right(case: Judged) -> bool:
    """Whether the whole answer is what was wanted of a record of that population."""
    spoke = case.verdict != "error" or refused(case)
    return spoke and not named_falsely(case) and (says_missing(case) or not is_open(case))
