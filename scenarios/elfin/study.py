"""`fluxtwin run elfin`: a real spinner calibrated zone by zone, diagnosed for what is unmodelled, and predicted unseen."""

from __future__ import annotations

import platform
from dataclasses import replace
from functools import cache, partial
from importlib import metadata
from pathlib import Path

import numpy as np

from fluxtwin.calib.scalar.calibrate import calibrate_scalar
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.scenarios.elfin.record import Day, Slip, Zone, read_flight
from fluxtwin.scenarios.elfin.sensor import compare, record_of
from fluxtwin.scenarios.elfin.zone_fit import KINDS, fit_zone, local_noise_nT, responses
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


def compute(folder: Path, settings: Settings, progress: Progress = silent) -> Numbers:
    """Everything; errors as `read_flight`."""
    model = load_field(settings.field_model)
    progress("reading", 0.0)
    flight = read_flight(folder, settings, model)
    zones = []
    for number, zone in enumerate(flight.zones):
        progress(f"zone {zone.number}", 0.05 + 0.25 * number / len(flight.zones))
        zones.append(_zone(zone, flight.day, settings, model))
    own: list[Numbers] = [one.fits["static"] for one in zones]
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
    slips = tuple(_seen(one, slip) for one in zones for slip in one.zone.slips)
    return Numbers(
        flight=flight,
        zones=tuple(zones),
        slips=slips,
        # Those that the spin phase does not confirm.
        off=[slip for slip in slips if abs(slip.stamps_late_s - slip.field_late_s) > _AGREE_S],
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
    fit: Numbers = one.fits["harmonic"]
    zone: Zone = one.zone

    def late_s(rows: np.ndarray) -> float:
        slope, residual = fit.slope_nT[rows], fit.residual_nT[rows]
        return -float((slope * residual).sum() / (slope**2).sum()) / float(fit.rate_rad_s)

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
    return words().result("elfin", provenance, o=found, settings=settings.tree)


@cache
def words() -> Words:
    """The sections of `words.md`."""
    return Words("fluxtwin.scenarios.elfin", agree_ms=1e3 * _AGREE_S, known=(unseen_rows,))


def unseen_rows(found: Numbers) -> list[list[Cell]]:
    """Zone, light, its own static fit [nT], every model on the unseen zone [nT], and the local noise [nT]; and all zones."""
    rows: list[list[Cell]] = []
    for one, *unseen_nT in zip(found.zones, *(way.unseen_nT for way in found.ways), strict=True):
        whole_nT = map(round, (one.fits["static"].rms_nT, *unseen_nT))
        rows.append([str(one.zone.number), one.light, *whole_nT, round(one.noise_nT, 1)])
    own_nT = rms(np.array([one.fits["static"].rms_nT for one in found.zones]))
    noise_nT = rms(np.array([one.noise_nT for one in found.zones]))
    whole_nT = map(round, (own_nT, *(way.unseen_whole_nT for way in found.ways)))
    rows.append(["all", "", *whole_nT, round(noise_nT, 1)])
    rows.append(["of static", "", None, *(way.of_static for way in found.ways), None])
    return rows


run = partial(run_on_files, SETTINGS, compute, present)
