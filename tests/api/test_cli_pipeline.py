"""The verbs one after the other on files, and the one message that each mistake in a file costs."""

from __future__ import annotations

import csv
import json
import os
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli, status_of
from worlds import scenario_text

SECTIONS = """
[attitude]
yaw_rms_deg = 5.0
roll_rms_deg = 5.0
pitch_rms_deg = 5.0
[magnetometer]
S = [[0.02, -0.01, 0.004], [0.013, -0.02, -0.004], [0.007, -0.003, 0.002]]
b_nT = [500.0, -300.0, 200.0]
noise_nT = 20.0
[torquers]
dipole_Am2 = 10.0
positions_m = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]]
activity = "off"
"""
SCENARIO = 'name = "floor"\n' + scenario_text(
    SECTIONS,
    seed=7,
    name="Floor",
    epoch_utc="2012-03-01T00:00:00Z",
    altitude_km=700.0,
    inclination_deg=98.0,
    raan_deg=40.0,
    segment="samples = 200, step_s = 60.0",
)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, its telemetry as .nc and .csv, and a calibration."""
    folder = tmp_path_factory.mktemp("flight")
    (folder / "floor.toml").write_text(SCENARIO, encoding="utf-8")
    for suffix in ("nc", "csv"):
        out = str(folder / f"floor.{suffix}")
        assert status_of("simulate", folder / "floor.toml", "--out", out, "--truth", folder / "truth.nc") == 0
    assert status_of("calibrate", folder / "floor.nc", "--out", folder / "calibration.toml") == 0
    return folder


def table(path: Path) -> tuple[list[str], list[list[str]]]:
    with open(path, encoding="utf-8", newline="") as opened:
        rows = list(csv.reader(opened))
    return rows[0], rows[1:]


def rewritten(source: Path, out: Path, change: Callable[[list[str], list[list[str]]], None]) -> Path:
    """The CSV `source` with heading and rows changed in place, as `out`."""
    heading, rows = table(source)
    for row in (heading, *rows):
        row.pop()  # the checks, which a change would not fit
    change(heading, rows)
    with open(out, "w", encoding="utf-8", newline="") as opened:
        csv.writer(opened, lineterminator="\n").writerows([heading, *rows])
    return out


def test_the_scenario_is_saved_and_the_truth_stays_apart(flight: Path) -> None:
    saved = tomllib.loads((flight / "floor.scenario.toml").read_text(encoding="utf-8"))
    assert saved["seed"] == 7
    assert saved["magnetometer"]["b_nT"] == [500.0, -300.0, 200.0]
    assert (flight / "truth.nc").stat().st_size > 0
    for name in ("floor.csv", "floor.nc"):
        assert b"500.0, -300" not in (flight / name).read_bytes()


def test_the_same_scenario_gives_the_same_telemetry(cli: Cli, flight: Path, tmp_path: Path) -> None:
    assert cli("simulate", flight / "floor.scenario.toml", "--out", tmp_path / "again.csv").status == 0
    assert (tmp_path / "again.csv").read_bytes() == (flight / "floor.csv").read_bytes()


def test_the_saved_scenario_finds_the_file_it_names(cli: Cli, tmp_path: Path) -> None:
    tle = (
        "1 25544U 98067A   12061.00000000  .00016717  00000-0  10270-3 0  9000\n"
        "2 25544  51.6400 200.0000 0001000  90.0000 270.0000 15.50000000    19\n"
    )
    start, end = SCENARIO.index("[orbit]"), SCENARIO.index("[attitude]")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "iss.tle").write_text(with_checksums(tle), encoding="utf-8")
    text = SCENARIO[:start] + '[orbit]\ntle = "iss.tle"\n' + SCENARIO[end:]
    (tmp_path / "in" / "iss.toml").write_text(text, encoding="utf-8")
    for name in ("out", "again"):
        (tmp_path / name).mkdir()
    assert cli("simulate", tmp_path / "in" / "iss.toml", "--out", tmp_path / "out" / "a.csv").status == 0
    saved = tmp_path / "out" / "a.scenario.toml"
    assert cli("simulate", saved, "--out", tmp_path / "again" / "a.csv").status == 0
    assert (tmp_path / "out" / "a.csv").read_bytes() == (tmp_path / "again" / "a.csv").read_bytes()


def with_checksums(tle: str) -> str:
    """The two lines with the checksum digit that the format wants in column 69."""
    lines = []
    for line in tle.splitlines():
        body = line[:68].ljust(68)
        digits = sum(int(c) if c.isdigit() else c == "-" for c in body)
        lines.append(f"{body}{digits % 10}\n")
    return "".join(lines)


def test_calibrate_finds_what_was_put_in(cli: Cli, flight: Path) -> None:
    outcome = cli("calibrate", flight / "floor.nc", "--json", "-")
    assert outcome.status == 0
    record = json.loads(outcome.out)
    sigma = {p["name"]: p["sigma"] for p in record["parameters"]}
    truth = tomllib.loads(SCENARIO)["magnetometer"]
    found = np.concatenate([np.ravel(record["S"]), record["b_nT"]])
    wanted = np.concatenate([np.ravel(truth["S"]), truth["b_nT"]])
    pulls = (found - wanted) / np.array(list(sigma.values()))
    # 12 normal pulls: one beyond 4.5 sigma by chance in 12 000 runs; the seed is fixed
    assert np.abs(pulls).max() < 4.5
    assert np.abs((found * 1.5 - wanted) / np.array(list(sigma.values()))).max() > 4.5, "the test must bite"
    assert record["convention"] == "A B0 = (I+S) B + b + T D"
    assert record["field_model"] == "igrf14"


def test_apply_takes_the_error_out(cli: Cli, flight: Path, tmp_path: Path) -> None:
    plain = ("--no-errors-in-variables", "--robust", "none", "--json", "-")  # then nothing is left but rounding
    before = cli("calibrate", flight / "floor.nc", "--out", tmp_path / "c.toml", *plain)
    made = ("--calibration", tmp_path / "c.toml", "--out", tmp_path / "corrected.nc")
    assert cli("apply", flight / "floor.nc", *made).status == 0
    after = cli("calibrate", tmp_path / "corrected.nc", *plain)
    assert np.linalg.norm(json.loads(before.out)["b_nT"]) > 500
    assert np.linalg.norm(json.loads(after.out)["b_nT"]) < 1e-6
    assert np.abs(json.loads(after.out)["S"]).max() < 1e-10


def test_yaw_comes_with_its_sigma_row_by_row(cli: Cli, flight: Path, tmp_path: Path) -> None:
    made = (
        "--calibration",
        flight / "calibration.toml",
        "--out",
        tmp_path / "yaw.csv",
        "--json",
        tmp_path / "yaw.json",
    )
    outcome = cli("yaw", flight / "floor.nc", *made)
    assert outcome.status == 0
    heading, rows = table(tmp_path / "yaw.csv")
    assert heading[:2] == ["time", "yaw_deg"]
    assert len(rows) == 200
    record = json.loads((tmp_path / "yaw.json").read_text(encoding="utf-8"))
    rms = record["summary"]["rms_against_reference_deg"]
    assert rms["full"] < 0.5 < 2.0 < rms["zero_yaw"]


def test_check_passes_good_telemetry_and_names_a_trap(cli: Cli, flight: Path, tmp_path: Path) -> None:
    good = cli("check", flight / "floor.csv", "--json", "-")
    assert good.status == 0
    assert json.loads(good.out)["clean"] is True

    def in_mG(heading: list[str], rows: list[list[str]]) -> None:
        at = [heading.index(f"mag_{axis}_nT") for axis in "xyz"]
        for row in rows:
            for column in at:
                row[column] = repr(float(row[column]) / 100)

    bad = cli("check", rewritten(flight / "floor.csv", tmp_path / "mG.csv", in_mG))
    assert bad.status == 1
    assert "mG" in bad.out


@pytest.mark.parametrize(
    ("count", "said"), [(1, "(row 31)"), (3, "(rows 31, 51, 71)"), (6, "(rows 31, 51, 71, 91, 111, ...; 6 in all)")]
)
def test_check_says_the_rows(cli: Cli, flight: Path, tmp_path: Path, count: int, said: str) -> None:
    def spikes(heading: list[str], rows: list[list[str]]) -> None:
        at = heading.index("mag_x_nT")
        for row in rows[30 : 30 + 20 * count : 20]:
            row[at] = repr(float(row[at]) + 40_000.0)

    outcome = cli("check", rewritten(flight / "floor.csv", tmp_path / "spikes.csv", spikes))
    assert outcome.status == 1
    assert said in " ".join(outcome.out.split())


def test_check_repairs_rows_out_of_order(cli: Cli, flight: Path, tmp_path: Path) -> None:
    def swap(heading: list[str], rows: list[list[str]]) -> None:
        rows[10], rows[20] = rows[20], rows[10]
        rows.insert(50, list(rows[50]))

    mixed = rewritten(flight / "floor.csv", tmp_path / "mixed.csv", swap)
    outcome = cli("check", mixed, "--repair", tmp_path / "sorted.csv")
    assert outcome.status == 1
    assert "time" in outcome.out
    assert cli("check", tmp_path / "sorted.csv").status == 0
    assert table(tmp_path / "sorted.csv") == table(flight / "floor.csv")


def one_message(outcome: object, status: int, *words: str) -> None:
    """One message on standard error, no traceback, nothing on standard output, the words in it."""
    assert outcome.status == status, outcome.err
    assert outcome.out == ""
    assert "Traceback" not in outcome.err
    messages = [line for line in outcome.err.splitlines() if line.startswith("fluxtwin: ")]
    assert len(messages) == 1, outcome.err
    for word in words:
        assert word in messages[0]


def drop_unit(heading: list[str], rows: list[list[str]]) -> None:
    heading[heading.index("mag_x_nT")] = "mag_x"


def drop_column(heading: list[str], rows: list[list[str]]) -> None:
    at = heading.index("mag_y_nT")
    for row in (heading, *rows):
        del row[at]


def turn_time_back(heading: list[str], rows: list[list[str]]) -> None:
    at = heading.index("time")
    rows[4][at], rows[5][at] = rows[5][at], rows[4][at]


def zero_quaternion(heading: list[str], rows: list[list[str]]) -> None:
    for name in ("q_x", "q_y", "q_z", "q_w"):
        rows[6][heading.index(name)] = "0.0"


def in_metres(heading: list[str], rows: list[list[str]]) -> None:
    for name in ("r_x_km", "r_y_km", "r_z_km"):
        for row in rows:
            row[heading.index(name)] = repr(1000 * float(row[heading.index(name)]))


def after_the_model(heading: list[str], rows: list[list[str]]) -> None:
    for row in rows:
        row[heading.index("time")] = row[heading.index("time")].replace("2012", "2042")


def not_a_number(heading: list[str], rows: list[list[str]]) -> None:
    rows[3][heading.index("mag_x_nT")] = "12,5 nT"


def only_the_heading(heading: list[str], rows: list[list[str]]) -> None:
    rows.clear()


def eight_samples(heading: list[str], rows: list[list[str]]) -> None:
    del rows[3:]


def all_blank(heading: list[str], rows: list[list[str]]) -> None:
    for row in rows:
        for name in ("mag_x_nT", "mag_y_nT", "mag_z_nT"):
            row[heading.index(name)] = "NaN"


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        (drop_unit, 2, ["mag_x", "mag_x_nT"]),
        (drop_column, 2, ["mag_y_nT"]),
        (turn_time_back, 2, ["time", "increas", "--repair"]),
        (zero_quaternion, 2, ["q", "row 7"]),
        (in_metres, 2, ["km"]),
        (after_the_model, 2, ["2042", "igrf14", "1900", "2030"]),
        (not_a_number, 2, ["12,5 nT"]),
        (only_the_heading, 2, ["row"]),
        (eight_samples, 1, ["3", "12"]),
        (all_blank, 1, []),
    ],
)
def test_a_bad_file_costs_one_message_and_leaves_nothing(
    cli: Cli,
    flight: Path,
    tmp_path: Path,
    change: Callable[[list[str], list[list[str]]], None],
    status: int,
    words: list[str],
) -> None:
    bad = rewritten(flight / "floor.csv", tmp_path / "bad.csv", change)
    out, record = tmp_path / "out.toml", tmp_path / "out.json"
    outcome = cli("calibrate", bad, "--out", out, "--json", record)
    one_message(outcome, status, *words)
    assert status == 1 or "bad.csv" in outcome.err or change is after_the_model
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.csv"]


def test_rows_with_nan_are_left_out_and_counted(cli: Cli, flight: Path, tmp_path: Path) -> None:
    def blanks(heading: list[str], rows: list[list[str]]) -> None:
        for row in rows[20:30]:
            row[heading.index("mag_x_nT")] = "NaN"

    outcome = cli("calibrate", rewritten(flight / "floor.csv", tmp_path / "nan.csv", blanks), "--json", "-")
    assert outcome.status == 0
    record = json.loads(outcome.out)
    assert record["samples"] == 190
    assert sum(record["rows"]["left_out"].values()) == 10


@pytest.mark.parametrize("command", ["check", "calibrate", "diagnose"])
def test_a_magnetometer_that_reads_nothing_but_zero_is_said_to(
    cli: Cli, flight: Path, tmp_path: Path, command: str
) -> None:
    def dead(heading: list[str], rows: list[list[str]]) -> None:
        for row in rows:
            for name in ("mag_x_nT", "mag_y_nT", "mag_z_nT"):
                row[heading.index(name)] = "0.0"

    outcome = cli(command, rewritten(flight / "floor.csv", tmp_path / "dead.csv", dead))
    assert outcome.status in (1, 2)
    assert "zero" in outcome.out + outcome.err or "stuck" in outcome.out + outcome.err


@pytest.mark.parametrize("content", [b"", b"\n\n", b"\x00" * 64, b"\xff\xfet\x00i\x00", b"time\n"])
@pytest.mark.parametrize("suffix", ["csv", "nc", "csv.gz"])
def test_a_file_of_rubbish(cli: Cli, tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"rubbish.{suffix}"
    path.write_bytes(content)
    one_message(cli("check", path), 2, f"rubbish.{suffix}")


def test_files_that_are_not_there(cli: Cli, flight: Path, tmp_path: Path) -> None:
    one_message(cli("calibrate", tmp_path / "none.csv"), 2, "none.csv")
    one_message(cli("check", tmp_path), 2, str(tmp_path))
    one_message(cli("simulate", tmp_path / "none.toml", "--out", tmp_path / "x.nc"), 2, "none.toml")
    wants = ("--calibration", tmp_path / "none.toml", "--out", tmp_path / "x.nc")
    one_message(cli("apply", flight / "floor.nc", *wants), 2, "none.toml")
    one_message(cli("check", flight / "floor.nc", "--map", tmp_path / "map.toml"), 2, "map.toml")
    one_message(cli("check", flight / "floor.nc", "--field", "chaos:none.mat"), 2, "none.mat")
    assert list(tmp_path.iterdir()) == []


def test_a_torquer_that_never_fired_is_refused_by_name(cli: Cli, flight: Path) -> None:
    outcome = cli("calibrate", flight / "floor.nc", "--parameters", "b,S,T", "--json", "-")
    record = json.loads(outcome.out)
    for axis in "XYZ":
        assert any(f"torquer {axis} never fired" in words for words in record["unobservable"])
    assert {p["sigma"] for p in record["parameters"] if p["name"].startswith("T")} == {None}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--parameters", "S"), ["b,S,T"]),
        (("--method", "threestep"), ["threestep", "linear", "scalar"]),
        (("--covariance", "grey"), ["grey", "white", "blocks"]),
        (("--robust", "very"), ["very", "none", "tukey"]),
        (("--block-s", "-1"), ["-1"]),
        (("--degree", "99"), ["99", "1 to 13"]),
    ],
)
def test_a_bad_option_costs_one_message(cli: Cli, flight: Path, options: tuple[str, str], words: list[str]) -> None:
    one_message(cli("calibrate", flight / "floor.nc", *options), 2, *words)


def test_an_unknown_scenario_key_is_answered_with_the_nearest(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "typo.toml"
    path.write_text(SCENARIO.replace("altitude_km", "altitud_km"), encoding="utf-8")
    outcome = cli("simulate", path, "--out", tmp_path / "x.nc")
    assert outcome.status == 2
    assert outcome.err.count("fluxtwin: ") == 1
    for word in ("typo.toml", "altitud_km", "altitude_km"):
        assert word in outcome.err
    assert [p.name for p in tmp_path.iterdir()] == ["typo.toml"]


def test_a_scenario_outside_the_field_model(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text(SCENARIO.replace("2012-", "1812-"), encoding="utf-8")
    one_message(cli("simulate", path, "--out", tmp_path / "x.nc"), 2, "1812", "1900", "2030")
    assert [p.name for p in tmp_path.iterdir()] == ["old.toml"]


@pytest.mark.parametrize("command", ["simulate", "calibrate", "apply", "run"])
def test_a_write_protected_folder(cli: Cli, flight: Path, tmp_path: Path, command: str) -> None:
    """A file stands where the folder should be made: nobody, not even root, can write below it."""
    wall = tmp_path / "wall"
    wall.write_text("", encoding="utf-8")
    calls = {
        "simulate": (flight / "floor.toml", "--out", wall / "x.nc"),
        "calibrate": (flight / "floor.nc", "--out", wall / "x.toml"),
        "apply": (flight / "floor.nc", "--calibration", flight / "calibration.toml", "--out", wall / "x.nc"),
        "run": ("seasat", "--out", wall),
    }
    one_message(cli(command, *calls[command]), 2, "wall")
    assert [p.name for p in tmp_path.iterdir()] == ["wall"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(cli: Cli, flight: Path, tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    one_message(cli("simulate", flight / "floor.toml", "--out", folder / "x.nc"), 2, "locked", "write-protected")
