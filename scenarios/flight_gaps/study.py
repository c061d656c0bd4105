"""`fluxtwin run flight-gaps`: the diagnosis on records that flew, whose cause it is not given."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.gap import advice
from fluxtwin.gap.records import Diagnosis, EffectParameter, FoundEffect
from fluxtwin.plots import gap_cases
from fluxtwin.scenarios.flight_gaps.alone import Alone
from fluxtwin.scenarios.flight_gaps.cases import names_of
from fluxtwin.scenarios.flight_gaps.compute import STORM_NT, Answer, Outcome, compute
from fluxtwin.scenarios.page import Cell, FigureBlock, Page, Section, StudyResult, Table
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
_MINUS_IGRF = "MAGSAT minus IGRF-14"


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings(SETTINGS)
    outcome = compute(check_folder(data, settings.files), settings, part_of(progress, 0.0, 0.95))
    progress("drawing", 0.95)
    whole = page(outcome, settings)
    return StudyResult(
        name="flight-gaps",
        status_line=whole.verdict,
        summary=summary(outcome, settings),
        tables=tables(outcome),
        page=whole,
        written=[
            write_text(out / "flight_gaps.toml", tomli_w.dumps(settings.tree)),
            write_text(out / "report.md", as_markdown(whole)),
        ],
    )


def tables(outcome: Outcome) -> list[Table]:
    """The tables for the terminal."""
    rows = [[answer.case.title, _said(answer), as_expected(answer)] for answer in outcome.answers]
    return [_WORDS.table("short", rows), _storm_table(outcome)]


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


def _plain(table: Alone) -> dict[str, Any]:
    kept = {key: value for key, value in vars(table).items() if key != "shares"}
    return kept | {"effects": [vars(share) for share in table.shares]}


def page(outcome: Outcome, settings: Settings) -> Page:
    """The whole report."""
    rows: list[list[Cell]] = []
    for answer in outcome.answers:
        case = answer.case
        rows.append([case.title, case.known, case.expected, _said(answer), as_expected(answer)])
    return Page(
        title="Gaps that really flew",
        verdict=verdict(outcome),
        sections=[
            _WORDS.section("answers", [_WORDS.table("answers", rows)]),
            storm(outcome),
            _magsat(outcome),
            remains(outcome),
            _swarm(outcome),
            _dmsp(outcome),
            _aircraft(outcome),
        ],
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
    told = {"effect": effect.name, "parameter": name, "value": value.value, "unit": unit, "ratio": ratio}
    return _WORDS.sentence("oversized", **told)


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


def _storm_table(outcome: Outcome) -> Table:
    rows: list[list[Cell]] = [["nothing", 0, round(outcome.storm.raw_nT, 1), ""]]
    for share in sorted(outcome.storm.shares, key=lambda one: one.left_nT):
        size = f"{share.sizes[0]:.4g}" if share.parameters == 1 else ""
        rows.append([" + ".join(share.effects), share.parameters, round(share.left_nT, 1), size])
    return _WORDS.table("storm", rows)


def _ranking_table(answers: Sequence[Answer]) -> Table:
    """The best effects alone of every case."""
    rows: list[list[Cell]] = []
    for answer in answers:
        for place, line in enumerate(answer.found.ranking[:_TOP]):
            p = "< 1e-12" if line.p_value < 1e-12 else f"{min(line.p_value, 1.0):.1e}"
            rows.append(["" if place else answer.case.title, line.name, f"{line.drop:.4g}", line.directions, p])
    return _WORDS.table("ranking", rows, top=_TOP)


def storm(outcome: Outcome) -> Section:
    """Swarm A in the storm."""
    bare, full = outcome.answer("storm-none").found, outcome.answer("storm-default").found
    arc, _, orbit, day = outcome.storm_visible
    values = {
        "o": outcome,
        "bare": bare,
        "full": full,
        "ring": bare.ranking[0],
        "bias": next(line for line in bare.ranking if line.name == "bias"),
        "storm_nT": STORM_NT,
        "manoeuvre": find_effect("ring_current").settled_by,
        "names": _names,
        "unnamed": _unnamed,
        "names_of": names_of,
    }
    rows: list[list[Cell]] = [
        [one.rows, one.samples, round(one.whole_nT, 2), round(one.beside_b_and_S_nT, 3)]
        for one in outcome.storm_visible
    ]
    visible = _WORDS.table("visible", rows, size=STORM_NT)
    tables = [_storm_table(outcome), visible, _ranking_table(outcome.part("storm"))]
    bars = []
    for share in sorted(outcome.storm.shares, key=lambda one: one.left_nT):
        count = f"{share.parameters} parameter{'s' if share.parameters > 1 else ''}"
        bars.append((share.effects[0], share.left_nT, f"{share.left_nT:.1f} nT, {count}"))
    title = "Swarm A in the storm of 1 January 2016, |latitude| < 50 deg: each effect alone, nothing modelled"
    drawn = _WORDS.figure("storm_alone", gap_cases.left_alone(bars, outcome.storm.raw_nT, title))
    return _WORDS.section("storm", tables, [drawn], arc=arc, orbit=orbit, day=day, **values)


def _magsat(outcome: Outcome) -> Section:
    """MAGSAT, four wrong or right models."""
    fitted = zip(("b and S", "b, S and field_truncation"), outcome.degree_left, strict=True)
    tracks = [(name, left.latitude_deg, left.residual_nT) for name, left in fitted]
    drawn = gap_cases.by_latitude(tracks, f"{_MINUS_IGRF} to degree 8", _AURORA_DEG)
    figures = [_WORDS.figure("magsat_degree_8", drawn)]
    return _WORDS.section("magsat", [_ranking_table(outcome.part("magsat"))], figures, o=outcome, doubts=doubts)


def remains(outcome: Outcome) -> Section:
    """What IGRF-14 leaves of MAGSAT, and why an epoch helps."""
    nec, orbit = outcome.magsat["IGRF-14, NEC"], outcome.magsat["IGRF-14, orbit"]
    left, bands = outcome.magsat_left, outcome.magsat_left.bands()
    rows: list[list[Cell]] = []
    for name, table in outcome.magsat.items():
        rows.append([name, "b and S", round(table.base_nT, 1), ""])
        for share in table.shares:
            sizes = ", ".join(f"{size:.3g}" for size in share.sizes)
            rows.append(["", " + ".join(share.effects), round(share.left_nT, 1), sizes])
    by_band: list[list[Cell]] = [[f"{low:g} to {high:g}", count, round(rms, 1)] for low, high, count, rms in bands]
    along, epoch = "along_track_error", "field_epoch"
    pair = (nec, orbit)
    series = {
        "b and S": [table.base_nT for table in pair],
        "with field_epoch": [table.left_nT(epoch) for table in pair],
        "with along_track_error": [table.left_nT(along) for table in pair],
        "with both": [table.left_nT(along, epoch) for table in pair],
    }
    axes, title = ["north, east, centre", "axes of the orbit"], "MAGSAT and IGRF-14: what stands in for what"
    track = ("rms in steps of 5 deg", left.latitude_deg, left.residual_nT)
    by_latitude = gap_cases.by_latitude([track], f"{_MINUS_IGRF}, b and S free", _AURORA_DEG)
    figures = [
        _WORDS.figure("magsat_latitude", by_latitude),
        _WORDS.figure("magsat_epoch", gap_cases.groups(axes, series, "rms left per component [nT]", title)),
    ]
    tables = [_WORDS.table("magsat", rows), _WORDS.table("bands", by_band)]
    both = nec.share(along, epoch)
    return _WORDS.section("remains", tables, figures, o=outcome, nec=nec, orbit=orbit, bands=bands, both=both)


def _swarm(outcome: Outcome) -> Section:
    """Three satellites on one day."""
    answers = outcome.part("swarm")
    found = [answer.found for answer in answers]
    labels = [answer.case.title.partition(",")[0] for answer in answers]
    rows: list[list[Cell]] = [
        ["verdict", *(one.verdict for one in found)],
        ["stage", *(one.where.stage for one in found)],
        ["probability of that stage", *(_share_of_stage(one) for one in found)],
        ["frame", *(one.where.frame for one in found)],
        ["left", *map(_unnamed, found)],
        ["rms before [nT]", *(round(one.gap.before_nT, 1) for one in found)],
        ["floor [nT]", *(round(one.gap.floor_nT, 1) for one in found)],
        ["rows cut", *(one.samples["cut"] for one in found)],
    ]
    ranked = ("first of the ranking", "second", "third")
    rows[5:5] = [[name, *(one.ranking[place].name for one in found)] for place, name in enumerate(ranked)]
    first = [line.name for line in found[0].ranking[:4]]
    drops = [{line.name: line.drop for line in one.ranking} for one in found]
    series = {label: [drop.get(name, 0.0) for name in first] for label, drop in zip(labels, drops, strict=True)}
    tracks = [(label, a.latitude_deg, a.left_nT) for label, a in zip(labels, answers, strict=True)]
    by_latitude = gap_cases.by_latitude(tracks, "Swarm minus CHAOS, 8 September 2014, b and S free", _AURORA_DEG)
    figures = [
        _WORDS.figure("swarm_latitude", by_latitude),
        _WORDS.figure("swarm_ranking", gap_cases.groups(first, series, "drop of chi-square", "Each effect alone")),
    ]
    values = {
        "alike": len({(one.verdict, one.where.stage) for one in found}) == 1,
        "same_resemblance": len({tuple(one.resembles) for one in found}) == 1,
        "beyond": sum(int((a.cut & (np.abs(a.latitude_deg) > _AURORA_DEG)).sum()) for a in answers),
        "cut": sum(int(a.cut.sum()) for a in answers),
        "spurious": [a.case.title for a in answers if "bit_errors" in names_of(a.found)],
    }
    tables = [Table("Three satellites, one day", ["", *labels], rows), _ranking_table(answers)]
    return _WORDS.section("swarm", tables, figures, answers=answers, **values)


def _share_of_stage(found: Diagnosis) -> float:
    """Probability of the stage that the answer gives."""
    shares = found.where.probabilities.get("stage", {})
    return round(float(np.clip(shares.get(found.where.stage or "", 0.0), 0.0, 1.0)), 2)


def _dmsp(outcome: Outcome) -> Section:
    """Two days in spacecraft axes; rms of the change from row to row beyond 65 deg, by axis."""
    f16 = outcome.answer("dmsp-f16")
    change = np.diff(f16.left_nT, axis=0)[np.abs(f16.latitude_deg[1:]) > 65.0]
    steps = "nothing that is known"
    if np.isfinite(change).any():
        steps = ", ".join(f"{value:.0f}" for value in np.sqrt(np.nanmean(np.square(change), axis=0)))
    tables = [_ranking_table(outcome.part("dmsp"))]
    return _WORDS.section("dmsp", tables, o=outcome, unnamed=_unnamed, steps=steps)


def _aircraft(outcome: Outcome) -> Section:
    eddy, drawn = aircraft_eddy(outcome)
    tables, c = [eddy, _ranking_table(outcome.part("aircraft"))], outcome.coefficients
    return _WORDS.section("aircraft", tables, [drawn], o=outcome, c=c, eddy=bool(eddy.rows[0][2]))


def aircraft_eddy(outcome: Outcome) -> tuple[Table, FigureBlock]:
    """Published and found eddy terms, as a table and drawn."""
    named = [one for one in outcome.answer("aircraft-eddy_current").found.effects if one.name == "eddy_current"]
    found_us = {name: 1e6 * value.value for one in named for name, value in one.parameters.items()}
    published_us = {name: -1e6 * float(outcome.coefficients.symmetric_eddy_s[ij]) for name, ij in _EDDY.items()}
    rows = [[name, f"{published_us[name]:.1f}", f"{found_us[name]:.1f}" if name in found_us else ""] for name in _EDDY]
    series = {"published": list(published_us.values())}
    if found_us:
        series["found"] = [found_us[name] for name in _EDDY]
    drawn = gap_cases.groups(list(_EDDY), series, "coefficient [us]", "An aircraft's eddy currents")
    return _WORDS.table("eddy", rows), _WORDS.figure("aircraft_eddy", drawn)
