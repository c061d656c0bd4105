"""Frozen S, b and T of one simulated Seasat record: they move only when someone means them to.

The numbers and the reason for each change are in `calibration_seasat.toml`; a change needs a CHANGELOG line.
The draws come from numpy's legacy RandomState, whose stream is frozen for good (NEP 19).
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.baseline

BASELINE = Path(__file__).with_name("calibration_seasat.toml")
S = np.array([[0.021, -0.016, 0.004], [0.013, -0.022, -0.004], [0.007, -0.003, 0.002]])
B_NT = np.array([7150.0, -2810.0, -6120.0])
T_NT_PER_AM2 = np.array([[1.2, -0.4, 0.3], [0.2, -0.9, 0.5], [-0.6, 0.1, 1.5]])


def calibrate(
    S: np.ndarray = S, b: np.ndarray = B_NT, shift: int = 0, direction: str = "linear"
) -> tuple[Calibration, Any]:
    """The frozen record, from an instrument with S and b, its dipole logged `shift` samples late."""
    days = ((205, 92), (219, 88), (225, 101), (227, 44))
    start = np.datetime64("1978-01-01T06:00:00", "ns")
    minute, day = np.timedelta64(60, "s"), np.timedelta64(1, "D")
    time = np.concatenate([start + (d - 1) * day + np.arange(n) * minute for d, n in days])
    orbit = Orbit(
        epoch_utc=np.datetime64("1978-07-24", "ns"),
        altitude_km=789.863,
        inclination_rad=np.radians(108.0),
        raan_rad=1.0,
    )
    r, v = orbit.propagate(time)
    R_BN = frames.rotation_ON(r, v)
    model = load_field("igrf14")
    rng = np.random.RandomState(1978)  # this stream never changes
    dipole = rng.choice([-100.0, 0.0, 100.0], size=(len(time), 3))
    reading = Magnetometer(S, b, T_NT_PER_AM2).ideal_reading(R_BN.apply(field_N_nT(model, time, r)), dipole)
    reading = 440.0 * np.rint((reading + rng.normal(size=reading.shape) * 200.0) / 440.0)
    record = Telemetry(
        time=time,
        mag_B_nT=reading,
        r_N_km=r,
        v_N_km_s=v,
        q_NB=frames.q_from_rotation(R_BN),
        dipole_B_Am2=np.roll(dipole, shift, axis=0),
    )
    known: dict[str, Any] = {"parameters": "b,S,T", "noise_nT": 200.0, "lsb_nT": 440.0, "robust": "none"}
    fit = calibrate_linear(record, model, method=direction, **known)
    return fit.calibration, fit


def compare(close: Callable[..., None], found: Calibration, frozen: dict[str, Any]) -> None:
    """Each frozen matrix with its own tolerance and reason."""
    for key, entry in frozen.items():
        close(getattr(found, key), entry["value"], atol=entry["atol"], unit=entry["unit"], because=entry["why"])


@pytest.fixture(scope="module")
def frozen() -> dict[str, Any]:
    """By direction, then by field of the calibration."""
    return tomllib.loads(BASELINE.read_text(encoding="utf-8"))


@pytest.mark.parametrize("direction", ["linear", "forward"])
def test_nothing_has_moved(close: Callable[..., None], frozen: dict[str, Any], direction: str) -> None:
    compare(close, calibrate(direction=direction)[0], frozen[direction])


@pytest.mark.parametrize(
    "mutant",
    [{"b": -B_NT}, {"S": S.T}, {"shift": 1}],
    ids=["sign of b", "S transposed", "dipole a sample late"],
)
def test_a_mutant_is_caught(close: Callable[..., None], frozen: dict[str, Any], mutant: dict[str, Any]) -> None:
    with pytest.raises(AssertionError, match="differs by"):
        compare(close, calibrate(**mutant)[0], frozen["linear"])


def test_the_frozen_numbers_are_near_the_truth(frozen: dict[str, Any]) -> None:
    """A baseline that froze a mistake would be found here: every number within 4 of its own sigmas."""
    for direction in ("linear", "forward"):
        values = np.concatenate([np.ravel(frozen[direction][k]["value"]) for k in ("S", "b_nT", "T_nT_per_Am2")])
        sigma = np.sqrt(np.diag(calibrate(direction=direction)[0].covariance))
        truth = np.concatenate([S.ravel(), B_NT, T_NT_PER_AM2.ravel()])
        assert np.abs((values - truth) / sigma).max() < 4.0
