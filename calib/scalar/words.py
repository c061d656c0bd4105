"""The sentences of a calibration without attitude."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.calib.common.error_model import DECLARED, FOUND, ErrorModel
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.scalar.maximum_likelihood import Solved, add_up
from fluxtwin.calib.scalar.model import ScalarData, pack
from fluxtwin.calib.scalar.rows import ScalarRows

if TYPE_CHECKING:
    from fluxtwin.calib.common.options import ScalarOptions

_NAMES = {"center": "CENTER", "twostep": "TWOSTEP with the noise term corrected", "scalar": "scalar maximum likelihood"}
_MISSTATED = 1.25
_WORTH = 0.1
_CONSTANT = 0.05


def method(options: ScalarOptions, columns: tuple[str, ...]) -> str:
    """One line for the calibration file."""
    parts = [f"{_NAMES[options.method]} for {options.parameters}, without attitude"]
    others = [name for name in columns if not name.startswith("dipole_")]
    if others:
        parts.append("field of " + " and ".join(others) + " estimated")
    if options.robust != "none":
        parts.append("without outliers")
    return ", ".join(parts)


def messages(
    rows: ScalarRows, noise: ReadingNoise, options: ScalarOptions, inflation: float, columns: tuple[str, ...]
) -> list[str]:
    """Rows left out, the noise, and what the residual says of it."""
    out = [f"{count} rows left out: {reason}" for reason, count in rows.left_out.items()]
    out.append(f"noise of the reading: {noise.source}")
    ratio = float(np.sqrt(inflation))
    sure = 4.0 / np.sqrt(2.0 * max(len(rows), 1))
    if not 1.0 / _MISSTATED < ratio < _MISSTATED and abs(ratio - 1.0) > sure:
        declared = options.noise_nT is not None
        reason = (
            "the declared noise is wrong, or something is not modelled"
            if declared
            else ("the rest lasts longer than a sample: the field model, currents, temperature or S may be wrong")
        )
        shift = 3.0 * abs(ratio**2 - 1.0) * noise.variance_nT2.mean() / float((rows.H_nT**2).mean())
        out.append(
            f"the residual of |B| is {ratio:.3g} times what the noise gives: {reason}. The sigmas follow the residual; "
            f"were all of it noise of the reading, S would be off by {shift:.1g}"
        )
    others = [name for name in columns if not name.startswith("dipole_")]
    if others:
        out.append(f"b is for {' and '.join(others)} at zero")
    return out


def missing_S(solved: Solved, data: ScalarData, inflation: float) -> list[str]:
    """A sentence where scale and non-orthogonality, not estimated, are in the residual."""
    full = data._replace(with_D=True, columns=data.columns[:, :0])
    sums = add_up(pack(np.zeros((3, 3)), solved.p[:3], full), full)
    gain = float(sums.score @ np.linalg.lstsq(sums.information, sums.score, rcond=1e-12)[0])
    share = gain / max(sums.cost, 1e-300)
    if share < _WORTH or gain / max(inflation, 1.0) < 50.0:
        return []
    return [
        f"S is not estimated, and would take {share:.0%} of the variance of the residual: b then holds about S times the "
        "mean reading and moves from pass to pass. Compare with --parameters b,S"
    ]


def trivial(data: ScalarData) -> str:
    """Where the centred equations are of no use."""
    share = float(np.std(data.H) / np.mean(data.H))
    reason = "|H| is nearly constant" if share < _CONSTANT else "the directions of the field are few"
    return (
        f"{reason} (|H| varies by {max(100.0 * share, 1e-6):.2g} % rms): the centred equations tend to the solution "
        "S = -I that means nothing; the start was CENTER's bias instead"
    )


def not_settled(what: str) -> str:
    """A search without an end."""
    return (
        f"{what} does not settle: |B| and |H| disagree by more than a magnetometer can. Unit, position or time may be "
        "wrong (run `fluxtwin check`), or the readings keep too close to a plane"
    )


def field_error(field_error_nT: float, radian_s: float) -> str:
    """What was declared."""
    return (
        f"field model taken as wrong by {field_error_nT:.4g} nT rms in |H| with a memory of {radian_s:.0f} s, a radian "
        "of the orbit"
    )


def errors(noise: ReadingNoise, declared: bool) -> ErrorModel:
    """Where no attitude is looked at."""
    white_nT = np.sqrt(noise.variance_nT2)
    return ErrorModel(white_nT, DECLARED if declared else FOUND, float(np.sqrt((white_nT**2).mean())))


def never_fired(columns: tuple[str, ...]) -> list[str]:
    """Columns that are zero throughout."""
    out = []
    for name in columns:
        axis = "xyz".index(name[7]) + 1 if name.startswith("dipole_") else 0
        what = f"T1{axis}, T2{axis} and T3{axis}" if axis else f"the field of {name}"
        out.append(f"{what} not estimated: {name} is zero throughout these data")
    return out
