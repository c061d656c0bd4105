"""Free motion of an axisymmetric body in closed form, without its inertia.

    A(t) = Rz(lam t) A0 exp(-[Om x] t)

A0 is the attitude matrix (N to B) at t = 0, Om = L/Jt the precession in N, lam = w3 (1 - Js/Jt) the turn of the body
about its axis of symmetry, z; Rz(a) = exp(-[a z x]). An error d of the attitude is A_true = (1 - [d x]) A. (Markley &
Sedlak 2008 write the same motion with L and J; here the three are free, so that no inertia need be known.)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray


class SpinMotion(NamedTuple):
    """Seven numbers that hold the attitude at any time."""

    A0: FloatArray
    """(3, 3) N to B at t = 0."""
    Om_N_rad_s: FloatArray
    """(3,) precession."""
    lam_rad_s: float

    @property
    def spin_rad_s(self) -> float:
        """Rate about body z, w3."""
        return self.lam_rad_s + float(self.A0[2] @ self.Om_N_rad_s)

    @property
    def inertia_ratio(self) -> float:
        """Js / Jt; without nutation lam and Om cannot be separated and it means nothing."""
        return 1.0 - self.lam_rad_s / self.spin_rad_s

    @property
    def nutation_rad(self) -> float:
        """Angle from body z to the angular momentum (to its opposite for a negative spin)."""
        along = float(self.A0[2] @ self.Om_N_rad_s) / float(np.linalg.norm(self.Om_N_rad_s))
        return float(np.arccos(min(abs(along), 1.0)))

    def moved(self, step: FloatArray) -> SpinMotion:
        """After a step (7,) of [d0, dOm, dlam].

        The part of dOm across Om turns it and leaves its size: a step of 2 deg added as a vector would be 6e-4 longer,
        and slip a turn in an hour.
        """
        rate = float(np.linalg.norm(self.Om_N_rad_s))
        n = self.Om_N_rad_s / max(rate, 1e-300)
        longer = 1.0 + float(n @ step[3:6]) / max(rate, 1e-300)
        Om = turn(np.cross(n, step[3:6]) / max(rate, 1e-300)) @ self.Om_N_rad_s * longer
        return SpinMotion(turn(-step[:3]) @ self.A0, Om, self.lam_rad_s + float(step[6]))

    def shifted(self, seconds: float) -> SpinMotion:
        """The same motion with its zero of time `seconds` later."""
        return self._replace(A0=self.attitude(np.array([seconds]))[0])

    def attitude(self, t_s: FloatArray) -> FloatArray:
        """(N, 3, 3) attitude matrices, N to B."""
        rows = [self.see(t_s, np.broadcast_to(np.eye(3)[i], (len(t_s), 3))) for i in range(3)]
        return np.stack(rows, axis=2)

    def see(self, t_s: FloatArray, v_N: FloatArray) -> FloatArray:
        """(N, 3) vectors of N in B: A(t) v."""
        return about_z(self.lam_rad_s * t_s, self.unspun(t_s, v_N) @ self.A0.T)

    def slopes(self, t_s: FloatArray, v_N: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 3) y = A(t) v and (N, 3, 7) its derivatives by [d0, dOm, dlam], to first order in these.

        d(t) = Rz d0 + Rz A0 Jl(-Om t) t dOm + z t dlam,   Jl(x) = 1 + (1-cos x)/x^2 [x x] + (x - sin x)/x^3 [x x]^2
        """
        rate = max(float(np.linalg.norm(self.Om_N_rad_s)), 1e-300)
        n = self.Om_N_rad_s / rate
        v = self.unspun(t_s, v_N)
        u, spin = v @ self.A0.T, self.lam_rad_s * t_s
        c, s = np.cos(spin), np.sin(spin)
        y = _turned(c, s, u)
        # Component by component: loops over three numbers in each row would take most of the time.
        none, (u0, u1, u2), v = np.zeros(len(t_s)), u.T, np.ascontiguousarray(v.T)
        out = np.zeros((7, 3, len(t_s)))
        slow, fast = (1.0 - np.cos(rate * t_s)) / rate, t_s - np.sin(rate * t_s) / rate
        by_axes = (none, u2, -u1), (-u2, none, u0), (u1, -u0, none)  # u x axis
        for k, axis in enumerate(np.eye(3)):
            _turn_into(out[k], c, s, by_axes[k])
            across = _cross(n, axis)
            turned = [t_s * a - slow * b + fast * d for a, b, d in zip(axis, across, _cross(n, across), strict=True)]
            _turn_into(out[3 + k], c, s, (np.stack(_cross(v, turned), axis=1) @ self.A0.T).T)
        out[6, 0], out[6, 1] = y[:, 1] * t_s, -y[:, 0] * t_s
        return y, np.ascontiguousarray(out.transpose(2, 1, 0))

    def unspun(self, t_s: FloatArray, v_N: FloatArray) -> FloatArray:
        """(N, 3) exp(-[Om x] t) v."""
        rate = float(np.linalg.norm(self.Om_N_rad_s))
        n = self.Om_N_rad_s / max(rate, 1e-300)
        across = cross_by(n, v_N)
        sine, cosine = np.sin(rate * t_s)[:, None], np.cos(rate * t_s)[:, None]
        return np.asarray(v_N - sine * across + (1.0 - cosine) * cross_by(n, across))


def about_z(angle_rad: FloatArray, v: FloatArray) -> FloatArray:
    """(N, 3) Rz(angle) v: components in axes turned by the angle about z."""
    return _turned(np.cos(angle_rad), np.sin(angle_rad), v)


def _turned(c: FloatArray, s: FloatArray, v: FloatArray) -> FloatArray:
    """`about_z` by cosines and sines (N,)."""
    out = np.empty((len(v), 3))
    _turn_into(out.T, c, s, v.T)
    return out


def _turn_into(out: FloatArray, c: FloatArray, s: FloatArray, v: FloatArray | Sequence[FloatArray]) -> None:
    """The same, of and into the three components (3, N)."""
    np.add(c * v[0], s * v[1], out=out[0])
    np.subtract(c * v[1], s * v[0], out=out[1])
    out[2] = v[2]


def _cross(a: FloatArray | Sequence[FloatArray], b: FloatArray | Sequence[FloatArray]) -> list[FloatArray]:
    """The three components (N,) of a x b, of those of a and b."""
    return [a[j] * b[k] - a[k] * b[j] for j, k in ((1, 2), (2, 0), (0, 1))]


def cross_by(n: FloatArray, v: FloatArray) -> FloatArray:
    """(N, 3) n x v for one n (3,)."""
    return np.asarray(v @ skew(n).T)


def skew(v: FloatArray) -> FloatArray:
    """(3, 3) [v x]."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turn(v: FloatArray) -> FloatArray:
    """(3, 3) exp([v x])."""
    return np.asarray(Rotation.from_rotvec(v).as_matrix())


def turn_vector(R: FloatArray) -> FloatArray:
    """(3,) v of R = exp([v x])."""
    return np.asarray(Rotation.from_matrix(R).as_rotvec())
