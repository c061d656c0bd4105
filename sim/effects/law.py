"""A law that data gave: a field in proportion to recorded columns and geometry, for a cause that nobody has listed.

A factor is a quantity with what is done to it: `driver_payload`, `driver_payload^2`, `not sunlit`, `temperature_degC>21.5`,
`cos orbit_phase`, `sin2 local_time`. Quantities are recorded columns by their telemetry names (components: `dipole_x`,
`wheel_1`) and those of `GEOMETRY`. `since 2026-03-05T01:00:00Z` is 0 before that time and 1 from it on, `until ...` the
reverse: a switch that nobody recorded.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.late import bridged, late
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import Parameter, SignalEffect, vector_parameters
from fluxtwin.sim.effects.drivers import lit, sun_in_body
from fluxtwin.sim.effects.signal import Setting, Signal

Axes = Literal["body", "orbital", "inertial", "earth"]
_FACTOR = re.compile(r"(?:(not|cos|sin|cos2|sin2) )?([A-Za-z]\w*)(?:\^([23])|>(-?[\d.]+(?:e[+-]?\d+)?))?")
_TIMED = re.compile(r"(since|until) (\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d{1,9})?)Z")
_VECTORS = {"dipole": ("dipole_B_Am2", "xyz"), "wheel": ("wheel_speed_rpm", "123456789")}


def _sun(setting: Setting, axis: int) -> FloatArray:
    sun_B, known = sun_in_body(setting)
    return np.where(known, sun_B[:, axis], 0.0)


def _local_time_rad(setting: Setting) -> FloatArray:
    (x, y, _), (a, b, _) = setting.given[0].T, setting.sun_N.T
    return np.asarray(np.arctan2(y, x) - np.arctan2(b, a))


def _sun_height(setting: Setting) -> FloatArray:
    r_N_km = setting.given[0]
    return np.asarray(np.einsum("ij,ij->i", setting.sun_N, r_N_km) / np.linalg.norm(r_N_km, axis=1))


def _rate(setting: Setting, axis: int) -> FloatArray:
    return np.asarray(np.degrees(setting.rate_B_rad_s[:, axis]))


GEOMETRY: Mapping[str, Callable[[Setting], FloatArray]] = {
    "one": lambda setting: np.ones(setting.time.size),
    "sunlit": lit,
    **{f"sun_{axis}": partial(_sun, axis=number) for number, axis in enumerate("xyz")},
    "sun_height": _sun_height,
    **{f"rate_{axis}": partial(_rate, axis=number) for number, axis in enumerate("xyz")},
    "orbit_phase": lambda setting: setting.orbit_phase_rad,
    "local_time": _local_time_rad,
    "latitude": lambda setting: setting.latitude_rad,
    "longitude": lambda setting: setting.geocentric[1],
}
"""1 (a constant along axes that are not the body's), the sun's direction in body axes, the sine of its height, the body's
rate [deg/s], angles [rad]."""
FIELD = tuple(f"field_{part}" for part in ("x", "y", "z", "size"))
"""Of the ambient field in body axes [uT]."""
ANGLES = ("orbit_phase", "local_time", "latitude", "longitude")
_DONE: Mapping[str | None, Callable[[FloatArray], FloatArray]] = {
    None: lambda x: x,
    "not": lambda x: 1.0 - x,
    "cos": np.cos,
    "sin": np.sin,
    "cos2": lambda x: np.cos(2.0 * x),
    "sin2": lambda x: np.sin(2.0 * x),
}


def quantity(setting: Setting, field_B_nT: FloatArray, name: str) -> FloatArray | None:
    """(N,) a quantity at the stamps, a column with its gaps; None where it was not recorded. field_B_nT (N, 3): ambient."""
    if name in GEOMETRY:
        return GEOMETRY[name](setting)
    if name in FIELD:
        part = name.removeprefix("field_")
        return 1e-3 * (np.linalg.norm(field_B_nT, axis=1) if part == "size" else field_B_nT[:, "xyz".index(part)])
    stem, _, part = name.rpartition("_")
    column = setting.column(name)
    if stem in _VECTORS and part in _VECTORS[stem][1]:
        whole, number = setting.column(_VECTORS[stem][0]), _VECTORS[stem][1].index(part)
        wide = None if whole is None else whole.reshape(whole.shape[0], -1)
        column = wide[:, number] if wide is not None and number < wide.shape[1] else None
    if column is None or column.ndim != 1 or not np.isfinite(column).any():
        return None
    return np.radians(column) if name.endswith("_deg") else column


@dataclass(frozen=True)
class Law(SignalEffect):
    """Field by a law found in the data.

    k times the product of the factors in `of`, along fixed axes of the body, the orbit, inertial space or the Earth.
    The quantity of the first factor is taken `delay_s` before and behind a first-order lag `lag_s`.
    """

    name = "law"
    stage = "spacecraft"
    keyed_by = "term"
    settled_by = "switching what it records on and off, in several attitudes, in sunlight and in shadow"
    about = (
        "term of a law found by sparse regression of what no other effect explains, positive along the axis (Brunton, "
        "Proctor & Kutz 2016, doi 10.1073/pnas.1517384113); diagnose never takes it for a cause of the catalogue"
    )
    term: str = ""
    """NAME of the term."""
    of: tuple[str, ...] = ()
    axes: Axes = "body"
    delay_s: float = 0.0
    lag_s: float = 0.0
    typical_nT_per_unit: float = field(default=20.0, compare=False)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return vector_parameters("k", "nT/unit", self.typical_nT_per_unit)

    def instances(self, setting: Setting) -> tuple[Law, ...]:
        """None: the search for causes has the catalogue alone."""
        return ()

    def quantities(self) -> tuple[str, ...]:
        """What the factors are made of, times left out. Raises BadInput for one that cannot be read."""
        return tuple(_parsed(factor)[1] for factor in self.of if not timed(factor))

    def values(self, setting: Setting, field_B_nT: FloatArray, later_s: float | FloatArray = 0.0) -> FloatArray | None:
        """(N,) the product, `later_s` after the stamps as far as it is late; None where a column is missing.

        field_B_nT (N, 3): ambient, body axes.
        """
        product = np.ones(setting.time.size)
        for number, factor in enumerate(self.of):
            if switched := timed(factor):
                on = setting.seconds + later_s >= epoch.seconds_since(switched[1], setting.time[0])
                product = product * (on if switched[0] == "since" else ~on)
                continue
            done, name, power, level = _parsed(factor)
            column = quantity(setting, field_B_nT, name)
            if column is None:
                return None
            first = number == 0
            column = late(
                setting.seconds, column, (self.delay_s if first else 0.0) - later_s, self.lag_s if first else 0.0
            )
            column = (column > float(level)).astype(np.float64) if level else column ** int(power or 1)
            product = product * _DONE[done](column)
        return product

    def invented(self, setting: Setting) -> BoolArray:
        rows = super().invented(setting)
        for number, factor in enumerate(self.of):
            column = None if timed(factor) else quantity(setting, np.ones((rows.size, 3)), _parsed(factor)[1])
            if column is not None:
                rows |= bridged(setting.seconds, column, *((0.0, 0.0) if number else (self.delay_s, self.lag_s)))
        return rows

    def condition_on(self, setting: Setting) -> str | None:
        named = [name.removeprefix("driver_") for name in self.quantities() if name.startswith("driver_")]
        return f"driver:{named[0]}" if named else None

    def untestable(self, setting: Setting) -> str | None:
        if not self.of:
            return "it has no factors"
        missing = [n for n in self.quantities() if quantity(setting, np.ones((setting.time.size, 3)), n) is None]
        return f"the telemetry has no {missing[0]}" if missing else None

    def turn(self, setting: Setting, R_BN: Rotation) -> Rotation | None:
        """From its axes to those of the body, N turns; None where they are the same."""
        if self.axes == "body":
            return None
        if self.axes == "inertial":
            return R_BN
        return R_BN * (setting.R_ON if self.axes == "orbital" else setting.R_EN).inv()

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        values = self.values(signal.setting, signal.field_B_nT, signal.sample_offset_s)
        if values is None:
            return signal
        vector, turn = values[:, None] * theta, self.turn(signal.setting, signal.R_BN)
        return signal.with_stray(vector if turn is None else turn.apply(vector))


def timed(factor: str) -> tuple[str, np.datetime64] | None:
    """`since` or `until`, and the time; None for a factor that is not of the time."""
    found = _TIMED.fullmatch(factor)
    return None if found is None else (found.group(1), epoch.parse_time(found.group(2)))


def _parsed(factor: str) -> tuple[str | None, str, str | None, str | None]:
    found = _FACTOR.fullmatch(factor)
    if found is None:
        wanted = "a quantity as driver_payload^2, not sunlit, temperature_degC>21.5 or cos orbit_phase, or since TIME"
        raise BadInput(f"factor {factor!r}", where="law of", wanted=wanted)
    done, name, power, level = found.groups()
    return done, str(name), power, level
