"""Are the readings of one stretch in other axes than the rest, as where a driver was restarted with another setting?"""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.checks.evidence import S_SIGMA, BIAS_SIGMA_nT, MODEL_nT, SCALE_nT
from fluxtwin.calib.checks.orientation import FAR_BETTER, PLAIN_MOUNTINGS, mountings
from fluxtwin.calib.checks.outliers import LONGEST_RUN, STANDS_OUT, robust_fit
from fluxtwin.calib.checks.report import Finding, trap
from fluxtwin.calib.checks.sample import Sample
from fluxtwin.sim.earth import epoch

_MENDED = 3.0
"""Times the median misfit of the record: what the stretch may leave in its own axes."""
_ROUNDS = 3  # of fit and search: a stretch bends the first fit, in which it is not mended yet


def check_stretch(sample: Sample) -> list[Finding]:
    """The trap `turned_stretch`: axes swapped or reversed in one stretch, longer than a run of outliers, of fewer than
    half of the rows. The rows (n,) have attitudes; scales and bias are those of most of them.

    Of each order and sign of the axes the stretch is sought in which it gains most, where the misfit of a row counts up to
    what stands out (Bentley 1984, Communications of the ACM 27, 865: the greatest sum).
    """
    reading = sample.R_BN.apply(sample.field_N_nT)
    mag, mended = sample.mag_nT / SCALE_nT, sample.mag_nT / SCALE_nT
    sigmas_nT = np.array([S_SIGMA * SCALE_nT] * 3 + [BIAS_SIGMA_nT])
    most = STANDS_OUT**2
    for _ in range(_ROUNDS):
        design = np.column_stack([mended, np.ones(len(sample))])
        off = (reading - SCALE_nT * mended).T
        fit = np.column_stack([robust_fit(design, axis, sigmas_nT) for axis in off])
        fit[:3] += SCALE_nT * np.eye(3)
        typical = max(float(np.median(np.linalg.norm(reading - design @ fit, axis=1))), MODEL_nT)
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
    as_is, turned = (typical * float(np.sqrt(np.mean(one[rows]))) for one in (left, other))
    if as_is < STANDS_OUT * typical or turned > min(_MENDED * typical, FAR_BETTER * as_is):
        return []
    start, end = (epoch.iso(sample.time[row], "s") for row in (rows.start, rows.stop - 1))
    said = {"first": start, "last": end, "sides": mounting.words, "as_is": as_is, "mended": turned}
    return [trap("turned_stretch", sample.rows[rows], **said)]
