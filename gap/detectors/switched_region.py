"""A field that is on over a part of the Earth, in the dark or at any time: found in the residual.

Boxes of latitude and longitude are tried over all places that the record passes, and the best is refined edge by edge, and
as a circle. Any patch of wrong field looks a little like that, so the name is given only if a field of the Earth's own is
excluded, and if no block of columns and no single pass, an interval of time, does as well. The Earth's own is there
by day too, and seen from above it has no sharper edges than the altitude: of two half planes, one magnetised, the field at
height h goes over as the arctangent of the distance in units of h (Blakely 1995, chapter 9).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product

import numpy as np

from fluxtwin.gap.detectors.finding import Finding, Fitted, does_as_well, fitted, stands_out
from fluxtwin.gap.hypotheses.blocks import BlockFit, in_body, local_axes
from fluxtwin.gap.linear.projection import ProjectedResidual
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import THRESHOLD
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.effects.region import depth_deg
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.switched_field import SwitchedField

_FEWEST_ROWS = 20

Region = tuple[float, ...]
"""As `SwitchedField.region_deg` has it."""


@dataclass(frozen=True)
class _Place:
    """Where the rows are, in deg, and in which a field may be on by condition."""

    latitude: FloatArray
    longitude: FloatArray
    holds: dict[str, BoolArray]

    def depth(self, region: Region) -> FloatArray:
        """(N,) how far within the region the ground points lie, in deg."""
        return depth_deg(self.latitude, self.longitude, region)

    def on(self, condition: str, region: Region) -> BoolArray:
        """(N,) rows in which a field is on."""
        return np.asarray((self.depth(region) >= 0.0) & self.holds[condition])


def switched_region(problem: Problem, left: ProjectedResidual, rivals: Sequence[BlockFit]) -> Finding | None:
    """Look for a field switched on over a region; None where nothing like it is there.

    left: whitened residual with what was fitted out; rivals: fits of the design's blocks to it.
    """
    place = _place(problem.setting)
    search = _Search(left, place)
    trials, found = search.best(), []
    tried = float(np.log(max(len(search.known), 1)))
    for condition, region in trials:
        effect = SwitchedField(condition, region_deg=region)
        images = problem.derivatives([(effect, np.zeros(3))])
        one = fitted(left, images, len(region))  # the edges are estimated with the field
        found.append((one.worth(tried, len(region)), effect, region, images, one))
    if not found:
        return None
    value, effect, region, images, one = max(found, key=lambda trial: trial[0])
    if value <= THRESHOLD:
        return None
    faults = does_as_well(value, one, rivals)
    on = place.on(effect.condition, region)
    if max(fitted(left, in_body(rows.astype(float)), 2).worth(tried, 2) for rows in _passes(on)) >= value:
        faults.append("an interval of time does as well")
    day = (place.depth(region) >= 0.0) & ~on
    if day.sum() >= _FEWEST_ROWS:
        if stands_out(left, images, in_body(day.astype(float))):
            faults.append("it is present by day as well")
    elif search.seen_from_above(problem.setting, effect.condition, region, value):
        faults.append("a local error of the Earth's field, which has no edges sharper than the altitude, does as well")
    what = f"a field {effect.region_words}"
    return Finding(effect, one.size, one.sigma, value, what, tuple(faults))


class _Search:
    """The regions that were tried."""

    def __init__(self, left: ProjectedResidual, place: _Place) -> None:
        self.left, self.place = left, place
        self.known: dict[bytes, float] = {}
        """By rows in which the field is on, what it explains."""

    def best(self) -> list[tuple[str, Region]]:
        """Condition and region of the field that explains most, refined edge by edge: as a box, and as a circle."""
        trials = [trial for trial in _coarse(self.place) if self._gain(*trial) > 0.0]
        if not trials:
            return []
        condition, box = max(trials, key=lambda trial: self._gain(*trial))
        south, north, west, east = box
        circle = (0.5 * (south + north), 0.5 * (west + east), 0.5 * (north - south))
        regions = [_climbed(region, lambda one: self._gain(condition, one)) for region in (box, circle)]
        found = [(max(self.place.holds, key=lambda one: self._gain(one, region)), region) for region in regions]
        return [(one, _snug(self.place, region, self.place.on(one, region))) for one, region in found]

    def seen_from_above(self, setting: Setting, condition: str, region: Region, value: float) -> bool:
        """Whether a field of the Earth's own over such a region, its edges where they explain most, is worth as much."""
        height_deg = np.degrees(setting.geocentric[2] / EARTH_RADIUS_KM - 1.0)
        axes, holds = local_axes(setting), self.place.holds[condition]

        def fit(one: Region) -> Fitted:
            share = 0.5 + np.arctan2(self.place.depth(one), height_deg) / np.pi
            return fitted(self.left, axes * (share * holds)[:, None, None], len(one))

        best = fit(_climbed(region, lambda one: fit(one).drop))
        return best.worth(float(np.log(len(self.known))), len(region)) >= value

    def _gain(self, condition: str, region: Region) -> float:
        """Drop of chi-square; nothing by a region of too few rows, or of most of those in which the condition holds, as the
        place does not matter then."""
        on = self.place.on(condition, region)
        if not _FEWEST_ROWS <= on.sum() <= 0.5 * self.place.holds[condition].sum():
            return 0.0
        key = on.tobytes()
        if key not in self.known:
            self.known[key] = fitted(self.left, in_body(on.astype(float))).drop
        return self.known[key]


def _passes(on: BoolArray) -> list[BoolArray]:
    """(N,) each stretch of rows that are on."""
    number = np.cumsum(on & ~np.concatenate([[False], on[:-1]]))
    return [on & (number == one) for one in range(1, int(number[-1]) + 1)]


def _place(setting: Setting) -> _Place:
    latitude, longitude = (np.degrees(a) for a in setting.geocentric[:2])
    holds = {"region": np.ones(latitude.size, dtype=bool)}
    for condition in ("night", "eclipse"):
        on = SwitchedField(condition).values(setting)
        if on is not None and 0.0 < on.mean() < 1.0:
            holds[condition] = np.asarray(on > 0.5)
    return _Place(latitude, longitude, holds)


def _coarse(place: _Place) -> Iterator[tuple[str, Region]]:
    """Boxes of two sizes, half a box apart, over all places that the record passes, and over those it passes in the dark.

    Night and shadow hardly differ: which of them it is, is asked when the region is found.
    """
    for condition, holds in list(place.holds.items())[:2]:
        points = np.stack([place.latitude[holds], place.longitude[holds]], axis=1)
        for half in (12.0, 20.0):
            for latitude, longitude in (half * np.unique(np.rint(points / half), axis=0)).tolist():
                wide = min(half / max(np.cos(np.radians(latitude)), 0.2), 90.0)
                yield condition, _within((latitude - half, latitude + half, longitude - wide, longitude + wide))


def _climbed(region: Region, gain: Callable[[Region], float]) -> Region:
    """The region with its numbers moved one at a time while it gains."""
    while gain(moved := max(_moved(region), key=gain)) > gain(region) + 1e-9:
        region = moved
    return region


def _moved(region: Region) -> Iterator[Region]:
    """The region with one of its numbers moved, or two by as much: a circle that only grows on one side moves, too."""
    for first, second in combinations_with_replacement(range(len(region)), 2):
        for move, sense in product(
            (0.3, 1.0, 3.0, 9.0, -0.3, -1.0, -3.0, -9.0), (1.0, -1.0) if first != second else (1.0,)
        ):
            given = {second: sense * move, first: move}
            moved = tuple(value + given.get(place, 0.0) for place, value in enumerate(region))
            if len(region) == 3 and abs(moved[0]) <= 90.0 and 0.0 < moved[2] < 90.0:
                yield moved
            elif len(region) == 4 and moved[0] < moved[1] and moved[2] < moved[3] < moved[2] + 360.0:
                yield _within(moved)


def _within(box: Region) -> Region:
    """The box as far as there are latitudes."""
    return (max(box[0], -90.0), min(box[1], 90.0), *box[2:])


def _snug(place: _Place, region: Region, on: BoolArray) -> Region:
    """The box that just holds its rows: of what lies beyond the record knows nothing. A circle to tenths of a degree."""
    if len(region) == 3:
        return tuple(round(float(value), 1) for value in region)
    latitude = place.latitude[on]
    eastward = region[2] + np.mod(place.longitude[on] - region[2], 360.0)
    west, east = float(np.floor(eastward.min())), float(np.ceil(eastward.max()))
    shift = 360.0 * float(np.floor((west + 180.0) / 360.0))
    return float(np.floor(latitude.min())), float(np.ceil(latitude.max())), west - shift, east - shift
