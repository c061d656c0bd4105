"""`fluxtwin calibrate` where no attitude is known, as a person meets it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

Cli = Callable[..., object]
B_NT = np.array([400.0, -300.0, 200.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`tumbling.nc` with an array current, and `spinning.nc` about an axis along the field's own plane."""
    place, rng = tmp_path_factory.mktemp("scalar"), np.random.default_rng(5)
    time = np.datetime64("2020-03-01", "ns") + np.arange(400) * np.timedelta64(15, "s")
    r, v = Orbit(epoch_utc=time[0], altitude_km=600.0, inclination_rad=1.5, raan_rad=1.0).propagate(time)
    field_N = field_N_nT(load_field("igrf14"), time, r)
    current = np.abs(rng.normal(size=400))
    tumbling = Rotation.from_rotvec(2.0 * rng.normal(size=(400, 3))).apply(field_N)
    mag = tumbling - B_NT + current[:, None] * np.array([300.0, -200.0, 100.0]) + 20.0 * rng.normal(size=(400, 3))
    record = Telemetry(time=time, mag_B_nT=mag, r_N_km=r, v_N_km_s=v, array_current_A=current)
    write_telemetry(record, place / "tumbling.nc")
    angle = rng.uniform(0.0, 6.3, 400)
    size = np.linalg.norm(field_N, axis=1)
    flat = np.stack([size * np.cos(angle), size * np.sin(angle), np.zeros(400)], axis=1)
    write_telemetry(record.replace(mag_B_nT=flat - B_NT + 20.0 * rng.normal(size=(400, 3))), place / "spinning.nc")
    return place


def test_without_attitude_scalar_is_taken(cli: Cli, folder: Path, tmp_path: Path) -> None:
    outcome = cli(
        "calibrate",
        folder / "tumbling.nc",
        "--out",
        tmp_path / "c.toml",
        "--json",
        tmp_path / "c.json",
        "--driver",
        "array_current_A",
        "--figures",
        tmp_path / "figures",
        "--unseen",
        folder / "tumbling.nc",
    )
    assert outcome.status == 0, outcome.err
    assert "without attitude" in outcome.out
    assert "array_current_A x" in outcome.out
    assert "in |B|" in outcome.out
    content = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    assert content["method_name"] == "scalar"
    assert np.abs(np.array(content["telemetry_bias"]["array_current_A"]["nT_per_unit"]) - [300, -200, 100]).max() < 20.0
    known = Calibration.from_toml(tmp_path / "c.toml")
    assert np.abs((known.b_nT - B_NT) / known.sigmas[9:]).max() < 4.5
    assert (tmp_path / "figures" / "residuals.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("method", "parameters"), [("center", "b"), ("twostep", "b"), ("twostep", "b,S"), ("scalar", "b")]
)
def test_each_method_by_name(cli: Cli, folder: Path, tmp_path: Path, method: str, parameters: str) -> None:
    out = tmp_path / "c.toml"
    outcome = cli("calibrate", folder / "tumbling.nc", "--method", method, "--parameters", parameters, "--out", out)
    assert outcome.status == 0, outcome.err
    assert out.is_file()
    assert f"for {parameters}, without attitude" in Calibration.from_toml(out).method


@pytest.mark.parametrize("options", [(), ("--method", "center"), ("--parameters", "b"), ("--method", "twostep")])
def test_a_plane_is_refused_in_one_message_and_nothing_is_written(
    cli: Cli, folder: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    outcome = cli("calibrate", folder / "spinning.nc", "--out", tmp_path / "c.toml", *options)
    assert outcome.status == 1
    said = [line for line in outcome.err.splitlines() if not line.endswith(" ...")]  # a slow machine shows progress
    assert len(said) == 1 and said[0].startswith("fluxtwin: ")
    assert "normal body Z" in outcome.err
    assert "Traceback" not in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_an_attitude_method_without_attitude(cli: Cli, folder: Path) -> None:
    outcome = cli("calibrate", folder / "tumbling.nc", "--method", "linear")
    assert outcome.status == 1
    assert "no reference attitude" in outcome.err
    outcome = cli("calibrate", folder / "tumbling.nc", "--method", "scalar", "--errors-in-variables")
    assert outcome.status == 2
    assert "--errors-in-variables" in outcome.err


def test_a_spinner_by_batch_and_iteration(cli: Cli, tmp_path: Path) -> None:
    """Ten minutes of ST5 through files: CSV and NetCDF, rows of pulses between rows of readings."""
    from fluxtwin.scenarios.st5 import mission

    segment = {"start_utc": "2006-04-15T00:00:00Z", "samples": 4800, "step_s": 0.125}
    flight = mission.fly(mission.scenario().updated({"schedule.segments": [segment]}))
    for method, suffix in (("batch", "nc"), ("iterative", "csv")):
        record, out = tmp_path / f"st5.{suffix}", tmp_path / f"{method}.toml"
        write_telemetry(flight.telemetry, record)
        outcome = cli(
            "calibrate",
            record,
            "--method",
            method,
            "--noise-nT",
            "200",
            "--sun-sigma-deg",
            "0.18",
            "--out",
            out,
            "--json",
            tmp_path / "c.json",
        )
        assert outcome.status == 0, outcome.err
        assert "blind start" in outcome.out
        assert "per component" in outcome.out
        assert "the sun sensor defines it" in outcome.out.lower().replace("\n", " ")
        content = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
        assert content["method_name"] == method
        assert abs(content["motion"]["inertia_ratio"] - 1.4) < 1e-3
        known = Calibration.from_toml(out)
        truth = np.concatenate([flight.truth.S.ravel(), flight.truth.b_nT])
        assert np.abs((known.values - truth) / known.sigmas).max() < 5.0
    outcome = cli("calibrate", tmp_path / "st5.nc", "--method", "batch", "--robust", "huber")
    assert outcome.status == 2
    assert "--robust" in outcome.err
