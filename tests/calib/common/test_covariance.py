"""Are the stated sigmas right when the errors are not white, the rows not alike, or the bits wrong?

Monte Carlo with fixed seeds. A variance of pulls over R runs has relative sigma sqrt(2/R); bands are four of
those unless said otherwise (false alarm 6e-5 each).
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fluxtwin.calib.common.covariance import bread_of, cell_starts, groupings, make_blocks
from fluxtwin.calib.common.design import Design, assemble
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.linear.calibrate import calibrate_linear, fit_design

pytestmark = pytest.mark.closure


def design_of(geometry: Any) -> Design:
    """Rows whose reading is replaced run by run."""
    return assemble(geometry.record(geometry.field_B_nT), geometry.model, with_dipole=False)


def with_reading(design: Design, reading: np.ndarray, rows: slice = slice(None)) -> Design:
    """The same rows with another reading."""
    return dataclasses.replace(
        design, B_nT=reading[rows], H_nT=design.H_nT[rows], time=design.time[rows], rows=design.rows[rows]
    )


def pull(fit: Any, meter: Any) -> np.ndarray:
    """(12,)."""
    truth = np.concatenate([meter.S.ravel(), meter.b_nT])
    return (fit.calibration.values - truth) / fit.calibration.sigmas


def nees(fit: Any, meter: Any) -> float:
    """e' C^-1 e over its 12: by 0.46 from run to run, where the variance of pulls that go together scatters by 0.75."""
    e = fit.calibration.values - np.concatenate([meter.S.ravel(), meter.b_nT])
    return float(e @ np.linalg.solve(fit.calibration.covariance, e)) / 12.0


def test_errors_constant_within_a_pass_widen_the_covariance(passes: Any) -> None:
    """A field-model error that is constant in each of 40 passes: the white covariance is wrong by far, the
    blocks are right. Bands: three of the scatter of the mean of 15 runs, 0.12; four of that of a single variance."""
    meter = passes.magnetometer(noise_nT=50.0)
    design = design_of(passes)
    white, blocks, sizes = [], [], []
    for seed in range(15):
        rng = np.random.default_rng([40, seed])
        constant = np.repeat(rng.normal(size=(40, 3)) * 120.0, 12, axis=0)
        now = with_reading(design, meter.reading(passes.field_B_nT + constant, None, rng))
        known = LinearOptions(noise_nT=50.0, lsb_nT=0.0, covariance="white", robust="none")
        white.append(pull(fit_design(now, known), meter))
        fit = fit_design(now, dataclasses.replace(known, covariance="blocks"))
        blocks.append(pull(fit, meter))
        sizes.append(nees(fit, meter))
    assert np.var(white, axis=0).mean() > 4.0
    assert 0.65 < np.mean(sizes) < 1.35
    assert np.var(blocks, axis=0).max() < 1.0 + 4.0 * np.sqrt(2.0 / 15.0)
    words = fit_design(now, LinearOptions(covariance="blocks", robust="none")).messages[-1]
    assert "40 blocks" in words
    assert "passes separated by gaps" in words


def test_blocks_agree_with_white_when_errors_are_white(seasat: Any) -> None:
    """35 blocks: sigma to 1/sqrt(2*34) = 12 % each; the mean over 12 is asked to 15 %."""
    meter = seasat.magnetometer(noise_nT=300.0)
    design = design_of(seasat)
    ratio = []
    for seed in range(15):
        now = with_reading(design, meter.reading(seasat.field_B_nT, None, np.random.default_rng([8, seed])))
        white = fit_design(now, LinearOptions(noise_nT=300.0, lsb_nT=0.0, covariance="white", robust="none"))
        blocks = fit_design(
            now, LinearOptions(noise_nT=300.0, lsb_nT=0.0, covariance="blocks", block_s=600.0, robust="none")
        )
        ratio.append(blocks.calibration.sigmas / white.calibration.sigmas)
    assert abs(np.mean(ratio) - 1.0) < 0.15


def test_slow_errors_under_white_noise_are_seen(seasat: Any) -> None:
    """200 nT white noise over 150 nT that remembers six minutes: at the first lag the residual seems nearly white.
    White sigmas are too small by 1.9; those of the model are right. 13 runs; their mean scatters by 0.13: three of
    those."""
    meter = seasat.magnetometer(noise_nT=200.0)
    design = design_of(seasat)
    rho = np.exp(-1.0 / 6.0)
    white, blocks = [], []
    for seed in range(13):
        rng = np.random.default_rng([17, seed])
        slow = lfilter([150.0 * np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.normal(size=(400, 3)), axis=0)[75:]
        now = with_reading(design, meter.reading(seasat.field_B_nT + slow, None, rng))
        known = LinearOptions(noise_nT=200.0, lsb_nT=0.0, covariance="white", robust="none")
        white.append(pull(fit_design(now, known), meter))
        blocks.append(nees(fit_design(now, dataclasses.replace(known, covariance="blocks")), meter))
    assert np.var(white, axis=0).mean() > 2.5
    assert 0.6 < np.mean(blocks) < 1.4


def test_few_blocks_fall_back_on_the_memory_of_the_residual(seasat: Any) -> None:
    """One short stretch of slow errors: too short for blocks, said so, and the sigmas grow by half at least (the
    residual's rms is ten times the noise, and two or three periods make a fit eat most of it)."""
    meter = seasat.magnetometer(noise_nT=20.0)
    slow = 300.0 * np.sin(np.arange(92)[:, None] / 12.0 + np.arange(3))
    reading = meter.reading(seasat.field_B_nT[:92] + slow, None, np.random.default_rng(3))
    record = seasat.record(seasat.field_B_nT, rows=slice(0, 92)).replace(mag_B_nT=reading)
    white = calibrate_linear(record, seasat.model, noise_nT=20.0, lsb_nT=0.0, covariance="white")
    blocks = calibrate_linear(record, seasat.model, noise_nT=20.0, lsb_nT=0.0)
    assert "(fewer than 8)" in blocks.messages[-1]
    assert (blocks.calibration.sigmas / white.calibration.sigmas).min() > 1.5
    assert blocks.calibration.covariance_kind == "blocks"
    assert "correlated in time" in white.messages[-1]


def test_noise_found_in_the_data_serves_as_well_as_noise_declared(seasat: Any) -> None:
    """With attitude noise of 0.1 deg that must not be taken for noise of the reading. Quantised to 4.4 mG.
    200 runs; band for the mean variance of the pulls 0.8 to 1.25 (its scatter is under 0.05)."""
    meter = seasat.magnetometer(noise_nT=200.0, lsb_nT=440.0)
    design = design_of(seasat)
    found, sigma = [], []
    for seed in range(200):
        rng = np.random.default_rng([12, seed])
        now = with_reading(design, meter.reading(seasat.field_B_nT, None, rng))
        tilt = rng.normal(size=now.H_nT.shape) * np.radians(0.1)
        fit = fit_design(
            dataclasses.replace(now, H_nT=now.H_nT - np.cross(tilt, now.H_nT)),
            LinearOptions(covariance="white", robust="none"),
        )
        found.append(pull(fit, meter))
        sigma.append(np.sqrt(fit.noise.variance_nT2.mean()))
    assert "LSB 440 nT found" in fit.noise.source
    expected = np.sqrt(200.0**2 + 440.0**2 / 12.0)
    assert abs(np.mean(sigma) / expected - 1.0) < 0.05
    assert 0.8 < np.var(found, axis=0).mean() < 1.25
    assert np.abs(np.mean(found, axis=0)).max() < 0.3


def test_weights_follow_the_papers_equation_4(seasat: Any) -> None:
    """Half of the rows five times noisier, weights 1/sigma^2: pulls stay right, and sigma is smaller than
    with equal weights. 200 runs, band four sigma of the mean variance."""
    design = design_of(seasat)
    sigma = np.where(np.arange(len(design)) % 2, 500.0, 100.0)
    meter = seasat.magnetometer()
    weighted, smaller = [], []
    for seed in range(200):
        rng = np.random.default_rng([13, seed])
        noisy_reference = dataclasses.replace(
            with_reading(design, meter.ideal_reading(seasat.field_B_nT)),
            H_nT=design.H_nT + rng.normal(size=(len(design), 3)) * sigma[:, None],
        )
        options = LinearOptions(noise_nT=0.0, lsb_nT=0.0, covariance="white", robust="none")
        fit = fit_design(noisy_reference, options, weights=7.0 / sigma**2)
        plain = fit_design(noisy_reference, options)
        weighted.append(pull(fit, meter))
        smaller.append((fit.calibration.sigmas / plain.calibration.sigmas).max())
        assert abs(fit.weights.sum() - 1.0) < 1e-12
    assert 0.85 < np.var(weighted, axis=0).mean() < 1.2
    assert max(smaller) < 0.6


def flip_bits(reading: np.ndarray, lsb_nT: float, share: float, rng: np.random.Generator) -> np.ndarray:
    """Each reading of `share` of the samples has one random bit of one 8-bit word flipped."""
    counts = np.rint(reading / lsb_nT).astype(int) + 128
    for row in np.flatnonzero(rng.uniform(size=len(reading)) < share):
        counts[row, rng.integers(3)] ^= 1 << int(rng.integers(8))
    return (counts - 128) * lsb_nT


@pytest.mark.parametrize("direction", ["linear", "forward"])
def test_five_per_cent_bit_errors_are_left_out(seasat: Any, direction: str) -> None:
    """Every parameter within 4 sigma of the truth where plain least squares is lost. 40 runs of 12.

    Of 480 pulls one beyond 4 sigma has a probability of 3 %, two 5e-4.
    """
    meter = seasat.magnetometer(noise_nT=150.0, lsb_nT=440.0)
    design = design_of(seasat)
    robust, plain_b = [], []
    for seed in range(40):
        rng = np.random.default_rng([14, seed])
        now = with_reading(design, flip_bits(meter.reading(seasat.field_B_nT, None, rng), 440.0, 0.05, rng))
        known = LinearOptions(method=direction, noise_nT=150.0, lsb_nT=440.0, covariance="white", robust="none")
        fit = fit_design(now, dataclasses.replace(known, robust="tukey"))
        robust.append(pull(fit, meter))
        plain_b.append(np.abs(fit_design(now, known).calibration.b_nT - meter.b_nT).max())
    assert np.median(plain_b) > 150.0
    assert (np.abs(robust) > 4.0).sum() <= 1
    assert 0.7 < np.var(robust, axis=0).mean() < 1.4


def test_clean_data_lose_no_row(seasat: Any) -> None:
    """8e-8 of Gaussian rows lie beyond six sigma: least squares, and its pulls (50 runs, mean variance)."""
    meter = seasat.magnetometer(noise_nT=300.0)
    design = design_of(seasat)
    found = []
    for seed in range(50):
        now = with_reading(design, meter.reading(seasat.field_B_nT, None, np.random.default_rng([15, seed])))
        plain = fit_design(now, LinearOptions(noise_nT=300.0, lsb_nT=0.0, covariance="white", robust="none"))
        robust = fit_design(now, LinearOptions(noise_nT=300.0, lsb_nT=0.0, robust="tukey", covariance="white"))
        found.append(pull(robust, meter))
        assert np.array_equal(robust.calibration.sigmas, plain.calibration.sigmas)
    assert 0.8 < np.var(found, axis=0).mean() < 1.25


def test_block_rules() -> None:
    """Passes as given; gaps; stretches of a stated length."""
    minute = np.timedelta64(60, "s")
    one = np.datetime64("2020-01-01T00:00:00", "ns") + np.arange(100) * minute
    whole = np.zeros(100, dtype=int)
    ((given, _),) = groupings(one, whole, passes=np.repeat(["a", "b", "c", "d"], 25))
    assert np.bincount(given).tolist() == [25] * 4
    ((asked, words),) = groupings(one, whole, block_s=600.0)
    assert np.bincount(asked).tolist() == [10] * 10
    assert words == "stretches of 600 s, as asked"
    assert make_blocks(one, 150.0).max() + 1 == 10  # four memories
    gaps = np.concatenate([one + k * np.timedelta64(1, "D") for k in range(20)])
    assert np.bincount(make_blocks(gaps, 600.0)).tolist() == [100] * 20
    assert set(np.bincount(make_blocks(gaps[:700], 600.0))) == {20, 40}  # seven passes are too few: 2400 s


def test_one_block_that_alone_determines_a_column(seasat: Any) -> None:
    """All the variation along body Y in one of the blocks: the covariance is regular all the same."""
    rng = np.random.default_rng(31)
    field = rng.normal(size=(300, 3)) * 2e4
    field[30:, 1] = 500.0
    reading = seasat.magnetometer().ideal_reading(field) + rng.normal(size=field.shape) * 10.0
    time = np.datetime64("1978-07-24", "ns") + np.arange(300) * np.timedelta64(60, "s")
    design = Design(time, reading, field, {}, np.arange(300), {})
    fit = fit_design(
        design,
        LinearOptions(noise_nT=10.0, lsb_nT=0.0, covariance="blocks", robust="none"),
        passes=np.repeat(np.arange(10), 30),
    )
    assert np.isfinite(fit.calibration.sigmas).all()
    reading[:, 1] = np.where(np.arange(300) < 30, reading[:, 1], 500.0)  # no noise left there either
    exact = Design(time, reading, field, {}, np.arange(300), {})
    fit = fit_design(
        exact,
        LinearOptions(noise_nT=10.0, lsb_nT=0.0, covariance="blocks", robust="none"),
        passes=np.repeat(np.arange(10), 30),
    )
    scale = np.outer(fit.calibration.sigmas, fit.calibration.sigmas)
    assert np.linalg.eigvalsh(fit.calibration.covariance / scale)[0] > 0.0


def test_the_names_of_passes_do_not_matter(seasat: Any) -> None:
    """Labels that fall and return along the record are blocks like any others."""
    rng = np.random.default_rng(32)
    field = rng.normal(size=(300, 3)) * 2e4
    reading = seasat.magnetometer().ideal_reading(field) + np.repeat(rng.normal(size=(10, 3)), 30, axis=0) * 30.0
    reading += rng.normal(size=field.shape) * 10.0
    time = np.datetime64("1978-07-24", "ns") + np.arange(300) * np.timedelta64(60, "s")
    design, options = (
        Design(time, reading, field, {}, np.arange(300), {}),
        LinearOptions(noise_nT=10.0, lsb_nT=0.0, robust="none"),
    )
    rising = np.repeat(np.arange(10), 30)
    sigmas = [fit_design(design, options, passes=passes).calibration.sigmas for passes in (rising, -rising)]
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=1e-9)
    alternating = fit_design(design, options, passes=rising % 9).calibration.sigmas
    assert np.isfinite(alternating).all()


def test_blocks_in_the_forward_direction(passes: Any) -> None:
    """The covariance of G and o, carried to S and b: right for errors constant within a pass. 12 runs; their mean
    scatters by 0.13: three of those."""
    meter = passes.magnetometer(noise_nT=50.0)
    design = design_of(passes)
    found = []
    for seed in range(12):
        rng = np.random.default_rng([41, seed])
        constant = np.repeat(rng.normal(size=(40, 3)) * 120.0, 12, axis=0)
        now = with_reading(design, meter.reading(passes.field_B_nT + constant, None, rng))
        options = LinearOptions(method="forward", noise_nT=50.0, lsb_nT=0.0, covariance="blocks", robust="none")
        found.append(nees(fit_design(now, options), meter))
    assert 0.6 < np.mean(found) < 1.4


def test_one_orbit_with_the_correction_for_noise(seasat: Any) -> None:
    """Day 205 alone, where the correction moves S22 by 0.02, about one sigma. 400 runs: the variance of each pull
    within 0.75 to 1.35 and its mean within 0.25 (3.5 and 5 sigma of a right estimator: false alarm under 0.3 %)."""
    meter = seasat.magnetometer(noise_nT=250.0)
    rows = slice(0, 92)
    design = design_of(seasat)
    found = []
    for seed in range(400):
        reading = meter.reading(seasat.field_B_nT, None, np.random.default_rng([16, seed]))
        fit = fit_design(
            with_reading(design, reading, rows),
            LinearOptions(noise_nT=250.0, lsb_nT=0.0, covariance="white", robust="none"),
        )
        found.append(pull(fit, meter))
    variance = np.var(found, axis=0)
    assert variance.min() > 0.75
    assert variance.max() < 1.35
    assert np.abs(np.mean(found, axis=0)).max() < 0.25


def test_the_mean_product_of_the_readings_is_taken_without_its_noise() -> None:
    xx, noise = np.diag([4.0, 9.0]), np.diag([1.0, 1.0])
    fit: Any = SimpleNamespace(xx=xx)
    assert np.allclose(bread_of(fit, noise), np.diag([1.0 / 3.0, 1.0 / 8.0, 1.0]))


def test_cells_are_no_longer_than_asked() -> None:
    label = np.array([0] * 7 + [1] * 3)
    assert cell_starts(np.arange(10.0), label, 3.0).tolist() == [0, 3, 6, 7]
