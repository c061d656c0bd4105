"""Is there a magnetometer that reads so? A free matrix and bias may explain readings that none can have.

One axis in another unit or at another gain, or axes that are mixed, leave |B| and the directions too near for a unit or a
mounting to be named, and too far for any calibration.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from fluxtwin.calib.checks.orientation import FAR_BETTER, Hypothesis
from fluxtwin.calib.checks.report import Finding, trap
from fluxtwin.calib.checks.sample import Sample
from fluxtwin.calib.checks.unit import UNIT_RATIO, SMALLEST_MISFIT_nT
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.verdict import IMPOSSIBLE_S
from fluxtwin.sim.base.types import FloatArray

EXPLAINED = 0.04
"""Share of |B| that a free matrix and bias may leave: noise, coarse steps and attitude errors do, other causes more."""
EDDY_S = 1.0
"""Longest decay time of eddy currents that a spacecraft has, as in the effect `eddy_current`."""
_SCALE_nT = 1e4


def check_matrix(sample: Sample, tried: list[Hypothesis] | None = None) -> list[Finding]:
    """The trap `magnetometer_matrix`: a free 3x3 matrix and bias leave at most half of what any leave that a magnetometer
    may have. Geometry that does not determine the matrix leaves both alike.

    sample: rows with attitude. tried: other ways to read the record, for rows of their own evenly taken from these; none
    of them may explain the readings with a possible matrix. None where a unit is wrong.
    """
    reading = sample.R_BN.apply(sample.field_N_nT)
    free_nT = _misfit_nT(sample.mag_nT, reading, np.inf)
    if free_nT > max(EXPLAINED * sample.typical_nT, SMALLEST_MISFIT_nT):
        return []
    gain = _gain(sample, reading)
    units = np.linalg.svd(gain, compute_uv=False)  # one that all axes share is no matrix of this kind
    units = np.maximum(units, 1e-12)
    units = np.append(units[np.abs(np.log(units)) > np.log(UNIT_RATIO)], 1.0)
    possible_nT = min(_misfit_nT(sample.mag_nT / unit, reading, IMPOSSIBLE_S) for unit in units.tolist())
    if free_nT > FAR_BETTER * possible_nT:
        return []
    if _of_eddies(sample, gain):
        return []
    for other in tried or []:
        mag_nT = sample.thinned(len(other.predicted_nT)).mag_nT
        if free_nT > FAR_BETTER * _misfit_nT(mag_nT, other.predicted_nT, np.inf) and (
            free_nT > FAR_BETTER * _misfit_nT(mag_nT, other.predicted_nT, IMPOSSIBLE_S)
        ):
            return []
    found, mend = _words(gain)
    return [
        trap("magnetometer_matrix", found=found, mend=mend, free=free_nT, possible=possible_nT, most=100 * IMPOSSIBLE_S)
    ]


def eddies_would_do(sample: Sample) -> bool:
    """Whether a free matrix and bias explain the readings of a body that turns, and eddy currents may be that matrix."""
    reading = sample.R_BN.apply(sample.field_N_nT)
    explained = _misfit_nT(sample.mag_nT, reading, np.inf) <= max(EXPLAINED * sample.typical_nT, SMALLEST_MISFIT_nT)
    return explained and _of_eddies(sample, _gain(sample, reading))


def _of_eddies(sample: Sample, gain: FloatArray) -> bool:
    """In a body that turns at w they are a matrix K [w x], no element of K beyond their decay time."""
    turn = (sample.R_BN[1:] * sample.R_BN[:-1].inv()).magnitude()
    most = 3.0**0.5 * EDDY_S * float(np.median(turn / np.diff(sample.seconds)))
    return bool(np.abs(gain - np.eye(3)).max() < IMPOSSIBLE_S + most)


def _gain(sample: Sample, reading: FloatArray) -> FloatArray:
    """(3, 3) what each axis has of what a perfect magnetometer reads (n, 3)."""
    return np.asarray(np.linalg.lstsq(_design(reading), sample.mag_nT / _SCALE_nT, rcond=None)[0][:3].T)


def _design(vectors_nT: FloatArray) -> FloatArray:
    return np.column_stack([vectors_nT / _SCALE_nT, np.ones(len(vectors_nT))])


def _misfit_nT(mag_nT: FloatArray, reading_nT: FloatArray, most: float) -> float:
    """Rms [nT] that (I + S) m + b leaves of what a perfect magnetometer reads, no element of S beyond `most`."""
    design, off = _design(mag_nT), (reading_nT - mag_nT) / _SCALE_nT
    if np.isinf(most):
        left = off - design @ np.linalg.lstsq(design, off, rcond=None)[0]
    else:
        bound = np.array([most] * 3 + [np.inf])
        left = np.stack([one - design @ lsq_linear(design, one, (-bound, bound)).x for one in off.T], axis=1)
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1)))) * _SCALE_nT


def _words(gain: FloatArray) -> tuple[str, str]:
    """What is odd about the share (3, 3) of the field along an axis (column) that an axis (row) reads; and what to do."""
    own = np.diag(gain)
    cross = gain - np.diag(own)
    odd = [axis for axis in range(3) if abs(own[axis] - 1.0) > IMPOSSIBLE_S * abs(own[axis])]  # of S: 1 / gain - 1
    if np.abs(cross).max() > IMPOSSIBLE_S or not odd:
        row, column = np.unravel_index(int(np.abs(cross).argmax()), cross.shape)
        found = f"mag_{'xyz'[row]} has {cross[row, column]:.3f} of the field along {'xyz'[column]}"
        return (
            f"{found}: axes that are mixed, or a correction that is not this sensor's",
            "Find out how the columns were made, and give the readings as the sensor has them",
        )
    listed = " and ".join(f"the {'xyz'[axis]} axis reads {plain(float(own[axis]))} of the field" for axis in odd)
    factors = ", ".join(plain(float(1.0 / own[axis])) if axis in odd else "1" for axis in range(3))
    return (
        f"{listed}: another unit or gain",
        f"A column map corrects it: `scale` for `mag` may be a list, here about [{factors}] times what it is now",
    )
