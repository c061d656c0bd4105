"""What each rule of the search buys: tuning records answered with one rule off at a time.

    python docs/design/ablation.py OUT [--only RULE ...] [--together]

The records are those of benchmarks/withheld.py at a seed that no frozen run has (a frozen run's is made of a commit).
They are made once, into OUT. A rule is switched off by replacing the function or the number that holds it, alone or
together with the others: where none of many matters, one pass says so.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import numpy as np
from withheld_cases.ask import arguments
from withheld_cases.cases import identity
from withheld_cases.judged import Judged
from withheld_cases.make import make
from withheld_cases.store import Store

import fluxtwin
from fluxtwin.sim.base import files

SEED = 4016
RECORDS = {
    "nulls": 8,
    "nulls_undeclared": 4,
    "passes_only": 3,
    "singles": 30,
    "pairs": 10,
    "shapes": 10,
    "outside": 14,
}
GAP = "fluxtwin.gap"


def _no(*_: Any) -> bool:
    return False


def _none(*_: Any) -> None:
    return None


def _no_faults(*_: Any) -> list[str]:
    return []


RULES: dict[str, dict[str, Any]] = {
    "all on": {},
    "pairs and triples ranked afresh": {f"{GAP}.selection.forward._afresh": lambda *_: []},
    "settings moved between the tried values": {
        f"{GAP}.selection.forward._sharper": lambda search, fit: (fit, search.beside(fit))
    },
    "backward elimination": {f"{GAP}.selection.forward._eliminated": lambda _, fit, __: fit},
    "rivals refitted": {f"{GAP}.selection.search.room_for": _no},
    "noise of the other explanations": {
        f"{GAP}.posterior.explanations._gained": lambda _, fits, *__: [0.0] * len(fits)
    },
    "variance of the shape": {
        f"{GAP}.posterior.explanations.SHAPE": 0.0,
        f"{GAP}.selection.criterion.SHAPE": 0.0,
    },
    "a random walk": {f"{GAP}.posterior.structured.Structured._walking": _none},
    "errors in an image, given back": {f"{GAP}.selection.refit.Readings.blur": _none},
    "structure: drift": {f"{GAP}.detectors.residual_structure.drift": lambda _: (0.0, 0.0)},
    "structure: parts of the record": {f"{GAP}.detectors.residual_structure.PARTS": ()},
    "structure: places": {f"{GAP}.hypotheses.blocks.regions": lambda _: ()},
    "a walk beside a name": {f"{GAP}.posterior.structured._with_rival": _none},
    "a walk beside all names but a step": {
        f"{GAP}.posterior.structured.Structured._where_it_walks": lambda *given: iter([given[2:]])
    },
    "multiples of a wheel's line": {
        f"{GAP}.{place}.multiples": lambda setting, _: np.zeros((setting.seconds.size, 3, 0))
        for place in ("posterior.explanations", "posterior.structured", "detectors.lines")
    },
    "a region": {f"{GAP}.posterior.structured.switched_region": _none},
    "S set anew beside the names": {f"{GAP}.diagnose._beside_the_names": lambda problem, _: problem},
    "white noise of each axis": {f"{GAP}.noise.choice._axis_factor": lambda *given: given[2]},
    "several names likelier wrong than right": {f"{GAP}.report.verdict.likelier_unknown": _no},
    "least share by the attitude error": {
        f"{GAP}.linear.projection.share_of_errors": lambda _, least: least,
        f"{GAP}.noise.choice.share_of_errors": lambda _, least: least,
    },
    "the field shortened by a turn": {f"{GAP}.problem.problem.Problem._unshortened": lambda *given: given[1]},
    "images that follow the attitude's error": {f"{GAP}.hypotheses.candidates.MOST_CHANGED": np.inf},
    "multiples of the declared step": {f"{GAP}.detectors.codes._common_multiple": lambda *_: []},
    "data quieter than their noise model": {f"{GAP}.selection.score._QUIETEST": 0.0},
    "check: a walk that comes back": {f"{GAP}.detectors.random_walk._COME_BACK": ()},
    "check: a step of a walk that stands out": {f"{GAP}.detectors.random_walk._one_stands_out": _no},
    "check: a line that is linearly polarised": {f"{GAP}.detectors.lines._linear": _no},
    "check: a line that changes": {
        f"{GAP}.detectors.lines.varies": _no_faults,
        f"{GAP}.detectors.lines.stands_out": _no,
    },
    "check: a block does as well": {
        f"{GAP}.detectors.{name}.does_as_well": _no_faults for name in ("lines", "switched_region")
    },
    "check: an irregular thermostat": {f"{GAP}.detectors.thermostat._regularity": lambda *_: 0.0},
    "check: a thermostat that is a line": {f"{GAP}.detectors.thermostat.stands_out": _no},
    "a sequence polished": {f"{GAP}.detectors.thermostat._polished": lambda _, on: on},
}


@contextmanager
def without(rules: Sequence[str]) -> Iterator[None]:
    """The product with these rules off, and no law sought: none is counted here."""
    with ExitStack() as stack:
        stack.enter_context(patch(f"{GAP}.diagnose._with_law", lambda _, found, __: found))
        for rule in rules:
            for target, value in RULES[rule].items():
                stack.enter_context(patch(target, value))
        yield


def right(population: str, one: Judged) -> bool:
    """Whether the answer is the one that was wanted."""
    if population in ("nulls", "nulls_undeclared", "passes_only"):
        return one.verdict == "no_gap"
    return one.verdict == "unknown" if population == "outside" else one.list_right


def main() -> int:
    """Make, ask with each rule off, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(RULES), default=list(RULES))
    parser.add_argument("--together", action="store_true", help="all of them off at once")
    given = parser.parse_args()
    store = Store(given.out).prepared()
    cases = [(population, number) for population, count in RECORDS.items() for number in range(count)]
    for population, number in cases:
        if not store.has("asked", identity(SEED, population, number)):
            make(str(given.out), SEED, population, number, None)
    print("| rule switched off | " + " | ".join(RECORDS) + " | place | false names | seconds |")
    print("|" + "---|" * (len(RECORDS) + 4))
    for off in [given.only] if given.together else [[rule] for rule in given.only]:
        rule = off[0] if len(off) == 1 else f"{len(off)} rules together"
        counts, places, extra, began = dict.fromkeys(RECORDS, 0), 0, 0, time.process_time()
        answers: dict[str, Any] = {}
        with without(off):
            for population, number in cases:
                name = identity(SEED, population, number)
                one = _asked(store, name)
                counts[population] += right(population, one)
                places += population in ("singles", "pairs", "shapes") and one.stage_right
                extra += one.extra
                answers[f"{population} {number}"] = [one.verdict, [e["name"] for e in one.effects], one.truths]
        seconds = time.process_time() - began
        line = " | ".join(str(counts[population]) for population in RECORDS)
        print(f"| {rule} | {line} | {places} | {extra} | {seconds:.0f} |", flush=True)
        files.write_json(given.out / f"{rule.replace(' ', '-')}.json", answers)
    return 0


def _asked(store: Store, name: str) -> Judged:
    sealed = json.loads(store.path("sealed", name).read_text(encoding="utf-8"))
    try:
        found = fluxtwin.diagnose(store.path("telemetry", name), **arguments(store.read("asked", name)))
        said = found.to_dict()
    except Exception as error:  # an error is an answer too
        said = {"verdict": "error", "error": str(error), "effects": []}
    return Judged(sealed, said)


if __name__ == "__main__":
    sys.exit(main())
