"""The noise of a diagnosis: whitening against dense algebra, its choice on simulated noise, spikes, thin data.

Witnesses: dense covariance matrices (numpy), a Gauss-Markov process drawn step by step, and the chi-square law.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fluxtwin.gap.diagnose import _floor_log_sd
from fluxtwin.gap.noise import choice
from fluxtwin.gap.noise.choice import (
    DECLARED,
    FROM_DIFFERENCES,
    FROM_SPACING,
    NOT_KNOWN,
    Data,
    Likelihood,
    NoisePrior,
    _affordable,
    choose_noise,
    complete_budget,
    prior_of,
    reading_spacing,
    select_noise,
)
from fluxtwin.gap.noise.kernels import predict_each
from fluxtwin.gap.noise.robust_rows import first_weights, spike_weights, standing_out, weights_of
from fluxtwin.gap.noise.whitening import NoiseModel, Whitener, make_whitener, with_walk
from fluxtwin.gap.problem.problem import ALIKE, Budget, Problem, Roll, pose
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

Close = Callable[..., None]


@dataclasses.dataclass(frozen=True)
class World:
    """Noise on a design, with a wrong calibration in the residual."""

    seconds: np.ndarray
    segment: np.ndarray
    field: np.ndarray
    noise: np.ndarray
    residual: np.ndarray
    design: np.ndarray


def field_of(seconds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) nT, of the size and pace of a low orbit's."""
    u = 2 * np.pi * seconds / 5800 + rng.uniform(0, 6)
    return 25_000 * np.stack([np.cos(u), 0.4 * np.sin(1.1 * u + 1), -2 * np.sin(u)], 1) + 3000 * rng.normal(size=3)


def attitude_error(seconds: np.ndarray, theta: float, tau: float, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) rad, drawn one step after the other."""
    steps = np.diff(seconds, prepend=seconds[0] - 1e12)
    phi = np.exp(-steps / tau) if tau > 0 else np.zeros(seconds.size)
    x, out = np.zeros(3), np.empty((seconds.size, 3))
    for t, shock in enumerate(rng.standard_normal(out.shape)):
        x = phi[t] * x + np.sqrt(1 - phi[t] ** 2) * shock
        out[t] = theta * x
    return out


def design_of(seconds: np.ndarray, field: np.ndarray, columns: int) -> np.ndarray:
    """(N, 3, P): bias, the nine of a linear calibration, then harmonics per axis."""
    n, eye = seconds.size, np.eye(3)
    made = [np.tile(eye[k], (n, 1)) for k in range(3)]
    made += [np.outer(field[:, j], eye[i]) for i in range(3) for j in range(3)]
    for k in range(2, 2 + (columns - 12 + 2) // 3):
        made += [np.outer(np.sin(2 * np.pi * k * seconds / 9000 + k), eye[i]) for i in range(3)]
    return np.stack(made[:columns], axis=-1)


def world(
    rows: int,
    spacing_s: float,
    sigma: float,
    theta: float,
    tau: float,
    seed: int,
    *,
    columns: int = 40,
    uneven: float = 0.0,
    gaps: int = 0,
) -> World:
    """A record of noise; `uneven` is the scatter of the spacing over its mean, `gaps` how many hours are missing."""
    rng = np.random.default_rng(seed)
    steps = spacing_s * (1 + uneven * rng.uniform(-1, 1, rows))
    breaks = rng.choice(np.arange(1, rows), gaps, replace=False)
    steps[breaks] += 3600.0
    seconds = np.cumsum(steps)
    segment = np.cumsum(np.isin(np.arange(rows), breaks)).astype(float)
    field = field_of(seconds, rng)
    noise = sigma * rng.standard_normal((rows, 3)) + np.cross(attitude_error(seconds, theta, tau, rng), field)
    design = design_of(seconds, field, columns)
    wrong = rng.standard_normal(12) * np.r_[np.full(3, 1000.0), np.full(9, 0.005)]
    return World(seconds, segment, field, noise, noise + design[:, :, :12] @ wrong, design)


def whitener_of(w: World, noise: NoiseModel, weights: np.ndarray | None = None) -> Whitener:
    return make_whitener(turn_images(w.field), w.seconds, w.segment, noise, weights)


def chosen(w: World, prior: NoisePrior) -> NoiseModel:
    return select_noise(
        w.residual, [w.design[:, :, :12], w.design[:, :, 12:]], turn_images(w.field), w.seconds, w.segment, prior
    )[0]


# ---------------------------------------------------------------- whitening against dense algebra

MODELS = [(0.0, 0.0), (2.6e-3, 0.0), (2.6e-3, 60.0), (2.6e-3, 600.0), (1e-4, 150.0)]


def dense_attitude(w: World, theta: float, tau: float, roll: Roll = ALIKE) -> np.ndarray:
    """(3N, 3N) covariance of theta x B."""
    n = w.seconds.size
    lag = np.abs(w.seconds[:, None] - w.seconds[None, :])
    kept = np.exp(-lag / tau) if tau > 0 else np.eye(n)
    kept = np.where(w.segment[:, None] == w.segment[None, :], kept, 0.0)
    turn = np.cross(np.eye(3)[None, :, :], w.field[:, None, :])  # [t, k] = e_k x B
    across = np.eye(3) - np.outer(roll.axis, roll.axis)
    C = 3.0 * (across + roll.factor**2 * np.outer(roll.axis, roll.axis)) / (2.0 + roll.factor**2)
    return theta**2 * np.einsum("tki,kl,slj,ts->tisj", turn, C, turn, kept).reshape(3 * n, 3 * n)


def weights_for(rows: int, rng: np.random.Generator) -> np.ndarray:
    """A tenth of the components missing, some in doubt, one row gone."""
    weights = np.where(rng.random((rows, 3)) < 0.1, 0.0, rng.choice([1.0, 1.0, 0.4], (rows, 3)))
    weights[7] = 0.0
    return weights


@pytest.mark.parametrize("walk", [0.0, 0.3])
@pytest.mark.parametrize("roll", [ALIKE, Roll((1.0 / 3.0, 2.0 / 3.0, -2.0 / 3.0), 5.0)])
@pytest.mark.parametrize(("theta", "tau"), MODELS)
def test_whitening_is_that_of_the_dense_covariance(
    theta: float, tau: float, roll: Roll, walk: float, close: Close
) -> None:
    """e' V^-1 e and log det V of 70 uneven rows in three segments, with missing and doubtful components and axes of
    different noise, also beside a bias that walks from the first row on, against numpy's inverse and determinant."""
    w = world(70, 25.0, 7.0, theta, tau, 3, uneven=0.8, gaps=2)
    rng = np.random.default_rng(4)
    weights = weights_for(70, rng)
    noise = NoiseModel(7.0, theta, tau, axis_factor=(1.0, 1.4, 0.7), roll=roll)
    whitener = with_walk(whitener_of(w, noise, weights), walk)
    used = (weights > 0).ravel()
    since = w.seconds - w.seconds[0]
    white = np.square(7.0 * np.array([1.0, 1.4, 0.7])) / np.where(weights > 0, weights, 1.0)
    walked = walk**2 * np.kron(np.minimum.outer(since, since), np.eye(3))
    V = (dense_attitude(w, theta, tau, roll) + np.diag(white.ravel()) + walked)[np.ix_(used, used)]
    columns = rng.standard_normal((70, 3, 5))
    flat = columns.reshape(-1, 5)[used]
    expected = flat.T @ np.linalg.solve(V, flat)
    done = whitener.apply(columns).reshape(-1, 5)
    scale = float(np.abs(expected).max())
    close(done.T @ done / scale, expected / scale, atol=1e-9, unit="of the largest", because="rounding of the filter")
    close(whitener.log_det, np.linalg.slogdet(V)[1], atol=1e-8, unit="", because="rounding, 200 factors")
    assert not done[~used].any()
    assert whitener.measured == int(used.sum())
    # A whitener of another noise does not pass: the comparison can fail.
    other = whitener_of(w, dataclasses.replace(noise, sigma_nT=7.07, theta_rad=theta * 1.01), weights).apply(columns)
    assert np.abs(np.einsum("tip,tiq->pq", other, other) / scale - expected / scale).max() > 1e-4


def test_each_component_is_predicted_by_all_others(close: Close) -> None:
    """Leave-one-out differences and their sigmas against dense conditional normal distributions."""
    theta, tau = 2.6e-3, 90.0
    w = world(40, 25.0, 7.0, theta, tau, 5, uneven=0.8, gaps=1)
    rng = np.random.default_rng(6)
    weights, own = weights_for(40, rng), np.ones((40, 3))
    found, plain = np.empty((40, 3)), np.empty((40, 3))
    known = make_whitener(
        turn_images(w.field), w.seconds, w.segment, NoiseModel(7.0, theta, tau), weights, covariance=True
    )
    predict_each(known.load, known.decay, known.gains, known.covariance, weights, own, w.noise / 7.0, found, plain)
    in_nT = spike_weights(w.noise, known, np.ones((40, 3), dtype=bool))[1]
    close(in_nT, 7.0 * plain, atol=1e-9, unit="nT", because="rounding of the same in nT")
    A, y = dense_attitude(w, theta, tau) / 49.0, w.noise.ravel() / 7.0
    used = np.flatnonzero(weights.ravel() > 0)
    for i in range(120):
        others = used[used != i]
        V = A[np.ix_(others, others)] + np.diag(1.0 / weights.ravel()[others])
        gain = np.linalg.solve(V, A[others, i])
        sd = np.sqrt(1.0 + A[i, i] - gain @ A[others, i])
        close(plain.ravel()[i], y[i] - gain @ y[others], atol=1e-9, unit="sigma", because="rounding")
        close(found.ravel()[i], (y[i] - gain @ y[others]) / sd, atol=1e-9, unit="sigma", because="rounding")


def test_a_cut_component_moves_nothing() -> None:
    w = world(300, 10.0, 50.0, 2e-3, 100.0, 8)
    weights = np.ones((300, 3))
    weights[120, 1] = 0.0
    whitener = whitener_of(w, NoiseModel(50.0, 2e-3, 100.0), weights)
    corrupted = w.noise.copy()
    corrupted[120, 1] += 1e6
    np.testing.assert_array_equal(whitener.apply(corrupted), whitener.apply(w.noise))


# ---------------------------------------------------------------- whitened noise is white

WHITE = [  # theta, tau, unevenness, gaps
    (2.6e-3, 0.0, 0.0, 0),
    (2.6e-3, 60.0, 0.0, 0),
    (2.6e-3, 600.0, 0.0, 0),
    (2.6e-3, 60.0, 0.9, 5),
    (2.6e-3, 600.0, 0.9, 5),
    (0.0, 0.0, 0.9, 5),
]
_LAGS = 12


def not_white(white: np.ndarray) -> list[str]:
    """Which of 1 + 12 x 9 tests reject white noise of unit variance, each at a two-sided 1e-6."""
    n, bar = white.shape[0], stats.norm.isf(0.5e-6)
    failed = []
    if abs(stats.norm.ppf(stats.chi2.cdf(np.sum(white**2), white.size))) > bar:
        failed.append("variance")
    for lag in range(1, _LAGS + 1):
        moment = white[lag:].T @ white[:-lag] / np.sqrt(n - lag)
        failed += [f"lag {lag}"] * int((np.abs(moment) > bar).sum())
    return failed


@pytest.mark.parametrize(("theta", "tau", "uneven", "gaps"), WHITE)
def test_whitened_noise_is_white(theta: float, tau: float, uneven: float, gaps: int) -> None:
    """4000 rows at 20 s; false alarm of the whole test 109 x 1e-6 = 1.1e-4."""
    w = world(4000, 20.0, 100.0, theta, tau, 11, uneven=uneven, gaps=gaps)
    assert not_white(whitener_of(w, NoiseModel(100.0, theta, tau)).apply(w.noise)) == []


@pytest.mark.parametrize(
    "wrong", [NoiseModel(100.0, 0.0, 0.0), NoiseModel(100.0, 2.6e-3, 20.0), NoiseModel(108.0, 2.6e-3, 60.0)]
)
def test_a_wrong_model_does_not_whiten(wrong: NoiseModel) -> None:
    w = world(4000, 20.0, 100.0, 2.6e-3, 60.0, 12)
    assert not_white(whitener_of(w, wrong).apply(w.noise))


# ---------------------------------------------------------------- the choice

TRUTHS = [  # sigma nT, theta rad, tau s
    (200.0, 2.6e-3, 150.0),
    (200.0, 2.6e-3, 0.0),
    (20.0, 1.0e-3, 60.0),
    (20.0, 1.0e-3, 600.0),
]


@pytest.mark.parametrize(("sigma", "theta", "tau"), TRUTHS)
def test_the_choice_recovers_the_truth(sigma: float, theta: float, tau: float) -> None:
    """Ten records of 700 rows at 30 s with a wrong calibration, noise undeclared: the pulls of log sigma and log theta
    by their stated sigmas stay within chi-square limits of false alarm 1e-4 each, and none beyond 4.5."""
    pulls, taus = [], []
    for seed in range(10):
        w = world(700, 30.0, sigma, theta, tau, 100 + seed)
        found = chosen(w, NoisePrior(sigma, 0.7))
        taus.append(found.tau_s)
        pulls.append(
            [np.log(found.sigma_nT / sigma) / found.sigma_log_sd, np.log(found.theta_rad / theta) / found.theta_log_sd]
        )
    squares = np.sum(np.square(pulls), axis=0)
    assert (squares < stats.chi2.isf(1e-4, 10)).all(), f"{pulls}"
    assert np.abs(pulls).max() < 4.5
    if tau > 0:
        assert 0.4 * tau < np.median(taus) < 2.5 * tau
    else:
        assert np.median(taus) < 15.0  # half the spacing: as good as white


@pytest.mark.parametrize("factor", [1.5, 1 / 1.5])
def test_a_budget_that_is_wrong_by_half_is_corrected(factor: float, close: Close) -> None:
    """2000 rows: the data outweigh the prior of sigma (0.1 in log) a hundredfold."""
    w = world(2000, 30.0, 200.0, 2.6e-3, 150.0, 21)
    found = chosen(w, NoisePrior(200.0 * factor, 0.1, 2.6e-3 * factor))
    close(found.sigma_nT, 200.0, atol=8.0, unit="nT", because="1 % scatter at 4 sigma")
    close(
        np.log(found.theta_rad / 2.6e-3), 0.0, atol=0.35, unit="", because="scatter 0.07 at 4 sigma, pull of the prior"
    )
    assert not_white(whitener_of(w, found).apply(w.noise)) == []


def test_few_rows_keep_the_budget(close: Close) -> None:
    w = world(12, 30.0, 200.0, 2.6e-3, 150.0, 22)
    found = chosen(w, NoisePrior(200.0, 0.1, 2.6e-3))
    close(np.log(found.sigma_nT / 200.0), 0.0, atol=0.35, unit="", because="prior 0.1, three sigma and a little")


def test_columns_that_repeat_each_other_do_not_tilt_the_choice(close: Close) -> None:
    """The difference between two nodes is the same with the design given twice, in other units and other order."""
    w = world(500, 30.0, 200.0, 2.6e-3, 150.0, 23)
    one = likelihood(w, w.design)
    other = likelihood(w, np.concatenate([w.design[:, :, ::-1] * 1e6, w.design], axis=2))
    for ratio, tau in ((1.0, 0.0), (1.0, 800.0), (0.3, 60.0)):
        steps = [m.at(ratio, tau).log_posterior - m.at(0.7, 150.0).log_posterior for m in (one, other)]
        close(steps[0], steps[1], atol=1e-3, unit="", because="directions below 1e-5 of the largest are dropped")


def likelihood(w: World, design: np.ndarray) -> Likelihood:
    n = w.seconds.size
    data = Data(w.residual, design, turn_images(w.field), w.seconds, w.segment, np.ones((n, 3)))
    return Likelihood(data, NoisePrior(200.0, 0.1))


def test_the_restricted_likelihood_is_that_of_error_contrasts(close: Close) -> None:
    """Against the likelihood of contrasts U'e with U the null space of the design: differences between nodes agree
    (Harville 1974: all sets of contrasts are equivalent)."""
    w = world(60, 30.0, 200.0, 2.6e-3, 150.0, 24, columns=12)
    m = likelihood(w, w.design)
    flat = w.design.reshape(180, 12) / np.linalg.norm(w.design.reshape(180, 12), axis=0)
    U = np.linalg.svd(flat)[0][:, 12:]
    contrasts = U.T @ w.residual.ravel()
    mine, witness = [], []
    for ratio, tau in ((0.5, 0.0), (0.5, 300.0), (2.0, 60.0)):
        at = m.at(ratio, tau)
        V = U.T @ (dense_attitude(w, at.noise.theta_rad, tau) + at.noise.sigma_nT**2 * np.eye(180)) @ U
        prior = m.prior.log_density(at.noise.sigma_nT, at.noise.theta_rad, tau)
        mine.append(at.log_posterior - prior)
        witness.append(-0.5 * (np.linalg.slogdet(V)[1] + contrasts @ np.linalg.solve(V, contrasts)))
    close(np.diff(mine), np.diff(witness), atol=1e-6, unit="", because="rounding")


def test_an_axis_with_more_noise_gets_its_own(close: Close) -> None:
    w = world(2000, 30.0, 200.0, 2.6e-3, 150.0, 25)
    extra = np.random.default_rng(26).standard_normal(2000) * 300.0
    w.residual[:, 2] += extra
    found = chosen(w, NoisePrior(200.0, 0.1, 2.6e-3))
    close(found.white_nT, [200.0, 200.0, 360.6], atol=25.0, unit="nT", because="estimated from differences; 7 %")
    even = chosen(world(2000, 30.0, 200.0, 2.6e-3, 150.0, 25), NoisePrior(200.0, 0.1, 2.6e-3))
    assert even.axis_factor == (1.0, 1.0, 1.0)


# ---------------------------------------------------------------- many rows


@pytest.mark.parametrize("tau", [0.0, 5.0, 200.0])
def test_many_rows_show_the_noise(tau: float) -> None:
    """30,000 rows at 1 s: pulls of sigma and theta by their stated sigmas; false alarm about 1e-4."""
    w = world(30_000, 1.0, 100.0, 2.6e-3, tau, 31, columns=21)
    found = chosen(w, NoisePrior(100.0, 0.1, 2.6e-3))
    assert abs(np.log(found.sigma_nT / 100.0)) < 4 * found.sigma_log_sd + 0.01  # 1 %: a mean hides a little of theta
    assert abs(np.log(found.theta_rad / 2.6e-3)) < 4 * found.theta_log_sd + 0.02
    if tau > 0:
        assert abs(np.log(found.tau_s / tau)) < 4 * found.tau_log_sd + 0.1


# ---------------------------------------------------------------- spikes


def corrupted(w: World, share: float, seed: int, lsb: float = 440.0) -> tuple[World, np.ndarray]:
    """One component of a share of the rows with a bit of 2**0 to 2**7 LSB flipped."""
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(rng.random(w.seconds.size) < share)
    flips = np.zeros_like(w.residual)
    flips[rows, rng.integers(0, 3, rows.size)] = (
        lsb * 2.0 ** rng.integers(0, 8, rows.size) * rng.choice([-1, 1], rows.size)
    )
    return dataclasses.replace(w, residual=w.residual + flips), flips


@pytest.mark.parametrize("tau", [0.0, 150.0])
def test_five_per_cent_bit_errors_are_survived(tau: float, close: Close) -> None:
    """Every flip of ten sigma is cut, nothing good is; the noise comes out as without them."""
    clean = world(1500, 30.0, 60.0, 1e-3, tau, 41)
    w, flips = corrupted(clean, 0.05, 42)
    blocks = [w.design[:, :, :12], w.design[:, :, 12:]]
    noise, rows = select_noise(
        w.residual, blocks, turn_images(w.field), w.seconds, w.segment, NoisePrior(60.0, 0.1, 1e-3)
    )
    size = np.hypot(60.0, 1e-3 * 50_000) if tau == 0 else 75.0
    assert rows.cut[np.abs(flips) > 10 * size].all()
    assert not rows.cut[flips == 0].any()
    assert rows.cut_rows.sum() == int((rows.weights <= 0).any(axis=1).sum()) > 40
    before = chosen(clean, NoisePrior(60.0, 0.1, 1e-3))
    close(np.log(noise.sigma_nT / before.sigma_nT), 0.0, atol=0.05, unit="", because="flips under the cut stay in")
    whitened = whitener_of(w, noise, rows.weights).apply(clean.noise)
    kept = whitened[rows.weights == 1]
    close(np.mean(kept**2), 1.0, atol=0.08, unit="", because="scatter 0.02 at 4 sigma")


def test_the_first_fit_takes_no_steep_signal_for_spikes() -> None:
    """Single rows where a column of the design acts, a hundred sigma high: signal. Bit errors beside them: spikes."""
    clean = world(1500, 30.0, 60.0, 0.0, 0.0, 46, columns=12)
    pulse = (np.arange(1500) % 17 == 0)[:, None] * np.array([0.3, 1.0, -0.4])
    w, flips = corrupted(dataclasses.replace(clean, residual=clean.residual + 6000.0 * pulse), 0.05, 47)
    cut = (
        first_weights(w.residual, np.concatenate([w.design, pulse[:, :, None]], axis=2), np.ones((1500, 3), dtype=bool))
        == 0
    )
    assert cut[np.abs(flips) > 900.0].all()
    assert not cut[flips == 0].any()


def test_nothing_is_cut_from_clean_noise() -> None:
    """9000 components: six sigma has a false alarm of 2e-9 each, 4.5 sigma of 7e-6 each (6 % to lose any weight)."""
    w = world(3000, 30.0, 200.0, 2.6e-3, 150.0, 43)
    blocks = [w.design[:, :, :12], w.design[:, :, 12:]]
    rows = select_noise(w.residual, blocks, turn_images(w.field), w.seconds, w.segment, NoisePrior(200.0, 0.1, 2.6e-3))[
        1
    ]
    assert rows.cut_rows.sum() == 0
    assert (rows.weights < 1).sum() <= 2


def test_an_unmodelled_effect_is_not_cut_as_spikes() -> None:
    """A field that is switched on for a few rows at a time, and a fast oscillation, eight sigma each."""
    w = world(1500, 30.0, 100.0, 5e-4, 150.0, 44, columns=12)
    on = (np.arange(1500) // 5) % 9 == 0
    fast = np.sin(2.1 * np.arange(1500))
    for shape in (on.astype(float), fast):
        extra = 800.0 * shape[:, None] * np.array([0.2, 1.0, -0.5])
        args = (turn_images(w.field), w.seconds, w.segment, NoisePrior(100.0, 0.1, 5e-4))
        rows = select_noise(w.residual + extra, [w.design], *args)[1]
        assert rows.cut_rows.sum() <= 3


def test_noise_that_was_only_guessed_makes_no_spikes_of_what_kicks_now_and_then() -> None:
    """Kicks in one row of seven over a quarter of each orbit, as over the aurora: what the quiet rows have is no budget."""
    w = world(2000, 30.0, 20.0, 5e-4, 150.0, 45, columns=12)
    rng, loud = np.random.default_rng(46), np.mod(w.seconds, 5700.0) < 1400.0
    extra = 160.0 * (loud & (rng.random(2000) < 0.15))[:, None] * rng.choice([-1, 1], (2000, 3))
    args = (w.residual + extra, [w.design], turn_images(w.field), w.seconds, w.segment)
    guessed, declared = (select_noise(*args, NoisePrior(20.0, sd, 5e-4))[1].cut_rows.mean() for sd in (0.7, 0.1))
    assert guessed < 0.01 < declared


def test_at_most_a_tenth_of_the_rows_is_cut() -> None:
    distance = np.full((1000, 3), 1.0)
    distance[:400, 1] = np.linspace(7.0, 60.0, 400)
    cut = weights_of(distance) <= 0
    assert cut.any(axis=1).sum() == 100
    assert cut[300:400, 1].all()


def test_standing_out_counts_in_sigmas(close: Close) -> None:
    rng = np.random.default_rng(45)
    values = 3.0 * rng.standard_normal((4001, 3)) + np.linspace(0, 900, 4001)[:, None]
    values[2000, 1] += 36.0
    distance = standing_out(values - np.linspace(0, 900, 4001)[:, None])
    assert np.unravel_index(np.argmax(distance), distance.shape) == (2000, 1)
    close(distance[2000, 1], 12.0, atol=5.0, unit="sigma", because="the spike's own noise and a scatter from 25 rows")


def test_nothing_stands_out_of_noise_that_is_known_to_be_larger(close: Close) -> None:
    """Where a record happens to be quieter than its noise, a spike counts in sigmas of the noise."""
    values = np.random.default_rng(46).standard_normal((401, 3))
    values[200, 1] += 36.0
    spike = values[200, 1] - np.median(values[197:204, 1])
    close(
        standing_out(values, 9.0)[200, 1],
        spike / 9.0,
        atol=1e-12,
        unit="sigma",
        because="seven rows, by the definition",
    )


# ---------------------------------------------------------------- thin and degenerate data


@pytest.mark.parametrize("rows", [1, 2, 3, 5, 9, 17, 33])
def test_few_rows_do_not_break_it(rows: int) -> None:
    w = world(rows, 30.0, 200.0, 2.6e-3, 150.0, 51)
    found = chosen(w, NoisePrior(200.0, 0.1, 2.6e-3))
    assert 50.0 < found.sigma_nT < 800.0
    assert np.isfinite([found.theta_rad, found.tau_s]).all()
    assert np.isfinite(whitener_of(w, found).apply(w.residual)).all()


def test_degenerate_designs_do_not_break_it() -> None:
    w = world(200, 30.0, 200.0, 2.6e-3, 150.0, 52)
    steady = dataclasses.replace(w, field=np.tile([20_000.0, 0.0, 0.0], (200, 1)))
    silent = dataclasses.replace(w, residual=np.zeros((200, 3)))
    no_field = dataclasses.replace(w, field=np.zeros((200, 3)))
    nothing = dataclasses.replace(w, design=np.zeros((200, 3, 40)))
    for case in (steady, silent, no_field, nothing):
        for prior in (NoisePrior(200.0, 0.1, 2.6e-3), NoisePrior(200.0, 0.7), NoisePrior(200.0, 0.1, 0.0, tau_s=0.0)):
            found = chosen(case, prior)
            assert found.sigma_nT > 0
            assert np.isfinite(whitener_of(case, found).apply(case.residual)).all()


def test_a_declared_perfect_attitude_is_believed() -> None:
    w = world(400, 30.0, 200.0, 0.0, 0.0, 53)
    found = chosen(w, NoisePrior(200.0, 0.1, 0.0))
    assert found.theta_rad == 0.0
    assert "no attitude error" in found.words


# ---------------------------------------------------------------- the budget, and a whole problem


@pytest.mark.parametrize("lsb", [4.4, 440.0, 3.90625, 0.1])
def test_the_lsb_shows_in_the_spacing(lsb: float, close: Close) -> None:
    w = world(1000, 30.0, max(3 * lsb, 20.0), 0.0, 0.0, 61)
    reading = w.field + w.noise
    on_grid = np.round(lsb * np.rint(reading / lsb), 4)  # as a file with four decimals has it
    close(reading_spacing(on_grid), lsb, atol=lsb * 1e-4, unit="nT", because="decimals of the file")
    flipped = on_grid.copy()
    flipped[::20, 0] += lsb * 2.0 ** np.random.default_rng(62).integers(0, 6, 50)
    close(reading_spacing(np.round(flipped, 4)), lsb, atol=lsb * 1e-4, unit="nT", because="bit errors are on the grid")
    assert reading_spacing(reading) is None
    assert reading_spacing(on_grid @ (np.eye(3) + 0.01 * np.sqrt([[2, 3, 5], [7, 11, 13], [17, 19, 23]]))) is None


@pytest.fixture(scope="module")
def flight() -> Problem:
    """600 rows at 30 s, earth-fixed axes as body: 60 nT noise, LSB 44 nT, attitude error 0.1 deg over 120 s."""
    rng = np.random.default_rng(71)
    time = np.datetime64("2020-03-01", "ns") + np.arange(600) * np.timedelta64(30, "s")
    orbit = Orbit(epoch_utc=time[0], altitude_km=600.0, inclination_rad=1.7, raan_rad=0.5)
    r, v = orbit.propagate(time)
    model = load_field("igrf14")
    R_BN = frames.rotation_EN(time)
    field = R_BN.apply(field_N_nT(model, time, r))
    seconds = (time - time[0]) / np.timedelta64(1, "s")
    theta = attitude_error(seconds, np.radians(0.1), 120.0, rng)
    truth = field - np.cross(theta, field)  # the reported attitude is turned by theta: prediction = truth + theta x B
    reading = 1.01 * truth + [300.0, -200.0, 100.0] + 60.0 * rng.standard_normal((600, 3))
    record = Telemetry(
        time=time, mag_B_nT=44.0 * np.rint(reading / 44.0), r_N_km=r, v_N_km_s=v, q_NB=frames.q_from_rotation(R_BN)
    )
    return pose(record, model, modelled=["bias"])


def test_as_many_columns_are_fitted_as_leave_degrees_of_freedom() -> None:
    designs = np.split(np.random.default_rng(1).normal(size=(20, 3, 12)), [9], axis=2)
    for components, count in ((24, 12), (23, 9), (19, 0)):
        assert np.array_equal(_affordable(designs, components), np.concatenate(designs, axis=2)[:, :, :count])


def test_a_prior_is_normal_in_the_logarithms() -> None:
    prior = NoisePrior(200.0, 0.1, 1e-3, 0.4, 50.0)
    law = stats.multivariate_normal(np.log([200.0, 1e-3, 50.0]), np.diag([0.1, 0.4, 0.5]) ** 2)
    at = np.array([220.0, 2e-3, 30.0])
    assert prior.log_density(*at) == pytest.approx(law.logpdf(np.log(at)) - law.logpdf(law.mean))


def test_what_is_expected_is_as_sure_as_its_parts(flight: Problem) -> None:
    noise = NoiseModel(60.0, 1e-3, 0.0, sigma_log_sd=0.03, theta_log_sd=0.2)
    assert _floor_log_sd(flight, noise, 0.75) == pytest.approx(np.hypot(0.75 * 0.03, 0.25 * 0.2))


def test_the_budget_is_completed_and_says_how(flight: Problem, close: Close) -> None:
    whole = complete_budget(flight)
    assert whole.noise_nT is not None
    assert whole.lsb_nT is not None
    close(whole.lsb_nT, 44.0, atol=1e-6, unit="nT", because="the readings are exact multiples")
    close(whole.noise_nT, 60.0, atol=12.0, unit="nT", because="scatter of a MAD of 598 second differences, 5 %, at 4")
    assert whole.attitude_sigma_rad is None
    assert dict(whole.sources or {}) == {
        "lsb_nT": FROM_SPACING,
        "noise_nT": FROM_DIFFERENCES,
        "attitude_sigma_rad": NOT_KNOWN,
        "attitude_tau_s": NOT_KNOWN,
    }
    given = complete_budget(dataclasses.replace(flight, budget=Budget(60.0, 44.0, 0.002)))
    assert dict(given.sources or {})["noise_nT"] == DECLARED
    assert prior_of(given).sigma_log_sd < prior_of(whole).sigma_log_sd
    close(prior_of(given).sigma_nT, np.sqrt(60.0**2 + 44.0**2 / 12), atol=1e-9, unit="nT", because="noise and rounding")
    assert prior_of(complete_budget(dataclasses.replace(flight, budget=whole))) == prior_of(whole)


@pytest.mark.parametrize("budget", [None, Budget(60.0, 44.0, np.radians(0.1))])
def test_a_problem_gets_its_noise(flight: Problem, budget: Budget | None, close: Close) -> None:
    problem = flight if budget is None else dataclasses.replace(flight, budget=budget)
    n = problem.rows
    scale = np.stack([np.outer(problem.field_B_nT[:, j], np.eye(3)[i]) for i in range(3) for j in range(3)], axis=2)
    noise, rows = choose_noise(problem, scale)
    white = np.sqrt(60.0**2 + 44.0**2 / 12)
    close(noise.sigma_nT, white, atol=4 * noise.sigma_log_sd * white, unit="nT", because="four stated sigmas")
    close(
        np.log(noise.theta_rad / np.radians(0.1)),
        0.0,
        atol=4 * noise.theta_log_sd,
        unit="",
        because="four stated sigmas",
    )
    assert rows.weights.shape == (n, 3)
    assert rows.cut_rows.sum() == 0
    whitener = make_whitener(
        turn_images(problem.field_B_nT), problem.setting.seconds, problem.segment, noise, rows.weights
    )
    A = whitener.apply(np.concatenate([problem.nuisance, scale], axis=2)).reshape(3 * n, -1)
    r = whitener.apply(problem.residual_nT).ravel()
    left = (r - A @ np.linalg.lstsq(A, r, rcond=None)[0]).reshape(n, 3)
    assert not_white(left) == []


def test_the_search_reaches_a_ratio_far_from_its_start() -> None:
    """White errors of 0.1 deg in 4,000 close rows are met from a start at long memory, 17 times off in the ratio."""
    w = world(4000, 0.1, 20.0, 1.745e-3, 0.0, 21)
    noise = chosen(w, NoisePrior(20.0, 0.1, 1.745e-3))
    assert noise.sigma_nT == pytest.approx(20.0, rel=0.03)  # 3 sigma: 1 / sqrt(2 * 4000) on the one component along B
    assert noise.theta_rad == pytest.approx(1.745e-3, rel=0.03)


@pytest.mark.parametrize(("third", "uneven"), [(1.6, False), (3.0, True)])
def test_axes_of_few_rows_are_uneven_beyond_chance_alone(third: float, uneven: bool) -> None:
    """30 differences know the ratio of two sizes to 22 %; four of those are allowed."""
    white = np.random.default_rng(2).standard_normal((31, 3))
    white /= np.sqrt(np.mean(np.diff(white, axis=0) ** 2, axis=0))
    whitener: Any = SimpleNamespace(apply_in_row_axes=lambda left: left, weights=np.ones((31, 3)))
    found = choice._axis_factor(whitener, white * [1.0, 1.0, third], (1.0, 1.0, 1.0), np.ones(31, dtype=bool))
    assert found == (pytest.approx(np.array([1.0, 1.0, third]) / third ** (1.0 / 3.0)) if uneven else (1.0, 1.0, 1.0))


def test_a_search_that_starts_without_memory_finds_the_memory(close: Close) -> None:
    """It starts so where the round before it held outliers for noise, or all axes to be alike."""
    w = world(1700, 5.0, 60.0, 7e-4, 800.0, 41)
    data = choice.Data(w.residual, w.design, turn_images(w.field), w.seconds, w.segment, np.ones((1700, 3)))
    likelihood = choice.Likelihood(data, NoisePrior(60.0, 0.1, 7e-4))
    best = choice.best_noise(likelihood)
    again = choice.best_noise(likelihood, NoiseModel(60.0, 7e-4, 0.0))
    assert best.noise.tau_s > 0.0
    close(again.log_posterior, best.log_posterior, atol=2 * choice.CLOSE, unit="", because="no step is taken for less")


@pytest.mark.parametrize(
    ("boresight", "shows"), [((0.0, 0.0, -1.0), True), ((0.6, 0.0, 0.8), True), ((0.48, 0.64, -0.6), False)]
)
def test_an_attitude_error_about_one_axis_is_not_taken_for_noise_of_another(
    boresight: tuple[float, float, float], shows: bool
) -> None:
    """A star tracker's error is white, and five times as large about its boresight. Far from every body axis it is as large
    in each of the three, and nothing is looked for; noise that is larger on one axis is no such error. The axis is the
    nearest of those tried (18 deg)."""
    for seed in (51, 52):
        w = world(900, 20.0, 20.0, 0.0, 0.0, seed)
        rng = np.random.default_rng(seed)
        error = 3.5e-4 * rng.standard_normal((900, 3)) @ (np.eye(3) + 4.0 * np.outer(boresight, boresight))
        tracker = dataclasses.replace(w, residual=w.residual + np.cross(error, w.field))
        noise = chosen(tracker, NoisePrior(20.0, 0.1))
        assert noise.axis_factor == (1.0, 1.0, 1.0)
        assert (noise.roll != ALIKE) is shows
        assert not shows or abs(np.dot(noise.roll.axis, boresight)) > np.cos(np.radians(18.0))
        assert noise.theta_rad == pytest.approx(3.5e-4 * 3.0, rel=0.15)  # rms of 5, 1 and 1
        assert noise.sigma_nT == pytest.approx(20.0, rel=0.1)
        noisy = w.residual + 60.0 * np.outer(rng.standard_normal(900), np.eye(3)[int(np.argmax(np.abs(boresight)))])
        assert chosen(dataclasses.replace(w, residual=noisy), NoisePrior(20.0, 0.1)).roll == ALIKE
