"""Scenarios as text; Seasat's geometry for the closure tests of the calibration; results of a study in another world."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel, field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

# Lerner & Shuster 1979/1981: final b (eq. 10), final S (eq. 11) with the conference paper's sign of S12
SEASAT_S = np.array([[0.021, -0.016, 0.004], [0.013, -0.022, -0.004], [0.007, -0.003, 0.002]])
SEASAT_B_NT = np.array([7150.0, -2810.0, -6120.0])

ORBIT = {
    "epoch_utc": "2020-03-01T00:00:00Z",
    "altitude_km": 650.0,
    "inclination_deg": 97.9,
    "raan_deg": 10.0,
    "argument_of_latitude_deg": 0.0,
}

COARSE_MAGNETOMETER = """[magnetometer]
S = [[0.005, 0.002, 0.0], [0.0, -0.005, 0.0], [0.001, 0.0, 0.004]]
b_nT = [1000.0, -500.0, 200.0]
noise_nT = 100.0
lsb_nT = 100.0
"""
THERMAL = """[thermal]
sunlit_degC = 25.0
eclipse_degC = -20.0
time_constant_min = 20.0
"""


PARTS = """
[torquers]
dipole_Am2 = 50.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [1.5, 0.0, 0.0]]
[power]
full_sun_current_A = 8.0
load_A = 3.0
[thermal]
sunlit_degC = 25.0
eclipse_degC = -20.0
time_constant_min = 20.0
heater_on_below_degC = -5.0
heater_off_above_degC = 0.0
heater_rise_degC = 30.0
[wheels]
axes_B = [[0.0, 1.0, 0.0]]
inertia_kg_m2 = 0.01
bias_rpm = [2000.0]
"""
"""Torquers, power, temperature with a heater, and a wheel."""


def scenario_text(
    sections: str = "",
    *,
    seed: int = 1,
    name: str = "test",
    inertia_kg_m2: list[list[float]] | None = None,
    start_utc: str | None = None,
    segment: str | None = "samples = 50, step_s = 30.0",
    **orbit: Any,
) -> str:
    """The TOML text of a scenario: `ORBIT` with its changes, further sections, one segment from `start_utc` or the epoch.

    With `segment=None` the sections bring their own schedule.
    """
    elements = {**ORBIT, **orbit}
    body = {"name": name} if inertia_kg_m2 is None else {"name": name, "inertia_kg_m2": inertia_kg_m2}
    text = f"seed = {seed}\n"
    for section, values in (("spacecraft", body), ("orbit", elements)):
        text += f"[{section}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
    text += sections.lstrip("\n")
    if segment is not None:
        text += f'[schedule]\nsegments = [{{ start_utc = "{start_utc or elements["epoch_utc"]}", {segment} }}]\n'
    return text


@dataclass(frozen=True)
class Geometry:
    """Orbit, attitude and true field of the four days; the truth stays here, a record carries none."""

    model: FieldModel
    time: np.ndarray
    r_N_km: np.ndarray
    v_N_km_s: np.ndarray
    q_NB: np.ndarray
    field_B_nT: np.ndarray

    def record(
        self, mag_B_nT: np.ndarray, dipole_B_Am2: np.ndarray | None = None, rows: slice = slice(None)
    ) -> Telemetry:
        """Telemetry with the given readings; what the calibrator sees."""
        whole = Telemetry(
            time=self.time,
            mag_B_nT=mag_B_nT,
            r_N_km=self.r_N_km,
            v_N_km_s=self.v_N_km_s,
            q_NB=self.q_NB,
            dipole_B_Am2=dipole_B_Am2,
        )
        return whole.select(rows)

    def magnetometer(self, T: np.ndarray | None = None, **noise: float) -> Magnetometer:
        """The papers' final calibration as the truth of an instrument."""
        return Magnetometer(SEASAT_S, SEASAT_B_NT, T, **noise)


def stamps(day: int, samples: int) -> np.ndarray:
    """`samples` UTC stamps a minute apart from 6 h on a day of 1978."""
    start = np.datetime64("1978-01-01T06:00:00", "ns") + np.timedelta64(day - 1, "D")
    return start + np.arange(samples) * np.timedelta64(60, "s")


def geometry(time: np.ndarray) -> Geometry:
    """a = 7168 km, i = 108 deg, e = 0 (1979 paper), earth-pointing. Node and phase are free choices."""
    orbit = Orbit(
        epoch_utc=np.datetime64("1978-07-24", "ns"),
        altitude_km=7168.0 - 6378.137,
        inclination_rad=np.radians(108.0),
        raan_rad=1.0,
    )
    r, v = orbit.propagate(time)
    R_BN = frames.rotation_ON(r, v)
    model = load_field("igrf14")
    return Geometry(model, time, r, v, frames.q_from_rotation(R_BN), R_BN.apply(field_N_nT(model, time, r)))


@pytest.fixture(scope="session")
def seasat() -> Geometry:
    """Days 205, 219, 225 and 227 of 1978 with 92, 88, 101 and 44 samples a minute apart (1979 paper)."""
    days = ((205, 92), (219, 88), (225, 101), (227, 44))
    return geometry(np.concatenate([stamps(day, samples) for day, samples in days]))


@pytest.fixture(scope="session")
def passes() -> Geometry:
    """Forty passes of twelve samples over eight days."""
    starts = np.datetime64("1978-07-24T00:17:00", "ns") + np.arange(40) * np.timedelta64(4 * 3600 + 2711, "s")
    return geometry((starts[:, None] + np.arange(12) * np.timedelta64(60, "s")).ravel())


@pytest.fixture(scope="module")
def lawless() -> Iterator[None]:
    """No law is looked for, which takes most of the time of a verdict "unknown"; for files that are about something else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fluxtwin.gap.diagnose._with_law", lambda work, found, progress: found)
        yield


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sizes of a fit's errors from a third of the draws, which take most of the time of a calibration; for tests that
    are about something else than its sigmas."""
    for name, count in (("_BURN", 80), ("_KEPT", 120), ("_STATES", 10)):
        monkeypatch.setattr(f"fluxtwin.calib.common.error_model.{name}", count)


@pytest.fixture(scope="module")
def small_figures() -> Iterator[None]:
    """Figures of pages with a few dots; for files that look at no picture."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fluxtwin.report.FIGURE_DPI", 30)
        yield


@pytest.fixture(scope="session")
def changed() -> Callable[..., Any]:
    """`changed(results, "accuracy.lsb_x_deg", value)`: the frozen records with one field, or entry of a mapping, replaced.

    A value that can be called gets the old one.
    """

    def change(record: Any, path: str, value: Any) -> Any:
        name, _, rest = path.partition(".")
        old = record[name] if isinstance(record, Mapping) else getattr(record, name)
        new = change(old, rest, value) if rest else value(old) if callable(value) else value
        if isinstance(record, Mapping):
            return {**record, name: new}
        if hasattr(record, "model_copy"):
            return record.model_copy(update={name: new})
        return dataclasses.replace(record, **{name: new})

    return change


@pytest.fixture(scope="session")
def close_sizes(close: Callable[..., None]) -> Callable[..., None]:
    """`close_sizes(curves, frozen)`: rms and largest size of each curve of a figure, within 0.1 % and a last digit of 1e-4.

    The seed fixes all draws; what is left is the rounding of another machine, which moves a curve far less, unless it
    turns a bit of a reading.
    """

    def compare(curves: Mapping[str, Any], frozen: Mapping[str, tuple[float, float]]) -> None:
        shown = [np.asarray(curve, dtype=float)[np.isfinite(curve)] for curve in curves.values()]
        found = np.array([(np.sqrt(np.mean(one**2)), np.abs(one).max()) for one in shown])
        said = "; ".join(f"{name}: {rms:.4f}, {peak:.4f}" for name, (rms, peak) in zip(curves, found, strict=True))
        assert list(curves) == list(frozen), said
        expected = np.array(list(frozen.values()))
        close(found, expected, atol=1e-3 * expected + 1e-4, unit="as drawn", because=f"the same seed; found {said}")

    return compare


def small_record(rows: int) -> Telemetry:
    """Time, reading, position, velocity and attitude on a circular orbit: what every format can hold."""
    time = np.datetime64("2020-03-01T00:00:00", "ns") + np.arange(rows) * np.timedelta64(10, "s")
    turn = 0.0011 * np.arange(rows) * 10.0
    r_N_km = 7000.0 * np.stack([np.cos(turn), np.sin(turn), 0.1 * np.sin(turn)], axis=1)
    v_N_km_s = 7.7 * np.stack([-np.sin(turn), np.cos(turn), 0.1 * np.cos(turn)], axis=1)
    q_NB = np.stack([0.6 * np.sin(turn), 0.8 * np.sin(turn), 0.0 * turn, np.cos(turn)], axis=1)
    mag_B_nT = np.random.default_rng(3).normal(0.0, 2e4, (rows, 3)).round(1)
    return Telemetry(time, mag_B_nT, r_N_km=r_N_km, v_N_km_s=v_N_km_s, q_NB=q_NB)


TUMBLING = """
[attitude]
mode = "tumble"
rate_deg_s = [0.12, 0.08, 0.2]
[attitude.reference]
sigma_deg = 0.05
tau_s = 0.0
[magnetometer]
b_nT = [900.0, -300.0, 200.0]
noise_nT = 20.0
"""
"""A slow tumble, in which most effects show, and a magnetometer: sections for `tumbling`."""


def tumbling(sections: str = TUMBLING, seed: int = 1) -> str:
    """Fifty minutes of it, as a scenario."""
    inertia = [[0.05, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.04]]
    return scenario_text(sections, seed=seed, segment="samples = 300, step_s = 10.0", inertia_kg_m2=inertia)
