"""The rows of a record that can be compared with the field model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.records import seconds_of
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.build import velocity_from_positions
from fluxtwin.sim.telemetry.record import Telemetry

FEWEST = 20
"""Fewer rows are not compared."""
MAX_ROWS = 3000


@dataclass(frozen=True)
class Sample:
    """Rows that can be compared with the model; at most a few thousand, evenly taken."""

    rows: np.ndarray
    """Their places in the record."""
    time: TimeArray
    r_N_km: FloatArray
    mag_nT: FloatArray
    field_N_nT: FloatArray
    q_NB: FloatArray | None
    v_N_km_s: FloatArray

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def seconds(self) -> FloatArray:
        """(n,) since the first row."""
        return seconds_of(self.time)

    @cached_property
    def R_BN(self) -> Rotation:
        """The attitude as the record states it."""
        return frames.rotation_from_q(np.zeros((0, 4)) if self.q_NB is None else self.q_NB)

    @cached_property
    def R_EN(self) -> Rotation:
        """GCRS to Earth-fixed axes at the stamps."""
        return frames.rotation_EN(self.time)

    @property
    def typical_nT(self) -> float:
        """Rms of the model field."""
        return rms(self.field_N_nT)

    def take(self, rows: np.ndarray) -> Sample:
        """The sample cut to `rows` (indices or a mask)."""
        names = ("rows", "time", "r_N_km", "mag_nT", "field_N_nT", "v_N_km_s")
        q = None if self.q_NB is None else self.q_NB[rows]
        part = replace(self, q_NB=q, **{name: getattr(self, name)[rows] for name in names})
        part.__dict__.update({name: self.__dict__[name][rows] for name in ("R_BN", "R_EN") if name in self.__dict__})
        return part

    def thinned(self, count: int) -> Sample:
        """At most `count` rows, evenly taken."""
        return self if len(self) <= count else self.take(_evenly(len(self), count))


def comparable(telemetry: Telemetry, model: FieldModel, usable: BoolArray, *, with_attitude: bool) -> Sample | None:
    """The rows among `usable` with reading and position (and attitude); None without any, or where most read zero.

    Raises OutOfRange for stamps that the model does not cover.
    """
    good = telemetry.has_reading & telemetry.has_position & usable
    if with_attitude:
        good &= telemetry.has_attitude
    if telemetry.r_N_km is None or not good.any():
        return None
    rows = np.flatnonzero(good)
    rows = rows[_evenly(rows.size, MAX_ROWS)]
    rows = rows[np.linalg.norm(telemetry.r_N_km[rows], axis=1) > 6300.0]
    size = np.linalg.norm(telemetry.mag_B_nT[rows], axis=1)
    rows = rows[size < 3.0 * np.median(size)] if size.any() else rows[:0]  # single bit errors must not decide
    if rows.size == 0:
        return None
    time, r, v = telemetry.time[rows], np.array(telemetry.r_N_km[rows]), telemetry.v_N_km_s
    sample = Sample(
        rows,
        time,
        r,
        np.array(telemetry.mag_B_nT[rows]),
        field_N_nT(model, time, r),
        np.array(telemetry.q_NB[rows]) if telemetry.q_NB is not None and with_attitude else None,
        velocity_from_positions(time, r) if v is None else np.array(v[rows]),
    )
    moving = np.asarray(np.isfinite(sample.v_N_km_s).all(axis=1))  # a few positions between two gaps give none
    return sample.take(moving) if 2 * moving.sum() > moving.size else sample


def rms(vectors: FloatArray) -> float:
    """Root mean square length of vectors (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _evenly(count: int, most: int) -> np.ndarray:
    return np.linspace(0, count - 1, min(count, most)).astype(int)
