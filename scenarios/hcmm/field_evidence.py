"""Why four night passes had large residuals: the error of IGRF 1975 along each real pass, beside the printed residual.

Nothing is simulated here. The orbit comes from acquisition times and sun-nadir angles; the field of 1978 is known
today; so the error that IGRF 1975 made in field strength along each of the 43 passes can be computed and set beside
the residual that was printed. The witness against chance: the same map of errors turned about the Earth's axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from fluxtwin.scenarios.hcmm.mission import quantity
from fluxtwin.scenarios.hcmm.overflights import orders_of, overflights_of
from fluxtwin.scenarios.hcmm_orbit.angles import angles_along
from fluxtwin.scenarios.hcmm_orbit.fit import OrbitFit
from fluxtwin.scenarios.hcmm_orbit.record import read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import Windows
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import field_E_nT, load_field

LSB_MG = quantity("LSB") / float(np.sqrt(12.0))
"""What the step of the readings leaves in field strength, rms."""
TOP = 10
_SHUFFLES = 20_000
_TURNS_DEG = np.arange(0.0, 360.0, 15.0)


@dataclass(frozen=True)
class FieldEvidence:
    """43 passes."""

    labels: tuple[str, ...]
    printed_mG: FloatArray
    """(43,) residual of Table 5."""
    predicted_mG: FloatArray
    """(43,) rms error of IGRF 1975 in field strength along the pass."""
    night: FloatArray
    """(43,) 1 at night."""
    correlation: float
    """Rank correlation of the two."""
    correlation_without_four: float
    """The same without the four passes above 3 mG."""
    correlation_night: float
    """Among the night passes alone; none of these went into a calibration."""
    correlation_sunlit: float
    chance: float
    """Share of random orders of the overflights with at least that correlation (all 43).

    The map of errors is smooth, so a wrong one correlates as well: see `turned_correlation`."""
    top_shared: int
    """Of the ten largest printed residuals, how many are among the ten largest predicted errors."""
    turns_deg: FloatArray
    turned_correlation: FloatArray
    """Rank correlation with the map of errors turned east by so much."""

    def best_turned(self, count: int) -> list[tuple[float, float]]:
        """The largest rank correlations of maps that are turned, with the turn [deg] of each, largest first."""
        turned = [(c, t) for t, c in zip(self.turns_deg.tolist(), self.turned_correlation.tolist(), strict=True) if t]
        return [(t, c) for c, t in sorted(turned, reverse=True)[:count]]

    @property
    def with_lsb_mG(self) -> FloatArray:
        """(43,) predicted error and the LSB's 1.36 mG together."""
        return np.asarray(np.hypot(self.predicted_mG, LSB_MG))


def weigh_field_error(fit: OrbitFit, windows: Windows, seed: int) -> FieldEvidence:
    """Predict, compare, and turn the map."""
    passes = read_passes()
    truth, flown = load_field("igrf14"), load_field("igrf1975")
    printed = np.array([p.eps_M_mG for p in passes])

    track = angles_along(passes, windows, fit.orbit, truth)
    latitude, longitude = np.radians(track.latitude_deg.ravel()), np.radians(track.longitude_deg.ravel())
    radius = np.full_like(latitude, fit.orbit.semi_major_axis_km)

    def error_mG(turn_deg: float) -> FloatArray:
        r_E_km = frames.from_geocentric(latitude, longitude - np.radians(turn_deg), radius)
        a, b = (np.linalg.norm(field_E_nT(model, passes[20].aos, r_E_km), axis=1) for model in (truth, flown))
        return np.asarray(np.sqrt(np.mean((a - b).reshape(len(passes), -1) ** 2, axis=1)) / NT_PER_MG)

    predicted = error_mG(0.0)
    found = rank_correlation(printed, predicted)
    rng = stream(seed, "hcmm.shuffles")
    shuffled = _shuffled_correlations(printed, predicted, orders_of(overflights_of(passes), rng, _SHUFFLES))
    quiet = printed <= quantity("residual limit")
    night = np.array([not p.sunlit for p in passes])
    return FieldEvidence(
        labels=tuple(p.label for p in passes),
        printed_mG=printed,
        predicted_mG=predicted,
        night=night.astype(np.float64),
        correlation=found,
        correlation_without_four=rank_correlation(printed[quiet], predicted[quiet]),
        correlation_night=rank_correlation(printed[night], predicted[night]),
        correlation_sunlit=rank_correlation(printed[~night], predicted[~night]),
        chance=float(np.mean(shuffled >= found)),
        top_shared=len(set(np.argsort(-printed)[:TOP]) & set(np.argsort(-predicted)[:TOP])),
        turns_deg=_TURNS_DEG,
        turned_correlation=np.array([rank_correlation(printed, error_mG(turn)) for turn in _TURNS_DEG]),
    )


def _shuffled_correlations(printed: FloatArray, predicted: FloatArray, orders: np.ndarray) -> FloatArray:
    """Rank correlations with the predicted errors, the printed residuals in each of the orders (Q, P)."""
    x, y = ((ranks - ranks.mean()) / ranks.std() for ranks in (rankdata(printed), rankdata(predicted)))
    return np.asarray(x[orders] @ y / x.size)


def rank_correlation(a: FloatArray, b: FloatArray) -> float:
    """Spearman's rho, ties averaged."""
    x, y = rankdata(a), rankdata(b)
    return float(np.corrcoef(x, y)[0, 1])
