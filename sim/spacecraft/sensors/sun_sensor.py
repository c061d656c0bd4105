"""Two-axis digital sun-sensor heads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.section_types import ZERO3, Direction, NonNegative, Vector3
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings

_SUNLIT = 0.5  # a head needs more than half of the disc


@dataclass(frozen=True)
class SunSensorHead:
    """One head with a square field of view.

    Head axes: z is the boresight, x the part of x_axis_B across it, y completes. The head measures the angles
    atan2(x, z) and atan2(y, z) of the sun in its *actual* mounting; the ground reads them in the nominal one.
    """

    number: int
    """From 1; 0 stands for no head."""
    boresight_B: Direction
    x_axis_B: Direction
    half_fov_rad: float
    """Largest size of either angle: a 128 x 128 degree head has 64 degrees."""
    lsb_rad: float = 0.0
    noise_rad: float = 0.0
    """White noise of each angle, 1 sigma."""
    misalignment_B_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The head is turned from its nominal mounting by this rotation vector (right-handed, body axes)."""

    @property
    def R_HB(self) -> Rotation:
        """Body to nominal head axes."""
        z = np.asarray(self.boresight_B, dtype=np.float64)
        z = z / np.linalg.norm(z)
        y = np.cross(z, self.x_axis_B)
        y = y / np.linalg.norm(y)
        return Rotation.from_matrix(np.stack([np.cross(y, z), y, z]))

    def angles(self, sun_B: FloatArray) -> FloatArray:
        """(N, 2) angles of the sun in the actual mounting, rad, without error."""
        turned = Rotation.from_rotvec(-np.asarray(self.misalignment_B_rad, dtype=np.float64))
        sun_H = np.atleast_2d((self.R_HB * turned).apply(sun_B))
        return np.arctan2(sun_H[:, :2], sun_H[:, 2:])

    def sees(self, sun_B: FloatArray, illumination: FloatArray | float = 1.0) -> BoolArray:
        """(N,) True where the sun is inside the field of view and more than half of its disc is lit.

        sun_B (N, 3) true unit vectors in body axes.
        """
        inside = (np.abs(self.angles(sun_B)) <= self.half_fov_rad).all(axis=1)
        return np.asarray(inside & (np.broadcast_to(illumination, inside.shape) > _SUNLIT))

    def measure(self, sun_B: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Measured unit vectors (N, 3) in nominal body axes: noise on the two angles, rounding to the LSB.

        Meaningful only where the head sees the sun; a row elsewhere is a number all the same, so that the
        random draws do not depend on what is seen.
        """
        angles = self.angles(sun_B)
        angles = angles + self.noise_rad * rng.standard_normal(angles.shape)
        if self.lsb_rad > 0:
            angles = self.lsb_rad * np.rint(angles / self.lsb_rad)
        x, y = np.tan(angles).T
        sun_H = np.stack([x, y, np.ones_like(x)], axis=1)
        return np.asarray(np.atleast_2d(self.R_HB.inv().apply(sun_H / np.linalg.norm(sun_H, axis=1)[:, None])))


def measure_sun(
    heads: Sequence[SunSensorHead],
    sun_B: FloatArray,
    illumination: FloatArray | float,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """The head in use and what it measures: head number (N,), 0 for none, and sun_B (N, 3), NaN where none.

    In use is, of the heads that see the sun, the one with the sun nearest its boresight (the first listed of
    equals). sun_B (N, 3) are true unit vectors; illumination (N,) is the share of the sun's disc in view.
    Each head's noise has a stream of its own, made from one draw of `rng` and the head's number: taking a head
    away moves no other.
    """
    numbers = [head.number for head in heads]
    if len(set(numbers)) < len(numbers):
        raise BadInput(f"numbers {numbers}", where="sun-sensor heads", wanted="a number of its own for each head")
    sun = np.atleast_2d(np.asarray(sun_B, dtype=np.float64))
    best = np.full(sun.shape[0], -np.inf)
    number = np.zeros(sun.shape[0])
    measured = np.full(sun.shape, np.nan)
    word = int(rng.integers(2**63))
    for head in heads:
        reading = head.measure(sun, np.random.default_rng([word, head.number]))
        boresight = np.asarray(head.boresight_B) / np.linalg.norm(head.boresight_B)
        nearness = np.where(head.sees(sun, illumination), sun @ boresight, -np.inf)
        chosen = nearness > best
        best = np.where(chosen, nearness, best)
        number[chosen] = head.number
        measured[chosen] = reading[chosen]
    return number, measured


class SunSensorSection(SensorSection):
    """One two-axis head. Azimuth from +x towards +y, elevation from the xy plane towards -z (up)."""

    azimuth_deg: float
    elevation_deg: float = 0.0
    half_fov_deg: Annotated[float, Field(gt=0, lt=90)] = 64.0
    lsb_deg: NonNegative = 0.0
    noise_deg: NonNegative = 0.0
    misalignment_deg: Vector3 = ZERO3

    @classmethod
    def measure_with(
        cls, heads: Mapping[str, Self], around: Surroundings, rng: np.random.Generator
    ) -> dict[str, FloatArray]:
        """sun_B (N, 3) unit vectors in body axes, and the number of the head in use (N,)."""
        fitted = [heads[number].head(int(number)) for number in sorted(heads, key=int)]
        number, sun_B = measure_sun(fitted, around.R_BN.apply(around.sun_N), around.illumination, rng)
        return {"sun_sensor_head": number, "sun_B": sun_B}

    def head(self, number: int) -> SunSensorHead:
        """The head of this section."""
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        flat = float(np.cos(elevation))
        x, y, z = (float(np.radians(angle)) for angle in self.misalignment_deg)
        return SunSensorHead(
            number=number,
            boresight_B=(flat * float(np.cos(azimuth)), flat * float(np.sin(azimuth)), -float(np.sin(elevation))),
            x_axis_B=(-float(np.sin(azimuth)), float(np.cos(azimuth)), 0.0),
            half_fov_rad=float(np.radians(self.half_fov_deg)),
            lsb_rad=float(np.radians(self.lsb_deg)),
            noise_rad=float(np.radians(self.noise_deg)),
            misalignment_B_rad=(x, y, z),
        )
