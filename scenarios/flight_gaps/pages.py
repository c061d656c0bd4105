"""The telling half of the study: tables, figures, summary and page from what was computed."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.plots import gap_cases
from fluxtwin.scenarios.flight_gaps import words
from fluxtwin.scenarios.flight_gaps.alone import Alone
from fluxtwin.scenarios.flight_gaps.cases import AIRCRAFT, DMSP, MAGSAT, STORM, SWARM
from fluxtwin.scenarios.flight_gaps.compute import STORM_NT, Answer, Outcome
from fluxtwin.scenarios.flight_gaps.settings import Settings
from fluxtwin.scenarios.page import Cell, FigureBlock, Page, Section, Table
from fluxtwin.sim.effects.catalogue import CATALOGUE

_AURORA_DEG = 60.0
_TOP = 5
_EDDY = (("K_xx", 0, 0), ("K_yy", 1, 1), ("K_xy", 0, 1), ("K_xz", 0, 2), ("K_yz", 1, 2))


def summary(outcome: Outcome, settings: Settings) -> dict[str, Any]:
    """The content of summary.json: every answer whole, and the least-squares tables."""
    return {
        "study": settings.name,
        "cases": [
            {
                "name": answer.case.name, "title": answer.case.title, "known": answer.case.known,
                "expected": answer.case.expected or None, "agrees": answer.agrees, "wrong": answer.wrong,
                "doubts": words.doubts(answer), "diagnosis": answer.found.to_dict(),
            }
            for answer in outcome.answers
        ],
        "alone": {"storm": _alone(outcome.storm)} | {name: _alone(table) for name, table in outcome.magsat.items()},
        "ring_current_visible": [
            {"rows": rows, "samples": count, "whole_nT": whole, "beside_b_and_S_nT": left, "size_nT": STORM_NT}
            for rows, count, whole, left in outcome.storm_visible
        ],
        "magsat_by_latitude": [
            {"from_deg": low, "to_deg": high, "samples": count, "rms_nT": rms}
            for low, high, count, rms in outcome.magsat_left.bands()
        ],
        "kp": [float(value) for value in outcome.kp],
        "aircraft": {
            "permanent_nT": outcome.coefficients.permanent_nT.tolist(),
            "induced": outcome.coefficients.induced.tolist(),
            "eddy_s": outcome.coefficients.eddy_s.tolist(),
            "worst_nT": outcome.coefficients.worst_nT,
            "rms_nT": list(outcome.coefficients.parts_nT),
        },
        "settings": settings.model_dump(),
    }  # fmt: skip


def tables(outcome: Outcome) -> list[Table]:
    """The tables for the terminal."""
    return [short_table(outcome), storm_table(outcome)]


def page(outcome: Outcome, settings: Settings) -> Page:
    """The whole report."""
    return Page(
        title="Gaps that really flew",
        verdict=words.verdict(outcome),
        sections=[
            Section(
                "What the diagnosis was not told, and what it said",
                [
                    "`fluxtwin run flight-gaps --data DIR` asks the diagnosis of recorded files whose cause is known, and "
                    "withheld. No noise is declared. Which of the rows are used was settled after other spacings had been "
                    "seen: with MAGSAT's rows at other spacings, or with noise declared, field_truncation came alone or "
                    "with polynomials beside it. Body axes are those of the orbit (x forward, z down), as these satellites "
                    "fly, unless a file has axes of its own. What came out stands here as it is: the sentences in the "
                    "sections below are the diagnosis's own.",
                ],
                [answers_table(outcome)],
            ),
            Section(
                "Swarm A in the storm of 1 January 2016", words.storm(outcome),
                [storm_table(outcome), visible_table(outcome), ranking_table(outcome, STORM)], [_storm_figure(outcome)],
            ),
            Section(
                "MAGSAT, 1 January 1980: four models of the field", words.magsat(outcome),
                [ranking_table(outcome, MAGSAT)], [_degree_figure(outcome)],
            ),
            Section(
                "MAGSAT and IGRF-14: what remains, and where", words.remains(outcome),
                [magsat_table(outcome), bands_table(outcome)], _magsat_figures(outcome),
            ),
            Section(
                "Swarm A, B and C on 8 September 2014", words.swarm(outcome),
                [swarm_table(outcome), ranking_table(outcome, SWARM)], _swarm_figures(outcome),
            ),
            Section("DMSP F16 and F14", words.dmsp(outcome), [ranking_table(outcome, DMSP)]),
            Section(
                "An aircraft's compensation", words.aircraft(outcome),
                [aircraft_table(outcome), ranking_table(outcome, AIRCRAFT)], [_aircraft_figure(outcome)],
            ),
        ],
        provenance={
            "settings": "flight_gaps.toml beside this page",
            "files": ", ".join(settings.files),
            "effects in the catalogue": str(len(CATALOGUE)),
        },
    )  # fmt: skip


def answers_table(outcome: Outcome) -> Table:
    """Every case in a row."""
    rows: list[list[Cell]] = [
        [answer.case.title, answer.case.known, answer.case.expected, _said(answer), words.as_foretold(answer)]
        for answer in outcome.answers
    ]
    return Table(
        "Every case",
        ["record", "known, withheld", "foretold", "said", "as foretold"],
        rows,
        note="Modelled, and so estimated anew in every test: b and S, if the record does not say otherwise.",
    )


def short_table(outcome: Outcome) -> Table:
    """The same for the terminal."""
    rows = [[answer.case.title, _said(answer), words.as_foretold(answer)] for answer in outcome.answers]
    return Table("Every case", ["record", "said", "as foretold"], rows)


def _said(answer: Answer) -> str:
    found = answer.found
    said = found.verdict if not found.effects else f"{found.verdict}: {words.names(found)}"
    said += f", stage {found.where.stage}" if found.where.stage else ""
    return said + (f"; resembles {', '.join(found.resembles)}" if found.resembles else "")


def storm_table(outcome: Outcome) -> Table:
    """What each name takes alone of the storm."""
    table = outcome.storm
    rows: list[list[Cell]] = [["nothing", 0, round(table.raw_nT, 1), ""]]
    for share in sorted(table.shares, key=lambda one: one.left_nT):
        size = f"{share.sizes[0]:.4g}" if share.parameters == 1 else ""
        rows.append([" + ".join(share.effects), share.parameters, round(share.left_nT, 1), size])
    return Table(
        "Swarm A in the storm: what each effect leaves alone, nothing modelled",
        ["effect", "parameters", "rms left [nT]", "size"],
        rows,
        note="Plain least squares, rms per component. Size: nT, km, s and years.",
    )


def visible_table(outcome: Outcome) -> Table:
    """What b and S leave of a ring current, by data."""
    rows: list[list[Cell]] = [
        [kind, count, round(whole, 2), round(left, 3)] for kind, count, whole, left in outcome.storm_visible
    ]
    return Table(
        f"A ring current of {STORM_NT:.0f} nT, with b and S free",
        ["along", "rows", "whole, rms [nT]", "left, rms [nT]"],
        rows,
        note="From the geometry alone; axes of the orbit. The day is that of 8 September 2014, 90 s apart.",
    )


def magsat_table(outcome: Outcome) -> Table:
    """Plain least squares of MAGSAT, by model and axes."""
    rows: list[list[Cell]] = []
    for name, table in outcome.magsat.items():
        rows.append([name, "b and S", round(table.base_nT, 1), ""])
        for share in table.shares:
            sizes = ", ".join(f"{size:.3g}" for size in share.sizes)
            rows.append(["", " + ".join(share.effects), round(share.left_nT, 1), sizes])
    return Table(
        "MAGSAT, b and S free: what each effect leaves beside them",
        ["model, axes", "fitted", "rms left [nT]", "size"],
        rows,
        note="Plain least squares, rms per component. Size: km along the track, years, s, nT, share of the degrees. An "
        "independent look at degree 8: 56.6 to 39.8 nT.",
    )


def bands_table(outcome: Outcome) -> Table:
    """Residual of MAGSAT by latitude."""
    rows: list[list[Cell]] = [
        [f"{low:g} to {high:g}", count, round(rms, 1)] for low, high, count, rms in outcome.magsat_left.bands()
    ]
    return Table(
        "MAGSAT less IGRF-14, b and S free, by latitude", ["latitude [deg]", "rows", "rms per component [nT]"], rows
    )


def swarm_table(outcome: Outcome) -> Table:
    """The three satellites side by side."""
    answers = [answer for answer in outcome.answers if answer.case.part == SWARM]
    rows: list[list[Cell]] = []

    def row(name: str, cells: list[Cell]) -> None:
        rows.append([name, *cells])

    row("verdict", [a.found.verdict for a in answers])
    row("stage", [a.found.where.stage for a in answers])
    row("probability of that stage", [round(words.share_of(a.found, a.found.where.stage or ""), 2) for a in answers])
    row("frame", [a.found.where.frame for a in answers])
    row("left", [words.left(a.found) for a in answers])
    row("first of the ranking", [a.found.ranking[0].name for a in answers])
    row("second", [a.found.ranking[1].name for a in answers])
    row("third", [a.found.ranking[2].name for a in answers])
    row("rms before [nT]", [round(a.found.gap.before_nT, 1) for a in answers])
    row("floor [nT]", [round(a.found.gap.floor_nT, 1) for a in answers])
    row("rows cut", [a.found.samples["cut"] for a in answers])
    return Table("Three satellites, one day", ["", *[a.case.title.partition(",")[0] for a in answers]], rows)


def ranking_table(outcome: Outcome, part: str) -> Table:
    """The best effects alone of every case of a part."""
    rows: list[list[Cell]] = []
    for answer in outcome.answers:
        if answer.case.part != part:
            continue
        for place, line in enumerate(answer.found.ranking[:_TOP]):
            title = answer.case.title if place == 0 else ""
            rows.append([title, line.name, f"{line.drop:.4g}", line.directions, _p_value(line.p_value)])
    return Table(
        f"The first {_TOP} effects, each alone, before any is named",
        ["record", "effect", "drop of chi-square", "parameters seen", "p-value"],
        rows,
    )


def aircraft_table(outcome: Outcome) -> Table:
    """Published and found eddy terms."""
    found = _eddy(outcome.answer("aircraft-eddy_current"))
    published = -outcome.coefficients.symmetric_eddy_s
    rows: list[list[Cell]] = [
        [name, f"{1e6 * published[i, j]:.1f}", "" if name not in found else f"{1e6 * found[name]:.1f}"]
        for name, i, j in _EDDY
    ]
    return Table(
        "Eddy-current terms of the aircraft",
        ["coefficient", "published [us]", "found [us]"],
        rows,
        note="Published: symmetric part without trace of the compensation's nine terms, with the sign of eddy_current "
        "(-K dB/dt).",
    )


def _storm_figure(outcome: Outcome) -> FigureBlock:
    shares = sorted(outcome.storm.shares, key=lambda one: one.left_nT)
    bars = [
        (share.effects[0], share.left_nT, f"{share.left_nT:.1f} nT, {share.parameters} parameter"
         + ("s" if share.parameters > 1 else "")) for share in shares
    ]  # fmt: skip
    title = "Swarm A in the storm of 1 January 2016, |latitude| < 50 deg: each effect alone, nothing modelled"
    return FigureBlock(
        "storm_alone",
        "The ring current is the cause; b and S, which have more parameters, leave a little less.",
        gap_cases.left_alone(bars, outcome.storm.raw_nT, title),
    )


def _degree_figure(outcome: Outcome) -> FigureBlock:
    without, with_it = outcome.degree_left
    tracks = [
        ("b and S", without.latitude_deg, without.residual_nT),
        ("b, S and field_truncation", with_it.latitude_deg, with_it.residual_nT),
    ]
    return FigureBlock(
        "magsat_degree_8",
        "What field_truncation takes when the model is cut at degree 8. Plain fits; tinted: beyond 60 deg.",
        gap_cases.by_latitude(tracks, "MAGSAT less IGRF-14 to degree 8", _AURORA_DEG),
    )


def _magsat_figures(outcome: Outcome) -> list[FigureBlock]:
    left = outcome.magsat_left
    title = "MAGSAT less IGRF-14, b and S free"
    names = {
        "b and S": None, "with field_epoch": ("field_epoch",), "with along_track_error": ("along_track_error",),
        "with both": ("along_track_error", "field_epoch"),
    }  # fmt: skip
    series = {
        words_: [
            table.base_nT if effects is None else table.left_nT(*effects)
            for table in (outcome.magsat["IGRF-14, NEC"], outcome.magsat["IGRF-14, orbit"])
        ]
        for words_, effects in names.items()
    }
    return [
        FigureBlock(
            "magsat_latitude",
            f"What is left grows towards the poles; tinted: beyond {_AURORA_DEG:g} deg.",
            gap_cases.by_latitude([("rms in steps of 5 deg", left.latitude_deg, left.residual_nT)], title, _AURORA_DEG),
        ),
        FigureBlock(
            "magsat_epoch",
            "An epoch helps only as long as nothing takes the second between stamps and positions.",
            gap_cases.groups(
                ["north, east, centre", "axes of the orbit"], series, "rms left per component [nT]",
                "MAGSAT and IGRF-14: what stands in for what",
            ),
        ),
    ]  # fmt: skip


def _swarm_figures(outcome: Outcome) -> list[FigureBlock]:
    answers = [answer for answer in outcome.answers if answer.case.part == SWARM]
    labels = [answer.case.title.partition(",")[0] for answer in answers]
    tracks = [(name, a.latitude_deg, a.left_nT) for name, a in zip(labels, answers, strict=True)]
    first = [line.name for line in answers[0].found.ranking[:4]]
    series = {
        name: [next((line.drop for line in a.found.ranking if line.name == effect), 0.0) for effect in first]
        for name, a in zip(labels, answers, strict=True)
    }
    return [
        FigureBlock(
            "swarm_latitude",
            f"Residual of the three satellites, spikes left out; tinted: beyond {_AURORA_DEG:g} deg.",
            gap_cases.by_latitude(tracks, "Swarm less CHAOS, 8 September 2014, b and S free", _AURORA_DEG),
        ),
        FigureBlock(
            "swarm_ranking",
            "The first effects of Swarm A's ranking, for all three: the same look-alikes, in like order.",
            gap_cases.groups(first, series, "drop of chi-square", "Each effect alone"),
        ),
    ]


def _aircraft_figure(outcome: Outcome) -> FigureBlock:
    found = _eddy(outcome.answer("aircraft-eddy_current"))
    published = -outcome.coefficients.symmetric_eddy_s
    series = {"published": [1e6 * float(published[i, j]) for _, i, j in _EDDY]}
    if found:
        series["found"] = [1e6 * found[name] for name, _, _ in _EDDY]
    return FigureBlock(
        "aircraft_eddy",
        "Eddy-current terms: the published ones, symmetric and without trace, and what eddy_current came out as.",
        gap_cases.groups([name for name, _, _ in _EDDY], series, "coefficient [us]", "An aircraft's eddy currents"),
    )


def _eddy(answer: Answer) -> dict[str, float]:
    effect = next((one for one in answer.found.effects if one.name == "eddy_current"), None)
    return {} if effect is None else {name: value.value for name, value in effect.parameters.items()}


def _alone(table: Alone) -> dict[str, Any]:
    return {
        "raw_nT": table.raw_nT, "modelled": list(table.modelled), "base_nT": table.base_nT,
        "effects": [
            {"effects": list(share.effects), "parameters": share.parameters, "left_nT": share.left_nT,
             "sizes": list(share.sizes)} for share in table.shares
        ],
    }  # fmt: skip


def _p_value(value: float) -> str:
    return "< 1e-12" if value < 1e-12 else f"{float(np.clip(value, 0, 1)):.1e}"
