"""Discrepancies placed inside the chain: at each stage, under each condition, carried to the reading.

A block is a small set of columns: what the reading would show if the stage's quantity were off by a free vector
whenever (or in proportion as) the condition holds. Attitude: theta(c) x B. Orbit: A grad(B) dr(c). Time: dt(c)
dB/dt. Sensor: gain and non-linearity. Spacecraft: a field in body axes. Field: a field in Earth-fixed, inertial
or local axes. (Kennedy & O'Hagan 2001 put one discrepancy at the output; here every stage has its own.)

A condition is columns of numbers along the record. The names are those of a diagnosis (`sunlit eclipse torquer latitude
orbit_phase temperature current field_strength time after_time head rate region flag:NAME`; a named driver adds its
`driver:NAME`); `label` tells variants of one name apart.

How much a block explains of a residual follows from small Gram matrices, in whitened units with the fitted columns projected
out: it is only credited with what calibration and the named effects cannot do. A block is made, whitened, reduced to its
Gram matrix and forgotten: memory does not grow with the number of blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from fluxtwin.calib.common.direction import even_directions
from fluxtwin.gap.hypotheses.candidates import PerturbedDesign, alike
from fluxtwin.gap.linear.projection import ProjectedResidual, Whitens, explained
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.earth.field import design_matrix_E, field_gradient_E_nT_km
from fluxtwin.sim.effects import drivers
from fluxtwin.sim.effects.base import known_column
from fluxtwin.sim.effects.chain import jacobian
from fluxtwin.sim.effects.clock_and_orbit import TimeTagOffset
from fluxtwin.sim.effects.drivers import TIME_CONSTANTS_S
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.telemetry.quantities import QUANTITIES

LEAST_SHARE = 0.02
"""Of the rows: an indicator that holds for less, or for all but less, says nothing."""
STAGES = ("time", "orbit", "field", "attitude", "spacecraft", "sensor")
"""Where a discrepancy of this kind can lie; dynamics and telemetry have none."""
OWN_STAGES = ("spacecraft", "sensor")
"""What is done there is added to the readings of one magnetometer; the others are the same for all."""
_TOGETHER = 8  # blocks that are whitened at once: so many columns fit the cache of a core


@dataclass(frozen=True)
class Condition:
    """One condition along the record."""

    name: str | None
    """As a diagnosis names it; None for "always"."""
    label: str
    columns: FloatArray
    """(N, k); 0 or 1, or of unit rms. Where nature's zero is not known (time, latitude, temperature) the first
    column is constant: calibration absorbs it in body axes, but not in others."""
    indicator: bool = False


def conditions(setting: Setting) -> tuple[Condition, ...]:
    """Every condition that varies on this design, but regions (`regions`) and steps (`step_block`)."""
    every = (*_lighting(setting), *_orbital(setting), *_housekeeping(setting))
    return tuple(condition for condition in every if _varies(condition))


def always(setting: Setting) -> Condition:
    """The condition that always holds."""
    return Condition(None, "always", np.ones((setting.time.size, 1)), indicator=True)


def regions(setting: Setting) -> tuple[Condition, ...]:
    """Smooth patches of the Earth, each about 40 degrees wide, that the record passes over."""
    unit = setting.R_EN.apply(setting.given[0])
    unit = unit / np.linalg.norm(unit, axis=1)[:, None]
    found = []
    for centre in even_directions(48, first=0.5):
        away = np.arccos(np.clip(unit @ centre, -1.0, 1.0)) / 0.35  # neighbours on the sphere overlap at half height
        patch = np.exp(-0.5 * away**2)
        if 0.005 * unit.shape[0] < (patch > 0.5).sum() and (patch > 0.5).mean() < 0.5:
            latitude, longitude = np.degrees([np.arcsin(centre[2]), np.arctan2(centre[1], centre[0])])
            found.append(Condition("region", f"region {latitude:.0f} N {longitude:.0f} E", patch[:, None]))
    return tuple(found)


def _lighting(setting: Setting) -> Iterator[Condition]:
    sunlit = np.asarray(drivers.lit(setting) > 0.5, dtype=np.float64)
    yield _indicator("sunlit", "sunlit", sunlit)
    since = _since_start(setting.seconds, sunlit < 0.5)
    yield _smooth("eclipse", "time in eclipse", since, zero_known=True)
    yield _indicator("eclipse", "eclipse", 1.0 - sunlit)
    r_E_km = setting.R_EN.apply(setting.given[0])
    sun_E = setting.R_EN.apply(sun.sun_direction_N(setting.time))
    day = np.einsum("ij,ij->i", sun_E, r_E_km) > 0
    yield _indicator("eclipse", "night below", 1.0 - day)
    sun_B, known = drivers.sun_in_body(setting)
    shone_on = sunlit * known
    yield Condition("sunlit", "sun direction", sun_B * shone_on[:, None])
    faces = np.concatenate([np.maximum(sun_B, 0), np.maximum(-sun_B, 0)], axis=1) * shone_on[:, None]
    yield Condition("sunlit", "sun on each face", faces)
    recorded = known_column(setting, "temperature_degC")
    if recorded is not None:
        yield _smooth("temperature", "temperature", recorded)
    else:
        for tau_s in TIME_CONSTANTS_S:  # as the effects try them
            lagged = drivers.temperature_K(setting, float(tau_s))
            yield _smooth("temperature", f"sunlight lagged by {tau_s:.0f} s", lagged)


def _orbital(setting: Setting) -> Iterator[Condition]:
    u = setting.orbit_phase_rad
    waves = [wave(n * u) for n in (1, 2, 3) for wave in (np.cos, np.sin)]
    yield _smooth("orbit_phase", "orbit phase, once", np.stack(waves[:2], axis=1))
    yield _smooth("orbit_phase", "orbit phase", np.stack(waves, axis=1))
    sine = np.sin(setting.latitude_rad)
    yield _smooth("latitude", "latitude", np.stack([sine, np.cos(2 * setting.latitude_rad)], axis=1))
    yield _smooth("latitude", "polar caps", np.stack([np.maximum(sine, 0) ** 4, np.maximum(-sine, 0) ** 4], axis=1))
    longitude = frames.geocentric(setting.R_EN.apply(setting.given[0]))[1]
    waves = [wave(n * longitude) for n in (1, 2) for wave in (np.cos, np.sin)]
    yield _smooth("region", "longitude", np.stack(waves, axis=1))
    t = 2 * setting.seconds / max(float(setting.seconds[-1]), 1e-9) - 1
    yield _smooth("time", "time", t)
    yield _smooth("time", "time, cubic", np.stack([t, t**2, t**3], axis=1))


def _housekeeping(setting: Setting) -> Iterator[Condition]:
    dipole = known_column(setting, "dipole_B_Am2")
    if dipole is not None:
        yield _smooth("torquer", "torquer dipole", dipole, zero_known=True)
        yield _indicator("torquer", "any torquer on", (np.abs(dipole) > 1e-3 * np.abs(dipole).max()).any(axis=1))
    for quantity in QUANTITIES:
        recorded = None if quantity.condition is None else known_column(setting, quantity.name)
        if recorded is not None:
            yield _smooth(quantity.condition, quantity.stems[0].replace("_", " "), recorded, zero_known=True)
    head = known_column(setting, "sun_sensor_head")
    for number in np.unique(head)[1:] if head is not None else ():
        yield _indicator("head", f"head {number:.0f}", head == number)
    switches = {name: known_column(setting, name) for name in setting.columns if name.startswith("flag_")}
    switches["flag_heater_on"] = known_column(setting, "heater_on")
    for name, flag in switches.items():
        if flag is not None:
            yield _indicator(f"flag:{name.removeprefix('flag_')}", name.removeprefix("flag_"), flag > 0.5)
    rate = setting.rate_B_rad_s
    if setting.attitude_known is not None and setting.column("rate_B_rad_s") is None:
        rate = np.where(setting.attitude_known[:, None], rate, 0.0)
    if np.linalg.norm(rate.std(axis=0)) > 1e-5:
        yield _smooth("rate", "body rate", rate)


def _varies(one: Condition) -> bool:
    if one.indicator and not LEAST_SHARE < one.columns.mean() < 1 - LEAST_SHARE:
        return False
    return bool(one.columns.size and one.columns.std(axis=0).max() > 1e-9)


def _indicator(name: str, label: str, values: FloatArray | BoolArray) -> Condition:
    return Condition(name, label, np.asarray(values, dtype=np.float64).reshape(-1, 1), indicator=True)


def _smooth(name: str | None, label: str, values: FloatArray, zero_known: bool = False) -> Condition:
    columns = np.asarray(values, dtype=np.float64).reshape(values.shape[0], -1)
    moving = columns.std(axis=0) > 1e-9 * np.abs(columns).max(initial=1e-30)
    columns = columns[:, moving]
    columns = columns if zero_known else columns - columns.mean(axis=0)
    columns = columns / np.sqrt(np.mean(columns**2, axis=0))
    if not zero_known and columns.shape[1]:
        columns = np.concatenate([np.ones((columns.shape[0], 1)), columns], axis=1)
    return Condition(name, label, columns)


def _since_start(seconds: FloatArray, holds: BoolArray) -> FloatArray:
    """(N,) seconds since the condition last began; 0 where it does not hold."""
    begins = holds & ~np.concatenate([[False], holds[:-1]])
    latest = np.maximum.accumulate(np.where(begins, np.arange(holds.size), 0))
    return np.where(holds, seconds - seconds[latest], 0.0)


@dataclass(frozen=True)
class Block:
    """One hypothesis about where something is off, and when."""

    stages: Mapping[str, float]
    """The stages it may belong to, with their prior shares; more than one where nature could do it at either."""
    condition: str | None
    frame: str | None
    label: str
    axes: str
    """One letter a column: x, y, z, or a blank where a column belongs to no axis."""
    make: Callable[[], FloatArray]
    """(N, 3, k) columns, in nT per unit; made when wanted, so that long records do not fill the memory."""
    prior: float = 1.0
    """Weight against the other blocks of its stage."""


class Carrier:
    """What carries a discrepancy to the reading, for one problem: made once, shared by all blocks."""

    def __init__(self, problem: Problem) -> None:
        setting = problem.design.setting
        self.problem, self.rows = problem, problem.rows
        r, _, R_BN = setting.given
        self.field_B_nT = problem.design.signal([*problem.frozen, *problem.modelled_active]).field_B_nT
        r_E_km = setting.R_EN.apply(r)
        R_BE = R_BN * setting.R_EN.inv()
        self.turns = {
            "body": np.broadcast_to(np.eye(3), (self.rows, 3, 3)),
            "inertial": R_BN.as_matrix(),
            "earth": R_BE.as_matrix(),
            "orbital": (R_BN * setting.R_ON.inv()).as_matrix(),
            "local": local_axes(setting),
        }
        gradient = field_gradient_E_nT_km(setting.model, setting.time, r_E_km)
        R_EO = (setting.R_EN * setting.R_ON.inv()).as_matrix()
        self.displaced_nT_km = self.turns["earth"] @ gradient @ R_EO
        self.delayed_nT_s = jacobian(problem.design, TimeTagOffset(), at=problem.frozen)[:, :, 0]
        self._r_E_km = r_E_km

    def additive(self, condition: Condition, frame: str) -> FloatArray:
        """(N, 3, 3k) a vector in `frame` under the condition."""
        return _spread(np.asarray(self.turns[frame]), condition.columns)

    def turned(self, condition: Condition, frame: str) -> FloatArray:
        """(N, 3, 3k) a rotation about the axes of `frame` under the condition: theta x B, in nT per rad."""
        axes = np.swapaxes(self.turns[frame], 1, 2)
        turned = np.swapaxes(np.cross(axes, self.field_B_nT[:, None, :]), 1, 2)
        return _spread(turned, condition.columns)

    def gain(self, condition: Condition) -> FloatArray:
        """(N, 3, 3k) a scale error of each axis under the condition."""
        return _spread(np.eye(3) * self.field_B_nT[:, None, :], condition.columns)

    def mixed(self, condition: Condition) -> FloatArray:
        """(N, 3, 9k) a share of each component of the field in each axis under the condition: S that follows it."""
        return in_body((self.field_B_nT[:, :, None] * condition.columns[:, None, :]).reshape(self.rows, -1))

    def moved(self, condition: Condition) -> FloatArray:
        """(N, 3, 3k) an error of position along x, y, z of the orbital frame under the condition."""
        return _spread(self.displaced_nT_km, condition.columns)

    def late(self, condition: Condition) -> FloatArray:
        """(N, 3, k) an error of the time under the condition."""
        late: FloatArray = self.delayed_nT_s[:, :, None] * condition.columns[:, None, :]
        return late

    def potential(self, degree: int) -> FloatArray:
        """(N, 3, K) an error of the field model's coefficients up to a degree."""
        return np.asarray(self.turns["earth"] @ design_matrix_E(degree, self._r_E_km))

    def products(self, power: int) -> FloatArray:
        """(N, 3, 3m) all products of two or three components in each axis, at 50,000 nT."""
        x, y, z = (self.field_B_nT / 5e4).T
        terms = [x * x, y * y, z * z, x * y, x * z, y * z]
        if power == 3:
            terms = [x**3, y**3, z**3, x * x * y, x * x * z, y * y * x, y * y * z, z * z * x, z * z * y, x * y * z]
        return in_body(np.stack(terms, axis=1))

    def own_slope(self) -> FloatArray:
        """(N, 3, 3) the sign of each component's own slope, in its own axis: what hysteresis follows."""
        return np.asarray(np.eye(3) * np.sign(self.delayed_nT_s)[:, None, :])

    def excess(self) -> FloatArray:
        """(N, 3, 3) by how much each component is beyond its 80th percentile, in its own axis: what clipping cuts."""
        size = np.abs(self.field_B_nT)
        beyond = np.sign(self.field_B_nT) * np.maximum(size - np.quantile(size, 0.8, axis=0), 0.0)
        return np.asarray(np.eye(3) * beyond[:, None, :])

    def induced(self) -> FloatArray:
        """(N, 3, 9) the slope of each component of the field in each axis: what eddy currents follow."""
        return in_body(self.delayed_nT_s)


def local_axes(setting: Setting) -> FloatArray:
    """(N, 3, 3) north, east and down as columns in body axes."""
    r, _, R_BN = setting.given
    R_NEC_E = frames.rotation_NEC_E(setting.R_EN.apply(r))
    return np.asarray((R_BN * setting.R_EN.inv() * R_NEC_E.inv()).as_matrix())


def blocks(problem: Problem, perturbed: PerturbedDesign | None = None) -> tuple[Block, ...]:
    """All blocks of this design. perturbed: the design with one more attitude error, if at hand."""
    carrier = Carrier(problem)
    setting = problem.design.setting
    found = steady(perturbed or PerturbedDesign(problem), conditions(setting))
    patches = list(regions(setting))
    constant = always(setting)
    return (
        *_additive(carrier, found, patches, constant),
        *_rotations(carrier, found),
        *_sensor(carrier, found),
        *_orbit_and_time(carrier, found, constant),
        *_field(carrier),
    )


def steady(perturbed: PerturbedDesign, found: Iterable[Condition]) -> list[Condition]:
    """Conditions of a design that do not follow the attitude's error."""
    if perturbed.setting is None:
        return list(found)
    again = {(c.name, c.label): c.columns for c in conditions(perturbed.setting)}
    return [c for c in found if alike(c.columns, again.get((c.name, c.label)))]


def step_block(problem: Problem, step_s: float) -> Block:
    """A field in body axes that sets in at a moment, in seconds from the first stamp."""
    on = (problem.setting.seconds >= step_s).astype(float)
    return Block(_BODY_STAGES["after_time"], "after_time", "body", "after a moment", "xyz", partial(in_body, on))


_BODY_STAGES: Mapping[str | None, Mapping[str, float]] = {
    "temperature": {"sensor": 0.8, "spacecraft": 0.2},
    "time": {"sensor": 0.8, "spacecraft": 0.2},
    "after_time": {"sensor": 0.7, "spacecraft": 0.3},
    "field_strength": {"sensor": 1.0},
}
DEFAULT_BODY: Mapping[str, float] = {"spacecraft": 0.85, "sensor": 0.15}


def _additive(
    carrier: Carrier, found: list[Condition], patches: list[Condition], constant: Condition
) -> Iterator[Block]:
    for c in found:
        if c.name == "head":
            continue
        stages = _BODY_STAGES.get(c.name, DEFAULT_BODY)
        yield _block(carrier.additive, c, "body", stages)
        for frame in ("orbital", "inertial", "earth"):
            yield _block(carrier.additive, c, frame, {"field": 1.0}, axes=" ")
    for frame in ("orbital", "inertial", "earth"):
        yield _block(carrier.additive, constant, frame, {"field": 1.0}, axes=" ")
    for c in patches:
        one = 1.0 / len(patches)  # all patches together count as one block
        yield _block(carrier.additive, c, "body", {"spacecraft": 1.0}, one)
        yield _block(carrier.additive, c, "local", {"field": 1.0}, one, axes=" ", named="earth")


def _rotations(carrier: Carrier, found: list[Condition]) -> Iterator[Block]:
    for c in found:
        if c.name in ("torquer", "current", "field_strength"):
            continue
        for frame in ("body", "orbital"):
            yield _block(carrier.turned, c, frame, {"attitude": 1.0})


def _sensor(carrier: Carrier, found: list[Condition]) -> Iterator[Block]:
    for c in found:
        if c.name in ("temperature", "time", "sunlit", "orbit_phase", "eclipse") and c.columns.shape[1] <= 4:
            yield _block(lambda c, _: carrier.gain(c), c, "body", {"sensor": 1.0})
            pattern = "xyz" * 3 * c.columns.shape[1]
            yield Block({"sensor": 1.0}, c.name, "body", c.label, pattern, partial(carrier.mixed, c))
    only: Mapping[str, float] = {"sensor": 1.0}
    for power, terms, count in ((2, 6, "two"), (3, 10, "three")):
        label = f"products of {count} components"
        yield Block(only, "field_strength", "body", label, "xyz" * terms, partial(carrier.products, power))
    yield Block({"sensor": 0.8, "spacecraft": 0.2}, "field_strength", "body", "own slope", "xyz", carrier.own_slope)
    yield Block(only, "field_strength", "body", "beyond a level", "xyz", carrier.excess)
    yield Block({"spacecraft": 1.0}, "rate", "body", "induced by the slope", "xyz" * 3, carrier.induced)


def _orbit_and_time(carrier: Carrier, found: list[Condition], constant: Condition) -> Iterator[Block]:
    smooth = [c for c in found if c.name in ("orbit_phase", "time", "sunlit") and c.columns.shape[1] <= 4]
    for c in [constant, *smooth]:
        yield _block(lambda c, _: carrier.moved(c), c, "orbital", {"orbit": 1.0}, axes=" ")
        stages = {"time": 0.9, "sensor": 0.1} if c is constant else {"time": 1.0}
        yield Block(stages, c.name, None, f"time, {c.label}", " " * c.columns.shape[1], partial(carrier.late, c))


def _field(carrier: Carrier) -> Iterator[Block]:
    for degree in (1, 3, 6, 10):
        terms = degree * (degree + 2)
        label, made = f"field to degree {degree}", partial(carrier.potential, degree)
        yield Block({"field": 1.0}, None, "earth", label, " " * terms, made)


def _block(
    make: Callable[[Condition, str], FloatArray],
    c: Condition,
    frame: str,
    stages: Mapping[str, float],
    prior: float = 1.0,
    axes: str = "xyz",
    named: str | None = None,
) -> Block:
    pattern = (axes * 3)[:3] * c.columns.shape[1]
    return Block(stages, c.name, named or frame, c.label, pattern, lambda: make(c, frame), prior)


def in_body(courses: FloatArray) -> FloatArray:
    """(N, 3, 3m) fields in body axes that follow courses (N,) or (N, m): axes run fastest."""
    return _spread(np.eye(3)[None], courses.reshape(len(courses), -1))


def _spread(vectors: FloatArray, columns: FloatArray) -> FloatArray:
    """(N, 3, 3k): each of the vectors (N, 3, m) times each of the columns (N, k); the vectors run fastest."""
    spread = vectors[:, :, None, :] * columns[:, None, :, None]
    return np.asarray(spread.reshape(len(columns), 3, -1))


@dataclass(frozen=True, eq=False)
class BlockFit:
    """A block against a residual: what its projected columns explain of it."""

    block: Block
    gram: FloatArray
    """(k, k) of the whitened columns with the fitted ones out of them."""
    moment: FloatArray
    """(k,) of these columns with the residual."""
    size: FloatArray
    """(k,) squared lengths of the whitened columns before the projection: what rank is measured against."""
    least_share: float
    searched: int = 0
    """Parameters that no column has: a moment, a frequency."""
    _known: dict[bytes, tuple[float, int]] = field(default_factory=dict, init=False)
    """By columns, what they explain."""

    def explained(self, columns: BoolArray | None = None) -> tuple[float, int]:
        """Drop of chi-square by all columns, or by some of them (k,), and the number of parameters that are seen."""
        pick = np.ones(self.moment.size, dtype=np.bool_) if columns is None else columns
        key = pick.tobytes()
        if key not in self._known:
            self._known[key] = self._explained(pick)
        return self._known[key]

    def _explained(self, pick: BoolArray) -> tuple[float, int]:
        pick = pick & (np.diag(self.gram) > self.least_share * self.size)
        if not pick.any():
            return 0.0, 0
        least = self.least_share * float(self.size[pick].max())
        drop, rank = explained(self.gram[np.ix_(pick, pick)], self.moment[pick], least)
        return drop, rank + self.searched


def fit(block: Block, left: ProjectedResidual) -> BlockFit:
    """Make a block, whiten it, project it, and keep what counts."""
    free, size = left.project(block.make())
    return BlockFit(block, free.T @ free, free.T @ left.residual, size, left.least_share)


_Some = tuple[Sequence[Block], FloatArray, list[slice], list[FloatArray]]
"""Blocks, (3N, k) their columns, whitened, and of each block its columns among them and its Gram matrix."""


class Dictionary:
    """The blocks of a design side by side.

    Blocks are only compared through their own small Gram matrices, so what a residual's basis takes from all of them is one
    product of matrices. What is whitened is kept for the next question under the same noise model; where it takes too much
    room, some blocks are made and whitened at a time, and forgotten.
    """

    def __init__(self, found: Sequence[Block], rows: int, most_bytes: float = 100e6) -> None:
        """most_bytes: that what is whitened may take between two questions."""
        self.found, self.rows = tuple(found), rows
        self.kept = 24 * rows * sum(len(block.axes) for block in self.found) <= most_bytes
        self._latest: tuple[Whitens, Sequence[_Some]] | None = None

    def _white(self, whitener: Whitens) -> Iterator[_Some]:
        """All blocks, some at a time."""
        if self._latest is not None and self._latest[0] is whitener:
            yield from self._latest[1]
            return
        self._latest = None
        every: list[_Some] = []
        for first in range(0, len(self.found), _TOGETHER):
            some = self._whitened(self.found[first : first + _TOGETHER], whitener)
            if self.kept:
                every.append(some)
            yield some
        self._latest = (whitener, every) if self.kept else None

    def _whitened(self, blocks: Sequence[Block], whitener: Whitens) -> _Some:
        white = whitener.apply(np.concatenate([block.make() for block in blocks], axis=2)).reshape(3 * self.rows, -1)
        ends = np.cumsum([0, *(len(block.axes) for block in blocks)]).tolist()
        places = [slice(*pair) for pair in pairwise(ends)]
        return blocks, white, places, [white[:, here].T @ white[:, here] for here in places]

    def fits(self, left: ProjectedResidual) -> list[BlockFit]:
        """`fit` for each block."""
        return self.fits_each([left])[0]

    def fits_each(self, lefts: Sequence[ProjectedResidual]) -> list[list[BlockFit]]:
        """`fits` for each of some residuals that were whitened alike."""
        found: list[list[BlockFit]] = [[] for _ in lefts]
        targets = [np.column_stack([left.basis, left.residual]) for left in lefts]
        for blocks, white, places, grams in self._white(lefts[0].whitener):
            for left, target, fits in zip(lefts, targets, found, strict=True):
                along = white.T @ target
                for block, here, gram in zip(blocks, places, grams, strict=True):
                    basis, moment = along[here, :-1], along[here, -1]
                    fits.append(BlockFit(block, gram - basis @ basis.T, moment, np.diag(gram), left.least_share))
        return found
