"""Is the clock right? Shifts of the stamps, tried against the field model.

All stamps of a record are moved together. What that does depends on where positions and attitude come from (`Origin`):
relative to GCRS they stay and the Earth turns under them by 15 deg an hour; Earth-fixed positions stay on the
Earth; positions from two-line elements run along the orbit, 7 km each second. A clock that is slow by a constant number of
hours or seconds is then one prediction among others, and `evidence` compares them with S and b free in each.
"""

from __future__ import annotations

import contextlib
from collections.abc import Container, Iterable
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from fluxtwin.calib.checks.evidence import (
    Evidence,
    VECTOR_SIGMAS_nT,
    compare,
    scalar_evidence,
    step_nT,
    vector_evidence,
)
from fluxtwin.calib.checks.report import Finding, named, note, trap
from fluxtwin.calib.checks.sample import FEWEST, Sample
from fluxtwin.calib.checks.unit import SMALLEST_MISFIT_nT
from fluxtwin.calib.checks.values import GAP_STEPS
from fluxtwin.calib.common.observability import listed
from fluxtwin.sim.base.errors import OutOfRange
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S
from fluxtwin.sim.earth.field import FieldModel, field_beyond_E_nT, field_N_nT
from fluxtwin.sim.earth.tle import TleSeries, along_track_sigma_km
from fluxtwin.sim.telemetry.record import Origin, Telemetry
from fluxtwin.sim.telemetry.time_stamps import GPS_EPOCH

HOURS = tuple(sign * half / 2.0 for half in range(1, 29) for sign in (1, -1))
"""Time zones are whole hours from UTC-12 to UTC+14, a few are half hours."""
STEP_S, ELEMENTS_STEP_S = 300.0, 5.0
"""Spacing of shifts without a known cause: a clock that was never set, and what a known shift must be better than. Five
minutes turn the Earth by 1.3 deg, to 14 hours; along the orbit that two-line elements give, 5 s are 37 km, to 10 minutes."""
EPOCH_YEARS = tuple(sign * half / 2.0 for half in range(1, 41) for sign in (1, -1))
"""Years by which the field of another date is tried, as far as the effect `field_epoch` goes."""
WHOLE_COST, OTHER_COST, PLAIN_COST = 5.0, 8.0, 10.0
"""Log prior odds against one whole hour, against any other known shift, and against a shift without a known cause. Of 150
files one has a wrong time zone (odds of 5); the others are rarer, by a factor 20 and 150: judgements."""
CLEAR = 4.0
"""Log odds at which a shift is named: 50 to 1 after its cost."""
LEANING_RAD = 0.005
"""A constant error of the attitude in inertial axes, 0.3 deg, is free: 18 s turn the Earth by 0.075 deg, no more."""
SIZE_SHARE = 0.7
"""By |B| alone, or by anything but a time zone, a shift must leave at most this share of the misfit: an effect that is not
modelled may fit a little better a day off."""
ROWS_AT_ONCE = 10_000
"""Shifts are tried together up to so many rows: a call for each would cost more than the field itself."""
BLOCKS = 100
"""Means over so many stretches of the record are compared: 14 minutes each in a day."""
TT_TAI_S = 32.184
"""Terrestrial time less TAI, by definition (IAU 1991, resolution A4)."""
ROLLOVER_S = 1024 * 7 * 86400.0
"""After which the ten bits of a GPS week begin again (IS-GPS-200, section 20.3.3.3.1.1)."""


def shifts_s(sample: Sample) -> dict[float, str]:
    """Seconds that stamps may be late by, with what it would be: time zones, leap seconds at this epoch, a day."""
    first = sample.time[:1]
    plain = float((first - GPS_EPOCH).astype("int64")[0]) * 1e-9
    gps = float(np.round(epoch.seconds_since(first, GPS_EPOCH)[0] - plain))  # leap seconds since 1980
    leaps = {18.0: "GPS time is ahead of UTC by 18 s", 37.0: "TAI is ahead of UTC by 37 s"}
    if gps > 0.0:
        leaps |= {gps: f"GPS time was ahead of UTC by {gps:g} s", 1.0: "a leap second"}
        leaps[gps + 19.0] = f"TAI was ahead of UTC by {gps + 19.0:g} s"
        leaps[gps + 19.0 + TT_TAI_S] = f"TT was ahead of UTC by {gps + 19.0 + TT_TAI_S:g} s"
    out = {hours * 3600.0: "a time zone" for hours in HOURS}
    for seconds, words in leaps.items():
        out |= {seconds: words, -seconds: f"{words}, taken twice or with the wrong sign"}
    again = "the GPS week counts to 1023 and began again"
    out |= {-ROLLOVER_S: again, -2.0 * ROLLOVER_S: f"{again}, twice"}  # in 1999 and in 2019; next in 2038
    return out | {86400.0: "a day", -86400.0: "a day"}


def plain_shifts_s(origin: Origin) -> dict[float, str]:
    """Seconds without a known cause that stamps may be late by, and the words for each."""
    step, most = (STEP_S, 168) if origin.elements is None else (ELEMENTS_STEP_S, 120)
    words = (
        f"to within {shift_words(step)}; no time zone and no leap seconds: a clock or a date (4 min a day) that is off"
    )
    return {sign * step * number: words for number in range(1, most + 1) for sign in (1, -1)}


def cost(shift_s: float, known: Container[float]) -> float:
    """Log prior odds against a shift."""
    if shift_s not in known:
        return PLAIN_COST
    return WHOLE_COST if shift_s % 3600.0 == 0.0 and abs(shift_s) < 86400.0 else OTHER_COST


def shifted(
    sample: Sample, model: FieldModel, origin: Origin, shift_s: FloatArray
) -> tuple[FloatArray, Rotation | None]:
    """GCRS field (n, 3) [nT] and attitude if the stamps are late by `shift_s` (n,)."""
    time = sample.time - np.rint(shift_s * 1e9).astype("timedelta64[ns]")
    stated = sample.R_EN
    R_EN = _further(stated, EARTH_RATE_RAD_S * shift_s)  # the pole moves by 1e-6 rad a day
    r, v = sample.r_N_km, sample.v_N_km_s
    if origin.elements is not None:
        r, v = origin.elements.propagate(time)
    elif origin.position == "ITRS":
        back = R_EN.inv() * stated
        r, v = back.apply(r), back.apply(v)
    field = field_N_nT(model, time, r, R_EN)
    if sample.q_NB is None or origin.attitude == "GCRS":
        return field, None if sample.q_NB is None else sample.R_BN
    if origin.attitude == "ITRS":
        return field, sample.R_BN * stated.inv() * R_EN
    if origin.attitude in ("NEC", "NED"):  # the vertical turns by as much, whichever it is
        old = frames.rotation_NEC_E(stated.apply(sample.r_N_km)) * stated
        new = frames.rotation_NEC_E(R_EN.apply(r)) * R_EN
    else:
        old, new = frames.rotation_ON(sample.r_N_km, sample.v_N_km_s), frames.rotation_ON(r, v)
    return field, sample.R_BN * old.inv() * new


def _further(R_EN: Rotation, angle_rad: FloatArray) -> Rotation:
    """Rotations of which the last turn, about z, goes further by (n,) angles: scipy's product takes ten times as long."""
    x, y, z, w = R_EN.as_quat().T
    c, s = np.cos(0.5 * angle_rad), np.sin(0.5 * angle_rad)
    return Rotation.from_quat(np.stack([c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z], axis=1))


def predictions(sample: Sample, model: FieldModel, origin: Origin, shifts: Iterable[float]) -> dict[float, FloatArray]:
    """The reading that a perfect magnetometer would give, (n, 3) [nT], for each shift that field model and elements reach;
    body axes with attitude, GCRS without."""
    out: dict[float, FloatArray] = {}
    tried, _ = list(shifts), sample.R_EN  # computed once, for all shifts
    size = max(ROWS_AT_ONCE // len(sample), 1)
    repeated = cache(lambda count: sample.take(np.tile(np.arange(len(sample)), count)))
    for first in range(0, len(tried), size):
        some = tried[first : first + size]
        try:
            out |= _together(repeated(len(some)), model, origin, some)
        except OutOfRange:
            for shift_s in some:
                with contextlib.suppress(OutOfRange):
                    out |= _together(sample, model, origin, [shift_s])
    return out


def _together(rows: Sample, model: FieldModel, origin: Origin, shifts: list[float]) -> dict[float, FloatArray]:
    """`predictions` of a few shifts, all of which must be in reach, in one evaluation. rows: the sample, once for each."""
    count = len(rows) // len(shifts)
    field, R_BN = shifted(rows, model, origin, np.repeat(shifts, count))
    reading = field if R_BN is None else R_BN.apply(field)
    return dict(zip(shifts, reading.reshape(len(shifts), count, 3), strict=True))


def check_clock(sample: Sample, model: FieldModel, origin: Origin) -> list[Finding]:
    """The trap `clock`, or the note `clock_tested` with what would and what would not show, or `elements_off`."""
    sample = sample.thinned(5 * BLOCKS)
    shifts = shifts_s(sample)
    plain = plain_shifts_s(origin)
    fields = predictions(sample, model, origin, dict.fromkeys((0.0, *shifts, *plain)))
    tried = list(fields)
    evidence = _evidence(sample, [fields[shift] for shift in tried])
    costs = np.array([0.0, *(cost(shift, shifts) for shift in tried[1:])])
    odds = evidence.log - evidence.log[0] - costs
    zone = (costs == WHOLE_COST) & (sample.q_NB is not None)
    share = np.where(zone, 1.0, SIZE_SHARE)  # coarse steps of a slow reading look like a shift to |B|
    odds[1:][(evidence.misfit_nT > share * evidence.misfit_nT[0])[1:]] = -np.inf  # nor may the plain fit get worse
    best = int(np.argmax(odds))
    if best and odds[best] > CLEAR and of_elements(tried[best], shifts, sample, origin):
        return [_elements_off(tried[best], sample, *evidence.misfit_nT[[0, best]].tolist())]
    if best and odds[best] > CLEAR:
        other = _of_date(sample, model, float(evidence.log[0] + odds[best]))
        if other is not None:
            return [_epoch_off(*other, tried[best], float(evidence.misfit_nT[0]))]
        cause = shifts.get(tried[best]) or plain[tried[best]]
        said = named_shift(tried[best], cause, float(evidence.misfit_nT[0]), float(evidence.misfit_nT[best]))
        near = 3.0 * min(map(abs, plain)) if tried[best] not in shifts else 0.0
        likely = sorted(zip(odds, tried, strict=True), reverse=True)
        close = [shift for one, shift in likely if one > odds[best] - CLEAR and abs(shift - tried[best]) > near]
        unknown = [shift for shift in close if shift and shift not in shifts]  # neighbours: one stands for all
        close = [shift for shift in close if shift not in unknown[1:]]
        return [named("clock", said + still_off(float(evidence.misfit_nT[best])) + _ambiguous(close))]
    # What a shift costs this record is what taking it back would gain one whose stamps are off by as much.
    gain = np.maximum(evidence.log[0] - evidence.log, 0.0)
    shows = gain - np.sqrt(2.0 * gain) > costs + CLEAR
    shows &= evidence.misfit_nT[0] <= share * evidence.misfit_nT
    return [_what_shows(dict(zip(tried, shows.tolist(), strict=True)), shifts, plain, origin)]


def check_jump(sample: Sample, model: FieldModel, origin: Origin) -> list[Finding]:
    """The trap `clock` with the instant of a jump; none where one clock serves both sides, or a side is too short.

    A jump leaves a gap as long as itself, or longer: each side of the longest gap is tested by itself. Where each is far
    better with its own shift than with the other's, no one shift mends the record.
    """
    step_s = np.diff(sample.seconds)
    first = int(np.argmax(step_s)) + 1
    if step_s[first - 1] <= GAP_STEPS * np.median(step_s) or min(first, len(sample) - first) < FEWEST:
        return []
    known, plain = shifts_s(sample), plain_shifts_s(origin)
    tried = list(dict.fromkeys((0.0, *known, *plain)))
    sides = [sample.take(np.arange(first)), sample.take(np.arange(first, len(sample)))]
    found = [_of_side(side.thinned(BLOCKS), model, origin, tried) for side in sides]
    tried = [shift for shift in tried if all(shift in one for one in found)]
    costs = np.array([cost(shift, known) if shift else 0.0 for shift in tried])
    odds = [np.array([one[shift][0] for shift in tried]) - costs for one in found]
    best = [int(np.argmax(one)) for one in odds]
    if any(one[mine] - one[other] <= CLEAR for one, mine, other in zip(odds, best, reversed(best), strict=True)):
        return []
    if tried[best[0]] and tried[best[1]] and abs(tried[best[0]] - tried[best[1]]) <= 3.0 * min(map(abs, plain)):
        return []  # neighbours in the steps that are tried
    causes = plain | known
    said = [
        f"{shift_words(shift)} too {'late' if shift > 0 else 'early'} ({causes[shift]})" if shift else "right"
        for shift in (tried[at] for at in best)
    ]
    misfit = {f"{name}_nT": one[tried[at]][1] for name, one, at in zip(("before", "after"), found, best, strict=True)}
    at = epoch.iso(sample.time[first], "s")
    return [trap("clock.jump", sample.rows[first : first + 1], at=at, first=said[0], then=said[1], **misfit)]


def _of_side(side: Sample, model: FieldModel, origin: Origin, tried: list[float]) -> dict[float, tuple[float, float]]:
    """Log evidence and misfit [nT] by shift, for the shifts that field model and elements reach."""
    fields = predictions(side, model, origin, tried)
    found = _evidence(side, list(fields.values()))
    return dict(zip(fields, zip(found.log.tolist(), found.misfit_nT.tolist(), strict=True), strict=True))


def epochs(sample: Sample, model: FieldModel) -> dict[float, FloatArray]:
    """As `predictions`, of the model's field some years (of 365.25 days) after the stamps, or before: its drift is about
    that of a field which turns about the pole."""
    r_E_km, later = sample.R_EN.apply(sample.r_N_km), {}
    for years in EPOCH_YEARS:
        time = sample.time + epoch.years(years)
        field = sample.R_EN.inv().apply(field_beyond_E_nT(model, time, r_E_km))
        later[years] = field if sample.q_NB is None else sample.R_BN.apply(field)
    return later


def of_elements(shift_s: float, known: Container[float], sample: Sample, origin: Origin) -> bool:
    """Whether positions so far along the orbit are likelier an error of the two-line elements than one of the clock.

    Of elements of that age the error along the track has a normal distribution; the log odds against its size are held
    against those against the shift.
    """
    if origin.elements is None:
        return False
    return 0.5 * (_distance_km(shift_s, sample) / _elements_km(sample, origin.elements)) ** 2 < cost(shift_s, known)


def _distance_km(shift_s: float, sample: Sample) -> float:
    """Along the orbit, by the median speed."""
    return abs(shift_s) * float(np.nanmedian(np.linalg.norm(sample.v_N_km_s, axis=1)))


def _elements_km(sample: Sample, elements: TleSeries) -> float:
    """The error along the track of such elements, 1 sigma."""
    return along_track_sigma_km(float(np.median(elements.age_days(sample.time))))


def _elements_off(shift_s: float, sample: Sample, as_is_nT: float, mended_nT: float) -> Finding:
    """The note where positions farther along the orbit fit better, by no more than elements may be off."""
    side = "behind" if shift_s > 0 else "ahead of"
    sizes = {"km": _distance_km(shift_s, sample), "as_is": as_is_nT, "mended": mended_nT}
    return note("elements_off", side=side, shift=shift_words(shift_s), **sizes)


def _of_date(sample: Sample, model: FieldModel, log: float) -> tuple[float, float] | None:
    """Years after the stamps by which the field explains the readings about as well as a shift of such log odds, and the
    misfit [nT] that it leaves; None if none does."""
    later = epochs(sample, model)
    evidence = _evidence(sample, list(later.values()))
    best = int(np.argmax(evidence.log))
    if evidence.log[best] - PLAIN_COST <= log - CLEAR:
        return None
    return list(later)[best], float(evidence.misfit_nT[best])


def _epoch_off(years: float, mended_nT: float, shift_s: float, as_is_nT: float) -> Finding:
    """The note where the field of another date does as well as other stamps."""
    side = "after" if years > 0 else "before"
    sizes = {"years": abs(years), "as_is": as_is_nT, "mended": mended_nT}
    return note("epoch_off", side=side, shift=shift_words(shift_s), **sizes)


def named_shift(shift_s: float, words: str, as_is_nT: float, mended_nT: float) -> str:
    """The sentence that names a shift."""
    zone = ", or time.zone where they are local times" if words == "a time zone" else ""
    if words.startswith(("GPS ", "TAI ", "TT ")):
        zone = f', or time.scale = "{words.split()[0] if shift_s > 0.0 else "UTC"}"'
    return (
        f"the stamps are {shift_words(shift_s)} too {'late' if shift_s > 0 else 'early'} ({words}): as they stand the "
        f"reading misses the model by {as_is_nT:.0f} nT rms after a fit, with {-shift_s:+.10g} s by {mended_nT:.0f} nT. "
        f"Add it in a column map: time.offset_s = {-shift_s:.10g}{zone}"
    )


def still_off(left_nT: float) -> str:
    """Words of doubt about a shift with which a fit of S and b leaves more of a component [nT] than a right clock would."""
    if left_nT <= SMALLEST_MISFIT_nT:
        return ""
    return (
        f". But a fit of S and b then leaves {left_nT:.0f} nT, more than a right clock does: the date, the attitude or the "
        "positions may be wrong instead"
    )


def _ambiguous(close: list[float]) -> str:
    if not close:
        return ""
    listed = " or ".join(shift_words(shift) if shift else "none" for shift in close[:4])
    return f". This record cannot distinguish it from {listed}"


def _evidence(sample: Sample, fields: list[FloatArray]) -> Evidence:
    """By vectors in GCRS axes, averaged over stretches, where the attitude is known; else by |B|."""
    seconds = sample.seconds
    if sample.q_NB is None:
        rows = np.linspace(0, len(sample) - 1, min(len(sample), 3 * BLOCKS)).astype(int)
        size = np.stack([np.linalg.norm(field[rows], axis=1) for field in fields])
        return scalar_evidence(seconds[rows], sample.mag_nT[rows], size)
    R_NB, field = sample.R_BN.inv(), sample.field_N_nT
    turn = R_NB.as_matrix()
    readings = np.einsum("nik,nl->nikl", turn, sample.mag_nT / 1e4).reshape(len(sample), 3, 9)
    leaning = np.stack([np.cross(axis, field) for axis in np.eye(3)], axis=2)
    design = np.concatenate([readings, turn, leaning], axis=2)
    starts = np.unique(np.linspace(0, len(sample), BLOCKS, endpoint=False).astype(int))
    sizes = np.diff(np.append(starts, len(sample))).astype(float)

    def mean(values: FloatArray) -> FloatArray:
        total = np.add.reduceat(values, starts, axis=0)
        return np.asarray(total / sizes.reshape(-1, *([1] * (values.ndim - 1))))

    sigmas = np.append(VECTOR_SIGMAS_nT, [LEANING_RAD] * 3)
    rhs = np.stack([mean(R_NB.apply(predicted - sample.mag_nT)) for predicted in fields], axis=2)
    return compare(mean(seconds), mean(design), rhs, sigmas, mean(field), step_nT(sample.mag_nT))


def _what_shows(shows: dict[float, bool], shifts: dict[float, str], plain: Iterable[float], origin: Origin) -> Finding:
    """In words, which shifts this record would show."""
    if origin.elements is not None:
        meant = "positions from two-line elements move with them"
    elif origin.position == "ITRS":
        meant = "Earth-fixed positions are kept"
    else:
        meant = "GCRS positions are kept while the Earth turns under them"
    said: dict[str, list[str]] = {"would show": [], "would not show": [], "cannot be tested": []}
    for shift, words in ((s, shifts[s]) for s in sorted(shifts) if 1.0 < s < 1800.0 or s in (3600.0, 86400.0)):
        sides = [shows[side] for side in (shift, -shift) if side in shows]
        seen = "cannot be tested" if len(sides) < 2 else "would show" if all(sides) else "would not show"
        what = "" if shift >= 3600.0 else f" ({words.split()[0]})"
        said[seen].append(f"{shift_words(shift)}{what}")
    parts = [f"shifts of {listed(some)} {seen} here" for seen, some in said.items() if some]
    hidden = [abs(shift) for shift in plain if not shows.get(shift, False)]
    greatest = max(map(abs, plain))
    apart = shift_words(min(map(abs, plain)))
    tried = f". The other shifts that were tried, up to {shift_words(greatest)} in steps of {apart}, would "
    words = f"{tried}show if they were longer than {shift_words(max(hidden))}" if hidden else f"{tried}all show"
    words = "" if hidden and max(hidden) >= min(3600.0, greatest) else words
    shown = "; ".join(parts)
    return note("clock_tested", meant=meant, shifts=f"{shown[:1].upper()}{shown[1:]}", others=words)


def readings_shift(sample: Sample, telemetry: Telemetry, model: FieldModel) -> tuple[float, float, float] | None:
    """Seconds by which the magnetometer's stamps alone are late, misfits [nT] an axis without and with that.

    None if no shift is far better.

    The reading is compared with position and attitude of another row; what runs off the record is left out.
    """
    if telemetry.r_N_km is None or telemetry.q_NB is None:
        return None
    known = np.flatnonzero(telemetry.has_position & telemetry.has_attitude)
    track_s = (telemetry.time[known] - sample.time[0]).astype("int64") * 1e-9
    from scipy.interpolate import CubicSpline

    position = CubicSpline(track_s, telemetry.r_N_km[known])
    turn = Slerp(track_s, frames.rotation_from_q(telemetry.q_NB[known]))
    found = []
    for hours in (sign * hour for hour in range(1, 15) for sign in (1, -1)):
        then = sample.seconds - 3600.0 * hours
        inside = np.flatnonzero((then >= track_s[0]) & (then <= track_s[-1]))
        if inside.size < max(60, len(sample) // 10):
            continue
        time = sample.time[inside] - np.timedelta64(hours, "h")
        field = turn(then[inside]).apply(field_N_nT(model, time, position(then[inside])))
        rows = np.linspace(0, inside.size - 1, min(inside.size, BLOCKS)).astype(int)
        part = sample.take(inside[rows])
        both = vector_evidence(part.seconds, part.mag_nT, np.stack([part.R_BN.apply(part.field_N_nT), field[rows]]))
        found.append((float(both.misfit_nT[1] / both.misfit_nT[0]), 3600.0 * hours, *both.misfit_nT.tolist()))
    if not found:
        return None
    share, shift_s, as_is, misfit = min(found)
    return (shift_s, as_is, misfit) if share < 0.25 else None


def shift_words(shift_s: float) -> str:
    """Its size, without the sign."""
    size = abs(shift_s)
    if size >= ROLLOVER_S:
        return f"{size / 604800.0:.0f} weeks"
    if size == 86400.0:
        return "1 day"
    if size % 1800.0 == 0.0:
        return f"{size / 3600.0:g} h"
    return f"{size / 60.0:g} min" if size >= 120.0 else f"{size:g} s"
