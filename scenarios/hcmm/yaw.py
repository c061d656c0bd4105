"""Yaw: Table 6, the expected error over the stations; figure 3, a pass over Winkfield, and its error bar; and small numbers
that are in the text: what the LSB leaves, direction errors, the dipole of equation 20, the poles."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from fluxtwin.calib.attitude.yaw import yaw_from_field, yaw_full, yaw_sigma
from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.flights import Numbers, compare_yaw, rms, wrapped_deg
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.mission import Flight
from fluxtwin.scenarios.hcmm.passes import compare
from fluxtwin.scenarios.hcmm_orbit.record import read_stations
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM, NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_E_nT, field_N_nT, load_field
from fluxtwin.sim.earth.stations import find_contacts
from fluxtwin.sim.effects.ambient_field import dipole_axis_E
from fluxtwin.sim.run.world import ephemeris, orbit_from, stations_of
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
    winkfield = [station for station in stations_of(config) if station.name == "WNK"]
    end = epoch.add_seconds(_FIGURE_DAY, 3600.0)[0]
    contact = next(iter(find_contacts(winkfield, lambda time: ephemeris(config, time), _FIGURE_DAY, end)))
    samples = int(contact.seconds // STEP_S) + 1
    segment = {"start_utc": f"{contact.rise}Z", "samples": samples, "step_s": STEP_S}
    flight = mission.fly(config.updated({"schedule.segments": [segment], "schedule.in_view_of_stations": None}))
    solution = yaw_from_field(flight.telemetry, calibration, ground, sigma_angle_rad=float(np.radians(SIGMA_DEG)))
    found, reference = solution.yaw_rad, solution.yaw_reference_rad
    truth = flight.truth.yaw_rad[solution.rows]
    angles = compare(flight.telemetry, calibration, ground)
    nadir_field_deg, sun_nadir = rms(angles.nadir_field), angles.computed_deg["sun_nadir"]
    return Numbers(
        stations=stations,
        figure=compare_yaw(flight.telemetry, solution),
        # The pass of figure 3 by our orbit, its rise less the printed 11 h 35 min, and the range of the sun-nadir angle.
        contact=contact,
        minutes_late=epoch.seconds_since(contact.rise, _PRINTED_START)[0] / 60.0,
        sun_nadir_deg=(float(sun_nadir.min()), float(sun_nadir.max())),
        delta_sun_nadir_deg=rms(angles.sun_nadir),
        delta_nadir_field_deg=nadir_field_deg,
        # By the papers' rule: the mean of the nadir-field residual and Table 6.
        error_bar_deg=0.5 * (nadir_field_deg + next(row.dipole for row in stations if row.station == "WNK")),
        # Magnetometer less sun-sensor yaw, sun-sensor less true yaw, magnetometer less true yaw; single samples.
        yaw_rms_deg=rms(wrapped_deg(found - reference)),
        sun_yaw_rms_deg=rms(wrapped_deg(reference - truth)),
        magnetometer_yaw_rms_deg=rms(wrapped_deg(found - truth)),
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
    # Equation 11 where the ground track passes within _NEAR_DEG of the station, rms of the sigmas.
    assert config.schedule is not None
    start = epoch.parse_time(config.schedule.segments[0].start_utc)
    time = epoch.add_seconds(start, np.arange(0.0, _DAYS * 86400.0, 10.0))
    r_N_km, v_N_km_s = ephemeris(config, time)
    r_E_km = frames.rotation_EN(time).apply(r_N_km)
    site = np.broadcast_to(read_stations()[name].r_E_km, r_E_km.shape)
    near = np.flatnonzero(np.degrees(frames.angle_between(r_E_km, site)) < _NEAR_DEG)
    field_N = field_N_nT(load_field(config.field.truth), time[near], r_N_km[near])
    field_O = frames.rotation_ON(r_N_km[near], v_N_km_s[near]).apply(field_N)
    rng = stream(config.seed, f"hcmm.table_6.{latitude:.3f}")
    field = np.repeat(_dipole_nT(latitude), _DRAWS, axis=0)
    noisy = field + rng.normal(0.0, SIGMA_B_MG * NT_PER_MG, size=field.shape)
    roll, pitch = rng.normal(0.0, np.radians(SIGMA_DEG), size=(2, _DRAWS))
    return Numbers(
        station=name,
        printed=mission.printed_value("yaw", "yaw_deg", station=name),
        # Equation 11 in the papers' dipole, with the angle that gives their numbers and with the printed one.
        dipole=equation_11(latitude, SIGMA_DEG),
        dipole_printed_sigma=equation_11(latitude, PRINTED_SIGMA_DEG),
        # In the field of 1978, rms of the sigmas of all passes near the station, northbound and southbound.
        main_field=rms(np.degrees(yaw_sigma(field_O, SIGMA_B_MG * NT_PER_MG, np.radians(SIGMA_DEG)))),
        # Monte Carlo in the dipole: scatter of yaw for such errors.
        scatter=float(np.degrees(np.std(yaw_full(noisy, field, roll, pitch)))),
    )


def run_accuracy(
    config: Scenario, flight: Flight, calibration: Calibration, bias_nT: FloatArray, ground: FieldModel
) -> Numbers:
    """The small numbers, on the three days of Table 5. bias_nT: (3,) of a calibration with S = T = 0."""
    truth = load_field(config.field.truth)
    world, when = flight.world, flight.world.time[0]
    strength = np.linalg.norm(world.field_N_nT, axis=1) / NT_PER_MG
    calibrated = calibration.apply(flight.telemetry.mag_B_nT)
    model_N = field_N_nT(ground, world.time, world.r_N_km)
    sun_error, nadir_error = _sensor_errors(flight)
    raw = np.degrees(frames.angle_between(flight.telemetry.mag_B_nT, flight.truth.field_B_nT))
    none = np.zeros((3, 3))
    ways = {"raw": Calibration(none, np.zeros(3)), "b": Calibration(none, bias_nT), "b, S": calibration}
    yaw_error = {name: _yaw_error_deg(flight, way, model_N) for name, way in ways.items()}
    limits = {angle: np.radians(mission.quantity(f"{angle} wanted")) for angle in ("roll", "pitch", "yaw")}
    within = [np.abs(getattr(flight.truth, f"{angle}_rad")) <= limit for angle, limit in limits.items()]
    north, south = dipole_axis_E(truth, when), -dipole_axis_E(truth, when)
    assert config.orbit is not None
    degree_1_nT = truth.coefficients_nT(np.datetime64("1978-11-30", "ns"))[0, :3]
    ratio = FIELD_RADIUS_KM / orbit_from(config.orbit).semi_major_axis_km
    return Numbers(
        # Residual in field strength with the LSB as the only error, the true S and b.
        lsb_scalar_mG=_lsb_scalar(config),
        # Weakest and strongest field along the passes.
        field_mG=(float(strength.min()), float(strength.max())),
        # [deg] rms angle of the calibrated reading, and of the ground's model, to the true field.
        direction_noise=rms(np.degrees(frames.angle_between(calibrated, flight.truth.field_B_nT))),
        direction_model=rms(np.degrees(frames.angle_between(model_N, world.field_N_nT))),
        # [deg] rms error of measured sun and nadir in the plane of both, heads 2 and 3.
        sun_error=sun_error,
        nadir_error=nadir_error,
        # Equatorial field of the dipole part of the field of 1978 at HCMM's altitude.
        dipole_equator_mG=float(np.linalg.norm(degree_1_nT) * ratio**3 / NT_PER_MG),
        # Arc from Orroral to the southern, from Fairbanks to the northern pole of that dipole; the same to the points
        # where the field is vertical at the ground.
        dipole_pole_deg=_arcs(south, north),
        dip_pole_deg=_arcs(*(_dip_pole(truth, when, start) for start in (south, north))),
        # [deg] rms and largest angle between the reading as it is and the true field.
        raw_direction=(rms(raw), float(raw.max())),
        # Share of the samples whose yaw, with roll and pitch known, errs by less than was wanted, and the median error.
        yaw_known={name: float((error < np.degrees(limits["yaw"])).mean()) for name, error in yaw_error.items()},
        yaw_median={name: float(np.median(error)) for name, error in yaw_error.items()},
        # Share of the samples with roll, pitch and yaw within the limits of the mission.
        attitude_within=np.mean(np.all(within, axis=0)),
    )


def _lsb_scalar(config: Scenario) -> float:
    flight = mission.fly(mission.only(config, "lsb").updated({"sun_sensor.1.misalignment_deg": None}))
    known = Calibration(flight.truth.S, flight.truth.b_nT)
    measured = np.linalg.norm(known.apply(flight.telemetry.mag_B_nT), axis=1)
    return rms(measured - np.linalg.norm(flight.truth.field_B_nT, axis=1)) / NT_PER_MG


def _sensor_errors(flight: Flight) -> tuple[float, float]:
    """rms errors of sun and nadir in the plane that holds both, where heads 2 and 3 see the sun [deg]."""
    t = flight.telemetry
    assert t.sun_B is not None and t.nadir_B is not None and t.sun_sensor_head is not None
    rows = np.flatnonzero(np.isin(t.sun_sensor_head, (2, 3)))
    R_BN = frames.rotation_from_q(flight.truth.q_NB[rows])
    sun_B, nadir_B = R_BN.apply(flight.world.sun_N[rows]), R_BN.apply(-flight.world.r_N_km[rows])
    computed = frames.angle_between(sun_B, nadir_B)
    by_sun = frames.angle_between(np.array(t.sun_B)[rows], nadir_B) - computed
    by_nadir = frames.angle_between(sun_B, np.array(t.nadir_B)[rows]) - computed
    return rms(np.degrees(by_sun)), rms(np.degrees(by_nadir))


def _yaw_error_deg(flight: Flight, calibration: Calibration, model_N_nT: FloatArray) -> FloatArray:
    """(N,) size of the error of yaw from the magnetometer, roll and pitch being known."""
    field_B, field_O = calibration.apply(flight.telemetry.mag_B_nT), flight.world.R_ON.apply(model_N_nT)
    found = yaw_full(field_B, field_O, flight.truth.roll_rad, flight.truth.pitch_rad)
    return np.abs(wrapped_deg(found - flight.truth.yaw_rad))


def _dip_pole(truth: FieldModel, when: np.datetime64, start: FloatArray) -> FloatArray:
    """Unit vector to where the field is vertical at the ground, searched from a pole of the dipole."""

    def horizontal(at: FloatArray) -> float:
        r_E = frames.from_geocentric(at[:1], at[1:], np.array([FIELD_RADIUS_KM]))
        field = field_E_nT(truth, when, r_E)[0]
        up = r_E[0] / FIELD_RADIUS_KM
        return float(np.linalg.norm(field - (field @ up) * up))

    latitude, longitude, _ = frames.geocentric(start)
    best = minimize(
        horizontal,
        np.array([latitude[0], longitude[0]]),
        method="Nelder-Mead",
        options={"xatol": 1e-5, "fatol": 1e-3, "maxiter": 600},
    ).x
    return np.asarray(frames.from_geocentric(best[:1], best[1:], np.ones(1))[0])


def _arcs(south: FloatArray, north: FloatArray) -> tuple[float, float]:
    """Arc from Orroral to the southern, from Fairbanks to the northern of two poles [deg]."""
    stations = read_stations()
    pairs = ((stations["ORR"], south), (stations["ULA"], north))
    to_orr, to_ula = (float(np.degrees(frames.angle_between(s.r_E_km[None, :], pole[None, :])[0])) for s, pole in pairs)
    return to_orr, to_ula
