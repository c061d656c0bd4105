"""TWOSTEP, CENTER and scalar maximum likelihood against algebra, the papers, an independent minimiser and real flight.

Witnesses: Alonso & Shuster 2002 (J. Astronaut. Sci. 50, 433 and 475) and 2003 (51, 71) for the cost and the mirror;
scipy.optimize.least_squares on the costs written out here; ELFIN-A's fluxgate of 2022-01-12, whose description says
that a scalar fit of one zone means nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares, root
from scipy.optimize._numdiff import approx_derivative

from fluxtwin.calib.common.conventions import PAIRS
from fluxtwin.calib.scalar import model
from fluxtwin.calib.scalar.calibrate import calibrate_scalar
from fluxtwin.calib.scalar.model import ScalarData, pack, solve, unpack
from fluxtwin.calib.scalar.twostep import Twostep, center, moments_of, twostep
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

pytestmark = pytest.mark.reference

D = np.array([[0.03, 0.01, -0.005], [0.01, -0.02, 0.004], [-0.005, 0.004, 0.01]])
B_A = np.array([0.01, -0.02, 0.03])


def rows(seed: int, samples: int = 600, noise: float = 0.01, spread: float = 0.15, truth: np.ndarray = D) -> ScalarData:
    """Field of size about one in random directions, read as (I+D)^-1 (A H + b)."""
    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(samples, 3))
    H = 1.0 + spread * rng.uniform(-1, 1, samples)
    field = unit / np.linalg.norm(unit, axis=1)[:, None] * H[:, None]
    B = (field + B_A) @ np.linalg.inv(np.eye(3) + truth) + noise * rng.normal(size=(samples, 3))
    return ScalarData(B, H, np.zeros((samples, 0)), max(noise, 1e-9) ** 2 * np.eye(3), True)


def quartic(theta: np.ndarray, data: ScalarData, root: np.ndarray, published: bool) -> np.ndarray:
    """Weighted z - L theta + |b|^2 - mu of the 2002 papers, written out."""
    c, e = theta[:3], theta[3:]
    E = np.array([[e[0], e[3], e[4]], [e[3], e[1], e[5]], [e[4], e[5], e[2]]])
    B, variance = data.B, data.Sigma[0, 0]
    BB = np.einsum("ki,kj->kij", B, B) - (0.0 if published else variance) * np.eye(3)
    z = np.trace(BB, axis1=1, axis2=2) - data.H**2 + (3.0 * variance if published else 0.0)
    model = 2.0 * B @ c - np.einsum("ij,kij->k", E, BB) - c @ np.linalg.solve(np.eye(3) + E, c)
    return np.asarray((z - model) * root)


def weighted(found: Twostep, data: ScalarData) -> tuple[np.ndarray, np.ndarray]:
    """w (n, 3) and variance (n,) of the quartic's rows, noise 0.01."""
    P = np.eye(3) + found.D
    w = (data.B @ P - found.b) @ P
    return w, 4.0 * 1e-4 * (w**2).sum(axis=1) + 2.0 * 3.0 * 1e-8


def theta_of(found: Twostep) -> np.ndarray:
    """c and E."""
    E = 2.0 * found.D + found.D @ found.D
    return np.concatenate([(np.eye(3) + found.D) @ found.b, [E[i, j] for i, j in PAIRS]])


def test_as_published_both_steps_end_where_the_whole_quartic_cost_is_least(close: Callable[..., None]) -> None:
    data = rows(1)
    found = twostep(data, noise_term="published")
    _, variance = weighted(found, data)
    start = np.concatenate([theta_of(found)[:3], np.zeros(6)])
    witness = least_squares(quartic, start, args=(data, variance**-0.5, True), xtol=1e-15, ftol=1e-15)
    ours = theta_of(found)
    close(ours, witness.x, atol=2e-7, unit="1", because="scipy's derivative is a difference; a sigma here is 6e-4")
    assert np.abs(ours * 1.01 - witness.x).max() > 1e-4


def test_corrected_both_steps_end_where_the_score_less_its_own_noise_vanishes(close: Callable[..., None]) -> None:
    """Row by row, the mean of the score's product of noises written out: of L with v, of the weight with v."""
    data = rows(1)
    found = twostep(data)
    w, variance = weighted(found, data)
    P2 = (np.eye(3) + found.D) @ (np.eye(3) + found.D)
    from_weight = 16.0 * 1e-8 * np.einsum("ki,ij,kj->k", w, P2, w) / variance
    slopes = np.zeros((len(w), 9, 3))
    slopes[:, :3] = 2.0 * np.eye(3)
    for k, (i, j) in enumerate(PAIRS):
        for row, B in zip(slopes, data.B, strict=True):
            row[3 + k, i] -= 2.0 * B[j]
            row[3 + k, j] -= 2.0 * B[i] if i != j else 0.0

    def score(theta: np.ndarray) -> np.ndarray:
        one = np.ones(len(w))
        v = quartic(theta, data, one, False)
        L = -approx_derivative(quartic, theta, method="3-point", args=(data, one, False))
        E = np.array([[theta[3 + PAIRS.index((min(i, j), max(i, j)))] for j in range(3)] for i in range(3)])
        at = data.B @ (np.eye(3) + E) - theta[:3]
        mean = 2.0 * 1e-4 * np.einsum("kpi,ki->kp", slopes, at)
        return np.asarray(((L * (v + from_weight)[:, None] - mean) / variance[:, None]).sum(axis=0))

    ours = theta_of(found)
    witness = root(score, np.zeros(9), tol=1e-13)
    close(ours, witness.x, atol=2e-7, unit="1", because="a derivative by differences; a sigma here is 6e-4")
    plain = least_squares(quartic, ours, args=(data, variance**-0.5, False), xtol=1e-15, ftol=1e-15)
    assert np.abs(ours - plain.x).max() > 1e-5


def test_plain_least_squares_of_the_size_agrees_with_scipy(close: Callable[..., None]) -> None:
    data = rows(2)

    def cost(p: np.ndarray) -> np.ndarray:
        S, b, _ = unpack(p, data)
        y = data.B @ (np.eye(3) + S) - b
        size = np.linalg.norm(y, axis=1)
        spread = (np.eye(3) + S) @ data.Sigma @ (np.eye(3) + S)
        q = np.einsum("ki,ij,kj->k", y, spread, y) / size**2
        return np.asarray((size - data.H - (np.trace(spread) - q) / (2.0 * data.H)) / np.sqrt(q0))

    found = solve(pack(np.zeros((3, 3)), center(data), data), data, adjusted=False)
    S, b, _ = unpack(found.p, data)
    y = data.B @ (np.eye(3) + S) - b
    q0 = np.einsum("ki,ij,kj->k", y, (np.eye(3) + S) @ data.Sigma @ (np.eye(3) + S), y) / (y**2).sum(axis=1)
    witness = least_squares(cost, found.p + 1e-3, xtol=1e-15, ftol=1e-15)
    close(found.p, witness.x, atol=2e-7, unit="1", because="a sigma is 6e-4; the noise term's own slope is left out")


def test_noise_free_readings_give_the_truth(close: Callable[..., None]) -> None:
    data = rows(3, noise=0.0)
    found = twostep(data)
    ml = solve(pack(np.zeros((3, 3)), center(data), data), data)
    for got_D, got_b in ((found.D, found.b), unpack(ml.p, data)[:2]):
        close(got_D, D, atol=1e-9, unit="1", because="rounding of sums of squares")
        close(got_b, B_A, atol=1e-9, unit="1", because="rounding of sums of squares")
        with pytest.raises(AssertionError):
            close(-got_b, B_A, atol=1e-9, unit="1", because="a sign flip must be seen")


def test_where_the_size_is_constant_step_one_alone_has_the_trivial_solution(close: Callable[..., None]) -> None:
    """z less a constant is |B|^2 = L theta at E = -I, c = 0 exactly, and noise makes that the only one; step 2 finds
    the truth all the same (sigma of D here 4e-4, of b 3e-4)."""
    data = rows(4, noise=0.005, spread=0.0)
    moments = moments_of(data, np.zeros((3, 3)), np.zeros(3), "published")
    trivial = np.concatenate([np.zeros(3), -np.ones(3), np.zeros(3)])
    close(moments.LL @ trivial, moments.Lz, atol=1e-6 * np.abs(moments.Lz).max(), unit="1", because="algebra")
    found = twostep(data, noise_term="published")
    assert abs(found.centred_eigenvalue) < 1e-6
    for answer in (found, twostep(data)):
        close(answer.D, D, atol=1.6e-3, unit="1", because="four sigma")
        close(answer.b, B_A, atol=1.2e-3, unit="1", because="four sigma")


def test_published_noise_term_is_off_by_three_variances() -> None:
    """E v is + tr Sigma for measured B: D_ii come out low by 3 sigma^2/<H^2>, here 2.2e-3 or two sigma. 60 runs, mean
    of three axes: its scatter is 1.1e-3/sqrt(60)/sqrt(3) = 8e-5."""
    noise = 0.027
    of = {"corrected": [], "published": []}
    for seed in range(60):
        data = rows(100 + seed, noise=noise, samples=1800)
        for term, found in of.items():
            found.append(float(np.trace(twostep(data, noise_term=term).D - D)) / 3.0)
    assert abs(np.mean(of["corrected"])) < 3.5e-4
    assert abs(np.mean(of["published"]) + 3.0 * noise**2) < 5e-4


def test_a_field_in_a_plane_has_an_exact_mirror(close: Callable[..., None]) -> None:
    """Alonso & Shuster 2003: b and its mirror in the plane of the readings leave the same |B - b|."""
    data = rows(5, noise=0.0, truth=np.zeros((3, 3)))._replace(with_D=False)
    B = data.B.copy()
    B[:, 2] = 0.3
    H = np.linalg.norm(B - B_A, axis=1)
    flat = data._replace(B=B, H=H)
    mirror = B_A + 2.0 * np.array([0.0, 0.0, 0.3 - B_A[2]])
    close(np.linalg.norm(B - mirror, axis=1), H, atol=1e-14, unit="1", because="rounding")
    for start in (B_A, mirror):
        close(solve(start + 0.01, flat).p, start, atol=1e-6, unit="1", because="both are solutions")


@pytest.mark.parametrize("parameters", ["b,S", "b"])
def test_one_zone_of_elfin_is_refused(shared: Path, parameters: str) -> None:
    """Every zone: the field stays near the spin plane, and the direction at fault is near body X."""
    file = shared / "flight" / "elfin_a_20220112.nc"
    if not file.is_file():
        pytest.skip("ELFIN-A's file is absent")
    whole = read_telemetry(file, column_map="preset:elfin")
    edges = np.flatnonzero(np.diff(whole.time) > np.timedelta64(60, "s")) + 1
    zones = np.split(np.arange(len(whole)), edges)
    assert len(zones) == 9
    model = load_field("igrf14")
    for zone in zones:
        with pytest.raises(
            NoAnswer, match=r"means nothing|does not determine|two solutions fit equally well"
        ) as refusal:
            calibrate_scalar(whole.select(zone), model, parameters=parameters)
        assert "plane with normal body direction (0." in str(refusal.value)
        if parameters == "b,S":
            assert "S11" in refusal.value.evidence["parameters"]


def test_an_adjustment_that_runs_away_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its steps have no cost that bounds them: the last place that a magnetometer can have is kept, and is no answer."""
    data = rows(6)
    start = pack(np.zeros((3, 3)), center(data), data)
    plain = solve(start, data, adjusted=False)
    assert plain.converged
    usual = model.solve_scaled
    monkeypatch.setattr(model, "solve_scaled", lambda *given: usual(*given) if len(given) > 2 else np.full(9, np.inf))
    found = solve(start, data)
    assert not found.converged
    assert np.array_equal(found.p, plain.p)
