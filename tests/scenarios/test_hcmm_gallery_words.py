"""What the gallery says of a coupling that the control law hardly drives: elements that are not seen are not given."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.hcmm.study import words

pytestmark = pytest.mark.property


def answer(*compared, drive=0.1):
    return SimpleNamespace(
        compared=compared,
        name="torquer_coupling",
        later=SimpleNamespace(rms=(162.4, 161.2), floor=158.7),
        telemetry=SimpleNamespace(dipole_B_Am2=np.full((4, 3), drive)),
    )


def element(name, put_in, found, sigma):
    return Numbers(name=name, put_in=put_in, found=found, sigma=sigma, unit="nT/(A m2)")


LAW = answer(
    element("C_xx", -100.0, 51.7, 70.8), element("C_yy", -100.0, -95.0, 17.0), element("C_zx", 0.0, 32.8, 46.0)
)


def test_an_element_within_its_noise_is_not_given_as_found():
    """The column of x has the size that was put in, of noise alone, and its own element the wrong sign."""
    said = words().say("drive", answer=answer(drive=10.0), law=LAW)
    assert "but 1 of its 3 elements is above 3 sigma: C_yy -95 ± 17 (put in -100)" in said
    assert "C_xx" not in said
    assert "up to 71 nT/(A m2)" in said


def test_the_number_furthest_from_what_was_put_in_is_named():
    furthest = partial(words().say, "furthest")
    assert furthest(answer=LAW).startswith("Furthest from what was put in: C_xx, by 2.1 of its sigma")
    wrong = answer(element("S_zz", -0.007, -0.0075, 0.0001))
    assert furthest(answer=wrong).endswith("that sigma is too small.")
    assert furthest(answer=answer()) == ""
