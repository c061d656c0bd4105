"""Calibrations over time: no alarm where nothing changed, and what changed is named, dated and sized."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli
from scipy.stats import binom, chi2
from worlds import scenario_text

import fluxtwin
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.trend import Trend, trend
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.trending import trend_figure

pytestmark = pytest.mark.closure

TRUE = np.array([0.01, 0.002, 0.0, 0.001, -0.01, 0.0, 0.0, 0.0, 0.02, 1500.0, -800.0, 300.0])
SIGMA = np.array([2e-4] * 9 + [10.0, 12.0, 8.0])
START = np.datetime64("2026-03-01T00:00:00", "ns")


def covariance_of(rng: np.random.Generator) -> np.ndarray:
    """With correlations of up to 0.9, as calibrations have them."""
    root = rng.normal(size=(12, 12)) + 2.0 * rng.normal(size=(12, 1)) * rng.normal(size=12)
    C = root @ root.T
    scale = SIGMA * rng.uniform(0.7, 1.4, size=12) / np.sqrt(np.diag(C))
    return np.asarray(C * np.outer(scale, scale))


def made(seed: int, moved: np.ndarray, temperature_degC: np.ndarray | None = None) -> list[Calibration]:
    """A calibration a week, drawn with its covariance about the truth and what is added to it, (K, 12) in sigmas."""
    rng = np.random.default_rng(seed)
    found = []
    for week, more in enumerate(moved):
        C = covariance_of(rng)
        p = rng.multivariate_normal(TRUE + more * SIGMA, C)
        first = START + np.timedelta64(7 * week, "D")
        warm = None if temperature_degC is None else (temperature_degC[week] - 2.0, temperature_degC[week] + 2.0)
        span = (first, first + np.timedelta64(5, "h"))
        found.append(
            Calibration(p[:9].reshape(3, 3), p[9:], covariance=C, span=span, temperature_degC=warm, sigma_nT=20.0)
        )
    return found


def one(found: Trend, name: str) -> object:
    return next(history for history in found.histories if history.name == name)


def test_no_alarm_where_nothing_changed() -> None:
    """Two tests at 1 %, of all parameters together and of their histories: at most 2 % of 400 draws."""
    alarms = sum(not trend(made(seed, np.zeros((5, 12)))).holds for seed in range(400))
    assert alarms <= binom.ppf(0.999, 400, 0.02)
    assert alarms >= 1  # a test that never rejects is none


def test_the_statistic_is_that_of_whitened_least_squares() -> None:
    """Against the residual of a mean fitted by `lstsq` to whitened values; one parameter against the textbook's form."""
    known = made(3, np.zeros((4, 12)))
    found = trend(known)
    whiten = [np.linalg.inv(np.linalg.cholesky(c.covariance)) for c in known]
    rows, right = np.vstack(whiten), np.concatenate([w @ c.values for w, c in zip(whiten, known, strict=True)])
    mean = np.linalg.lstsq(rows, right, rcond=None)[0]
    assert found.q == pytest.approx(float(((right - rows @ mean) ** 2).sum()), rel=1e-6)
    assert found.degrees_of_freedom == 36
    w, b1 = np.array([c.sigma["b1"] for c in known], dtype=float) ** -2, np.array([c.b_nT[0] for c in known])
    q = (w * b1**2).sum() - (w * b1).sum() ** 2 / w.sum()
    assert one(found, "b1").q == pytest.approx(q, rel=1e-6)  # type: ignore[attr-defined]
    named = [replace(c, spacecraft="Seasat") for c in known]
    assert trend(named).q == found.q
    with pytest.raises(BadInput, match="they are of HCMM and Seasat"):
        trend([replace(known[0], spacecraft="HCMM"), *named[1:]])
    assert one(found, "b1").probability == pytest.approx(chi2.sf(q, 3), rel=1e-6)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("kind", "name"), [("step", "b2"), ("drift", "S33"), ("temperature", "b1")])
def test_what_changed_is_named_and_sized(kind: str, name: str) -> None:
    warm = np.array([10.0, 25.0, 12.0, 30.0, 8.0, 22.0])
    at = Calibration(np.zeros((3, 3)), np.zeros(3)).names.index(name)
    shape = {"step": np.arange(6) >= 4, "drift": 7.0 * np.arange(6), "temperature": warm}[kind].astype(float)
    size = {"step": 12.0, "drift": 0.5, "temperature": 0.8}[kind]  # sigmas, of a whole, a day, a degC
    hits = 0
    for seed in range(20):
        moved = np.zeros((6, 12))
        moved[:, at] = size * shape
        known = made(seed, moved, warm)
        found = trend(known)
        assert not found.holds and found.lines[0].startswith("Does not hold")
        history = one(found, name)
        wrong = [h.name for h in found.histories if h.kind != "constant" and h.name != name]
        hits += history.kind == kind and not wrong  # type: ignore[attr-defined]
        if history.kind == kind:  # type: ignore[attr-defined]
            assert abs(history.size - size * SIGMA[at]) < 4 * history.size_sigma  # type: ignore[attr-defined]
            assert kind != "step" or history.after == 4  # type: ignore[attr-defined]
            assert (found.expires is not None) == (kind == "drift")
            if found.expires is not None:  # three sigmas of the last, from the middle of its five hours
                days = 3.0 * (known[-1].sigma[name] or 0.0) / abs(history.size)  # type: ignore[attr-defined]
                since = (found.expires - START) / np.timedelta64(1, "s") - 35.0 * 86_400.0
                assert since == pytest.approx(2.5 * 3600.0 + 86_400.0 * days, abs=1.0)  # whole seconds
    assert hits >= 18


def test_what_comes_and_goes_is_no_drift_and_has_no_date() -> None:
    """A bias that follows ten days of a thermal period of nine: a line through it explains some of it."""
    for seed in range(10):
        moved = np.zeros((10, 12))
        moved[:, 9] = 40.0 * np.sin(2.0 * np.pi * np.arange(10) / 9.0 + 0.3 * seed)
        found = trend(made(seed, moved))
        assert one(found, "b1").kind == "varies" and found.expires is None  # type: ignore[attr-defined]
        assert any(line.startswith("b1 varies by more than its sigmas") for line in found.lines)
        figure = trend_figure(found)
        figure.clear()


def test_a_drift_stays_one_where_its_sigmas_are_too_small() -> None:
    moved = np.zeros((10, 12))
    moved[:, 9] = 20.0 * np.arange(10) + 6.0 * np.random.default_rng(5).normal(size=10)
    history = one(trend(made(5, moved)), "b1")
    assert history.kind == "drift"  # type: ignore[attr-defined]
    assert abs(history.size - 20.0 * SIGMA[9] / 7.0) < 3.0 * history.size_sigma  # type: ignore[attr-defined]
    assert history.size_sigma > 0.05 * SIGMA[9] / 7.0 * 6.0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("kind", "sizes"), [("step", (0, 5, 1000)), ("step", (0, 1000, 1006)), ("drift", (0, 54, 97, 152))]
)
def test_three_or_four_calibrations_still_show_a_step_or_a_drift(kind: str, sizes: tuple[float, ...]) -> None:
    moved = np.zeros((len(sizes), 12))
    moved[:, 9] = sizes
    found = trend(made(2, moved))
    assert one(found, "b1").kind == kind and (found.expires is not None) == (kind == "drift")  # type: ignore[attr-defined]


def test_a_large_drift_is_no_step() -> None:
    """Far beyond 38 sigma, where probabilities are no longer numbers."""
    moved = np.zeros((6, 12))
    moved[:, 9] = 200.0 * np.arange(6)
    history = one(trend(made(4, moved)), "b1")
    assert history.kind == "drift" and history.size == pytest.approx(200.0 * SIGMA[9] / 7.0, rel=0.02)  # type: ignore[attr-defined]


def test_parameters_that_follow_from_others_are_counted_once() -> None:
    """A trace of zero, of calibrations from a gyro: 11 that are free. They do not go with those of a field model."""
    bind = np.eye(12)
    bind[np.ix_([0, 4, 8], [0, 4, 8])] -= 1.0 / 3.0
    full = made(5, np.zeros((4, 12)))
    gyro = [
        replace(
            c,
            S=(bind @ c.values)[:9].reshape(3, 3),
            covariance=bind @ c.covariance @ bind.T,
            field_model="none",
        )
        for c in full
    ]
    found = trend(gyro)
    assert found.degrees_of_freedom == 33 and found.holds
    kept = [name for name in full[0].names if name != "S33"]
    assert [history.name for history in found.histories] == kept
    with pytest.raises(BadInput, match="without a field model"):
        trend([gyro[0], full[1]])


def test_calibrations_that_share_data_say_so() -> None:
    known = made(5, np.zeros((4, 12)))
    assert not any("share" in line for line in trend(known).lines)
    assert known[1].span is not None
    first, last = known[1].span
    long = replace(known[1], span=(first - np.timedelta64(7, "D") + np.timedelta64(1, "h"), last))
    found = trend([known[0], long, *known[2:]])
    assert found.overlap_ratio == pytest.approx(0.8) and "share up to 80 % of their time" in " ".join(found.lines)


def test_at_one_time_there_is_no_drift() -> None:
    known = made(6, np.zeros((3, 12)))
    assert trend([replace(c, span=known[0].span) for c in known]).holds


def test_telemetry_is_cut_by_days(tmp_path: Path, cli: Cli) -> None:
    """Two days and an hour, with a bias that steps at midnight of the second."""
    text = scenario_text(
        "\n[magnetometer]\nnoise_nT = 20.0\n",
        segment="samples = 588, step_s = 300.0",
        start_utc="2026-03-01T00:00:00Z",
    )
    record = fluxtwin.simulate(parse_scenario(text, where="test"))[0]
    second = (record.time >= np.datetime64("2026-03-02T00:00:00"))[:, None]
    fluxtwin.write(record.replace(mag_B_nT=record.mag_B_nT + second * [-500.0, 0.0, 0.0]), tmp_path / "t.nc")
    done = cli("trend", tmp_path / "t.nc", "--parameters", "b")
    assert done.status == 1, done.err
    assert re.search(r"b1 changed by (49|50)\d\.\d ± ", done.out) and done.out.count("changed by") == 1
    found = fluxtwin.trend(record, parameters="b")
    assert found.holds and len(found.time) == 2  # the hour is of the second day
    assert cli("trend", tmp_path / "t.nc", "--every", "-1").status == 2
    fluxtwin.write(record.replace(mag_B_nT=-record.mag_B_nT), tmp_path / "wrong.nc")
    done = cli("trend", tmp_path / "wrong.nc")
    assert done.status == 1 and done.err.count("telemetry from 2026-03-01T00:00:00Z: Bad: not a calibration.") == 1
    assert "longer stretches (--every)" in done.err
    for hours in ("0.2", "0.3"):  # one to four rows each
        done = cli("trend", tmp_path / "t.nc", "--every", hours, "--parameters", "b")
        assert done.status == 1 and "telemetry from 2026-03-01T0" in done.err and "(--every)" in done.err


def test_calibrations_that_cannot_be_compared_are_refused() -> None:
    two = made(1, np.zeros((2, 12)))
    bare = Calibration(two[0].S, two[0].b_nT)
    for bad in ([two[0]], [two[0], bare]):
        with pytest.raises(BadInput, match="calibration"):
            trend(bad)
    with pytest.raises(BadInput, match="given twice"):
        trend([two[0], two[0]])
    b_only = replace(two[1], S=np.zeros((3, 3)), covariance=np.diag([0.0] * 9 + [9.0] * 3))
    with pytest.raises(BadInput, match="S was estimated in some"):
        trend([two[0], b_only])
    with pytest.raises(BadInput, match="several magnetometers"):
        trend([two[0], replace(two[1], magnetometer=2)])
    symmetric = Calibration(np.diag([0.01, 0.0, 0.0]), two[0].b_nT, covariance=two[0].covariance, span=two[0].span)
    with pytest.raises(BadInput, match="without attitude"):
        trend([symmetric, two[1]])


def test_the_command_says_whether_it_holds(tmp_path: Path, cli: Cli) -> None:
    step = np.zeros((3, 12))
    step[2, 9] = 30.0
    for name, moved in (("same", np.zeros((3, 12))), ("new", step)):
        files = [c.to_toml(tmp_path / f"{name}{k}.toml") for k, c in enumerate(made(2, moved))]
        done = cli("trend", *files, "--html", tmp_path / f"{name}.html")
        assert done.status == (name == "new"), done.err
        assert done.out.startswith("Holds" if name == "same" else "Does not hold")
        assert ("b1 changed by" in done.out) == (name == "new")
        assert "<img" in (tmp_path / f"{name}.html").read_text(encoding="utf-8")
    same = fluxtwin.trend(list(tmp_path.glob("same*.toml")))
    assert same.holds and "would cause errors" not in " ".join(same.lines) and "as their sigmas allow" in same.lines[1]


def test_the_last_calibration_is_written_with_its_expiry(tmp_path: Path, cli: Cli) -> None:
    drift = np.zeros((6, 12))
    drift[:, 9] = 40.0 * np.arange(6)
    for name, moved in (("same", np.zeros((6, 12))), ("drifts", drift)):
        known = made(2, moved)
        files = [c.to_toml(tmp_path / f"{name}{k}.toml") for k, c in enumerate(known)]
        done = cli("trend", *files, "--out", tmp_path / f"{name}.toml")
        written = Calibration.from_toml(tmp_path / f"{name}.toml")
        assert np.array_equal(written.values, known[-1].values) and written.span == known[-1].span
        assert (written.expires is not None) == (name == "drifts") == ("off by 3 of its sigmas" in done.out)
        assert written.expires is None or str(written.expires)[:10] in done.out


def test_a_step_is_drawn_as_one() -> None:
    """Upright half way between the calibrations, where a line from one to the next would be a drift."""
    step = np.zeros((4, 12))
    step[2:, 9] = 30.0
    figure = trend_figure(trend(made(2, step)))
    panels = {axes.get_title(loc="left").split(" ")[0]: axes for axes in figure.axes if axes.get_visible()}
    assert panels["b1"].lines[0].get_drawstyle() == "steps-mid"
    assert panels["b2"].lines[0].get_drawstyle() == "default"
