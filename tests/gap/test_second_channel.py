"""The angle between sun and nadir decides between a turned magnetometer and a turned sun-sensor head.

Rows of one head alone, and only b modelled: then both explain the readings, and the head does with fewer parameters. The
witness is the simulator; the turn is 1 deg, some 700 nT at the magnetometer.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fluxtwin.diagnosing import diagnose
from fluxtwin.gap.channels.sun_nadir import _confirmed
from fluxtwin.gap.posterior.stated import stated
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.sim.earth import frames
from fluxtwin.sim.run.simulate import simulate

pytestmark = pytest.mark.closure

TURN_DEG = [0.6, -0.8, 0.3]
HEAD_2 = {"effects.sun_sensor_head_misalignment": {"head": 2, "turn_deg": TURN_DEG}}
PLAIN = {"sun_sensor.1.misalignment_deg": None, "magnetometer.S": [[0.0] * 3] * 3}


def record(changes):
    telemetry = mission.fly(mission.scenario().updated(PLAIN | changes)).telemetry
    return telemetry.select(np.flatnonzero(np.array(telemetry.sun_sensor_head) == 2)[::3])


def turned_magnetometer():
    """A reading of axes turned by -theta is that of a reference attitude turned by +theta."""
    x, y, z = np.radians(TURN_DEG)
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return {"magnetometer.S": turn.tolist()}


ask = partial(diagnose, modelled=("bias",), field="igrf14", noise_nT=0.0, lsb_nT=471.0)


def test_a_turned_head_is_named_and_the_angle_confirms_it():
    found = ask(record(HEAD_2))
    first = found.effects[0]
    assert (first.name, first.settings, first.group) == (
        "sun_sensor_head_misalignment",
        {"head": 2},
        ("sun_sensor_head_misalignment",),
    )
    assert first.probability == stated(1.0)  # both show it
    alike = replace(first, group=(first.name, "yaw_drift", "bias_step"))
    doubted = _confirmed(alike, replace(first, probability=0.75))  # who else it may be shares the doubt
    sure = _confirmed(replace(first, significance=1e-3), replace(first, significance=1e-9))
    assert sure.significance == 1e-9
    assert (doubted.group, doubted.rivals) == ((first.name,), (("yaw_drift", 0.125), ("bias_step", 0.125)))
    # With one head in use a constant bias of the scanner changes the angle alike; the readings tell the two apart.
    shown = found.provenance["sun_nadir"]
    assert "sun_sensor_head_misalignment of head 2" in [
        *shown["rivals"],
        f"{shown['named']['name']} of head {shown['named']['head']}",
    ]
    assert len(found.effects) == 1
    assert shown["ruled_out"] == []


def test_a_turned_magnetometer_is_not_blamed_on_the_head():
    telemetry = record(turned_magnetometer())
    blind = ask(telemetry.replace(nadir_B=None))
    assert blind.effects[0].name == "sun_sensor_head_misalignment"  # what readings alone say: fewer parameters
    found = ask(telemetry)
    assert found.verdict == "effect"
    assert [effect.name for effect in found.effects] == ["scale_misalignment"]
    assert "angle between sun and nadir" in found.untestable["sun_sensor_head_misalignment"]
    assert found.provenance["sun_nadir"]["ruled_out"] == ["sun_sensor_head_misalignment"]
    assert any("ruled out" in note for note in found.notes)


@pytest.mark.parametrize(
    ("section", "column", "other"),
    [
        (HEAD_2, "sun_B", "nadir_B"),
        ({"effects.horizon_scanner_bias": {"roll_sin_deg": 0.4, "pitch_cos2_deg": -0.3}}, "nadir_B", "sun_B"),
    ],
)
def test_what_the_faulty_sensor_measures_is_turned_with_the_attitude(section, column, other):
    """A turned head reports a turned sun, a biased scanner a turned nadir, by the turn of the reported attitude."""
    config = mission.scenario().updated(PLAIN)
    plain, faulty = simulate(config)[0], simulate(config.updated(section))[0]
    known = plain.has_attitude
    turn = (
        frames.rotation_from_q(np.array(faulty.q_NB)[known]) * frames.rotation_from_q(np.array(plain.q_NB)[known]).inv()
    )
    assert np.degrees(turn.magnitude()).max() > 0.25
    np.testing.assert_allclose(
        np.array(getattr(faulty, column))[known], turn.apply(np.array(getattr(plain, column))[known]), atol=1e-9
    )  # unit vectors: rounding only
    np.testing.assert_array_equal(getattr(faulty, other), getattr(plain, other))
