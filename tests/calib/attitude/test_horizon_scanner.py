"""Scanner calibration from sun-nadir angles: what is put in comes back, within honest sigmas, or is refused in words."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.calib.attitude.horizon_scanner import _by_pass, calibrate_scanner
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.earth.frames import nadir_of, roll_pitch
from fluxtwin.sim.earth.sun import sun_direction_N

pytestmark = pytest.mark.closure

BIAS_DEG = np.array([0.40, -0.30])


@pytest.fixture(scope="module")
def config():
    segment = {"start_utc": "1978-10-17T00:00:00Z", "duration_min": 720.0, "step_s": 30.0}
    return mission.scenario().updated(
        {
            "schedule.segments": [segment],
            "horizon_scanner.roll_bias_deg": float(BIAS_DEG[0]),
            "horizon_scanner.pitch_bias_deg": float(BIAS_DEG[1]),
            "sun_sensor.1.misalignment_deg": None,
        }
    )


@pytest.fixture(scope="module")
def telemetry(config):
    return mission.fly(config).telemetry


def test_biases_come_back_and_the_residual_falls_to_the_sensors_noise(telemetry, close):
    found = calibrate_scanner(telemetry, heads=(2, 3))
    assert found.passes == 12
    pull = (np.degrees(found.bias_rad) - BIAS_DEG) / np.degrees(found.sigmas_rad)
    assert (np.abs(pull) < 4.0).all()  # false alarm 1.3e-4
    assert np.degrees(found.rms_before_rad) > 1.5 * np.degrees(found.rms_after_rad)
    # Sun: 0.5/sqrt 12 and 0.12 deg; scanner: 0.15 deg; the papers print 0.24 deg after the same calibration.
    close(
        np.degrees(found.rms_after_rad), 0.24, atol=0.02, unit="deg", because="noise put in; 1,000 correlated samples"
    )


def test_sigmas_hold_over_seeds(config):
    pulls = []
    for seed in range(20):
        found = calibrate_scanner(mission.fly(config.updated({"seed": seed})).telemetry, heads=(2, 3))
        pulls.append((np.degrees(found.bias_rad) - BIAS_DEG) / np.degrees(found.sigmas_rad))
    # 40 pulls: their rms is 1 +- 0.11; stated sigmas may be a little wide, by the small-sample factor.
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.35


def test_the_corrected_record_has_no_bias_left(telemetry):
    found = calibrate_scanner(telemetry, heads=(2, 3))
    again = calibrate_scanner(found.apply(telemetry), heads=(2, 3))
    assert np.abs(np.degrees(again.bias_rad)).max() < 1e-6
    assert again.rms_before_rad == pytest.approx(found.rms_after_rad, rel=1e-9)


def test_a_scanner_without_bias_gets_none(config):
    plain = config.updated({"horizon_scanner.roll_bias_deg": 0.0, "horizon_scanner.pitch_bias_deg": 0.0})
    found = calibrate_scanner(mission.fly(plain).telemetry, heads=(2, 3))
    assert (np.abs(found.bias_rad) < 4.0 * found.sigmas_rad).all()


def test_swapped_or_reversed_angles_would_be_noticed(telemetry):
    """Mutants: the answer is tens of sigmas from the biases swapped, or with another sign."""
    found = calibrate_scanner(telemetry, heads=(2, 3))
    sigma = np.degrees(found.sigmas_rad)
    for wrong in (BIAS_DEG[::-1], -BIAS_DEG, BIAS_DEG * [1, -1], BIAS_DEG * [-1, 1]):
        assert (np.abs(np.degrees(found.bias_rad) - wrong) / sigma).max() > 10.0


def test_a_trusted_head_that_is_turned_goes_into_the_scanner(config, telemetry):
    """Why heads are chosen: a turned head is taken for a biased scanner, with small sigmas and no sign of it."""
    turned = mission.fly(config.updated({"sun_sensor.2.misalignment_deg": [0.6, 0.0, 0.0]})).telemetry
    right, wrong = (calibrate_scanner(record, heads=(2, 3)) for record in (telemetry, turned))
    assert (np.abs(wrong.bias_rad - right.bias_rad) > 5 * right.sigmas_rad).any()
    assert (np.abs(np.degrees(right.bias_rad) - BIAS_DEG) < 4 * np.degrees(right.sigmas_rad)).all()


def test_too_little_is_said_in_words(telemetry):
    with pytest.raises(NoAnswer, match="rows have both"):
        calibrate_scanner(telemetry.select(np.arange(5)))
    with pytest.raises(BadInput, match="no such columns"):
        calibrate_scanner(telemetry.replace(nadir_B=None))
    with pytest.raises(BadInput, match="does not say which saw the sun"):
        calibrate_scanner(telemetry.replace(sun_sensor_head=None), heads=(2, 3))


def test_one_sun_direction_cannot_give_both(telemetry):
    """A few seconds of data: the sun stands still in the body, so the tilt across it is not seen."""
    good = np.flatnonzero(np.isfinite(telemetry.sun_B).all(axis=1))[:1]
    one = telemetry.select(np.repeat(good, 1))
    steps = np.arange(12)
    many = one.replace(
        time=one.time[0] + steps * np.timedelta64(1, "ms"),
        **{n: np.repeat(getattr(one, n), 12, axis=0) for n in _columns(one)},
    )
    with pytest.raises(NoAnswer, match="cannot be seen"):
        calibrate_scanner(many)


def test_a_sigma_of_more_than_five_degrees_is_refused(telemetry):
    """By the slopes of the angle between sun s and nadir n, -s . dn / sin, and the scatter about a line: to a half, as the
    slopes at the fit, by degrees elsewhere, are others."""
    good = np.flatnonzero(np.isfinite(telemetry.sun_B).all(axis=1) & np.isin(telemetry.sun_sensor_head, (2, 3)))
    few = telemetry.select(good[100:110])
    with pytest.raises(NoAnswer) as refused:
        calibrate_scanner(few)
    s, n = np.array(few.sun_B), np.array(few.nadir_B)
    angle = np.arccos(np.sum(s * n, axis=1))
    h = 1e-5
    slopes = [(nadir_of(roll_pitch(n) + h * one) - n) / h for one in np.eye(2)]
    J = np.stack([-np.sum(s * one, axis=1) / np.sin(angle) for one in slopes], axis=1)
    down = -np.array(few.r_N_km)
    sun_N = sun_direction_N(few.time, few.r_N_km)
    y = angle - np.arccos(np.sum(down * sun_N, axis=1) / np.linalg.norm(down, axis=1))
    left = y - J @ np.linalg.lstsq(J, y, rcond=None)[0]
    sigma_deg = np.degrees(np.sqrt(np.mean(left**2) / np.linalg.eigvalsh(J.T @ J)[0]))
    assert refused.value.evidence["sigma_deg"] == pytest.approx(sigma_deg, rel=0.5)


def _columns(record):
    names = (
        "mag_B_nT",
        "r_N_km",
        "v_N_km_s",
        "q_NB",
        "sunlit",
        "sun_B",
        "nadir_B",
        "sun_sensor_head",
        "wheel_speed_rpm",
    )
    return [name for name in names if getattr(record, name) is not None]


def test_three_passes_show_their_scatter_and_two_do_not() -> None:
    """Residuals of 1 that pull neither angle anywhere within a pass: they scatter by nothing; two passes give 1 / n."""
    J, residual = np.tile(np.eye(2), (12, 1)), np.tile([1.0, 1.0, -1.0, -1.0], 6)
    assert np.abs(_by_pass(J, residual, np.repeat([4, 5, 9], 8))[0]).max() < 1e-15
    assert _by_pass(J, residual, np.repeat([4, 9], 12))[0] == pytest.approx(np.eye(2) / 12.0)
