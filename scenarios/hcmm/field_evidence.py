"""Why four night passes had large residuals: the error of IGRF 1975 along each real pass, beside the printed residual.

Nothing is simulated here. The orbit comes from acquisition times and sun-nadir angles; the field of 1978 is known
today; so the error that IGRF 1975 made in field strength along each of the 43 passes can be computed and set beside
the residual that was printed. The witness against chance: the same map of errors turned about the Earth's axis.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

from fluxtwin.scenarios.hcmm.mission import quantity
from fluxtwin.scenarios.hcmm.overflights import orders_of, overflights_of
from fluxtwin.scenarios.hcmm_orbit.angles import angles_along
from fluxtwin.scenarios.hcmm_orbit.fit import OrbitFit
from fluxtwin.scenarios.hcmm_orbit.record import read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows
from fluxtwin.scenarios.numbers import Numbers
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


def weigh_field_error(fit: OrbitFit, windows: PassWindows, seed: int) -> Numbers:
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
    turned = np.array([rank_correlation(printed, error_mG(turn)) for turn in _TURNS_DEG])
    order = np.argsort(-turned[1:], kind="stable") + 1
    return Numbers(
        labels=tuple(p.label for p in passes),
        # (43,) residual of Table 5; rms error of IGRF 1975 in field strength along the pass, without and with the LSB's.
        printed_mG=printed,
        predicted_mG=predicted,
        with_lsb_mG=np.hypot(predicted, LSB_MG),
        # (43,) 1 at night.
        night=night.astype(np.float64),
        # Rank correlation of the two; without the four passes above 3 mG; among the night passes, of which none went into
        # a calibration; among the sunlit ones.
        correlation=found,
        correlation_without_four=rank_correlation(printed[quiet], predicted[quiet]),
        correlation_night=rank_correlation(printed[night], predicted[night]),
        correlation_sunlit=rank_correlation(printed[~night], predicted[~night]),
        # Share of random orders of the overflights with at least that correlation. The map of errors is smooth, so a wrong
        # one correlates as well: the rank correlations with the map turned east by so much, and the three best of these.
        chance=np.mean(shuffled >= found),
        turns_deg=_TURNS_DEG,
        turned_correlation=turned,
        best_turned=[(float(_TURNS_DEG[k]), float(turned[k])) for k in order[:3]],
        # Of the ten largest printed residuals, how many are among the ten largest predicted errors.
        top_shared=len(set(np.argsort(-printed)[:TOP]) & set(np.argsort(-predicted)[:TOP])),
    )


def _shuffled_correlations(printed: FloatArray, predicted: FloatArray, orders: np.ndarray) -> FloatArray:
    """Rank correlations with the predicted errors, the printed residuals in each of the orders (Q, P)."""
    x, y = ((ranks - ranks.mean()) / ranks.std() for ranks in (rankdata(printed), rankdata(predicted)))
    return np.asarray(x[orders] @ y / x.size)


def rank_correlation(a: FloatArray, b: FloatArray) -> float:
    """Spearman's rho, ties averaged."""
    x, y = rankdata(a), rankdata(b)
    return float(np.corrcoef(x, y)[0, 1])
