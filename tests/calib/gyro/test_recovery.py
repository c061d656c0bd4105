"""From gyro and magnetometer alone: S, b and the gyro's bias come back within their sigmas; what is not seen is refused."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from worlds import scenario_text

import fluxtwin
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.records import seconds_of
from fluxtwin.calib.gyro import calibrate
from fluxtwin.calib.gyro import solve as solver
from fluxtwin.calib.gyro.solve import BASIS_S, GyroRows, cut, degree_for, drops, fields_without_errors, follow, solve
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.late import late
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

S = np.array([[0.01, 0.004, 0.0], [-0.002, -0.01, 0.0], [0.003, 0.0, 0.02]])
B_NT = np.array([1500.0, -800.0, 300.0])
WORLD = """
[attitude]
mode = "tumble"
rate_deg_s = {rate}
[magnetometer]
S = {S}
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 50.0
[gyro]
bias_deg_h = [30.0, -20.0, 10.0]
noise_deg_s = {gyro}
"""
INERTIA = [[0.02, 0.0, 0.0], [0.0, 0.025, 0.0], [0.0, 0.0, 0.03]]


def flown(
    seed: int, rate: str = "[1.5, 0.8, -1.1]", S: np.ndarray = S, gyro: float = 0.02, rows: int = 300
) -> Telemetry:
    segment = f"samples = {rows}, step_s = 4.0"
    world = WORLD.format(rate=rate, S=S.tolist(), gyro=gyro)
    text = scenario_text(world, segment=segment, seed=seed, inertia_kg_m2=INERTIA)
    record = fluxtwin.simulate(parse_scenario(text, where="test"))[0]
    return record.replace(q_NB=None, r_N_km=None, v_N_km_s=None)  # nothing but gyro and magnetometer


def misfit(fit: Fit, S: np.ndarray = S) -> float:
    """e' C^-1 e of b and the part of S that can be seen: the truth in the scale in which the trace of S is zero."""
    scale = np.trace(np.eye(3) + S) / 3.0
    e = fit.calibration.values - np.concatenate([((np.eye(3) + S) / scale - np.eye(3)).ravel(), B_NT / scale])
    seen = np.zeros((12, 11))
    seen[:9, :8], seen[9:, 8:] = BASIS_S, np.eye(3)
    down = np.linalg.pinv(seen) if fit.sigma["S12"] is not None else np.hstack([np.zeros((3, 9)), np.eye(3)])
    return float(down @ e @ np.linalg.solve(down @ fit.calibration.covariance @ down.T, down @ e))


def test_errors_are_as_large_as_the_sigmas_say() -> None:
    """The sum over seeds is chi-square; half the sigmas, or a b of the wrong sign, are far outside."""
    field = load_field("igrf14")
    fits = [calibrate.calibrate_gyro(flown(7000 + seed, rows=500), field, stretch_s=170.0) for seed in range(3)]
    found = [misfit(fit) for fit in fits]
    for fit in fits:  # each axis to 4 sigma, a false alarm of 6e-4 for nine
        assert fit.rejected == 0  # six sigma
        # thirteen records gave them with a scatter of 5 and 2 %
        assert np.degrees(fit.solved.gyro_noise_rad_s) == pytest.approx(0.02, rel=0.2)
        assert np.sqrt(fit.solved.variance_nT2) == pytest.approx(50.0, rel=0.08)
        said = next(words for words in fit.messages if words.startswith("bias of the gyro"))
        bias = np.array(re.findall(r"(\S+) ± ([\d.]+)", said), dtype=float)
        assert np.abs((bias[:, 0] - [30.0, -20.0, 10.0]) / bias[:, 1]).max() < 4.0
    low, high = chi2.ppf([0.0005, 0.9995], 11 * len(found))
    assert low < sum(found) < high
    assert 4.0 * sum(found) > high


def test_a_part_of_a_turn_in_each_stretch_is_enough_for_b_and_a_slow_body_is_refused() -> None:
    """1.1 deg/s: a quarter of a turn in 80 s; S is none and said to be none. What hardly turns the moving field hides."""
    none = np.zeros((3, 3))
    found = []
    for seed in range(3):
        record = flown(7100 + seed, "[0.8, 0.5, -0.6]", none, gyro=0.01)
        fit = fluxtwin.calibrate(record, method="gyro", parameters="b", stretch_s=80.0)
        assert fit.calibration.sigmas[9:].max() < 1500.0
        found.append(misfit(fit, none))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(found))
    assert low < sum(found) < high
    with pytest.raises(NoAnswer, match="not determined"):
        fluxtwin.calibrate(flown(7150, "[0.01, 0.02, -0.01]", none), method="gyro", parameters="b", stretch_s=80.0)


def test_the_field_of_a_column_is_found_within_its_sigmas(tmp_path: Path) -> None:
    """Without attitude, position and field model. The sums over seeds are chi-square; b and S are as good as without."""
    k_nT, off, seen = np.array([300.0, -200.0, 120.0]), [], []
    for seed in range(3):
        record = flown(7000 + seed)
        on = (np.arange(len(record)) // 17 % 2).astype(float)
        driven = record.replace(mag_B_nT=record.mag_B_nT + np.outer(on, k_nT), drivers={"tx": on})
        fit = fluxtwin.calibrate(driven, method="gyro", stretch_s=170.0, driver=["tx"])
        found = fit.calibration.telemetry_bias["driver_tx"]
        e = found.value_nT - k_nT
        off.append(float(e @ np.linalg.solve(fit.driver_covariance, e)))
        seen.append(misfit(fit))
        assert found.sigma_nT.max() < 20.0
    for total, size in ((off, 3), (seen, 11)):
        low, high = chi2.ppf([0.0005, 0.9995], size * len(total))
        assert low < sum(total) < high
    known = fluxtwin.Calibration.from_toml(fit.calibration.to_toml(tmp_path / "c.toml"))
    assert np.allclose(known.telemetry_bias["driver_tx"].value_nT, found.value_nT)
    ignored = fluxtwin.calibrate(driven, method="gyro", stretch_s=170.0)
    assert ignored.calibration.sigma_nT > 1.2 * fit.calibration.sigma_nT
    same = driven.replace(drivers={"tx": on, "never": np.ones_like(on)})
    with pytest.raises(NoAnswer, match="driver_never cannot be estimated: it never changes"):
        fluxtwin.calibrate(same, method="gyro", stretch_s=170.0, driver=["never"])


def test_a_field_that_is_late_is_found_late() -> None:
    """12 s of delay, or a lag of 20 s, behind a switch: its size is within its covariance over both, with 1 - 5e-4."""
    k_nT, total = np.array([300.0, -200.0, 120.0]), 0.0
    for seed, (delay_s, lag_s) in enumerate(((12.0, 0.0), (0.0, 20.0))):
        record = flown(7000 + seed)
        on = stream(seed, "test.switch").integers(0, 2, 56).astype(float).repeat(9)[: len(record)]
        field = np.outer(late(seconds_of(record.time), on, delay_s, lag_s), k_nT)
        driven = record.replace(mag_B_nT=record.mag_B_nT + field, drivers={"tx": on})
        fit = fluxtwin.calibrate(driven, method="gyro", stretch_s=170.0, driver=["tx"])
        found = fit.calibration.telemetry_bias["driver_tx"]
        assert abs(found.delay_s - delay_s) < 4.0 + 0.2 * lag_s and abs(found.lag_s - lag_s) < 0.5 * lag_s + 1.0
        e = found.value_nT - k_nT
        total += float(e @ np.linalg.solve(fit.driver_covariance, e))
    assert total < chi2.ppf(0.9995, 6)


def test_bit_errors_do_not_move_the_answer() -> None:
    record = flown(7200, rows=500)
    readings = np.array(record.mag_B_nT)
    readings[np.random.default_rng(1).choice(len(readings), 8, replace=False), 1] += 8192.0
    corrupted = record.replace(mag_B_nT=readings)
    fit = fluxtwin.calibrate(corrupted, method="gyro", stretch_s=170.0)
    assert fit.rejected == 8 and misfit(fit) < chi2.ppf(0.9999, 11)
    assert len(fit.rows) + sum(fit.left_out.values()) == len(record), "a row is in the fit, or is said not to be"
    with pytest.raises(NoAnswer, match="looks like rotation"):
        fluxtwin.calibrate(corrupted, method="gyro", parameters="b", stretch_s=170.0, robust="none")


def test_what_the_motion_does_not_show_is_refused() -> None:
    with pytest.raises(BadInput, match="no body rates"):
        fluxtwin.calibrate(flown(1).replace(rate_B_rad_s=None), method="gyro")
    spin = flown(2, "[0.0, 0.0, 1.5]", np.zeros((3, 3)))
    with pytest.raises(NoAnswer, match="S is not determined"):
        fluxtwin.calibrate(spin, method="gyro", stretch_s=100.0)
    slow = flown(4, "[0.03, 0.02, -0.03]", rows=57)
    readings = np.array(slow.mag_B_nT)
    readings[:, 0] = 123.0  # an axis that is stuck: of its row of S nothing is left but rounding
    with pytest.raises(NoAnswer, match="S is not determined"):
        fluxtwin.calibrate(slow.replace(mag_B_nT=readings), method="gyro")
    few = flown(3, rows=8)
    degrees_s = 180.0 / np.pi * np.median(np.linalg.norm(np.asarray(few.rate_B_rad_s), axis=1))
    with pytest.raises(NoAnswer, match=f"fewer than 3 stretches[^(]* by {degrees_s:.3g} deg/s .* more than 57 deg"):
        fluxtwin.calibrate(few, method="gyro")


def test_the_gyros_noise_is_sought_in_a_part_of_many_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 79 stretches of 80 s in 27 along the whole record; and it is found as well."""
    seen: list[np.ndarray] = []
    whole = solver._ratio

    def ratio(stretches: Any, *rest: Any, **more: Any) -> float:
        seen.append(np.array([one.rows[0] for one in stretches]))
        return whole(stretches, *rest, **more)

    monkeypatch.setattr(solver, "_ratio", ratio)
    record = flown(7200, rows=1600)
    fit = calibrate.calibrate_gyro(record, load_field("igrf14"), stretch_s=80.0)
    assert all(len(rows) <= 30 and len(set(np.diff(rows))) == 1 and rows[-1] > 1400 for rows in seen) and seen
    assert np.degrees(fit.solved.gyro_noise_rad_s) == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize("count", [2, 3])
def test_three_stretches_are_enough(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    used = flown(1, rows=20).replace(rate_B_rad_s=np.ones((20, 3)))
    options: Any = SimpleNamespace(stretch_s=100.0, parameters="b", robust="none")
    monkeypatch.setattr(calibrate, "cut", lambda *_: [np.arange(5)] * count)
    monkeypatch.setattr(calibrate, "_robust", lambda *_: ("solved", "weights"))
    monkeypatch.setattr(calibrate, "_require_no_false_turns", lambda *_: None)
    if count < 3:
        with pytest.raises(NoAnswer, match="fewer than 3 stretches"):
            calibrate._best(used, np.zeros((20, 0)), options)
    else:
        seen, *answer = calibrate._best(used, np.zeros((20, 0)), options)
        assert (seen.length_s, *answer) == (100.0, "solved", "weights")


def test_a_stretch_has_three_rows_more_than_its_polynomial_has_degrees() -> None:
    fewest = degree_for(100.0) + 3
    for rows, stretches in ((fewest, 1), (fewest - 1, 0)):
        time = np.datetime64("2020-03-01", "ns") + np.arange(rows) * np.timedelta64(1, "s")
        assert len(cut(time, np.zeros((rows, 3)), 100.0)) == stretches


@pytest.mark.parametrize(("mean_rad_s", "stretches"), [(0.9, 1), (1.1, 0)])
def test_no_stretch_has_a_step_that_turns_by_more_than_a_radian(mean_rad_s: float, stretches: int) -> None:
    """Rates that differ by 1 rad/s from row to row, a second apart: a step turns by the mean of its two ends."""
    time = np.datetime64("2020-03-01", "ns") + np.arange(20) * np.timedelta64(1, "s")
    speed = mean_rad_s + np.where(np.arange(20) % 2, 0.5, -0.5)
    assert len(cut(time, speed[:, None] * [0.6, 0.0, 0.8], 20.0)) == stretches


def test_a_column_lowers_chi_square_by_what_fitting_it_does() -> None:
    """Two fits with the same noises, without and with the column: residual sums of squares are variances by freedoms."""
    record = flown(7000, gyro=0.05, rows=120)
    rate, on = np.asarray(record.rate_B_rad_s), (np.arange(120) // 17 % 2).astype(float)[:, None]
    cuts, none, whole = cut(record.time, rate, 170.0), np.zeros((120, 0)), np.ones(120)
    reading_nT = record.mag_B_nT + on * [300.0, -200.0, 120.0]
    rows = GyroRows(record.time, reading_nT, rate, cuts, 170.0, none, True)
    solved = solve(rows, whole, corrected=False)
    without = solve(rows, whole, start=solved, corrected=False)
    start = solved._replace(fields_nT=np.zeros((1, 3)))
    beside = solve(rows._replace(columns=on), whole, start=start, corrected=False)
    freedom = 3 * 120 - 3 * (degree_for(170.0) + 1) * len(cuts) - 14
    lowered = without.variance_nT2 * freedom - beside.variance_nT2 * (freedom - 3)
    found = drops(rows, solved, none, on, np.zeros((120, 3, 1)), np.zeros(1))
    assert found == pytest.approx([lowered / solved.variance_nT2], rel=1e-6)


@pytest.mark.reference
def test_the_gyro_is_integrated_to_fourth_order() -> None:
    """Against the attitude that was flown, without noise: the error falls by 16 or so when the step is halved."""
    text = scenario_text(
        WORLD.format(rate="[3.0, 2.0, -4.0]", S=S.tolist(), gyro=0.0).replace("[30.0, -20.0, 10.0]", "[0.0, 0.0, 0.0]"),
        segment="samples = 161, step_s = 1.0",
        inertia_kg_m2=INERTIA,
    )
    record = fluxtwin.simulate(parse_scenario(text, where="test"))[0]
    assert record.rate_B_rad_s is not None and record.q_NB is not None
    R_BN = frames.rotation_from_q(record.q_NB)
    errors = []
    for step in (4, 2):
        rows = np.arange(0, 161, step)
        one = follow(record.time, record.rate_B_rad_s, np.zeros_like(record.rate_B_rad_s), rows, degree_for(150.0))
        assert np.abs(one.basis).max() == pytest.approx(1.0)  # Chebyshev's, over the stretch
        true = (R_BN[int(rows[-1])] * R_BN[0].inv()).as_matrix()
        errors.append(float(np.abs(one.R[-1] - true).max()))
    field = R_BN.apply([2e4, -1e4, 3e4])
    cuts, none = [np.arange(0, 161, 2), np.arange(1, 161, 2)], np.zeros((161, 0))
    rows_of_all = GyroRows(record.time, field, record.rate_B_rad_s, cuts, 150.0, none, False)
    found = fields_without_errors(rows_of_all, np.ones(161))
    assert np.abs(found - np.concatenate([field[::2], field[1::2]])).max() < 10.0  # of 37,000 nT
    assert errors[1] < 1e-4 and 8.0 < errors[0] / errors[1] < 32.0


def test_a_field_as_strong_as_the_earths_that_follows_a_column_changes_nothing_but_its_own_estimate() -> None:
    """Without S the model is linear in it. The ratio of the noises is sought to 2 %; a sigma follows its root at most."""
    record = flown(7003, S=np.zeros((3, 3)), rows=150)
    wave = np.sin(0.3 * np.arange(len(record)))[:, None]
    reading_nT, rate = np.array(record.mag_B_nT), np.array(record.rate_B_rad_s)
    given = (rate, [np.arange(k, k + 50) for k in (0, 50, 100)], 200.0, wave, False)
    strong_nT = np.array([20000.0, -25000.0, 15000.0])
    bare, driven = (
        solve(GyroRows(record.time, nT, *given), np.ones(len(record)), corrected=False)
        for nT in (reading_nT, reading_nT + wave * strong_nT)
    )
    assert driven.fields_nT - bare.fields_nT == pytest.approx(strong_nT[None], rel=1e-4)
    assert driven.bias_sigma_rad_s == pytest.approx(bare.bias_sigma_rad_s, rel=0.01)
