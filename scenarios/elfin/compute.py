"""All the numbers of the study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fluxtwin.calib.scalar.calibrate import calibrate_scalar
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.scenarios.elfin.gap_record import record_of
from fluxtwin.scenarios.elfin.record import Flight, Slip, Zone, read_flight
from fluxtwin.scenarios.elfin.unseen import Way, compare, residuals_nT
from fluxtwin.scenarios.elfin.zone_fit import KINDS, ComplexArray, ZoneFit, fit_zone, local_noise_nT, responses
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.field_models import FieldModel

NAMED = ("boom", "boom, two lags")
"""Models whose lags the diagnosis may be given: the one that fits all zones best."""
SUNLIT = 0.999
"""Mean share of the sun in view from which on a zone is sunlit."""
_NEIGHBOURS = 50
_LSB_NT = 0.01


@dataclass(frozen=True)
class SlipSeen:
    """A slip named by its stamps, and what the spin phase of the readings says of it."""

    zone: int
    start_utc: str
    rows: int
    stamps_late_s: float
    field_late_s: float
    """How late the stamps are by the spin phase of the readings, mean of the rows."""
    largest_nT: float
    """Length of the residual vector, relative to the neighbours."""


@dataclass(frozen=True)
class ZoneResult:
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

    @property
    def period_s(self) -> float:
        """Of the spin."""
        return 2.0 * float(np.pi) / self.fits["static"].rate_rad_s

    @property
    def light(self) -> str:
        """Whether the zone is sunlit."""
        lit = self.zone.sunlit
        return "sunlit" if lit > SUNLIT else "shadow" if lit < 1.0 - SUNLIT else "shadow, then sun"


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    flight: Flight
    zones: tuple[ZoneResult, ...]
    slips: tuple[SlipSeen, ...]
    ways: tuple[Way, ...]
    diagnosis: Diagnosis
    """Of all zones."""
    in_shadow: Diagnosis
    """Of the zones that begin in shadow."""
    shown: Mapping[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]
    """Of two zones: minutes and residual of the static and of the best model, both fitted without the zone."""

    @property
    def best(self) -> Way:
        """The model with the smallest residual on unseen zones."""
        return min(self.ways[1:], key=lambda way: way.unseen_whole_nT)


def compute(folder: Path, settings: Settings, progress: Progress = silent) -> Results:
    """Everything; errors as `read_flight`."""
    model = load_field(settings.field_model)
    progress("reading", 0.0)
    flight = read_flight(folder, settings, model)
    zones = []
    for number, zone in enumerate(flight.zones):
        progress(f"zone {zone.number}", 0.05 + 0.25 * number / len(flight.zones))
        zones.append(_zone(zone, settings, model))
    own = [one.fits["static"] for one in zones]
    ways = compare(flight, own, settings, part_of(progress, 0.3, 0.75))
    boom = min((way for way in ways if way.name in NAMED), key=lambda way: way.within.whole_nT)
    component = float(np.median([one.noise_nT for one in zones]) / np.sqrt(3.0))
    shadow = [place for place, zone in enumerate(flight.zones) if zone.lit[0] < 0.5]
    # the attitude is as uncertain as the spin axis is stated to be
    budget = Budget(component, _LSB_NT, flight.axis_sigma_rad, None)
    part = replace(flight, zones=tuple(flight.zones[place] for place in shadow))
    record = record_of(flight, own, boom.lags_s[0], settings)
    whole = diagnose(record, model, budget=budget, progress=part_of(progress, 0.75, 0.85))
    record = record_of(part, [own[place] for place in shadow], boom.lags_s[0], settings)
    in_shadow = diagnose(record, model, budget=budget, progress=part_of(progress, 0.85, 0.95))
    slips = tuple(_seen(one, slip) for one in zones for slip in one.zone.slips)
    found = Results(flight, tuple(zones), slips, ways, whole, in_shadow, {})
    sunny = [place for place, zone in enumerate(flight.zones) if zone.sunlit > 0.5]
    dark = [place for place, zone in enumerate(flight.zones) if zone.sunlit < 0.5]
    shown = {}
    for place in (dark[len(dark) // 2], sunny[-1] if sunny else dark[-1]):
        before = residuals_nT(flight, own, ways[0], place, settings)
        shown[place] = (*before, *residuals_nT(flight, own, found.best, place, settings))
    return replace(found, shown=shown)


def _zone(zone: Zone, settings: Settings, model: FieldModel) -> ZoneResult:
    static = fit_zone(zone, "static", settings)
    fits = {"static": static} | {kind: fit_zone(zone, kind, settings, static.rate_rad_s) for kind in KINDS[1:]}
    first = zone.seconds < zone.seconds[0] + settings.switch_on_s
    starting_nT = float(np.linalg.norm(fits["harmonic"].residual_nT[first], axis=1).max())
    noise_nT, refused = local_noise_nT(zone, static), refusal(zone, model)
    return ZoneResult(zone, fits, noise_nT, refused, *responses(zone, static), starting_nT)


def refusal(zone: Zone, model: FieldModel) -> str:
    """Why the scalar fit of this zone alone is refused; empty where it gets an answer."""
    try:
        calibrate_scalar(zone.telemetry, model, parameters="b,S", robust="none")
    except NoAnswer as error:
        return str(error)
    return ""


def _seen(one: ZoneResult, slip: Slip) -> SlipSeen:
    """How late a slip is in the spin phase: the phase by which the readings differ from their neighbours, over the rate."""
    fit, zone = one.fits["harmonic"], one.zone

    def late_s(rows: np.ndarray) -> float:
        slope, residual = fit.slope_nT[rows], fit.residual_nT[rows]
        return -float((slope * residual).sum() / (slope**2).sum()) / fit.rate_rad_s

    inside = np.arange(slip.first, slip.last + 1)
    around = np.arange(max(slip.first - _NEIGHBOURS, 0), min(slip.last + _NEIGHBOURS + 1, zone.seconds.size))
    off_s = late_s(inside) - late_s(around[zone.used[around]])
    largest = float(np.linalg.norm(fit.residual_nT[inside], axis=1).max())
    stamp = epoch.iso(zone.telemetry.time[slip.first], "ms")
    return SlipSeen(zone.number, stamp, int(inside.size), slip.late_s, off_s, largest)
