"""`fluxtwin run flight-field`: the field models against MAGSAT in 1980 and Swarm A in a storm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from matplotlib.figure import Figure as Drawing

from fluxtwin.plots.field_residuals import ResidualTrack, residual_map, residual_series
from fluxtwin.scenarios.flight_field.causes import PITCH, RING_CURRENT, TIME_OFFSET
from fluxtwin.scenarios.flight_field.compute import Outcome, compute, found_figures
from fluxtwin.scenarios.flight_field.figures import Figure, compare, read_figures
from fluxtwin.scenarios.flight_field.residuals import COMPONENTS, Residual, low_latitude, rms, statistics
from fluxtwin.scenarios.page import Cell, Page, StudyResult
from fluxtwin.scenarios.recorded_files import Settings, check_folder, read_settings
from fluxtwin.scenarios.worded_page import PageWords
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import BoolArray
from fluxtwin.sim.earth import epoch

_WORDS = PageWords("fluxtwin.scenarios.flight_field")
SETTINGS = Path(__file__).parent / "flight_field.toml"
"""What the study runs with; a copy lies beside its results."""


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings(SETTINGS)
    outcome = compute(check_folder(data, settings.files), settings, part_of(progress, 0.0, 0.8))
    figures = compare(read_figures(), found_figures(outcome, settings), explanations(outcome))
    progress("drawing the residuals", 0.85)
    values = _values(outcome, figures, settings)
    tracks = (outcome.magsat.track, outcome.swarm[0].track)
    page = Page(
        title="The field models against magnetometers in orbit",
        verdict=_WORDS.sentence("verdict", **values),
        sections=_WORDS.sections(values, _drawn(outcome, settings.low_latitude_deg)),
        provenance={
            **{track.name: track.source for track in tracks},
            **{f"{track.name}, span": " to ".join(map(epoch.iso, track.time[[0, -1]])) for track in tracks},
            "field models": f"IGRF-14; {settings.swarm.chaos_file} to degree {settings.swarm.crust_degree}",
            "settings": "flight_field.toml beside this page",
        },
    )
    return StudyResult(
        name="flight-field",
        status_line=page.verdict,
        summary=_summary(outcome, figures, settings),
        tables=[_WORDS.table(name, values) for name in ("figures", "selections", "causes")],
        page=page,
        written=[write_text(out / "flight_field.toml", tomli_w.dumps(settings.tree))],
    )


def explanations(outcome: Outcome) -> Mapping[str, str]:
    """Why a figure differs, by its id: computed evidence, not an excuse."""
    later = outcome.rc.nearest(outcome.swarm[0].track.time[-1] + np.timedelta64(60, "m"))
    return {"swarm-rc": _WORDS.sentence("why_swarm_rc", o=outcome, later=later)}


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


def _values(outcome: Outcome, figures: Sequence[Figure], settings: Settings) -> dict[str, Any]:
    """What the words and tables of the page take; hours: local time of Swarm's sample nearest to the equator."""
    count = Counter({"reproduced": 0} | Counter(figure.status for figure in figures))
    high = ~low_latitude(outcome.magsat.track, settings.low_latitude_deg)
    swarm = outcome.swarm[0].track
    low = low_latitude(swarm, settings.low_latitude_deg)
    row = int(np.argmin(np.abs(swarm.latitude_deg)))
    of_day = (swarm.time[row] - swarm.time[row].astype("datetime64[D]")).astype("int64") / 3600e9
    pairs = [(quantity, part) for quantity in ("rms", "mean") for part in COMPONENTS]
    selections: list[list[Cell]] = []
    for residual, words, chosen in _selections(outcome, settings):
        numbers = [round(statistics(residual, chosen)[pair], 2) for pair in pairs]
        selections.append([residual.track.name, residual.model, words, int(chosen.sum()), *numbers])
    return {
        "o": outcome,
        "limit": settings.low_latitude_deg,
        "figures": figures,
        "names": {"share": "share of the mean explained", "kp": "Kp", "rc": "RC"},
        "count": count,
        "others": ", ".join(f"{count[status]} {status}" for status in ("differs", "not testable") if count[status]),
        "beyond": tuple(rms(r.NEC_nT[high]) for r in (outcome.magsat, outcome.magsat_explained)),
        **dict(zip(("alone", "with_time", "with_pitch", "whole", "scalar"), outcome.fits, strict=False)),
        "ring": RING_CURRENT,
        "time": TIME_OFFSET,
        "pitch": PITCH,
        "mean": [statistics(residual, low)["mean", "N"] for residual in outcome.swarm],
        "storm": outcome.fits[-2],
        "hours": float((of_day + swarm.longitude_deg[row] / 15.0) % 24.0),
        "pairs": pairs,
        "rows": {"selections": selections},
    }


def _drawn(outcome: Outcome, limit: float) -> dict[str, Drawing]:
    magsat, storm = outcome.magsat, outcome.swarm
    low = low_latitude(storm[0].track, limit)
    then, now = "1 January 1980", "1 January 2016"
    title = f"Swarm A minus model, {now}"
    along = [_track(magsat), _track(outcome.magsat_explained)]
    return {
        "magsat_map": residual_map(_track(magsat), f"MAGSAT minus {magsat.model}, {then}", limit),
        "magsat_series": residual_series(along, f"MAGSAT minus model, {then}", limit),
        "swarm_low": residual_series([_track(r, low) for r in storm], f"{title}, below {limit:g} deg", limit),
        "swarm_series": residual_series([_track(r) for r in storm], title, limit),
        "swarm_map": residual_map(_track(storm[0]), f"Swarm A minus {storm[0].model}, {now}", limit),
    }


def _selections(outcome: Outcome, settings: Settings) -> Iterator[tuple[Residual, str, BoolArray]]:
    words = f"|latitude| < {settings.low_latitude_deg:g} deg"
    for residual in (outcome.magsat, outcome.magsat_at_stamps, outcome.magsat_explained, *outcome.swarm):
        low, good = low_latitude(residual.track, settings.low_latitude_deg), residual.track.attitude_good
        yield residual, "all", np.ones_like(low)
        yield residual, words, low
        if residual is outcome.magsat:
            yield residual, "attitude flag 0", good
            yield residual, f"attitude flag 0, {words}", good & low


def _track(residual: Residual, rows: BoolArray | slice = slice(None)) -> ResidualTrack:
    """The record that the figures take; of the chosen rows only, where some are chosen."""
    track = residual.track
    place = (track.time[rows], track.latitude_deg[rows], track.longitude_deg[rows])
    return ResidualTrack(residual.model, *place, residual.NEC_nT[rows], residual.F_nT[rows])
