"""The benchmark of calibrations without attitude runs, and says what it could not run. No speed is tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.property

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "calibration.py"


def test_smoke_run(tmp_path: Path) -> None:
    target = tmp_path / "bench.json"
    command = [sys.executable, str(SCRIPT), "--quick", "--json", str(target)]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert shown.returncode == 0, shown.stderr
    record = json.loads(target.read_text(encoding="utf-8"))
    results = record["results"]
    for name in ("fluxtwin twostep", "fluxtwin scalar"):
        for data, most_mG in (("varying", 1.5), ("constant", 0.2), ("passes", 12.0)):  # five sigma at this size
            assert results[name][data]["offset_mG"] < most_mG
    # Where |B| varies, a fit that supposes it constant cannot be near.
    assert results["ellipsoid (Li & Griffiths)"]["constant"]["offset_mG"] < 0.2
    assert results["ellipsoid (Li & Griffiths)"]["varying"]["offset_mG"] > 10.0
    for who in results:
        assert who in shown.stdout
    for reason in record["skipped"].values():
        assert reason


def test_too_few_samples_is_an_error_in_one_line() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), "--samples", "3"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
