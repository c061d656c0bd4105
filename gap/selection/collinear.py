"""Pairs of causes that undo each other: what only their small difference explains is no proof of two large ones."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fluxtwin.gap.linear.leftover import orthonormal
from fluxtwin.gap.selection.refit import Channel, Fit
from fluxtwin.sim.base.types import FloatArray

_OPPOSITE = -0.9  # cosine of two signals, in the linear model, from which on they are looked at closely
_LITTLE = 0.2  # of the smaller signal: what a pair may leave at the least


def undone(channel: Channel, fit: Fit, nuisance: FloatArray, alone: Sequence[bool]) -> bool:
    """Whether two of a fit's effects leave together less than a fifth of what either does by itself.

    Signals are whitened and beside the nuisance (M, 3, c). alone: for each chosen effect, whether it is significant
    by itself; two that both are may well undo each other.
    """
    if len(fit.chosen) < 2 or sum(alone) == len(alone):
        return False
    basis = orthonormal(nuisance)
    linear = [
        _beside(basis, fit.jacobian[:, :, part] @ theta)
        for part, (_, theta) in zip(fit.slices(), fit.chosen, strict=True)
    ]
    for one, other in combinations(range(len(linear)), 2):
        if alone[one] and alone[other]:
            continue
        size = float(np.linalg.norm(linear[one]) * np.linalg.norm(linear[other]))
        if size == 0.0 or float(linear[one] @ linear[other]) > _OPPOSITE * size:
            continue
        of_one, of_other, of_both = (_signal(channel, fit, basis, out) for out in ((one,), (other,), (one, other)))
        if of_both < _LITTLE * min(of_one, of_other):
            return True
    return False


def _signal(channel: Channel, fit: Fit, basis: FloatArray, out: Sequence[int]) -> float:
    """Size of what these of the chosen effects do together, in the nonlinear chain."""
    left = [pair for place, pair in enumerate(fit.chosen) if place not in out]
    bare = channel.residual([*fit.modelled, *left])
    return float(np.linalg.norm(_beside(basis, bare - fit.residual)))


def _beside(basis: FloatArray, signal: FloatArray) -> FloatArray:
    flat = signal.reshape(-1)
    return np.asarray(flat - basis @ (basis.T @ flat))
