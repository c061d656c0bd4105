"""The regression against numpy's Householder QR, against the papers' explicit eq. 8, and in hard cases."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.calib.common.observability import pair_words
from fluxtwin.calib.common.regression import regress, residuals

pytestmark = pytest.mark.reference

RNG = np.random.default_rng(79)


def rows(count: int, spread_nT: tuple[float, float, float], mean_nT: float = 0.0) -> tuple[np.ndarray, ...]:
    """Reading, true field, dipole."""
    axes = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    field = (RNG.normal(size=(count, 3)) * spread_nT) @ axes + mean_nT
    dipole = RNG.choice([-100.0, 0.0, 100.0], size=(count, 3))
    truth = np.eye(3) + RNG.normal(size=(3, 3)) * 0.02
    reading = (field - 4000.0 - dipole @ np.diag([1.0, 0.5, -0.3])) @ np.linalg.inv(truth).T
    return reading + RNG.normal(size=field.shape) * 300.0, field, dipole


def numpy_qr(y: np.ndarray, x: np.ndarray, a: np.ndarray | None = None) -> np.ndarray:
    """(m + 1, 3) by numpy's QR of the scaled, uncentred design: the witness."""
    design = np.hstack([x, np.full((len(x), 1), np.abs(x).max())])
    root = np.ones(len(x)) if a is None else np.sqrt(a)
    Q, R = np.linalg.qr(design * root[:, None])
    found = np.linalg.solve(R, Q.T @ (y * root[:, None]))
    found[-1] *= np.abs(x).max()
    return np.asarray(found)


@pytest.mark.parametrize("count", [13, 325, 16384, 16385, 50001])
@pytest.mark.parametrize("spread", [(2e4, 2e4, 2e4), (1.3e3, 1.5e4, 3e4), (30.0, 1.5e4, 3e4)])
def test_agrees_with_qr(count: int, spread: tuple[float, float, float]) -> None:
    """1e-9 of each column's size, weights or not, dipole or not, condition up to 1e6."""
    B, H, D = rows(count, spread)
    for parts in ([B], [B, D]):
        for a in (None, RNG.uniform(0.1, 3.0, size=count)):
            found = regress(H, parts, a)
            witness = numpy_qr(H, np.hstack(parts), a)
            assert np.abs(found.M - witness[:-1].T).max() < 1e-9 * np.abs(witness[:-1]).max()
            assert np.abs(found.c - witness[-1]).max() < 1e-9 * np.abs(H).max()


def test_far_from_zero_and_hardly_varying() -> None:
    """Mean 50,000 nT, spread 2 nT in one direction."""
    for spread in (2e3, 20.0, 2.0):
        B, H, _ = rows(5000, (spread, 1e4, 1e4), mean_nT=50_000.0)
        B = H * 1.01 + RNG.normal(size=H.shape) * 1e-3
        found, witness = regress(H, [B]), numpy_qr(H - H.mean(axis=0), B - B.mean(axis=0))
        assert np.abs(found.M - witness[:-1].T).max() < 1e-9


def test_the_papers_equation_8() -> None:
    """S by the printed elimination of T, S = (<H|B> - <H|D><D|D>^-1<D|B>)(<B|B> - <B|D><D|D>^-1<D|B>)^-1."""
    B, true, D = rows(325, (2e4, 2e4, 2e4))
    h = true - B

    def cov(f: np.ndarray, g: np.ndarray) -> np.ndarray:
        return f.T @ g / len(f) - np.outer(f.mean(axis=0), g.mean(axis=0))

    inverse = np.linalg.inv(cov(D, D))
    S = (cov(h, B) - cov(h, D) @ inverse @ cov(D, B)) @ np.linalg.inv(cov(B, B) - cov(B, D) @ inverse @ cov(D, B))
    found = regress(true, [B, D])
    assert np.abs(found.M[:, :3] - np.eye(3) - S).max() < 1e-9
    b = h.mean(axis=0) - S @ B.mean(axis=0) - found.M[:, 3:] @ D.mean(axis=0)  # eq. 5c
    assert np.abs(found.c - b).max() < 1e-5
    assert np.abs(found.M[:, :3] - np.eye(3) - S.T).max() > 1e-4  # mutant: transposed


def test_moments_and_residuals() -> None:
    B, H, D = rows(20001, (1.3e3, 1.5e4, 3e4))
    a = RNG.uniform(0.5, 2.0, size=len(B))
    a /= a.sum()
    x = np.hstack([B, D])
    found = regress(H, [B, D], a)
    r = residuals(H, [B, D], found.M, found.c)
    assert np.abs(r - (H - x @ found.M.T - found.c)).max() < 1e-9
    assert np.abs(a @ r).max() < 1e-7
    assert np.abs((r * a[:, None]).T @ x / np.abs(x).max(axis=0)).max() < 1e-6
    centred = x - a @ x
    assert np.allclose(found.xx, (centred * a[:, None]).T @ centred, rtol=1e-9, atol=1e-6)
    assert np.allclose(found.rr, (r * a[:, None]).T @ r, rtol=1e-9, atol=1e-6)
    assert np.allclose(found.mean_x, a @ x, rtol=1e-12, atol=1e-9)


def test_an_exact_relation_is_found_exactly() -> None:
    """Analytic: noise-free rows give the matrix back to rounding."""
    B = RNG.normal(size=(400, 3)) * 3e4
    M = np.eye(3) + np.array([[0.021, -0.016, 0.004], [0.013, -0.022, -0.004], [0.007, -0.003, 0.002]])
    found = regress(B @ M.T + [7150.0, -2810.0, -6120.0], [B])
    assert np.abs(found.M - M).max() < 1e-13
    assert np.abs(found.c - [7150.0, -2810.0, -6120.0]).max() < 1e-8


def test_the_sigma_of_a_factor_counts_in_nT_of_the_field() -> None:
    """A pair is named where its larger sigma, 0.01 of S12 in a field of 30,000 nT or 5 nT of b1, is above the residual's."""
    covariance = np.zeros((12, 12))
    covariance[np.ix_([1, 9], [1, 9])] = [[1e-4, 0.049], [0.049, 25.0]]
    assert ["S12 and b1" in words for words in pair_words(covariance, False, 3e4, 299.0)] == [True]
    assert pair_words(covariance, False, 3e4, 301.0) == []
    assert pair_words(covariance, False, 4.0, 4.9) and not pair_words(covariance, False, 4.0, 5.1)
