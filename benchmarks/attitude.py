"""Attitude dynamics against Basilisk: the same vehicle, orbit and field, in one run, one core.

    python benchmarks/attitude.py [--repeats R] [--vehicles V] [--basilisk PYTHON] [--quick] [--json FILE|-]

A rigid body at 790 km with gravity gradient and a degree-13 field in the body at each step of 1 s, logged each 10 s, for
four orbits (24,159 steps). Ours works out orbit and field in one batch at nodes 10 s apart, the default of a scenario, and
draws cubics between; Basilisk does it at each step. So does ours where the record says `each_step`, with the readings'
largest difference. Basilisk's magnetometer reads at each step; ours makes readings of what is logged, which
saves it some 4 % of its time. Each repeat runs both sides in turn; medians of processor time count. Ours is everything
from the orbit to the readings, the mean of ten flights in a row (the first of them is given as well); Basilisk's is its bare
execution, without its set-up. Basilisk (`pip install bsk`) may live in another interpreter: name it with --basilisk or
in BASILISK_PYTHON. It gets the field as a file, so nothing is fetched.
Then an ensemble of vehicles, each with its own orbit, on one core and on all.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import importlib.metadata
import importlib.util
import json
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base import files
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.earth.field import field_E_nT, load_field
from fluxtwin.sim.scenario.dynamics_sections import DynamicsSection
from fluxtwin.sim.spacecraft.dynamics.environment import environment_along
from fluxtwin.sim.spacecraft.dynamics.flight import Flight, Start, fly
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.torques import GravityGradient

DEGREE, STEP_S, LOG_EVERY, STEPS = 13, 1.0, 10, 24_159
NODE_S = DynamicsSection().surroundings_s
START = np.datetime64("2022-01-01T00:00:00", "ns")
RADIUS_KM = 7168.137
SPEED_KM_S = float(np.sqrt(GM_EARTH_KM3_S2 / RADIUS_KM))
INERTIA_KG_M2 = np.diag([100.0, 120.0, 80.0])
RATE_B_RAD_S = np.array([1e-3, -2e-3, 3e-3])
MRP_BN = np.array([0.1, 0.2, -0.3])
MODEL = load_field("igrf14", DEGREE)
SENSOR = Magnetometer(
    S=0.01 * np.eye(3), b_nT=np.array([100.0, -50.0, 20.0]), T_nT_per_Am2=None, noise_nT=0.0, lsb_nT=0.0, range_nT=None
)


class Circle:
    """A circular two-body orbit."""

    def __init__(self, inclination_rad: float, node_rad: float) -> None:
        self.ascending = np.array([np.cos(node_rad), np.sin(node_rad), 0.0])
        flat, up = np.cos(inclination_rad), np.sin(inclination_rad)
        self.ahead = np.array([-flat * np.sin(node_rad), flat * np.cos(node_rad), up])

    def __call__(self, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position [km] and velocity [km/s]."""
        angle = (SPEED_KM_S / RADIUS_KM) * 1e-9 * (stamps - START).astype("int64")
        turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        r = turn @ (RADIUS_KM * np.stack([self.ascending, self.ahead]))
        v = turn @ (SPEED_KM_S * np.stack([self.ahead, -self.ascending]))
        return r, v


ORBIT = Circle(np.radians(108.0), np.radians(36.0))


def q_from_mrp(mrp: np.ndarray) -> np.ndarray:
    """Textbook quaternion of modified Rodrigues parameters."""
    squared = float(mrp @ mrp)
    q: np.ndarray = np.append(2.0 * mrp, 1.0 - squared) / (1.0 + squared)
    return q


def ours(steps: int, orbit: Circle = ORBIT, node_s: float = NODE_S) -> tuple[Flight, np.ndarray, dict[str, float]]:
    """One flight, the logged readings, and the seconds of its parts."""
    marks = [time.process_time()]
    environment = environment_along(orbit, START, (steps + 1) * STEP_S, spacing_s=node_s, field=MODEL)
    marks.append(time.process_time())
    vehicle = Vehicle(INERTIA_KG_M2, torques=(GravityGradient(),))
    start = Start(q_from_mrp(MRP_BN), RATE_B_RAD_S, np.zeros(0))
    flight = fly(vehicle, environment, start, duration_s=steps * STEP_S, step_s=STEP_S, log_every=LOG_EVERY)
    marks.append(time.process_time())
    reading = SENSOR.ideal_reading(flight.field_B_nT)
    marks.append(time.process_time())
    parts = dict(zip(("orbit and field", "dynamics", "magnetometer"), np.diff(marks).tolist(), strict=True))
    return flight, reading, parts


def ten_times(steps: int, node_s: float = NODE_S) -> dict[str, float]:
    """Mean seconds of each part over ten flights, and all of the first one."""
    flights = [ours(steps, node_s=node_s)[2] for _ in range(10)]
    means = {name: statistics.fmean(parts[name] for parts in flights) for name in flights[0]}
    return means | {"first": sum(flights[0].values())}


class Basilisk:
    """A process that flies the same vehicle each time it is asked to."""

    def __init__(self, python: str, steps: int, folder: Path) -> None:
        field_file = folder / "IGRF.COF"
        field_file.write_text(cof(), encoding="ascii")
        r, v = ORBIT(np.array([START]))
        flight = {
            "step_s": STEP_S,
            "steps": steps,
            "log_every": LOG_EVERY,
            "inertia_kg_m2": INERTIA_KG_M2.tolist(),
            "r_N_m": (1e3 * r[0]).tolist(),
            "v_N_m_s": (1e3 * v[0]).tolist(),
            "mrp_BN": MRP_BN.tolist(),
            "rate_B_rad_s": RATE_B_RAD_S.tolist(),
            "gm_m3_s2": GM_EARTH_KM3_S2 * 1e9,
            "field_file": str(field_file),
            "year": 2022.0,
        }
        script = Path(__file__).with_name("peers") / "basilisk_attitude.py"
        self.process = subprocess.Popen(
            [python, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.version = self._ask(json.dumps(flight))["version"]

    def fly(self) -> dict[str, Any]:
        """Fly once."""
        return self._ask("fly")

    def close(self) -> None:
        """End the process."""
        self.process.communicate()

    def _ask(self, line: str) -> dict[str, Any]:
        assert self.process.stdin is not None and self.process.stdout is not None and self.process.stderr is not None
        try:
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            said = self.process.stderr.read().strip().splitlines()
            raise RuntimeError(said[-1] if said else "Basilisk's process ended without a word")
        record: dict[str, Any] = json.loads(answer)
        return record


def cof() -> str:
    """The field as a file that Basilisk reads, at the start and without secular variation."""
    coefficients = iter(MODEL.coefficients_nT(START)[0])
    lines = ["    2022.0            IGRF-14       01/01/2022"]
    for n in range(1, DEGREE + 1):
        for m in range(n + 1):
            g, h = next(coefficients), next(coefficients) if m else 0.0
            lines.append(f"{n:3d}{m:3d}{g:11.2f}{h:11.2f}{0.0:11.2f}{0.0:11.2f}")
    return "\n".join([*lines, "9" * 48, "9" * 48]) + "\n"


def interpreter(named: str | None) -> str:
    """An interpreter that has Basilisk; ImportError says that there is none."""
    python = named or os.environ.get("BASILISK_PYTHON")
    if python is None and importlib.util.find_spec("Basilisk") is None:
        raise ImportError("Basilisk is not installed here (pip install bsk), and no other interpreter was named")
    return python or sys.executable


def race(arguments: argparse.Namespace) -> dict[str, Any]:
    """Both sides in turn, so many times."""
    ours(STEPS // 10)  # compiles, or reads the cache
    record: dict[str, Any] = {"skipped": {}}
    peer, answer = None, None
    theirs: list[float] = []
    mine: list[dict[str, float]] = []
    dense: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        try:
            peer = Basilisk(interpreter(arguments.basilisk), arguments.steps, Path(folder))
            for _ in range(arguments.repeats):
                mine.append(ten_times(arguments.steps))
                dense.append(ten_times(arguments.steps, STEP_S))
                answer = peer.fly()
                theirs.append(answer["seconds"])
        except (ImportError, OSError, RuntimeError) as error:
            record["skipped"]["Basilisk"] = str(error)
            mine += [ten_times(arguments.steps) for _ in range(arguments.repeats)]
        finally:
            if peer is not None:
                peer.close()
    record["fluxtwin_first_of_ten_s"] = statistics.median(parts.pop("first") for parts in mine)
    seconds = statistics.median(sum(parts.values()) for parts in mine)
    record["fluxtwin_s"], record["million_steps_per_s"] = seconds, arguments.steps / seconds / 1e6
    record["parts_s"] = {name: statistics.median(parts[name] for parts in mine) for name in mine[0]}
    if peer is not None and answer is not None and theirs:
        record |= {"basilisk_version": peer.version, "basilisk_s": statistics.median(theirs)}
        record["ratio_vs_basilisk"] = statistics.median(theirs) / seconds
        record |= compare(arguments.steps, answer)
        each = statistics.median(sum(parts.values()) - parts["first"] for parts in dense)
        record["each_step_s"], record["each_step_ratio_vs_basilisk"] = each, statistics.median(theirs) / each
        here, there = ours(arguments.steps)[1], ours(arguments.steps, node_s=STEP_S)[1]
        record["each_step_reading_difference_nT"] = float(np.abs(here - there).max())
    return record


def compare(steps: int, answer: dict[str, Any]) -> dict[str, float]:
    """How far the two sides are apart in the last row."""
    flight, _, _ = ours(steps)
    here, there = flight.q_NB[-1:], q_from_mrp(np.array(answer["mrp_BN"]))[None]
    apart = (frames.rotation_from_q(here) * frames.rotation_from_q(there).inv()).magnitude()[0]
    last_s = float(flight.seconds_s[-1])
    r_km, _ = ORBIT(epoch.add_seconds(START, np.array([last_s])))
    # Basilisk was given no Earth that turns: its field stands still in N.
    unturned_nT = field_E_nT(MODEL, START, r_km)
    assert last_s == answer["last_s"], "the two logs end at different times"
    return {
        "attitude_difference_deg": float(np.degrees(apart)),
        "rate_difference_deg_s": float(np.degrees(np.abs(flight.rate_B_rad_s[-1] - answer["rate_B_rad_s"]).max())),
        "position_difference_m": float(np.linalg.norm(1e3 * r_km[0] - answer["r_N_m"])),
        "field_difference_nT": float(abs(np.linalg.norm(unturned_nT) - np.linalg.norm(answer["field_B_nT"]))),
    }


def ensemble(arguments: argparse.Namespace) -> dict[str, Any]:
    """Seconds of many vehicles, one orbit each, on one core and on all; a tenth of them shows that it is linear."""
    rng = np.random.default_rng(1)
    orbits = [Circle(i, n) for i, n in rng.uniform(0.0, 3.0, (arguments.vehicles, 2))]
    cores = os.cpu_count() or 1

    def fly_some(count: int, threads: int) -> float:
        started = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            for _ in pool.map(lambda orbit: ours(arguments.steps, orbit)[2], orbits[:count]):
                pass
        return time.perf_counter() - started

    few = max(1, arguments.vehicles // 10)
    record = {"vehicles": arguments.vehicles, "cores": cores, "tenth_one_core_s": fly_some(few, 1)}
    record["one_core_s"] = fly_some(arguments.vehicles, 1)
    record["all_cores_s"] = fly_some(arguments.vehicles, cores)
    per_few = record["tenth_one_core_s"] / few
    return record | {"time_per_vehicle_over_that_of_a_tenth": record["one_core_s"] / arguments.vehicles / per_few}


def second_start() -> dict[str, float]:
    """Processor seconds in a fresh interpreter, compiled code from the cache: all the imports, and the first flight."""
    code = (
        "import runpy, sys, time;"
        f"sys.argv = ['x']; m = runpy.run_path({__file__!r}, run_name='started'); t = time.process_time();"
        "m['ours'](100); print(t, time.process_time() - t)"
    )
    took = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        took.append([float(word) for word in done.stdout.split()])
    imports, first = (statistics.median(column) for column in zip(*took, strict=True))
    return {"imports_cpu_s": imports, "first_flight_cpu_s": first}


def report(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run everything; the record that `--json` writes."""
    record = {
        "benchmark": "attitude",
        "degree": DEGREE,
        "steps": arguments.steps,
        "repeats": arguments.repeats,
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "versions": {name: importlib.metadata.version(name) for name in ("fluxtwin", "numpy", "numba")},
        **race(arguments),
    }
    record["second_start"] = second_start()
    record["ensemble"] = ensemble(arguments)
    return record


def show(record: dict[str, Any]) -> None:
    """The record on the terminal."""
    print(f"{record['steps']} steps of {STEP_S:g} s, degree {DEGREE}, {record['repeats']} repeats, medians")
    parts = ", ".join(f"{name} {1e3 * seconds:.1f} ms" for name, seconds in record["parts_s"].items())
    print(f"fluxtwin  {record['fluxtwin_s']:.4f} s, {record['million_steps_per_s']:.2f} M steps/s ({parts})")
    if "basilisk_s" in record:
        print(f"Basilisk  {record['basilisk_s']:.4f} s: {record['ratio_vs_basilisk']:.1f} x as long")
        print(
            f"with orbit and field at each step {record['each_step_ratio_vs_basilisk']:.1f} x; the readings differ"
            f" by {record['each_step_reading_difference_nT']:.1g} nT"
        )
        print(f"attitude differs by {record['attitude_difference_deg']:.1e} deg after the last step")
    many = record["ensemble"]
    print(
        f"{many['vehicles']} vehicles: {many['one_core_s']:.2f} s on one core, {many['all_cores_s']:.2f} s on"
        f" {many['cores']}; time a vehicle {many['time_per_vehicle_over_that_of_a_tenth']:.2f} of that of a tenth"
    )
    start = record["second_start"]
    print(
        f"a second start: processor time: imports {start['imports_cpu_s']:.2f} s,"
        f" the first flight {start['first_flight_cpu_s']:.2f} s"
    )
    for name, reason in record["skipped"].items():
        print(f"not run: {name}: {reason}")


def main() -> None:
    """Parse the command line, run, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, help="interleaved repeats (7; --quick 1)")
    parser.add_argument("--vehicles", type=int, help="size of the ensemble (1,000; --quick 4)")
    parser.add_argument("--basilisk", metavar="PYTHON", help="an interpreter that has Basilisk; default this one")
    parser.add_argument("--quick", action="store_true", help="a few seconds: to see that it runs")
    parser.add_argument("--json", metavar="FILE", help="write the record to FILE, or to standard output for -")
    arguments = parser.parse_args()
    arguments.steps = STEPS // 10 if arguments.quick else STEPS
    arguments.repeats = arguments.repeats or (1 if arguments.quick else 7)
    arguments.vehicles = arguments.vehicles or (4 if arguments.quick else 1000)
    if min(arguments.repeats, arguments.vehicles) < 1:
        parser.error("--repeats and --vehicles: 1 or more")
    record = report(arguments)
    if arguments.json == "-":
        print(files.to_json(record), end="")
        return
    show(record)
    if arguments.json:
        files.write_json(arguments.json, record)


if __name__ == "__main__":
    main()
