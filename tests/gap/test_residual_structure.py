"""Laws of the searches in a residual: known answers, uniform p-values, invariances."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fluxtwin.gap.detectors.finding import fitted
from fluxtwin.gap.detectors.lines import line_columns, strongest_line
from fluxtwin.gap.detectors.residual_structure import drift, likeliest_step
from fluxtwin.gap.linear.projection import (
    ProjectedResidual,
    left_beside,
    log10_sf_f,
    orthonormal,
    projected_out,
    projected_white,
    span_of,
)
from fluxtwin.gap.selection.criterion import THRESHOLD

pytestmark = pytest.mark.property


class Identity:
    """Noise that is white already."""

    def apply(self, columns):
        return columns


def make_left(series: np.ndarray, columns: np.ndarray | None = None) -> ProjectedResidual:
    rows = series.shape[0]
    basis = orthonormal(np.zeros((3 * rows, 0)) if columns is None else columns.reshape(3 * rows, -1))
    flat = series.reshape(-1)
    return ProjectedResidual(Identity(), flat - basis @ (basis.T @ flat), basis, flat.size - basis.shape[1])


def test_f_tail_continues_where_doubles_end() -> None:
    for ratio, rank, spare in ((3.0, 5, 200), (40.0, 3, 500), (90.0, 9, 1000)):
        assert log10_sf_f(ratio, rank, spare) == pytest.approx(stats.f.logsf(ratio, rank, spare) / np.log(10), rel=1e-6)
    # Beyond the range of doubles: the exact tail of F with two degrees of freedom is (1 + 2 f / n)^(-n / 2).
    assert log10_sf_f(900.0, 2, 1000) == pytest.approx(-500 * np.log10(1 + 2 * 900 / 1000))
    assert log10_sf_f(90_000.0, 2, 1000) == pytest.approx(-500 * np.log10(1 + 180.0), rel=1e-9)


def test_a_basis_taken_out_leaves_what_least_squares_leaves() -> None:
    columns, rest = np.split(np.random.default_rng(2).standard_normal((50, 6)), [4], axis=1)
    left = rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0]
    assert np.allclose(projected_out(orthonormal(columns), rest), left, rtol=0.0, atol=1e-13)


def test_coefficients_make_what_has_those_coordinates_in_the_basis() -> None:
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((50, 3)) @ rng.standard_normal((3, 5)) * np.geomspace(1.0, 1e6, 5)
    span, along = span_of(columns), np.array([3.0, -1.0, 2.0])
    basis = span.basis(columns)
    assert basis.T @ basis == pytest.approx(np.eye(3), abs=1e-12)
    assert columns @ span.coefficients(along, 5) == pytest.approx(basis @ along, rel=1e-9)


def test_what_is_fitted_to_a_residual_has_the_covariance_of_least_squares() -> None:
    """s^2 (X' X)^-1 of all columns together, s^2 from 30 - 4 degrees of freedom; one less with a parameter searched for."""
    rng = np.random.default_rng(5)
    series, columns = rng.standard_normal((10, 3)), rng.standard_normal((10, 3, 4))
    X, y = columns.reshape(30, 4), series.reshape(30)
    size, rss, *_ = np.linalg.lstsq(X, y, rcond=None)
    left = make_left(series, columns[:, :, :2])
    for further in (0, 1):
        found = fitted(left, columns[:, :, 2:], further)
        wanted = rss[0] / (26 - further) * np.linalg.inv(X.T @ X)[2:, 2:]
        assert found.size == pytest.approx(size[2:]) and found.covariance == pytest.approx(wanted)


def test_columns_that_repeat_each_other_take_their_rank_of_the_degrees_of_freedom() -> None:
    """White residuals of 300 readings less two columns: the energy left is chi-square with 298, not 297."""
    whitener: Any = SimpleNamespace(measured=300)
    columns = np.random.default_rng(3).standard_normal((300, 2)) @ [[1.0, 0.0, 2.0], [0.0, 1.0, -1.0]]
    left = projected_white(whitener, np.ones((100, 3)), columns)
    assert left.degrees == 300 - np.linalg.matrix_rank(columns) == 298


@pytest.mark.parametrize("length", [1.0, 3.0, 10.0])
def test_what_is_known_to_be_of_order_one_is_taken_out_to_its_likeliest_size(length: float) -> None:
    """Of a direction known to 1 beside unit noise, l^2 / (1 + l^2) is taken for a column of length l: a Gaussian's mean."""
    rng = np.random.default_rng(5)
    columns, likely, series = (rng.standard_normal((100, 3, k)) for k in (2, 1, 1))
    whitener: Any = SimpleNamespace(measured=300)
    basis = orthonormal(columns)
    across = projected_out(basis, likely.reshape(300))
    likely *= length / np.linalg.norm(across)
    unit = across / np.linalg.norm(across)
    left = left_beside(whitener, series[:, :, 0], columns, likely)
    plain = projected_white(whitener, series[:, :, 0], columns)
    assert left.residual @ unit == pytest.approx(plain.residual @ unit / (1.0 + length**2), rel=1e-12)
    assert left.degrees == plain.degrees


def test_the_searches_keep_their_false_alarm_rates() -> None:
    """p below 5 % in at most 5 % of 300 runs each: more than 27 would come by chance in 0.1 % of seeds."""
    rng = np.random.default_rng(1)
    seconds = np.arange(500) * 10.0
    columns = np.einsum("ik,n->nik", np.eye(3), np.ones(500))
    runs, low = 300, {"line": 0, "drift": 0}
    for _ in range(runs):
        left = make_left(rng.standard_normal((500, 3)), columns)
        low["line"] += strongest_line(seconds, left).worth > THRESHOLD
        low["drift"] += drift(left)[0] < np.log10(0.05)
    assert max(low.values()) <= 27, low
    assert low["line"] <= 2


def test_the_excess_of_a_drift_is_its_energy() -> None:
    """Half a sigma up and half down, for 512 rows each, on one of three axes: 256. Means over 64 rows have 48 degrees of
    freedom, so their energy scatters by sqrt(2 x 48 + 4 x 256) = 33; here to four standard deviations."""
    series = np.random.default_rng(8).standard_normal((1024, 3))
    series[:, 1] += np.repeat([0.5, -0.5], 512)
    log10_p, excess = drift(make_left(series))
    assert log10_p < -3.0 and excess == pytest.approx(256.0, abs=4.0 * 33.0)


@pytest.mark.parametrize("even", [True, False])
def test_a_line_is_found_at_its_frequency(even: bool) -> None:
    rng = np.random.default_rng(2)
    seconds = np.arange(800) * 10.0 if even else np.sort(rng.uniform(0, 8000.0, 800))
    frequency = 0.01234
    series = rng.standard_normal((800, 3))
    series += line_columns(seconds, frequency) @ np.array([0.4, 0.0, 0.1, 0.0, 0.4, 0.2])
    line = strongest_line(seconds, make_left(series))
    assert line.worth > 30.0
    assert line.frequency_Hz == pytest.approx(frequency, abs=0.5 / 8000.0)
    first, quarter = line_columns(np.array([0.0, 0.25 / frequency]), frequency)
    assert np.allclose(first, np.eye(3, 6), atol=1e-12), "the cosine is one at the first row, by which phases are given"
    assert np.allclose(quarter, np.eye(3, 6, 3), atol=1e-12)


def test_a_step_and_a_drift_are_found() -> None:
    rng = np.random.default_rng(3)
    seconds = np.arange(900) * 5.0
    series = rng.standard_normal((900, 3))
    series[300:, 1] += 0.6
    assert likeliest_step(seconds, make_left(series)) == pytest.approx(1500.0, abs=100.0)
    slow = rng.standard_normal((900, 3)) + 0.1 * np.cumsum(rng.standard_normal((900, 3)), axis=0)
    assert drift(make_left(slow))[0] < -6
    # Louder white noise is no drift.
    assert drift(make_left(5.0 * rng.standard_normal((900, 3))))[0] > -3
