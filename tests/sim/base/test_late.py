"""What acts late: delays."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.sim.base.late import late

pytestmark = pytest.mark.property


@pytest.mark.parametrize(
    ("column", "wanted"), [([0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]), ([0.0, 1.0, 2.0, 3.0], [0.0, 0.6, 1.6, 2.6])]
)
def test_a_switch_holds_between_its_samples_and_all_else_is_a_straight_line(
    column: list[float], wanted: list[float]
) -> None:
    """4 s late in rows of 10 s: a switch is seen in the row after; before the first row all was as it is there."""
    assert late(np.arange(0.0, 40.0, 10.0), np.array(column), 4.0, 0.0) == pytest.approx(wanted)
