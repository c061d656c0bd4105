"""Yaw from the magnetometer: figures 1 and 2 on day 205, day 279, and the accuracy to be expected (equations 11-14).

The papers do not say how large Seasat's yaw was, and that decides whether yaw = 0 is the better estimate; so
the amplitude of a prescribed motion is swept and the crossover reported.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.attitude.yaw import yaw_first_order, yaw_from_field, yaw_full, yaw_sigma
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.residuals import residuals_of
from fluxtwin.plots.yaw import YawComparison
from fluxtwin.scenarios.flights import Numbers, compare_yaw, day, latitude_deg, prescribed, rms, rms_along, wrapped_deg
from fluxtwin.scenarios.seasat import mission
from fluxtwin.scenarios.seasat.calibration import calibrations, reference_error_rad
from fluxtwin.scenarios.seasat.geometry import CHECK_DAY, DATA_DAYS, DATA_MINUTES, SEMI_MAJOR_AXIS_KM
from fluxtwin.scenarios.seasat.mission import Flight
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_E_nT, field_N_nT, load_field
from fluxtwin.sim.run.world import build_world, orbit_from
from fluxtwin.sim.scenario.scenario import Scenario

STEP_S = 4.0
"""Assumed spacing of the samples in the figures; the papers do not give it."""
ORBIT_SAMPLES = 1510
AMPLITUDES_DEG = (0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0)
SEEDS = 10
BASES = 400
SIGMA_ANGLE_RAD = float(np.radians(0.1))
_CHECK_MINUTES = 125
_DRAWS = 400
_START = day(DATA_DAYS[0])


def run_yaw(config: Scenario, full: Calibration, ground: FieldModel, progress: Progress) -> Numbers:
    """Calibrate with a mean bias, solve for yaw both ways, sweep the true amplitude, check day 279."""
    progress("yaw on day 205", 0.0)
    bias_only = calibrations(mission.fly(config), ground)[1]
    fine = mission.fly(fine_scenario(config))
    figure_1, figure_2 = (_compared(fine, c, ground) for c in (bias_only, full))
    sweep = _sweep(config, fine, ground, progress)
    progress("day 279", 0.9)
    return Numbers(
        bias_errors=judge(figure_1),
        full_errors=judge(figure_2),
        figure_1=figure_1,
        figure_2=figure_2,
        sweep=sweep,
        check=run_check_day(config, ground),
    )


def fine_scenario(config: Scenario) -> Scenario:
    """One orbit of day 205, a sample every few seconds."""
    return mission.with_schedule(config, _START, ORBIT_SAMPLES, STEP_S)


def judge(record: YawComparison) -> Numbers:
    """How one calibration does against yaw = 0, over the windows of an orbit and those near the equator."""
    return Numbers(
        # Yaw of the magnetometer, and yaw = 0, less that of the sun sensor.
        rms_deg=rms(record.mean_error_deg),
        rms_at_nodes_deg=rms(record.mean_error_deg[record.near_node]),
        zero_rms_deg=rms(record.mean_sun_deg),
        # Share of windows in which yaw = 0 is nearer.
        zero_wins=1.0 - record.nearer.mean(),
        zero_wins_at_nodes=1.0 - record.nearer[record.near_node].mean(),
    )


def _compared(flight: Flight, calibration: Calibration, ground: FieldModel) -> YawComparison:
    return compare_yaw(flight.telemetry, yaw_from_field(flight.telemetry, calibration, ground))


def _sweep(config: Scenario, fine: Flight, ground: FieldModel, progress: Progress) -> Numbers:
    """Share of windows won by yaw = 0. Each seed draws its own libration, noise, torquer activity and calibration."""
    kinds = {"slow": config, "white": config.updated({"magnetometer.unknown.kind": "white"})}
    base = build_world(config)
    shares = {name: np.empty((len(AMPLITUDES_DEG), SEEDS)) for name in ("full", "bias_only", "white")}
    for number in range(SEEDS):
        progress(f"yaw sweep: seed {number + 1} of {SEEDS}", 0.1 + 0.75 * number / SEEDS)
        for kind, scenario in kinds.items():
            seeded = scenario.updated({"seed": config.seed + 1 + number})
            full, bias_only = calibrations(mission.fly(seeded, base), ground)
            for row, amplitude in enumerate(AMPLITUDES_DEG):
                moved = prescribed(seeded).updated({"attitude.yaw_rms_deg": amplitude / np.sqrt(2.0)})
                flight = mission.fly(fine_scenario(moved), fine.world)
                won = judge(_compared(flight, full, ground)).zero_wins
                shares["full" if kind == "slow" else "white"][row, number] = won
                if kind == "slow":
                    shares["bias_only"][row, number] = judge(_compared(flight, bias_only, ground)).zero_wins
    amplitude_deg = np.array(AMPLITUDES_DEG)
    mean = {f"share_{name}": values.mean(axis=1) for name, values in shares.items()}
    spread = {f"spread_{name}": values.std(axis=1) for name, values in shares.items()}
    return Numbers(
        amplitude_deg=amplitude_deg,
        # Of the windows, with the full calibration, the mean bias alone, and had the unexplained part of the residual been
        # white noise: mean over the seeds of the share that yaw = 0 wins, and its standard deviation.
        **mean,
        **spread,
        # Amplitude at which the full calibration begins to win half of the windows; None outside the sweep.
        crossover_deg=_crossover(amplitude_deg, mean["share_full"]),
        crossover_white_deg=_crossover(amplitude_deg, mean["share_white"]),
        # Share of the seeds for which yaw = 0 beats the full calibration in most windows, slow unknown.
        seeds_won=np.mean(shares["full"] > 0.5, axis=1),
    )


def _crossover(amplitude_deg: FloatArray, share: FloatArray) -> float | None:
    """Amplitude at which the share falls through one half, linear in between."""
    below = np.flatnonzero((share[:-1] >= 0.5) & (share[1:] < 0.5))
    if not below.size:
        return None
    k = int(below[0])
    return float(np.interp(-0.5, -share[k : k + 2], amplitude_deg[k : k + 2]))


def run_check_day(config: Scenario, ground: FieldModel) -> Numbers:
    """Day 279 (claim 32): the calibration of the four days tried on a day that did not enter it.

    The four days and day 279 are flown with SEEDS seeds, each calibrated anew; rms over the samples in which a head sees the
    sun south of 45 S or north of 30 N.
    """
    later = mission.with_schedule(config, day(CHECK_DAY), _CHECK_MINUTES, 60.0)
    base, world = build_world(config), build_world(later)
    latitude = latitude_deg(world)
    rows = []
    for seed in range(config.seed + 1, config.seed + 1 + SEEDS):
        full, _ = calibrations(mission.fly(config.updated({"seed": seed}), base), ground)
        flight = mission.fly(later.updated({"seed": seed}), world)
        assert flight.telemetry.sun_sensor_head is not None
        chosen = (flight.telemetry.sun_sensor_head > 0) & ((latitude < -45.0) | (latitude > 30.0))
        error = reference_error_rad(flight)[chosen]
        field = flight.truth.field_B_nT[chosen] / NT_PER_MG
        residual = residuals_of(flight.telemetry.select(chosen), full, ground) / NT_PER_MG
        rows.append(
            [
                rms_along(residual, axis=0),
                rms_along(np.degrees(error), axis=0),
                rms_along(np.cross(error, field), axis=0),
            ]
        )
    rms_mG, attitude_deg, attitude_mG = np.moveaxis(np.array(rows), 1, 0)
    angle = np.degrees(frames.angle_between(-world.r_N_km, world.sun_N))[chosen]
    return Numbers(
        # (SEEDS, 3) residual per body axis.
        rms_mG=rms_mG,
        # (SEEDS, 3) error of the reference attitude about each body axis (roll, pitch, yaw), and what it leaves.
        attitude_deg=attitude_deg,
        attitude_mG=attitude_mG,
        # (3,) true field per body axis.
        field_mG=rms_along(field, axis=0),
        # Least and greatest angle between sun and nadir.
        sun_nadir_deg=(float(angle.min()), float(angle.max())),
        samples=chosen.sum(),
    )


def run_accuracy(config: Scenario, ground: FieldModel, residual_mG: float, progress: Progress) -> Numbers:
    """Evaluate the papers' formulas in the field of 1978; no calibration is needed. residual_mG: of this run's."""
    printed_mG = mission.printed_value("errors", "rms_mG", source="observed rms")
    progress("yaw accuracy along many orbits", 0.0)
    truth = load_field(config.field.truth)
    field, latitude = _field_O(config, truth, np.arange(0.0, 30 * 86400.0, 10.0))
    crossing_O = field[np.abs(latitude) < np.radians(1.0)]
    at_equator, ours = (
        np.degrees(yaw_sigma(crossing_O, mG * NT_PER_MG, SIGMA_ANGLE_RAD)) for mG in (printed_mG, residual_mG)
    )
    worst = _worst_values(config, truth, printed_mG)
    printed_deg = mission.printed_value("yaw", "value", quantity="sigma_y pole max")
    progress("quantisation and the equations", 0.6)
    lsb = config.magnetometer.step_nT
    horizontal = np.sum(crossing_O[:, :2] ** 2, axis=1)
    # (N,) yaw error by quantisation alone, NaN where it is 5 deg or more. Known S and b, the true field as model: what is
    # left is the rounding.
    flight = mission.fly(mission.only(fine_scenario(config), "lsb"))
    field_O = flight.world.R_ON.apply(flight.world.field_N_nT)
    corrected = Calibration(flight.truth.S, flight.truth.b_nT).apply(flight.telemetry.mag_B_nT)
    solved = yaw_full(corrected, field_O, flight.truth.roll_rad, flight.truth.pitch_rad)
    error = wrapped_deg(solved - flight.truth.yaw_rad)
    lsb_deg = np.where(np.abs(error) < 5.0, error, np.nan)
    return Numbers(
        # Mean and range over equator crossings at the printed residual, and at this run's.
        sigma_equator_deg=at_equator.mean(),
        sigma_equator_range_deg=(float(at_equator.min()), float(at_equator.max())),
        sigma_equator_ours_deg=ours.mean(),
        figure=Numbers(**worst, printed_deg=printed_deg),
        # Largest value of a data base of four orbits; share [%] of the data bases in which it is below the printed one,
        # and share [%] of single orbits in which it is above.
        worst_quantiles_deg={f"{q:g} %": float(np.percentile(worst["worst_base_deg"], q)) for q in (5, 25, 50, 75, 95)},
        printed_percentile=100 * np.mean(worst["worst_base_deg"] < printed_deg),
        orbits_above=100 * np.mean(worst["worst_orbit_deg"] > printed_deg),
        # Yaw of one LSB of the X and Y reading, mean over equator crossings.
        lsb_x_deg=np.degrees(np.mean(lsb * np.abs(crossing_O[:, 1]) / horizontal)),
        lsb_y_deg=np.degrees(np.mean(lsb * np.abs(crossing_O[:, 0]) / horizontal)),
        # Yaw error along an orbit with quantisation alone.
        lsb_mean_deg=np.nanmean(lsb_deg),
        lsb_rms_deg=rms(lsb_deg),
        # X, Y, Z: median time that the field's motion along the orbit takes for one LSB.
        seconds_per_step=_seconds_per_step(config, truth),
        # Largest difference of equation 12 from the pseudo-inverse of equation 13; scatter of yaw over equation 14.
        equation_12_error_deg=_equation_12_error(crossing_O, config.seed),
        equation_14_ratio=_equation_14_ratio(config, truth, printed_mG),
        equator_field_mG=_equator_strength(truth),
        # Three times the rms direction error of IGRF 1975 at 600 and 800 km.
        field_direction_3sigma_deg=[_direction_3sigma(config, truth, ground, altitude) for altitude in (600.0, 800.0)],
    )


def _field_O(config: Scenario, model: FieldModel, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Field in the orbital frame [nT] (N, 3) and geocentric latitude [rad] (N,) along Seasat's orbit, from day 205 on."""
    assert config.orbit is not None
    time: TimeArray = epoch.add_seconds(_START, seconds)
    r_N_km, v_N_km_s = orbit_from(config.orbit).propagate(time)
    R_EN = frames.rotation_EN(time)
    field = frames.rotation_ON(r_N_km, v_N_km_s).apply(field_N_nT(model, time, r_N_km, R_EN))
    return field, frames.geocentric(R_EN.apply(r_N_km))[0]


def _worst_values(config: Scenario, model: FieldModel, residual_mG: float) -> dict[str, FloatArray]:
    """Largest sigma of single orbits and of data bases (92 + 88 + 101 + 44 minutes, starts at random), and
    latitude and sigma along the first orbit [deg]."""
    rng = stream(config.seed, "seasat.worst_yaw")
    largest: list[FloatArray] = []
    first: dict[str, FloatArray] = {}
    for minutes in DATA_MINUTES:
        start_s = rng.uniform(0.0, 60 * 86400.0, size=BASES)
        field, latitude = _field_O(config, model, (start_s[:, None] + 60.0 * np.arange(minutes)).ravel())
        sigma = np.degrees(yaw_sigma(field, residual_mG * NT_PER_MG, SIGMA_ANGLE_RAD)).reshape(BASES, minutes)
        first = first or {"latitude_deg": np.degrees(latitude[:minutes]), "sigma_deg": sigma[0]}
        largest.append(sigma.max(axis=1))
    return {**first, "worst_orbit_deg": np.concatenate(largest[:3]), "worst_base_deg": np.max(largest, axis=0)}


def _seconds_per_step(config: Scenario, model: FieldModel) -> tuple[float, float, float]:
    field, _ = _field_O(config, model, np.arange(0.0, 86400.0, 10.0))
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


def _equation_14_ratio(config: Scenario, model: FieldModel, sigma_mG: float) -> float:
    field, _ = _field_O(config, model, np.arange(0.0, 6040.0, 60.0))
    expected = yaw_sigma(field, sigma_mG * NT_PER_MG, SIGMA_ANGLE_RAD)
    rng = stream(config.seed, "seasat.equation_14")
    noisy = field + rng.normal(0.0, sigma_mG * NT_PER_MG, size=(_DRAWS, *field.shape))
    roll, pitch = rng.normal(0.0, SIGMA_ANGLE_RAD, size=(2, _DRAWS, len(field)))
    found = np.array([yaw_first_order(noisy[k], field, roll[k], pitch[k]) for k in range(_DRAWS)])
    return float(np.median(found.std(axis=0) / expected))


def _equator_strength(model: FieldModel) -> float:
    longitude = np.radians(np.arange(0.0, 360.0, 1.0))
    radius = np.full_like(longitude, SEMI_MAJOR_AXIS_KM)
    field = field_E_nT(model, _START, frames.from_geocentric(np.zeros_like(longitude), longitude, radius))
    return float(np.mean(np.linalg.norm(field, axis=1)) / NT_PER_MG)


def _direction_3sigma(config: Scenario, truth: FieldModel, ground: FieldModel, altitude_km: float) -> float:
    """Three times the rms angle between the two models along ten days at an altitude [deg]."""
    other = config.updated({"orbit.altitude_km": altitude_km})
    seconds = np.arange(0.0, 10 * 86400.0, 60.0)
    a, b = (_field_O(other, model, seconds)[0] for model in (truth, ground))
    return 3 * rms(np.degrees(frames.angle_between(a, b)))
