"""The sun-nadir channel names a faulty attitude sensor and keeps quiet about a turned magnetometer."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, t

from fluxtwin.gap.channels.sun_nadir import _by_signs, _weigh, open_channel
from fluxtwin.gap.selection.criterion import worth
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.sim.base.errors import BadInput, NoAnswer

pytestmark = pytest.mark.closure

HEAD_1 = {"sun_sensor.1.misalignment_deg": [0.3, 0.52, 0.0]}
CASES = {
    "nothing": ({}, None),
    "magnetometer": ({"magnetometer.S": [[0.0, 0.02, -0.01], [-0.02, 0.0, 0.01], [0.01, -0.01, 0.0]]}, None),
    "head 1": (HEAD_1, ("sun_sensor_head_misalignment", 1)),
    "head 2": ({"sun_sensor.2.misalignment_deg": [0.0, 0.4, 0.0]}, ("sun_sensor_head_misalignment", 2)),
    "scanner": (
        {"horizon_scanner.roll_bias_deg": 0.3, "horizon_scanner.pitch_bias_deg": -0.2},
        ("horizon_scanner_bias", None),
    ),
}


def fly(changes, seed=1978):
    plain = {"sun_sensor.1.misalignment_deg": None, "seed": seed}
    return mission.fly(mission.scenario().updated(plain | changes)).telemetry


@pytest.mark.parametrize("case", CASES)
def test_the_fault_is_named(case):
    changes, expected = CASES[case]
    found = open_channel(fly(changes)).weigh()
    named = None if found.named is None else (found.named.name, found.named.head)
    assert named == expected
    json.dumps(found.to_dict(), allow_nan=False)
    assert found.words.startswith("sun and nadir")


def test_the_turn_of_head_1_comes_back_where_it_can_be_seen():
    """Only the turn about the normal of the plane of sun and nadir moves the angle; at dawn the sun stands at azimuth -28
    to -34 deg, so that normal lies at azimuth 58 deg. A head turned by theta reports the sun turned by minus theta."""
    named = open_channel(fly(HEAD_1)).weigh().named
    normal = np.array([np.cos(np.radians(59.0)), np.sin(np.radians(59.0))])
    found = normal @ [named.parameters["turn_x"].value, named.parameters["turn_y"].value]
    assert found == pytest.approx(-normal @ [0.3, 0.52], abs=0.08)  # 0.5 deg steps of the head over four short passes


def test_passes_of_any_size_explain_by_chance_as_often_as_is_said():
    """Errors of eleven passes, one ten times the next, in six directions: the chance is that of exchanged signs."""
    rng, size = np.random.default_rng(5), np.geomspace(1.0, 10.0, 11)[:, None]
    chance = np.array([_by_signs(size * rng.standard_normal((11, 6)), np.eye(6)) for _ in range(300)])
    for level in (0.05, 0.2, 0.5):
        assert abs(np.mean(chance <= level) - level) < 4.0 * np.sqrt(level * (1.0 - level) / 300)
    assert _by_signs(size * np.ones((11, 6)), np.eye(6)) < 2.0 * 2.0**-10


def test_the_errors_themselves_with_all_signs_turned_are_no_others():
    """Four passes of one sign: of the sixteen choices, two explain as much as they do, and both are they."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        assert _by_signs(rng.uniform(0.5, 2.0, (4, 1)) * np.full((4, 2), np.pi), np.eye(2)) == 0.0


def test_a_reported_orbit_that_is_wrong_is_no_fault_of_a_sensor():
    """The nadir is computed from the reported position: turned by 0.5 deg about a slanting axis, which is an error along
    the orbit and of its plane at once, it looks like a biased scanner until the orbit may be wrong too."""
    right = fly({})
    turned = Rotation.from_rotvec(np.radians(0.5) * np.array([0.6, 0.0, 0.8])).apply(np.array(right.r_N_km))
    channel = open_channel(right.replace(r_N_km=turned))
    assert channel.weigh().named is not None
    beside = channel.beside_orbit()
    assert beside.weigh().named is None
    left = open_channel(right).beside_orbit().residual_rad
    assert beside.residual_rad == pytest.approx(left, abs=np.radians(0.5) ** 2)  # what is not linear in the turn
    assert open_channel(fly(HEAD_1)).beside_orbit().weigh().named.words == "sun_sensor_head_misalignment of head 1"


def test_a_reported_orbit_of_wrong_eccentricity_is_no_fault_of_a_sensor():
    """2 e = 0.5 deg along the orbit, once a revolution."""
    right = fly({})
    r_N_km = np.array(right.r_N_km)
    across = np.cross(r_N_km[0], np.array(right.v_N_km_s)[0])
    across /= np.linalg.norm(across)
    phase = np.arctan2(np.cross(r_N_km[0], r_N_km) @ across, r_N_km @ r_N_km[0])
    ahead = Rotation.from_rotvec(np.radians(0.5) * np.sin(phase + 1.0)[:, None] * across).apply(r_N_km)
    channel = open_channel(right.replace(r_N_km=ahead))
    assert channel.weigh().named is not None
    assert channel.beside_orbit().weigh().named is None


def test_false_alarms_are_rare():
    """30 flights without a fault: at 1 % two alarms or more have a chance of 4 %."""
    alarms = [seed for seed in range(30) if open_channel(fly({}, seed)).weigh().named is not None]
    assert len(alarms) <= 1


def test_too_little_is_said_in_words():
    telemetry = fly({})
    with pytest.raises(NoAnswer, match="passes have measured sun and nadir"):
        open_channel(telemetry.select(np.arange(100))).weigh()
    with pytest.raises(BadInput, match="no such columns"):
        open_channel(telemetry.replace(sun_B=None)).weigh()


def test_a_record_without_gaps_is_cut_into_stretches():
    continuous = mission.scenario().updated(
        {"schedule.in_view_of_stations": None, "sun_sensor.1.misalignment_deg": None}
    )
    segment = {"start_utc": "1978-11-29T14:00:00Z", "duration_min": 400.0, "step_s": 10.0}
    found = open_channel(mission.fly(continuous.updated({"schedule.segments": [segment]})).telemetry).weigh()
    assert found.passes >= 8
    assert found.named is None


def test_a_constant_is_weighed_as_the_textbook_weighs_a_mean():
    """Twenty passes of five rows: Student's t over the means of the passes, and what they share on top of its sigma."""
    of_row = np.repeat(np.arange(20), 5)
    residual = np.random.default_rng(9).normal(0.004, 0.01, 100)
    found = _weigh(("a", None), ("x",), np.ones((100, 1)), residual, of_row, 3)
    value, sigma = found.parameters["x"].value, found.parameters["x"].sigma
    means = residual.reshape(20, 5).mean(axis=1)
    assert value == pytest.approx(np.degrees(means.mean()))
    assert sigma == pytest.approx(np.degrees(means.std(ddof=1) / np.sqrt(20.0)))
    p_value = 2.0 * t.sf(abs(value / sigma), 19)
    assert found.p_value == pytest.approx(3.0 * p_value)
    assert found.worth == pytest.approx(worth(chi2.isf(p_value, 1), 1, 20, np.log(3.0)))
    left = np.degrees(residual - residual.mean())
    assert found.rms_left_deg == pytest.approx(left.std())
    assert found.amount_deg == pytest.approx((abs(value), np.sqrt(sigma**2 + (left**2).mean() / 20.0)))
    once = _weigh(("a", None), ("x",), np.ones((100, 1)), residual, np.zeros(100), 3)
    assert (once.p_value, once.worth) == (1.0, worth(0.0, 1, 2, np.log(3.0)))  # one pass shows nothing
    unseen = _weigh(("a", None), ("x",), np.zeros((100, 1)), residual, of_row, 3)
    assert unseen.rms_left_deg == pytest.approx(np.degrees(np.sqrt((residual**2).mean())))
