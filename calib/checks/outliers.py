"""Single readings that cannot be right, against the scatter of their neighbours.

What the field model, a fit of S and b, and a running median over nine rows leave is compared with its own scatter nearby.
So slow errors, of the attitude or of the model, hide nothing, and noisy stretches are allowed more than quiet ones.
"""

from __future__ import annotations

import itertools

import numpy as np

from fluxtwin.calib.checks.evidence import FLAT, slope_of_form
from fluxtwin.calib.checks.report import Finding, note, trap
from fluxtwin.calib.checks.sample import Sample
from fluxtwin.calib.checks.stuck import fill_words, least_step
from fluxtwin.calib.checks.values import GAP_STEPS
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry

STANDS_OUT = 8.0
"""Robust standard deviations: in 10 million Gaussian numbers the largest is 5.3; the scale is known to 20 %, and varies
along the record by as much again."""
FEW = 0.05
"""More rows than this share are no outliers but a rough sensor or interference: a note."""
LONGEST_RUN = 4
"""The running median over nine rows follows what lasts longer."""
_WINDOW, _BLOCK, _FIT_ROWS = 9, 200, 3000
_TOGETHER = 50_000  # rows that are turned at once: their matrices take 4 MB; any number gives the same bits
_FEWEST = 40
_ROWS_EACH = 300  # of a column whose field is fitted: ten columns make a hundred coefficients
_FURTHEST = 14  # rows: of ten pairs a run of outliers spoils four at the most


def without_gross_outliers(sample: Sample) -> Sample:
    """The sample without rows whose |B| no ellipsoid fits as it fits the others; needs no attitude."""
    if len(sample) < _FEWEST:
        return sample
    alone = np.zeros((len(sample), 0))
    left = np.abs(_ellipsoid(sample.mag_nT, np.linalg.norm(sample.field_N_nT, axis=1), alone))
    scale = MAD_TO_SIGMA * float(np.median(left))
    keep = left <= max(2.0 * STANDS_OUT * scale, 100.0)
    return sample if keep.all() or keep.mean() < 1.0 - 2.0 * FEW else sample.take(np.flatnonzero(keep))


def check_outliers(
    telemetry: Telemetry, sample: Sample | None, model: FieldModel, usable: BoolArray
) -> tuple[list[Finding], BoolArray]:
    """The trap `outliers` with its rows, or a note where readings are rough throughout; and which rows (N,) they are.

    sample: rows that can be compared with the model, with their attitude where it is known; None without positions.
    """
    mask = np.zeros(len(telemetry), dtype=bool)
    rows, left, field, jumps_nT = _left(telemetry, sample, model, usable)
    if rows.size < _FEWEST:
        return [], mask
    deviation, inner = _deviation(left, *_ends(telemetry.time[rows]))
    ratio = _ratio(deviation, inner if inner.any() else ~inner, field, least_step(telemetry.mag_B_nT[rows]))
    if jumps_nT is None:
        ratio[_driven(telemetry, rows, 1 if sample is not None else _FURTHEST)] = 0.0
    else:  # a switch that was recorded some rows early or late makes a jump as large as its field
        ratio *= np.maximum(1.0 - jumps_nT / np.maximum(np.linalg.norm(deviation, axis=1), 1e-9), 0.0)
    out = np.flatnonzero(ratio > _limit(ratio))
    tail = out.size == 0
    if tail:
        out = np.flatnonzero(ratio > STANDS_OUT)
    if out.size == 0:
        return [], mask
    runs = np.split(out, np.flatnonzero(np.diff(out) > 1) + 1)
    size = np.linalg.norm(deviation[out], axis=1)
    where = rows[out]
    evidence = (
        f"{out.size} of {rows.size} readings stand out from their neighbours by {_from_to(size)} nT, "
        f"{_from_to(ratio[out])} times the scatter there"
    )
    fill = fill_words(telemetry.mag_B_nT[where], telemetry.origin)
    if tail or out.size > max(FEW * rows.size, 3) or max(map(len, runs)) > LONGEST_RUN:
        blind = sample is None  # of |B| alone, how it curves from row to row may be all of that
        return [] if blind else [note("rough_readings", where, evidence=evidence, fill=fill)], mask
    mask[where] = True
    shown = ", ".join(epoch.iso(telemetry.time[row]) for row in where[:3]) + (", ..." if out.size > 3 else "")
    return [trap("outliers", where, evidence=evidence, shown=shown, fill=fill)], mask


def _limit(ratio: FloatArray) -> float:
    """Robust standard deviations beyond which a row is taken for an outlier, `STANDS_OUT` or more.

    Where more rows lie between three quarters of the limit and the limit than beyond it, these may all be the tail of one
    scatter, as the residual of a spinner has one: it is so for tails that fall faster than the power -2.4, as that of
    Student's t with three degrees of freedom does.
    """
    limit = STANDS_OUT
    while 0 < (beyond := np.count_nonzero(ratio > limit)) < np.count_nonzero(ratio > 0.75 * limit) - beyond:
        limit /= 0.75
    return limit


def _from_to(values: FloatArray) -> str:
    """The least and the greatest, in two digits and without an exponent; once where they read alike."""
    least, greatest = (plain(float(value), 2) for value in (values.min(), values.max()))
    return least if least == greatest else f"{least} to {greatest}"


def _left(
    telemetry: Telemetry, sample: Sample | None, model: FieldModel, usable: BoolArray
) -> tuple[np.ndarray, FloatArray, FloatArray | None, FloatArray | None]:
    """Rows, their residuals (n, 1 or 3) [nT], in GCRS axes with attitude, along the field without; in the first case the
    field (n, 3); and by how much (n,) the field of torquers, currents, drivers and flags changes among the neighbours, None
    where it was not fitted."""
    good = telemetry.has_reading & usable
    if sample is None or telemetry.r_N_km is None:
        rows = np.flatnonzero(good)
        # (n - 28,) sizes less the median mean of pairs of rows five to fourteen before and after: where they rise from row
        # to row by more than their noise, each is its own running median, and noise would show nowhere.
        size_nT = np.linalg.norm(telemetry.mag_B_nT[rows], axis=1)
        inside = np.arange(_FURTHEST, max(size_nT.size - _FURTHEST, _FURTHEST))
        pairs = [0.5 * (size_nT[inside - k] + size_nT[inside + k]) for k in range(LONGEST_RUN + 1, _FURTHEST + 1)]
        left = np.asarray(size_nT[inside] - np.median(pairs, axis=0))
        return rows[_FURTHEST:-_FURTHEST], left[:, None], None, None
    good &= telemetry.has_position
    if sample.q_NB is not None:
        good &= telemetry.has_attitude
    rows = np.flatnonzero(good)
    R_EN = frames.rotation_EN(telemetry.time[rows])
    field = np.empty((rows.size, 3))
    for part in _in_turn(rows):
        field[part] = field_N_nT(model, telemetry.time[rows[part]], telemetry.r_N_km[rows[part]], R_EN[part])
    del R_EN
    mag = telemetry.mag_B_nT[rows]
    # (n, J) what acts on the reading, each between 0 and 1, as many as the rows can tell apart. Its field is fitted too:
    # in a body that turns fast it changes from row to row.
    columns = [telemetry.array_current_A, telemetry.battery_current_A, *telemetry.drivers.values()]
    q_NB = None if sample.q_NB is None else telemetry.q_NB
    if q_NB is not None:  # |B| alone tells the others apart badly
        dipole = [] if telemetry.dipole_B_Am2 is None else list(np.nan_to_num(telemetry.dipole_B_Am2).T)
        columns = [*dipole, *columns, telemetry.heater_on, *telemetry.flags.values()]
    known = [np.asarray(column, dtype=np.float64)[rows] for column in columns if column is not None]
    moving = [(one - one.min()) / np.ptp(one) for one in known if np.isfinite(one).all() and np.ptp(one) > 0.0]
    beside = np.array(moving[: rows.size // _ROWS_EACH]).reshape(-1, rows.size).T
    whole = beside.shape[1] == len(moving) and all(np.isfinite(one).all() for one in known)
    del known, moving
    if q_NB is None:
        return rows, _ellipsoid(mag, np.linalg.norm(field, axis=1), beside)[:, None], None, None
    predicted = np.empty_like(field)
    for part in _in_turn(rows):
        predicted[part] = frames.rotation_from_q(q_NB[rows[part]]).apply(field[part])
    steady = _steady(predicted - mag)
    for column in beside.T:
        steady |= _range(column) > 0.0
    some = _some(steady)
    fit = np.column_stack([robust_fit(_terms(mag, beside, some), one) for one in predicted[some].T])
    jumps = np.linalg.norm(_range(beside @ fit[4:]), axis=1) if whole else None
    left = predicted
    for part in _in_turn(rows):
        left[part] -= _terms(mag, beside, part) @ fit
        left[part] = frames.rotation_from_q(q_NB[rows[part]]).apply(left[part], inverse=True)
    return rows, left, field, jumps


def _terms(mag_nT: FloatArray, beside: FloatArray, rows: np.ndarray | slice) -> FloatArray:
    """(n, 4 + J) scales, bias and what acts on the reading, in these rows."""
    return np.column_stack([mag_nT[rows] / 1e4, np.ones(len(mag_nT[rows])), beside[rows]])


def _in_turn(rows: np.ndarray) -> list[slice]:
    """A long record a part at a time: a rotation is turned into a matrix where it is applied."""
    return [slice(first, first + _TOGETHER) for first in range(0, rows.size, _TOGETHER)]


def _ellipsoid(mag_nT: FloatArray, size_nT: FloatArray, beside: FloatArray) -> FloatArray:
    """What a quadratic form of the readings (n, 3) leaves of |B| (n,) [nT], bias, scale and misalignment free.

    beside: (n, J) columns whose field is free as well. It is the distance of the readings, by the slope of the form at
    their neighbours: on a short arc it may be flat, more here than there.
    """
    m, size = np.hstack([mag_nT / 1e4, beside]), size_nT / 1e4
    width = m.shape[1]
    pairs = [m[:, i] * m[:, j] for i, j in itertools.combinations_with_replacement(range(width), 2)]
    design = np.column_stack([*pairs, m, np.ones(len(m))]) / (2.0 * size)[:, None]
    some = _some(_steady(mag_nT))
    form = robust_fit(design[some], (size / 2.0)[some])
    left: FloatArray = 1e4 * (size / 2.0 - design @ form)
    slope = np.linalg.norm(slope_of_form(m, form[:-1])[:, :3], axis=1, keepdims=True) / (2.0 * size)[:, None]
    return np.asarray(left / np.maximum(_running_median(slope)[:, 0], FLAT))


def _range(values: FloatArray) -> FloatArray:
    """(n, d) greatest less least among the nine rows that a running median is of."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    return np.asarray(maximum_filter1d(values, _WINDOW, axis=0) - minimum_filter1d(values, _WINDOW, axis=0))


def _steady(mag_nT: FloatArray) -> BoolArray:
    """Readings (n, 3) that do not jump out of their neighbours; a quadratic form would bend to reach those that do."""
    jump = np.linalg.norm(mag_nT - _running_median(mag_nT), axis=1)
    return np.asarray(jump <= STANDS_OUT * np.median(jump) + 1e-6)


def _some(trusted: BoolArray) -> np.ndarray:
    """At most a few thousand of the rows (n,) that are trusted."""
    rows = np.flatnonzero(trusted)
    return np.asarray(rows[np.linspace(0, rows.size - 1, min(rows.size, _FIT_ROWS)).astype(int)])


def robust_fit(X: FloatArray, y: FloatArray, sigmas: FloatArray | None = None) -> FloatArray:
    """Coefficients (c,) of least absolute deviations, by reweighting; sigmas (c,) of a prior about zero, none by default."""
    prior = np.zeros((0, X.shape[1])) if sigmas is None else np.diag(1.0 / sigmas)
    nothing = np.zeros(len(prior))
    fit = np.linalg.lstsq(X, y, rcond=1e-10)[0]
    for _ in range(12):
        left = np.abs(y - X @ fit)
        middle = np.median(left)
        weight = 1.0 / np.sqrt(np.maximum(left, 0.1 * middle + 1e-12))
        rows = np.concatenate([X * weight[:, None], np.sqrt(middle) * prior])
        fit = np.linalg.lstsq(rows, np.concatenate([y * weight, nothing]), rcond=1e-10)[0]
    return np.asarray(fit)


def _running_median(values: FloatArray) -> FloatArray:
    """(n, d) medians over nine rows."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(values, size=(_WINDOW, 1), mode="mirror"))


def _ends(time: TimeArray) -> tuple[np.ndarray, np.ndarray]:
    """(S,) first and last rows of stretches without a gap that are no shorter than the window of the running median. If less
    than half of the rows lie in such stretches, the record counts as one: the window then runs across the gaps."""
    step = np.diff(time).astype("int64")
    after = np.flatnonzero(step > GAP_STEPS * np.median(step)) + 1
    first, last = np.append(0, after), np.append(after, len(time)) - 1
    long = last - first >= _WINDOW - 1
    if 2 * (last - first + 1)[long].sum() < len(time):
        return np.array([0]), np.array([len(time) - 1])
    return first[long], last[long]


def _deviation(left: FloatArray, first: np.ndarray, last: np.ndarray) -> tuple[FloatArray, BoolArray]:
    """(n, d) what is left, less its running median, in stretches with these ends (S,), zero elsewhere; and the rows (n,)
    that have neighbours enough on both sides.

    Towards an end the window is mirrored. On a slope its median lags by two steps in the last row and by one in the row
    before. So many of the third steepest step among the next rows are no deviation there: two are those of one more outlier.
    """
    course, half = _running_median(left), _WINDOW // 2
    change = np.zeros(len(left) + 1, dtype=np.intp)
    np.add.at(change, first, 1)
    np.add.at(change, last + 1, -1)
    inner = np.asarray(np.cumsum(change[:-1]) > 0)
    sides = ((first[:, None], 1), (last[:, None], -1))
    for end, inwards in sides:
        about = np.abs(np.arange(half)[:, None] + np.arange(-half, half + 1))  # (4, 9) rows from the end
        course[end + inwards * np.arange(half)] = np.median(left[end[:, :, None] + inwards * about], axis=2)
    deviation = np.where(inner[:, None], left - course, 0.0)
    for (end, inwards), (row, lag) in itertools.product(sides, ((0, 2), (1, 1))):
        at = end[:, 0] + inwards * row
        steps = np.abs(np.diff(left[end + inwards * np.arange(row + 1, _WINDOW)], axis=1))
        beyond = np.abs(deviation[at]) - lag * np.sort(steps, axis=1)[:, -3]
        deviation[at] = np.sign(deviation[at]) * np.maximum(beyond, 0.0)
        inner[at] = False
    return deviation, inner


def _ratio(deviation: FloatArray, inner: BoolArray, field_nT: FloatArray | None, least_step_nT: float) -> FloatArray:
    """(n,) size of the deviations in robust standard deviations, which are those of the inner rows.

    With the field (n, 3): along it, where only the reading errs, and across it, where attitude errors act in
    proportion to the field.
    """
    if field_nT is None:
        return np.asarray(np.abs(deviation[:, 0]) / _scale(deviation[:, 0], inner, 0.6745, least_step_nT))
    size = np.linalg.norm(field_nT, axis=1)
    along = np.sum(deviation * field_nT, axis=1) / size
    across = np.sqrt(np.maximum(np.sum(deviation**2, axis=1) - along**2, 0.0))
    plain, both = _scale(along, inner, 0.6745, least_step_nT), _scale(across, inner, 1.1774, least_step_nT)
    lever = (size / np.median(size)) ** 2
    both = np.sqrt(np.minimum(plain, both) ** 2 + np.maximum(both**2 - plain**2, 0.0) * lever)
    return np.asarray(np.maximum(np.abs(along) / plain, across / both))


def _scale(deviation: FloatArray, inner: BoolArray, median: float, least_step_nT: float) -> FloatArray:
    """(n,) robust standard deviation of a few hundred rows around; no less than 0.7 of the record's.

    median: that of the absolute value where the standard deviation is one (0.6745 on one axis, 1.1774 on two).
    """
    size = np.abs(deviation) / median
    usual = float(np.median(size[inner]))
    parts = np.array_split(np.arange(len(size)), max(1, len(size) // _BLOCK))
    near = [np.full(len(part), np.median(size[part][inner[part]]) if inner[part].any() else usual) for part in parts]
    return np.asarray(np.maximum(np.maximum(np.concatenate(near), 0.7 * usual), 0.4 * least_step_nT + 1e-6))


def _driven(telemetry: Telemetry, rows: np.ndarray, beside: int) -> BoolArray:
    """Rows up to so many beside a torquer's pulse, a switched flag or a driver's step, where a jump has a reason; for
    records in which the fields of these cannot be fitted."""
    acts = np.zeros(len(telemetry), dtype=bool)
    if telemetry.dipole_B_Am2 is not None:
        acts |= np.nan_to_num(telemetry.dipole_B_Am2).any(axis=1)
    for flag in (telemetry.heater_on, *telemetry.flags.values()):
        if flag is not None:
            acts[1:] |= np.diff(np.nan_to_num(flag)) != 0
    for driver in telemetry.drivers.values():
        known = np.flatnonzero(np.isfinite(driver))
        step = np.abs(np.diff(driver[known], prepend=driver[known[:1]]))
        acts[known[step > 0.5 * (np.nanmax(driver, initial=-np.inf) - np.nanmin(driver, initial=np.inf))]] = True
    near = np.convolve(acts, np.ones(2 * beside + 1), mode="same") > 0.5
    return np.asarray(near[rows])
