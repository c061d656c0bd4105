"""Pass-limited telemetry, and `fluxtwin passes`, from a scenario's stations."""

from __future__ import annotations

import json

import numpy as np
import pytest
from worlds import scenario_text

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.stations import in_view
from fluxtwin.sim.run.scenario_passes import list_passes
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.spacecraft import torquer_correction
from fluxtwin.sim.run.world import build_world, stations_of
from fluxtwin.sim.scenario.scenario import parse_scenario

pytestmark = pytest.mark.property

SECTIONS = """
[station.north]
latitude_deg = 64.97
longitude_deg = 212.49
mask_deg = 5.0
[station.south]
latitude_deg = -35.63
longitude_deg = 148.96
[schedule]
in_view_of_stations = true
segments = [{ start_utc = "2020-03-01T00:00:00Z", duration_min = 600.0, step_s = 20.0 }]
"""
TEXT = scenario_text(SECTIONS, seed=3, segment=None)


@pytest.fixture(scope="module")
def config():
    return parse_scenario(TEXT)


def test_samples_are_those_in_view_and_no_others(config):
    seen = build_world(config)
    everything = build_world(config.updated({"schedule.in_view_of_stations": False}))
    above = in_view(stations_of(config), frames.rotation_EN(everything.time).apply(everything.r_N_km)) > 0
    assert (seen.time == everything.time[above.any(axis=1)]).all()
    assert 0 < len(seen.time) < 0.5 * len(everything.time)


def test_each_stretch_in_view_is_a_segment(config):
    world = build_world(config)
    gap = np.diff(world.time).astype("timedelta64[s]").astype(int) > 20
    assert (np.diff(world.segment) == gap).all()
    assert world.segment[0] == 0
    assert int(world.segment[-1]) + 1 == len(list_passes(config))  # these two stations never see it together


def test_noise_of_a_sample_that_is_kept_depends_on_the_seed_only(config):
    first, second = (simulate(config)[0].mag_B_nT for _ in range(2))
    assert (first == second).all()


def test_passes_agree_with_the_samples_in_view(config):
    world = build_world(config)
    for number, item in enumerate(list_passes(config)):
        rise, down = (np.datetime64(item[key].rstrip("Z"), "ns") for key in ("rise", "set"))
        inside = world.time[world.segment == number]
        assert abs((inside[0] - rise) / np.timedelta64(1, "s")) <= 21
        assert abs((down - inside[-1]) / np.timedelta64(1, "s")) <= 21
        assert item["highest_deg"] > 0


def test_nothing_in_view_is_said(config):
    with pytest.raises(BadInput, match="in view of any station"):
        build_world(config.updated({"station.north.mask_deg": 89.9, "station.south.mask_deg": 89.9}))


def test_a_schedule_in_view_of_no_stations_is_refused():
    text = TEXT[: TEXT.index("[station.north]")] + TEXT[TEXT.index("[schedule]") :]
    with pytest.raises(BadInput, match=r"station\.NAME"):
        parse_scenario(text)
    with pytest.raises(BadInput, match="no station"):
        list_passes(parse_scenario(text.replace("in_view_of_stations = true", "")))
    with pytest.raises(BadInput, match="the orbit is that of a recorded file"):
        replay = {"orbit": None, "schedule": None, "replay.telemetry": "t.nc"}
        list_passes(parse_scenario(TEXT).updated(replay))


def test_the_command_lists_passes(tmp_path, cli):
    path = tmp_path / "two.toml"
    path.write_text(TEXT, encoding="utf-8")
    outcome = cli("passes", path, "--json", tmp_path / "passes.json")
    assert outcome.status == 0
    shown = outcome.out
    found = json.loads((tmp_path / "passes.json").read_text(encoding="utf-8"))["passes"]
    assert found == list_passes(parse_scenario(TEXT))
    assert f"{len(found)} passes over 2 stations" in shown
    for item in found:
        assert item["rise"] in shown
    path.write_text(TEXT[: TEXT.index("[station.north]")], encoding="utf-8")
    assert cli("passes", path).status == 2


STATION = """[station.home]
latitude_deg = 52.1
longitude_deg = 4.3
mask_deg = 10.0
"""


def test_anyones_stations_stand_in_for_those_of_a_scenario(tmp_path, cli):
    scenario, stations = tmp_path / "two.toml", tmp_path / "mine.toml"
    scenario.write_text(TEXT, encoding="utf-8")
    stations.write_text(STATION, encoding="utf-8")
    outcome = cli("passes", scenario, "--stations", stations)
    assert outcome.status == 0
    mine = {"home": {"latitude_deg": 52.1, "longitude_deg": 4.3, "mask_deg": 10.0}}
    found = list_passes(parse_scenario(TEXT).updated({"station": mine}))
    shown = outcome.out
    assert f"{len(found)} passes over 1 station," in shown
    for item in found:
        assert item["rise"] in shown
    stations.write_text(STATION.replace("10.0", "89.9"), encoding="utf-8")
    outcome = cli("passes", scenario, "--stations", stations)
    assert outcome.status == 0 and "0 passes over 1 station," in outcome.out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (STATION.replace("52.1", "95"), "latitude_deg"),
        (STATION.replace("10.0", "95"), "mask_deg"),
        (STATION.replace("10.0", "nan"), "mask_deg"),
        (STATION.replace("4.3", "inf"), "longitude_deg"),
        (STATION.replace("mask_deg", "maks_deg"), "did you mean"),
        (STATION.replace("[station.home]", "[stations.home]"), "did you mean station"),
        ("station = 3", "table"),
        ("", "station is missing"),
        ("[station.home", "not valid TOML"),
    ],
)
def test_a_bad_station_file_is_refused_in_words(tmp_path, cli, text, said):
    path = tmp_path / "stations.toml"
    path.write_text(text, encoding="utf-8")
    outcome = cli("passes", "hcmm", "--stations", path)
    assert outcome.status == 2
    shown = outcome.err
    assert "stations.toml" in shown
    assert said in shown
    assert "Traceback" not in shown


def test_a_name_that_is_no_scenario_is_answered_with_what_there_is(cli):
    outcome = cli("passes", "hcm")
    assert outcome.status == 2
    shown = " ".join(outcome.err.split())
    assert "did you mean 'hcmm'" in shown
    for name in ("hcmm", "seasat", "st5"):
        assert name in shown
    outcome = cli("passes", "seasat")  # packaged, but without stations
    assert outcome.status == 2
    shown = " ".join(outcome.err.split())
    assert "no station" in shown
    assert "--stations" in shown


def test_compensation_takes_out_its_share_of_the_torquers(config):
    torquers = {"dipole_Am2": 10.0, "positions_m": [[0.0, 0.0, 1.0]] * 3, "compensation": 0.0}
    plain = torquer_correction(config.updated({"torquers": torquers}))
    left = torquer_correction(config.updated({"torquers": torquers | {"compensation": 0.955}}))
    np.testing.assert_allclose(left, 0.045 * plain, rtol=1e-12)
    # One coil of 10,000 pole-cm on its axis at 1 m: 20 mG (Lerner & Shuster 1979), 0.9 mG after compensation.
    assert abs(plain[2, 2]) * 10.0 == pytest.approx(2000.0)
    assert not torquer_correction(config.updated({"torquers": torquers | {"compensation": 1.0}})).any()
