"""From a scenario to the true motion of the body, at any stamps: worked out anew, not interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.attitude.libration import Libration, draw_libration
from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.run.flights import flights
from fluxtwin.sim.run.world import World, ephemeris, world_along
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import AttitudeSection

_SQRT2 = float(np.sqrt(2.0))


def true_attitude(scenario: Scenario, world: World) -> Attitude:
    """The motion at the world's stamps; the same seed gives the same motion at any stamps."""
    section = scenario.attitude
    if section.mode == "earth_pointing":
        return attitude.librating(
            world.time,
            world.r_N_km,
            world.v_N_km_s,
            libration(scenario),
            orbital_rate_O_rad_s=_orbital_rate(scenario, world),
        )
    if section.mode == "inertial_hold":
        return attitude.inertial_hold(world.time, frames.rotation_from_q(np.array([section.q_NB])))
    if section.mode == "dynamics":
        return flights(scenario).attitude(world.time)
    start = _start(scenario, world)
    if section.mode == "slews":
        points = []
        for point in scenario.attitude.waypoints:
            angles = np.radians([[point.yaw_deg], [point.roll_deg], [point.pitch_deg]])
            when = epoch.add_seconds(start, point.after_s)[0]
            points.append(attitude.Waypoint(when, frames.rotation_BO(*angles), point.hold_s))
        return attitude.orbital_slews(
            world.time,
            world.r_N_km,
            world.v_N_km_s,
            points,
            orbital_rate_O_rad_s=_orbital_rate(scenario, world),
        )
    inertia = np.array(scenario.spacecraft.inertia_kg_m2)
    if section.mode == "tumble":
        rate0 = np.radians(section.rate_deg_s)
        return attitude.tumble(world.time, inertia, np.array(section.q_NB), rate0, epoch=start)
    return _spin(section, inertia, world.time, start)


def _orbital_rate(scenario: Scenario, world: World) -> FloatArray:
    return attitude.ephemeris_rate_O_rad_s(lambda time: ephemeris(scenario, time), world.time)


def _start(scenario: Scenario, world: World) -> np.datetime64:
    """When the motion begins: the first sample of the schedule, whatever stamps are asked for."""
    if scenario.schedule is None:
        return np.datetime64(world.time[0])
    return epoch.parse_time(scenario.schedule.segments[0].start_utc)


def libration(scenario: Scenario) -> Libration:
    """The libration drawn for this scenario and seed."""
    a = scenario.attitude
    return draw_libration(
        (
            _SQRT2 * np.radians(a.yaw_rms_deg),
            _SQRT2 * np.radians(a.roll_rms_deg),
            _SQRT2 * np.radians(a.pitch_rms_deg),
        ),
        60.0 * a.shortest_period_min,
        60.0 * a.longest_period_min,
        stream(scenario.seed, "attitude.libration"),
        offsets_rad=(
            float(np.radians(a.yaw_offset_deg)),
            float(np.radians(a.roll_offset_deg)),
            float(np.radians(a.pitch_offset_deg)),
        ),
    )


def _spin(section: AttitudeSection, inertia: FloatArray, time: TimeArray, start: np.datetime64) -> Attitude:
    off_diagonal = inertia - np.diag(np.diag(inertia))
    if np.abs(off_diagonal).max() > 1e-9 * np.diag(inertia).max():
        raise BadInput(
            "the inertia tensor has products of inertia",
            where="spacecraft.inertia_kg_m2",
            wanted="principal axes along the body axes for mode spin (or mode tumble)",
        )
    return attitude.spin(
        time,
        np.diag(inertia),
        np.array(section.spin_axis_N),
        section.spin_rate_rpm * 2.0 * np.pi / 60.0,
        nutation_rad=float(np.radians(section.nutation_deg)),
        phase_rad=float(np.radians(section.phase_deg)),
        epoch=start,
    )


@dataclass(frozen=True)
class ScenarioMotion:
    """Motion along a scenario's orbit with its prescribed attitude."""

    scenario: Scenario
    world: World
    """The world at the stamps."""
    attitude: Attitude
    """The true attitude at the stamps."""

    def at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position [km] and velocity [km/s] (N, 3), GCRS, and R_BN, `offset_s` (or (N,)) after each stamp."""
        if not np.any(offset_s):
            return self.world.r_N_km, self.world.v_N_km_s, self.attitude.R_BN
        start = self.world.time[0]
        time = epoch.add_seconds(start, epoch.seconds_since(self.world.time, start) + offset_s)
        r, v = ephemeris(self.scenario, time)
        later = world_along(self.scenario, time, self.world.segment, r, v, with_field=False)
        return r, v, true_attitude(self.scenario, later).R_BN
