"""`fluxtwin run elfin`: a real spinner calibrated zone by zone, diagnosed for what is unmodelled, and predicted unseen."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.plots.elfin import Response, residuals_figure, response_figure, zones_figure
from fluxtwin.scenarios.elfin.bending import Lags
from fluxtwin.scenarios.elfin.compute import Results, ZoneResult, compute
from fluxtwin.scenarios.elfin.unseen import Way
from fluxtwin.scenarios.elfin.zone_fit import KINDS
from fluxtwin.scenarios.page import Cell, FigureBlock, Page, StudyResult, Table
from fluxtwin.scenarios.recorded_files import Settings, check_folder, read_settings
from fluxtwin.scenarios.worded_page import PageWords
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import FloatArray

_WORDS = PageWords("fluxtwin.scenarios.elfin")
SETTINGS = Path(__file__).parent / "elfin.toml"
"""What the study runs with; a copy lies beside its results."""
_AGREE_S = 5e-4
"""A slip seen in the spin phase to within that is the one that the stamps show."""
_REACH = 0.5
"""Of the static sensor's rms on unseen zones."""
_SUNLIT = 0.999
_RANKED = 6


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings(SETTINGS)
    found = compute(check_folder(data, settings.files), settings, part_of(progress, 0.0, 0.95))
    progress("drawing", 0.95)
    values = _values(found, settings)
    tables = [_zone_table(found), _unseen_table(found, values), _found_table(found), _slip_table(found)]
    independent = [line.split(" | ") for line in _WORDS.say("independent_rows", **values).splitlines()]
    tables.append(_WORDS.table("independent", independent))
    page = _page(found, tables, values, settings)
    return StudyResult(
        name="elfin",
        status_line=page.verdict,
        summary=_summary(found, values["share"], independent, settings),
        tables=tables,
        page=page,
        written=[write_text(out / "elfin.toml", tomli_w.dumps(settings.tree))],
    )


def _values(found: Results, settings: Settings) -> dict[str, Any]:
    """What the words of the page and the rows of the independent figures take."""
    static = found.ways[0]
    off = [slip for slip in found.slips if abs(slip.stamps_late_s - slip.field_late_s) > _AGREE_S]
    sunny = [one for one in found.zones if one.zone.sunlit > _SUNLIT]
    response_X = np.concatenate([one.response[:, 0] for one in found.zones])
    noise = [one.noise_nT for one in found.zones]
    return {
        "o": found,
        "p": settings.printed,
        "refused": sum(bool(one.refusal) for one in found.zones),
        "share": lambda way: round(way.unseen_whole_nT / static.unseen_whole_nT, 3),
        "below": lambda way: sum(np.array(way.unseen_nT) < _REACH * np.array(static.unseen_nT)),
        "lags": lambda way: lags_words(way.lags_s),
        "tilted_deg": lambda way: _tilted_deg(found, way),
        "span": lambda values, digits=0: f"{min(values):.{digits}f} to {max(values):.{digits}f}",
        "median": np.median,
        "noise": noise,
        "noise_nT": float(np.median(noise)),
        "off": off,
        "agree_ms": 1e3 * _AGREE_S,
        "starting_nT": max(one.starting_nT for one in found.zones),
        "starting_rows": sum(one.zone.left_out.get("switching on", 0) for one in found.zones),
        **{kind: [one.fits[kind].rms_nT for one in found.zones] for kind in KINDS},
        **{f"sunlit_{kind}": [one.fits[kind].rms_nT for one in sunny] for kind in KINDS},
        "response_X": 100.0 * abs(response_X),
        "turn_XZ_deg": np.ptp(np.degrees(np.angle(response_X))),
        "slips_ms": [1e3 * abs(slip.stamps_late_s) for slip in found.slips],
        "slips_nT": max(slip.largest_nT for slip in found.slips),
    }


def _summary(
    found: Results, share: Callable[[Way], float], independent: list[list[str]], settings: Settings
) -> dict[str, Any]:
    return {
        "study": settings.name,
        "zones": [
            {
                "zone": one.zone.number,
                "rows": len(one.zone.telemetry),
                "left_out": one.zone.left_out,
                "lit": one.zone.sunlit,
                "spin_period_s": _period_s(one),
                "rms_nT": {kind: fit.rms_nT for kind, fit in one.fits.items()},
                "local_noise_nT": one.noise_nT,
                "scalar_refused": one.refusal or None,
                "switching_on_nT": one.starting_nT,
            }
            for one in found.zones
        ],
        "clock_slips": [vars(slip) for slip in found.slips],
        "unseen": [
            {
                "way": way.name,
                "lags_s": [list(series) for series in way.lags_s],
                "within_nT": list(way.within.rms_nT),
                "unseen_nT": list(way.unseen_nT),
                "unseen_all_nT": way.unseen_whole_nT,
                "of_static": share(way),
                "turn_deg": np.degrees(way.within.sensor.turn_rad).tolist(),
                "scale": way.within.sensor.scale.tolist(),
            }
            for way in found.ways
        ],
        "diagnosis": found.diagnosis.to_dict(),
        "diagnosis_in_shadow": found.in_shadow.to_dict(),
        "figures": [dict(zip(("what", "independent", "here", "remark"), row, strict=True)) for row in independent],
        "settings": settings.tree,
    }


def _page(found: Results, tables: list[Table], values: dict[str, Any], settings: Settings) -> Page:
    zones, unseen, diagnosed, slips, independent = tables
    responses, *predicted = _figures(found)
    refused = _WORDS.table("refusals", [[one.zone.number, one.refusal or "not refused"] for one in found.zones])
    return Page(
        title="ELFIN-A, 12 January 2022: a spinner whose sensor follows sun and shadow",
        verdict=_WORDS.sentence("status", **values),
        sections=[
            _WORDS.section("assumptions"),
            _WORDS.section("scalar", [refused], **values),
            _WORDS.section("zones", [zones], [responses]),
            _WORDS.section("unmodelled", [diagnosed], **values),
            _WORDS.section("unseen", [unseen], predicted, **values),
            _WORDS.section("slips", [slips], **values),
            _WORDS.section("independent", [independent]),
        ],
        provenance={
            "data": "ELFIN-A, UCLA (V. Angelopoulos), NASA and NSF; github jiashuwu89/elf_fgm fbaba5dd",
            "field model": settings.field_model,
            "fluxtwin": metadata.version("fluxtwin"),
            "python": platform.python_version(),
        },
    )


def _zone_table(found: Results) -> Table:
    rows: list[list[Cell]] = []
    for one in found.zones:
        fitted = [round(one.fits[kind].rms_nT, 1) for kind in KINDS]
        last = (round(one.noise_nT, 2), int((~one.zone.used).sum()))
        rows.append([one.zone.number, _light(one), round(_period_s(one), 4), *fitted, *last])
    return _WORDS.table("zones", rows)


def _slip_table(found: Results) -> Table:
    rows: list[list[Cell]] = []
    for slip in found.slips:
        late_ms = [round(1e3 * float(late), 1) for late in (slip.stamps_late_s, slip.field_late_s)]
        rows.append([slip.zone, slip.start_utc, slip.rows, *late_ms, round(slip.largest_nT)])
    return _WORDS.table("slips", rows)


def _unseen_table(found: Results, values: dict[str, Any]) -> Table:
    rows: list[list[Cell]] = []
    for place, one in enumerate(found.zones):
        predicted = [round(way.unseen_nT[place]) for way in found.ways]
        own = round(one.fits["static"].rms_nT)
        rows.append([str(one.zone.number), _light(one), own, *predicted, round(one.noise_nT, 1)])
    own_nT, noise_nT = (float(np.sqrt(np.mean(np.square(values[name])))) for name in ("static", "noise"))
    whole = [round(way.unseen_whole_nT) for way in found.ways]
    rows.append(["all", "", round(own_nT), *whole, round(noise_nT, 1)])
    rows.append(["of static", "", None, *map(values["share"], found.ways), None])
    headings = [f"unseen, {way.name} [nT]" for way in found.ways]
    return _WORDS.table("unseen", rows, [*headings, "local noise [nT]"], **values)


def _found_table(found: Results) -> Table:
    """Both answers of the diagnosis, and the causes by what each explains alone."""
    rows: list[list[Cell]] = []
    for words, one in (("all", found.diagnosis), ("begin in shadow", found.in_shadow)):
        named = ", ".join(" or ".join(effect.group) for effect in one.effects)
        ranked = ", ".join(f"{cause.name} {cause.drop:.3g}" for cause in one.ranking[:_RANKED])
        rms_nT = (round(one.gap.before_nT), round(one.gap.after_nT))
        rows.append([words, one.verdict, named, ", ".join(one.resembles), ranked, *rms_nT])
    return _WORDS.table("diagnoses", rows)


def _tilted_deg(found: Results, way: Way) -> float:
    """How far the sensor tilts from one moment of the zones to another, at most; its turn about the spin axis cannot be
    distinguished from the spin phase."""
    seconds = np.concatenate([one.zone.seconds[one.zone.used][::50] for one in found.zones])
    states = np.stack([found.flight.day.lagged(seconds, *series) for series in way.lags_s], axis=1)
    tilts = (states @ way.within.sensor.turn_rad)[:, :2]
    return float(np.degrees(np.linalg.norm(tilts[:, None, :] - tilts[None, :, :], axis=2).max()))


def _figures(found: Results) -> list[FigureBlock]:
    day = found.flight.day
    shadows = [day.shadow_s(float(one.zone.seconds[0])) for one in found.zones]

    def response(one: ZoneResult, entry_s: float, channel: int) -> Response:
        size: FloatArray = np.abs(one.response[:, channel])
        return Response(f"zone {one.zone.number}", one.middle_s - entry_s, size, one.zone.sunlit > _SUNLIT)

    channels = {
        name: [response(one, shadow[0], place) for one, shadow in zip(found.zones, shadows, strict=True)]
        for place, name in enumerate(("channel X", "channel Y"))
    }
    series_nT: dict[str, Sequence[float]] = {f"unseen: {way.name}": way.unseen_nT for way in found.ways}
    series_nT["static, the zone's own"] = [one.fits["static"].rms_nT for one in found.zones]
    series_nT["local noise"] = [one.noise_nT for one in found.zones]
    numbers = [one.zone.number for one in found.zones]
    shown = {f"zone {numbers[place]}": residuals for place, residuals in found.shown.items()}
    return [
        _WORDS.figure("responses", response_figure(channels, shadows[0][1])),
        _WORDS.figure("unseen_zones", zones_figure(series_nT, numbers)),
        _WORDS.figure("unseen_residuals", residuals_figure(shown)),
    ]


def lags_words(lags_s: Lags) -> str:
    """ "200 + 200": in series; "200; 400": side by side."""
    return "; ".join(" + ".join(f"{lag:g}" for lag in series) for series in lags_s)


def _period_s(one: ZoneResult) -> float:
    return 2.0 * float(np.pi) / one.fits["static"].rate_rad_s


def _light(one: ZoneResult) -> str:
    lit = one.zone.sunlit
    return "sunlit" if lit > _SUNLIT else "shadow" if lit < 1.0 - _SUNLIT else "shadow, then sun"
