"""A scenario says what is wrong with it, and a run can be repeated from the saved one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import scenario_text

from fluxtwin.scenarios import packaged
from fluxtwin.scenarios.seasat import mission
from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.limits import TEXT_BYTES
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import load_scenario, parse_scenario, save_scenario
from fluxtwin.sim.scenario.sections import TorquersSection

pytestmark = pytest.mark.property

SMALL = scenario_text(seed=3)
INERT = {"spacecraft.inertia_kg_m2": [[0.05, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.04]]}


def test_a_saved_scenario_repeats_the_run_bit_for_bit(tmp_path):
    scenario = mission.scenario().updated({"seed": 11})
    again = load_scenario(save_scenario(scenario, tmp_path / "scenario.toml"))
    assert again == scenario != scenario.updated({"seed": 12}), "wherever its file lies"
    first, second = simulate(scenario)[0], simulate(again)[0]
    assert np.array_equal(first.mag_B_nT, second.mag_B_nT)
    assert np.array_equal(first.q_NB, second.q_NB)
    other = simulate(scenario.updated({"seed": 12}))[0]
    assert not np.array_equal(first.mag_B_nT, other.mag_B_nT)


def test_a_saved_scenario_has_no_table_of_names_without_one():
    scenario = packaged.load_scenario("late_clock")
    text = scenario.to_toml()
    assert "[effects.time_tag_offset]" in text and "[drivers]" not in text and "[draws]" not in text
    assert "[effects.driver]" not in text and "[effects.law]" not in text
    assert parse_scenario(text) == scenario


@given(st.tuples(*9 * [st.floats(-0.4, 0.4)]), st.tuples(*3 * [st.floats(-1e5, 1e5)]), st.integers(0, 2**31))
def test_whatever_the_numbers_a_saved_scenario_is_the_same(tmp_path, matrix, bias, seed):
    values = {"magnetometer.S": np.reshape(matrix, (3, 3)).tolist(), "magnetometer.b_nT": list(bias), "seed": seed}
    values["magnetometer_2"] = {"S": values["magnetometer.S"], "position_m": list(bias)}
    scenario = parse_scenario(SMALL).updated(values)
    (tmp_path / "scenario.toml").unlink(missing_ok=True)
    again = load_scenario(save_scenario(scenario, tmp_path / "scenario.toml"))
    assert again.model_dump() == scenario.model_dump()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("altitude_km = 650.0\naltitud_km = 3.0", "unknown key orbit.altitud_km; did you mean altitude_km?"),
        ('altitude_km = "650"', "orbit.altitude_km: one number is wanted (found '650')"),
        ("altitude_km = nan", "orbit.altitude_km"),
        ("altitude_km = 650.0\neccentricity = 0.5", "the perigee is at"),
        ("", "missing altitude_km"),
    ],
)
def test_faults_are_named(change, said):
    with pytest.raises(BadInput) as caught:
        parse_scenario(SMALL.replace("altitude_km = 650.0", change), where="my.toml")
    assert said in str(caught.value)
    assert "my.toml" in str(caught.value)


def test_what_is_no_scenario_at_all_is_said():
    with pytest.raises(BadInput, match=r"m\.toml: this is a column map\. Wanted: a scenario"):
        parse_scenario("[[file]]\npath = 1\n", where="m.toml")
    with pytest.raises(BadInput, match=f"more than {TEXT_BYTES} characters"):
        parse_scenario("#" * (TEXT_BYTES + 1))


def test_every_fault_is_listed_at_once():
    text = SMALL.replace("seed = 3", "seed = -1").replace('name = "test"', 'nam = "test"')
    with pytest.raises(BadInput) as caught:
        parse_scenario(text)
    for part in ("seed", "spacecraft.name is missing", "did you mean name?"):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"replay": {"telemetry": "t.nc"}}, "leave [orbit] out"),
        ({"replay": {"telemetry": "t.nc"}, "orbit": None, "attitude.mode": "dynamics", **INERT}, "needs an orbit"),
        (
            {
                "replay": {"telemetry": "t.nc"},
                "orbit": None,
                "sampling.magnetometer_2.every_s": 60.0,
                "magnetometer_2.position_m": [1.0, 0.0, 0.0],
            },
            "leave [sampling] out",
        ),
        ({"sun_sensor": {"front": {"azimuth_deg": 0.0}}}, "heads are numbered"),
        ({"attitude.reference.source": "sensors"}, "needs sun sensors"),
        (
            {"attitude.reference.source": "sensors", "sun_sensor": {"1": {"azimuth_deg": 0.0}}},
            "needs a [horizon_scanner]",
        ),
        ({"orbit.altitude_km": 400000.0}, "looks like metres"),
        ({"orbit.tle": "e.tle"}, "not both"),
        ({"attitude.shortest_period_min": 500.0}, "shortest_period_min is longer"),
        ({"attitude.mode": "slews"}, "at least two waypoints"),
        ({"orbit.epoch_utc": "2020-03-01T00:00:00"}, 'for UTC write "2020-03-01T00:00:00Z"'),
        ({"orbit.epoch_utc": 2020}, "a time is needed, as"),
        (
            {
                "thermal.sunlit_degC": 20.0,
                "thermal.eclipse_degC": 0.0,
                "thermal.time_constant_min": 9.0,
                "thermal.heater_on_below_degC": 5.0,
            },
            "a heater needs both",
        ),
    ],
)
def test_sections_that_do_not_go_together(changes, said):
    with pytest.raises(BadInput) as caught:
        parse_scenario(SMALL).updated(changes)
    assert said in str(caught.value)


@pytest.mark.parametrize("zone", ["", "+02:00"])
def test_a_date_of_toml_says_that_it_is_utc(zone):
    text = SMALL.replace('epoch_utc = "2020-03-01T00:00:00Z"', f"epoch_utc = 2020-03-01T00:00:00{zone}")
    assert text != SMALL
    with pytest.raises(BadInput, match="a time needs UTC: end it with Z"):
        parse_scenario(text)


@pytest.mark.parametrize(
    "content", [b"\xff\xfe\x00", b"a = [" * 20000, b"x = 1" * 300000, b"seed = ", b"", b"#" * 1_000_001]
)
def test_files_that_are_no_scenario(tmp_path, content):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"bad\.toml"):
        load_scenario(path)
    with pytest.raises(BadInput, match="no such file"):
        load_scenario(tmp_path / "absent.toml")


def test_epoch_outside_the_field_model_names_its_range():
    late = SMALL.replace("2020-03-01", "2031-03-01")
    with pytest.raises(OutOfRange, match="1900") as caught:
        simulate(parse_scenario(late))
    assert "2030" in str(caught.value)


def test_segments_must_be_in_order():
    start = '{ start_utc = "2020-03-01T00:00:00Z", samples = 50, step_s = 30.0 }'
    with pytest.raises(BadInput, match="overlap"):
        build_world(parse_scenario(SMALL.replace(start, f"{start}, {start}")))


def test_a_moment_in_pole_cm_is_a_thousandth_of_it_in_A_m2():
    """1 pole cm, the unit of moment of the CGS system, is 1 erg/G = 1e-3 J/T (Jackson, appendix, table 4)."""
    section = TorquersSection(dipole_pole_cm=1e4, positions_m=[[1.0, 0.0, 0.0]] * 3)
    assert section.Am2 == pytest.approx(10.0, rel=1e-12)


def test_updated_changes_only_what_is_named():
    scenario = parse_scenario(SMALL)
    changed = scenario.updated({"magnetometer.lsb_nT": 5.0, "orbit.altitude_km": 700.0})
    assert changed.magnetometer.step_nT == 5.0
    assert changed.orbit.altitude_km == 700.0
    assert changed.orbit.inclination_deg == scenario.orbit.inclination_deg
    assert (
        changed.updated({"magnetometer.lsb_nT": None, "orbit.altitude_km": 650.0}).model_dump() == scenario.model_dump()
    )
    assert scenario.updated({"magnetometer.b_nT": np.ones(3)}) == scenario.updated({"magnetometer.b_nT": [1.0] * 3})
    with pytest.raises(BadInput, match=r"unknown key magnetometer\.lsb"):
        scenario.updated({"magnetometer.lsb": 5.0})
    for key, near in (("torquer", "torquers"), ("magnetometer.noise_nt", "noise_nT")):
        with pytest.raises(BadInput, match=rf"unknown key {key}; did you mean {near}"):
            scenario.updated({key: None})
    for key in ("gyro.bogus", "seed.x", "schedule.segments.x"):
        with pytest.raises(BadInput, match=rf"unknown key {key}"):
            scenario.updated({key: None})
    assert scenario.updated({"gyro.noise_deg_s": None}) == scenario, "no gyro is switched on"


def test_arrays_may_be_anywhere_in_what_is_changed() -> None:
    S = np.diag([0.01, -0.02, 0.03])
    x, y, z = S
    for changes in ({"magnetometer.S": S}, {"magnetometer": {"S": S}}, {"magnetometer": {"S": (x, list(y), z)}}):
        changed = parse_scenario(SMALL).updated(changes | {"seed": np.int64(3)})
        assert np.array_equal(changed.magnetometer.S, S)


def test_units_are_exclusive_and_convert():
    # 1 mG = 100 nT by definition.
    unknown = "[magnetometer.unknown]\nrms_mG = 0.7\n"
    scenario = parse_scenario(
        SMALL + "[magnetometer]\nb_mG = [1.0, 2.0, 3.0]\nlsb_mG = 4.4\nnoise_mG = 0.5\n" + unknown
    )
    assert scenario.magnetometer.white_nT == pytest.approx(50.0, rel=1e-12)
    assert scenario.magnetometer.unknown.nT == pytest.approx(70.0, rel=1e-12)
    assert scenario.magnetometer.bias_nT == (100.0, 200.0, 300.0)
    assert scenario.magnetometer.step_nT == pytest.approx(440.0, rel=1e-12)
    with pytest.raises(BadInput, match="not both"):
        parse_scenario(SMALL + "[magnetometer]\nb_mG = [1.0, 2.0, 3.0]\nb_nT = [1.0, 2.0, 3.0]\n")


def test_a_run_across_a_leap_second_leaves_out_the_sample_that_has_no_stamp():
    """UTC had 23:59:60 on 31 December 1978 (IERS Bulletin C); 200 samples a second apart hold one without a stamp."""
    text = SMALL.replace("2020-03-01T00:00:00Z", "1978-12-31T23:59:30Z").replace(
        "samples = 50, step_s = 30.0", "samples = 200, step_s = 1.0"
    )
    world = build_world(parse_scenario(text))
    assert world.time.size == 199
    assert (np.diff(world.time.astype("int64")) > 0).all()
    moved_km = np.linalg.norm(np.diff(world.r_N_km, axis=0), axis=1)
    assert moved_km.max() == pytest.approx(2 * np.median(moved_km), rel=1e-3)  # two seconds across the gap


def test_sensors_and_an_error_model_exclude_each_other():
    text = (
        SMALL
        + """
[attitude.reference]
source = "sensors"
sigma_deg = 0.1
[sun_sensor.1]
azimuth_deg = 0.0
[horizon_scanner]
"""
    )
    with pytest.raises(BadInput, match="leave sigma_deg and tau_s out"):
        parse_scenario(text)
