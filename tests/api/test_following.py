"""`fluxtwin diagnose --follow`: rows as they come, by the command line and from Python."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli
from worlds import scenario_text

import fluxtwin
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = [pytest.mark.property, pytest.mark.usefixtures("lawless")]

SECTIONS = """
[attitude]
yaw_rms_deg = 4.0
roll_rms_deg = 4.0
pitch_rms_deg = 4.0
[attitude.reference]
sigma_deg = 0.05
tau_s = 0.0
[magnetometer]
b_nT = [1000.0, -500.0, 200.0]
noise_nT = 20.0
lsb_nT = 10.0
"""
CHANGE_ROW = 800


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Telemetry:
    path = tmp_path_factory.mktemp("follow") / "s.toml"
    path.write_text(scenario_text(SECTIONS, seed=5, segment="duration_min = 170.0, step_s = 10.0"), encoding="utf-8")
    return fluxtwin.simulate(str(path))[0]


@pytest.fixture(scope="module")
def noisy(record: Telemetry) -> Telemetry:
    """Its noise is five times as large from a row on."""
    mag = np.array(record.mag_B_nT)
    mag[CHANGE_ROW:] += np.random.default_rng(2).normal(0.0, 100.0, mag[CHANGE_ROW:].shape)
    return record.replace(mag_B_nT=mag)


def test_a_file_that_grows_rings(noisy: Telemetry, record: Telemetry, tmp_path: Path, cli: Cli) -> None:
    """Rows are appended in pieces that end in the middle of a line; the calibration of the quiet part is watched."""
    known = fluxtwin.calibrate(record.select(slice(0, 600))).calibration
    known.to_toml(tmp_path / "june.toml")
    text = b"# the receiver, its own line\n" + fluxtwin.write(noisy, tmp_path / "whole.csv").read_bytes()
    growing = tmp_path / "growing.csv"
    growing.write_bytes(text[:5000])

    def grow() -> None:
        with growing.open("ab") as file:
            for start in range(5000, len(text), 60_001):
                time.sleep(0.05)
                file.write(text[start : start + 60_001])
                file.flush()

    thread = threading.Thread(target=grow)
    thread.start()
    done = cli("diagnose", "--follow", growing, "--calibration", tmp_path / "june.toml", "--json", tmp_path / "a.json")
    thread.join()
    assert done.status == 1, done.err
    lines = done.out.splitlines()
    assert lines[0].startswith("watching: white noise") and "comparing |B| only" in lines[0]
    assert lines[1].startswith("2020-03-01T00Z: 360 rows, residual ")
    alarm = next(line for line in lines if line.startswith("ALARM 2020-03-01T02:1"))
    assert "june.toml no longer holds" in alarm and "Most likely change: the noise of" in alarm
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    since = np.datetime64(answer["alarm"]["since"].removesuffix("Z"))
    assert abs((since - noisy.time[CHANGE_ROW]) / np.timedelta64(10, "s")) < 30
    assert CHANGE_ROW < answer["rows"] < CHANGE_ROW + 40
    assert answer["diagnosis"]["samples"]["used"] > CHANGE_ROW and answer["mean_run_rows"] == 1e6


def test_records_from_python_are_the_same_to_the_bit_in_any_pieces(record: Telemetry) -> None:
    said: list[str] = []
    pieces = [record.select(slice(i, i + 97)) for i in range(0, len(record), 97)]
    one = fluxtwin.follow(iter([record]), said=said.append, attitude_sigma_deg=0.05)
    other = fluxtwin.follow(iter(pieces), attitude_sigma_deg=0.05)
    assert one.changed is None and one.line == said[-2] and "still holds" in one.line
    assert one.diagnosis.to_dict() == other.diagnosis.to_dict()
    assert one.diagnosis.to_dict() == fluxtwin.diagnose(record, attitude_sigma_deg=0.05).to_dict()
    assert fluxtwin.follow(record, attitude_sigma_deg=0.05) == one
    assert fluxtwin.follow(record.to_pandas(), attitude_sigma_deg=0.05).line == one.line
    assert "in all three components" in said[0]
    assert one.line in one.report() and one.diagnosis.sentence in one.report() and "<table" in one._repr_html_()
    assert one.plot().get_title(loc="left").startswith("Where the gap lies")
    assert one.rows in range(other.rows - 250, other.rows + 250)  # begun where the first piece was long enough


def test_rows_that_repeat_the_rounding_of_others_are_counted(tmp_path: Path) -> None:
    """A row every two seconds, in steps of 200 nT: one in four is tested; an hour has 1,800 rows all the same."""
    coarse = SECTIONS.replace("noise_nT = 20.0\nlsb_nT = 10.0", "noise_nT = 0.0\nlsb_nT = 200.0")
    path = tmp_path / "s.toml"
    path.write_text(scenario_text(coarse, seed=5, segment="duration_min = 160.0, step_s = 2.0"), encoding="utf-8")
    record, said = fluxtwin.simulate(path)[0], list[str]()
    pieces = [record.select(slice(i, i + 97)) for i in range(0, len(record), 97)]
    known = fluxtwin.calibrate(record).calibration
    found = fluxtwin.follow(iter(pieces), calibration=known, said=said.append)
    assert found.changed is None and len(record) == found.rows == 4801 and "in 4801 rows" in found.line
    assert said[1].startswith("2020-03-01T00Z: 1800 rows")
    few = record.select(slice(0, None, 2))
    with pytest.raises(fluxtwin.NoAnswer, match="2401 rows, of which one in 8 counts as the readings repeat: "):
        fluxtwin.follow(few.replace(mag_B_nT=1500.0 * np.round(few.mag_B_nT / 1500.0)))


def test_a_table_is_read_as_by_every_verb(record: Telemetry, tmp_path: Path) -> None:
    two = record.replace(mag_B_nT=np.full((len(record), 3), np.nan), mag2_B_nT=record.mag_B_nT)
    line = fluxtwin.follow(record, attitude_sigma_deg=0.05).line
    for given in (two, two.to_pandas()):
        assert fluxtwin.follow(given, magnetometer=2, attitude_sigma_deg=0.05).line == line
    with pytest.raises(fluxtwin.BadInput, match=r"none\.toml"):
        fluxtwin.follow(record.to_pandas(), column_map=tmp_path / "none.toml")
    with pytest.raises(fluxtwin.BadInput, match="column_map: a record is read already"):
        fluxtwin.follow(record, column_map=tmp_path / "none.toml")


def test_a_selection_is_followed_and_ends_the_stream(record: Telemetry, tmp_path: Path, cli: Cli) -> None:
    """From Python in pieces, and from a file that would be followed for ever: the rows that `diagnose` takes."""
    begin, end = (str(record.time[row]) for row in (30, 1000))
    chosen = {"start": begin, "end": end, "where": "mag_x_nT > -15000"}
    whole = fluxtwin.diagnose(record, **chosen, attitude_sigma_deg=0.05).to_dict()
    pieces = [record.select(slice(i, i + 97)) for i in range(0, len(record), 97)]
    assert fluxtwin.follow(iter(pieces), **chosen, attitude_sigma_deg=0.05).diagnosis.to_dict() == whole
    path, options = (
        fluxtwin.write(record, tmp_path / "t.csv"),
        ("--from", begin, "--to", end, "--where", chosen["where"]),
    )
    done = cli("diagnose", "--follow", path, *options, "--attitude-sigma-deg", "0.05", "--json", tmp_path / "a.json")
    assert done.status == 0, done.err
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert answer["diagnosis"]["samples"] == whole["samples"] and answer["last"] < f"{end}Z"


def test_what_cannot_be_followed_is_said(record: Telemetry, tmp_path: Path, cli: Cli) -> None:
    whole = fluxtwin.write(record, tmp_path / "t.nc")
    (tmp_path / "c.toml").write_text("", encoding="utf-8")
    for words, said in (
        (("--follow", whole), "while it is still being written"),
        (("--follow", tmp_path / "none.csv"), "No such file"),
        (("--follow", whole, "--close", tmp_path / "x.toml"), "no other effects"),
        (("--follow", whole, "--where", "sunlit ="), "cannot be read"),
        ((whole, "--calibration", tmp_path / "c.toml"), "is for --follow"),
    ):
        done = cli("diagnose", *words)
        assert done.status == 2 and said in done.err, done.err


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_standard_input_and_an_interrupt(record: Telemetry, tmp_path: Path) -> None:
    """A stream that is too short says so; one that stays open ends at Ctrl-C, as any command does."""
    text = fluxtwin.write(record, tmp_path / "t.csv").read_bytes()
    short = b"".join(text.splitlines(keepends=True)[:300])
    command = [sys.executable, "-m", "fluxtwin", "diagnose", "--follow", "-"]
    done = subprocess.run(command, input=short, capture_output=True, check=False, timeout=120)
    assert done.returncode == 1 and b"the stream ended after 299 rows" in done.stderr
    running = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert running.stdin is not None and running.stdout is not None
    running.stdin.write(text)
    running.stdin.flush()
    assert running.stdout.readline().startswith(b"watching")
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130 and said.endswith(b"interrupted; nothing half-written is left behind\n"), said


@pytest.mark.parametrize("to_a_file", [True, False])
def test_without_a_reader_it_ends_unless_a_file_was_asked_for(
    noisy: Telemetry, tmp_path: Path, to_a_file: bool
) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    rows = fluxtwin.write(noisy, tmp_path / "rows.csv")
    command = [sys.executable, "-m", "fluxtwin", "diagnose", "--follow", "-", "--noise-nT", "20"]
    command += ["--json", str(tmp_path / "x.json")] if to_a_file else []
    with open(rows, "rb") as stream:
        done = subprocess.run(command, stdin=stream, stdout=write_end, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write_end)
    assert (done.returncode, (tmp_path / "x.json").exists()) == ((1, True) if to_a_file else (0, False)), done.stderr
    assert "Traceback" not in done.stderr and "ignored" not in done.stderr
