"""Make one case on disk: question, telemetry, sealed answer, noise-free twin and another day."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry
from withheld_cases import laws, limits, null_regimes, of_dynamics, undetermined
from withheld_cases.cases import (
    LAWS,
    TWO,
    Case,
    answer,
    case_seed,
    identity,
    make_case,
    question,
    sealed_world,
    undeclared,
)
from withheld_cases.chain import fly, noise_free, twin
from withheld_cases.draft import recording
from withheld_cases.plainly import shares
from withheld_cases.readme import readme
from withheld_cases.store import Store
from withheld_cases.visible import signature_nT
from withheld_cases.worlds import another_day

_LONGEST_TWIN = 6000
"""Rows; longer flights are not judged against their twin."""


def make(root: str, seed: int, population: str, number: int, chaos: str | None) -> str:
    """Write the files of one case; the sealed answer last, so that a case with an answer is whole."""
    if population in of_dynamics.POPULATIONS:
        return of_dynamics.make(root, seed, population, number)
    if population in LAWS:
        return laws.make(root, seed, population, number)
    if population == "limits":
        return limits.make(root, seed, number)
    store, name = Store(Path(root)), identity(seed, population, number)
    if store.has("sealed", name):
        return name
    if null_regimes.is_readme(population, number) or population == "undetermined":
        return _of_its_own(store, name, seed, population, number)
    try:
        case = make_case(seed, population, number, rich_field(chaos))
    except RuntimeError as error:
        store.write("sealed", name, {"case": name, "population": population, "number": number, "void": str(error)})
        return name
    clean = noise_free(case.world, case.truths)
    try:
        flown = fly(case.world, case.truths, clean)
    except BadInput as error:  # a truth so large that no reading is possible
        store.write("sealed", name, {"case": name, "population": population, "number": number, "void": str(error)})
        return name
    write_telemetry(flown, store.path("telemetry", name))
    store.write("asked", name, question(case))
    sealed = answer(case)
    if case.truths and TWO.get(population, population) != "outside":
        if case.world.time.size <= _LONGEST_TWIN:
            whole = recording(case.world, "v_N_km_s")  # without it nothing can be replayed
            write_telemetry(twin(whole, case.truths, clean), store.path("twin", name))
        sealed["second"] = _second_day(store, case, seed) if population == "singles" else None
        sealed["plain_share"] = min(shares(case.world, case.truths, case.sizes, plain=population != "shapes"))
    store.write("sealed", name, sealed)
    return name


def _of_its_own(store: Store, name: str, seed: int, population: str, number: int) -> str:
    """A record without a truth that is no flight of the usual worlds, asked without a flag."""
    if population == "undetermined":
        world, drifts, label = undetermined.draw(case_seed(seed, population, number))
        record = undetermined.fly(world, drifts)
        sealed = sealed_world(world) | {"label": label, "truths": [], "drifts": [dict(d.parameters) for d in drifts]}
        sealed |= dict(zip(("weakest_b_nT", "weakest_S"), undetermined.weakest(world), strict=True))
        asked = undeclared(name, world)
    else:
        record, sealed = readme(seed, number)
        asked = {"case": name} | dict.fromkeys(("noise_nT", "lsb_nT", "attitude_sigma_deg", "modelled", "degree"))
    write_telemetry(record, store.path("telemetry", name))
    store.write("asked", name, asked)
    store.write("sealed", name, {"case": name, "population": population, "number": number} | sealed)
    return name


def _second_day(store: Store, case: Case, seed: int) -> dict[str, float] | str:
    """The same truths weeks later, and how much is to be seen of them there; or why not."""
    rng = np.random.default_rng([seed, case.number, 99])
    world = another_day(case.world, rng)
    if world.degree is not None or case.world.real_model.valid_to < world.time[-1]:
        return "the field model does not reach that day" if world.degree is None else "the model is cut"
    try:
        write_telemetry(fly(world, case.truths), store.path("second", case.identity))
        truths = [truth for truth in case.truths if truth.signal]
        left = signature_nT(world, truths) if truths else np.zeros((1, 3))
    except (AssertionError, ValueError) as error:
        return f"{type(error).__name__}: {error}"
    return {"left_nT": float(np.sqrt(np.mean(left**2)))}


def rich_field(chaos: str | None) -> FieldModel | None:
    """CHAOS to degree 20, if a file is given."""
    return None if chaos is None else load_field(f"chaos:{chaos}", 20)
