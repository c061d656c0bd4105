"""The benchmark of the sigmas runs, and its records are borne out. No speed is tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.property

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "sigmas.py"


def test_smoke_run(tmp_path: Path) -> None:
    """Six seeds a case: a mean square of pulls scatters by sqrt(2/6) at most, three of those above 1 is 2.7."""
    target = tmp_path / "sigmas.json"
    command = [sys.executable, str(SCRIPT), "--quick", "--json", str(target)]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert shown.returncode == 0, shown.stderr
    record = json.loads(target.read_text(encoding="utf-8"))
    assert [one["case"] for one in record["cases"]] == ["readme", "slow", "scalar"]
    for one in record["cases"]:
        assert one["words"] in shown.stdout
        assert one["pull_all"] ** 2 < 2.7, one
        assert one["nees"] < 2.7, one
