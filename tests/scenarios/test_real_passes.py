"""The questions to the 43 printed residuals: a difference that is put in is found, and none where there is none.

Witness: the same tests on residuals drawn at random on the real passes' stations and nights.
"""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.scenarios.hcmm.strength import ask, weigh_field_error
from fluxtwin.scenarios.hcmm_orbit.fit import fit_orbit
from fluxtwin.scenarios.hcmm_orbit.predictions import windows_of
from fluxtwin.scenarios.hcmm_orbit.record import read_passes

pytestmark = pytest.mark.property

DAY = "night against day"


@pytest.fixture(scope="module")
def passes():
    return read_passes()


@pytest.fixture(scope="module")
def evidence(passes):
    orbit = fit_orbit()
    return weigh_field_error(orbit, windows_of(passes, orbit.orbit, as_scanned=False), 1978)


def drawn(evidence, rng, night_ratio=1.0):
    """Residuals that follow the model's error, with 10 % of scatter."""
    night = np.where(evidence.night > 0.5, night_ratio, 1.0)
    return evidence.model_copy({"printed_mG": evidence.with_lsb_mG * night * np.exp(0.1 * rng.standard_normal(43))})


def test_residuals_without_a_difference_rarely_show_one(passes, evidence):
    """Of 40 draws with 26 counted tests each at 5 %, seven alarms or more have a chance of 0.3 %."""
    rng = np.random.default_rng(5)
    alarms = [
        any(q.certain for q in ask(passes, drawn(evidence, rng), n, 2000).asked.values() if q.corrected)
        for n in range(40)
    ]
    assert sum(alarms) < 7


def test_a_difference_by_night_is_found_beside_the_error_of_the_model(passes, evidence):
    found = ask(passes, drawn(evidence, np.random.default_rng(6), night_ratio=1.4), 1)
    question = found.asked[DAY, True]
    assert question.certain
    assert question.ratio == pytest.approx(1.4, rel=0.15)  # 19 and 24 passes of 10 %, less what the slope takes


def test_of_the_real_passes_only_greenbelt_differs_and_the_model_of_1975_explains_it(passes, evidence):
    found = ask(passes, evidence, 1978)
    alone = [q for q in found.asked.values() if q.name.endswith("against the others") and not q.corrected]
    assert [q.name.split()[0] for q in alone if q.certain] == ["ETC"]
    assert not found.asked[DAY, False].certain
    assert not found.asked[DAY, True].certain
    assert found.asked["station against station", False].certain
    assert not found.asked["station against station", True].certain
    assert found.explained > 0.5


def test_two_stations_that_hear_one_overflight_count_once(passes, evidence):
    found = ask(passes, evidence, 1978)
    sizes = np.bincount(found.overflight)
    assert sizes.sum() == 43
    assert sizes.max() == 2
    assert (found.stations[found.overflight == found.overflight[5]] == ["WNK", "MAD"]).all()


def test_all_tests_are_counted(passes, evidence):
    found = ask(passes, evidence, 1978)
    assert all(q.p_counted >= q.p_value for q in found.asked.values())
    least = min(found.asked.values(), key=lambda q: q.p_value)
    assert least.p_counted == pytest.approx(len(found.asked) * least.p_value)
