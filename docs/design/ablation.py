"""What each rule of the search buys: tuning records answered with one rule off at a time.

    python docs/design/ablation.py OUT [--only RULE ...]

The records are those of benchmarks/withheld.py at a seed that no frozen run has (a frozen run's is made of a commit).
They are made once, into OUT. A rule is switched off by replacing the function or the number that holds it.
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
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from withheld_cases.ask import arguments
from withheld_cases.cases import identity
from withheld_cases.judged import Judged
from withheld_cases.make import make
from withheld_cases.store import Store

import fluxtwin
from fluxtwin.sim.base import files

SEED = 51001
RECORDS = {
    "nulls": 4,
    "nulls_undeclared": 4,
    "passes_only": 4,
    "singles": 12,
    "pairs": 10,
    "shapes": 6,
    "outside": 8,
}
GAP = "fluxtwin.gap"
RULES: dict[str, dict[str, Any]] = {
    "all on": {},
    "pairs and triples ranked afresh": {f"{GAP}.selection.forward._afresh": lambda *_: []},
    "settings moved between the tried values": {
        f"{GAP}.selection.forward._sharper": lambda search, fit: (fit, search.beside(fit))
    },
    "backward elimination": {f"{GAP}.selection.forward._eliminated": lambda _, fit, __: fit},
    "rivals refitted": {f"{GAP}.selection.search.room_for": lambda *_: False},
    "noise of the other explanations": {
        f"{GAP}.posterior.explanations._gained": lambda _, fits, *__: [0.0] * len(fits)
    },
    "structure: drift and parts of the record": {
        f"{GAP}.detectors.residual_structure.drift": lambda _: (0.0, 0.0),
        f"{GAP}.detectors.residual_structure.PARTS": (),
    },
    "variance of the shape": {f"{GAP}.posterior.explanations.SHAPE": 0.0},
    "a random walk": {f"{GAP}.posterior.structured.Structured._walking": lambda *_: None},
}


@contextmanager
def without(rule: str) -> Iterator[None]:
    """The product with one rule off."""
    with ExitStack() as stack:
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
    given = parser.parse_args()
    store = Store(given.out).prepared()
    cases = [(population, number) for population, count in RECORDS.items() for number in range(count)]
    for population, number in cases:
        if not store.has("asked", identity(SEED, population, number)):
            make(str(given.out), SEED, population, number, None)
    print("| rule switched off | " + " | ".join(RECORDS) + " | place | false names | seconds |")
    print("|" + "---|" * (len(RECORDS) + 4))
    for rule in given.only:
        counts, places, extra, began = dict.fromkeys(RECORDS, 0), 0, 0, time.process_time()
        answers: dict[str, Any] = {}
        with without(rule):
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
