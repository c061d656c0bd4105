"""The attitude as a smooth function of time, through a record of attitudes that each have an error.

About each stamp the turn to its neighbours is fitted by a polynomial in time; between two stamps the two fits are
blended. How many neighbours, and of what degree, is what predicts an attitude best from the others (leave one out:
Allen 1974, Technometrics 16:125; local polynomials: Fan & Gijbels 1996, chapter 4). Where errors are slow, an attitude
shares its error with its neighbours, and those next to it would predict it best whatever the motion (Opsomer, Wang & Yang
2001, Statistical Science 16:134): there it is the step to an attitude that is left out and predicted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.late import stretches as stretches
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames

RowArray = NDArray[np.intp]
"""Numbers of rows."""

_HALVES = (1, 2, 3, 4, 6, 9, 13, 20, 30, 45, 70, 100, 150)  # rows to either side
_DEGREES = ((1, 1), (3, 2), (5, 4))  # a polynomial of this degree needs so many rows to either side
_KEPT = np.array([0.0, 0.95])
"""Share of its error that an attitude hands on to the next: of white errors, and of slow ones. Errors in between do with
either. Not 1, because steps alone do not tell that a level is off: of 90 motions (three laws, steps of 1 to 60 s, errors of
0.1 deg with time constants of 0 to 3000 s) one got a track that was 0.6 deg off, and with 0.95 none more than 0.16 deg."""
_CENTRES = 300  # rows that choose the window; more add little
_AS_GOOD = 1.01  # of the smallest prediction error: among such fits the one that smooths least, its bias is least
_WILD = 100.0  # times the median: a single wrong attitude counts no more
_FURTHEST = 1.0  # rad from one attitude to the next: less than half a turn is one also with a wobble twice as fast
_ASTRAY = 0.1  # rad, rms: a gyro that misses the attitudes by more is none to go by
_PARTS = 6  # of the way to the next stamp: 0.4 rad each where a spinner turns by 130 deg
_TELLS = (
    0.2  # between the correlations that white and slow errors leave: 6 sigma of 900 pairs, 3 from either to the middle
)
_MOST_OWN = 0.95  # weight of a row in its own fit: beyond it the others predict nothing
_HOPELESS = 3.0  # times the smallest error: wider windows are not tried any more


@dataclass(frozen=True, eq=False)
class Places:
    """Where M moments lie among N stamps: between two that belong together, or beyond the end of a stretch."""

    row: RowArray
    """(M,) the stamp before, or beyond an end the nearest one."""
    after_s: FloatArray
    """(M,) time since that stamp, negative before it."""
    other: RowArray
    """(M,) the stamp after, or the same one beyond an end."""
    other_after_s: FloatArray
    """(M,) time since `other`."""
    weights: FloatArray
    """(M,) of `other`, from 0 to 1 with a level start and end."""


def places(time_s: FloatArray, stretch: RowArray, moments_s: FloatArray) -> Places:
    """Where moments (M,) lie among the stamps (N,), which rise."""
    if time_s.size == 1:
        row = np.zeros(moments_s.size, dtype=np.intp)
        return Places(row, moments_s - time_s[0], row, moments_s - time_s[0], np.zeros(moments_s.size))
    before = np.clip(np.searchsorted(time_s, moments_s, side="right") - 1, 0, time_s.size - 2)
    step = time_s[before + 1] - time_s[before]
    share = (moments_s - time_s[before]) / step
    nearest = np.where(share > 0.5, before + 1, before)
    between = (share >= 0.0) & (share <= 1.0) & (stretch[before] == stretch[before + 1])
    row = np.where(between, before, nearest)
    other = np.where(between, before + 1, nearest)
    weight = np.where(between, share * share * (3.0 - 2.0 * share), 0.0)
    return Places(row, moments_s - time_s[row], other, moments_s - time_s[other], weight)


@dataclass(frozen=True, eq=False)
class _Course:
    """A first course through N stamps, from which the fit takes over: steady about each stamp, or by gyro."""

    time_s: FloatArray
    rate_B_rad_s: FloatArray
    integrated: Rotation | None = None
    """From the first stamp to each, by gyro; None where each stamp's own rate is kept."""
    by_gyro: tuple[FloatArray, FloatArray] | None = None
    """Rates between stamps as `track_kernels.turned` takes them."""

    def onward(self, here: RowArray, after_s: FloatArray) -> FloatArray:
        """(n, 4) turn of the body, from axes to axes, from stamps `here` by `after_s` (n,)."""
        from fluxtwin.sim.attitude.track_kernels import steady, turned

        if self.by_gyro is None:
            return steady(here, after_s, self.rate_B_rad_s)
        return turned(*self.by_gyro, self.time_s[here], after_s, _PARTS)


@dataclass(frozen=True, eq=False)
class _Moments:
    """Sums over the neighbours of n centres, for polynomials in z = (t - t_centre - mid) / span up to a degree."""

    mid_s: FloatArray
    span_s: FloatArray
    gram: FloatArray
    """(n, d + 1, d + 1)."""
    moment: FloatArray
    """(n, d + 1, 3)."""
    onward: FloatArray
    """(n, K, d + 1) of a new error of one at the centre that later rows keep a share of."""
    before_rad: FloatArray
    """(n, 3) turn of the row before the centre; NaN where the window has none."""
    before_s: FloatArray
    """(n,) its time since the centre."""
    counts: FloatArray
    balanced: BoolArray
    """Whether there are as many rows on one side as on the other."""

    def fit(self, degree: int) -> FloatArray:
        """(n, degree + 1, 3 + K) coefficients of the fit to the turns, and to each kind of error. A stretch with few rows
        gets a lower degree."""
        order = np.arange(degree + 1)
        bare = self.counts[:, None] < order + 1 + order // 2
        gram = np.where(bare[:, :, None] | bare[:, None, :], 0.0, self.gram[:, : degree + 1, : degree + 1])
        gram[:, order, order] += bare
        right = np.concatenate([self.moment, self.onward.swapaxes(1, 2)], axis=2)[:, : degree + 1]
        return np.linalg.solve(gram, np.where(bare[:, :, None], 0.0, right))

    def off(self, fit: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(n, 3) what the centres and the rows before them stand off their fit, and (n, K) the fit to each kind of error at
        both."""
        order = np.arange(fit.shape[1])
        here, before = (
            np.einsum("nk,nkc->nc", ((after_s - self.mid_s) / self.span_s)[:, None] ** order, fit)
            for after_s in (0.0, self.before_s)
        )
        return -here[:, :3], self.before_rad - before[:, :3], here[:, 3:], before[:, 3:]


@dataclass(frozen=True, eq=False)
class AttitudeTrack:
    """A smoothed track through N attitudes."""

    time_s: FloatArray
    R_BN: Rotation
    """As recorded."""
    stretch: RowArray
    course: _Course
    coefficients_rad: FloatArray
    """(N, d + 1, 3) of the turn that is left beside the course, body axes at the stamp."""
    mid_s: FloatArray
    span_s: FloatArray
    half: int
    """Rows to either side that a fit has."""
    own_weight: FloatArray
    """(N,) weight of an attitude in the fit about it, at its stamp."""

    @property
    def degree(self) -> int:
        return int(self.coefficients_rad.shape[1]) - 1

    def at(self, moments_s: FloatArray) -> Rotation:
        """Smoothed R_BN at moments (M,); beyond an end the last fit goes on, in a straight line after one spacing."""
        from fluxtwin.sim.attitude.track_kernels import blended

        place = places(self.time_s, self.stretch, moments_s)
        first = self._about(place.row, place.after_s)
        if not place.weights.any():
            return Rotation.from_quat(first)
        second = self._about(place.other, place.other_after_s)
        return Rotation.from_quat(blended(first, second, place.weights))

    def onward(self, offset_s: float | FloatArray, rows: RowArray | None = None) -> Rotation:
        """The turn from stamps `rows` (n,), default all, to `offset_s` (or (n,)) later, by the fit about that stamp alone.

        Errors of the attitudes are in all fits, and differ from one to the next: a step from one fit to another would add
        what differs. From half a spacing to a whole one the fit goes over into the track, which follows the motion better
        there.
        """
        from fluxtwin.sim.attitude.track_kernels import blended

        rows = np.arange(self.time_s.size, dtype=np.intp) if rows is None else rows
        after = np.full(rows.shape, offset_s, dtype=np.float64)
        here = self._from_fit[rows]
        own = frames.product(Rotation.from_quat(self._about(rows, after)), here)
        reach_s = self._reach_s[rows]
        beyond = np.clip(2.0 * np.abs(after) / np.where(reach_s > 0, reach_s, np.inf) - 1.0, 0.0, 1.0)
        if not beyond.any():
            return own
        along = frames.product(self.at(self.time_s[rows] + after), here)
        return Rotation.from_quat(blended(own.as_quat(), along.as_quat(), beyond * beyond * (3.0 - 2.0 * beyond)))

    def reaches(self, moments_s: FloatArray) -> BoolArray:
        """(M,) whether moments lie between two stamps of a stretch, or at most half a spacing beyond its end."""
        place = places(self.time_s, self.stretch, moments_s)
        return np.asarray((place.other != place.row) | (np.abs(place.after_s) <= 0.501 * self._reach_s[place.row]))

    def _about(self, row: RowArray, after_s: FloatArray) -> FloatArray:
        """(M, 4) quaternions of the fit about stamps `row` (M,), `after_s` later."""
        from fluxtwin.sim.attitude.track_kernels import about

        fits = (self._reach_s, self.mid_s, self.span_s, self.coefficients_rad)
        return about(row, after_s, *fits, self.course.onward(row, after_s), self._q_BN)

    @cached_property
    def _from_fit(self) -> Rotation:
        """(N,) from the fit about each stamp, at that stamp."""
        rows = np.arange(self.time_s.size, dtype=np.intp)
        return Rotation.from_quat(self._about(rows, np.zeros(rows.size))).inv()

    @cached_property
    def _q_BN(self) -> FloatArray:
        return np.asarray(self.R_BN.as_quat())

    @cached_property
    def _reach_s(self) -> FloatArray:
        """(N,) the longer of the steps to the next stamps of the stretch."""
        step = np.where(np.diff(self.stretch) == 0, np.diff(self.time_s), 0.0)
        return np.asarray(np.maximum(np.append(step, 0.0), np.append(0.0, step)))


def better(track: AttitudeTrack, denser: AttitudeTrack) -> AttitudeTrack:
    """Which of two tracks to go by, the first through some of the attitudes of the second: the first, which smooths longer,
    unless it predicts the attitudes between its own worse than their neighbours do."""
    between = np.flatnonzero(~np.isin(denser.time_s, track.time_s))
    at_s, R_BN = denser.time_s[between], denser.R_BN[between]
    off = [(one.at(at_s) * R_BN.inv()).magnitude() for one in (track, denser)]
    off[1] /= 1.0 - np.minimum(
        denser.own_weight[between], _MOST_OWN
    )  # the fit is linear: so much without the attitude itself
    error, least = (np.mean(np.minimum(one**2, _WILD * np.median(one**2))) for one in off)
    return track if error <= _AS_GOOD * least else denser


def smoothed(time_s: FloatArray, R_BN: Rotation, gyro_B_rad_s: FloatArray | None = None) -> AttitudeTrack:
    """The track through attitudes R_BN at rising stamps (N,).

    gyro_B_rad_s: (N, 3) measured body rates, rows may be NaN; used if they predict attitudes better than no gyro.
    """
    stretch = stretches(time_s)
    plain = _Course(time_s, _steady_rate(time_s, R_BN, stretch))
    courses, missed_rad = [plain], 0.0
    if gyro_B_rad_s is not None:
        known = np.asarray(np.isfinite(gyro_B_rad_s).all(axis=1))
        if known.mean() > 0.5:
            filled = [np.interp(time_s, time_s[known], axis) for axis in gyro_B_rad_s[known].T]
            by_gyro = _by_gyro(time_s, np.stack(filled, axis=1), stretch)
            missed_rad = _missed_rad(R_BN, stretch, by_gyro)
            courses += [by_gyro] if missed_rad < _FURTHEST else []  # else of wrong sign, unit or axes
    found = [(*_window(R_BN, stretch, course), course) for course in courses]
    best = min(found, key=lambda one: one[0])
    if len(found) > 1 and time_s.size > 1 and missed_rad < _ASTRAY and found[-1][0] < _ASTRAY**2:
        step_rad = np.linalg.norm(found[-1][-1].rate_B_rad_s[:-1], axis=1) * np.diff(time_s)
        if np.median(step_rad) > _FURTHEST:
            best = found[-1]  # attitudes so far apart are met as well by motions that are not there between them
    _, degree, half, course = best
    sums = _moments(R_BN, stretch, course, np.arange(time_s.size, dtype=np.intp), half, degree, np.zeros(1))
    fit = sums.fit(degree)
    own_weight = sums.off(fit)[2][:, 0]
    turns = np.ascontiguousarray(fit[:, :, :3])
    return AttitudeTrack(time_s, R_BN, stretch, course, turns, sums.mid_s, sums.span_s, half, own_weight)


def _steady_rate(time_s: FloatArray, R_BN: Rotation, stretch: RowArray) -> FloatArray:
    """(N, 3) body rate from the steps to the rows before and after; zero for a row alone."""
    rate, weight = np.zeros((time_s.size, 3)), np.zeros(time_s.size)
    if time_s.size > 1:
        joined = np.flatnonzero(np.diff(stretch) == 0)
        turn = -(R_BN[joined + 1] * R_BN[joined].inv()).as_rotvec() if joined.size else np.zeros((0, 3))
        for row in (joined, joined + 1):
            rate[row] += turn
            weight[row] += time_s[joined + 1] - time_s[joined]
    return np.asarray(rate / np.where(weight > 0, weight, 1.0)[:, None])


def _by_gyro(time_s: FloatArray, rate_B_rad_s: FloatArray, stretch: RowArray) -> _Course:
    """The course by gyro: a spline through its rates, for a wobble that turns far from one stamp to the next."""
    from scipy.interpolate import make_interp_spline  # here: it takes a fifth of a second to load

    from fluxtwin.sim.attitude.track_kernels import turned

    ends = np.flatnonzero(np.diff(stretch, prepend=-1, append=stretch[-1] + 1))
    degree = min(5, int(np.diff(ends).max()) - 1)
    breaks_s, pieces = [], []  # of all stretches one after the other, constant from each end to the next start
    for low, high in pairwise(ends.tolist()):
        k = min(degree, high - low - 1)
        spline = make_interp_spline(time_s[low:high], rate_B_rad_s[low:high], k=k)
        breaks_s.append(np.unique(spline.t) if k else time_s[low:high])
        pieces.append(np.zeros((degree + 1, breaks_s[-1].size, 3)))
        for power in range(k + 1):
            pieces[-1][degree - power, :-1] = spline(breaks_s[-1][:-1], nu=power) / factorial(power)
        pieces[-1][-1, -1] = rate_B_rad_s[high - 1]
    rates = np.concatenate(breaks_s), np.concatenate(pieces, axis=1)
    steps = Rotation.from_quat(turned(*rates, time_s[:-1], np.diff(time_s), _PARTS))
    whole = Rotation.concatenate([Rotation.identity(), steps])
    shift = 1
    while shift < time_s.size:  # products of 2, 4, 8, ... steps
        whole = Rotation.concatenate([whole[:shift], frames.product(whole[shift:], whole[:-shift])])
        shift *= 2
    return _Course(time_s, rate_B_rad_s, whole, rates)


def _missed_rad(R_BN: Rotation, stretch: RowArray, course: _Course) -> float:
    """By how much a course by gyro misses the turn from one attitude to the next: median."""
    joined = np.flatnonzero(np.diff(stretch) == 0)
    if course.integrated is None or not joined.size:
        return 0.0
    said = course.integrated[joined + 1] * course.integrated[joined].inv()
    return float(np.median((R_BN[joined + 1] * R_BN[joined].inv() * said.inv()).magnitude()))


@dataclass(frozen=True)
class _Trial:
    """A window; for each share of an error that the next row may keep (K,), how well the others predict what is new in an
    attitude."""

    degree: int
    half: int
    error: FloatArray
    """(K,) mean square prediction error; infinite where too few rows are predicted from both sides."""
    weight: FloatArray
    """(K,) that what is left out has in its own fit, mean."""
    kept: int | None
    """Which share this fit leaves; None where the window is too short to tell."""
    left: float
    """Mean square of what attitudes stand off their fit."""
    of_walk: float
    """The same of a random walk, for a mean square of 1 from row to row."""

    def misses(self, other: _Trial) -> bool:
        """Whether it misses all of a motion that the other misses: it is no shorter, and of no higher degree."""
        return self.half >= other.half and self.degree <= other.degree


def _window(R_BN: Rotation, stretch: RowArray, course: _Course) -> tuple[float, int, int]:
    """(mean square prediction error, degree, rows to either side) of the best window."""
    centres = np.arange(0, stretch.size, -(-stretch.size // _CENTRES), dtype=np.intp)
    trials = list(_trials(R_BN, stretch, course, centres))
    # Of what a short window cannot tell, the shortest one that can says most: it follows nearly all motion.
    usual = next((one.kept for one in trials if one.kept is not None), 0)
    kept = [usual if one.kept is None else one.kept for one in trials]
    missed = [_missed(one, trials, stretch.size) for one in trials]
    tried = [
        # A longer window or a lower degree misses no less of the motion.
        (
            float(one.error[k]) + max(m for o, m in zip(trials, missed, strict=True) if one.misses(o)),
            float(one.weight[k]),
            one,
        )
        for one, k in zip(trials, kept, strict=True)
    ]
    best = min((error for error, *_ in tried), default=np.inf)
    if not np.isfinite(best):
        return np.inf, 1, 1
    good = [one for one in tried if one[0] <= _AS_GOOD * best]
    error, _, trial = max(good, key=lambda one: one[1])
    return error, trial.degree, trial.half


def _missed(trial: _Trial, trials: list[_Trial], rows: int) -> float:
    """Mean square of the motion that a window does not follow: what attitudes stand off its fit beyond what errors can.

    No stationary error leaves more in a longer window, beside what it leaves in a shorter one, than a random walk does; by
    chance, three sigma of as many windows as do not overlap, three axes each.
    """
    shorter = [one for one in trials if one.of_walk < trial.of_walk]
    if not shorter or not np.isfinite(trial.left):
        return 0.0
    of_errors = trial.of_walk * min(one.left / one.of_walk for one in shorter)
    most = of_errors * (1.0 + 3.0 * float(np.sqrt(2.0 * (2 * trial.half + 1) / (3.0 * rows))))
    return max(trial.left - most, 0.0)


def _trials(R_BN: Rotation, stretch: RowArray, course: _Course, centres: RowArray) -> Iterator[_Trial]:
    """Every window worth trying."""
    smallest = np.inf
    for half in _HALVES:
        degrees = [degree for degree, least in _DEGREES if least <= half and (degree > 1 or half == 1)]
        sums = _moments(R_BN, stretch, course, centres, half, max(degrees), _KEPT)
        trials = [_trial(sums, degree, half) for degree in degrees]
        yield from trials
        errors = [float(one.error[one.kept]) for one in trials if one.kept is not None]
        if half >= _DEGREES[-1][1] and errors and min(errors) > _HOPELESS * smallest:
            return
        smallest = min([smallest, *errors])


def _trial(sums: _Moments, degree: int, half: int) -> _Trial:
    """One degree of one window.

    Left out and predicted by the others is what an attitude has of its own beside the share of an error that it keeps from
    the row before. The fit is linear, so what it would be without that follows from the weight that it has.
    """
    off, before, weight, weight_before = sums.off(sums.fit(degree))
    own = weight - _KEPT * weight_before
    missed = np.sum((off[:, None] - _KEPT[:, None] * before[:, None]) ** 2, axis=2) / np.maximum(1.0 - own, 1e-9) ** 2
    errors, weights = np.full(_KEPT.size, np.inf), np.zeros(_KEPT.size)
    for k in range(_KEPT.size):
        fair = sums.balanced & (own[:, k] < _MOST_OWN) & np.isfinite(missed[:, k])
        if fair.sum() >= 0.3 * fair.size:
            some = missed[fair, k]
            errors[k], weights[k] = np.mean(np.minimum(some, _WILD * np.median(some))), np.mean(own[fair, k])
    expected, of_walk = _correlations(half, degree)
    telling = expected[-1] - expected[0] > _TELLS
    kept = int(np.argmin(np.abs(expected - _correlation(off, before)))) if telling else None
    size = np.sum(off[sums.balanced] ** 2, axis=1)
    size = size[np.isfinite(size)]
    left = float(np.mean(np.minimum(size, _WILD * np.median(size)))) if size.size else np.inf
    return _Trial(degree, half, errors, weights, kept, left, of_walk)


def _correlation(one: FloatArray, other: FloatArray) -> float:
    """Of vectors (n, 3) about zero; NaN rows and wild ones are passed over."""
    size = np.sum(one**2 + other**2, axis=1)
    known = np.isfinite(size)
    tame = known & (size <= _WILD * np.median(size[known])) if known.any() else known
    whole = np.sqrt(np.sum(one[tame] ** 2) * np.sum(other[tame] ** 2))
    return float(np.sum(one[tame] * other[tame]) / whole) if whole > 0 else 0.0


@cache
def _correlations(half: int, degree: int) -> tuple[FloatArray, float]:
    """(K,) correlation of what the middle row and the one before it stand off a fit of evenly spaced rows, for errors that
    keep each share from row to row; and the variance of the middle row's for a random walk with steps of 1."""
    rows = np.arange(2 * half + 1)
    basis = np.linalg.qr(np.vander((rows - half) / half, degree + 1))[0]
    rest = np.eye(rows.size) - basis @ basis.T
    found = []
    apart = np.abs(np.subtract.outer(rows, rows))
    for share in _KEPT:
        left = rest @ share**apart @ rest
        found.append(left[half, half - 1] / np.sqrt(left[half, half] * left[half - 1, half - 1]))
    return np.array(found), float((rest @ (-0.5 * apart) @ rest)[half, half])


def _moments(
    R_BN: Rotation, stretch: RowArray, course: _Course, centres: RowArray, half: int, degree: int, kept: FloatArray
) -> _Moments:
    """Sums over 2 half + 1 rows about each of the centres (n,), fewer in a short stretch, one-sided at its ends.

    kept (K,): shares of an error that the next row keeps."""
    from fluxtwin.sim.attitude.track_kernels import moments

    time_s = course.time_s
    first = np.searchsorted(stretch, stretch[centres], side="left")
    last = np.searchsorted(stretch, stretch[centres], side="right") - 1
    low = np.maximum(first, np.minimum(centres - half, last - 2 * half))
    high = np.minimum(last, low + 2 * half)
    mid = 0.5 * (time_s[low] + time_s[high]) - time_s[centres]
    span = np.where(high > low, 0.5 * (time_s[high] - time_s[low]), 1.0)
    integrated = np.zeros((0, 4)) if course.integrated is None else course.integrated.as_quat()
    sums, moment, onward, before_rad = moments(
        time_s, R_BN.as_quat(), (integrated, course.rate_B_rad_s), centres, (low, high, mid, span), degree, kept
    )
    order = np.arange(degree + 1)
    gram = sums[:, np.add.outer(order, order)]
    balanced = (centres - low == half) & (high - centres == half)
    before_s = time_s[np.maximum(centres - 1, 0)] - time_s[centres]
    return _Moments(mid, span, gram, moment, onward, before_rad, before_s, sums[:, 0], balanced)
