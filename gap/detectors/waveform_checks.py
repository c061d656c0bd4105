"""Does a shape that was searched for keep its field in body axes throughout?

A line or an on/off sequence is found because it fits, and so may a piece of something else: one side band of an
error of the clock, the passes through a region. What tells them apart is that a wheel or a heater has one field in
body axes, whatever the orbit, the ambient field and its slope do. So the found columns are multiplied by each of
these; a fault is what is certain and carries more than a tenth (named effects must carry the rest).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from fluxtwin.gap.linear.leftover import Leftover, log10_sf_f, orthonormal
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.orbit import argument_of_latitude
from fluxtwin.sim.effects.signal import Setting

MOST_BESIDE = 0.1
"""Share of the energy of a shape and its variations together that the variations may have."""
_SURE_P = 0.01  # of all drivers together: so often is a true wheel or heater refused, at most
_NEIGHBOURS = 5
_FOLLOWS = 0.7  # Cohen's kappa from which two sequences are one
_NEAR = 0.05  # of a coordinate within [-1, 1]
_FEWEST_DWELLS = 4
_LEAST_ROWS = 3
_REGULAR = 0.35  # relative median deviation; that of a random telegraph is 0.69


def gains(left: Leftover, few: FloatArray, many: FloatArray) -> tuple[float, float]:
    """Columns (N, 3, k) `many` against the `few` among them: p-value, share of what the many explain beyond noise."""
    explained, ranks = [], []
    for columns in (few, many):
        basis = orthonormal(left.project(columns)[0])
        explained.append(float(np.sum((basis.T @ left.residual) ** 2)))
        ranks.append(basis.shape[1])
    rank, spare = ranks[1] - ranks[0], left.degrees - ranks[1]
    if rank <= 0 or spare < 10:
        return 1.0, 0.0
    variance = max((left.energy - explained[1]) / spare, 1e-300)
    more = max(explained[1] - explained[0], 0.0)
    whole = max(explained[1] - ranks[1] * variance, 1e-300)
    share = float(np.clip((more - rank * variance) / whole, 0.0, 1.0))
    return float(10 ** log10_sf_f(more / rank / variance, rank, spare)), share


def varies(left: Leftover, columns: FloatArray, drivers: Mapping[str, FloatArray]) -> list[str]:
    """Which drivers, (N, m) by name, the size or direction of columns (N, 3, k) changes with."""
    found = []
    for name, driver in drivers.items():
        parts = columns[:, :, :, None] * driver[:, None, None, :]
        both = np.concatenate([columns, parts.reshape(*columns.shape[:2], -1)], axis=2)
        p, share = gains(left, columns, both)
        if p < _SURE_P / len(drivers) and share > MOST_BESIDE:
            found.append(f"its field changes with {name}")
    return found


def drivers(setting: Setting) -> dict[str, FloatArray]:
    """(N, m) what a field of the spacecraft's own knows nothing of: orbit phase, ambient field, its slope; unit rms."""
    r, v, R_BN = setting.given
    u = argument_of_latitude(setting.time, r, v)
    field_N = field_N_nT(setting.model, setting.time, r) if setting.field_N_nT is None else setting.field_N_nT
    field_B = R_BN.apply(field_N)
    rate_B, along_N = setting.rates(0.0)
    slope_B = R_BN.apply(along_N) - np.cross(rate_B, field_B)
    waves = np.stack([np.cos(u), np.sin(u), np.cos(2 * u), np.sin(2 * u)], axis=1)
    return {"the orbit phase": waves, "the ambient field": _unit(field_B), "the slope of the field": _unit(slope_B)}


def halves(setting: Setting) -> dict[str, FloatArray]:
    """(N, 1) the second half of the record against the first."""
    middle = 0.5 * (setting.seconds[0] + setting.seconds[-1])
    return {"time": np.where(setting.seconds < middle, -1.0, 1.0)[:, None]}


def _unit(columns: FloatArray) -> FloatArray:
    return np.asarray(columns / max(float(np.sqrt(np.mean(columns**2))), 1e-12))


def dwells(on: BoolArray) -> list[slice]:
    """Runs of rows in one state, those at the ends included."""
    edges = [0, *(np.flatnonzero(on[1:] != on[:-1]) + 1).tolist(), on.size]
    return [slice(a, b) for a, b in pairwise(edges)]


def within_dwells(on: BoolArray) -> FloatArray:
    """(N, 2) slope and bow along each run in one state: two levels have neither."""
    shapes = np.zeros((on.size, 2))
    for run in dwells(on):
        if run.stop - run.start >= _LEAST_ROWS:
            place = np.linspace(-1.0, 1.0, run.stop - run.start)
            shapes[run] = np.stack([place, place**2 - 1.0 / 3.0], axis=1)
    return shapes


def irregular(seconds: FloatArray, on: BoolArray, sunlit: BoolArray) -> list[str]:
    """What speaks against a thermostat in the dwell times, apart by state and by sun or shadow."""
    faults = []
    inner = dwells(on)[1:-1]
    rows = {state: [run.stop - run.start for run in inner if on[run.start] == state] for state in (True, False)}
    if min(float(np.median(mine or [0])) for mine in rows.values()) < _LEAST_ROWS:
        faults.append("it dwells hardly longer than the sampling")
    lengths: dict[tuple[bool, bool], list[float]] = {}
    for run in inner:
        kind = bool(on[run.start]), bool(sunlit[(run.start + run.stop) // 2])
        lengths.setdefault(kind, []).append(float(seconds[run.stop] - seconds[run.start]))
    for mine in (np.array(kind) for kind in lengths.values()):
        if mine.size >= _FEWEST_DWELLS and np.median(np.abs(mine / np.median(mine) - 1)) > _REGULAR:
            faults.append("its dwell times are not those of a thermostat")
            break
    return faults


def follows_place(setting: Setting, on: BoolArray) -> str | None:
    """The coordinate from which the state can be told; None where it cannot.

    Each row's state is predicted by the nearest rows on other passes; agreement beyond chance is Cohen's kappa (1960,
    Educational and Psychological Measurement 20, 37).
    """
    r, v, _ = setting.given
    u = argument_of_latitude(setting.time, r, v)
    r_E = setting.R_EN.apply(r)
    turn_s = 2 * np.pi * float(np.median(np.sum(r**2, axis=1) / np.linalg.norm(np.cross(r, v), axis=1)))
    size = np.linalg.norm(r_E, axis=1)
    g10, g11, h11 = setting.model.coefficients_nT(setting.time[:1])[0, :3]
    pole = -np.array([g11, h11, g10]) / np.linalg.norm([g10, g11, h11])
    places = {
        "the orbit phase": np.stack([np.cos(u), np.sin(u)], axis=1),
        "the magnetic latitude": np.stack([r_E @ pole / size, 2.0 * (np.cos(u) > 0)], axis=1),
        "the place on the Earth": r_E / size[:, None],
    }
    for name, coordinates in places.items():
        if _kappa(setting.seconds, on, coordinates, 0.25 * turn_s) > _FOLLOWS:
            return name
    return None


def _kappa(seconds: FloatArray, on: BoolArray, coordinates: FloatArray, apart_s: float) -> float:
    rows = np.arange(0, on.size, max(on.size // 2000, 1))
    told, actual = [], []
    for row in rows:
        away = np.max(np.abs(coordinates[rows] - coordinates[row]), axis=1)
        other = np.flatnonzero((np.abs(seconds[rows] - seconds[row]) > apart_s) & (away < _NEAR))
        if other.size:
            nearest = other[np.argsort(away[other])[:_NEIGHBOURS]]
            told.append(float(np.mean(on[rows[nearest]])) > 0.5)
            actual.append(bool(on[row]))
    if len(told) < 0.3 * rows.size:
        return 0.0
    one, two = np.array(told), np.array(actual)
    chance = float(one.mean() * two.mean() + (1 - one.mean()) * (1 - two.mean()))
    return (float(np.mean(one == two)) - chance) / (1 - chance) if chance < 1 else 0.0
