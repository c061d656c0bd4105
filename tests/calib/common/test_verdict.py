"""What a calibration says of itself: good ones are called good, impossible ones bad, and the degrees are kept."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.verdict import assess
from fluxtwin.calib.methods import calibrate_by
from fluxtwin.sim.earth import frames
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

HOUR = np.timedelta64(3600, "s")


def flown(seasat: Any, seed: int = 1, **changes: float) -> Telemetry:
    """Seasat's four days: noise 20 nT, reference attitude wrong by 0.1 deg white."""
    rng = np.random.default_rng(seed)
    meter = seasat.magnetometer(noise_nT=changes.pop("noise_nT", 20.0))
    record = seasat.record(meter.reading(seasat.field_B_nT, None, rng))
    turn = frames.Rotation.from_rotvec(np.radians(changes.pop("attitude_deg", 0.1)) * rng.normal(size=(len(record), 3)))
    assert not changes
    return record.replace(q_NB=frames.q_from_rotation(turn * frames.rotation_from_q(record.q_NB)))


def fitted(record: Telemetry, seasat: Any, **options: Any) -> Fit:
    return calibrate_by(record, seasat.model, **options)


@pytest.mark.parametrize("method", ["linear", "forward", "scalar"])
def test_a_good_fit_is_called_good(seasat: Any, method: str) -> None:
    """Four records each; a comparison of variances errs once in a thousand. `scalar` has no attitude to compare with."""
    for seed in range(4):
        record = flown(seasat, seed, noise_nT=5.0)
        record = record.replace(q_NB=None) if method == "scalar" else record
        verdict = fitted(record, seasat, method=method).verdict
        assert verdict is not None
        assert verdict.level == "good", verdict.reasons
        assert verdict.lines[0].startswith("Good. The residual")
        assert verdict.lines[-1] == f"Next: {verdict.next_step}"
        assert verdict.next_step.startswith(("fluxtwin apply", "add data"))


def test_what_is_known_worse_than_of_any_magnetometer_is_no_calibration(seasat: Any) -> None:
    record = flown(seasat)
    fit = fitted(record, seasat)
    worst = int(fit.calibration.sigmas[:9].argmax())
    for size, level in ((0.21, "bad"), (0.19, "usable")):
        wider = fit.calibration.covariance * (size / fit.calibration.sigmas[worst]) ** 2
        verdict = assess(replace(fit, calibration=replace(fit.calibration, covariance=wider)), record)
        assert verdict.level == level
    assert not any("do not determine" in words for words in verdict.reasons)
    wider = fit.calibration.covariance * (67.0 / fit.calibration.sigmas[worst]) ** 2
    verdict = assess(replace(fit, calibration=replace(fit.calibration, covariance=wider)), record)
    assert verdict.reasons[0].startswith(f"{fit.calibration.names[worst]} is only known to ± 67, and no magnetometer")
    assert verdict.next_step.startswith("add data") and not any(" deg " in line for line in verdict.lines)


def test_the_clock_an_hour_off_is_no_calibration(seasat: Any) -> None:
    record = flown(seasat)
    verdict = fitted(record.replace(time=record.time + HOUR), seasat).verdict
    assert verdict is not None
    assert verdict.level == "bad"
    assert any("clock" in words for words in verdict.reasons)
    assert verdict.next_step.startswith("fluxtwin check TELEMETRY; if it finds nothing, fluxtwin diagnose")


def test_a_clock_twenty_minutes_off_is_not_the_field_model(seasat: Any) -> None:
    """Between what a field model may be wrong by and what is impossible: said as more than a model gives."""
    record = flown(seasat)
    verdict = fitted(record.replace(time=record.time + HOUR / 3), seasat).verdict
    assert verdict is not None
    assert verdict.level == "usable"
    words = " ".join(verdict.reasons)
    assert "an error of the field model" not in words
    assert "clock" in words
    assert verdict.next_step.startswith("fluxtwin check TELEMETRY; if it finds nothing, fluxtwin diagnose")


def test_an_S_that_no_magnetometer_has_is_named(seasat: Any) -> None:
    record = flown(seasat)
    verdict = fitted(record.replace(mag_B_nT=record.mag_B_nT * np.array([1.0, 1.4, 1.0])), seasat).verdict
    assert verdict is not None
    assert verdict.level == "bad"
    assert verdict.reasons[0].startswith("S22 = -0.3")
    sound = fitted(record.replace(mag_B_nT=record.mag_B_nT * np.array([1.0, 1.1, 1.0])), seasat).verdict
    assert sound is not None
    assert sound.level == "good"  # a tenth is a magnetometer badly made, not an impossible one


def test_an_attitude_error_is_not_taken_for_a_bad_calibration(seasat: Any) -> None:
    """0.3 deg give 200 nT across the field and none along it."""
    verdict = fitted(flown(seasat, attitude_deg=0.3), seasat).verdict
    assert verdict is not None
    assert verdict.level == "good", verdict.reasons
    assert verdict.residual_nT > 100.0
    assert verdict.along_field_nT < 30.0


def test_an_attitude_error_beyond_the_declared_one_is_said(seasat: Any) -> None:
    record = flown(seasat, attitude_deg=0.3)
    levels = [
        (verdict.level, " ".join(verdict.reasons))
        for declared in (0.3, 0.15, 0.02)
        if (verdict := fitted(record, seasat, attitude_sigma_deg=declared, attitude_tau_s=0.0).verdict) is not None
    ]
    assert [level for level, _ in levels] == ["good", "usable", "bad"], levels
    assert "0.02 deg were declared" in levels[2][1]


@pytest.mark.parametrize(
    ("first", "end", "level", "where"),
    [
        (0.6, 1.0, "bad", " lie from {first} on, among "),
        (0.0, 0.3, "bad", " lie until {last}, among "),
        (0.5, 0.6, "usable", " lie from {first} to {last}, among "),
    ],
)
def test_two_populations_are_no_calibration(seasat: Any, first: float, end: float, level: str, where: str) -> None:
    """A stretch in which two axes are swapped: much of a record is no outlier, and the stretch is named by its stamps."""
    record = flown(seasat, noise_nT=5.0)
    swapped = np.arange(int(first * len(record)), int(end * len(record)))
    B = np.array(record.mag_B_nT)
    B[swapped] = B[swapped][:, [1, 0, 2]]
    fit = fitted(record.replace(mag_B_nT=B), seasat)
    verdict, out = fit.verdict, fit.rows[~fit.kept]
    assert verdict is not None
    assert verdict.level == level, verdict.lines
    words = next(one for one in verdict.reasons if "of the rows are outliers" in one)
    assert set(out) <= set(swapped) and len(out) > 0.9 * len(swapped)
    ends = {"first": record.time[out[0]], "last": record.time[out[-1]]}
    assert where.format(**{name: f"{time.astype('datetime64[s]')}Z" for name, time in ends.items()}) in words
    assert ("describes only a part of the record" in words) == (level == "bad")


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1, 0.2])
def test_bit_errors_here_and_there_are_outliers(seasat: Any, share: float) -> None:
    record, rng = flown(seasat, noise_nT=5.0), np.random.default_rng(3)
    wrong = rng.random(len(record)) < share
    bits = rng.choice([-1.0, 1.0], (len(record), 3)) * 2.0 ** rng.integers(10, 15, (len(record), 3))
    B = np.where(wrong[:, None], record.mag_B_nT + bits, record.mag_B_nT)
    verdict = fitted(record.replace(mag_B_nT=B), seasat).verdict
    assert verdict is not None
    assert verdict.level in {"good", "usable"} and verdict.set_aside > 0.9 * wrong.sum()
    assert not any("no errors of single readings" in words for words in verdict.reasons)


def test_what_is_left_along_the_field_limits_it(seasat: Any) -> None:
    """A field that follows no parameter, 150 nT along the field, beside 20 nT of noise."""
    record = flown(seasat)
    unit = record.mag_B_nT / np.linalg.norm(record.mag_B_nT, axis=1)[:, None]
    wave = 200.0 * np.sin(np.arange(len(record)) / 3.0)[:, None] * unit
    verdict = fitted(record.replace(mag_B_nT=record.mag_B_nT + wave), seasat).verdict
    assert verdict is not None
    assert verdict.level == "usable"
    assert "Along the field" in verdict.reasons[0]
    assert verdict.next_step.startswith("fluxtwin diagnose")


def test_a_load_that_lasts_is_no_noise(seasat: Any) -> None:
    """75 nT along the field, on and off for half an hour each: what lasts does not excuse its own size."""
    record = flown(seasat, noise_nT=30.0)
    unit = record.mag_B_nT / np.linalg.norm(record.mag_B_nT, axis=1)[:, None]
    minutes = (record.time - record.time[0]) / np.timedelta64(60, "s")
    wave = 75.0 * np.where(minutes % 60.0 < 30.0, 1.0, -1.0)[:, None] * unit
    verdict = fitted(record.replace(mag_B_nT=record.mag_B_nT + wave), seasat).verdict
    assert verdict is not None and verdict.level == "usable", verdict.lines
    assert verdict.next_step.startswith("fluxtwin diagnose")


def test_an_uncertain_bias_hides_no_scale_error(seasat: Any) -> None:
    """S of a percent, not estimated, leaves 250 nT along the field and a bias known to 160 nT. That a calibration is
    uncertain excuses no more than a field model does, and the answer is to estimate S, not to check the file."""
    record = flown(seasat)
    verdict = fitted(record, seasat, parameters="b").verdict
    assert verdict is not None and verdict.level == "usable"
    assert verdict.next_step == "fluxtwin calibrate TELEMETRY --parameters b,S"
    worse = fitted(record.replace(mag_B_nT=record.mag_B_nT * [1.12, 0.92, 1.04]), seasat, parameters="b").verdict
    assert worse is not None and worse.impossible and "S (which was not estimated), clock" in worse.lines[1]
    assert worse.next_step == verdict.next_step
    counts = fitted(record.replace(mag_B_nT=record.mag_B_nT / 100.0), seasat, parameters="b").verdict
    assert counts is not None and counts.impossible and counts.next_step.startswith("fluxtwin check")


def test_a_slow_load_does_not_excuse_itself(seasat: Any) -> None:
    """A body field that swings by 90 nT once an orbit and two fifths: the fit takes it for slow errors of its own."""
    record = flown(seasat, noise_nT=25.0)
    minutes = (record.time - record.time[0]) / np.timedelta64(60, "s")
    load = np.sin(2.0 * np.pi * minutes / 140.0)[:, None] * [90.0, -60.0, 120.0]
    fit = fitted(record.replace(mag_B_nT=record.mag_B_nT + load), seasat)
    assert fit.error_model.slow_nT > 25.0
    assert fit.verdict.along_field_nT > 1.5 * fit.verdict.along_field_expected_nT
    assert fit.verdict.level == "usable", fit.verdict.lines


def test_a_small_load_is_not_called_good(seasat: Any) -> None:
    """A field of the body, on and off, as large as the noise: 325 rows show that the residual is not noise."""
    record = flown(seasat)
    half = np.arange(len(record)) % 80 < 40
    load = np.where(half[:, None], 25.0, -25.0) * [1.0, -1.0, 1.0]
    fit = fitted(record.replace(mag_B_nT=record.mag_B_nT + load), seasat)
    assert fit.verdict.along_field_nT < np.sqrt(2.0) * fit.verdict.along_field_expected_nT
    assert fit.verdict.level == "usable", fit.verdict.lines
    assert fit.verdict.next_step.startswith("fluxtwin diagnose")


@pytest.mark.parametrize("seed", range(4))
def test_a_coarse_attitude_is_not_taken_for_an_effect(seasat: Any, seed: int) -> None:
    """2 deg take 45 nT (rms) from the field along itself, beside 10 nT of noise."""
    fit = fitted(flown(seasat, seed, noise_nT=10.0, attitude_deg=2.0), seasat)
    assert fit.verdict.along_field_nT > 30.0
    assert not any("not modelled" in words for words in fit.verdict.reasons), fit.verdict.lines
    assert "act by their square alone" in fit.verdict.residual


def test_a_weak_direction_is_answered_with_a_manoeuvre(seasat: Any) -> None:
    """Day 227 alone, 44 minutes: the field hardly varies along body Y."""
    verdict = fitted(flown(seasat).select(slice(281, 325)), seasat).verdict
    assert verdict is not None
    assert "along body Y" in verdict.next_step
    assert verdict.level == "usable"
    assert "in attitudes that these data do not have" in verdict.reasons[0]
    assert verdict.direction.calibration_anywhere_deg > 2.0 * verdict.direction.calibration_deg
    # a field that hardly varies along Y is a bias to these data
    worst = [(pair.one, pair.other) for pair in verdict.correlated[:3]]
    assert worst == [("S12", "b1"), ("S22", "b2"), ("S32", "b3")]
    sizes = [abs(pair.correlation) for pair in verdict.correlated]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] >= 0.95


def test_a_symmetric_S_is_no_correlation(seasat: Any) -> None:
    """S12 and S21 of a scalar fit are one number."""
    verdict = fitted(flown(seasat), seasat, method="scalar").verdict
    assert verdict is not None
    assert not [pair for pair in verdict.correlated if pair.one[0] == "S" and pair.one[1:] == pair.other[:0:-1]]


def test_the_stated_angle_holds(seasat: Any) -> None:
    """Mean over 15 records of the share of calibrated readings within the stated angle of the true field.

    Noise alone makes up most of it; its share of 325 rows has a standard error of 1.2 % a record, the calibration's
    part is one draw a record: 0.95 +- 0.02 is about four sigma of the mean.
    """
    shares, before = [], []
    for seed in range(15):
        record = flown(seasat, seed)
        fit = fitted(record, seasat)
        assert fit.verdict is not None
        estimate, true = fit.calibration.apply(record.mag_B_nT), seasat.field_B_nT
        cross = np.linalg.norm(np.cross(estimate, true), axis=1)
        angle = np.degrees(np.arctan2(cross, (estimate * true).sum(axis=1)))
        shares.append((angle <= fit.verdict.direction.after_deg).mean())
        raw = np.linalg.norm(np.cross(record.mag_B_nT, true), axis=1)
        angle = np.degrees(np.arctan2(raw, (record.mag_B_nT * true).sum(axis=1)))
        before.append(np.quantile(angle, 0.95) / fit.verdict.direction.before_deg)
    assert abs(np.mean(shares) - 0.95) < 0.02, np.mean(shares)
    assert abs(np.mean(before) - 1.0) < 0.01, np.mean(before)


def test_the_record_is_plain(seasat: Any) -> None:
    import json

    fit = fitted(flown(seasat), seasat)
    content = json.loads(json.dumps(fit.to_dict(), allow_nan=False))["verdict"]
    assert content["level"] == "good"
    assert content["confidence"] == 0.95
    assert content["lines"][0].startswith("Good.")
    assert set(content["direction"]) == {
        "before_deg",
        "after_deg",
        "calibration_deg",
        "calibration_anywhere_deg",
        "noise_deg",
        "against_reference_deg",
        "rotation_counted",
        "rotation_deg",
    }


def test_an_error_without_the_sensors_rotation_is_not_called_absolute(seasat: Any) -> None:
    """Seasat's S turns the sensor by most of a degree; turned by three more, |B| is the same and so is the fit to it."""
    record = flown(seasat, noise_nT=5.0)
    turn = frames.Rotation.from_rotvec(np.radians([0.0, 0.0, 3.0]))
    turned = record.replace(mag_B_nT=turn.apply(np.array(record.mag_B_nT)))
    alone = fitted(turned.replace(q_NB=None), seasat).verdict
    assert alone is not None and alone.level == "good"
    assert alone.direction.rotation_deg is None and not alone.direction.rotation_counted
    (degrees,) = (line for line in alone.lines if line.startswith("Field direction"))
    assert "without a rotation of the sensor in the body, which |B| does not show (so no absolute one, AKE)" in degrees
    full = fitted(turned, seasat, method="linear")
    known = full.calibration.apply(turned.mag_B_nT)
    seen = fitted(turned, seasat, method="scalar")
    axis = frames.Rotation.align_vectors(known, seen.calibration.apply(turned.mag_B_nT))[0]
    assert seen.verdict is not None and full.verdict is not None
    assert seen.verdict.direction.rotation_deg == pytest.approx(np.degrees(axis.magnitude()), abs=0.05)
    assert 2.0 < (seen.verdict.direction.rotation_deg or 0.0) < 4.0
    assert seen.verdict.level == "usable" and "--method linear takes it out" in seen.verdict.reasons[-1]
    assert any("AKE) at 95 %" in line for line in full.verdict.lines) and full.verdict.direction.rotation_counted
