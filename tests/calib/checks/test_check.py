"""The traps of foreign telemetry: each one put into a good simulated file is named, and good files stay clean."""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import motions
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from fluxtwin import load_scenario
from fluxtwin.calib.checks.check import check_file, check_telemetry, repair
from fluxtwin.calib.checks.clock import check_clock, named_shift, shifts_s
from fluxtwin.calib.checks.evidence import _covariances
from fluxtwin.calib.checks.orientation import mountings
from fluxtwin.calib.checks.outliers import without_gross_outliers
from fluxtwin.calib.checks.sample import comparable
from fluxtwin.calib.checks.stuck import _held, check_held
from fluxtwin.calib.checks.unit import _misfit_nT
from fluxtwin.calib.checks.values import _plane_wander
from fluxtwin.scenarios.seasat import mission
from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth import frames, references, sun
from fluxtwin.sim.earth.field import FieldModel, field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.telemetry.record import Origin, Telemetry, concatenate
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.property

LSB_nT = 440.0
"""4.4 mG, the step of Seasat's magnetometer (Lerner and Shuster 1979): the coarsest that these checks must bear."""


@pytest.fixture(scope="module")
def model() -> FieldModel:
    return load_field("igrf14")


def good(
    model: FieldModel,
    seed: int = 1,
    *,
    rows: int = 600,
    step_s: float = 30.0,
    mode: str = "earth",
    year: int = 1978,
    altitude_km: float = 790.0,
    inclination_deg: float = 108.0,
    bias_nT: float | None = None,
    scale_error: float = 0.02,
) -> Telemetry:
    """A record as a healthy spacecraft sends it: preflight errors of 2 %, 1000 nT, 0.3 deg, LSB 440 nT.

    `bias_nT` is the size of a bias in a random direction instead.
    """
    rng = stream(seed, "check.good")
    start = np.datetime64(f"{year}-07-24T06:00:00", "ns")
    orbit = Orbit(
        epoch_utc=start,
        altitude_km=altitude_km,
        inclination_rad=float(np.radians(inclination_deg)),
        raan_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        eccentricity=0.005,
    )
    time = start + (np.arange(rows) * round(step_s * 1e9)).astype("timedelta64[ns]")
    r, v = orbit.propagate(time)
    R_BN = _attitude(mode, time, r, v, rng)
    field = R_BN.apply(field_N_nT(model, time, r))
    S, b = rng.normal(0.0, 0.02, (3, 3)) * (scale_error / 0.02), rng.normal(0.0, 1000.0, 3)
    b *= 1.0 if bias_nT is None else bias_nT / np.linalg.norm(b)
    reading = (field - b) @ np.linalg.inv(np.eye(3) + S).T + rng.normal(0.0, 50.0, field.shape)
    noise = Rotation.from_rotvec(rng.normal(0.0, np.radians(0.3), (rows, 3)))
    light = sun.illumination(r, sun.sun_N_km(time))
    sun_B = R_BN.apply(sun.sun_direction_N(time, r)) + rng.normal(0.0, np.radians(0.1), (rows, 3))
    sun_B /= np.linalg.norm(sun_B, axis=1)[:, None]
    sun_B[light < 0.5] = np.nan
    return Telemetry(
        time=time,
        mag_B_nT=np.round(reading / LSB_nT) * LSB_nT,
        r_N_km=r,
        v_N_km_s=v,
        q_NB=frames.q_from_rotation(noise * R_BN),
        sun_B=sun_B,
        sunlit=(light > 0.5).astype(float),
    )


def _attitude(mode: str, time: np.ndarray, r: np.ndarray, v: np.ndarray, rng: np.random.Generator) -> Rotation:
    start = Rotation.from_rotvec(rng.normal(0.0, 1.5, 3))
    if mode == "hold":
        return Rotation.from_matrix(np.tile(start.as_matrix(), (len(time), 1, 1)))
    if mode == "spin":
        seconds = (time - time[0]).astype("int64") * 1e-9
        return Rotation.from_rotvec(np.outer(seconds * 2.0 * np.pi / 97.3, [0.0, 0.0, 1.0])) * start
    if mode == "tumble":
        return attitude.tumble(
            time, np.array([1.0, 1.6, 2.1]), frames.q_from_rotation(start), rng.normal(0.0, 0.01, 3)
        ).R_BN
    swing = 30.0 if mode == "wide" else 1.0
    return motions.earth_pointing(
        time,
        r,
        v,
        yaw_amplitude_rad=swing * 0.02,
        roll_amplitude_rad=swing * 0.01,
        pitch_amplitude_rad=swing * 0.01,
        shortest_period_s=600.0,
        longest_period_s=6000.0,
        rng=rng,
    ).R_BN


CASES = (
    {"rows": 600, "step_s": 30.0},
    {"rows": 150, "step_s": 120.0, "year": 2015, "altitude_km": 500.0, "inclination_deg": 97.5},
    {"rows": 2000, "step_s": 0.5, "year": 2022, "altitude_km": 425.0, "inclination_deg": 93.0},
    {"rows": 1500, "step_s": 4.0, "year": 1990, "altitude_km": 1200.0, "inclination_deg": 30.0},
    {"rows": 400, "step_s": 60.0, "year": 2005, "altitude_km": 20000.0, "inclination_deg": 55.0},
)


@pytest.mark.parametrize("mode", ["earth", "spin", "hold"])
@pytest.mark.parametrize("case", CASES)
def test_good_files_are_clean(model: FieldModel, mode: str, case: dict[str, float]) -> None:
    for seed in range(3):
        found = check_telemetry(good(model, seed, mode=mode, **case), model)  # type: ignore[arg-type]
        assert [(f.code, f.text) for f in found.traps] == []
        assert found.exit_status == 0


LARGE = (*CASES, {"rows": 150, "step_s": 60.0, "year": 2020, "altitude_km": 550.0, "inclination_deg": 97.6})


@pytest.mark.parametrize("row", range(3))
@pytest.mark.parametrize("mode", ["earth", "wide", "spin", "tumble", "hold"])
def test_a_large_bias_is_no_trap(model: FieldModel, mode: str, row: int) -> None:
    """Uncompensated CubeSats fly with 170 to 620 mG an axis. False alarms: under 1 % of such files.

    Each mode meets each orbit, and each size of bias meets each mode twice and each orbit at least once.
    """
    column = ["earth", "wide", "spin", "tumble", "hold"].index(mode)
    for seed, case in list(enumerate(LARGE))[row::3]:
        bias_nT = (10_000.0, 20_000.0, 50_000.0)[(row + column) % 3]
        record = good(model, seed, mode=mode, bias_nT=bias_nT, scale_error=0.06, **case)  # type: ignore[arg-type]
        assert [(f.code, f.text) for f in check_telemetry(record, model).traps] == []


@pytest.fixture(scope="module")
def seasat() -> Telemetry:
    return mission.fly(mission.scenario()).telemetry


@pytest.mark.parametrize("day", [None, 205, 219, 225, 227])
@pytest.mark.parametrize("extra_mG", [(0, 0, 0), (120, -60, -100), (-96, 96, 98), (-170, 170, 175), (0, 500, 0)])
def test_simulated_seasat_is_clean(
    model: FieldModel, seasat: Telemetry, day: int | None, extra_mG: tuple[float, ...]
) -> None:
    """Its printed bias is 98.2 mG (Lerner and Shuster 1979, Table 1); more is put on top, up to 600 mG in all."""
    days = (seasat.time.astype("datetime64[D]") - np.datetime64("1978-01-01")).astype(int) + 1
    record = seasat if day is None else seasat.select(days == day)
    record = record.replace(mag_B_nT=record.mag_B_nT - 100.0 * np.array(extra_mG))
    found = check_telemetry(record, model)
    assert [(f.code, f.text) for f in found.traps] == []
    assert found.exit_status == 0
    if day is None:
        assert "large_bias" in {finding.code for finding in found.notes}, "what it cannot tell is still said"


def turned_attitude(record: Telemetry, R_XN: Rotation) -> Telemetry:
    """The attitude relative to X under the name of GCRS."""
    return record.replace(q_NB=frames.q_from_rotation(frames.rotation_from_q(record.q_NB) * R_XN.inv()))


def times(record: Telemetry, factor: float) -> Telemetry:
    return record.replace(mag_B_nT=record.mag_B_nT * factor)


def axes(record: Telemetry, order: list[int], signs: list[float]) -> Telemetry:
    return record.replace(mag_B_nT=np.array(record.mag_B_nT)[:, order] * signs)


def quaternion(record: Telemetry, order: list[int], signs: list[float]) -> Telemetry:
    return record.replace(q_NB=np.array(record.q_NB)[:, order] * signs)


def earth_fixed(record: Telemetry) -> Telemetry:
    r = frames.rotation_EN(record.time).apply(np.array(record.r_N_km))
    return record.replace(r_N_km=r, v_N_km_s=None)


def earth_fixed_velocity(record: Telemetry) -> Telemetry:
    turning = np.cross([0.0, 0.0, 7.292115e-5], np.array(record.r_N_km))
    return record.replace(v_N_km_s=record.v_N_km_s - turning)


def stuck(record: Telemetry) -> Telemetry:
    mag = np.array(record.mag_B_nT)
    mag[100:140] = mag[100]
    return record.replace(mag_B_nT=mag)


def no_fix(record: Telemetry) -> Telemetry:
    r = np.array(record.r_N_km)
    r[50:60] = 0.0
    return record.replace(r_N_km=r)


def filled_position(record: Telemetry) -> Telemetry:
    r = np.array(record.r_N_km)
    r[[40, 41, 42, 300], 0] = -9999.0
    return record.replace(r_N_km=r)


TRAPS: dict[str, tuple[Callable[[Telemetry], Telemetry], str, str]] = {
    "counts": (lambda t: times(t, 100.7), "magnetometer_unit", "counts of 0.01 nT labelled as nT"),
    "offset binary": (
        lambda t: t.replace(mag_B_nT=np.rint(t.mag_B_nT / 440.0) + 2048.0),
        "magnetometer_unit",
        "from 0 to 4095 with zero at 2048 (offset binary), about 4",
    ),
    "whole counts": (
        lambda t: t.replace(mag_B_nT=np.rint(t.mag_B_nT / 15.26)),
        "magnetometer_unit",
        "probably raw counts of about 15",
    ),
    "milligauss": (lambda t: times(t, 1e-2), "magnetometer_unit", "milligauss labelled as nT"),
    "microtesla": (lambda t: times(t, 1e-3), "magnetometer_unit", "microtesla labelled as nT"),
    "tesla": (lambda t: times(t, 1e-9), "magnetometer_unit", "tesla labelled as nT"),
    "gauss": (lambda t: times(t, 1e-5), "magnetometer_unit", "gauss labelled as nT"),
    "transposed": (lambda t: quaternion(t, [0, 1, 2, 3], [-1, -1, -1, 1]), "attitude_convention", "is conjugated"),
    "scalar first": (lambda t: quaternion(t, [3, 0, 1, 2], [1, 1, 1, 1]), "attitude_convention", "scalar first"),
    "orbital": (
        lambda t: turned_attitude(t, frames.rotation_ON(t.r_N_km, t.v_N_km_s)),
        "attitude_convention",
        "orbital frame",
    ),
    "Earth-fixed attitude": (
        lambda t: turned_attitude(t, frames.rotation_EN(t.time)),
        "attitude_convention",
        "relative to Earth-fixed axes",
    ),
    "of date": (lambda t: turned_attitude(t, frames.rotation_TN(t.time)), "attitude_of_date", "equinox of date"),
    "swapped": (lambda t: axes(t, [1, 0, 2], [1, 1, 1]), "magnetometer_axes", "mag_x is +y, mag_y is +x"),
    "flipped": (lambda t: axes(t, [0, 1, 2], [1, 1, -1]), "magnetometer_axes", "mag_z is -z; mirrored"),
    "shifted": (lambda t: axes(t, [2, 0, 1], [1, 1, 1]), "magnetometer_axes", "mag_x is +z, mag_y is +x"),
    "Earth-fixed position": (earth_fixed, "position_frame", "ecef_x_km"),
    "Earth-fixed velocity": (earth_fixed_velocity, "velocity_frame", "derivative of the position"),
    "stuck": (stuck, "stuck_values", "does not change for up to 1"),
    "constant": (lambda t: t.replace(mag_B_nT=np.ones((len(t), 3)) * 2e4), "constant_field", "never changes"),
    "dead axis": (lambda t: axes(t, [0, 1, 2], [1, 1, 0]), "stuck_axis", "mag_z is"),
    "sunlit": (lambda t: t.replace(sunlit=1.0 - np.array(t.sunlit)), "sunlit_flag", "where geometry says"),
    "no fix": (no_fix, "position_inside_earth", "there was no fix; in a column map: invalid = [0])"),
    "fill in a position": (filled_position, "position_jumps", "one component is -9999 km, a fill value"),
    "ten rows": (lambda t: t.select(slice(0, 10)), "too_few_samples", "10 rows have a reading"),
    "time zone": (
        lambda t: t.replace(time=t.time + np.timedelta64(5 * 3600, "s"), q_NB=None),
        "clock",
        "5 h too late",
    ),
    "positions of other rows": (
        lambda t: t.replace(
            r_N_km=np.random.default_rng(1).permutation(t.r_N_km), v_N_km_s=None, q_NB=None, sunlit=None
        ),
        "field_mismatch",
        "wrong positions",
    ),
}


@pytest.mark.parametrize("name", TRAPS)
def test_a_trap_is_named(model: FieldModel, name: str) -> None:
    corrupt, code, words = TRAPS[name]
    found = check_telemetry(corrupt(good(model, 2)), model)
    assert found.exit_status == 1
    texts = [finding.text for finding in found.traps if finding.code == code]
    assert texts, [finding.code for finding in found.traps]
    assert any(words in text for text in texts), texts
    assert "not_compared" not in {finding.code for finding in found.notes}, "it has positions"
    if code == "magnetometer_unit":
        assert len(found.traps) == 1, "a wrong unit must not be taken for other traps"


LARGE_TRAPS = (
    "counts",
    "milligauss",
    "microtesla",
    "tesla",
    "gauss",
    "transposed",
    "scalar first",
    "orbital",
    "Earth-fixed attitude",
    "swapped",
    "flipped",
    "shifted",
    "Earth-fixed position",
)


@pytest.mark.parametrize("name", LARGE_TRAPS)
@pytest.mark.parametrize("mode", ["earth", "tumble"])
def test_a_large_bias_hides_no_trap(model: FieldModel, mode: str, name: str) -> None:
    corrupt, code, _ = TRAPS[name]
    found = check_telemetry(corrupt(good(model, 2, mode=mode, bias_nT=20_000.0)), model)
    assert code in {finding.code for finding in found.traps}, found.traps


def test_metres_sold_as_kilometres_and_kilometres_sold_as_metres_are_named(model: FieldModel) -> None:
    record = good(model, 2)
    for factor in (1e3, 1e-3):
        wrong = record.replace(r_N_km=np.array(record.r_N_km) * factor, v_N_km_s=np.array(record.v_N_km_s) * factor)
        assert check_telemetry(wrong, model).exit_status == 1


@pytest.mark.parametrize("name", ["transposed", "scalar first", "orbital", "swapped", "shifted"])
@pytest.mark.parametrize("mode", ["earth", "hold"])
def test_a_short_arc_cannot_hide_a_wrong_attitude_behind_a_bias(model: FieldModel, mode: str, name: str) -> None:
    corrupt, code, _ = TRAPS[name]
    record = good(model, 2, mode=mode, rows=1000, step_s=1.0, year=2022, altitude_km=425.0, inclination_deg=93.0)
    codes = {finding.code for finding in check_telemetry(corrupt(record), model).traps}
    assert codes & {code, "vector_mismatch"}, codes


def test_without_positions_an_impossible_magnitude_is_still_named(model: FieldModel) -> None:
    record = good(model, 3).replace(r_N_km=None, v_N_km_s=None, sunlit=None)
    assert check_telemetry(record, model).exit_status == 0
    for factor in (100.0, 1e-2, 1e-9):
        found = check_telemetry(times(record, factor), model)
        assert [finding.code for finding in found.traps] == ["magnetometer_unit"]


@pytest.mark.parametrize("with_attitude", [True, False])
def test_the_field_of_a_recorded_current_is_no_outlier_and_hides_none(model: FieldModel, with_attitude: bool) -> None:
    """A body that turns by twenty degrees from row to row: along the field that of the current changes its sign at once."""
    world = {
        "torquers": None,
        "attitude": {"mode": "tumble", "rate_deg_s": [0.7, -0.4, 1.1]},
        "spacecraft.inertia_kg_m2": [[0.03, 0.0, 0.0], [0.0, 0.035, 0.0], [0.0, 0.0, 0.01]],
        "schedule.segments": [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 900.0, "step_s": 15.0}],
        "drivers.bus": {"pattern": "square", "low": 0.3, "high": 1.7, "period_s": 2300.0, "duty": 0.45},
        "effects.driver.bus": {"k_nT_per_unit": [150.0, -90.0, 120.0]},
    }
    record, _ = simulate(load_scenario("cubesat").updated(world))
    record = record if with_attitude else record.replace(q_NB=None)
    assert not check_telemetry(record, model).traps
    wild = np.array(record.mag_B_nT)
    wild[[300, 900], 1] += 3000.0
    (found,) = check_telemetry(record.replace(mag_B_nT=wild), model).traps
    assert found.rows == (301, 901)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_positions_a_size_that_rises_faster_than_its_noise_has_no_outliers(
    model: FieldModel, seed: int
) -> None:
    """Ten seconds a row, 20 nT: |B| changes by 100 nT from row to row. Three wrong readings are found."""
    scenario = load_scenario("cubesat").updated({"seed": seed, "torquers": None})
    record = simulate(scenario)[0].replace(r_N_km=None, v_N_km_s=None)
    for part in (slice(0, 199), slice(300, 499), slice(None)):
        assert not check_telemetry(record.select(part), model).traps
    reading = np.array(record.mag_B_nT)
    reading[[50, 51, 700], 0] += 3000.0
    (found,) = check_telemetry(record.replace(mag_B_nT=reading), model).traps
    assert (found.code, found.rows) == ("outliers", (51, 52, 701))


def test_of_few_readings_three_may_be_outliers(model: FieldModel) -> None:
    """A twentieth of 48 is two; three are still wrong readings and not a rough sensor, and four are a rough sensor."""
    record = good(model, rows=48)
    for wrong, code in (([8, 22, 37], "outliers"), ([8, 17, 26, 37], "rough_readings")):
        reading = np.array(record.mag_B_nT)
        reading[wrong, 1] += 20_000.0
        report = check_telemetry(record.replace(mag_B_nT=reading), model)
        assert {one.code: one.rows for one in (*report.traps, *report.notes)}[code] == tuple(row + 1 for row in wrong)


def test_noise_is_no_gross_outlier_and_a_doubled_reading_is(model: FieldModel) -> None:
    sample = comparable(good(model), model, np.ones(600, dtype=bool), with_attitude=False)
    assert sample is not None
    reading = sample.field_N_nT + stream(5, "check.gross").normal(0.0, 50.0, sample.field_N_nT.shape)
    assert len(without_gross_outliers(replace(sample, mag_nT=reading))) == len(sample)
    reading[7] *= 2.0
    assert set(sample.rows) - set(without_gross_outliers(replace(sample, mag_nT=reading)).rows) == {sample.rows[7]}


def test_what_cannot_be_tested_is_said(model: FieldModel) -> None:
    record = good(model, 3, mode="hold")
    codes = {finding.code for finding in check_telemetry(record.replace(sun_B=None), model).notes}
    assert "of_date_not_tested" in codes
    far = check_telemetry(record.replace(time=record.time + np.timedelta64(60 * 365, "D")), model)
    assert "outside_field_model" in {finding.code for finding in far.traps}


@pytest.mark.parametrize(("times", "year"), [(1, 1978), (2, 2026)])
def test_a_week_that_began_again_is_named(times: int, year: int, model: FieldModel) -> None:
    """The weeks began again in 1999 and in 2019, so that a receiver of the first kind is two rounds behind."""
    record = good(model, 4, year=year, rows=150)
    found = check_telemetry(record.replace(time=record.time - np.timedelta64(times * 1024, "W")), model)
    assert [finding.code for finding in found.traps] == ["clock"]
    assert f"{times * 1024} weeks too early" in found.traps[0].text
    assert f"time.offset_s = {times * 619315200}" in found.traps[0].text
    assert "more than a right clock" not in found.traps[0].text


def test_a_shift_that_leaves_more_than_a_right_clock_would_is_doubted(model: FieldModel) -> None:
    """Half a century off, a time of day that fits better is not what is wrong: the field itself has changed."""
    record = good(model, 4, year=2026, mode="tumble")
    moved = record.replace(time=record.time - np.timedelta64(3 * 1024, "W") - np.timedelta64(150, "m"))
    (found,) = check_telemetry(moved, model).traps
    assert found.code == "clock" and "more than a right clock" in found.text, found.text


def test_eddy_currents_of_a_fast_spinner_are_no_wrong_file(model: FieldModel) -> None:
    """At 3 rpm a loop that decays in 0.8 s reads a quarter of the field along another axis; a gain of ten is too much."""
    record = good(model, 3, year=2024, rows=900, step_s=2.0, mode="hold")
    assert record.q_NB is not None and record.r_N_km is not None
    field_N = field_N_nT(model, record.time, record.r_N_km)
    seconds = (record.time - record.time[0]).astype("int64") * 1e-9
    rate = np.array([0.0, 0.0, np.radians(18.0)])
    R_BN = Rotation.from_rotvec(np.outer(seconds, -rate)) * frames.rotation_from_q(record.q_NB[0])
    field = R_BN.apply(field_N)
    slope = np.cross(field, rate)
    K = np.array([[0.1, -0.8, -0.5], [-0.8, -0.4, 0.4], [-0.5, 0.4, 0.3]])
    noise = stream(3, "eddies").normal(0.0, 50.0, field.shape)
    spun = record.replace(mag_B_nT=field - slope @ K + noise, q_NB=frames.q_from_rotation(R_BN), sun_B=None)
    assert check_telemetry(spun, model).traps == ()
    ten = check_telemetry(spun.replace(mag_B_nT=(field + noise) @ np.diag([1.0, 10.0, 1.0])), model)
    assert [found.code for found in ten.traps] == ["magnetometer_matrix"]


@pytest.mark.parametrize(
    ("seconds", "said"), [(600, "10 min too late (to within"), (3600, "1 h too late (a time zone)")]
)
def test_a_clock_that_jumps_is_no_late_clock(seconds: int, said: str, model: FieldModel) -> None:
    """Half of the stamps late beyond a gap is a jump; with all of them late the gap is only a gap."""
    record = good(model, 5, year=2026, rows=600, step_s=10.0, mode="tumble")
    late = np.timedelta64(seconds, "s")
    beyond = np.arange(len(record)) >= 300
    (found,) = check_telemetry(record.replace(time=record.time + late * beyond), model).traps
    assert found.code == "clock" and f"and {said}" in found.text, found.text
    assert "the stamps are right up to the gap before" in found.text and "time.offset_s =" not in found.text
    gap = record.select(np.flatnonzero((np.arange(600) < 250) | (np.arange(600) >= 350)))
    (found,) = check_telemetry(gap.replace(time=gap.time + late), model).traps
    assert found.code == "clock" and f"time.offset_s = -{seconds}" in found.text, found.text


def test_what_was_not_compared_is_not_called_clean(model: FieldModel) -> None:
    record = good(model)
    assert check_telemetry(record, model).clean == "clean: no trap found"
    without = check_telemetry(record.replace(r_N_km=None, v_N_km_s=None), model)
    assert (
        not without.traps and "without positions nothing was compared" in without.clean and "clean" not in without.clean
    )
    assert "no positions (--tle FILE or a column map gives them)" in without.notes[0].text


def test_missing_rows_and_gaps_are_notes(model: FieldModel) -> None:
    record = good(model, 4)
    mag, keep = np.array(record.mag_B_nT), np.ones(600, dtype=bool)
    mag[10:15] = np.nan
    keep[300:330] = False
    found = check_telemetry(record.replace(mag_B_nT=mag).select(keep), model)
    assert found.exit_status == 0
    by_code = {finding.code: finding for finding in found.findings}
    assert by_code["missing_magnetometer"].rows == (11, 12, 13, 14, 15)
    assert by_code["gaps"].row_count == 1


def test_the_report_is_json(model: FieldModel) -> None:
    found = check_telemetry(times(good(model, 2), 1e-2), model).to_dict()
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["clean"] is False


def shuffled(model: FieldModel, folder: Path) -> tuple[Telemetry, Path]:
    """A good file with two rows swapped, one repeated exactly and one repeated with other content."""
    record = good(model, 5)
    lines = write_telemetry(record, folder / "good.csv").read_text(encoding="utf-8").splitlines()
    lines = [line.rpartition(",")[0] for line in lines]  # without its checks, which a rival would not fit
    lines[100], lines[101] = lines[101], lines[100]
    lines.insert(201, lines[200])
    rival = lines[300].split(",")
    rival[7] = "1.0"
    lines.insert(301, ",".join(rival))
    path = folder / "shuffled.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return record, path


def test_stamps_out_of_order_are_a_trap_and_repair_mends_them(model: FieldModel, tmp_path: Path) -> None:
    record, path = shuffled(model, tmp_path)
    with pytest.raises(BadInput, match="time does not increase"):
        read_telemetry(path)
    found = check_file(path, model)
    assert {"time_not_increasing", "time_repeated", "conflicting_rows"} <= {finding.code for finding in found.traps}
    assert found.samples == len(record) + 2, "the rows of the file"
    assert f"dropped: 1 of {len(record) + 2} rows" in found.report()
    before = path.read_bytes()
    mended = repair(path, tmp_path / "out.nc")
    by_code = {finding.code: finding for finding in mended.findings}
    assert by_code["duplicates_dropped"].rows == (201,)
    assert by_code["conflicting_rows"].rows == (301,)
    assert path.read_bytes() == before
    back = read_telemetry(tmp_path / "out.nc")
    assert np.array_equal(back.time, record.time)
    assert np.array_equal(back.mag_B_nT, record.mag_B_nT)
    assert check_file(tmp_path / "out.nc", model).exit_status == 0


def test_without_positions_a_smooth_course_is_not_called_rough(model: FieldModel) -> None:
    """|B| of a healthy record, of 25 nT noise and a row in 30 s, curves by more than its noise."""
    record = good(model, mode="tumble")
    field = frames.rotation_from_q(record.q_NB).apply(field_N_nT(model, record.time, record.r_N_km))
    noisy = field + np.random.default_rng(3).normal(0.0, 25.0, field.shape)
    blind = record.replace(mag_B_nT=noisy, r_N_km=None, v_N_km_s=None)
    assert "rough_readings" not in {finding.code for finding in check_telemetry(blind, model).findings}


def test_repair_never_writes_over_its_input(model: FieldModel, tmp_path: Path) -> None:
    path = write_telemetry(good(model, 5), tmp_path / "a.csv")
    with pytest.raises(BadInput, match="would overwrite the input"):
        repair(path, tmp_path / "." / "a.csv")


def test_a_record_without_any_reading_is_a_trap_and_no_crash():
    time = np.datetime64("2020-03-01T00:00:00", "ns") + np.arange(50) * np.timedelta64(60, "s")
    report = check_telemetry(Telemetry(time=time, mag_B_nT=np.full((50, 3), np.nan)), load_field("igrf14"))
    assert "no_readings" in {finding.code for finding in report.traps}
    assert report.exit_status == 1


def test_the_axis_that_has_no_reading_is_named(model: FieldModel) -> None:
    record = good(model)
    mag = np.array(record.mag_B_nT)
    mag[:, 2] = np.nan
    (found,) = check_telemetry(record.replace(mag_B_nT=mag), model).traps
    assert found.code == "no_readings" and "on axis z;" in found.text


def test_stamps_outside_the_field_model_are_a_trap():
    time = np.datetime64("2051-03-01T00:00:00", "ns") + np.arange(50) * np.timedelta64(60, "s")
    angle = 0.06 * np.arange(50)
    r = 7000.0 * np.stack([np.cos(angle), np.sin(angle), np.zeros(50)], axis=1)
    mag = 20000.0 * np.stack([np.cos(angle), np.sin(angle), 0.5 + 0.1 * np.sin(angle)], axis=1)
    report = check_telemetry(Telemetry(time=time, mag_B_nT=mag, r_N_km=r), load_field("igrf14"))
    (found,) = [finding for finding in report.traps if finding.code == "outside_field_model"]
    assert "1900" in found.text
    assert "2030" in found.text
    assert not [finding for finding in report.notes if "no positions" in finding.text]


def test_the_wander_of_a_plane_is_that_of_its_normals() -> None:
    tilt = np.radians([1.0, -1.0])
    r, v = np.array([[7000.0, 0.0, 0.0]] * 2), 7.5 * np.stack([0.0 * tilt, np.cos(tilt), np.sin(tilt)], axis=1)
    assert _plane_wander(r, v) == pytest.approx(1.0, rel=1e-4)  # a chord for an arc


def test_errors_are_as_large_in_every_row_and_forget_as_they_say() -> None:
    white, *slow = _covariances(np.array([0.0, 100.0, 700.0]), None, 3, 1)
    assert np.array_equal(white, np.eye(3))
    expected = np.eye(3) + np.exp(-np.array([[0, 1, 7], [1, 0, 6], [7, 6, 0]]))  # 100 s, as large as the noise
    assert np.allclose(slow[0], expected, rtol=1e-12)


def test_mountings_are_turns_by_eighths_and_mirrors() -> None:
    found = np.array([one.matrix for one in mountings()])
    assert len(found) == 48 + 3 * 24 and np.allclose(found @ found.swapaxes(1, 2), np.eye(3), atol=1e-15)
    assert np.allclose(np.sort(np.abs(found), axis=2)[48:, :, :].sum(axis=2).max(axis=1), np.sqrt(2.0))


def test_a_misfit_of_the_size_is_an_rms_by_the_median() -> None:
    size = np.linspace(2e4, 5e4, 9)
    assert _misfit_nT(np.outer(size + 10.0, [0.0, 0.6, 0.8]), size) == pytest.approx(10.0 / norm.ppf(0.75))


@pytest.mark.parametrize("truth", ["NEC", "NED"])
def test_local_axes_that_fit_alike_are_both_named_with_what_settles_it(truth: str, model: FieldModel) -> None:
    """Their verticals are up to 0.19 deg apart, 60 nT: forty rows with 0.3 deg and 130 nT of noise do not distinguish them,
    200 rows with 20 nT do."""
    rng = stream(3, "check.local_axes")
    for rows, alike in ((40, True), (200, False)):
        record = good(model, rows=rows, mode="tumble", altitude_km=500.0, inclination_deg=97.0)
        assert record.q_NB is not None and record.r_N_km is not None
        if not alike:
            field = field_N_nT(model, record.time, np.array(record.r_N_km))
            exact = frames.rotation_from_q(np.array(record.q_NB)).apply(field)
            record = replace(record, mag_B_nT=exact + rng.normal(0.0, 20.0, exact.shape))
        R_XN = references.rotation_XN(truth, record.time, np.array(record.r_N_km))
        relative = frames.q_from_rotation(frames.rotation_from_q(np.array(record.q_NB)) * R_XN.inv())
        (found,) = check_telemetry(replace(record, q_NB=relative), model).traps
        assert found.code == "attitude_convention"
        named = [name for name in ("(NEC)", "(NED)") if name in found.text]
        assert named == (["(NEC)", "(NED)"] if alike else [f"({truth})"]), found.text
        assert ("both are possible. What settles it: the documentation" in found.text) == alike


def column_map(mag: str = "", attitude: str = 'order = "xyzw", relative_to = "GCRS"') -> str:
    """A map for a file with the contract's names, with these keys of the readings and of the attitude."""
    vectors = {"mag": ("mag_{}_nT", "nT"), "position": ("r_{}_km", "km"), "velocity": ("v_{}_km_s", "km/s")}
    rows = []
    for name, (of, unit) in vectors.items():
        keys = [f"from = {json.dumps([of.format(axis) for axis in 'xyz'])}", f'unit = "{unit}"']
        keys += [mag] * bool(mag) if name == "mag" else ['frame = "GCRS"']
        rows.append(f"{name} = {{ {', '.join(keys)} }}")
    rows.append(f'attitude = {{ from = ["q_x", "q_y", "q_z", "q_w"], {attitude} }}')
    return "\n".join(['[[file]]\ntime = { recipe = "iso", columns = "time" }\n[file.columns]', *rows, ""])


@pytest.mark.parametrize("kind", ["quarter", "eighth", "mirrored"])
def test_the_matrix_that_is_advised_puts_the_axes_right(kind: str, model: FieldModel, tmp_path: Path) -> None:
    """The line goes into a column map as it stands."""
    record = good(model, mode="tumble")
    turn = {"quarter": 90.0, "eighth": 45.0, "mirrored": 0.0}[kind]
    matrix = Rotation.from_euler("z", turn, degrees=True).as_matrix() @ np.diag(
        [1.0, 1.0, 1.0 - 2.0 * (kind == "mirrored")]
    )
    path = write_telemetry(record.replace(mag_B_nT=np.array(record.mag_B_nT) @ matrix.T), tmp_path / "t.csv")
    (found,) = check_file(path, model).traps
    assert found.code == "magnetometer_axes"
    line = found.text[found.text.index("matrix = ") :].partition(" for `mag`")[0]
    (tmp_path / "m.toml").write_text(column_map(mag=line), encoding="utf-8")
    assert check_file(path, model, column_map=tmp_path / "m.toml").traps == ()


def test_a_matrix_that_a_map_has_already_is_in_the_one_that_is_advised(model: FieldModel, tmp_path: Path) -> None:
    record = good(model, mode="tumble")
    stored = np.array(record.mag_B_nT) @ Rotation.from_euler("z", 90.0, degrees=True).as_matrix().T
    path = write_telemetry(record.replace(mag_B_nT=stored), tmp_path / "t.csv")
    (tmp_path / "m.toml").write_text(column_map(mag="matrix = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]"), encoding="utf-8")
    (found,) = check_file(path, model, column_map=tmp_path / "m.toml").traps
    line = found.text[found.text.index("matrix = ") :].partition(" for `mag`")[0]
    (tmp_path / "m.toml").write_text(column_map(mag=line), encoding="utf-8")
    assert check_file(path, model, column_map=tmp_path / "m.toml").traps == ()


@pytest.mark.parametrize(
    ("stored", "stated", "wanted"),
    [
        ("wxyz", {}, {"order": "wxyz"}),
        ("wxyz conjugate", {}, {"order": "wxyz", "sense": "conjugate"}),
        ("xyzw", {"order": "wxyz"}, {"order": "xyzw"}),
        ("xyzw", {"sense": "conjugate"}, {"sense": "textbook"}),
        ("wxyz", {"sense": "conjugate"}, {"order": "wxyz", "sense": "textbook"}),
        ("xyzw ITRS", {}, {"relative_to": "ITRS"}),
        ("wxyz ITRS", {}, {"order": "wxyz", "relative_to": "ITRS"}),
    ],
)
def test_the_keys_of_an_attitude_that_are_advised_put_it_right(
    stored: str, stated: dict[str, str], wanted: dict[str, str], model: FieldModel, tmp_path: Path
) -> None:
    """They go into a column map as they stand, beside or in place of what it has."""
    record = good(model, mode="tumble")
    q = np.array(record.q_NB)
    if "ITRS" in stored:
        R_EN = references.rotation_XN("ITRS", record.time, np.array(record.r_N_km))
        q = frames.q_from_rotation(frames.rotation_from_q(q) * R_EN.inv())
    q = q * [-1.0, -1.0, -1.0, 1.0] if "conjugate" in stored else q
    q = q[:, [3, 0, 1, 2]] if "wxyz" in stored else q
    path = write_telemetry(record.replace(q_NB=q), tmp_path / "t.csv")
    keys = {"order": "xyzw", "relative_to": "GCRS"} | stated

    def traps() -> list[str]:
        text = column_map(attitude=", ".join(f'{key} = "{value}"' for key, value in keys.items()))
        (tmp_path / "m.toml").write_text(text, encoding="utf-8")
        said = [found.text for found in check_file(path, model, column_map=tmp_path / "m.toml").traps]
        record = read_telemetry(path, column_map=tmp_path / "m.toml")
        assert [found.text for found in check_telemetry(record, model).traps] == said
        return said

    (found,) = traps()
    needed = found.partition("`attitude` in a column map needs ")[2]
    assert dict(re.findall(r'(\w+) = "(\w+)"', needed)) == wanted, found
    keys |= wanted
    assert traps() == []


def test_a_record_knows_how_it_was_read_until_that_is_changed(model: FieldModel, tmp_path: Path) -> None:
    """Cut, sent elsewhere and joined it does; with another attitude or position, and read from a file of its own, not."""
    path = write_telemetry(good(model, mode="tumble"), tmp_path / "t.csv")
    keys = 'order = "wxyz", sense = "conjugate", relative_to = "ITRS"'
    (tmp_path / "m.toml").write_text(column_map(mag="scale = 2.0", attitude=keys), encoding="utf-8")
    record = read_telemetry(path, column_map=tmp_path / "m.toml")
    wanted = Origin(attitude="ITRS", scalar_first=True, conjugated=True, count_nT=2.0)
    joined = concatenate([record[:300], record[300:]])
    for one in (record, record[::2], record.replace(sunlit=None), joined, pickle.loads(pickle.dumps(record))):
        assert one.origin == wanted
    assert record.replace(q_NB=record.q_NB).origin == Origin(count_nT=2.0)
    fixed = record.replace(origin=replace(wanted, position="ITRS"))
    assert fixed.replace(r_N_km=record.r_N_km).origin == wanted
    assert read_telemetry(write_telemetry(record, tmp_path / "t.nc")).origin == Origin()
    plain = concatenate([record[:300], record[300:].replace(origin=Origin())])
    assert plain.origin == Origin()


@pytest.mark.parametrize(("count", "key"), [(-32768, "fill"), (0, "invalid")])
def test_a_number_on_all_axes_is_called_a_fill_value_with_the_line_for_it(
    count: int, key: str, model: FieldModel, tmp_path: Path
) -> None:
    record = good(model, mode="tumble")
    mag = np.round(np.array(record.mag_B_nT) / 10.0) * 10.0
    mag[[30, 60, 61, 90]] = 10.0 * count
    path = write_telemetry(record.replace(mag_B_nT=mag / 10.0), tmp_path / "t.csv")
    (tmp_path / "m.toml").write_text(column_map(mag="scale = 10"), encoding="utf-8")
    (found,) = check_file(path, model, column_map=tmp_path / "m.toml").traps
    assert found.code == "stuck_values" and f"Of these, 4 have {10 * count} nT on all axes" in found.text
    line = found.text.partition("`mag` in a column map needs ")[2].partition(". ")[0]
    assert line == f"{key} = [{count}]"
    (tmp_path / "m.toml").write_text(column_map(mag=f"scale = 10, {line}"), encoding="utf-8")
    assert check_file(path, model, column_map=tmp_path / "m.toml").traps == ()


def test_terrestrial_time_is_a_clock_that_is_tried(model: FieldModel) -> None:
    """TT - UTC is 69.184 s since 2017, 65.184 s before mid 2012 (IERS Bulletin C and the definition of TT)."""
    from astropy.time import Time

    for stamp in ("2020-05-01T00:00:00", "2011-05-01T00:00:00"):
        tt_s = float((Time(Time(stamp, scale="utc").tt.iso, scale="utc") - Time(stamp, scale="utc")).sec)
        record = good(model, mode="tumble", rows=400)
        record = record.replace(time=np.datetime64(stamp, "ns") + (record.time - record.time[0]))
        sample = comparable(record, model, np.ones(len(record), dtype=bool), with_attitude=False)
        assert sample is not None
        (tried,) = [shift for shift, words in shifts_s(sample).items() if words.startswith("TT") and shift > 0.0]
        assert tried == pytest.approx(tt_s, abs=1e-6)
        assert 'or time.scale = "TT"' in named_shift(tried, shifts_s(sample)[tried], 900.0, 30.0)
        assert 'or time.scale = "UTC"' in named_shift(-tried, shifts_s(sample)[-tried], 900.0, 30.0)


def test_two_rows_between_gaps_do_not_end_a_check(model: FieldModel) -> None:
    """They have no velocity of their own, which an attitude relative to the orbital frame needs."""
    rows = np.r_[0:200, 300:302, 400:600]
    record = good(model).replace(v_N_km_s=None).select(rows)
    found = comparable(record, model, np.ones(rows.size, dtype=np.bool_), with_attitude=True)
    assert found is not None and len(found) == rows.size - 2
    assert np.isfinite(found.v_N_km_s).all()
    assert [one.severity for one in check_clock(found, model, Origin(attitude="orbital"))] == ["note"]


@pytest.mark.parametrize("rows", [2, 3, 6])
@pytest.mark.parametrize("what", ["reading", "attitude", "position"])
def test_what_is_repeated_between_its_samples_is_named(what: str, rows: int, model: FieldModel) -> None:
    record = good(model, mode="tumble")
    column = {"reading": "mag_B_nT", "attitude": "q_NB", "position": "r_N_km"}[what]
    held = np.array(getattr(record, column))[np.arange(len(record)) // rows * rows]
    (found,) = check_telemetry(record.replace(**{column: held}, v_N_km_s=None), model).traps
    assert found.code == "held" and f"the {what} lasts for {rows} rows" in found.text
    assert found.row_count == len(record) - len(record) // rows and found.rows[0] == 2


def test_samples_of_a_rate_that_is_no_multiple_are_seen_to_be_held(model: FieldModel) -> None:
    record = good(model, mode="tumble")
    held = np.array(record.mag_B_nT)[(np.arange(len(record)) * 0.4).astype(int)]
    (found,) = (one for one in check_telemetry(record.replace(mag_B_nT=held), model).traps if one.code == "held")
    assert "lasts for 2 to 3 rows" in found.text


@pytest.mark.parametrize("step_s", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("mode", ["earth", "hold", "spin", "tumble", "wide"])
def test_coarse_steps_of_what_moves_slowly_are_not_held(mode: str, step_s: float, model: FieldModel) -> None:
    """They repeat values too, and for long, but go on by a step."""
    record = good(model, 3, mode=mode, step_s=step_s, rows=1500)
    turn = Rotation.from_rotvec([0.3, 0.5, 0.7]).as_matrix()
    for step_nT in (500.0, 2000.0):
        mag = np.round(np.array(record.mag_B_nT) / step_nT) * step_nT
        assert check_held(record.replace(mag_B_nT=mag))[0] == []
        assert check_held(record.replace(mag_B_nT=mag @ turn))[0] == []
    for step in (1e-2, 1e-3):
        assert _held(np.round(np.array(record.q_NB) / step) * step) is None
    for step in (1.0, 10.0):
        assert _held(np.round(np.array(record.r_N_km) / step) * step) is None
    assert check_held(record.replace(q_NB=np.array(record.q_NB)[[0] * len(record)]))[0] == []
