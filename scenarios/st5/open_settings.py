"""Two settings that the abstract leaves open, searched: the filter's process noise and its weight of the sun.

Two figures fitted by two free settings prove nothing, so each choice leaves printed numbers out, and those are compared:
one takes the three errors before calibration and predicts the error after it; the other takes both root sums of squares
and predicts how the error before is shared by the axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from fluxtwin.calib.spin.batch import Noise
from fluxtwin.calib.spin.filter import Filtered, FilterSettings, spin_filter
from fluxtwin.calib.spin.motion import SpinMotion
from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.calib.spin.sedlak import at
from fluxtwin.scenarios.st5 import mission
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import FloatArray

WALKS_RAD_S = tuple(np.geomspace(5e-5, 1e-2, 7).tolist())
"""Process noise: random walk of L/Jt in a second. 4e-4 is 1e-7 (N m s)^2/s."""
FACTORS = tuple(np.geomspace(1.0, 12.0, 6).tolist())
"""The sun's noise as the filter takes it, over what it is."""
_STEP = 0.01  # of the searched range: the filter's error is smooth on that scale
_CLOSE = 1e-3
_MOST_STEPS = 12


@dataclass(frozen=True)
class Setting:
    """The filter with one setting, before and after calibration."""

    walk_rad_s: float
    sun_factor: float
    pre_deg: FloatArray
    """(3,) rms about body x, y, z before calibration."""
    post_deg: FloatArray
    """(3,) with the batch's calibration."""

    @property
    def pre_rss_deg(self) -> float:
        """Root sum of squares before."""
        return float(np.linalg.norm(self.pre_deg))

    @property
    def post_rss_deg(self) -> float:
        """The same after."""
        return float(np.linalg.norm(self.post_deg))


@dataclass(frozen=True)
class Search:
    """What the two settings do, and two choices of them."""

    walks_rad_s: tuple[float, ...]
    factors: tuple[float, ...]
    grid: tuple[Setting, ...]
    """All pairs, the factor running fastest."""
    by_axes: Setting
    """Nearest to the three printed rms before calibration; nothing that is printed of the time after was used."""
    by_rss: Setting
    """Nearest to the two printed root sums of squares, before and after; how the axes share them was not used."""

    def rss_deg(self, when: str) -> FloatArray:
        """(W, F) root sum of squares "pre" or "post" calibration over the grid [deg]."""
        values = [setting.pre_rss_deg if when == "pre" else setting.post_rss_deg for setting in self.grid]
        return np.array(values).reshape(len(self.walks_rad_s), len(self.factors))


def settings(walk_rad_s: float = 0.0, sun_factor: float = 1.0) -> FilterSettings:
    """Of the filter: the abstract's noise, the sun's times `sun_factor`, and a random walk of L/Jt."""
    known: Noise = mission.noises()
    return FilterSettings(known.field_nT, known.sun_rad * sun_factor, walk_rad_s)


def filtered(rows: SpinRows, field_B_nT: FloatArray, motion: SpinMotion, chosen: FilterSettings) -> Filtered:
    """One pass over readings (N, 3) from the motion at the first event, with the abstract's inertia."""
    inertia: Sequence[float] = mission.published()["inertia_kg_m2"]
    begin_s = float(min(rows.t_s[0], rows.pulse_s[0]))
    return spin_filter(rows, field_B_nT, *at(motion, begin_s), inertia[2] / inertia[0], chosen)


def search(
    run: Callable[[float, float], Setting],
    printed: Mapping[str, Any],
    *,
    walks_rad_s: Sequence[float] = WALKS_RAD_S,
    factors: Sequence[float] = FACTORS,
    progress: Progress = silent,
) -> Search:
    """The grid of `run(walk, factor)`, and from its best points the two choices by least squares within the grid."""
    grid: list[Setting] = []
    for walk in walks_rad_s:
        progress("the filter's open settings", len(grid) / (len(walks_rad_s) * len(factors) + 20))
        grid += [run(walk, factor) for factor in factors]

    def axes(setting: Setting) -> FloatArray:
        return np.asarray(setting.pre_deg - np.array(printed["pre_rms_deg"]), dtype=np.float64)

    def sums(setting: Setting) -> FloatArray:
        before, after = setting.pre_rss_deg / printed["pre_rss_deg"], setting.post_rss_deg / printed["post_rss_deg"]
        return np.log(np.array([before, after], dtype=np.float64))  # ratios: one is ten times the other

    low, high = (np.log([end(walks_rad_s), end(factors)]) for end in (min, max))

    def nearest(misfit: Callable[[Setting], FloatArray]) -> Setting:
        def at(place: FloatArray) -> Setting:
            walk, factor = np.exp(low + (place - 1.0) * (high - low))
            return run(float(walk), float(factor))

        best = min(grid, key=lambda setting: float(np.sum(misfit(setting) ** 2)))
        begin = 1.0 + (np.log([best.walk_rad_s, best.sun_factor]) - low) / (high - low)

        def off(place: FloatArray) -> FloatArray:
            return misfit(at(place))

        found = least_squares(
            off,
            np.clip(begin, 1.0, 2.0),
            bounds=(1.0, 2.0),
            diff_step=[_STEP, _STEP],
            xtol=_CLOSE,
            ftol=_CLOSE,
            max_nfev=_MOST_STEPS,
        )
        return at(found.x)

    return Search(tuple(walks_rad_s), tuple(factors), tuple(grid), nearest(axes), nearest(sums))
