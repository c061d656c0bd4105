"""A corrected record says so in every kind of file, and every verb that reads it knows."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from worlds import tumbling

import fluxtwin
from fluxtwin.calib.common.records import CONVENTION
from fluxtwin.sim.scenario.scenario import parse_scenario

SCENARIO = """
seed = 11
[spacecraft]
name = "First, one"
[orbit]
epoch_utc = "2012-03-01T00:00:00Z"
altitude_km = 700.0
inclination_deg = 98.0
raan_deg = 40.0
argument_of_latitude_deg = 0.0
[attitude]
yaw_rms_deg = 5.0
roll_rms_deg = 5.0
pitch_rms_deg = 5.0
[magnetometer]
S = [[0.02, -0.01, 0.004], [0.013, -0.02, -0.004], [0.007, -0.003, 0.002]]
b_nT = [500.0, -300.0, 200.0]
noise_nT = 20.0
[schedule]
segments = [{ start_utc = "2012-03-01T00:00:00Z", samples = 200, step_s = 60.0 }]
"""
FORCED = "--force"

Cli = Callable[..., object]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with telemetry as .nc and .csv, of another spacecraft and of other days, a calibration, corrected files."""
    from fluxtwin.cli import main

    folder = tmp_path_factory.mktemp("corrected")
    for name, text in (
        ("raw", SCENARIO),
        ("other", SCENARIO.replace("First, one", "Second")),
        ("near", SCENARIO.replace('2012-03-01T00:00:00Z", samples', '2012-03-01T01:00:00Z", samples')),
        ("late", SCENARIO.replace('2012-03-01T00:00:00Z", samples', '2012-03-09T00:00:00Z", samples')),
    ):
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        for suffix in ("nc", "csv"):
            assert main(["simulate", str(folder / f"{name}.toml"), "--out", str(folder / f"{name}.{suffix}")]) == 0
    known = folder / "known.toml"
    assert main(["calibrate", str(folder / "raw.csv"), "--out", str(known)]) == 0
    for suffix in ("nc", "csv", "csv.gz"):
        raw, out = folder / f"raw.{suffix.removesuffix('.gz')}", folder / f"corrected.{suffix}"
        assert main(["apply", str(raw), "--calibration", str(known), "--out", str(out)]) == 0
    return folder


def refused(outcome: object, *words: str) -> None:
    assert outcome.status == 2, outcome  # type: ignore[attr-defined]
    for word in words:
        assert word in outcome.err  # type: ignore[attr-defined]


@pytest.mark.parametrize("suffix", ["nc", "csv", "csv.gz"])
def test_the_file_says_by_what_and_whose_it_is(flight: Path, suffix: str) -> None:
    known = fluxtwin.Calibration.from_toml(flight / "known.toml")
    record = fluxtwin.read(flight / f"corrected.{suffix}")
    assert known.spacecraft.startswith("First")
    assert record.spacecraft.startswith("First")
    assert known.digest[:12] in record.corrected_by
    assert fluxtwin.read(flight / "raw.nc").corrected_by == ""
    assert known.digest in (flight / "known.toml").read_text("utf-8")


def test_any_reader_of_csv_takes_the_file(flight: Path) -> None:
    with open(flight / "corrected.csv", newline="", encoding="utf-8") as opened:
        rows = list(csv.DictReader(opened))
    assert len(rows) == 200
    assert {row["spacecraft"] for row in rows} == {"First; one"}
    assert {row["mag_corrected_by"][:12] for row in rows} == {"calibration "}


@pytest.mark.parametrize("suffix", ["nc", "csv", "csv.gz"])
def test_a_second_correction_is_refused(cli: Cli, flight: Path, tmp_path: Path, suffix: str) -> None:
    again = (
        "apply",
        flight / f"corrected.{suffix}",
        "--calibration",
        flight / "known.toml",
        "--out",
        tmp_path / "2.csv",
    )
    refused(cli(*again), "corrected already", "--force")
    assert not (tmp_path / "2.csv").exists()
    forced = cli(*again, FORCED)
    assert forced.status == 0  # type: ignore[attr-defined]
    assert "applied anyway, by --force" in forced.err  # type: ignore[attr-defined]
    assert "corrected already" in forced.err  # type: ignore[attr-defined]
    assert fluxtwin.read(tmp_path / "2.csv").corrected_by.count(" then ") == 1


@pytest.mark.parametrize("suffix", ["nc", "csv"])
def test_another_spacecraft_is_refused(cli: Cli, flight: Path, tmp_path: Path, suffix: str) -> None:
    words = ("'Second'", "'First; one'", "--force")
    call = ("apply", flight / f"other.{suffix}", "--calibration", flight / "known.toml", "--out", tmp_path / "out.nc")
    refused(cli(*call), *words)
    assert not (tmp_path / "out.nc").exists()
    assert cli(*call, FORCED).status == 0  # type: ignore[attr-defined]
    yaw = ("yaw", flight / f"other.{suffix}", "--calibration", flight / "known.toml")
    refused(cli(*yaw), *words)
    assert cli(*yaw, FORCED).status == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize(("name", "rows"), [("near", 60), ("late", 200)])
@pytest.mark.parametrize("verb", ["apply", "yaw"])
def test_another_time_is_said(noting: Cli, flight: Path, tmp_path: Path, verb: str, name: str, rows: int) -> None:
    """An hour beyond the end of the calibration's data, and a week after it."""
    more = ("--out", tmp_path / "o.nc") if verb == "apply" else ()
    outcome = noting(verb, flight / f"{name}.nc", "--calibration", flight / "known.toml", *more)
    assert outcome.status == 0  # type: ignore[attr-defined]
    said = f"{rows} of the 200 rows here are of another time"
    assert said in outcome.err and "2012-03-01T03:19:00Z" in outcome.err  # type: ignore[attr-defined]


@pytest.mark.parametrize("suffix", ["nc", "csv"])
def test_yaw_needs_no_calibration_for_a_corrected_record(cli: Cli, flight: Path, suffix: str) -> None:
    raw = cli("yaw", flight / f"raw.{suffix}", "--calibration", flight / "known.toml", "--json", "-")
    corrected = cli("yaw", flight / f"corrected.{suffix}", "--json", "-")
    yaw, sigma = (
        [np.array(json.loads(one.out)[key]) for one in (raw, corrected)]  # type: ignore[attr-defined]
        for key in ("yaw_deg", "sigma_deg")
    )
    assert np.abs(yaw[1] - yaw[0]).max() < 1e-9
    assert sigma[1] == pytest.approx(sigma[0], rel=5e-3)  # the stamp gives the residual with three digits
    refused(cli("yaw", flight / f"raw.{suffix}"), "not corrected", "--calibration")
    refused(cli("yaw", flight / f"corrected.{suffix}", "--calibration", flight / "known.toml"), "corrected already")


def test_a_calibration_that_was_not_fitted_states_no_residual(cli: Cli, flight: Path, tmp_path: Path) -> None:
    """Written by hand, it says nothing of the error of a component: neither mark nor sigma of yaw take it for zero."""
    by_hand, out = tmp_path / "hand.toml", tmp_path / "out.csv"
    S = fluxtwin.Calibration.from_toml(flight / "known.toml").S.tolist()
    by_hand.write_text(f'convention = "{CONVENTION}"\nS = {S}\nb_nT = [500.0, -300.0, 200.0]\n', encoding="utf-8")
    applied = cli("apply", flight / "raw.nc", "--calibration", by_hand, "--out", out)
    assert applied.status == 0 and "residual" not in applied.out  # type: ignore[attr-defined]
    assert len(fluxtwin.read(out).corrected_by) == len("calibration 0123456789ab")
    for words in (("yaw", flight / "raw.nc", "--calibration", by_hand), ("yaw", out)):
        refused(cli(*words), "the error of a field component is not known")
        assert cli(*words, "--sigma-nT", "20").status == 0  # type: ignore[attr-defined]
    refused(cli("apply", out, "--calibration", by_hand, "--out", tmp_path / "twice.csv"), "corrected already")


def test_a_calibration_of_corrected_readings_is_a_residual_one(cli: Cli, flight: Path, tmp_path: Path) -> None:
    rest = tmp_path / "rest.toml"
    outcome = cli("calibrate", flight / "corrected.nc", "--out", rest)
    assert outcome.status == 0  # type: ignore[attr-defined]
    assert "corrected already" in outcome.out  # type: ignore[attr-defined]
    assert fluxtwin.Calibration.from_toml(rest).residual_to == fluxtwin.read(flight / "corrected.nc").corrected_by
    composed = ("--calibration", rest, "--out", tmp_path / "composed.nc")
    assert cli("apply", flight / "corrected.csv", *composed).status == 0  # type: ignore[attr-defined]
    refused(cli("apply", flight / "raw.nc", *composed), "these are not corrected")


def test_diagnose_says_that_the_readings_are_corrected(cli: Cli, flight: Path) -> None:
    words = ("--attitude-sigma-deg", "0.01", "--noise-nT", "20")
    outcome = cli("diagnose", flight / "corrected.nc", "--scenario", flight / "raw.toml", *words)
    assert outcome.status == 0  # type: ignore[attr-defined]
    assert "the readings are corrected already" in outcome.err  # type: ignore[attr-defined]


def test_corrected_rows_are_not_mixed_with_others(cli: Cli, flight: Path, tmp_path: Path) -> None:
    half = flight / "corrected.csv"
    lines = [line.rpartition(",")[0] for line in half.read_text("utf-8").splitlines()]  # without its checks
    lines[50] = lines[50].rsplit(",", 1)[0] + ","
    (tmp_path / "mixed.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    refused(cli("check", tmp_path / "mixed.csv"), "mag_corrected_by", "different rows")
    refused(cli("calibrate", flight / "corrected.csv", flight / "late.csv"), "those of another are not")
    refused(cli("calibrate", flight / "raw.csv", flight / "other.csv"), "different spacecraft")


def test_what_a_calibration_is_wrong_by_is_no_gap(tmp_path: Path) -> None:
    """Its T, and the field of a column, are known to their sigmas, and the torquers are strong: 7 nT rms of the 52 nT that
    are left are the error of T, and were named torquer_coupling, at p < 1e-12."""
    record, _ = fluxtwin.simulate("cubesat")
    dipole, heater = np.array(record.dipole_B_Am2), (np.arange(len(record)) // 150 % 2).astype(float)
    dipole[700], heater[900] = np.nan, np.nan  # their rows have no corrected reading
    record = record.replace(dipole_B_Am2=dipole, drivers={"heater": heater})
    calibration = fluxtwin.calibrate(record, parameters="b,S,T", driver=["heater"]).calibration
    corrected = fluxtwin.apply(record, calibration)
    assert corrected.corrected_by.endswith("nT) with T; driver_heater")
    for kind in ("csv", "nc"):
        fluxtwin.write(corrected, tmp_path / f"corrected.{kind}")
        again = fluxtwin.read(tmp_path / f"corrected.{kind}")
        assert again.corrected_by == corrected.corrected_by
    diagnosis = fluxtwin.diagnose(corrected)
    assert diagnosis.modelled[2:] == ["torquer_coupling", "driver.heater"]
    assert diagnosis.verdict == "no_gap", diagnosis.sentence
    still = corrected.replace(dipole_B_Am2=np.zeros((len(record), 3)), drivers={})
    assert fluxtwin.diagnose(still.select(slice(0, 400))).modelled == ["bias", "scale_misalignment"]


def test_other_columns_than_drivers_that_the_calibration_followed_are_estimated_anew() -> None:
    record, _ = fluxtwin.simulate(parse_scenario(tumbling()))
    current_A = 2.0 + np.sin(np.arange(len(record)) / 9.0)
    record = record.replace(
        array_current_A=current_A, mag_B_nT=record.mag_B_nT + current_A[:, None] * [40.0, -20.0, 9.0]
    )
    calibration = fluxtwin.calibrate(record, driver=["array_current_A"]).calibration
    corrected = fluxtwin.apply(record, calibration)
    assert corrected.corrected_by.endswith("nT) with array_current_A")
    diagnosis = fluxtwin.diagnose(corrected)
    assert diagnosis.modelled == ["bias", "scale_misalignment", "driver.array_current_A"]
    assert diagnosis.verdict == "no_gap", diagnosis.sentence
    own = fluxtwin.diagnose(record, modelled=["bias", "scale_misalignment", "driver.array_current_A"])
    assert own.verdict == "no_gap", own.sentence
    exactly = fluxtwin.diagnose(corrected, modelled=("bias", "scale_misalignment"))
    assert exactly.modelled == ["bias", "scale_misalignment"], "what is asked for by name is all there is"
    still = corrected.replace(array_current_A=np.ones(len(record)))
    assert fluxtwin.diagnose(still).modelled == ["bias", "scale_misalignment"]
