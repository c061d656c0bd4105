"""`fluxtwin run elfin`: a real spinner calibrated zone by zone, diagnosed for what is unmodelled, and predicted unseen."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from fluxtwin.plots.elfin import Response, residuals_figure, response_figure, zones_figure
from fluxtwin.scenarios.elfin.bending import Lags
from fluxtwin.scenarios.elfin.compute import SUNLIT, Results, ZoneResult, compute
from fluxtwin.scenarios.elfin.unseen import Way
from fluxtwin.scenarios.elfin.zone_fit import KINDS
from fluxtwin.scenarios.page import Cell, Page, StudyResult
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
_RANKED = 6


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings(SETTINGS)
    found = compute(check_folder(data, settings.files), settings, part_of(progress, 0.0, 0.95))
    progress("drawing", 0.95)
    values = _values(found, settings)
    page = Page(
        title="ELFIN-A, 12 January 2022: a spinner whose sensor follows sun and shadow",
        verdict=_WORDS.sentence("status", **values),
        sections=_WORDS.sections(values, _figures(found)),
        provenance={
            "data": "ELFIN-A, UCLA (V. Angelopoulos), NASA and NSF; github jiashuwu89/elf_fgm fbaba5dd",
            "field model": settings.field_model,
            "fluxtwin": metadata.version("fluxtwin"),
            "python": platform.python_version(),
        },
    )
    return StudyResult(
        name="elfin",
        status_line=page.verdict,
        summary=_summary(found, values, settings),
        tables=[_WORDS.table(name, values) for name in ("zones", "unseen", "diagnoses", "slips", "independent")],
        page=page,
        written=[write_text(out / "elfin.toml", tomli_w.dumps(settings.tree))],
    )


def _values(found: Results, settings: Settings) -> dict[str, Any]:
    """What the words of the page and the rows of the independent figures take."""
    static = found.ways[0]
    off = [slip for slip in found.slips if abs(slip.stamps_late_s - slip.field_late_s) > _AGREE_S]
    sunny = [one for one in found.zones if one.zone.sunlit > SUNLIT]
    response_X = np.concatenate([one.response[:, 0] for one in found.zones])
    noise = [one.noise_nT for one in found.zones]
    values: dict[str, Any] = {
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
        "ranked": lambda one: ", ".join(f"{cause.name} {cause.drop:.3g}" for cause in one.ranking[:_RANKED]),
    }
    independent = [line.split(" | ") for line in _WORDS.say("independent_rows", **values).splitlines()]
    return values | {"rows": {"independent": independent, "unseen": _unseen_rows(found, values)}}


def _summary(found: Results, values: dict[str, Any], settings: Settings) -> dict[str, Any]:
    return {
        "study": settings.name,
        "zones": [
            {
                "zone": one.zone.number,
                "rows": len(one.zone.telemetry),
                "left_out": one.zone.left_out,
                "lit": one.zone.sunlit,
                "spin_period_s": one.period_s,
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
                "of_static": values["share"](way),
                "turn_deg": np.degrees(way.within.sensor.turn_rad).tolist(),
                "scale": way.within.sensor.scale.tolist(),
            }
            for way in found.ways
        ],
        "diagnosis": found.diagnosis.to_dict(),
        "diagnosis_in_shadow": found.in_shadow.to_dict(),
        "figures": [
            dict(zip(("what", "independent", "here", "remark"), row, strict=True))
            for row in values["rows"]["independent"]
        ],
        "settings": settings.tree,
    }


def _unseen_rows(found: Results, values: dict[str, Any]) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    for place, one in enumerate(found.zones):
        predicted = [round(way.unseen_nT[place]) for way in found.ways]
        own = round(one.fits["static"].rms_nT)
        rows.append([str(one.zone.number), one.light, own, *predicted, round(one.noise_nT, 1)])
    own_nT, noise_nT = (float(np.sqrt(np.mean(np.square(values[name])))) for name in ("static", "noise"))
    rows.append(["all", "", round(own_nT), *(round(way.unseen_whole_nT) for way in found.ways), round(noise_nT, 1)])
    rows.append(["of static", "", None, *map(values["share"], found.ways), None])
    return rows


def _tilted_deg(found: Results, way: Way) -> float:
    """How far the sensor tilts from one moment of the zones to another, at most; its turn about the spin axis cannot be
    distinguished from the spin phase."""
    seconds = np.concatenate([one.zone.seconds[one.zone.used][::50] for one in found.zones])
    states = np.stack([found.flight.day.lagged(seconds, *series) for series in way.lags_s], axis=1)
    tilts = (states @ way.within.sensor.turn_rad)[:, :2]
    return float(np.degrees(np.linalg.norm(tilts[:, None, :] - tilts[None, :, :], axis=2).max()))


def _figures(found: Results) -> dict[str, Figure]:
    day = found.flight.day
    shadows = [day.shadow_s(float(one.zone.seconds[0])) for one in found.zones]

    def response(one: ZoneResult, entry_s: float, channel: int) -> Response:
        size: FloatArray = np.abs(one.response[:, channel])
        return Response(f"zone {one.zone.number}", one.middle_s - entry_s, size, one.zone.sunlit > SUNLIT)

    channels = {
        name: [response(one, shadow[0], place) for one, shadow in zip(found.zones, shadows, strict=True)]
        for place, name in enumerate(("channel X", "channel Y"))
    }
    series_nT: dict[str, Sequence[float]] = {f"unseen: {way.name}": way.unseen_nT for way in found.ways}
    series_nT["static, the zone's own"] = [one.fits["static"].rms_nT for one in found.zones]
    series_nT["local noise"] = [one.noise_nT for one in found.zones]
    numbers = [one.zone.number for one in found.zones]
    shown = {f"zone {numbers[place]}": residuals for place, residuals in found.shown.items()}
    return {
        "responses": response_figure(channels, shadows[0][1]),
        "unseen_zones": zones_figure(series_nT, numbers),
        "unseen_residuals": residuals_figure(shown),
    }


def lags_words(lags_s: Lags) -> str:
    """ "200 + 200": in series; "200; 400": side by side."""
    return "; ".join(" + ".join(f"{lag:g}" for lag in series) for series in lags_s)
