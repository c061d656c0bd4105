"""Effects that the table does not have yet, or has in a narrower form: `JOINING`, by forward models of the benchmark's own.

What the table will call them stands in `NAMES` and nowhere else.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from withheld_cases import of_place, of_sensor, spacecraft
from withheld_cases.chain import Ambient, Truth, low_pass
from withheld_cases.draft import Draft, changes, direction, followed, listed, recording, share, sign
from withheld_cases.worlds import World, between, shift

NAMES = {
    "lag_of_one_axis": "sensor_lag",
    "axis_skew": "axis_skew",
    "track_with_rate": "along_track_error",
    "far_along_track": "along_track_error",
    "clock_with_drift": "time_tag_offset",
    "drift_of_bias": "linear_drift",
    "drift_of_scale": "linear_drift",
    "common_gain_drift": "common_gain_drift",
    "attitude_step": "attitude_step",
    "mounting_step": "mounting_step",
    "stray_field": "stray_field",
    "driver": "driver",
    "field_of_an_interval": "switched_field",
    "excess_noise": "excess_noise",
}
"""Kind to the name in the effects table."""
POINTED = ("far_along_track",)
"""Only where the body keeps to the Earth."""
_DAY_S = 86400.0


def lag_of_one_axis(world: World, rng: np.random.Generator) -> Draft:
    """A first-order low-pass on one axis alone."""
    axis, plain = int(rng.integers(0, 3)), of_sensor.sensor_lag(world, rng)

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            late = m.copy()
            late[:, axis] += (low_pass(perfect, time, size) - perfect(time))[:, axis]
            return late

        return Truth(NAMES["lag_of_one_axis"], "sensor", {"tau_s": size, "axis": "xyz"[axis]}, sense=sense)

    return dataclasses.replace(plain, at=at)


def axis_skew(world: World, rng: np.random.Generator) -> Draft:
    """The axes are read one after another: y and z later than x."""
    late = np.array([0.0, 1.0, float(rng.uniform(1.3, 2.5))])

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            more = [(perfect(shift(time, size * late[k])) - perfect(time))[:, k] for k in (1, 2)]
            return m + np.stack([np.zeros(time.size), *more], axis=1)

        return Truth(NAMES["axis_skew"], "sensor", {"late_y_z_s": listed(size * late[1:])}, sense=sense)

    most = 0.4 * of_place.latest_s(world)
    return Draft(followed(world), at, 1e-4, most, min(3.0, 0.2 * most))


def _along_track(
    kind: str, world: World, ahead_km: FloatArray, rate_km_h: FloatArray, follows: bool, size: float
) -> Truth:
    """Reported ahead, more and more; the attitude is right, or as the body keeps to the reported orbit."""
    begin = world.start

    def place(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
        hours = epoch.seconds_since(time, begin) / 3600.0
        return of_place.ahead(w, time, size * (ahead_km + rate_km_h * hours))

    def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
        R_BO = R_BN * frames.rotation_ON(*w.where(time)).inv()
        return R_BO * frames.rotation_ON(*place(w, time))

    parameters = {"ahead_km": float(size * ahead_km), "rate_km_h": float(size * rate_km_h), "attitude_follows": follows}
    return Truth(NAMES[kind], "orbit", parameters, place=place, report=report if follows else None)


def track_with_rate(world: World, rng: np.random.Generator) -> Draft:
    """The reported position lies ahead, by a third to three times more or less at the end than at the beginning."""
    grows = sign(rng) * between(rng, 0.3, 3.0)
    ahead_km, rate_km_h = np.array(sign(rng)), np.array(grows * 3600.0 / world.span_s)
    follows = world.regime == "nadir" and bool(rng.random() < 0.5)

    def at(size: float) -> Truth:
        return _along_track("track_with_rate", world, ahead_km, rate_km_h, follows, size)

    return Draft(world, at, 0.2, 3000.0, 20.0)


def far_along_track(world: World, rng: np.random.Generator) -> Draft:
    """Hundreds to thousands of km ahead, as by old elements; the body keeps to the reported orbit, or slews about it."""
    ahead_km, rate_km_h = np.array(sign(rng)), np.array(sign(rng) * between(rng, 0.2, 5.0) * 1e-3)

    def at(size: float) -> Truth:
        return _along_track("far_along_track", world, ahead_km, rate_km_h, True, size)

    return Draft(world, at, 300.0, 8000.0, between(rng, 300.0, 8000.0), as_drawn=True)


def clock_with_drift(world: World, rng: np.random.Generator) -> Draft:
    """Sampled later than the stamp by an offset that drifts."""
    begins, grows, begin = float(rng.uniform(-0.5, 0.5)), sign(rng), world.start
    per_day = grows * _DAY_S / world.span_s

    def at(size: float) -> Truth:
        def clock(w: World, time: TimeArray) -> FloatArray:
            return size * (begins + per_day * epoch.seconds_since(time, begin) / _DAY_S)

        parameters = {"offset_s": size * begins, "drift_s_per_day": size * per_day}
        return Truth(NAMES["clock_with_drift"], "time", parameters, clock=clock)

    most = of_place.latest_s(world)
    return Draft(followed(world), at, 1e-4, most, min(3.0, 0.2 * most))


def _of_the_record(world: World, time: TimeArray) -> FloatArray:
    """(N,) from -1/2 at its beginning to 1/2 at its end."""
    return np.asarray(epoch.seconds_since(time, world.start) / world.span_s - 0.5)


def drift_of_bias(world: World, rng: np.random.Generator) -> Draft:
    """Equation 1's b drifts at a constant rate."""
    slope, days = direction(rng), world.span_s / _DAY_S

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            return np.zeros((time.size, 3, 3)), np.outer(_of_the_record(w, time), size * slope)

        parameters = {"rate_nT_per_day": listed(size * slope / days)}
        return Truth(NAMES["drift_of_bias"], "sensor", parameters, correction=correction)

    return Draft(world, at, 1.0, 5000.0, 100.0)


def drift_of_scale(world: World, rng: np.random.Generator) -> Draft:
    """Equation 1's S drifts at a constant rate: its diagonal, or all of it."""
    slope, days = direction(rng, 9).reshape(3, 3), world.span_s / _DAY_S
    if rng.random() < 0.5:
        slope = np.diag(direction(rng))

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            return _of_the_record(w, time)[:, None, None] * size * slope, np.zeros((time.size, 3))

        parameters = {"rate_per_day": listed(size * slope / days)}
        return Truth(NAMES["drift_of_scale"], "sensor", parameters, correction=correction)

    return Draft(world, at, 1e-5, 0.1, 4e-3)


def common_gain_drift(world: World, rng: np.random.Generator) -> Draft | None:
    """One gain of all axes follows a temperature nobody records; what the body adds, up to 30,000 nT, grows with it."""
    if not 0.15 < share(world.sun(world.time)[1] > 0.5) < 0.93:
        return None
    if rng.random() < 0.5:
        world = dataclasses.replace(world, b_nT=between(rng, 3e3, 3e4) * direction(rng))
    tau_s = world.craft.temperature_tau_s * between(rng, 0.4, 2.5)

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            return m * (1.0 + size * (spacecraft.temperature_degC(w, time, tau_s) - 10.0))[:, None]

        return Truth(NAMES["common_gain_drift"], "sensor", {"gain_per_K": size, "tau_s": tau_s}, sense=sense)

    return Draft(world, at, 1e-7, 3e-3, 1e-4)


def _later(world: World, rng: np.random.Generator) -> np.datetime64:
    return shift(world.time[:1], float(rng.uniform(0.2, 0.8)) * world.span_s)[0]


def attitude_step(world: World, rng: np.random.Generator) -> Draft:
    """From one moment on the reported attitude is turned."""
    instant, axis = _later(world, rng), direction(rng)

    def at(size: float) -> Truth:
        def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            return of_place.turned_by(time >= instant, np.radians(size) * axis, R_BN)

        parameters = {"at": str(instant), "rotation_deg": listed(size * axis)}
        return Truth(NAMES["attitude_step"], "attitude", parameters, report=report)

    return Draft(world, at, 0.005, 20.0, 0.2)


def mounting_step(world: World, rng: np.random.Generator) -> Draft:
    """From one moment on the sensor is turned, and sees the field turned the other way."""
    instant, axis = _later(world, rng), direction(rng)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            straight = field(time)
            turned = Rotation.from_rotvec(-np.radians(size) * axis).apply(straight)
            return np.where((time >= instant)[:, None], turned - straight, 0.0)

        parameters = {"at": str(instant), "rotation_deg": listed(size * axis)}
        return Truth(NAMES["mounting_step"], "sensor", parameters, stray=stray, turns_sensor=True)

    return Draft(world, at, 0.005, 20.0, 0.2)


def stray_field(world: World, rng: np.random.Generator) -> Draft | None:
    """Currents that nobody records: in sunlight a field that is linear in the sun's direction in the body."""
    if share(world.sun(world.time)[1] > 0.5) < 0.15:
        return None
    unseen = world.recorded - {"array_current_A", "battery_current_A"}
    world, shape = dataclasses.replace(world, recorded=unseen), direction(rng, 9).reshape(3, 3)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            towards, light = w.sun(time)
            return light[:, None] * (w.attitude(time).R_BN.apply(towards) @ (size * shape).T)

        return Truth(NAMES["stray_field"], "spacecraft", {"by_sun_nT": listed(size * shape)}, stray=stray)

    return Draft(world, at, 2.0, 5000.0, 100.0)


_COLUMNS = {
    "array_current_A": spacecraft.array_current_A,
    "battery_current_A": spacecraft.battery_current_A,
    "flag_payload": spacecraft.payload_on,
    "temperature_degC": spacecraft.temperature_degC,
}


def driver(world: World, rng: np.random.Generator) -> Draft | None:
    """A field that follows a recorded column, one to ten minutes late."""
    column, late_s, axis = str(rng.choice(list(_COLUMNS))), float(rng.uniform(60.0, 600.0)), direction(rng)
    values = _COLUMNS[column](world, world.time)
    if late_s < 2.0 * world.step_s or values.std() == 0.0 or 0.0 < np.mean(values != 0.0) < 0.05:
        return None
    typical = float(values.std())

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            return np.outer(_COLUMNS[column](w, shift(time, -late_s)), size / typical * axis)

        parameters = {"column": column, "late_s": late_s, "k_nT_per_unit": listed(size / typical * axis)}
        return Truth(NAMES["driver"], "spacecraft", parameters, stray=stray)

    return Draft(recording(world, column), at, 1.0, 5000.0, 80.0)


def field_of_an_interval(world: World, rng: np.random.Generator) -> Draft | None:
    """A constant field from one moment to another."""
    axis, first, part = direction(rng), float(rng.uniform(0.1, 0.6)), float(rng.uniform(0.08, 0.3))
    begin, end = (shift(world.time[:1], s * world.span_s)[0] for s in (first, first + part))
    on = ((world.time >= begin) & (world.time < end)).astype(np.float64)
    if changes(on) < 2:
        return None

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            return np.outer((time >= begin) & (time < end), size * axis)

        parameters = {"condition": "clock", "from": str(begin), "to": str(end), "field_nT": listed(size * axis)}
        return Truth(NAMES["field_of_an_interval"], "spacecraft", parameters, stray=stray)

    return Draft(world, at, 2.0, 5000.0, 100.0)


JOINING = {name: {**vars(of_sensor), **globals()}[name] for name in NAMES}
