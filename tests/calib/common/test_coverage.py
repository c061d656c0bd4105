"""Directions of the field in the body, and what more data would do to the worst sigma: predicted, then flown."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import scenario_text

import fluxtwin
from fluxtwin.calib.common.coverage import BINS, coverage
from fluxtwin.calib.common.direction import even_directions
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

WORLD = """
[attitude]
{attitude}
[magnetometer]
S = [[0.01, 0.0, 0.0], [0.0, -0.01, 0.0], [0.0, 0.0, 0.02]]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 20.0
"""
POINTING = 'mode = "earth_pointing"\nyaw_rms_deg = {yaw}'
TUMBLING = 'mode = "tumble"\nrate_deg_s = [0.31, 0.22, -0.27]'
INERTIA = [[0.02, 0.0, 0.0], [0.0, 0.025, 0.0], [0.0, 0.0, 0.03]]


def flown(attitude: str, rows: int, start_utc: str, seed: int) -> Telemetry:
    segment = f"samples = {rows}, step_s = 20.0"
    text = scenario_text(
        WORLD.format(attitude=attitude), segment=segment, start_utc=start_utc, seed=seed, inertia_kg_m2=INERTIA
    )
    return fluxtwin.simulate(parse_scenario(text, where="test"))[0]


def test_even_directions_fill_the_bins_and_one_direction_one() -> None:
    known = Calibration(np.zeros((3, 3)), np.zeros(3), covariance=np.eye(12) * 1e-6)
    everywhere = 30e3 * even_directions(4000)
    seen = coverage(known, everywhere, everywhere, size_only=False)
    assert seen.share == 1.0 and seen.counts.sum() == 4000
    assert seen.counts.max() < 1.2 * 4000 / BINS and seen.counts.min() > 0.8 * 4000 / BINS  # equal areas
    once = np.tile([0.0, 0.0, 30e3], (10, 1)) + np.random.default_rng(1).normal(size=(10, 3))
    assert coverage(known, once, once, size_only=False).share == 1 / BINS
    none = Calibration(np.zeros((3, 3)), np.zeros(3))
    assert coverage(none, once, once, size_only=False).plans == ()


@pytest.mark.parametrize(("method", "yaw_deg"), [("linear", 20.0), ("scalar", 35.0)])
def test_what_is_predicted_comes_true(method: str, yaw_deg: float) -> None:
    """A pointing record, then the tumble that is said to halve its worst sigma; four times the record is known to."""
    record = flown(POINTING.format(yaw=yaw_deg), 900, "2020-03-01T00:00:00Z", 1)
    first = fluxtwin.calibrate(record, method=method, covariance="white", noise_nT=20.0)
    assert first.coverage is not None and 0.05 < first.coverage.share < 0.8
    plans = {plan.words.split(" ")[1]: plan for plan in first.coverage.plans}
    assert plans["same"].ratio == pytest.approx(3.0, rel=0.03)  # halved by four times the data
    tumble = plans["tumble"]
    assert tumble.rows is not None and 24 < tumble.rows < 700
    more = flown(TUMBLING, tumble.rows, "2020-03-01T06:00:00Z", 2)
    second = fluxtwin.calibrate([record, more], method=method, covariance="white", noise_nT=20.0)
    before, after = (fit.sigma[first.coverage.worst] for fit in (first, second))
    assert before is not None and after is not None
    assert after / before == pytest.approx(0.5, rel=0.25)  # each fit finds the size of its errors anew
    assert "To halve it" in first.coverage.lines[1] and first.coverage.worst in first.coverage.lines[1]
