"""Applying a calibration, predicting other days, the noise that the data reveal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fluxtwin.calib.common.apply import apply_calibration
from fluxtwin.calib.common.covariance import autocorrelation, correlation_time_s
from fluxtwin.calib.common.noise import lsb_from_spacing_nT
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.residuals import predict, residual_statistics
from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

S = np.array([[0.021, -0.016, 0.004], [0.013, -0.022, -0.004], [0.007, -0.003, 0.002]])
B_NT = np.array([7150.0, -2810.0, -6120.0])


@pytest.fixture(scope="module")
def days() -> tuple[list[Telemetry], Any]:
    """Four records of 200 samples on four days, 100 nT noise."""
    orbit = Orbit(
        epoch_utc=np.datetime64("1978-07-24", "ns"), altitude_km=789.9, inclination_rad=np.radians(108), raan_rad=1.0
    )
    model = load_field("igrf14")
    out = []
    for day in range(4):
        start = np.datetime64("1978-07-24T03:00:00", "ns") + np.timedelta64(29 * day, "h")
        time = start + np.arange(200) * np.timedelta64(30, "s")
        r, v = orbit.propagate(time)
        R = frames.rotation_ON(r, v)
        rng = np.random.default_rng([3, day])
        reading = Magnetometer(S, B_NT, noise_nT=100.0).reading(R.apply(field_N_nT(model, time, r)), None, rng)
        out.append(Telemetry(time=time, mag_B_nT=reading, r_N_km=r, v_N_km_s=v, q_NB=frames.q_from_rotation(R)))
    return out, model


def test_several_records_are_one(days: Any) -> None:
    records, model = days
    fit = calibrate_linear(records, model)
    backwards = calibrate_linear(records[::-1], model)
    assert np.array_equal(fit.calibration.S, backwards.calibration.S)
    assert fit.calibration.samples == 800
    assert fit.calibration.span == (records[0].time[0], records[3].time[-1])
    with pytest.raises(BadInput):
        calibrate_linear([records[0], records[0]], model)


def test_apply_gives_the_field_of_the_model(days: Any) -> None:
    records, model = days
    calibration = calibrate_linear(records, model).calibration
    corrected = apply_calibration(records[0], calibration)
    identity = Calibration(np.zeros((3, 3)), np.zeros(3))
    assert predict(corrected, identity, model).component_rms_nT == pytest.approx(100.0, rel=0.1)
    assert corrected.corrected_by.startswith(f"calibration {calibration.digest[:12]} (residual ")
    assert "linear regression" in corrected.provenance["calibration_note"]
    assert np.array_equal(corrected.time, records[0].time)


def test_days_that_were_not_used_are_predicted(days: Any) -> None:
    """Hold-out rms is the noise (100 nT) and the little that the calibration lacks; S' predicts badly."""
    records, model = days
    for day, record in enumerate(records):
        known = calibrate_linear([*records[:day], *records[day + 1 :]], model).calibration
        statistics = predict(record, known, model)
        assert 90.0 < statistics.component_rms_nT < 115.0
        assert abs(statistics.lag_correlation[1]) < 0.2
    wrong = Calibration(S.T, B_NT)
    assert predict(records[0], wrong, model).component_rms_nT > 200.0


def test_bias_alone(days: Any) -> None:
    """b only: the mean of A B0 - B, the covariance only of b."""
    records, model = days
    fit = calibrate_linear(records, model, parameters="b", robust="none")
    assert [name for name, sigma in fit.sigma.items() if sigma is not None] == ["b1", "b2", "b3"]
    assert not fit.calibration.S.any()
    off = [
        frames.rotation_from_q(one.q_NB).apply(field_N_nT(model, one.time, one.r_N_km)) - one.mag_B_nT
        for one in records
    ]
    assert fit.calibration.b_nT == pytest.approx(np.concatenate(off).mean(axis=0), rel=1e-9)
    assert np.abs(fit.residuals_nT.mean(axis=0)).max() < 1e-8
    robust = calibrate_linear(records, model, parameters="b", robust="tukey", covariance="blocks")
    assert np.abs(robust.calibration.b_nT - fit.calibration.b_nT).max() < 100.0


def test_statistics_of_a_known_process() -> None:
    """AR(1) with rho = 0.9: lag correlation 0.9^k, 1/e at 9.49 samples (algebra). 200,000 samples: 0.01."""
    rng = np.random.default_rng(19)
    r = np.zeros((200_000, 3))
    for axis in range(3):
        from scipy.signal import lfilter

        r[:, axis] = lfilter([1.0], [1.0, -0.9], rng.normal(size=len(r)))
    time = np.datetime64("2020-01-01", "ns") + np.arange(len(r)) * np.timedelta64(10, "s")
    segment = np.zeros(len(r), dtype=int)
    assert np.abs(autocorrelation(r, segment, range(6)) - 0.9 ** np.arange(6)).max() < 0.01
    assert 90.0 <= correlation_time_s(time, r, segment) <= 120.0  # lags grow by a fifth
    statistics = residual_statistics(time, r)
    assert statistics.component_rms_nT == pytest.approx(1.0 / np.sqrt(1.0 - 0.81), rel=0.02)
    assert statistics.to_dict()["component_rms_mG"] == statistics.component_rms_nT / 100.0


@pytest.mark.parametrize("lsb", [440.0, 4.7, 0.1])
def test_the_lsb_is_found(lsb: float) -> None:
    rng = np.random.default_rng(21)
    smooth = 3e4 * np.sin(np.arange(500)[:, None] / (30.0 + np.arange(3)))
    values = lsb * np.rint((smooth + rng.normal(size=smooth.shape)) / lsb)
    assert np.allclose(lsb_from_spacing_nT(values), lsb, rtol=0.01, atol=0)
    assert np.allclose(lsb_from_spacing_nT(np.round(values, 2)), lsb, rtol=0.01, atol=0)  # as a file prints it


def test_no_lsb_is_found_where_there_is_none() -> None:
    values = np.random.default_rng(22).normal(size=(300, 3)) * 1e4
    assert lsb_from_spacing_nT(values).tolist() == [0.0, 0.0, 0.0]
    assert lsb_from_spacing_nT(np.zeros((10, 3))).tolist() == [0.0, 0.0, 0.0]
