"""How much of a truth the plain entry of the same name can carry, at best: of one of another shape, and of one whose
driving column is not recorded.

An answer is `effect` only where the named effects carry at least 90 % of the structured energy; so where the plain
shape cannot carry as much, `unknown` that resembles the name is the right answer, and the score keeps such cases apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fluxtwin.sim.earth import epoch, frames
from withheld_cases import of_place, of_sensor, of_spacecraft, spacecraft
from withheld_cases.chain import Ambient, Truth
from withheld_cases.visible import signature_nT
from withheld_cases.worlds import World

State = Callable[[World, np.ndarray], np.ndarray]
STOOD_IN = {
    "solar_array_current": "array_current_A",
    "battery_current": "battery_current_A",
    "thermal_bias_drift": "temperature_degC",
    "thermal_scale_drift": "temperature_degC",
}
"""Entries for which something stands in where their column is not recorded."""
_TAUS_S = (300.0, 500.0, 800.0, 1200.0, 1800.0, 2700.0, 4000.0)
_TRACELESS = [np.diag([1.0, -1.0, 0.0]), np.diag([0.0, 1.0, -1.0])] + [
    np.eye(3)[[a]].T @ np.eye(3)[[b]] + np.eye(3)[[b]].T @ np.eye(3)[[a]] for a, b in ((0, 1), (0, 2), (1, 2))
]


def plain_share(world: World, truth: Truth, size: float) -> float:
    """Largest share of the visible energy that the plain entry carries, over what it can choose."""
    seen = signature_nT(world, [truth]).ravel()
    best = 0.0
    for family in families(world, truth, size):
        columns = np.stack([signature_nT(world, [member]).ravel() for member in family], axis=1)
        rest = seen - columns @ np.linalg.lstsq(columns, seen, rcond=None)[0]
        best = max(best, 1.0 - float(rest @ rest) / float(seen @ seen))
    return best


def families(world: World, truth: Truth, size: float) -> list[list[Truth]]:
    """What the plain entry may choose from; each family is fitted by linear combination."""
    name, p = truth.name, truth.parameters
    switched: dict[str, State] = {
        "solar_array_current": spacecraft.array_current_A,
        "battery_current": spacecraft.battery_current_A,
        "heater_switching": spacecraft.heater_on,
        "switched_field": spacecraft.payload_on,
        "thermal_bias_drift": spacecraft.temperature_degC,
    }
    if name in STOOD_IN and STOOD_IN[name] not in world.recorded:
        return _stood_in(name)
    if name == "switched_field" and p.get("condition") == "region":
        return [[_stray(box, axis) for axis in np.eye(3)] for box in _boxes(p)]
    if name in switched:
        return [[_stray(switched[name], axis) for axis in np.eye(3)]]
    if name == "torquer_coupling":
        return [[_stray(_component(k), axis) for k in range(3) for axis in np.eye(3)]]
    if name == "wheel_field":
        waves: list[State] = [
            lambda w, t: np.cos(spacecraft.wheel_phase_rad(w, t)),
            lambda w, t: np.sin(spacecraft.wheel_phase_rad(w, t)),
        ]
        return [[_stray(wave, axis) for wave in waves for axis in np.eye(3)]]
    if name == "bias_step":
        instant = np.datetime64(p["at"])
        return [[_stray(lambda w, t: (t >= instant).astype(float), axis) for axis in np.eye(3)]]
    if name == "eddy_current":
        return [[_eddy(0.1 * K) for K in _TRACELESS]]
    if name == "cubic_nonlinearity":
        return [[_cubic(axis, k) for axis in range(3) for k in range(10)]]
    if name == "sun_sensor_head_misalignment":
        return [[_turned(p["head"], axis) for axis in np.eye(3)]]
    if name == "horizon_scanner_bias":
        return [[_horizon(k) for k in range(4)]]
    return _one_parameter(world, truth, size)


def _stood_in(name: str) -> list[list[Truth]]:
    """What stands in for a column that is not recorded: sun and shadow, the sun's incidence, a lag behind them."""
    if name == "solar_array_current":
        return [[_stray(state, axis) for axis in np.eye(3)] for state in (_light, _on_zenith)]
    if name == "battery_current":
        return [[_stray(_light, axis) for axis in np.eye(3)]]
    if name == "thermal_bias_drift":
        return [[_stray(_warmth(tau_s), axis) for axis in np.eye(3)] for tau_s in _TAUS_S]
    return [[_scaled(_warmth(tau_s), axis) for axis in np.eye(3)] for tau_s in _TAUS_S]


def _boxes(p: Mapping[str, Any]) -> list[State]:
    """Ranges of latitude and longitude that stand in for a cap: the entry's regions have no other shape."""
    south_north = [p["latitude_deg"] + side * p["radius_deg"] for side in (-1.0, 1.0)]
    width = p["radius_deg"] / max(float(np.cos(np.radians(p["latitude_deg"]))), 0.2)
    return [_box(south_north, p["longitude_deg"], share * width) for share in (0.75, 0.85, 0.95, 1.1)]


def _box(south_north: list[float], longitude_deg: float, half_deg: float) -> State:
    def inside(w: World, t: np.ndarray) -> np.ndarray:
        latitude, longitude = frames.geocentric(frames.rotation_EN(t).apply(w.where(t)[0]))[:2]
        off = np.abs((np.degrees(longitude) - longitude_deg + 180.0) % 360.0 - 180.0)
        degrees = np.degrees(latitude)
        return ((degrees > south_north[0]) & (degrees < south_north[1]) & (off < half_deg)).astype(float)

    return inside


def _light(world: World, time: np.ndarray) -> np.ndarray:
    return world.sun(time)[1]


def _on_zenith(world: World, time: np.ndarray) -> np.ndarray:
    towards, light = world.sun(time)
    sun_B = world.attitude(time).R_BN.apply(towards)
    return np.asarray(np.clip(-sun_B[:, 2], 0.0, None) * light)


def _warmth(tau_s: float) -> State:
    return lambda w, t: spacecraft.temperature_degC(w, t, tau_s)


def _scaled(state: State, axis: np.ndarray) -> Truth:
    def sense(w: World, t: np.ndarray, m: np.ndarray, perfect: Ambient) -> np.ndarray:
        return m * (1.0 + 1e-4 * np.outer(state(w, t), axis))

    return Truth("", "", {}, sense=sense)


def _one_parameter(world: World, truth: Truth, size: float) -> list[list[Truth]]:
    """Entries whose one number, or setting, is tried at several values."""
    name, p = truth.name, truth.parameters
    around = [size * factor for factor in (0.5, 0.7, 0.85, 1.0, 1.15, 1.4)]
    if name == "sensor_lag":
        return [[Truth(name, "sensor", {}, lag_s=value)] for value in around]
    if name == "saturation":
        top = p["level_nT"] + size
        return [[_clip(top - value)] for value in around]
    if name == "ring_current":
        return [[_ring(tau_h)] for tau_h in (np.inf, 30.0, 15.0, 8.0, 5.0)]
    if name == "hysteresis":
        widths = np.array([0.5, 1.0, 2.0, 3.0]) * p["width_nT"]
        return [[_stop(float(width), axis) for axis in range(3)] for width in widths]
    if name == "along_track_error":
        return [[Truth(name, "orbit", {}, place=lambda w, t: of_place.ahead(w, t, p["ahead_km"]))]]
    if name == "time_tag_offset":
        return [[Truth(name, "time", {}, clock=lambda w, t: np.full(t.size, p["offset_s"]))]]
    if name == "field_epoch":
        draft = of_place.field_epoch(world, np.random.default_rng(0))
        return [[draft.at(size)]]
    if name == "yaw_drift":
        return [[_yaw(p["rate_deg_h"])]]
    raise ValueError(f"no plain shape of {name} is written down")


def _stray(state: State, axis: np.ndarray) -> Truth:
    return Truth("", "", {}, stray=lambda w, t, field: np.outer(state(w, t), axis))


def _component(k: int) -> State:
    return lambda w, t: spacecraft.dipole_B_Am2(w, t)[:, k]


def _eddy(K: np.ndarray) -> Truth:
    return Truth("", "", {}, stray=lambda w, t, field: -of_spacecraft.field_rate_nT_s(w, t, field) @ K.T)


def _cubic(axis: int, k: int) -> Truth:
    def sense(w: World, t: np.ndarray, m: np.ndarray, perfect: Ambient) -> np.ndarray:
        return m + 100.0 * np.outer(of_sensor.products(m, 3)[:, k], np.eye(3)[axis])

    return Truth("", "", {}, sense=sense)


def _turned(head: int, axis: np.ndarray) -> Truth:
    turn = np.radians(0.1) * axis
    return Truth("", "", {}, report=lambda w, t, R: of_place.turned_by(spacecraft.head_in_use(w, t) == head, turn, R))


def _horizon(k: int) -> Truth:
    def report(w: World, t: np.ndarray, R: object) -> object:
        lat = of_place.latitude_rad(w, t)
        wave = np.radians(0.1) * (np.sin(lat) if k % 2 == 0 else np.cos(2 * lat))
        none = np.zeros_like(lat)
        return of_place.with_angles(w, t, R, (none, wave, none) if k < 2 else (none, none, wave))  # type: ignore[arg-type]

    return Truth("", "", {}, report=report)  # type: ignore[arg-type]


def _yaw(rate_deg_h: float) -> Truth:
    def report(w: World, t: np.ndarray, R: object) -> object:
        yaw = np.radians(rate_deg_h) * epoch.seconds_since(t, w.start) / 3600.0
        return of_place.with_angles(w, t, R, (yaw, np.zeros_like(yaw), np.zeros_like(yaw)))  # type: ignore[arg-type]

    return Truth("", "", {}, report=report)  # type: ignore[arg-type]


def _ring(tau_h: float) -> Truth:
    def more(w: World, t: np.ndarray, r_N_km: np.ndarray) -> np.ndarray:
        hours = epoch.seconds_since(t, w.start) / 3600.0
        return of_place.ring_field_N_nT(w, t, r_N_km, -100.0 * np.exp(-hours / tau_h))

    return Truth("", "", {}, field=more)


def _clip(level: float) -> Truth:
    return Truth("", "", {}, sense=lambda w, t, m, perfect: np.clip(m, -level, level))


def _stop(width_nT: float, axis: int) -> Truth:
    def sense(w: World, t: np.ndarray, m: np.ndarray, perfect: Ambient) -> np.ndarray:
        seconds, z = of_sensor.stop_state(w, width_nT)
        state = np.interp(epoch.seconds_since(t, w.start), seconds, z[:, axis])
        return m + 50.0 * np.outer(state, np.eye(3)[axis])

    return Truth("", "", {}, sense=sense)


def shares(world: World, truths: Sequence[Truth], sizes: Sequence[float], *, plain: bool = False) -> list[float]:
    """`plain_share` of each; plain: the truths have the plain shape, so only a missing column can make it less than 1."""
    return [
        1.0 if plain and not _narrowed(world, truth) else plain_share(world, truth, size)
        for truth, size in zip(truths, sizes, strict=True)
    ]


def _narrowed(world: World, truth: Truth) -> bool:
    """Whether the entry cannot have just the truth's shape: a column is missing, or its region is no cap."""
    if truth.name == "switched_field":
        return truth.parameters.get("condition") == "region"
    return STOOD_IN.get(truth.name, "") not in {"", *world.recorded}
