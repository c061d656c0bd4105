"""Columns of telemetry that a field follows: B = ... + s d, estimated beside S, b and T.

A column that goes with the attitude (the array's current with the sun's direction) is no harm where the reference field
is known in body axes: both are regressed together. What the data cannot distinguish is: a column that never changes from b,
one in proportion to a component of the field from S, two that go together from each other.

A field may come late: each column is tried at delays and lags, and the likeliest is taken where it beats none by more than
the number that was tried would by chance.

Of all columns (`all`) those are kept whose field is worth its three parameters and the number of columns tried, by
`criterion`. The drop of chi-square is s' C^-1 s, with C the covariance that the method states, so that errors which last
are allowed for; without a column the others are what they are on condition that its s is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from fluxtwin.calib.common.criterion import THRESHOLD, worth
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.records import seconds_of
from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.sim.base.errors import BadInput, NoAnswer, names_in, nearest
from fluxtwin.sim.base.late import late, lateness_near, lateness_tried
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.columns import file_columns
from fluxtwin.sim.telemetry.quantities import DRIVERS
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns

F = TypeVar("F", bound=Fit)
Columns = Mapping[str, FloatArray]
"""(n,) by name, in the rows that are fitted."""
Drops = Callable[[F, Columns, Columns, str, FloatArray], FloatArray]
"""From a fit, its columns, what these are by now, the name of one and (n, c) what may stand in its place: by how much each
lowers chi-square, (c,), beside everything else that is fitted."""

EVERY = "all"
_LEAST_LEFT = 1e-8
"""Of its variance, that a column must have beside others: a ten-thousandth of its swing."""
_LEAST_KNOWN = 0.5
"""Share of the rows with a reading in which one of all columns must be known: the others would be left out."""
_SAME = 0.9
_PASSES = 5
_FAR = 5.0
_NO_NOISE_NT = 1e-12
_MOVES = ((1.12, 0.12), (1.12, 0.12), (1.06, 0.06), (1.03, 0.03))
_WIDE = (1.25, 0.25)
"""Of delay and lag, round by round: by what factor their sum is moved, and by how much the delay's share of it."""
_GRID = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij"), axis=-1).reshape(9, 2)
_BETTER = 1e-6
"""Of chi-square: less is rounding."""
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
    time_s: FloatArray
    """(N,) of the telemetry, since its first row."""


class _Late(NamedTuple):
    delay_s: float
    lag_s: float
    near: tuple[tuple[float, float], ...] = ()
    """Delays and lags [s] that are one sigma off: in the sum of both, and in the share of the delay."""


_NOT = _Late(0.0, 0.0)


def asked_for(telemetry: Telemetry, names: Sequence[str]) -> Asked:
    """Columns by NAME of `driver_NAME`, or by their own names; `all`: each `driver_NAME`. BadInput for an absent one."""
    names = names_in(names)
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
            elif name.endswith("_current_A") and name not in names:
                left_out[name] = f"it is no driver_NAME. --driver {name} asks for it"
    for name in names:
        column = next((one for one in (DRIVERS.prefix + name, name) if one in known), None)
        if column is not None:
            found[column] = known[column]
        elif name != EVERY:
            if name in file_columns(telemetry):
                said = f"{name!r} is not taken for what a field is in proportion to"
                raise BadInput(said, where="--driver", wanted="a copy of the column called driver_NAME")
            near = nearest(name, [*known, *telemetry.drivers], "{!r} is near", cutoff=0.4)
            wanted = near or ", ".join(known) or "a column driver_NAME in the telemetry, with any unit"
            raise BadInput(f"the telemetry has no column {name!r}", where="--driver", wanted=wanted)
    return Asked(found, EVERY in names, left_out, seconds_of(telemetry.time))


def fitted(
    asked: Asked,
    rows: np.ndarray,
    others: FloatArray,
    fit: Callable[[Columns], F],
    drops: Drops[F],
    values_of: Callable[[Columns], F] | None = None,
) -> F:
    """The fit with the columns that are asked for, or, of all, with those that are worth it; what was dropped is said.

    rows: (n,) of the telemetry that are fitted; others: (n, k) what else is fitted there. fit: by its columns; values_of:
    the same, whose covariances mean nothing, where that is less work.
    Raises NoAnswer where a column that is asked for by name cannot be distinguished.
    """
    if not asked.columns and not asked.every:
        return fit({})
    columns = {name: values[rows] for name, values in asked.columns.items()}
    apart, same = distinguishable(columns, others)
    if same and not asked.every:
        name, why = next(iter(same.items()))
        raise NoAnswer(
            f"the field of {name} cannot be estimated: {why}. Leave --driver {name} out", evidence={"drivers": same}
        )
    whole, found = fit({name: columns[name] for name in apart}), dict[str, _Late]()
    for _ in range(_PASSES):  # once more with the others as late, and rows that only looked far back in their place
        before, found = found, _lateness(asked, rows, whole, {name: columns[name] for name in apart}, drops)
        if {name: one[:2] for name, one in found.items()} == {name: one[:2] for name, one in before.items()}:
            break
        columns = {name: late(asked.time_s, asked.columns[name], *found.get(name, _NOT)[:2])[rows] for name in columns}
        apart, together = distinguishable({name: columns[name] for name in apart}, others)
        same |= together
        whole = fit({name: columns[name] for name in apart})
        if _settled(before, found):
            break
    kept, worths = chosen(whole, len(apart) * len(lateness_tried(asked.time_s)))
    final = whole if len(kept) == len(apart) or not asked.every else fit({name: columns[name] for name in kept})
    used = {name: columns[name] for name in final.calibration.telemetry_bias}

    def again(name: str, other: tuple[float, float]) -> F:
        return (values_of or fit)({**used, name: late(asked.time_s, asked.columns[name], *other)[rows]})

    final = _with_lateness(final, found, again) if found else final
    if not asked.every:
        unseen = [name for name in apart if name not in kept]
        said = f"no field of {' or '.join(unseen)} is significant: compare without it"
        return replace(final, messages=(*final.messages, said)) if unseen else final
    dropped = [f"{name} ({plain(value)})" for name, value in worths.items() if name not in kept]
    said = f"kept of {len(apart)} columns: {', '.join(kept) or 'none'}"
    if dropped:
        said += (
            f". Dropped, because they lower chi-square by too little (below: by how much, less what {len(apart)} columns "
            f"would by chance; {THRESHOLD:g} are needed): {', '.join(dropped)}"
        )
    reasons = {**asked.left_out, **same}
    more = [f"{name} was not tried: {why}" for name, why in reasons.items()]
    return replace(final, messages=(*final.messages, said, *more))


def taken_out_first(
    telemetry: Telemetry, found: Fit, fit: Callable[[Telemetry], F], progress: Progress, *, sigmas: bool
) -> F:
    """A fit by a method that takes the spacecraft's own field for constant, to readings less the fields of `found`.

    Their covariance is in its own: a refit for each of its principal parts, as in a joint fit by least squares, where what
    is left of the rows once the fields are known is independent of the fields' errors.
    """
    biases = found.calibration.telemetry_bias
    columns = found.calibration.columns_of(telemetry)

    def freed(moved_nT: FloatArray) -> F:
        B = np.array(telemetry.mag_B_nT)
        for (name, bias), more in zip(biases.items(), moved_nT.reshape(-1, 3), strict=True):
            B -= np.outer(columns[name], bias.value_nT + more)
        return fit(telemetry.replace(mag_B_nT=B))

    own = freed(np.zeros(3 * len(biases)))
    covariance = own.calibration.covariance
    parts = np.linalg.cholesky(found.driver_covariance).T if biases and sigmas else ()
    for number, part in enumerate(parts, 1):
        progress(f"refit {number} of {len(parts)}, for the errors of the fields", number / (len(parts) + 1))
        step = freed(part).calibration.values - own.calibration.values
        covariance = covariance + np.outer(step, step)
    said = f"the fields of the columns are those of {found.method}, which works with |B|"
    of_columns = [text for text in found.messages if any(name in text for name in recorded_columns(telemetry))]
    method = own.calibration.method + (f", field of {' and '.join(biases)} taken out first" if biases else "")
    calibration = replace(own.calibration, telemetry_bias=biases, covariance=covariance, method=method)
    messages = (*own.messages, *([said] if biases else []), *of_columns)
    return replace(own, calibration=calibration, driver_covariance=found.driver_covariance, messages=messages)


def _lateness(asked: Asked, rows: np.ndarray, whole: F, columns: Columns, drops: Drops[F]) -> dict[str, _Late]:
    """Of the columns whose field comes late, how late: the likeliest of what is tried, where it beats none."""
    found: dict[str, _Late] = {}
    known = dict(columns)
    for name in columns:
        raw, tried = asked.columns[name], lateness_tried(asked.time_s)
        values = drops(whole, columns, known, name, _moved(asked, raw, tried)[rows])
        best = _likeliest(values)
        if values[best] - values[0] <= 2.0 * np.log(len(tried)):
            continue
        at, top = tried[best], float(values[best])
        for moves in (None, None, *_MOVES):
            near = lateness_near(*at) if moves is None else _near(at, _GRID, moves)
            values = drops(whole, columns, known, name, _moved(asked, raw, near)[rows])
            if values.max() > top + _BETTER:
                at, top = near[_likeliest(values)], float(values.max())
        lower = top - drops(whole, columns, known, name, _moved(asked, raw, _near(at, _GRID, _WIDE))[rows])
        found[name] = _Late(*at, tuple(_near(at, _one_sigma(lower.reshape(3, 3)), _WIDE)))
        known[name] = late(asked.time_s, raw, *at)[rows]
    return found


def _settled(before: Mapping[str, _Late], found: Mapping[str, _Late]) -> bool:
    """Whether the same columns are late, as late as before to the last of the moves."""
    moved = [
        np.abs(np.subtract(one[:2], before.get(name, _NOT)[:2])).max() / sum(one[:2]) for name, one in found.items()
    ]
    return before.keys() == found.keys() and max(moved, default=0.0) <= _MOVES[-1][1]


def _likeliest(values: FloatArray) -> int:
    """The first of those that are best: a switch looks alike at every delay between two rows, but for rounding."""
    return int(np.argmax(values >= values.max() - _BETTER))


def _near(at: tuple[float, float], steps: FloatArray, moves: tuple[float, float]) -> list[tuple[float, float]]:
    """Delays and lags [s], `steps` (K, 2) from one: in their sum, and in the delay's share of it, from 0 to 1."""
    sums, share = sum(at) * moves[0] ** steps[:, 0], at[0] / sum(at)
    shares = np.clip(share + moves[1] * steps[:, 1], 0.0, 1.0)
    return [(float(part * whole), float((1.0 - part) * whole)) for whole, part in zip(sums, shares, strict=True)]


def _one_sigma(lower: FloatArray) -> FloatArray:
    """(2, 2) steps of one sigma each, independent, from how far chi-square's drop (3, 3) falls around its top: by x' H x."""
    H = np.diag([lower[::2, 1].mean(), lower[1, ::2].mean()])
    if 0.0 in lower[1, ::2]:  # a share of 0 or 1 has steps to one side
        one_way = 1.0 if lower[1, 0] == 0.0 else -1.0
        return np.asarray(np.diag([1.0, one_way]) / np.sqrt(np.maximum(H * [1.0, 2.0], 1.0)))
    H[0, 1] = H[1, 0] = (lower[0, 0] + lower[2, 2] - lower[0, 2] - lower[2, 0]) / 8.0
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1.0))).T)


def _moved(asked: Asked, column: FloatArray, tried: Sequence[tuple[float, float]]) -> FloatArray:
    """(N, c) the column at each delay and lag."""
    return np.stack([late(asked.time_s, column, *one) for one in tried], axis=1)


def _with_lateness(fit: F, found: Mapping[str, _Late], again: Callable[[str, tuple[float, float]], F]) -> F:
    """The fit whose fields follow their columns so late, with what an error of that does to it in its covariances.

    again: the fit with the column of a name at another delay and lag, of which the values count alone.
    """
    biases, covariance, of_drivers = {}, fit.calibration.covariance, fit.driver_covariance
    biases_of = fit.calibration.telemetry_bias
    for name, bias in biases_of.items():
        biases[name] = bias
        if name in found:
            for near in found[name].near:
                other = again(name, near).calibration
                moved = other.values - fit.calibration.values
                fields = np.concatenate(
                    [other.telemetry_bias[key].value_nT - biases_of[key].value_nT for key in biases_of]
                )
                covariance, of_drivers = covariance + np.outer(moved, moved), of_drivers + np.outer(fields, fields)
            biases[name] = replace(bias, delay_s=found[name].delay_s, lag_s=found[name].lag_s)
    sigma_nT = np.sqrt(np.diag(of_drivers)).reshape(-1, 3)
    biases = {name: replace(bias, sigma_nT=sigma_nT[k]) for k, (name, bias) in enumerate(biases.items())}
    calibration = replace(fit.calibration, telemetry_bias=biases, covariance=covariance)
    return replace(fit, calibration=calibration, driver_covariance=of_drivers)


def drawn_in(
    error: FloatArray,
    kept: np.ndarray,
    fields: Mapping[str, FloatArray],
    of_fit: Columns,
    now: Columns,
    name: str,
    tried: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What is left of the reading for a column `name`, (N, k, 1); what of this is beyond five times the usual error, with
    the column as it is now and with each of `tried` (N, c) in its place, (N, k, 1 + c); and that in chi-square, (1 + c,).
    The latter two for one, (N, k, 1) and (1,), where all are alike.

    error: (N, k) of the reading beside a fit, with fields (k,) or (N, k) of a unit of its columns `of_fit`; kept: (N,) its
    rows that are no outliers. What is beyond is taken off the reading, lest an outlier rule, and counts in proportion
    (Huber 1964). It is asked for beside what is tried: beside the fit, the rows that a strong field reaches late are the
    ones that are far off, and taken off they would speak for the fit.
    """
    limit = np.maximum(_FAR * MAD_TO_SIGMA * np.median(np.abs(error[kept]), axis=0), _NO_NOISE_NT)[:, None]
    error = error + sum(field * (of_fit[one] - now[one])[:, None] for one, field in fields.items())
    own, field = now[name][:, None], fields[name][..., None]
    left = error[..., None] + field * own[:, None]
    beside = left - field * np.hstack([own, tried])[:, None]
    far = beside - np.clip(beside, -limit, limit)
    if (far == far[..., :1]).all():
        far = far[..., :1]
    return left, far, 2.0 * _FAR**2 * (np.abs(far) / limit).sum(axis=(0, 1))


def drops_of(gram: FloatArray, fixed: int, beyond: FloatArray) -> FloatArray:
    """By how much blocks of three columns lower chi-square beside others.

    gram: whitened products of the `fixed` others, of the blocks, and, last, of what is fitted: one target, or one beside
    none of the blocks and one for each. beyond: (t,) of chi-square, for what was taken off each target; see `drawn_in`.
    """
    targets = len(beyond)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    G = gram / np.outer(scale, scale)
    left = G[fixed:, fixed:] - G[fixed:, :fixed] @ np.linalg.pinv(G[:fixed, :fixed], hermitian=True) @ G[:fixed, fixed:]
    squares, found = np.diag(left)[-targets:] * scale[-targets:] ** 2 + beyond, []
    starts = range(0, len(left) - targets, 3)
    own_of = np.array([left[at : at + 3, at : at + 3] for at in starts]).reshape(-1, 3, 3)
    for k, inverse in enumerate(np.linalg.pinv(own_of, rcond=_LEAST_LEFT, hermitian=True)):
        of = 0 if targets == 1 else 1 + k
        y = left[starts[k] : starts[k] + 3, of - targets]
        explained = y @ inverse @ y
        found.append(explained * scale[of - targets] ** 2 + squares[0] - squares[of])
    return np.array(found)


def distinguishable(columns: Mapping[str, FloatArray], others: FloatArray) -> tuple[tuple[str, ...], dict[str, str]]:
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


def chosen(fit: Fit, settings: int) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names of the columns whose field is worth its parameters, and the worth of each: when dropped, or in the end.

    settings: number of columns, delays and lags that were tried.

    The least of them is dropped as long as it is below the threshold.
    """
    found = fit.calibration.telemetry_bias
    names = list(found)
    values = np.concatenate([np.zeros(0), *(found[name].value_nT for name in names)])
    covariance, tried = fit.driver_covariance, float(np.log(max(settings, 1)))
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
