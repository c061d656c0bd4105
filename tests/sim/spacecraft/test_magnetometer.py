"""Magnetometer and torquers: equation 1 of the papers, rounding, the dipole law and the papers' figures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.constants import AM2_PER_POLE_CM, NT_PER_MG
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.torquers import coupling_nT_per_Am2, dipole_field_nT

pytestmark = pytest.mark.reference

S = np.array([[0.021, -0.016, 0.004], [0.013, -0.022, -0.004], [0.007, -0.003, 0.002]])
B_NT = np.array([7150.0, -2810.0, -6120.0])
T = np.array([[0.3, -0.1, 0.05], [0.02, -0.4, 0.1], [-0.2, 0.15, 0.25]])
TORQUER_AM2 = 1e5 * AM2_PER_POLE_CM


@pytest.fixture
def field() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.uniform(-40_000.0, 40_000.0, (500, 3)), rng.choice([-100.0, 0.0, 100.0], (500, 3))


def test_equation_1_of_the_reading_is_the_truth(field, close) -> None:
    """Lerner & Shuster, eq. 1: A B0 = (I + S) B + b + T D, S times the *measured* field."""
    truth, D = field
    B = Magnetometer(S, B_NT, T).ideal_reading(truth, D)
    back = B + B @ S.T + B_NT + D @ T.T
    close(back, truth, atol=1e-9, unit="nT", because="rounding of 4e4 nT in double precision is 1e-11")
    mutants = {
        "S on the truth": truth - truth @ S.T - B_NT - D @ T.T,
        "b of the other sign": Magnetometer(S, -B_NT, T).ideal_reading(truth, D),
        "S transposed": Magnetometer(S.T, B_NT, T).ideal_reading(truth, D),
        "T of the other sign": Magnetometer(S, B_NT, -T).ideal_reading(truth, D),
        "no torquers": Magnetometer(S, B_NT, T).ideal_reading(truth),
    }
    for mutant in mutants.values():
        wrong = mutant + mutant @ S.T + B_NT + D @ T.T
        with pytest.raises(AssertionError):
            close(wrong, truth, atol=1.0, unit="nT", because="a mutant must fail by more than a nanotesla")


@given(
    st.tuples(*9 * [st.floats(-0.05, 0.05)]),
    st.tuples(*3 * [st.floats(-1e5, 1e5)]),
    st.tuples(*9 * [st.floats(-1.0, 1.0)]),
    st.tuples(*6 * [st.floats(-6e4, 6e4)]),
)
def test_whatever_the_calibration_the_corrected_reading_is_the_truth(close, matrix, bias, coupling, state) -> None:
    S, T = np.reshape(matrix, (3, 3)), np.reshape(coupling, (3, 3))
    truth, D = np.array([state[:3]]), np.array([state[3:]]) / 600.0
    B = Magnetometer(S, np.array(bias), T).ideal_reading(truth, D)
    close(B + B @ S.T + bias + D @ T.T, truth, atol=1e-9, unit="nT", because="rounding of 2e5 nT is 3e-11")


def test_signs_of_stray_field_and_coupling(close) -> None:
    """A stray field f adds at the sensor: b = -f. A coupling C is T = -C."""
    stray, C = np.array([100.0, -50.0, 20.0]), np.array([[0.2, 0, 0], [0, -0.1, 0.3], [0, 0.3, -0.1]])
    sensor = Magnetometer(np.zeros((3, 3)), -stray, -C)
    D = np.array([[100.0, 0.0, -100.0]])
    truth = np.array([[20_000.0, -10_000.0, 5_000.0]])
    close(sensor.ideal_reading(truth, D), truth + stray + D @ C.T, atol=1e-11, unit="nT", because="they add")


def test_rounding_error_is_uniform_on_a_moving_field(close) -> None:
    """LSB 4.4 mG: error within half an LSB, variance LSB^2/12, mean zero, independent of the axis."""
    lsb = 440.0
    rows = 40_000
    t = np.arange(rows)
    truth = 30_000.0 * np.stack([np.sin(0.0017 * t), np.cos(0.0023 * t), np.sin(0.0031 * t + 1.0)], axis=1)
    sensor = Magnetometer(S, B_NT, lsb_nT=lsb)
    rng = np.random.default_rng(0)
    reading = sensor.reading(truth, None, rng)
    close(np.mod(reading / lsb + 0.5, 1.0), 0.5, atol=1e-9, unit="LSB", because="readings are whole multiples")
    error = reading - sensor.ideal_reading(truth)
    assert np.abs(error).max() <= 0.5 * lsb * (1.0 + 1e-12)
    # The sampled field sweeps some 1e5 codes; equidistribution leaves well under 2 % in the variance.
    close(error.var(axis=0) / (lsb**2 / 12.0), 1.0, atol=0.02, unit="LSB^2/12", because="1e5 codes swept")
    close(error.mean(axis=0) / lsb, 0.0, atol=0.005, unit="LSB", because="nearest, not floor, which gives -0.5")
    share = np.histogram(error / lsb, bins=10, range=(-0.5, 0.5))[0] / error.size
    close(share, 0.1, atol=0.005, unit="share", because="uniform; the turning points crowd a few codes")


def test_noise_saturation_and_rounding_come_in_that_order(close) -> None:
    """Saturated before rounding: a full scale of 1000 with LSB 300 reads 900, never the clipped 1200.

    Noise before saturation: no reading leaves the range. Noise before rounding: every reading is a multiple.
    """
    sensor = Magnetometer(np.zeros((3, 3)), np.zeros(3), noise_nT=200.0, lsb_nT=300.0, range_nT=1000.0)
    truth = np.tile([[5_000.0, -5_000.0, 0.0]], (2000, 1))
    reading = sensor.reading(truth, None, np.random.default_rng(2))
    close(reading[:, 0], 900.0, atol=0.0, unit="nT", because="clipped to 1000, then the nearest multiple of 300")
    close(reading[:, 1], -900.0, atol=0.0, unit="nT", because="the same below")
    assert set(np.unique(reading[:, 2])) <= {-900.0, -600.0, -300.0, 0.0, 300.0, 600.0, 900.0}
    assert np.unique(reading[:, 2]).size >= 3


def test_noise_has_the_stated_size(close) -> None:
    """12,000 draws: sigma of the estimate 0.65 %; 4 sigma, false alarm 6e-5 for any seed."""
    sensor = Magnetometer(S, B_NT, noise_nT=50.0)
    truth = np.tile([[20_000.0, 10_000.0, -5_000.0]], (4000, 1))
    noise = sensor.reading(truth, None, np.random.default_rng(3)) - sensor.ideal_reading(truth)
    close(noise.std() / 50.0, 1.0, atol=4 * 0.00645, unit="of 50 nT", because="4 sigma of 12,000 draws")


def test_the_noise_stream_does_not_depend_on_its_size() -> None:
    truth = np.zeros((4, 3))
    after = []
    for noise in (0.0, 10.0):
        rng = np.random.default_rng(5)
        Magnetometer(S, B_NT, noise_nT=noise).reading(truth, None, rng)
        after.append(rng.standard_normal())
    assert after[0] == after[1]


def test_an_impossible_magnetometer_is_refused() -> None:
    with pytest.raises(BadInput, match="magnetometer"):
        Magnetometer(-np.eye(3), B_NT)


# ---- torquers ------------------------------------------------------------------------------------------------


def test_seasats_torquers_at_six_metres(close) -> None:
    """Lerner & Shuster: 1e5 pole-cm, 6 m away, "no greater than 1.7 mG". m/r^3 in mG is 1e5/600^3 G = 0.463."""
    broadside = dipole_field_nT([0, 0, TORQUER_AM2], [6.0, 0, 0])[0] / NT_PER_MG
    axial = dipole_field_nT([0, 0, TORQUER_AM2], [0, 0, 6.0])[0] / NT_PER_MG
    cgs = 1e5 / 600.0**3 * 1e3  # Gaussian units: gauss = pole cm / cm^3
    close(broadside, [0, 0, -cgs], atol=1e-12, unit="mG", because="the law in Gaussian units")
    close(axial, [0, 0, 2.0 * cgs], atol=1e-12, unit="mG", because="the law in Gaussian units")
    close(np.abs([broadside[2], axial[2]]), [0.463, 0.926], atol=5e-4, unit="mG", because="three decimals")
    # Three orthogonal dipoles fire together: the sum has size sqrt 3 m and may point along r.
    together = dipole_field_nT(TORQUER_AM2 * np.ones(3), 6.0 / np.sqrt(3.0) * np.ones(3))[0]
    worst = np.linalg.norm(together) / NT_PER_MG
    close(worst, 1.604, atol=5e-4, unit="mG", because="three decimals")
    assert worst < 1.7, "the paper's bound"


def test_hcmms_torquers_at_one_metre(close) -> None:
    """Lerner & Shuster: 10,000 pole-cm within a metre give a bias of about 20 mG."""
    field = dipole_field_nT([1e4 * AM2_PER_POLE_CM, 0, 0], [1.0, 0, 0])[0] / NT_PER_MG
    close(field, [20.0, 0, 0], atol=1e-12, unit="mG", because="2 m / r^3")


def test_dipole_field_against_two_opposite_poles(close) -> None:
    """The limit of two magnetic charges +-p a short distance apart, Coulomb's law for each."""
    m, r = np.array([3.0, -5.0, 8.0]), np.array([0.7, 1.1, -0.4])
    half = 1e-4 * m / np.linalg.norm(m)
    p = np.linalg.norm(m) / 2e-4
    poles = 100.0 * p * sum(s * (r - s * half) / np.linalg.norm(r - s * half) ** 3 for s in (1.0, -1.0))
    found = dipole_field_nT(m, r)[0]
    close(
        found, poles, atol=1e-6 * np.linalg.norm(found), unit="nT", because="finite length 2e-4 m: 1e-8, rounding 1e-8"
    )
    for mutant in (1.01 * found, -found, found[[1, 0, 2]]):
        with pytest.raises(AssertionError):
            close(mutant, poles, atol=1e-6 * np.linalg.norm(found), unit="nT", because="a mutant must fail")


def test_coupling_is_the_field_of_all_torquers(close) -> None:
    positions = np.array([[-5.0, 1.0, 2.0], [-6.0, 0.0, 0.5], [-4.0, -2.0, 1.0]])
    C = coupling_nT_per_Am2(positions)
    dipole = np.array([100.0, -50.0, 25.0])
    total = sum(dipole_field_nT(dipole * np.eye(3)[k], -positions[k])[0] for k in range(3))
    close(C @ dipole, total, atol=1e-12, unit="nT", because="sum over torquers; r points to the sensor")
    single = coupling_nT_per_Am2(np.tile(positions[0], (3, 1)))
    close(single, single.T, atol=1e-15, unit="nT/(A m2)", because="one place: 3uu - 1 is symmetric")
    close(np.trace(single), 0.0, atol=1e-15, unit="nT/(A m2)", because="and traceless")
    with pytest.raises(BadInput, match="distance"):
        coupling_nT_per_Am2(np.zeros((3, 3)))
