"""The conditions that a discrepancy may depend on, as columns of numbers along the record.

The names are those of a diagnosis (`sunlit eclipse torquer latitude orbit_phase temperature current
field_strength time after_time head rate region flag:NAME`; a named driver adds its `driver:NAME`); `label` tells
variants of one name apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.effects import drivers
from fluxtwin.sim.effects.base import known_column
from fluxtwin.sim.effects.drivers import TIME_CONSTANTS_S
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.telemetry.quantities import QUANTITIES

_HARMONICS = 3
_REGIONS = 48
_REGION_RADIUS_RAD = 0.35  # of a Gaussian patch, about 20 degrees: neighbours on the sphere overlap at half height
LEAST_SHARE = 0.02
"""Of the rows: an indicator that holds for less, or for all but less, says nothing."""


@dataclass(frozen=True)
class Condition:
    """One condition along the record."""

    name: str | None
    """As a diagnosis names it; None for "always"."""
    label: str
    columns: FloatArray
    """(N, k); 0 or 1, or of unit rms. Where nature's zero is not known (time, latitude, temperature) the first
    column is constant: calibration absorbs it in body axes, but not in others."""
    indicator: bool = False


def conditions(setting: Setting) -> tuple[Condition, ...]:
    """Every condition that varies on this design, but regions (`regions`) and steps (`after`)."""
    every = (*_lighting(setting), *_orbital(setting), *_housekeeping(setting))
    return tuple(condition for condition in every if _varies(condition))


def always(setting: Setting) -> Condition:
    """The condition that always holds."""
    return Condition(None, "always", np.ones((setting.time.size, 1)), indicator=True)


def after(setting: Setting, seconds: float) -> Condition:
    """From a moment on, in seconds from the first stamp."""
    return Condition("after_time", "after a moment", (setting.seconds >= seconds)[:, None].astype(float), True)


def regions(setting: Setting) -> tuple[Condition, ...]:
    """Smooth patches of the Earth, each about 40 degrees wide, that the record passes over."""
    unit = setting.R_EN.apply(setting.given[0])
    unit = unit / np.linalg.norm(unit, axis=1)[:, None]
    found = []
    for centre in _fibonacci_sphere(_REGIONS):
        away = np.arccos(np.clip(unit @ centre, -1.0, 1.0)) / _REGION_RADIUS_RAD
        patch = np.exp(-0.5 * away**2)
        if 0.005 * unit.shape[0] < (patch > 0.5).sum() and (patch > 0.5).mean() < 0.5:
            latitude, longitude = np.degrees([np.arcsin(centre[2]), np.arctan2(centre[1], centre[0])])
            found.append(Condition("region", f"region {latitude:.0f} N {longitude:.0f} E", patch[:, None]))
    return tuple(found)


def _lighting(setting: Setting) -> Iterator[Condition]:
    sunlit = np.asarray(drivers.lit(setting) > 0.5, dtype=np.float64)
    yield _indicator("sunlit", "sunlit", sunlit)
    since = _since_start(setting.seconds, sunlit < 0.5)
    yield _smooth("eclipse", "time in eclipse", since, zero_known=True)
    yield _indicator("eclipse", "eclipse", 1.0 - sunlit)
    r_E_km = setting.R_EN.apply(setting.given[0])
    sun_E = setting.R_EN.apply(sun.sun_direction_N(setting.time))
    day = np.einsum("ij,ij->i", sun_E, r_E_km) > 0
    yield _indicator("eclipse", "night below", 1.0 - day)
    sun_B, known = drivers.sun_in_body(setting)
    shone_on = sunlit * known
    yield Condition("sunlit", "sun direction", sun_B * shone_on[:, None])
    faces = np.concatenate([np.maximum(sun_B, 0), np.maximum(-sun_B, 0)], axis=1) * shone_on[:, None]
    yield Condition("sunlit", "sun on each face", faces)
    recorded = known_column(setting, "temperature_degC")
    if recorded is not None:
        yield _smooth("temperature", "temperature", recorded)
    else:
        for tau_s in TIME_CONSTANTS_S:  # as the effects try them
            lagged = drivers.temperature_K(setting, float(tau_s))
            yield _smooth("temperature", f"sunlight lagged by {tau_s:.0f} s", lagged)


def _orbital(setting: Setting) -> Iterator[Condition]:
    u = setting.orbit_phase_rad
    waves = [wave(n * u) for n in range(1, _HARMONICS + 1) for wave in (np.cos, np.sin)]
    yield _smooth("orbit_phase", "orbit phase, once", np.stack(waves[:2], axis=1))
    yield _smooth("orbit_phase", "orbit phase", np.stack(waves, axis=1))
    sine = np.sin(setting.latitude_rad)
    yield _smooth("latitude", "latitude", np.stack([sine, np.cos(2 * setting.latitude_rad)], axis=1))
    yield _smooth("latitude", "polar caps", np.stack([np.maximum(sine, 0) ** 4, np.maximum(-sine, 0) ** 4], axis=1))
    longitude = frames.geocentric(setting.R_EN.apply(setting.given[0]))[1]
    waves = [wave(n * longitude) for n in (1, 2) for wave in (np.cos, np.sin)]
    yield _smooth("region", "longitude", np.stack(waves, axis=1))
    t = 2 * setting.seconds / max(float(setting.seconds[-1]), 1e-9) - 1
    yield _smooth("time", "time", t)
    yield _smooth("time", "time, cubic", np.stack([t, t**2, t**3], axis=1))


def _housekeeping(setting: Setting) -> Iterator[Condition]:
    dipole = known_column(setting, "dipole_B_Am2")
    if dipole is not None:
        yield _smooth("torquer", "torquer dipole", dipole, zero_known=True)
        yield _indicator("torquer", "any torquer on", (np.abs(dipole) > 1e-3 * np.abs(dipole).max()).any(axis=1))
    for quantity in QUANTITIES:
        recorded = None if quantity.condition is None else known_column(setting, quantity.name)
        if recorded is not None:
            yield _smooth(quantity.condition, quantity.stems[0].replace("_", " "), recorded, zero_known=True)
    head = known_column(setting, "sun_sensor_head")
    for number in np.unique(head)[1:] if head is not None else ():
        yield _indicator("head", f"head {number:.0f}", head == number)
    switches = {name: known_column(setting, name) for name in setting.columns if name.startswith("flag_")}
    switches["flag_heater_on"] = known_column(setting, "heater_on")
    for name, flag in switches.items():
        if flag is not None:
            yield _indicator(f"flag:{name.removeprefix('flag_')}", name.removeprefix("flag_"), flag > 0.5)
    rate = setting.rate_B_rad_s
    if setting.attitude_known is not None and setting.column("rate_B_rad_s") is None:
        rate = np.where(setting.attitude_known[:, None], rate, 0.0)
    if np.linalg.norm(rate.std(axis=0)) > 1e-5:
        yield _smooth("rate", "body rate", rate)


def _varies(one: Condition) -> bool:
    if one.indicator and not LEAST_SHARE < one.columns.mean() < 1 - LEAST_SHARE:
        return False
    return bool(one.columns.size and one.columns.std(axis=0).max() > 1e-9)


def _indicator(name: str, label: str, values: FloatArray | BoolArray) -> Condition:
    return Condition(name, label, np.asarray(values, dtype=np.float64).reshape(-1, 1), indicator=True)


def _smooth(name: str | None, label: str, values: FloatArray, zero_known: bool = False) -> Condition:
    columns = np.asarray(values, dtype=np.float64).reshape(values.shape[0], -1)
    moving = columns.std(axis=0) > 1e-9 * np.abs(columns).max(initial=1e-30)
    columns = columns[:, moving]
    columns = columns if zero_known else columns - columns.mean(axis=0)
    columns = columns / np.sqrt(np.mean(columns**2, axis=0))
    if not zero_known and columns.shape[1]:
        columns = np.concatenate([np.ones((columns.shape[0], 1)), columns], axis=1)
    return Condition(name, label, columns)


def _since_start(seconds: FloatArray, holds: BoolArray) -> FloatArray:
    """(N,) seconds since the condition last began; 0 where it does not hold."""
    begins = holds & ~np.concatenate([[False], holds[:-1]])
    latest = np.maximum.accumulate(np.where(begins, np.arange(holds.size), 0))
    return np.where(holds, seconds - seconds[latest], 0.0)


def _fibonacci_sphere(count: int) -> FloatArray:
    """(count, 3) unit vectors spread evenly over the sphere."""
    index = np.arange(count) + 0.5
    z, turn = 1 - 2 * index / count, np.pi * (1 + np.sqrt(5)) * index
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
