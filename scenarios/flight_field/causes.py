"""What a residual may consist of: least-squares fits of a few simple causes, each with one number.

The causes, as first-order differences of the field that the satellite reports:

* ring current: a uniform field along the geomagnetic dipole axis with its induced dipole in the Earth, sized by
  its value at the dipole equator on the ground, negative in a storm (Langel & Estes 1985, doi
  10.1029/JB090iB03p02495, for the induced share);
* time offset: the position belongs to a time that many seconds after the measurement (an error along the track);
* pitch: the measured vector is turned about the orbit normal, as by an attitude error.

An attitude error does not change the magnitude, so a time offset found in the magnitude alone is not an attitude error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.flight_field.residuals import Residual, rms
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field import FieldModel, field_NEC_nT

RING_CURRENT, TIME_OFFSET, PITCH = "ring current [nT]", "time offset [s]", "pitch [deg]"
_STEP_S = 0.5


@dataclass(frozen=True)
class CauseFit:
    """One least-squares fit over chosen rows."""

    track: str
    rows: str
    """Which rows, in words."""
    on: str
    """`vector` or `magnitude`."""
    size: Mapping[str, float]
    """Each cause's size, unit in its name."""
    rms_before_nT: float
    rms_after_nT: float
    fitted_NEC_nT: FloatArray
    """(N, 3) what the causes add to the reported field, at every row of the track."""


def ring_current_NEC(model: FieldModel, residual: Residual, induced_share: float) -> FloatArray:
    """(N, 3) field of a ring current of 1 nT at the dipole equator on the ground, induced part included."""
    g10, g11, h11 = model.coefficients_nT(epoch.as_times(residual.track.time)[:1])[0, :3]
    axis = -np.array([g11, h11, g10]) / np.linalg.norm([g11, h11, g10])  # points to the northern dipole pole
    r_E_km = residual.track.r_E_km
    radius = np.linalg.norm(r_E_km, axis=1)[:, None]
    up = r_E_km / radius
    induced = (FIELD_RADIUS_KM / radius) ** 3 * (3.0 * (up @ axis)[:, None] * up - axis)
    field_E = (axis - induced_share * induced) / (1.0 + induced_share)
    field_NEC: FloatArray = frames.rotation_NEC_E(r_E_km).apply(field_E)
    return field_NEC


def time_offset_NEC(model: FieldModel, residual: Residual) -> FloatArray:
    """(N, 3) change of the residual for each second by which the position runs ahead of the field [nT/s]."""
    track, velocity = residual.track, _velocity_E_km_s(residual)
    ahead, behind = (field_NEC_nT(model, track.time, track.r_E_km + s * velocity) for s in (_STEP_S, -_STEP_S))
    return -(ahead - behind) / (2.0 * _STEP_S)


def pitch_NEC(residual: Residual) -> FloatArray:
    """(N, 3) change of the measured vector for a turn of one degree about the orbit normal [nT/deg]."""
    r_E_km = residual.track.r_E_km
    normal_E = np.cross(r_E_km, _velocity_E_km_s(residual))
    normal_NEC = frames.rotation_NEC_E(r_E_km).apply(normal_E / np.linalg.norm(normal_E, axis=1)[:, None])
    turned: FloatArray = np.cross(normal_NEC, residual.model_NEC_nT) * np.radians(1.0)
    return turned


def fit(
    residual: Residual,
    chosen: tuple[str, BoolArray],
    columns: Mapping[str, FloatArray],
    causes: Sequence[str],
    on: str = "vector",
) -> CauseFit:
    """Least squares of the named causes to the residual over the chosen rows, all components alike.

    chosen: the rows in words, and (N,). columns: field (N, 3) of each cause at size 1. on: "vector", or "magnitude".
    """
    words, rows = chosen
    if on == "vector":
        design = np.stack([columns[name][rows].ravel() for name in causes], axis=1)
        measured = residual.NEC_nT[rows].ravel()
    else:
        along = residual.model_NEC_nT / np.linalg.norm(residual.model_NEC_nT, axis=1)[:, None]
        design = np.stack([np.einsum("ij,ij->i", columns[name], along)[rows] for name in causes], axis=1)
        measured = residual.F_nT[rows]
    size = np.linalg.lstsq(design, measured, rcond=None)[0]
    fitted = sum((s * columns[name] for s, name in zip(size, causes, strict=True)), np.zeros_like(residual.NEC_nT))
    sizes = {name: float(s) for name, s in zip(causes, size, strict=True)}
    track = residual.track.name.rpartition(" ")[0]
    return CauseFit(track, words, on, sizes, rms(measured), rms(measured - design @ size), fitted)


def _velocity_E_km_s(residual: Residual) -> FloatArray:
    """(N, 3) Earth-fixed velocity from the positions."""
    track = residual.track
    velocity: FloatArray = np.gradient(track.r_E_km, epoch.seconds_since(track.time, track.time[0]), axis=0)
    return velocity
