"""Forward models of the spacecraft stage: stray fields at the sensor, in body axes."""

from __future__ import annotations

import dataclasses

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from withheld_cases import spacecraft
from withheld_cases.chain import Ambient, Truth
from withheld_cases.draft import Draft, changes, direction, followed, listed, recording, share
from withheld_cases.worlds import World, between, shift

_STRAIGHT_DEGC = 10.0


def torquer_coupling(world: World, rng: np.random.Generator) -> Draft | None:
    """Field C m at the sensor."""
    world = recording(world, "dipole_B_Am2")
    dipole = spacecraft.dipole_B_Am2(world, world.time)
    if min(share(dipole[:, k]) for k in range(3)) < 0.03:
        return None
    shape = direction(rng, 9).reshape(3, 3)

    def at(size: float) -> Truth:
        return Truth(
            "torquer_coupling",
            "spacecraft",
            {"coupling_nT_per_Am2": listed(size * shape)},
            stray=lambda w, t, field: spacecraft.dipole_B_Am2(w, t) @ (size * shape).T,
        )

    return Draft(world, at, 0.01, 300.0, 2.0)


def solar_array_current(world: World, rng: np.random.Generator) -> Draft | None:
    """Field in proportion to the array current."""
    axis = direction(rng)
    if not 0.15 < share(spacecraft.array_current_A(world, world.time)) < 0.97:
        return None

    def at(size: float) -> Truth:
        return Truth(
            "solar_array_current",
            "spacecraft",
            {"k_nT_per_A": listed(size * axis)},
            stray=lambda w, t, field: np.outer(spacecraft.array_current_A(w, t), size * axis),
        )

    return Draft(world, at, 0.2, 1000.0, 20.0)


def battery_current(world: World, rng: np.random.Generator) -> Draft | None:
    """Field in proportion to the battery current, positive when charging."""
    axis = direction(rng)
    amperes = spacecraft.battery_current_A(world, world.time)
    if not 0.1 < float(np.mean(amperes < 0)) < 0.9:
        return None

    def at(size: float) -> Truth:
        return Truth(
            "battery_current",
            "spacecraft",
            {"k_nT_per_A": listed(size * axis)},
            stray=lambda w, t, field: np.outer(spacecraft.battery_current_A(w, t), size * axis),
        )

    return Draft(world, at, 0.2, 1000.0, 20.0)


def heater_switching(world: World, rng: np.random.Generator) -> Draft | None:
    """A constant field while the heater is on."""
    axis = direction(rng)
    on = spacecraft.heater_on(world, world.time)
    if not 0.08 < share(on) < 0.92 or changes(on) < 4:
        return None

    def at(size: float) -> Truth:
        return Truth(
            "heater_switching",
            "spacecraft",
            {"field_nT": listed(size * axis), "switches": changes(on)},
            stray=lambda w, t, field: np.outer(spacecraft.heater_on(w, t), size * axis),
        )

    return Draft(world, at, 2.0, 5000.0, 100.0)


def steady_wheel(world: World) -> World:
    """The world with a wheel at a constant speed where its column could not tell its angle."""
    craft = world.craft
    ripple = world.step_s**2 / 12.0 * 2 * np.pi / 60.0 * craft.wheel_swing_rpm * craft.wheel_swing_rad_s
    if "wheel_speed_rpm" in world.recorded and ripple < 0.05:
        return world
    return dataclasses.replace(world, craft=dataclasses.replace(craft, wheel_swing_rpm=0.0))


def wheel_field(world: World, rng: np.random.Generator) -> Draft:
    """A dipole that turns with the wheel; the sampling folds it."""
    world = steady_wheel(world)
    cosine, sine = direction(rng), direction(rng)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            phase = spacecraft.wheel_phase_rad(w, time)
            return size * (np.outer(np.cos(phase), cosine) + np.outer(np.sin(phase), sine))

        parameters = {
            "cos_nT": listed(size * cosine),
            "sin_nT": listed(size * sine),
            "speed_rpm": world.craft.wheel_rpm,
            "swing_rpm": world.craft.wheel_swing_rpm,
            "step_s": world.step_s,
        }
        return Truth("wheel_field", "spacecraft", parameters, stray=stray)

    return Draft(world, at, 1.0, 2000.0, 80.0)


def field_rate_nT_s(world: World, time: TimeArray, field: Ambient) -> FloatArray:
    """Time derivative of the field in body axes, central difference over a thousandth of a turn."""
    h = min(0.5, world.turn_period_s() / 1000.0)
    rate: FloatArray = (field(shift(time, h)) - field(shift(time, -h))) / (2.0 * h)
    return rate


def traceless(rng: np.random.Generator) -> FloatArray:
    """A random symmetric matrix without trace, rms 1 per element."""
    m = rng.standard_normal((3, 3))
    m = m + m.T
    m -= np.trace(m) / 3.0 * np.eye(3)
    scaled: FloatArray = m / np.sqrt(np.mean(m**2))
    return scaled


def eddy_current(world: World, rng: np.random.Generator) -> Draft:
    """Field -K dB/dt of currents that the changing field induces."""
    shape = traceless(rng)

    def at(size: float) -> Truth:
        return Truth(
            "eddy_current",
            "spacecraft",
            {"K_s": listed(size * shape)},
            stray=lambda w, t, field: -field_rate_nT_s(w, t, field) @ (size * shape).T,
        )

    # No currents in a structure of a metre last longer: mu0 sigma r d / 2 is 0.2 s for 1 cm of aluminium.
    most = min(1.0, world.turn_period_s() / 20.0)
    return Draft(followed(world), at, 1e-5, most, 0.1 * most)


def condition(world: World, rng: np.random.Generator) -> tuple[dict[str, object], object] | None:
    """When the unit is on: a flag, an interval of the clock, the night or a region; and a function of world and time."""
    kind = str(rng.choice(["flag", "clock", "night", "region"]))
    if kind == "flag":
        return {"condition": "flag:payload"}, spacecraft.payload_on
    if kind == "night":
        return {"condition": "eclipse"}, lambda w, t: (w.sun(t)[1] <= 0.5).astype(np.float64)
    if kind == "clock":
        first, part = float(rng.uniform(0.15, 0.6)), float(rng.uniform(0.15, 0.3))
        begin = shift(world.time[:1], first * world.span_s)[0]
        end = shift(world.time[:1], (first + part) * world.span_s)[0]
        text: dict[str, object] = {"condition": "clock", "from": str(begin), "to": str(end)}
        return text, lambda w, t: ((t >= begin) & (t < end)).astype(np.float64)
    lat, lon = float(np.degrees(np.arcsin(rng.uniform(-0.9, 0.9)))), float(rng.uniform(-180, 180))
    reach = float(rng.uniform(20.0, 40.0))
    station = frames.from_geocentric(np.radians([lat]), np.radians([lon]), np.ones(1))[0]

    def near(w: World, t: TimeArray) -> FloatArray:
        return within(w, t, station, np.radians(reach))

    return {"condition": "region", "latitude_deg": lat, "longitude_deg": lon, "radius_deg": reach}, near


def within(world: World, time: TimeArray, station_E: FloatArray, radius_rad: float) -> FloatArray:
    """(N,) 1 where the spacecraft is over the cap around a station."""
    r_E_km = frames.rotation_EN(time).apply(world.where(time)[0])
    cosine = r_E_km @ station_E / np.linalg.norm(r_E_km, axis=1)
    return np.asarray((cosine > np.cos(radius_rad)).astype(np.float64))


def switched_field(world: World, rng: np.random.Generator) -> Draft | None:
    """A constant field while a condition holds."""
    drawn = condition(world, rng)
    if drawn is None:
        return None
    words, state = drawn
    if words["condition"] == "flag:payload":
        world = recording(world, "flag_payload")
    on = state(world, world.time)  # type: ignore[operator]
    visits = 2 if words["condition"] == "clock" else 4
    if not 0.02 < share(on) < 0.9 or changes(on) < visits:
        return None
    axis = direction(rng)

    def at(size: float) -> Truth:
        return Truth(
            "switched_field",
            "spacecraft",
            {**words, "field_nT": listed(size * axis), "share": share(on)},
            stray=lambda w, t, field: np.outer(state(w, t), size * axis),  # type: ignore[operator]
        )

    return Draft(world, at, 2.0, 5000.0, 100.0)


def boom_bending(world: World, rng: np.random.Generator) -> Draft | None:
    """The boom bends with the temperature: the sensor at its tip turns, and sees the field turned the other way."""
    if not 0.15 < share(world.sun(world.time)[1] > 0.5) < 0.93:
        return None
    axis = direction(rng)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            warmer = spacecraft.temperature_degC(w, time) - _STRAIGHT_DEGC
            angle = np.radians(warmer * size * np.linalg.norm(axis))[:, None]
            n, straight = axis / np.linalg.norm(axis), field(time)
            along = np.outer(straight @ n, n)  # Rodrigues' formula for the turn by minus the angle
            return (np.cos(angle) - 1.0) * (straight - along) - np.sin(angle) * np.cross(n, straight)

        parameters = {"turn_deg_per_K": listed(size * axis), "tau_s": world.craft.temperature_tau_s}
        return Truth("boom_bending", "spacecraft", parameters, stray=stray, turns_sensor=True)

    return Draft(world, at, 2e-5, 1.0, 5e-3)


def seconds_on(world: World, time: TimeArray, state: object, longest_s: float = 6000.0) -> FloatArray:
    """(N,) seconds since a two-state function of world and time went on, 0 while it is off."""
    grid = np.arange(-longest_s, world.span_s + 300.0, 5.0)
    on = state(world, epoch.add_seconds(world.start, grid)) > 0.5  # type: ignore[operator]
    last_off = np.maximum.accumulate(np.where(on, -np.inf, grid))
    since = np.where(np.isfinite(last_off), grid - last_off, grid - grid[0])
    now = epoch.seconds_since(time, world.start)
    active = state(world, time) > 0.5  # type: ignore[operator]
    return np.where(active, np.maximum(np.interp(now, grid, since), 0.0), 0.0)


def settle_time_s(rng: np.random.Generator) -> float:
    """A few minutes."""
    return between(rng, 60.0, 300.0)
