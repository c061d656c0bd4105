"""Diagnoses of records that have no reference attitude, in some rows or in none.

The effects are injected by the simulator, so large that 40 nT (the solar array) to 130 nT (the ring current) are left
along the field beside the best re-estimation of b and S, where the noise is 105 nT; the seeds are the first that were
tried.
"""

from __future__ import annotations

import numpy as np
import pytest
from worlds import COARSE_MAGNETOMETER, scenario_text

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

SECTIONS = f"""
[attitude.reference]
sigma_deg = 0.1
tau_s = 150.0
[horizon_scanner]
noise_deg = 0.15
tau_s = 200.0
{COARSE_MAGNETOMETER}[power]
full_sun_current_A = 8.0
load_A = 3.0
"""
NADIR = "yaw_rms_deg = 4.0\nroll_rms_deg = 4.0\npitch_rms_deg = 4.0"
TUMBLE = 'mode = "tumble"\nrate_deg_s = [0.12, 0.08, 0.2]'
AT = "2020-03-01T02:00:00Z"
SINGLES = {
    "bias_step": (f'at = "{AT}"\nb_nT = [200.0, -150.0, 100.0]', {"b_x": 200.0, "b_y": -150.0, "b_z": 100.0}),
    "solar_array_current": ("s_nT_per_A = [60.0, -50.0, 40.0]", {"s_x": 60.0, "s_y": -50.0, "s_z": 40.0}),
    "ring_current": ("external_nT = -300.0", {"external": -300.0}),
    "quadratic_nonlinearity": ("q_x_xx_nT = 900.0\nq_y_yy_nT = -700.0", {"q_x_xx": 900.0, "q_y_yy": -700.0}),
}


def flight(attitude: str, effects: str = "") -> Telemetry:
    text = scenario_text(
        f"[attitude]\n{attitude}\n{SECTIONS}{effects}\n",
        seed=4,
        inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
        segment="duration_min = 240.0, step_s = 30.0",
    )
    return simulate(parse_scenario(text))[0]


def without(record: Telemetry, rows: np.ndarray, nadir: bool = False) -> Telemetry:
    q = np.array(record.q_NB)
    q[rows] = np.nan
    return record.replace(q_NB=None if rows.all() else q, nadir_B=record.nadir_B if nadir else None)


def blind(record: Telemetry) -> Telemetry:
    return without(record, np.ones(len(record), dtype=bool))


def diagnosed(record: Telemetry) -> Diagnosis:
    budget = Budget(100.0, 100.0, float(np.radians(0.1)), None)
    return diagnose(record, load_field("igrf14"), budget=budget)


def pulls(found: Diagnosis, truth: dict[str, float]) -> np.ndarray:
    known = found.effects[0].parameters
    return np.array([(known[name].value - value) / known[name].sigma for name, value in truth.items()])


def test_a_perfect_simulation_without_any_attitude_has_no_gap(close):
    found = diagnosed(blind(flight(TUMBLE)))
    assert found.verdict == "no_gap"
    assert found.samples == {"used": 481, "cut": 0, "without_attitude": 481}
    assert {"horizon_scanner_bias", "yaw_drift", "sun_sensor_head_misalignment", "bit_errors"} <= set(found.untestable)
    assert "481 of 481 rows" in found.provenance["without_attitude"]
    close(
        found.gap.before_nT,
        float(np.hypot(100.0, 100.0 / np.sqrt(12.0))),
        atol=12.0,
        unit="nT",
        because="sensor noise and rounding alone: 481 components, nine parameters, to three sigma",
    )


@pytest.mark.parametrize("name", SINGLES)
def test_an_effect_is_named_and_measured_from_the_size_of_the_field_alone(name):
    keys, truth = SINGLES[name]
    found = diagnosed(blind(flight(TUMBLE, f"[effects.{name}]\n{keys}\n")))
    assert found.verdict == "effect"
    assert [effect.name for effect in found.effects] == [name]
    assert np.abs(pulls(found, truth)).max() < 4.0  # 6e-5 each by chance
    parts = found.effects[0].parameters
    if name == "quadratic_nonlinearity":
        # The field's size sees q_x_yy + q_y_xy: their sum, not which axis reads it.
        assert parts["q_x_yy"].sigma is None and parts["q_y_xy"].sigma is None
        assert found.effects[0].axis is None


def test_a_field_switched_at_night_is_found_in_rows_that_have_nadir_alone():
    record = flight(NADIR, '[effects.switched_field]\ncondition = "eclipse"\nf_nT = [250.0, 150.0, -100.0]\n')
    found = diagnosed(without(record, np.array(record.sunlit) < 0.5, nadir=True))
    assert found.verdict == "effect"
    assert [effect.name for effect in found.effects] == ["switched_field"]
    assert found.where.condition == "eclipse" and found.where.frame == "body"
    assert np.abs(pulls(found, {"f_x": 250.0, "f_y": 150.0, "f_z": -100.0})).max() < 4.0
    assert "160 of them through its angle to nadir" in found.provenance["without_attitude"]


def test_a_clock_error_is_measured_where_every_second_row_lacks_attitude():
    record = flight(TUMBLE, "[effects.time_tag_offset]\noffset_s = 4.0\n")
    found = diagnosed(without(record, np.arange(len(record)) % 2 == 0))
    assert [effect.name for effect in found.effects] == ["time_tag_offset"]
    assert abs(pulls(found, {"offset": 4.0})[0]) < 4.0
    assert found.samples["without_attitude"] == 241
