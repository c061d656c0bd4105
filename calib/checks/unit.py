"""Is the reading in nT? Tested with |B|, which needs no attitude, with a bias of any flown size free.

Scale and bias are distinguished where the reading turns or the field changes: a bias shifts the reading, a wrong unit
stretches it. And is it raw, or calibrated already? |B| tells that too.
"""

from __future__ import annotations

import itertools

import numpy as np

from fluxtwin.calib.checks.evidence import step_nT
from fluxtwin.calib.checks.orientation import FAR_BETTER
from fluxtwin.calib.checks.report import Finding, note, trap
from fluxtwin.calib.checks.sample import FEWEST, Sample, comparable
from fluxtwin.calib.common.conventions import OffsetFirst
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.records import Onboard
from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

HIGHEST_FIELD_nT = 70_000.0
"""The Earth's field reaches 66,000 nT at the ground; no orbit meets 70,000."""
HIGHEST_BIASED_nT = 120_000.0
"""That and a bias of 50,000 nT."""
LOWEST_FIELD_nT = 1_000.0
"""Reached by the dipole 13,000 km up; below, an orbit must be higher or the unit wrong."""
UNIT_RATIO = 1.5
"""Preflight scale errors change |B| by 30 % at the most; units differ by 10 or more."""
LIKELY_RATIO = 2.2
"""For the words of the trap: a bias may nearly double |B|, and known units lie ten apart."""
LARGEST_BIAS_nT = 110_000.0
"""Uncompensated CubeSats fly with 17,000 to 62,000 nT an axis: at most 62,000 times the root of three."""
CANCELLED = 0.15
"""A bias that cancels the field to less than this share of |B| is not believed (by chance once in 300 biases)."""
BIASED_MISFIT, HIGHEST_BIASED_MISFIT = 0.15, 0.3
"""Share of the reading, bias included, that scale errors and misalignments of 10 % leave; and never more than that
share of the field. A reading stretched twice or more and turned leaves 1."""
SMALLEST_MISFIT_nT = 500.0
"""Coarse steps (440 nT) and storms alone leave this much."""
_OFF_MIDDLE = 0.15
"""Of half the range, that a bias may be: 50,000 nT in a range of 330,000, that of the usual chips."""
CALIBRATED_NT, RAW_NT = 300.0, 1000.0
"""Misfit of |B| up to which readings look calibrated (a field model is off by 150 nT, 1 sigma, and noise comes on top), and
from which they do not (magnetometers fly with biases of thousands). Between them nothing is said."""
NOT_APPLIED = "the readings are raw, it was not applied"
_TIMES_BETTER = 1.5
"""One way of taking an on-board calibration must fit so many times better than the others."""
_FIT_ROWS = 300
_UNITS = (
    (1e-9, "tesla labelled as nT"),
    (1e-5, "gauss labelled as nT"),
    (1e-3, "microtesla labelled as nT"),
    (1e-2, "milligauss labelled as nT"),
    (0.1, "counts of 10 nT labelled as nT, or microtesla labelled as milligauss"),
    (10.0, "counts of 0.1 nT labelled as nT, or milligauss labelled as microtesla"),
    (100.0, "counts of 0.01 nT labelled as nT, or nT labelled as mG"),
    (1000.0, "picotesla labelled as nT, or nT labelled as microtesla"),
    (1e5, "nT labelled as gauss"),
    (1e9, "nT labelled as tesla"),
)


def check_unit(sample: Sample) -> list[Finding]:
    """The trap `magnetometer_unit`; or the note `large_bias` where a bias explains |B| as well."""
    if counts := _offset_binary(sample):
        return [counts]
    measured = float(np.median(np.linalg.norm(sample.mag_nT, axis=1)))
    expected = float(np.median(np.linalg.norm(sample.field_N_nT, axis=1)))
    ratio = measured / expected
    if 1.0 / UNIT_RATIO <= ratio <= UNIT_RATIO:
        return []
    medians = {"measured": plain(measured, 4), "expected": plain(expected, 4)}
    if biased := _explaining_bias_nT(sample, ratio):
        _, scale, left_nT = _middle_and_scale(sample)
        if left_nT >= FAR_BETTER * biased[1] or 1.0 / UNIT_RATIO <= scale <= UNIT_RATIO:
            return [note("large_bias.by_size", bias=plain(biased[0], 2), **medians)]
        likely = _likely(sample, 1.0 / scale)
    else:
        likely = _likely(sample, ratio)
    impossible = " (an impossible |B|)" if measured > HIGHEST_FIELD_nT or measured < 20.0 else ""
    more = {"ratio": plain(ratio), "likely": likely, "impossible": impossible}
    return [trap("magnetometer_unit.compared", **medians, **more)]


def _offset_binary(sample: Sample) -> Finding | None:
    """Counts from 0 on with zero in the middle of a range of 2^n steps, on all three axes; None where they are not that."""
    m, step = sample.mag_nT, step_nT(sample.mag_nT)
    if (m < 0.0).any() or not step:
        return None
    middle, scale, left_nT = _middle_and_scale(sample)
    if (middle <= 0.0).any():
        return None
    zero = step * 2.0 ** np.rint(np.log2(np.median(middle) / step))
    if (
        m.max() >= 2.0 * zero
        or np.abs(middle / zero - 1.0).max() > _OFF_MIDDLE
        or left_nT > BIASED_MISFIT * np.median(np.linalg.norm(sample.field_N_nT, axis=1))
    ):
        return None
    return trap(
        "magnetometer_unit.offset_binary", last=f"{2.0 * zero - step:.6g}", zero=f"{zero:.6g}", scale=plain(scale)
    )


def _middle_and_scale(sample: Sample) -> tuple[FloatArray, float, float]:
    """What readings m are counted from, d (3,), and the nT of each 1, by |m - d| scale = |B|; and the rms [nT] it leaves.

    |m - d|^2 = (|B| / scale)^2 is linear in d, in scale^-2 and in |d|^2.
    """
    size, wanted = float(np.abs(sample.mag_nT).max()), np.linalg.norm(sample.field_N_nT, axis=1)
    square, unit = (wanted / wanted.mean()) ** 2, sample.mag_nT / size
    design = np.column_stack([2.0 * unit, np.ones(len(unit)), square])
    middle = np.linalg.lstsq(design, np.sum(unit**2, axis=1), rcond=1e-9)[0][:3] * size
    off = np.linalg.norm(sample.mag_nT - middle, axis=1)
    scale = float(np.median(wanted) / np.median(off))
    return middle, scale, _core_rms(off * scale - wanted)


def blind_magnitude(telemetry: Telemetry) -> list[Finding]:
    """Without positions only what no orbit can have is named."""
    size = np.linalg.norm(telemetry.mag_B_nT[telemetry.has_reading], axis=1)
    if size.size == 0:
        return []
    typical = float(np.median(size))
    if LOWEST_FIELD_nT <= typical <= HIGHEST_FIELD_nT:
        return [note("not_compared.possible")]
    guess = _nearest_unit(typical / 35_000.0, 3.0)
    if HIGHEST_FIELD_nT < typical <= HIGHEST_BIASED_nT:
        return [note("not_compared.large", typical=plain(typical, 4))]
    likely = f"; likely {guess}" if guess else ""
    what = "no orbit has" if typical > HIGHEST_FIELD_nT else "no orbit below 13,000 km altitude has"
    return [trap("magnetometer_unit.blind", typical=plain(typical, 4), what=what, likely=likely)]


def check_calibrated(
    telemetry: Telemetry, model: FieldModel, usable: BoolArray, onboard: Onboard | None
) -> list[Finding]:
    """The note `calibrated_or_raw`; none where positions are missing, the record says it itself, or the data do not show it.

    usable: (N,) rows. onboard: what is said to have been applied on board: then it is also undone, and applied once more.
    """
    sample = comparable(telemetry, model, usable, with_attitude=False)
    if sample is None or len(sample) < FEWEST or telemetry.corrected_by:
        return []
    size_nT = np.linalg.norm(sample.field_N_nT, axis=1)
    as_is = _misfit_nT(sample.mag_nT, size_nT)
    if onboard is not None:
        held = OffsetFirst(onboard.M, onboard.o_nT)
        undone, applied = (_misfit_nT(change(sample.mag_nT), size_nT) for change in (held.undo, held.apply))
        said = "these data do not tell whether it was applied"
        if _TIMES_BETTER * applied < min(as_is, undone):
            said = f"{NOT_APPLIED}; calibrate without --onboard"
        elif _TIMES_BETTER * as_is < min(applied, undone):
            said = "the readings are corrected by it already; `fluxtwin calibrate --onboard FILE` undoes that"
        elif _TIMES_BETTER * undone < min(applied, as_is):
            said = "it was applied and makes the readings worse, or it belongs to another sensor"
        return [
            note("calibrated_or_raw.onboard", as_is=as_is, undone=undone, applied=applied, name=onboard.name, said=said)
        ]
    if CALIBRATED_NT < as_is < RAW_NT:
        return []
    calibrated = as_is <= CALIBRATED_NT
    return [note("calibrated_or_raw.calibrated" if calibrated else "calibrated_or_raw.raw", misfit=as_is)]


def _misfit_nT(mag_nT: FloatArray, size_nT: FloatArray) -> float:
    """Of |B|, as an rms that single outliers do not move."""
    return float(MAD_TO_SIGMA * np.median(np.abs(np.linalg.norm(mag_nT, axis=1) - size_nT)))


def _nearest_unit(ratio: float, within: float) -> str | None:
    if ratio <= 0:
        return None
    factor, text = min(_UNITS, key=lambda unit: abs(np.log(ratio / unit[0])))
    return text if 1.0 / within <= ratio / factor <= within else None


def _likely(sample: Sample, ratio: float) -> str:
    """What the number may be: a known unit; raw counts where they are whole, or where no unit is near."""
    guess = _nearest_unit(ratio, LIKELY_RATIO)
    whole = bool((sample.mag_nT == np.round(sample.mag_nT)).all())
    counts = f"raw counts of about {plain(1.0 / ratio)} nT (`scale` = nT per count)"
    if guess and whole:
        if _nearest_unit(ratio, UNIT_RATIO) is None:  # farther off than a scale error
            return f"{counts}, as all readings are whole, or {guess}"
        return f"{guess}, or, as all readings are whole, {counts}"
    return guess or counts


def _explaining_bias_nT(sample: Sample, ratio: float) -> tuple[float, float] | None:
    """Size of the bias that makes |B| fit as it stands, and the rms that it leaves; None where it is unbelievable or a known
    unit fits far better."""
    if ratio < CANCELLED:
        return None
    wanted = np.linalg.norm(sample.field_N_nT, axis=1)
    bias_nT, misfit = _magnitude_bias(sample.mag_nT, wanted)
    size = float(np.linalg.norm(bias_nT))
    scaled = _core_rms(np.linalg.norm(sample.mag_nT, axis=1) / ratio - wanted)
    share = min(BIASED_MISFIT * max(ratio, 1.0), HIGHEST_BIASED_MISFIT)
    allowed = max(share * float(np.median(wanted)), SMALLEST_MISFIT_nT)
    unit_fits = _nearest_unit(ratio, UNIT_RATIO) is not None and scaled < FAR_BETTER * misfit
    if size > LARGEST_BIAS_nT or misfit > allowed or unit_fits:
        return None
    return size, misfit


def _magnitude_bias(mag_nT: FloatArray, wanted_nT: FloatArray) -> tuple[FloatArray, float]:
    """Offset d (3,) [nT] with |reading - d| closest to `wanted_nT` (N,), and the rms [nT] it leaves.

    Squares are linear in d once |d|^2 is free; Gauss-Newton then ties the two. A short arc has several minima, so it
    starts on all sides of the reading as well; believable biases go first.
    """
    scale = 1e4
    thin = slice(None, None, 1 + len(mag_nT) // _FIT_ROWS)
    m, size = mag_nT[thin] / scale, wanted_nT[thin] / scale
    design = np.column_stack([2.0 * m, np.ones(len(m))])
    fit, *_ = np.linalg.lstsq(design, np.sum(m**2, axis=1) - size**2, rcond=1e-6)
    sides = np.array([side for side in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(side)])
    sides *= float(np.median(size)) / np.linalg.norm(sides, axis=1)[:, None]
    fits = [_gauss_newton(m, size, start) for start in (fit[:3], np.zeros(3), *(m.mean(axis=0) + sides))]
    d, left = min(fits, key=lambda fit: (np.linalg.norm(fit[0]) * scale > LARGEST_BIAS_nT, fit[1]))
    return d * scale, left * scale


def _gauss_newton(m: FloatArray, size: FloatArray, start: FloatArray) -> tuple[FloatArray, float]:
    """The offset (3,) and the rms left, from one start; damped along directions that the record does not show."""
    d = np.array(start)
    for _ in range(20):
        off = m - d
        length = np.maximum(np.linalg.norm(off, axis=1), 1e-9)
        slope = off / length[:, None]
        normal = slope.T @ slope / len(m) + np.eye(3) * 1e-4
        d = d + np.linalg.solve(normal, slope.T @ (length - size) / len(m))
    return d, _core_rms(np.linalg.norm(m - d, axis=1) - size)


def _core_rms(left: FloatArray) -> float:
    """Rms without the values beyond five times the median size: single bit errors must not decide."""
    core = np.abs(left) <= 5.0 * np.median(np.abs(left)) + 1e-12
    return float(np.sqrt(np.mean(left[core] ** 2)))
