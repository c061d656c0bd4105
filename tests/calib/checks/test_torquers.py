"""Torquers a few centimetres away couple more than the field has: no trap of the record, and the next step says so."""

from __future__ import annotations

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
    wrong = cubesat.replace(q_NB=cubesat.q_NB * [-1.0, -1.0, -1.0, 1.0])
    assert fluxtwin.check(wrong).traps, "torquers excuse nothing else"
    bare = cubesat.replace(dipole_B_Am2=None)
    assert fluxtwin.check(bare).traps, "nor what nobody recorded"


def test_the_next_step_asks_for_what_couples(cubesat: Telemetry) -> None:
    bad = fluxtwin.calibrate(cubesat).verdict
    assert bad is not None and bad.impossible and "torquers were on in 89 %" in bad.reasons[0]
    assert bad.next_step.endswith("--parameters b,S,T")
    good = fluxtwin.calibrate(cubesat, parameters="b,S,T").verdict
    assert good is not None and good.level == "good" and "torquers" not in " ".join(good.lines)
