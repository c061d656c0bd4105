"""The computing half of the study: files in, residuals, figures and fits out. Nothing is drawn or written here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.scenarios.flight_field import causes
from fluxtwin.scenarios.flight_field.causes import PITCH, RING_CURRENT, TIME_OFFSET, CauseFit
from fluxtwin.scenarios.flight_field.figures import Key
from fluxtwin.scenarios.flight_field.residuals import Residual, against_field, against_model, low_latitude, statistics
from fluxtwin.scenarios.flight_field.tracks import (
    RingCurrentIndex,
    Track,
    read_kp,
    read_magsat,
    read_ring_current,
    read_swarm,
)
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel, field_NEC_nT, load_field
from fluxtwin.sim.earth.field_external import magnetospheric_field_E_nT, read_magnetosphere

_CHAOS = "chaos7 with external field"


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
    fits: tuple[CauseFit, ...]

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
    progress("what the MAGSAT residual consists of", 0.3)
    fits, explained = _magsat_fits(at_stamps, model, settings)
    progress("CHAOS-7 along the orbit of Swarm A", 0.5)
    storm = _swarm_residuals(swarm, folder, settings, rc)
    ring = causes.ring_current_NEC(load_field(settings.swarm.model), storm[0], settings.ring_current_induced_share)
    one_pass = ("one pass", low_latitude(swarm, settings.low_latitude_deg))
    fits += [causes.fit(storm[0], one_pass, {RING_CURRENT: ring}, [RING_CURRENT], on) for on in ("vector", "magnitude")]
    return Outcome(fixed, at_stamps, explained, storm, kp, rc, tuple(fits))


def found_figures(outcome: Outcome, settings: Settings) -> Mapping[Key, float]:
    """Every figure that can be set beside an independent one."""
    found: dict[Key, float] = {}
    plain, _, whole = outcome.swarm
    for track, model, residual in (
        ("magsat", "igrf14 at 1980.0", outcome.magsat),
        ("swarm", "igrf14", plain),
        ("swarm", _CHAOS, whole),
    ):
        low = low_latitude(residual.track, settings.low_latitude_deg)
        for selection, rows in (("all", np.ones_like(low)), ("low", low)):
            for (quantity, component), value in statistics(residual, rows).items():
                found[track, model, selection, quantity, component] = value
    remaining = found["swarm", _CHAOS, "low", "mean", "N"] / found["swarm", "igrf14", "low", "mean", "N"]
    stamps = plain.track.time
    return found | {
        ("swarm", _CHAOS, "low", "share", "N"): 1.0 - remaining,
        ("magsat", "index", "track", "kp", "first"): float(outcome.kp[0]),
        ("magsat", "index", "day", "kp", "largest"): float(outcome.kp.max()),
        ("swarm", "index", "track", "rc", "nearest hour"): outcome.rc.nearest(
            stamps[0] + (stamps[-1] - stamps[0]) // 2
        ),
    }


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


def _magsat_fits(residual: Residual, model: FieldModel, settings: Settings) -> tuple[list[CauseFit], Residual]:
    """The causes at low latitude, both passes and each, and the residual that remains along the whole track."""
    track = residual.track
    columns = {
        RING_CURRENT: causes.ring_current_NEC(model, residual, settings.ring_current_induced_share),
        TIME_OFFSET: causes.time_offset_NEC(model, residual),
        PITCH: causes.pitch_NEC(residual),
    }
    ring, ring_time, every = [RING_CURRENT], [RING_CURRENT, TIME_OFFSET], list(columns)
    low = low_latitude(track, settings.low_latitude_deg)
    both = ("both passes", low)
    fits = [causes.fit(residual, both, columns, names) for names in (ring, ring_time, [RING_CURRENT, PITCH], every)]
    explained = residual.model_NEC_nT + fits[-1].fitted_NEC_nT
    fits.append(causes.fit(residual, both, columns, ring_time, "magnitude"))
    northbound = np.gradient(track.latitude_deg) > 0.0
    for one in (("northbound pass", low & northbound), ("southbound pass", low & ~northbound)):
        fits.append(causes.fit(residual, one, columns, every))
        fits.append(causes.fit(residual, one, columns, ring_time, "magnitude"))
    return fits, against_field(track, explained, "IGRF-14 with ring current, time offset and pitch fitted")
