"""What two magnetometers share, and what is each one's own: drawn sizes are found again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fluxtwin.calib.common.pair import compare
from fluxtwin.sim.base.errors import NoAnswer

pytestmark = pytest.mark.closure

ROWS = 4000


def fits(shared_nT: float, own_nT: tuple[float, float]) -> list[Any]:
    """Residuals of two, at instants of which the last 100 of each are not the other's."""
    rng = np.random.default_rng(5)
    both = shared_nT * rng.standard_normal((ROWS, 3))
    stamps = np.datetime64("2026-03-01", "s") + np.arange(ROWS + 200)
    made = []
    for number, size in enumerate(own_nT):
        alone = size * rng.standard_normal((ROWS + 100, 3))
        alone[:ROWS] += both
        time = np.r_[stamps[:ROWS], stamps[ROWS + 100 * number : ROWS + 100 * (number + 1)]]
        made.append(SimpleNamespace(time=time, residuals_nT=alone))
    return made


def test_what_is_shared_and_what_is_not_are_told_apart(close: Any) -> None:
    """The covariance of two sums with one term in common is the variance of that term."""
    found = compare(*fits(30.0, (10.0, 40.0)))
    assert found.shared_nT is not None and None not in found.own_nT and found.samples <= ROWS
    because = "four sigma of the mean of 12,000 products x y, of variance <xx><yy> + <xy>^2, over twice the size"
    close([found.shared_nT, *found.own_nT], [30.0, 10.0, 40.0], atol=[1.1, 2.4, 1.2], unit="nT", because=because)
    assert (np.array(found.most_nT) > [found.shared_nT, *found.own_nT]).all()
    assert found.to_dict()["shared_nT"] == found.shared_nT


def test_nothing_shared_is_not_given_a_size() -> None:
    found = compare(*fits(0.0, (10.0, 40.0)))
    assert found.shared_nT is None or found.shared_nT < 3.0
    assert found.most_nT[0] < 5.0


def test_what_cannot_be_compared() -> None:
    one, two = fits(30.0, (10.0, 40.0))
    two.time = two.time + np.timedelta64(ROWS + 90, "s")
    with pytest.raises(NoAnswer, match="readings at the same instants; 20 are needed"):
        compare(one, two)
    one.residuals_nT = one.residuals_nT[:, :1]
    with pytest.raises(NoAnswer, match="a method with attitude is needed"):
        compare(one, two)
