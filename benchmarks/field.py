"""The field against ppigrf, chaosmagpy and a C kernel: same points, same run, one core.

    python benchmarks/field.py [--points N] [--repeats R] [--quick] [--json FILE|-]

Degree 13, IGRF-14, random points between 6371.2 and 7500 km. Each repeat runs every contestant once, in turn; medians of
processor time count. Ours is the public `field_E_nT` with its checks; the C kernel (field_kernel.c, compiled on the spot
with gcc -O3 -march=native) is timed bare. The libraries get geocentric angles ready-made and blocks of 20,000 points, at
which they are faster than in one piece. A contestant that cannot run is named with the reason.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import ctypes
import importlib.metadata
import importlib.resources
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base import files
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_E_nT, load_field

DEGREE = 13
BLOCK = 20_000
EPOCH = datetime(2022, 10, 5)
Contestant = Callable[[], np.ndarray]


class Points:
    """Random positions, as vectors and as angles, and a trajectory's epochs one second apart."""

    def __init__(self, count: int) -> None:
        rng = np.random.default_rng(1)
        latitude = np.arcsin(rng.uniform(-1, 1, count))
        longitude = rng.uniform(-np.pi, np.pi, count)
        self.radius_km = rng.uniform(6371.2, 7500.0, count)
        self.colatitude_deg = 90.0 - np.degrees(latitude)
        self.longitude_deg = np.degrees(longitude)
        self.r_E_km = frames.from_geocentric(latitude, longitude, self.radius_km)
        self.epochs = np.datetime64(EPOCH, "ns") + np.arange(count).astype("timedelta64[s]")

    def blocks(self) -> list[slice]:
        return [slice(i, i + BLOCK) for i in range(0, self.radius_km.size, BLOCK)]

    def to_E(self, up: np.ndarray, south: np.ndarray, east: np.ndarray) -> np.ndarray:
        """Earth-fixed components of a library's answer, for the comparison (not timed)."""
        nec = np.stack([-south, east, -up], axis=1)
        vectors: np.ndarray = frames.rotation_NEC_E(self.r_E_km).inv().apply(nec)
        return vectors


def contestants(points: Points) -> tuple[dict[str, Contestant], dict[str, str]]:
    """The runs, each giving (N, 3), and the reasons of those that cannot be made."""
    model = load_field("igrf14", DEGREE)
    when = np.datetime64(EPOCH)
    runs: dict[str, Contestant] = {
        "fluxtwin": lambda: field_E_nT(model, when, points.r_E_km),
        "fluxtwin, per-sample epochs": lambda: field_E_nT(model, points.epochs, points.r_E_km),
    }
    skipped: dict[str, str] = {}
    for name, make in {"C": c_kernel, "chaosmagpy": chaosmagpy, "ppigrf": ppigrf}.items():
        try:
            runs |= make(points)
        except (ImportError, OSError, RuntimeError, subprocess.CalledProcessError) as error:
            skipped[name] = str(error)
    return runs, skipped


def c_kernel(points: Points) -> dict[str, Contestant]:
    from fluxtwin.sim.earth.field_kernels import fold

    compiler = shutil.which("gcc")
    if compiler is None:
        raise RuntimeError("no gcc on this machine")
    folder = Path(tempfile.mkdtemp())
    try:
        library = folder / "field_kernel.so"
        source = Path(__file__).with_name("field_kernel.c")
        flags = ["-O3", "-march=native", "-shared", "-fPIC"]
        subprocess.run([compiler, *flags, "-o", library, source, "-lm"], check=True, capture_output=True)
        function = ctypes.CDLL(str(library)).synthesize
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    table = fold(load_field("igrf14", DEGREE).coefficients_nT(np.datetime64(EPOCH))[0])

    def run() -> np.ndarray:
        r, out = points.r_E_km, np.empty_like(points.r_E_km)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (r, table, out)]
        function(*pointers[:2], ctypes.c_long(DEGREE + 1), ctypes.c_long(r.shape[0]), pointers[2])
        return out

    return {"C": run}


def chaosmagpy(points: Points) -> dict[str, Contestant]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from chaosmagpy.chaos import BaseModel
    with importlib.resources.as_file(importlib.resources.files("ppigrf") / "IGRF14.shc") as path:
        model: Any = BaseModel.from_shc(str(path), leap_year=True)
    one = (np.datetime64(EPOCH) - np.datetime64("2000-01-01")) / np.timedelta64(1, "D")
    days = (points.epochs - np.datetime64("2000-01-01")) / np.timedelta64(1, "D")

    def run(time_days: np.ndarray | float) -> np.ndarray:
        parts = []
        for s in points.blocks():
            when = time_days[s] if isinstance(time_days, np.ndarray) else time_days
            where = (points.radius_km[s], points.colatitude_deg[s], points.longitude_deg[s])
            parts.append(np.stack(model.synth_values(when, *where, nmax=DEGREE), axis=1))
        return np.concatenate(parts)

    return {"chaosmagpy": lambda: run(float(one)), "chaosmagpy, per-sample epochs": lambda: run(days)}


def ppigrf(points: Points) -> dict[str, Contestant]:
    import ppigrf as library

    def run() -> np.ndarray:
        parts = []
        for s in points.blocks():
            where = (points.radius_km[s], points.colatitude_deg[s], points.longitude_deg[s])
            parts.append(np.stack(library.igrf_gc(*where, EPOCH, max_degree=DEGREE), axis=-1)[0])
        return np.concatenate(parts)

    return {"ppigrf": run}


def measure(runs: dict[str, Contestant], repeats: int) -> tuple[dict[str, float], dict[str, np.ndarray], float]:
    """Median seconds and the last answer of each run, and the seconds of our first call (compiling included)."""
    started = time.process_time()
    runs["fluxtwin"]()
    first = time.process_time() - started
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    answers = {}
    for repeat in range(repeats):
        for name, run in runs.items():
            if sys.stderr.isatty():
                print(f"\rrepeat {repeat + 1} of {repeats}: {name:<40}", end="", file=sys.stderr)
            started = time.process_time()
            answers[name] = run()
            seconds[name].append(max(time.process_time() - started, 1e-9))  # a coarse clock may not have moved
    if sys.stderr.isatty():
        print(f"\r{'':<60}\r", end="", file=sys.stderr)
    return {name: statistics.median(times) for name, times in seconds.items()}, answers, first


def compare(points: Points, answers: dict[str, np.ndarray]) -> dict[str, float]:
    """Largest difference [nT] of each answer from ours at the same epochs."""
    differences = {}
    for name, answer in answers.items():
        ours = answers["fluxtwin, per-sample epochs" if name.endswith("epochs") else "fluxtwin"]
        vectors = points.to_E(*answer.T) if name.startswith(("chaosmagpy", "ppigrf")) else answer
        differences[name] = float(np.abs(vectors - ours).max())
    return differences


def report(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run everything; the record that `--json` writes."""
    points = Points(arguments.points)
    runs, skipped = contestants(points)
    seconds, answers, first = measure(runs, arguments.repeats)
    differences = compare(points, answers)
    base = {name: "fluxtwin, per-sample epochs" if name.endswith("epochs") else "fluxtwin" for name in runs}
    results = {
        name: {
            "seconds": seconds[name],
            "million_points_per_s": arguments.points / seconds[name] / 1e6,
            "fluxtwin_is_faster_by": seconds[name] / seconds[base[name]],
            "largest_difference_nT": differences[name],
        }
        for name in runs
    }
    ratio = seconds["fluxtwin"] / seconds["fluxtwin, per-sample epochs"]
    return {
        "benchmark": "field",
        "degree": DEGREE,
        "points": arguments.points,
        "repeats": arguments.repeats,
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "versions": {name: _version(name) for name in ("fluxtwin", "numpy", "numba", "chaosmagpy", "ppigrf")},
        "first_call_s": first,
        "per_sample_over_one_epoch_rate": ratio,
        "results": results,
        "skipped": skipped,
    }


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def show(record: dict[str, Any]) -> None:
    """The record as a table on the terminal."""
    print(f"degree {record['degree']}, {record['points']} points, {record['repeats']} repeats, one core, medians")
    print(f"{'':<32}{'s':>10}{'M points/s':>12}{'fluxtwin is':>14}{'differs by':>14}")
    for name, row in record["results"].items():
        faster = "" if name.startswith("fluxtwin") else f"{row['fluxtwin_is_faster_by']:.3g} x"
        difference = "" if name.startswith("fluxtwin") else f"{row['largest_difference_nT']:.1e} nT"
        rate = row["million_points_per_s"]
        print(f"{name:<32}{row['seconds']:>10.4f}{rate:>12.4g}{faster:>14}{difference:>14}")
    print(f"per-sample epochs run at {record['per_sample_over_one_epoch_rate']:.2f} of the one-epoch rate")
    print(f"first call, with the compiler or its cache: {record['first_call_s']:.2f} s")
    for name, reason in record["skipped"].items():
        print(f"not run: {name}: {reason}")


def main() -> None:
    """Parse the command line, run, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--points", type=int, help="number of points (1,000,000; --quick 20,000)")
    parser.add_argument("--repeats", type=int, help="interleaved repeats (7; --quick 3)")
    parser.add_argument("--quick", action="store_true", help="a few seconds: to see that it runs")
    parser.add_argument("--json", metavar="FILE", help="write the record to FILE, or to standard output for -")
    arguments = parser.parse_args()
    arguments.points = arguments.points or (20_000 if arguments.quick else 1_000_000)
    arguments.repeats = arguments.repeats or (3 if arguments.quick else 7)
    if min(arguments.points, arguments.repeats) < 1:
        parser.error("--points and --repeats: 1 or more")
    record = report(arguments)
    if arguments.json == "-":
        print(files.to_json(record), end="")
        return
    show(record)
    if arguments.json:
        files.write_json(arguments.json, record)


if __name__ == "__main__":
    main()
