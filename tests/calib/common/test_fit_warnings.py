"""A fit that cannot be right says so; a sound one does not."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.calib.methods import calibrate_by
from fluxtwin.scenarios.seasat import mission
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth.field import load_field

pytestmark = pytest.mark.closure


@pytest.fixture(scope="module")
def sound():
    return mission.fly(mission.scenario().updated({"torquers.telemetered": False})).telemetry


@pytest.fixture(scope="module")
def ground():
    return load_field("igrf1975")


def warnings_of(telemetry, ground, **options):
    return " ".join(calibrate_linear(telemetry, ground, covariance="white", **options).messages)


def test_a_sound_fit_raises_no_doubt(sound, ground):
    said = warnings_of(sound, ground)
    for word in ("check", "tukey", "T was not estimated"):
        assert word not in said


def test_a_conjugated_quaternion_and_a_wrong_unit_are_no_calibration(sound, ground):
    conjugated = np.array(sound.q_NB) * [-1, -1, -1, 1]
    for wrong in (sound.replace(q_NB=conjugated), sound.replace(mag_B_nT=np.array(sound.mag_B_nT) * 2.0)):
        verdict = calibrate_by(wrong, ground).verdict
        assert verdict.level == "bad"
        assert "attitude" in " ".join(verdict.reasons)
        assert "unit" in " ".join(verdict.reasons)


def test_bit_errors_are_doubted_unless_they_are_left_out(sound, ground):
    mag = np.array(sound.mag_B_nT)
    rows = stream(1, "test.bit_errors").choice(len(mag), size=15, replace=False)
    mag[rows, 0] += 16 * 440.0
    assert "--robust tukey" in warnings_of(sound.replace(mag_B_nT=mag), ground, robust="none")
    robust = warnings_of(sound.replace(mag_B_nT=mag), ground)
    assert "15 outliers of more than 6 robust sigma left out" in robust and "--robust" not in robust


def test_torquers_that_fired_are_mentioned_until_T_is_asked_for(ground):
    telemetry = mission.fly(mission.scenario()).telemetry
    assert "T was not estimated" in warnings_of(telemetry, ground)
    assert "T was not estimated" not in warnings_of(telemetry, ground, parameters="b,S,T")
