"""Flights of a rigid body with wheels, by an integrator and torques that are the benchmark's own.

Euler's equations with quaternion and rate by an adaptive method of order eight, from switch to switch of the torquers;
wheels follow a speed profile that is given. Nothing of the simulator's dynamics is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.earth.atmosphere import density_along
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.earth.orbit import Orbit

GM_M3_S2 = 3.986004418e14
PUSH_N_M2 = 1361.0 / 299792458.0
EARTH_RATE = np.array([0.0, 0.0, 7.292115e-5])
_NODES_S = 20.0

Instant = dict[str, FloatArray]
"""What a torque may follow at one moment: r, v, field, rate, sun (in B), light, density, dipole, J."""
Torque = Callable[[Instant], FloatArray]


@dataclass(frozen=True, eq=False)
class Body:
    """What flies."""

    inertia: FloatArray
    axes: FloatArray
    """(W, 3) of the wheels."""
    wheel_inertia: float
    speed_rad_s: Callable[[float], FloatArray]
    """(W,) relative to the body, at a time since the start."""
    acceleration: Callable[[float], FloatArray]
    switches: FloatArray
    """Times at which torquers change."""
    dipoles: FloatArray
    """(len(switches), 3) A m2 from each switch on."""

    def dipole(self, seconds: FloatArray) -> FloatArray:
        """(N, 3) at times since the start."""
        held: FloatArray = self.dipoles[np.clip(np.searchsorted(self.switches, seconds, side="right") - 1, 0, None)]
        return held


class Surroundings:
    """Orbit, field, sun and air as functions of the time since a start."""

    def __init__(self, orbit: Orbit, model: FieldModel, start: np.datetime64, length_s: float) -> None:
        seconds = np.arange(-2 * _NODES_S, length_s + 3 * _NODES_S, _NODES_S)
        time = epoch.add_seconds(start, seconds)
        r_km, v_km_s = orbit.propagate(time)
        sun_km = sun.sun_N_km(time)
        towards = sun_km - r_km
        light = sun.illumination(r_km, sun_km)[:, None]
        nodes = [
            1e3 * r_km,
            1e3 * v_km_s,
            1e-9 * field_N_nT(model, time, r_km),
            towards / np.linalg.norm(towards, axis=1)[:, None],
        ]
        self.smooth = CubicSpline(seconds, np.hstack([*nodes, np.log(density_along(time, r_km))[:, None]]))
        self.seconds, self.light = seconds, light[:, 0]

    def at(self, t: float) -> tuple[FloatArray, float, float]:
        """(12,) r, v, field, sun in N; light; density."""
        values = self.smooth(t)
        return values[:12], float(np.interp(t, self.seconds, self.light)), float(np.exp(values[12]))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a x b of two single vectors: numpy's own takes most of a flight's time."""
    x, y, z = a.tolist()
    u, v, w = b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def gravity_gradient(now: Instant) -> FloatArray:
    """3 GM / r^5 (r x J r)."""
    r = now["r"]
    torque: FloatArray = 3.0 * GM_M3_S2 / math.sqrt(r @ r) ** 5 * cross(r, now["J"] @ r)
    return torque


def magnetic(now: Instant) -> FloatArray:
    """What the torquers do."""
    return cross(now["dipole"], now["field"])


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight, dense in time."""

    seconds: FloatArray
    q: FloatArray
    """(R, 4) scalar last, v_N = R v_B."""
    rate: FloatArray

    def attitude(self, seconds: FloatArray) -> tuple[Rotation, FloatArray]:
        """R_BN and rate in B, by splines through rows a second or less apart."""
        q = CubicSpline(self.seconds, self.q)(seconds)
        rate = CubicSpline(self.seconds, self.rate)(seconds)
        return Rotation.from_quat(q / np.linalg.norm(q, axis=1)[:, None]).inv(), rate


def fly(
    body: Body, around: Surroundings, torques: list[Torque], q: FloatArray, rate: FloatArray, begin: float, end: float
) -> Flown:
    """From `begin` to `end` [s since the start of the surroundings]."""
    inside = body.switches[(body.switches > begin) & (body.switches < end)]
    edges = np.concatenate([[begin], inside, [end]])
    step = min(1.0, 0.05 / max(float(np.linalg.norm(rate)), 1e-3))
    state, rows, times = np.concatenate([q, rate]), [], []
    inverse = np.linalg.inv(body.inertia)
    for a, b in pairwise(edges):
        dipole = body.dipole(np.array([0.5 * (a + b)]))[0]
        moments = np.append(np.arange(a, b, step), b)
        found = solve_ivp(
            lambda t, y, m=dipole: _slope(t, y, body, inverse, around, torques, m),
            (a, b),
            state,
            method="DOP853",
            rtol=1e-9,
            atol=1e-11,
            t_eval=moments,
        )
        state = found.y[:, -1]
        rows.append(found.y[:, :-1].T)
        times.append(found.t[:-1])
    whole = np.vstack([*rows, state[None]])
    return Flown(np.append(np.concatenate(times), end), whole[:, :4], whole[:, 4:])


def _slope(
    t: float,
    y: FloatArray,
    body: Body,
    inverse: FloatArray,
    around: Surroundings,
    torques: list[Torque],
    dipole: FloatArray,
) -> FloatArray:
    q, w = y[:4] / math.sqrt(y[:4] @ y[:4]), y[4:]
    values, light, density = around.at(t)
    R = _from_N(q)
    r, v, field, towards = values.reshape(4, 3) @ R.T
    wind = v - R @ cross(EARTH_RATE, values[:3])
    now = {
        "r": r,
        "v": wind,
        "field": field,
        "sun": towards,
        "rate": w,
        "J": body.inertia,
        "dipole": dipole,
        "light": np.array(light),
        "density": np.array(density),
    }
    own = body.wheel_inertia * body.axes.T
    momentum = body.inertia @ w + own @ body.speed_rad_s(t)
    torque = sum((one(now) for one in torques), np.zeros(3)) - cross(w, momentum) - own @ body.acceleration(t)
    x, yy, z, s = q.tolist()
    turn = 0.5 * np.array(
        [
            s * w[0] - z * w[1] + yy * w[2],
            z * w[0] + s * w[1] - x * w[2],
            -yy * w[0] + x * w[1] + s * w[2],
            -x * w[0] - yy * w[1] - z * w[2],
        ]
    )
    return np.concatenate([turn, inverse @ torque])


def _from_N(q: FloatArray) -> FloatArray:
    """(3, 3) matrix that takes N into B, of a unit quaternion that takes B into N."""
    x, y, z, s = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * s), 2 * (x * z - y * s)],
            [2 * (x * y - z * s), 1 - 2 * (x * x + z * z), 2 * (y * z + x * s)],
            [2 * (x * z + y * s), 2 * (y * z - x * s), 1 - 2 * (x * x + y * y)],
        ]
    )
