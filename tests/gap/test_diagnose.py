"""The diagnosis from end to end: nothing where nothing is, the cause where one is, unknown where it is not ours.

Every case has a wrong calibration (b about 1000 nT, S half a per cent), noise, rounding and an attitude error with a
memory of 150 s. Effects are switched on in the scenario, at a size that leaves about the noise's rms (115 nT) beside
the best re-estimation of b and S. A perfect simulation is given a name, or called structured, in 4 of 1000 cases by
the gates of the search (0.002) and of what is left (0.002); the seeds are the first that were tried.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from worlds import COARSE_MAGNETOMETER, THERMAL, scenario_text

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = [pytest.mark.closure, pytest.mark.usefixtures("lawless")]

SECTIONS = f"""
[attitude.reference]
sigma_deg = 0.1
tau_s = 150.0
{COARSE_MAGNETOMETER}"""
ATTITUDES = {
    "nadir": "yaw_rms_deg = 4.0\nroll_rms_deg = 4.0\npitch_rms_deg = 4.0",
    "tumble": 'mode = "tumble"\nrate_deg_s = [0.12, 0.08, 0.2]',
}
SINGLES = {
    "time_tag_offset": ("tumble", "[effects.time_tag_offset]\noffset_s = 4.0", "time", {"offset": 4.0}),
    "field_epoch": ("tumble", "[effects.field_epoch]\nahead_yr = 5.0", "field", {"ahead": 5.0}),
    "thermal_bias_drift": (
        "nadir",
        "[effects.thermal_bias_drift]\nb_nT_per_K = [34.0, -24.0, 17.0]",
        "sensor",
        {"b_x": 34.0, "b_y": -24.0, "b_z": 17.0},
    ),
}


THERMOSTAT = """[thermal]
sunlit_degC = 25.0
eclipse_degC = -25.0
time_constant_min = 8.0
heater_on_below_degC = -6.0
heater_off_above_degC = -2.0
heater_rise_degC = {rise_degC}
[effects.heater_switching]
f_nT = [-240.0, -120.0, 600.0]
"""
BUDGET = Budget(100.0, 100.0, float(np.radians(0.1)), None)
ARRAY = "[power]\nfull_sun_current_A = 3.0\naxis_B = [0.0, 1.0, 0.0]\nload_A = 1.0\n"


def telemetry(design: str, effects: str = "", thermal: str = THERMAL, hours: float = 4.0) -> Telemetry:
    text = scenario_text(
        f"[attitude]\n{ATTITUDES[design]}\n{SECTIONS}{thermal}{effects}\n",
        seed=4,
        inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
        segment=f"duration_min = {60.0 * hours}, step_s = 30.0",
    )
    return simulate(parse_scenario(text))[0]


def diagnosed(record: Telemetry) -> Diagnosis:
    return diagnose(record, load_field("igrf14"), budget=BUDGET)


@pytest.mark.parametrize("design", ["nadir", "tumble"])
def test_a_perfect_simulation_has_no_gap(design, close):
    record = telemetry(design)
    found = diagnosed(record)
    assert found.verdict == "no_gap" and found.samples["used"] + found.samples["cut"] == len(record)
    assert found.effects == [] and found.gap.closed is None
    close(
        found.gap.before_nT,
        found.gap.floor_nT,
        atol=0.1 * found.gap.floor_nT,
        unit="nT",
        because="held-out residual of a perfect simulation is its noise, to a tenth (slow attitude error, 480 rows)",
    )


@pytest.mark.parametrize("name", SINGLES)
def test_one_effect_is_named_placed_measured_and_closes_the_gap(name):
    design, effects, stage, truth = SINGLES[name]
    found = diagnosed(telemetry(design, effects))
    assert found.verdict == "effect"
    assert [effect.name for effect in found.effects] == [name]
    assert found.where.stage == stage
    for parameter, value in truth.items():
        known = found.effects[0].parameters[parameter]
        assert abs(known.value - value) < 4.0 * known.sigma  # 6e-5 each by chance
    assert found.gap.closed > 0.8


@pytest.mark.parametrize("name", ["solar_array_current", "battery_current"])
def test_a_panel_whose_current_was_not_recorded_is_array_or_battery(name):
    """The currents are those of the simulated power system; they are in the field and not in the record. Which of the two
    makes it is not said by any record without them."""
    power = "[power]\nfull_sun_current_A = 2.0\nload_A = 0.7\nnormal_B = [0.0, 0.0, -1.0]\n"
    record = telemetry("nadir", f"{power}[effects.{name}]\ns_nT_per_A = [250.0, -170.0, 120.0]")
    unrecorded = record.replace(array_current_A=None, battery_current_A=None)
    result = diagnosed(unrecorded)
    (effect,) = result.effects
    assert {*effect.group} == {"solar_array_current", "battery_current"}, result.sentence
    assert effect.settings["panel"] == "zenith", "the face of the simulated panel"
    in_full_sun, sigma = effect.parameters["s_x"].value, effect.parameters["s_x"].sigma
    assert abs(in_full_sun - 2.0 * 250.0) < 4.0 * sigma < 0.5 * in_full_sun, "2 A in full sun"


def test_a_battery_whose_charging_tapers_is_not_the_array():
    """The battery is the simulation's own: a constant current, then an approach to full charge; neither current is in the
    record. Its field in the sun is not that of an array."""
    record = telemetry("nadir", f"{ARRAY}[effects.battery_current]\ns_nT_per_A = [250.0, -170.0, 120.0]")
    charging = record.battery_current_A[record.battery_current_A > 0.0]
    assert np.quantile(charging, 0.1) < 0.2 * np.quantile(charging, 0.9), "it tapers"
    result = diagnosed(record.replace(array_current_A=None, battery_current_A=None))
    assert [effect.group for effect in result.effects] == [("battery_current",)], result.sentence
    assert result.effects[0].settings["panel"] == "tapered"
    assert "at sunrise on an assumed charging current that tapers" in result.sentence


@pytest.mark.parametrize("name", ["solar_array_current", "battery_current"])
def test_a_tilted_panel_whose_current_was_not_recorded_is_found_by_the_way_the_field_follows_the_sun(name):
    normal = np.array([0.8, -0.35, 0.5]) / np.linalg.norm([0.8, -0.35, 0.5])
    power = f"[power]\nfull_sun_current_A = 2.0\nload_A = 0.7\nnormal_B = {normal.round(6).tolist()}\n"
    record = telemetry("tumble", f"{power}[effects.{name}]\ns_nT_per_A = [250.0, -170.0, 120.0]")
    result = diagnosed(record.replace(array_current_A=None, battery_current_A=None))
    (effect,) = result.effects
    assert {*effect.group} == {"solar_array_current", "battery_current"}, result.sentence
    off_deg = np.degrees(np.arccos(normal @ effect.settings["panel"]))
    assert off_deg < 5.0, "the finest tilt that is tried"
    in_full_sun, sigma = effect.parameters["s_x"].value, effect.parameters["s_x"].sigma
    assert abs(in_full_sun - 2.0 * 250.0) < 4.0 * sigma < 0.5 * in_full_sun, "2 A in full sun"


@pytest.mark.parametrize(
    ("rise_degC", "beside", "names"),
    [
        # It warms fast, and cycles through the shadow: the mean over a cycle follows the shadow.
        (28.0, "[effects.field_epoch]\nahead_yr = 5.0\n", {"field_epoch", "heater_switching"}),
        # It hardly keeps up: on through the shadow but for a pause or two, which the array's current has not.
        (23.5, ARRAY, {"heater_switching"}),
        (25.0, ARRAY, {"heater_switching"}),
    ],
)
def test_a_thermostat_that_nobody_recorded_is_one_cause(rise_degC, beside, names):
    """Neither for what it does with the shadow, nor for what others took of it before it was found, is there another."""
    record = telemetry("nadir", beside, THERMOSTAT.format(rise_degC=rise_degC), hours=8.0)
    result = diagnosed(record.replace(heater_on=None, temperature_degC=None))
    assert {*(effect.name for effect in result.effects)} == names and len(result.effects) == len(names), result.sentence
    heater = next(effect for effect in result.effects if effect.name == "heater_switching")
    on = np.array([heater.parameters[f"f_{axis}"].value for axis in "xyz"])
    # A row of each edge, of some three of a state, may be on the wrong side: a sixth.
    assert np.linalg.norm(on - [-240.0, -120.0, 600.0]) < np.linalg.norm([240.0, 120.0, 600.0]) / 6.0


def test_two_effects_at_once_are_both_named_and_nothing_else():
    both = "[effects.time_tag_offset]\noffset_s = 6.0\n[effects.thermal_bias_drift]\nb_nT_per_K = [34.0, -24.0, 17.0]\n"
    found = diagnosed(telemetry("tumble", both))
    assert found.verdict == "effect"
    assert {effect.name for effect in found.effects} == {"time_tag_offset", "thermal_bias_drift"}


def test_a_walk_beside_an_effect_of_ten_times_its_size_is_told_from_its_shape():
    """The noise in which a walk is looked for is that beside the effect: without its name an image of 1.5 uT is noise."""
    both = "[effects.time_tag_offset]\noffset_s = 25.0\n[effects.bias_random_walk]\nrate_nT_per_sqrt_s = 3.0\n"
    found = diagnosed(telemetry("tumble", both))
    assert [effect.name for effect in found.effects] == ["time_tag_offset", "bias_random_walk"]
    assert found.verdict == "effect" and not found.gap.shape_incomplete


def test_a_patch_of_unknown_field_over_a_region_is_unknown():
    """A field of 800 nT, pointing up, over a bell of 2000 km around a place: no effect of the catalogue is like it."""
    record = telemetry("nadir")
    r_E = frames.rotation_EN(record.time).apply(np.array(record.r_N_km))
    up_E = r_E / np.linalg.norm(r_E, axis=1)[:, None]
    centre = up_E[120]
    patch_E = (
        800.0 * np.exp(-0.5 * (np.arccos(np.clip(up_E @ centre, -1.0, 1.0)) * 6371.0 / 2000.0) ** 2)[:, None] * up_E
    )
    patch_N = frames.rotation_EN(record.time).inv().apply(patch_E)
    patch_B = frames.rotation_from_q(np.array(record.q_NB)).apply(patch_N)
    found = diagnosed(record.replace(mag_B_nT=np.asarray(record.mag_B_nT) + 100.0 * np.rint(patch_B / 100.0)))
    assert found.verdict == "unknown"
    assert found.sentence.startswith("There is a gap that the catalogue does not explain")


def test_a_coupling_of_axes_with_a_delay_is_no_eddy_current():
    """An eddy current's images at nothing and at its size differ by little: what lies along that is not all its own."""
    record = telemetry("tumble")
    seconds = np.arange(len(record)) * 30.0
    late_nT = 0.2 * CubicSpline(seconds, record.mag_B_nT[:, 1])(seconds - 10.0)
    reading = record.mag_B_nT + np.outer(100.0 * np.rint(late_nT / 100.0), [0.0, 0.0, 1.0])
    found = diagnosed(record.replace(mag_B_nT=reading))
    assert found.verdict == "unknown" and not found.effects
    assert "induced by the slope" in found.sentence


def two_lines(second_rad_s: float, *modelled: str) -> Diagnosis:
    """A wheel's line turns on an ellipse; and one on a straight line, which is no wheel's. modelled: besides b and S."""
    record = telemetry("nadir")
    t = np.arange(len(record)) * 30.0
    wheel_nT = 300.0 * np.stack([np.cos(0.0371 * t), np.sin(0.0371 * t), 0.3 * np.cos(0.0371 * t)], axis=1)
    line_nT = 150.0 * np.outer(np.cos(second_rad_s * t), [0.6, -0.5, 0.62])
    record = record.replace(mag_B_nT=record.mag_B_nT + 100.0 * np.rint((wheel_nT + line_nT) / 100.0))
    if not modelled:
        return diagnosed(record)
    turning = record.replace(wheel_speed_rpm=np.full(len(record), 0.0371 * 60.0 / (2.0 * np.pi)))
    return diagnose(turning, load_field("igrf14"), modelled=("bias", "scale_misalignment", *modelled), budget=BUDGET)


def test_a_multiple_of_a_wheel_that_is_modelled_is_a_gap():
    found = two_lines(2.0 * 0.0371, "wheel_field")
    assert found.verdict == "unknown" and not found.effects
    assert "a line at a period of 85 s" in found.sentence


def test_a_second_line_leaves_it_unknown_and_the_first_is_what_it_resembles():
    found = two_lines(0.0633)
    assert found.verdict == "unknown"
    assert found.resembles == ["wheel_field"]
    assert "It resembles wheel_field." in found.sentence


def test_a_second_line_at_a_multiple_of_the_first_is_the_same_wheel():
    found = two_lines(2.0 * 0.0371)
    assert [effect.name for effect in found.effects] == ["wheel_field"]
    assert found.gap.shape_incomplete
    assert (
        "a line at a period of 85 s remains, at a multiple or a simple fraction of the wheel's frequency"
        in found.sentence
    )
