"""Torquers a few centimetres away couple more than the field has: no trap of the record, and the next step says so."""

from __future__ import annotations

import numpy as np
import pytest

import fluxtwin
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure


@pytest.fixture(scope="module")
def cubesat() -> Telemetry:
    """The packaged one, whose torquers are on in nine rows of ten."""
    return fluxtwin.simulate("cubesat")[0]


def test_a_record_with_torquers_on_is_no_trap(cubesat: Telemetry) -> None:
    found = fluxtwin.check(cubesat)
    assert found.traps == ()
    assert "--parameters b,S,T" in next(note.text for note in found.notes if note.code == "torquers_on")
    assert cubesat.q_NB is not None
    for wrong, code in (
        (cubesat.replace(q_NB=cubesat.q_NB * [-1.0, -1.0, -1.0, 1.0]), "attitude_convention"),
        (cubesat.replace(time=cubesat.time + np.timedelta64(3600, "s")), "clock"),
        (cubesat.replace(mag_B_nT=cubesat.mag_B_nT[:, [1, 0, 2]]), "magnetometer_axes"),
    ):
        assert [trap.code for trap in fluxtwin.check(wrong).traps] == [code], "torquers neither excuse nor hide it"
    bare = cubesat.replace(dipole_B_Am2=None)
    assert fluxtwin.check(bare).traps, "nor what nobody recorded"


@pytest.mark.parametrize(("first", "last"), [(0, 80), (0, 600), (1200, 1500)])
def test_torquers_that_are_hardly_ever_off_are_no_trap(cubesat: Telemetry, first: int, last: int) -> None:
    """Of the last no row has them off."""
    part = cubesat[first:last]
    found = fluxtwin.check(part)
    assert found.traps == ()
    assert "only without the steps" in next(note.text for note in found.notes if note.code == "torquers_on")
    assert part.q_NB is not None
    turned = part.replace(q_NB=part.q_NB * [-1.0, -1.0, -1.0, 1.0])
    assert [trap.code for trap in fluxtwin.check(turned).traps] == ["attitude_convention"]


def test_a_wrong_reading_shows_though_torquers_are_on(cubesat: Telemetry) -> None:
    """30 uT beside a coupling of 14 uT a torquer; switches that were recorded a row or two late are none."""
    assert cubesat.dipole_B_Am2 is not None and cubesat.dipole_B_Am2[[600, 1100]].any(axis=1).all()
    reading = np.array(cubesat.mag_B_nT)
    reading[600, 1] += 30_000.0
    reading[1100, 0] -= 40_000.0
    (found,) = fluxtwin.check(cubesat.replace(mag_B_nT=reading)).traps
    assert (found.code, found.rows) == ("outliers", (601, 1101))
    truth = fluxtwin.simulate("cubesat")[1]
    one = cubesat.dipole_B_Am2 * [1.0, 0.0, 0.0]  # and two that never fire
    without = truth.T_nT_per_Am2 @ (cubesat.dipole_B_Am2 - one).T
    alone = cubesat.mag_B_nT + np.linalg.solve(np.eye(3) + truth.S, without).T
    alone[600] += 30_000.0
    (found,) = fluxtwin.check(cubesat.replace(mag_B_nT=alone, dipole_B_Am2=one)).traps
    assert (found.code, found.rows) == ("outliers", (601,))
    for late in (1, 2):
        assert not fluxtwin.check(cubesat.replace(dipole_B_Am2=np.roll(cubesat.dipole_B_Am2, late, axis=0))).traps


def test_the_next_step_asks_for_what_couples(cubesat: Telemetry) -> None:
    bad = fluxtwin.calibrate(cubesat).verdict
    assert bad is not None and bad.impossible and "torquers were on in 89 %" in bad.reasons[0]
    assert bad.next_step.endswith("--parameters b,S,T")
    good = fluxtwin.calibrate(cubesat, parameters="b,S,T").verdict
    assert good is not None and good.level == "good" and "torquers" not in " ".join(good.lines)
