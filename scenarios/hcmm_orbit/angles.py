"""The ranges of the three angles that the fitted orbit, the sun and a field model give in each pass's window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.hcmm_orbit.geometry import angle_between
from fluxtwin.scenarios.hcmm_orbit.record import Pass
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.field import FieldModel, field_E_nT
from fluxtwin.sim.earth.orbit import Orbit

_SAMPLES = 61
"""Times in a window: at most 14 s apart, 0.05 deg of the fastest angle at an extremum."""


@dataclass(frozen=True)
class PassAngles:
    """Along each pass's window; P passes, M times."""

    minutes: FloatArray
    """(P, M) after the printed acquisition."""
    sun_field_deg: FloatArray
    nadir_field_deg: FloatArray
    sun_nadir_deg: FloatArray
    latitude_deg: FloatArray
    """(P, M) geocentric."""
    longitude_deg: FloatArray

    def range_of(self, name: str) -> FloatArray:
        """(P, 2) lowest and highest of `sun_field_deg`, `nadir_field_deg`, `sun_nadir_deg`, ..."""
        values = getattr(self, name)
        return np.stack([values.min(axis=1), values.max(axis=1)], axis=1)


def angles_along(
    passes: Sequence[Pass], windows: PassWindows, orbit: Orbit, model: FieldModel, *, turned_east_deg: float = 0.0
) -> PassAngles:
    """Evaluate the model along the orbit. turned_east_deg: the whole field is turned about the Earth's axis by this."""
    share = np.linspace(0.0, 1.0, _SAMPLES)
    minutes = windows.start_min[:, None] + (windows.end_min - windows.start_min)[:, None] * share[None, :]
    time = np.concatenate([epoch.add_seconds(p.aos, 60.0 * row) for p, row in zip(passes, minutes, strict=True)])
    r_N_km, _ = orbit.propagate(time)
    R_EN = frames.rotation_EN(time)
    r_E_km = R_EN.apply(r_N_km)
    turn = np.radians(turned_east_deg)
    field_E = _about_axis(field_E_nT(model, time, _about_axis(r_E_km, -turn)), turn)
    field_N = R_EN.inv().apply(field_E)
    towards_sun = sun.sun_direction_N(time, r_N_km)
    latitude, longitude, _ = frames.geocentric(r_E_km)
    shape = minutes.shape
    return PassAngles(
        minutes=minutes,
        sun_field_deg=np.degrees(angle_between(towards_sun, field_N)).reshape(shape),
        nadir_field_deg=np.degrees(angle_between(-r_N_km, field_N)).reshape(shape),
        sun_nadir_deg=np.degrees(angle_between(-r_N_km, towards_sun)).reshape(shape),
        latitude_deg=np.degrees(latitude).reshape(shape),
        longitude_deg=np.degrees(longitude).reshape(shape),
    )


def _about_axis(vectors: FloatArray, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)
