"""The benchmark of the field runs, compares like with like, and says what it could not run. No speed is tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.property

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "field.py"


def test_smoke_run(tmp_path: Path) -> None:
    target = tmp_path / "bench.json"
    command = [sys.executable, str(SCRIPT), "--quick", "--points", "300", "--repeats", "1", "--json"]
    shown = subprocess.run([*command, str(target)], capture_output=True, text=True, timeout=120, check=False)
    assert shown.returncode == 0, shown.stderr
    record = json.loads(target.read_text(encoding="utf-8"))
    assert {"fluxtwin", "chaosmagpy", "ppigrf", "C"} <= record["results"].keys() | record["skipped"].keys()
    for name, row in record["results"].items():
        assert name in shown.stdout
        assert row["largest_difference_nT"] < 1e-6, name  # the same field, or the ratio means nothing
    for reason in record["skipped"].values():
        assert reason and reason in shown.stdout


def test_no_points_is_an_error_in_one_line() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), "--points", "-3"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
