"""A diagnosis as a page and as tables to read: the sentence, then where, which, how far, and what stays open."""

from __future__ import annotations

import re

import numpy as np

from fluxtwin.calib.common.digits import measured, percent, plain, with_sigma
from fluxtwin.calib.common.records import parameter_unit
from fluxtwin.calibration_page import parameter_tables
from fluxtwin.gap.held_out.closing import calibration, can_be_taken_out, reestimated
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED
from fluxtwin.gap.records.diagnosis import Diagnosis, Law
from fluxtwin.gap.report.words import APART_FROM_THEM, FIRST, located, typical_size
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table, with_rows
from fluxtwin.sim.base.files import to_json
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.catalogue import title_of
from fluxtwin.sim.telemetry.record import Telemetry

_CONFUSED = 0.8  # shares below this are in the JSON
_RANKED = 6
_LEAST = 0.01  # probability of a place that is worth a word
_FACTS = {
    "budget: attitude_sigma_rad": "attitude error",
    "budget: attitude_tau_s": "time constant of the attitude error",
    "budget: lsb_nT": "step of the readings",
    "budget: noise_nT": "noise of the readings",
    "noise": "noise model",
}
"""What the page calls a fact of the provenance, where its own name does not say it."""
CORRECT = "fluxtwin apply TELEMETRY --scenario CLOSED.toml --out CORRECTED.nc"
_ALL_TESTED = "Every effect of the catalogue could be tested."


def diagnosis_page(
    diagnosis: Diagnosis,
    title: str,
    *,
    record: Telemetry | None = None,
    source: str = "TELEMETRY",
    correct: str = CORRECT,
    closed: str = "",
) -> Page:
    """The page of one diagnosis; record: the telemetry that was diagnosed; the others as `next_step`."""
    far = _far(diagnosis, record)
    seen = [one for one in far.figures if one.name in ("field", "gap_series")]
    as_it_stands = [PageSection("The residual of the file as it stands", [], [], seen)]
    # What the answer says beyond its first sentence, and no later section says again.
    rest = [one for one in _sentences(diagnosis)[1:] if not one.startswith("It resembles ")]
    rest = [*what_lines(diagnosis), *rest, *second_lines(diagnosis)]
    return Page(
        title=title,
        verdict=_sentences(diagnosis)[0],
        next_step=next_step(diagnosis, source, correct, closed),
        sections=[
            *([PageSection("What it means", rest)] if rest else []),
            *(as_it_stands if _wrong_file(diagnosis) else _found(diagnosis, record, far)),
        ],
        provenance=_provenance(diagnosis),
        downloads={"diagnosis.json": to_json(diagnosis.to_dict())},
    )


def _found(diagnosis: Diagnosis, record: Telemetry | None, far: PageSection) -> list[PageSection]:
    """What was found, what not, and what could not be. far: how far the gap shrinks."""
    elsewhere, open_ = with_rows(transfer_table(diagnosis)), with_rows(untestable_table(diagnosis))
    could = [detectable_table(diagnosis), *with_rows(confused_table(diagnosis))]
    words = []
    if diagnosis.verdict == "unknown":
        words.append("The residual has structure that no effect in the catalogue explains, so none is named.")
    if diagnosis.resembles:
        words.append(f"It resembles {', '.join(diagnosis.resembles)}.")
    groups = [effect.group for effect in diagnosis.effects if len(effect.group) > 1]
    words += [f"{' and '.join(group)} cannot be distinguished in these data." for group in groups]
    shown = with_rows(effects_table(diagnosis), rivals_table(diagnosis), ranking_table(diagnosis))
    return [
        far,
        *_parameters(diagnosis),
        _where(diagnosis),
        PageSection("Which effect causes it", words or ([] if diagnosis.effects else ["None is named."]), shown),
        *_law(diagnosis),
        *([PageSection("Where the closed scenario holds", [], elsewhere)] if elsewhere else []),
        PageSection("What could not be tested", [] if open_ else [_ALL_TESTED], open_),
        PageSection("What these data could show", [], could, _coverage(diagnosis, record)),
    ]


def _parameters(diagnosis: Diagnosis) -> list[PageSection]:
    """The calibration that was re-estimated, as the page of a calibration shows it."""
    if diagnosis.closure is None or not diagnosis.modelled:
        return []
    beside = "together with the named effects" if diagnosis.effects else "without other effects"
    words = f"Re-estimated {beside}. The sigmas contain noise and attitude error only"
    more = "; the gap may have moved a value by more." if diagnosis.verdict == "unknown" else "."
    tables = [*parameter_tables(calibration(diagnosis.closure)), *_reestimated(diagnosis)]
    return [PageSection("Parameters", [words + more], tables)]


def _reestimated(diagnosis: Diagnosis, *, with_calibration: bool = False) -> list[Table]:
    """Values of the effects that were re-estimated, one a row; with_calibration: also S, b and T."""
    if diagnosis.closure is None:
        return []
    rows = []
    if with_calibration:
        known = calibration(diagnosis.closure)
        marks = {"scale_misalignment": "S", "bias": "b", "torquer_coupling": "T"}
        for name, value in zip(known.names, known.values, strict=True):
            effect = next((one for one, mark in marks.items() if name.startswith(mark)), "")
            if effect in diagnosis.modelled:
                rows.append([effect, name, *with_sigma(float(value), known.sigma[name]), parameter_unit(name)])
    for effect, parameters in reestimated(diagnosis.closure).items():
        rows += [[effect, key, *with_sigma(one.value, one.sigma), one.unit] for key, one in parameters.items()]
    return with_rows(Table("Re-estimated", ["effect", "parameter", "value", "sigma", "unit"], rows))


def _sentences(diagnosis: Diagnosis) -> list[str]:
    """The answer, a sentence each."""
    return re.split(r"(?<=\.) (?=[A-Z])", diagnosis.sentence)


def _coverage(diagnosis: Diagnosis, record: Telemetry | None) -> list[FigureBlock]:
    """The sky of the body, of the readings as the diagnosis calibrates them."""
    series, closure = diagnosis.series, diagnosis.closure
    if record is None or series is None or closure is None:
        return []
    from fluxtwin.calib.common.coverage import counted
    from fluxtwin.evidence import coverage_block

    rows = np.isin(record.time, series.time if series.cut is None else series.time[~series.cut])
    fitted = {effect.name: theta for effect, theta in closure.modelled}
    S, b_nT = fitted.get("scale_misalignment", np.zeros(9)), fitted.get("bias", np.zeros(3))
    reading = record.mag_B_nT[rows]
    return [coverage_block(*counted(reading + reading @ S.reshape(3, 3).T + b_nT))] if rows.any() else []


def correcting(diagnosis: Diagnosis, command: str) -> str:
    """The command with what it does; empty where nothing that is named can be taken out of readings or positions."""
    closure = diagnosis.closure
    named = [] if closure is None else [effect for effect, _ in closure.chosen]
    named += [] if closure is None else [one.effect for one in closure.stochastic if one.effect is not None]
    taken = [effect.name for effect in named if can_be_taken_out(effect)]
    return f"{command} corrects the telemetry with {' and '.join(taken)} taken out" if taken else ""


def next_step(diagnosis: Diagnosis, source: str = "TELEMETRY", correct: str = CORRECT, closed: str = "") -> str:
    """What to do now, as terminal and page say it.

    source: what names and reads the telemetry in a command. correct: the command that corrects it with a closed scenario.
    closed: the scenario that was written with the effects that are named; empty for none.
    """
    if diagnosis.sentence.startswith(FIRST):
        return "correct the file, and diagnose again."
    if diagnosis.verdict == "no_gap" and diagnosis.provenance.get("two_magnetometers", {}).get("differ"):
        return f"fluxtwin diagnose {source} --magnetometer 2: the two magnetometers differ, and the first shows no gap."
    if diagnosis.verdict == "no_gap":
        return "nothing needs correcting. The tables say what these data could not have shown."
    if APART_FROM_THEM in diagnosis.sentence:
        return "find out why these rows are wrong, or leave their readings blank; the others need nothing."
    alike = any(len(effect.group) > 1 for effect in diagnosis.effects)
    unsure = alike or diagnosis.verdict == "unknown"
    if unsure and not closed:
        return f"fluxtwin plan {source}, which proposes what to fly to find out."
    done = correcting(diagnosis, correct)
    if closed:
        done = done or f"fluxtwin simulate {closed} --out simulated.nc simulates with the named effects"
        test = f"diagnose the telemetry of another day with --scenario {closed}"
        asked = f"fluxtwin plan {source} proposes what to fly to find out {'which it is' if alike else 'more'}"
        return f"{done}; {asked if unsure else test}."
    if diagnosis.transfers is not None:
        return f"{done and f'{done}; '}diagnose the telemetry of another day with the closed scenario (--scenario)."
    close = f"fluxtwin diagnose {source} --close CLOSED.toml; "
    return f"{close}{done and f'{done}; '}test the scenario on the telemetry of another day."


def tables(diagnosis: Diagnosis) -> list[Table]:
    """The tables for the terminal, in order."""
    if _wrong_file(diagnosis):
        return []
    law, whole = diagnosis.law, untestable_table(diagnosis)
    rows = [[name, f"{why}. To settle it: {cure}" if cure else why] for name, why, cure in whole.rows]
    usual = set(diagnosis.modelled) == set(DEFAULT_MODELLED)
    return with_rows(
        effects_table(diagnosis),
        *([] if usual else _reestimated(diagnosis, with_calibration=True)),
        *([ranking_table(diagnosis)] if diagnosis.verdict == "unknown" else []),
        *([law_table(law)] if law is not None and law.terms else []),
        far_table(diagnosis),
        *momentum_tables(diagnosis),
        transfer_table(diagnosis),
        Table(whole.title, whole.columns[:2], rows),
        small_table(diagnosis),
    )


def lines(diagnosis: Diagnosis) -> list[str]:
    """What follows the answer: what the named effects are, where the gap lies, what a second magnetometer says."""
    named = [] if _wrong_file(diagnosis) else what_lines(diagnosis)
    return [*named, *where_lines(diagnosis), *second_lines(diagnosis)]


def where_lines(diagnosis: Diagnosis) -> list[str]:
    """Where the gap lies, in words; empty where there is none, and for a file that is wrong."""
    if diagnosis.verdict == "no_gap" or _wrong_file(diagnosis):
        return []
    return located(diagnosis.where)


def what_lines(diagnosis: Diagnosis) -> list[str]:
    """What the named effects are, for a person."""
    names = dict.fromkeys(name for effect in diagnosis.effects for name in effect.group or (effect.name,))
    return [f"{name}: {title[0].lower()}{title[1:]}." for name in names if (title := title_of(name))]


def second_lines(diagnosis: Diagnosis) -> list[str]:
    """What was used of a second magnetometer, and how to ask it; empty where there is none, or none that could be used."""
    pair = diagnosis.provenance.get("two_magnetometers")
    if not pair or _wrong_file(diagnosis):
        return []
    gone = pair["ruled_out"]
    used = f"rules out {' and '.join(gone)}" if gone else "rules out no cause"
    return [
        f"After a calibration of each, the two magnetometers differ by {pair['apart_nT']:.3g} nT rms, and their noise "
        f"explains {pair['noise_nT']:.3g} nT. This {used}. For more about the other one: "
        f"--magnetometer {pair['other']}, or fluxtwin calibrate --both."
    ]


def _wrong_file(diagnosis: Diagnosis) -> bool:
    """Whether no cause is named and `fluxtwin check` finds the file wrong: what else was found may be of that alone."""
    return diagnosis.verdict != "effect" and diagnosis.sentence.startswith(FIRST)


def _where(diagnosis: Diagnosis) -> PageSection:
    if diagnosis.verdict == "no_gap":
        return PageSection("Where the gap lies", ["There is none, so no place is shown."])
    return PageSection("Where the gap lies", where_lines(diagnosis), [places_table(diagnosis)])


def places_table(diagnosis: Diagnosis) -> Table:
    """The likeliest places of each kind; those below 1 % are left out."""
    rows = []
    for kind, shares in diagnosis.where.to_dict()["probabilities"].items():
        likely = sorted(((share, name) for name, share in shares.items() if share >= _LEAST), reverse=True)
        words = [f"{name} {percent(share)}" for share, name in likely]
        rows.append([kind, words[0] if words else "", ", ".join(words[1:]) or "nothing else"])
    return Table("Places by probability", ["", "likeliest", "else"], rows)


def _law(diagnosis: Diagnosis) -> list[PageSection]:
    law = diagnosis.law
    if law is None:
        return []
    title = "A law for what the catalogue does not explain"
    if not law.terms:
        return [PageSection(title, [], [looked_at_table(law)])] if law.looked_at else []
    from fluxtwin.plots.gap import draw_law

    caption = (
        "Dots: the residual without this term, along its direction, against what the term follows. "
        "Circles: means of equal counts, with their standard error. Line: the term."
    )
    figures = [FigureBlock("gap_law", caption, draw_law(law.fitted))] if law.fitted else []
    return [PageSection(title, [], [law_table(law)], figures)]


def law_table(law: Law) -> Table:
    """The terms of a law with their coefficients."""
    rows = []
    for term in law.terms:
        left = ["law." + term.name, " x ".join(term.of), term.axes, f"{term.delay_s:.3g}", f"{term.lag_s:.3g}"]
        for axis, (value, sigma) in term.coefficients.items():
            rows.append([*left, f"k_{axis} [{term.unit}]", measured(value, sigma)])
            left = [""] * len(left)
    closed = _closed(law.closed, law.interval)
    return Table(
        "The law",
        ["term", "of", "axes", "delay [s]", "lag [s]", "coefficient", "value, 1 sigma"],
        rows,
        f"On held-out samples from {law.before_nT:.1f} to {law.after_nT:.1f} nT, where {law.floor_nT:.1f} are expected: "
        f"it closes {closed}. {law.tried:,} terms were tried, and the criterion corrects for their number. "
        "Delay and lag apply to the first factor.",
    )


def looked_at_table(law: Law) -> Table:
    """What a law was looked for in, and the smallest size that would have shown."""
    rows = [[one.quantity, plain(one.value), one.unit, plain(one.visible_nT, 2)] for one in law.looked_at]
    return Table(
        "What was tried, and the smallest size that would have shown",
        ["quantity", "smallest that shows", "unit", "rms [nT]"],
        rows,
        "For each quantity as recorded, in body axes, equal on all axes, with a 90 % chance of being found. Delays, lags, "
        "powers, other frames and products were tried too.",
    )


def _far(diagnosis: Diagnosis, record: Telemetry | None) -> PageSection:
    figures = []
    series = diagnosis.series
    if series is not None:
        from fluxtwin.evidence import driver_blocks, field_block
        from fluxtwin.plots.gap import draw_spectra, gap_series

        dots = (
            "Residual: reading minus prediction, in body axes. Dots: samples, predicted by an estimate that has not seen "
            "them. Lines: means over equal stretches."
        )
        spectra = (
            "Amplitude of the residual by frequency, rms over the axes and over neighbouring frequencies. "
            + ("The named effects explain the difference between the two curves. " if diagnosis.effects else "")
            + "The level on the right is noise."
        )
        field, aside_nT = [], None
        if record is not None:
            rows = record.select(np.isin(record.time, series.time))
            words = "Predicted: the model with the calibration re-estimated, before any effect is named."
            parts = {"residual": series.before_nT}
            if diagnosis.effects:
                parts = {"before": series.before_nT, "after": series.after_nT}
            aside = np.zeros(len(rows), dtype=np.bool_) if series.cut is None else series.cut
            if not np.isfinite(series.before_nT[~aside]).any(axis=1).all():
                words += " Rows that the rest of the record does not determine have no prediction."
            field = [field_block(rows, rows.mag_B_nT, rows.mag_B_nT - series.before_nT, words, aside)]
            figures = driver_blocks(rows, parts)
            if aside.any():
                aside_nT = _residual_aside(rows, series.before_nT, aside)
                dots += " Crosses: rows set aside, against the prediction of their neighbours. Arrows: values beyond."
        gap = FigureBlock("gap_series", dots, gap_series(series, aside_nT))
        figures = [*field, gap, *figures, FigureBlock("gap_spectra", spectra, draw_spectra(series))]
    return PageSection("How much of it is closed", [], [far_table(diagnosis), *momentum_tables(diagnosis)], figures)


def _residual_aside(rows: Telemetry, residual_nT: FloatArray, aside: BoolArray) -> FloatArray:
    """(N, 3) residual of the rows set aside, NaN elsewhere; they have no prediction, so between those of the neighbours."""
    made, stamps = np.full(residual_nT.shape, np.nan), rows.time.astype(np.int64)
    for axis, (reading, residual) in enumerate(zip(rows.mag_B_nT.T, residual_nT.T, strict=True)):
        known = np.isfinite(residual) & ~aside
        if known.any():
            expected = np.interp(stamps[aside], stamps[known], (reading - residual)[known])
            made[aside, axis] = reading[aside] - expected
    return made


def effects_table(diagnosis: Diagnosis) -> Table:
    """Named effects with parameters."""
    rows = []
    for effect in diagnosis.effects:
        label = " / ".join(effect.group) or effect.name
        about = [percent(effect.probability), effect.stage, _p_value(effect.significance)]
        for name, parameter in effect.parameters.items():
            unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
            rows.append([label, f"{name}{unit}", measured(parameter.value, parameter.sigma), *about])
            label, about = "", [""] * len(about)
        if not effect.parameters:
            rows.append([label, "", "", *about])
    known = [(one.name, one.settings.get("assumed")) for one in diagnosis.effects]
    assumed = "".join(f" The parameters of {name} are the field {words}." for name, words in known if words)
    return Table(
        "Named effects",
        ["effect", "parameter", "value, 1 sigma", "probability", "stage", "p-value"],
        rows,
        f"p-value: how often noise alone would look this good, corrected for the number of tests.{assumed}",
    )


def rivals_table(diagnosis: Diagnosis) -> Table:
    """Less likely alternatives to what is named."""
    rows = [
        [effect.name, name, percent(probability)] for effect in diagnosis.effects for name, probability in effect.rivals
    ]
    return Table("Rivals", ["instead of", "it could be", "probability"], rows)


def momentum_tables(diagnosis: Diagnosis) -> list[Table]:
    """The balance of the momentum; none where there is none."""
    m = diagnosis.momentum
    if m is None:
        return []
    dynamic = any(effect.stage == "dynamics" for effect in diagnosis.effects)
    closed = "not measurable" if dynamic else "nothing named"
    closed = _closed(m.closed, m.interval) or closed
    errors = [
        f"{axis} {value:.3f}" + ("" if sigma is None else f" ± {sigma:.3f}")
        for axis, (value, sigma) in m.standing_error_deg.items()
    ]
    standing = f" Constant attitude error in body axes: {', '.join(errors)} deg." if errors else ""
    return [
        Table(
            "Misfit of the attitude to the momentum balance, rms per component on held-out windows [deg]",
            ["windows", "before", "after", "expected", "closed (90 %)"],
            [[str(m.windows), f"{m.before_deg:.3f}", f"{m.after_deg:.3f}", f"{m.floor_deg:.3f}", closed]],
            f"Windows of up to {m.window_s / 60.0:.0f} min, each with a free initial state. Expected: {m.noise}.{standing}",
        )
    ]


def _closed(share: float | None, interval: tuple[float, float] | None) -> str:
    if share is None:
        return ""
    bounds = "" if interval is None else f" ({100 * interval[0]:.0f} to {100 * interval[1]:.0f} %)"
    return f"{100 * share:.0f} %{bounds}"


def far_table(diagnosis: Diagnosis) -> Table:
    """Before, after and floor."""
    g = diagnosis.gap
    closed = "nothing to close" if diagnosis.verdict == "no_gap" else "not measurable"
    if diagnosis.verdict == "unknown" and not diagnosis.effects:
        closed = "nothing is named"
    if {effect.name for effect in diagnosis.effects} == {"bit_errors"}:
        closed = "cut from both"
    closed = _closed(g.closed, g.interval) or closed
    floors = [f"{g.floor_nT:.1f}", f"{g.floor_with_effects_nT:.1f}"]
    rows = [["all", f"{g.before_nT:.1f}", f"{g.after_nT:.1f}", *floors, closed]]
    rows += [
        [axis, f"{values['before_nT']:.1f}", f"{values['after_nT']:.1f}", "", "", ""]
        for axis, values in g.per_axis.items()
    ]
    held_out = "Both are predictions of samples that were not fitted."
    if g.prediction == "fit":
        held_out = (
            "Both are residuals of the fit itself: one part of this record does not determine the calibration and the best "
            "fit from the catalogue together well enough to predict another, so nothing is held out in this table."
        )
    return Table(
        f"The gap, rms per component {'in the fit' if g.prediction == 'fit' else 'on held-out samples'} [nT]",
        ["axis", "before", "after", "expected", "expected with effects", "closed (90 %)"],
        rows,
        f"Before: calibration re-estimated. After: named effects included. {held_out} Expected: from noise, "
        "quantisation, attitude error and the error of the prediction; with effects: from named noise as well.",
    )


def transfer_table(diagnosis: Diagnosis) -> Table:
    """For which other designs each named effect is good enough; designs with one and the same reason share a row."""
    rows: list[list[str]] = []
    for one in diagnosis.transfers or ():
        answer = "yes" if one.transfers else "no"
        answer += f": {one.why}" if one.why else ""
        size, bar = ("" if value is None else f"{value:.3g}" for value in (one.uncertainty_nT, one.detectable_nT))
        chance = "" if one.chance is None else percent(one.chance)
        if rows and not chance and [one.effect, answer, ""] == [rows[-1][0], rows[-1][2], rows[-1][5]]:
            rows[-1][1] = "any other"
        else:
            rows.append([one.effect, one.design, answer, size, bar, chance])
    return Table(
        "Would the closed scenario hold elsewhere?",
        ["effect", "design", "transfers", "error [nT]", "detectable [nT]", "chance"],
        rows,
        "Error: rms per component caused there by the uncertainty of the parameters, after the calibration is re-estimated. "
        "Detectable: the smallest such error that would be seen. "
        "Chance: the probability that a diagnosis of as many samples there finds a gap; an effect transfers up to 5 %. "
        "Housekeeping is assumed to repeat, or to follow the sunlight as it does here.",
    )


def ranking_table(diagnosis: Diagnosis) -> Table:
    """The best effects alone."""
    lines = diagnosis.ranking[:_RANKED]
    named = {name for effect in diagnosis.effects for name in effect.group}
    rows = [
        [
            line.name + (" (named)" if line.name in named else ""),
            f"{line.drop:.1f}",
            str(line.directions),
            _p_value(line.p_value),
        ]
        for line in lines
    ]
    return Table(
        f"The {len(lines)} most significant of {len(diagnosis.ranking)} effects, each tested alone",
        ["effect", "drop of chi-square", "parameters seen", "p-value"],
        rows,
        "Tested before any effect is named, so effects that imitate a cause rank high too. The p-value is corrected for the "
        "number of tests; near 1 means no better than chance.",
    )


def small_table(diagnosis: Diagnosis) -> Table:
    """Effects that are tested, but not down to their typical size; those that are named are seen."""
    named = {effect.name for effect in diagnosis.effects}
    words = diagnosis.would_settle
    rows = [[name, words[name]] for name in diagnosis.minimum_detectable if name in words and name not in named]
    note = "To see them, run fluxtwin plan on the same file: it proposes what to fly."
    note = "" if "fluxtwin plan" in next_step(diagnosis) else note
    return Table("Not detectable at typical size", ["effect", "what would show it"], rows, note)


def untestable_table(diagnosis: Diagnosis) -> Table:
    """Effects this design cannot show, why, and what would; those with one reason share a row."""
    names: dict[tuple[str, str], list[str]] = {}
    for name, why in diagnosis.untestable.items():
        names.setdefault((why, diagnosis.would_settle.get(name, "")), []).append(name)
    rows = [[", ".join(alike), why, settle] for (why, settle), alike in names.items()]
    return Table("Untestable here, not absent", ["effect", "why", "what would settle it"], rows)


def detectable_table(diagnosis: Diagnosis) -> Table:
    """The smallest sizes this design shows, beside typical ones."""
    rows = []
    for name, d in diagnosis.minimum_detectable.items():
        unit = "" if d.unit == "1" else f" [{d.unit}]"
        typical = typical_size(name, d.parameter)
        advice = diagnosis.would_settle.get(name, "").partition(": ")
        shown = "" if typical is None else f"{abs(typical):g}"
        rows.append(
            [name, f"{d.parameter}{unit}", plain(d.value), shown, plain(d.visible_nT, 2), advice[2] or advice[0]]
        )
    return Table(
        "Minimum detectable sizes",
        ["effect", "parameter", "smallest that shows", "typical", "visible rms [nT]", "to see the typical size"],
        rows,
        "Detected with a probability of 90 %, with 0.2 % false alarms over all tests. The last column is blank where these "
        "data show the typical size. To see half the size takes four times the data.",
    )


def confused_table(diagnosis: Diagnosis) -> Table:
    """Pairs that imitate each other on this orbit and attitude, whatever the data say."""
    best: dict[tuple[str, str], float] = {}
    for name, shares in diagnosis.isolability.items():
        for other, share in shares.items():
            pair = (name, other)
            if share >= _CONFUSED and best.get((other, name), 0.0) < share:
                best.pop((other, name), None)
                best[pair] = share
    ordered = sorted(best.items(), key=lambda item: -item[1])
    rows = [[name, other, f"{100 * share:.0f} %"] for (name, other), share in ordered]
    return Table(
        "Confused with each other on this orbit and attitude",
        ["effect", "can be imitated by", "share"],
        rows,
        "This follows from orbit, attitude and columns, not from the readings. Two effects that imitate each other by 98 % "
        "or more are named as a group.",
    )


def _p_value(value: float) -> str:
    return "< 1e-12" if value < 1e-12 else f"{value:.1e}" if value < 0.01 else f"{value:.2g}"


def _provenance(diagnosis: Diagnosis) -> dict[str, str]:
    unused = [("rows_thinned_by", 1), ("rounding_lasts_rows", 1)]  # a list: a fact may be a mapping
    known = {key: value for key, value in diagnosis.provenance.items() if key not in ("design", "posterior")}
    facts = {
        _FACTS.get(key, key.replace("_", " ")): str(known[key]) for key in known if (key, known[key]) not in unused
    }
    lines = facts | {"notes": "; ".join(note for note in diagnosis.notes if note not in facts.values())}
    lines["modelled, re-estimated in every test"] = ", ".join(diagnosis.modelled) or "none"
    names = {"used": "used", "cut": "cut as spikes", "without_attitude": "without attitude"}
    lines["samples"] = ", ".join(f"{diagnosis.samples[key]} {words}" for key, words in names.items())
    return {key: value for key, value in lines.items() if value}
