"""Whether named effects keep their parameters over the record: the law under noise alone, and what is found."""

import numpy as np
import pytest
from scipy import stats

from fluxtwin.gap.constancy import p_values

pytestmark = pytest.mark.property

ROWS = 400


def _columns(rng: np.random.Generator, count: int) -> np.ndarray:
    smooth = np.cumsum(rng.standard_normal((ROWS, 3, count)), axis=0)
    return smooth / np.sqrt(np.mean(smooth**2, axis=(0, 1)))


def _residual(columns: np.ndarray, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    flat = columns.reshape(3 * ROWS, -1)
    y = (signal + rng.standard_normal((ROWS, 3))).reshape(-1)
    return (y - flat @ np.linalg.lstsq(flat, y, rcond=None)[0]).reshape(ROWS, 3)


def test_constant_parameters_give_the_law_of_f() -> None:
    """Chow's statistic follows F exactly where parameters are constant and noise is normal (Chow 1960): its p-values are
    even. Kolmogorov-Smirnov on 200 draws for each of the six tests; each fails by chance once in a thousand."""
    rng = np.random.default_rng(71)
    columns = _columns(rng, 4 + 5 + 2)
    found = []
    for _ in range(200):
        signal = columns[:, :, 4:] @ rng.standard_normal(7)
        found.append(list(p_values(_residual(columns, signal, rng), columns, [5, 2])))
    for values in np.transpose(found):
        assert stats.kstest(values, "uniform").pvalue > 1e-3


@pytest.mark.parametrize(("number", "start"), [(0, 4), (1, 9)])
def test_parameters_that_change_on_the_way_are_found(number: int, start: int) -> None:
    rng = np.random.default_rng(72)
    columns = _columns(rng, 4 + 5 + 2)
    width = [5, 2][number]
    changed = np.zeros((ROWS, 3))
    changed[ROWS // 2 :] = columns[ROWS // 2 :, :, start : start + width] @ np.full(width, 0.5)
    values = list(p_values(_residual(columns, changed, rng), columns, [5, 2]))
    assert values[2 * number] < 1e-6
    assert values[4] < 1e-6  # all together


def test_rows_that_are_cut_do_not_count() -> None:
    """Zero rows, as whitening leaves them, change nothing but where the parts meet."""
    rng = np.random.default_rng(73)
    columns = _columns(rng, 6)
    columns[::4] = 0.0
    residual = _residual(columns, np.zeros((ROWS, 3)), rng)
    residual[::4] = 0.0
    kept = np.arange(ROWS) % 4 != 0
    there = list(p_values(residual[kept], columns[kept], [3]))
    assert list(p_values(residual, columns, [3])) == pytest.approx(there, rel=1e-6)
