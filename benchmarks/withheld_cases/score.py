"""The table: every figure with its 95 % interval, the tables by effect and regime, and the list of failures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

from withheld_cases import beside, defaults, laws_judged, promises
from withheld_cases.cases import TWO
from withheld_cases.judged import Judged, names_of
from withheld_cases.rows import Test, distributional, expressible, number_row, of, share_row
from withheld_cases.statistics import brier, calibration_error, median, reliability
from withheld_cases.store import Store

NOT_RUN = "not run"
CRITERIA = ("BIC", "EBIC")
LATER = ("judged", "rival", "loop", "control", "limit")
"""What may be known of a case beside its answer, in the order of the fields of `Judged`."""


def opened(store: Store, names: Iterable[str]) -> tuple[list[Judged], int]:
    """All cases with an answer, and how many could not be made."""
    found, void = [], 0
    for name in names:
        sealed = store.read("sealed", name)
        if "void" in sealed:
            void += 1
        elif store.has("said", name):
            more = [store.read(kind, name) if store.has(kind, name) else None for kind in LATER]
            found.append(Judged(sealed, store.read("said", name), *more))
    return found, void


def rows_of(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """Every row of the table."""
    return [
        *_detection(cases),
        *_several(cases),
        *_elsewhere(cases),
        *beside.torques(cases),
        *beside.second_channel(cases),
        *beside.two_magnetometers(cases),
        *beside.richer_field(cases),
        *defaults.rows(cases),
        *promises.rows(cases),
        *_probabilities(cases),
        *_closing(cases),
        *_rival(cases),
        *laws_judged.rows(cases),
    ]


def _detection(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    signals = of(cases, "singles", least=0.2, names=lambda c: not distributional(c) and expressible(c))
    noises = of(cases, "singles", least=0.5, names=distributional)
    named = [c for c in of(cases, "singles", least=0.2) if c.effects]
    sizes = [len(names_of(entry)) for c in named for entry in c.effects]
    mean = sum(sizes) / len(sizes) if sizes else None
    return [
        share_row("no gap on a perfect simulation", ">= 99 %", of(cases, "nulls"), lambda c: c.quiet, 0.99),
        share_row(
            "the same, declared attitude sigma off by 1.5",
            ">= 97 %",
            of(cases, "nulls_off"),
            lambda c: c.verdict == "no_gap",
            0.97,
        ),
        share_row(
            "single, with a Jacobian, visible >= 0.2: first name", ">= 98 %", signals, lambda c: c.first_right, 0.98
        ),
        share_row("the same: list exactly right", ">= 95 %", signals, lambda c: c.list_right, 0.95),
        share_row(
            "known by distribution, visible >= 0.5: list exactly right", ">= 95 %", noises, lambda c: c.list_right, 0.95
        ),
        share_row(
            "truth in the group, singles that are named, visible >= 0.2", ">= 99 %", named, lambda c: c.in_group, 0.99
        ),
        number_row("mean group size", "<= 1.5", mean, len(sizes), mean is not None and mean <= 1.5),
    ]


def _several(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    pairs, triples = (
        of(cases, "pairs", least=0.65, names=expressible),
        of(cases, "triples", least=0.95, names=expressible),
    )
    return [
        share_row("pairs, each visible >= 0.7: both exactly", ">= 90 %", pairs, lambda c: c.list_right, 0.90),
        share_row("pairs: false extra", "<= 5 %", pairs, lambda c: c.extra, 0.0, 0.05),
        share_row("triples, each visible >= 1: all three exactly", ">= 75 %", triples, lambda c: c.list_right, 0.75),
        share_row("triples: false extra", "<= 10 %", triples, lambda c: c.extra, 0.0, 0.10),
    ]


def _elsewhere(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    beyond = of(cases, "outside", least=0.95)
    shaped = of(cases, "shapes", least=0.5, names=expressible)
    strange = of(cases, "shapes", least=0.5, names=lambda c: not expressible(c))
    without = of(cases, "singles", least=0.2, names=lambda c: not expressible(c))
    staged = of(cases, "singles", "shapes", least=0.5)
    return [
        share_row(
            "another shape, visible >= 0.5: verdict effect and first name",
            ">= 95 %",
            shaped,
            lambda c: c.verdict == "effect" and c.first_right,
            0.95,
        ),
        share_row(
            "another shape, and the catalogue's entry explains less than 90 % of it: named, or unknown that resembles it",
            "compared",
            strange,
            lambda c: c.first_right or _resembled(c),
            0.0,
        ),
        share_row(
            "single, its column not recorded, and others explain less than 90 % of it: named, or unknown that resembles it",
            "compared",
            without,
            lambda c: c.first_right or _resembled(c),
            0.0,
        ),
        share_row(
            "outside the catalogue, visible >= 1: unknown", ">= 97 %", beyond, lambda c: c.verdict == "unknown", 0.97
        ),
        share_row("outside the catalogue: wrongly confirmed", "<= 3 %", beyond, lambda c: bool(c.effects), 0.0, 0.03),
        share_row("stage right, visible >= 0.5", ">= 95 %", staged, lambda c: c.stage_right, 0.95),
        share_row("stage right outside the catalogue, visible >= 1", ">= 70 %", beyond, lambda c: c.stage_right, 0.70),
    ]


def _resembled(case: Judged) -> bool:
    return case.verdict == "unknown" and bool(set(case.truths) & set(case.said.get("resembles") or []))


def _probabilities(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    cases = [case for case in cases if case.population not in defaults.POPULATIONS]
    everything = [pair for case in cases for pair in case.stated()]
    faint = [pair for case in cases if 0.1 <= case.visible <= 0.3 for pair in case.stated()]
    error, faint_error = (calibration_error(*_columns(pairs)) for pairs in (everything, faint))
    score, base = brier(*_columns(everything))
    lower = 1.0 - score / base if base > 0 else float("nan")
    return [
        number_row("stated probabilities: calibration error", "<= 0.05", error, len(everything), error <= 0.05),
        number_row("the same, visible 0.1-0.3", "<= 0.08", faint_error, len(faint), faint_error <= 0.08),
        number_row("Brier score lower than the base rate's by", ">= 20 %", lower, len(everything), lower >= 0.20),
    ]


def _columns(pairs: Sequence[tuple[float, bool]]) -> tuple[list[float], list[bool]]:
    return [p for p, _ in pairs], [hit for _, hit in pairs]


def _closing(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    seen = of(cases, "singles", least=0.5, names=lambda c: c.signal)
    closed = [float(c.said["gap"]["closed"]) for c in seen if (c.said.get("gap") or {}).get("closed") is not None]
    errors = [
        abs(float(c.said["gap"]["closed"]) - float(c.twin["closed"]))
        for c in seen
        if c.twin is not None
        and c.twin.get("closed") is not None
        and (c.said.get("gap") or {}).get("closed") is not None
    ]
    middle, off = median(closed), median(errors)
    looped = [c for c in seen if c.loop is not None and c.first_right]
    controls = [c for c in seen if c.control is not None and c.control["verdict"] != "error"]
    return [
        number_row("closed, visible >= 0.5: median", ">= 0.90", middle, len(closed), middle >= 0.90),
        number_row("closed: median error against the noise-free twin", "<= 0.03", off, len(errors), off <= 0.03),
        share_row(
            "loop on another day: no gap, or it had said 'does not transfer'", ">= 95 %", looped, _loop_right, 0.95
        ),
        share_row(
            "control, a wrong effect of equal rms: no gap",
            "<= 10 %",
            controls,
            lambda c: (c.control or {})["verdict"] == "no_gap",
            0.0,
            0.10,
        ),
    ]


def _loop_right(case: Judged) -> bool:
    said = case.loop or {}
    return said["verdict"] == "no_gap" or bool(said.get("said_not_to_transfer"))


def _rival(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    both = [c for c in cases if c.rival is not None]
    singles = [c for c in both if c.population in ("singles", "pairs", "triples") and c.visible >= 0.2]
    shown = [c for c in singles if not distributional(c)]
    nulls = of(both, "nulls")
    ours = _mean(nulls, lambda c: not c.quiet)
    rows = []
    for rule in CRITERIA:
        for mine, which in ((singles, "list exactly right"), (shown, "the same, effects with a Jacobian")):
            better = (
                _mean(mine, lambda c: c.list_right) - _mean(mine, lambda c, rule=rule: c.rival_right(rule))
                if mine
                else None
            )
            title = f"against the rival by {rule}: {which}, points better"
            rows.append(number_row(title, ">= 0.15", better, len(mine), better is not None and better >= 0.15))
        theirs = _mean(nulls, lambda c, rule=rule: c.rival_alarm(rule))
        times = theirs / max(ours, 1.0 / max(1, len(nulls))) if nulls else None
        title = f"against the rival by {rule}: false alarms, times fewer"
        rows.append(number_row(title, ">= 10", times, len(nulls), times is not None and times >= 10))
    return rows


def _mean(cases: Sequence[Judged], test: Test) -> float:
    return sum(test(c) for c in cases) / len(cases) if cases else 0.0


def right(case: Judged) -> bool:
    """Whether the whole answer is what was wanted of this case."""
    if case.population == "undetermined":
        return defaults.undetermined_right(case)
    if case.population == "limits":
        return case.limit is None or case.limit["said"] is None or defaults.detected(case)
    if not case.truths:
        return case.quiet
    if TWO.get(case.population, case.population) == "outside":
        return case.verdict == "unknown" and not case.effects
    if case.population == "shapes":
        return case.verdict == "effect" and case.first_right
    return case.list_right


def table_rows(store: Store, names: Iterable[str]) -> list[dict[str, Any]]:
    """The rows alone, for the log."""
    return rows_of(opened(store, names)[0])


def report(store: Store, names: Iterable[str]) -> tuple[str, dict[str, Any]]:
    """The page in Markdown, and the record."""
    cases, void = opened(store, names)
    rows = rows_of(cases)
    parts = [table(rows), f"{len(cases)} cases; {void} could not be made.", by(cases, "label", "effect or member")]
    parts += [by(cases, "regime", "regime"), _confusion_text(cases)]
    parts += [promises.outside_list(cases), seconds(cases), _failures(cases)]
    pairs = [pair for case in cases for pair in case.stated()]
    record = {
        "rows": rows,
        "cases": len(cases),
        "void": void,
        "confusion": confusion(cases),
        "reliability": reliability(*_columns(pairs)) if pairs else [],
        "failures": [_line(case) for case in cases if not right(case)],
    }
    return "\n\n".join(parts) + "\n", record


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as Markdown."""
    lines = ["| figure | reach | found | 95 % | of | met |", "|---|--:|--:|--:|--:|---|"]
    for row in rows:
        value, inside = row["value"], row.get("interval")
        shown = NOT_RUN if value is None else f"{100 * value:.1f} %" if inside else f"{value:.3g}"
        span = f"{100 * inside[0]:.1f} to {100 * inside[1]:.1f} %" if inside and value is not None else ""
        met = {None: "", True: "yes", False: "no"}[row["met"]]
        lines.append(f"| {row['figure']} | {row['reach']} | {shown} | {span} | {row['of']} | {met} |")
    return "\n".join(lines)


def by(cases: Sequence[Judged], key: str, title: str) -> str:
    """What was right, by something that is sealed with each case: a line a population."""
    groups: dict[tuple[str, str], list[Judged]] = {}
    for case in cases:
        groups.setdefault((case.population, str(case.sealed[key])), []).append(case)
    rows = []
    for (population, label), mine in sorted(groups.items()):
        if key == "label" and population in ("pairs", "triples", "outside"):
            continue
        wrong = [_short(case) for case in mine if not right(case)]
        counts = {text: wrong.count(text) for text in dict.fromkeys(wrong)}
        answers = "; ".join(
            f"{text} x{n}" if n > 1 else text for text, n in sorted(counts.items(), key=lambda i: -i[1])[:5]
        )
        good, first = sum(map(right, mine)), sum(case.first_right for case in mine)
        rows.append((population, label or "others", good, first, len(mine), answers))
    return lines_of(rows, title)


def lines_of(rows: Sequence[tuple[str, str, int, int, int, str]], title: str) -> str:
    """Rows of population, label, right, first name right, records and wrong answers, folded to a line a population."""
    lines = [f"| population | right | {title}, all right: records | with wrong answers |", "|---|---|---|---|"]
    for population, group in groupby(rows, key=lambda row: row[0]):
        mine = list(group)
        whole = [f"{label} {of}" for _, label, good, _, of, _ in mine if good == of]
        wrong = [
            f"**{label} {good} of {of}**{f', first name right {first}' if first > good else ''}: {answers}"
            for _, label, good, first, of, answers in mine
            if good < of
        ]
        good, of = sum(row[2] for row in mine), sum(row[4] for row in mine)
        lines.append(f"| {population} | {good} of {of} | {', '.join(whole)} | {'. '.join(wrong)} |")
    return "\n".join(lines)


def _short(case: Judged) -> str:
    return case.verdict + (" " + "+".join(str(entry["name"]) for entry in case.effects) if case.effects else "")


def confusion(cases: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """Truth by what came first, of those with one truth (a name that is in a right group counts as the truth)."""
    counts: dict[str, dict[str, int]] = {}
    for case in of(cases, "singles", "new_singles", "shapes", "torques"):
        said = case.truths[0] if case.first_right else str(case.effects[0]["name"]) if case.effects else case.verdict
        row = counts.setdefault(case.truths[0], {})
        row[said] = row.get(said, 0) + 1
    return counts


def _confusion_text(cases: Sequence[Judged]) -> str:
    lines = ["| truth | first name said: count |", "|---|---|"]
    for name, row in sorted(confusion(cases).items()):
        lines.append(f"| {name} | " + ", ".join(f"{s} {n}" for s, n in sorted(row.items(), key=lambda i: -i[1])) + " |")
    return "\n".join(lines)


def seconds(cases: Sequence[Judged]) -> str:
    """Speed, in words."""
    times = [float(case.said["seconds"]) for case in cases]
    return f"CPU time of a diagnosis: median {median(times):.1f} s, longest {max(times, default=0.0):.0f} s."


def _line(case: Judged) -> dict[str, Any]:
    sealed = case.sealed
    keys = ("case", "population", "number", "label", "regime", "rows", "step_s", "attitude_tau_s", "bursts")
    return {key: sealed[key] for key in keys} | {
        "truths": [{k: t[k] for k in ("name", "visible", "parameters")} for t in sealed["truths"]],
        "said": case.words(),
    }


def _failures(cases: Sequence[Judged]) -> str:
    lines = [
        "| case | population | number | regime | rows x step | truth (visible) | said |",
        "|---|---|---|---|---|---|---|",
    ]
    for case in cases:
        if right(case):
            continue
        s = case.sealed
        truth = ", ".join(f"{t['name']} ({t['visible']:.2f})" for t in s["truths"]) or "none"
        where = f"{s['rows']} x {s['step_s']:.3g} s" + (" in bursts" if s["bursts"] else "")
        lines.append(
            f"| {s['case']} | {s['population']} | {s['number']} | {s['regime']} | {where} | {truth} | {case.words()} |"
        )
    return "\n".join(lines)
