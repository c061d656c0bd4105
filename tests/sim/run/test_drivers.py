"""[drivers.NAME] and the fields that follow them: patterns as they are defined, delays and lags as analysis has them."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from worlds import scenario_text

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import Scenario, load_scenario, parse_scenario
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.property

SECTIONS = """
[drivers.heat]
pattern = "ramp"
low = -1.0
high = 4.0
period_s = 5000.0
offset_s = 500.0
unit = "W"
[drivers.payload]
pattern = "square"
high = 1.5
period_s = 1000.0
duty = 0.3
[drivers.radio]
pattern = "random"
low = 0.5
high = 1.0
duty = 0.25
dwell_s = 60.0
[drivers.array]
pattern = "sunlit"
high = 2.0
[drivers.rail]
pattern = "constant"
high = 3.3
"""
TEXT = scenario_text(SECTIONS, seed=5, raan_deg=100.0, segment="duration_min = 200.0, step_s = 10.0")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


def followed(scenario: Scenario, name: str, **section: object) -> np.ndarray:
    """(N,) what the field follows: the x component of the reading changes by it."""
    moved = scenario.updated({f"effects.driver.{name}": {"k_nT_per_unit": [1000.0, 0.0, 0.0], **section}})
    return (simulate(moved)[0].mag_B_nT - simulate(scenario)[0].mag_B_nT)[:, 0] / 1000.0


def test_each_pattern_is_what_it_is_called(scenario: Scenario) -> None:
    telemetry, _ = simulate(scenario)
    seconds, drivers = 10.0 * np.arange(1201), telemetry.drivers
    assert sorted(drivers) == ["array", "heat", "payload", "radio", "rail"]
    assert np.array_equal(drivers["payload"], np.where(seconds % 1000.0 < 300.0, 1.5, 0.0))
    assert np.allclose(drivers["heat"], -1.0 + 5.0 * (((seconds - 500.0) / 5000.0) % 1.0), atol=1e-12)
    assert set(drivers["radio"]) == {0.5, 1.0}
    # 200 slots: a share of 0.25 within four sigma, and no slot is cut in two
    assert abs(np.mean(drivers["radio"] == 1.0) - 0.25) < 4.0 * np.sqrt(0.25 * 0.75 / 200.0)
    assert np.diff(np.flatnonzero(np.diff(drivers["radio"]))).min() >= 5
    assert np.array_equal(drivers["array"] > 1.0, np.array(telemetry.sunlit) > 0.5)
    assert (drivers["rail"] == 3.3).all()
    assert telemetry.driver_units == {"heat": "W"}
    other, _ = simulate(scenario.updated({"seed": 6}))
    changed = [name for name in drivers if not np.array_equal(drivers[name], other.drivers[name])]
    assert changed == ["radio"], "the only one that is drawn"
    again, _ = simulate(parse_scenario(scenario.to_toml()))
    assert np.array_equal(again.drivers["radio"], drivers["radio"])


def test_a_field_follows_its_column_late_and_smoothed(scenario: Scenario) -> None:
    """A ramp r t behind a lag tau, in balance before, is r (t - tau + tau exp(-t / tau)); late by d it is r (t - d)."""
    telemetry, _ = simulate(scenario.updated({"drivers.heat.offset_s": 0.0, "drivers.heat.period_s": 40_000.0}))
    heat, seconds = telemetry.drivers["heat"], 10.0 * np.arange(1201)
    longer = scenario.updated({"drivers.heat.offset_s": 0.0, "drivers.heat.period_s": 40_000.0})
    rise, tau = 5.0 / 40_000.0, 250.0
    assert np.abs(followed(longer, "heat") - heat).max() < 1e-10
    late = followed(longer, "heat", delay_s=35.0)
    assert np.abs(late - (-1.0 + rise * np.maximum(seconds - 35.0, 0.0))).max() < 1e-10
    smooth = followed(longer, "heat", lag_s=tau)
    assert np.abs(smooth - (-1.0 + rise * (seconds - tau + tau * np.exp(-seconds / tau)))).max() < 1e-10
    both = followed(longer, "heat", delay_s=40.0, lag_s=tau)
    assert np.abs(both[4:] - smooth[:-4]).max() < 1e-10
    steps = followed(scenario, "payload", delay_s=20.0)
    assert np.array_equal(np.rint(steps[2:] / 1.5), simulate(scenario)[0].drivers["payload"][:-2] / 1.5), "held"


def test_several_fields_add_up_and_one_without_its_column_is_left_out(scenario: Scenario) -> None:
    sections = {
        "effects.driver.payload": {"k_nT_per_unit": [10.0, -20.0, 30.0]},
        "effects.driver.heat": {"k_nT_per_unit": [0.0, 5.0, -5.0]},
    }
    plain, _ = simulate(scenario)
    telemetry, truth = simulate(scenario.updated(sections))
    wanted = np.outer(plain.drivers["payload"], [10.0, -20.0, 30.0]) + np.outer(plain.drivers["heat"], [0.0, 5.0, -5.0])
    assert np.abs(telemetry.mag_B_nT - plain.mag_B_nT - wanted).max() < 1e-9
    assert '"driver.payload"' in truth.effects and '"driver.heat"' in truth.effects
    lacking = scenario.updated({"effects.driver.camera": {"k_nT_per_unit": [1.0, 0.0, 0.0]}})
    with pytest.warns(UserWarning, match=r"effects.driver.camera is left out: the telemetry has no driver_camera"):
        assert np.array_equal(simulate(lacking)[0].mag_B_nT, plain.mag_B_nT)


def test_a_file_and_a_slower_rate(scenario: Scenario, tmp_path: Path) -> None:
    """A column of a CSV, linear between its rows; read each minute, it is blank in between, and a replay still has it."""
    start = scenario.schedule.segments[0].start_utc if scenario.schedule else ""
    stamps = epoch.add_seconds(epoch.parse_time(start), np.array([-100.0, 3000.0, 20_000.0]))
    rows = [f"{epoch.iso(stamp)},{value}" for stamp, value in zip(stamps, (1.0, 4.1, -12.9), strict=True)]
    (tmp_path / "load.csv").write_text("\n".join(["time,load_A", *rows]) + "\n", encoding="utf-8")
    section = '[drivers.load]\npattern = "file"\nfile = "load.csv"\ncolumn = "load_A"\n'
    (tmp_path / "s.toml").write_text(TEXT + section + "[sampling.housekeeping]\nevery_s = 60.0\n", encoding="utf-8")
    telemetry, _ = simulate(load_scenario(tmp_path / "s.toml"))
    read, load = np.isfinite(telemetry.drivers["load"]), telemetry.drivers["load"]
    seconds = 10.0 * np.arange(1201)
    assert np.array_equal(read, seconds % 60.0 == 0.0)
    assert np.array_equal(read, np.isfinite(telemetry.drivers["radio"]))
    wanted = np.where(seconds < 3000.0, 1.1 + 1e-3 * seconds, 4.1 - 1e-3 * (seconds - 3000.0))
    assert np.abs(load - wanted)[read].max() < 1e-9
    path = write_telemetry(telemetry, tmp_path / "t.nc")
    replay = {"orbit": None, "schedule": None, "replay.telemetry": str(path)}
    assert np.array_equal(simulate(scenario.updated(replay))[0].drivers["load"], load, equal_nan=True)
    assert read_telemetry(path).driver_units == {"heat": "W"}
    (tmp_path / "load.csv").write_text("time,load_A\n" + "\n".join(rows[1:]) + "\n", encoding="utf-8")
    with pytest.raises(BadInput, match=r"drivers.load: .*load.csv: its values of load_A do not cover the schedule"):
        simulate(load_scenario(tmp_path / "s.toml"))
    for head, held, said in (
        ("time,load_W", rows, "column load_A is missing"),
        ("time,load_A", rows[::-1], "time does not increase"),
    ):
        (tmp_path / "load.csv").write_text("\n".join([head, *held, ""]), encoding="utf-8")
        with pytest.raises(BadInput, match=rf"drivers.load: .*load.csv: {said}"):
            simulate(load_scenario(tmp_path / "s.toml"))


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ('[drivers.x]\npattern = "square"\nhigh = 1.0', 'pattern = "square" wants high, period_s, duty (and low'),
        ('[drivers.x]\npattern = "ramp"\nhigh = 1.0\nperiod_s = 5.0\nduty = 0.5', "found duty, high, period_s"),
        ('[drivers.x]\npattern = "saw"\nhigh = 1.0', "drivers.x.pattern"),
        ('[drivers."a b"]\npattern = "constant"\nhigh = 1.0', "a name has letters, digits and _ only"),
        ("[effects.driver.x]\ndelay_s = 1.0", "effects.driver.x: give k_nT_per_unit"),
        ("[effects.driver.x]\nk_nT_per_unit = [1.0, 2.0, 3.0]\ndelay = 1.0", "did you mean delay_s?"),
        ("[effects.driver]\nk_nT_per_unit = [1.0, 2.0, 3.0]", "effects.driver.k_nT_per_unit"),
    ],
)
def test_faults_are_named(section: str, said: str) -> None:
    with warnings.catch_warnings(), pytest.raises(BadInput) as caught:
        parse_scenario(TEXT + section + "\n", where="my.toml")
    assert said in str(caught.value)
