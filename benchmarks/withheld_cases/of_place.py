"""Forward models of the time, orbit, field and attitude stages."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import load_field
from withheld_cases import spacecraft
from withheld_cases.chain import Truth
from withheld_cases.draft import Draft, direction, followed, listed, recording, share, sign
from withheld_cases.worlds import World, between, shift

INDUCED_SHARE = 0.27
_YEAR_S = 365.25 * 86400.0


def time_tag_offset(world: World, rng: np.random.Generator) -> Draft:
    """The magnetometer samples that much later than the stamp."""
    way = sign(rng)

    def at(size: float) -> Truth:
        return Truth(
            "time_tag_offset", "time", {"offset_s": way * size}, clock=lambda w, t: np.full(t.size, way * size)
        )

    most = latest_s(world)
    return Draft(followed(world), at, 1e-4, most, min(3.0, 0.2 * most))


def latest_s(world: World) -> float:
    """A clock error within which no body turns by more than 15 deg: more would have been noticed at once."""
    return min(40.0, world.turn_period_s() / 24.0)


def ahead(world: World, time: TimeArray, distance_km: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Where the spacecraft will be after that way along its orbit."""
    _, v_N_km_s = world.where(time)
    return world.where(shift(time, distance_km / np.linalg.norm(v_N_km_s, axis=1)))


def along_track_error(world: World, rng: np.random.Generator) -> Draft:
    """The reported position lies ahead of the true one; the attitude is right."""
    way = sign(rng)

    def at(size: float) -> Truth:
        return Truth("along_track_error", "orbit", {"ahead_km": way * size}, place=lambda w, t: ahead(w, t, way * size))

    return Draft(world, at, 0.2, 100.0, 20.0)


def field_epoch(world: World, rng: np.random.Generator) -> Draft:
    """The real field is that many years ahead of the model."""
    way = sign(rng)
    world = dataclasses.replace(world, real_model=world.ground_model)

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            turn = frames.rotation_EN(time)  # the Earth is where it is; only the model's clock is advanced
            later = shift(time, way * size * _YEAR_S)
            return field_N_nT(w.real_model, later, r_N_km, turn) - field_N_nT(w.real_model, time, r_N_km, turn)

        return Truth("field_epoch", "field", {"ahead_yr": way * size}, field=more)

    return Draft(world, at, 0.2, 10.0, 3.0)


def field_truncation(world: World, rng: np.random.Generator) -> Draft:
    """Real field and model differ by all degrees above N: the model is cut, or the field has no more."""
    degree = int(rng.integers(5, 11))
    whole = load_field("igrf14")
    cut = whole.truncated(degree)
    model_lacks = bool(rng.random() < 0.5)
    if model_lacks:
        world = dataclasses.replace(world, ground_model=cut, real_model=cut, degree=degree)
    else:
        world = dataclasses.replace(world, real_model=whole)
    way = 1.0 if model_lacks else -1.0

    def above(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
        return way * (field_N_nT(whole, time, r_N_km) - field_N_nT(cut, time, r_N_km))

    parameters = {"degree": degree, "lacks_them": "model" if model_lacks else "field"}
    return Draft(world, lambda size: Truth("field_truncation", "field", parameters, field=above), 1.0, 1.0, 1.0)


def dipole_axis_E(world: World, time: TimeArray) -> FloatArray:
    """(3,) unit vector to the geomagnetic north pole, Earth-fixed: the field at the dipole equator points there."""
    g10, g11, h11 = world.ground_model.coefficients_nT(time[:1])[0][:3]
    axis = -np.array([g11, h11, g10])
    unit: FloatArray = axis / np.linalg.norm(axis)
    return unit


def ring_field_N_nT(world: World, time: TimeArray, r_N_km: FloatArray, dst_nT: FloatArray) -> FloatArray:
    """Field of a ring current that changes the field at the dipole equator on the ground by dst_nT (north positive).

    A uniform field along the dipole axis, and the dipole that it induces in the Earth; of the change at the equator
    on the ground the induced part is 0.27 of the external one.
    """
    turn = frames.rotation_EN(time)
    r_E_km = turn.apply(r_N_km)
    axis = dipole_axis_E(world, time)
    radius = np.linalg.norm(r_E_km, axis=1)[:, None]
    up = r_E_km / radius
    outside = (np.asarray(dst_nT) / (1.0 + INDUCED_SHARE))[:, None]
    # A dipole of moment -m along the axis: (3 (m.u) u - m) / r^3; at the equator it points along +m.
    moment = -INDUCED_SHARE * outside * FIELD_RADIUS_KM**3 * axis
    induced = (3.0 * np.sum(moment * up, axis=1)[:, None] * up - moment) / radius**3
    b_N_nT: FloatArray = turn.inv().apply(outside * axis + induced)
    return b_N_nT


def ring_current(world: World, rng: np.random.Generator) -> Draft:
    """A ring current, constant or recovering."""
    way = -1.0 if rng.random() < 0.8 else 1.0
    tau_h = float(rng.uniform(6.0, 30.0)) if rng.random() < 0.5 else np.inf
    begin = world.start

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            hours = epoch.seconds_since(time, w.start) / 3600.0
            return ring_field_N_nT(w, time, r_N_km, way * size * np.exp(-hours / tau_h))

        parameters = {"dst_nT": way * size, "tau_h": None if np.isinf(tau_h) else tau_h, "from": str(begin)}
        return Truth("ring_current", "field", parameters, field=more)

    return Draft(world, at, 5.0, 600.0, 150.0)


def sun_sensor_head_misalignment(world: World, rng: np.random.Generator) -> Draft | None:
    """The reference attitude is turned while one head is in use."""
    world = recording(world, "sun_sensor_head")
    used = spacecraft.head_in_use(world, world.time)
    heads = [k for k in range(1, len(world.craft.heads_B) + 1) if 0.1 < share(used == k) < 0.85]
    if not heads:
        return None
    head, axis = int(rng.choice(heads)), direction(rng)

    def at(size: float) -> Truth:
        def turned(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            return turned_by(spacecraft.head_in_use(w, time) == head, np.radians(size) * axis, R_BN)

        def seen(w: World, time: TimeArray, sun_B: FloatArray) -> FloatArray:
            return turned_sun(spacecraft.head_in_use(w, time) == head, np.radians(size) * axis, sun_B)

        parameters = {"head": head, "rotation_deg": listed(size * axis)}
        return Truth("sun_sensor_head_misalignment", "attitude", parameters, report=turned, sun=seen)

    return Draft(world, at, 0.005, 5.0, 0.2)


def turned_by(mask: FloatArray, theta_B_rad: FloatArray, R_BN: Rotation) -> Rotation:
    """exp([theta x]) R_BN where the mask is not zero: a vector that reads v is then reported as v + theta x v."""
    return Rotation.from_rotvec(np.asarray(mask, dtype=np.float64)[:, None] * theta_B_rad) * R_BN


def turned_sun(mask: FloatArray, theta_B_rad: FloatArray, sun_B: FloatArray) -> FloatArray:
    """What a head so mounted takes for the direction to the sun, (N, 3), where the mask is not zero: as `turned_by`."""
    seen: FloatArray = Rotation.from_rotvec(np.asarray(mask, dtype=np.float64)[:, None] * theta_B_rad).apply(sun_B)
    return seen


def with_angles(
    world: World, time: TimeArray, R_BN: Rotation, more_rad: tuple[FloatArray, FloatArray, FloatArray]
) -> Rotation:
    """The attitude whose yaw, roll and pitch are larger by that."""
    R_ON = frames.rotation_ON(*world.where(time))
    yaw, roll, pitch = frames.yaw_roll_pitch(R_BN * R_ON.inv())
    return frames.rotation_BO(yaw + more_rad[0], roll + more_rad[1], pitch + more_rad[2]) * R_ON


def latitude_rad(world: World, time: TimeArray) -> FloatArray:
    """Geocentric latitude of the spacecraft."""
    r_N_km, _ = world.where(time)
    return frames.geocentric(frames.rotation_EN(time).apply(r_N_km))[0]


def by_scanner(scanned: Callable[[World, TimeArray], FloatArray]) -> Callable[[World, TimeArray, Rotation], Rotation]:
    """The reported attitude errs as the scanner does that gives its roll and pitch."""

    def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
        roll, pitch = scanned(w, time).T
        return with_angles(w, time, R_BN, (np.zeros_like(roll), roll, pitch))

    return report


def horizon_scanner_bias(world: World, rng: np.random.Generator) -> Draft | None:
    """Roll and pitch errors that follow the latitude, as the warmth of the horizon does."""
    if world.regime not in ("nadir", "slews"):
        return None
    c = direction(rng, 4)

    def at(size: float) -> Truth:
        def scanned(w: World, time: TimeArray) -> FloatArray:
            lat = latitude_rad(w, time)
            a, d = np.sin(lat), np.cos(2.0 * lat)
            return np.radians(size) * np.stack([c[k] * a + c[k + 1] * d for k in (0, 2)], axis=1)

        parameters = {"roll_sin_roll_cos2_pitch_sin_pitch_cos2_deg": listed(size * c)}
        return Truth("horizon_scanner_bias", "attitude", parameters, report=by_scanner(scanned), nadir=scanned)

    return Draft(world, at, 0.005, 4.0, 0.2)


@lru_cache(maxsize=8)
def _shadow(world: World) -> tuple[FloatArray, FloatArray]:
    """Seconds since the sun was lost, on a grid."""
    grid = np.arange(-6000.0, world.span_s + 300.0, 5.0)
    light = world.sun(epoch.add_seconds(world.start, grid))[1] > 0.5
    last = np.maximum.accumulate(np.where(light, grid, -np.inf))
    return grid, np.where(np.isfinite(last), grid - last, 0.0)


def coasting_s(world: World, time: TimeArray) -> FloatArray:
    """(N,) seconds since the spacecraft went into shadow, 0 in sunlight."""
    grid, since = _shadow(world)
    now = epoch.seconds_since(time, world.start)
    dark = world.sun(time)[1] <= 0.5
    return np.where(dark, np.interp(now, grid, since), 0.0)


def yaw_drift(world: World, rng: np.random.Generator) -> Draft | None:
    """The reference yaw runs away, always or while in shadow."""
    if world.regime not in ("nadir", "slews"):
        return None
    way, coasting = sign(rng), rng.random() < 0.5
    if coasting and share(coasting_s(world, world.time)) < 0.1:
        coasting = False

    def at(size: float) -> Truth:
        def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            since = coasting_s(w, time) if coasting else epoch.seconds_since(time, w.start)
            yaw = way * np.radians(size) * since / 3600.0
            return with_angles(w, time, R_BN, (yaw, np.zeros_like(yaw), np.zeros_like(yaw)))

        parameters = {"rate_deg_h": way * size, "when": "eclipse" if coasting else "always"}
        return Truth("yaw_drift", "attitude", parameters, report=report)

    return Draft(world, at, 0.002, 10.0, 0.5 if coasting else between(rng, 0.05, 0.2))
