"""A closed scenario takes its effects out of telemetry: what is left is the flight without them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import Cli
from worlds import THERMAL, scenario_text

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.scenario.scenario import load_scenario, parse_scenario, save_scenario

pytestmark = pytest.mark.closure

SENSOR = f"""
[attitude]
yaw_rms_deg = 20.0
roll_rms_deg = 10.0
pitch_rms_deg = 10.0
[attitude.reference]
sigma_deg = 0.02
tau_s = 0.0
[magnetometer]
S = [[0.01, 0.004, -0.002], [0.003, -0.015, 0.005], [-0.001, 0.006, 0.012]]
b_nT = [1200.0, -800.0, 300.0]
noise_nT = 20.0
{THERMAL}"""
PLAIN = scenario_text(SENSOR, seed=4, segment="samples = 600, step_s = 20.0")
EFFECTS = {
    "thermal_scale_drift": "S_xx_per_K = 0.0008\nS_yy_per_K = 0.0\nS_zz_per_K = -0.0003\nreference_degC = 10.0\n",
    "along_track_error": 'ahead_km = -30.0\nrate_km_h = -0.5\ncourse = "linear"\nsince = "2020-03-01T00:00:00Z"\n',
}


@pytest.mark.parametrize("name", [*EFFECTS, "both"])
def test_what_is_left_is_the_flight_without_the_effects(name: str, tmp_path: Path, cli: Cli) -> None:
    """The same seed draws the same noise, so the flight without the effect is the witness, row by row; 0.02 deg of attitude
    error turn a change of the reading by 0.04 %, and the circle of a nearly circular orbit is good to 0.1 km."""
    wanted = EFFECTS if name == "both" else {name: EFFECTS[name]}
    text = PLAIN + "".join(f"[effects.{key}]\n{value}" for key, value in wanted.items())
    scenario = parse_scenario(text)
    save_scenario(scenario, tmp_path / "closed.toml")
    with_it, without = (fluxtwin.simulate(one)[0] for one in (scenario, parse_scenario(PLAIN)))
    fluxtwin.write(with_it, tmp_path / "t.nc")
    done = cli("apply", tmp_path / "t.nc", "--scenario", tmp_path / "closed.toml", "--out", tmp_path / "c.nc")
    assert done.status == 0, done.err
    assert all(key in done.out.partition("effects taken out: ")[2].splitlines()[0] for key in wanted)
    found = fluxtwin.read(tmp_path / "c.nc")
    S, b = (np.array(getattr(scenario.magnetometer, key)) for key in ("S", "b_nT"))
    expected = np.array(without.mag_B_nT) @ (np.eye(3) + S).T + b
    off = np.linalg.norm(found.mag_B_nT - expected, axis=1)
    change = np.linalg.norm(np.array(with_it.mag_B_nT) - without.mag_B_nT, axis=1)
    if "thermal_scale_drift" in wanted:
        assert np.median(change) > 50.0 and off.max() < 0.02 * change.max()
    else:
        assert off.max() < 1e-6
    assert np.abs(np.array(found.r_N_km) - without.r_N_km).max() < 0.1
    moved = np.linalg.norm(np.array(with_it.r_N_km) - without.r_N_km, axis=1)
    assert (moved.min() > 29.0) == ("along_track_error" in wanted)
    fit = fluxtwin.calibrate(found.replace(provenance={}))
    assert np.abs(fit.calibration.values / fit.calibration.sigmas).max() < 4.5, "nothing is left to calibrate"


def test_what_cannot_be_taken_out_is_said_and_one_of_the_two_is_wanted(tmp_path: Path, cli: Cli) -> None:
    text = f"{PLAIN}[effects.time_tag_offset]\noffset_s = 3.0\n"
    save_scenario(parse_scenario(text), tmp_path / "closed.toml")
    fluxtwin.write(fluxtwin.simulate(load_scenario(tmp_path / "closed.toml"))[0], tmp_path / "t.nc")
    to = ("--out", tmp_path / "c.nc")
    done = cli("apply", tmp_path / "t.nc", "--scenario", tmp_path / "closed.toml", *to)
    assert "effects taken out: none" in done.out and "time_tag_offset" in done.out.partition("not taken out")[2]
    again = cli("apply", tmp_path / "c.nc", "--scenario", tmp_path / "closed.toml", "--out", tmp_path / "d.nc")
    assert again.status == 2 and "corrected already" in again.err
    both = cli("apply", tmp_path / "t.nc", *to, "--force")
    assert both.status == 2 and "a closed scenario" in both.err
    with pytest.raises(BadInput, match="one of the two"):
        fluxtwin.apply(tmp_path / "t.nc")
