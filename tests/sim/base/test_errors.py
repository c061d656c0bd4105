"""Refusals that no other test meets: what is wrong, where, and what is wanted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.attitude.yaw import average_yaw
from fluxtwin.calib.common.pair import compare
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.onboard.export import find_target
from fluxtwin.calib.onboard.own import _held
from fluxtwin.gap.fleet import fleet
from fluxtwin.sim.attitude import record
from fluxtwin.sim.base.errors import BadInput, FluxtwinError
from fluxtwin.sim.base.seals import unsealed_json
from fluxtwin.sim.effects.response import Hysteresis
from fluxtwin.sim.spacecraft.dynamics.environment import environment_along
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.sensors.slit_sun_sensor import SlitSunSensor
from fluxtwin.sim.spacecraft.torques import GravityGradient
from fluxtwin.sim.telemetry.formats.forty_two import _numbers
from fluxtwin.sim.telemetry.formats.table import Table
from fluxtwin.sim.telemetry.record import Telemetry, concatenate

pytestmark = pytest.mark.property

TIME = np.datetime64("2020-03-01", "ns") + np.arange(3) * np.timedelta64(1, "s")
TWO, AXES = Rotation.identity(2), np.eye(3)
SOMETHING: Any = SimpleNamespace()


def spun(moments: list[float], axis: list[float]) -> object:
    return record.spin(TIME, np.array(moments), np.array(axis), 0.1)


def made(**columns: Any) -> Telemetry:
    return Telemetry(**{"time": TIME, "mag_B_nT": AXES, **columns})


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: spun([2.0, 2.0, 1.0], [0.0] * 3), "spin: the rate or the axis is zero"),
        (
            lambda: environment_along(SOMETHING, TIME[0], 0.0),
            "environment: duration 0 s, spacing 10 s. Wanted: both > 0",
        ),
        (lambda: Vehicle(AXES, torques=(GravityGradient(),) * 2).packed(), "torques: a torque is listed twice"),
        (lambda: unsealed_json("[1]", where="x.json", wanted="JSON"), "x.json: is JSON without keys. Wanted: JSON"),
        (
            lambda: Hysteresis(start="oox").apply(SOMETHING, AXES[0]),
            "start: 'oox'. Wanted: three letters of o, r and n",
        ),
        (lambda: Table("t.csv", {"x": np.array([np.inf])}).numbers("x"), "t.csv: x has infinite values"),
        (lambda: made(time=TIME[:0], mag_B_nT=AXES[:0]), "time: the record has no rows"),
        (lambda: made(mag_B_nT=np.zeros((3, 2))), r"mag_B_nT: has shape \(3, 2\). Wanted: shape \(3, 3\)"),
        (lambda: made(mag_B_nT=1e200 * AXES), r"mag_B_nT: 1e\+200 in row 1 is no measurement. Wanted: a blank cell"),
        (
            lambda: concatenate([]),
            "telemetry: there is no record to join. Wanted: a record, a file, or a list with one",
        ),
        (
            lambda: concatenate([made(), made()]),
            "telemetry: two records overlap in time: one ends at 2020-03-01T00:00:02",
        ),
        (
            lambda: concatenate([made(provenance={"spacecraft": name}) for name in "AB"]),
            "telemetry: the records are of different spacecraft: A, B. Wanted: one spacecraft",
        ),
        (lambda: average_yaw(TIME, np.zeros(3), 0.0), "--average-s: 0.0. Wanted: seconds, positive"),
        (
            lambda: compare(*[SimpleNamespace(residuals_nT=np.zeros((9, 1)))] * 2),  # type: ignore[arg-type]
            "compared by vectors: a method with attitude is needed",
        ),
        (lambda: Calibration(AXES, AXES[0], covariance_kind="guess"), "covariance_kind: 'guess'. Wanted: "),
        (lambda: _held({"M": np.ones(8), "o": np.ones(3)}, "e.h"), "e.h: M is not 9 finite numbers. Wanted: 9 numbers"),
        (lambda: find_target("pixhawk"), "--to: 'pixhawk' is no target. Wanted: .*px4"),
        (lambda: fleet(["a", "b"], [SOMETHING] * 2), "fleet: 2 vehicles. Wanted: three or more"),
    ],
)
def test_what_is_refused(call: Callable[[], object], said: str) -> None:
    with pytest.raises(FluxtwinError, match=said):
        call()


def test_a_grid_that_is_too_coarse_for_the_spin_is_refused() -> None:
    sensor = SlitSunSensor(noise_deg=0.1)
    around = lambda t: np.stack([np.cos(3.0 * t), np.sin(3.0 * t), 0.0 * t], axis=1)  # noqa: E731
    with pytest.raises(
        BadInput, match=r"slit sun sensor: the grid of times is too coarse for the spin. Wanted: a finer"
    ):
        sensor.crossings(np.arange(5.0), around, np.random.default_rng(0))


def test_a_file_of_42_without_rows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "MTB.42").write_text("\n", encoding="utf-8")
    with pytest.raises(BadInput, match=r"MTB\.42: has no rows"):
        _numbers(tmp_path / "MTB.42", 10)
