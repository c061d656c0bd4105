"""The packaged scenarios: each loads by its name, flies, and repeats from its saved copy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fluxtwin
from fluxtwin.cli import main
from fluxtwin.scenarios.packaged import SCENARIOS
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.scenario.scenario import Scenario, save_scenario

pytestmark = pytest.mark.property


def first_minutes(scenario: Scenario) -> Scenario:
    """The first six samples of the first segment; a flight by physics settles for two minutes only."""
    assert scenario.schedule is not None
    first = scenario.schedule.segments[0]
    short = {"start_utc": str(first.start_utc), "samples": 6, "step_s": first.step_s}
    changes: dict[str, object] = {"schedule.segments": [short]}
    if scenario.dynamics is not None:
        changes["dynamics.settle_min"] = 2.0
    return scenario.updated(changes)


def test_the_names() -> None:
    assert sorted(SCENARIOS) == ["cubesat", "hcmm", "hidden_law", "late_clock", "momentum_bias", "seasat", "st5"]
    assert fluxtwin.load_scenario("momentum_bias").attitude.mode == "dynamics"
    assert "offset_s = 10.0" in fluxtwin.load_scenario("late_clock").to_toml()


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_it_flies_and_its_saved_copy_repeats_the_run(name: str, tmp_path: Path) -> None:
    scenario = first_minutes(fluxtwin.load_scenario(name))
    telemetry, truth = fluxtwin.simulate(scenario)
    # a spinner's record also has the rows of its sun pulses, which carry no reading
    assert np.isfinite(telemetry.mag_B_nT).all(axis=1).sum() == 6
    again, true_again = fluxtwin.simulate(fluxtwin.load_scenario(save_scenario(scenario, tmp_path / "copy.toml")))
    assert np.array_equal(telemetry.mag_B_nT, again.mag_B_nT, equal_nan=True)
    assert np.array_equal(truth.field_B_nT, true_again.field_B_nT)
    other, _ = fluxtwin.simulate(scenario.updated({"seed": scenario.seed + 1}))
    assert not np.array_equal(telemetry.mag_B_nT, other.mag_B_nT, equal_nan=True)


def test_a_file_of_that_name_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = fluxtwin.load_scenario("cubesat").updated({"seed": 77})
    monkeypatch.chdir(tmp_path)
    save_scenario(mine, tmp_path / "cubesat")
    assert fluxtwin.load_scenario("cubesat").seed == 77
    Path("seasat").mkdir()
    assert fluxtwin.load_scenario("seasat").name == "seasat"


def test_what_is_neither_file_nor_name_is_answered_with_the_names() -> None:
    with pytest.raises(BadInput, match=r"seasta: there is no such file.*did you mean 'seasat'") as raised:
        fluxtwin.load_scenario("seasta")
    for name in SCENARIOS:
        assert name in str(raised.value).partition("Wanted")[2]
    with pytest.raises(BadInput, match=r"none/cubesat\.toml.*did you mean 'cubesat'"):
        fluxtwin.load_scenario("none/cubesat.toml")


def test_the_command_line_takes_a_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "cubesat", "--out", "x.nc"]) == 0
    assert main(["simulate", "cubesat", "--out", "x.nc"]) == 0, "what fluxtwin wrote it may write again"
    assert len(fluxtwin.read("x.nc")) == 1801
    assert fluxtwin.load_scenario("x.scenario.toml").to_toml() == fluxtwin.load_scenario("cubesat").to_toml()
    capsys.readouterr()
    assert main(["simulate", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name in SCENARIOS:
        assert name in shown
