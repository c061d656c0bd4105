"""What acts late: delays."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.sim.base.late import bridged, late

pytestmark = pytest.mark.property


@pytest.mark.parametrize(
    ("column", "wanted"), [([0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]), ([0.0, 1.0, 2.0, 3.0], [0.0, 0.6, 1.6, 2.6])]
)
def test_a_switch_holds_between_its_samples_and_all_else_is_a_straight_line(
    column: list[float], wanted: list[float]
) -> None:
    """4 s late in rows of 10 s: a switch is seen in the row after; before the first row all was as it is there."""
    assert late(np.arange(0.0, 40.0, 10.0), np.array(column), 4.0, 0.0) == pytest.approx(wanted)


def test_what_hangs_on_a_missing_value_is_told_from_what_does_not() -> None:
    """20 s late in rows of 10 s: the two rows after those without a value; a lag forgets 99 % in 4.6 of its lengths."""
    seconds, column = np.arange(0.0, 1000.0, 10.0), np.sin(np.arange(100.0))
    column[[0, 1, *range(40, 50), 98, 99]] = np.nan
    assert set(np.flatnonzero(bridged(seconds, column, 20.0, 0.0))) == {0, 1, 2, 3, *range(42, 52)}
    assert set(np.flatnonzero(bridged(seconds, column, 0.0, 0.0))) == {0, 1, *range(40, 50), 98, 99}
    lagging = np.flatnonzero(bridged(seconds, column, 0.0, 20.0))
    assert {*range(40, 50)} <= set(lagging) and {57, 58} <= set(lagging) and not {60, 61, 62} & set(lagging)
    assert bridged(seconds, np.full(100, np.nan), 20.0, 0.0).all()


def test_a_column_that_is_sampled_less_often_and_rows_that_are_not_there_lack_nothing() -> None:
    seconds = np.r_[np.arange(0.0, 300.0, 10.0), np.arange(900.0, 1200.0, 10.0)]
    assert not bridged(seconds, np.sin(seconds), 25.0, 40.0).any()
    seldom = np.where(np.arange(60) % 3 == 0, np.sin(seconds), np.nan)
    assert not bridged(seconds, seldom, 25.0, 40.0).any()
    seldom[12] = np.nan
    assert set(np.flatnonzero(bridged(seconds, seldom, 0.0, 0.0))) == {10, 11, 12, 13, 14}
