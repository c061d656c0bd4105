"""`info` and `convert` on a file whose content is known line by line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli

import fluxtwin

ROWS = [*range(0, 100, 10), *range(1000, 1100, 10), 1140]
"""Seconds: two passes with a gap of 910 s between them, and a step of 50 s in the second."""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    lines = ["time,mag_x_uT,mag_y_uT,mag_z_uT,r_x_km,r_y_km,r_z_km,temperature_degC,spacecraft"]
    for index, second in enumerate(ROWS):
        stamp = np.datetime64("2026-03-01T00:00:00") + np.timedelta64(second, "s")
        warm = "" if index % 2 else "21.5"
        lines.append(f"{stamp}Z,20.{index:02d},1,-3,7000,0,0,{warm},Widget")
    (tmp_path / "t.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    return tmp_path / "t.csv"


def test_info_tells_what_is_there_and_what_is_not(cli: Cli, file: Path) -> None:
    done = cli("info", file, "--json", "-")
    assert done.status == 0
    (found,) = json.loads(done.out)["files"]
    assert (found["rows"], found["gaps"], found["step_s"], found["span_s"]) == (21, 2, 10.0, 1140.0)
    assert [(p["rows"], p["gap_before_s"]) for p in found["passes"]] == [(10, None), (11, 910.0)]
    columns = {column["name"]: column for column in found["columns"]}
    assert columns["mag_x_nT"] | {"meaning": ""} == {
        "name": "mag_x_nT", "unit": "nT", "meaning": "", "known": 21, "step_s": 10.0,
        "low": 20000.0, "median": pytest.approx(20100.0), "high": pytest.approx(20200.0),
    }  # fmt: skip
    assert (columns["temperature_degC"]["known"], columns["temperature_degC"]["step_s"]) == (11, 20.0)
    assert found["lacks"]["diagnose"] == [] and found["lacks"]["calibrate --method linear"] == ["attitude"]
    assert found["lacks"]["calibrate --method gyro"] == ["body rates"]
    assert found["provenance"]["spacecraft"] == "Widget"
    text = cli("info", file).out
    assert (
        "has the columns for: check, apply" in text
        and "yaw lacks attitude, or nadir" in text
        and "2 passes" in text
        and "910" in text
    )


def test_yaw_lacks_nothing_where_nadir_gives_roll_and_pitch() -> None:
    ten_minutes = [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 10.0, "step_s": 30.0}]
    changes = {"horizon_scanner": {}, "torquers": None, "schedule.segments": ten_minutes}
    flown, _ = fluxtwin.simulate(fluxtwin.load_scenario("cubesat").updated(changes))
    record = flown.replace(q_NB=None)
    assert fluxtwin.info(record).lacks["yaw"] == []
    assert len(fluxtwin.yaw(record, fluxtwin.Calibration(np.zeros((3, 3)), np.zeros(3)), sigma_nT=1.0).time) == 21


def test_info_lists_the_header_of_a_foreign_file(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text("stamp,Bx [nT],By [nT]\n1,2,3\n", encoding="utf-8")
    done = cli("info", tmp_path / "f.csv")
    assert done.status == 0
    assert "Bx [nT]" in done.out and "fluxtwin map" in done.out and "column time is missing" in done.out
    assert cli("info", tmp_path / "none.csv").status == 2


def test_info_shows_what_it_read_before_a_file_that_it_cannot_read(cli: Cli, file: Path, tmp_path: Path) -> None:
    done = cli("info", file, tmp_path / "none.csv")
    assert done.status == 2 and "t.csv: 21 rows" in done.out and "none.csv" in done.err


def test_convert_keeps_every_number_of_the_rows_it_takes(cli: Cli, file: Path, tmp_path: Path) -> None:
    done = cli(
        "convert", file, "--out", tmp_path / "t.nc", "--from", "2026-03-01T00:16:40Z", "--where", "mag_x_uT < 20.15"
    )
    assert done.status == 0 and "5 rows" in done.out
    whole, part = fluxtwin.read(file), fluxtwin.read(tmp_path / "t.nc")
    assert np.array_equal(part.mag_B_nT, whole.mag_B_nT[10:15])
    assert np.array_equal(part.time, whole.time[10:15]) and part.spacecraft == "Widget"
    assert cli("convert", file, "--out", file).status == 2  # never onto its input
