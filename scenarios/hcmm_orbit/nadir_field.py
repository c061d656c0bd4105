"""The open question: the printed nadir-field angles disagree with the main field that the sun-field angles confirm.

Orbit and windows are those of the test against flight. For each idea of what that column holds, the ends of the 43
ranges are predicted and compared, apart for the end near a magnetic pole (field near the vertical) and the other one,
and apart for sunlit passes, whose windows are fixed, and night passes, whose equatorward ends are not: there the
sun-nadir angle has passed its minimum.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.hcmm_orbit.angles import PassAngles, angles_along
from fluxtwin.scenarios.hcmm_orbit.fit import OrbitFit
from fluxtwin.scenarios.hcmm_orbit.geometry import angle_between
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel, field_E_nT, load_field

NEAR_DEG = 1.5
"""An end this near counts as explained."""
COULD_BE = {"8": "6", "6": "8", "1": "4", "5": "8"}
"""Digit as read by the digit that may have been printed: eights and sixes, fours read as ones, eights as fives."""
MAIN_FIELD, DIPOLE = "the main field (IGRF-14)", "the dipole of IGRF-14 alone"
_DEALS = 40
_POLES = [(float(lat), float(lon)) for lat in np.arange(70.0, 90.0, 1.0) for lon in np.arange(240.0, 340.0, 4.0)]


@dataclass(frozen=True)
class Idea:
    """One hypothesis and how it does; errors are predicted less printed [deg]."""

    name: str
    error_deg: FloatArray
    """(P, 2) at the lower and the higher end."""
    explained: int
    """Ends within NEAR_DEG."""
    explained_with_digits: int
    """The same if one digit of each end may be a known misreading."""
    by_chance: tuple[float, float]
    """Mean and standard deviation of `explained` when the printed ranges are dealt out at random among the passes of
    the same hemisphere: what an idea does without knowing which pass is which."""


@dataclass(frozen=True)
class NadirField:
    """All ideas, and which ends are which."""

    passes: tuple[Pass, ...]
    ideas: tuple[Idea, ...]
    poleward: BoolArray
    """(P, 2) the end at which the field is nearest the vertical."""
    sunlit: BoolArray
    """(P,)."""
    pole_deg: tuple[float, float]
    """Latitude and east longitude of the pole of the centred dipole that fits the sunlit ends best."""
    model_pole_deg: tuple[float, float]
    """The pole of the dipole part of IGRF-14 on that day."""
    dipole_wrong_deg: float
    """rms over the passes of the dipole's nadir-field angle less the main field's: a residual against a dipole would be
    at least of this size, and the printed ones are 0.3 to 1 deg. Only the ranges can be a dipole's."""

    def ends_explained(self, idea: Idea, *, poleward: bool, sunlit: bool) -> tuple[int, int]:
        """How many of one group of ends are within NEAR_DEG, and how many there are."""
        near = np.abs(idea.error_deg[self._group(poleward=poleward, sunlit=sunlit)]) <= NEAR_DEG
        return int(near.sum()), int(near.size)

    def median_abs(self, idea: Idea, *, poleward: bool, sunlit: bool) -> float:
        """Median error of one group of ends."""
        return float(np.median(np.abs(idea.error_deg[self._group(poleward=poleward, sunlit=sunlit)])))

    def _group(self, *, poleward: bool, sunlit: bool) -> BoolArray:
        ends = self.poleward if poleward else ~self.poleward
        return np.asarray(ends & (self.sunlit if sunlit else ~self.sunlit)[:, None])


def weigh_ideas(fit: OrbitFit, windows: PassWindows) -> NadirField:
    """Predict the column by every idea, along the fitted orbit and in the windows of all 43 passes."""
    passes = read_passes()
    model, flown = load_field("igrf14"), load_field("igrf1975")
    printed = np.array([p.nadir_field_read for p in passes])

    def along(which: FieldModel, where: PassWindows = windows) -> FloatArray:
        return angles_along(passes, where, fit.orbit, which).range_of("nadir_field_deg")

    def moved(start_min: float, end_min: float) -> PassWindows:
        return dataclasses.replace(windows, start_min=windows.start_min + start_min, end_min=windows.end_min + end_min)

    shown = {
        MAIN_FIELD: _whole(along(model)),
        "the field that HCMM used (IGRF 1975)": _whole(along(flown)),
        DIPOLE: _whole(along(model.truncated(1))),
        "a dipole along the axis (equation 20)": _whole(_axial(passes, windows, fit)),
        "degrees 1 and 2": _whole(along(model.truncated(2))),
        "degrees 1 to 3": _whole(along(model.truncated(3))),
        "nadir across the ellipsoid": _whole(_geodetic(passes, windows, fit, model)),
        "data a minute later": _whole(along(model, moved(1.0, 1.0))),
        "a minute less at both ends": _whole(along(model, moved(1.0, -1.0))),
        "the best part of each window": _best_part(passes, windows, fit, model),
        "the best part of each window, dipole": _best_part(passes, windows, fit, model.truncated(1)),
    }
    north = printed.mean(axis=1) < 90.0
    poleward = np.stack([north, ~north], axis=1)
    sunlit = np.array([p.sunlit for p in passes])
    return NadirField(
        passes=passes,
        ideas=tuple(_idea(name, predict, printed) for name, predict in shown.items()),
        poleward=poleward,
        sunlit=sunlit,
        pole_deg=_fit_pole(passes, windows, fit, printed, sunlit),
        model_pole_deg=_dipole_pole(model, passes[20].aos),
        dipole_wrong_deg=_apart(*(angles_along(passes, windows, fit.orbit, m) for m in (model, model.truncated(1)))),
    )


Predict = Callable[[FloatArray], FloatArray]
"""Ranges (P, 2) that an idea gives for printed ranges (P, 2)."""


def _whole(predicted: FloatArray) -> Predict:
    """An idea that predicts the ranges whatever is printed."""
    return lambda printed: predicted


def _idea(name: str, predict: Predict, printed: FloatArray) -> Idea:
    predicted = predict(printed)
    error = predicted - printed
    ends = zip(predicted.ravel(), printed.ravel(), strict=True)
    repaired = np.array([min(abs(end - value) for value in _readings(what)) for end, what in ends])
    rng = np.random.default_rng(1978)
    dealt = []
    for _ in range(_DEALS):
        other = printed.copy()
        for side in (printed.mean(axis=1) < 90.0, printed.mean(axis=1) >= 90.0):
            other[side] = printed[rng.permutation(np.flatnonzero(side))]
        dealt.append(int((np.abs(predict(other) - other) <= NEAR_DEG).sum()))
    return Idea(
        name,
        error,
        int((np.abs(error) <= NEAR_DEG).sum()),
        int((repaired <= NEAR_DEG).sum()),
        (float(np.mean(dealt)), float(np.std(dealt))),
    )


def _readings(value: float) -> list[float]:
    """The number as read and all that differ in one confused digit."""
    text = f"{value:.0f}"
    shown = [text]
    for place, digit in enumerate(text):
        shown += [text[:place] + true + text[place + 1 :] for true in COULD_BE.get(digit, "")]
    return [float(item) for item in shown if float(item) <= 180.0]


def _geodetic(passes: Sequence[Pass], windows: PassWindows, fit: OrbitFit, model: FieldModel) -> FloatArray:
    """Ranges of the angle between the field and the inward normal of the ellipsoid."""

    def down(r_E_km: FloatArray) -> FloatArray:
        latitude, longitude, _ = frames.geodetic(r_E_km)
        return -frames.from_geocentric(latitude, longitude, np.ones_like(latitude))

    return _ranges(passes, windows, fit, lambda time, r: angle_between(down(r), field_E_nT(model, time, r)))


def _axial(passes: Sequence[Pass], windows: PassWindows, fit: OrbitFit) -> FloatArray:
    """Ranges for the dipole of the papers' equation 20, along the Earth's axis."""

    def angle(time: np.ndarray, r_E_km: FloatArray) -> FloatArray:
        latitude = frames.geocentric(r_E_km)[0]
        return np.asarray(np.arctan2(np.cos(latitude), 2.0 * np.sin(latitude)))

    return _ranges(passes, windows, fit, angle)


def _ranges(
    passes: Sequence[Pass], windows: PassWindows, fit: OrbitFit, angle: Callable[[np.ndarray, FloatArray], FloatArray]
) -> FloatArray:
    out = np.empty((len(passes), 2))
    for row in range(len(passes)):
        values = np.degrees(angle(*_track(passes, windows, fit, row, 41)))
        out[row] = values.min(), values.max()
    return out


def _track(
    passes: Sequence[Pass], windows: PassWindows, fit: OrbitFit, row: int, count: int
) -> tuple[np.ndarray, FloatArray]:
    """(count,) times in the window of a pass, and positions r_E_km (count, 3)."""
    minutes = np.linspace(windows.start_min[row], windows.end_min[row], count)
    time = epoch.add_seconds(passes[row].aos, 60.0 * minutes)
    return time, frames.rotation_EN(time).apply(fit.orbit.propagate(time)[0])


def _best_part(passes: Sequence[Pass], windows: PassWindows, fit: OrbitFit, model: FieldModel) -> Predict:
    """The ranges nearest to print that any part of at least 1.5 min of each window can give: two free numbers a pass."""
    found = angles_along(passes, windows, fit.orbit, model)
    tables = []
    for minutes, values in zip(found.minutes, found.nadir_field_deg, strict=True):
        inside = np.triu(np.ones((values.size, values.size), dtype=bool))
        table = np.where(inside, values[None, :], np.nan)
        low, high = np.fmin.accumulate(table, axis=1), np.fmax.accumulate(table, axis=1)
        kept = minutes[None, :] - minutes[:, None] >= 1.5
        tables.append((low[kept], high[kept]))

    def predict(printed: FloatArray) -> FloatArray:
        out = np.empty_like(printed)
        for row, (low, high) in enumerate(tables):
            at = int(np.argmin(np.abs(low - printed[row, 0]) + np.abs(high - printed[row, 1])))
            out[row] = low[at], high[at]
        return out

    return predict


def _fit_pole(
    passes: Sequence[Pass], windows: PassWindows, fit: OrbitFit, printed: FloatArray, sunlit: BoolArray
) -> tuple[float, float]:
    """The centred dipole whose nadir-field angles fit the sunlit passes best (median of 48 ends)."""
    unit = np.array([_track(passes, windows, fit, row, 25)[1] for row in np.flatnonzero(sunlit).tolist()])
    unit /= np.linalg.norm(unit, axis=2)[:, :, None]
    best = (np.inf, (0.0, 0.0))
    for latitude, longitude in _POLES:
        axis = frames.from_geocentric(np.radians([latitude]), np.radians([longitude]), np.ones(1))[0]
        sine = unit @ axis
        # Nadir and the field of a dipole: the field points down in the north, tan(angle) = cot(latitude) / 2.
        angle = np.degrees(np.arctan2(np.sqrt(1.0 - sine**2), 2.0 * sine))
        error = np.stack([angle.min(axis=1), angle.max(axis=1)], axis=1) - printed[sunlit]
        best = min(best, (float(np.median(np.abs(error))), (latitude, longitude)))
    return best[1]


def _apart(a: PassAngles, b: PassAngles) -> float:
    return float(np.sqrt(np.mean((a.nadir_field_deg - b.nadir_field_deg) ** 2)))


def _dipole_pole(model: FieldModel, time: np.datetime64) -> tuple[float, float]:
    g10, g11, h11 = model.coefficients_nT(time)[0, :3]
    axis = -np.array([[g11, h11, g10]])
    latitude, longitude, _ = frames.geocentric(axis)
    return float(np.degrees(latitude[0])), float(np.degrees(longitude[0]) % 360.0)
