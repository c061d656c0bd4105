"""What came out, in words; every number is computed."""

from __future__ import annotations

import numpy as np

from fluxtwin.gap import advice
from fluxtwin.gap.records import Diagnosis, FoundEffect
from fluxtwin.scenarios.flight_gaps.cases import SWARM, names_of
from fluxtwin.scenarios.flight_gaps.compute import STORM_NT, Answer, Outcome
from fluxtwin.sim.effects.catalogue import find_effect

SUSPICIOUS = 100.0
"""Times its typical size: a parameter as large as that is no effect of its name."""


def verdict(outcome: Outcome) -> str:
    """The status line of the study."""
    foretold = [answer for answer in outcome.answers if answer.agrees is not None]
    met = [answer for answer in foretold if answer.agrees]
    spoilt = sum(bool(answer.wrong) for answer in met)
    return (
        f"{len(met) - spoilt} of {len(foretold)} answers to records that flew are as foretold, {spoilt} more are but give "
        f"a wrong name as well, {len(foretold) - len(met)} are not."
    )


def as_foretold(answer: Answer) -> str:
    """Whether the answer says what was foretold, and what else it says."""
    if answer.agrees is None:
        return "nothing foretold"
    wrong = f"; wrong: {', '.join(answer.wrong)}" if answer.wrong else ""
    return ("yes" if answer.agrees else "no") + wrong


def names(found: Diagnosis) -> str:
    """The names of an answer, groups by slashes."""
    return ", ".join(" / ".join(effect.group) or effect.name for effect in found.effects) or "none"


def oversized(effect: FoundEffect) -> str | None:
    """The parameter of a named effect that is most above its typical size, if it is absurdly so."""
    ratios = {}
    for name, value in effect.parameters.items():
        typical = advice.typical_size(effect.name, name)
        if typical:
            ratios[name] = abs(value.value / typical)
    if not ratios:
        return None
    worst = max(ratios, key=lambda name: ratios[name])
    if ratios[worst] < SUSPICIOUS:
        return None
    value = effect.parameters[worst]
    unit = "" if value.unit == "1" else f" {value.unit}"
    return f"{effect.name} {worst} of {value.value:.3g}{unit} is {ratios[worst]:.0f} times its typical size"


def doubts(answer: Answer) -> list[str]:
    """What a reader should hold against an answer: absurd sizes, and names that predict worse than none."""
    found = answer.found
    said = [words for effect in found.effects if (words := oversized(effect)) is not None]
    if found.effects and found.gap.after_nT > found.gap.before_nT:
        said.append(
            f"on held-out samples the names leave {found.gap.after_nT:.0f} nT where none of them leaves "
            f"{found.gap.before_nT:.0f}"
        )
    return said


def storm(outcome: Outcome) -> list[str]:
    """Swarm A in the storm."""
    table, bare, full = outcome.storm, outcome.answer("storm-none").found, outcome.answer("storm-default").found
    ring, first = bare.ranking[0], {line.name: line for line in bare.ranking}
    bias = first["bias"]
    arc, orbit, whole = (outcome.storm_visible[place] for place in (0, -2, -1))
    said = [
        f"Nothing modelled: the residual to IGRF-14 is {table.raw_nT:.0f} nT. By plain least squares one number, the "
        f"ring current, leaves {table.left_nT('ring_current'):.1f}; a constant b leaves {table.left_nT('bias'):.1f} "
        f"with three numbers, S {table.left_nT('scale_misalignment'):.1f} with nine (an independent look had 35, 31 and "
        "26). On one short arc of a satellite that keeps its axes along the orbit the three draw the same curve.",
        f"The diagnosis ranks {ring.name} first ({ring.drop:.1f} off chi-square with {ring.directions}; bias "
        f"{bias.drop:.1f} with {bias.directions}) because fewer numbers do as well. Its answer: {names(bare)}. "
        + _sure(bare),
        f"With b and S modelled ring_current is {_state(full, 'ring_current')}: of a ring current of "
        f"{STORM_NT:.0f} nT, {arc[2]:.0f} nT rms along this arc, {arc[3]:.3f} nT are left once b and S are free "
        f"(independent: 0.04 of 48). What would settle it, it says: {find_effect('ring_current').settled_by}.",
        f"The arc is too short, not the attitude too quiet: with b and S free, a whole orbit leaves {orbit[3]:.1f} of "
        f"{orbit[2]:.0f} nT of it, a day {whole[3]:.1f}. So one whole orbit of the storm would split the names, or a "
        "calibration from before it: with b and S known, a constant b of a hundred nT is no rival.",
    ]
    if full.verdict != "no_gap":
        said.append(
            f"What is left with b and S free is called {full.verdict}: {left(full)}. The arc ends at the limit of low "
            "latitude, where in this storm the auroral currents are felt already (see the study flight-field). On so "
            f"short a record the held-out figure ({full.gap.before_nT:.0f} nT before) is an extrapolation of twelve "
            "parameters and means nothing."
        )
    return said


def magsat(outcome: Outcome) -> list[str]:
    """MAGSAT, four wrong or right models."""
    said = []
    for name in ("magsat-degree-8", "magsat-igrf1975-held", "magsat-igrf1975-carried", "magsat-igrf14"):
        answer = outcome.answer(name)
        wanted = f" Foretold: {answer.case.expected}." if answer.case.expected else ""
        against = doubts(answer)
        but = f" Against it: {'; '.join(against)}." if against else ""
        said.append(f"{answer.case.title}. {answer.found.sentence}{wanted}{but}")
    cut = outcome.answer("magsat-degree-8")
    if not cut.agrees:
        table = outcome.magsat["degree 8, orbit"]
        said.append(
            f"By a plain fit field_truncation takes {table.base_nT:.1f} to {table.left_nT('field_truncation'):.1f} nT at "
            f"degree 8, with a share of {table.size('field_truncation'):.2f} where 1 is all that is missing, and it is "
            f"{'first' if cut.found.ranking[0].name == 'field_truncation' else 'not first'} of the ranking. The diagnosis "
            "does not confirm it, because something else is left (the aurora, a second in time) that further names take "
            "up and do not hold; whether it should confirm the first of such a list is open."
        )
    said.append(
        "In one orbit of a satellite that keeps its axes along the orbit, the field in body axes runs over few "
        "directions, so products of its components, steps and eddy currents imitate any smooth error of the field. A "
        "name must keep its parameters from part to part of the record, which takes most polynomials out; whether its "
        "sizes can be, the list does not ask."
    )
    return said


def remains(outcome: Outcome) -> list[str]:
    """What IGRF-14 leaves of MAGSAT, and why an epoch helps."""
    nec, orbit = outcome.magsat["IGRF-14, NEC"], outcome.magsat["IGRF-14, orbit"]
    bands = outcome.magsat_left.bands()
    rest = nec.left_nT("along_track_error"), nec.left_nT("along_track_error", "field_epoch")
    return [
        f"With IGRF-14 and b and S free, {orbit.base_nT:.1f} nT are left: {bands[0][3]:.0f} nT rms below "
        f"{bands[0][1]:g} deg of latitude, {bands[-1][3]:.0f} nT beyond {bands[-1][0]:g} deg. It grows where the auroral "
        f"currents are; Kp was {outcome.kp[0]:.1f} during the track and rose to {outcome.kp.max():.0f} that day.",
        f"In north, east, centre axes, with b and S free, field_epoch takes {nec.base_nT:.1f} to "
        f"{nec.left_nT('field_epoch'):.1f} nT with {nec.size('field_epoch'):+.1f} years (an independent look: 39.5 to "
        f"30.2 with +1.8). An error along the track does far more: {rest[0]:.1f} nT left with "
        f"{nec.size('along_track_error'):.1f} km, about a second of flight; beside it field_epoch takes next to nothing "
        f"({rest[1]:.1f} nT, {nec_epoch(outcome):+.2f} years). So the years stood in for the second, and say nothing "
        "of the file's date, which is from its name.",
        f"In the axes of the orbit S takes most of that second itself, as a turn in pitch: {orbit.base_nT:.1f} nT are "
        f"left, {orbit.left_nT('field_epoch'):.1f} with field_epoch ({orbit.size('field_epoch'):+.1f} years), "
        f"{orbit.left_nT('along_track_error'):.1f} with an error along the track.",
    ]


def nec_epoch(outcome: Outcome) -> float:
    """Years of field_epoch beside an error along the track."""
    shares = outcome.magsat["IGRF-14, NEC"].shares
    return next(share.sizes[1] for share in shares if share.effects == ("along_track_error", "field_epoch"))


def swarm(outcome: Outcome) -> list[str]:
    """Three satellites, one story or not."""
    answers = [answer for answer in outcome.answers if answer.case.part == SWARM]
    stories = {(a.found.verdict, a.found.where.stage) for a in answers}
    told = "; ".join(
        f"{a.case.title.partition(',')[0]}: {a.found.verdict}, stage {a.found.where.stage}, resembling "
        f"{', '.join(a.found.resembles) or 'nothing'}"
        for a in answers
    )
    alike = "The three tell one story" if len(stories) == 1 else "The three do not tell one story"
    if len(stories) == 1 and len({tuple(a.found.resembles) for a in answers}) > 1:
        alike += " but for what it resembles"
    told = f"{alike}: {told}."
    cut = ", ".join(f"{a.found.samples['cut']} of {a.found.samples['cut'] + a.found.samples['used']}" for a in answers)
    spurious = [a.case.title for a in answers if "bit_errors" in names_of(a.found)]
    return [
        told + " The residuals are those to CHAOS, so core, crust and ring current are taken off already, and what is "
        "left are currents that no effect of the catalogue describes.",
        f"Rows cut as spikes: {cut}; {_polar(answers)} beyond 60 deg of latitude, where over the auroral currents the "
        "field changes faster than a sample. "
        + ("Bit errors are named: " + ", ".join(spurious) if spurious else "No bit errors are named")
        + ".",
    ]


def dmsp(outcome: Outcome) -> list[str]:
    """Two days in spacecraft axes."""
    said = []
    for name in ("dmsp-f16", "dmsp-f14"):
        answer = outcome.answer(name)
        found, (filled, cut) = answer.found, outcome.fill_rows[name]
        said.append(
            f"{answer.case.title}: {found.verdict}, stage {found.where.stage}: {left(found)}. Rows cut: "
            f"{found.samples['cut']}"
            + (f"; of {filled} with a fill value of a million nT {cut}" if filled else "")
            + "."
        )
    said.append(
        "A fill value is no bit error, and none is named: it is cut and counted, as a spike is. The axes (x down, y "
        f"forward) are assumed; from row to row beyond 65 deg F16 changes by {_steps(outcome.answer('dmsp-f16'))} nT rms "
        "in x, y, z, and the down component is the quiet one, as it must be over currents along the field. The model that "
        "the ground processing took off is not in the file."
    )
    return said


def aircraft(outcome: Outcome) -> list[str]:
    """The aircraft."""
    c = outcome.coefficients
    found = outcome.answer("aircraft-eddy_current").found
    named = {effect.name: effect for effect in found.effects}.get("eddy_current")
    said = [
        "The file has a fluxgate, a scalar magnetometer and its published compensation, and neither time, place nor "
        "attitude. The record is built from the published values alone: the scalar reading along the fluxgate's "
        "direction, at a place where a dipole has the compensated size, without attitude. So the gap is what the "
        f"aircraft adds along the field. Eighteen coefficients repeat the published compensation to {c.worst_nT:.1g} nT; "
        f"its permanent part is {c.parts_nT[0]:.2f} nT rms along the field, the induced {c.parts_nT[1]:.2f}, the eddy "
        f"part {c.parts_nT[2]:.3f}, of which {c.antisymmetric_nT:.3f} are antisymmetric, which eddy_current has not.",
        "Asked for everything at once: " + outcome.answer("aircraft-none").found.sentence,
    ]
    for name in ("bias", "scale_misalignment", "eddy_current"):
        answer = outcome.answer(f"aircraft-{name}")
        said.append(f"{answer.case.title}: {answer.found.sentence}")
    if named is not None:
        said.append(
            "The eddy terms are named, at the stage spacecraft, and said to be incomplete, which they are: the "
            "antisymmetric part has nowhere to go but into the symmetric one, so signs and order of size are right and "
            "the numbers are not."
        )
    said.append(
        "Along one slow turn the size of the field hardly tells b from S, nor either from steps and polynomials of the "
        "reading. Box patterns (pitch, roll and yaw on four headings), which compensation flights make, are what would "
        "split them."
    )
    return said


def _polar(answers: list[Answer]) -> str:
    """How many of the rows cut lie beyond 60 deg of latitude."""
    beyond = sum(int((answer.cut & (np.abs(answer.latitude_deg) > 60.0)).sum()) for answer in answers)
    return f"{beyond} of the {sum(int(answer.cut.sum()) for answer in answers)}"


def _steps(answer: Answer) -> str:
    """rms of the change from row to row beyond 65 deg, by axis."""
    polar = np.abs(answer.latitude_deg[1:]) > 65.0
    change = np.diff(answer.left_nT, axis=0)[polar]
    if not np.isfinite(change).any():
        return "nothing that is known"
    return ", ".join(f"{value:.0f}" for value in np.sqrt(np.nanmean(np.square(change), axis=0)))


def _sure(found: Diagnosis) -> str:
    first = found.effects[0] if found.effects else None
    if first is None:
        return "Nothing is put first, which is the honest answer."
    if first.name == "ring_current" and len(first.group) < 2:
        others = len(found.effects) - 1
        partner = f", with {others} more to mop up what it leaves" if others else ""
        return (
            f"The name is right, but it is given a probability of {min(first.probability, 0.99):.0%} or more{partner}, and "
            "that is more than a table of such close rows supports."
        )
    return "It does not put the ring current first alone."


def _state(found: Diagnosis, name: str) -> str:
    if name in found.untestable:
        return f"untestable ({found.untestable[name]})"
    return "named" if name in names_of(found) else "tested and not named"


def left(found: Diagnosis) -> str:
    """What is left without a name, in the words of the diagnosis; else the names."""
    if found.verdict != "unknown":
        return names(found)
    return found.sentence.partition(": ")[2].partition(".")[0]


def share_of(found: Diagnosis, stage: str) -> float:
    """Probability of a stage."""
    shares = found.where.probabilities.get("stage", {})
    return float(np.clip(shares.get(stage, 0.0), 0.0, 1.0))
