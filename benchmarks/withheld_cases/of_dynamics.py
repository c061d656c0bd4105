"""Truths that turn the body, alone and beside one of the sensors, in flights of the benchmark's own integrator.

The ground has a scenario of the vehicle: inertia, wheels, torquers, gravity gradient. What it lacks is the truth.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry
from withheld_cases import chain, of_place, of_sensor, of_spacecraft
from withheld_cases.chain import Truth
from withheld_cases.draft import Maker, sign
from withheld_cases.flight import (
    PUSH_N_M2,
    Body,
    Flown,
    Instant,
    Surroundings,
    Torque,
    cross,
    fly,
    gravity_gradient,
    magnetic,
)
from withheld_cases.store import Store
from withheld_cases.torque_visible import LEAST_CHI_SQUARE, Ground, seen
from withheld_cases.visible import scaled, visible
from withheld_cases.worlds import World, between, draw_world, shift

POPULATIONS = ("torque_nulls", "torques", "torque_pairs")
REGIMES = ("bias", "wheels", "tumble", "spin")
BEFORE_S = 120.0
_TRIES = 6
_STEPS, _CLOSE_ENOUGH = 5, 0.25
_SAME_COURSE = 0.3
"""Of the size's logarithm: within it the body moves so alike that what another start does is not worked out again."""
STRENGTH = (0.7, 5.0)
PARTNERS: tuple[Maker, ...] = (
    of_place.time_tag_offset,
    of_place.field_epoch,
    of_place.ring_current,
    of_sensor.quadratic_nonlinearity,
    of_sensor.bias_step,
    of_spacecraft.solar_array_current,
)


@dataclass(frozen=True, eq=False)
class Turned:
    """A truth on the dynamics: torque, or another tensor, for a size of 1."""

    name: str
    parameters: Callable[[float], dict[str, Any]]
    torque: Callable[[float], Torque] | None
    change: FloatArray | None
    """(3, 3) kg m2 of inertia for a size of 1."""
    start: float
    most: float = np.inf
    """The largest size that would not have been noticed on the ground."""


@dataclass(frozen=True, eq=False)
class Sized:
    """A truth at its size, and the flight with it."""

    size: float
    visible: float
    chi_square: float
    flown: Flown


def truth(name: str, rng: np.random.Generator, inertia: FloatArray) -> Turned:
    """One truth with everything drawn but its size."""
    vector = rng.standard_normal(3)
    vector /= np.linalg.norm(vector)
    words = {
        "residual_dipole_torque": "dipole_Am2",
        "aerodynamic_torque": "moment_m3",
        "solar_pressure_torque": "moment_m3",
        "torquer_gain_error": "gain",
    }
    if name == "gravity_gradient_inertia_error":
        mixed = rng.standard_normal((3, 3))
        change = 0.5 * (mixed + mixed.T) * np.trace(inertia) / 3.0
        return Turned(name, lambda s: {"inertia_kg_m2": (s * change).tolist()}, None, change, 0.02, 0.1)
    if name == "eddy_torque":
        K = rng.uniform(0.5, 1.5, 3)

        def brake(size: float) -> Torque:
            return lambda now: cross(size * K * cross(now["rate"], now["field"]), now["field"])

        return Turned(name, lambda s: {"K_Am2_s_per_T": (s * K).tolist()}, brake, None, 1000.0)

    def torque(size: float) -> Torque:
        return lambda now: _of(name, size * vector, now)

    begin = {"residual_dipole_torque": 0.2, "aerodynamic_torque": 1.0, "solar_pressure_torque": 1.0}.get(name, 0.1)
    most = 0.5 if name == "torquer_gain_error" else np.inf
    return Turned(name, lambda s: {words[name]: (s * vector).tolist()}, torque, None, begin, most)


def _of(name: str, vector: FloatArray, now: Instant) -> FloatArray:
    if name == "residual_dipole_torque":
        return cross(vector, now["field"])
    if name == "torquer_gain_error":
        return cross(vector * now["dipole"], now["field"])
    if name == "aerodynamic_torque":
        pressure = -0.5 * float(now["density"]) * np.linalg.norm(now["v"])
        return np.asarray(pressure * cross(vector, now["v"]))
    return np.asarray(-PUSH_N_M2 * float(now["light"]) * cross(vector, now["sun"]))


WHERE = {
    "residual_dipole_torque": REGIMES,
    "torquer_gain_error": ("bias", "wheels", "tumble"),
    "eddy_torque": ("spin",),
    "aerodynamic_torque": ("bias", "wheels"),
    "solar_pressure_torque": ("bias", "wheels"),
    "gravity_gradient_inertia_error": ("bias", "wheels", "tumble"),
}
"""Regimes in which a truth can be distinguished from the free start of a window."""


@dataclass(frozen=True, eq=False)
class Craft:
    """A vehicle and its plan, without any truth."""

    regime: str
    body: Body
    orbit: Orbit
    q: FloatArray
    rate: FloatArray
    step_s: float
    rows: int

    def text(self, world: World) -> str:
        """The scenario that the ground has."""
        J = self.body.inertia.tolist()
        lines = [
            'name = "ground"',
            "seed = 1",
            "[spacecraft]",
            'name = "withheld"',
            f"inertia_kg_m2 = {J}",
            "[orbit]",
            f'epoch_utc = "{epoch.iso(self.orbit.epoch_utc)}"',
            f"altitude_km = {self.orbit.altitude_km!r}",
            f"inclination_deg = {float(np.degrees(self.orbit.inclination_rad))!r}",
            f"raan_deg = {float(np.degrees(self.orbit.raan_rad))!r}",
            f"argument_of_latitude_deg = {float(np.degrees(self.orbit.argument_of_latitude_rad))!r}",
            "[attitude]",
            'mode = "dynamics"',
            "[torques.gravity_gradient]",
            "[torquers]",
            "dipole_Am2 = 10.0",
            "positions_m = [[0.0, 0.0, 9.0], [0.0, 0.0, 9.0], [0.0, 0.0, 9.0]]",
            "[schedule]",
            f'segments = [{{ start_utc = "{epoch.iso(world.start)}", samples = {self.rows}, step_s = {self.step_s} }}]',
        ]
        if len(self.body.axes):
            speeds = self.body.speed_rad_s(0.0) * 30.0 / np.pi
            lines += [
                "[wheels]",
                f"axes_B = {self.body.axes.tolist()}",
                f"inertia_kg_m2 = {self.body.wheel_inertia!r}",
                f"bias_rpm = {speeds.tolist()}",
            ]
        return "\n".join(lines) + "\n"


def draw_craft(rng: np.random.Generator, regime: str, *, low: bool) -> Craft:
    """Vehicle, orbit and plan. low: where there is air."""
    day = np.datetime64("2010-01-01", "s") + int(rng.integers(0, 8 * 365 * 86400)) * np.timedelta64(1, "s")
    orbit = Orbit(
        epoch_utc=day.astype("datetime64[ns]"),
        altitude_km=float(rng.uniform(380, 450) if low else rng.uniform(500, 800)),
        inclination_rad=float(np.radians(rng.uniform(50, 98))),
        raan_rad=float(rng.uniform(0, 6.28)),
        argument_of_latitude_rad=float(rng.uniform(0, 6.28)),
    )
    scale = {"bias": 25.0, "wheels": 60.0, "tumble": 2.0, "spin": 2.0}[regime]
    shape = {"bias": [1.2, 1.25, 0.8], "wheels": [1.1, 1.2, 0.8], "tumble": [1.0, 1.3, 0.8], "spin": [1.0, 1.1, 1.5]}
    J = scale * np.diag(shape[regime])
    axes = {"bias": np.array([[0.0, -1.0, 0.0]]), "wheels": np.eye(3)}.get(regime, np.zeros((0, 3)))
    size = {"bias": 0.012, "wheels": 0.01}.get(regime, 0.01)
    middle = {"bias": np.array([between(rng, 150.0, 300.0)]), "wheels": rng.uniform(-50.0, 50.0, 3)}.get(
        regime, np.zeros(0)
    )
    swing = {"bias": np.zeros(1), "wheels": rng.uniform(-5.0, 5.0, 3)}.get(regime, np.zeros(0))
    slow, phase = 2.0 * np.pi / rng.uniform(600.0, 2000.0), rng.uniform(0.0, 6.28, len(axes))
    rows = int(rng.integers(900, 1500)) * (2 if regime == "spin" else 1)  # at 2 s: two windows would be all
    step = {"spin": 2.0, "tumble": 5.0}.get(regime, 10.0)
    length = rows * step + 2 * BEFORE_S
    switches = np.arange(-2 * BEFORE_S, length, 10.0 * np.ceil(rng.uniform(200.0, 600.0) / 10.0))
    most = {"bias": 1.0, "wheels": 5.0, "tumble": 0.3, "spin": 0.0}[regime]
    dipoles = most * rng.choice([-1.0, 0.0, 1.0], (switches.size, 3))
    body = Body(
        J,
        axes,
        size,
        lambda t: middle + swing * np.sin(slow * t + phase),
        lambda t: swing * slow * np.cos(slow * t + phase),
        switches,
        dipoles,
    )
    q, rate = _start(rng, regime, orbit)
    return Craft(regime, body, orbit, q, rate, step, rows)


def _start(rng: np.random.Generator, regime: str, orbit: Orbit) -> tuple[FloatArray, FloatArray]:
    r, v = orbit.propagate(np.array([orbit.epoch_utc]))
    lean = frames.rotation_BO(*(np.radians(rng.uniform(-2.0, 2.0, (1,))) for _ in range(3)))
    q = frames.q_from_rotation(lean * frames.rotation_ON(r, v))[0]
    if regime in ("bias", "wheels"):
        return q, np.array([0.0, -2.0 * np.pi / orbit.nodal_period_s, 0.0])
    if regime == "tumble":
        return q, np.radians(rng.uniform(-0.8, 0.8, 3))
    return q, np.array([*np.radians(rng.uniform(-0.5, 0.5, 2)), between(rng, 0.1, 0.5)])


def make(root: str, seed: int, population: str, number: int) -> str:
    """Write the files of one case, as `make.make` does."""
    store = Store(Path(root))
    name = hashlib.sha256(f"{seed}/{population}/{number}".encode()).hexdigest()[:12]
    if store.has("sealed", name):
        return name
    rng = np.random.default_rng([seed, int(hashlib.sha256(population.encode()).hexdigest()[:8], 16), number])
    turned = None if population == "torque_nulls" else list(WHERE)[number % len(WHERE)]
    regimes = REGIMES if turned is None else WHERE[turned]
    regime = regimes[(number // (1 if turned is None else len(WHERE))) % len(regimes)]
    tries, drawn = 0, None
    while drawn is None and tries < _TRIES:
        tries, drawn = tries + 1, _drawn(rng, regime, turned)
    if drawn is None:
        why = f"{population} {number} ({turned}, {regime}): no vehicle shows it at the wanted size"
        store.write("sealed", name, {"case": name, "population": population, "number": number, "void": why})
        return name
    craft, world, truths = drawn
    partner = _partner(world, rng) if population == "torque_pairs" else None
    if partner is not None:
        world, other, strength = partner
        truths.append(
            {
                "name": other.name,
                "stage": other.stage,
                "parameters": dict(other.parameters),
                "signal": True,
                "target": strength,
                "visible": strength,
                "size": 1.0,
            }
        )
    _write(store, name, craft, world, [] if partner is None else [partner[1]])
    store.write(
        "sealed",
        name,
        {
            "case": name,
            "population": population,
            "number": number,
            "regime": regime,
            "truths": truths,
            "label": turned or "",
            "plain_share": 1.0,
            "second": None,
            "declared_sigma_factor": 1.0,
            "attitude_sigma_deg": float(np.degrees(world.budget.attitude_sigma_rad)),
            "rows": craft.rows,
            "step_s": craft.step_s,
            "span_s": world.span_s,
            "bursts": False,
            "attitude_tau_s": world.budget.attitude_tau_s,
            "altitude_km": craft.orbit.altitude_km,
            "start": str(world.start),
            "recorded": sorted(world.recorded),
            "real_model": world.real_model.name,
            "sensors_deg": None,
            "tries": tries,
        },
    )
    return name


def _drawn(
    rng: np.random.Generator, regime: str, turned: str | None
) -> tuple[Craft, World, list[dict[str, Any]]] | None:
    """A vehicle, its flight with the truth in it, and what is sealed of that."""
    craft = draw_craft(rng, regime, low=turned == "aerodynamic_torque")
    base = dataclasses.replace(
        draw_world(rng, "nadir"), orbit=craft.orbit, real_model=load_field("igrf14"), sensors=None
    )
    time = shift(np.full(craft.rows, craft.orbit.epoch_utc), BEFORE_S + craft.step_s * np.arange(craft.rows))
    world = dataclasses.replace(
        base,
        time=time,
        missing=np.zeros(craft.rows, dtype=bool),
        regime=regime,
        recorded=base.recorded - {"rate_B_rad_s", "wheel_speed_rpm"},
    )
    around = Surroundings(
        craft.orbit, world.real_model, craft.orbit.epoch_utc, craft.rows * craft.step_s + 2 * BEFORE_S
    )
    if turned is None:
        return craft, dataclasses.replace(world, motion=_motion(_flight(craft, around, None, 0.0), craft)), []
    chosen, target = truth(turned, rng, craft.body.inertia), between(rng, *STRENGTH)
    sized = _sized(craft, around, chosen, target, world)
    if sized is None:
        return None
    sealed = {
        "name": turned,
        "stage": "dynamics",
        "parameters": chosen.parameters(sized.size),
        "signal": True,
        "target": target,
        "visible": sized.visible,
        "size": sized.size,
        "chi_square": sized.chi_square,
    }
    return craft, dataclasses.replace(world, motion=_motion(sized.flown, craft)), [sealed]


def _flight(craft: Craft, around: Surroundings, chosen: Turned | None, size: float) -> Flown:
    body, torques = _with(craft.body, chosen, size)
    return fly(body, around, torques, craft.q, craft.rate, 0.0, craft.rows * craft.step_s + 2 * BEFORE_S)


def _with(body: Body, chosen: Turned | None, size: float) -> tuple[Body, list[Torque]]:
    torques: list[Torque] = [gravity_gradient, magnetic]
    if chosen is not None and chosen.torque is not None:
        torques.append(chosen.torque(size))
    if chosen is not None and chosen.change is not None:
        body = dataclasses.replace(body, inertia=body.inertia + size * chosen.change)
    return body, torques


def _sized(craft: Craft, around: Surroundings, chosen: Turned, target: float, world: World) -> Sized | None:
    """The size at which the truth is so visible, by steps of a rule of three; more where the attitude's errors would
    hide that. None where it would have to be larger than anybody would believe, or the steps do not settle."""
    sigma, tau_s = world.budget.attitude_sigma_rad, world.budget.attitude_tau_s
    ground = Ground(*_with(craft.body, None, 0.0), around)
    size, found, of_size = chosen.start, None, 0.0
    for _ in range(_STEPS):
        flown = _flight(craft, around, chosen, size)
        near = of_size > 0.0 and abs(np.log(size / of_size)) < _SAME_COURSE
        found, of_size = (
            seen(flown, ground, craft.rows * craft.step_s, found if near else None),
            of_size if near else size,
        )
        visible, chi_square = found.visible(sigma), found.chi_square(sigma, tau_s)
        factor = max(target / visible, float(np.sqrt(LEAST_CHI_SQUARE / chi_square)))
        if abs(np.log(factor)) < _CLOSE_ENOUGH:
            return Sized(size, visible, chi_square, flown)
        size *= factor
        if size > chosen.most:
            return None
    return None


def _motion(flown: Flown, craft: Craft) -> Callable[..., attitude.Attitude]:
    def motion(time: Any, r: FloatArray, v: FloatArray) -> attitude.Attitude:
        R, rate = flown.attitude(epoch.seconds_since(time, craft.orbit.epoch_utc))
        return attitude.Attitude(R, rate)

    return motion


def _partner(world: World, rng: np.random.Generator) -> tuple[World, Truth, float] | None:
    """A truth of the sensors at a visible size."""
    for place in rng.permutation(len(PARTNERS)):
        draft = PARTNERS[place](world, rng)
        if draft is None:
            continue
        found = scaled(
            lambda s, d=draft: visible(d.world, [d.at(s)]), between(rng, 0.7, 3.0), draft.low, draft.high, draft.start
        )
        if found is not None:
            return draft.world, draft.at(found[0]), found[1]
    return None


def _write(store: Store, name: str, craft: Craft, world: World, truths: list[Truth]) -> None:
    seconds = epoch.seconds_since(world.time, craft.orbit.epoch_utc)
    speed = np.array([craft.body.speed_rad_s(t) for t in seconds]).reshape(craft.rows, -1) * 30.0 / np.pi
    telemetry = chain.fly(world, truths).replace(
        dipole_B_Am2=craft.body.dipole(seconds), wheel_speed_rpm=speed if speed.shape[1] else None
    )
    write_telemetry(telemetry, store.path("telemetry", name))
    budget = world.budget
    store.write(
        "asked",
        name,
        {
            "case": name,
            "noise_nT": budget.noise_nT,
            "lsb_nT": budget.lsb_nT,
            "attitude_sigma_deg": float(np.degrees(budget.attitude_sigma_rad)),
            "modelled": list(world.modelled),
            "degree": world.degree,
            "scenario": craft.text(world),
        },
    )


__all__ = ["POPULATIONS", "make", "sign"]
