"""The second magnetometer through the commands: its own calibration, never the other one's, into its own columns."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli, status_of
from worlds import scenario_text

import fluxtwin
from fluxtwin.sim.base.errors import BadInput

pytestmark = [pytest.mark.closure, pytest.mark.usefixtures("small_figures")]
SENSORS = """
[attitude]
mode = "earth_pointing"
yaw_rms_deg = 20.0
roll_rms_deg = 10.0
pitch_rms_deg = 10.0
[attitude.reference]
sigma_deg = 0.1
tau_s = 0.0
[magnetometer]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 20.0
[magnetometer_2]
b_nT = [-700.0, 400.0, 900.0]
noise_nT = 60.0
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    (folder / "s.toml").write_text(
        scenario_text(SENSORS, seed=2, segment="samples = 750, step_s = 20.0"), encoding="utf-8"
    )
    assert status_of("simulate", folder / "s.toml", "--out", folder / "t.nc", "-q") == 0
    return folder / "t.nc"


def test_each_is_calibrated_and_the_shared_part_is_the_attitudes(cli: Cli, flown: Path, tmp_path: Path) -> None:
    shown = ("--html", tmp_path / "c.html", "--figures", tmp_path / "figures")
    done = cli("calibrate", flown, "--both", "--out", tmp_path / "c.toml", "--json", tmp_path / "c.json", *shown)
    assert done.status == 0, done.err
    page = (tmp_path / "c.html").read_text(encoding="utf-8")
    assert page.count("nT per component are common to both") == 1 and page.count("<img") >= 4
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == ["residuals-2.png", "residuals.png"]
    found = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    for fit, truth in ((found, [1500.0, -800.0, 300.0]), (found["second"], [-700.0, 400.0, 900.0])):
        for one in fit["parameters"][9:12]:
            assert abs(one["value"] - truth[int(one["name"][1]) - 1]) < 4.0 * one["sigma"]
    field = np.linalg.norm(fluxtwin.read(flown).mag_B_nT, axis=1)
    attitude_nT = float(np.sqrt(np.mean(field**2) * 2.0 / 3.0)) * np.radians(0.1)  # two of three components turn
    assert found["pair"]["shared_nT"] == pytest.approx(attitude_nT, rel=0.1)
    assert found["pair"]["own_nT"] == [pytest.approx(20.0, rel=0.1), pytest.approx(60.0, rel=0.1)]
    second = fluxtwin.Calibration.from_toml(tmp_path / "c-2.toml")
    assert second.magnetometer == 2 and fluxtwin.Calibration.from_toml(tmp_path / "c.toml").magnetometer == 1
    alone = fluxtwin.calibrate(flown, magnetometer=2).calibration
    assert np.array_equal(alone.b_nT, second.b_nT)


def test_the_next_steps_of_both_write_no_file_twice(cli: Cli, flown: Path) -> None:
    said = " ".join(cli("calibrate", flown, "--both").out.split())
    assert re.findall(r"--out (\S+\.toml)", said) == ["t-calibration.toml", "t-calibration-2.toml"]


@pytest.mark.usefixtures("lawless")
def test_the_diagnosis_says_what_it_used_of_the_other_and_how_to_ask_it(cli: Cli, flown: Path, tmp_path: Path) -> None:
    """Noise of 20 and 60 nT, 63 nT together; a magnetometer alone hears nothing of another."""
    done = cli("diagnose", flown, "--html", tmp_path / "d.html")
    assert done.status == 0, done.err
    said = " ".join(done.out.split())
    found = re.search(r"two magnetometers differ by (\S+) nT rms, and their noise explains (\S+) nT. This rules", said)
    assert found and all(float(size) == pytest.approx(np.hypot(20.0, 60.0), rel=0.1) for size in found.groups())
    assert "--magnetometer 2, or fluxtwin calibrate --both." in said
    assert "--magnetometer 1, or fluxtwin calibrate --both." in " ".join(
        cli("diagnose", flown, "--magnetometer", 2).out.split()
    )
    assert "two magnetometers differ by" in (tmp_path / "d.html").read_text(encoding="utf-8")
    fluxtwin.write(fluxtwin.read(flown).replace(mag2_B_nT=None), tmp_path / "one.nc")
    assert "two magnetometers" not in cli("diagnose", tmp_path / "one.nc").out


@pytest.mark.parametrize("noise_nT", [1.0, 60.0])
def test_what_drowns_in_the_shared_part_is_given_a_limit_and_not_a_zero(
    cli: Cli, tmp_path: Path, noise_nT: float
) -> None:
    text = SENSORS.replace("noise_nT = 20.0", "noise_nT = 1.0").replace("noise_nT = 60.0", f"noise_nT = {noise_nT}")
    text = text.replace("sigma_deg = 0.1", "sigma_deg = 1.0").replace("tau_s = 0.0", "tau_s = 300.0")
    (tmp_path / "s.toml").write_text(
        scenario_text(text, seed=2, segment="samples = 750, step_s = 20.0"), encoding="utf-8"
    )
    record, _ = fluxtwin.simulate(tmp_path / "s.toml")
    fluxtwin.write(record, tmp_path / "t.nc")
    done = cli("calibrate", tmp_path / "t.nc", "--both", "--json", tmp_path / "c.json")
    assert "less than" in done.out and " 0.0 " not in done.out.partition("common to both")[2]
    pair = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["pair"]
    assert pair["own_nT"][0] is None and pair["most_nT"][1] > 1.0
    for own, most, truth in zip(pair["own_nT"], pair["most_nT"][1:], (1.0, noise_nT), strict=True):
        assert own is None or abs(own - truth) < most - own
        assert truth < 1.5 * most  # two sigma above: an estimate two sigma low may miss it


def test_a_second_magnetometer_that_is_none_leaves_no_file(cli: Cli, flown: Path, tmp_path: Path) -> None:
    record = fluxtwin.read(flown)
    assert record.mag2_B_nT is not None
    fluxtwin.write(record.replace(mag2_B_nT=1.5 * record.mag2_B_nT), tmp_path / "t.nc")
    done = cli("calibrate", tmp_path / "t.nc", "--both", "--out", tmp_path / "c.toml")
    assert done.status == 1 and "c-2.toml is not written" in done.out and (tmp_path / "c.toml").exists()
    assert not (tmp_path / "c-2.toml").exists()
    cli("calibrate", tmp_path / "t.nc", "--both", "--out", tmp_path / "c.toml", "--force")
    assert (tmp_path / "c-2.toml").exists()


def test_a_calibration_corrects_its_own_magnetometer_only(cli: Cli, flown: Path, tmp_path: Path) -> None:
    fluxtwin.calibrate(flown, magnetometer=2).calibration.to_toml(tmp_path / "c2.toml")
    refused = cli("apply", flown, "--calibration", tmp_path / "c2.toml", "--out", tmp_path / "x.nc")
    assert refused.status == 2 and "--magnetometer 2" in refused.err
    for name in ("x.nc", "x.csv"):
        out = tmp_path / name
        assert cli("apply", flown, "--magnetometer", 2, "--calibration", tmp_path / "c2.toml", "--out", out).status == 0
        before, after = fluxtwin.read(flown), fluxtwin.read(out)
        assert np.array_equal(after.mag_B_nT, before.mag_B_nT) and not after.corrected_by
        assert after.mag2_B_nT is not None and before.mag2_B_nT is not None
        moved = np.mean(after.mag2_B_nT - before.mag2_B_nT, axis=0)
        assert np.allclose(moved, [-700.0, 400.0, 900.0], atol=150.0)  # S adds up to 0.003 of the mean field
        assert after.with_magnetometer(2).corrected_by and after.with_magnetometer(2).with_magnetometer(1) is not after
        with pytest.raises(BadInput, match="corrected already"):
            fluxtwin.apply(out, tmp_path / "c2.toml", magnetometer=2)


def test_there_is_no_second_magnetometer(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,mag_x_nT,mag_y_nT,mag_z_nT\n2026-03-01T00:00:00Z,1,2,3\n", encoding="utf-8")
    done = cli("check", tmp_path / "t.csv", "--magnetometer", 2)
    assert done.status == 2 and "one magnetometer" in done.err and "mag2_x_nT" in done.err
