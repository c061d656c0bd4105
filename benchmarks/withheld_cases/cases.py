"""The populations: which truths, in which regime, at which visible size. A case follows from seed, population, number."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.special import gammaln

from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from withheld_cases import joining, null_regimes, of_dynamics, of_place, of_sensor, of_spacecraft, outside, shapes
from withheld_cases.attitude_sensors import draw_sensors
from withheld_cases.chain import Truth
from withheld_cases.draft import Draft, Maker
from withheld_cases.visible import noise_rms_nT, scaled, signature_nT, visible
from withheld_cases.worlds import REGIMES, SecondSensor, World, between, draw_second, draw_world

PLAIN: dict[str, Maker] = {
    maker.__name__: maker
    for maker in (
        of_sensor.bias,
        of_sensor.scale_misalignment,
        of_spacecraft.torquer_coupling,
        of_sensor.quadratic_nonlinearity,
        of_sensor.cubic_nonlinearity,
        of_sensor.hysteresis,
        of_sensor.saturation,
        of_sensor.sensor_lag,
        of_sensor.coarse_quantization,
        of_sensor.excess_noise,
        of_sensor.thermal_bias_drift,
        of_sensor.thermal_scale_drift,
        of_sensor.bias_step,
        of_sensor.bias_random_walk,
        of_sensor.bit_errors,
        of_place.time_tag_offset,
        of_place.along_track_error,
        of_place.field_epoch,
        of_place.field_truncation,
        of_place.ring_current,
        of_spacecraft.solar_array_current,
        of_spacecraft.battery_current,
        of_spacecraft.heater_switching,
        of_spacecraft.wheel_field,
        of_spacecraft.eddy_current,
        of_spacecraft.switched_field,
        of_spacecraft.boom_bending,
        of_place.sun_sensor_head_misalignment,
        of_place.horizon_scanner_bias,
        of_place.yaw_drift,
    )
}
DISTRIBUTIONAL = ("excess_noise", "coarse_quantization", "bit_errors", "bias_random_walk")
CALIBRATION = ("bias", "scale_misalignment")
POINTED = ("horizon_scanner_bias", "yaw_drift", "yaw_runs_away", "horizon_third", *joining.POINTED)
"""Only where there is a roll, a pitch and a yaw to speak of."""
PACKETS = ("stale_packets", "swapped_rows", "missorted_samples")
"""Only where the field changes little from row to row: else each bad packet would be a spike."""
TURNING = ("spin_gain",)
"""Only where the size of the body's rate changes."""
CONFUSED = (
    {"sensor_lag", "time_tag_offset", "along_track_error"},
    {"bias_step", "bias_random_walk"},
    {"wheel_field", "excess_noise"},
    {"wheel_field", "coarse_quantization"},
)
"""Names that are one group by nature, beside what the numbers show."""
LAWS = ("laws", "laws_nulls", "laws_catalogue")
"""See `laws`."""
TWO = {"outside_two": "outside", "singles_two": "singles"}
"""Flights of another population once more, the same but for a second magnetometer in the record."""
POPULATIONS = (
    "nulls",
    "nulls_off",
    "singles",
    "faint",
    "pairs",
    "triples",
    "shapes",
    "outside",
    "new_singles",
    "sensed",
    *of_dynamics.POPULATIONS,
    "nulls_undeclared",
    "singles_undeclared",
    *null_regimes.UNDECLARED,
    "limits",
    "undetermined",
    *LAWS,
    *TWO,
)
NULLS = ("nulls", "nulls_off", "nulls_undeclared")
KINDS: dict[str, dict[str, Maker]] = {
    "shapes": shapes.SHAPES,
    "outside": outside.OUTSIDE,
    "new_singles": joining.JOINING,
}
"""Populations with kinds of their own; the others go through PLAIN."""
STRENGTH = {
    "singles": (0.2, 3.0),
    "faint": (0.1, 0.3),
    "pairs": (0.7, 3.0),
    "triples": (1.0, 3.0),
    "shapes": (0.5, 3.0),
    "outside": (1.0, 3.0),
    "new_singles": (0.2, 3.0),
    "sensed": (0.2, 3.0),
    "singles_undeclared": (0.5, 3.0),
}
SENSED = (
    "sun_sensor_head_misalignment",
    "horizon_scanner_bias",
    "scale_misalignment",
    "along_track_error",
    "yaw_drift",
)
"""Faults of the two attitude sensors, and what may be taken for one. Each case is made twice, the same but for sun and
nadir: even numbers have them, odd ones have not."""
_TRIES = 60
_LEAST_NOISE_NT, _MOST_NOISE_NT = 3.0, 600.0
_ALIKE = 0.8


@dataclass(frozen=True)
class Case:
    """One sealed question."""

    identity: str
    population: str
    number: int
    world: World
    truths: tuple[Truth, ...]
    targets: tuple[float, ...]
    achieved: tuple[float, ...]
    sizes: tuple[float, ...]
    tries: int
    label: str = ""
    """Which shape or outside member."""


def identity(seed: int, population: str, number: int) -> str:
    """A name that gives nothing away."""
    return hashlib.sha256(f"{seed}/{population}/{number}".encode()).hexdigest()[:12]


def case_seed(seed: int, population: str, *number: int) -> np.random.Generator:
    """The draws of one case; without a number, of the whole population."""
    word = int(hashlib.sha256(population.encode()).hexdigest()[:8], 16)
    return np.random.default_rng([seed, word, *number])


def make_case(seed: int, population: str, number: int, rich: FieldModel | None = None) -> Case:
    """The case. Raises RuntimeError if no world in many shows the truths at the wanted size."""
    own, base = number // 2 if population == "sensed" else number, TWO.get(population, population)
    rng = case_seed(seed, base, own)
    makers, regimes, label = _chosen(base, own, case_seed(seed, base))
    regime = regimes[own % len(regimes)]
    if population == "sensed":
        label += ", sun and nadir " + ("left out" if number % 2 else "measured")
    if population in ("nulls", *null_regimes.UNDECLARED):
        label, motion = null_regimes.chosen(population, number)
        world = null_regimes.REGIMES[label](rng, motion)
        return Case(identity(seed, population, number), population, number, world, (), (), (), (), 1, label)
    if population in NULLS:
        world = draw_world(rng, regime)
        if population == "nulls_off":
            world = dataclasses.replace(world, declared_sigma_factor=1.5 if number % 8 < 4 else 1.0 / 1.5)
        return Case(identity(seed, population, number), population, number, world, (), (), (), (), 1)
    low, high = STRENGTH[base]
    targets = tuple(between(rng, low, high) for _ in makers)
    for attempt in range(1, _TRIES + 1):
        world = draw_world(rng, regime, rich=rich)
        if population == "sensed":
            world = dataclasses.replace(world, sensors=draw_sensors(world.key) if number % 2 == 0 else None)
        if population in TWO:
            world = dataclasses.replace(world, second=draw_second(world.key))
        found = _fitted(world, makers, targets, rng)
        if found is not None:
            world, truths, sizes, achieved = found
            name = identity(seed, population, number)
            return Case(name, population, number, world, truths, targets, achieved, sizes, attempt, label)
    raise RuntimeError(f"{population} {number} ({label}, {regime}): no world shows it at the wanted size")


def _chosen(population: str, number: int, order: np.random.Generator) -> tuple[list[Maker], tuple[str, ...], str]:
    """Makers, the regimes they may have (rotated by the round), and a label."""
    if population in (*NULLS, *null_regimes.UNDECLARED):
        return [], REGIMES, ""
    if population == "sensed":
        name = SENSED[number % len(SENSED)]
        return [PLAIN[name]], ("nadir",), name
    if population in ("pairs", "triples"):
        sets = _sets({"pairs": 2, "triples": 3}[population])
        names = sets[int(order.permutation(len(sets))[number % len(sets)])]
        return [PLAIN[name] for name in names], _regimes(names), "+".join(names)
    table = KINDS.get(population, PLAIN)
    names = tuple(table)
    name = names[number % len(names)]
    regimes = _regimes((name,))
    # The round advances the regime, so that every name meets every regime equally often.
    spin = (number // len(names) + number % len(names)) % len(regimes)
    return [table[name]], (regimes[spin],), name


def _regimes(names: Sequence[str]) -> tuple[str, ...]:
    if any(name in TURNING for name in names):
        return ("slews",)
    return ("nadir", "slews") if any(name in POINTED + PACKETS for name in names) else REGIMES


def _sets(count: int) -> list[tuple[str, ...]]:
    """All sets of that many names that are no group by nature and hold at most one known by its distribution."""
    names = [name for name in PLAIN if name not in CALIBRATION]
    return [
        chosen
        for chosen in combinations(names, count)
        if sum(name in DISTRIBUTIONAL for name in chosen) <= 1
        and not any(len(group & set(chosen)) > 1 for group in CONFUSED)
    ]


def _fitted(
    world: World, makers: Sequence[Maker], targets: Sequence[float], rng: np.random.Generator
) -> tuple[World, tuple[Truth, ...], tuple[float, ...], tuple[float, ...]] | None:
    """Truths at their visible sizes in that world; the noise is changed where the physical range asks for it."""
    seeds = rng.integers(0, 2**31, size=len(makers))
    for _ in range(3):
        drafted = _drafts(world, makers, seeds)
        if drafted is None:
            return None
        world, drafts = drafted
        truths, sizes, achieved = [], [], []
        factor = None
        for draft, target in zip(drafts, targets, strict=True):
            size = _size(world, draft, target)
            if isinstance(size, tuple):
                truths.append(draft.at(size[0]))
                sizes.append(size[0])
                achieved.append(size[1])
            elif factor is None:
                factor = size
        if len(truths) == len(drafts):
            lost = _alike(world, truths) or any(_unknowable(world, truth) for truth in truths)
            return None if lost else (world, tuple(truths), tuple(sizes), tuple(achieved))
        changed = None if factor is None else world.budget.scaled(factor)
        if changed is None or not _LEAST_NOISE_NT < changed.noise_nT < _MOST_NOISE_NT:
            return None
        world = dataclasses.replace(world, budget=changed)
    return None


def _drafts(world: World, makers: Sequence[Maker], seeds: np.ndarray) -> tuple[World, list[Draft]] | None:
    """All truths drawn in one world; what the first ones need of it stays for the others."""
    for _ in range(2):  # the second time every one of them sees the final world
        drafts = []
        for maker, seed in zip(makers, seeds.tolist(), strict=True):
            draft = maker(world, np.random.default_rng(seed))
            if draft is None:
                return None
            world = draft.world
            drafts.append(draft)
    return world, drafts


def _size(world: World, draft: Draft, target: float) -> tuple[float, float] | float | None:
    """Size and visible strength; or the factor on the noise that would help; or None."""

    def measure(size: float) -> float:
        truth = draft.at(size)
        return visible(world, [truth]) if draft.measure is None else draft.measure(world, truth)

    if draft.as_drawn:
        return draft.start, measure(draft.start)
    found = scaled(measure, target, draft.low, draft.high, draft.start)
    if found is not None:
        return found
    if draft.measure is not None:
        return None
    ends = [measure(draft.low)] if draft.low == draft.high else [measure(draft.low), measure(draft.high)]
    for end in (ends[-1], ends[0]):
        factor = end / target
        if 0.02 < factor < 1.0:
            return 0.9 * factor if draft.low < draft.high else factor
        if 1.0 < factor < 5.0 and (draft.low == draft.high or end == ends[0]):
            return 1.1 * factor if draft.low < draft.high else factor
    return None


def _unknowable(world: World, truth: Truth) -> bool:
    """Whether a heater that nobody recorded says less than it takes to tell when it switched.

    Its sequence is one of the ways to choose the switches among the rows; half of the chi-square that the field makes
    in the noise has to pay for the logarithm of their number (minimum description length: Rissanen 1978).
    """
    if truth.name != "heater_switching" or "heater_on" in world.recorded:
        return False
    rows, switches = int((~world.missing).sum()), int(truth.parameters["switches"])
    ways = gammaln(rows + 1) - gammaln(switches + 1) - gammaln(rows - switches + 1)
    return bool(0.5 * 3 * rows * visible(world, [truth]) ** 2 < ways)


def _alike(world: World, truths: Sequence[Truth]) -> bool:
    """Whether one truth's signature is mostly a free 3 x 3 mixture of another's: then they are one group."""
    signs = [signature_nT(world, [truth]) for truth in truths if truth.signal]
    for one, other in combinations(signs, 2):
        for a, b in ((one, other), (other, one)):
            rest = a - b @ np.linalg.lstsq(b, a, rcond=None)[0]
            if np.sum(rest**2) < (1.0 - _ALIKE) * np.sum(a**2):
                return True
    return False


def answer(case: Case) -> dict[str, Any]:
    """What is sealed."""
    return {
        "case": case.identity,
        "population": case.population,
        "number": case.number,
        "label": case.label,
        "truths": [
            {
                "name": t.name,
                "stage": t.stage,
                "parameters": dict(t.parameters),
                "signal": t.signal,
                "target": target,
                "visible": got,
                "size": size,
            }
            for t, target, got, size in zip(case.truths, case.targets, case.achieved, case.sizes, strict=True)
        ],
        "tries": case.tries,
        **sealed_world(case.world),
    }


def sealed_world(world: World) -> dict[str, Any]:
    """What is sealed of a world."""
    rows = world.time.size
    return {
        "regime": world.regime,
        "noise_rms_nT": noise_rms_nT(world),
        "attitude_tau_s": world.budget.attitude_tau_s,
        "attitude_sigma_deg": float(np.degrees(world.budget.attitude_sigma_rad)),
        "altitude_km": world.orbit.altitude_km,
        "eccentricity": world.orbit.eccentricity,
        "inclination_deg": float(np.degrees(world.orbit.inclination_rad)),
        "start": str(world.start),
        "rows": rows,
        "step_s": world.step_s,
        "span_s": world.span_s,
        "bursts": bool(world.span_s > 1.2 * rows * world.step_s),
        "recorded": sorted(world.recorded),
        "modelled": list(world.modelled),
        "degree": world.degree,
        "real_model": world.real_model.name.partition(":")[0],
        "richer_nT": richer_nT(world),
        "b_nT": world.b_nT.tolist(),
        "S": world.S.tolist(),
        "declared_sigma_factor": world.declared_sigma_factor,
        "sensors_deg": None
        if world.sensors is None
        else {
            name.replace("_rad", ""): value if name.endswith("_s") else float(np.degrees(value))
            for name, value in dataclasses.asdict(world.sensors).items()
        },
    } | ({} if world.second is None else {"second_magnetometer": _sealed_second(world.second)})


def _sealed_second(sensor: SecondSensor) -> dict[str, float]:
    """What is sealed of a second magnetometer."""
    budget = sensor.budget
    return {"spacecraft_factor": sensor.spacecraft_factor, "noise_nT": budget.noise_nT, "lsb_nT": budget.lsb_nT}


def richer_nT(world: World) -> float:
    """By how much the real field departs from the ground's, rms per component; what truths add to it left out."""
    if world.real_model is world.ground_model or world.real_model.name == world.ground_model.name:
        return 0.0
    r_N_km, _ = world.where(world.time)
    more = world.real_field_N_nT(world.time, r_N_km) - field_N_nT(world.ground_model, world.time, r_N_km)
    return float(np.sqrt(np.mean(more**2)))


def question(case: Case) -> dict[str, Any]:
    """What the diagnosis is given besides the telemetry: as a user would."""
    flagless = case.population in ("nulls_undeclared", "singles_undeclared", *null_regimes.UNDECLARED)
    return (undeclared if flagless else declared)(case.identity, case.world)


def declared(identity: str, world: World) -> dict[str, Any]:
    """With the noise, the step and the attitude error of the world; never the error's time constant."""
    budget = world.budget
    return {
        "case": identity,
        "noise_nT": budget.noise_nT,
        "lsb_nT": budget.lsb_nT,
        "attitude_sigma_deg": float(np.degrees(budget.attitude_sigma_rad)) * world.declared_sigma_factor,
        "modelled": list(world.modelled),
        "degree": world.degree,
    }


def undeclared(identity: str, world: World) -> dict[str, Any]:
    """The same without any word of noise."""
    nothing = dict.fromkeys(("noise_nT", "lsb_nT", "attitude_sigma_deg"))
    return declared(identity, world) | nothing
