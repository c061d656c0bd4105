"""Infrared horizon scanner: roll and pitch from the Earth's disc, or from where conical scans cross the horizon.

Two crossings of one scan and the angle from nadir at which each should lie give nadir; with two scanners there are four,
and the mean height of the horizon cancels in roll (Wertz 1978, sections 6.2 and 7.2). The angles are those of the Earth as
it is assumed to be, seen from where the spacecraft is, in the attitude it should have.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.base.section_types import NonNegative
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import horizon
from fluxtwin.sim.earth.frames import nadir_of, roll_pitch
from fluxtwin.sim.earth.horizon import Surface, nadir_angle, tangent_cone
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings

_STEPS = 4
"""Of Newton's method; the first guess is off by the flattening, 0.003."""
DOWN = np.array([0.0, 0.0, 1.0])


class HorizonScannerSection(SensorSection):
    """Measures roll and pitch against the Earth's horizon; noise is correlated over `tau_s`."""

    earth: Literal["disc", "ellipsoid", "infrared"] = "disc"
    """What is seen: a disc whose middle is found as it is, or the horizon of that surface, crossed by conical scans."""
    assumed: Literal["sphere", "ellipsoid"] = "sphere"
    """What the processing takes the Earth for."""
    scans: Literal["pair", "+y", "-y"] = "pair"
    """Body axes that the half-cones are centred on."""
    half_cone_deg: Annotated[float, Field(gt=0, lt=90)] = 45.0
    noise_deg: NonNegative = 0.0
    lsb_deg: NonNegative = 0.0
    tau_s: NonNegative = 0.0
    roll_bias_deg: float = 0.0
    pitch_bias_deg: float = 0.0

    def measure(self, around: Surroundings, rng: np.random.Generator) -> dict[str, FloatArray]:
        """nadir_B (N, 3) unit vectors in body axes; to roll and pitch are added bias, noise and rounding, in that order."""
        correlated = self.tau_s > 0
        wander_rad = float(np.radians(self.noise_deg)) if correlated else 0.0
        white_rad = 0.0 if correlated else float(np.radians(self.noise_deg))
        angles = roll_pitch(self._seen_nadir_B(around))
        bias_rad = (float(np.radians(self.roll_bias_deg)), float(np.radians(self.pitch_bias_deg)))
        wander = gauss_markov(around.time, wander_rad, self.tau_s, rng, columns=2)
        angles = angles + bias_rad + wander + white_rad * rng.standard_normal(angles.shape)
        lsb_rad = float(np.radians(self.lsb_deg))
        if lsb_rad > 0:
            angles = lsb_rad * np.rint(angles / lsb_rad)
        return {"nadir_B": nadir_of(angles)}

    @property
    def conical(self) -> ConicalScanner:
        axes = {"pair": (1, -1), "+y": (1,), "-y": (-1,)}[self.scans]
        return ConicalScanner(axes, float(np.radians(self.half_cone_deg)))

    def _seen_nadir_B(self, around: Surroundings) -> FloatArray:
        """(N, 3) nadir as the horizon shows it, before the errors of the scanner itself."""
        if self.earth == "disc":
            return around.R_BN.apply(around.nadir_N)
        seen, assumed = (horizon.surface(name, around.time) for name in (self.earth, self.assumed))
        north_N = horizon.north_N(around.time)
        return self.conical.nadir(around.r_N_km, north_N, around.R_BN, around.R_ON, seen, assumed)


@dataclass(frozen=True)
class ConicalScanner:
    """One or two scanners whose half-cone is centred on body +y or -y."""

    axes: tuple[int, ...] = (1, -1)
    """Sign of body y of each scan axis."""
    half_cone_rad: float = float(np.pi / 4.0)

    def nadir(
        self, r_km: FloatArray, pole: FloatArray, R_BN: Rotation, R_ON: Rotation, seen: Surface, assumed: Surface
    ) -> FloatArray:
        """(N, 3) unit vectors to nadir, body axes, as found from the crossings; NaN where a scan misses the Earth.

        r_km, pole: (N, 3) position and north, N axes; R_BN, R_ON: (N,) attitude and orbital frame; seen, assumed: the
        surface that is there and the one that the processing takes for it.
        """
        down_B = R_BN.apply(-r_km / np.linalg.norm(r_km, axis=1)[:, None])
        cone_B = tangent_cone(seen, R_BN.apply(r_km), R_BN.apply(pole))
        # The processing knows the orbit, not the attitude: it looks up the horizon as if the body were on its axes.
        cone_O = tangent_cone(assumed, R_ON.apply(r_km), R_ON.apply(pole))
        crossings, cosines = [], []
        for sign in self.axes:
            for side in (1, -1):
                crossing = self._crossing(sign, side, down_B, cone_B)
                across = crossing * [1.0, 1.0, 0.0]
                across /= np.linalg.norm(across, axis=1)[:, None]
                angle = nadir_angle(cone_O, np.broadcast_to(DOWN, across.shape), across)
                crossings.append(crossing)
                cosines.append(np.cos(angle))
        return _nadir_of(np.stack(crossings, axis=1), np.stack(cosines, axis=1))

    def _crossing(self, sign: int, side: int, down_B: FloatArray, cone_B: FloatArray) -> FloatArray:
        """(N, 3) line of sight at which the scan passes from space to Earth, or back on the other side."""
        axis = np.array([0.0, sign, 0.0])
        along = down_B @ axis
        u = down_B - along[:, None] * axis
        flat = np.linalg.norm(u, axis=1)
        u = u / flat[:, None]
        v = np.cross(axis, u)
        c, s = np.cos(self.half_cone_rad), np.sin(self.half_cone_rad)
        # (N,) squared sine of the horizon's angle from nadir, averaged over azimuth: where Newton's method begins.
        inward = np.einsum("ni,nij,nj->n", down_B, cone_B, down_B)
        outward = 0.5 * (np.trace(cone_B, axis1=1, axis2=2) - inward)
        middle = np.sqrt(np.maximum(1.0 - np.asarray(inward / (inward - outward)), 0.0))
        with np.errstate(invalid="ignore"):
            phase = side * np.arccos((middle - c * along) / (s * flat))
        for _ in range(_STEPS):
            d = c * axis + s * (np.cos(phase)[:, None] * u + np.sin(phase)[:, None] * v)
            slope = s * (np.cos(phase)[:, None] * v - np.sin(phase)[:, None] * u)
            Md = np.einsum("nij,nj->ni", cone_B, d)
            phase = phase - np.einsum("ni,ni->n", d, Md) / (2.0 * np.einsum("ni,ni->n", slope, Md))
        return np.asarray(c * axis + s * (np.cos(phase)[:, None] * u + np.sin(phase)[:, None] * v))


def _nadir_of(crossings: FloatArray, cosines: FloatArray) -> FloatArray:
    """(N, 3) from K crossings (N, K, 3) and the cosine of nadir's angle to each (N, K): exact of two, else least squares."""
    if crossings.shape[1] == 2:
        first, second = crossings[:, 0], crossings[:, 1]
        plus, minus, normal = first + second, first - second, np.cross(first, second)
        in_plane = (cosines.sum(axis=1) / np.sum(plus**2, axis=1))[:, None] * plus
        in_plane += ((cosines[:, 0] - cosines[:, 1]) / np.sum(minus**2, axis=1))[:, None] * minus
        with np.errstate(invalid="ignore"):
            out = np.sqrt((1.0 - np.sum(in_plane**2, axis=1)) / np.sum(normal**2, axis=1))[:, None] * normal
        # Two answers, mirrored about the plane of the crossings: nadir is the one nearer to body z.
        return np.asarray(in_plane + np.sign(out[:, 2:]) * out)
    known = np.isfinite(crossings).all(axis=(1, 2))
    found = np.full((len(crossings), 3), np.nan)
    A, b = crossings[known], cosines[known]
    found[known] = np.linalg.solve(np.einsum("nki,nkj->nij", A, A), np.einsum("nki,nk->ni", A, b)[:, :, None])[:, :, 0]
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])
