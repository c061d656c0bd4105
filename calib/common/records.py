"""The calibration record: what the estimators hand on, and how it is applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.calib.common.conventions import Correction, Forward, forward_from_correction
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.late import bridged, late
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns

CONVENTION = "A B0 = (I+S) B + b + T D"
"""Journal eq. 1 of Lerner & Shuster (1981): measured to true."""

COVARIANCE_KINDS = ("white", "blocks", "none")
"""`white`: errors independent from sample to sample; `blocks`: correlated within blocks; `none`: unknown."""

LARGE_S = 0.3
"""No magnetometer is off by 30 %; wrong units, axes and attitudes are."""


def parameter_names(with_T: bool) -> tuple[str, ...]:
    """Names in the order of the covariance: S row by row, b, T row by row (12 or 21)."""
    grid = [f"{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    names = [f"S{at}" for at in grid] + ["b1", "b2", "b3"]
    return tuple(names + [f"T{at}" for at in grid] if with_T else names)


def parameter_unit(name: str) -> str:
    """Unit of a parameter: S is a pure number, b in nT, T in nT/(A m2)."""
    return {"S": "1", "b": "nT", "T": "nT/(A m2)"}[name[0]]


@dataclass(frozen=True)
class TelemetryBias:
    """A field in the reading that follows a column of telemetry: B = ... + s I."""

    value_nT: FloatArray
    """(3,) s: nT for a unit of the column."""
    sigma_nT: FloatArray
    """(3,) 1 sigma."""
    delay_s: float = 0.0
    """The field follows the column this long after,"""
    lag_s: float = 0.0
    """and then behind a first-order lag."""


@dataclass(frozen=True)
class Onboard:
    """What was applied to the readings on board, m' = M (m - o). Arrays are read-only."""

    name: str
    """Of the file that it was read from."""
    M: FloatArray
    """(3, 3)."""
    o_nT: FloatArray
    """(3,)."""

    def __post_init__(self) -> None:
        for name, shape in (("M", (3, 3)), ("o_nT", (3,))):
            object.__setattr__(self, name, array_of(getattr(self, name), shape, f"onboard: {name}"))


@dataclass(frozen=True)
class Calibration(Shown):
    """S, b and T of A B0 = (I+S) B + b + T D, with their covariance. Arrays are read-only.

    A parameter that was not estimated has the value 0 and zero rows in the covariance; `sigma` is None for it.
    """

    S: FloatArray
    """(3, 3) scale, cross-talk and misalignment; a pure number."""
    b_nT: FloatArray
    """(3,) bias, added to the reading [nT]."""
    T_nT_per_Am2: FloatArray | None = None
    """(3, 3) coupling of the torquers; None where they were not modelled."""
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(P, P), P = 12 or 21 with T; order: S row by row, b, T row by row; units of the parameters."""
    covariance_kind: str = "none"
    """`white`, `blocks` or `none`."""
    sigma_nT: float = 0.0
    """Residual of one field component, 1 sigma, rms over the three axes [nT]."""
    samples: int = 0
    """Vector samples used."""
    span: tuple[np.datetime64, np.datetime64] | None = None
    """First and last sample used, UTC."""
    temperature_degC: tuple[float, float] | None = None
    """Lowest and highest temperature of the magnetometer among these samples; None where it is not known."""
    expires: np.datetime64 | None = None
    """When a drift that `calib.trend` found has made it wrong by three of its sigmas, UTC; None where none is known."""
    field_model: str = ""
    """Model of the geomagnetic field."""
    method: str = ""
    """The method, in words."""
    unobservable: tuple[str, ...] = ()
    """In words: what these data do not determine."""
    telemetry_bias: Mapping[str, TelemetryBias] = field(default_factory=dict)
    """By column of telemetry: the field in the reading that is subtracted before S, b and T act. Not in `covariance`."""
    spacecraft: str = ""
    """Whose magnetometer it is; empty where the telemetry did not say."""
    magnetometer: int = 1
    """Number of the magnetometer on that spacecraft."""
    residual_to: str = ""
    """The calibration that had corrected the readings before; empty for a calibration of raw readings."""
    onboard: Onboard | None = None
    """What had been applied on board to the readings that were calibrated, and was undone: S, b and T act on the sensor's
    own. `calib.common.onboard` composes the two."""
    version: str = field(default="", compare=False)
    """Version of fluxtwin that made it; a file states it, and is none the less equal to what was written."""

    def __post_init__(self) -> None:
        size = len(self.names)
        if np.size(self.covariance) == 0:
            object.__setattr__(self, "covariance", np.zeros((size, size)))
        shapes = {"S": (3, 3), "b_nT": (3,), "T_nT_per_Am2": (3, 3), "covariance": (size, size)}
        for name, shape in shapes.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, array_of(getattr(self, name), shape, name))
        if self.covariance_kind not in COVARIANCE_KINDS:
            raise BadInput(f"{self.covariance_kind!r}", where="covariance_kind", wanted=" or ".join(COVARIANCE_KINDS))
        object.__setattr__(self, "unobservable", tuple(self.unobservable))

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in the order of the covariance."""
        return parameter_names(self.T_nT_per_Am2 is not None)

    @property
    def values(self) -> FloatArray:
        """(P,) parameters in the order of the covariance."""
        T = np.zeros(0) if self.T_nT_per_Am2 is None else self.T_nT_per_Am2.ravel()
        return np.concatenate([self.S.ravel(), self.b_nT, T])

    @property
    def sigmas(self) -> FloatArray:
        """(P,) 1 sigma, 0 where a parameter was not estimated."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sigma(self) -> dict[str, float | None]:
        """1 sigma by parameter name; None where the parameter was not estimated."""
        return {n: float(s) if s > 0 else None for n, s in zip(self.names, self.sigmas, strict=True)}

    @property
    def correction(self) -> Correction:
        """The same numbers as a `conventions.Correction`, for conversion to other conventions."""
        return Correction(self.S, self.b_nT, self.T_nT_per_Am2)

    @property
    def forward(self) -> Forward:
        """G, o, C of B = G A H + o + C D."""
        return forward_from_correction(self.correction)

    def apply(
        self,
        mag_B_nT: FloatArray,
        dipole_B_Am2: FloatArray | None = None,
        columns: Mapping[str, FloatArray] | None = None,
    ) -> FloatArray:
        """(N, 3) estimate of the true field in body axes: (I+S) B + b + T D (Lerner & Shuster 1981, eq. 1).

        mag_B_nT, dipole_B_Am2: (N, 3), body. columns: (N,) columns of telemetry by name, as `columns_of` returns
        them. Rows with missing numbers stay missing.
        Raises BadInput for readings of another shape, when T is known but no dipole is given, or when a column that the
        reading follows is missing.
        """
        try:
            given = np.asarray(mag_B_nT, dtype=np.float64)
        except (TypeError, ValueError):
            wanted = "shape (N, 3); of a record, fluxtwin.apply(record, calibration)"
            raise BadInput("is no array of numbers", where="mag_B_nT", wanted=wanted) from None
        if given.shape[-1:] != (3,):
            raise BadInput(f"has shape {given.shape}", where="mag_B_nT", wanted="shape (N, 3)")
        reading = self._without_telemetry_bias(given, columns or {})
        true = reading + reading @ self.S.T + self.b_nT
        if self.T_nT_per_Am2 is None or not self.T_nT_per_Am2.any():
            return true
        if dipole_B_Am2 is None:
            raise BadInput(
                "this calibration has a T, and no torquer dipole is given",
                where="dipole_x_Am2 dipole_y_Am2 dipole_z_Am2",
                wanted="the dipole columns, or a calibration of b and S alone",
            )
        # A column of T that is zero must not spread a blank dipole of that axis.
        used = np.flatnonzero(self.T_nT_per_Am2.any(axis=0))
        dipole = np.asarray(dipole_B_Am2, dtype=np.float64)[..., used]
        return np.asarray(true + dipole @ self.T_nT_per_Am2[:, used].T)

    def _without_telemetry_bias(self, reading_nT: FloatArray, columns: Mapping[str, FloatArray]) -> FloatArray:
        for name, bias in self.telemetry_bias.items():
            if name not in columns:
                raise BadInput(
                    f"this calibration subtracts a field that follows {name!r}, and the telemetry lacks the column",
                    where=name,
                    wanted="telemetry with that column, or a calibration made without its --driver",
                )
            reading_nT = reading_nT - np.asarray(columns[name], dtype=np.float64)[..., None] * bias.value_nT
        return reading_nT

    def columns_of(
        self, telemetry: Telemetry, rows: np.ndarray | slice = slice(None), *, fitted: bool = False
    ) -> dict[str, FloatArray]:
        """Columns of the telemetry by name, in these rows; those of `telemetry_bias` with delay and lag of their field.

        What hangs on a missing value is missing; in the rows that were fitted it is as it was there, bridged.
        """
        columns = recorded_columns(telemetry)
        for name, bias in self.telemetry_bias.items():
            if (bias.delay_s or bias.lag_s) and name in columns and np.isfinite(columns[name]).any():
                acts = (seconds_of(telemetry.time), columns[name], bias.delay_s, bias.lag_s)
                columns[name] = late(*acts) if fitted else np.where(bridged(*acts), np.nan, late(*acts))
        return {name: values[rows] for name, values in columns.items()}

    @property
    def digest(self) -> str:
        """SHA-256 of the content, as the calibration file states it."""
        from fluxtwin.calib.common.calibration_file import file_content
        from fluxtwin.sim.base.seals import digest_of

        return digest_of(file_content(self))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text by name, S, b and T as arrays; no NaN."""
        from fluxtwin.calib.common.calibration_file import calibration_to_dict

        return calibration_to_dict(self)

    def to_toml(self, path: Path | str) -> Path:
        """Write the calibration file atomically. Raises BadInput when it cannot be written."""
        from fluxtwin.calib.common.calibration_file import write_calibration

        return write_calibration(self, path)

    @classmethod
    def from_toml(cls, path: Path | str) -> Calibration:
        """Read a calibration file. Raises BadInput naming file, key, what was found and what is wanted."""
        from fluxtwin.calib.common.calibration_file import read_calibration

        return read_calibration(path)


def seconds_of(time: TimeArray) -> FloatArray:
    """(N,) seconds since the first stamp."""
    return np.asarray((time - time[0]).astype("int64") * 1e-9)


def array_of(value: Any, shape: tuple[int, ...], name: str) -> FloatArray:
    """A finite, read-only array of that shape; raises BadInput for anything else."""
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, OverflowError):
        raise BadInput("is no array of numbers", where=name, wanted=f"shape {shape}") from None
    if array.shape != shape:
        raise BadInput(f"has shape {array.shape}", where=name, wanted=f"shape {shape}")
    if not np.isfinite(array).all():
        raise BadInput("holds a number that is not finite", where=name, wanted="finite numbers")
    array.setflags(write=False)
    return array
