"""All the numbers of the study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fluxtwin.calib.scalar.calibrate import calibrate_scalar
from fluxtwin.gap.records import Diagnosis
from fluxtwin.scenarios.elfin.gap_question import ask
from fluxtwin.scenarios.elfin.record import Flight, Slip, Zone, read_flight
from fluxtwin.scenarios.elfin.settings import Settings
from fluxtwin.scenarios.elfin.unseen import Told, compare, residuals_nT
from fluxtwin.scenarios.elfin.zone_fit import KINDS, ComplexArray, ZoneFit, fit_zone, local_noise_nT, responses
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.field_models import FieldModel

NAMED = ("boom", "boom, two lags")
"""Ways whose lags the diagnosis may be given: the one that fits all zones best."""
_BESIDE = 50


@dataclass(frozen=True)
class SlipSeen:
    """A slip named by its stamps, and what the field's turning says of it."""

    zone: int
    start_utc: str
    rows: int
    stamps_late_s: float
    field_late_s: float
    """How late the stamps are by the spin phase of the readings, mean of the rows."""
    largest_nT: float
    """Length of the residual vector beside the neighbours."""


@dataclass(frozen=True)
class ZoneTold:
    """One zone by itself."""

    zone: Zone
    fits: Mapping[str, ZoneFit]
    noise_nT: float
    """Length of the residual vector, local."""
    refusal: str
    """Why the scalar fit was refused; empty: it was not."""
    middle_s: FloatArray
    response: ComplexArray
    """(M, 3) complex, see `responses`."""
    starting_nT: float
    """Largest residual vector in the rows after switching on."""


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    flight: Flight
    zones: tuple[ZoneTold, ...]
    slips: tuple[SlipSeen, ...]
    told: tuple[Told, ...]
    diagnosis: Diagnosis
    """Of all zones."""
    in_shadow: Diagnosis
    """Of the zones that begin in shadow."""
    shown: Mapping[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]
    """Of two zones: minutes and residual of the static and of the best way, both fitted without the zone."""

    @property
    def best(self) -> Told:
        """The way with the smallest residual on unseen zones."""
        return min(self.told[1:], key=lambda one: one.unseen_whole_nT)


def compute(folder: Path, settings: Settings, progress: Progress = silent) -> Results:
    """Everything; errors as `read_flight`."""
    model = load_field(settings.field_model)
    progress("reading", 0.0)
    flight = read_flight(folder, settings, model)
    zones = []
    for number, zone in enumerate(flight.zones):
        progress(f"zone {zone.number}", 0.05 + 0.25 * number / len(flight.zones))
        zones.append(_zone(zone, settings, model))
    slips = tuple(_seen(told, slip) for told in zones for slip in told.zone.slips)
    own = [told.fits["static"] for told in zones]
    told = compare(flight, own, settings, part_of(progress, 0.3, 0.75))
    boom = min((one for one in told if one.way.name in NAMED), key=lambda one: one.within.whole_nT)
    component = float(np.median([one.noise_nT for one in zones]) / np.sqrt(3.0))
    found = ask(flight, own, boom.lags_s[0], component, settings, part_of(progress, 0.75, 0.85))
    shadow = [place for place, zone in enumerate(flight.zones) if zone.lit[0] < 0.5]
    part = replace(flight, zones=tuple(flight.zones[place] for place in shadow))
    in_shadow = ask(
        part, [own[place] for place in shadow], boom.lags_s[0], component, settings, part_of(progress, 0.85, 0.95)
    )  # fmt: skip
    best = min(told[1:], key=lambda one: one.unseen_whole_nT)
    dark, sunny = _examples(flight)
    shown = {}
    for place in (dark, sunny):
        minutes, before = residuals_nT(flight, own, told[0], place, settings)
        later, after = residuals_nT(flight, own, best, place, settings)
        shown[place] = (minutes, before, later, after)
    return Results(flight, tuple(zones), slips, told, found, in_shadow, shown)


def _zone(zone: Zone, settings: Settings, model: FieldModel) -> ZoneTold:
    static = fit_zone(zone, "static", settings)
    fits = {"static": static} | {kind: fit_zone(zone, kind, settings, static.rate_rad_s) for kind in KINDS[1:]}
    middle, response = responses(zone, static)
    first = zone.seconds < zone.seconds[0] + settings.switch_on_s
    starting = np.linalg.norm(fits["harmonic"].residual_nT[first], axis=1)
    return ZoneTold(
        zone, fits, local_noise_nT(zone, static), refusal(zone, model), middle, response, float(starting.max())
    )


def refusal(zone: Zone, model: FieldModel) -> str:
    """What the scalar fit of this zone alone is answered with; empty where it gets an answer."""
    try:
        calibrate_scalar(zone.telemetry, model, parameters="b,S", robust="none")
    except NoAnswer as error:
        return str(error)
    return ""


def _seen(told: ZoneTold, slip: Slip) -> SlipSeen:
    """The field's word on a slip: the phase by which the readings are off beside their neighbours, over the rate."""
    fit, zone = told.fits["harmonic"], told.zone
    inside = np.arange(slip.first, slip.last + 1)
    beside = np.arange(max(slip.first - _BESIDE, 0), min(slip.last + _BESIDE + 1, zone.seconds.size))
    beside = beside[zone.used[beside]]
    off = _late_s(fit, inside) - _late_s(fit, beside)
    spoilt = fit.residual_nT[inside]
    stamp = epoch.iso(zone.telemetry.time[slip.first], "ms")
    largest = float(np.linalg.norm(spoilt, axis=1).max())
    return SlipSeen(zone.number, stamp, int(inside.size), slip.late_s, off, largest)


def _late_s(fit: ZoneFit, rows: np.ndarray) -> float:
    slope, left = fit.slope_nT[rows], fit.residual_nT[rows]
    return -float((slope * left).sum() / (slope**2).sum()) / fit.rate_rad_s


def _examples(flight: Flight) -> tuple[int, int]:
    """A zone in shadow and the last in sunlight."""
    sunny = [place for place, zone in enumerate(flight.zones) if zone.lit.mean() > 0.5]
    dark = [place for place, zone in enumerate(flight.zones) if zone.lit.mean() < 0.5]
    return dark[len(dark) // 2], sunny[-1] if sunny else dark[-1]
