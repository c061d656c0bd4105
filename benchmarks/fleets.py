"""Does a fleet show what no vehicle shows by itself?

    python benchmarks/fleets.py [--fleets N] [--vehicles V] [--visible SHARE] [--seed S] [--jobs J] [--quick]

Each fleet flies one design on V orbits of its own with calibrations of their own, five hours each. All have one effect in
common, one of four, so small that what a calibration leaves of it is a given share of the noise (rms per component, the
errors of the attitude in the noise); or none. Printed: fleets whose common effect is named, and by how many vehicles by
themselves; the error of the size over that of the vehicle that knows best by itself; fleets without an effect of which one
is said; vehicles wrongly singled out; processor time of putting together all vehicles that were flown, and a tenth of them.
Forward models are those of the simulator: what is measured is the sum over vehicles, not the catalogue.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import re
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import fluxtwin
from fluxtwin.gap.fleet import Fleet, fleet
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

README = Path(__file__).resolve().parents[1] / "README.md"
EFFECTS = {
    "time_tag_offset": "offset_s",
    "along_track_error": "ahead_km",
    "yaw_drift": "rate_deg_h",
    "sensor_lag": "lag_s",
}
NOISE_NT, STEP_NT, ATTITUDE_DEG = 20.0, 10.0, 0.1
VISIBLE = 0.1


def design() -> Scenario:
    """The scenario of README.md, which turns enough to show something."""
    text = re.search(r"```toml\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    assert text is not None
    plan = parse_scenario(text.group(1), where="README.md")
    return plan.updated({"attitude.yaw_rms_deg": 8.0, "attitude.roll_rms_deg": 5.0, "attitude.pitch_rms_deg": 5.0})


def asked(seed: int, vehicle: int, effect: dict[str, float]) -> Diagnosis:
    """One vehicle, flown and diagnosed with what its maker knows of its noise."""
    rng = np.random.default_rng([seed, vehicle])
    drawn: dict[str, Any] = {
        "seed": int(rng.integers(2**31)),
        "magnetometer.b_nT": (1500.0 * rng.normal(size=3)).tolist(),
        "orbit.raan_deg": float(rng.uniform(0.0, 360.0)),
    }
    changes = {f"effects.{name}.{EFFECTS[name]}": size for name, size in effect.items()}
    record, _ = fluxtwin.simulate(design().updated({**drawn, **changes}))
    return fluxtwin.diagnose(
        record, noise_nT=NOISE_NT, lsb_nT=STEP_NT, attitude_sigma_deg=ATTITUDE_DEG, attitude_tau_s=300.0
    )


def noise_rms_nT(seed: int) -> float:
    """Of the sensor, its steps, and the attitude times the field across, per component."""
    record, _ = fluxtwin.simulate(design().updated({"seed": seed}))
    across = 2.0 / 3.0 * np.radians(ATTITUDE_DEG) ** 2 * float(np.mean(np.sum(record.mag_B_nT**2, axis=1)))
    return float(np.sqrt(NOISE_NT**2 + STEP_NT**2 / 12.0 + across))


def flown(seed: int, vehicles: int, name: str | None, visible: float) -> tuple[str | None, float, Fleet]:
    """A fleet whose vehicles have the effect in common, or none."""
    size = 0.0
    if name is not None:
        smallest = asked(seed, 0, {}).minimum_detectable.get(name)
        if smallest is None:
            return None, 0.0, fleet([], [])
        size = smallest.value * visible * noise_rms_nT(seed) / smallest.visible_nT
    found = [asked(seed, vehicle, {} if name is None else {name: size}) for vehicle in range(vehicles)]
    return name, size, fleet([str(vehicle) for vehicle in range(vehicles)], found)


def _processor_s(diagnoses: list[Diagnosis]) -> float:
    """The least of five runs."""
    took = []
    for _ in range(5):
        began = time.process_time()
        fleet([str(number) for number in range(len(diagnoses))], diagnoses)
        took.append(time.process_time() - began)
    return min(took)


def main() -> int:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fleets", type=int, default=20, help="with an effect, and as many without")
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--visible", type=float, default=VISIBLE, help=f"share of the noise ({VISIBLE})")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="a fleet of three with an effect and one without")
    given = parser.parse_args()
    count, vehicles = (1, 3) if given.quick else (given.fleets, given.vehicles)
    names = [list(EFFECTS)[number % len(EFFECTS)] for number in range(count)]
    wanted = [*names, *[None] * count]
    calls = [(given.seed * 1000 + number, vehicles, name, given.visible) for number, name in enumerate(wanted)]
    if given.jobs == 1:
        fleets = [flown(*call) for call in calls]
    else:
        with ProcessPoolExecutor(given.jobs) as pool:
            fleets = list(pool.map(flown, *zip(*calls, strict=True)))
    hits, singles, ratios, pulls, alarms, faults = 0, 0, [], [], 0, 0
    for name, size, found in fleets:
        faults += len(found.faults)
        common = found.common
        if name is None:
            alarms += common is not None
            continue
        hits += common is not None and name in common.group
        singles += sum(any(name in one.group for one in each.effects) for each in found.diagnoses)
        said = "nothing" if common is None else f"{' or '.join(common.group)} ({100 * common.probability:.0f} %)"
        if common is not None and common.name == name:
            ratios.append(float(common.mean_sigma[0] / common.best_single_sigma[0]))
            pulls.append(float((common.mean[0] - size) / common.mean_sigma[0]))
        print(f"  {name} {size:.3g}: {said}")
    print(f"common effect named: {hits} of {count}; by its vehicles alone {singles} of {count * vehicles}")
    if ratios:
        print(
            f"sigma of the size over that of the best vehicle: {np.mean(ratios):.2f}; errors {np.std(pulls):.2f} sigma rms"
        )
    print(f"fleets without an effect of which one is said: {alarms} of {count}")
    print(f"vehicles singled out, none of which is odd: {faults} of {2 * count * vehicles}")
    many = [one for _, _, found in fleets for one in found.diagnoses]
    for some in (many[: max(3, len(many) // 10)], many):
        print(f"put together, {len(some)} diagnoses: {1e3 * _processor_s(some):.0f} ms of the processor")
    return 0


if __name__ == "__main__":
    sys.exit(main())
