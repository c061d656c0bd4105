"""Rows without a reference attitude: what they say is the size of the field, and its angle to nadir where that was measured.

Such a row gets a pseudo attitude, one of the many that take the model field to where the reading points. The
direction of the field in body axes is known from the reading itself, so the chain's derivatives at the pseudo
attitude, seen along the field, are those of the field's size (for bias, scale and non-orthogonality: Alonso &
Shuster 2002, J. Astronautical Sciences 50, 477). What an error of attitude could do is turned out of such rows: they
are compared in axes of their own, of which only those count that no turn of the body reaches. With a nadir vector the
pseudo attitude has nadir exactly and the field in the measured plane, so only a turn about nadir stays unknown. Where no
row has an attitude, a calibration of |B| says where to start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.scalar.calibrate import calibrate_scalar
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

_FEWEST = 20  # rows with nadir, in a row or beside an attitude: fewer do not show how its error goes on


@dataclass(frozen=True, eq=False)
class RowAxes:
    """The axes in which the rows are compared; N rows, those with attitude in body axes."""

    known: BoolArray
    """(N,) rows with a reference attitude."""
    turn: FloatArray
    """(N, 3, 3) body axes to the row's own axes: identity, or the field, across it towards nadir, across both."""
    measured: BoolArray
    """(N, 3) components, in the row's own axes, that no turn of the body reaches."""
    nadir_B: FloatArray
    """(N, 3) measured nadir where it is used, else zero."""
    matrix: FloatArray
    """(3, 3) I + S: from reading to field."""
    nadir_error: float = 1.0
    """Error of the nadir vector over that of the reference attitude."""

    @property
    def with_nadir(self) -> BoolArray:
        """(N,) rows without attitude whose angle between field and nadir is used."""
        return np.asarray(~self.known & self.measured[:, 1], dtype=np.bool_)

    @property
    def words(self) -> str:
        """How rows without attitude entered."""
        nadir, rows = int(self.with_nadir.sum()), int((~self.known).sum())
        angle = f", and {nadir} of them through its angle to nadir" if nadir else ""
        entered = f"have no reference attitude and enter through the size of the field{angle}"
        return f"{rows} of {self.known.size} rows {entered}"

    def in_row_axes(self, columns: FloatArray) -> FloatArray:
        """Columns (N, 3) or (N, 3, P) in body axes, turned into the rows' own axes, zero where not measured."""
        turned, here = np.array(columns, dtype=np.float64), np.flatnonzero(~self.known)
        part = np.matmul(self.turn[here], turned[here].reshape(here.size, 3, -1)) * self.measured[here, :, None]
        turned[here] = part.reshape(here.size, *turned.shape[1:])
        return turned

    def in_body(self, rows_own: FloatArray) -> FloatArray:
        """(N, 3) vectors in the rows' own axes, back in body axes."""
        return np.asarray(np.einsum("nki,nk->ni", self.turn, rows_own))

    def noise_field_nT(self, field_B_nT: FloatArray) -> FloatArray:
        """(N, 3) field that an attitude error acts on: none along itself, that of nadir in the plane with nadir."""
        alone = np.zeros_like(field_B_nT)
        size = np.linalg.norm(field_B_nT, axis=1)
        alone[:, 0] = np.where(self.with_nadir, self.nadir_error * size, 0.0)
        return np.where(self.known[:, None], field_B_nT, alone)

    def without_turn(self, residual_nT: FloatArray, field_B_nT: FloatArray) -> FloatArray:
        """Residual (N, 3) less what a turn of the body explains of it, body axes; field_B_nT (N, 3) as predicted.

        Exact for what adds to the field, however large: sizes are compared, not projections.
        """
        out = np.array(residual_nT)
        plain, angle = ~self.known & ~self.with_nadir, self.with_nadir
        F, E = field_B_nT, residual_nT @ self.matrix.T
        back = np.linalg.inv(self.matrix).T
        f = F[plain]
        longer = np.linalg.norm(f + E[plain], axis=1) / np.linalg.norm(f, axis=1) - 1.0
        out[plain] = longer[:, None] * f @ back
        n = self.nadir_B[angle]
        before, after = (_across(v, n) for v in (F[angle], F[angle] + E[angle]))
        along = np.einsum("ni,ni->n", E[angle], n)
        wider = np.linalg.norm(after, axis=1) / np.maximum(np.linalg.norm(before, axis=1), 1e-9) - 1.0
        out[angle] = (along[:, None] * n + wider[:, None] * before) @ back
        return out

    def fitting_turn(self, residual_nT: FloatArray, field_B_nT: FloatArray) -> FloatArray:
        """(N, 3) rotation vectors by which pseudo attitudes must be turned to fit the reading; zero where known."""
        F, G = field_B_nT, field_B_nT + residual_nT @ self.matrix.T
        axis = np.cross(F, G)
        size = np.linalg.norm(axis, axis=1)
        angle = np.arctan2(size, np.einsum("ni,ni->n", F, G))
        turn = axis / np.maximum(size, 1e-300)[:, None] * angle[:, None]
        before, after = _across(F, self.nadir_B), _across(G, self.nadir_B)
        sine = np.einsum("ni,ni->n", self.nadir_B, np.cross(before, after))
        about = np.arctan2(sine, np.einsum("ni,ni->n", before, after))[:, None] * self.nadir_B
        turn = np.where(self.with_nadir[:, None], about, turn)
        return np.where(self.known[:, None], 0.0, turn)


def pseudo_attitude(R_BN: Rotation, known: BoolArray, field_N_nT: FloatArray, field_B_nT: FloatArray) -> FloatArray:
    """(N, 4) R_BN where it is known; elsewhere that of the row before, turned as little as makes the field fit.

    field_N_nT, field_B_nT (N, 3): model, and reading as calibrated so far. So the way of the field through the body
    is that of the readings, and the rate about the field, which nobody knows, is small.
    """
    quaternions = np.atleast_2d(R_BN.as_quat())
    wanted = field_B_nT / np.maximum(np.linalg.norm(field_B_nT, axis=1), 1e-300)[:, None]
    there = field_N_nT / np.linalg.norm(field_N_nT, axis=1)[:, None]
    start = quaternions[int(np.argmax(known))] if known.any() else np.array([0.0, 0.0, 0.0, 1.0])
    before = (float(start[0]), float(start[1]), float(start[2]), float(start[3]))
    for row in range(known.size):
        if known[row]:
            x, y, z, w = quaternions[row].tolist()
            before = (x, y, z, w)
            continue
        before = _least_turned(before, there[row].tolist(), wanted[row].tolist())
        quaternions[row] = before
    return quaternions


_Quaternion = tuple[float, float, float, float]


def _least_turned(q: _Quaternion, there: list[float], wanted: list[float]) -> _Quaternion:
    """The rotation q followed by the smallest one that brings q(there) to `wanted`. Plain numbers: it is a recursion."""
    x, y, z, w = q
    a, b, c = there
    # v = q there q*, by v + 2 w (r x v) + 2 r x (r x v)
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    vx, vy, vz = a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx
    ux, uy, uz = wanted
    cosine = vx * ux + vy * uy + vz * uz
    px, py, pz, pw = vy * uz - vz * uy, vz * ux - vx * uz, vx * uy - vy * ux, 1.0 + cosine
    if pw < 1e-9:  # opposite: half a turn about anything across
        px, py, pz, pw = (-vy, vx, 0.0, 0.0) if abs(vz) < 0.9 else (0.0, -vz, vy, 0.0)
    size = (px * px + py * py + pz * pz + pw * pw) ** 0.5
    px, py, pz, pw = px / size, py / size, pz / size, pw / size
    return (
        pw * x + px * w + py * z - pz * y,
        pw * y + py * w + pz * x - px * z,
        pw * z + pz * w + px * y - py * x,
        pw * w - px * x - py * y - pz * z,
    )


def row_axes(
    known: BoolArray, field_B_nT: FloatArray, nadir_B: FloatArray, matrix: FloatArray, nadir_error: float
) -> RowAxes:
    """The rows' own axes at the predicted field (N, 3). nadir_B (N, 3): zero where there is none; matrix: I + S.

    What a turn of the body does to the field shows in the reading through (I + S)^-1, so the axes that it does not
    reach are (I + S)^T times those of the field.
    """
    use = ~known & np.any(nadir_B != 0.0, axis=1)
    unit = field_B_nT / np.linalg.norm(field_B_nT, axis=1)[:, None]
    helper = np.where(use[:, None], nadir_B, np.eye(3)[np.argmin(np.abs(unit), axis=1)])
    towards = _across(helper, unit)
    first = _unit(unit @ matrix)
    second = _unit(_across(_unit(towards) @ matrix, first))
    turn = np.stack([first, second, np.cross(first, second)], axis=1)
    turn[known] = np.eye(3)
    measured = np.stack([np.ones_like(known), known | use, known], axis=1)
    return RowAxes(known, turn, measured, np.where(use[:, None], nadir_B, 0.0), matrix, nadir_error)


def usable_nadir(
    nadir_B: FloatArray | None,
    known: BoolArray,
    R_BN: Rotation,
    nadir_N: FloatArray,
    field_N_nT: FloatArray,
    attitude_sigma_rad: float | None,
) -> tuple[FloatArray, float]:
    """(N, 3) nadir vectors to be used, zero elsewhere, and their error over that of the reference attitude.

    Where no row has an attitude the noise model finds the error of nadir. Where some have, rows with both say how the
    two sensors differ: a constant turn between them is taken out, the rest adds to the error. Without such rows
    nothing is known of the nadir sensor, and it is not used.
    """
    none = np.zeros((known.size, 3))
    if nadir_B is None:
        return none, 1.0
    size = np.linalg.norm(nadir_B, axis=1)
    given = np.isfinite(size) & (size > 0.5)
    unit = np.where(given[:, None], nadir_B / np.where(given, size, 1.0)[:, None], 0.0)
    ratio = 1.0
    if known.any():
        both = given & known
        if both.sum() < _FEWEST:
            return none, 1.0
        unit, ratio = _aligned(unit, R_BN.apply(nadir_N), both, attitude_sigma_rad)
    down = field_N_nT / np.linalg.norm(field_N_nT, axis=1)[:, None]
    # Nearer than ten degrees the plane of the two is lost in noise.
    wide = np.linalg.norm(np.cross(nadir_N, down), axis=1) > 0.17
    use = _long_runs(given & wide & ~known, known)
    return np.where(use[:, None], unit, 0.0), ratio


def _aligned(
    nadir_B: FloatArray, expected_B: FloatArray, both: BoolArray, attitude_sigma_rad: float | None
) -> tuple[FloatArray, float]:
    """Nadir with its constant turn against the reference attitude taken out, and the ratio of the errors."""
    apart = np.cross(expected_B, nadir_B)[both]  # expected x (turn x expected) = turn across expected
    e = expected_B[both]
    projectors = np.eye(3) - e[:, :, None] * e[:, None, :]
    turn = np.linalg.lstsq(projectors.reshape(-1, 3), apart.reshape(-1), rcond=1e-3)[0]
    scatter = float(np.sqrt(np.mean(np.sum((apart - projectors @ turn) ** 2, axis=1)) / 2.0))
    # Errors that are independent, or nadir's own on top of a common one: the larger of the two is taken.
    theta = attitude_sigma_rad if attitude_sigma_rad else scatter / np.sqrt(2.0)
    ratio = float(np.hypot(1.0, scatter / theta)) if theta > 0 else 1.0
    return Rotation.from_rotvec(-turn).apply(nadir_B), ratio


def _long_runs(use: BoolArray, known: BoolArray) -> BoolArray:
    """Of the rows to be used (N,), those in runs of enough rows that no row with attitude breaks."""
    run = np.cumsum(known)
    count = np.bincount(run[use], minlength=int(run[-1]) + 1 if run.size else 1)
    return np.asarray(use & (count[run] >= _FEWEST), dtype=np.bool_)


def calibrated(reading_B_nT: FloatArray, instrument: Magnetometer, dipole_B_Am2: FloatArray | None) -> FloatArray:
    """(N, 3) field that the instrument's S, b, T make of a reading (equation 1)."""
    field = reading_B_nT @ (np.eye(3) + instrument.S).T + instrument.b_nT
    if instrument.T_nT_per_Am2 is not None and dipole_B_Am2 is not None:
        field = field + np.nan_to_num(dipole_B_Am2) @ instrument.T_nT_per_Am2.T
    return np.asarray(field)


def _across(vectors: FloatArray, unit: FloatArray) -> FloatArray:
    """(n, 3) part of vectors across unit vectors; all of them where the unit vector is zero."""
    return np.asarray(vectors - np.einsum("ni,ni->n", vectors, unit)[:, None] * unit)


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None])


def turn_images(field_B_nT: FloatArray, matrix: FloatArray | None = None) -> FloatArray:
    """(N, 3, 3) J with J theta = M (theta x B): what a turn theta [rad] does to a reading. field_B_nT: (N, 3).

    matrix: M (3, 3), of the sensor, (I + S)^-1 of equation 1; default one.
    """
    images = np.cross(np.eye(3)[None, :, :], np.asarray(field_B_nT, dtype=np.float64)[:, None, :]).swapaxes(1, 2)
    return np.ascontiguousarray(images if matrix is None else matrix @ images)


def start_without_attitude(telemetry: Telemetry, model: FieldModel) -> Magnetometer | None:
    """The magnetometer as the record itself calibrates it; None where the readings are near the field as they are.

    Everything in a diagnosis is linear about its start, and a raw magnetometer may be off by more than the field. Raises
    NoAnswer, naming what is open, where such a record does not determine b and S: nothing could be concluded from them then.
    """
    usable = telemetry.select(telemetry.has_reading & telemetry.has_position)
    if not len(usable):
        return None
    assert usable.r_N_km is not None
    size_nT = np.linalg.norm(field_N_nT(model, usable.time, np.asarray(usable.r_N_km)), axis=1)
    off_nT = np.linalg.norm(usable.mag_B_nT, axis=1) - size_nT
    if np.median(np.abs(off_nT)) < 0.1 * np.median(size_nT):  # Gauss-Newton may start there
        return None
    known = calibrate_scalar(telemetry, model).calibration
    sigmas = dict(zip(known.names, known.sigmas, strict=True))
    usual_nT = float(np.median(size_nT))
    relative = {name: sigma / usual_nT if name.startswith("b") else sigma for name, sigma in sigmas.items()}
    # A bias that is open by 2 % moves |B| by half its square over |B|, some 8 nT in 40,000, whatever the linear fit makes of
    # it: about the least noise of a magnetometer in orbit.
    worst = [name for name in sorted(relative, key=lambda name: -relative[name]) if relative[name] > 0.02]
    if worst:
        words = [f"{name} by {sigmas[name]:.2g}{' nT' if name.startswith('b') else ''}" for name in worst[:3]]
        raise NoAnswer(
            f"no row has a reference attitude, and |B| alone leaves {' and '.join(words)} open (1 sigma): no effect can be "
            "distinguished from the calibration. A record with attitude, or with turns about a second axis, would allow it",
            evidence={"sigma": {name: float(sigmas[name]) for name in worst}},
        )
    return Magnetometer(known.S, known.b_nT)
