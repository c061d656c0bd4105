"""`fluxtwin run elfin`: a real spinner calibrated zone by zone, diagnosed for what is unmodelled, and predicted unseen."""

from __future__ import annotations

import platform
from dataclasses import replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.calib.scalar.calibrate import calibrate_scalar
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.scenarios.elfin.record import Day, Slip, Zone, read_flight
from fluxtwin.scenarios.elfin.sensor import Lags, compare, record_of
from fluxtwin.scenarios.elfin.zone_fit import KINDS, ZoneFit, fit_zone, local_noise_nT, responses
from fluxtwin.scenarios.flights import Numbers, rms
from fluxtwin.scenarios.page import Cell, StudyResult
from fluxtwin.scenarios.recorded_files import Settings, run_on_files
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.field_models import FieldModel

SETTINGS = Path(__file__).parent / "elfin.toml"
"""What the study runs with; a copy lies beside its results."""
NAMED = ("boom", "boom, two lags")
"""Models whose lags the diagnosis may be given: the one that fits all zones best."""
SUNLIT = 0.999
"""Mean share of the sun in view from which on a zone is sunlit."""
_NEIGHBOURS = 50
_LSB_NT = 0.01
_AGREE_S = 5e-4
"""A slip seen in the spin phase to within that is the one that the stamps show."""
_REACH = 0.5
"""Of the static sensor's rms on unseen zones."""
_RANKED = 6


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study, as `run_on_files`."""
    return run_on_files(SETTINGS, out, data, progress, compute, present)


def compute(folder: Path, settings: Settings, progress: Progress = silent) -> Numbers:
    """Everything; errors as `read_flight`."""
    model = load_field(settings.field_model)
    progress("reading", 0.0)
    flight = read_flight(folder, settings, model)
    zones = []
    for number, zone in enumerate(flight.zones):
        progress(f"zone {zone.number}", 0.05 + 0.25 * number / len(flight.zones))
        zones.append(_zone(zone, flight.day, settings, model))
    own: list[ZoneFit] = [one.fits["static"] for one in zones]
    ways = compare(flight, own, settings, part_of(progress, 0.3, 0.75))
    best = min(ways[1:], key=lambda way: way.unseen_whole_nT)
    boom = min((way for way in ways if way.name in NAMED), key=lambda way: way.within.whole_nT)
    component = float(np.median([one.noise_nT for one in zones]) / np.sqrt(3.0))
    # the attitude is as uncertain as the spin axis is stated to be
    budget = Budget(component, _LSB_NT, flight.axis_sigma_rad, None)
    shadow = [place for place, zone in enumerate(flight.zones) if zone.lit[0] < 0.5]
    diagnoses = []
    for share, places in ((0.75, range(len(zones))), (0.85, shadow)):
        part = replace(flight, zones=tuple(flight.zones[place] for place in places))
        record = record_of(part, [own[place] for place in places], boom.lags_s[0], settings)
        diagnoses.append(diagnose(record, model, budget=budget, progress=part_of(progress, share, share + 0.1)))
    sunny, dark = ([k for k, zone in enumerate(flight.zones) if (zone.sunlit > 0.5) == lit] for lit in (True, False))
    return Numbers(
        flight=flight,
        zones=tuple(zones),
        slips=tuple(_seen(one, slip) for one in zones for slip in one.zone.slips),
        ways=ways,
        # The model with the smallest residual on unseen zones.
        best=best,
        # Of all zones, and of those that begin in shadow.
        diagnosis=diagnoses[0],
        in_shadow=diagnoses[1],
        # How long the shadow before the first zone lasts.
        shadow_s=flight.day.shadow_s(float(flight.zones[0].seconds[0]))[1],
        # Of two zones, by number: minutes and residual of the static and of the best model, both fitted without the zone.
        shown={
            flight.zones[place].number: [one for way in (ways[0], best) for one in way.unseen[place]]
            for place in (dark[len(dark) // 2], sunny[-1] if sunny else dark[-1])
        },
    )


def _zone(zone: Zone, day: Day, settings: Settings, model: FieldModel) -> Numbers:
    """One zone by itself."""
    static = fit_zone(zone, "static", settings)
    fits = {"static": static} | {kind: fit_zone(zone, kind, settings, static.rate_rad_s) for kind in KINDS[1:]}
    first = zone.seconds < zone.seconds[0] + settings.switch_on_s
    middle_s, response = responses(zone, static)
    lit = zone.sunlit
    return Numbers(
        zone=zone,
        light="sunlit" if lit > SUNLIT else "shadow" if lit < 1.0 - SUNLIT else "shadow, then sun",
        fits=fits,
        # Of the spin.
        period_s=2.0 * float(np.pi) / static.rate_rad_s,
        # Length of the residual vector, local; and largest in the rows after switching on.
        noise_nT=local_noise_nT(zone, static),
        starting_nT=np.linalg.norm(fits["harmonic"].residual_nT[first], axis=1).max(),
        # Why the scalar fit was refused; empty: it was not.
        refusal=refusal(zone, model),
        # (M,) since the shadow before was entered, and (M, 3) complex, see `responses`.
        since_shadow_s=middle_s - day.shadow_s(float(zone.seconds[0]))[0],
        response=response,
    )


def refusal(zone: Zone, model: FieldModel) -> str:
    """Why the scalar fit of this zone alone is refused; empty where it gets an answer."""
    try:
        calibrate_scalar(zone.telemetry, model, parameters="b,S", robust="none")
    except NoAnswer as error:
        return str(error)
    return ""


def _seen(one: Numbers, slip: Slip) -> Numbers:
    """A slip named by its stamps, and what the spin phase of the readings says of it: the phase by which the readings differ
    from their neighbours, over the rate."""
    fit: ZoneFit = one.fits["harmonic"]
    zone: Zone = one.zone

    def late_s(rows: np.ndarray) -> float:
        slope, residual = fit.slope_nT[rows], fit.residual_nT[rows]
        return -float((slope * residual).sum() / (slope**2).sum()) / fit.rate_rad_s

    inside = np.arange(slip.first, slip.last + 1)
    around = np.arange(max(slip.first - _NEIGHBOURS, 0), min(slip.last + _NEIGHBOURS + 1, zone.seconds.size))
    return Numbers(
        zone=zone.number,
        start_utc=epoch.iso(zone.telemetry.time[slip.first], "ms"),
        rows=int(inside.size),
        stamps_late_s=slip.late_s,
        # Mean of the rows.
        field_late_s=late_s(inside) - late_s(around[zone.used[around]]),
        # Length of the residual vector.
        largest_nT=np.linalg.norm(fit.residual_nT[inside], axis=1).max(),
    )


def present(found: Numbers, settings: Settings) -> StudyResult:
    """What the study says of what it found."""
    provenance = {
        "data": "ELFIN-A, UCLA (V. Angelopoulos), NASA and NSF; github jiashuwu89/elf_fgm fbaba5dd",
        "field model": settings.field_model,
        "fluxtwin": metadata.version("fluxtwin"),
        "python": platform.python_version(),
    }
    return words().result("elfin", provenance, **_values(found, settings))


@cache
def words() -> Words:
    """The sections of `words.md`."""
    return Words(
        "fluxtwin.scenarios.elfin",
        agree_ms=1e3 * _AGREE_S,
        degrees=lambda angles_rad: np.degrees(angles_rad).tolist(),
        lags=lambda way: lags_words(way.lags_s),
        median=np.median,
        rms_by_kind=lambda fits: {kind: fit.rms_nT for kind, fit in fits.items()},
        ranked=lambda one: ", ".join(f"{cause.name} {cause.drop:.3g}" for cause in one.ranking[:_RANKED]),
        span=lambda values, digits=0: f"{min(values):.{digits}f} to {max(values):.{digits}f}",
    )


def _values(found: Numbers, settings: Settings) -> dict[str, Any]:
    """What the words of the page take."""
    static = found.ways[0]
    sunny = [one for one in found.zones if one.zone.sunlit > SUNLIT]
    response_X = np.concatenate([one.response[:, 0] for one in found.zones])
    noise = [one.noise_nT for one in found.zones]
    values: dict[str, Any] = {
        "o": found,
        "settings": settings.tree,
        "p": settings.printed,
        "refused": sum(bool(one.refusal) for one in found.zones),
        "share": lambda way: round(way.unseen_whole_nT / static.unseen_whole_nT, 3),
        "below": lambda way: sum(np.array(way.unseen_nT) < _REACH * np.array(static.unseen_nT)),
        "tilted_deg": lambda way: _tilted_deg(found, way),
        "noise": noise,
        "noise_nT": float(np.median(noise)),
        "off": [slip for slip in found.slips if abs(slip.stamps_late_s - slip.field_late_s) > _AGREE_S],
        "starting_nT": max(one.starting_nT for one in found.zones),
        "starting_rows": sum(one.zone.left_out.get("switching on", 0) for one in found.zones),
        **{kind: [one.fits[kind].rms_nT for one in found.zones] for kind in KINDS},
        **{f"sunlit_{kind}": [one.fits[kind].rms_nT for one in sunny] for kind in KINDS},
        "response_X": 100.0 * abs(response_X),
        "turn_XZ_deg": np.ptp(np.degrees(np.angle(response_X))),
        "slips_ms": [1e3 * abs(slip.stamps_late_s) for slip in found.slips],
        "slips_nT": max(slip.largest_nT for slip in found.slips),
    }
    values |= {"unseen": _unseen_rows(found, values)}
    return values | {"independent": words().table("independent", **values).rows}


def _unseen_rows(found: Numbers, values: dict[str, Any]) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    for place, one in enumerate(found.zones):
        predicted = [round(way.unseen_nT[place]) for way in found.ways]
        own = round(one.fits["static"].rms_nT)
        rows.append([str(one.zone.number), one.light, own, *predicted, round(one.noise_nT, 1)])
    own_nT, noise_nT = (rms(np.array(values[name])) for name in ("static", "noise"))
    rows.append(["all", "", round(own_nT), *(round(way.unseen_whole_nT) for way in found.ways), round(noise_nT, 1)])
    rows.append(["of static", "", None, *map(values["share"], found.ways), None])
    return rows


def _tilted_deg(found: Numbers, way: Numbers) -> float:
    """How far the sensor tilts from one moment of the zones to another, at most; its turn about the spin axis cannot be
    distinguished from the spin phase."""
    seconds = np.concatenate([one.zone.seconds[one.zone.used][::50] for one in found.zones])
    states = np.stack([found.flight.day.lagged(seconds, *series) for series in way.lags_s], axis=1)
    tilts = (states @ way.within.sensor.turn_rad)[:, :2]
    return float(np.degrees(np.linalg.norm(tilts[:, None, :] - tilts[None, :, :], axis=2).max()))


def lags_words(lags_s: Lags) -> str:
    """ "200 + 200": in series; "200; 400": side by side."""
    return "; ".join(" + ".join(f"{lag:g}" for lag in series) for series in lags_s)
