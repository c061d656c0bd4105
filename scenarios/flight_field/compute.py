"""The computing half of the study: files in, residuals, figures and fits out. Nothing is drawn or written here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.scenarios.flight_field import causes
from fluxtwin.scenarios.flight_field.causes import CauseFit
from fluxtwin.scenarios.flight_field.figures import Key
from fluxtwin.scenarios.flight_field.residuals import (
    Residual,
    against_field,
    against_model,
    low_latitude,
    statistics,
)
from fluxtwin.scenarios.flight_field.settings import Settings
from fluxtwin.scenarios.flight_field.tracks import (
    RingCurrentIndex,
    Track,
    read_kp,
    read_magsat,
    read_ring_current,
    read_swarm,
)
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel, field_NEC_nT, load_field
from fluxtwin.sim.earth.field_external import magnetospheric_field_E_nT, read_magnetosphere


@dataclass(frozen=True)
class Fit:
    """One row of the table of causes."""

    track: str
    rows: str
    fit: CauseFit


@dataclass(frozen=True)
class Outcome:
    """All that the study found."""

    magsat: Residual
    """To IGRF-14 at one epoch."""
    magsat_at_stamps: Residual
    magsat_explained: Residual
    """To IGRF-14 and the causes fitted at low latitude."""
    swarm: tuple[Residual, Residual, Residual]
    """To IGRF-14, to the internal field of CHAOS, to the whole of CHAOS."""
    kp: FloatArray
    """Eight values of the day of MAGSAT."""
    rc: RingCurrentIndex
    fits: tuple[Fit, ...]
    low_latitude_deg: float

    @property
    def rc_range_nT(self) -> tuple[float, float]:
        """Lowest and highest RC along the track of Swarm."""
        external, induced = self.rc.at(self.swarm[0].track.time)
        whole = external + induced
        return float(whole.min()), float(whole.max())


def compute(folder: Path, settings: Settings, progress: Progress) -> Outcome:
    """Read the files of the folder and compute everything. Raises BadInput for a file that cannot be used."""
    progress("reading the recorded files", 0.02)
    magsat, swarm = read_magsat(folder / settings.magsat.file), read_swarm(folder / settings.swarm.file)
    kp = read_kp(folder / settings.magsat.kp_file, magsat.time[0])
    rc = read_ring_current(folder / settings.swarm.rc_file)
    progress("IGRF-14 along the orbit of MAGSAT", 0.1)
    model = load_field(settings.magsat.model)
    one_epoch = epoch.parse_time(settings.magsat.epoch_utc, where="magsat.epoch_utc")
    fixed = against_model(magsat, model, f"IGRF-14 at {epoch.decimal_year(one_epoch)[0]:.1f}", one_epoch)
    at_stamps = against_model(magsat, model, "IGRF-14 at each stamp")
    progress("what the MAGSAT residual is made of", 0.3)
    fits, explained = _magsat_fits(at_stamps, model, settings)
    progress("CHAOS-7 along the orbit of Swarm A", 0.5)
    swarm_residuals = _swarm_residuals(swarm, folder, settings, rc)
    fits += _swarm_fits(swarm_residuals[0], load_field(settings.swarm.model), settings)
    return Outcome(fixed, at_stamps, explained, swarm_residuals, kp, rc, tuple(fits), settings.low_latitude_deg)


def found_figures(outcome: Outcome, settings: Settings) -> Mapping[Key, float]:
    """Every figure that can be set beside an independent one."""
    found: dict[Key, float] = {}
    labels = (("magsat", "igrf14 at 1980.0", outcome.magsat), ("swarm", "igrf14", outcome.swarm[0]),
              ("swarm", "chaos7 with external field", outcome.swarm[2]))  # fmt: skip
    for track, model, residual in labels:
        low = low_latitude(residual.track, settings.low_latitude_deg)
        for selection, rows in (("all", np.ones_like(low)), ("low", low)):
            for (quantity, component), value in statistics(residual, rows).items():
                found[track, model, selection, quantity, component] = value
    plain = found["swarm", "igrf14", "low", "mean", "N"]
    left = found["swarm", "chaos7 with external field", "low", "mean", "N"]
    found["swarm", "chaos7 with external field", "low", "share", "N"] = 1.0 - left / plain
    found["magsat", "index", "track", "kp", "first"] = float(outcome.kp[0])
    found["magsat", "index", "day", "kp", "largest"] = float(outcome.kp.max())
    stamps = outcome.swarm[0].track.time
    middle = stamps[0] + (stamps[-1] - stamps[0]) // 2
    found["swarm", "index", "track", "rc", "nearest hour"] = outcome.rc.nearest(middle)
    return found


def _swarm_residuals(
    swarm: Track, folder: Path, settings: Settings, rc: RingCurrentIndex
) -> tuple[Residual, Residual, Residual]:
    path = folder / settings.swarm.chaos_file
    internal = load_field(f"chaos:{path}", settings.swarm.crust_degree)
    inside = field_NEC_nT(internal, swarm.time, swarm.r_E_km)
    outside_E = magnetospheric_field_E_nT(read_magnetosphere(path), swarm.time, swarm.r_E_km, *rc.at(swarm.time))
    outside = frames.rotation_NEC_E(swarm.r_E_km).apply(outside_E)
    return (
        against_model(swarm, load_field(settings.swarm.model), "IGRF-14"),
        against_field(swarm, inside, "CHAOS-7, internal only"),
        against_field(swarm, inside + outside, "CHAOS-7 with external field and RC"),
    )


def _magsat_fits(residual: Residual, model: FieldModel, settings: Settings) -> tuple[list[Fit], Residual]:
    """The causes at low latitude, together and pass by pass, and the residual that is left along the whole track."""
    track = residual.track
    columns = {
        causes.RING_CURRENT: causes.ring_current_NEC(model, residual, settings.ring_current_induced_share),
        causes.TIME_OFFSET: causes.time_offset_NEC(model, residual),
        causes.PITCH: causes.pitch_NEC(residual),
    }
    low = low_latitude(track, settings.low_latitude_deg)
    ring, time, pitch = columns
    fits = [
        Fit("MAGSAT", "both passes", causes.fit(residual, low, columns, names))
        for names in ([ring], [ring, time], [ring, pitch], [ring, time, pitch])
    ]
    fits.append(Fit("MAGSAT", "both passes", causes.fit(residual, low, columns, [ring, time], "magnitude")))
    for words, rows in _passes(track, low):
        fits.append(Fit("MAGSAT", words, causes.fit(residual, rows, columns, [ring, time, pitch])))
        fits.append(Fit("MAGSAT", words, causes.fit(residual, rows, columns, [ring, time], "magnitude")))
    best = fits[3].fit
    words = "IGRF-14 with ring current, time offset and pitch fitted"
    return fits, against_field(track, residual.model_NEC_nT + best.fitted_NEC_nT, words)


def _swarm_fits(residual: Residual, model: FieldModel, settings: Settings) -> list[Fit]:
    ring = causes.ring_current_NEC(model, residual, settings.ring_current_induced_share)
    low = low_latitude(residual.track, settings.low_latitude_deg)
    columns = {causes.RING_CURRENT: ring}
    return [
        Fit("Swarm A", "one pass", causes.fit(residual, low, columns, [causes.RING_CURRENT], on))
        for on in ("vector", "magnitude")
    ]


def _passes(track: Track, low: BoolArray) -> tuple[tuple[str, BoolArray], tuple[str, BoolArray]]:
    northbound: BoolArray = np.gradient(track.latitude_deg) > 0.0
    return ("northbound pass", low & northbound), ("southbound pass", low & ~northbound)
