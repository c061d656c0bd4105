"""Are the readings of one stretch in other axes than the rest, as where a driver was restarted with another setting?"""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.checks.evidence import S_SIGMA, BIAS_SIGMA_nT, MODEL_nT, SCALE_nT
from fluxtwin.calib.checks.matrix import EXPLAINED
from fluxtwin.calib.checks.orientation import FAR_BETTER, PLAIN_MOUNTINGS, mountings
from fluxtwin.calib.checks.outliers import LONGEST_RUN, STANDS_OUT, robust_fit
from fluxtwin.calib.checks.report import Finding, trap
from fluxtwin.calib.checks.sample import Sample
from fluxtwin.calib.checks.unit import SMALLEST_MISFIT_nT
from fluxtwin.calib.common.verdict import IMPOSSIBLE_S
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch

_MENDED = 3.0
"""Times the median misfit of the record: what the stretch may leave in its own axes."""
_ROUNDS = 3  # of search and fit: a stretch bends the first fit, in which it is not mended yet
_START_ROWS = 300


def check_stretch(sample: Sample) -> list[Finding]:
    """The trap `turned_stretch`: axes swapped or reversed in one stretch, longer than a run of outliers, of fewer than
    half of the rows. The rows (n,) have attitudes; scales and bias are those of most of them.

    Of each order and sign of the axes the stretch is sought in which it gains most, where the misfit of a row counts up to
    what stands out (Bentley 1984, Communications of the ACM 27, 865: the greatest sum).
    """
    reading = sample.R_BN.apply(sample.field_N_nT)
    mag, mended = sample.mag_nT / SCALE_nT, sample.mag_nT / SCALE_nT
    most, fit = STANDS_OUT**2, _start(mag, reading)
    for _ in range(_ROUNDS):
        typical = max(_median_nT(mended, reading, fit), MODEL_nT)
        left = np.sum((reading - mag @ fit[:3] - fit[3]) ** 2, axis=1) / typical**2
        found = []
        for mounting in mountings()[1:PLAIN_MOUNTINGS]:
            other = np.sum((reading - mag @ mounting.matrix @ fit[:3] - fit[3]) ** 2, axis=1) / typical**2
            total = np.concatenate([[0.0], np.cumsum(np.minimum(left, most) - np.minimum(other, most))])
            last = int(np.argmax(total - np.minimum.accumulate(total)))
            first = int(np.argmin(total[: last + 1]))
            found.append((total[last] - total[first], slice(first, last), other, mounting))
        _, rows, other, mounting = max(found, key=lambda one: one[0])
        if not LONGEST_RUN < rows.stop - rows.start < len(sample) / 2:
            return []
        mended = mag.copy()
        mended[rows] = mag[rows] @ mounting.matrix
        fit = _fit(mended, reading)
    if typical > max(EXPLAINED * sample.typical_nT, SMALLEST_MISFIT_nT):
        return []  # the other rows do not fit either
    as_is, turned = (typical * float(np.sqrt(np.mean(one[rows]))) for one in (left, other))
    if as_is < STANDS_OUT * typical or turned > min(_MENDED * typical, FAR_BETTER * as_is):
        return []
    start, end = (epoch.iso(sample.time[row], "s") for row in (rows.start, rows.stop - 1))
    said = {"first": start, "last": end, "sides": mounting.words, "as_is": as_is, "mended": turned}
    return [trap("turned_stretch", sample.rows[rows], **said)]


def _start(mag: FloatArray, reading: FloatArray) -> FloatArray:
    """The fit with the least median misfit (Rousseeuw 1984, J. Am. Stat. Assoc. 79, 871) of those to all rows and to all but
    a quarter or a half of them in turn: one of these is nearly without the stretch. What no magnetometer has comes last: it
    may explain the stretch with the rest, where the field hardly turns."""
    some = np.unique(np.linspace(0, len(mag) - 1, _START_ROWS).astype(int))
    mag, reading, place = mag[some], reading[some], np.arange(some.size) / some.size
    fits = [_fit(mag, reading)]
    for length in (0.25, 0.5):
        for first in np.arange(0.0, 1.0 - length / 2, length / 2):
            others = (place < first) | (place >= first + length)
            fits.append(_fit(mag[others], reading[others]))
    return min(fits, key=lambda fit: (_impossible(fit), _median_nT(mag, reading, fit)))


def _impossible(fit: FloatArray) -> bool:
    return bool(np.abs(fit[:3] / SCALE_nT - np.eye(3)).max() > IMPOSSIBLE_S)


def _fit(mag: FloatArray, reading: FloatArray) -> FloatArray:
    """(4, 3) what turns readings and a one into the field [nT], by least absolute deviations."""
    sigmas_nT = np.array([S_SIGMA * SCALE_nT] * 3 + [BIAS_SIGMA_nT])
    design, off = np.column_stack([mag, np.ones(len(mag))]), reading - SCALE_nT * mag
    fit = np.column_stack([robust_fit(design, axis, sigmas_nT) for axis in off.T])
    fit[:3] += SCALE_nT * np.eye(3)
    return fit


def _median_nT(mag: FloatArray, reading: FloatArray, fit: FloatArray) -> float:
    return float(np.median(np.linalg.norm(reading - mag @ fit[:3] - fit[3], axis=1)))
