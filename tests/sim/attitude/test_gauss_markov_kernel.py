"""The compiled recursion of correlated noise is the sum written out, to the last bit, so seeds keep their noise."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.earth import epoch

pytestmark = pytest.mark.property


def test_the_recursion_is_the_one_written_out() -> None:
    seconds = np.cumsum(np.random.default_rng(1).uniform(0.1, 5.0, 200))
    time = epoch.add_seconds(np.datetime64("2022-01-01T00:00:00", "ns"), seconds)
    found = gauss_markov(time, [1.0, 3.0], 20.0, np.random.default_rng(2), columns=2)
    white = np.random.default_rng(2).standard_normal((200, 2))
    share = np.diff(epoch.seconds_since(time, time[0])) / 20.0
    driven = white[1:] * np.sqrt(-np.expm1(-2.0 * share))[:, None]
    factor = np.exp(-share)
    for column in range(2):
        x, scale = float(white[0, column]), (1.0, 3.0)[column]
        for row in range(200):
            assert found[row, column] == x * scale
            if row < 199:
                x = float(factor[row]) * x + float(driven[row, column])


def test_one_sample_is_white() -> None:
    time = np.array(["2022-01-01T00:00:00"], dtype="datetime64[ns]")
    assert (
        gauss_markov(time, 2.0, 20.0, np.random.default_rng(2))[0, 0]
        == 2.0 * np.random.default_rng(2).standard_normal()
    )
