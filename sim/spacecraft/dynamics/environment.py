"""What surrounds the vehicle along its orbit, computed in one batch before the flight.

Position, velocity, field, sun and air stand at nodes some seconds apart; between them the kernel draws a cubic
through four nodes. In low orbit its error is under 4e-10 of the position and 0.003 nT of a degree-13 field for nodes
10 s apart, and grows with the fourth power of the distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import erfa
import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.atmosphere import density_along
from fluxtwin.sim.earth.constants import AU_KM
from fluxtwin.sim.earth.field import FieldModel, field_E_nT
from fluxtwin.sim.earth.orbit import Ephemeris

_BLOCK = 8192
_STRETCH_S = 21600.0
"""A block of nodes is no longer than this many nodes, and this time (or 64 nodes)."""
_ROTATION_RAD_S = 2.0 * np.pi * 1.00273781191135448 / 86400.0
"""Of the Earth, per second of UT1 (IAU 2000, Capitaine et al. 2000; as in ERFA era00)."""


@dataclass(frozen=True)
class Environment:
    """Surroundings at equally spaced nodes; the first stands one spacing before `start`."""

    start: np.datetime64
    spacing_s: float
    nodes: FloatArray
    """(K, up to 14): position [m], velocity [m/s], field [T], sun (unit), all in N; sunlight; density [kg/m3]. What is
    not there is zero."""

    def at(self, seconds: FloatArray) -> FloatArray:
        """(N, 14) the surroundings at times since the start, by a spline through the nodes; zero what is not there."""
        from scipy.interpolate import CubicSpline  # here: it takes a fifth of a second to load

        stamps = self.spacing_s * np.arange(-1.0, len(self.nodes) - 1.0)
        rows = np.zeros((np.size(seconds), 14))
        rows[:, : self.nodes.shape[1]] = CubicSpline(stamps, self.nodes)(np.ravel(seconds))
        return rows


def environment_along(
    ephemeris: Ephemeris,
    start: np.datetime64,
    duration_s: float,
    *,
    spacing_s: float = 10.0,
    field: FieldModel | None = None,
    with_sun: bool = False,
    with_air: bool = False,
) -> Environment:
    """The surroundings along an orbit. What is not asked for is zero.

    Raises BadInput for a length or spacing that is not positive and OutOfRange for epochs outside the field model.
    """
    if not (duration_s > 0 and spacing_s > 0):
        raise BadInput(f"duration {duration_s:g} s, spacing {spacing_s:g} s", where="environment", wanted="both > 0")
    count = int(np.ceil(duration_s / spacing_s - 1e-9)) + 3
    time = epoch.add_seconds(start, spacing_s * np.arange(-1.0, count - 1.0))
    nodes = np.zeros((count, 14 if with_sun or with_air else 9 if field is not None else 6))
    edges = [*range(0, count, max(64, min(_BLOCK, int(_STRETCH_S / spacing_s)))), count]
    earth = _EarthTurn(time, edges) if field is not None else None
    for block, rows in enumerate(slice(a, b) for a, b in pairwise(edges)):  # small ones stay in the cache
        r_N_km, v_N_km_s = ephemeris(time[rows])
        np.multiply(r_N_km, 1e3, out=nodes[rows, 0:3])
        np.multiply(v_N_km_s, 1e3, out=nodes[rows, 3:6])
        if field is not None and earth is not None:
            np.multiply(earth.field_N_nT(field, block, r_N_km), 1e-9, out=nodes[rows, 6:9])
        if with_sun:
            nodes[rows, 9:12], nodes[rows, 12] = _sunlight(time[rows], r_N_km)
        if with_air:
            nodes[rows, 13] = density_along(time[rows], r_N_km)
    _mend_leap_second(nodes, time, spacing_s)
    return Environment(start, spacing_s, nodes)


def _mend_leap_second(nodes: FloatArray, time: TimeArray, spacing_s: float) -> None:
    """Nodes that fall inside a leap second have no stamp of their own: draw them through their neighbours."""
    if spacing_s * (len(nodes) - 1) == float((time[-1] - time[0]).astype("int64")) * 1e-9:
        return
    seconds = spacing_s * np.arange(len(nodes), dtype=np.float64)
    good = np.abs(epoch.seconds_since(time, time[0]) - seconds) < 1e-6
    if not good.all():
        from scipy.interpolate import CubicSpline

        nodes[~good] = CubicSpline(seconds[good], nodes[good])(seconds[~good])


class _EarthTurn:
    """The field along an orbit as `field.field_N_nT` has it, within 0.1 nT and several times as fast.

    A block of stamps has the field of its middle (secular variation in three hours: up to 0.1 nT). The Earth's rotation
    is split: its angle is worked out at each stamp, the slow part (precession and nutation, 2e-8 rad an hour) at the
    ends of a block and linearly between.
    """

    def __init__(self, time: TimeArray, edges: Sequence[int]) -> None:
        self.time, self.edges = time, edges
        start = float(erfa.era00(*epoch.jd_ut1(time[:1]))[0])
        self.angle = start + _ROTATION_RAD_S * 1e-9 * (time - time[0]).astype("int64")
        self.knots = np.minimum(edges, time.size - 1)
        turns = frames.rotation_EN(time[self.knots]).as_matrix()
        self.slow = [_about_z(-self.angle[k]) @ turn for k, turn in zip(self.knots, turns, strict=True)]

    def field_N_nT(self, model: FieldModel, block: int, r_N_km: FloatArray) -> FloatArray:
        """(n, 3) at the positions (n, 3) of a block."""
        from fluxtwin.sim.spacecraft.dynamics.earth_kernels import from_earth, to_earth

        first, last = self.edges[block], self.edges[block + 1]
        slow, length = self.slow[block], max(1, int(self.knots[block + 1] - self.knots[block]))
        change = (self.slow[block + 1] - slow) / length
        r_E_km, turn = np.empty((last - first, 3)), np.empty((last - first, 2))
        to_earth(np.ascontiguousarray(r_N_km), slow, change, self.angle[first:last], turn, r_E_km)
        b_nT = field_E_nT(model, self.time[(first + last) // 2], r_E_km)
        from_earth(b_nT, slow, change, turn, b_nT)
        return b_nT


def _about_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _sunlight(time: TimeArray, r_N_km: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Direction of the sun in N, and its light in units of that at 1 au, shadow included."""
    sun_N_km = sun.sun_N_km(time)
    towards = sun_N_km - r_N_km
    distance = np.linalg.norm(towards, axis=1)
    return towards / distance[:, None], sun.illumination(r_N_km, sun_N_km) * (AU_KM / distance) ** 2
