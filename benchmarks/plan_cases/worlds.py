"""Spacecraft that point at the Earth, drawn at random, with one cause that their record confuses with another."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

NADIR_ORBITS = (0.5, 1.0)


def world(rng: np.random.Generator) -> Scenario:
    """A scenario without effects: orbit, pointing, noise, calibration, torquers, power and temperature are drawn."""
    altitude_km = rng.uniform(450.0, 750.0)
    period_min = 2.0 * np.pi * np.sqrt((6378.137 + altitude_km) ** 3 / 398600.4418) / 60.0
    start = np.datetime64("2021-01-01") + np.timedelta64(int(rng.integers(0, 1200)), "D")
    noise_nT = float(np.exp(rng.uniform(np.log(20.0), np.log(80.0))))
    S = rng.normal(0.0, 0.005, (3, 3))
    tree: dict[str, Any] = {
        "orbit.altitude_km": altitude_km,
        "orbit.inclination_deg": float(rng.choice([51.6, 82.0, 97.6])),
        "orbit.raan_deg": rng.uniform(0.0, 360.0),
        "orbit.argument_of_latitude_deg": rng.uniform(0.0, 360.0),
        "attitude": {
            **{f"{axis}_rms_deg": float(rng.uniform(0.5, 2.0)) for axis in ("yaw", "roll", "pitch")},
            "reference": {"sigma_deg": float(rng.uniform(0.03, 0.1)), "tau_s": float(rng.choice([60.0, 150.0, 300.0]))},
        },
        "magnetometer.S": S.tolist(),
        "magnetometer.b_nT": rng.normal(0.0, 1000.0, 3).tolist(),
        "magnetometer.noise_nT": noise_nT,
        "magnetometer.lsb_nT": float(rng.choice([10.0, 40.0])),
        "power": {"full_sun_current_A": float(rng.uniform(3.0, 8.0)), "load_A": float(rng.uniform(1.0, 3.0))},
        "thermal": {
            "sunlit_degC": float(rng.uniform(15.0, 35.0)),
            "eclipse_degC": float(rng.uniform(-25.0, -5.0)),
            "time_constant_min": float(rng.uniform(10.0, 30.0)),
        },
        "torquers.dipole_Am2": float(rng.uniform(5.0, 20.0)),
    }
    base = parse_scenario(
        f'seed = {int(rng.integers(1, 2**31))}\n[spacecraft]\nname = "drawn"\n'
        f'[orbit]\nepoch_utc = "{start}T00:00:00Z"\naltitude_km = 600.0\ninclination_deg = 97.0\nraan_deg = 0.0\n'
        f"argument_of_latitude_deg = 0.0\n[torquers]\ndipole_Am2 = 5.0\n"
        f"positions_m = [[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [1.5, 0.0, 0.0]]\n"
        f'[schedule]\nsegments = [{{ start_utc = "{start}T00:00:00Z", step_s = 15.0, '
        f"duration_min = {float(rng.uniform(*NADIR_ORBITS)) * period_min:.3f} }}]\n"
    )
    return base.updated(tree)
