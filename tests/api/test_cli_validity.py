"""A calibration says for what time and temperatures it was made; apply and yaw say where a record leaves them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli
from worlds import THERMAL, scenario_text

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.scenario.scenario import parse_scenario

MAGNETOMETER = "\n[magnetometer]\nb_nT = [1000.0, -500.0, 300.0]\nnoise_nT = 20.0\n"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("validity")
    text = scenario_text(MAGNETOMETER + THERMAL, segment="samples = 300, step_s = 30.0")
    record, _ = fluxtwin.simulate(parse_scenario(text, where="test"))
    assert record.temperature_degC is not None
    fluxtwin.write(record, folder / "t.nc")
    fluxtwin.calibrate(record.select(slice(0, 200))).calibration.to_toml(folder / "c.toml")
    fluxtwin.write(record.replace(temperature_degC=record.temperature_degC + 15.0), folder / "hot.nc")
    return folder


def test_the_file_has_the_range_of_the_rows_that_were_used(files: Path, tmp_path: Path) -> None:
    known = fluxtwin.Calibration.from_toml(files / "c.toml")
    seen = fluxtwin.read(files / "t.nc").temperature_degC
    assert seen is not None and known.temperature_degC is not None
    assert np.allclose(known.temperature_degC, (seen[:200].min(), seen[:200].max()), atol=0.01)
    text = (files / "c.toml").read_text(encoding="utf-8").replace(f"{known.temperature_degC[0]!r},", "999.0,", 1)
    mended = "\n".join(line for line in text.splitlines() if not line.startswith("sha256"))
    (tmp_path / "c.toml").write_text(mended, encoding="utf-8")
    with pytest.raises(BadInput, match="temperature_degC"):
        fluxtwin.Calibration.from_toml(tmp_path / "c.toml")


@pytest.mark.parametrize("verb", ["apply", "yaw"])
def test_rows_outside_are_counted(files: Path, tmp_path: Path, process: Cli, verb: str) -> None:
    more = ("--out", tmp_path / "o.nc") if verb == "apply" else ()
    hot = process(verb, files / "hot.nc", "--calibration", files / "c.toml", *more)
    assert hot.status == 0 and "100 of the 300 rows here are of another time" in hot.err
    assert "temperatures that the calibration has not seen" in hot.err and "degC), by up to 1" in hot.err


def test_rows_outside_are_warned_of_in_python(files: Path) -> None:
    with pytest.warns(UserWarning, match="100 of the 300 rows here are of another time") as said:
        fluxtwin.apply(files / "t.nc", files / "c.toml")
    assert "temperatures" not in str(said[0].message)


@pytest.mark.parametrize("verb", ["apply", "yaw"])
def test_rows_after_the_expiry_are_counted(files: Path, tmp_path: Path, noting: Cli, verb: str) -> None:
    known, time = fluxtwin.Calibration.from_toml(files / "c.toml"), fluxtwin.read(files / "t.nc").time
    replace(known, expires=time[180]).to_toml(tmp_path / "c.toml")
    assert fluxtwin.Calibration.from_toml(tmp_path / "c.toml").expires == time[180]
    more = ("--out", tmp_path / "o.nc") if verb == "apply" else ()
    done = noting(verb, files / "t.nc", "--calibration", tmp_path / "c.toml", *more)
    assert done.status == 0 and "rows here are of another time, 120 are after 2" in done.err and "expires" in done.err
    assert done.err.count("calibration was made") == 1 and "unchanged" not in done.err, "one note, which is true"
    assert "expires" not in noting(verb, files / "t.nc", "--calibration", files / "c.toml", *more, "--force").err
