"""`fluxtwin effects`, and effects in `fluxtwin simulate`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
import xarray as xr
from command_line import Cli
from worlds import scenario_text

from fluxtwin.sim.effects.catalogue import CATALOGUE

SCENARIO = scenario_text(seed=3)


def test_the_catalogue_as_a_table_and_as_json(cli: Cli) -> None:
    table = cli("effects")
    assert table.status == 0
    lines = table.out.splitlines()
    assert max(map(len, lines)) <= 80
    for effect in CATALOGUE:
        (line,) = [line for line in lines if line.split()[:1] == [effect.name]]
        sentence = line.removeprefix(effect.name).strip()
        assert sentence[0].isupper() and sentence.endswith("."), "a whole sentence, not one that was cut off"
        assert effect.stage in lines[: lines.index(line)]
        assert effect.parameters[0].unit in cli("effects", effect.name).out
    record = json.loads(cli("effects", "--json", "-").out)
    assert [entry["name"] for entry in record["effects"]] == [effect.name for effect in CATALOGUE]
    for entry in record["effects"]:
        for parameter in entry["parameters"]:
            low, high = parameter["range"]
            assert low is None or low <= 0.0
            assert high is None or high >= parameter["typical"] > 0.0


@pytest.mark.parametrize("name", [effect.name for effect in CATALOGUE])
def test_one_effect_in_full_gives_a_section_that_works(cli: Cli, name: str) -> None:
    from fluxtwin.sim.scenario.effect_sections import active_effects
    from fluxtwin.sim.scenario.scenario import parse_scenario

    shown = cli("effects", name)
    assert shown.status == 0
    section = shown.out[shown.out.index(f"[effects.{name}") :]
    assert set(tomllib.loads(section)) == {"effects"}
    ((effect, theta),) = active_effects(parse_scenario(SCENARIO + section))
    assert effect.family == name
    assert effect.name == (name if effect.keyed_by is None else f"{name}.NAME")
    assert theta.tolist() == [parameter.scale for parameter in effect.parameters]


@pytest.mark.parametrize(
    ("given", "nearest"),
    [("yaw_drif", "yaw_drift"), ("torquer", "torquer_coupling"), ("solar_array", "solar_array_current")],
)
def test_a_mistyped_effect_is_named_with_the_nearest(given: str, nearest: str, cli: Cli) -> None:
    outcome = cli("effects", given)
    assert outcome.status == 2
    assert f"did you mean {nearest}?" in outcome.err


def test_simulate_with_effects_writes_them_to_the_truth_only(cli: Cli, tmp_path: Path) -> None:
    plan, out, truth = (tmp_path / name for name in ("s.toml", "t.nc", "truth.nc"))
    plan.write_text(SCENARIO + "[effects.field_epoch]\nahead_yr = 2.0\n", encoding="utf-8")
    assert cli("simulate", plan, "--out", out, "--truth", truth).status == 0
    assert "is the truth of a simulation. Wanted: its telemetry" in cli("calibrate", truth).err
    with xr.open_dataset(truth, engine="h5netcdf") as opened:
        assert json.loads(str(opened["effects"].values)) == {"field_epoch": {"ahead_yr": 2.0}}
    assert b"field_epoch" not in out.read_bytes()
    assert "[effects.field_epoch]" in (tmp_path / "t.scenario.toml").read_text(encoding="utf-8")
    plan.write_text(SCENARIO + "[effects.field_epoch]\nahead_y = 2.0\n", encoding="utf-8")
    wrong = cli("simulate", plan, "--out", out)
    assert wrong.status == 2
    assert "did you mean ahead_yr?" in wrong.err
    assert wrong.err.count("\n") == 1


def test_simulate_says_which_effect_had_nothing_to_act_on(noting: Cli, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        SCENARIO + "[effects.sun_sensor_head_misalignment]\nturn_deg = [0.1, 0.0, 0.0]\n", encoding="utf-8"
    )
    outcome = noting("simulate", tmp_path / "s.toml", "--out", tmp_path / "t.nc")
    assert outcome.status == 0
    assert "note: effects.sun_sensor_head_misalignment is left out: the telemetry has no column" in outcome.err
    assert (tmp_path / "t.nc").exists()
