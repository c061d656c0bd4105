"""Fields that follow recorded columns by laws that no effect of the catalogue has, and records with the same columns and
no such field.

Every record has eight columns `driver_A` to `driver_H` in an order that is drawn; the field follows one or two of them, or
none. What moves them are forward models of their own, functions of time; what the diagnosis makes of columns is not used.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry
from withheld_cases import cases, spacecraft
from withheld_cases.chain import Ambient, Truth, fly, noise_free, twin
from withheld_cases.draft import direction, recording, share
from withheld_cases.store import Store
from withheld_cases.visible import noise_rms_nT, scaled, visible
from withheld_cases.worlds import World, another_day, between, draw_world, shift

STRENGTH = (1.0, 4.0)
"""Visible size of a law, in noise."""
LIKE = 0.95
"""Correlation from which on a current is sunlight under another name."""
RECORDED = ("exact", "exact", "coarse", "through another")
"""How the columns that matter are recorded: half of the cases as they are."""
REGIMES = ("nadir", "tumble", "slews")
_NODES_S = 20.0
_BACK_S = 8000.0
_TRIES = 60
MOST_ROWS = 1500
"""Longer records say the same, and take minutes."""

Course = Callable[[World, TimeArray], FloatArray]
"""World and stamps to (N,): what a column really does."""


@dataclass(frozen=True)
class Column:
    """One of the eight: what it really does."""

    kind: str
    course: Course


@dataclass(frozen=True)
class Part:
    """A part of a field: coefficients times a course, along axes that are carried with it."""

    course: Course
    k: FloatArray
    frame: str = "body"


@dataclass(frozen=True)
class Drawn:
    """A law: what the field is, and what would be right to say."""

    parts: tuple[Part, ...]
    columns: tuple[str, ...]
    """Quantities that are in it, as telemetry calls them."""
    form: Mapping[str, Any]
    """What else there is to it: late_s, lag_s, power, level, frame."""


def duty(rng: np.random.Generator) -> Column:
    """On and off, in dwells of random length."""
    mean_s, part, key = between(rng, 200.0, 1500.0), float(rng.uniform(0.3, 0.6)), int(rng.integers(1, 2**31))

    def course(world: World, time: TimeArray) -> FloatArray:
        lengths = stream(key, "dwells").exponential(1.0, size=4000)
        on = stream(key, "first").random() < 0.5
        factor = np.where((np.arange(4000) % 2 == 0) == on, part, 1.0 - part)
        ends = np.cumsum(2.0 * mean_s * factor * (0.3 + lengths))
        slot = np.searchsorted(ends, _age_s(time) % ends[-1])
        return ((slot % 2 == 0) == on).astype(np.float64)

    return Column("duty", course)


def load(rng: np.random.Generator) -> Column:
    """A load of many levels, each held for a while."""
    dwell_s, key, base = between(rng, 150.0, 1200.0), int(rng.integers(1, 2**31)), float(rng.uniform(0.2, 1.0))

    def course(world: World, time: TimeArray) -> FloatArray:
        slot = np.floor(_age_s(time) / dwell_s).astype(np.int64)
        return base + np.random.default_rng(key).random(997)[(slot * 7919) % 997]

    return Column("load", course)


def wander(rng: np.random.Generator) -> Column:
    """Six waves of unlike periods about nothing in particular."""
    periods, phases = np.array([between(rng, 500.0, 9000.0) for _ in range(6)]), rng.uniform(0, 2 * np.pi, 6)
    sizes, level = rng.uniform(0.4, 1.0, 6), float(rng.uniform(-0.3, 0.3))

    def course(world: World, time: TimeArray) -> FloatArray:
        turns = _age_s(time)[:, None] / periods
        return level + np.sin(2 * np.pi * turns + phases) @ sizes / 1.5

    return Column("wander", course)


def angle(rng: np.random.Generator) -> Column:
    """A mechanism that swings through more than half a turn [deg]."""
    period_s, phase, reach = between(rng, 700.0, 5000.0), float(rng.uniform(0, 6)), float(rng.uniform(120.0, 300.0))

    def course(world: World, time: TimeArray) -> FloatArray:
        return reach * np.abs(2.0 * np.mod(_age_s(time) / period_s + phase, 1.0) - 1.0)

    return Column("angle", course)


def _age_s(time: TimeArray) -> FloatArray:
    return epoch.seconds_since(time, np.datetime64("2006-01-01", "ns"))


KINDS: Mapping[str, Callable[[np.random.Generator], Column]] = {
    "duty": duty,
    "load": load,
    "wander": wander,
    "angle": angle,
}
_EIGHT = ("duty", "duty", "load", "load", "load", "wander", "wander", "angle")


def sunlight(world: World, time: TimeArray) -> FloatArray:
    """(N,) 1 where more than half of the sun is seen."""
    return (world.sun(time)[1] > 0.5).astype(np.float64)


def late(course: Course, seconds: float) -> Course:
    """The same, later."""
    return lambda world, time: course(world, shift(time, -seconds))


def behind(course: Course, tau_s: float) -> Course:
    """The same behind a first-order low-pass: its impulse response, summed over ten time constants."""

    def filtered(world: World, time: TimeArray) -> FloatArray:
        step = tau_s / 12.0
        ages = step * (np.arange(120) + 0.5)
        weights = np.exp(-ages / tau_s)
        total = sum(w * course(world, shift(time, -age)) for w, age in zip(weights, ages.tolist(), strict=True))
        return np.asarray(total / weights.sum())

    return filtered


def times(one: Course, other: Course) -> Course:
    """A product."""
    return lambda world, time: one(world, time) * other(world, time)


Form = Callable[[World, Mapping[str, Column], np.random.Generator], Drawn | None]


def _pick(columns: Mapping[str, Column], rng: np.random.Generator, *kinds: str) -> list[str]:
    """Names of columns of these kinds, no one twice."""
    found: list[str] = []
    for kind in kinds:
        names = [name for name, one in columns.items() if one.kind == kind and name not in found]
        found.append(names[int(rng.integers(0, len(names)))])
    return found


def two_columns(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """The product of a load and a wandering column."""
    one, other = _pick(columns, rng, "load", "wander")
    course = times(columns[one].course, columns[other].course)
    return Drawn((Part(course, direction(rng)),), (one, other), {})


def in_sunlight(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn | None:
    """A load that acts in sunlight only."""
    return _gated(world, columns, rng, 0.0)


def late_in_sunlight(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn | None:
    """The same, minutes late."""
    return _gated(world, columns, rng, between(rng, 40.0, 400.0))


def _gated(world: World, columns: Mapping[str, Column], rng: np.random.Generator, late_s: float) -> Drawn | None:
    (name,) = _pick(columns, rng, "load")
    if not 0.2 < share(sunlight(world, world.time)) < 0.85:
        return None
    course = times(late(columns[name].course, late_s), sunlight)
    return Drawn((Part(course, direction(rng)),), (name, "sunlit"), {"late_s": late_s})


def while_payload(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn | None:
    """A wandering column that acts while the payload is on."""
    (name,) = _pick(columns, rng, "wander")
    if not 0.15 < share(spacecraft.payload_on(world, world.time)) < 0.85:
        return None
    course = times(columns[name].course, spacecraft.payload_on)
    return Drawn((Part(course, direction(rng)),), (name, "flag_payload"), {})


def filtered_product(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """A load behind a low-pass of minutes, while another unit is on."""
    one, other = _pick(columns, rng, "load", "duty")
    tau_s = between(rng, 60.0, 400.0)
    course = times(behind(columns[one].course, tau_s), columns[other].course)
    return Drawn((Part(course, direction(rng)),), (one, other), {"late_s": tau_s})


def squared(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """The square of a column that has both signs."""
    (name,) = _pick(columns, rng, "wander")
    course = times(columns[name].course, columns[name].course)
    return Drawn((Part(course, direction(rng)),), (name,), {"power": 2})


def on_above(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """Something goes on where a wandering column is above a level."""
    (name,) = _pick(columns, rng, "wander")
    inner = columns[name].course
    on = float(rng.uniform(0.3, 0.7))
    level = float(np.quantile(inner(world, world.time), 1.0 - on))
    return Drawn(
        (Part(lambda w, t: (inner(w, t) > level).astype(np.float64), direction(rng)),),
        (name,),
        {"level": level, "share_on": on},
    )


def by_the_sun(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """A load times the sun's direction along a body axis."""
    (name,) = _pick(columns, rng, "load")
    axis = int(rng.integers(0, 3))

    def along(w: World, t: TimeArray) -> FloatArray:
        return np.asarray(w.attitude(t).R_BN.apply(w.sun(t)[0])[:, axis])

    course = times(columns[name].course, along)
    return Drawn((Part(course, direction(rng)),), (name, f"sun_{'xyz'[axis]}"), {})


def turning(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """A magnet on a mechanism that turns: sine and cosine of its angle."""
    (name,) = _pick(columns, rng, "angle")
    inner = columns[name].course
    parts = (
        Part(lambda w, t: np.cos(np.radians(inner(w, t))), direction(rng)),
        Part(lambda w, t: np.sin(np.radians(inner(w, t))), direction(rng)),
    )
    return Drawn(parts, (name,), {"waves": 1})


def along_the_stars(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """A load whose field keeps its direction among the stars: it sits on a platform that does."""
    (name,) = _pick(columns, rng, "load")
    return Drawn((Part(columns[name].course, direction(rng), "inertial"),), (name,), {"frame": "inertial"})


def from_a_time_on(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn:
    """A load that acts from a time on that nobody recorded: a relay that was switched."""
    (name,) = _pick(columns, rng, "load")
    inner = columns[name].course
    since = world.time[int(rng.uniform(0.25, 0.75) * world.time.size)]
    course = times(inner, lambda w, t: (t >= since).astype(np.float64))
    return Drawn((Part(course, direction(rng)),), (name,), {"since": str(since)})


def two_at_once(world: World, columns: Mapping[str, Column], rng: np.random.Generator) -> Drawn | None:
    """A load in sunlight, and the square of another column."""
    first, second = _gated(world, columns, rng, 0.0), squared(world, columns, rng)
    if first is None:
        return None
    return Drawn((*first.parts, *second.parts), (*first.columns, *second.columns), {"power": 2})


FORMS: Mapping[str, Form] = {
    form.__name__: form
    for form in (
        two_columns,
        in_sunlight,
        late_in_sunlight,
        while_payload,
        filtered_product,
        squared,
        on_above,
        by_the_sun,
        turning,
        along_the_stars,
        two_at_once,
        from_a_time_on,
    )
}


def truth_of(drawn: Drawn, size_nT: float) -> Truth:
    """The field: each part as large as its course and its coefficients make it."""

    def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
        total = np.zeros((time.size, 3))
        for part in drawn.parts:
            vector = size_nT * np.outer(part.course(w, time), part.k)
            total += w.attitude(time).R_BN.apply(vector) if part.frame == "inertial" else vector
        return total

    return Truth("law", "spacecraft", {"size_nT": size_nT, **drawn.form}, stray=stray)


def recorded(world: World, columns: Mapping[str, Column], drawn: Drawn | None, how: str) -> dict[str, FloatArray]:
    """The columns as telemetry has them."""
    found = {}
    for name, one in columns.items():
        values = one.course(world, world.time)
        if drawn is not None and name in drawn.columns and one.kind != "duty" and how == "coarse":
            step = np.ptp(values) / 12.0
            held = np.arange(values.size) // 3 * 3  # a slower frame: every third row, held
            values = step * np.rint(values[held] / step)
        if drawn is not None and name in drawn.columns and one.kind != "duty" and how == "through another":
            noise = np.random.default_rng([world.key, len(found)]).standard_normal(values.size)
            values = 21.0 + 4.0 * values + 0.15 * 4.0 * float(values.std()) * noise
        found[name.removeprefix("driver_")] = values
    return found


def draw_columns(rng: np.random.Generator) -> dict[str, Column]:
    """Eight columns in an order that gives nothing away."""
    order = rng.permutation(len(_EIGHT))
    found = {}
    for letter, place in zip("ABCDEFGH", order.tolist(), strict=True):
        kind = _EIGHT[place]
        found[f"driver_{letter}{'_deg' if kind == 'angle' else ''}"] = KINDS[kind](rng)
    return found


def make(root: str, seed: int, population: str, number: int) -> str:
    """Write the files of one case."""
    store, name = Store(Path(root)), cases.identity(seed, population, number)
    if store.has("sealed", name):
        return name
    rng = cases.case_seed(seed, population, number)
    columns = draw_columns(rng)
    base: dict[str, Any] = {"case": name, "population": population, "number": number}
    if population == "laws_catalogue":
        return _of_the_catalogue(store, base, seed, number, columns)
    label = "" if population == "laws_nulls" else tuple(FORMS)[number % len(FORMS)]
    how = RECORDED[(number // len(FORMS) + number) % len(RECORDED)]
    for _ in range(_TRIES):
        world = recording(draw_world(rng, REGIMES[number % len(REGIMES)]), "v_N_km_s", "sunlit", "flag_payload")
        if world.time.size > MOST_ROWS or world.span_s > 1.2 * world.time.size * world.step_s:
            continue
        if not label:
            return _write(store, base, world, [], columns, None, "exact")
        drawn = FORMS[label](world, columns, rng)
        if drawn is None:
            continue
        target = between(rng, *STRENGTH)
        found = scaled(lambda s, w=world, d=drawn: visible(w, [truth_of(d, s)]), target, 1e-3, 1e6, noise_rms_nT(world))
        if found is None:
            continue
        base |= {"label": label, "how": how, "columns": list(drawn.columns), "form": dict(drawn.form)}
        later = another_day(world, np.random.default_rng([seed, number, 77]))
        base["second"] = _second(store, name, later, columns, drawn, found[0], how)
        if base["second"] is None:
            continue
        return _write(store, base, world, [truth_of(drawn, found[0])], columns, drawn, how, found)
    store.write("sealed", name, base | {"void": "no world shows it"})
    return name


def _second(
    store: Store, name: str, world: World, columns: Mapping[str, Column], drawn: Drawn, size: float, how: str
) -> float | None:
    """Another day without noise, with and without the field; the rms of the field there."""
    if world.real_model.valid_to < world.time[-1]:
        return None
    drivers = recorded(world, columns, drawn, how)
    with_it = twin(world, [truth_of(drawn, size)]).replace(drivers=drivers)
    write_telemetry(with_it, store.path("second", name))
    write_telemetry(twin(world, ()).replace(drivers=drivers), store.path("twin", name))
    return visible(world, [truth_of(drawn, size)])


def _write(
    store: Store,
    base: dict[str, Any],
    world: World,
    truths: list[Truth],
    columns: Mapping[str, Column],
    drawn: Drawn | None,
    how: str,
    size: tuple[float, float] = (0.0, 0.0),
) -> str:
    name = base["case"]
    record: Telemetry = fly(world, truths, noise_free(world, truths)).replace(
        drivers=recorded(world, columns, drawn, how)
    )
    write_telemetry(record, store.path("telemetry", name))
    store.write("asked", name, cases.declared(name, world) | {"rival": "laws_rival"})
    listed = [
        {"name": t.name, "stage": t.stage, "parameters": {}, "signal": t.signal, "visible": size[1], "size": size[0]}
        for t in truths
    ]
    lit, housekeeping = sunlight(world, world.time), ("array_current_A", "battery_current_A", "temperature_degC")
    there = {one: np.asarray(getattr(record, one)) for one in housekeeping if getattr(record, one) is not None}
    like = [one for one, values in there.items() if np.ptp(values) > 0 and np.corrcoef(values, lit)[0, 1] > LIKE]
    sealed = (
        {"label": "", "how": how, "columns": [], "like_sunlight": like}
        | base
        | {"truths": listed}
        | cases.sealed_world(world)
    )
    store.write("sealed", name, sealed)
    return str(name)


def _of_the_catalogue(store: Store, base: dict[str, Any], seed: int, number: int, columns: Mapping[str, Column]) -> str:
    """A single of the catalogue, with the eight columns in its record."""
    case = cases.make_case(seed, "singles", number)
    world = dataclasses.replace(case.world, sensors=None)
    if world.time.size > 2 * MOST_ROWS:
        store.write("sealed", base["case"], base | {"void": "too long"})
        return str(base["case"])
    base |= {"label": case.label}
    return _write(store, base, world, list(case.truths), columns, None, "exact", (case.sizes[0], case.achieved[0]))
