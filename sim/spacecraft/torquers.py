"""Magnetic torquers: what they do as a function of time, drawn once, and their field at the magnetometer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock
from fluxtwin.sim.earth.constants import MU0_OVER_4PI_NT_M3_PER_AM2


@dataclass(frozen=True, eq=False)
class RandomDuty:
    """Momentum unloading: each axis on or off at random, in slots of `dwell_s`, either way round.

    A slot is on with probability `duty`, independently of all others, then +amplitude or -amplitude with
    equal chance (always + when not `both_signs`). A state lasts a whole number of slots; on-stretches have a
    mean length of dwell_s / (1 - duty).
    """

    amplitude_Am2: FloatArray
    """(3,)."""
    duty: FloatArray
    """(3,)."""
    dwell_s: float
    key: list[int]
    """One 64-bit key an axis; what a slot does is a hash of its number and the key."""
    offset_s: FloatArray
    """(3,) when the slots of each axis begin, from 2000 on."""
    both_signs: bool = True

    def dipole_B_Am2(self, time: TimeArray) -> FloatArray:
        """(N, 3) dipole at each stamp, the same whatever other stamps are asked for."""
        seconds = clock.seconds_since(time, clock.MJD2000)
        dipole = np.zeros((seconds.size, 3))
        for axis in range(3):
            slot = np.floor((seconds - self.offset_s[axis]) / self.dwell_s).astype("int64").astype("uint64")
            bits = _hash(slot, self.key[axis])
            on = (bits >> np.uint64(11)) * 2.0**-53 < self.duty[axis]
            # The lowest bit is not among the 53 that decide on or off, so the sign is independent.
            sign = np.where(self.both_signs & (bits & np.uint64(1) == 1), -1.0, 1.0)
            dipole[:, axis] = np.where(on, sign * self.amplitude_Am2[axis], 0.0)
        return dipole


def draw_random_duty(
    amplitude_Am2: float | tuple[float, float, float],
    duty: float | tuple[float, float, float],
    dwell_s: float,
    rng: np.random.Generator,
    *,
    both_signs: bool = True,
) -> RandomDuty:
    """A random unloading duty, see `RandomDuty`."""
    amplitudes, duties = (np.broadcast_to(np.asarray(one, dtype=np.float64), (3,)) for one in (amplitude_Am2, duty))
    keys = rng.integers(0, 2**64, size=3, dtype=np.uint64).tolist()
    return RandomDuty(amplitudes, duties, dwell_s, keys, dwell_s * rng.random(3), both_signs)


def _hash(number: np.ndarray, key: int) -> np.ndarray:
    """64 well-mixed bits of number and key: the finaliser of SplitMix64 (Steele et al. 2014), twice."""
    bits = number
    for salt in (key, key ^ 0x9E3779B97F4A7C15):
        bits = bits ^ np.uint64(salt)  # unsigned array arithmetic wraps, as it should here
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        bits = bits ^ (bits >> np.uint64(31))
    return bits


def dipole_field_nT(m_B_Am2: FloatArray, r_B_m: FloatArray) -> FloatArray:
    """Field (N, 3) in nT of point dipoles m_B_Am2 at the point r_B_m from them; (3,) or (N, 3) each.

    mu0/(4 pi) (3 (m.u) u - m) / r^3 with u = r/|r| (Jackson, section 5.6). It is even in r: whether r points
    from the dipole to the sensor or back does not matter. Good where r is many times the torquer's length.
    Raises BadInput for a zero distance.
    """
    m, r = np.broadcast_arrays(np.atleast_2d(m_B_Am2).astype(float), np.atleast_2d(r_B_m).astype(float))
    distance = np.linalg.norm(r, axis=1)[:, None]
    if not (distance > 0).all():
        raise BadInput("a torquer sits in the magnetometer", where="torquer position", wanted="a distance > 0 m")
    u = r / distance
    along = np.sum(m * u, axis=1)[:, None]
    return np.asarray(MU0_OVER_4PI_NT_M3_PER_AM2 * (3.0 * along * u - m) / distance**3)


def coupling_nT_per_Am2(positions_B_m: FloatArray) -> FloatArray:
    """Coupling C (3, 3): field at the magnetometer [nT] = C @ dipole [A m2]. Equation 1's T is -C.

    positions_B_m (3, 3): row k is where torquer k, along body axis k, sits as seen from the magnetometer, body axes.
    Column k of C belongs to torquer k.
    """
    return dipole_field_nT(np.eye(3), positions_B_m).T
