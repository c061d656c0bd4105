"""CovarianceReport sigmas where errors are correlated in time, turn with the attitude or differ from axis to axis.

Monte Carlo with fixed seeds. The mean square of the pulls of 12 parameters over R runs scatters by at most
sqrt(2/R) (fully correlated parameters); bands are three of those about 1 unless said otherwise (false alarm under
0.3 % each), and what the plain formulas would give lies outside them.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fluxtwin.calib.common.covariance import PairedCells, kernel_moments
from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.noise import reading_noise
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.linear.calibrate import calibrate_linear, fit_design
from fluxtwin.calib.methods import ESTIMATORS, offered
from fluxtwin.sim.base.errors import NoAnswer

pytestmark = pytest.mark.closure


def rows_at(seconds: np.ndarray, reading: np.ndarray, field: np.ndarray) -> Design:
    """A design of given seconds."""
    time = np.datetime64("1978-07-24", "ns") + (seconds * 1e9).astype("int64").astype("timedelta64[ns]")
    return Design(time, reading, field, {}, np.arange(len(field)), {})


def markov(rows: int, memory: float, rng: np.random.Generator) -> np.ndarray:
    """(rows, 3) unit first-order Gauss-Markov, stationary; memory in rows."""
    rho = np.exp(-1.0 / memory)
    white = rng.normal(size=(rows, 3)) * np.sqrt(1.0 - rho**2)
    white[0] /= np.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0))


def pull(fit: Any, meter: Any) -> np.ndarray:
    """(12,)."""
    truth = np.concatenate([meter.S.ravel(), meter.b_nT])
    return np.asarray((fit.calibration.values - truth) / fit.calibration.sigmas)


def nees(fit: Any, meter: Any) -> float:
    """e' C^-1 e over its 12: where C is right the mean of R runs scatters by sqrt(2/12/R)."""
    e = fit.calibration.values - np.concatenate([meter.S.ravel(), meter.b_nT])
    return float(e @ np.linalg.solve(fit.calibration.covariance, e)) / 12.0


def mean_square(pulls: list[np.ndarray]) -> float:
    """Over runs and parameters."""
    return float((np.array(pulls) ** 2).mean())


def test_a_weak_slow_error_that_neighbours_hardly_show(seasat: Any) -> None:
    """50 nT white over 20 nT with a memory of 600 samples: neighbours correlate by 0.14 only, and white sigmas are too
    small by far, which is said; the default is right. A field that turns with the orbit (5677 s), 20,000 rows, 12 runs;
    the band for the default is that of a ratio with eight blocks (variance 7/5) and 12 runs: 0.3 to 2.5."""
    seconds = np.arange(20_000.0)
    u, v = 2.0 * np.pi * seconds / 5677.0, 2.0 * np.pi * seconds / 86164.0
    field = 3e4 * np.stack([np.cos(u), 0.6 * np.sin(2.0 * u + v), np.sin(u + v)], axis=1)
    meter = seasat.magnetometer(noise_nT=50.0)
    white, default = [], []
    for seed in range(12):
        rng = np.random.default_rng([51, seed])
        now = rows_at(seconds, meter.reading(field + 20.0 * markov(20_000, 600.0, rng), None, rng), field)
        plain = fit_design(now, LinearOptions(covariance="white", robust="none"))
        assert plain.statistics.lag_correlation[1] < 0.2
        assert "correlated in time" in plain.messages[-1]
        white.append(pull(plain, meter))
        default.append(pull(fit_design(now, LinearOptions(robust="none")), meter))
    assert mean_square(white) > 10.0
    assert 0.3 < mean_square(default) < 2.5


def test_white_errors_raise_no_warning(seasat: Any) -> None:
    """Three-sigma tests of up to four batch lengths: false alarms in under 2 % of runs; of 30, at most three."""
    meter = seasat.magnetometer(noise_nT=300.0)
    said = 0
    for seed in range(30):
        reading = meter.reading(seasat.field_B_nT, None, np.random.default_rng([52, seed]))
        fit = calibrate_linear(seasat.record(reading), seasat.model, covariance="white")
        said += any("correlated in time" in words for words in fit.messages)
    assert said <= 3


@pytest.mark.parametrize(("rows", "limit"), [(92, 2.6), (325, 1.95)])
def test_errors_that_last_ten_minutes(seasat: Any, rows: int, limit: float) -> None:
    """250 nT with a memory of 600 s in records of one orbit and of four. Four orbits: three sigma of 20 runs. One
    orbit has no blocks long enough and too few independent errors to tell their size: its pulls are Student's with
    about five degrees of freedom (variance 5/3), the limit three sigma of 20 runs above that. White is far out."""
    meter = seasat.magnetometer(noise_nT=50.0)
    found, white, said = [], [], 0
    for seed in range(20):
        rng = np.random.default_rng([53, seed])
        slow = np.concatenate([markov(n, 10.0, rng) for n in (92, 88, 101, 44)]) * 250.0
        reading = meter.reading(seasat.field_B_nT + slow, None, rng)[:rows]
        now = Design(seasat.time[:rows], reading, seasat.field_B_nT[:rows], {}, np.arange(rows), {})
        fit = fit_design(now, LinearOptions(noise_nT=50.0, lsb_nT=0.0, robust="none"))
        found.append(pull(fit, meter))
        white.append(
            pull(fit_design(now, LinearOptions(noise_nT=50.0, lsb_nT=0.0, covariance="white", robust="none")), meter)
        )
        said += fit.error_model is not None and fit.error_model.passes is not None
    assert said == 20 if rows == 92 else said >= 14  # under 5 % of several passes nothing is said
    assert mean_square(white) > 4.0
    assert 0.4 < mean_square(found) < limit


def test_a_declared_field_error(seasat: Any) -> None:
    """A field model wrong by 150 nT rms an axis, constant and once an orbit, over 30 nT of noise: nothing in four
    passes shows its size. Declared, the errors are bounded: 10 runs, three of the scatter above 1; undeclared white ones
    are not. The words go away."""
    meter = seasat.magnetometer(noise_nT=30.0)
    day = np.repeat(np.arange(4), (92, 88, 101, 44))
    u = 2.0 * np.pi * (seasat.time - seasat.time[0]).astype("int64") * 1e-9 / 6040.0
    shapes = np.stack([np.ones_like(u), np.sqrt(2.0) * np.cos(u), np.sqrt(2.0) * np.sin(u)], axis=1)
    declared, white = [], []
    for seed in range(10):
        rng = np.random.default_rng([54, seed])
        wrong = np.einsum("kf,kfi->ki", shapes, rng.normal(size=(4, 3, 3))[day]) * 150.0 / np.sqrt(5.0)
        reading = meter.reading(seasat.field_B_nT + wrong, None, rng)
        record = seasat.record(reading)
        known: dict[str, Any] = {"noise_nT": 30.0, "lsb_nT": 0.0}
        fit = calibrate_linear(record, seasat.model, field_error_nT=150.0, **known)
        declared.append(nees(fit, meter))
        white.append(pull(calibrate_linear(record, seasat.model, covariance="white", **known), meter))
        assert fit.error_model is not None and fit.error_model.passes is None
    assert any("field model taken as wrong by 150 nT" in words for words in fit.messages)
    assert mean_square(white) > 10.0
    assert np.mean(declared) < 1.0 + 3.0 * np.sqrt(2.0 / 120.0)


def test_the_kernel_sum_is_the_double_sum() -> None:
    """Against the sum over all pairs, uneven steps and weights; rounding."""
    rng = np.random.default_rng(55)
    seconds = np.cumsum(rng.uniform(1.0, 50.0, size=60))
    weights = rng.uniform(0.1, 1.0, size=60)
    z = rng.normal(size=(60, 3))
    found = kernel_moments(PairedCells(seconds, weights, z), np.array([5.0, 300.0]))
    for K, tau in zip(found, (5.0, 300.0), strict=True):
        decay = np.exp(-np.abs(seconds[:, None] - seconds) / tau)
        assert np.allclose(K, (z * weights[:, None]).T @ decay @ (z * weights[:, None]), rtol=1e-12)


@pytest.mark.parametrize("rows", [2_000, 20_000])
def test_forward_solves_what_varies_less_than_the_reading_is_noisy(seasat: Any, rows: int) -> None:
    """The reference varies by 60 nT along body Y under 100 nT of noise: in the forward direction the reference stands on
    the right, without noise, and least squares gives column 2 to 100/60/sqrt(N). All of it within 5 sigma (false
    alarm 1e-5). The linear direction refuses and points there."""
    rng = np.random.default_rng(56)
    field = rng.normal(size=(rows, 3)) * np.array([2e4, 60.0, 2e4]) + np.array([0.0, 12_000.0, 0.0])
    meter = seasat.magnetometer(noise_nT=100.0)
    now = rows_at(np.arange(float(rows)), meter.reading(field, None, rng), field)
    known: dict[str, Any] = {"noise_nT": 100.0, "lsb_nT": 0.0, "covariance": "white"}
    fit = fit_design(now, LinearOptions(method="forward", **known, robust="none"))
    assert np.abs(pull(fit, meter)).max() < 5.0
    assert np.allclose(fit.calibration.sigmas[[1, 4, 7]], 100.0 / 60.0 / np.sqrt(rows), rtol=0.15)
    with pytest.raises(NoAnswer, match="method forward"):
        fit_design(now, LinearOptions(**known, robust="none"))


def test_noise_that_differs_between_axes_is_found(seasat: Any) -> None:
    """50, 300 and 50 nT: taken for alike, S22 would be wrong by 1.2 of its sigma on average. 100 runs: its mean pull
    within 0.3 (three sigma), each noise within a tenth on average, the pulls right."""
    meter = seasat.magnetometer()
    noise = np.array([50.0, 300.0, 50.0])
    pulls, found = [], []
    for seed in range(100):
        rng = np.random.default_rng([57, seed])
        reading = meter.ideal_reading(seasat.field_B_nT) + rng.normal(size=(325, 3)) * noise
        now = Design(seasat.time, reading, seasat.field_B_nT, {}, np.arange(325), {})
        fit = fit_design(now, LinearOptions(covariance="white", robust="none"))
        pulls.append(pull(fit, meter))
        found.append(fit.noise.variance_nT2)
    assert np.abs(np.sqrt(np.mean(found, axis=0)) / noise - 1.0).max() < 0.1
    assert abs(np.mean(pulls, axis=0)[4]) < 0.3
    assert abs(mean_square(pulls) - 1.0) < 3.0 * np.sqrt(2.0 / 100.0)


@pytest.mark.parametrize("rows", [30, 31])
def test_thirty_differences_are_enough_to_find_the_noise(seasat: Any, rows: int) -> None:
    """Uniform, 50 nT rms, so that no difference stands out; of thirty, sigma scatters by 16 %: within three of those. Of
    fewer it is taken from the residual along the field, and is as good as unknown, not nothing."""
    field = seasat.field_B_nT[:: 325 // rows][:rows]
    residual = 50.0 * np.sqrt(3.0) * np.random.default_rng(61).uniform(-1.0, 1.0, (rows, 3))
    noise = reading_noise(rows_at(np.arange(float(rows)), field, field), residual, None, None)
    assert ("too few neighbouring samples" in noise.source) == (rows == 30)
    assert abs(np.sqrt(noise.variance_nT2.mean()) / 50.0 - 1.0) < 0.5
    assert rows == 31 or np.sqrt(noise.covariance[0, 0]) > 0.25 * noise.variance_nT2[0]


def test_a_noise_of_next_to_nothing_has_a_sigma_of_its_size(seasat: Any) -> None:
    """Of a residual without noise on one axis the least squares give zero, whose square root has no slope to speak of."""
    field, rng = seasat.field_B_nT, np.random.default_rng(62)
    residual = rng.standard_normal((len(field), 3)) * [30.0, 30.0, 0.0]
    noise = reading_noise(rows_at(np.arange(float(len(field))), field, field), residual, None, None)
    sigmas = [float(one) for one in re.findall(r"± ([\d.e+]+)", noise.source)]
    assert len(sigmas) == 3 and max(sigmas) < 60.0, noise.source


def test_noise_that_lasts_is_counted_as_unknown(seasat: Any) -> None:
    """300 nT that lasts three samples: differences show half of it. What they miss is in the covariance of the noise:
    300^2 lies within the width of its uniform law (sqrt(12) sigma), and three sigma of the variance of 325 samples of
    which every six tell as much as one (3 sqrt(2 6/325) 300^2); the words say that white noise was taken."""
    meter = seasat.magnetometer()
    for seed in range(10):
        rng = np.random.default_rng([58, seed])
        reading = meter.ideal_reading(seasat.field_B_nT) + 300.0 * markov(325, 3.0, rng)
        now = Design(seasat.time, reading, seasat.field_B_nT, {}, np.arange(325), {})
        fit = fit_design(now, LinearOptions(covariance="white", robust="none"))
        assert (fit.noise.variance_nT2 < 250.0**2).all()
        sigma = np.sqrt(np.diag(fit.noise.covariance))
        chance = 3.0 * np.sqrt(2.0 * 6.0 / 325.0) * 300.0**2
        assert (np.abs(300.0**2 - fit.noise.variance_nT2) < np.sqrt(12.0) * sigma + chance).all()
        assert (sigma > 0.1 * 300.0**2).all()
        assert "taken as white" in fit.noise.source


def test_errors_of_the_attitude_have_a_direction(seasat: Any) -> None:
    """Half a degree of white attitude error in a field from everywhere leaves no error along the field: the trace of S
    is known far better than its off-diagonal differences. 150 runs, each variance of pulls within 0.6 to 1.5 (three
    sigma of 0.115 and the sandwich's own scatter); the plain formula gives 1.6 and 0.02."""
    meter = seasat.magnetometer(noise_nT=20.0)
    ways = np.zeros((5, 12))
    for way, (i, j, sign) in enumerate([(1, 3, -1.0), (2, 6, -1.0), (5, 7, -1.0), (1, 3, 1.0)]):
        ways[way, i], ways[way, j] = 1.0, sign
    ways[4, [0, 4, 8]] = 1.0
    found = []
    for seed in range(150):
        rng = np.random.default_rng([59, seed])
        field = rng.normal(size=(300, 3))
        field *= 35_000.0 / np.linalg.norm(field, axis=1)[:, None]
        tilt = rng.normal(size=(300, 3)) * np.radians(0.5)
        now = rows_at(60.0 * np.arange(300.0), meter.reading(field, None, rng), field + np.cross(tilt, field))
        fit = fit_design(now, LinearOptions(noise_nT=20.0, lsb_nT=0.0, covariance="white", robust="none"))
        error = fit.calibration.values - np.concatenate([meter.S.ravel(), meter.b_nT])
        sigma = np.sqrt(np.einsum("wi,ij,wj->w", ways, fit.calibration.covariance, ways))
        found.append(ways @ error / sigma)
    variance = np.var(found, axis=0)
    assert variance.min() > 0.6, variance
    assert variance.max() < 1.5, variance


def test_every_method_allows_for_correlation_by_default() -> None:
    """And the command line leaves it to them."""
    defaults = {name: one.takes["covariance"].default for name, one in ESTIMATORS.items() if "covariance" in one.takes}
    assert {"linear", "forward", "scalar", "twostep", "recursive", "batch"} <= set(defaults)
    assert set(defaults.values()) == {"blocks"}
    assert next(one for one in offered() if one.name == "covariance").default in ("blocks", None)
