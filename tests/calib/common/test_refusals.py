"""What the data cannot tell is refused by name. The cases are those of the notes on the papers' numbers: a
constant dipole is confounded with b, a dipole in proportion to B with S, D = sign(B) is not degenerate."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from fluxtwin.calib.common.observability import _one_by_one
from fluxtwin.calib.common.verdict import worst_pairs
from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.sim.base.errors import BadInput, NoAnswer

pytestmark = pytest.mark.closure

T_NT_PER_AM2 = np.array([[1.2, -0.4, 0.3], [0.2, -0.9, 0.5], [-0.6, 0.1, 1.5]])


def record(seasat: Any, dipole: np.ndarray, noise_nT: float = 370.0) -> Any:
    """Telemetry of a magnetometer with a T."""
    meter = seasat.magnetometer(T_NT_PER_AM2, noise_nT=noise_nT)
    return seasat.record(meter.reading(seasat.field_B_nT, dipole, np.random.default_rng(4)), dipole)


@pytest.mark.parametrize("direction", ["linear", "forward"])
def test_a_torquer_that_never_fired(seasat: Any, direction: str) -> None:
    rng = np.random.default_rng(1)
    dipole = rng.choice([-100.0, 100.0], size=(len(seasat.time), 3))
    dipole[:, 1] = 0.0
    fit = calibrate_linear(record(seasat, dipole), seasat.model, parameters="b,S,T", method=direction)
    assert any("T12, T22 and T32" in words and "torquer Y never fired" in words for words in fit.observability)
    assert [fit.sigma[name] for name in ("T12", "T22", "T32")] == [None, None, None]
    assert fit.calibration.T_nT_per_Am2 is not None
    left = np.delete(fit.calibration.T_nT_per_Am2 - T_NT_PER_AM2, 1, axis=1)
    sigma = np.delete(fit.calibration.sigmas[12:].reshape(3, 3), 1, axis=1)
    assert np.abs(left / sigma).max() < 4.0
    json.dumps(fit.to_dict(), allow_nan=False)


def test_no_torquer_fired_at_all(seasat: Any) -> None:
    fit = calibrate_linear(record(seasat, np.zeros((len(seasat.time), 3))), seasat.model, parameters="b,S,T")
    assert sum("never fired" in words for words in fit.observability) == 3
    assert fit.sigma["S11"] is not None
    assert fit.sigma["T33"] is None


@pytest.mark.parametrize("direction", ["linear", "forward"])
@pytest.mark.parametrize("wobble", [0.0, 1e-4])
def test_a_dipole_that_never_changes(seasat: Any, direction: str, wobble: float) -> None:
    rng = np.random.default_rng(2)
    dipole = rng.choice([-100.0, 0.0, 100.0], size=(len(seasat.time), 3))
    dipole[:, 2] = 60.0 + wobble * rng.normal(size=len(dipole))
    with pytest.raises(NoAnswer, match=r"torquer Z never changes: b1, b2, b3, T13, T23 and T33") as refusal:
        calibrate_linear(record(seasat, dipole), seasat.model, parameters="b,S,T", method=direction)
    assert set(refusal.value.evidence["parameters"]) == {"b1", "b2", "b3", "T13", "T23", "T33"}


@pytest.mark.parametrize("direction", ["linear", "forward"])
def test_a_dipole_in_proportion_to_the_field(seasat: Any, direction: str) -> None:
    """The law a simple controller would use: each coil against its own component of the reading."""
    meter = seasat.magnetometer(noise_nT=370.0)
    reading = meter.reading(seasat.field_B_nT, None, np.random.default_rng(4))
    telemetry = seasat.record(reading, -0.003 * reading)
    with pytest.raises(NoAnswer, match="in proportion to the field") as refusal:
        calibrate_linear(telemetry, seasat.model, parameters="b,S,T", method=direction)
    named = refusal.value.evidence["parameters"]
    assert any(name.startswith("S") for name in named)
    assert any(name.startswith("T") for name in named)


def test_what_moves_nothing_is_the_same_however_rounding_mixes_it() -> None:
    """Three coils, each in proportion to its own component of a field that is weak along y: they are named
    together, however the eigenvectors of their one eigenvalue are turned."""
    rms = np.array([1.0, 0.6, 0.1, 0.79, 1.0, 1.0, 1.0])
    null = np.zeros((7, 3))
    for k in range(3):
        null[[1 + k, 4 + k], k] = 1.0, -rms[1 + k]
    null /= np.linalg.norm(null, axis=0)
    found = []
    for seed in range(20):
        turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        found.append(_one_by_one(null @ turn, rms)[:, 0])
    assert np.ptp(found, axis=0).max() < 1e-12
    assert np.allclose(found[0][1:], np.sqrt(0.5))


def test_coils_that_always_fire_together(seasat: Any) -> None:
    rng = np.random.default_rng(3)
    dipole = rng.choice([-100.0, 0.0, 100.0], size=(len(seasat.time), 3))
    dipole[:, 1] = dipole[:, 0]
    with pytest.raises(NoAnswer, match="torquers X and Y always fire in the same proportion"):
        calibrate_linear(record(seasat, dipole), seasat.model, parameters="b,S,T")


def test_random_dipoles_cost_nothing_and_the_sign_of_the_field_is_solved(seasat: Any) -> None:
    """Notes on the papers' numbers: random +-1 gives sigma T 0.21 mG per unit and no loss for S; HCMM's momentum
    law D = sign(B) about doubles sigma S and sigma T and is not degenerate."""
    known: dict[str, Any] = {"noise_nT": 370.0, "lsb_nT": 0.0, "covariance": "white"}
    law = np.sign(seasat.field_B_nT)
    random = np.random.default_rng(5).choice([-1.0, 1.0], size=law.shape)
    none = calibrate_linear(record(seasat, random * 0.0), seasat.model, **known)
    free = calibrate_linear(record(seasat, random), seasat.model, parameters="b,S,T", **known)
    bound = calibrate_linear(record(seasat, law), seasat.model, parameters="b,S,T", **known)
    assert np.abs(free.calibration.sigmas[12:] / 100.0 - 0.21).max() < 0.03  # mG; 12 % of a sample sigma and chance
    assert np.median(free.calibration.sigmas[:9] / none.calibration.sigmas[:9]) < 1.1
    truth = np.concatenate([seasat.magnetometer().S.ravel(), seasat.magnetometer().b_nT, T_NT_PER_AM2.ravel()])
    assert np.abs((bound.calibration.values - truth) / bound.calibration.sigmas).max() < 4.0
    growth = bound.calibration.sigmas / free.calibration.sigmas
    assert 1.3 < np.median(growth[:9]) < 3.0
    assert 1.3 < np.median(growth[12:]) < 3.0


@pytest.mark.parametrize("direction", ["linear", "forward"])
def test_a_field_that_does_not_vary_along_an_axis(seasat: Any, direction: str) -> None:
    """Reading and reference both still along body Y but for the noise of the reading."""
    from fluxtwin.calib.common.design import Design
    from fluxtwin.calib.common.options import LinearOptions
    from fluxtwin.calib.linear.calibrate import fit_design

    reference = seasat.field_B_nT.copy()
    reference[:, 1] = 7000.0
    rng = np.random.default_rng(6)
    reading = seasat.magnetometer(noise_nT=0.0).ideal_reading(reference)
    reading = np.stack([reference[:, 0], np.full(len(reference), 7000.0), reference[:, 2]], axis=1)
    reading = reading + rng.normal(size=reading.shape) * 100.0
    design = Design(seasat.time, reading, reference, {}, np.arange(len(reading)), {})
    with pytest.raises(
        NoAnswer, match=r"does not vary beyond the noise along body Y: S12, S22, S32, b1, b2 and b3 .* stuck axis"
    ):
        fit_design(design, LinearOptions(method=direction, noise_nT=100.0, lsb_nT=0.0, robust="none"))


def test_a_real_one_orbit_record_is_solved_not_refused(seasat: Any) -> None:
    """Day 227's 44 minutes: the paper solved it; the sigma of column 2 says what it is worth."""
    meter = seasat.magnetometer(noise_nT=370.0)
    reading = meter.reading(seasat.field_B_nT, None, np.random.default_rng(8))
    fit = calibrate_linear(seasat.record(reading, rows=slice(281, 325)), seasat.model, method="forward")
    assert (fit.sigma["S12"] or 0.0) > 0.05
    assert ("S12", "b1") in [pair[:2] for pair in worst_pairs(fit)]
    said = [words for words in fit.observability if "are not separable in these data: correlation" in words]
    assert len(said) == 1  # the worst pair; the others are counted
    assert "more pairs with a correlation of 0.95 or more" in said[0]


def test_fewer_samples_than_parameters(seasat: Any) -> None:
    whole = record(seasat, np.zeros((len(seasat.time), 3)))
    with pytest.raises(NoAnswer, match="11 usable samples for 12 parameters"):
        calibrate_linear(whole.select(slice(0, 11)), seasat.model)
    with pytest.raises(NoAnswer, match="1 usable sample for 3 parameters"):
        calibrate_linear(whole.select(slice(0, 1)), seasat.model, parameters="b")
    calibrate_linear(whole.select(slice(0, 324, 27)), seasat.model, noise_nT=370.0, lsb_nT=0.0)  # twelve, spread


def test_incomplete_rows_are_left_out_and_counted(seasat: Any) -> None:
    whole = record(seasat, np.zeros((len(seasat.time), 3)))
    q, mag, r = whole.q_NB.copy(), whole.mag_B_nT.copy(), whole.r_N_km.copy()
    q[:10], mag[5:15], r[20:22] = np.nan, np.nan, np.nan
    fit = calibrate_linear(whole.replace(q_NB=q, mag_B_nT=mag, r_N_km=r), seasat.model)
    assert fit.left_out == {"no reading": 10, "no reference attitude": 5, "no position": 2}
    assert len(fit.time) == 325 - 17
    assert fit.rows[0] == 15
    with pytest.raises(NoAnswer, match="no row is complete: 325 rows have no reference attitude"):
        calibrate_linear(whole.replace(q_NB=None), seasat.model)
    with pytest.raises(NoAnswer, match=r"325 rows have no position.*; --tle FILE gives positions"):
        calibrate_linear(whole.replace(r_N_km=None, v_N_km_s=None), seasat.model)
    with pytest.raises(BadInput, match="no torquer dipole"):
        calibrate_linear(whole.replace(dipole_B_Am2=None), seasat.model, parameters="b,S,T")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"parameters": "S"}, "parameters: 'S'"),
        ({"method": "backward"}, "method"),
        ({"robust": "cauchy"}, "robust"),
        ({"covariance": "pink"}, "covariance"),
        ({"noise_nT": -1.0}, "--noise-nT"),
        ({"weights": np.ones(3)}, "weights"),
        ({"weights": -np.ones(325)}, "weights"),
        ({"block_s": 0.0}, "--block-s"),
        ({"field_error_nT": -1.0}, "--field-error-nT"),
        ({"field_error_nT": float("nan")}, "--field-error-nT"),
        ({"method": "forward", "errors_in_variables": True}, "errors_in_variables"),
    ],
)
def test_unknown_options(seasat: Any, arguments: dict[str, Any], words: str) -> None:
    whole = record(seasat, np.zeros((len(seasat.time), 3)))
    with pytest.raises(BadInput, match=words):
        calibrate_linear(whole, seasat.model, **arguments)


def test_a_silent_magnetometer(seasat: Any) -> None:
    with pytest.raises(NoAnswer, match="reads zero throughout"):
        calibrate_linear(seasat.record(np.zeros((325, 3))), seasat.model)
    with pytest.raises(NoAnswer, match="does not vary"):
        calibrate_linear(seasat.record(np.full((325, 3), 3e4)), seasat.model)
