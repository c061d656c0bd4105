"""A star tracker: three-axis attitude, weakest about its boresight, blind near the sun and the Earth."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.section_types import Direction, NonNegative, Positive
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings

_RAD_PER_ARCSEC = float(np.pi / 180.0 / 3600.0)
_Angle = Annotated[float, Field(ge=0, lt=90)]


class StarTrackerSection(SensorSection):
    """Gives the reference attitude (`source = "star_tracker"` in [attitude.reference]).

    Each attitude is turned from the true one by a small rotation, white from row to row: `noise_arcsec` about each of two
    axes across the boresight, `roll_noise_arcsec` about it: stars of a narrow field tell that turn several times less well
    (Liebe 2002, IEEE Trans. Aerosp. Electron. Syst. 38, 587).
    """

    boresight_B: Direction = (0.0, 0.0, -1.0)
    noise_arcsec: NonNegative = 0.0
    """Standard deviation about each axis across the boresight."""
    roll_noise_arcsec: NonNegative = 0.0
    """Standard deviation about the boresight."""
    sun_exclusion_deg: _Angle = 0.0
    """No attitude while the boresight is within this angle of a sun that is not eclipsed."""
    earth_exclusion_deg: _Angle = 0.0
    """No attitude while the boresight is within this angle of the Earth's limb, or on the Earth."""
    max_rate_deg_s: Positive | None = None
    """No attitude while the body turns faster across the boresight."""

    @property
    def sigma_deg(self) -> float:
        """Error of an attitude per axis, rms over the axes."""
        return float(
            np.degrees(_RAD_PER_ARCSEC * np.sqrt((2.0 * self.noise_arcsec**2 + self.roll_noise_arcsec**2) / 3.0))
        )

    def measure(self, around: Surroundings, rng: np.random.Generator) -> dict[str, FloatArray]:
        """q_NB (N, 4), NaN in the rows without an attitude."""
        boresight = np.asarray(self.unit_B)
        draws = rng.standard_normal((around.time.size, 3))
        about = (draws @ boresight)[:, None] * boresight
        turn = _RAD_PER_ARCSEC * (self.noise_arcsec * (draws - about) + self.roll_noise_arcsec * about)
        q_NB = frames.q_from_rotation(Rotation.from_rotvec(turn) * around.R_BN)
        q_NB[~self.sees(around)] = np.nan
        return {"q_NB": q_NB}

    @property
    def unit_B(self) -> tuple[float, float, float]:
        """The boresight as a unit vector."""
        x, y, z = (np.asarray(self.boresight_B) / np.linalg.norm(self.boresight_B)).tolist()
        return x, y, z

    def sees(self, around: Surroundings) -> BoolArray:
        boresight = np.asarray(self.unit_B)
        boresight_N = around.R_BN.inv().apply(boresight)
        from_sun = frames.angle_between(boresight_N, around.sun_N)
        from_nadir = frames.angle_between(boresight_N, around.nadir_N)
        earth = np.arcsin(np.minimum(EARTH_RADIUS_KM / np.linalg.norm(around.r_N_km, axis=1), 1.0))
        seen: BoolArray = (from_sun >= np.radians(self.sun_exclusion_deg)) | (around.illumination <= 0.0)
        seen &= from_nadir >= earth + np.radians(self.earth_exclusion_deg)
        if self.max_rate_deg_s is not None:
            across = np.linalg.norm(np.cross(around.rate_B_rad_s, boresight), axis=1)
            seen &= across <= np.radians(self.max_rate_deg_s)
        return seen
