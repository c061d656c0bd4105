"""`fluxtwin fleet` as a person meets it: records of several vehicles, one answer."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Cli, status_of
from worlds import scenario_text

SECTIONS = """
[attitude]
mode = "tumble"
rate_deg_s = [0.12, 0.08, 0.2]
[attitude.reference]
sigma_deg = 0.05
tau_s = 0.0
[magnetometer]
b_nT = [900.0, -300.0, 200.0]
noise_nT = 20.0
[effects.time_tag_offset]
offset_s = 0.3
"""
INERTIA = [[0.05, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.04]]


@pytest.mark.closure
def test_a_late_clock_of_the_design(cli: Cli, tmp_path: Path) -> None:
    files = []
    for seed in (1, 2, 3):
        plan = tmp_path / f"{seed}.toml"
        text = scenario_text(SECTIONS, seed=seed, segment="samples = 300, step_s = 10.0", inertia_kg_m2=INERTIA)
        plan.write_text(text, encoding="utf-8")
        files.append(tmp_path / f"{seed}.nc")
        assert status_of("simulate", plan, "--out", files[-1], "-q") == 0
    done = cli("fleet", *files, "--noise-nT", 20, "--jobs", 2, "--json", tmp_path / "f.json")
    assert done.status == 0, done.err
    assert "of the design: time_tag_offset" in done.out and "No vehicle stands out" in done.out
    found = json.loads((tmp_path / "f.json").read_text(encoding="utf-8"))["common"]
    assert abs(found["mean"][0] - 0.3) < 4.0 * found["mean_sigma"][0]
    assert found["mean_sigma"][0] < 0.7 * found["best_single_sigma"][0]
    few = cli("fleet", *files[:2])
    assert few.status == 2 and "three or more" in few.err
