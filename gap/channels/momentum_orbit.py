"""A clock error against an error along the orbit: alike in the readings of a vehicle that hardly turns, not in its torques.

A magnetometer that is sampled late leaves the torques where they are. A body that is behind its reported place has the
field, the nadir and the light of that other place to work against, so its momentum says how far along the orbit it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.gap.channels.momentum_search import Balance, Refit
from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.selection.named import SearchResult
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError, TimeTagOffset
from fluxtwin.sim.effects.response import SensorLag

_AHEAD = AlongTrackError.name
_LATE = (TimeTagOffset.name, SensorLag.name)
"""What moves the readings as an error along the orbit does, and no torque."""
_AGAINST, _FOR = 3.89, 2.58
"""Sigma: beyond the first (1e-4) a value is not there, within the second (0.01) it may be."""


def estimate(balance: Balance, fit: Refit | None, *further: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best values and sigma of the columns that are always fitted, of those of the named effects at their refit, and of
    further ones (M, 3, p), all at once; infinite sigma where there is nothing."""
    residual = balance.residual if fit is None else fit.residual
    columns = np.concatenate([balance.nuisance, *(() if fit is None else fit.columns), *further], axis=2)
    white = balance.whitener.apply(columns).reshape(-1, columns.shape[2])
    length = np.linalg.norm(white, axis=0)
    live = length > 0
    unit = white[:, live] / length[live]
    gram = np.linalg.pinv(unit.T @ unit, rcond=1e-12)
    value, sigma = np.zeros(columns.shape[2]), np.full(columns.shape[2], np.inf)
    value[live] = gram @ (unit.T @ balance.whitener.apply(residual).reshape(-1)) / length[live]
    sigma[live] = np.sqrt(np.maximum(np.diag(gram), 0.0)) / length[live]
    return value, sigma


def ahead_km(
    balance: Balance, fit: Refit | None, chosen: Sequence[int], result: SearchResult
) -> tuple[float, float] | None:
    """How far the reported position is ahead of the true one, by the balance alone, and sigma [km].

    None where no error along the orbit can be seen.
    """
    at, applied, width = None, 0.0, 0
    for effect, theta in (*result.modelled, *result.chosen):
        if effect.name == _AHEAD:
            at, applied = width, float(theta[0])
        width += len(theta)
    width, further = balance.nuisance.shape[2], []
    for number, theta in zip(chosen, () if fit is None else fit.thetas, strict=True):
        if balance.candidates[number].name == _AHEAD:
            at, applied = width, float(theta[0])
        width += len(theta)
    if at is None:
        further = [one.jacobian for one in balance.candidates if one.name == _AHEAD]
        at = width
    if at == width and not further:
        return None
    value, sigma = estimate(balance, fit, *further)
    return (applied + float(value[at]), float(sigma[at])) if np.isfinite(sigma[at]) else None


def ruled_out(result: SearchResult, whitener: Whitener, ahead: tuple[float, float] | None) -> dict[str, str]:
    """{name: why} of causes that the readings would accept and the torques do not. ahead: as `ahead_km` has it."""
    for place, one in enumerate(result.named):
        alike = {one.name, *one.group, *(name for name, _ in one.rivals)}
        if ahead is None or _AHEAD not in alike or not alike & set(_LATE):
            continue
        wanted, unsure = _by_readings_km(result, whitener, place)
        value, sigma = ahead
        none, whole = abs(value) / sigma, abs(value - wanted) / float(np.hypot(sigma, unsure))
        found = f"by the balance of the momentum the position is {value:.1f} ± {sigma:.1f} km ahead"
        if none > _AGAINST and whole < _FOR:
            return {name: f"{found}, which a clock does not do" for name in _LATE if name in alike}
        if whole > _AGAINST and none < _FOR:
            return {_AHEAD: f"{found}, and not {wanted:.1f} km as it would take"}
    return {}


def _by_readings_km(result: SearchResult, whitener: Whitener, place: int) -> tuple[float, float]:
    """The error along the orbit that would do in place of a named effect, and its sigma [km]."""
    effect, theta = result.chosen[place]
    if effect.name == _AHEAD:
        return float(theta[0]), float(result.named[place].sigma[0])
    image = next(c.jacobian for c in result.candidates if c.name == _AHEAD)
    first = sum(len(each) for _, each in (*result.modelled, *result.chosen[:place]))
    own = slice(first, first + len(theta))
    target = (result.residual_white + result.jacobian_white[:, :, own] @ theta).reshape(-1)
    rest = np.delete(result.jacobian_white, np.r_[own], axis=2)
    columns = np.concatenate([rest, whitener.apply(image)], axis=2).reshape(target.size, -1)
    length = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    gram = np.linalg.pinv((columns / length).T @ (columns / length), rcond=1e-12)
    value = gram[-1] @ ((columns / length).T @ target) / length[-1]
    return float(value), float(np.sqrt(gram[-1, -1]) / length[-1])
