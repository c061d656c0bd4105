"""Measured minus model along a track, and the figures that describe it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.flight_field.tracks import Track
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth.field import FieldModel, field_NEC_nT

COMPONENTS = ("N", "E", "C", "F")
"""Geocentric north, east, centre, and the magnitude."""


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


def rms(value: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(value))))


def statistics(residual: Residual, rows: BoolArray) -> Mapping[tuple[str, str], float]:
    """rms and mean [nT] of N, E, C and F over the rows, by (quantity, component)."""
    parts = dict(zip(COMPONENTS, (*residual.NEC_nT[rows].T, residual.F_nT[rows]), strict=True))
    return {("rms", name): rms(part) for name, part in parts.items()} | {
        ("mean", name): float(part.mean()) for name, part in parts.items()
    }
