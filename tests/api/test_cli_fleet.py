"""`fluxtwin diagnose --fleet` as a person meets it: records of several vehicles, one answer."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Cli, status_of
from worlds import TUMBLING, tumbling

LATE = """
[effects.time_tag_offset]
offset_s = 0.3
"""


@pytest.mark.closure
def test_a_late_clock_of_the_design(cli: Cli, tmp_path: Path) -> None:
    files = []
    for seed in (1, 2, 3):
        plan = tmp_path / f"{seed}.toml"
        plan.write_text(tumbling(TUMBLING + LATE, seed=seed), encoding="utf-8")
        files.append(tmp_path / f"{seed}.nc")
        assert status_of("simulate", plan, "--out", files[-1], "-q") == 0
    done = cli("diagnose", "--fleet", *files, "--noise-nT", 20, "--jobs", 2, "--json", tmp_path / "f.json")
    assert done.status == 0, done.err
    assert "of the design: time_tag_offset" in done.out and "No vehicle stands out" in done.out
    found = json.loads((tmp_path / "f.json").read_text(encoding="utf-8"))["common"]
    assert abs(found["mean"][0] - 0.3) < 4.0 * found["mean_sigma"][0]
    assert found["mean_sigma"][0] < 0.7 * found["best_single_sigma"][0]
    few = cli("diagnose", *files[:2], "--fleet")
    assert few.status == 2 and "three or more" in few.err
