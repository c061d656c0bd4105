"""Sensors at rates of their own: who is read when, and what check, calibration and a column map make of the blanks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from worlds import scenario_text

from fluxtwin.calib.checks.check import check_telemetry
from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.calib.methods import default_method
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.sampling import SamplingSection
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
yaw_rms_deg = 8.0
roll_rms_deg = 8.0
pitch_rms_deg = 8.0
[attitude.reference]
sigma_deg = 0.02
tau_s = 600.0
[magnetometer]
S = [[0.02, 0.004, -0.003], [-0.009, 0.014, 0.008], [0.014, -0.004, -0.007]]
b_nT = [300.0, -200.0, 100.0]
noise_nT = 10.0
[gyro]
[thermal]
sunlit_degC = 20.0
eclipse_degC = -10.0
time_constant_min = 20.0
[sampling.magnetometer]
every_s = 10.0
[sampling.attitude]
every_s = 30.0
offset_s = 5.0
[sampling.gyro]
every_s = 15.0
[sampling.housekeeping]
every_s = 60.0
[schedule]
segments = [
    { start_utc = "2022-01-01T00:00:00Z", step_s = 5.0, duration_min = 200.0 },
    { start_utc = "2022-01-01T12:00:02.5Z", step_s = 2.5, duration_min = 10.0 },
]
"""
TEXT = scenario_text(
    SECTIONS, seed=5, epoch_utc="2022-01-01T00:00:00Z", altitude_km=600.0, inclination_deg=97.0, segment=None
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


def test_each_sensor_has_its_rows_and_blanks_elsewhere(scenario: Scenario) -> None:
    telemetry, truth = simulate(scenario)
    whole, _ = simulate(scenario.updated({"sampling": None}))
    assert len(telemetry) == len(whole) == len(truth.time)
    second = telemetry.time >= np.datetime64("2022-01-01T12:00:00")
    for start, part in (("2022-01-01T00:00:00", ~second), ("2022-01-01T12:00:02.5", second)):
        seconds = epoch.seconds_since(telemetry.time[part], np.datetime64(start, "ns"))
        for name, every_s, offset_s in (
            ("mag_B_nT", 10.0, 0.0),
            ("q_NB", 30.0, 5.0),
            ("rate_B_rad_s", 15.0, 0.0),
            ("temperature_degC", 60.0, 0.0),
        ):
            value, full = (np.array(getattr(record, name))[part] for record in (telemetry, whole))
            known = np.isfinite(value.reshape(len(value), -1)).all(axis=1)
            assert np.array_equal(known, np.isclose(seconds % every_s, offset_s))
            assert np.array_equal(value[known], full[known])  # the same readings, fewer of them
    assert telemetry.has_position.all() and np.isfinite(np.array(telemetry.sunlit)).all()


def test_a_saved_scenario_samples_again(scenario: Scenario) -> None:
    assert parse_scenario(scenario.to_toml()).sampling == scenario.sampling
    assert parse_scenario(
        TEXT.replace("[sampling", "[effects_").split("[effects_")[0] + TEXT[TEXT.index("[schedule") :]
    )


def test_an_attitude_from_sensors_wants_both_in_its_row(scenario: Scenario) -> None:
    head = {"azimuth_deg": 0.0, "elevation_deg": 20.0, "half_fov_deg": 80.0}
    other = {"azimuth_deg": 180.0, "elevation_deg": 20.0, "half_fov_deg": 80.0}
    sensed = scenario.updated(
        {
            "sun_sensor": {"1": head, "2": other},
            "horizon_scanner": {},
            "attitude.reference": {"source": "sensors"},
            "sampling": {"sun_sensor": {"every_s": 10.0}, "horizon_scanner": {"every_s": 15.0}},
        }
    )
    telemetry, _ = simulate(sensed)
    seen = np.isfinite(np.array(telemetry.sun_B)).all(axis=1)
    nadir = np.isfinite(np.array(telemetry.nadir_B)).all(axis=1)
    assert telemetry.has_attitude.any() and not (telemetry.has_attitude & ~(seen & nadir)).any()


def test_blanks_are_read_as_the_documents_say(scenario: Scenario, tmp_path: Path) -> None:
    """No row has reading and attitude: calibration falls back to |B|. A column map brings them together."""
    telemetry, truth = simulate(scenario)
    model = load_field()
    write_telemetry(telemetry, tmp_path / "flight.csv")
    record = read_telemetry(tmp_path / "flight.csv")
    assert not (record.has_reading & record.has_attitude).any()
    report = check_telemetry(record, model)
    assert all(finding.severity == "note" for finding in report.findings), report.findings
    assert any(finding.code == "missing_attitude" for finding in report.findings)
    assert default_method(record) == "scalar"
    text = (Path(__file__).resolve().parents[3] / "docs" / "telemetry.md").read_text(encoding="utf-8")
    (example,) = [block for block in re.findall(r"```toml\n(.*?)```", text, flags=re.S) if '"flight.csv"' in block]
    (tmp_path / "map.toml").write_text(example, encoding="utf-8")
    merged = read_telemetry(tmp_path, column_map=tmp_path / "map.toml")
    assert (merged.has_reading & merged.has_attitude).sum() > 0.95 * merged.has_reading.sum()
    found = calibrate_linear(merged, model).calibration
    pulls = np.concatenate([(found.S - truth.S).ravel(), found.b_nT - truth.b_nT]) / found.sigmas[:12]
    # Twelve pulls: one beyond 4.5 happens once in 12,000 sets.
    assert np.abs(pulls).max() < 4.5, pulls


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sampling.gyro.every_s": 7.0}, "whole multiples of the rows' step_s"),
        ({"sampling.attitude.offset_s": 30.0}, "offset_s is to be less than every_s"),
        ({"sampling.torquers": {"every_s": 10.0}}, r"\[sampling.torquers\]: the scenario has no such part"),
        ({"sampling.magnetometer_2": {"every_s": 10.0}}, "the scenario has no such part"),
        ({"sampling.compass": {"every_s": 10.0}}, "unknown key sampling.compass"),
        (
            {"torquers": {"dipole_Am2": [1.0, 1.0, 1.0], "positions_m": [[1.0, 0.0, 0.0]] * 3}},
            r"torquers.dipole_Am2: one number is wanted \(found a list of 3\)",
        ),
    ],
)
def test_what_does_not_fit_is_said(scenario: Scenario, changes: dict[str, object], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        scenario.updated(changes)


def test_every_name_is_in_the_documents() -> None:
    text = (Path(__file__).resolve().parents[3] / "docs" / "scenario.md").read_text(encoding="utf-8")
    section = text[text.index("## [sampling.NAME]") : text.index("## [station.NAME]")]
    assert [name for name in SamplingSection.model_fields if f"`{name}`" not in section] == []
