"""Readings that are not of their instant: an axis at the end of its range, and a block that stands there twice."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from fluxtwin.calib.checks.report import Finding, trap
from fluxtwin.calib.checks.stuck import check_stuck, runs
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.record import Telemetry

FEWEST_CLIPPED = 10
"""Rows at the end of a range: fewer come about by chance, where steps are coarse."""
_BESIDE = 8
"""Values that occur next to the end of the range. About a turning point readings lie as the square root of their distance
from it: in coarse steps, so many hold twice as many rows as the last one."""
_TIMES_MORE = 3.0
_FEWEST_VALUES = 20
"""A reading with fewer stands at its ends anyway."""
_APPROACH = 5.0
"""Median changes from row to row within which a reading comes to its limit; a fill value or a bit error jumps there."""
SHORTEST_COPY = 20
"""Rows: noise of one step on three axes repeats one row in a hundred by chance, and never twenty in turn."""
_MOST_COPIED = 0.5
"""Of the rows: of a spinner with coarse steps nearly all readings occur again a turn later."""


def without_stuck(telemetry: Telemetry) -> tuple[Telemetry, BoolArray]:
    """The record without the readings of rows in which some or all axes are stuck, and which rows (N,) these are: no effect
    but a range that is too small repeats a reading to the last digit, so they would be taken for another one; and that never
    on all axes at once. Where all are stuck, the record as it is."""
    repeated = np.all(np.diff(telemetry.mag_B_nT, axis=0) == 0.0, axis=1)
    held = np.append(repeated, False) | np.append(False, repeated)
    rows = check_stuck(telemetry)[1] & (held | ~check_clipped(telemetry)[1])
    if not rows.any() or rows[telemetry.has_reading].all():
        return telemetry, np.zeros(len(telemetry), dtype=bool)
    return telemetry.replace(mag_B_nT=np.where(rows[:, None], np.nan, telemetry.mag_B_nT)), rows


def stuck_words(time: TimeArray, rows: BoolArray) -> str:
    """How many rows (N,) have a reading that repeats to the last digit, or a fill value, and were left out, and when."""
    where = np.flatnonzero(rows)
    first, last = (epoch.iso(time[row]) for row in (where[0], where[-1]))
    return f"{where.size} rows have a stuck reading or a fill value, from {first} to {last}, and were excluded"


@contextmanager
def saying_stuck(telemetry: Telemetry, stuck: BoolArray) -> Iterator[None]:
    """What gives no answer says too which rows (N,) of the record were left out as stuck: they do have a reading."""
    try:
        yield
    except NoAnswer as error:
        if stuck.any():
            error.args = (f"{error}. {stuck_words(telemetry.time, stuck)}",)
        raise


def check_clipped(telemetry: Telemetry) -> tuple[list[Finding], BoolArray]:
    """The trap `saturated`, an axis each, and which rows (N,) have such an axis."""
    findings, clipped = [], np.zeros(len(telemetry), dtype=bool)
    for axis in range(3):
        values = telemetry.mag_B_nT[:, axis]
        ends = {float(end): _at_end(values, float(end), telemetry.time) for end in _ends(values)}
        found = {end: rows for end, rows in ends.items() if rows.any()}
        both: BoolArray = np.zeros(len(telemetry), dtype=bool)
        for rows in found.values():
            both |= rows
        count = len(runs(both, telemetry.time))
        if count > 1:  # once may be a hold
            words = " and ".join(f"{end:.10g} nT in {rows.sum()} rows" for end, rows in found.items())
            findings.append(trap("saturated", np.flatnonzero(both), axis="xyz"[axis], at=words, count=count))
            clipped |= both
    return findings, clipped


def _ends(values: FloatArray) -> FloatArray:
    """Least and greatest of the values (N,), where many more rows have them than the values next to them."""
    level, rows = np.unique(values[np.isfinite(values)], return_counts=True)
    if level.size < _FEWEST_VALUES:
        return level[:0]
    beside = np.array([rows[1 : _BESIDE + 1].sum(), rows[-_BESIDE - 1 : -1].sum()])
    ends: FloatArray = level[[0, -1]]
    return ends[rows[[0, -1]] >= np.maximum(FEWEST_CLIPPED, _TIMES_MORE * beside)]


def _at_end(values: FloatArray, end: float, time: TimeArray) -> BoolArray:
    """Rows (N,) that are at the end of a range of (N,) values; none where they jump there."""
    at, off = np.asarray(values == end), np.abs(values - end)
    found = runs(at, time)
    padded = np.concatenate([[np.nan], off, [np.nan]])
    nearest = np.fmin(padded[found[:, 0]], padded[found[:, 1] + 2])  # of the rows before and after
    moves = np.abs(np.diff(values))
    usual = float(np.nanmedian(moves[moves > 0.0]))
    return at if np.nanmedian(nearest) <= _APPROACH * usual else np.zeros_like(at)


def check_copied(telemetry: Telemetry) -> tuple[list[Finding], BoolArray]:
    """The trap `copied_block`, and which rows (N,) hold readings that stood in earlier rows."""
    copied, good = np.zeros(len(telemetry), dtype=bool), np.flatnonzero(telemetry.has_reading)
    if good.size < 2 * SHORTEST_COPY:
        return [], copied
    # one number a reading, by weights that no two readings share by chance
    _, first, place = np.unique(
        telemetry.mag_B_nT[good] @ np.sqrt([2.0, 3.0, 5.0]), return_index=True, return_inverse=True
    )
    lag = np.arange(good.size) - first[place]
    starts = np.flatnonzero(np.diff(lag, prepend=-1))
    lengths = np.diff(np.append(starts, good.size))
    long = (lengths >= SHORTEST_COPY) & (lag[starts] > 0)
    if not long.any() or lengths[long].sum() > _MOST_COPIED * good.size:
        return [], copied
    findings = []
    for start, length in zip(starts[long], lengths[long], strict=True):
        later = good[start : start + length]
        earlier = good[start - lag[start] : start - lag[start] + length]
        copied[later] = True
        ends = [epoch.iso(telemetry.time[row], "s") for row in (later[0], later[-1], earlier[0], earlier[-1])]
        said = dict(zip(("first", "last", "from_", "to"), ends, strict=True))
        findings.append(trap("copied_block", later, count=length, **said))
    return findings, copied
