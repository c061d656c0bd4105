"""Measured minus model along a track, the figures that describe it, and what it may consist of.

Least-squares fits of a few simple causes, each with one number, as first-order differences of the field that the satellite
reports:

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

from fluxtwin.scenarios.flight_field.tracks import Track
from fluxtwin.scenarios.flights import Numbers, rms
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel, field_NEC_nT
from fluxtwin.sim.effects.ambient_field import dipole_axis_E, unit_storm_E

COMPONENTS = ("N", "E", "C", "F")
"""Geocentric north, east, centre, and the magnitude."""
RING_CURRENT, TIME_OFFSET, PITCH = "ring current [nT]", "time offset [s]", "pitch [deg]"
_STEP_S = 0.5


@dataclass(frozen=True)
class Residual:
    """Measured minus model along a track of N samples."""

    track: Track
    model: str
    """What was subtracted, in words."""
    model_NEC_nT: FloatArray
    """(N, 3) what was subtracted."""
    NEC_nT: FloatArray
    """(N, 3) measured minus model."""
    F_nT: FloatArray
    """(N,) difference of the magnitudes."""


def against_model(
    track: Track, model: FieldModel, words: str, time: TimeArray | np.datetime64 | None = None
) -> Residual:
    """Residual of the track to a field model, at the stamps' own epochs or at the one given.

    Raises OutOfRange for an epoch outside the model.
    """
    return against_field(track, field_NEC_nT(model, track.time if time is None else time, track.r_E_km), words)


def against_field(track: Track, model_NEC_nT: FloatArray, words: str) -> Residual:
    """Residual of the track to a field (N, 3) in its own components."""
    size = np.linalg.norm(track.b_NEC_nT, axis=1) - np.linalg.norm(model_NEC_nT, axis=1)
    return Residual(track, words, model_NEC_nT, track.b_NEC_nT - model_NEC_nT, size)


def low_latitude(track: Track, limit_deg: float) -> BoolArray:
    """Rows (N,) within `limit_deg` of the equator, geodetic latitude."""
    low: BoolArray = np.abs(track.latitude_deg) < limit_deg
    return low


def statistics(residual: Residual, rows: BoolArray) -> Mapping[tuple[str, str], float]:
    """rms and mean [nT] of N, E, C and F over the rows, by (quantity, component)."""
    parts = dict(zip(COMPONENTS, (*residual.NEC_nT[rows].T, residual.F_nT[rows]), strict=True))
    return {("rms", name): rms(part) for name, part in parts.items()} | {
        ("mean", name): float(part.mean()) for name, part in parts.items()
    }


def ring_current_NEC(model: FieldModel, residual: Residual, induced_share: float) -> FloatArray:
    """(N, 3) field of a ring current of 1 nT at the dipole equator on the ground, induced part included."""
    track = residual.track
    external_E = unit_storm_E(dipole_axis_E(model, track.time[0]), track.r_E_km, induced_share)
    return np.asarray(frames.rotation_NEC_E(track.r_E_km).apply(external_E / (1.0 + induced_share)))


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
) -> Numbers:
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
    return Numbers(
        track=residual.track.name.rpartition(" ")[0],
        rows=words,
        on=on,
        # Of each cause, unit in its name.
        size=dict(zip(causes, size.tolist(), strict=True)),
        rms_before_nT=rms(measured),
        rms_after_nT=rms(measured - design @ size),
        # (N, 3) what the causes add to the reported field, at every row of the track.
        fitted_NEC_nT=np.tensordot(size, np.stack([columns[name] for name in causes]), axes=1),
    )


def _velocity_E_km_s(residual: Residual) -> FloatArray:
    """(N, 3) Earth-fixed velocity from the positions."""
    track = residual.track
    velocity: FloatArray = np.gradient(track.r_E_km, epoch.seconds_since(track.time, track.time[0]), axis=0)
    return velocity
