"""The window of a pass from a printed range: exact where the angle runs one way, sensible where it turns."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.hcmm_orbit.geometry import fix_windows, turning_ends

pytestmark = pytest.mark.property

MINUTES = np.arange(-8.0, 22.1, 0.25)


def one_pass(angle):
    """A pass visible from 0 to 12 min with the given angle at every minute of the grid."""
    elevation = 40.0 - ((MINUTES - 6.0) / 6.0) ** 2 * 40.0
    grid = Numbers(minutes=MINUTES, passes=(None,))
    return grid, Numbers(sun_nadir_deg=angle(MINUTES)[None, :], elevation_deg=elevation[None, :])


@pytest.mark.parametrize("rate", [3.6, -3.6])
@pytest.mark.parametrize(("start", "end"), [(1.0, 9.0), (0.3, 11.6), (4.0, 6.5)])
def test_a_steady_angle_gives_the_window_back(rate, start, end):
    grid, sky = one_pass(lambda t: 100.0 + rate * t)
    low, high = sorted((100.0 + rate * start, 100.0 + rate * end))
    found = fix_windows(grid, sky, [(low, high)])
    assert found.start_min[0] == pytest.approx(start, abs=0.06)  # times are tried 0.1 min apart
    assert found.end_min[0] == pytest.approx(end, abs=0.06)


def test_rounding_to_degrees_moves_an_end_by_no_more_than_it_must():
    grid, sky = one_pass(lambda t: 100.0 + 3.6 * t)
    found = fix_windows(grid, sky, [(np.rint(103.6 + 0.4), np.rint(132.4 - 0.4))])
    assert abs(found.start_min[0] - 1.0) < 0.5 / 3.6 + 0.06
    assert abs(found.end_min[0] - 9.0) < 0.5 / 3.6 + 0.06


def test_a_turning_angle_keeps_the_least_one_inside():
    """Least 26.4 deg at 7 min, printed 27: the window runs through it to the other side."""
    grid, sky = one_pass(lambda t: np.hypot(26.4, 3.7 * (t - 7.0)))
    high = float(np.hypot(26.4, 3.7 * 6.0))
    found = fix_windows(grid, sky, [(27.0, high)])
    assert found.start_min[0] == pytest.approx(1.0, abs=0.06)
    assert found.end_min[0] > 12.0  # to the end of visibility, half a minute of grace
    assert turning_ends(grid, sky, [(27.0, high)]).tolist() == [[True, False]]
    assert turning_ends(grid, sky, [(29.0, high)]).tolist() == [[False, False]]


def test_the_window_never_leaves_the_visible_arc():
    grid, sky = one_pass(lambda t: 100.0 + 3.6 * t)
    found = fix_windows(grid, sky, [(60.0, 180.0)])
    assert found.start_min[0] >= -0.5 - 1e-9
    assert found.end_min[0] <= 12.5 + 1e-9
