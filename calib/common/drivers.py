"""Columns of telemetry that a field follows: B = ... + s d, estimated beside S, b and T.

A column that goes with the attitude (the array's current with the sun's direction) is no harm where the reference field
is known in body axes: both are regressed together. What the data cannot distinguish is: a column that never changes from b,
one in proportion to a component of the field from S, two that go together from each other.

Of all columns (`all`) those are kept whose field is worth its three parameters and the number of columns tried, by
`criterion`. The drop of chi-square is s' C^-1 s, with C the covariance that the method states, so that errors which last
are allowed for; without a column the others are what they are on condition that its s is zero.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from fluxtwin.calib.common.criterion import THRESHOLD, worth
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.fit import Fit
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.quantities import DRIVERS
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns

F = TypeVar("F", bound=Fit)

EVERY = "all"
_LEAST_LEFT = 1e-8
"""Of its variance, that a column must have beside others: a ten-thousandth of its swing."""
_LEAST_KNOWN = 0.5
"""Share of the rows with a reading in which one of all columns must be known: the others would be left out."""
_SAME = 0.9
_CONSTANT = 1e-9
"""Of its largest value, that a column must move by."""


@dataclass(frozen=True)
class Asked:
    """The columns that are asked for."""

    columns: Mapping[str, FloatArray]
    """(N,) of the telemetry, by its names."""
    every: bool
    """Whether they are all there are, to be chosen from."""
    left_out: Mapping[str, str]
    """Why a column was not tried, by name."""


def asked_for(telemetry: Telemetry, names: Sequence[str]) -> Asked:
    """Columns by NAME of `driver_NAME`, or by their own names; `all`: each `driver_NAME`. BadInput for an absent one."""
    known = {name: v for name, v in recorded_columns(telemetry).items() if v.ndim == 1}
    found: dict[str, FloatArray] = {}
    left_out: dict[str, str] = {}
    if EVERY in names:
        read = telemetry.has_reading
        for name in known:
            if DRIVERS.name_in(name) is not None:
                share = float(np.isfinite(known[name])[read].mean()) if read.any() else 0.0
                if share < _LEAST_KNOWN:
                    left_out[name] = f"it is known in {100.0 * share:.0f} % of the rows with a reading"
                else:
                    found[name] = known[name]
    for name in names:
        column = next((one for one in (DRIVERS.prefix + name, name) if one in known), None)
        if column is not None:
            found[column] = known[column]
        elif name != EVERY:
            near = difflib.get_close_matches(name, [*known, *telemetry.drivers], n=1, cutoff=0.4)
            hint = f"{near[0]!r} is near" if near else ", ".join(known) or "this telemetry has no such column"
            raise BadInput(f"the telemetry has no column {name!r}", where="--driver", wanted=hint)
    return Asked(found, EVERY in names, left_out)


def fitted(asked: Asked, rows: Mapping[str, FloatArray], others: FloatArray, fit: Callable[[Sequence[str]], F]) -> F:
    """The fit with the columns that are asked for, or, of all, with those that are worth it; what was dropped is said.

    rows: (n,) the columns in the rows that are fitted; others: (n, k) what else is fitted there. fit: by names of columns.
    Raises NoAnswer where a column that is asked for by name cannot be distinguished.
    """
    if not asked.columns and not asked.every:
        return fit(())
    apart, same = told_apart({name: rows[name] for name in asked.columns}, others)
    if same and not asked.every:
        name, why = next(iter(same.items()))
        raise NoAnswer(
            f"the field of {name} cannot be estimated: {why}. Leave --driver {name} out", evidence={"drivers": same}
        )
    whole = fit(apart)
    kept, worths = chosen(whole)
    if not asked.every:
        unseen = [name for name in apart if name not in kept]
        said = f"no field of {' or '.join(unseen)} is seen beyond chance: compare without"
        return replace(whole, messages=(*whole.messages, said)) if unseen else whole
    final = whole if len(kept) == len(apart) else fit(kept)
    dropped = [f"{name} ({plain(value)})" for name, value in worths.items() if name not in kept]
    said = f"kept of {len(apart)} columns: {', '.join(kept) or 'none'}"
    if dropped:
        said += (
            f". Dropped, because what they explain (in chi-square, less what {len(apart)} columns would by chance; "
            f"{THRESHOLD:g} are wanted) is too little: {', '.join(dropped)}"
        )
    reasons = {**asked.left_out, **same}
    more = [f"{name} was not tried: {why}" for name, why in reasons.items()]
    return replace(final, messages=(*final.messages, said, *more))


def told_apart(columns: Mapping[str, FloatArray], others: FloatArray) -> tuple[tuple[str, ...], dict[str, str]]:
    """Names of columns (n,) that are no combination of a constant, of others (n, k) and of those before, and why not."""
    basis, kept = np.zeros((len(others), 0)), list[str]()
    for column in others.T:
        basis = _with(basis, column)
    alone, same = basis, dict[str, str]()
    for name, column in columns.items():
        wider = _with(basis, column)
        if wider is not basis:
            basis, kept = wider, [*kept, name]
        elif _constant(column):
            same[name] = "it never changes, so its field is in b"
        elif _with(alone, column) is alone:
            same[name] = "it follows the field, or a torquer, so its field is in S or T"
        else:
            likeness = {one: abs(float(np.corrcoef(column, columns[one])[0, 1])) for one in kept}
            twin = max(likeness, key=lambda one: likeness[one])
            others_too = "a combination of the field and of other columns"
            same[name] = f"it goes together with {twin}" if likeness[twin] > _SAME else f"it is {others_too}"
    return tuple(kept), same


def _constant(column: FloatArray) -> bool:
    return bool(np.ptp(column) <= _CONSTANT * np.abs(column).max())


def _with(basis: FloatArray, column: FloatArray) -> FloatArray:
    """An orthonormal basis (n, k) of columns less their means, and what a further one (n,) adds; itself where that is
    nothing."""
    if _constant(column):
        return basis
    level = column - column.mean()
    left = level / np.linalg.norm(level)
    for _ in range(2):  # twice is enough: the second pass removes the rounding of the first
        left = left - basis @ (basis.T @ left)
    length = float(np.linalg.norm(left))
    return basis if length**2 < _LEAST_LEFT else np.hstack([basis, (left / length)[:, None]])


def chosen(fit: Fit) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names of the columns whose field is worth its parameters, and the worth of each: when dropped, or in the end.

    The least of them is dropped as long as it is below the threshold.
    """
    found = fit.calibration.telemetry_bias
    names = list(found)
    values = np.concatenate([np.zeros(0), *(found[name].value_nT for name in names)])
    covariance, tried = fit.driver_covariance, float(np.log(max(len(names), 1)))
    worths: dict[str, float] = {}
    while names:
        now = {}
        for k, name in enumerate(names):
            own = slice(3 * k, 3 * k + 3)
            drop = float(values[own] @ np.linalg.solve(covariance[own, own], values[own]))
            now[name] = worth(drop, 3, len(fit.time), tried)
        least = min(now, key=lambda name: now[name])
        if now[least] >= THRESHOLD:
            return tuple(names), {**worths, **now}
        worths[least] = now[least]
        k = names.index(least)
        own = slice(3 * k, 3 * k + 3)
        pull = np.linalg.solve(covariance[own, own], covariance[own]).T
        values, covariance = values - pull @ values[own], covariance - pull @ covariance[own]
        left = np.r_[0 : 3 * k, 3 * k + 3 : len(values)]
        values, covariance = values[left], covariance[np.ix_(left, left)]
        names.remove(least)
    return (), worths
