"""Expected yaw accuracy (equations 11-14) and what quantisation does to yaw; no calibration is needed here."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.attitude.yaw import yaw_first_order, yaw_full, yaw_sigma
from fluxtwin.plots.yaw import YawSigma
from fluxtwin.scenarios.flights import day
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.yaw_study import fine_scenario
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_E_nT, field_N_nT, load_field
from fluxtwin.sim.run.world import orbit_from
from fluxtwin.sim.scenario.scenario import Scenario

SIGMA_ANGLE_RAD = float(np.radians(0.1))
BASES = 400
_NEAR_EQUATOR_RAD = float(np.radians(1.0))


def run_accuracy(config: Scenario, ground: FieldModel, residual_mG: float, progress: Progress) -> Numbers:
    """Evaluate the papers' formulas in the field of 1978. residual_mG: of this run's calibration."""
    printed_mG = mission.printed_value("errors", "rms_mG", source="observed rms")
    progress("yaw accuracy along many orbits", 0.0)
    truth = load_field(config.field.truth)
    crossing_O = _equator_fields(config, truth)
    at_equator = np.degrees(yaw_sigma(crossing_O, printed_mG * NT_PER_MG, SIGMA_ANGLE_RAD))
    ours = np.degrees(yaw_sigma(crossing_O, residual_mG * NT_PER_MG, SIGMA_ANGLE_RAD))
    worst_orbit, worst_base, latitude, along = _worst_values(config, truth, printed_mG)
    printed_deg = mission.printed_value("yaw", "value", quantity="sigma_y pole max")
    progress("quantisation and the equations", 0.6)
    lsb = config.magnetometer.step_nT
    horizontal = np.sum(crossing_O[:, :2] ** 2, axis=1)
    mean, rms = _lsb_error(config)
    return Numbers(
        # Mean and range over equator crossings at the printed residual, and at this run's.
        sigma_equator_deg=at_equator.mean(),
        sigma_equator_range_deg=(float(at_equator.min()), float(at_equator.max())),
        sigma_equator_ours_deg=ours.mean(),
        figure=YawSigma(latitude, along, worst_orbit, worst_base, printed_deg),
        # Largest value of a data base of four orbits; share [%] of the data bases in which it is below the printed one,
        # and share [%] of single orbits in which it is above.
        worst_quantiles_deg={f"{q:g} %": float(np.percentile(worst_base, q)) for q in (5, 25, 50, 75, 95)},
        printed_percentile=100 * np.mean(worst_base < printed_deg),
        orbits_above=100 * np.mean(worst_orbit > printed_deg),
        # Yaw of one LSB of the X and Y reading, mean over equator crossings.
        lsb_x_deg=np.degrees(np.mean(lsb * np.abs(crossing_O[:, 1]) / horizontal)),
        lsb_y_deg=np.degrees(np.mean(lsb * np.abs(crossing_O[:, 0]) / horizontal)),
        # Yaw error along an orbit with quantisation alone.
        lsb_mean_deg=mean,
        lsb_rms_deg=rms,
        # X, Y, Z: median time that the field's motion along the orbit takes for one LSB.
        seconds_per_step=_seconds_per_step(config, truth),
        # Largest difference of equation 12 from the pseudo-inverse of equation 13; scatter of yaw over equation 14.
        equation_12_error_deg=_equation_12_error(crossing_O, config.seed),
        equation_14_ratio=_equation_14_ratio(config, truth, printed_mG),
        equator_field_mG=_equator_strength(truth),
        # Three times the rms direction error of IGRF 1975 at 600 and 800 km.
        field_direction_3sigma_deg=[_direction_3sigma(config, truth, ground, altitude) for altitude in (600.0, 800.0)],
    )


def _field_O(config: Scenario, model: FieldModel, time: TimeArray) -> tuple[FloatArray, FloatArray]:
    """Field in the orbital frame [nT] (N, 3) and geocentric latitude [rad] (N,) along Seasat's orbit."""
    assert config.orbit is not None
    r_N_km, v_N_km_s = orbit_from(config.orbit).propagate(time)
    R_EN = frames.rotation_EN(time)
    field = frames.rotation_ON(r_N_km, v_N_km_s).apply(field_N_nT(model, time, r_N_km, R_EN))
    return field, frames.geocentric(R_EN.apply(r_N_km))[0]


def _equator_fields(config: Scenario, model: FieldModel) -> FloatArray:
    """Field in O at samples within a degree of the equator, 30 days of the mission at 10 s."""
    time = epoch.add_seconds(day(geometry.DATA_DAYS[0]), np.arange(0.0, 30 * 86400.0, 10.0))
    field, latitude = _field_O(config, model, time)
    return field[np.abs(latitude) < _NEAR_EQUATOR_RAD]


def _worst_values(
    config: Scenario, model: FieldModel, residual_mG: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Largest sigma of single orbits and of data bases (92 + 88 + 101 + 44 minutes, starts at random), and
    latitude and sigma [deg] along the first orbit."""
    rng = stream(config.seed, "seasat.worst_yaw")
    largest: list[FloatArray] = []
    first = (np.zeros(0), np.zeros(0))
    for minutes in geometry.DATA_MINUTES:
        start_s = rng.uniform(0.0, 60 * 86400.0, size=BASES)
        seconds = (start_s[:, None] + 60.0 * np.arange(minutes)).ravel()
        field, latitude = _field_O(config, model, epoch.add_seconds(day(geometry.DATA_DAYS[0]), seconds))
        sigma = np.degrees(yaw_sigma(field, residual_mG * NT_PER_MG, SIGMA_ANGLE_RAD)).reshape(BASES, minutes)
        if not largest:
            first = (np.degrees(latitude[:minutes]), sigma[0])
        largest.append(sigma.max(axis=1))
    return np.concatenate(largest[:3]), np.max(largest, axis=0), *first


def _lsb_error(config: Scenario) -> tuple[float, float]:
    """Mean and rms [deg] of yaw error by quantisation alone where it is below 5 deg.

    Known S and b, the true field as model: what is left is the rounding.
    """
    quiet = mission.only(fine_scenario(config), "lsb").updated({"seed": config.seed})
    flight = mission.fly(quiet)
    field_O = flight.world.R_ON.apply(flight.world.field_N_nT)
    corrected = flight.telemetry.mag_B_nT @ (np.eye(3) + flight.truth.S).T + flight.truth.b_nT
    solved = yaw_full(corrected, field_O, flight.truth.roll_rad, flight.truth.pitch_rad)
    error = np.degrees(np.arctan2(np.sin(solved - flight.truth.yaw_rad), np.cos(solved - flight.truth.yaw_rad)))
    usable = np.where(np.abs(error) < 5.0, error, np.nan)
    return float(np.nanmean(usable)), float(np.sqrt(np.nanmean(usable**2)))


def _seconds_per_step(config: Scenario, model: FieldModel) -> tuple[float, float, float]:
    time = epoch.add_seconds(day(geometry.DATA_DAYS[0]), np.arange(0.0, 86400.0, 10.0))
    field, _ = _field_O(config, model, time)
    rate = np.abs(np.gradient(field, 10.0, axis=0))
    x, y, z = np.median(config.magnetometer.step_nT / np.maximum(rate, 1e-12), axis=0)
    return float(x), float(y), float(z)


def _equation_12_error(field_O_nT: FloatArray, seed: int) -> float:
    """Equation 12 against numerical least squares on equation 13 for random small angles [deg].

    Equation 13's vertical component of B0 is taken from the measured field, as equation 12 does.
    """
    rng = stream(seed, "seasat.equation_12")
    yaw, roll, pitch = rng.normal(0.0, np.radians(0.5), size=(3, len(field_O_nT)))
    B = frames.rotation_BO(yaw, roll, pitch).apply(field_O_nT)
    solved = []
    for b, b0, r, p in zip(B, field_O_nT, roll, pitch, strict=True):
        design = np.array([b0[1], -b0[0], 0.0])
        left = b - np.array([b0[0] - p * b[2], b0[1] + r * b[2], p * b0[0] - r * b0[1] + b0[2]])
        solved.append(np.linalg.lstsq(design[:, None], left, rcond=None)[0][0])
    return float(np.degrees(np.max(np.abs(np.array(solved) - yaw_first_order(B, field_O_nT, roll, pitch)))))


def _equation_14_ratio(config: Scenario, model: FieldModel, sigma_mG: float, draws: int = 400) -> float:
    time = epoch.add_seconds(day(geometry.DATA_DAYS[0]), np.arange(0.0, 6040.0, 60.0))
    field, _ = _field_O(config, model, time)
    expected = yaw_sigma(field, sigma_mG * NT_PER_MG, SIGMA_ANGLE_RAD)
    rng = stream(config.seed, "seasat.equation_14")
    noisy = field + rng.normal(0.0, sigma_mG * NT_PER_MG, size=(draws, *field.shape))
    roll, pitch = rng.normal(0.0, SIGMA_ANGLE_RAD, size=(2, draws, len(field)))
    found = np.array([yaw_first_order(noisy[k], field, roll[k], pitch[k]) for k in range(draws)])
    return float(np.median(found.std(axis=0) / expected))


def _equator_strength(model: FieldModel) -> float:
    longitude = np.radians(np.arange(0.0, 360.0, 1.0))
    radius = np.full_like(longitude, geometry.SEMI_MAJOR_AXIS_KM)
    r_E_km = frames.from_geocentric(np.zeros_like(longitude), longitude, radius)
    field = field_E_nT(model, day(geometry.DATA_DAYS[0]), r_E_km)
    return float(np.mean(np.linalg.norm(field, axis=1)) / NT_PER_MG)


def _direction_3sigma(config: Scenario, truth: FieldModel, ground: FieldModel, altitude_km: float) -> float:
    """Three times the rms angle between the two models along ten days at an altitude [deg]."""
    assert config.orbit is not None
    other = config.updated({"orbit.altitude_km": altitude_km})
    time = epoch.add_seconds(day(geometry.DATA_DAYS[0]), np.arange(0.0, 10 * 86400.0, 60.0))
    a, b = (_field_O(other, model, time)[0] for model in (truth, ground))
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))
    return float(3 * np.degrees(np.sqrt(np.mean(angle**2))))
