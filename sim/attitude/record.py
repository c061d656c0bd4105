"""Attitude: the record every mode returns, 3-1-2 kinematics, and the prescribed modes.

Prescribed modes (Earth-pointing with libration, inertial hold, slews, free tumble, spin with nutation) and
any later dynamics give the same record: `Attitude`, the rotation N to B at each stamp and the body rate. A
mode is a function of time alone, so two samplings of one run see the same motion.

Frames and angles are those of `frames`: yaw, roll and pitch are the 3-1-2 set from O to B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.libration import Libration
from fluxtwin.sim.attitude.rigid_body import torque_free
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.orbit import Ephemeris


@dataclass(frozen=True)
class Attitude:
    """The motion of the body at N stamps; what every mode returns."""

    R_BN: Rotation
    """Batch of N: v_B = R_BN.apply(v_N)."""
    rate_B_rad_s: FloatArray
    """(N, 3) angular rate of B relative to N, components in B."""

    def __len__(self) -> int:
        return int(self.rate_B_rad_s.shape[0])

    @property
    def q_NB(self) -> FloatArray:
        """(N, 4) textbook quaternion of B relative to N, scalar last."""
        return frames.q_from_rotation(self.R_BN)


def rate_BO_B(angles_rad: FloatArray, angle_rates_rad_s: FloatArray) -> FloatArray:
    """Rate of B relative to O, components in B, from the 3-1-2 angles and their derivatives.

    Both arguments are (N, 3) in the order yaw, roll, pitch; the result is (N, 3) in rad/s. Each angle's rate
    acts about its own axis, carried to B by the turns that follow (Wertz 1978, section 16.1 and table E-2).
    """
    roll, pitch = angles_rad[:, 1], angles_rad[:, 2]
    yaw_rate, roll_rate, pitch_rate = angle_rates_rad_s.T
    x = roll_rate * np.cos(pitch) - yaw_rate * np.cos(roll) * np.sin(pitch)
    y = pitch_rate + yaw_rate * np.sin(roll)
    z = roll_rate * np.sin(pitch) + yaw_rate * np.cos(roll) * np.cos(pitch)
    return np.stack([x, y, z], axis=1)


def kepler_rate_O_rad_s(r_N_km: FloatArray, v_N_km_s: FloatArray) -> FloatArray:
    """Rate of the orbital frame relative to N, components in O, (N, 3), for a fixed orbital plane.

    It is |r x v| / r^2 about the orbit normal, which is -y of O. What is left out is the turn of the plane
    about the radius: under J2 at most 1.5 J2 (Re/r)^2 = 0.16 % of the orbital rate, 2e-6 rad/s in low orbit.
    `ephemeris_rate_O_rad_s` has no such error.
    """
    r = np.atleast_2d(np.asarray(r_N_km, dtype=np.float64))
    momentum = np.linalg.norm(np.cross(r, v_N_km_s), axis=1)
    rate = np.zeros_like(r)
    rate[:, 1] = -momentum / np.sum(r**2, axis=1)
    return rate


def ephemeris_rate_O_rad_s(ephemeris: Ephemeris, time: TimeArray) -> FloatArray:
    """Rate of the orbital frame relative to N, components in O, (N, 3), of the motion as it is propagated.

    Half the turn between one second before and after each stamp. Error under 1e-9 rad/s for orbits to
    eccentricity 0.5 (truncation step^2/6 times the second derivative of the rate, plus rounding).
    """
    stamps = clock.as_times(time)
    step = np.timedelta64(1, "s")
    before, after = stamps - step, stamps + step
    turn = frames.product(frames.rotation_ON(*ephemeris(after)), frames.rotation_ON(*ephemeris(before)).inv())
    # Counted in SI seconds, so that a leap second between the two does not look like a faster orbit.
    elapsed = clock.seconds_since(after, stamps[0]) - clock.seconds_since(before, stamps[0])
    return np.asarray(-np.atleast_2d(turn.as_rotvec()) / elapsed[:, None])


def librating(
    time: TimeArray,
    r_N_km: FloatArray,
    v_N_km_s: FloatArray,
    libration: Libration,
    *,
    orbital_rate_O_rad_s: FloatArray | None = None,
) -> Attitude:
    """Earth-pointing attitude with the given libration.

    time (N,), r_N_km and v_N_km_s (N, 3). orbital_rate_O_rad_s (N, 3) is the rate of the orbital frame, from
    `ephemeris_rate_O_rad_s`; without it `kepler_rate_O_rad_s` is used, with the error stated there.
    """
    angles = libration.angles(time)
    R_BO = frames.rotation_BO(*angles.T)
    R_ON = frames.rotation_ON(r_N_km, v_N_km_s)
    if orbital_rate_O_rad_s is None:
        orbital_rate_O_rad_s = kepler_rate_O_rad_s(r_N_km, v_N_km_s)
    rate = rate_BO_B(angles, libration.rates(time)) + R_BO.apply(orbital_rate_O_rad_s)
    return Attitude(frames.product(R_BO, R_ON), rate)


def inertial_hold(time: TimeArray, R_BN0: Rotation) -> Attitude:
    """The attitude R_BN0 (one rotation) at every stamp, at zero rate."""
    rows = clock.as_times(time).size
    return Attitude(Rotation.from_quat(np.tile(R_BN0.as_quat(), (rows, 1))), np.zeros((rows, 3)))


@dataclass(frozen=True)
class Waypoint:
    """An attitude that is reached at rest at `time` and held for `hold_s` seconds."""

    time: np.datetime64
    attitude: Rotation
    """R_BN for `slews`, R_BO for `orbital_slews`; one rotation."""
    hold_s: float = 0.0


def slews(time: TimeArray, waypoints: Sequence[Waypoint]) -> Attitude:
    """Rest-to-rest slews between inertial attitudes, each about one fixed axis by the shortest way.

    The angle follows 10 s^3 - 15 s^4 + 6 s^5 in the share s of the slew's duration: rate and acceleration are
    zero at both ends. Before the first waypoint and after the last the attitude is held. Raises BadInput when
    a waypoint is due before the hold of the one before has ended.
    """
    origin = clock.as_times(waypoints[0].time)[0]
    now = clock.seconds_since(time, origin)
    arrive = np.array([clock.seconds_since(w.time, origin)[0] for w in waypoints])
    depart = arrive + np.array([w.hold_s for w in waypoints])
    late = np.flatnonzero(arrive[1:] <= depart[:-1])
    if late.size:
        raise BadInput(
            f"waypoint {late[0] + 2} is due {arrive[late[0] + 1]:g} s after the first, but the hold of the"
            f" one before it ends at {depart[late[0]]:g} s",
            where="slews",
            wanted="waypoints in order of time, each with time to slew to it",
        )
    reached = Rotation.concatenate([w.attitude for w in waypoints])
    # The axis has the same components before and after the turn, hence in B throughout.
    turn_rad = np.zeros((len(waypoints), 3))
    duration = np.ones(len(waypoints))
    if len(waypoints) > 1:
        turn_rad[:-1] = -np.atleast_2d((reached[1:] * reached[:-1].inv()).as_rotvec())
        duration[:-1] = arrive[1:] - depart[:-1]

    leg = np.clip(np.searchsorted(arrive, now, side="right") - 1, 0, None)
    share = np.clip((now - depart[leg]) / duration[leg], 0.0, 1.0)
    profile = share**3 * (10.0 + share * (-15.0 + 6.0 * share))
    slope = 30.0 * (share * (1.0 - share)) ** 2 / duration[leg]
    turned = Rotation.from_rotvec(-profile[:, None] * turn_rad[leg]) * reached[leg]
    return Attitude(turned, slope[:, None] * turn_rad[leg])


def orbital_slews(
    time: TimeArray,
    r_N_km: FloatArray,
    v_N_km_s: FloatArray,
    waypoints: Sequence[Waypoint],
    *,
    orbital_rate_O_rad_s: FloatArray | None = None,
) -> Attitude:
    """As `slews`, between attitudes relative to the orbital frame (R_BO); rates are relative to N.

    orbital_rate_O_rad_s as in `librating`.
    """
    relative = slews(time, waypoints)
    if orbital_rate_O_rad_s is None:
        orbital_rate_O_rad_s = kepler_rate_O_rad_s(r_N_km, v_N_km_s)
    R_BO = relative.R_BN
    rate = relative.rate_B_rad_s + R_BO.apply(orbital_rate_O_rad_s)
    return Attitude(frames.product(R_BO, frames.rotation_ON(r_N_km, v_N_km_s)), rate)


def tumble(
    time: TimeArray,
    inertia_kg_m2: FloatArray,
    q_NB0: FloatArray,
    rate0_B_rad_s: FloatArray,
    *,
    epoch: np.datetime64 | None = None,
) -> Attitude:
    """Free rigid-body motion from attitude q_NB0 and rate rate0_B_rad_s at `epoch` (default: first stamp).

    inertia_kg_m2: three principal moments along the body axes, or a (3, 3) tensor in B; any body, tri-axial
    too. See `rigid_body.torque_free` for method, accuracy and errors.
    """
    stamps = clock.as_times(time)
    seconds = clock.seconds_since(stamps, stamps[0] if epoch is None else epoch)
    R_BN0 = frames.rotation_from_q(q_NB0)
    return Attitude(*torque_free(seconds, inertia_kg_m2, R_BN0, rate0_B_rad_s))


def spin(
    time: TimeArray,
    inertia_kg_m2: FloatArray,
    momentum_axis_N: FloatArray,
    spin_rate_rad_s: float,
    *,
    nutation_rad: float = 0.0,
    phase_rad: float = 0.0,
    epoch: np.datetime64 | None = None,
) -> Attitude:
    """Spin about body z with nutation, free of torque.

    inertia_kg_m2: the moments about x, y, z. momentum_axis_N (3,): the direction of the
    angular momentum. spin_rate_rad_s: the rate about body z at `epoch` (default: first stamp); nutation_rad:
    the angle from body z to the momentum then, towards body x, constant for a body with equal x and y moments.
    phase_rad: a right-handed turn of the whole body about the momentum. Raises BadInput for a zero rate, a zero axis
    or a nutation angle outside [0, 90) degrees.
    """
    inertia = np.asarray(inertia_kg_m2, dtype=np.float64)
    axis = np.asarray(momentum_axis_N, dtype=np.float64)
    if not 0.0 <= nutation_rad < 0.5 * np.pi:
        raise BadInput(f"{nutation_rad:g} rad", where="spin nutation", wanted="an angle from 0 to under 90 deg")
    if spin_rate_rad_s == 0.0 or not np.linalg.norm(axis) > 0.0:
        raise BadInput("the rate or the axis is zero", where="spin", wanted="both different from zero")
    sense = np.sign(spin_rate_rad_s)
    direction_B = np.array([np.sin(nutation_rad), 0.0, sense * np.cos(nutation_rad)])
    momentum = inertia[2] * abs(spin_rate_rad_s) / np.cos(nutation_rad)
    rate0 = momentum * direction_B / inertia
    # Smallest turn that carries the momentum from its direction in N to its direction in B, then the phase.
    R_BN0 = _shortest_turn(axis / np.linalg.norm(axis), direction_B)
    R_BN0 = Rotation.from_rotvec(-phase_rad * direction_B) * R_BN0
    return tumble(time, inertia, frames.q_from_rotation(R_BN0), rate0, epoch=epoch)


def _shortest_turn(start: FloatArray, end: FloatArray) -> Rotation:
    axis = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(axis)), float(start @ end)
    if sine < 1e-12:  # parallel, or opposite: then any axis across serves
        axis, sine = np.cross(start, np.eye(3)[int(np.argmin(np.abs(start)))]), 0.0
    return Rotation.from_rotvec(np.arctan2(sine, cosine) * axis / np.linalg.norm(axis))
