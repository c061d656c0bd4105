"""A field that is on only where it is dark and only over a part of the Earth: the box is found in the residual.

Boxes of latitude and longitude are tried by night and in shadow over all places that the record passes, and the best is
refined edge by edge. Any patch of wrong field looks a little like that, so the name is given only if the same box by
day has nothing of it (a field of the Earth's own is there by day too), and if no block of columns does as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.gap.detectors.finding import Finding, does_as_well, fitted, stands_out
from fluxtwin.gap.hypotheses.blocks import in_body
from fluxtwin.gap.hypotheses.evidence import BlockFit
from fluxtwin.gap.linear.projection import ProjectedResidual
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import THRESHOLD
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.switched_field import SwitchedField

_DARK = ("night", "eclipse")
_HALF_SIZES_DEG = (12.0, 20.0)
_MOVES_DEG = (1.0, 3.0, 9.0)
_ROUNDS = 6
_FEWEST_ROWS = 20
_EDGES = 4  # of a box, estimated with the field
_MOST_OF_DARK = 0.5
"""Share of the dark rows that a region may have: beyond it, it is not the place that matters."""

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class _Place:
    """Where the rows are, in deg."""

    latitude: FloatArray
    longitude: FloatArray
    dark: dict[str, BoolArray]

    def inside(self, box: Box) -> BoolArray:
        """(N,) rows whose ground point lies in the box."""
        south, north, west, east = box
        turn = np.mod(self.longitude - west, 360.0)
        return np.asarray((self.latitude >= south) & (self.latitude <= north) & (turn <= np.mod(east - west, 360.0)))


@dataclass(frozen=True)
class _Trial:
    condition: str
    box: Box
    gain: float

    @property
    def effect(self) -> SwitchedField:
        return SwitchedField(self.condition, region_deg=self.box)


def switched_region(problem: Problem, left: ProjectedResidual, rivals: Sequence[BlockFit]) -> Finding | None:
    """Look for a field switched on in the dark over a region; None where nothing like it is there.

    left: whitened residual with what was fitted out; rivals: fits of the design's blocks to it.
    """
    place = _place(problem.setting)
    search = _Search(left, place)
    best = search.best()
    if best is None:
        return None
    images = problem.derivatives([(best.effect, np.zeros(3))])
    found = fitted(left, images, _EDGES)
    value = found.worth(float(np.log(search.tried)), _EDGES)
    if value <= THRESHOLD:
        return None
    faults = does_as_well(value, found, rivals)
    day = place.inside(best.box) & ~search.rows_on(best)
    if day.sum() < _FEWEST_ROWS:
        faults.append(
            "the record has no daytime pass over the region, so a local error of the Earth's field would look the same"
        )
    elif stands_out(left, images, in_body(day.astype(float))):
        faults.append("it is present by day as well")
    what = f"a field by {best.condition}, {best.effect.region_words}"
    return Finding(best.effect, found.size, found.sigma, value, what, tuple(faults))


class _Search:
    """The boxes that were tried, and what each explains."""

    def __init__(self, left: ProjectedResidual, place: _Place) -> None:
        self.left, self.place, self.tried = left, place, 0
        self._known: dict[bytes, float] = {}

    def rows_on(self, trial: _Trial) -> BoolArray:
        """(N,) rows in which the field is on."""
        return np.asarray(self.place.inside(trial.box) & self.place.dark[trial.condition])

    def best(self) -> _Trial | None:
        """The box that explains most, refined edge by edge."""
        found = [trial for trial in (self._trial(*each) for each in _coarse(self.place)) if trial.gain > 0]
        if not found:
            return None
        best = max(found, key=lambda trial: trial.gain)
        for _ in range(_ROUNDS):
            moved = max((self._trial(best.condition, box) for box in _moved(best.box)), key=lambda trial: trial.gain)
            if moved.gain <= best.gain + 1e-9:
                break
            best = moved
        other = [self._trial(condition, best.box) for condition in self.place.dark]
        best = max([best, *other], key=lambda trial: trial.gain)
        return replace(best, box=_snug(self.place, best.box, self.rows_on(best)))

    def _trial(self, condition: str, box: Box) -> _Trial:
        trial = _Trial(condition, box, 0.0)
        on = self.rows_on(trial)
        if not _FEWEST_ROWS <= on.sum() <= _MOST_OF_DARK * self.place.dark[condition].sum():
            return trial
        key = on.tobytes()
        if key not in self._known:
            self.tried += 1
            self._known[key] = fitted(self.left, in_body(on.astype(float))).drop
        return replace(trial, gain=self._known[key])


def _place(setting: Setting) -> _Place:
    latitude, longitude = (np.degrees(a) for a in frames.geocentric(setting.R_EN.apply(setting.given[0]))[:2])
    dark = {}
    for condition in _DARK:
        on = SwitchedField(condition).values(setting)
        if on is not None and 0.0 < on.mean() < 1.0:
            dark[condition] = np.asarray(on > 0.5)
    return _Place(latitude, longitude, dark)


def _coarse(place: _Place) -> Iterator[tuple[str, Box]]:
    """Boxes of two sizes, half a box apart, over all places that the record passes in the dark.

    Night and shadow hardly differ: which of them it is, is asked when the box is found.
    """
    for condition, dark in list(place.dark.items())[:1]:
        points = np.stack([place.latitude[dark], place.longitude[dark]], axis=1)
        for half in _HALF_SIZES_DEG:
            for latitude, longitude in (half * np.unique(np.rint(points / half), axis=0)).tolist():
                wide = min(half / max(np.cos(np.radians(latitude)), 0.2), 90.0)
                yield condition, _box(latitude - half, latitude + half, longitude - wide, longitude + wide)


def _box(south: float, north: float, west: float, east: float) -> Box:
    return (max(south, -90.0), min(north, 90.0), west, east)


def _moved(box: Box) -> Iterator[Box]:
    """The box with one edge moved."""
    for edge in range(4):
        for move in (*_MOVES_DEG, *(-m for m in _MOVES_DEG)):
            south, north, west, east = (value + (move if place == edge else 0.0) for place, value in enumerate(box))
            if south < north and west < east < west + 360.0:
                yield _box(south, north, west, east)


def _snug(place: _Place, box: Box, on: BoolArray) -> Box:
    """The box that just holds its rows: of what lies beyond the record knows nothing."""
    latitude = place.latitude[on]
    eastward = box[2] + np.mod(place.longitude[on] - box[2], 360.0)
    west, east = float(np.floor(eastward.min())), float(np.ceil(eastward.max()))
    shift = 360.0 * float(np.floor((west + 180.0) / 360.0))
    return float(np.floor(latitude.min())), float(np.ceil(latitude.max())), west - shift, east - shift
