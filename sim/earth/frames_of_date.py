"""Rotations from GCRS to the other inertial and Earth-fixed axes that foreign files use, by name."""

from __future__ import annotations

import erfa
import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import TimeArray
from fluxtwin.sim.earth import epoch, frames

NAMES = ("GCRS", "J2000", "mean_of_date", "true_of_date", "ITRS")


def rotation_from_N(name: str, time: TimeArray) -> Rotation:
    """GCRS to the axes `name` at each stamp. Batch of N.

    J2000: mean equator and equinox of J2000.0, 0.023 arcsec from GCRS (ERFA bp06, frame bias). mean_of_date and
    true_of_date: mean or true equator and equinox at the stamp (ERFA pmat06, pnm06a). ITRS: as
    `frames.rotation_EN`.
    """
    count = len(time)
    if name == "GCRS":
        return Rotation.identity(count)
    if name == "J2000":
        bias = erfa.bp06(2451545.0, 0.0)[0]
        return Rotation.from_matrix(np.tile(bias, (count, 1, 1)))  # older scipy refuses what is read-only
    if name == "mean_of_date":
        return Rotation.from_matrix(erfa.pmat06(*epoch.jd_tt(time)))
    if name == "true_of_date":
        return frames.rotation_TN(time)
    if name == "ITRS":
        return frames.rotation_EN(time)
    raise KeyError(name)
