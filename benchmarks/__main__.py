"""All comparisons of speed in one table: what was measured, what is wanted, what bounds it.

    python -m benchmarks [--quick] [--basilisk PYTHON] [--only NAME] [--page docs/benchmarks.md] [--json FILE|-]

Each script runs by itself, on one core where it compares with one, and gives ratios of runs in turn on the same machine: a
ratio says more than seconds, which change with the machine and with what else it does. Seconds are of the processor. --page
writes the table as a page. A rival that is not installed (chaosmagpy and ppigrf come with '.[test]'; Basilisk, `pip install
bsk`, may live in another interpreter) leaves its line open, with the reason. --quick: small sizes, some two minutes, without
the study: to see that it runs; its ratios are of no worth.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fluxtwin.sim.base import files

HERE = Path(__file__).resolve().parent
ONE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
FREE = {name: str(os.cpu_count() or 1) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""What BLAS takes by itself where nobody limits it."""


class Line(NamedTuple):
    """One line of the table."""

    work: str
    measured: str
    wanted: str
    reached: bool | None
    """None: nothing is wanted, or it was not measured."""
    bound: str
    """What bounds it."""


class Asked(NamedTuple):
    """How to run."""

    quick: bool
    basilisk: str | None

    def script(self, name: str, *words: object) -> dict[str, Any]:
        """The record that a benchmark writes."""
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "record.json"
            quick = ["--quick"] if self.quick else []
            command = [sys.executable, str(HERE / f"{name}.py"), *quick, *map(str, words), "--json", str(target)]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            record: dict[str, Any] = json.loads(target.read_text(encoding="utf-8"))
        return record


def field(asked: Asked) -> Iterator[Line]:
    """The field at a million points."""
    record = asked.script("field", *([] if asked.quick else ["--repeats", 3]))
    rows, points = record["results"], record["points"]
    for rival, wanted in (("chaosmagpy", 73.0), ("ppigrf", 242.0)):
        if rival in rows:
            ratio = rows[rival]["fluxtwin_is_faster_by"]
            how = (
                "eight points (four without AVX-512) stay in registers; the other library makes arrays for each degree"
            )
            yield Line(
                f"field, {points:,} points, against {rival}", f"{ratio:.3g} x", f"{wanted:g} x", ratio >= wanted, how
            )
        else:
            yield Line(f"field against {rival}", "not run", f"{wanted:g} x", None, record["skipped"][rival])
    why = "the same sums in the same registers; positions are checked first, and the output starts as zeros"
    if "C" in rows:
        share = rows["C"]["fluxtwin_is_faster_by"]
        yield Line("field against C (`gcc -O3 -march=native`)", f"{share:.2f} of its rate", "0.6", share >= 0.6, why)
    else:
        yield Line("field against C (`gcc -O3 -march=native`)", "not run", "0.6", None, record["skipped"]["C"])
    share = record["per_sample_over_one_epoch_rate"]
    why = "each point has coefficients of its own: six more products a harmonic"
    yield Line("field, each point at its own epoch", f"{share:.2f} of the rate of one epoch", "0.5", share >= 0.5, why)


def step(asked: Asked) -> Iterator[Line]:
    """Attitude, field and magnetometer, step by step."""
    words = ["--vehicles", 4 if asked.quick else 20, *(["--basilisk", asked.basilisk] if asked.basilisk else [])]
    record = asked.script("attitude", *words)
    parts = record["parts_s"]
    whole = sum(parts.values())
    most = ", ".join(
        f"{name} {100 * seconds / whole:.0f} %" for name, seconds in sorted(parts.items(), key=lambda p: -p[1])
    )
    if "ratio_vs_basilisk" in record:
        ratio = record["ratio_vs_basilisk"]
        most += f"; orbit and field at each step, as Basilisk, {record['each_step_ratio_vs_basilisk']:.3g} x"
        yield Line("attitude, field and reading against Basilisk", f"{ratio:.3g} x", "60 x", ratio >= 60.0, most)
    else:
        yield Line(
            "attitude, field and reading against Basilisk", "not run", "60 x", None, record["skipped"]["Basilisk"]
        )


def ensembles(asked: Asked) -> Iterator[Line]:
    """Many vehicles."""
    record = asked.script("ensembles", *([] if asked.quick else ["--vehicles", 64, 256]))
    thousand = 1000.0 * record["cpu_s_of_one_more_vehicle"]
    parts = record["ms_a_vehicle"]["one orbit for all"]
    most = ", ".join(f"{name} {ms:.0f} ms" for name, ms in sorted(parts.items(), key=lambda p: -p[1])[:3])
    yield Line("ensemble: processor time of 1,000 vehicles", f"{thousand:.0f} s", "15 s", thousand <= 15.0, most)
    if "longest_way_s_once" in record:
        way, once = record["longest_way_s_of_one_more_vehicle"], record["longest_way_s_once"]
        gain = record["cpu_s_of_one_more_vehicle"] / way
        whole = (record["cpu_s_once"] + thousand) / (once + 1000.0 * way)
        why = f"processes that share nothing but the machine do {record['apart']:.2f} x; each takes {once:.1f} s to start, "
        why += f"so {whole:.2f} x for 1,000; tables before and after, one process"
        name = f"ensemble: {record['cores']} processes with a core each, per additional vehicle"
        yield Line(name, f"{gain:.2f} x one", "1.9 x", gain >= 1.9, why)


def calibration(asked: Asked) -> Iterator[Line]:
    """The regression against one pass over its arrays."""
    record = asked.script("calibration_linear")
    ratio = record["ratio_to_sum"]["regression"]
    why = "six products of columns read once; `sum` reads and adds alone"
    yield Line(
        f"linear calibration, {record['samples']:,} rows", f"{ratio:.1f} x numpy.sum", "15 x", ratio <= 15.0, why
    )
    whole = record["ratio_to_sum"]["whole"]
    why = "tests of excitation, sandwich covariance and statistics, a pass each"
    yield Line("the same with all its statistics", f"{whole:.0f} x numpy.sum", "", None, why)


def reading(asked: Asked) -> Iterator[Line]:
    """NetCDF into a record, against h5py alone."""
    import h5py

    import fluxtwin

    rows = 20_000 if asked.quick else 1_000_000
    rng = np.random.default_rng(1)
    stamps = np.datetime64("2026-03-01", "ns") + np.arange(rows) * np.timedelta64(1, "s")
    q = rng.normal(size=(rows, 4))
    record = fluxtwin.Telemetry(
        time=stamps,
        mag_B_nT=rng.normal(0, 2e4, (rows, 3)),
        r_N_km=rng.normal(0, 4e3, (rows, 3)),
        q_NB=q / np.linalg.norm(q, axis=1)[:, None],
    )
    with tempfile.TemporaryDirectory() as folder:
        path = fluxtwin.write(record, Path(folder) / "t.nc")

        def raw() -> None:
            with h5py.File(path) as file:
                for name in file:
                    file[name][()]

        ratio = _ratio(lambda: fluxtwin.read(path, max_samples=rows), raw, 3 if asked.quick else 5)
    why = "two SHA-256, of the file and of its content, copies into the record, every value looked at"
    yield Line(f"reading {rows:,} rows of NetCDF against h5py", f"{ratio:.1f} x as long", "3 x", ratio <= 3.0, why)


def notebook(asked: Asked) -> Iterator[Line]:
    """The same diagnosis from Python, with as many threads as BLAS takes, and from the command line."""
    del asked
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "t.nc"
        _run(["-m", "fluxtwin", "simulate", "cubesat", "--out", str(record)])
        timed = "import json, time, fluxtwin; started = time.process_time(); found = fluxtwin.diagnose({!r}).to_dict();"
        timed += "print(json.dumps([time.process_time() - started, found], default=str))"
        took, bits = [], []
        for limits in (FREE, ONE):
            seconds, found = json.loads(_run(["-c", timed.format(str(record))], limits))
            took.append(seconds)
            bits.append(json.dumps(found))
        shown = Path(folder) / "a.json"
        _run(["-m", "fluxtwin", "diagnose", str(record), "--json", str(shown)], FREE)
        said = {key: value for key, value in json.loads(shown.read_text(encoding="utf-8")).items() if key in found}
        same = bits[0] == bits[1] and said == json.loads(bits[0])
    ratio = took[0] / took[1]
    words = f"{ratio:.2f} x the processor time, {'the same' if same else 'other'} bits"
    why = "the verbs limit BLAS to one thread by themselves (test_the_number_of_threads_changes_no_bit)"
    yield Line("diagnosis in Python, threads not limited from outside", words, "the same", same and ratio < 1.15, why)


def start(asked: Asked) -> Iterator[Line]:
    """What a small command costs."""
    repeats = 2 if asked.quick else 7
    with tempfile.TemporaryDirectory() as folder:
        half = Path(folder) / "s.toml"
        example = (HERE.parent / "README.md").read_text(encoding="utf-8")
        text = re.search(r"```toml\n(seed.*?)```", example, re.DOTALL)
        assert text is not None
        half.write_text(text[1].replace("duration_min = 300.0", "duration_min = 30.0"), encoding="utf-8")
        simulate = ["-m", "fluxtwin", "simulate", str(half), "--out", str(Path(folder) / "t.nc"), "--force"]
        works = (
            ("fluxtwin --help", ["-m", "fluxtwin", "--help"], 0.2, "imports of typer and rich"),
            ("import fluxtwin", ["-c", "import fluxtwin"], 0.1, "the interpreter itself"),
            ("simulate half an hour", simulate, 1.05, "imports of numpy, scipy, numba, pydantic; the kernels' cache"),
        )
        for name, words, wanted, why in works:
            used = statistics.median(_processor_s(words) for _ in range(repeats))
            yield Line(f"{name}, processor time", f"{used:.2f} s", f"{wanted:g} s", used <= wanted, why)


def study(asked: Asked) -> Iterator[Line]:
    """`fluxtwin run seasat`, the first command of the README."""
    if asked.quick:
        return
    with tempfile.TemporaryDirectory() as folder:
        used = _processor_s(["-m", "fluxtwin", "run", "seasat", "--out", str(Path(folder) / "r")])
    why = "655 flights and 2,900 regressions of 325 rows; no function takes more than 6 %"
    yield Line("fluxtwin run seasat, processor time", f"{used:.0f} s", "60 s", used <= 60.0, why)


def follow(asked: Asked) -> Iterator[Line]:
    """A row that is watched."""
    record = asked.script("follow", *(["--runs", 1, "--rows", 500, "--delays", 1]))
    used = record["us_a_row"]
    why = "fifteen states and 108 changes a row, compiled"
    yield Line("diagnose --follow, a row of a thousand", f"{used:.0f} us", "1,000 us", used <= 1000.0, why)
    alone = record["us_a_row_alone"]
    why = "the reader of files, once a row, and the orbit's frame and field, a third each"
    yield Line("diagnose --follow, a row alone", f"{alone:,.0f} us", "1,000 us", alone <= 1000.0, why)


def size(asked: Asked) -> Iterator[Line]:
    """What `pip install .` brings."""
    del asked
    wanted, seen, sizes = ["fluxtwin"], set[str](), dict[str, int]()
    while wanted:
        name = wanted.pop().lower().replace("_", "-")
        if name in seen:
            continue
        seen.add(name)
        try:
            one = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            seen.discard(name)  # only for another Python or machine
            continue
        if name != "fluxtwin":
            sizes[name] = sum(Path(str(f.locate())).stat().st_size for f in one.files or () if f.locate().exists())
        wanted += [re.split(r"[ ;<>=!~\[(]", need)[0] for need in one.requires or () if "extra ==" not in need]
    direct = [need for need in importlib.metadata.requires("fluxtwin") or () if "extra ==" not in need]
    words = f"{len(direct)} required packages, {len(seen) - 1} with theirs, {sum(sizes.values()) / 1e6:.0f} MB"
    most = sorted(sizes, key=lambda name: -sizes[name])[:5]
    yield Line("installed", words, "", None, ", ".join(f"{name} {sizes[name] / 1e6:.0f} MB" for name in most))


WORKS: dict[str, Callable[[Asked], Iterator[Line]]] = {
    work.__name__: work for work in (field, step, ensembles, calibration, reading, notebook, start, study, follow, size)
}


def _run(words: Sequence[str], limits: dict[str, str] | None = None) -> str:
    environment = {name: value for name, value in os.environ.items() if name not in ONE} | (limits or {})
    done = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True, check=True)
    return done.stdout


def _processor_s(words: Sequence[str]) -> float:
    """Processor seconds of a fresh process, user and system, its children included."""
    before = os.times()
    _run(words, ONE)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def _ratio(ours: Callable[[], object], theirs: Callable[[], object], repeats: int) -> float:
    took: list[tuple[float, float]] = []
    for _ in range(repeats + 1):  # the first warms the caches
        marks = [time.process_time()]
        for run in (ours, theirs):
            run()
            marks.append(time.process_time())
        took.append((marks[1] - marks[0], marks[2] - marks[1]))
    mine, other = (min(column) for column in zip(*took[1:], strict=True))  # the least that other load added to
    return mine / max(other, 1e-9)


def page(lines: Sequence[Line], how: str) -> str:
    """The table as Markdown; how: under which load it was measured."""
    cpu = next((row.split(":")[1].strip() for row in _cpu() if row.startswith("model name")), platform.machine())
    head = [
        "# Speed",
        "",
        "Made by `python -m benchmarks [--basilisk PYTHON] --page docs/benchmarks.md` on",
        f"{cpu}, {os.cpu_count()} cores, Python {platform.python_version()}; {how}.",
        "Ratios compare runs that alternate on the same machine; seconds are processor time.",
        "",
        "| work | measured | wanted | reached | what limits it |",
        "|---|--:|--:|---|---|",
    ]
    said = {True: "yes", False: "no", None: ""}
    rows = [f"| {a} | {b} | {c} | {said[reached]} | {why} |" for a, b, c, reached, why in lines]
    return "\n".join([*head, *rows, ""])


def _how() -> str:
    """What else the machine does at the start, and whether this run goes before it."""
    group = Path("/proc/self/autogroup")
    first = group.exists() and "nice -" in group.read_text(encoding="utf-8")
    return f"load average {os.getloadavg()[0]:.0f} at the start{', this run at raised priority' if first else ''}"


def _cpu() -> list[str]:
    info = Path("/proc/cpuinfo")
    return info.read_text(encoding="utf-8").splitlines() if info.exists() else []


def main() -> None:
    """Parse the command line, run, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="some minutes: to see that it runs")
    parser.add_argument("--basilisk", metavar="PYTHON", help="an interpreter that has Basilisk")
    parser.add_argument("--only", choices=WORKS, action="append", help="one part; repeatable")
    parser.add_argument("--page", metavar="FILE", help="write the table as Markdown")
    parser.add_argument("--json", metavar="FILE", help="write the lines to FILE, or to standard output for -")
    arguments = parser.parse_args()
    asked, lines, how = Asked(arguments.quick, arguments.basilisk), list[Line](), _how()
    for name in arguments.only or WORKS:
        for line in WORKS[name](asked):
            lines.append(line)
            if arguments.json != "-":
                mark = {True: "reached", False: "not reached", None: ""}[line.reached]
                print(
                    f"{line.work}: {line.measured} (wanted: {line.wanted or 'nothing'}) {mark}\n    {line.bound}",
                    flush=True,
                )
    if arguments.page:
        files.write_text(arguments.page, page(lines, how))
    if arguments.json == "-":
        print(files.to_json([line._asdict() for line in lines]), end="")
    elif arguments.json:
        files.write_json(arguments.json, [line._asdict() for line in lines])


if __name__ == "__main__":
    main()
