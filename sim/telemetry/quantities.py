"""The columns of telemetry, in one table: names, units, what a file may call them, and who writes them.

A new column is a row of `QUANTITIES`, a field of the record (`Telemetry`) and the part of the simulator that writes it.
Files, column maps, rates of sampling, the record and the diagnosis read the table. Columns whose names are the user's
(`flag_NAME`, `driver_NAME`) are `FAMILIES`: as many as there are.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

_DEG = float(np.pi / 180.0)

Part = Literal[
    "magnetometer",
    "magnetometer_2",
    "attitude",
    "sun_sensor",
    "horizon_scanner",
    "gyro",
    "torquers",
    "housekeeping",
]
"""Who writes a column: a section under [sampling] of a scenario says when."""


@dataclass(frozen=True)
class Quantity:
    """One quantity: its columns in a file, the units they may carry, its place in the record."""

    name: str
    """Field of the record, or `r_E_km` and `yaw_roll_pitch_rad`, which become fields of the record on reading."""
    stems: tuple[str, ...]
    """Names of its columns without the unit, one a component."""
    units: Mapping[str, float]
    """Unit at the end of a column's name: factor into the record's unit. The first one is written. "" is no unit."""
    long_name: str
    cf_units: str
    """Unit of the first ending as CF (UDUNITS) spells it."""
    part: Part | None = None
    mapped: str | None = None
    """What a column map calls it; None where a map has no such quantity."""
    more_units: Mapping[str, float] = field(default_factory=dict)
    """Units that a column map takes besides."""
    binary: bool = False
    """Values are 0 or 1."""
    held: bool = False
    """Between samples the last value holds; otherwise it is interpolated."""
    condition: str | None = None
    """The condition of a diagnosis that follows it as it stands; None where it enters in another way, or not at all."""

    def columns(self, unit: str) -> tuple[str, ...]:
        """Names of the file's columns in `unit`, one a component."""
        return tuple(f"{stem}_{unit}" if unit else stem for stem in self.stems)

    @property
    def written(self) -> tuple[str, ...]:
        """Names of the file's columns in the unit that is written."""
        return self.columns(next(iter(self.units)))

    @property
    def plain(self) -> tuple[str, ...]:
        """Names of the file's columns in the record's own unit."""
        return self.columns(next(unit for unit, factor in self.units.items() if factor == 1.0))

    @property
    def components(self) -> int:
        """Columns of the record's array (N, k); 0 for an array (N,), -1 for any number."""
        return -1 if self is WHEELS else 0 if len(self.stems) == 1 else len(self.stems)

    @property
    def map_units(self) -> dict[str, float]:
        """Units that a column map takes, in its spelling: km/s for the ending km_s. Empty: it takes none."""
        units = {unit.replace("_", "/"): factor for unit, factor in self.units.items() if unit}
        return units | dict(self.more_units)


def _xyz(stem: str) -> tuple[str, ...]:
    return tuple(f"{stem}_{axis}" for axis in "xyz")


def _number(stem: str, unit: str, long_name: str, cf_units: str | None = None, **more: Any) -> Quantity:
    """A quantity of one number a row, which a map calls by its stem."""
    name = f"{stem}_{unit}" if unit else stem
    return Quantity(name, (stem,), {unit: 1.0}, long_name, cf_units or unit or "1", mapped=stem, **more)


def _direction(stem: str, long_name: str, part: Part) -> Quantity:
    """A measured unit vector."""
    return Quantity(f"{stem}_B", _xyz(stem), {"": 1.0}, f"{long_name}, body axes", "1", part=part, mapped=stem)


POSITION = Quantity("r_N_km", _xyz("r"), {"km": 1.0}, "position, GCRS", "km", mapped="position", more_units={"m": 1e-3})
POSITION_E = Quantity("r_E_km", _xyz("ecef"), {"km": 1.0}, "position, Earth-fixed (ITRS)", "km")
VELOCITY = Quantity(
    "v_N_km_s", _xyz("v"), {"km_s": 1.0}, "velocity, GCRS", "km s-1", mapped="velocity", more_units={"m/s": 1e-3}
)
MAG = Quantity(
    "mag_B_nT",
    _xyz("mag"),
    {"nT": 1.0, "mG": 100.0, "uT": 1e3, "T": 1e9},
    "magnetometer reading, nominal body axes",
    "nT",
    part="magnetometer",
    mapped="mag",
    more_units={"G": 1e5},
)
MAG2 = replace(
    MAG,
    name="mag2_B_nT",
    stems=_xyz("mag2"),
    long_name="reading of the second magnetometer, nominal body axes",
    part="magnetometer_2",
    mapped="mag2",
)
QUATERNION = Quantity(
    "q_NB",
    ("q_x", "q_y", "q_z", "q_w"),
    {"": 1.0},
    "attitude quaternion of the body relative to GCRS, scalar last (Wertz; Markley and Crassidis)",
    "1",
    part="attitude",
    mapped="attitude",
)
ANGLES = Quantity(
    "yaw_roll_pitch_rad",
    ("yaw", "roll", "pitch"),
    {"deg": _DEG},
    "3-1-2 attitude angles from the orbital frame to the body",
    "degree",
)
DIPOLE = Quantity(
    "dipole_B_Am2",
    _xyz("dipole"),
    {"Am2": 1.0},
    "torquer dipole, body axes",
    "A m2",
    part="torquers",
    mapped="dipole",
    more_units={"mAm2": 1e-3},
    held=True,
)
RATE = Quantity(
    "rate_B_rad_s",
    _xyz("rate"),
    {"deg_s": _DEG, "rad_s": 1.0},
    "body rate",
    "degree s-1",
    part="gyro",
    mapped="rate",
)
_HOUSE: dict[str, Any] = {"part": "housekeeping"}
_STATE: dict[str, Any] = {"binary": True, "held": True}
_CURRENT: dict[str, Any] = {**_HOUSE, "more_units": {"mA": 1e-3}, "condition": "current"}
WHEELS = _number(
    "wheel_speed",
    "rpm",
    "wheel speeds; columns wheel_1_speed_rpm, wheel_2_speed_rpm, ...",
    more_units={"rad/s": 60.0 / (2.0 * np.pi)},
    **_HOUSE,
)
QUANTITIES: tuple[Quantity, ...] = (
    POSITION,
    POSITION_E,
    VELOCITY,
    MAG,
    MAG2,
    QUATERNION,
    ANGLES,
    DIPOLE,
    _number("sunlit", "", "1 in sunlight, 0 in shadow", **_STATE),
    _number("heater_on", "", "1 while the heater is on", **_HOUSE, **_STATE),
    _number("array_current", "A", "solar array current", **_CURRENT),
    _number("battery_current", "A", "battery current, positive charging", **_CURRENT),
    _number("temperature", "degC", "magnetometer temperature", "degree_Celsius", more_units={"K": 1.0}, **_HOUSE),
    _number("sun_sensor_head", "", "sun sensor head in use, 0 none", part="sun_sensor", held=True),
    _direction("sun", "measured unit vector to the sun", "sun_sensor"),
    _direction("nadir", "measured unit vector to nadir", "horizon_scanner"),
    RATE,
)
"""In the order in which files have them."""

BY_NAME = {quantity.name: quantity for quantity in QUANTITIES}
RECORDED = tuple(q for q in (*QUANTITIES, WHEELS) if q not in (POSITION_E, ANGLES))
"""The arrays of a record beside time and flags."""
BY_MAP_NAME = {q.mapped: q for q in RECORDED if q.mapped is not None}


@dataclass(frozen=True)
class Family:
    """Columns that a user names, `prefix` and NAME; a field of the record holds them by NAME, (N,) each."""

    field: str
    prefix: str
    about: str
    """What one of them is, for a file."""
    part: Part | None = None
    binary: bool = False
    """Values are 0 or 1, and the last one holds until the next."""

    @property
    def pattern(self) -> str:
        """Of a whole column name; the group is NAME."""
        return self.prefix + "([A-Za-z0-9_]{1,60})"

    def name_in(self, column: str) -> str | None:
        """NAME, where the column is of this family."""
        match = re.fullmatch(self.pattern, column)
        return None if match is None else match[1]


FLAGS = Family("flags", "flag_", "flag, 0 or 1", binary=True)
DRIVERS = Family("drivers", "driver_", "what may drive a field of the spacecraft", part="housekeeping")
FAMILIES = (FLAGS, DRIVERS)


def family_of(column: str) -> Family | None:
    """The family of a column; None where its name is not the user's."""
    return next((family for family in FAMILIES if family.name_in(column) is not None), None)


def columns_of(part: str) -> tuple[str, ...]:
    """Fields of the record that a part of the spacecraft writes."""
    return tuple(quantity.name for quantity in RECORDED if quantity.part == part)
