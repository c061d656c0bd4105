"""The noise of the reading, Sigma_B: declared, or found in the data.

It is needed because the reading stands on the right side of journal eq. 1 and its noise attenuates S
(`linear`), and because a field that varies by no more than the noise does not vary. The quantisation of the
telemetry counts as noise of variance LSB^2/12 per axis.

Found in the data: differences d of neighbouring residuals of B = G A B0 + o, whose mean products are

    <d d'> / 2 = diag(sigma_x^2, sigma_y^2, sigma_z^2) + sum_j phi_j^2 (B x e_j)(B x e_j)'

for white noise sigma_i of the reading, an axis each, and an error phi_j of the reference attitude about axis j, which
only turns the field (mean over the two fields of a difference); errors of the field model are smooth and cancel. The
six variances are fitted, none negative. They may not add up to more than what is seen along the field, where no
error of the attitude has a part, whatever its law.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import nnls

from fluxtwin.calib.common.conventions import PAIRS
from fluxtwin.calib.common.covariance import stretches
from fluxtwin.calib.common.design import Design, of_turns
from fluxtwin.calib.common.digits import measured, plain
from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray

_SMALLEST_LSB_NT = 1e-3
_FEWEST_PAIRS = 30
_TOO_FEW = "too few neighbouring samples to tell noise from other errors: all of the residual"
_FIRST, _SECOND = ([pair[side] for pair in PAIRS] for side in (0, 1))
_ROUNDS = 3


@dataclass(frozen=True)
class ReadingNoise:
    """Variance of the reading per axis, and where it comes from."""

    variance_nT2: FloatArray
    """(3,) diagonal of Sigma_B, quantisation included."""
    source: str
    """In words."""
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3) of `variance_nT2` [nT^4]; 0 where it was declared."""


def per_axis(value: float | FloatArray, name: str) -> FloatArray:
    """(3,) of a scalar or three numbers; raises BadInput for anything negative or not finite."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (3,)) or not np.isfinite(array).all() or (array < 0).any():
        raise BadInput(f"{value!r}", where=name, wanted="one number or three, in nT, not negative")
    return np.array(np.broadcast_to(array, (3,)))


def lsb_from_spacing_nT(B_nT: FloatArray) -> FloatArray:
    """(3,) LSB of each axis from the spacing of the values that occur; 0 where the values are on no grid.

    The grid step is the smallest spacing that all the others are whole multiples of (to 2 %).
    """
    return np.array([_grid_step(B_nT[:, axis]) for axis in range(3)])


def reading_noise(
    design: Design,
    residual_nT: FloatArray,
    noise_nT: float | FloatArray | None,
    lsb_nT: float | FloatArray | None,
) -> ReadingNoise:
    """Sigma_B from what is declared, the rest from the data.

    residual_nT: (N, 3) of a first fit, on the side of the reading. Noise that lasts longer than a sample is not seen
    in differences; how much of the residual along the field may be of that kind goes into the covariance.
    """
    some = stretches(len(design))
    declared, lsb, lsb_words = _declared(design.B_nT[some], noise_nT, lsb_nT)
    if declared is not None:
        return declared
    reference, r = design.H_nT[some], residual_nT[some]
    unit = reference / np.maximum(np.linalg.norm(reference, axis=1), 1e-9)[:, None]
    along = np.einsum("ij,ij->i", r, unit)
    whole_nT2 = clipped_sigma(along) ** 2 * len(r) / max(len(r) - 4, 1)
    first, differences = _differences(r, design.time[some])
    if len(differences) < _FEWEST_PAIRS:
        return _all_noise(whole_nT2, lsb, f"{lsb_words}; {_TOO_FEW} along the field is taken for noise")
    variance, covariance = _fit_variances(reference[first], reference[first + 1], differences)
    # The reading cannot be noisier than the whole residual of its axis.
    variance = np.minimum(variance, np.array([clipped_sigma(r[:, axis]) for axis in range(3)]) ** 2)
    step_nT2 = 0.5 * clipped_sigma(along[first + 1] - along[first]) ** 2
    variance = variance * min(1.0, step_nT2 / max(float(((unit**2) @ variance).mean()), 1e-300))
    variance = np.maximum(variance, lsb**2 / 12.0)
    # Of the residual along the field, what neighbours share.
    hidden = max(0.0, whole_nT2 - float(((unit**2) @ variance).mean()))
    # Anything from none of it to all of it may be noise of the reading: a uniform law of that width.
    covariance = covariance + np.full((3, 3), hidden**2 / 12.0)
    sigma = np.sqrt(variance)
    unsure = np.sqrt(variance + np.sqrt(np.diag(covariance))) - sigma
    sizes = " / ".join(measured(float(s), float(u)) for s, u in zip(sigma, unsure, strict=True))
    words = f"{sizes} nT per axis, taken as white, from short differences of the residual; {lsb_words}"
    return ReadingNoise(variance, words, covariance)


def scalar_noise(
    B_nT: FloatArray,
    time: TimeArray,
    residual_nT: FloatArray,
    noise_nT: float | FloatArray | None,
    lsb_nT: float | FloatArray | None,
) -> ReadingNoise:
    """Sigma_B: declared, or taken alike on the three axes from differences of neighbours.

    B_nT: (N, 3). residual_nT: (N,) |B| less |H| of a first fit. What lasts longer than a sample is not noise here; how
    much of the residual is of that kind goes into the covariance, as any part of it may be noise all the same.
    """
    some = stretches(len(time))
    declared, lsb, words = _declared(B_nT[some], noise_nT, lsb_nT)
    if declared is not None:
        return declared
    r, near = residual_nT[some], _near(time[some])
    whole = clipped_sigma(r) ** 2
    scaled = whole * len(r) / max(len(r) - 9, 1)
    if near.size < _FEWEST_PAIRS:
        return _all_noise(scaled, lsb, f"{words}; {_TOO_FEW} of |B| is taken for noise")
    white = min(0.5 * clipped_sigma(np.diff(r)[near]) ** 2, whole)
    variance = np.maximum(np.full(3, white), lsb**2 / 12.0)
    hidden = max(0.0, scaled - white)
    spread = np.full((3, 3), hidden**2 / 12.0 + 3.0 * white**2 / near.size)
    size = plain(float(np.sqrt(white)))
    text = f"{size} nT per axis from short differences of the residual of |B|, taken as equal; {words}"
    return ReadingNoise(variance, text, spread)


def _all_noise(variance_nT2: float, lsb_nT: FloatArray, words: str) -> ReadingNoise:
    """Noise of that variance, alike on the axes, of which anything from none to all may be something else."""
    return ReadingNoise(np.maximum(variance_nT2, lsb_nT**2 / 12.0), words, np.full((3, 3), variance_nT2**2 / 12.0))


def _declared(
    B_nT: FloatArray, noise_nT: float | FloatArray | None, lsb_nT: float | FloatArray | None
) -> tuple[ReadingNoise | None, FloatArray, str]:
    """The noise where it is declared; (3,) LSB of each axis and where it comes from."""
    lsb = lsb_from_spacing_nT(B_nT) if lsb_nT is None else per_axis(lsb_nT, "--lsb-nT")
    found = "found from the spacing of the readings" if lsb.any() else "because the readings show no step"
    words = f"LSB {_three(lsb)} nT {found if lsb_nT is None else 'declared'}"
    if noise_nT is None:
        return None, lsb, words
    noise = per_axis(noise_nT, "--noise-nT")
    return ReadingNoise(noise**2 + lsb**2 / 12.0, f"noise {_three(noise)} nT declared, {words}"), lsb, words


def clipped_sigma(values: FloatArray) -> float:
    """Standard deviation with what lies beyond four robust sigma clipped: sees no bit errors."""
    middle = float(np.median(values))
    robust = MAD_TO_SIGMA * float(np.median(np.abs(values - middle)))
    if robust == 0.0:
        return 0.0
    inside = values[np.abs(values - middle) < 4.0 * robust]
    return float(np.std(inside))


def white_nT(residual_nT: FloatArray, time: TimeArray) -> float:
    """White noise of residuals (N,) from differences of neighbours; 0 where these are too few."""
    near = _near(time)
    return float(np.sqrt(0.5)) * clipped_sigma(np.diff(residual_nT)[near]) if near.size >= _FEWEST_PAIRS else 0.0


def _near(time: TimeArray) -> np.ndarray:
    """First rows (n,) of neighbours."""
    step = np.diff(time).astype("int64")
    return np.flatnonzero(step <= 1.5 * np.median(step)) if step.size else np.zeros(0, dtype=int)


def _differences(r: FloatArray, time: TimeArray) -> tuple[np.ndarray, FloatArray]:
    """First rows (n,) of neighbours and the differences (n, 3); what is beyond four robust sigma is left out."""
    near = _near(time)
    if near.size == 0:
        return near, np.zeros((0, 3))
    d = r[near + 1] - r[near]
    robust = MAD_TO_SIGMA * np.median(np.abs(d), axis=0)
    inside = (np.abs(d) <= 4.0 * np.where(robust > 0, robust, np.inf)).all(axis=1)
    return near[inside], d[inside]


def _fit_variances(B1_nT: FloatArray, B2_nT: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) sigma_i^2 and their covariance, by weighted least squares of products of differences d = r(B2) - r(B1)."""
    size = float(np.sqrt((B1_nT**2).sum(axis=1).mean()))
    features = 0.5 * (_features(B1_nT / size) + _features(B2_nT / size))
    products = 0.5 * d[:, _FIRST] * d[:, _SECOND]
    found = np.concatenate([np.diag(d.T @ d) / len(d) / 2.0, np.zeros(3)])
    information = np.zeros((6, 6))
    for _ in range(_ROUNDS):
        # Cov of the products of Gaussian differences, no terms between products: V_ii V_jj + V_ij^2 (here halved)
        model = features @ found
        floor = 1e-6 * model[:, :3].mean() + 1e-300
        own = np.maximum(model[:, :3], floor)
        spread = own[:, _FIRST] * own[:, _SECOND] + model**2
        root = 1.0 / np.sqrt(spread)
        rows = (features * root[:, :, None]).reshape(-1, 6)
        information = rows.T @ rows
        half = np.linalg.cholesky(information + 1e-12 * np.trace(information) * np.eye(6))
        found, _ = nnls(half.T, np.linalg.solve(half, rows.T @ (products * root).ravel()))
    # Neighbouring differences share a sample: their squares correlate by 1/4, on either side.
    return found[:3], np.asarray(1.5 * np.linalg.pinv(information)[:3, :3], dtype=np.float64)


def _features(b: FloatArray) -> FloatArray:
    """(n, 6 products, 6 variances) of the model for <d d'>/2; b: the field in units of its rms."""
    turned = of_turns(b)
    out = np.zeros((len(b), 6, 6))
    for product, (i, j) in enumerate(PAIRS):
        out[:, product, i] = 1.0 if i == j else 0.0
        for axis in range(3):
            out[:, product, 3 + axis] = turned[:, axis, i] * turned[:, axis, j]
    return out


def _grid_step(values: FloatArray) -> float:
    spacing = np.diff(np.unique(values))
    spacing = spacing[spacing > _SMALLEST_LSB_NT]
    if spacing.size < 2:
        return 0.0
    for parts in (1, 2, 3):  # the smallest spacing that occurs may be two or three steps
        step = float(spacing.min()) / parts
        for _ in range(2):  # the mean of the short spacings sharpens a rounded step
            counts = np.rint(spacing / step)
            short = counts <= 3 * parts
            step = float(spacing[short].sum() / counts[short].sum())
        if np.abs(spacing / step - counts).max() < 0.02:
            return step
    return 0.0


def _three(values: FloatArray) -> str:
    alike = np.ptp(values) <= 0.01 * values.max()
    return plain(float(values[0])) if alike else "/".join(plain(float(value)) for value in values)
