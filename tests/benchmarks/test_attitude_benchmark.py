"""The benchmark of the attitude runs, says what it could not run, and flies what Basilisk flies. No speed is tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.property

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "attitude.py"


def test_smoke_run(tmp_path: Path) -> None:
    target = tmp_path / "bench.json"
    command = [sys.executable, str(SCRIPT), "--quick", "--vehicles", "2", "--json", str(target)]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert shown.returncode == 0, shown.stderr
    record = json.loads(target.read_text(encoding="utf-8"))
    assert record["fluxtwin_s"] > 0 and record["ensemble"]["vehicles"] == 2
    if "Basilisk" in record["skipped"]:
        assert "pip install bsk" in record["skipped"]["Basilisk"] and "ratio_vs_basilisk" not in record
    else:
        assert record["attitude_difference_deg"] < 1e-4
        assert record["position_difference_m"] < 0.01
        assert record["field_difference_nT"] < 1.0  # its file has two decimals: the same field


def test_an_interpreter_without_basilisk_is_a_reason_and_no_crash(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), "--quick", "--vehicles", "1", "--basilisk", "no-such-python", "--json", "-"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "no-such-python" in json.loads(done.stdout)["skipped"]["Basilisk"]


def test_no_vehicles_is_an_error_in_one_line() -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--vehicles", "-3"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
