"""`fluxtwin ensemble` as a person meets it: a table, files, one vehicle taken out, one message for a mistake."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Cli
from worlds import scenario_text

import fluxtwin

pytestmark = pytest.mark.usefixtures("small_figures")

SECTIONS = """
[attitude]
yaw_rms_deg = 1.0
[magnetometer]
b_nT = [0.0, 0.0, 0.0]
[draws]
"magnetometer.b_nT" = { normal = 100.0 }
"""
TEXT = 'name = "few"\n' + scenario_text(SECTIONS, seed=2, segment="samples = 20, step_s = 60.0")


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "few.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_an_ensemble_and_one_vehicle_of_it(cli: Cli, scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "results"
    outcome = cli("ensemble", scenario, "--vehicles", 3, "--out", out, "--jobs", 1)
    assert outcome.status == 0, outcome.err
    assert "3 vehicles of few, seed 2" in outcome.out and "pointing_p95_deg" in outcome.out
    names = {path.name for path in out.iterdir()}
    tables = {"ensemble.json", "vehicles.csv", "summary.json", "envelope.csv", "envelope.png"}
    assert names == {*tables, "report.html", "chunk-00000.nc"}
    assert (out / "vehicles.csv").read_text(encoding="utf-8").startswith("vehicle,seed,magnetometer.b_nT[0],")
    again = cli("ensemble", scenario, "--vehicles", 3, "--out", out, "--resume", "--json", "-")
    shown = json.loads(again.out)
    assert shown.pop("fluxtwin") == fluxtwin.__version__
    kept = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert shown.pop("sha256") != kept.pop("sha256"), "the one has a key more"
    assert shown == kept
    one = tmp_path / "one.toml"
    assert cli("ensemble", scenario, "--extract", 1, "--out", one).status == 0
    assert cli("simulate", one, "--out", tmp_path / "one.nc").status == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((), ["--vehicles", "1000"]),
        (("--vehicles", "0"), ["--vehicles", "1 to 1,000,000"]),
        (("--vehicles", "2", "--jobs", "0"), ["--jobs", "1 or more"]),
        (("--extract", "-1"), ["--extract", "from 0"]),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    cli: Cli, scenario: Path, tmp_path: Path, change: tuple[str, ...], words: list[str]
) -> None:
    outcome = cli("ensemble", scenario, "--out", tmp_path / "results", *change)
    assert outcome.status == 2 and outcome.out == ""
    assert outcome.err.count("\n") == 1 and all(word in outcome.err for word in words)
    assert not (tmp_path / "results").exists()


def test_a_folder_with_an_ensemble_is_left_alone(cli: Cli, scenario: Path, tmp_path: Path) -> None:
    command = ("ensemble", scenario, "--vehicles", 2, "--out", tmp_path / "results", "--jobs", 1)
    assert cli(*command).status == 0
    outcome = cli(*command)
    assert outcome.status == 2 and "--resume" in outcome.err
    outcome = cli(*command, "--resume", "--seed", 9)
    assert outcome.status == 2 and "the seed changed" in outcome.err and "seed 2 then, 9 now" in outcome.err
