"""`fluxtwin attitude` as a person meets it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

Cli = Callable[..., object]
SCENARIO = """seed = 5
[spacecraft]
name = "night"
[orbit]
epoch_utc = "2026-03-01T00:00:00Z"
altitude_km = 620.0
inclination_deg = 97.6
raan_deg = 0.0
argument_of_latitude_deg = 200.0
[attitude]
mode = "earth_pointing"
yaw_rms_deg = 0.5
[magnetometer]
b_nT = [500.0, -800.0, 300.0]
noise_nT = 50.0
[sun_sensor.1]
azimuth_deg = 180.0
elevation_deg = 40.0
noise_deg = 0.1
[horizon_scanner]
noise_deg = 0.1
[schedule]
segments = [{ start_utc = "2026-03-01T00:00:00Z", duration_min = 45.0, step_s = 10.0 }]
"""
SIZES = ("--noise-nT", 50, "--attitude-sigma-deg", 0.1, "--attitude-tau-s", 0, "--sun-sigma-deg", 0.1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`t.nc` and its calibration `c.toml`."""
    place = tmp_path_factory.mktemp("attitude")
    telemetry, truth = simulate(parse_scenario(SCENARIO, where="test"))
    write_telemetry(telemetry, place / "t.nc")
    Calibration(np.zeros((3, 3)), truth.b_nT, sigma_nT=50.0, method="truth").to_toml(place / "c.toml")
    return place


def test_attitude_row_by_row_and_the_first_line_is_the_verdict(cli: Cli, folder: Path, tmp_path: Path) -> None:
    made = ("--out", tmp_path / "a.csv", "--json", tmp_path / "a.json")
    outcome = cli("attitude", folder / "t.nc", "--calibration", folder / "c.toml", *SIZES, *made)
    assert outcome.status == 0, outcome.err + outcome.out
    lines = outcome.out.splitlines()
    assert lines[0].startswith("Good: nothing contradicts the attitude. 1 sigma about body x, y, z: 0.")
    assert "without" in lines[0]
    assert any(line.startswith("Used: nadir and sun") for line in lines)
    assert any(line.startswith("Next: ") for line in lines)
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()))
    record = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert len(rows) == len(record["time"]) > 260
    q = np.array([[float(row[f"q_{axis}"]) for axis in "xyzw"] for row in rows])
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() < 1e-9
    assert 0.0 < float(rows[-1]["sigma_z_deg"]) < 1.0
    assert record["sigma_deg"]["night"][2] > 0.0
    assert cli("attitude", folder / "t.nc", "--calibration", folder / "c.toml", "--out", tmp_path / "a.csv").status == 2


def test_sizes_that_the_data_contradict_end_with_status_1(cli: Cli, folder: Path) -> None:
    outcome = cli("attitude", folder / "t.nc", "--calibration", folder / "c.toml", *SIZES[2:], "--noise-nT", 500)
    assert outcome.status == 1
    assert outcome.out.startswith("Bad: the attitude does not hold.")
    assert "The squared innovations of the field are 0.0" in outcome.out
    assert "Next: fluxtwin check" in outcome.out


def test_corrected_telemetry_needs_no_calibration(cli: Cli, folder: Path, tmp_path: Path) -> None:
    assert cli("attitude", folder / "t.nc").status == 2
    assert cli("apply", folder / "t.nc", "--calibration", folder / "c.toml", "--out", tmp_path / "c.nc").status == 0
    assert cli("attitude", tmp_path / "c.nc", *SIZES, "-q").status == 0
