"""What the fitted orbit predicts of angles that entered no fit: the test against flight, and an open question.

Each sunlit pass's window is fixed from its printed sun-nadir range. The lowest and highest sun-field angle in that
window are then predicted from orbit, sun and field and compared with the two printed numbers: 24 passes, 48 ends. What
counts are the ends whose digits nobody has touched: the few that were read anew had the prediction as one of the reasons.
The same is done with fields and an orbit that are known to be wrong; if the test could not tell them, it would test nothing.

The printed nadir-field angles disagree with the main field that the sun-field angles confirm. For each idea of what that
column holds, the ends of the 43 ranges are predicted and compared, apart for the end near a magnetic pole (field near the
vertical) and the other one, and apart for sunlit passes, whose windows are fixed, and night passes, whose equatorward ends
are not: there the sun-nadir angle has passed its minimum.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from fluxtwin.scenarios.flights import Numbers, rms
from fluxtwin.scenarios.hcmm_orbit.geometry import (
    PassWindows,
    angles_along,
    ends_of,
    fix_windows,
    look,
    make_grid,
    parts_of,
    track_of,
)
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel, field_E_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.effects.ambient_field import dipole_axis_E

NODE_MINUTES = 15.0
FIELD_TURN_DEG = 10.0
NEAR_DEG = 1.5
"""An end this near counts as explained."""
COULD_BE = {"8": "6", "6": "8", "1": "4", "5": "8"}
"""Digit as read by the digit that may have been printed: eights and sixes, fours read as ones, eights as fives."""
MAIN_FIELD, DIPOLE = "the main field (IGRF-14)", "the dipole of IGRF-14 alone"
_DEALS = 40
_POLES = [(float(lat), float(lon)) for lat in np.arange(70.0, 90.0, 1.0) for lon in np.arange(240.0, 340.0, 4.0)]


def windows_of(passes: tuple[Pass, ...], orbit: Orbit, *, as_scanned: bool = True) -> PassWindows:
    """Windows along an orbit, from the printed sun-nadir ranges."""
    grid = make_grid(passes)
    return fix_windows(grid, look(grid, orbit), [p.sun_nadir_read if as_scanned else p.sun_nadir for p in passes])


def run_flight_test(fit: Numbers, model: FieldModel | None = None) -> Numbers:
    """Predict with IGRF-14 where there is no other, and with four wrong fields and a wrong node."""
    model = load_field("igrf14") if model is None else model
    passes = tuple(item for item in read_passes() if item.sunlit)

    def predict(orbit: Orbit, other: FieldModel, turn_deg: float = 0.0) -> FloatArray:
        windows = windows_of(passes, orbit)
        return ends_of(angles_along(passes, windows, orbit, other, turned_east_deg=turn_deg).sun_field_deg)

    predicted = predict(fit.orbit, model)
    scanned, used = (
        np.array([getattr(p, name) for p in passes], dtype=np.float64) for name in ("sun_field_read", "sun_field")
    )
    untouched = scanned == used

    def median(orbit: Orbit, other: FieldModel, turn_deg: float = 0.0) -> float:
        return float(np.median(np.abs(predict(orbit, other, turn_deg) - used)[untouched]))

    later_rad = float(np.radians(NODE_MINUTES / 4.0))
    nodes = [dataclasses.replace(fit.orbit, raan_rad=fit.orbit.raan_rad + sign * later_rad) for sign in (-1.0, 1.0)]
    as_scanned, corrected = np.abs(predicted - scanned), np.abs(predicted - used)
    return Numbers(
        labels=tuple(p.label for p in passes),
        # (24, 2) lowest and highest sun-field angle; less the digits with the documented corrections; the ends whose digits
        # are those of the scan.
        predicted_deg=predicted,
        error_deg=predicted - used,
        untouched=untouched,
        # Median error of the untouched ends; of all 48, digits as scanned; the same with the documented corrections.
        median_deg=np.median(corrected[untouched]),
        median_as_scanned_deg=np.median(as_scanned),
        median_corrected_deg=np.median(corrected),
        # Ends with an error of at most 1 deg, of all 48.
        within_1_deg=(corrected <= 1.0).sum(),
        within_1_deg_as_scanned=(as_scanned <= 1.0).sum(),
        # Median error of the untouched ends with one thing wrong; of two directions of a turn the better one.
        nulls_deg={
            "dipole": median(fit.orbit, model.truncated(1)),
            "degree2": median(fit.orbit, model.truncated(2)),
            "degree4": median(fit.orbit, model.truncated(4)),
            "field_10deg": min(median(fit.orbit, model, sign * FIELD_TURN_DEG) for sign in (-1.0, 1.0)),
            "node_15min": min(median(orbit, model) for orbit in nodes),
        },
    )


def weigh_ideas(fit: Numbers, windows: PassWindows) -> Numbers:
    """Predict the nadir-field column by every idea, along the fitted orbit and in the windows of all 43 passes."""
    passes = read_passes()
    model, flown = load_field("igrf14"), load_field("igrf1975")
    printed = np.array([p.nadir_field_read for p in passes])
    _, time, r_N_km = track_of(passes, windows, fit.orbit, 41)
    r_E_km = frames.rotation_EN(time).apply(r_N_km)
    latitude, longitude, _ = frames.geodetic(r_E_km)
    down = -frames.from_geocentric(latitude, longitude, np.ones_like(latitude))
    geodetic = frames.angle_between(down, field_E_nT(model, time, r_E_km))
    latitude = frames.geocentric(r_E_km)[0]
    axial = np.arctan2(np.cos(latitude), 2.0 * np.sin(latitude))

    def along(which: FieldModel, start_min: float = 0.0, end_min: float = 0.0) -> Predict:
        moved = {"start_min": windows.start_min + start_min, "end_min": windows.end_min + end_min}
        where = dataclasses.replace(windows, **moved)
        return _whole(ends_of(angles_along(passes, where, fit.orbit, which).nadir_field_deg))

    def best_part(which: FieldModel) -> Predict:
        found = angles_along(passes, windows, fit.orbit, which)
        return _best_part(found.minutes, found.nadir_field_deg)

    shown = {
        MAIN_FIELD: along(model),
        "the field that HCMM used (IGRF 1975)": along(flown),
        DIPOLE: along(model.truncated(1)),
        "a dipole along the axis (equation 20)": _whole(ends_of(np.degrees(axial).reshape(len(passes), -1))),
        "degrees 1 and 2": along(model.truncated(2)),
        "degrees 1 to 3": along(model.truncated(3)),
        "nadir across the ellipsoid": _whole(ends_of(np.degrees(geodetic).reshape(len(passes), -1))),
        "data a minute later": along(model, 1.0, 1.0),
        "a minute less at both ends": along(model, 1.0, -1.0),
        "the best part of each window": best_part(model),
        "the best part of each window, dipole": best_part(model.truncated(1)),
    }
    north = printed.mean(axis=1) < 90.0
    poleward = np.stack([north, ~north], axis=1)
    sunlit = np.array([p.sunlit for p in passes])
    groups = {
        f"{end}, {light}": ends & lit[:, None]
        for end, ends in (("poleward", poleward), ("equatorward", ~poleward))
        for light, lit in (("sunlit", sunlit), ("night", ~sunlit))
    }
    whole, dipole = (angles_along(passes, windows, fit.orbit, m).nadir_field_deg for m in (model, model.truncated(1)))
    latitude, longitude, _ = np.degrees(frames.geocentric(dipole_axis_E(model, passes[20].aos)))
    return Numbers(
        passes=passes,
        ideas=tuple(_idea(name, predict, printed, groups) for name, predict in shown.items()),
        # (P, 2) the end at which the field is nearest the vertical, and (P,).
        poleward=poleward,
        sunlit=sunlit,
        # Latitude and east longitude of the pole of the centred dipole that fits the sunlit ends best, and of the pole of
        # the dipole part of IGRF-14 on that day.
        pole_deg=_fit_pole(passes, windows, fit, printed, sunlit),
        model_pole_deg=(float(latitude[0]), float(longitude[0] % 360.0)),
        # rms over the passes of the dipole's nadir-field angle less the main field's: a residual against a dipole would be
        # at least of this size, and the printed ones are 0.3 to 1 deg. Only the ranges can be a dipole's.
        dipole_wrong_deg=rms(whole - dipole),
    )


Predict = Callable[[FloatArray], FloatArray]
"""Ranges (P, 2) that an idea gives for printed ranges (P, 2)."""


def _whole(predicted: FloatArray) -> Predict:
    """An idea that predicts the ranges whatever is printed."""
    return lambda printed: predicted


def _idea(name: str, predict: Predict, printed: FloatArray, groups: dict[str, BoolArray]) -> Numbers:
    """One hypothesis and how it does."""
    predicted = predict(printed)
    error = np.abs(predicted - printed)
    ends = zip(predicted.ravel(), printed.ravel(), strict=True)
    repaired = np.array([min(abs(end - value) for value in _readings(what)) for end, what in ends])
    rng = np.random.default_rng(1978)
    dealt = []
    for _ in range(_DEALS):
        other = printed.copy()
        for side in (printed.mean(axis=1) < 90.0, printed.mean(axis=1) >= 90.0):
            other[side] = printed[rng.permutation(np.flatnonzero(side))]
        dealt.append(int((np.abs(predict(other) - other) <= NEAR_DEG).sum()))
    return Numbers(
        name=name,
        # (P, 2) predicted less printed at the lower and the higher end.
        error_deg=predicted - printed,
        # Ends within NEAR_DEG; the same if one digit of each end may be a known misreading.
        explained=(error <= NEAR_DEG).sum(),
        explained_with_digits=(repaired <= NEAR_DEG).sum(),
        # Mean and standard deviation of `explained` when the printed ranges are dealt out at random among the passes of the
        # same hemisphere: what an idea does without knowing which pass is which.
        by_chance=(float(np.mean(dealt)), float(np.std(dealt))),
        # Of each group of ends: how many are explained, how many there are, and their median error.
        groups={
            words: Numbers(explained=(error[of] <= NEAR_DEG).sum(), ends=int(of.sum()), median_deg=np.median(error[of]))
            for words, of in groups.items()
        },
    )


def _readings(value: float) -> list[float]:
    """The number as read and all that differ in one confused digit."""
    text = f"{value:.0f}"
    shown = [text]
    for place, digit in enumerate(text):
        shown += [text[:place] + true + text[place + 1 :] for true in COULD_BE.get(digit, "")]
    return [float(item) for item in shown if float(item) <= 180.0]


def _best_part(minutes: FloatArray, angle_deg: FloatArray) -> Predict:
    """The ranges nearest to print that any part of at least 1.5 min of each window can give: two free numbers a pass."""
    tables = []
    for time, values in zip(minutes, angle_deg, strict=True):
        kept = time[None, :] - time[:, None] >= 1.5
        tables.append([ends[kept] for ends in parts_of(values)])

    def predict(printed: FloatArray) -> FloatArray:
        out = np.empty_like(printed)
        for row, (low, high) in enumerate(tables):
            at = int(np.argmin(np.abs(low - printed[row, 0]) + np.abs(high - printed[row, 1])))
            out[row] = low[at], high[at]
        return out

    return predict


def _fit_pole(
    passes: Sequence[Pass], windows: PassWindows, fit: Numbers, printed: FloatArray, sunlit: BoolArray
) -> tuple[float, float]:
    """The centred dipole whose nadir-field angles fit the sunlit passes best (median of 48 ends)."""
    _, time, r_N_km = track_of(passes, windows, fit.orbit, 25)
    unit = frames.rotation_EN(time).apply(r_N_km / np.linalg.norm(r_N_km, axis=1)[:, None])
    unit = unit.reshape(len(passes), -1, 3)[sunlit]
    best = (np.inf, (0.0, 0.0))
    for latitude, longitude in _POLES:
        axis = frames.from_geocentric(np.radians([latitude]), np.radians([longitude]), np.ones(1))[0]
        sine = unit @ axis
        # Nadir and the field of a dipole: the field points down in the north, tan(angle) = cot(latitude) / 2.
        angle = np.degrees(np.arctan2(np.sqrt(1.0 - sine**2), 2.0 * sine))
        error = ends_of(angle) - printed[sunlit]
        best = min(best, (float(np.median(np.abs(error))), (latitude, longitude)))
    return best[1]
