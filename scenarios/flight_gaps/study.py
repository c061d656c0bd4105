"""`fluxtwin run flight-gaps`: the diagnosis on records that flew, whose cause it is not given."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from fluxtwin.gap.records.diagnosis import Diagnosis, EffectParameter, FoundEffect, Ranked
from fluxtwin.gap.report import advice
from fluxtwin.plots import gap_cases
from fluxtwin.scenarios.flight_gaps.alone import Share, Shares
from fluxtwin.scenarios.flight_gaps.cases import names_of
from fluxtwin.scenarios.flight_gaps.compute import STORM_NT, Answer, Outcome, compute
from fluxtwin.scenarios.page import Cell, Page, StudyResult
from fluxtwin.scenarios.page_markdown import as_markdown
from fluxtwin.scenarios.recorded_files import Settings, check_folder, read_settings
from fluxtwin.scenarios.worded_page import PageWords
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect

SUSPICIOUS = 100.0
"""Times its typical size: a parameter as large as that is no effect of its name."""
_WORDS = PageWords("fluxtwin.scenarios.flight_gaps")
SETTINGS = Path(__file__).parent / "flight_gaps.toml"
"""What the study runs with; a copy lies beside its results."""
_AURORA_DEG = 60.0
_TOP = 5
_EDDY = {"K_xx": (0, 0), "K_yy": (1, 1), "K_xy": (0, 1), "K_xz": (0, 2), "K_yz": (1, 2)}


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings(SETTINGS)
    outcome = compute(check_folder(data, settings.files), settings, part_of(progress, 0.0, 0.95))
    progress("drawing", 0.95)
    values, whole = page_values(outcome), page(outcome, settings)
    return StudyResult(
        name="flight-gaps",
        status_line=whole.verdict,
        summary=summary(outcome, settings),
        tables=[_WORDS.table(name, values) for name in ("short", "storm")],
        page=whole,
        written=[
            write_text(out / "flight_gaps.toml", tomli_w.dumps(settings.tree)),
            write_text(out / "report.md", as_markdown(whole)),
        ],
    )


def summary(outcome: Outcome, settings: Settings) -> dict[str, Any]:
    """The content of summary.json: every answer whole, and the least-squares tables."""
    return {
        "study": settings.name,
        "cases": [
            {key: getattr(answer.case, key) for key in ("name", "title", "known")}
            | {"expected": answer.case.expected or None, "agrees": answer.agrees, "wrong": answer.wrong}
            | {"doubts": doubts(answer), "diagnosis": answer.found.to_dict()}
            for answer in outcome.answers
        ],
        "alone": {name: _plain(table) for name, table in {"storm": outcome.storm, **outcome.magsat}.items()},
        "ring_current_visible": [vars(one) | {"size_nT": STORM_NT} for one in outcome.storm_visible],
        "magsat_by_latitude": [
            dict(zip(("from_deg", "to_deg", "samples", "rms_nT"), band, strict=True))
            for band in outcome.magsat_left.bands()
        ],
        "kp": [float(value) for value in outcome.kp],
        "aircraft": {
            "permanent_nT": outcome.coefficients.permanent_nT.tolist(),
            "induced": outcome.coefficients.induced.tolist(),
            "eddy_s": outcome.coefficients.eddy_s.tolist(),
            "worst_nT": outcome.coefficients.worst_nT,
            "rms_nT": list(outcome.coefficients.parts_nT),
        },
        "settings": settings.tree,
    }


def _plain(table: Shares) -> dict[str, Any]:
    kept = {key: value for key, value in vars(table).items() if key != "shares"}
    return kept | {"effects": [vars(share) for share in table.shares]}


def page(outcome: Outcome, settings: Settings) -> Page:
    """The whole report."""
    return Page(
        title="Gaps that really flew",
        verdict=verdict(outcome),
        sections=_WORDS.sections(page_values(outcome), _figures(outcome)),
        provenance={
            "settings": "flight_gaps.toml beside this page",
            "files": ", ".join(settings.files),
            "effects in the catalogue": str(len(CATALOGUE)),
        },
    )


def verdict(outcome: Outcome) -> str:
    """The status line of the study."""
    asked = [answer for answer in outcome.answers if answer.agrees is not None]
    met = [answer for answer in asked if answer.agrees]
    spoilt = sum(bool(answer.wrong) for answer in met)
    return _WORDS.sentence("verdict", met=len(met), spoilt=spoilt, total=len(asked))


def as_expected(answer: Answer) -> str:
    """Whether the answer says what was expected, and what else it says."""
    if answer.agrees is None:
        return "nothing expected"
    return ("yes" if answer.agrees else "no") + (f"; wrong: {', '.join(answer.wrong)}" if answer.wrong else "")


def oversized(effect: FoundEffect) -> str | None:
    """The parameter of a named effect that is most above its typical size, if it is absurdly so."""
    ratios: dict[float, tuple[str, EffectParameter]] = {}
    for name, value in effect.parameters.items():
        typical = advice.typical_size(effect.name, name)
        if typical:
            ratios.setdefault(abs(value.value / typical), (name, value))
    ratio = max(ratios, default=0.0)
    if ratio < SUSPICIOUS:
        return None
    name, value = ratios[ratio]
    unit = "" if value.unit == "1" else f" {value.unit}"
    values = {"effect": effect.name, "parameter": name, "value": value.value, "unit": unit, "ratio": ratio}
    return _WORDS.sentence("oversized", **values)


def doubts(answer: Answer) -> list[str]:
    """What a reader should hold against an answer: absurd sizes, and names that predict worse than none."""
    found = answer.found
    said = [words for effect in found.effects if (words := oversized(effect)) is not None]
    if found.effects and found.gap.after_nT > found.gap.before_nT:
        said.append(_WORDS.sentence("worse", gap=found.gap))
    return said


def _names(found: Diagnosis) -> str:
    """The names of an answer, groups by slashes."""
    return ", ".join(" / ".join(effect.group) or effect.name for effect in found.effects) or "none"


def _unnamed(found: Diagnosis) -> str:
    """The residual that has no name, in the words of the diagnosis; else the names."""
    return _names(found) if found.verdict != "unknown" else found.sentence.partition(": ")[2].partition(".")[0]


def _said(answer: Answer) -> str:
    found = answer.found
    said = found.verdict if not found.effects else f"{found.verdict}: {_names(found)}"
    said += f", stage {found.where.stage}" if found.where.stage else ""
    return said + (f"; resembles {', '.join(found.resembles)}" if found.resembles else "")


def _ranked(answers: Sequence[Answer]) -> list[tuple[str, Ranked]]:
    """The best effects alone of every case, the first of each with the title of its record."""
    return [
        ("" if place else answer.case.title, line)
        for answer in answers
        for place, line in enumerate(answer.found.ranking[:_TOP])
    ]


def page_values(outcome: Outcome) -> dict[str, Any]:
    """What the words and tables of the page take."""
    bare, f16, table = outcome.answer("storm-none").found, outcome.answer("dmsp-f16"), outcome.storm
    arc, _, one_orbit, day = outcome.storm_visible
    nec, orbit = outcome.magsat["IGRF-14, NEC"], outcome.magsat["IGRF-14, orbit"]
    change = np.diff(f16.left_nT, axis=0)[np.abs(f16.latitude_deg[1:]) > 65.0]
    steps = np.sqrt(np.nanmean(np.square(change), axis=0)) if np.isfinite(change).any() else []
    answers = outcome.part("swarm")
    return {
        "o": outcome,
        "names": _names,
        "unnamed": _unnamed,
        "names_of": names_of,
        "doubts": doubts,
        "said": _said,
        "as_expected": as_expected,
        "ranked": _ranked,
        "bare": bare,
        "full": outcome.answer("storm-default").found,
        "ring": bare.ranking[0],
        "bias": next(line for line in bare.ranking if line.name == "bias"),
        "storm_nT": STORM_NT,
        "manoeuvre": find_effect("ring_current").settled_by,
        "shares": [Share(("nothing",), 0, table.raw_nT, ()), *sorted(table.shares, key=lambda one: one.left_nT)],
        "arc": arc,
        "one_orbit": one_orbit,
        "day": day,
        "nec": nec,
        "orbit": orbit,
        "both": nec.share("along_track_error", "field_epoch"),
        "bands": outcome.magsat_left.bands(),
        "answers": answers,
        "alike": len({(a.found.verdict, a.found.where.stage) for a in answers}) == 1,
        "same_resemblance": len({tuple(a.found.resembles) for a in answers}) == 1,
        "beyond": sum(int((a.cut & (np.abs(a.latitude_deg) > _AURORA_DEG)).sum()) for a in answers),
        "cut": sum(int(a.cut.sum()) for a in answers),
        "spurious": [a.case.title for a in answers if "bit_errors" in names_of(a.found)],
        "steps": ", ".join(f"{value:.0f}" for value in steps) or "nothing that is known",
        "c": outcome.coefficients,
        "eddy_us": _eddy_us(outcome),
        "rows": {"magsat": _magsat_rows(outcome), "swarm": _swarm_rows([answer.found for answer in answers])},
    }


def _magsat_rows(outcome: Outcome) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    for name, table in outcome.magsat.items():
        rows.append([name, "b and S", round(table.base_nT, 1), ""])
        for share in table.shares:
            sizes = ", ".join(f"{size:.3g}" for size in share.sizes)
            rows.append(["", " + ".join(share.effects), round(share.left_nT, 1), sizes])
    return rows


def _swarm_rows(found: Sequence[Diagnosis]) -> list[list[Cell]]:
    of_stage = [one.where.probabilities.get("stage", {}).get(one.where.stage or "", 0.0) for one in found]
    places = enumerate(("first of the ranking", "second", "third"))
    ranked: list[list[Cell]] = [[name, *(one.ranking[place].name for one in found)] for place, name in places]
    return [
        ["verdict", *(one.verdict for one in found)],
        ["stage", *(one.where.stage for one in found)],
        ["probability of that stage", *(round(float(np.clip(share, 0.0, 1.0)), 2) for share in of_stage)],
        ["frame", *(one.where.frame for one in found)],
        ["left", *map(_unnamed, found)],
        *ranked,
        ["rms before [nT]", *(round(one.gap.before_nT, 1) for one in found)],
        ["floor [nT]", *(round(one.gap.floor_nT, 1) for one in found)],
        ["rows cut", *(one.samples["cut"] for one in found)],
    ]


def _eddy_us(outcome: Outcome) -> dict[str, dict[str, float]]:
    """Published and found eddy terms of the aircraft, in microseconds."""
    named = [one for one in outcome.answer("aircraft-eddy_current").found.effects if one.name == "eddy_current"]
    published = -1e6 * outcome.coefficients.symmetric_eddy_s
    return {
        "published": {name: float(published[place]) for name, place in _EDDY.items()},
        "found": {name: 1e6 * value.value for one in named for name, value in one.parameters.items()},
    }


def _figures(outcome: Outcome) -> dict[str, Figure]:
    return {**_magsat_figures(outcome), **_storm_and_aircraft_figures(outcome), **_swarm_figures(outcome)}


def _storm_and_aircraft_figures(outcome: Outcome) -> dict[str, Figure]:
    bars = []
    for share in sorted(outcome.storm.shares, key=lambda one: one.left_nT):
        count = f"{share.parameters} parameter{'s' if share.parameters > 1 else ''}"
        bars.append((share.effects[0], share.left_nT, f"{share.left_nT:.1f} nT, {count}"))
    title = "Swarm A in the storm of 1 January 2016, |latitude| < 50 deg: each effect alone, nothing modelled"
    eddy = {name: [values[term] for term in _EDDY] for name, values in _eddy_us(outcome).items() if values}
    return {
        "storm_alone": gap_cases.left_alone(bars, outcome.storm.raw_nT, title),
        "aircraft_eddy": gap_cases.groups(list(_EDDY), eddy, "coefficient [us]", "An aircraft's eddy currents"),
    }


def _magsat_figures(outcome: Outcome) -> dict[str, Figure]:
    left, (without, with_it) = outcome.magsat_left, outcome.degree_left
    fitted = {"b and S": without, "b, S and field_truncation": with_it}
    cut = [(name, one.latitude_deg, one.residual_nT) for name, one in fitted.items()]
    track = ("rms in steps of 5 deg", left.latitude_deg, left.residual_nT)
    pair = (outcome.magsat["IGRF-14, NEC"], outcome.magsat["IGRF-14, orbit"])
    along, epoch = "along_track_error", "field_epoch"
    series = {
        "b and S": [table.base_nT for table in pair],
        "with field_epoch": [table.left_nT(epoch) for table in pair],
        "with along_track_error": [table.left_nT(along) for table in pair],
        "with both": [table.left_nT(along, epoch) for table in pair],
    }
    axes, title = ["north, east, centre", "axes of the orbit"], "MAGSAT and IGRF-14: what stands in for what"
    minus = "MAGSAT minus IGRF-14"
    return {
        "magsat_degree_8": gap_cases.by_latitude(cut, f"{minus} to degree 8", _AURORA_DEG),
        "magsat_latitude": gap_cases.by_latitude([track], f"{minus}, b and S free", _AURORA_DEG),
        "magsat_epoch": gap_cases.groups(axes, series, "rms left per component [nT]", title),
    }


def _swarm_figures(outcome: Outcome) -> dict[str, Figure]:
    answers = {answer.case.title.partition(",")[0]: answer for answer in outcome.part("swarm")}
    tracks = [(label, a.latitude_deg, a.left_nT) for label, a in answers.items()]
    drops = {label: {line.name: line.drop for line in a.found.ranking} for label, a in answers.items()}
    first = list(next(iter(drops.values())))[:4]
    series = {label: [drop.get(name, 0.0) for name in first] for label, drop in drops.items()}
    title = "Swarm minus CHAOS, 8 September 2014, b and S free"
    return {
        "swarm_latitude": gap_cases.by_latitude(tracks, title, _AURORA_DEG),
        "swarm_ranking": gap_cases.groups(first, series, "drop of chi-square", "Each effect alone"),
    }
