"""The four diagnosed cases as a page, and what the real passes say, for the study's report and summary."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.gap.sun_nadir import open_channel
from fluxtwin.plots import gallery as plots
from fluxtwin.scenarios.hcmm.gallery_study import GROUND, REGION_DEG, Answer
from fluxtwin.scenarios.hcmm.real_passes import Question, RealPasses
from fluxtwin.scenarios.page import Cell, FigureBlock, Page, Section, Table
from fluxtwin.sim.earth import epoch

FILE = "gallery"
_MOST_ROWS = 9
_SEEN = 3.0
"""Sigmas above which an element is said to be seen."""
_CHANCE = 3.5
"""Sigmas that the worst of some twenty numbers exceeds by chance once in a hundred pages."""


def gallery_page(answers: Sequence[Answer], seed: int, law: Answer | None = None) -> Page:
    """The page. law: case (c) with the coils driven by the control law of the study."""
    right = sum(answer.right for answer in answers)
    return Page(
        title="HCMM: four faults, found from telemetry",
        verdict=f"{right} of {len(answers)} faults that the ground was not told of are named from three days of passes.",
        sections=[_overview(answers), *(_section(answer, law) for answer in answers)],
        provenance={"seed": str(seed), "field of the diagnosis": GROUND},
        links={"Back to the report": "report.html"},
    )


def overview_table(answers: Sequence[Answer]) -> Table:
    """One line a case."""
    rows: list[list[Cell]] = []
    for answer in answers:
        d, later = answer.diagnosis, answer.later
        judged = (
            ""
            if later is None
            else f"{_as(later.rms[0], later.unit)} to {_as(later.rms[1], later.unit)} {later.unit} (floor "
            f"{_as(later.floor, later.unit)})"
        )
        rows.append(
            [f"({answer.case.key}) {answer.case.title}", answer.name or f"nothing: {d.verdict}", d.where.stage or "",
             answer.located, judged]
        )  # fmt: skip
    return Table(
        "Four faults",
        ["what was wrong", "named", "stage", "where", "passes not used, where it acts"],
        rows,
        "Named from telemetry alone. Residual, rms, on the passes of the two days that follow, without the cause and "
        "with it as found. Flown in the prescribed motion, coils at random with their full dipole, not by the control law.",
    )


def _overview(answers: Sequence[Answer]) -> Section:
    return Section(
        "What was flown",
        [
            "Each fault is simulated along HCMM's orbit; telemetry exists only while a station sees the satellite, and no "
            "row of the night has an attitude. Three days are diagnosed; the two that follow are kept apart. The step of "
            "the readings, 4.7 mG, is all that the diagnosis is told. Its field model is IGRF-14, what is known of 1978 "
            "today, and the field that is flown, so its error is nil: with the model of 1975 the error, 1 mG and more, "
            "would be a gap of its own.",
            "This is not quite the spacecraft of the study: its motion here is prescribed, without wheels or control law, "
            "and its coils act at random with their full dipole. That matters to (c), and is said there.",
        ],
        [overview_table(answers)],
    )


def _section(answer: Answer, law: Answer | None) -> Section:
    d = answer.diagnosis
    words = [answer.case.told, f"The diagnosis says: {d.sentence}"]
    place = [f"{name} {value}" for name, value in _place(answer).items() if value]
    if place:
        words.append(f"Where: {', '.join(place)}. In detail: {answer.located}.")
    if answer.case.key == "c":
        words.append(_drive(answer, law))
    tables = [_compared_table(answer)] if answer.compared else []
    figures = [*_evidence(answer), *_later(answer)]
    return Section(f"({answer.case.key}) {answer.case.title}", words, tables, figures)


def _drive(answer: Answer, law: Answer | None) -> str:
    """How hard the coils work here, and what is found where the control law drives them."""
    said = f"The coils act at random here: {_dipole_words(answer)}."
    if law is None:
        return said
    said += f" The control law of the study commands less: {_dipole_words(law)}. Flown under it, the same fault "
    if not law.compared or law.later is None:
        return said + f"is not found: the diagnosis says {law.name or law.diagnosis.verdict}."
    known = [one for one in law.compared if one.sigma is not None]
    seen = [one for one in known if one.sigma is not None and abs(one.found) > _SEEN * one.sigma]
    shown = ", ".join(
        f"{one.name} {_known(one.found, one.sigma)} ± {_known(one.sigma or 0.0, one.sigma)} (put in {one.put_in:.0f})"
        for one in seen
    )
    before, after, floor = (f"{value:.1f}" for value in (*law.later.rms, law.later.floor))
    return said + (
        f"is named {law.name}, but {len(seen)} of its {len(known)} elements {'is' if len(seen) == 1 else 'are'} above "
        f"{_SEEN:g} sigma"
        f"{': ' + shown if seen else ''} (the sigma of an element is up to {max(one.sigma or 0.0 for one in known):.0f} "
        f"{law.compared[0].unit}), and the passes not used go from {before} to {after} nT (floor {floor}): with so small a "
        "drive C is hardly known, and to leave it out costs little."
    )


def _dipole_words(answer: Answer) -> str:
    dipole = answer.telemetry.dipole_B_Am2
    assert dipole is not None
    rms = "/".join(f"{value:.2g}" for value in np.sqrt(np.mean(np.square(dipole), axis=0)))
    return f"{rms} A m2 rms along x/y/z, {np.abs(dipole).max():.2g} at most"


def _place(answer: Answer) -> dict[str, str | None]:
    w = answer.diagnosis.where
    return {"stage": w.stage, "axis": w.axis, "frame": w.frame, "condition": w.condition}


def _compared_table(answer: Answer) -> Table:
    rows: list[list[Cell]] = [
        [f"{one.name} [{one.unit}]", _known(one.put_in, one.sigma), _known(one.found, one.sigma),
         "not seen" if one.sigma is None else _known(one.sigma, one.sigma)]
        for one in answer.compared[:_MOST_ROWS]
    ]  # fmt: skip
    if answer.case.key == "b" and answer.diagnosis.effects:
        box = answer.diagnosis.effects[0].settings.get("region_deg", [])
        for name, true, found in zip(("south", "north", "west", "east"), REGION_DEG, box, strict=False):
            rows.append([f"{name} edge [deg]", f"{true:.0f}", f"{found:.0f}", ""])
    return Table("Put in, and found", ["parameter", "put in", "found", "1 sigma"], rows, _furthest(answer))


def _furthest(answer: Answer) -> str:
    """The parameter furthest from what was put in, by its own sigma."""
    known = [(abs(one.found - one.put_in) / one.sigma, one.name) for one in answer.compared if one.sigma]
    if not known:
        return ""
    far, name = max(known)
    words = f"Furthest from what was put in: {name}, by {far:.1f} of its sigma"
    return words + ("; so far is not chance, that sigma is too small." if far > _CHANCE else ".")


def _later(answer: Answer) -> list[FigureBlock]:
    later = answer.later
    if later is None:
        return []
    record = plots.PassResiduals(later.labels, later.unit, later.before, later.after, later.concerned, later.floor)
    caption = (
        "The passes of 2 and 3 December 1978, which were not used, one after the other; grey: passes in which the cause "
        "acts. Without the cause, all that is re-estimated comes from the passes used; with it, the cause too, as found."
    )
    return [FigureBlock(f"{answer.case.key}_passes", caption, plots.draw_later(record, title="Passes not used"))]


def _evidence(answer: Answer) -> list[FigureBlock]:
    drawn: dict[str, tuple[Figure, str]] = {}
    if answer.case.key == "a":
        drawn["a"] = (
            _heads(answer),
            "Measured less computed angle between sun and nadir in the three days that are diagnosed, by the head "
            "that saw the "
            "sun. Head 1 is the one that is turned.",
        )
    elif answer.case.key == "b":
        drawn["b"] = (
            _map(answer),
            "Samples of the night where they were taken, coloured by measured less model field strength, with the "
            "box in which "
            "the field is on and the one that the search found.",
        )
    elif answer.case.key == "c":
        drawn["c"] = (
            _torquers(answer),
            "Residual of each axis against the dipole of its own torquer, samples with attitude: a coil is off, or fully on "
            "one way or the other.",
        )
    else:
        drawn["d"] = (
            _field(answer),
            "Residual of each axis against its own reading, samples with attitude. The slope of x is its scale "
            "error; y and z "
            "show the other axes too, because none of S is modelled.",
        )
    return [FigureBlock(f"{key}_evidence", caption, figure) for key, (figure, caption) in drawn.items()]


def _heads(answer: Answer) -> Figure:
    channel, t = open_channel(answer.telemetry), answer.telemetry
    assert t.sun_sensor_head is not None
    hours = epoch.seconds_since(t.time[channel.rows], t.time[0]) / 3600.0
    record = plots.HeadAngles(hours, np.degrees(channel.residual_rad), np.array(t.sun_sensor_head)[channel.rows])
    return plots.draw_heads(record, title="The angle between sun and nadir")


def _map(answer: Answer) -> Figure:
    night = ~answer.known
    found = answer.diagnosis.effects[0].settings.get("region_deg") if answer.diagnosis.effects else None
    record = plots.NightMap(
        answer.place_deg[night, 0], answer.place_deg[night, 1], answer.residual_nT[night, 0], REGION_DEG,
        None if found is None else (found[0], found[1], found[2], found[3]),
    )  # fmt: skip
    return plots.draw_night_map(record, title="Night passes, size of the field")


def _torquers(answer: Answer) -> Figure:
    dipole = answer.telemetry.dipole_B_Am2
    assert dipole is not None
    record = plots.Following(np.array(dipole)[answer.known], answer.residual_nT[answer.known], "dipole [A m2]")
    return plots.draw_following(record, title="What the torquers do to the readings")


def _field(answer: Answer) -> Figure:
    reading = np.array(answer.telemetry.mag_B_nT)[answer.known]
    record = plots.Following(reading / 1000.0, answer.residual_nT[answer.known], "reading [uT]")
    return plots.draw_following(record, title="What a bias alone leaves")


def real_passes_section(real: RealPasses) -> Section:
    """The 43 printed residuals, asked."""
    raw, left = (real.question("station against station", corrected=c) for c in (False, True))
    record = plots.RealResiduals(
        real.stations, real.night, real.printed_mG, real.ratio,
        (f"as printed: stations {_differ(raw)}, p {_is(raw.p_counted)}",
         f"IGRF 1975's error out: p {_is(left.p_counted)}"),
    )  # fmt: skip
    caption = (
        "Left: printed residual of field strength. Right: the same over what the error of IGRF 1975 along the pass and "
        f"the step of the readings let expect, to the power {real.slope:.2f} that fits best. p-values with all "
        f"{len(real.questions)} tests counted."
    )
    figure = FigureBlock("real_passes", caption, plots.draw_real_passes(record, title="43 passes of 1978"))
    return Section("The real passes, asked", _words(real), [real_passes_table(real)], [figure])


def _words(real: RealPasses) -> list[str]:
    def q(name: str, corrected: bool) -> Question:
        return real.question(name, corrected=corrected)

    day, rest = "night against day", "night against day, without the eastern United States"
    nights = "night over the eastern United States against other nights"
    within = "night against day over the eastern United States"
    days = "day over the eastern United States against other days"
    stations = "station against station"
    return [
        f"{real.overflight.max() + 1} overflights gave the 43 passes; {len(real.questions)} tests are made and counted.",
        f"Night against day: a ratio of {q(day, False).ratio:.2f} (p {_is(q(day, False).p_value)} by itself); one of "
        f"{q(day, False).detectable:.2f} would have been seen. Outside the eastern United States it is "
        f"{q(rest, False).ratio:.2f} (p {_is(q(rest, False).p_value)}; {q(rest, False).detectable:.2f} would have been "
        f"seen): {'nothing is seen that follows' if q(rest, False).p_value > 0.05 else 'something follows'} the night as "
        "such.",
        f"Station against station: they {_differ(q(stations, False))} (p {_is(q(stations, False).p_counted)}, counted). It "
        f"is {_strongest(real)}; nights over the eastern United States have {q(nights, False).ratio:.1f} times the residual "
        f"of other nights (p {_is(q(nights, False).p_counted)}, counted).",
        f"The error of IGRF 1975 along the passes, known today, explains {100 * real.explained:.0f} % of the variance of "
        "the logarithm. "
        f"Once it is out, the stations {_differ(q(stations, True))} (p {_is(q(stations, True).p_value)} by itself; at "
        f"Greenbelt a ratio of {q('ETC against the others', True).detectable:.2f} would have been seen).",
        f"What stays: over the eastern United States nights have {q(within, True).ratio:.2f} times the residual of days "
        f"for the same error of the model ({_both(q(within, True))}); nights there have {q(nights, True).ratio:.2f} times "
        f"that of other nights ({_both(q(nights, True))}), days there {q(days, True).ratio:.2f} times that of other days "
        f"({_both(q(days, True))}). A calibration made with the sunlit passes, which took part of the model's error "
        "there for its own, does this; a field on board at night over the region could too, and 43 residuals without a "
        "direction cannot tell which.",
    ]


def _differ(one: Question) -> str:
    return "differ" if one.certain else "are not seen to differ"


def _both(one: Question) -> str:
    """Both p-values, and what they are worth."""
    worth = "likely" if one.certain else "a hint" if one.p_value < 0.05 else "nothing"
    return f"p {_is(one.p_value)} by itself, {_p(one.p_counted)} counted: {worth}"


def _strongest(real: RealPasses) -> str:
    single = [one for one in real.questions if one.name.endswith("against the others") and not one.corrected]
    best = min(single, key=lambda one: one.p_value)
    name = best.name.split()[0]
    others = sum(one.certain for one in single) - int(best.certain)
    words = "alone stands out" if best.certain and not others else "stands out most"
    return f"{name} that {words} ({best.ratio:.2f} times the others, p {_is(best.p_counted)}, counted)"


def real_passes_table(real: RealPasses) -> Table:
    """All tests."""
    rows: list[list[Cell]] = [
        [one.name, "model's error out" if one.corrected else "as printed", f"{one.passes[0]}, {one.passes[1]}",
         f"{one.ratio:.2f}", _p(one.p_value), _p(one.p_counted),
         "" if np.isnan(one.detectable) else f"{one.detectable:.2f}"]
        for one in real.questions
    ]  # fmt: skip
    return Table(
        "Questions to the 43 residuals",
        ["question", "residual", "passes", "ratio", "p by itself", "p counted", "seen 4 times in 5"],
        rows,
        "Ratio of geometric means; of all stations the largest over the smallest, and numbers of stations and passes. "
        "20,000 permutations of overflights. Counted: Holm's p-value over all tests. Last column: the ratio that would "
        "have been found four times in five.",
    )


def gallery_summary(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """For `summary.json`."""
    return [
        {
            "case": answer.case.key,
            "title": answer.case.title,
            "verdict": answer.diagnosis.verdict,
            "named": answer.name,
            "right": answer.right,
            "where": _place(answer),
            "located": answer.located,
            "parameters": [
                {"name": c.name, "put_in": c.put_in, "found": c.found, "sigma": c.sigma, "unit": c.unit}
                for c in answer.compared
            ],
            "passes_not_used": None if answer.later is None else {
                "unit": answer.later.unit, "before": answer.later.rms[0], "after": answer.later.rms[1],
                "floor": answer.later.floor, "concerned": int(answer.later.concerned.sum()),
                "passes": len(answer.later.labels),
            },
        }
        for answer in answers
    ]  # fmt: skip


def real_passes_summary(real: RealPasses) -> dict[str, Any]:
    """For `summary.json`."""
    return {
        "overflights": int(real.overflight.max()) + 1,
        "tests": len(real.questions),
        "explained_by_igrf1975": real.explained,
        "slope": real.slope,
        "questions": [
            {
                "question": one.name, "model_error_out": one.corrected, "passes": list(one.passes), "ratio": one.ratio,
                "p": one.p_value, "p_counted": one.p_counted,
                "detectable_ratio": None if np.isnan(one.detectable) else one.detectable,
            }
            for one in real.questions
        ],
    }  # fmt: skip


def _size(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2f}"


def _as(value: float, unit: str) -> str:
    """A residual in its unit: hundredths of a degree, whole nT."""
    return f"{value:.2f}" if unit == "deg" else f"{value:.0f}"


def _known(value: float, sigma: float | None) -> str:
    """Rounded to the second digit of its sigma; to four digits where it has none."""
    if not sigma:
        return f"{value:.4g}"
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(sigma))))}f}"


def _is(value: float) -> str:
    text = _p(value)
    return text if text.startswith("<") else f"= {text}"


def _p(value: float) -> str:
    if value < 0.0001:
        return "<\u00a00.0001"
    return f"{value:.4f}" if value < 0.01 else f"{value:.2f}"
