"""Small numbers that stand in the text: what the LSB leaves, direction errors, the dipole of equation 20, the poles."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from fluxtwin.calib.attitude.yaw import yaw_full
from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.mission import Flight
from fluxtwin.scenarios.hcmm_orbit.geometry import angle_between
from fluxtwin.scenarios.hcmm_orbit.record import read_stations
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM, NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_E_nT, field_N_nT, load_field
from fluxtwin.sim.run.world import orbit_from
from fluxtwin.sim.scenario.scenario import Scenario


def run_accuracy(
    config: Scenario, flight: Flight, calibration: Calibration, bias_nT: FloatArray, ground: FieldModel
) -> Numbers:
    """Evaluate them on the three days of Table 5. bias_nT: (3,) of a calibration with S = T = 0."""
    truth = load_field(config.field.truth)
    strength = np.linalg.norm(flight.world.field_N_nT, axis=1) / NT_PER_MG
    calibrated = calibration.apply(flight.telemetry.mag_B_nT)
    model_N = field_N_nT(ground, flight.world.time, flight.world.r_N_km)
    sun_error, nadir_error = _sensor_errors(flight)
    raw = angle_between(flight.telemetry.mag_B_nT, flight.truth.field_B_nT)
    ways = {
        "raw": Calibration(np.zeros((3, 3)), np.zeros(3)),
        "b": Calibration(np.zeros((3, 3)), bias_nT),
        "b, S": calibration,
    }
    yaw_error = {name: _yaw_error_deg(flight, way, model_N) for name, way in ways.items()}
    wanted = mission.quantity("yaw wanted")
    return Numbers(
        # Residual in field strength with the LSB as the only error, the true S and b.
        lsb_scalar_mG=_lsb_scalar(config),
        # Weakest and strongest field along the passes.
        field_mG=(float(strength.min()), float(strength.max())),
        # [deg] rms angle of the calibrated reading, and of the ground's model, to the true field.
        direction_noise=_rms_deg(angle_between(calibrated, flight.truth.field_B_nT)),
        direction_model=_rms_deg(angle_between(model_N, flight.world.field_N_nT)),
        # [deg] rms error of measured sun and nadir in the plane of both, heads 2 and 3.
        sun_error=sun_error,
        nadir_error=nadir_error,
        # Equatorial field of the dipole part of the field of 1978 at HCMM's altitude.
        dipole_equator_mG=_dipole_equator(config, truth),
        # Arc from Orroral to the southern, from Fairbanks to the northern pole of that dipole; the same to the points
        # where the field is vertical at the ground.
        dipole_pole_deg=_arcs(*_dipole_axis(truth, flight.world.time[0])),
        dip_pole_deg=_arcs(*_dip_poles(truth, flight.world.time[0])),
        # [deg] rms and largest angle between the reading as it is and the true field.
        raw_direction=(_rms_deg(raw), float(np.degrees(raw.max()))),
        # Share of the samples whose yaw, with roll and pitch known, errs by less than was wanted, and the median error.
        yaw_known={name: float((error < wanted).mean()) for name, error in yaw_error.items()},
        yaw_median={name: float(np.median(error)) for name, error in yaw_error.items()},
        # Share of the samples with roll, pitch and yaw within the limits of the mission.
        attitude_within=np.mean(_within(flight)),
    )


def _lsb_scalar(config: Scenario) -> float:
    flight = mission.fly(mission.only(config, "lsb").updated({"sun_sensor.1.misalignment_deg": None}))
    known = Calibration(flight.truth.S, flight.truth.b_nT)
    measured = np.linalg.norm(known.apply(flight.telemetry.mag_B_nT), axis=1)
    return float(np.sqrt(np.mean((measured - np.linalg.norm(flight.truth.field_B_nT, axis=1)) ** 2)) / NT_PER_MG)


def _sensor_errors(flight: Flight) -> tuple[float, float]:
    """rms errors of sun and nadir in the plane that holds both, where heads 2 and 3 see the sun [deg]."""
    t = flight.telemetry
    assert t.sun_B is not None and t.nadir_B is not None and t.sun_sensor_head is not None
    rows = np.flatnonzero(np.isin(t.sun_sensor_head, (2, 3)))
    R_BN = frames.rotation_from_q(flight.truth.q_NB[rows])
    sun_B, nadir_B = R_BN.apply(flight.world.sun_N[rows]), R_BN.apply(-flight.world.r_N_km[rows])
    computed = angle_between(sun_B, nadir_B)
    by_sun = angle_between(np.array(t.sun_B)[rows], nadir_B) - computed
    by_nadir = angle_between(sun_B, np.array(t.nadir_B)[rows]) - computed
    return _rms_deg(by_sun), _rms_deg(by_nadir)


def _yaw_error_deg(flight: Flight, calibration: Calibration, model_N_nT: FloatArray) -> FloatArray:
    """(N,) size of the error of yaw from the magnetometer, roll and pitch being known."""
    field_O = flight.world.R_ON.apply(model_N_nT)
    found = yaw_full(
        calibration.apply(flight.telemetry.mag_B_nT), field_O, flight.truth.roll_rad, flight.truth.pitch_rad
    )
    off = found - flight.truth.yaw_rad
    return np.asarray(np.abs(np.degrees(np.arctan2(np.sin(off), np.cos(off)))))


def _within(flight: Flight) -> FloatArray:
    limits = np.radians([mission.quantity(f"{angle} wanted") for angle in ("roll", "pitch", "yaw")])
    angles = np.stack([flight.truth.roll_rad, flight.truth.pitch_rad, flight.truth.yaw_rad], axis=1)
    return np.asarray((np.abs(angles) <= limits).all(axis=1), dtype=np.float64)


def _dipole_equator(config: Scenario, truth: FieldModel) -> float:
    assert config.orbit is not None and config.schedule is not None
    when = np.datetime64("1978-11-30", "ns")
    g10, g11, h11 = truth.coefficients_nT(when)[0, :3]
    ratio = FIELD_RADIUS_KM / orbit_from(config.orbit).semi_major_axis_km
    return float(np.sqrt(g10**2 + g11**2 + h11**2) * ratio**3 / NT_PER_MG)


def _dipole_axis(truth: FieldModel, when: np.datetime64) -> tuple[FloatArray, FloatArray]:
    """Unit vectors to the southern and the northern geomagnetic pole."""
    g10, g11, h11 = truth.coefficients_nT(when)[0, :3]
    south = np.array([g11, h11, g10]) / np.sqrt(g10**2 + g11**2 + h11**2)
    return south, -south


def _dip_poles(truth: FieldModel, when: np.datetime64) -> tuple[FloatArray, FloatArray]:
    """Unit vectors to where the field is vertical at the ground, south and north, searched from the dipole's poles."""
    found = []
    for start in _dipole_axis(truth, when):
        latitude, longitude, _ = frames.geocentric(start)

        def horizontal(at: FloatArray) -> float:
            r_E = frames.from_geocentric(at[:1], at[1:], np.array([FIELD_RADIUS_KM]))
            field = field_E_nT(truth, when, r_E)[0]
            up = r_E[0] / FIELD_RADIUS_KM
            return float(np.linalg.norm(field - (field @ up) * up))

        best = minimize(
            horizontal,
            np.array([latitude[0], longitude[0]]),
            method="Nelder-Mead",
            options={"xatol": 1e-5, "fatol": 1e-3, "maxiter": 600},
        ).x
        found.append(frames.from_geocentric(best[:1], best[1:], np.ones(1))[0])
    return found[0], found[1]


def _arcs(south: FloatArray, north: FloatArray) -> tuple[float, float]:
    """Arc from Orroral to the southern, from Fairbanks to the northern of two poles [deg]."""
    stations = read_stations()
    pairs = ((stations["ORR"], south), (stations["ULA"], north))
    to_orr, to_ula = (float(np.degrees(angle_between(s.r_E_km[None, :], pole[None, :])[0])) for s, pole in pairs)
    return to_orr, to_ula


def _rms_deg(angle: FloatArray) -> float:
    return float(np.degrees(np.sqrt(np.mean(angle**2))))
