"""Ensembles: does the time grow as the number of vehicles, how soon is a second start up, and where does the time go?

    python benchmarks/ensembles.py [--vehicles N ...] [--jobs J] [--quick] [--json FILE|-]

Flies docs/examples/ensemble.toml (a momentum-bias satellite, degree-13 field, control and sensors each second, 24,000
steps a vehicle, kept each 10 s) by `fly_ensemble`, in files as a user has them: with one process and with one a core.
Whether the time is linear is measured by processor time (this process and those it starts), because the clock's depends on
what else the machine does, and so is what several processes gain: their longest way is what this process does besides
them and an equal share of what they do, as the clock would show were each on a core of its own (the chunks go to
whoever is free). Each figure is the least of some repeats. Then 16 vehicles on one orbit, and 16 on an orbit each,
with the processor time of every part by itself.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import functools
import importlib.metadata
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from fluxtwin.sim.base import files
from fluxtwin.sim.base.processes import start_and_end_quickly
from fluxtwin.sim.run import flights as scenario_dynamics
from fluxtwin.sim.run.ensemble import chunk, plan, summary
from fluxtwin.sim.run.ensemble.run import fly_ensemble
from fluxtwin.sim.scenario.scenario import Scenario, load_scenario

EXAMPLE = Path(__file__).resolve().parents[1] / "docs" / "examples" / "ensemble.toml"
QUICK_MIN = 30.0
PARTS: list[tuple[Any, str, str]] = [
    (plan, "vehicle_scenario", "drawing and checking"),
    (chunk, "around", "orbit and field"),
    (scenario_dynamics, "_surroundings", "orbit and field"),
    (scenario_dynamics, "_knowledge", "errors of the attitude given to the law"),
    (scenario_dynamics, "fly", "torques, control, integration"),
    (chunk, "simulate", "attitude at the samples, sensors"),
    (chunk, "series", "figures of a vehicle"),
    (chunk, "figures", "figures of a vehicle"),
    (chunk, "write_chunk", "writing chunks"),
    (summary, "summarise", "tables"),
    (summary, "envelope", "tables"),
    (summary, "write_index", "tables"),
]
"""Where a function is called from, its name, and the part it belongs to; a part's time leaves out those within it."""


class Clock:
    """Processor time by part, each without the parts that run inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {part: 0.0 for _, _, part in PARTS}
        self.inner = [0.0]

    def timed(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        """The function, its own time added to the part."""

        @functools.wraps(function)
        def call(*arguments: Any, **options: Any) -> Any:
            self.inner.append(0.0)
            began = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                took = time.process_time() - began
                self.seconds[part] += took - self.inner.pop()
                self.inner[-1] += took

        return call

    @contextmanager
    def running(self) -> Iterator[None]:
        """Time all parts."""
        kept = [(module, name, getattr(module, name)) for module, name, _ in PARTS]
        try:
            for module, name, part in PARTS:
                setattr(module, name, self.timed(getattr(module, name), part))
            yield
        finally:
            for module, name, function in kept:
                setattr(module, name, function)


def example(quick: bool) -> Scenario:
    """The scenario of the documents; shorter to see that it runs."""
    scenario = load_scenario(EXAMPLE)
    assert scenario.schedule is not None
    if not quick:
        return scenario
    first = scenario.schedule.segments[0].model_dump(exclude_none=True) | {"duration_min": QUICK_MIN}
    return scenario.updated({"schedule.segments": (first,)})


class Used(NamedTuple):
    """Seconds for an ensemble, files and tables included."""

    clock_s: float
    processor_s: float
    """Of all processes."""
    longest_way_s: float
    """Processor time of this process and of one of those that it started, on average."""


def seconds_of(scenario: Scenario, vehicles: int, jobs: int) -> Used:
    """For so many vehicles. Nothing is remembered of flights before."""
    scenario_dynamics._latest.clear()
    scenario_dynamics._around.clear()
    with tempfile.TemporaryDirectory() as folder:
        began, own, others = time.perf_counter(), time.process_time(), others_s()
        fly_ensemble(scenario, vehicles, Path(folder) / "results", jobs=jobs)
        own, others = time.process_time() - own, others_s() - others
        return Used(time.perf_counter() - began, own + others, own + others / jobs)


def others_s() -> float:
    """Processor seconds of all processes that this one has started and that have ended, user and system."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def growth(scenario: Scenario, counts: list[int], cores: int, steps: int, repeats: int) -> list[dict[str, float]]:
    """Seconds for each number of vehicles, on one core and on all in turn, and processor time of a step of a vehicle."""
    tried: dict[tuple[int, int], list[Used]] = {(count, jobs): [] for count in counts for jobs in {1, cores}}
    for _ in range(repeats):
        for (count, jobs), done in tried.items():
            done.append(seconds_of(scenario, count, jobs))
    rows = []
    for count in counts:
        used = min(one.processor_s for one in tried[count, 1])
        row = {
            "vehicles": count,
            "one_core_s": min(one.clock_s for one in tried[count, 1]),
            "one_core_cpu_s": used,
            "cpu_us_per_step": 1e6 * used / count / steps,
        }
        if cores > 1:
            best = min(tried[count, cores], key=lambda one: one.clock_s)
            row |= {
                "all_cores_s": best.clock_s,
                "all_cores_cpu_s": best.processor_s,
                "cores_kept_busy": best.processor_s / best.clock_s,
                "cpu_over_that_of_one_core": best.processor_s / used,
                "longest_way_s": min(one.longest_way_s for one in tried[count, cores]),
            }
        rows.append(row)
    return rows


def apart(quick: bool, vehicles: int, cores: int, repeats: int) -> float:
    """How many times the work of one process as many processes do that have nothing in common but the machine: an ensemble
    each, in turn with one alone, by processor time. What the processes of one ensemble gain is bounded by it."""
    alone, together = [], []
    with ProcessPoolExecutor(cores, get_context("spawn"), initializer=start_and_end_quickly) as pool:
        for number in range(repeats + 1):  # the first loads the kernels
            one = pool.submit(_alone, quick, vehicles).result()
            many = list(pool.map(_alone, [quick] * cores, [vehicles] * cores))
            if number:
                alone.append(one)
                together.append(statistics.mean(many))
    return cores * min(alone) / min(together)


def _alone(quick: bool, vehicles: int) -> float:
    return seconds_of(example(quick), vehicles, 1).processor_s


def shares(scenario: Scenario, vehicles: int) -> dict[str, float]:
    """Milliseconds of processor time a vehicle of every part; what torques cost is found by flying without them."""
    clock = Clock()
    with clock.running():
        total = seconds_of(scenario, vehicles, 1).processor_s
    parts = {part: 1e3 * seconds / vehicles for part, seconds in clock.seconds.items()}
    parts["the rest"] = 1e3 * (total - sum(clock.seconds.values())) / vehicles
    draws = {key: draw.model_dump(exclude_none=True) for key, draw in scenario.draws.items() if "torques." not in key}
    bare = scenario.updated({"torques": None, "draws": draws})
    flying = [min(_flying_ms(one, vehicles) for _ in range(3)) for one in (scenario, bare)]
    return parts | {"of the integration: gravity gradient, dipole": flying[0] - flying[1]}


def _flying_ms(scenario: Scenario, vehicles: int) -> float:
    clock = Clock()
    with clock.running():
        seconds_of(scenario, vehicles, 1)
    return 1e3 * clock.seconds["torques, control, integration"] / vehicles


def second_start(scenario: Scenario, repeats: int) -> dict[str, float]:
    """Processor seconds in a fresh interpreter with compiled code from the cache: imports, the first vehicle, one more,
    and all of a process that flies two vehicles, its end included."""
    code = (
        "import sys, time; from fluxtwin.sim.base.processes import start_and_end_quickly as quickly; quickly()\n"
        "t = [0.0]\n"
        "from fluxtwin.sim.run.ensemble import chunk, plan, run\n"
        "from fluxtwin.sim.scenario.scenario import parse_scenario\n"
        "t.append(time.process_time())\n"
        "flyer = chunk.Flyer(plan.Plan(parse_scenario(sys.stdin.read()), 1, 2, 1))\n"
        "for number in (0, 1): flyer.chunk(number); t.append(time.process_time())\n"
        "print(*(b - a for a, b in zip(t, t[1:])))"
    )
    took = []
    for _ in range(repeats):
        before = sum(os.times()[2:4])
        done = subprocess.run(
            [sys.executable, "-c", code], input=scenario.to_toml(), capture_output=True, text=True, check=True
        )
        took.append([*(float(word) for word in done.stdout.split()), sum(os.times()[2:4]) - before])
    imports, first, another, whole = (statistics.median(column) for column in zip(*took, strict=True))
    return {
        "imports_cpu_s": imports,
        "first_vehicle_cpu_s": first,
        "another_vehicle_cpu_s": another,
        "whole_process_cpu_s": whole,
        "start_cpu_s": whole - 2.0 * another,
    }


def report(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run everything; the record that `--json` writes."""
    scenario = example(arguments.quick)
    seconds_of(scenario, 1, 1)  # compiles, or reads the cache
    section = plan.make_plan(scenario, 1).scenario.schedule
    assert section is not None
    own_orbit = scenario.updated(
        {
            "draws": {key: draw.model_dump(exclude_none=True) for key, draw in scenario.draws.items()}
            | {"orbit.raan_deg": {"uniform": (0.0, 360.0)}}
        }
    )
    steps = int((section.segments[0].count - 1) * section.segments[0].step_s)
    rows = growth(scenario, arguments.vehicles, arguments.jobs, steps, 1 if arguments.quick else 5)
    record: dict[str, Any] = {
        "benchmark": "ensembles",
        "steps_a_vehicle": steps,
        "cores": arguments.jobs,
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "versions": {name: importlib.metadata.version(name) for name in ("fluxtwin", "numpy", "numba")},
        "growth": rows,
        "second_start": second_start(scenario, 1 if arguments.quick else 5),
        "ms_a_vehicle": {
            "one orbit for all": shares(scenario, arguments.share_of),
            "an orbit each": shares(own_orbit, arguments.share_of),
        },
    }
    if arguments.jobs > 1:
        record["apart"] = apart(arguments.quick, arguments.share_of, arguments.jobs, 1 if arguments.quick else 15)
    if len(rows) > 1:
        record |= linearity(rows)
    return record


def linearity(rows: list[dict[str, float]]) -> dict[str, float]:
    """How far from linear: processor time of one more vehicle between two numbers of them, and what comes once.

    1 is linear; above it, vehicles take more the more there are.
    """
    few, many = rows[0], rows[-1]
    one_more = (many["one_core_cpu_s"] - few["one_core_cpu_s"]) / (many["vehicles"] - few["vehicles"])
    once = few["one_core_cpu_s"] - few["vehicles"] * one_more
    found = {}
    if "longest_way_s" in few and "longest_way_s" in many:
        together = (many["longest_way_s"] - few["longest_way_s"]) / (many["vehicles"] - few["vehicles"])
        found = {"longest_way_s_of_one_more_vehicle": together, "longest_way_s_once": few["longest_way_s"]}
        found["longest_way_s_once"] -= few["vehicles"] * together
    return found | {
        "cpu_s_of_one_more_vehicle": one_more,
        "cpu_s_once": once,
        "cpu_per_vehicle_over_that_of_fewer": many["cpu_us_per_step"] / rows[-2]["cpu_us_per_step"],
    }


def show(record: dict[str, Any]) -> None:
    """The record on the terminal."""
    print(f"{record['steps_a_vehicle']} steps a vehicle, {record['cores']} processes where all cores are used")
    for row in record["growth"]:
        line = f"{row['vehicles']:6.0f} vehicles: one process {row['one_core_s']:.2f} s, of the processor"
        line += f" {row['one_core_cpu_s']:.2f} s ({row['cpu_us_per_step']:.2f} us a step)"
        if "all_cores_s" in row:
            line += f"; all cores {row['all_cores_s']:.2f} s, of the processors {row['all_cores_cpu_s']:.2f} s"
            line += f" ({row['cores_kept_busy']:.2f} kept busy)"
        print(line)
    if "cpu_s_once" in record:
        more, ratio = 1e3 * record["cpu_s_of_one_more_vehicle"], record["cpu_per_vehicle_over_that_of_fewer"]
        print(f"one more vehicle {more:.1f} ms, once {record['cpu_s_once']:.2f} s")
        if "longest_way_s_once" in record:
            way, once = 1e3 * record["longest_way_s_of_one_more_vehicle"], record["longest_way_s_once"]
            print(f"the longest way of {record['cores']} processes: one more vehicle {way:.1f} ms, once {once:.2f} s;")
            print(f"processes with nothing in common but the machine do {record['apart']:.2f} times the work of one")
        print(f"a vehicle of the last line takes {ratio:.2f} of one of the line before: 1 is linear")
    start = record["second_start"]
    print(
        f"a second start, processor time: imports {start['imports_cpu_s']:.2f} s, the first vehicle"
        f" {start['first_vehicle_cpu_s']:.2f} s, one more {start['another_vehicle_cpu_s']:.3f} s;"
        f" the whole process beyond its vehicles {start['start_cpu_s']:.2f} s"
    )
    for name, parts in record["ms_a_vehicle"].items():
        print(f"milliseconds of processor time a vehicle, {name}:")
        for part, milliseconds in parts.items():
            print(f"  {milliseconds:8.2f}  {part}")


def main() -> None:
    """Parse the command line, run, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--vehicles", type=int, nargs="+", help="sizes of the ensemble (10 100 1000; --quick 2 4)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes where all cores are used")
    parser.add_argument("--quick", action="store_true", help="a few seconds: to see that it runs")
    parser.add_argument("--json", metavar="FILE", help="write the record to FILE, or to standard output for -")
    arguments = parser.parse_args()
    arguments.vehicles = arguments.vehicles or ([2, 4] if arguments.quick else [10, 100, 1000])
    arguments.share_of = 2 if arguments.quick else 16
    if min(*arguments.vehicles, arguments.jobs, 1) < 1:
        parser.error("--vehicles and --jobs: 1 or more")
    start_and_end_quickly()  # as the command line does
    record = report(arguments)
    if arguments.json == "-":
        print(files.to_json(record), end="")
        return
    show(record)
    if arguments.json:
        files.write_json(arguments.json, record)


if __name__ == "__main__":
    main()
