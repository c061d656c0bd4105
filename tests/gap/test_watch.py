"""The watch over rows as they come: arithmetic against scipy, silence where nothing changes, alarms where something does."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from worlds import scenario_text

from fluxtwin.calib.common.records import Calibration, TelemetryBias
from fluxtwin.gap import watch as module
from fluxtwin.gap import watch_kernels
from fluxtwin.gap.noise.whitening import NoiseModel
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.watch import Watch, begin
from fluxtwin.gap.watch_kernels import run_rows
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

MODEL = load_field("igrf14")
FIRST, AT = 610, 1300
SECTIONS = """
[attitude]
yaw_rms_deg = 4.0
roll_rms_deg = 4.0
pitch_rms_deg = 4.0
shortest_period_min = 40.0
[attitude.reference]
sigma_deg = {sigma_deg}
tau_s = 300.0
[magnetometer]
S = [[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 20.0
lsb_nT = 10.0
"""


def flown(sigma_deg: float = 0.1, segment: str = "duration_min = 500.0, step_s = 10.0") -> Telemetry:
    return simulate(parse_scenario(scenario_text(SECTIONS.format(sigma_deg=sigma_deg), seed=3, segment=segment)))[0]


@pytest.fixture(scope="module")
def record() -> Telemetry:
    return flown()


def with_change(record: Telemetry, at: int = AT, **change: float) -> Telemetry:
    """A bias in x [nT], noise [nT] or a scale from row `at` on."""
    mag, rows = np.array(record.mag_B_nT), slice(at, None)
    mag[rows] *= 1.0 + change.get("scale", 0.0)
    mag[rows, 0] += change.get("bias_nT", 0.0)
    mag[rows] += change.get("noise_nT", 0.0) * np.random.default_rng(1).normal(size=mag[rows].shape)
    return record.replace(mag_B_nT=mag)


def watched(
    record: Telemetry, sigma_deg: float | None = None, first: int = FIRST
) -> tuple[Watch, module.Changed | None]:
    budget = Budget(attitude_sigma_rad=None if sigma_deg is None else float(np.radians(sigma_deg)))
    watch = begin(record.select(slice(0, first)), MODEL, budget)
    return watch, watch.take(record.select(slice(first, None)))


def test_a_row_says_what_the_densities_say(record: Telemetry) -> None:
    """The evidence of a first row is the ratio of two normal densities, with and without the change (scipy's)."""
    for by_size in (False, True):
        watch = begin(record.select(slice(0, FIRST)), MODEL, Budget(attitude_sigma_rad=float(np.radians(0.1))))
        row = record.select(slice(FIRST, FIRST + 1))
        y, load, white, present, faults, field = watch._measured(row, watch.calibration.apply(row.mag_B_nT), by_size)
        P, x = watch.covariance.copy(), watch.state.copy()
        phi = np.exp(-10.0 / watch.noise.tau_s)
        keep = np.where(np.arange(len(x)) < 3, phi, 1.0)
        x = x * keep
        P[3:], P[:, 3:], watch.settled[:] = (
            0.0,
            0.0,
            0.0,
        )  # changes are sought as the attitude error alone lets them through
        watch.covariance[:] = P
        run_rows(
            *(y, load, white, present, faults, field, np.array([phi]), watch.back, module._USUAL_nT),
            *(module.DIRECTIONS, module.SIZES, module._AXES, module.GROWTH, module._PRIOR),
            *(watch.state, watch.covariance, watch.settled, watch.evidence, watch.excursion, watch.since, watch.wild),
            *(row.time.astype(np.int64), True, 6.0, 1e3, 1e3, 1e300, np.empty((1, 3))),
        )  # load is now the image that was used
        there = present[0]
        P = P * np.outer(keep, keep)
        P[:3, :3] += (1.0 - phi**2) * np.eye(3)
        h, e = load[0][there], y[0][there] - load[0][there] @ x
        C = h @ P @ h.T + np.diag(white[0][there].sum(axis=1))
        still = multivariate_normal(np.zeros(len(e)), C).pdf(e)
        for place in (0, 7, 40, 50, 95):  # direction, size, sign
            direction, rest = divmod(place, 2 * module.SIZES.size)
            size = module.SIZES[rest // 2] * (1 if rest % 2 else -1)
            moved = faults[0][there] @ module.DIRECTIONS[direction] * size
            ratio = multivariate_normal(moved, C).pdf(e) / still
            assert watch.evidence[place] == pytest.approx(ratio, rel=1e-6), place
        if by_size:
            for place, (axes, growth) in enumerate(itertools.product(module._AXES, module.GROWTH), start=96):
                wider = C + (growth**2 - 1.0) * (white[0, 0] @ axes)
                ratio = multivariate_normal([0.0], wider).pdf(e) / still
                assert watch.evidence[place] == pytest.approx(ratio, rel=1e-6), place


@pytest.mark.parametrize(("sigma_deg", "declared"), [(0.1, None), (0.01, 0.01), (0.5, None)])
def test_nothing_rings_where_nothing_changes(sigma_deg: float, declared: float | None) -> None:
    """2,400 rows and a stated mean run of a million: an alarm in one of 400 such tests."""
    watch, changed = watched(flown(sigma_deg), declared)
    assert changed is None and watch.rows == 3001 - FIRST
    assert watch.by_size == (declared is None)
    assert 0.9 < np.std(watch.innovations[watch.innovations != 0]) < 1.05


def test_a_row_a_second_does_not_ring() -> None:
    """Thousands of rows in an orbit: S is then known so well that noise in its own regressors would show."""
    record = flown(segment="duration_min = 200.0, step_s = 1.0")
    watch, changed = watched(record, first=6001)
    assert changed is None and watch.rows == 6000


@pytest.mark.parametrize(
    ("change", "within", "word"),
    [
        ({"bias_nT": 100.0}, 150, "the readings"),
        ({"noise_nT": 40.0}, 60, "has grown"),
        ({"scale": 0.003}, 40, "too large in proportion to the field"),
    ],
)
def test_a_change_rings_and_is_dated(record: Telemetry, change: dict[str, float], within: int, word: str) -> None:
    _, changed = watched(with_change(record, **change))
    assert changed is not None and word in changed.what, changed
    assert not any(letter.isdigit() for letter in changed.what)
    assert 0 < changed.rows - (AT - FIRST) <= within
    apart = abs((changed.since - record.time[AT]) / np.timedelta64(10, "s"))
    assert apart <= within
    assert changed.time == record.time[FIRST + changed.rows - 1]


def test_wild_readings_are_no_change(record: Telemetry) -> None:
    mag = np.array(record.mag_B_nT)
    mag[700::400] += 30_000.0
    mag[701::800] -= 30_000.0
    assert watched(record.replace(mag_B_nT=mag))[1] is None


def test_rows_may_come_in_any_pieces(record: Telemetry) -> None:
    changed = with_change(record, bias_nT=100.0)
    _, whole = watched(changed)
    again = begin(changed.select(slice(0, FIRST)), MODEL)
    # 0.1 deg is 70 nT, a new one every 600 s of 6100 s: 22 nT, here to 4.5 standard deviations; in 2e4 nT, 0.005.
    assert again.calibration.b_nT == pytest.approx([1500.0, -800.0, 300.0], abs=100.0)
    assert (
        pytest.approx(np.array([[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]), abs=0.005)
        == again.calibration.S
    )
    for start in range(FIRST, len(changed), 7):
        found = again.take(changed.select(slice(start, start + 7)))
        if found is not None:
            break
    assert whole is not None and found == whole
    assert again.take(changed.select(slice(0, 50))) is None and again.rows == whole.rows  # rows that were seen


def test_last_months_calibration(record: Telemetry) -> None:
    """The true one stays silent from the first row on, whenever it was made; one that is off by ten sigma rings."""
    S = np.array([[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]])
    sigmas = np.concatenate([np.full(9, 1e-4), np.full(3, 5.0)])
    long_ago = (np.datetime64("2019-01-01"), np.datetime64("2019-01-02"))
    good = Calibration(S, np.array([1500.0, -800.0, 300.0]), covariance=np.diag(sigmas**2), span=long_ago)
    first, rest = record.select(slice(0, FIRST)), record.select(slice(FIRST, None))
    watch = begin(first, MODEL, None, good)
    known = [1.0] * 3 + [1e-4 * module._USUAL_nT] * 9 + [5.0] * 3
    assert np.sqrt(np.diag(watch.covariance)) == pytest.approx(known, rel=1e-12)
    assert watch.take(first) is None and watch.take(rest) is None and watch.rows == len(record)
    old = begin(first, MODEL, None, replace(good, b_nT=good.b_nT + np.array([0.0, 0.0, 60.0])))
    changed = old.take(first)
    assert changed is not None and changed.since <= record.time[200]


@pytest.mark.parametrize("missing", ["dipole", "driver"])
def test_one_missing_dipole_or_current_does_not_silence_the_watch(record: Telemetry, missing: str) -> None:
    S, column = np.array([[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]), np.zeros((len(record), 3))
    column[FIRST + 20] = np.nan
    changed, known = with_change(record, bias_nT=300.0), Calibration(S, np.array([1500.0, -800.0, 300.0]))
    if missing == "dipole":
        changed = changed.replace(dipole_B_Am2=column)
        known = replace(known, T_nT_per_Am2=np.eye(3), covariance=np.zeros((21, 21)))
    else:
        changed = changed.replace(drivers={"heater": column[:, 0]})
        bias = {"driver_heater": TelemetryBias(np.ones(3), np.ones(3))}
        known = replace(known, telemetry_bias=bias, covariance=np.zeros((12, 12)))
    watch = begin(changed.select(slice(0, FIRST)), MODEL, None, known)
    found = watch.take(changed.select(slice(FIRST, None)))
    assert found is not None and found.time > record.time[AT]
    assert found.rows == int(np.flatnonzero(record.time == found.time)[0]) - FIRST  # but for the row that lacks it


def test_bias_scale_and_noise_are_sought_with_a_third_each() -> None:
    of_mean, of_noise = np.split(module._prior(), [2 * len(module.DIRECTIONS) * module.SIZES.size])
    of_direction = of_mean.reshape(len(module.DIRECTIONS), -1).sum(axis=1)
    assert (of_direction[3], of_direction.sum(), of_noise.sum()) == pytest.approx((1 / 3, 2 / 3, 1 / 3))


def test_the_most_noise_lasts_and_grows_by_what_is_not_known() -> None:
    found = NoiseModel(20.0, 1e-3, 100.0, sigma_log_sd=0.1, theta_log_sd=0.2, tau_log_sd=0.3)
    most, sure = module._at_most(found), module._SURE
    assert np.log([most.sigma_nT / 20.0, most.tau_s / 100.0]) == pytest.approx([0.1 * sure, 0.3 * sure])
    assert np.log(most.theta_rad / 1e-3) == pytest.approx((0.2 + 0.5 * 0.3) * sure)


def test_the_attitude_error_is_half_forgotten_after_its_half_life(
    record: Telemetry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """tau is the half-life over ln 2; rows are 10 s apart, the third 20 s after the second; the first is 1."""
    seen: list[np.ndarray] = []
    monkeypatch.setattr(watch_kernels, "run_rows", lambda *given: seen.append(given[6]) or -1)
    noise = NoiseModel(20.0, 1e-3, 10.0 / np.log(2.0))
    watch = Watch(MODEL, noise, noise, False, Calibration(np.zeros((3, 3)), np.zeros(3)), np.eye(15))
    assert watch.take(record.select(np.array([0, 1, 3]))) is None
    assert seen[0] == pytest.approx([1.0, 0.5, 0.25])


def test_too_few_rows_are_said(record: Telemetry) -> None:
    with pytest.raises(NoAnswer, match="600 with reading and position over 6000 s"):
        begin(record.select(slice(0, 300)), MODEL)


def test_a_field_that_comes_late_is_not_taken_without_the_rows_before(record: Telemetry) -> None:
    plain = Calibration(np.zeros((3, 3)), np.zeros(3))
    heater = record.replace(drivers={"heater": np.arange(len(record)) % 7.0})
    for delay_s, refused in ((30.0, True), (0.0, False)):
        bias = TelemetryBias(np.array([10.0, 0.0, 0.0]), np.ones(3), delay_s=delay_s)
        known = replace(plain, telemetry_bias={"driver_heater": bias})
        if refused:
            with pytest.raises(BadInput, match="driver_heater is delayed"):
                begin(heater.select(slice(0, FIRST)), MODEL, None, known)
        else:
            begin(heater.select(slice(0, FIRST)), MODEL, None, known)
