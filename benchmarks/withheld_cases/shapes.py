"""Effects of the table in another shape than the table gives them: reality seldom reads the catalogue.

Each keeps the name of its cause. The size is the same as that of the plain model.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import field_N_nT
from withheld_cases import of_place, of_sensor, of_spacecraft, spacecraft
from withheld_cases.chain import Ambient, Truth, ambient
from withheld_cases.draft import Draft, direction, followed, listed, recording, share, sign
from withheld_cases.worlds import World, shift


def torquer_saturates(world: World, rng: np.random.Generator) -> Draft | None:
    """The core saturates: the field grows as tanh of the commanded dipole, which takes many values here."""
    plain = of_spacecraft.torquer_coupling(world, rng)
    if plain is None:
        return None
    full = max(world.craft.torquers.amplitude_Am2)
    shape = direction(rng, 9).reshape(3, 3)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            dipole = spacecraft.dipole_B_Am2(w, time)
            real = 0.6 * full * np.tanh(dipole / (0.6 * full))
            real += 0.25 * real * (dipole > 0)  # one way stronger than the other: a remanence that adds
            return real @ (size * shape).T

        return Truth("torquer_coupling", "spacecraft", {"coupling_nT_per_Am2": listed(size * shape)}, stray=stray)

    return Draft(plain.world, at, 0.01, 300.0, 2.0)


def array_current_power(world: World, rng: np.random.Generator) -> Draft | None:
    """The field grows as the array current to the power 1.3."""
    world = recording(world, "array_current_A")
    craft = dataclasses.replace(world.craft, panels_B=np.eye(3)[[int(rng.integers(0, 3))]])
    world = dataclasses.replace(world, craft=craft)
    if of_spacecraft.solar_array_current(world, rng) is None:
        return None
    axis, full = direction(rng), world.craft.full_sun_A

    def at(size: float) -> Truth:
        return Truth(
            "solar_array_current",
            "spacecraft",
            {"k_nT_per_A": listed(size * axis), "power": 1.3},
            stray=lambda w, t, field: np.outer(full * (spacecraft.array_current_A(w, t) / full) ** 1.3, size * axis),
        )

    return Draft(world, at, 0.2, 1000.0, 20.0)


def battery_two_paths(world: World, rng: np.random.Generator) -> Draft | None:
    """Charge and discharge run through other cables: the constant differs by 40 % in size and a little in direction."""
    world = recording(world, "battery_current_A")
    if of_spacecraft.battery_current(world, rng) is None:
        return None
    axis = direction(rng)
    other = 1.4 * axis + 0.2 * direction(rng)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            amperes = spacecraft.battery_current_A(w, time)
            return size * (np.outer(np.maximum(amperes, 0), axis) + np.outer(np.minimum(amperes, 0), other))

        return Truth("battery_current", "spacecraft", {"k_nT_per_A": listed(size * axis)}, stray=stray)

    return Draft(world, at, 0.2, 1000.0, 20.0)


def thermal_other_node(world: World, rng: np.random.Generator) -> Draft | None:
    """The electronics follow with another time constant than the thermometer (0.7 of it)."""
    world = recording(world, "temperature_degC")
    if of_sensor.thermal_bias_drift(world, rng) is None:
        return None
    slope, tau = direction(rng), 0.7 * world.craft.temperature_tau_s

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            warmer = spacecraft.temperature_degC(w, time, tau)
            return np.zeros((time.size, 3, 3)), np.outer(warmer, size * slope)

        parameters = {"slope_nT_per_K": listed(size * slope), "tau_s": tau}
        return Truth("thermal_bias_drift", "sensor", parameters, correction=correction)

    return Draft(world, at, 0.05, 300.0, 5.0)


def storm_wanders(world: World, rng: np.random.Generator) -> Draft:
    """A storm recovers within hours, and wanders by a sixth about that, as Dst does."""
    way, phase = -1.0 if rng.random() < 0.8 else 1.0, rng.uniform(0, 2 * np.pi, 2)
    hours, tau_h = np.array([1.1, 2.7]) * rng.uniform(0.8, 1.2, 2), float(rng.uniform(3.0, 10.0))

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            t = epoch.seconds_since(time, w.start)[:, None] / 3600.0
            wander = 1.0 + 0.15 * np.sum(np.sin(2 * np.pi * t / hours + phase), axis=1)
            return of_place.ring_field_N_nT(w, time, r_N_km, way * size * np.exp(-t[:, 0] / tau_h) * wander)

        return Truth("ring_current", "field", {"dst_nT": way * size, "tau_h": tau_h, "wander": 0.15}, field=more)

    return Draft(world, at, 5.0, 1000.0, 150.0)


def head_other_view(world: World, rng: np.random.Generator) -> Draft | None:
    """The head's error acts in another field of view than the column says: 2.5 deg off."""
    plain = of_place.sun_sensor_head_misalignment(world, rng)
    if plain is None:
        return None
    world = plain.world
    used = spacecraft.head_in_use(world, world.time)
    heads = [k for k in range(1, len(world.craft.heads_B) + 1) if 0.1 < share(used == k) < 0.85]
    head, axis, other = int(rng.choice(heads)), direction(rng), world.craft.head_half_angle_rad + np.radians(2.5)

    def at(size: float) -> Truth:
        def turned(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            mask = spacecraft.head_in_use(w, time, other) == head
            return of_place.turned_by(mask, np.radians(size) * axis, R_BN)

        def seen(w: World, time: TimeArray, sun_B: FloatArray) -> FloatArray:
            return of_place.turned_sun(spacecraft.head_in_use(w, time, other) == head, np.radians(size) * axis, sun_B)

        parameters = {"head": head, "rotation_deg": listed(size * axis)}
        return Truth("sun_sensor_head_misalignment", "attitude", parameters, report=turned, sun=seen)

    return Draft(world, at, 0.005, 5.0, 0.2)


def heater_tapers(world: World, rng: np.random.Generator) -> Draft | None:
    """The heater's current falls by a third within minutes of switching on."""
    world = recording(world, "heater_on")
    if of_spacecraft.heater_switching(world, rng) is None:
        return None
    axis, tau = direction(rng), of_spacecraft.settle_time_s(rng)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            since = of_spacecraft.seconds_on(w, time, spacecraft.heater_on)
            now = spacecraft.heater_on(w, time) * (1.0 + 0.5 * np.exp(-since / tau))
            return np.outer(now, size * axis)

        return Truth("heater_switching", "spacecraft", {"field_nT": listed(size * axis), "tau_s": tau}, stray=stray)

    return Draft(world, at, 2.0, 5000.0, 100.0)


def switch_ramps(world: World, rng: np.random.Generator) -> Draft | None:
    """The flagged unit ramps up within a minute or two."""
    world = recording(world, "flag_payload")
    on = spacecraft.payload_on(world, world.time)
    if not 0.08 < share(on) < 0.9:
        return None
    axis, tau = direction(rng), 0.3 * of_spacecraft.settle_time_s(rng)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            since = of_spacecraft.seconds_on(w, time, spacecraft.payload_on)
            return np.outer(spacecraft.payload_on(w, time) * (1.0 - np.exp(-since / tau)), size * axis)

        parameters = {"condition": "flag:payload", "field_nT": listed(size * axis), "tau_s": tau}
        return Truth("switched_field", "spacecraft", parameters, stray=stray)

    return Draft(world, at, 2.0, 5000.0, 100.0)


def wheel_harmonic(world: World, rng: np.random.Generator) -> Draft:
    """The wheel's field has a second harmonic of a quarter."""
    world = of_spacecraft.steady_wheel(recording(world, "wheel_speed_rpm"))
    a, c, d, e = (direction(rng) for _ in range(4))

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            p = spacecraft.wheel_phase_rad(w, time)
            first = np.outer(np.cos(p), a) + np.outer(np.sin(p), c)
            return size * (first + 0.25 * (np.outer(np.cos(2 * p), d) + np.outer(np.sin(2 * p), e)))

        return Truth("wheel_field", "spacecraft", {"cos_nT": listed(size * a), "sin_nT": listed(size * c)}, stray=stray)

    return Draft(world, at, 1.0, 2000.0, 80.0)


def step_settles(world: World, rng: np.random.Generator) -> Draft:
    """The bias jumps, and a third of the jump settles back."""
    jump, instant = direction(rng), shift(world.time[:1], float(rng.uniform(0.2, 0.8)) * world.span_s)[0]
    tau = 0.05 * world.span_s

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            since = epoch.seconds_since(time, instant)
            course = (since >= 0) * (1.0 + 0.5 * np.exp(-np.maximum(since, 0.0) / tau))
            return np.zeros((time.size, 3, 3)), np.outer(course, size * jump)

        parameters = {"at": str(instant), "jump_nT": listed(size * jump), "tau_s": tau}
        return Truth("bias_step", "sensor", parameters, correction=correction)

    return Draft(world, at, 2.0, 5000.0, 100.0)


def lag_two_poles(world: World, rng: np.random.Generator) -> Draft:
    """Two equal poles in place of one."""
    plain = of_sensor.sensor_lag(world, rng)
    return dataclasses.replace(
        plain, at=lambda size: Truth("sensor_lag", "sensor", {"tau_s": size, "poles": 2}, lag_s=size, lag_two_pole=True)
    )


def clipping_softly(world: World, rng: np.random.Generator) -> Draft:
    """The amplifier bends before it clips."""
    plain = of_sensor.saturation(world, rng)
    top = float(np.abs(ambient(world, (), world.time)).max())

    def at(size: float) -> Truth:
        level = top - size
        knee = 0.92 * level

        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            over = np.maximum(np.abs(m) - knee, 0.0)
            return np.sign(m) * (np.minimum(np.abs(m), knee) + (level - knee) * np.tanh(over / (level - knee)))

        return Truth("saturation", "sensor", {"level_nT": level}, sense=sense)

    return Draft(world, at, plain.low, plain.high, plain.start)


def track_error_grows(world: World, rng: np.random.Generator) -> Draft:
    """The along-track error grows by a fifth along the record, as that of old elements does."""
    way, begin, span = sign(rng), world.start, world.span_s

    def at(size: float) -> Truth:
        def place(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            return of_place.ahead(w, time, way * size * (0.9 + 0.2 * epoch.seconds_since(time, begin) / span))

        return Truth("along_track_error", "orbit", {"ahead_km": way * size}, place=place)

    return Draft(world, at, 0.2, 100.0, 20.0)


def clock_creeps(world: World, rng: np.random.Generator) -> Draft:
    """The clock is late and loses a third of that more along the record."""
    way, begin, span = sign(rng), world.start, world.span_s

    def at(size: float) -> Truth:
        def clock(w: World, time: TimeArray) -> FloatArray:
            return way * size * (0.83 + 0.33 * epoch.seconds_since(time, begin) / span)

        return Truth("time_tag_offset", "time", {"offset_s": way * size}, clock=clock)

    most = of_place.latest_s(world)
    return Draft(followed(world), at, 1e-4, most, min(3.0, 0.2 * most))


def epoch_other_rates(world: World, rng: np.random.Generator) -> Draft:
    """The real field has moved by the change of another decade, not of this one."""
    way = sign(rng)
    world = dataclasses.replace(world, real_model=world.ground_model)
    back = np.timedelta64(8 * 365, "D")

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            turn = frames.rotation_EN(time)
            early = time - back
            later = shift(early, way * size * 365.25 * 86400.0)
            return field_N_nT(w.real_model, later, r_N_km, turn) - field_N_nT(w.real_model, early, r_N_km, turn)

        return Truth("field_epoch", "field", {"ahead_yr": way * size}, field=more)

    return Draft(world, at, 0.2, 10.0, 3.0)


def yaw_runs_away(world: World, rng: np.random.Generator) -> Draft | None:
    """The yaw error grows faster and faster."""
    if world.regime not in ("nadir", "slews"):
        return None
    way, begin, span = sign(rng), world.start, world.span_s

    def at(size: float) -> Truth:
        def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            since = epoch.seconds_since(time, begin)
            yaw = way * np.radians(size) * since / 3600.0 * (0.7 + 0.6 * since / span)
            return of_place.with_angles(w, time, R_BN, (yaw, np.zeros_like(yaw), np.zeros_like(yaw)))

        return Truth("yaw_drift", "attitude", {"rate_deg_h": way * size, "when": "always"}, report=report)

    return Draft(world, at, 0.002, 10.0, 0.2)


def horizon_third(world: World, rng: np.random.Generator) -> Draft | None:
    """The horizon error has a part in sin(3 lat) of a fifth."""
    if world.regime not in ("nadir", "slews"):
        return None
    c = direction(rng, 4)

    def at(size: float) -> Truth:
        def scanned(w: World, time: TimeArray) -> FloatArray:
            lat = of_place.latitude_rad(w, time)
            a, d = np.sin(lat) + 0.2 * np.sin(3 * lat), np.cos(2.0 * lat)
            return np.radians(size) * np.stack([c[k] * a + c[k + 1] * d for k in (0, 2)], axis=1)

        report = of_place.by_scanner(scanned)
        return Truth("horizon_scanner_bias", "attitude", {"c_deg": listed(size * c)}, report=report, nadir=scanned)

    return Draft(world, at, 0.005, 4.0, 0.2)


def eddy_late(world: World, rng: np.random.Generator) -> Draft:
    """The induced current answers with a delay of a fiftieth of a turn."""
    plain = of_spacecraft.eddy_current(world, rng)
    shape, late = of_spacecraft.traceless(rng), world.turn_period_s() / 50.0

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            return -of_spacecraft.field_rate_nT_s(w, shift(time, -late), field) @ (size * shape).T

        return Truth("eddy_current", "spacecraft", {"K_s": listed(size * shape), "late_s": late}, stray=stray)

    return dataclasses.replace(plain, at=at)


def bent_by_strength(world: World, rng: np.random.Generator) -> Draft:
    """Each axis bends with |B| and its own component: odd, not a polynomial."""
    c = direction(rng)

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            strength = np.linalg.norm(m, axis=1)[:, None] / 5e4
            return m + size * c * (m / 5e4) * strength**1.5

        return Truth("cubic_nonlinearity", "sensor", {"c_nT": listed(size * c)}, sense=sense)

    return Draft(world, at, 1.0, 8000.0, 300.0)


def soft_hysteresis(world: World, rng: np.random.Generator) -> Draft | None:
    """Half of the remanence nears saturation exponentially on either branch (Dahl), half slips at once."""
    plain = of_sensor.hysteresis(world, rng)
    grown = of_sensor.history(world)
    if plain is None or grown is None:
        return None
    axis, width = direction(rng), float(rng.uniform(0.05, 0.2)) * float(np.min(np.ptp(grown[1], axis=0)))
    seconds, x = grown
    z = 0.5 * dahl(x, width) + 0.5 * of_sensor.stop_state(world, width)[1]

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            now = epoch.seconds_since(time, w.start)
            return m + size * axis * np.stack([np.interp(now, seconds, z[:, k]) for k in range(3)], axis=1)

        return Truth("hysteresis", "sensor", {"h_nT": listed(size * axis), "width_nT": width}, sense=sense)

    return Draft(world, at, 2.0, 5000.0, 100.0)


def dahl(x: FloatArray, width_nT: float) -> FloatArray:
    """dz = (1 - sgn(dx) z) dx / width on each axis, exact from node to node."""
    z, states = np.zeros(3), np.zeros_like(x)
    for row in range(1, len(x)):
        step = x[row] - x[row - 1]
        way = np.sign(step)
        z = way + (z - way) * np.exp(-np.abs(step) / width_nT)
        states[row] = z
    return states


def thermal_two_rates(world: World, rng: np.random.Generator) -> Draft | None:
    """The electronics cool two to four times as slowly as they warm."""
    world = recording(world, "temperature_degC")
    if of_sensor.thermal_bias_drift(world, rng) is None:
        return None
    slope, warms_s = direction(rng), 0.6 * world.craft.temperature_tau_s
    cools_s = warms_s * float(rng.uniform(2.0, 4.0))

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            warmer = spacecraft.temperature_degC(w, time, warms_s, cools_s)
            return np.zeros((time.size, 3, 3)), np.outer(warmer, size * slope)

        parameters = {"slope_nT_per_K": listed(size * slope), "tau_s": warms_s, "cooling_tau_s": cools_s}
        return Truth("thermal_bias_drift", "sensor", parameters, correction=correction)

    return Draft(world, at, 0.05, 300.0, 5.0)


def two_current_loops(world: World, rng: np.random.Generator) -> Draft | None:
    """Beyond 60 % of its current the array, a fixed panel, feeds a second loop, which lies otherwise."""
    craft = dataclasses.replace(world.craft, panels_B=np.eye(3)[[int(rng.integers(0, 3))]])
    world = dataclasses.replace(recording(world, "array_current_A"), craft=craft)
    if of_spacecraft.solar_array_current(world, rng) is None:
        return None
    axis, other, knee_A = direction(rng), direction(rng), 0.6 * world.craft.full_sun_A

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            amperes = spacecraft.array_current_A(w, time)
            return size * (np.outer(amperes, axis) + np.outer(np.maximum(amperes - knee_A, 0.0), other))

        return Truth("solar_array_current", "spacecraft", {"k_nT_per_A": listed(size * axis)}, stray=stray)

    return Draft(world, at, 0.2, 1000.0, 20.0)


def array_watts(world: World, rng: np.random.Generator) -> Draft | None:
    """The field follows the power of the array: cells that warm twice as far as the sensor lose 0.4 %/K."""
    world = recording(world, "array_current_A")
    if of_spacecraft.solar_array_current(world, rng) is None:
        return None
    axis, tau_s = direction(rng), float(rng.uniform(300.0, 900.0))

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            volts = 1.0 - 0.004 * 2.0 * (spacecraft.temperature_degC(w, time, tau_s) - w.craft.sunlit_degC)
            return np.outer(volts * spacecraft.array_current_A(w, time), size * axis)

        parameters = {"k_nT_per_A": listed(size * axis), "tau_s": tau_s}
        return Truth("solar_array_current", "spacecraft", parameters, stray=stray)

    return Draft(world, at, 0.2, 1000.0, 20.0)


def torquer_remanence(world: World, rng: np.random.Generator) -> Draft | None:
    """A core stays magnetised by an eighth of its full dipole, the way it was last driven."""
    plain = of_spacecraft.torquer_coupling(world, rng)
    if plain is None:
        return None
    full, shape = max(world.craft.torquers.amplitude_Am2), direction(rng, 9).reshape(3, 3)
    nodes = np.arange(-6000.0, world.span_s + 60.0, 2.0)
    driven = np.sign(spacecraft.dipole_B_Am2(world, epoch.add_seconds(world.start, nodes)))
    last = np.maximum.accumulate(np.where(driven != 0.0, np.arange(nodes.size)[:, None], 0), axis=0)
    way = np.take_along_axis(driven, last, axis=0)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            held = np.searchsorted(nodes, epoch.seconds_since(time, w.start), side="right") - 1
            return (spacecraft.dipole_B_Am2(w, time) + 0.125 * full * way[held]) @ (size * shape).T

        return Truth("torquer_coupling", "spacecraft", {"coupling_nT_per_Am2": listed(size * shape)}, stray=stray)

    return Draft(plain.world, at, 0.01, 300.0, 2.0)


def quintic_beside_cubic(world: World, rng: np.random.Generator) -> Draft:
    """Each axis bends with the third and, half to once as much at 50,000 nT, with the fifth power of its own component."""
    c, fifth = direction(rng), rng.uniform(0.5, 1.0, 3)

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            x = m / 5e4
            return m + size * c * (x**3 + fifth * x**5)

        parameters = {"c_nT": listed(size * c), "quintic_nT": listed(size * c * fifth)}
        return Truth("cubic_nonlinearity", "sensor", parameters, sense=sense)

    return Draft(world, at, 1.0, 8000.0, 300.0)


SHAPES = {
    maker.__name__: maker
    for maker in (
        torquer_saturates,
        array_current_power,
        battery_two_paths,
        thermal_other_node,
        storm_wanders,
        head_other_view,
        heater_tapers,
        switch_ramps,
        wheel_harmonic,
        step_settles,
        lag_two_poles,
        clipping_softly,
        track_error_grows,
        clock_creeps,
        epoch_other_rates,
        yaw_runs_away,
        horizon_third,
        eddy_late,
        bent_by_strength,
        soft_hysteresis,
        thermal_two_rates,
        two_current_loops,
        array_watts,
        torquer_remanence,
        quintic_beside_cubic,
    )
}
