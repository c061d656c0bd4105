"""Calibration without attitude: what is put in comes out within its stated sigma, and what cannot come out is refused.

Monte Carlo with fixed seeds; the truth goes into the readings by equation 1 alone. The variance of a pull over R runs
has relative sigma sqrt(2/R), its mean sigma 1/sqrt(R); bands are four of those (false alarm 6e-5 each).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.scalar import calibrate
from fluxtwin.calib.scalar.calibrate import ScalarFit, ScalarOptions, fit_rows
from fluxtwin.sim.base.errors import NoAnswer

pytestmark = pytest.mark.closure

D = np.array([[0.03, 0.01, -0.005], [0.01, -0.02, 0.004], [-0.005, 0.004, 0.01]])
B_NT = np.array([100.0, -200.0, 300.0])
RUNS = 60


def directions(rng: np.random.Generator, samples: int) -> np.ndarray:
    """(n, 3) over the whole sphere."""
    unit = rng.normal(size=(samples, 3))
    return np.asarray(unit / np.linalg.norm(unit, axis=1)[:, None])


def rows_of(
    field: np.ndarray,
    rng: np.random.Generator,
    *,
    noise_nT: Any = 200.0,
    S: np.ndarray = D,
    added: np.ndarray | float = 0.0,
    columns: dict[str, np.ndarray] | None = None,
    error_nT: np.ndarray | float = 0.0,
) -> Design:
    """Readings (I+S)^-1 (field - b) + added + noise; |H| is off by error_nT."""
    B = (field - B_NT) @ np.linalg.inv(np.eye(3) + S) + added + noise_nT * rng.normal(size=field.shape)
    time = np.datetime64("2020-01-01", "ns") + np.arange(len(field)) * np.timedelta64(30, "s")
    H = np.linalg.norm(field, axis=1) + error_nT
    return Design(time, B, H, columns or {}, np.arange(len(field)), {})


def varied(rng: np.random.Generator, samples: int = 600) -> np.ndarray:
    """(n, 3) field that takes all directions and sizes of 25 to 35 thousand nT."""
    return directions(rng, samples) * (30_000.0 + 5_000.0 * rng.uniform(-1, 1, samples))[:, None]


def pulls(fit: ScalarFit, S: np.ndarray = D) -> np.ndarray:
    """Errors over sigmas of what was estimated of S (each pair once) and b."""
    known = fit.calibration
    truth = np.concatenate([S.ravel(), B_NT])
    kept = [i for i in (0, 4, 8, 1, 2, 5, 9, 10, 11) if known.sigmas[i] > 0]
    return (known.values[kept] - truth[kept]) / known.sigmas[kept]


def check_pulls(of_runs: list[np.ndarray]) -> None:
    """Means and variances within four of their own sigma, with 15 % for a variance that is itself estimated."""
    z = np.array(of_runs)
    runs = len(z)
    assert np.abs(z.mean(axis=0)).max() < 4.0 / np.sqrt(runs), z.mean(axis=0)
    assert z.var(axis=0).max() < 1.15 + 4.0 * np.sqrt(2.0 / runs), z.var(axis=0)
    assert z.var(axis=0).min() > 0.85 - 4.0 * np.sqrt(2.0 / runs), z.var(axis=0)
    whole = z.var(axis=0).mean()
    assert abs(whole - 1.0) < 0.1 + 4.0 * np.sqrt(2.0 / z.size), whole


@pytest.mark.parametrize(
    "options",
    [
        {"method": "scalar", "noise_nT": 200.0},
        {"method": "scalar"},
        {"method": "scalar", "covariance": "blocks"},
        {"method": "twostep"},
        {"method": "scalar", "robust": "tukey"},
    ],
    ids=str,
)
def test_complete_fits_state_their_sigmas(options: dict[str, Any]) -> None:
    found = []
    for seed in range(RUNS):
        rng = np.random.default_rng([1, seed])
        found.append(
            pulls(
                fit_rows(
                    rows_of(varied(rng), rng), ScalarOptions(**{"covariance": "white", "robust": "none", **options})
                )
            )
        )
    check_pulls(found)


@pytest.mark.parametrize("method", ["center", "twostep", "scalar"])
def test_bias_alone_states_its_sigmas(method: str) -> None:
    none, found = np.zeros((3, 3)), []
    for seed in range(RUNS):
        rng = np.random.default_rng([2, seed])
        rows = rows_of(varied(rng), rng, S=none)
        found.append(
            pulls(fit_rows(rows, ScalarOptions(method=method, parameters="b", covariance="white", robust="none")), none)
        )
    check_pulls(found)


def test_strong_uneven_noise_leaves_no_bias() -> None:
    """Noise of 1200, 600 and 300 nT in 30,000 nT, 1000 rows: what noise shared by a residual, its derivative and its
    weight does would be more than one sigma; neither method is off by more than chance shows (60 runs: 0.13 sigma)."""
    noise = np.array([1200.0, 600.0, 300.0])
    of: dict[str, list[np.ndarray]] = {"scalar": [], "twostep": []}
    for seed in range(RUNS):
        rng = np.random.default_rng([3, seed])
        rows = rows_of(varied(rng, 1000), rng, noise_nT=noise)
        for method, found in of.items():
            found.append(
                pulls(fit_rows(rows, ScalarOptions(method=method, noise_nT=noise, covariance="white", robust="none")))
            )
    for found in of.values():
        assert np.abs(np.mean(found, axis=0)).max() < 4.0 / np.sqrt(RUNS)


def test_constant_size_is_solved_and_said(close: Callable[..., None]) -> None:
    for method in ("twostep", "scalar"):
        found = []
        for seed in range(30):
            rng = np.random.default_rng([4, seed])
            rows = rows_of(directions(rng, 600) * 30_000.0, rng)
            fit = fit_rows(rows, ScalarOptions(method=method, covariance="white", robust="none"))
            found.append(pulls(fit))
        assert np.abs(found).max() < 4.5
        assert any("|H| is nearly constant" in words for words in fit.messages)


@pytest.mark.parametrize(
    ("options", "words", "parameters"),
    [
        ({}, r"plane with normal body Z", {"S33"}),
        ({"method": "twostep"}, r"plane with normal body Z", {"S33"}),
        ({"parameters": "b", "method": "center"}, r"does not determine b3 .* plane with normal body Z", {"b3"}),
        ({"parameters": "b"}, r"two solutions fit equally well, mirrors of each other: b = .* and b = ", set()),
        ({"parameters": "b", "method": "twostep"}, r"two solutions fit equally well", set()),
    ],
    ids=str,
)
def test_a_field_in_a_plane_is_refused(options: dict[str, Any], words: str, parameters: set[str]) -> None:
    for seed in range(5):
        rng = np.random.default_rng([5, seed])
        field = varied(rng)
        field[:, 2] = 6000.0
        S = D if "b" not in options.get("parameters", "b,S").split(",")[1:] and not options.get("parameters") else D * 0
        with pytest.raises(NoAnswer, match=words) as refusal:
            fit_rows(rows_of(field, rng, S=S), ScalarOptions(**options, robust="none"))
        if parameters:
            assert parameters <= set(refusal.value.evidence["null_direction"])
        assert "b3" in str(refusal.value)
        assert "--parameters b)" not in str(refusal.value)


def test_a_plane_through_zero_and_a_line_and_a_cone() -> None:
    rng = np.random.default_rng(6)
    flat = varied(rng)
    flat[:, 2] = 0.0  # through the sensor's own zero: the mirror is the same point, and the slope there is nil
    with pytest.raises(NoAnswer, match="b3"):
        fit_rows(rows_of(flat, rng, S=D * 0), ScalarOptions(parameters="b", robust="none"))
    line = np.outer(30_000.0 + 8000.0 * rng.uniform(-1, 1, 600), [0.6, 0.0, 0.8])
    with pytest.raises(NoAnswer, match="along one line"):
        fit_rows(rows_of(line, rng), ScalarOptions(robust="none"))
    angle = rng.uniform(0, 2 * np.pi, 600)
    cone = np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(600, 0.8)], axis=1)
    cone = cone * (30_000.0 + 8000.0 * rng.uniform(-1, 1, 600))[:, None]
    rows = rows_of(cone, rng, S=D * 0)
    rows = Design(rows.time, rows.B_nT + B_NT, rows.H_nT, {}, rows.rows, {})  # no bias: a cone in the readings too
    with pytest.raises(NoAnswer, match="cone about body Z") as refusal:
        fit_rows(rows, ScalarOptions(robust="none"))
    assert "S33" in refusal.value.evidence["parameters"]
    assert "--parameters b)" not in str(refusal.value)  # b alone takes in what S does, many sigmas of it


def test_of_two_solutions_the_better_is_taken() -> None:
    """Readings half a degree about a plane: the mirror is another minimum, and worse."""
    for seed in range(5):
        rng = np.random.default_rng([7, seed])
        field = varied(rng, 1500)
        field[:, 2] = 4000.0 + 300.0 * rng.normal(size=1500)
        fit = fit_rows(rows_of(field, rng, S=D * 0), ScalarOptions(parameters="b", covariance="white", robust="none"))
        assert np.abs(pulls(fit, D * 0)).max() < 4.5
        assert any("mirror solution" in words and "fits worse" in words for words in fit.messages)


def test_a_current_and_torquers_without_attitude() -> None:
    """Springmann & Cutler 2012: the field of a square-wave current. Ignored, b is off by half the swing; estimated,
    it and b come out within their sigmas. T too, from torquers that fire at random."""
    s, T, found, of_T = (
        np.array([500.0, -300.0, 200.0]),
        np.array([[12.0, -4.0, 3.0], [2.0, -9.0, 5.0], [-6.0, 1.0, 15.0]]),
        [],
        [],
    )
    for seed in range(30):
        rng = np.random.default_rng([8, seed])
        current = (np.arange(900) // 60 % 2).astype(float)
        field = varied(rng, 900)
        rows = rows_of(field, rng, added=current[:, None] * s, columns={"array_current_A": current})
        fit = fit_rows(rows, ScalarOptions(noise_nT=200.0, covariance="white", robust="none"))
        bias = fit.calibration.telemetry_bias["array_current_A"]
        found.append(np.concatenate([pulls(fit), (bias.value_nT - s) / bias.sigma_nT]))
        ignored = fit_rows(
            Design(rows.time, rows.B_nT, rows.H_nT, {}, rows.rows, {}),
            ScalarOptions(noise_nT=200.0, covariance="white", robust="none"),
        )
        dipole = rng.choice([-20.0, 0.0, 20.0], (900, 3))
        names = {f"dipole_{axis}_Am2": dipole[:, i] for i, axis in enumerate("xyz")}
        added = -dipole @ np.linalg.solve(np.eye(3) + D, T).T
        known = fit_rows(
            rows_of(field, rng, added=added, columns=names),
            ScalarOptions(parameters="b,S,T", noise_nT=200.0, covariance="white", robust="none"),
        ).calibration
        assert known.T_nT_per_Am2 is not None
        of_T.append((known.T_nT_per_Am2 - T).ravel() / known.sigmas[12:])
    check_pulls(found)
    check_pulls(of_T)
    assert np.abs(pulls(ignored)[6:]).max() > 8.0
    assert ignored.quality["chi2_per_sample"] > 1.3
    assert any("times what the noise gives" in words for words in ignored.messages)


def test_a_constant_column_and_a_silent_torquer() -> None:
    rng = np.random.default_rng(9)
    columns = {"array_current_A": np.full(600, 2.0)}
    with pytest.raises(NoAnswer, match=r"b1 .*array_current_A|array_current_A x") as refusal:
        fit_rows(rows_of(varied(rng), rng, columns=columns), ScalarOptions(robust="none"))
    assert any(name.startswith("array_current_A") for name in refusal.value.evidence["parameters"])
    dipole = rng.choice([-20.0, 20.0], (600, 3)) * np.array([1.0, 0.0, 1.0])
    names = {f"dipole_{axis}_Am2": dipole[:, i] for i, axis in enumerate("xyz")}
    fit = fit_rows(rows_of(varied(rng), rng, columns=names), ScalarOptions(parameters="b,S,T", robust="none"))
    assert any("T12, T22 and T32 not estimated" in words for words in fit.observability)
    assert fit.sigma["T22"] is None
    assert fit.sigma["T11"] is not None


def test_outliers_are_set_aside() -> None:
    """1 % of 20,000 nT: least squares is lost by many sigma, Tukey's weights are not (20 runs, 180 pulls)."""
    plain, robust = [], []
    for seed in range(20):
        rng = np.random.default_rng([10, seed])
        hit = rng.random((900, 1)) < 0.01
        rows = rows_of(varied(rng, 900), rng, added=hit * 20_000.0 * rng.normal(size=(900, 3)))
        plain.append(pulls(fit_rows(rows, ScalarOptions(noise_nT=200.0, covariance="white", robust="none"))))
        fit = fit_rows(rows, ScalarOptions(noise_nT=200.0, covariance="white", robust="tukey"))
        robust.append(fit.calibration.values[9:] - B_NT)
        assert fit.rejected >= 0.5 * hit.sum()
        assert np.abs(pulls(fit)).max() < 4.5
    assert np.sqrt(np.mean(np.square(robust))) < 20.0


def test_noise_that_is_mis_stated_is_said() -> None:
    rng = np.random.default_rng(11)
    rows = rows_of(varied(rng), rng)
    for declared, said in ((200.0, False), (50.0, True), (800.0, True)):
        fit = fit_rows(rows, ScalarOptions(noise_nT=declared, lsb_nT=0.0, covariance="white", robust="none"))
        assert any("times what the noise gives" in words for words in fit.messages) is said
        assert abs(fit.calibration.sigmas[9] / 14.0 - 1.0) < 0.25  # the sigmas follow the residual: 200 sqrt(3/600)


def test_scale_errors_in_a_fit_of_the_bias_are_said() -> None:
    rng = np.random.default_rng(12)
    fit = fit_rows(rows_of(varied(rng), rng), ScalarOptions(parameters="b", robust="none"))
    assert any("S is not estimated" in words and "--parameters b,S" in words for words in fit.messages)
    fit = fit_rows(rows_of(varied(rng), rng, S=D * 0), ScalarOptions(parameters="b", robust="none"))
    assert not any("S is not estimated" in words for words in fit.messages)


def test_errors_that_hang_together_widen_the_sigmas() -> None:
    """A field model off by 150 nT with a memory of 20 rows, directions that turn as slowly. White sigmas are too small;
    those of blocks are right to 30 %; a declared error of the field too. 24 runs, 216 pulls: scatter 10 %."""
    rho = np.exp(-1.0 / 20.0)
    white, blocks, declared = [], [], []
    for seed in range(24):
        rng = np.random.default_rng([13, seed])
        slow = lfilter([150.0 * np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.normal(size=1600))[100:]
        turn = lfilter([1.0], [1.0, -rho], rng.normal(size=(1600, 3)), axis=0)[100:]
        field = turn / np.linalg.norm(turn, axis=1)[:, None] * (30_000.0 + 4000.0 * rng.uniform(-1, 1, (1500, 1)))
        rows = rows_of(field, rng, noise_nT=50.0, error_nT=slow)
        rows = Design(rows.time, rows.B_nT, rows.H_nT, {}, rows.rows, {}, radian_s=600.0)
        known = {"noise_nT": 50.0, "lsb_nT": 0.0}
        white.append(pulls(fit_rows(rows, ScalarOptions(covariance="white", **known, robust="none"))))
        blocks.append(pulls(fit_rows(rows, ScalarOptions(covariance="blocks", block_s=2400.0, **known, robust="none"))))
        declared.append(
            pulls(fit_rows(rows, ScalarOptions(covariance="white", field_error_nT=150.0, **known, robust="none")))
        )
    assert np.var(white) > 4.0
    assert 0.6 < np.var(blocks) < 1.5
    assert 0.5 < np.var(declared) < 1.4  # white and declared count the slow part twice where it is short


def test_blocks_allow_for_errors_that_are_constant_in_a_pass(passes: Any) -> None:
    """Forty passes of twelve samples, Earth-pointing, the field model wrong by 120 nT an axis in each: white sigmas are
    too small by two, the jackknife's are right (30 runs, 270 correlated pulls: scatter of the mean 0.15)."""
    white, blocks = [], []
    for seed in range(30):
        rng = np.random.default_rng([14, seed])
        B = (passes.field_B_nT - B_NT) @ np.linalg.inv(np.eye(3) + D) + 40.0 * rng.normal(size=passes.field_B_nT.shape)
        wrong = np.repeat(120.0 * rng.normal(size=(40, 3)), 12, axis=0)
        H = np.linalg.norm(passes.field_B_nT + wrong, axis=1)
        rows = Design(passes.time, B, H, {}, np.arange(480), {})
        known = {"noise_nT": 40.0, "lsb_nT": 0.0}
        white.append(pulls(fit_rows(rows, ScalarOptions(covariance="white", **known, robust="none"))))
        blocks.append(pulls(fit_rows(rows, ScalarOptions(covariance="blocks", **known, robust="none"))))
    assert np.mean(np.square(white)) > 2.5
    assert 0.6 < np.mean(np.square(blocks)) < 1.6


def test_the_rows_that_outliers_leave_must_be_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine rows for nine parameters leave nothing to take a sigma from."""
    first = calibrate._first

    def fewer(*given: Any) -> Any:
        solved, kept = first(*given)
        return solved, kept & (np.arange(kept.size) < 9)

    monkeypatch.setattr(calibrate, "_first", fewer)
    rng = np.random.default_rng(5)
    with pytest.raises(NoAnswer, match="9 usable samples"):
        fit_rows(rows_of(varied(rng, 20), rng), ScalarOptions())
