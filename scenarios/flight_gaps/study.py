"""`fluxtwin run flight-gaps`: the diagnosis on records that flew, whose cause it is not given."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.calib.common.digits import plain
from fluxtwin.gap.law.words import made_of
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.gap.report.words import at_the_end
from fluxtwin.scenarios.flight_gaps.compute import STORM_NT, Answer, Outcome, Share, compute, names_of
from fluxtwin.scenarios.page import Cell, StudyResult
from fluxtwin.scenarios.recorded_files import Settings, run_on_files
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect

SETTINGS = Path(__file__).parent / "flight_gaps.toml"
"""What the study runs with; a copy lies beside its results."""
_AURORA_DEG = 60.0
_EDDY = {"K_xx": (0, 0), "K_yy": (1, 1), "K_xy": (0, 1), "K_xz": (0, 2), "K_yz": (1, 2)}


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study, as `run_on_files`."""
    return run_on_files(SETTINGS, out, data, progress, compute, present)


def present(outcome: Outcome, settings: Settings) -> StudyResult:
    """What the study says of its outcome."""
    provenance = {
        "settings": "flight_gaps.toml beside this page",
        "files": ", ".join(settings.files),
        "effects in the catalogue": str(len(CATALOGUE)),
    }
    values = page_values(outcome) | {"settings": settings.tree}
    return words().result("flight-gaps", provenance, **values)


@cache
def words() -> Words:
    """The sections of `words.md`, with what speaks of an answer."""
    return Words(
        "fluxtwin.scenarios.flight_gaps",
        filters={"before_comma": _before_comma},
        aurora_deg=_AURORA_DEG,
        unnamed=_unnamed,
        names_of=names_of,
        said=_said,
        as_expected=as_expected,
        law_of=_law_of,
        law_closes=_law_closes,
        storm_nT=STORM_NT,
    )


def counts(outcome: Outcome) -> dict[str, int]:
    """Answers from which something was expected, those that meet it, and those of these that add a wrong name."""
    asked = [answer for answer in outcome.answers if answer.agrees is not None]
    met = [answer for answer in asked if answer.agrees]
    return {"met": len(met), "erring": sum(bool(answer.wrong) for answer in met), "total": len(asked)}


def as_expected(answer: Answer) -> str:
    """Whether the answer says what was expected, and what else it says."""
    if answer.agrees is None:
        return "nothing expected"
    return ("yes" if answer.agrees else "no") + (f"; wrong: {', '.join(answer.wrong)}" if answer.wrong else "")


def _names(found: Diagnosis) -> str:
    """The names of an answer, groups by slashes."""
    return ", ".join(" / ".join(effect.group) or effect.name for effect in found.effects) or "none"


def _unnamed(found: Diagnosis) -> str:
    """The residual that has no name, in the words of the diagnosis; else the names."""
    return _names(found) if found.verdict != "unknown" else found.sentence.partition(": ")[2].partition(".")[0]


def _said(answer: Answer) -> str:
    found = answer.found
    said = found.verdict if not found.effects else f"{found.verdict}: {_names(found)}"
    said += "".join(f", with {end}" for effect in found.effects if (end := at_the_end(effect)))
    said += f", stage {' or '.join(found.where.likely('stage'))}" if found.where.stage else ""
    return said + (f"; resembles {', '.join(found.resembles)}" if found.resembles else "")


def _law_of(answer: Answer) -> str:
    """What the law follows, or why there is none."""
    law = answer.found.law
    if law is None:
        return "none was sought: the names leave nothing"
    return made_of(law.terms) if law.terms else f"none: {law.why_none}"


def _law_closes(answer: Answer) -> str:
    law = answer.found.law
    if law is None or not law.terms or law.closed is None:
        return ""
    return f"{plain(law.before_nT)} to {plain(law.after_nT)} nT, {100 * law.closed:.0f} %"


def page_values(outcome: Outcome) -> dict[str, Any]:
    """What the words and tables of the page take."""
    f16, table = outcome.answer("dmsp-f16"), outcome.storm
    arc, _, one_orbit, day = outcome.storm_visible
    nec, orbit = outcome.magsat["IGRF-14, NEC"], outcome.magsat["IGRF-14, orbit"]
    change = np.diff(f16.left_nT, axis=0)[np.abs(f16.latitude_deg[1:]) > 65.0]
    steps = np.sqrt(np.nanmean(np.square(change), axis=0)) if np.isfinite(change).any() else []
    answers = outcome.part("swarm")
    found = [answer.found for answer in answers]
    places = enumerate(("first of the ranking", "second", "third"))
    ranked: list[list[Cell]] = [[name, *(one.ranking[place].name for one in found)] for place, name in places]
    # Published and found eddy terms of the aircraft, in microseconds.
    named = [one for one in outcome.answer("aircraft-eddy_current").found.effects if one.name == "eddy_current"]
    published = -1e6 * outcome.coefficients.symmetric_eddy_s
    return {
        **counts(outcome),
        "o": outcome,
        "least_squares": {"storm": table, **outcome.magsat},
        "full": outcome.answer("storm-default").found,
        "manoeuvre": find_effect("ring_current").settled_by,
        "shares": [Share(("nothing",), 0, table.raw_nT, ()), *sorted(table.shares, key=lambda one: one.left_nT)],
        "arc": arc,
        "one_orbit": one_orbit,
        "day": day,
        "nec": nec,
        "orbit": orbit,
        "degree": outcome.magsat["degree 8, orbit"],
        "both": nec.share("along_track_error", "field_epoch"),
        "bands": outcome.magsat_left.bands,
        "answers": answers,
        "alike": len({(a.found.verdict, a.found.where.stage) for a in answers}) == 1,
        "surest": max(_stage_share(answer.found) for answer in answers),
        "beyond": sum(int((a.cut & (np.abs(a.latitude_deg) > _AURORA_DEG)).sum()) for a in answers),
        "spikes": sum(int(a.cut.sum()) for a in answers),
        "spurious": [a.case.title for a in answers if "bit_errors" in names_of(a.found)],
        "steps": ", ".join(f"{value:.0f}" for value in steps) or "nothing that is known",
        "c": outcome.coefficients,
        "eddy_us": {
            "published": {name: float(published[place]) for name, place in _EDDY.items()},
            "found": {name: 1e6 * value.value for one in named for name, value in one.parameters.items()},
        },
        "magsat": _magsat_rows(outcome),
        "swarm": [
            ["verdict", *(one.verdict for one in found)],
            ["stage", *(one.where.stage for one in found)],
            ["probability of that stage", *(round(_stage_share(one), 2) for one in found)],
            ["frame", *(one.where.frame for one in found)],
            ["residual structure", *map(_unnamed, found)],
            *ranked,
            ["rms before [nT]", *(round(one.gap.before_nT, 1) for one in found)],
            ["expected [nT]", *(round(one.gap.floor_nT, 1) for one in found)],
            ["rows cut", *(one.samples["cut"] for one in found)],
        ],
    }


def _magsat_rows(outcome: Outcome) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    for name, table in outcome.magsat.items():
        rows.append([name, "b and S", round(table.base_nT, 1), ""])
        rows += [["", " + ".join(one.effects), round(one.left_nT, 1), one.in_words()] for one in table.shares]
    return rows


def _stage_share(found: Diagnosis) -> float:
    return found.where.probabilities["stage"].get(found.where.stage or "", 0.0)


def _before_comma(text: str) -> str:
    return text.partition(",")[0]
