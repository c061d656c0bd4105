"""The torquers' activity: duty, dwell, signs, independence, and the same answer whatever stamps are asked."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.spacecraft.torquers import draw_random_duty

pytestmark = pytest.mark.property

START = np.datetime64("1978-07-24T06:00:00", "ns")


def stamps(seconds: np.ndarray) -> np.ndarray:
    return START + np.rint(np.asarray(seconds) * 1e9).astype("int64").astype("timedelta64[ns]")


def test_the_same_activity_whatever_stamps_are_asked() -> None:
    schedule = draw_random_duty(100.0, 0.4, 120.0, stream(1, "torquers"))
    seconds = np.arange(0.0, 90_000.0, 7.0)
    whole = schedule.dipole_B_Am2(stamps(seconds))
    some = np.random.default_rng(0).permutation(seconds.size)[:500]
    np.testing.assert_array_equal(schedule.dipole_B_Am2(stamps(seconds[some])), whole[some])
    again = draw_random_duty(100.0, 0.4, 120.0, stream(1, "torquers")).dipole_B_Am2(stamps(seconds))
    np.testing.assert_array_equal(again, whole)
    other = draw_random_duty(100.0, 0.4, 120.0, stream(2, "torquers")).dipole_B_Am2(stamps(seconds))
    assert (other != whole).any()


def test_duty_signs_and_independence(close) -> None:
    """One stamp a slot, 40,000 slots: counts within 4.5 sigma of binomial; false alarm 1e-4 over all checks."""
    slots = 40_000
    duty = np.array([0.2, 0.5, 0.9])
    schedule = draw_random_duty(100.0, tuple(duty), 300.0, stream(5, "torquers"))
    dipole = schedule.dipole_B_Am2(stamps(300.0 * np.arange(slots) + 1.0))
    assert set(np.unique(dipole)) == {-100.0, 0.0, 100.0}
    on = dipole != 0.0
    wide = 4.5 * np.sqrt(duty * (1.0 - duty) / slots)
    assert (np.abs(on.mean(axis=0) - duty) < wide).all()
    for axis in range(3):
        count = on[:, axis].sum()
        assert abs((dipole[:, axis] > 0).sum() / count - 0.5) < 4.5 * 0.5 / np.sqrt(count)
        neighbours = np.corrcoef(dipole[:-1, axis], dipole[1:, axis])[0, 1]
        close(neighbours, 0.0, atol=4.5 / np.sqrt(slots), unit="1", because="slots are independent, 4.5 sigma")
    across = np.corrcoef(dipole.T) - np.eye(3)
    close(across, 0.0, atol=4.5 / np.sqrt(slots), unit="1", because="axes are independent, 4.5 sigma")


def test_states_last_whole_slots(close) -> None:
    schedule = draw_random_duty(100.0, 0.5, 60.0, stream(6, "torquers"), both_signs=False)
    dipole = schedule.dipole_B_Am2(stamps(np.arange(60_000.0)))
    assert dipole.min() == 0.0
    for axis in range(3):
        changes = np.flatnonzero(np.diff(dipole[:, axis])) + 1
        assert (np.diff(changes) % 60 == 0).all()
        assert np.diff(changes).min() == 60
        lasting = np.diff(changes).mean()
        # Runs are geometric: mean 60/(1 - 0.5) = 120 s, sd 85 s, some 500 of them; 4.5 sigma.
        close(lasting, 120.0, atol=4.5 * 85.0 / np.sqrt(changes.size), unit="s", because="dwell / (1 - duty)")


def test_always_on_and_never_on() -> None:
    time = stamps(np.arange(0.0, 10_000.0, 50.0))
    always = draw_random_duty((1.0, 2.0, 3.0), 1.0, 60.0, stream(1, "t"), both_signs=False).dipole_B_Am2(time)
    assert (always == [1.0, 2.0, 3.0]).all()
    assert (draw_random_duty(1.0, 0.0, 60.0, stream(1, "t")).dipole_B_Am2(time) == 0.0).all()
