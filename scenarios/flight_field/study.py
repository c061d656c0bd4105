"""`fluxtwin run flight-field`: the field models against MAGSAT in 1980 and Swarm A in a storm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.plots.field_residuals import ResidualTrack, residual_map, residual_series
from fluxtwin.scenarios.flight_field.causes import PITCH, RING_CURRENT, TIME_OFFSET
from fluxtwin.scenarios.flight_field.compute import Outcome, compute, found_figures
from fluxtwin.scenarios.flight_field.figures import Figure, compare, read_figures
from fluxtwin.scenarios.flight_field.residuals import COMPONENTS, Residual, low_latitude, rms, statistics
from fluxtwin.scenarios.page import Cell, FigureBlock, Page, StudyResult, Table
from fluxtwin.scenarios.recorded_files import Settings, check_folder, read_settings
from fluxtwin.scenarios.worded_page import PageWords
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import BoolArray
from fluxtwin.sim.earth import epoch

_WORDS = PageWords("fluxtwin.scenarios.flight_field")
SETTINGS = Path(__file__).parent / "flight_field.toml"
"""What the study runs with; a copy lies beside its results."""
_NAMES = {"share": "share of the mean explained", "kp": "Kp", "rc": "RC"}
_CAUSES = (RING_CURRENT, TIME_OFFSET, PITCH)


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings(SETTINGS)
    outcome = compute(check_folder(data, settings.files), settings, part_of(progress, 0.0, 0.8))
    figures = compare(read_figures(), found_figures(outcome, settings), explanations(outcome))
    progress("drawing the residuals", 0.85)
    tables = [_figures_table(figures), _selection_table(outcome, settings), _causes_table(outcome)]
    page = _page(outcome, tables, settings, verdict(figures))
    return StudyResult(
        name="flight-field",
        status_line=page.verdict,
        summary=_summary(outcome, figures, settings),
        tables=tables,
        page=page,
        written=[write_text(out / "flight_field.toml", tomli_w.dumps(settings.tree))],
    )


def explanations(outcome: Outcome) -> Mapping[str, str]:
    """Why a figure differs, by its id: computed evidence, not an excuse."""
    later = outcome.rc.nearest(outcome.swarm[0].track.time[-1] + np.timedelta64(60, "m"))
    return {"swarm-rc": _WORDS.sentence("why_swarm_rc", o=outcome, later=later)}


def verdict(figures: Sequence[Figure]) -> str:
    """How many of the independent figures are reproduced."""
    count = Counter({"reproduced": 0} | Counter(figure.status for figure in figures))
    others = ", ".join(f"{count[status]} {status}" for status in ("differs", "not testable") if count[status])
    return _WORDS.sentence("verdict", count=count, total=len(figures), others=others)


def _summary(outcome: Outcome, figures: Sequence[Figure], settings: Settings) -> dict[str, Any]:
    sides = ("id", "printed", "here", "unit", "status")
    fitted = ("track", "rows", "on", "size", "rms_before_nT", "rms_after_nT")
    return {
        "study": settings.name,
        "figures": [
            {key: getattr(figure, key) for key in sides} | {"independent": figure.value, "why": figure.why or None}
            for figure in figures
        ],
        "residuals": [
            {"track": r.track.name, "model": r.model, "selection": words, "samples": int(rows.sum())}
            | {f"{quantity}_{part}_nT": value for (quantity, part), value in statistics(r, rows).items()}
            for r, words, rows in _selections(outcome, settings)
        ],
        "causes": [{key: getattr(fit, key) for key in fitted} for fit in outcome.fits],
        "kp": [float(value) for value in outcome.kp],
        "settings": settings.tree,
        "sources": {r.track.name: r.track.source for r in (outcome.magsat, outcome.swarm[0])},
    }


def _page(outcome: Outcome, tables: Sequence[Table], settings: Settings, line: str) -> Page:
    compared, selected, consists_of = tables
    tracks = (outcome.magsat.track, outcome.swarm[0].track)
    return Page(
        title="The field models against magnetometers in orbit",
        verdict=line,
        sections=[
            _WORDS.section("compared", [compared]),
            _WORDS.section("magsat", [consists_of], _magsat_figures(outcome, settings), **_magsat(outcome, settings)),
            _WORDS.section("swarm", [], _swarm_figures(outcome, settings), **_swarm(outcome, settings)),
            _WORDS.section("choices", [selected]),
        ],
        provenance={
            **{track.name: track.source for track in tracks},
            **{f"{track.name}, span": " to ".join(map(epoch.iso, track.time[[0, -1]])) for track in tracks},
            "field models": f"IGRF-14; {settings.swarm.chaos_file} to degree {settings.swarm.crust_degree}",
            "settings": "flight_field.toml beside this page",
        },
    )


def _magsat(outcome: Outcome, settings: Settings) -> dict[str, Any]:
    """The values in the words on MAGSAT."""
    high = ~low_latitude(outcome.magsat.track, settings.low_latitude_deg)
    beyond = tuple(rms(r.NEC_nT[high]) for r in (outcome.magsat, outcome.magsat_explained))
    fits = dict(zip(("alone", "with_time", "with_pitch", "whole", "scalar"), outcome.fits, strict=False))
    return {"o": outcome, "beyond": beyond, "ring": RING_CURRENT, "time": TIME_OFFSET, "pitch": PITCH, **fits}


def _swarm(outcome: Outcome, settings: Settings) -> dict[str, Any]:
    """The values in the words on Swarm; hours: local time of the sample nearest to the equator."""
    track = outcome.swarm[0].track
    low = low_latitude(track, settings.low_latitude_deg)
    mean = [statistics(residual, low)["mean", "N"] for residual in outcome.swarm]
    row = int(np.argmin(np.abs(track.latitude_deg)))
    of_day = (track.time[row] - track.time[row].astype("datetime64[D]")).astype("int64") / 3600e9
    hours = float((of_day + track.longitude_deg[row] / 15.0) % 24.0)
    return {"o": outcome, "mean": mean, "storm": outcome.fits[-2], "ring": RING_CURRENT, "hours": hours}


def _magsat_figures(outcome: Outcome, settings: Settings) -> list[FigureBlock]:
    plain, limit, day = outcome.magsat, settings.low_latitude_deg, "1 January 1980"
    drawn = residual_map(_drawn(plain), f"MAGSAT minus {plain.model}, {day}", limit)
    along = [_drawn(plain), _drawn(outcome.magsat_explained)]
    samples = plain.track.time.size
    return [
        _WORDS.figure("magsat_map", drawn, model=plain.model, samples=samples, limit=limit),
        _WORDS.figure("magsat_series", residual_series(along, f"MAGSAT minus model, {day}", limit)),
    ]


def _swarm_figures(outcome: Outcome, settings: Settings) -> list[FigureBlock]:
    storm, limit, day = outcome.swarm, settings.low_latitude_deg, "1 January 2016"
    low = low_latitude(storm[0].track, limit)
    title = f"Swarm A minus model, {day}"
    below = residual_series([_drawn(r, low) for r in storm], f"{title}, below {limit:g} deg", limit)
    drawn = residual_map(_drawn(storm[0]), f"Swarm A minus {storm[0].model}, {day}", limit)
    return [
        _WORDS.figure("swarm_low", below),
        _WORDS.figure("swarm_series", residual_series([_drawn(r) for r in storm], title, limit), limit=limit),
        _WORDS.figure("swarm_map", drawn, model=storm[0].model),
    ]


def _figures_table(figures: Sequence[Figure]) -> Table:
    rows: list[list[Cell]] = []
    for figure in figures:
        track, model, selection, quantity, component = figure.key
        name = _NAMES.get(quantity, quantity) + ("" if model == "index" else f" {component}")
        # one digit more than the printed figure
        digits = 1 - int(np.floor(np.log10(figure.last_digit)))
        here = None if figure.here is None else round(figure.here, digits)
        rows.append([track, model, selection, name, figure.unit, figure.printed, here, figure.status, figure.why])
    return _WORDS.table("figures", rows)


def _selection_table(outcome: Outcome, settings: Settings) -> Table:
    pairs = [(quantity, part) for quantity in ("rms", "mean") for part in COMPONENTS]
    rows: list[list[Cell]] = []
    for residual, words, chosen in _selections(outcome, settings):
        found = statistics(residual, chosen)
        numbers = [round(found[pair], 2) for pair in pairs]
        rows.append([residual.track.name, residual.model, words, int(chosen.sum()), *numbers])
    return _WORDS.table("selections", rows, [f"{quantity} {part} [nT]" for quantity, part in pairs])


def _causes_table(outcome: Outcome) -> Table:
    rows: list[list[Cell]] = []
    for fit in outcome.fits:
        sizes = [round(fit.size[name], 3) if name in fit.size else None for name in _CAUSES]
        rows.append([fit.track, fit.rows, fit.on, *sizes, round(fit.rms_before_nT, 1), round(fit.rms_after_nT, 1)])
    return _WORDS.table("causes", rows)


def _selections(outcome: Outcome, settings: Settings) -> Iterator[tuple[Residual, str, BoolArray]]:
    words = f"|latitude| < {settings.low_latitude_deg:g} deg"
    for residual in (outcome.magsat, outcome.magsat_at_stamps, outcome.magsat_explained, *outcome.swarm):
        low, good = low_latitude(residual.track, settings.low_latitude_deg), residual.track.attitude_good
        yield residual, "all", np.ones_like(low)
        yield residual, words, low
        if residual is outcome.magsat:
            yield residual, "attitude flag 0", good
            yield residual, f"attitude flag 0, {words}", good & low


def _drawn(residual: Residual, rows: BoolArray | slice = slice(None)) -> ResidualTrack:
    """The record that the figures take; of the chosen rows only, where some are chosen."""
    track = residual.track
    place = (track.time[rows], track.latitude_deg[rows], track.longitude_deg[rows])
    return ResidualTrack(residual.model, *place, residual.NEC_nT[rows], residual.F_nT[rows])
