"""What is the calibration worth at night? Attitude without the sun, against truth.

    python benchmarks/night.py [--seeds N] [--quick] [--json FILE|-]

HCMM as in `fluxtwin run hcmm`, but for what hides the magnetometer: prescribed motion, all hours in place of the passes over
stations, head 1 mounted as it should be, torquers in the telemetry and not compensated. Five hours by day are calibrated
with b alone, with b and S, with b, S and T; each calibration is then used over five hours of the next day. A seed draws
motion, torquers and every noise anew; the ground has IGRF 1975, the world DGRF. Errors about yaw (body z) of all rows in
which no head sees the sun: rms and 95th percentile; the filter's own sigma, rms; the share of rows within three of them;
the share of seeds in which the filter says that it holds, and that it is good. Beside it: yaw taken as zero, which is how
it is steered; yaw by sun and nadir interpolated across the night; yaw by the field of one reading at a time (b, S, T).
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import sys
from typing import Any

import numpy as np

from fluxtwin.calib.attitude.three_axis import estimate_attitude
from fluxtwin.calib.attitude.yaw import yaw_from_field
from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.scenarios.flights import prescribed
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.sim.base import files
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.sun import sun_direction_N
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.sensors.reference_attitude import attitude_from_sun_and_nadir
from fluxtwin.sim.telemetry.record import Telemetry

FIRST_SEED = 8000
PARAMETERS = ("b", "b,S", "b,S,T")
SPANS = {
    "days": {"start_utc": "1978-11-29T14:00:00Z", "duration_min": 300.0, "step_s": 10.0},
    "night": {"start_utc": "1978-11-30T14:00:00Z", "duration_min": 300.0, "step_s": 10.0},
}


def scenario(name: str) -> Scenario:
    """HCMM without what hides the magnetometer, over one of SPANS."""
    return prescribed(mission.scenario()).updated(
        {
            "schedule.in_view_of_stations": None,
            "schedule.segments": [SPANS[name]],
            "torquers.telemetered": True,
            "torquers.compensation": None,
            "sun_sensor.1.misalignment_deg": None,
        }
    )


def turn_deg(q_NB: np.ndarray, truth: Truth) -> np.ndarray:
    """(N,) error about body z [deg]; NaN where the attitude is not known."""
    error = np.full(len(q_NB), np.nan)
    known = np.isfinite(q_NB).all(axis=1)
    turned = frames.rotation_from_q(q_NB[known]) * frames.rotation_from_q(truth.q_NB[known]).inv()
    error[known] = np.degrees(turned.as_rotvec()[:, 2])
    return error


def interpolated_deg(telemetry: Telemetry, truth: Truth) -> np.ndarray:
    """(N,) error of yaw by sun and nadir, straight between the rows that have both."""
    assert telemetry.sun_B is not None and telemetry.nadir_B is not None and telemetry.r_N_km is not None
    assert telemetry.v_N_km_s is not None
    to_sun = sun_direction_N(telemetry.time, telemetry.r_N_km)
    q = attitude_from_sun_and_nadir(telemetry.sun_B, telemetry.nadir_B, to_sun, -np.array(telemetry.r_N_km))
    day = np.flatnonzero(np.isfinite(q).all(axis=1))
    R_ON = frames.rotation_ON(telemetry.r_N_km[day], telemetry.v_N_km_s[day])
    yaw = frames.yaw_roll_pitch(frames.rotation_from_q(q[day]) * R_ON.inv())[0]
    t = epoch.seconds_since(telemetry.time, telemetry.time[0])
    return wrapped_deg(np.interp(t, t[day], np.unwrap(yaw)) - truth.yaw_rad)


def wrapped_deg(angle_rad: np.ndarray) -> np.ndarray:
    """From -180 to 180 deg."""
    return np.degrees((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


def fly(seed: int, worlds: dict[str, Any], which: tuple[str, ...] = PARAMETERS) -> dict[str, dict[str, np.ndarray]]:
    """Errors, sigmas and consistency of one seed, by way."""
    model = load_field("igrf1975")
    flights = {}
    for name in SPANS:
        seeded = scenario(name).updated({"seed": seed})
        if name not in worlds:
            worlds[name] = build_world(seeded)
        flights[name] = simulate(seeded, world=worlds[name])
    days, (telemetry, truth) = flights["days"][0], flights["night"]
    assert telemetry.sun_B is not None
    dark = ~np.isfinite(telemetry.sun_B).all(axis=1)
    found = {
        "zero": {"error": wrapped_deg(-np.asarray(truth.yaw_rad))[dark]},
        "interpolation": {"error": interpolated_deg(telemetry, truth)[dark]},
    }
    for parameters in which:
        known = calibrate_linear(days, model, parameters=parameters).calibration
        filtered = estimate_attitude(telemetry, known, model)
        q, sigma = np.full((len(telemetry), 4), np.nan), np.full(len(telemetry), np.nan)
        q[filtered.rows], sigma[filtered.rows] = filtered.q_NB, np.degrees(filtered.sigma_rad[:, 2])
        found[parameters] = {
            "error": turn_deg(q, truth)[dark],
            "sigma": sigma[dark],
            "holds": np.array([filtered.holds]),
            "good": np.array([filtered.level == "good"]),
        }
        if parameters == PARAMETERS[-1]:
            single = yaw_from_field(telemetry.replace(q_NB=None), known, model)
            error = np.full(len(telemetry), np.nan)
            error[single.rows] = wrapped_deg(single.yaw_rad - truth.yaw_rad[single.rows])
            found["one reading"] = {"error": error[dark]}
    return found


def score(parts: list[dict[str, np.ndarray]]) -> dict[str, float | None]:
    """One row of the table."""
    error = np.concatenate([part["error"] for part in parts])
    known = np.isfinite(error)
    row: dict[str, float | None] = {
        "rms_deg": float(np.sqrt((error[known] ** 2).mean())),
        "p95_deg": float(np.quantile(np.abs(error[known]), 0.95)),
        "sigma_deg": None,
        "within_3_sigma": None,
        "holds": None,
        "good": None,
    }
    if "sigma" in parts[0]:
        sigma = np.concatenate([part["sigma"] for part in parts])[known]
        row["sigma_deg"] = float(np.sqrt((sigma**2).mean()))
        row["within_3_sigma"] = float((np.abs(error[known]) < 3.0 * sigma).mean())
        for name in ("holds", "good"):
            row[name] = float(np.concatenate([part[name] for part in parts]).mean())
    return row


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="one seed, one orbit, b, S and T: does it run?")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; - is standard output")
    arguments = parser.parse_args()
    if arguments.quick:
        SPANS["night"]["duration_min"] = 110.0
    worlds: dict[str, Any] = {}
    which = PARAMETERS[-1:] if arguments.quick else PARAMETERS
    flown = [fly(FIRST_SEED + k, worlds, which) for k in range(1 if arguments.quick else arguments.seeds)]
    rows = {way: score([one[way] for one in flown]) for way in flown[0]}
    result = {"seeds": len(flown), "first_seed": FIRST_SEED, "yaw_by_night": rows}
    if arguments.json == "-":
        sys.stdout.write(files.to_json(result))
        return 0
    print(f"{len(flown)} seeds from {FIRST_SEED}\n")
    print("| yaw by night from | rms [deg] | 95 % [deg] | sigma [deg] | in 3 sigma | holds | good |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    for way, row in rows.items():
        cells = [f"{row['rms_deg']:.2f}", f"{row['p95_deg']:.2f}"]
        if row["sigma_deg"] is not None:
            cells += [f"{row['sigma_deg']:.2f}", f"{100 * row['within_3_sigma']:.1f} %", f"{100 * row['holds']:.0f} %"]
            cells += [f"{100 * row['good']:.0f} %"]
        print(f"| {way} | {' | '.join([*cells, '', '', '', ''][:6])} |")
    if arguments.json:
        files.write_json(arguments.json, result)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
