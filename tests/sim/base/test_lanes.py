"""Vectors in kernels: compiled they do what they do in numpy, and their width changes no field."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from fluxtwin.sim.base.kernel_cache import part
from fluxtwin.sim.base.lanes import LANES, every, fused, load, store
from fluxtwin.sim.base.types import FloatArray

pytestmark = pytest.mark.property

FIELD = """
import numpy as np
from fluxtwin.sim.base.lanes import LANES
from fluxtwin.sim.earth.field import field_E_nT, load_field
r = np.random.default_rng(1).normal(size=(70, 3))
r *= np.linspace(6400.0, 7500.0, 70)[:, None] / np.linalg.norm(r, axis=1)[:, None]
time = np.datetime64("2022-10-05", "ns") + np.arange(70) * np.timedelta64(7, "D")
print(LANES, field_E_nT(load_field("igrf14"), time, r).tobytes().hex())
"""


def steps(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Every function, at places of its own."""
    p, q = load(a, 1), load(b, LANES + 2)
    store(out, 3, fused(p, q, every(a[0, 2]) * p))
    store(out, 3 + LANES, every(-2.0) * q)


def test_a_kernel_does_what_numpy_does() -> None:
    a, b = np.random.default_rng(2).normal(size=(2, 3, 16))
    compiled, plain, wrong = np.zeros((3, 2, 20))
    part()(steps)(a, b, compiled)
    steps(a, b, plain)
    steps(b, a, wrong)
    np.testing.assert_allclose(compiled, plain, rtol=4e-16, atol=4e-16)  # a fused product is rounded once
    assert np.count_nonzero(compiled) == 2 * LANES and not np.allclose(compiled, wrong)


def test_no_vector_is_taken_from_an_array_with_gaps() -> None:
    a, out = np.zeros((2, 4, 20))
    with pytest.raises(Exception, match=r"No implementation|Invalid use"):
        part()(steps)(a[:, ::2], a, out)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="names features of that machine")
def test_the_width_of_the_machine_changes_no_field() -> None:
    """As on a machine without AVX, where nothing is fused, and as on this one."""
    said = []
    for features in (None, "+sse2"):
        narrow = {} if features is None else {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": features}
        run = [sys.executable, "-c", FIELD]
        said.append(subprocess.run(run, env=os.environ | narrow, capture_output=True, text=True, check=True).stdout)
    here, there = (np.frombuffer(bytes.fromhex(one.split()[1])) for one in said)
    assert here.size == 210 and said[1].startswith("4 ")
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-9)  # nT: rounding of 60,000 nT, 120 times
