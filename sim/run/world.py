"""The world a spacecraft flies through: times, orbit, stations, sun, shadow and the field that acts.

It holds nothing random and nothing of the spacecraft, so one world serves any number of runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames, sun, tle
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.earth.stations import Station, in_view
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import OrbitSection


@dataclass(frozen=True)
class World:
    """Geometry and ambient field at N samples (see the field units in the names)."""

    time: TimeArray
    segment: FloatArray
    """(N,) number of the schedule's segment, from 0."""
    r_N_km: FloatArray
    v_N_km_s: FloatArray
    R_ON: Rotation
    sun_N: FloatArray
    """(N, 3) unit vector from the spacecraft to the sun."""
    illumination: FloatArray
    """(N,) share of the sun's disc in view."""
    field_N_nT: FloatArray


def build_world(scenario: Scenario) -> World:
    """The world of a scenario with [orbit] and [schedule].

    Raises BadInput for segments that overlap or lie wholly out of view of the stations, and OutOfRange for epochs
    outside the field model.
    """
    time, segment = schedule_times(scenario)
    r_N_km, v_N_km_s = ephemeris(scenario, time)
    if scenario.schedule is not None and scenario.schedule.in_view_of_stations:
        kept, segment = seen_from_stations(scenario, time, segment, r_N_km)
        time, r_N_km, v_N_km_s = time[kept], r_N_km[kept], v_N_km_s[kept]
    return world_along(scenario, time, segment, r_N_km, v_N_km_s)


def world_along(
    scenario: Scenario,
    time: TimeArray,
    segment: FloatArray,
    r_N_km: FloatArray,
    v_N_km_s: FloatArray,
    *,
    with_field: bool = True,
) -> World:
    """The world along a given trajectory, shapes (N,), (N,), (N, 3), (N, 3); without the field it is NaN."""
    field_nT = np.full((time.size, 3), np.nan)
    if with_field:
        model = load_field(scenario.field.truth, degree=scenario.field.truth_degree)
        field_nT = field_N_nT(model, time, r_N_km)
    sun_N_km = sun.sun_N_km(time)
    return World(
        time=time,
        segment=segment,
        r_N_km=r_N_km,
        v_N_km_s=v_N_km_s,
        R_ON=frames.rotation_ON(r_N_km, v_N_km_s),
        sun_N=sun.sun_direction_N(time, r_N_km),
        illumination=sun.illumination(r_N_km, sun_N_km),
        field_N_nT=field_nT,
    )


def stations_of(scenario: Scenario) -> list[Station]:
    """The stations in the order of the scenario."""
    return [
        Station(
            name,
            float(np.radians(entry.latitude_deg)),
            float(np.radians(entry.longitude_deg)),
            entry.altitude_km,
            float(np.radians(entry.mask_deg)),
        )
        for name, entry in scenario.station.items()
    ]


def seen_from_stations(
    scenario: Scenario, time: TimeArray, segment: FloatArray, r_N_km: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """(N,) True in the rows that some station sees, and for those rows the number of the stretch in view, from 0.

    Raises BadInput where no row is seen.
    """
    r_E_km = frames.rotation_EN(time).apply(r_N_km)
    seen: BoolArray = np.asarray((in_view(stations_of(scenario), r_E_km) > 0).any(axis=1))
    if not seen.any():
        raise BadInput(
            "no sample is in view of any station",
            where="schedule.in_view_of_stations",
            wanted="a longer schedule, a lower mask_deg, or other stations",
        )
    fresh = np.concatenate([[True], ~seen[:-1] | (np.diff(segment) != 0)])
    stretch = np.cumsum(fresh & seen) - 1.0
    return seen, np.asarray(stretch[seen])


def schedule_times(scenario: Scenario) -> tuple[TimeArray, FloatArray]:
    """All sample times (N,) and the number of the segment each belongs to (N,)."""
    assert scenario.schedule is not None
    times, numbers = [], []
    for number, part in enumerate(scenario.schedule.segments):
        # UTC stamps of a segment; samples that fall inside a leap second have no stamp of their own and are left out.
        start = epoch.parse_time(part.start_utc)
        seconds = part.step_s * np.arange(part.count, dtype=np.float64)
        stamps = epoch.add_seconds(start, seconds)
        kept = np.abs(epoch.seconds_since(stamps, start) - seconds) < 1e-6
        stamps = stamps[kept]
        times.append(stamps)
        numbers.append(np.full(stamps.size, float(number)))
    time, segment = np.concatenate(times), np.concatenate(numbers)
    if (np.diff(time.astype("int64")) <= 0).any():
        raise BadInput(
            "two segments overlap or are out of order",
            where="schedule.segments",
            wanted="segments in time order, each starting after the one before has ended",
        )
    return time, segment


def ephemeris(scenario: Scenario, time: TimeArray) -> tuple[FloatArray, FloatArray]:
    """Position [km] and velocity [km/s], GCRS, each (N, 3), of the scenario's orbit."""
    assert scenario.orbit is not None
    if scenario.orbit.tle is not None:
        return tle.read_tle(scenario.path_of(scenario.orbit.tle)).propagate(time)
    return orbit_from(scenario.orbit).propagate(time)


def orbit_from(section: OrbitSection) -> Orbit:
    """The orbit of a scenario's elements."""
    assert section.epoch_utc is not None and section.altitude_km is not None
    assert section.inclination_deg is not None and section.raan_deg is not None
    assert section.argument_of_latitude_deg is not None
    return Orbit(
        epoch_utc=epoch.parse_time(section.epoch_utc),
        altitude_km=section.altitude_km,
        eccentricity=section.eccentricity,
        inclination_rad=np.radians(section.inclination_deg),
        raan_rad=np.radians(section.raan_deg),
        argument_of_perigee_rad=np.radians(section.argument_of_perigee_deg),
        argument_of_latitude_rad=np.radians(section.argument_of_latitude_deg),
    )
