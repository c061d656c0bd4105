"""The benchmark of ensembles runs and accounts for the time. No speed is tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.property

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "ensembles.py"


def test_smoke_run() -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--quick", "--jobs", "1", "--json", "-"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert record["cpu_per_vehicle_over_that_of_fewer"] > 0.0
    assert record["growth"][1]["vehicles"] == 4 and record["second_start"]["imports_cpu_s"] > 0.0
    parts = record["ms_a_vehicle"]["an orbit each"]
    assert parts["torques, control, integration"] > 0.0 and parts["writing chunks"] > 0.0


def test_no_vehicles_is_an_error_in_one_line() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), "--vehicles", "0"], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "Traceback" not in done.stderr
