"""What the spacecraft does besides turning: torquers, power, heat, wheel, sun-sensor heads, a payload.

Own small models, each a function of time alone. Those with memory run on a grid that begins four orbits before the
first sample that is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.torquers import RandomDuty, draw_random_duty

if TYPE_CHECKING:
    from withheld_cases.worlds import World

_GRID_S = 5.0
_WARM_UP_ORBITS = 4.0


@dataclass(frozen=True)
class Spacecraft:
    """Constants of one spacecraft."""

    torquers: RandomDuty
    torquer_level: RandomDuty
    """Each torquer works at full or at a third of its dipole."""
    payload: RandomDuty
    panels_B: FloatArray | None
    """(K, 3) outward normals of fixed panels; None: one array that follows the sun."""
    full_sun_A: float
    load_A: float
    capacity_Ah: float
    sunlit_degC: float
    eclipse_degC: float
    temperature_tau_s: float
    heater_tau_s: float
    heater_on_below: float
    """Thermostat of a node that runs from 0 (long eclipse) to 1 (long sun); the heater adds `heater_gain`."""
    heater_off_above: float
    heater_gain: float
    wheel_rpm: float
    wheel_swing_rpm: float
    wheel_swing_rad_s: float
    heads_B: FloatArray
    """(K, 3) boresights of the sun-sensor heads, each with a field of view of 64 deg to either side."""
    head_half_angle_rad: float


def draw_spacecraft(rng: np.random.Generator, orbit: Orbit) -> Spacecraft:
    """A spacecraft."""
    faces = np.vstack([np.eye(3), -np.eye(3)])
    panels = None if rng.random() < 0.4 else faces[[int(rng.integers(0, 6))]]
    cold = float(rng.uniform(0.25, 0.5))
    wander = rng.random() < 0.3
    heads = faces[rng.permutation(6)[: int(rng.integers(2, 4))]]
    return Spacecraft(
        torquers=draw_random_duty(
            float(rng.uniform(5.0, 60.0)), float(rng.uniform(0.1, 0.6)), float(rng.uniform(40.0, 400.0)), rng
        ),
        torquer_level=draw_random_duty(1.0, 0.5, float(rng.uniform(60.0, 600.0)), rng, both_signs=False),
        payload=draw_random_duty(
            1.0, float(rng.uniform(0.2, 0.5)), float(rng.uniform(300.0, 1500.0)), rng, both_signs=False
        ),
        panels_B=panels,
        full_sun_A=float(rng.uniform(4.0, 12.0)),
        load_A=float(rng.uniform(1.5, 3.0)),
        capacity_Ah=float(rng.uniform(8.0, 30.0)),
        sunlit_degC=float(rng.uniform(15.0, 45.0)),
        eclipse_degC=float(rng.uniform(-50.0, -5.0)),
        temperature_tau_s=float(rng.uniform(500.0, 2500.0)),
        heater_tau_s=float(rng.uniform(400.0, 900.0)),
        heater_on_below=cold,
        heater_off_above=cold + float(rng.uniform(0.1, 0.25)),
        heater_gain=float(rng.uniform(0.8, 1.4)),
        wheel_rpm=float(rng.uniform(500.0, 4000.0)),
        wheel_swing_rpm=float(rng.uniform(5.0, 60.0)) if wander else 0.0,
        wheel_swing_rad_s=float(2 * np.pi / orbit.nodal_period_s * rng.choice([1.0, 2.0])),
        heads_B=heads,
        head_half_angle_rad=float(np.radians(64.0)),
    )


def dipole_B_Am2(world: World, time: TimeArray) -> FloatArray:
    """(N, 3) torquer dipole."""
    level = 0.35 + 0.65 * world.craft.torquer_level.dipole_B_Am2(time)
    return world.craft.torquers.dipole_B_Am2(time) * level


def payload_on(world: World, time: TimeArray) -> FloatArray:
    """(N,) 1 while the payload works."""
    on: FloatArray = (world.craft.payload.dipole_B_Am2(time)[:, 0] > 0.5).astype(np.float64)
    return on


def incidence(world: World, time: TimeArray) -> FloatArray:
    """(N,) array current over its current in full sun."""
    sun_N, light = world.sun(time)
    if world.craft.panels_B is None:
        return light
    sun_B = world.attitude(time).R_BN.apply(sun_N)
    share: FloatArray = np.clip(sun_B @ world.craft.panels_B.T, 0.0, None).sum(axis=1) * light
    return share


def array_current_A(world: World, time: TimeArray) -> FloatArray:
    """(N,) current of the solar array."""
    return world.craft.full_sun_A * incidence(world, time)


def battery_current_A(world: World, time: TimeArray) -> FloatArray:
    """(N,) battery current, positive when charging: what the load leaves, less and less as the battery fills."""
    seconds, charge = _charge(world)
    level = np.interp(_since(world, time), seconds, charge)
    craft = world.craft
    return _accepted(level, array_current_A(world, time) - craft.load_A, craft.capacity_Ah)


@lru_cache(maxsize=8)
def _charge(world: World) -> tuple[FloatArray, FloatArray]:
    """State of charge on the grid."""
    grid, seconds = _grid(world)
    craft = world.craft
    surplus = (array_current_A(world, grid) - craft.load_A).tolist()
    steps = np.diff(seconds).tolist()
    charge = [0.85]
    for step, amperes in zip(steps, surplus[:-1], strict=True):
        # `_accepted`, of numbers: of arrays without a dimension it takes ten times as long
        limit = 0.4 * craft.capacity_Ah * min(max((1.0 - charge[-1]) / 0.2, 0.0), 1.0)
        flow = amperes if amperes <= 0.0 else min(amperes, limit)
        charge.append(min(max(charge[-1] + flow * step / 3600.0 / craft.capacity_Ah, 0.05), 1.0))
    return seconds, np.array(charge)


def _accepted(charge: FloatArray, surplus_A: FloatArray, capacity_Ah: float) -> FloatArray:
    """At most 0.4 C; above 80 % charge a limit that falls to zero at full charge."""
    limit = 0.4 * capacity_Ah * np.clip((1.0 - charge) / 0.2, 0.0, 1.0)
    return np.where(surplus_A <= 0.0, surplus_A, np.minimum(surplus_A, limit))


def temperature_degC(
    world: World, time: TimeArray, tau_s: float | None = None, cooling_tau_s: float | None = None
) -> FloatArray:
    """(N,) temperature of the magnetometer: a first-order lag behind sun and shadow."""
    seconds, values = _temperature(world, world.craft.temperature_tau_s if tau_s is None else tau_s, cooling_tau_s)
    return np.interp(_since(world, time), seconds, values)


@lru_cache(maxsize=16)
def _temperature(world: World, tau_s: float, cooling_tau_s: float | None) -> tuple[FloatArray, FloatArray]:
    grid, seconds = _grid(world)
    _, light = world.sun(grid)
    craft = world.craft
    goal = craft.eclipse_degC + (craft.sunlit_degC - craft.eclipse_degC) * light
    return seconds, lagged(seconds, goal, tau_s, cooling_tau_s)


def lagged(seconds: FloatArray, goal: FloatArray, tau_s: float, cooling_tau_s: float | None = None) -> FloatArray:
    """First-order lag behind `goal` (held from node to node), from its mean; downwards with a tau of its own."""
    state = [float(goal.mean())]
    keep, cooled = (
        np.exp(-np.diff(seconds) / tau).tolist() for tau in (tau_s, tau_s if cooling_tau_s is None else cooling_tau_s)
    )
    for a, b, g in zip(keep, cooled, goal[:-1].tolist(), strict=True):
        state.append(g + (state[-1] - g) * (a if g > state[-1] else b))
    return np.array(state)


def heater_on(world: World, time: TimeArray) -> FloatArray:
    """(N,) 1 while the heater is on."""
    seconds, states = _heater(world)
    held = np.searchsorted(seconds, _since(world, time), side="right") - 1
    return states[held]


@lru_cache(maxsize=8)
def _heater(world: World) -> tuple[FloatArray, FloatArray]:
    """Heater state on the grid; the node is heated by the sun and by the heater."""
    grid, seconds = _grid(world)
    _, light = world.sun(grid)
    craft, node, on = world.craft, 0.5, False
    states = [False]
    for step, sunlight in zip(np.diff(seconds).tolist(), light[:-1].tolist(), strict=True):
        goal = 0.2 + 0.6 * sunlight + (craft.heater_gain if on else 0.0) - 0.3
        node = goal + (node - goal) * float(np.exp(-step / craft.heater_tau_s))
        on = node < craft.heater_off_above if on else node < craft.heater_on_below
        states.append(on)
    return seconds, np.array(states, dtype=np.float64)


def wheel_speed_rpm(world: World, time: TimeArray) -> FloatArray:
    """(N,) speed of the wheel."""
    t, craft = epoch.seconds_since(time, epoch.MJD2000), world.craft
    speed: FloatArray = craft.wheel_rpm + craft.wheel_swing_rpm * np.sin(craft.wheel_swing_rad_s * t)
    return speed


def wheel_phase_rad(world: World, time: TimeArray) -> FloatArray:
    """(N,) angle of the wheel: the exact integral of its speed."""
    t, craft = epoch.seconds_since(time, world.start), world.craft
    t0 = float(epoch.seconds_since(world.start, epoch.MJD2000)[0])
    rate = 2 * np.pi / 60.0
    phase: FloatArray = rate * craft.wheel_rpm * t
    if craft.wheel_swing_rpm:
        w = craft.wheel_swing_rad_s
        phase = phase - rate * craft.wheel_swing_rpm / w * (np.cos(w * (t0 + t)) - np.cos(w * t0))
    return phase


def head_in_use(world: World, time: TimeArray, half_angle_rad: float | None = None) -> FloatArray:
    """(N,) number (from 1) of the head that sees the sun nearest to its boresight, 0 where none sees it."""
    sun_N, light = world.sun(time)
    sun_B = world.attitude(time).R_BN.apply(sun_N)
    cosine = sun_B @ world.craft.heads_B.T
    best = np.argmax(cosine, axis=1)
    limit = np.cos(world.craft.head_half_angle_rad if half_angle_rad is None else half_angle_rad)
    seen = (cosine.max(axis=1) > limit) & (light > 0.5)
    return np.where(seen, best + 1.0, 0.0)


def _since(world: World, time: TimeArray) -> FloatArray:
    return epoch.seconds_since(time, world.start)


@lru_cache(maxsize=8)
def _grid(world: World) -> tuple[TimeArray, FloatArray]:
    """Stamps of the grid and their seconds from the first sample; fixed by the world, not by what is asked for."""
    before = _WARM_UP_ORBITS * world.orbit.nodal_period_s
    seconds = np.arange(-before, world.span_s + 300.0, _GRID_S if world.span_s < 60000.0 else 2 * _GRID_S)
    return epoch.add_seconds(world.start, seconds), seconds
