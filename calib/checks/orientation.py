"""Which way the attitude and the magnetometer's axes are meant, tested with the field model.

The reading is predicted with the attitude under every convention (scalar last or first, as it is or transposed,
relative to GCRS, Earth-fixed axes, north-east-centre or -down, or the orbital frame) and every mounting (48 signed
permutations of the axes, and those turned by 45 deg about an axis). The plausible ones are then weighed by
`evidence`, with bias, scale and misalignment free in each; a bias of any flown size is free, for uncompensated
satellites fly with 50,000 nT.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.checks.sample import Sample
from fluxtwin.calib.common.conventions import best_turn
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.references import rotation_XN
from fluxtwin.sim.telemetry.record import Origin

FAR_BETTER = 0.5
"""An alternative is named when it leaves at most half of the misfit."""
SINGLE_COST, EXTRA_COST = 4.0, 4.0
"""Log prior odds against one thing wrong (order, sense, reference or mounting), and against each further one."""
ODD_MOUNTING_COST, ANY_MOUNTING_COST = 1.0, 6.0
"""More against turns of 45 deg, and against a turn by any other angle."""
ORIENTATION = ("attitude_convention", "magnetometer_axes")
"""Codes of the traps of this module."""
PLAIN_MOUNTINGS = 48
"""The first of `mountings`, by quarter turns and reflections."""
_SHORT_LIST = 40
_SAME_TURN_RAD = np.radians(12.0)
"""A turn that fits best is the listed one that lies so near: misalignments and attitude errors are smaller."""


@dataclass(frozen=True)
class Hypothesis:
    """One way to read the record."""

    code: str
    """Code of the trap; empty for the record as it stands."""
    words: str
    advice: str
    cost: float
    """Log prior odds against it."""
    predicted_nT: FloatArray
    """(n, 3) what a perfect magnetometer would read, in the axes of the readings."""
    shift_s: float = 0.0
    """Seconds by which the stamps are late."""


@dataclass(frozen=True)
class _Convention:
    things: int
    """How many things are wrong."""
    words: str
    keys: tuple[str, ...]
    """What `attitude` needs in a column map to be read so, beside what it has."""
    R_BN: Rotation


@dataclass(frozen=True)
class _Mounting:
    matrix: FloatArray
    words: str
    cost: float


def orientations(sample: Sample, origin: Origin) -> list[Hypothesis]:
    """The record as it stands first; then every single thing wrong, and the pairs that leave the least misfit."""
    conventions, mounted = _conventions(sample, origin), mountings()
    matrices = np.stack([mounting.matrix for mounting in mounted])
    m = sample.mag_nT - sample.mag_nT.mean(axis=0)
    fields, misfits = [], np.empty((len(conventions), len(mounted)))
    turned: list[tuple[float, int, FloatArray]] = []
    for i, convention in enumerate(conventions):
        field = convention.R_BN.apply(sample.field_N_nT)
        fields.append(field)
        p = field - field.mean(axis=0)
        cross = m.T @ p
        gain = np.maximum(np.einsum("kij,ij->k", matrices, cross), 0.0)
        power = max(float(np.sum(p**2)), 1.0)
        misfits[i] = np.sqrt(np.maximum(np.sum(m**2) - gain**2 / power, 0.0))
        turn = best_turn(cross)
        turned.append((float(np.sum(m**2) - np.sum(turn * cross) ** 2 / power), i, turn))
    whole = np.array([[one.things + bool(two.words) for two in mounted] for one in conventions])
    order = np.argsort(misfits * (1.0 + 0.1 * whole), axis=None)[:_SHORT_LIST]
    listed = [divmod(int(place), len(mounted)) for place in order]
    listed += [(int(i), int(j)) for i, j in np.argwhere(whole <= 1)]
    pairs = [(0, 0), *(pair for pair in dict.fromkeys(listed) if pair != (0, 0))]
    out = [_hypothesis(conventions[i], mounted[j], fields[i], origin) for i, j in pairs]
    _, i, turn = min(turned, key=lambda one: one[0])
    return [*out, *_any_turn(conventions[i], turn, fields[i], matrices, origin)]


def _hypothesis(convention: _Convention, mounting: _Mounting, field_nT: FloatArray, origin: Origin) -> Hypothesis:
    things = convention.things + bool(mounting.words)
    code = "attitude_convention" if convention.words else "magnetometer_axes" if mounting.words else ""
    rows = (
        ", ".join(f"{value + 0.0:.4g}" for value in np.round(row, 4))
        for row in mounting.matrix.T @ np.array(origin.matrix)
    )
    turned = f"matrix = [{', '.join(f'[{row}]' for row in rows)}] for `mag` turns the columns in a column map"
    stated = f"`attitude` in a column map needs {', '.join(convention.keys)}"
    advice = "; ".join([stated] * bool(convention.words) + [turned] * bool(mounting.words))
    return Hypothesis(
        code,
        " and ".join(part for part in (convention.words, mounting.words) if part),
        advice,
        SINGLE_COST * (things > 0) + EXTRA_COST * max(things - 1, 0) + mounting.cost,
        field_nT @ mounting.matrix.T,
    )


def _any_turn(
    convention: _Convention, turn: FloatArray, field_nT: FloatArray, matrices: FloatArray, origin: Origin
) -> list[Hypothesis]:
    """The best turn of the mounting, unless it is one of those listed."""
    nearest = float(np.max(np.einsum("kij,ij->k", matrices, turn)))
    if np.arccos(np.clip((nearest - 1.0) / 2.0, -1.0, 1.0)) < _SAME_TURN_RAD:
        return []
    words = f"the magnetometer is turned by {_turn_words(turn)}"
    return [_hypothesis(convention, _Mounting(turn, words, ANY_MOUNTING_COST), field_nT, origin)]


@cache
def mountings() -> list[_Mounting]:
    """The 48 signed permutations of three axes, the plain one first, and the 24 turns of 90 deg after each of 45."""
    out, proper = [], []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            mirrored = np.linalg.det(matrix) < 0
            if not mirrored:
                proper.append(matrix)
            plain = order == (0, 1, 2) and min(signs) > 0
            words = f"the axes are turned ({_sides(matrix)}{'; mirrored' if mirrored else ''})"
            out.append(_Mounting(matrix, "" if plain else words, 0.0))
    for axis in np.eye(3):
        eighth = Rotation.from_rotvec(np.radians(45.0) * axis).as_matrix()
        for quarter in proper:
            matrix = quarter @ eighth
            words = f"the magnetometer is turned by {_turn_words(matrix)} ({_sides(matrix)})"
            out.append(_Mounting(matrix, words, ODD_MOUNTING_COST))
    return out


def _sides(matrix: FloatArray) -> str:
    """mag_x is +y, ...: each column in terms of the axes it ought to have."""
    sides = []
    for name, row in zip("xyz", matrix, strict=True):
        parts = [
            f"{'-' if value < 0 else '+'}{'' if abs(value) > 0.999 else f'{abs(value):.2f} '}{axis}"
            for axis, value in zip("xyz", row, strict=True)
            if abs(value) > 1e-6
        ]
        sides.append(f"mag_{name} is {' '.join(parts)}")
    return ", ".join(sides)


def _turn_words(matrix: FloatArray) -> str:
    """Angle and axis by which the sensor's axes are turned against the body's."""
    rotvec = Rotation.from_matrix(matrix.T).as_rotvec()
    angle = float(np.linalg.norm(rotvec))
    axis = rotvec / max(angle, 1e-12)
    for name, value in zip("xyz", axis, strict=True):
        if abs(value) > 0.9999:
            return f"{np.degrees(angle):.0f} deg about {'+' if value > 0 else '-'}{name}"
    return f"{np.degrees(angle):.0f} deg about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f})"


_REFERENCES = {
    "GCRS": "inertial axes (GCRS)",
    "ITRS": "Earth-fixed axes (ITRS)",
    "NEC": "north, east, centre (NEC)",
    "NED": "geodetic north, east, down (NED)",
    "orbital": "the orbital frame",
}
LOCAL = (_REFERENCES["NEC"], _REFERENCES["NED"])
"""Local axes that differ by the angle between the two verticals alone."""


def _conventions(sample: Sample, origin: Origin) -> list[_Convention]:
    """Every way to read the quaternion that was recorded; the first is as the contract, or the map, says."""
    assert sample.q_NB is not None
    names = [name for name in _REFERENCES if name != "orbital" or bool(np.isfinite(sample.v_N_km_s).all())]
    stated = origin.attitude if origin.attitude in names else "GCRS"
    axes = {name: rotation_XN(name, sample.time, sample.r_N_km, sample.v_N_km_s) for name in names}
    q = sample.q_NB if stated == "GCRS" else frames.q_from_rotation(sample.R_BN * axes[stated].inv())
    q = q * [-1.0, -1.0, -1.0, 1.0] if origin.conjugated else q  # as it is stored
    orders = [("", (), q), ("the quaternion is scalar first", ('order = "wxyz"',), q[:, [1, 2, 3, 0]])]
    if origin.scalar_first:
        orders[1] = ("the quaternion is scalar last", ('order = "xyzw"',), q[:, [3, 0, 1, 2]])
    sense = f'sense = "{"textbook" if origin.conjugated else "conjugate"}"'
    others = sorted(names, key=lambda name: name != stated)
    worded = [("" if name == stated else f"the attitude is relative to {_REFERENCES[name]}", name) for name in others]
    out = []
    for (order, order_key, quaternion), conjugate in itertools.product(orders, (False, True)):
        R = frames.rotation_from_q(quaternion)
        R = R.inv() if conjugate != origin.conjugated else R
        for reference, name in worded:
            words = [w for w in (order, "it is conjugated (transposed)" if conjugate else "", reference) if w]
            if words and words[0].startswith("it is"):
                words[0] = words[0].replace("it is", "the quaternion is")
            keys = (*order_key, *([sense] if conjugate else []), *([f'relative_to = "{name}"'] if reference else []))
            out.append(_Convention(len(words), " and ".join(words), keys, R * axes[name]))
    return out
