"""The rivals in the search for a law: a lasso (scikit-learn) and STLSQ (pysindy), on the same library and the same records.

Both have what the diagnosis has: the residual whitened by its noise model with S and b projected out, and every term of its
grammar in body axes, of unit length, three columns each. The lasso is the relaxed one along its whole path, STLSQ goes
through a ladder of thresholds after sure independence screening (Fan & Lv 2008), as a regression on thousands of columns
needs; the support of each is chosen by EBIC (Chen & Chen 2008) with coefficients refitted by least squares. That is better
than either by cross-validation, whose folds along an orbit repeat each other. A term counts where it carries a hundredth of
what is explained.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import gammaln

from fluxtwin.gap.law.search import Grammar, Regression
from fluxtwin.gap.linear.projection import projected
from fluxtwin.gap.noise.choice import choose_noise, whitener_of
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, Budget, pose
from fluxtwin.gap.selection.refit import settled
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

MISSING = "scikit-learn and pysindy are not installed (pip install 'fluxtwin[rivals]'): the rivals are left out"
_SCREENED = 300
_STEPS = 40
_LADDER = np.geomspace(0.5, 0.01, 12)
"""Thresholds of STLSQ, of the largest coefficient."""
_LEAST_SHARE = 0.01


def installed() -> bool:
    """Whether both rivals can be imported."""
    try:
        import pysindy  # noqa: F401
        import sklearn  # noqa: F401
    except ImportError:
        return False
    return True


def answer(path: Path, **declared: Any) -> dict[str, list[str]]:
    """Factors of the terms that each rival takes, of the record in a file."""
    record = read_telemetry(path)
    sigma_deg = declared.get("attitude_sigma_deg")
    sigma_rad = None if sigma_deg is None else float(np.radians(sigma_deg))
    budget = Budget(declared.get("noise_nT"), declared.get("lsb_nT"), sigma_rad)
    modelled = declared.get("modelled", DEFAULT_MODELLED)
    problem = settled(pose(record, load_field("igrf14", declared.get("degree")), modelled=modelled, budget=budget))
    noise, robust = choose_noise(problem)
    left = projected(whitener_of(problem, noise, robust.weights), problem.residual_nT, problem.nuisance)
    regression = Regression(problem, Grammar(problem))
    laws = [terms[0] for terms in regression.terms if terms[0].axes == "body"]
    parts = []
    for law in laws:
        columns, size = left.project(regression.block((law,)).make())
        free = np.linalg.norm(columns, axis=0)
        parts.append(np.where(free > 1e-3 * np.sqrt(size), columns / np.maximum(free, 1e-300), 0.0).astype(np.float32))
    X, y = np.concatenate(parts, axis=1), left.residual
    found = {"lasso": _lasso(X, y), "sindy": _sindy(X, y)}
    return {key: [factor for n in _owners(X, y, support) for factor in laws[n].of] for key, support in found.items()}


def _owners(X: FloatArray, y: FloatArray, support: Sequence[int]) -> list[int]:
    """Terms whose columns together carry their share of what is explained."""
    explained = _explained(X, y, support)
    owners = sorted({int(column) // 3 for column in support})
    rest = {n: [column for column in support if column // 3 != n] for n in owners}
    return [n for n in owners if explained - _explained(X, y, rest[n]) > _LEAST_SHARE * explained]


def _lasso(X: FloatArray, y: FloatArray) -> list[int]:
    from sklearn.linear_model import lars_path

    screened = _screened(X, y, 4 * _SCREENED)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, _, path = lars_path(X[:, screened].astype(np.float64), y, method="lasso", max_iter=_STEPS)
    return _best(X, y, ([int(screened[k]) for k in np.flatnonzero(step)] for step in path.T))


def _sindy(X: FloatArray, y: FloatArray) -> list[int]:
    from pysindy.optimizers import STLSQ

    screened = _screened(X, y, _SCREENED)
    columns = X[:, screened].astype(np.float64)
    largest = float(np.abs(columns.T @ y).max())
    supports = []
    for share in _LADDER:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = STLSQ(threshold=share * largest, alpha=0.05, max_iter=20).fit(columns, y[:, None])
        supports.append([int(screened[k]) for k in np.flatnonzero(np.ravel(model.coef_))])
    return _best(X, y, supports)


def _screened(X: FloatArray, y: FloatArray, most: int) -> FloatArray:
    """The columns that correlate most, whole terms."""
    score = np.sum(np.square(X.T @ y.astype(np.float32)).reshape(-1, 3), axis=1)
    best = np.argsort(-score)[: most // 3]
    return np.sort((3 * best[:, None] + np.arange(3)).ravel())


def _best(X: FloatArray, y: FloatArray, supports: Iterable[Sequence[int]]) -> list[int]:
    """The support of the lowest EBIC; that without any column among them."""
    rows, columns = y.size, X.shape[1]
    best, cost = [], float(y @ y)
    for support in supports:
        p = len(support)
        if not 0 < p <= 3 * _STEPS:
            continue
        ways = gammaln(columns + 1) - gammaln(p + 1) - gammaln(columns - p + 1)
        value = float(y @ y) - _explained(X, y, support) + p * np.log(rows) + 2.0 * float(ways)
        if value < cost:
            best, cost = list(support), value
    return best


def _explained(X: FloatArray, y: FloatArray, support: Sequence[int]) -> float:
    if not len(support):
        return 0.0
    columns = X[:, list(support)].astype(np.float64)
    return float(y @ (columns @ np.linalg.lstsq(columns, y, rcond=1e-8)[0]))
