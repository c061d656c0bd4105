"""Readings that do not change while they must: all axes, or one."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.calib.checks.report import Finding, trap
from fluxtwin.calib.checks.sample import FEWEST, Sample, comparable, rms
from fluxtwin.sim.base.errors import OutOfRange
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Origin, Telemetry

STUCK_S, STUCK_ROWS = 60.0, 10
"""Shorter runs of one reading come from coarse steps or fast sampling."""
STUCK_STEPS = 3.0
"""A run is stuck when elsewhere 99 % of stretches of that length move by more than this many least steps."""
LONGER, MUCH_LONGER = 3.0, 10.0
"""And when it is so many times longer than the runs that coarse steps make, and ends with a jump; or much longer."""
STUCK_MISFIT = 3.0
"""Rms that readings miss a repeated attitude by, over that of other rows: slow errors of the attitude differ by less from
one stretch to another, and a hold that is real shows no more than they do."""
_REGULAR = 0.8
"""Share of the values of a sensor that is held which last the usual number of rows, as rows may be lost. What coarse steps
repeat on three axes at once lasts now one row, now several: by chance half of them alike."""
_WINDOWS, _LONGEST_RUNS = 400, 50


def check_stuck(telemetry: Telemetry) -> tuple[list[Finding], BoolArray]:
    """The traps `constant_field`, `stuck_values`, `stuck_axis`, and which rows (N,) they spoil."""
    mag, good = telemetry.mag_B_nT, telemetry.has_reading
    faulty = np.zeros(len(mag), dtype=bool)
    if good.sum() < 13:
        return [], faulty
    spread = np.ptp(mag[good], axis=0)
    if (spread == 0).all():
        return [trap("constant_field")], good
    dead = [axis for axis in range(3) if spread[axis] == 0 and spread.max() >= 20.0 * least_step(mag)]
    if dead:
        value = mag[np.flatnonzero(good)[0]]
        return [trap("stuck_axis.always", axis="xyz"[axis], value=value[axis]) for axis in dead], good
    stuck = np.stack([_stuck(mag[:, [axis]], telemetry.time) for axis in range(3)], axis=1)
    filled = _filled(mag, good, telemetry.origin)
    every = _stuck(mag, telemetry.time) & ~filled
    some: BoolArray = np.asarray(stuck.any(axis=1) | every | filled)
    findings = []
    if filled.any():
        words = fill_words(mag[filled], telemetry.origin)
        findings.append(trap("stuck_values.filled", np.flatnonzero(filled), count=filled.sum(), fill=words))
    if every.any():
        said = {"fill": fill_words(mag[every], telemetry.origin), **_lengths(every, telemetry.time)}
        findings.append(trap("stuck_values.at_times", np.flatnonzero(every), **said))
    for axis in range(3):
        alone = stuck[:, axis] & ~every & ~filled
        if alone.any():
            long = _lengths(alone, telemetry.time)
            findings.append(trap("stuck_axis.at_times", np.flatnonzero(alone), axis="xyz"[axis], **long))
    return findings, some


def check_held(telemetry: Telemetry) -> tuple[list[Finding], Telemetry]:
    """The traps `held`, of what is slower than the rows and repeated between its samples throughout; and the record with
    blanks for what is repeated, in which the other faults show as they are."""
    findings: list[Finding] = []
    blanked: dict[str, object] = {}
    for name, what, mend in (
        ("mag_B_nT", "reading", "Keep the rows in which it changes"),
        ("q_NB", "attitude", _OWN_FILE),
        ("r_N_km", "position", _OWN_FILE),
    ):
        values = getattr(telemetry, name)
        held = None if values is None else _held(values)
        if held is not None:
            lasting, same = held
            repeated = {"repeats": int(same.sum()), "rows": len(telemetry)}
            findings.append(trap("held", np.flatnonzero(same), what=what, lasting=lasting, mend=mend, **repeated))
            blanked[name] = np.where(same[:, None], np.nan, values)
    return findings, telemetry.replace(**blanked, origin=telemetry.origin) if blanked else telemetry


def check_stuck_attitude(telemetry: Telemetry, model: FieldModel, usable: BoolArray) -> tuple[list[Finding], Telemetry]:
    """The trap `stuck_attitude`, of rows whose quaternion repeats while it changes in the others, and the record with blanks
    for it there: the readings beside it are not at fault.

    A hold repeats too where no errors are recorded. So the readings must miss that attitude by several times what those of
    other rows do under one matrix and bias.
    """
    if telemetry.q_NB is None or telemetry.r_N_km is None:
        return [], telemetry
    same = _stuck(np.array(telemetry.q_NB), telemetry.time)
    stuck = np.zeros_like(same)
    if not same.any():
        return [], telemetry
    try:
        moving = comparable(telemetry, model, usable & ~same, with_attitude=True)
        if moving is None or len(moving) < FEWEST:
            return [], telemetry
        X, expected = _regression(moving)
        fit = np.linalg.lstsq(X, expected, rcond=1e-10)[0]
        most_nT = STUCK_MISFIT * rms(expected - X @ fit)
        for first, last in runs(same, telemetry.time):
            stretch = np.zeros_like(same)
            stretch[first : last + 1] = True
            still = comparable(telemetry, model, usable & stretch, with_attitude=True)
            if still is not None:
                X, expected = _regression(still)
                stuck |= stretch & (rms(expected - X @ fit) > most_nT)
    except OutOfRange:  # which is named elsewhere
        return [], telemetry
    if not stuck.any():
        return [], telemetry
    rows = np.flatnonzero(stuck)
    first, last = (epoch.iso(telemetry.time[row]) for row in (rows[0], rows[-1]))
    said = {"count": rows.size, "first": first, "last": last, **_lengths(stuck, telemetry.time)}
    blanked = telemetry.replace(q_NB=np.where(stuck[:, None], np.nan, telemetry.q_NB), origin=telemetry.origin)
    return [trap("stuck_attitude", rows, **said)], blanked


def _regression(sample: Sample) -> tuple[FloatArray, FloatArray]:
    """(n, 4) readings [10 uT] and one, and (n, 3) the field [nT] that they should be, by the attitude."""
    return np.column_stack([sample.mag_nT / 1e4, np.ones(len(sample))]), sample.R_BN.apply(sample.field_N_nT)


_OWN_FILE = (
    "Blank the cells that repeat, and read it through a [[file]] of its own in a column map, which interpolates "
    "(docs/telemetry.md, sensors at different rates)"
)


def _held(values: FloatArray) -> tuple[str, BoolArray] | None:
    """How many rows a value (N, k) lasts, in words, and which rows (N,) repeat the one before; None unless that is regular.

    All components stand still at once, and then move by several of their least steps: rounding of what moves so fast
    would not hide the motion in between.
    """
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    moved = np.diff(values[known], axis=0)
    new = np.flatnonzero((moved != 0.0).any(axis=1))
    lengths = np.diff(new)
    if lengths.size < FEWEST or lengths.mean() < 1.5:
        return None
    usual = np.unique(np.floor([np.median(lengths), lengths.mean(), lengths.mean() + 1.0]))
    step = np.abs(moved[new]).max(axis=1)
    regular = np.isin(lengths, usual[usual > 0]).mean() >= _REGULAR
    if not regular or np.median(step) <= STUCK_STEPS * least_step(values[known]):
        return None
    same = np.zeros(len(values), dtype=bool)
    same[known[1:]] = ~(moved != 0.0).any(axis=1)
    first, last = (int(value) for value in np.percentile(lengths, [10, 90], method="nearest"))
    return f"{first}" if first == last else f"{first} to {last}", same


def fill_words(mag_nT: FloatArray, origin: Origin) -> str:
    """A sentence where one number stands on all axes in several of the rows (n, 3): no field does that."""
    alike = _on_all_axes(mag_nT, origin)
    values, counts = np.unique(alike[np.isfinite(alike)], return_counts=True)
    if counts.max(initial=0) < 2:
        return ""
    value, count = float(values[np.argmax(counts)]), int(counts.max())
    key = "fill" if value else "invalid"  # one axis may be zero
    if origin.count_nT is not None:
        key = f"{key} = [{value / origin.count_nT + 0.0:.10g}]"
    said = f"Of these, {count} have {value + 0.0:.10g} nT on all axes: a fill value"
    return f"{said}, then `mag` in a column map needs {key}. "


def _on_all_axes(mag_nT: FloatArray, origin: Origin) -> FloatArray:
    """(n,) the number [nT] that stands on all axes of readings (n, 3) as stored; NaN where they differ."""
    stored = mag_nT @ np.array(origin.matrix)  # its inverse is its transpose
    alike = np.ptp(stored, axis=1) <= 1e-9 * np.abs(stored).max(axis=1)
    return np.where(alike, np.round(stored[:, 0], 6), np.nan)


def _filled(mag_nT: FloatArray, good: BoolArray, origin: Origin) -> BoolArray:
    """Rows (N,) with one number on all axes, the same in two rows or more, that lie farther from the nearest other rows
    than any two neighbours among these lie apart."""
    alike = _on_all_axes(mag_nT, origin)
    values, counts = np.unique(alike[good & np.isfinite(alike)], return_counts=True)
    filled = np.isin(alike, values[counts > 1])
    rows, others = np.flatnonzero(filled), np.flatnonzero(good & ~filled)
    steps = np.linalg.norm(np.diff(mag_nT[others], axis=0), axis=1)[np.diff(others) == 1]
    if not rows.size or not steps.size:
        return np.zeros_like(filled)
    after = np.searchsorted(others, rows)
    beside = others[np.clip([after - 1, after], 0, others.size - 1)]
    filled[rows] = (np.linalg.norm(mag_nT[beside] - mag_nT[rows], axis=2) > steps.max()).all(axis=0)
    return filled


def least_step(mag: FloatArray) -> float:
    """Smallest change [nT] seen between neighbouring rows of an axis: the LSB, or less."""
    step = np.abs(np.diff(mag, axis=0))
    step = step[np.isfinite(step) & (step > 0)]
    return float(step.min()) if step.size else 0.0


def runs(mask: np.ndarray, time: TimeArray) -> np.ndarray:
    """(R, 2) first and last rows of stretches where `mask` holds, broken at gaps of more than five usual steps."""
    rows = np.flatnonzero(mask)
    if rows.size == 0:
        return np.zeros((0, 2), dtype=np.intp)
    step = np.diff(time.astype("int64"))
    usual = int(np.median(step)) if step.size else 0
    breaks = (np.diff(rows) > 1) | (np.diff(time[rows].astype("int64")) > 5 * usual)
    return np.stack([rows[np.append(True, breaks)], rows[np.append(breaks, True)]], axis=1)


def length_s(time: TimeArray, run: np.ndarray) -> float:
    """Seconds from the first to the last row of a run."""
    return float((time[run[-1]] - time[run[0]]).astype("int64")) * 1e-9


def _stuck(values: FloatArray, time: TimeArray) -> BoolArray:
    """Rows (N,) in runs of one reading (N, k) that are long enough that it must have changed, each with its first row."""
    same = np.zeros(len(values), dtype=bool)
    same[1:] = (values[1:] == values[:-1]).all(axis=1)
    found, out = runs(same, time), np.zeros(len(values), dtype=bool)
    sizes = found[:, 1] - found[:, 0] + 1
    order = np.argsort(-sizes, kind="stable")
    lengths, found = np.append(sizes[order], 1).astype(float), found[order[:_LONGEST_RUNS]]
    lasting = [k for k, run in enumerate(found) if lengths[k] >= STUCK_ROWS and length_s(time, run) >= STUCK_S]
    if not lasting:
        return out
    # between runs that may be stuck and those of coarse steps
    gap = max(lasting, key=lambda k: lengths[k] / lengths[k + 1])
    if lengths[gap] < LONGER * lengths[gap + 1]:
        return out
    long = [k for k in lasting if k <= gap]
    free = np.ones(len(values), dtype=bool)
    for first, last in found[long]:
        free[first : last + 1] = False
    step = least_step(values)
    for size, run in zip(sizes[order[long]], found[long], strict=True):
        if not _moves(values, free, int(size), step):  # nor do shorter stretches then
            break
        stuck = _jumps(values, run, step) or size > MUCH_LONGER * lengths[gap + 1]
        out[run[0] - 1 : run[-1] + 1] |= stuck
    return out


def _jumps(values: FloatArray, run: np.ndarray, least_step_nT: float) -> bool:
    """Whether the reading comes back far from where it stood; a turning point that coarse steps hide goes on by one."""
    after = run[-1] + 1
    return bool(after < len(values) and np.max(np.abs(values[after] - values[run[-1]])) > STUCK_STEPS * least_step_nT)


def _moves(values: FloatArray, free: BoolArray, rows: int, least_step_nT: float) -> bool:
    """Whether stretches of so many rows (N, k) practically always move, the runs themselves left out.

    Where there are not ten such stretches elsewhere, shorter ones are asked, which move less.
    """
    known = free & np.isfinite(values).all(axis=1)
    taken = np.concatenate([[0], np.cumsum(~known)])
    longest = int(np.diff(np.flatnonzero(np.concatenate([[True], ~known, [True]]))).max()) - 1
    rows = max(2, min(rows, max(STUCK_ROWS, len(values) // 8), longest + 1 - STUCK_ROWS))
    starts = np.flatnonzero(taken[rows:] == taken[:-rows])
    if starts.size < STUCK_ROWS:
        return False
    starts = starts[np.linspace(0, starts.size - 1, min(_WINDOWS, starts.size)).astype(int)]
    places = starts[:, None] + np.linspace(0, rows - 1, min(rows, 60)).astype(int)
    return float(np.percentile(np.ptp(values[places], axis=1).max(axis=1), 1)) > STUCK_STEPS * least_step_nT


def _lengths(mask: BoolArray, time: TimeArray) -> dict[str, Any]:
    """How long the longest stretch is, and how many there are, in words."""
    found = runs(mask, time)
    longest = max(length_s(time, run) for run in found)
    return {"length": longest, "stretches": f"{len(found)} stretch{'es' if len(found) > 1 else ''}"}
