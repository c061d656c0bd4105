"""What two magnetometers read apart, beside a calibration of each.

Field, orbit, attitude and clock are the same for both: an error of theirs is not in the difference of the readings. What
one sensor does is in it as it stands, what the spacecraft does by as much as the two places differ. No error of the
attitude reaches the difference, so it sees what a reading alone hides, and it separates stages that a reading cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.conventions import of_S
from fluxtwin.gap.hypotheses.blocks import OWN_STAGES
from fluxtwin.gap.linear.projection import ProjectedResidual, explained_in_units, orthonormal, projected
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA, standing_out
from fluxtwin.gap.noise.whitening import NoiseModel, Whitener, make_whitener
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, Problem
from fluxtwin.gap.selection.criterion import SHAPE, THRESHOLD
from fluxtwin.sim.base.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Apart:
    """The first magnetometer's readings less the second's."""

    left: ProjectedResidual
    """Whitened, beside the relative calibration."""
    rms_nT: float
    """Of what that calibration leaves, per component."""
    noise_nT: float
    """What the noise of both gives, per component."""

    def denies(
        self,
        readings: ProjectedResidual,
        stage: str,
        alternatives_nT: Sequence[FloatArray],
        image_nT: FloatArray,
        others_nT: Sequence[FloatArray],
    ) -> bool:
        """Whether the difference denies a cause in all its alternatives: one of the sensor must be in it as it is in the
        first one's readings, one that both share must not; of the spacecraft it may be there or not.

        readings: what the cause was found in, beside what is re-estimated; alternatives_nT, others_nT: columns (N, 3, p), of
        the cause and of others; image_nT (N, 3): what is to be explained of the readings. A size that readings alone give is
        as unsure as their attitude: so the cause is fitted to both at once, and weighed by the criterion. An alternative
        that explains nothing of the readings, while another does, cannot be the cause.
        """
        drops = []
        for columns_nT in alternatives_nT:
            gram, moment = _products(readings, columns_nT, others_nT, image_nT)
            its_gram, its_moment = _products(self.left, columns_nT, others_nT, None)
            own, _ = explained_in_units(gram, moment)
            both, _ = explained_in_units(gram + its_gram, moment + its_moment)
            drops.append((own, both))
        least = min(THRESHOLD, max((shared for shared, _ in drops), default=0.0))
        return bool(drops) and all(_denied(stage, *one) for one in drops if one[0] >= least)


def _denied(stage: str, shared: float, own: float) -> bool:
    """By the drops of chi-square of a cause that is in the first one's readings alone, and in the difference as well."""
    for_own = (own - shared) / (1.0 + SHAPE * max(shared, own))
    return stage != "spacecraft" and (-for_own if stage == "sensor" else for_own) > THRESHOLD


def _products(
    left: ProjectedResidual, columns_nT: FloatArray, others_nT: Sequence[FloatArray], image_nT: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Gram matrix of a cause's columns beside the others', and their products with an image, or with what is left."""
    columns, _ = left.project(columns_nT)
    target = left.residual if image_nT is None else left.project(image_nT[:, :, None])[0][:, 0]
    if others_nT:
        basis = orthonormal(left.project(np.concatenate(others_nT, axis=2))[0])
        columns = columns - basis @ (basis.T @ columns)
    return columns.T @ columns, columns.T @ target


def apart(problem: Problem) -> Apart | None:
    """The difference of the two magnetometers, the second's brought into the first's axes and scale; None where too few rows
    have both, or the second does not follow the field, or one is a copy of the other."""
    first, second = np.asarray(problem.telemetry.mag_B_nT), problem.telemetry.mag2_B_nT
    if second is None:
        return None
    both: BoolArray = np.asarray(np.isfinite(second).all(axis=1))
    if both.sum() < 50:  # four for each of the twelve parameters of a relative calibration
        return None
    difference = np.where(both[:, None], first - second, 0.0)
    field_B_nT = problem.design.signal([*problem.frozen, *problem.modelled_active]).field_B_nT
    # What S, row by row, and b of one against the other make of the field.
    relative = np.concatenate([of_S(field_B_nT), np.broadcast_to(np.eye(3), (problem.rows, 3, 3))], axis=2)
    # That field has the errors of the attitude in it, by which the two readings differ as far as their S do.
    columns, both_nT = relative[both].reshape(-1, 12), np.stack([difference[both], first[both]], axis=-1).reshape(-1, 2)
    size, *_ = np.linalg.lstsq(columns, both_nT, rcond=None)
    relative_S = size[:9, 0].reshape(3, 3)
    second_of_first = np.eye(3) - relative_S
    gain = np.linalg.svd(second_of_first, compute_uv=False)
    if gain.max() > 2.0 or gain.min() < 0.5:  # in some direction: it is dead, or in another unit
        return None
    own = np.zeros_like(difference)
    own[both] = (both_nT[:, 1] - columns @ size[:, 1]).reshape(-1, 3)
    difference[both] -= own[both] @ relative_S.T
    difference = np.linalg.solve(second_of_first, difference.T).T
    beside = [one for one in problem.modelled_active if one[0].name not in DEFAULT_MODELLED]
    beside += [one for one in problem.frozen if one[0].stage in OWN_STAGES]
    fitted = np.concatenate([relative, problem.derivatives(beside)], axis=2)
    kept = np.repeat(both[:, None], 3, axis=1)
    for _ in range(2):  # with the outliers, and without
        rest = projected(_white(problem, np.ones(3), kept), difference, fitted).residual.reshape(-1, 3)
        kept = kept & (standing_out(rest, measured=kept) <= CUT_SIGMA)
    # From steps from row to row: what is slow has no part in them.
    sigma_nT = np.array([np.std(np.diff(rest[there, axis])) / np.sqrt(2.0) for axis, there in enumerate(kept.T)])
    rows = kept.all(axis=1)
    # Less noise between them is the rounding of single precision (4 pT at 50 uT).
    if not np.min(sigma_nT) > 0.01 or _is_copy(*(_steps_along(x[rows], field_B_nT[rows]) for x in (own, rest))):
        return None
    left = projected(_white(problem, sigma_nT, kept), difference, fitted)
    rms_nT = float(np.sqrt(np.sum(rest[kept] ** 2) / left.degrees))
    return Apart(left, rms_nT, float(np.sqrt(np.mean(sigma_nT**2))))


def _white(problem: Problem, sigma_nT: FloatArray, kept: BoolArray) -> Whitener:
    """White noise of each axis (3,), over the components (N, 3) that both sensors have."""
    noise = NoiseModel(1.0, 0.0, 0.0, axis_factor=(float(sigma_nT[0]), float(sigma_nT[1]), float(sigma_nT[2])))
    geometry = (np.zeros((problem.rows, 3, 3)), problem.setting.seconds, problem.segment)
    return make_whitener(*geometry, noise, kept.astype(np.float64))


def _steps_along(values_nT: FloatArray, field_B_nT: FloatArray) -> FloatArray:
    """(n-1,) steps from row to row along the field, where no error of the attitude is."""
    along = np.einsum("ij,ij->i", values_nT, field_B_nT) / np.maximum(np.linalg.norm(field_B_nT, axis=1), 1e-9)
    return np.diff(along)


def _is_copy(first: FloatArray, difference: FloatArray) -> bool:
    """Whether the second's readings are made of the first's, or the other way round, be it rounded or with noise added.

    first: (n,) steps of what the first reads beside its calibration; difference: of the first less the second. The noise of
    an independent sensor is in the difference in full, that of one that was copied is not in it at all.
    """
    usual = (standing_out(np.stack([first, difference], axis=1)) <= CUT_SIGMA).all(axis=1)
    first, difference = first[usual], difference[usual]
    return any(_has_none_of(*pair) for pair in ((difference, first), (-difference, first - difference)))


def _has_none_of(difference: FloatArray, own: FloatArray) -> bool:
    """Whether the share of steps (n,) of their own in the difference is nothing, and not all, by three standard errors."""
    square = float(own @ own)
    if square == 0.0:
        return False
    share = float(difference @ own) / square
    left = difference - share * own
    # neighbouring steps have a row in common: their products correlate by 1/4, on either side
    error = float(np.sqrt(1.5 * (left @ left) / (len(own) * square)))
    return abs(share) < 3.0 * error < 1.0 - share
