"""Table 6: expected yaw error over the stations; figure 3: a pass over Winkfield, and its error bar."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.attitude.yaw import yaw_from_field, yaw_full, yaw_sigma
from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.pass_study import compare
from fluxtwin.scenarios.hcmm_orbit.geometry import angle_between
from fluxtwin.scenarios.hcmm_orbit.record import read_stations
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.yaw_comparison import compare_yaw
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_N_nT, load_field
from fluxtwin.sim.earth.stations import find_contacts
from fluxtwin.sim.run.scenario_stations import stations_of
from fluxtwin.sim.run.world import ephemeris
from fluxtwin.sim.scenario.scenario import Scenario

DIPOLE_MG = mission.quantity("dipole equator")
SIGMA_B_MG = mission.quantity("yaw sigma_B")
SIGMA_DEG = mission.quantity("yaw sigma_theta")
PRINTED_SIGMA_DEG = mission.quantity("yaw sigma_theta as printed")
"""What Table 6's text prints for the angle; ten times too much to give its numbers."""
STEP_S = 4.0
_DRAWS = 2000
_DAYS, _NEAR_DEG = 20, 2.0
"""For the field over a station: days of orbit, and how near the ground track must come."""
_FIGURE_DAY = np.datetime64("1978-11-29T11:20:00", "ns")
_PRINTED_START = np.datetime64("1978-11-29T11:35:00", "ns")


def run_yaw(config: Scenario, calibration: Calibration, ground: FieldModel, progress: Progress) -> Numbers:
    """Evaluate equation 11 over the stations and fly the pass of figure 3."""
    progress("yaw over the stations", 0.0)
    stations = tuple(_station(config, row["station"]) for row in mission.read_table("yaw"))
    progress("figure 3", 0.6)
    contact = next(
        item
        for item in find_contacts(
            [s for s in stations_of(config) if s.name == "WNK"],
            lambda time: ephemeris(config, time),
            _FIGURE_DAY,
            epoch.add_seconds(_FIGURE_DAY, 3600.0)[0],
        )
    )
    samples = int(contact.seconds // STEP_S) + 1
    short = config.updated(
        {
            "schedule.segments": [{"start_utc": f"{contact.rise}Z", "samples": samples, "step_s": STEP_S}],
            "schedule.in_view_of_stations": None,
        }
    )
    flight = mission.fly(short)
    solution = yaw_from_field(flight.telemetry, calibration, ground, sigma_angle_rad=float(np.radians(SIGMA_DEG)))
    found, reference = solution.yaw_rad, solution.yaw_reference_rad
    truth = flight.truth.yaw_rad[solution.rows]
    angles = compare(flight.telemetry, calibration, ground)
    d_se, d_em = (float(np.degrees(np.sqrt(np.nanmean(v**2)))) for v in (angles.sun_nadir, angles.nadir_field))
    sun_nadir = angles.computed_deg["sun_nadir"]
    winkfield = next(row for row in stations if row.station == "WNK")
    return Numbers(
        stations=stations,
        figure=compare_yaw(flight.telemetry, solution),
        # The pass of figure 3 by our orbit, its rise less the printed 11 h 35 min, and the range of the sun-nadir angle.
        contact=contact,
        minutes_late=epoch.seconds_since(contact.rise, _PRINTED_START)[0] / 60.0,
        sun_nadir_deg=(float(sun_nadir.min()), float(sun_nadir.max())),
        delta_sun_nadir_deg=d_se,
        delta_nadir_field_deg=d_em,
        # By the papers' rule: the mean of the nadir-field residual and Table 6.
        error_bar_deg=0.5 * (d_em + winkfield.dipole),
        # Magnetometer less sun-sensor yaw, sun-sensor less true yaw, magnetometer less true yaw; single samples.
        yaw_rms_deg=_rms_deg(found - reference),
        sun_yaw_rms_deg=_rms_deg(reference - truth),
        magnetometer_yaw_rms_deg=_rms_deg(found - truth),
    )


def equation_11(latitude_deg: float, sigma_deg: float) -> float:
    """Yaw sigma [deg] over a latitude in the papers' dipole, DIPOLE_MG (cos l, 0, 2 sin l)."""
    return float(np.degrees(yaw_sigma(_dipole_nT(latitude_deg), SIGMA_B_MG * NT_PER_MG, np.radians(sigma_deg))[0]))


def _dipole_nT(latitude_deg: float) -> FloatArray:
    angle = np.radians(latitude_deg)
    return DIPOLE_MG * NT_PER_MG * np.array([[np.cos(angle), 0.0, 2.0 * np.sin(angle)]])


def _station(config: Scenario, name: str) -> Numbers:
    """One row of Table 6, deg."""
    latitude = float(np.degrees(read_stations()[name].latitude_rad))
    return Numbers(
        station=name,
        printed=mission.printed_value("yaw", "yaw_deg", station=name),
        # Equation 11 in the papers' dipole, with the angle that gives their numbers and with the printed one.
        dipole=equation_11(latitude, SIGMA_DEG),
        dipole_printed_sigma=equation_11(latitude, PRINTED_SIGMA_DEG),
        # In the field of 1978, rms of the sigmas of all passes near the station, northbound and southbound.
        main_field=_in_main_field(config, name),
        # Monte Carlo in the dipole: scatter of yaw for such errors.
        scatter=_scatter(config, latitude),
    )


def _in_main_field(config: Scenario, name: str) -> float:
    """Equation 11 where the ground track passes within _NEAR_DEG of the station, rms of the sigmas."""
    assert config.schedule is not None
    start = epoch.parse_time(config.schedule.segments[0].start_utc)
    time = epoch.add_seconds(start, np.arange(0.0, _DAYS * 86400.0, 10.0))
    r_N_km, v_N_km_s = ephemeris(config, time)
    R_EN = frames.rotation_EN(time)
    r_E_km = R_EN.apply(r_N_km)
    site = np.broadcast_to(read_stations()[name].r_E_km, r_E_km.shape)
    near = np.flatnonzero(np.degrees(angle_between(r_E_km, site)) < _NEAR_DEG)
    field_N = field_N_nT(load_field(config.field.truth), time[near], r_N_km[near])
    field_O = frames.rotation_ON(r_N_km[near], v_N_km_s[near]).apply(field_N)
    sigma = np.degrees(yaw_sigma(field_O, SIGMA_B_MG * NT_PER_MG, np.radians(SIGMA_DEG)))
    return float(np.sqrt(np.mean(sigma**2)))


def _scatter(config: Scenario, latitude_deg: float) -> float:
    """Scatter of the full yaw solution in the dipole for normal errors of field, roll and pitch."""
    rng = stream(config.seed, f"hcmm.table_6.{latitude_deg:.3f}")
    field = np.repeat(_dipole_nT(latitude_deg), _DRAWS, axis=0)
    noisy = field + rng.normal(0.0, SIGMA_B_MG * NT_PER_MG, size=field.shape)
    roll, pitch = rng.normal(0.0, np.radians(SIGMA_DEG), size=(2, _DRAWS))
    return float(np.degrees(np.std(yaw_full(noisy, field, roll, pitch))))


def _rms_deg(angle: FloatArray) -> float:
    wrapped = np.arctan2(np.sin(angle), np.cos(angle))
    return float(np.degrees(np.sqrt(np.nanmean(wrapped**2))))
