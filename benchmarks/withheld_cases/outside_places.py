"""Outside the catalogue: field, orbit, attitude, and what a spacecraft has aboard. `outside` says why not."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field import field_N_nT
from withheld_cases import of_place, spacecraft
from withheld_cases.chain import Ambient, Truth
from withheld_cases.draft import Draft, direction, listed, share, sign
from withheld_cases.worlds import World, between

EARTH_RATE_N_RAD_S = np.array([0.0, 0.0, 7.292115e-5])
"""WGS 84."""


def longitude_error(world: World, rng: np.random.Generator) -> Draft:
    """The reported place is turned about the Earth's axis, as by a wrong sidereal time."""
    way = sign(rng)

    def at(size: float) -> Truth:
        turn = Rotation.from_rotvec([0.0, 0.0, np.radians(way * size)])

        def place(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            r_N_km, v_N_km_s = w.where(time)
            return turn.apply(r_N_km), turn.apply(v_N_km_s)

        return Truth("longitude_error", "orbit", {"east_deg": way * size}, place=place)

    return Draft(world, at, 1e-3, 8.0, 0.2)


def sq_dynamo(world: World, rng: np.random.Generator) -> Draft:
    """Currents below that stand still under the sun: V = a (a/r)^3 sin(lat) cos(lat) cos(local time), and its gradient."""
    late = float(rng.uniform(-0.5, 0.5))

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            sun_N = w.sun(time)[0]
            noon = np.arctan2(sun_N[:, 1], sun_N[:, 0]) + late
            east = np.stack([np.cos(noon), np.sin(noon), np.zeros_like(noon)], axis=1)
            r = r_N_km / FIELD_RADIUS_KM
            x, z, distance = np.sum(r * east, axis=1), r[:, 2], np.linalg.norm(r, axis=1)
            slope = z[:, None] * east + x[:, None] * np.array([0.0, 0.0, 1.0])
            radial = 5.0 * (x * z / distance**2)[:, None] * r
            return -size * (slope - radial) / distance[:, None] ** 5

        return Truth("sq_dynamo", "field", {"size_nT": size}, field=more)

    return Draft(world, at, 3.0, 3000.0, 100.0)


def plasma_depletions(world: World, rng: np.random.Generator) -> Draft | None:
    """Bubbles in the plasma of the evening, within 25 deg of the dipole equator: the field along itself is stronger."""
    width_deg, phase = float(rng.uniform(4.0, 9.0)), float(rng.uniform(0, 2 * np.pi))

    def bubbles(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
        turn = frames.rotation_EN(time)
        up = turn.apply(r_N_km) / np.linalg.norm(r_N_km, axis=1)[:, None]
        latitude = np.degrees(np.arcsin(np.clip(up @ of_place.dipole_axis_E(w, time), -1, 1)))
        sun_E = turn.apply(w.sun(time)[0])
        after_noon = np.arctan2(up[:, 1], up[:, 0]) - np.arctan2(sun_E[:, 1], sun_E[:, 0])
        evening = np.mod(after_noon * 12.0 / np.pi + 12.0, 24.0)
        inside = (np.abs(latitude) < 25.0) & ((evening > 18.5) | (evening < 3.0))
        wave = np.maximum(np.sin(2.0 * np.pi * latitude / width_deg + phase), 0.0) ** 2
        shape: FloatArray = inside * wave * np.cos(np.pi * latitude / 50.0)
        return shape

    if share(bubbles(world, world.time, world.where(world.time)[0]) > 0.1) < 0.02:
        return None

    def at(size: float) -> Truth:
        def more(w: World, time: TimeArray, r_N_km: FloatArray) -> FloatArray:
            b_N_nT = field_N_nT(w.real_model, time, r_N_km)
            along = b_N_nT / np.linalg.norm(b_N_nT, axis=1)[:, None]
            return size * bubbles(w, time, r_N_km)[:, None] * along

        return Truth("plasma_depletions", "field", {"peak_nT": size, "width_deg": width_deg}, field=more)

    return Draft(world, at, 10.0, 5000.0, 300.0)


def gyro_scale(world: World, rng: np.random.Generator) -> Draft:
    """Between two fixes the attitude comes from gyros whose scale is wrong: it errs by a share of the turn since then."""
    turn_s = world.turn_period_s()
    every_s, wrong = float(rng.uniform(0.5, 1.5)) * turn_s, direction(rng)
    nodes = np.arange(0.0, world.span_s + turn_s / 100.0, turn_s / 200.0)
    rate = world.attitude(epoch.add_seconds(world.start, nodes)).rate_B_rad_s
    steps = 0.5 * np.diff(nodes)[:, None] * (rate[1:] + rate[:-1])
    turned = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])

    def so_far(seconds: FloatArray) -> FloatArray:
        return np.stack([np.interp(seconds, nodes, turned[:, k]) for k in range(3)], axis=1)

    def at(size: float) -> Truth:
        def report(w: World, time: TimeArray, R_BN: Rotation) -> Rotation:
            now = epoch.seconds_since(time, w.start)
            since_fix = so_far(now) - so_far(now - np.mod(now, every_s))
            return Rotation.from_rotvec(size * wrong * since_fix) * R_BN

        parameters = {"scale": listed(size * wrong), "every_s": every_s}
        return Truth("gyro_scale", "attitude", parameters, report=report)

    return Draft(world, at, 1e-6, 0.05, 1e-3)


def scanning_arm(world: World, rng: np.random.Generator) -> Draft | None:
    """A magnetised part swings to and fro at a period of its own; its field falls with the cube of the distance."""
    least_s = max(8.0 * world.step_s, 200.0)
    if least_s > world.span_s / 12.0:
        return None
    period_s, phase, axis = between(rng, least_s, world.span_s / 6.0), float(rng.uniform(0, 2 * np.pi)), direction(rng)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            swing = np.sin(2.0 * np.pi * epoch.seconds_since(time, w.start) / period_s + phase)
            return np.outer((1.0 + 0.5 * swing) ** -3, size * axis)

        return Truth("scanning_arm", "spacecraft", {"field_nT": listed(size * axis), "period_s": period_s}, stray=stray)

    return Draft(world, at, 0.5, 5000.0, 30.0)


def switching_transients(world: World, rng: np.random.Generator) -> Draft | None:
    """Eddy currents in the structure: each step of a torquer, up or down, leaves a field that decays, always one way."""
    tau_s, axis = float(rng.uniform(100.0, 500.0)), direction(rng)
    step_s = min(2.0, tau_s / 50.0)
    nodes = np.arange(-6.0 * tau_s, world.span_s + 60.0, step_s)
    dipole = spacecraft.dipole_B_Am2(world, epoch.add_seconds(world.start, nodes))
    jumps = np.abs(np.diff(dipole, axis=0, prepend=dipole[:1])).sum(axis=1)
    course = lfilter([1.0], [1.0, -np.exp(-step_s / tau_s)], jumps)
    course /= max(float(course.std()), 1e-9)
    if tau_s < 2.0 * world.step_s or np.count_nonzero(jumps) < 8:
        return None

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            return np.outer(np.interp(epoch.seconds_since(time, w.start), nodes, course), size * axis)

        return Truth(
            "switching_transients", "spacecraft", {"field_nT": listed(size * axis), "tau_s": tau_s}, stray=stray
        )

    return Draft(world, at, 1.0, 5000.0, 80.0)


def two_heaters(world: World, rng: np.random.Generator) -> Draft | None:
    """Two thermostats at nearly one period: together on, apart, together; both at once draw less than their sum."""
    period_s = float(rng.uniform(900.0, 2400.0))
    periods = np.array([period_s, period_s * rng.uniform(1.06, 1.16)])
    phases, duty = rng.random(2), rng.uniform(0.3, 0.6, 2)
    if world.span_s < 6.0 * period_s or period_s < 8.0 * world.step_s:
        return None
    fields = np.stack([direction(rng), direction(rng)])

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            on = np.mod(epoch.seconds_since(time, w.start)[:, None] / periods + phases, 1.0) < duty
            sag = np.where(on.all(axis=1), 0.7, 1.0)
            return size * sag[:, None] * (on.astype(np.float64) @ fields)

        parameters = {"fields_nT": listed(size * fields), "periods_s": listed(periods)}
        return Truth("two_heaters", "spacecraft", parameters, stray=stray)

    return Draft(world, at, 1.0, 5000.0, 80.0)


def motional_current(world: World, rng: np.random.Generator) -> Draft:
    """v x B drives a current through structure and plasma, one way only; the current has a field."""
    along, axis = rng.standard_normal(3), direction(rng)
    along /= np.linalg.norm(along)

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            r_N_km, v_N_km_s = w.where(time)
            v_B_km_s = w.attitude(time).R_BN.apply(v_N_km_s - np.cross(EARTH_RATE_N_RAD_S, r_N_km))
            volt_m = 1e-6 * np.cross(v_B_km_s, field(time)) @ along
            return np.outer(np.maximum(volt_m, 0.0), size * axis)

        return Truth("motional_current", "spacecraft", {"k_nT_per_V_m": listed(size * axis)}, stray=stray)

    return Draft(world, at, 5.0, 5e4, 600.0)
