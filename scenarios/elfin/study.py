"""`fluxtwin run elfin`: a real spinner calibrated zone by zone, asked what is unmodelled, and predicted where unseen."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.scenarios.elfin import tables
from fluxtwin.scenarios.elfin.compute import Results, compute
from fluxtwin.scenarios.elfin.settings import Settings, read_settings
from fluxtwin.scenarios.page import Page, Section, StudyResult, Table
from fluxtwin.scenarios.recorded_files import check_folder
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent

_AGREE_S = 5e-4
"""A slip seen in the spin phase to within that is the one that the stamps show."""
REACH = 0.5
"""Of the static sensor's rms on unseen zones."""
ASSUMED = (
    "The body's axis of spin is the reported one. Its azimuth is a convention: channel Z's response across the axis is put "
    "on +y. The spin phase of a zone is an angle, a rate and a drift of the rate, estimated from the same readings.",
    "The temperature of the boom is nowhere recorded. What follows sun and shadow here follows the sunlight of the whole "
    "day along the orbit, from geometry (the file's own flag is wrong in three stretches of that day), behind lags.",
    "The field stays within a few degrees of the spin plane, so the response along the axis is known from small changes "
    "of the field along it only.",
)


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings()
    folder = check_folder(data, settings.files)
    results = compute(folder, settings, part_of(progress, 0.0, 0.95))
    progress("drawing", 0.95)
    line = status(results)
    saved = write_text(out / "elfin.toml", tomli_w.dumps(settings.model_dump()))
    return StudyResult(
        name="elfin",
        status_line=line,
        summary=summary(results, settings),
        tables=_tables(results, settings),
        page=page(results, settings, line),
        written=[saved],
    )


def status(results: Results) -> str:
    """One sentence."""
    best, static = results.best, results.told[0]
    reached = [b < REACH * s for b, s in zip(best.unseen_nT, static.unseen_nT, strict=True)]
    refused = sum(bool(told.refusal) for told in results.zones)
    names = ", ".join(effect.name for effect in results.diagnosis.effects) or "no known cause for all of it"
    return (
        f"ELFIN-A: the scalar fit is refused in {refused} of {len(results.zones)} zones; on unseen zones "
        f"{best.way.about} leave {best.unseen_whole_nT:.0f} nT where a static sensor leaves "
        f"{static.unseen_whole_nT:.0f} ({tables.share(results, best):.2f}), below half in {sum(reached)} of "
        f"{len(reached)}; the diagnosis names {names}."
    )


def summary(results: Results, settings: Settings) -> dict[str, Any]:
    """The content of `summary.json`."""
    return {
        "study": settings.name,
        "zones": [
            {
                "zone": told.zone.number,
                "rows": len(told.zone.telemetry),
                "left_out": told.zone.left_out,
                "lit": float(told.zone.lit.mean()),
                "spin_period_s": 2.0 * float(np.pi) / told.fits["static"].rate_rad_s,
                "rms_nT": {kind: fit.rms_nT for kind, fit in told.fits.items()},
                "local_noise_nT": told.noise_nT,
                "scalar_refused": told.refusal or None,
                "switching_on_nT": told.starting_nT,
            }
            for told in results.zones
        ],
        "clock_slips": [vars(slip) for slip in results.slips],
        "unseen": [
            {
                "way": told.way.name,
                "lags_s": [list(series) for series in told.lags_s],
                "within_nT": list(told.within.rms_nT),
                "unseen_nT": list(told.unseen_nT),
                "unseen_all_nT": told.unseen_whole_nT,
                "of_static": tables.share(results, told),
                "turn_deg": np.degrees(told.within.sensor.turn_rad).tolist(),
                "scale": told.within.sensor.scale.tolist(),
            }
            for told in results.told
        ],
        "diagnosis": results.diagnosis.to_dict(),
        "diagnosis_in_shadow": results.in_shadow.to_dict(),
        "figures": [
            {"what": what, "independent": theirs, "here": ours, "remark": remark}
            for what, theirs, ours, remark in tables.figures(results, settings)
        ],
        "settings": settings.model_dump(),
    }


def _tables(results: Results, settings: Settings) -> list[Table]:
    return [
        tables.zone_table(results),
        tables.unseen_table(results),
        tables.found_table(results),
        tables.slip_table(results),
        tables.figures_table(results, settings),
    ]


def page(results: Results, settings: Settings, verdict: str) -> Page:
    """The report."""
    zones, unseen, found, slips, figures = _tables(results, settings)
    drawn = tables.blocks(results)
    return Page(
        title="ELFIN-A, 12 January 2022: a spinner whose sensor follows sun and shadow",
        verdict=verdict,
        sections=[
            Section("What is assumed", ASSUMED),
            Section("The scalar fit", _scalar_words(results), [tables.refusal_table(results)]),
            Section("Each zone by itself", [], [zones], [drawn[0]]),
            Section("What is unmodelled", _diagnosis_words(results), [found]),
            Section("Zones that were not used", _unseen_words(results), [unseen], drawn[1:]),
            Section("Clock slips and switching on", _slip_words(results), [slips]),
            Section("The independent figures", [], [figures]),
        ],
        provenance={
            "data": "ELFIN-A, UCLA (V. Angelopoulos), NASA and NSF; github jiashuwu89/elf_fgm fbaba5dd",
            "field model": settings.field_model,
            "fluxtwin": metadata.version("fluxtwin"),
            "python": platform.python_version(),
        },
    )


def _scalar_words(results: Results) -> list[str]:
    refused = [told for told in results.zones if told.refusal]
    return [
        f"The size of the field alone is asked for S and b of each zone: refused in {len(refused)} of "
        f"{len(results.zones)}. The field stays near the spin plane, so the direction along the spin axis is free."
    ]


def _diagnosis_words(results: Results) -> list[str]:
    words = []
    for which, found in (("All zones", results.diagnosis), ("The zones that begin in shadow", results.in_shadow)):
        gap = found.gap
        closed = "" if gap.closed is None or gap.closed <= 0.0 else f", {gap.closed:.0%} of the gap"
        fails = " What is named does not hold on stretches it was not fitted to: it explains nothing here."
        words.append(
            f"{which}: {found.sentence} On held-out samples the residual goes from {gap.before_nT:.0f} to "
            f"{gap.after_nT:.0f} nT a component{closed}; the noise it can reach is {gap.floor_nT:.0f} nT."
            + (fails if gap.after_nT > gap.before_nT else "")
        )
    return words


def _unseen_words(results: Results) -> list[str]:
    static = results.told[0]
    words = []
    for told in results.told[1:]:
        below = sum(b < REACH * s for b, s in zip(told.unseen_nT, static.unseen_nT, strict=True))
        words.append(
            f"{told.way.about[0].upper()}{told.way.about[1:]}: {told.unseen_whole_nT:.0f} nT on unseen zones "
            f"({tables.share(results, told):.2f} of static), below half in {below} of {len(static.unseen_nT)} zones; the "
            f"sensor tilts by up to {tables.tilted_deg(results, told):.1f} deg."
        )
    words.append(
        "These tilts are what the fits need, not what was measured. They are large for a boom, change with what else is "
        "fitted, and the source does not say that it bends: an error of the attitude or of the responses that follows the "
        "sunlight passes for a tilt here."
    )
    noise = float(np.median([told.noise_nT for told in results.zones]))
    words.append(f"The local noise is {noise:.1f} nT: what is left is not noise.")
    return words


def _slip_words(results: Results) -> list[str]:
    starting = max(told.starting_nT for told in results.zones)
    count = sum(told.zone.left_out.get("switching on", 0) for told in results.zones)
    off = [slip for slip in results.slips if abs(slip.stamps_late_s - slip.field_late_s) > _AGREE_S]
    agree = len(results.slips) - len(off)
    others = "".join(
        f" Not so in zone {slip.zone} at {slip.start_utc}: stamps {1e3 * slip.stamps_late_s:.1f} ms late, readings "
        f"{1e3 * slip.field_late_s:.1f} ms: only a part of that packet may be off."
        for slip in off
    )
    return [
        f"{len(results.slips)} stretches of up to one packet carry stamps that the spacing of the stamps gives away; the "
        f"spin phase of the readings confirms {agree} of them to {1e3 * _AGREE_S:g} ms, and that there the readings "
        "themselves kept time." + others,
        f"In the first second of a zone the readings settle, up to {starting:.0f} nT off: {count} rows are left out as "
        "switching on.",
    ]
