"""A covariance from blocks, shrunk towards a model's: never singular, however few the blocks.

h_b, scores of blocks over the roots of what the model gives them, are taken as normal with a covariance W that has an
inverse Wishart prior about lambda I; how wide it is, and lambda, are weighed by the marginal likelihood (Chen 1979,
J. R. Stat. Soc. B 41, 235, has it in closed form), with half of the prior on W = I, the model as it is.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.special import logsumexp, multigammaln

from fluxtwin.sim.base.types import FloatArray

_BEYOND = np.geomspace(2.0, 2048.0, 11)
"""Degrees of freedom of the prior beyond the fewest that give it a mean."""
SURE = 3.0  # standard errors by which blocks scatter more than others do, or than chance
_LEAST = 1e-6  # of an eigenvalue relative to the largest
_SCALES = np.geomspace(0.5, 2.0**15, 33)


def half_of(total: FloatArray) -> FloatArray:
    """L (p, p) with L L' = total."""
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    value, vector = np.linalg.eigh(total / np.outer(size, size))
    return np.asarray(size[:, None] * vector * np.sqrt(np.maximum(value, _LEAST * value[-1])))


def in_units_of(half: FloatArray, scores: FloatArray, each: FloatArray) -> FloatArray:
    """h (G, p): scores of blocks over the symmetric root of the mean of their covariances (G, p, p), in units of `half`.

    The mean, not each block's own: a block weighs as it does in the sum, and directions that it hardly determines count
    for little.
    """
    down = np.linalg.inv(half)
    value, vector = np.linalg.eigh(down @ each.mean(axis=0) @ down.T)
    value = np.maximum(value, _LEAST * float(value.mean()))
    return np.asarray(scores @ down.T @ (vector / np.sqrt(value)) @ vector.T)


def grown(groupings: Iterable[tuple[FloatArray, str]]) -> tuple[FloatArray, float, str] | None:
    """(W, mean of its diagonal, words): of the shortest blocks whose scatter longer ones do not exceed.

    groupings: h and words, from short blocks to long ones. Errors that are correlated over longer than a block make
    longer ones scatter more, whatever oscillates within them. None where there are no blocks.
    """
    best: tuple[FloatArray, str] | None = None
    for h, words in groupings:
        if best is None or float((h**2).mean()) > float((best[0] ** 2).mean()) * (1.0 + SURE * np.sqrt(2.0 / h.size)):
            best = h, words
    if best is None:
        return None
    W = widening(best[0])
    return W, float(np.trace(W)) / len(W), best[1]


def widening(h: FloatArray) -> FloatArray:
    """(p, p) mean of W given h (G, p)."""
    blocks, size = h.shape
    square = h.T @ h
    value, vector = np.linalg.eigh(square)
    value = np.maximum(value, 0.0)
    log, mean = [], []
    log.append(-0.5 * float(value.sum()))
    mean.append(np.ones(size))
    for beyond in _BEYOND:
        nu = beyond + size + 1.0
        gamma = float(multigammaln(0.5 * (nu + blocks), size) - multigammaln(0.5 * nu, size))
        for scale in _SCALES:
            prior = beyond * scale
            # relative to (2 pi)^(-G p / 2)
            log.append(
                0.5 * blocks * size * np.log(2.0)
                + 0.5 * nu * size * np.log(prior)
                - 0.5 * (nu + blocks) * float(np.log(prior + value).sum())
                + gamma
            )
            mean.append((prior + value) / (nu + blocks - size - 1.0))
    weight = np.array(log)
    weight[1:] -= np.log(len(log) - 1.0)
    weight = np.exp(weight - logsumexp(weight))
    return np.asarray((vector * (weight @ np.array(mean))) @ vector.T)
