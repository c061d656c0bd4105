"""Fields that follow columns, estimated beside S and b where the columns go with the attitude.

The payload is on while the body leans forward, the array's current follows the sun's direction in the body. Regressed on
such a column alone, an axis of the reading gives coefficients that are mostly the Earth's field turning with the attitude:
off by hundreds of their own sigmas. Beside the reference field they come back within their sigmas, and S and b with them.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm
from worlds import scenario_text

from fluxtwin.calib.common.apply import apply_calibration
from fluxtwin.calib.common.drivers import _Late, _likeliest, _with_lateness, distinguishable
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.onboard import composed
from fluxtwin.calib.common.records import Calibration, Onboard, TelemetryBias, seconds_of
from fluxtwin.calib.linear.calibrate import _products
from fluxtwin.calib.methods import calibrate_by
from fluxtwin.calib.scalar.calibrate import _drops
from fluxtwin.calib.scalar.rows import assemble_scalar
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.late import late
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

SECTIONS = """
[attitude]
yaw_rms_deg = 25.0
roll_rms_deg = 15.0
pitch_rms_deg = 15.0
[attitude.reference]
sigma_deg = 0.05
tau_s = 300.0
[magnetometer]
S = [[0.02, 0.004, -0.003], [-0.009, 0.014, 0.008], [0.014, -0.004, -0.007]]
b_nT = [300.0, -200.0, 100.0]
noise_nT = 10.0
[torquers]
dipole_Am2 = 20.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [1.5, 0.0, 0.0]]
"""
ROWS, STEP_S, RUNS, LATE_RUNS = 1000, 15.0, 10, 6
S = np.array([[0.02, 0.004, -0.003], [-0.009, 0.014, 0.008], [0.014, -0.004, -0.007]])
B_NT = np.array([300.0, -200.0, 100.0])
K = {"driver_array": np.array([-0.03, 0.02, 0.045]), "driver_payload": np.array([60.0, -40.0, 25.0])}
"""In the reading: nT/mA and nT while on."""
SWITCH_NT = np.array([60.0, -40.0, 25.0])
ALARM = 1e-4


@cache
def flown(seed: int, *, noise: bool = True, torquers: bool = False, wrong_S: bool = True) -> Telemetry:
    """A record with two columns that go with the attitude, and their fields in the reading."""
    scenario = parse_scenario(scenario_text(SECTIONS, seed=seed, segment=f"samples = {ROWS}, step_s = {STEP_S}"))
    changes: dict[str, Any] = {} if torquers else {"torquers.activity": "off"}
    changes |= {} if noise else {"magnetometer.noise_nT": None, "attitude.reference": None}
    changes |= {} if wrong_S else {"magnetometer.S": None}
    record, truth = simulate(scenario.updated(changes))
    R_BN = frames.rotation_from_q(truth.q_NB)
    sun_B = R_BN.apply(sun.sun_direction_N(truth.time, truth.r_N_km))
    down_B = R_BN.apply(-truth.r_N_km / np.linalg.norm(truth.r_N_km, axis=1)[:, None])
    array_mA = 3000.0 * np.maximum(-sun_B[:, 2], 0.0) * np.array(record.sunlit)
    columns = {"driver_array": array_mA, "driver_payload": (down_B[:, 0] > 0.05).astype(float)}
    field = sum(np.outer(column, K[name]) for name, column in columns.items())
    drivers = {name.removeprefix("driver_"): column for name, column in columns.items()}
    return record.replace(mag_B_nT=record.mag_B_nT + field, drivers=drivers)


TUMBLING = """
[attitude]
mode = "tumble"
rate_deg_s = [1.5, 0.8, -1.1]
[magnetometer]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 50.0
"""
INERTIA = [[0.02, 0.0, 0.0], [0.0, 0.025, 0.0], [0.0, 0.0, 0.03]]
LATE = {"driver_array": (0.0, 120.0), "driver_payload": (45.0, 0.0)}
"""Delay and lag of their fields [s]."""


@cache
def late_flown(seed: int) -> Telemetry:
    """The same record with fields that come late."""
    record = flown(seed)
    seconds, B = seconds_of(record.time), np.array(record.mag_B_nT)
    for name, k in K.items():
        column = record.drivers[name.removeprefix("driver_")]
        B += np.outer(late(seconds, column, *LATE[name]) - column, k)
    return record.replace(mag_B_nT=B)


def fit_of(record: Telemetry, **options: Any) -> Fit:
    return calibrate_by(record, load_field(), **options)


def error_of_drivers(fit: Fit) -> FloatArray:
    found = fit.calibration.telemetry_bias
    return np.concatenate([found[name].value_nT - K[name] for name in found])


@cache
def fits() -> tuple[Fit, ...]:
    """One for each seed, both ways in turn."""
    methods = ("linear", "forward")
    return tuple(fit_of(flown(seed), method=methods[seed % 2], driver=["array", "payload"]) for seed in range(RUNS))


@cache
def runs() -> tuple[tuple[FloatArray, FloatArray, FloatArray, FloatArray], ...]:
    """For each seed: errors of S and b with their covariance, and those of the drivers."""
    made = []
    for fit in fits():
        error = fit.calibration.values - np.concatenate([S.ravel(), B_NT])
        made.append((error, fit.calibration.covariance, error_of_drivers(fit), fit.driver_covariance))
    return tuple(made)


def test_everything_comes_back_within_its_covariance() -> None:
    """e' C^-1 e is chi-square; each sum over the runs lies between its quantiles, both ways, with 1 - 1e-4."""
    for first, size in ((0, 12), (2, 6)):
        total = sum(float(run[first] @ np.linalg.solve(run[first + 1], run[first])) for run in runs())
        low, high = chi2.ppf([ALARM / 2.0, 1.0 - ALARM / 2.0], size * RUNS)
        assert low < total < high, (size, total / size / RUNS)


def test_every_coefficient_is_within_its_sigma() -> None:
    """Of the runs, one by one, as many within 1.96 sigma as the binomial law allows: 1e-4 over the 18 parameters."""
    least, farthest = binom.ppf(ALARM / 18.0, RUNS, 0.95), norm.isf(ALARM / 36.0)
    for first in (0, 2):
        pulls = np.array([run[first] / np.sqrt(np.diag(run[first + 1])) for run in runs()])
        assert ((np.abs(pulls) < 1.96).sum(axis=0) >= least).all()
        assert np.abs(pulls.mean(axis=0)).max() * np.sqrt(RUNS) < farthest, "nor is the mean off"


def test_methods_with_a_constant_field_have_what_the_column_leaves_open_in_their_sigmas() -> None:
    """TWOSTEP and |B| by maximum likelihood are one estimate of the same rows: sigmas agree to 5 %; those of readings
    that the true fields have left are smaller. CENTER comes back over the runs within the quantiles, with 1 - 1e-4."""
    record = flown(0)
    white: Any = {"driver": ["array", "payload"], "covariance": "white"}
    joint, found = (fit_of(record, method=name, **white) for name in ("scalar", "twostep"))
    assert np.array_equal(error_of_drivers(found), error_of_drivers(joint))
    assert found.calibration.method.endswith("field of driver_array and driver_payload taken out first")
    assert found.calibration.sigmas == pytest.approx(joint.calibration.sigmas, rel=0.05)
    field = sum(np.outer(record.drivers[name.removeprefix("driver_")], k) for name, k in K.items())
    known = fit_of(record.replace(mag_B_nT=record.mag_B_nT - field), method="twostep", covariance="white").calibration
    assert (joint.calibration.sigmas / known.sigmas)[9:].max() > 1.2
    total = 0.0
    for seed in range(RUNS):
        fit = fit_of(flown(seed, wrong_S=False), method="center", driver=["array", "payload"])
        error = fit.calibration.b_nT - B_NT
        total += float(error @ np.linalg.solve(fit.calibration.covariance[9:, 9:], error))
    low, high = chi2.ppf([ALARM / 2.0, 1.0 - ALARM / 2.0], 3 * RUNS)
    assert low < total < high


@cache
def late_runs() -> tuple[Fit, ...]:
    methods = ("linear", "forward", "scalar")
    return tuple(
        fit_of(late_flown(seed), method=methods[seed % 3], driver=["all"]) for seed in range(50, 50 + LATE_RUNS)
    )


def test_a_late_field_is_found_late_and_its_size_within_its_covariance() -> None:
    """e' C^-1 e of six coefficients over the runs, both ways, with 1 - 1e-4; a switch shows to the spacing of rows."""
    total = 0.0
    for fit in late_runs():
        found = fit.calibration.telemetry_bias
        assert list(found) == list(K)
        payload, array = found["driver_payload"], found["driver_array"]
        assert 30.0 < payload.delay_s <= 45.0 and payload.lag_s < 5.0
        assert abs(array.delay_s + array.lag_s - 120.0) < 60.0
        error = error_of_drivers(fit)
        total += float(error @ np.linalg.solve(fit.driver_covariance, error))
    low, high = chi2.ppf([ALARM / 2.0, 1.0 - ALARM / 2.0], 6 * LATE_RUNS)
    assert low < total < high, total / 6 / LATE_RUNS


@pytest.mark.parametrize("method", ["linear", "scalar"])
def test_a_delay_and_a_lag_together_are_told_apart(method: str) -> None:
    """20 s of delay, then a lag of 30 s, behind a switch: e' C^-1 e of three coefficients over the seeds, with 1 - 1e-4."""
    total = 0.0
    for seed in range(4):
        text = scenario_text(TUMBLING, segment="samples = 500, step_s = 4.0", seed=400 + seed, inertia_kg_m2=INERTIA)
        record, _ = simulate(parse_scenario(text, where="test"))
        on = stream(seed, "test.switch").integers(0, 2, 56).astype(float).repeat(9)[:500]
        B = record.mag_B_nT + np.outer(late(seconds_of(record.time), on, 20.0, 30.0), 5.0 * SWITCH_NT)
        fit = fit_of(record.replace(mag_B_nT=B, drivers={"switch": on}), method=method, driver=["switch"])
        error = fit.calibration.telemetry_bias["driver_switch"].value_nT - 5.0 * SWITCH_NT
        total += float(error @ np.linalg.solve(fit.driver_covariance, error))
    assert total < chi2.ppf(1.0 - ALARM, 12)


def strongly_late(seed: int, delays_s: tuple[float, ...]) -> tuple[Telemetry, FloatArray]:
    """A record with currents of 80 mA at most that change every five minutes, fields of some 6 nT/mA that follow them late,
    and the fields."""
    record, rng = flown(seed), np.random.default_rng(seed)
    B = record.mag_B_nT - sum(np.outer(record.drivers[name.removeprefix("driver_")], k) for name, k in K.items())
    seconds, field = seconds_of(record.time), np.zeros((ROWS, 3))
    currents = {}
    for name, delay_s, k in zip("xyz", delays_s, np.diag([-6.0, 5.0, -8.0]) + 0.3, strict=False):
        currents[f"mtq_{name}"] = np.repeat(rng.uniform(-80.0, 80.0, ROWS // 20), 20)
        field += np.outer(late(seconds, currents[f"mtq_{name}"], delay_s, 0.0), k)
    return record.replace(mag_B_nT=B + field, drivers=currents), field


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("seed", [31, 32])
@pytest.mark.parametrize("delays_s", [(40.0,), (40.0, 55.0, 25.0)])
def test_a_strong_field_that_is_late_leaves_no_outliers(delays_s: tuple[float, ...], seed: int) -> None:
    """Rows that it reaches late lie forty times the noise away from a fit without a delay, and are not its outliers. What
    switches between two rows is known to a row."""
    record, field = strongly_late(seed, delays_s)
    broken = np.array(record.mag_B_nT)
    broken[100:900:100, 1] += 4096.0
    fit = fit_of(record.replace(mag_B_nT=broken), driver=["all"])
    found = [bias.delay_s + bias.lag_s for bias in fit.calibration.telemetry_bias.values()]
    assert np.abs(np.subtract(found, delays_s)).max() <= STEP_S
    assert set(np.flatnonzero(~fit.kept)) >= set(range(100, 900, 100)) and (~fit.kept).sum() < 15
    left = (
        apply_calibration(record, fit.calibration).mag_B_nT
        - apply_calibration(
            record.replace(mag_B_nT=record.mag_B_nT - field), dataclasses.replace(fit.calibration, telemetry_bias={})
        ).mag_B_nT
    )
    assert np.median(np.abs(left)) < 10.0, "less than the noise, but for rows in which it switches"


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(
    ("lateness", "options"),
    [
        ([(60.0, 0.0)], {"method": "linear"}),
        ([(60.0, 0.0)], {"method": "scalar"}),
        ([(60.0, 0.0)] * 3, {"method": "scalar"}),
        ([(60.0, 0.0), (30.0, 0.0), (105.0, 0.0)], {"method": "linear"}),
        ([(60.0, 0.0), (30.0, 0.0), (105.0, 0.0)], {"method": "scalar"}),
        ([(0.0, 45.0), (60.0, 0.0), (0.0, 0.0)], {"method": "scalar"}),
        ([(60.0, 0.0)] * 3, {"method": "scalar", "robust": "none"}),
        ([(0.0, 0.0)] * 3, {"method": "scalar"}),
    ],
)
def test_a_strong_field_is_found_as_late_as_it_is(lateness: list[tuple[float, float]], options: dict[str, Any]) -> None:
    """To 6 %, two of the search's last steps, and half a row; also halfway between two delays that are tried, where no row
    is near enough to count until the search has moved. Bit errors beside are left out, and of the other rows 1 % at most:
    where a current changes, that much of a delay moves a field by ten sigma."""
    for seed in (2,) if options["method"] == "linear" else (0, 1, 2):
        record, rng = flown(seed), stream(seed, "test.strong")
        seconds, B = seconds_of(record.time), np.array(record.mag_B_nT)
        for name, k in K.items():
            B -= np.outer(record.drivers[name.removeprefix("driver_")], k)
        currents_mA, k = {}, np.diag([6.0, -5.0, 8.0]) + 0.3
        for j, one in enumerate(lateness):
            currents_mA[f"mtq_{j}"] = rng.choice([-80.0, 0.0, 40.0, 80.0], ROWS // 20).repeat(20)
            B += np.outer(late(seconds, currents_mA[f"mtq_{j}"], *one), k[j])
        size = 0 if "robust" in options else 15
        bad = rng.choice(ROWS, size, replace=False), rng.integers(0, 3, size)
        B[bad] += np.sign(B[bad]) * 2.0 ** rng.integers(12, 15, size)  # away from zero: |B| shows it
        fit = fit_of(record.replace(mag_B_nT=B, drivers=currents_mA), driver=["all"], **options)
        found = fit.calibration.telemetry_bias
        assert list(found) == [f"driver_{name}" for name in currents_mA]
        for j, (bias, wanted) in enumerate(zip(found.values(), lateness, strict=True)):
            off = np.abs(np.subtract((bias.delay_s, bias.lag_s), wanted))
            assert off.max() <= (0.06 * sum(wanted) + STEP_S / 2.0 if any(wanted) else 0.0), (seed, j, bias)
            assert np.abs(bias.value_nT - k[j]).max() < 0.3
        assert not fit.kept[bad[0]].any()
        assert fit.rejected <= size + ROWS // 100


def test_a_field_that_is_not_late_is_not_called_late() -> None:
    """At most one of these 20 columns: by chance one in a hundred is."""
    found = [fit.calibration.telemetry_bias for fit in fits()]
    assert sum(bool(one.delay_s or one.lag_s) for biases in found for one in biases.values()) <= 1


def switched(sigma_deg: float) -> dict[str, TelemetryBias]:
    """The field of a switch, with an attitude that is off by so much, by what the errors are and by the white covariance."""
    scenario = parse_scenario(scenario_text(SECTIONS, seed=9, segment=f"samples = {ROWS}, step_s = {STEP_S}"))
    changes = {"torquers.activity": "off", "attitude.reference.sigma_deg": sigma_deg}
    record, _ = simulate(scenario.updated(changes))
    switch = (np.arange(ROWS) % 113 < 45).astype(float)
    record = record.replace(mag_B_nT=record.mag_B_nT + np.outer(switch, SWITCH_NT), drivers={"switch": switch})
    fits = {kind: fit_of(record, driver=["switch"], covariance=kind) for kind in ("blocks", "white")}
    return {kind: fit.calibration.telemetry_bias["driver_switch"] for kind, fit in fits.items()}


def test_columns_are_heard_through_errors_of_the_attitude() -> None:
    """Weighted by what the errors are: half the sigmas of least squares at least, which the white covariance leaves."""
    errors = {kind: np.abs(found.value_nT - SWITCH_NT).max() for kind, found in switched(0.3).items()}
    assert errors["blocks"] < 0.5 * errors["white"]


def test_where_errors_are_white_weights_cost_nothing() -> None:
    """An attitude error of 2 nT beside noise of 10 nT: least squares is best (Gauss-Markov), and weights are alike."""
    found = switched(0.003)
    assert (found["blocks"].sigma_nT < 1.25 * found["white"].sigma_nT).all()


def test_an_error_of_the_lateness_is_in_the_covariance(close: Any) -> None:
    """One sigma, a tenth of 40 s of delay and 20 s of lag, moves b by 6 nT; one of the share, 8 s of the delay, by 8 nT."""
    fit = fit_of(flown(0), driver=["payload"], covariance="white")
    held = fit.calibration

    def again(name: str, other: tuple[float, float]) -> Fit:
        moved = 6.0 if other == (44.0, 22.0) else other[0] - 40.0
        return dataclasses.replace(fit, calibration=dataclasses.replace(held, b_nT=held.b_nT + moved))

    found = _Late(40.0, 20.0, ((44.0, 22.0), (48.0, 12.0)))
    wider = _with_lateness(fit, {"driver_payload": found}, again).calibration.covariance
    added = np.zeros((12, 12))
    added[9:, 9:] = 36.0 + 64.0
    close(wider - held.covariance, added, atol=1e-9, unit="nT^2", because="rounding")


def test_a_column_of_noise_lowers_chi_square_by_half_its_parameters(close: Any) -> None:
    """Of |B|, by three halves: white rows count as half as many, since the least correlation time is a step, also where that
    is a second. Half of chi-square with 3 degrees of freedom has a spread of 1.22; the mean of 400 draws, 0.061."""
    segment = f"samples = {ROWS}, step_s = 1.0"
    scenario = parse_scenario(scenario_text(SECTIONS, seed=11, segment=segment))
    record, _ = simulate(scenario.updated({"torquers.activity": "off", "magnetometer.S": None}))
    rng = stream(11, "test.noise")
    record = record.replace(drivers={"x": rng.normal(size=ROWS)})
    fit = fit_of(record, method="scalar", parameters="b", driver=["x"])
    columns = {"driver_x": record.drivers["x"]}
    rows = assemble_scalar(record, load_field(), with_dipole=False, drivers=columns)
    found = _drops(fit, rows, columns, "driver_x", rng.normal(size=(ROWS, 400)))
    close(found.mean(), 1.5, atol=0.25, unit="1", because="four sigma of the mean")


def test_an_axis_against_a_current_alone_takes_the_attitude_for_a_field() -> None:
    """The negative control: the same columns and readings, without the reference."""
    record = flown(0)
    for name, k in K.items():
        column = record.drivers[name.removeprefix("driver_")]
        x = np.column_stack([np.ones(ROWS), column])
        found = np.linalg.lstsq(x, record.mag_B_nT, rcond=None)[0]
        assert np.abs(found[1] - k).max() > 50.0 * np.abs(k).max()


def test_what_is_late_is_applied_late_also_from_its_file(tmp_path: Path) -> None:
    record = late_flown(50)
    known = Calibration(S, B_NT, telemetry_bias={name: TelemetryBias(K[name], np.zeros(3), *LATE[name]) for name in K})
    held = Calibration.from_toml(known.to_toml(tmp_path / "c.toml"))
    at_once = dataclasses.replace(
        known,
        telemetry_bias={
            name: dataclasses.replace(one, delay_s=0.0, lag_s=0.0) for name, one in known.telemetry_bias.items()
        },
    )
    wanted = apply_calibration(flown(50), at_once).mag_B_nT
    assert np.abs(apply_calibration(record, held).mag_B_nT - wanted).max() < 1e-9
    assert np.abs(apply_calibration(record, at_once).mag_B_nT - wanted).max() > 50.0


@pytest.mark.parametrize("lateness_s", [(60.0, 0.0), (0.0, 40.0)])
def test_a_value_that_is_missing_stays_missing_where_the_field_is_late(lateness_s: tuple[float, float]) -> None:
    """A calibration without a delay leaves just these rows blank; a held value would be wrong by the whole field."""
    record = flown(51)
    known = Calibration(
        S, B_NT, telemetry_bias={"driver_array": TelemetryBias(K["driver_array"], np.zeros(3), *lateness_s)}
    )
    whole = apply_calibration(record, known).mag_B_nT
    blank = np.array(record.drivers["array"])
    blank[:5] = blank[400:500] = blank[-20:] = np.nan
    there = apply_calibration(record.replace(drivers={**record.drivers, "array": blank}), known).mag_B_nT
    known_rows = np.isfinite(there).all(axis=1)
    rows = round(sum(lateness_s) / STEP_S)
    for first, end in ((0, 5), (400, 500), (ROWS - 20, ROWS)):
        assert not known_rows[min(first + rows, ROWS - 1) : min(end + rows, ROWS)].any()
    assert known_rows.sum() >= ROWS - 125 - 3 * 5 * rows, "a lag forgets within five of its lengths"
    most_nT = 0.01 * np.abs(K["driver_array"]).max() * np.ptp(record.drivers["array"])
    assert np.abs(there - whole)[known_rows].max() < 1.03 * most_nT


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("method", ["linear", "forward", "scalar"])
def test_of_all_columns_those_that_drive_are_kept_and_the_others_named(method: str) -> None:
    record, rng = flown(3), stream(3, "test.junk")
    junk: dict[str, FloatArray] = {f"noise_{k}": rng.normal(size=ROWS) for k in range(4)}
    junk |= {f"walk_{k}": np.cumsum(rng.normal(size=ROWS)) for k in range(4)}
    junk |= {f"switch_{k}": (np.arange(ROWS) % (40 + 37 * k) < 20.0).astype(float) for k in range(4)}
    junk |= {"bus": np.full(ROWS, 28.0), "copy": 2.0 - 3.0 * record.drivers["payload"]}
    junk["rare"] = np.where(np.arange(ROWS) % 3 == 0, record.drivers["array"], np.nan)
    fit = fit_of(record.replace(drivers={**record.drivers, **junk}), method=method, driver=["all"])
    assert set(fit.calibration.telemetry_bias) == {"driver_array", "driver_payload"}
    assert len(fit.time) == ROWS, "a column that is mostly blank costs no rows"
    said = " ".join(fit.messages)
    for name in set(junk) - {"bus", "copy", "rare"}:
        assert f"driver_{name} (" in said.split("Dropped")[1]
    assert "driver_bus was not tried: it never changes" in said
    assert "driver_copy was not tried: it goes together with driver_payload" in said
    assert "driver_rare was not tried: it is known in 33 % of the rows" in said


@pytest.mark.usefixtures("few_draws")
def test_where_none_drives_none_is_kept() -> None:
    record, rng = flown(4), stream(4, "test.junk")
    quiet = record.replace(
        mag_B_nT=record.mag_B_nT - sum(np.outer(record.drivers[n.removeprefix("driver_")], k) for n, k in K.items()),
        drivers={**record.drivers, **{f"walk_{k}": np.cumsum(rng.normal(size=ROWS)) for k in range(8)}},
    )
    fit = fit_of(quiet, driver=["all"])
    assert not fit.calibration.telemetry_bias
    assert any(message.startswith("kept of 10 columns: none") for message in fit.messages)
    asked = fit_of(quiet, driver=["payload"])
    assert any("no field of driver_payload is significant" in message for message in asked.messages)
    plain = fit_of(quiet)
    assert np.array_equal(fit.calibration.values, plain.calibration.values)


@pytest.mark.parametrize("parameters", ["b", "b,S", "b,S,T"])
@pytest.mark.parametrize("method", ["linear", "forward", "scalar"])
def test_without_noise_everything_is_exact(method: str, parameters: str) -> None:
    """Whatever stands beside them; without attitude S is symmetric, which that of the truth is not.

    The searches for |B| end where a step is 1e-8 of the field: 3e-4 nT, ten times that in b.
    """
    record = flown(5, noise=False, torquers="T" in parameters, wrong_S="S" in parameters and method != "scalar")
    fit = fit_of(record, method=method, parameters=parameters, driver=["array", "payload"], robust="none")
    assert np.abs(fit.calibration.S - (S if "S" in parameters and method != "scalar" else 0.0)).max() < 1e-7
    assert np.abs(fit.calibration.b_nT - B_NT).max() < 3e-3
    assert np.abs(error_of_drivers(fit) / np.abs(np.concatenate(list(K.values())))).max() < 1e-4


def test_a_written_file_takes_the_fields_out_again(tmp_path: Path) -> None:
    record = flown(7)
    fit = fit_of(record, driver=["array", "payload"])
    known = Calibration.from_toml(fit.calibration.to_toml(tmp_path / "known.toml"))
    assert list(known.telemetry_bias) == ["driver_array", "driver_payload"]
    corrected = apply_calibration(record, known)
    without = apply_calibration(record, dataclasses.replace(known, telemetry_bias={}), force=True)
    moved = without.mag_B_nT - corrected.mag_B_nT
    wanted = (np.eye(3) + known.S) @ known.telemetry_bias["driver_payload"].value_nT
    on = (record.drivers["payload"] > 0.0) & (record.drivers["array"] == 0.0)
    assert np.abs(moved[on] - wanted).max() < 1e-9
    with pytest.raises(BadInput, match=r"driver_array.* lacks the column"):
        apply_calibration(record.replace(drivers={}), known)


def test_what_was_done_on_board_is_composed_with_a_column() -> None:
    """m' = M (m - o) is what comes down: the field of the column is in it as M s."""
    rng = stream(1, "test.onboard")
    bias = {"driver_x": TelemetryBias(np.array([5.0, -3.0, 2.0]), np.array([0.1, 0.2, 0.3]))}
    M, o = np.eye(3) + 0.05 * rng.normal(size=(3, 3)), np.array([100.0, -50.0, 20.0])
    known = Calibration(S, B_NT, telemetry_bias=bias, onboard=Onboard("table", M, o))
    reading, columns = rng.normal(size=(9, 3)) * 3e4, {"driver_x": rng.normal(size=9)}
    assert known.onboard is not None
    down = (reading - o) @ M.T
    there = composed(known, known.onboard).apply(down, columns=columns)
    assert np.abs(there - known.apply(reading, columns=columns)).max() < 1e-8


def test_the_step_of_the_readings_is_found_beside_a_field() -> None:
    """Readings less a field have lost the step in which they came."""
    record = flown(0)
    coarse = record.replace(mag_B_nT=10.0 * np.rint(record.mag_B_nT / 10.0))
    for method in ("linear", "forward", "scalar"):
        assert any("LSB 10.0 nT found" in said for said in fit_of(coarse, method=method, driver=["payload"]).messages)


@pytest.mark.parametrize(
    ("method", "names", "said"),
    [
        ("linear", ["paylod"], "'payload' is near"),
        ("scalar", ["flag_x"], "the telemetry has no column 'flag_x'"),
        ("linear", ["mag_x_nT"], "'mag_x_nT' is not taken .*Wanted: a copy of the column called driver_NAME"),
    ],
)
def test_a_column_that_is_not_there_is_refused(method: str, names: list[str], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        fit_of(flown(0), method=method, driver=names)


def test_a_record_without_columns_says_how_to_name_one() -> None:
    with pytest.raises(BadInput, match=r"no column 'payload'\. Wanted: a column driver_NAME in the telemetry"):
        fit_of(flown(0).replace(drivers={}, driver_units={}, sunlit=None), method="linear", driver=["payload"])


@pytest.mark.parametrize(
    ("column", "said"),
    [
        (lambda r: np.full(ROWS, 3.3), "driver_x cannot be estimated: it never changes"),
        (lambda r: 1.0 - 2.0 * r.drivers["payload"], "goes together with driver_payload"),
    ],
)
def test_a_column_that_cannot_be_distinguished_is_refused(column: Any, said: str) -> None:
    record = flown(0)
    changed = record.replace(drivers={**record.drivers, "x": column(record)})
    for method in ("linear", "scalar"):
        with pytest.raises(NoAnswer, match=said):
            fit_of(changed, method=method, driver=["payload", "x"])


def test_what_can_be_distinguished_beside_the_field() -> None:
    rng = stream(2, "test.apart")
    field, free = 3e4 * rng.normal(size=(500, 3)), rng.normal(size=500)
    columns = {
        "free": free,
        "along": 2.0 * field[:, 0] - field[:, 2] + 7.0,
        "mixed": field[:, 1] * 1e-4 + free,
        "weak": field[:, 0] * 1e-4 + 0.01 * rng.normal(size=500),
        "zero": np.zeros(500),
    }
    kept, why = distinguishable(columns, field)
    assert kept == ("free", "weak")
    assert why["along"].startswith("it follows the field")
    assert why["mixed"].startswith("it is a combination of the field")
    assert why["zero"].startswith("it never changes")


def test_a_driver_that_is_not_modelled_is_said_to_be_a_slow_error_and_not_noise(close) -> None:
    """The fields are 40 nT rms, the noise of a reading 10 nT; what is expected is of the noise that the verdict states."""
    without, with_them = fit_of(flown(0)), fits()[0]
    for fit, slow in ((without, True), (with_them, False)):
        (words,) = (message for message in fit.messages if message.startswith("covariance"))
        assert ("slow errors of" in words, "white noise of" in words) == (slow, False), words
        model, field_nT = fit.error_model, np.linalg.norm(flown(0).mag_B_nT, axis=1)
        assert model is not None and model.attitude_sigma_deg is not None
        noise_nT = float(np.sqrt(fit.noise.variance_nT2.mean()))
        close(noise_nT, 10.0, atol=2.0, unit="nT", because="found in a thousand rows, of which switches are a few")
        across_nT = np.radians(model.attitude_sigma_deg) * np.sqrt((field_nT**2).mean() * 2.0 / 3.0)
        stated = np.hypot(noise_nT, across_nT)
        close(model.expected_rms_nT / stated, 1.0, atol=0.03, unit="1", because="|B| is read, with S of 2 %")


def test_products_of_columns_are_those_of_generalized_least_squares() -> None:
    """Noise of 20, 30 and 40 nT, and a white attitude error of 0.1 deg: in a row their covariances add up, and its products
    are X' C^-1 X, added over the rows."""
    rng = np.random.default_rng(5)
    H, B, part = 3e4 * rng.standard_normal((6, 3)), 3e4 * rng.standard_normal((6, 3)), rng.standard_normal(6)
    errors = SimpleNamespace(
        white_nT=np.array([20.0, 30.0, 40.0]), attitude_sigma_deg=0.1, attitude_tau_s=None, slow_nT=0.0, slow_tau_s=0.0
    )
    fit: Any = SimpleNamespace(error_model=errors, calibration=SimpleNamespace(S=np.zeros((3, 3))))
    time = np.datetime64("2020-03-01", "ns") + 10_000_000_000 * np.arange(6)
    design: Any = SimpleNamespace(H_nT=H, time=time)
    wanted = np.zeros((4, 4))
    for field, reading, share in zip(H, B, part, strict=True):
        C = np.diag([400.0, 900.0, 1600.0])
        C += np.radians(0.1) ** 2 * (field @ field * np.eye(3) - np.outer(field, field))
        X = np.column_stack([share * np.eye(3), reading - field])
        wanted += X.T @ np.linalg.solve(C, X)
    found = _products(fit, design, np.arange(6), [part], (B - H)[:, :, None])
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-12)


def test_of_delays_that_are_alike_but_for_rounding_the_first_is_taken() -> None:
    assert _likeliest(np.array([1.0, 5.0 - 1e-12, 5.0, 4.0])) == 1


def test_a_recorded_current_that_all_does_not_try_is_named() -> None:
    record = flown(90).replace(drivers={}, array_current_A=np.linspace(0.0, 1.0, ROWS))
    fit = fit_of(record, driver=["all"])
    assert "array_current_A was not tried: it is no driver_NAME. --driver array_current_A asks for it" in fit.messages
