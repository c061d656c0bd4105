"""The telling half of the study: tables, figures, summary and page from what was computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fluxtwin.plots.field_residuals import ResidualTrack, residual_map, residual_series
from fluxtwin.scenarios.flight_field import causes
from fluxtwin.scenarios.flight_field.compute import Fit, Outcome
from fluxtwin.scenarios.flight_field.figures import Finding
from fluxtwin.scenarios.flight_field.residuals import COMPONENTS, Residual, low_latitude, rms, statistics
from fluxtwin.scenarios.flight_field.settings import Settings
from fluxtwin.scenarios.page import Cell, FigureBlock, Page, Section, Table
from fluxtwin.sim.base.types import BoolArray
from fluxtwin.sim.earth import epoch

_RING, _TIME, _PITCH = causes.RING_CURRENT, causes.TIME_OFFSET, causes.PITCH
_TRACK_KM_S = 7.7  # what MAGSAT covers over the ground track at orbit height in a second
_WHAT = {"rms": "rms", "mean": "mean", "share": "share of the mean taken", "kp": "Kp", "rc": "RC"}


def explanations(outcome: Outcome) -> Mapping[str, str]:
    """Why a figure differs, by its id: computed evidence, not an excuse."""
    lowest, highest = outcome.rc_range_nT
    stamps = outcome.swarm[0].track.time
    later = outcome.rc.nearest(stamps[-1] + np.timedelta64(60, "m"))
    return {
        "swarm-rc": f"along the track RC runs from {lowest:.0f} to {highest:.0f} nT; the printed value is that of "
        f"the hour after the track ({later:.0f} nT)"
    }


def summary(outcome: Outcome, findings: Sequence[Finding], settings: Settings) -> dict[str, Any]:
    """The content of summary.json."""
    return {
        "study": settings.name,
        "figures": [
            {
                "id": f.figure.id, "independent": f.figure.value, "printed": f.figure.printed, "here": f.here,
                "unit": f.figure.unit, "status": f.status, "why": f.why or None,
            }
            for f in findings
        ],
        "residuals": [
            {"track": r.track.name, "model": r.model, "selection": words, "samples": int(rows.sum())}
            | {f"{q}_{c}_nT": value for (q, c), value in statistics(r, rows).items()}
            for r, words, rows in _selections(outcome, settings)
        ],
        "causes": [
            {
                "track": f.track, "rows": f.rows, "on": f.fit.on, "size": dict(f.fit.size),
                "rms_before_nT": f.fit.rms_before_nT, "rms_after_nT": f.fit.rms_after_nT,
            }
            for f in outcome.fits
        ],
        "kp": [float(value) for value in outcome.kp],
        "settings": settings.model_dump(),
        "sources": {r.track.name: r.track.source for r in (outcome.magsat, outcome.swarm[0])},
    }  # fmt: skip


def tables(outcome: Outcome, findings: Sequence[Finding], settings: Settings) -> list[Table]:
    """The tables for the terminal and the page."""
    return [_figures_table(findings), _selection_table(outcome, settings), _causes_table(outcome.fits)]


def page(outcome: Outcome, findings: Sequence[Finding], settings: Settings) -> Page:
    """The whole report."""
    compared, selected, made_of = tables(outcome, findings, settings)
    return Page(
        title="The field models against magnetometers in orbit",
        verdict=_verdict(findings),
        sections=[
            Section("The independent figures found again", tables=[compared]),
            Section(
                "MAGSAT, 1 January 1980",
                paragraphs=_magsat_words(outcome),
                tables=[made_of],
                figures=_magsat_figures(outcome),
            ),
            Section(
                "Swarm A in the storm of 1 January 2016",
                paragraphs=_swarm_words(outcome),
                figures=_swarm_figures(outcome),
            ),
            Section("What the choices change", tables=[selected]),
        ],
        provenance=_provenance(outcome, settings),
    )


def _magsat_figures(outcome: Outcome) -> list[FigureBlock]:
    plain, explained, limit = outcome.magsat, outcome.magsat_explained, outcome.low_latitude_deg
    return [
        FigureBlock(
            "magsat_map",
            f"MAGSAT minus {plain.model}, {len(plain.track)} samples in 1.7 h. Dashed: the limit of low latitude, "
            f"{limit:g} deg.",
            residual_map(_drawn(plain), f"MAGSAT minus {plain.model}, 1 January 1980", limit),
        ),
        FigureBlock(
            "magsat_series",
            "The same along the orbit: IGRF-14 alone, and with the three causes fitted in the tinted band.",
            residual_series([_drawn(plain), _drawn(explained)], "MAGSAT minus model, 1 January 1980", limit),
        ),
    ]


def _swarm_figures(outcome: Outcome) -> list[FigureBlock]:
    storm, limit = outcome.swarm, outcome.low_latitude_deg
    low = low_latitude(storm[0].track, limit)
    title = "Swarm A minus model, 1 January 2016"
    return [
        FigureBlock(
            "swarm_low",
            "Swarm A at low latitude: the external field with RC takes most of the north residual. From 47 deg on the "
            "auroral currents, far south in this storm, are felt already.",
            residual_series([_drawn(r, low) for r in storm], f"{title}, below {limit:g} deg", limit),
        ),
        FigureBlock(
            "swarm_series",
            f"The whole pass. Beyond {limit:g} deg (the tinted band ends there) the auroral currents, which no model "
            f"here holds.",
            residual_series([_drawn(r) for r in storm], title, limit),
        ),
        FigureBlock(
            "swarm_map",
            f"Swarm A minus {storm[0].model}, one pass over the north pole.",
            residual_map(_drawn(storm[0]), f"Swarm A minus {storm[0].model}, 1 January 2016", limit),
        ),
    ]


def _figures_table(findings: Sequence[Finding]) -> Table:
    rows: list[list[Cell]] = []
    for f in findings:
        track, model, selection, quantity, component = f.figure.key
        what = _WHAT[quantity] if track == "index" or model == "index" else f"{_WHAT[quantity]} {component}"
        rows.append([track, model, selection, what, f.figure.unit, f.figure.printed, _rounded(f), f.status, f.why])
    return Table(
        "Independent figures and ours",
        ["track", "model", "rows", "what", "unit", "independent", "here", "status", "why"],
        rows,
        note="Measured minus model in geocentric north N, east E, centre C (down) and magnitude F. low: within "
        "50 deg of the equator. Reproduced: within one unit of the last digit printed.",
    )


def _selection_table(outcome: Outcome, settings: Settings) -> Table:
    rows: list[list[Cell]] = []
    for residual, words, chosen in _selections(outcome, settings):
        found = statistics(residual, chosen)
        numbers = [round(found[q, c], 2) for q in ("rms", "mean") for c in COMPONENTS]
        rows.append([residual.track.name, residual.model, words, int(chosen.sum()), *numbers])
    headings = [f"{q} {c} [nT]" for q in ("rms", "mean") for c in COMPONENTS]
    return Table(
        "Every selection and model",
        ["track", "model", "rows", "samples", *headings],
        rows,
        note="The MAGSAT figures are those of all rows, whatever their attitude flag; one epoch or each stamp's own "
        "makes no difference in an hour and three quarters.",
    )


def _causes_table(fits: Sequence[Fit]) -> Table:
    rows: list[list[Cell]] = []
    for f in fits:
        sizes = [None if name not in f.fit.size else round(f.fit.size[name], 3) for name in (_RING, _TIME, _PITCH)]
        before, after = round(f.fit.rms_before_nT, 1), round(f.fit.rms_after_nT, 1)
        rows.append([f.track, f.rows, f.fit.on, *sizes, before, after])
    return Table(
        "What the low-latitude residual to IGRF-14 is made of",
        ["track", "rows", "fitted to", _RING, _TIME, _PITCH, "rms before [nT]", "rms after [nT]"],
        rows,
        note="Least squares, each row a fit of its own; a blank was not fitted. Ring current: uniform field along the "
        "dipole axis with its induced part, at the dipole equator on the ground. Time offset: the position is ahead "
        "of the field by that much. Pitch: a turn about the orbit normal. The scatter between the passes is a fairer "
        "error bar than the formal one.",
    )


def _magsat_words(outcome: Outcome) -> list[str]:
    alone, with_time, with_pitch, whole, scalar = (f.fit for f in outcome.fits[:5])
    limit = "the band of low latitude"
    before, after = (_rms_beyond(r, outcome.low_latitude_deg) for r in (outcome.magsat, outcome.magsat_explained))
    seconds = scalar.size[_TIME]
    return [
        f"At low latitude the residual is {whole.rms_before_nT:.1f} nT rms per component. A ring current alone takes "
        f"little of it ({alone.rms_after_nT:.1f} nT left); with an error along the track {with_time.rms_after_nT:.1f} "
        f"nT are left, with a turn in pitch instead {with_pitch.rms_after_nT:.1f} nT, with all three "
        f"{whole.rms_after_nT:.1f} nT. Beyond {limit}, where nothing was fitted, the same three bring it from "
        f"{before:.0f} to {after:.0f} nT; what is left there is as ragged as auroral currents are.",
        f"The magnitude does not feel attitude. Fitted to it alone, a ring current of {scalar.size[_RING]:.0f} nT and "
        f"positions {seconds:.1f} s (about {_TRACK_KM_S * seconds:.0f} km) ahead of the field leave "
        f"{scalar.rms_after_nT:.1f} of {scalar.rms_before_nT:.1f} nT; the vector gives {whole.size[_RING]:.0f} nT, "
        f"{whole.size[_TIME]:.1f} s and a pitch of {whole.size[_PITCH]:.2f} deg. So the stamps or the positions of "
        f"this file are off by about a second; which of them, the file alone does not say.",
        f"Kp was {outcome.kp[0]:.1f} during the track and rose to {outcome.kp.max():.0f} later: not a quiet day.",
    ]


def _swarm_words(outcome: Outcome) -> list[str]:
    low = low_latitude(outcome.swarm[0].track, outcome.low_latitude_deg)
    mean = [statistics(r, low)["mean", "N"] for r in outcome.swarm]
    lowest, highest = outcome.rc_range_nT
    ring = outcome.fits[-2].fit
    hours = _local_time_h(outcome.swarm[0])
    return [
        f"RC was {lowest:.0f} to {highest:.0f} nT. At low latitude the mean of the north residual falls from "
        f"{mean[0]:.0f} nT (IGRF-14; {mean[1]:.0f} with the internal field of CHAOS-7) to {mean[2]:.0f} nT with the "
        f"external field and RC: the ring current is {1.0 - mean[2] / mean[0]:.2f} of it.",
        f"A uniform field along the dipole axis with its induced part, fitted here without any index, comes out at "
        f"{ring.size[_RING]:.0f} nT at the dipole equator and brings the rms per component from "
        f"{ring.rms_before_nT:.0f} to {ring.rms_after_nT:.0f} nT. RC is a mean over local time; this pass crosses the "
        f"equator at {hours:.1f} h local time, and in a storm the ring current is strongest in the evening.",
    ]


def _rms_beyond(residual: Residual, limit_deg: float) -> float:
    """rms per component of the rows that are not at low latitude."""
    return rms(residual.NEC_nT[~low_latitude(residual.track, limit_deg)])


def _local_time_h(residual: Residual) -> float:
    """Mean local time of the sample nearest to the equator."""
    track = residual.track
    row = int(np.argmin(np.abs(track.latitude_deg)))
    of_day = (track.time[row] - track.time[row].astype("datetime64[D]")).astype("int64") / 3600e9
    return float((of_day + track.longitude_deg[row] / 15.0) % 24.0)


def _verdict(findings: Sequence[Finding]) -> str:
    count = {status: sum(f.status == status for f in findings) for status in ("reproduced", "differs", "not testable")}
    others = ", ".join(f"{n} {status}" for status, n in count.items() if n and status != "reproduced")
    return (
        f"{count['reproduced']} of {len(findings)} independent figures of the field in orbit are reproduced"
        f"{' (' + others + ', explained)' if others else ''}."
    )


def _selections(outcome: Outcome, settings: Settings) -> list[tuple[Residual, str, BoolArray]]:
    chosen = []
    words = f"|latitude| < {settings.low_latitude_deg:g} deg"
    for residual in (outcome.magsat, outcome.magsat_at_stamps, outcome.magsat_explained, *outcome.swarm):
        low = low_latitude(residual.track, settings.low_latitude_deg)
        chosen += [(residual, "all", np.ones_like(low)), (residual, words, low)]
        if residual is outcome.magsat:
            good = residual.track.attitude_good
            chosen += [(residual, "attitude flag 0", good), (residual, f"attitude flag 0, {words}", good & low)]
    return chosen


def _rounded(finding: Finding) -> float | None:
    """Ours with one digit more than the printed figure."""
    if finding.here is None:
        return None
    return round(finding.here, 1 - int(np.floor(np.log10(finding.figure.last_digit))))


def _drawn(residual: Residual, rows: BoolArray | None = None) -> ResidualTrack:
    """The record that the figures take; of the chosen rows only, where some are chosen."""
    track = residual.track
    chosen = np.ones(len(track), dtype=bool) if rows is None else rows
    return ResidualTrack(
        residual.model, track.time[chosen], track.latitude_deg[chosen], track.longitude_deg[chosen],
        residual.NEC_nT[chosen], residual.F_nT[chosen],
    )  # fmt: skip


def _provenance(outcome: Outcome, settings: Settings) -> dict[str, str]:
    tracks = {r.track.name: r.track.source for r in (outcome.magsat, outcome.swarm[0])}
    spans = {
        f"{r.track.name}, span": f"{epoch.iso(r.track.time[0])} to {epoch.iso(r.track.time[-1])}"
        for r in (outcome.magsat, outcome.swarm[0])
    }
    models = {"field models": f"IGRF-14; {settings.swarm.chaos_file} to degree {settings.swarm.crust_degree}"}
    return {**tracks, **spans, **models, "settings": "flight_field.toml beside this page"}
