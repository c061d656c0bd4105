"""Tests in a random order, alone and beside other work: one that depends on another, or on the clock, fails."""

from __future__ import annotations

import contextlib
import os
import secrets
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

from .harness import Row, timed

ROOT = Path(__file__).resolve().parents[2]


def orders(folder: Path, *, runs: int, loaded: int, tests: str = "tests") -> Row:
    """As many runs, each in an order of its own; the last ones beside one busy process for each core.

    A single file takes one process: its tests stay together, and others would only start.
    """
    row, loads = Row("tests in a random order that fail"), []
    workers = "0" if tests.endswith(".py") else "auto"
    with timed(row):
        for run in range(runs):
            seed, report = secrets.randbelow(2**32), folder / f"{run}.xml"
            command = [sys.executable, "-m", "pytest", "-q", "-n", workers, "-p", "no:cacheprovider"]
            command += [f"--shuffle={seed}", f"--junitxml={report}", tests]
            with _load(run >= runs - loaded):
                done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
            if not report.exists():
                row.fault(f"seed {seed}: {done.stdout[-300:]} {done.stderr[-300:]}")
                continue
            for case in ElementTree.parse(report).iter("testcase"):
                row.trials += 1
                if case.find("failure") is not None or case.find("error") is not None:
                    row.fault(f"seed {seed}: {case.get('classname')}::{case.get('name')}")
            loads.append(os.getloadavg()[1])
            print(
                f"run {run + 1}: seed {seed}, load {loads[-1]:.1f}, {row.trials} tests so far, {len(row.faults)} faults",
                flush=True,
            )
    each = ", ".join(f"{one:.1f}" for one in sorted(loads))
    row.note = f"{runs} runs, files and their tests shuffled; load averages of {os.cpu_count()} cores: {each}"
    return row


@contextlib.contextmanager
def _load(wanted: bool) -> Iterator[None]:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(wanted * (os.cpu_count() or 1))]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()
