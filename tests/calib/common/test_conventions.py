"""Both conventions convert to each other and back, and agree with the simulator's magnetometer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common import conventions as conv
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer

pytestmark = pytest.mark.property

RNG = np.random.default_rng(2024)
CASES = [
    conv.Correction(RNG.normal(size=(3, 3)) * 0.05, RNG.normal(size=3) * 5e3, RNG.normal(size=(3, 3)))
    for _ in range(20)
]
ROUNDING = 1e-12


def same(left: conv.Correction, right: conv.Correction, with_T: bool) -> bool:
    """Equal to rounding."""
    if not np.allclose(left.S, right.S, rtol=0, atol=ROUNDING):
        return False
    if not np.allclose(left.b_nT, right.b_nT, rtol=0, atol=ROUNDING * 1e5):
        return False
    if not with_T:
        return True
    assert left.T_nT_per_Am2 is not None
    assert right.T_nT_per_Am2 is not None
    return np.allclose(left.T_nT_per_Am2, right.T_nT_per_Am2, rtol=0, atol=ROUNDING * 10)


def test_there_and_back() -> None:
    for case in CASES:
        assert same(conv.correction_from_forward(conv.forward_from_correction(case)), case, with_T=True)
        flipped = conv.Correction(case.S, -case.b_nT, case.T_nT_per_Am2)
        turned = conv.Correction(case.S.T, case.b_nT, case.T_nT_per_Am2)
        assert not same(conv.correction_from_forward(conv.forward_from_correction(flipped)), case, with_T=True)
        assert not same(conv.correction_from_forward(conv.forward_from_correction(turned)), case, with_T=True)


def test_both_forms_describe_one_instrument() -> None:
    """The same reading and the same true field satisfy both equations."""
    field, dipole = RNG.normal(size=(50, 3)) * 3e4, RNG.normal(size=(50, 3)) * 10.0
    for case in CASES:
        f = conv.forward_from_correction(case)
        reading = field @ f.G.T + f.o_nT + dipole @ f.C_nT_per_Am2.T  # type: ignore[union-attr]
        back = reading + reading @ case.S.T + case.b_nT + dipole @ case.T_nT_per_Am2.T  # type: ignore[union-attr]
        assert np.allclose(back, field, rtol=0, atol=1e-7)


def test_the_simulator_and_the_record_speak_the_same_convention() -> None:
    """`Magnetometer` inverts journal eq. 1; `Calibration.apply` is eq. 1; `forward` is the magnetometer."""
    field, dipole = RNG.normal(size=(50, 3)) * 3e4, RNG.normal(size=(50, 3)) * 10.0
    for case in CASES:
        reading = Magnetometer(case.S, case.b_nT, case.T_nT_per_Am2).ideal_reading(field, dipole)
        calibration = Calibration(case.S, case.b_nT, case.T_nT_per_Am2)
        assert np.allclose(calibration.apply(reading, dipole), field, rtol=0, atol=1e-7)
        forward = calibration.forward
        expected = field @ forward.G.T + forward.o_nT + dipole @ forward.C_nT_per_Am2.T  # type: ignore[union-attr]
        assert np.allclose(expected, reading, rtol=0, atol=1e-7)
        for wrong in (
            Calibration(case.S.T, case.b_nT, case.T_nT_per_Am2),
            Calibration(case.S, -case.b_nT, case.T_nT_per_Am2),
            Calibration(case.S, case.b_nT, case.T_nT_per_Am2.T),  # type: ignore[union-attr]
        ):
            assert not np.allclose(wrong.apply(reading, dipole), field, rtol=0, atol=1.0)


def test_the_offset_has_the_opposite_sign_of_b() -> None:
    case = conv.Correction(np.zeros((3, 3)), np.array([100.0, -200.0, 300.0]))
    assert conv.forward_from_correction(case).o_nT.tolist() == [-100.0, 200.0, -300.0]


def test_polar_split() -> None:
    """M = O P with the rotation that was put in (analytic)."""
    rotation = Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()
    stretch = np.array([[1.02, 0.003, 0.0], [0.003, 0.98, -0.004], [0.0, -0.004, 1.001]])
    O, P = conv.polar_split(rotation @ stretch)  # noqa: E741
    assert np.allclose(O, rotation, rtol=0, atol=1e-14)
    assert np.allclose(P, stretch, rtol=0, atol=1e-14)


def test_forward_jacobian_against_differences() -> None:
    case = CASES[0]
    f = conv.forward_from_correction(case)

    def correction(theta: np.ndarray) -> np.ndarray:
        c = conv.correction_from_forward(conv.Forward(theta[:9].reshape(3, 3), theta[9:12], theta[12:].reshape(3, 3)))
        return np.concatenate([c.S.ravel(), c.b_nT, c.T_nT_per_Am2.ravel()])  # type: ignore[union-attr]

    theta = np.concatenate([f.G.ravel(), f.o_nT, f.C_nT_per_Am2.ravel()])  # type: ignore[union-attr]
    steps = np.concatenate([np.full(9, 1e-5), np.full(3, 1.0), np.full(9, 1e-4)])
    jacobian = conv.forward_jacobian(case)
    for at, step in enumerate(steps):
        d = np.zeros(21)
        d[at] = step
        numeric = (correction(theta + d) - correction(theta - d)) / (2.0 * step)
        assert np.allclose(jacobian[:, at], numeric, rtol=1e-6, atol=1e-6 * max(1.0, np.abs(numeric).max()))


def test_what_is_refused() -> None:
    with pytest.raises(BadInput, match="singular"):
        conv.forward_from_correction(conv.Correction(-np.eye(3), np.zeros(3)))
    with pytest.raises(BadInput, match="3 x 3"):
        conv.correction_from_forward(conv.Forward(np.eye(2), np.zeros(3)))


def test_apply_needs_a_dipole_only_where_T_is_not_zero() -> None:
    reading = np.ones((4, 3))
    with pytest.raises(BadInput, match="no torquer dipole"):
        Calibration(np.zeros((3, 3)), np.zeros(3), np.eye(3)).apply(reading)
    assert np.allclose(Calibration(np.zeros((3, 3)), np.ones(3), np.zeros((3, 3))).apply(reading), 2.0)
    T = np.diag([1.0, 0.0, 2.0])
    blank = np.array([[1.0, np.nan, 1.0], [np.nan, 0.0, 0.0]])
    applied = Calibration(np.zeros((3, 3)), np.zeros(3), T).apply(np.zeros((2, 3)), blank)
    assert applied[0].tolist() == [1.0, 0.0, 2.0]
    assert np.isnan(applied[1]).all()
