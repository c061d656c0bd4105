"""Two-axis digital sun-sensor heads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.section_types import ZERO3, NonNegative, Vector3
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings

_SUNLIT = 0.5  # a head needs more than half of the disc


class SunSensorSection(SensorSection):
    """One two-axis head. Azimuth from +x towards +y, elevation from the xy plane towards -z (up).

    The field of view is a square. Head axes: z is the boresight, x lies in the xy plane of the body towards larger
    azimuths, y completes. The head measures the angles atan2(x, z) and atan2(y, z) of the sun in its *actual* mounting;
    the ground reads them in the nominal one.
    """

    azimuth_deg: float
    elevation_deg: float = 0.0
    half_fov_deg: Annotated[float, Field(gt=0, lt=90)] = 64.0
    """Largest size of either angle: a 128 x 128 degree head has 64 degrees."""
    lsb_deg: NonNegative = 0.0
    noise_deg: NonNegative = 0.0
    """White noise of each angle, 1 sigma."""
    misalignment_deg: Vector3 = ZERO3
    """The head is turned from its nominal mounting by this rotation vector (right-handed, body axes)."""

    @property
    def boresight_B(self) -> FloatArray:
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        flat = np.cos(elevation)
        z = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), -np.sin(elevation)])
        return np.asarray(z / np.linalg.norm(z))

    @property
    def R_HB(self) -> Rotation:
        azimuth, z = np.radians(self.azimuth_deg), self.boresight_B
        y = np.cross(z, [-np.sin(azimuth), np.cos(azimuth), 0.0])
        y = y / np.linalg.norm(y)
        return Rotation.from_matrix(np.stack([np.cross(y, z), y, z]))

    def angles(self, sun_B: FloatArray) -> FloatArray:
        """(N, 2) angles of the sun in the actual mounting, rad, without error."""
        turned = Rotation.from_rotvec(-np.radians(self.misalignment_deg))
        sun_H = np.atleast_2d((self.R_HB * turned).apply(sun_B))
        return np.arctan2(sun_H[:, :2], sun_H[:, 2:])

    def sees(self, sun_B: FloatArray, illumination: FloatArray | float = 1.0) -> BoolArray:
        """(N,) True where the sun is inside the field of view and more than half of its disc is lit.

        sun_B (N, 3) true unit vectors in body axes.
        """
        inside = (np.abs(self.angles(sun_B)) <= np.radians(self.half_fov_deg)).all(axis=1)
        return np.asarray(inside & (np.broadcast_to(illumination, inside.shape) > _SUNLIT))

    def read(self, sun_B: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Measured unit vectors (N, 3) in nominal body axes: noise on the two angles, rounding to the LSB.

        Meaningful only where the head sees the sun; a row elsewhere is a number all the same, so that the
        random draws do not depend on what is seen.
        """
        angles = self.angles(sun_B)
        angles = angles + np.radians(self.noise_deg) * rng.standard_normal(angles.shape)
        if self.lsb_deg > 0:
            lsb_rad = np.radians(self.lsb_deg)
            angles = lsb_rad * np.rint(angles / lsb_rad)
        x, y = np.tan(angles).T
        sun_H = np.stack([x, y, np.ones_like(x)], axis=1)
        return np.asarray(np.atleast_2d(self.R_HB.inv().apply(sun_H / np.linalg.norm(sun_H, axis=1)[:, None])))


def measure_heads(
    heads: Mapping[str, SunSensorSection], around: Surroundings, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """sun_B (N, 3) unit vectors in body axes, and the number of the head in use (N,); heads: by their numbers."""
    numbered = [(int(number), heads[number]) for number in sorted(heads, key=int)]
    number, sun_B = measure_sun(numbered, around.R_BN.apply(around.sun_N), around.illumination, rng)
    return {"sun_sensor_head": number, "sun_B": sun_B}


def measure_sun(
    heads: Sequence[tuple[int, SunSensorSection]],
    sun_B: FloatArray,
    illumination: FloatArray | float,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """The head in use and what it measures: head number (N,), 0 for none, and sun_B (N, 3), NaN where none.

    heads: with their numbers, from 1. In use is, of the heads that see the sun, the one with the sun nearest its
    boresight (the first listed of equals). sun_B (N, 3) are true unit vectors; illumination (N,) is the share of the
    sun's disc in view. Each head's noise has a stream of its own, made from one draw of `rng` and the head's number:
    taking a head away moves no other.
    """
    numbers = [number for number, _ in heads]
    if len(set(numbers)) < len(numbers):
        raise BadInput(f"numbers {numbers}", where="sun-sensor heads", wanted="a number of its own for each head")
    sun = np.atleast_2d(np.asarray(sun_B, dtype=np.float64))
    best = np.full(sun.shape[0], -np.inf)
    in_use = np.zeros(sun.shape[0])
    measured = np.full(sun.shape, np.nan)
    word = int(rng.integers(2**63))
    for number, head in heads:
        reading = head.read(sun, np.random.default_rng([word, number]))
        nearness = np.where(head.sees(sun, illumination), sun @ head.boresight_B, -np.inf)
        chosen = nearness > best
        best = np.where(chosen, nearness, best)
        in_use[chosen] = number
        measured[chosen] = reading[chosen]
    return in_use, measured
