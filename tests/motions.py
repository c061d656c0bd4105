"""Motions and stamps that only tests ask for."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.attitude.libration import draw_libration
from fluxtwin.sim.attitude.record import Attitude, librating
from fluxtwin.sim.base.types import FloatArray, TimeArray


def earth_pointing(
    time: TimeArray,
    r_N_km: FloatArray,
    v_N_km_s: FloatArray,
    *,
    yaw_amplitude_rad: float,
    roll_amplitude_rad: float,
    pitch_amplitude_rad: float,
    shortest_period_s: float,
    longest_period_s: float,
    rng: np.random.Generator,
    offsets_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
    orbital_rate_O_rad_s: FloatArray | None = None,
) -> Attitude:
    """Earth-pointing with a libration drawn from `rng`: `draw_libration` followed by `librating`.

    An amplitude is sqrt 2 times the rms of that angle about its offset, as for a single sinusoid. The same
    stream gives the same motion whatever the stamps.
    """
    libration = draw_libration(
        (yaw_amplitude_rad, roll_amplitude_rad, pitch_amplitude_rad),
        shortest_period_s,
        longest_period_s,
        rng,
        offsets_rad=offsets_rad,
    )
    return librating(time, r_N_km, v_N_km_s, libration, orbital_rate_O_rad_s=orbital_rate_O_rad_s)


def from_decimal_year(year: float) -> np.datetime64:
    """The UTC stamp at which `decimal_year` has the value `year`."""
    whole = int(np.floor(year))
    start = np.datetime64(f"{whole:04d}-01-01", "ns")
    length = (np.datetime64(f"{whole + 1:04d}-01-01", "ns") - start).astype("int64")
    return start + np.timedelta64(round((year - whole) * int(length)), "ns")
