"""Inject, recover: S, b and T of Seasat's geometry, through telemetry only.

The pulls (estimate - truth)/sigma must have mean 0 and variance 1. Over 100 runs the bands "mean within 0.3,
variance 0.7 to 1.4" leave a right estimator outside with probability 0.27 % + 1.4 % a parameter, too much for
33 parameters; so the bands are asked of 400 runs, where that probability is below 2e-5 a parameter, 6e-4 for
the whole test, and the first hundred are tested together: over 12 (21) parameters of 100 runs the number
outside has 99.9 % bounds from the binomial law.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from fluxtwin.calib.common.design import assemble
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.linear.calibrate import _shortening, calibrate_linear, fit_design
from fluxtwin.calib.linear.estimating_equations import LinearProblem

pytestmark = pytest.mark.closure

RUNS = 400
NOISE_NT = 370.0  # the papers' residual of 3.7 mG, white, so that the white covariance must be right
T_NT_PER_AM2 = np.array([[1.2, -0.4, 0.3], [0.2, -0.9, 0.5], [-0.6, 0.1, 1.5]])


def pulls(seasat: Any, parameters: str, direction: str, runs: int = RUNS) -> tuple[np.ndarray, np.ndarray, float]:
    """Pulls (runs, P), e' C^-1 e (runs,) of the whole error e under the whole covariance C, and the share by which the
    mean of the latter exceeds P because a sandwich of N rows is itself random: to second order
    (E|s|^4 - P)/(N P), where |s|^2 = |r|^2 N h with E|r|^4 = 15 for three Gaussian components and h the leverage."""
    with_T = "T" in parameters
    meter = seasat.magnetometer(T_NT_PER_AM2 if with_T else None, noise_nT=NOISE_NT)
    truth = np.concatenate([meter.S.ravel(), meter.b_nT, T_NT_PER_AM2.ravel() if with_T else []])
    out, distance = [], []
    for seed in range(runs):
        rng = np.random.default_rng([1978, seed])
        dipole = rng.choice([-100.0, 0.0, 100.0], size=(len(seasat.time), 3)) if with_T else None
        record = seasat.record(meter.reading(seasat.field_B_nT, dipole, rng), dipole)
        if seed < 100:
            design = assemble(record, seasat.model, with_dipole=with_T)
        else:  # the reference field is that of the first run
            design = dataclasses.replace(design, B_nT=record.mag_B_nT, D_Am2=record.dipole_B_Am2)
        fit = fit_design(
            design,
            LinearOptions(
                parameters=parameters,
                method=direction,
                noise_nT=NOISE_NT,
                lsb_nT=0.0,
                covariance="white",
                robust="none",
            ),
        )
        error, sigma = fit.calibration.values - truth, fit.calibration.sigmas
        out.append(error / sigma)
        distance.append(error / sigma @ np.linalg.solve(fit.correlation, error / sigma))
    z = np.hstack([design.H_nT, np.ones((len(design), 1)), *([] if design.D_Am2 is None else [design.D_Am2])])
    h = (np.linalg.qr(z)[0] ** 2).sum(axis=1)
    size = out[0].size
    excess = (15.0 * ((len(z) * h) ** 2).mean() - size) / len(z) / size
    return np.array(out), np.array(distance), float(excess)


@pytest.mark.parametrize(("parameters", "direction"), [("b,S", "linear"), ("b,S,T", "linear"), ("b,S,T", "forward")])
def test_every_parameter_comes_back_within_its_stated_sigma(seasat: Any, parameters: str, direction: str) -> None:
    found, distance, excess = pulls(seasat, parameters, direction)
    mean, variance = found.mean(axis=0), found.var(axis=0, ddof=1)
    assert np.abs(mean).max() < 0.3, mean
    assert variance.min() > 0.7, variance
    assert variance.max() < 1.4, variance
    hundred = found[:100]
    outside = (
        (np.abs(hundred.mean(axis=0)) > 0.3) | (hundred.var(axis=0, ddof=1) < 0.7) | (hundred.var(axis=0, ddof=1) > 1.4)
    )
    assert outside.sum() <= binom.ppf(0.999, found.shape[1], 0.017)
    # the correlations too: chi-square of P degrees, more by what the scatter of the sandwich adds (third order: 0.02)
    assert abs(distance.mean() / found.shape[1] - 1.0 - excess) < 4.0 * np.sqrt(2.0 / found.shape[1] / RUNS) + 0.02


def test_the_correction_for_noise_in_the_reading_is_needed(seasat: Any) -> None:
    """Mutant: with the correction off, S22 is pulled towards -1 by (1.11), far outside the bands."""
    meter = seasat.magnetometer(noise_nT=NOISE_NT)
    truth = meter.S[1, 1]
    off, on, predicted = [], [], []
    design = assemble(seasat.record(seasat.field_B_nT), seasat.model, with_dipole=False)
    known = LinearOptions(noise_nT=NOISE_NT, lsb_nT=0.0, covariance="white", robust="none")
    for seed in range(100):
        reading = meter.reading(seasat.field_B_nT, None, np.random.default_rng([11, seed]))
        now = dataclasses.replace(design, B_nT=reading)
        without = fit_design(now, dataclasses.replace(known, errors_in_variables=False))
        with_it = fit_design(now, dataclasses.replace(known, errors_in_variables=True))
        off.append(without.calibration.S[1, 1] - truth)
        on.append(with_it.calibration.S[1, 1] - truth)
        predicted.append(-with_it.eiv_shift[1, 1])
    error = np.std(off) / 10.0
    assert np.mean(off) < -8.0 * error  # the attenuation is seen
    assert abs(np.mean(off) - np.mean(predicted)) < 4.0 * error  # and is what (1.11) says; false alarm 6e-5
    assert abs(np.mean(on)) < 4.0 * error


def test_a_doubtful_noise_adds_to_the_covariance_what_it_moves(
    seasat: Any, monkeypatch: pytest.MonkeyPatch, close: Any
) -> None:
    """To first order, by calibrations with a little more and less noise on each axis."""
    record = seasat.record(
        seasat.magnetometer(noise_nT=NOISE_NT).reading(seasat.field_B_nT, None, np.random.default_rng(8))
    )
    variance = NOISE_NT**2 * np.array([1.0, 0.8, 1.3])

    def fit(variance_nT2: np.ndarray, doubt: np.ndarray) -> Any:
        noise = ReadingNoise(variance_nT2, "", doubt)
        monkeypatch.setattr("fluxtwin.calib.linear.calibrate.reading_noise", lambda *_: noise)
        return calibrate_linear(record, seasat.model, parameters="b,S", covariance="white", robust="none").calibration

    sure, steps = np.zeros((3, 3)), 1e-3 * np.diag(variance)
    moved = [(fit(variance + h, sure).values - fit(variance - h, sure).values) / (2.0 * h.sum()) for h in steps]
    doubt = np.diag((0.3 * variance) ** 2)
    added = fit(variance, doubt).covariance - fit(variance, sure).covariance
    expected = np.array(moved).T @ doubt @ np.array(moved)
    sigma = np.sqrt(np.diag(expected))
    unit = np.outer(sigma, sigma)
    close(added / unit, expected / unit, atol=1e-4, unit="1", because="a central difference over a thousandth")


MUTANTS = {
    "sign of b": lambda S, b, T: (S, -b, T),
    "S transposed": lambda S, b, T: (S.T, b, T),
    "T transposed": lambda S, b, T: (S, b, T.T),
    "sign of T": lambda S, b, T: (S, b, -T),
}


@pytest.mark.parametrize("name", list(MUTANTS))
def test_a_wrong_convention_would_be_seen(seasat: Any, name: str) -> None:
    """A truth that differs by a sign or a transpose lies many sigma away (0.5 mG noise: T to 0.04 nT/(A m2))."""
    meter = seasat.magnetometer(T_NT_PER_AM2, noise_nT=50.0)
    rng = np.random.default_rng(5)
    dipole = rng.choice([-100.0, 0.0, 100.0], size=(len(seasat.time), 3))
    fit = calibrate_linear(
        seasat.record(meter.reading(seasat.field_B_nT, dipole, rng), dipole), seasat.model, parameters="b,S,T"
    )
    S, b, T = MUTANTS[name](meter.S, meter.b_nT, T_NT_PER_AM2)
    wrong = np.concatenate([S.ravel(), b, T.ravel()])
    pull = (fit.calibration.values - wrong) / fit.calibration.sigmas
    assert np.abs(pull).max() > 8.0


def test_a_time_shifted_dipole_is_seen_in_the_residual(seasat: Any) -> None:
    """Torquers logged a sample late: T vanishes and the residual shows it."""
    meter = seasat.magnetometer(T_NT_PER_AM2 * 5.0, noise_nT=50.0)
    rng = np.random.default_rng(6)
    dipole = rng.choice([-100.0, 0.0, 100.0], size=(len(seasat.time), 3))
    reading = meter.reading(seasat.field_B_nT, dipole, rng)
    right = calibrate_linear(seasat.record(reading, dipole), seasat.model, parameters="b,S,T")
    late = calibrate_linear(seasat.record(reading, np.roll(dipole, 1, axis=0)), seasat.model, parameters="b,S,T")
    assert right.calibration.sigma_nT < 60.0
    assert late.calibration.sigma_nT > 5.0 * right.calibration.sigma_nT


def test_column_two_of_S_is_what_one_orbit_cannot_tell(seasat: Any) -> None:
    """Claim 17: S is not observable with one orbit, and four orbits on different days cure it."""
    meter = seasat.magnetometer(noise_nT=NOISE_NT)
    reading = meter.reading(seasat.field_B_nT, None, np.random.default_rng(7))
    one = calibrate_linear(seasat.record(reading, rows=slice(0, 92)), seasat.model, noise_nT=NOISE_NT, lsb_nT=0)
    four = calibrate_linear(seasat.record(reading), seasat.model, noise_nT=NOISE_NT, lsb_nT=0)
    for fit in (one, four):
        sigma = {name: value for name, value in fit.sigma.items() if value is not None}
        others = max(sigma[f"S{i}{j}"] for i in (1, 2, 3) for j in (1, 3))
        assert min(sigma["S12"], sigma["S22"], sigma["S32"]) > 3.0 * others
    assert any("body Y" in words and "S12, S22, S32" in words for words in one.observability)
    assert one.condition_number > four.condition_number
    s12 = (one.sigma["S12"] or 0.0), (four.sigma["S12"] or 0.0)
    assert 0.02 < s12[0] < 0.06  # an independent prototype: 0.03 for white 3.7 mG
    assert 0.004 < s12[1] < 0.012  # the same: 0.006 to 0.009


def test_a_turn_shortens_by_half_its_square_without_the_noise() -> None:
    """500 nT across 40,000 nT, of which white noise of 10 and 20 nT makes 100 + 400 nT^2."""
    H, rows = np.tile([0.0, 0.0, 4e4], (9, 1)), np.tile([300.0, 400.0, 50.0], (9, 1))
    noise = SimpleNamespace(variance_nT2=np.array([100.0, 400.0, 900.0]))
    problem: Any = SimpleNamespace(
        design=SimpleNamespace(H_nT=H), noise=noise, weights=np.full(9, 1 / 9), effective=9.0
    )
    found = _shortening(problem, rows)
    assert found is not None and found[:, 2] == pytest.approx(np.full(9, 249_500.0 / (2.0 * 4e4)))


def test_the_rms_of_a_column_is_that_of_its_values() -> None:
    columns = {"a": np.array([3.0, 4.0]), "b": np.array([1.0, -1.0])}
    problem: Any = SimpleNamespace(design=SimpleNamespace(columns=columns))
    found = LinearProblem.driver_rms.func(problem)
    assert found.tolist() == [np.sqrt(12.5), 1.0]
