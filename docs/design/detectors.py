"""What each check of a waveform buys: what it rejects on tuning records, and what of that nothing else rejects.

    python docs/design/detectors.py OUT [COUNT]

The records are those of benchmarks/withheld.py at a seed that no frozen run has, made once, into OUT. A proposal that
only one check rejects is what the answer would turn on without it: the record is asked again with that check off.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import sys
from collections import defaultdict
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from withheld_cases.ask import arguments
from withheld_cases.cases import KINDS, PLAIN, identity
from withheld_cases.make import make
from withheld_cases.store import Store

import fluxtwin
from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.sim.effects.base import Effect

SEED = 41001
SINGLES = ("heater_switching", "wheel_field", "switched_field", "bias_random_walk", "bit_errors", "excess_noise")
RECORDS = [
    *(("singles", list(PLAIN).index(name)) for name in SINGLES),
    *(("outside", number) for number in reversed(range(len(KINDS["outside"])))),
    *(("shapes", number) for number in range(len(KINDS["shapes"]))),
    *(("pairs", number) for number in range(14)),
]
CHECKS = {
    "a block does as well": "does as well",
    "steady": "amplitude or phase",
    "elliptical": "linearly polarised",
    "one field in body axes": "its field changes with",
    "regular dwell times": "irregularly",
    "no line beside the levels": "line that was cut",
    "nothing of it by day": "by day",
    "no step stands out": "stands out",
    "no jumps": "jumps between",
    "nothing structured is left": "structure is left",
    "Gaussian": "not Gaussian",
    "most spikes are single bits": "the others are not",
}


def main() -> None:
    """Ask, and print a row for each check of each effect."""
    store = Store(Path(sys.argv[1])).prepared()
    count = int(sys.argv[2]) if len(sys.argv) > 2 else len(RECORDS)
    rows: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0] * 5)
    for population, number in RECORDS[:count]:
        make(str(store.root), SEED, population, number, None)
        name = identity(SEED, population, number)
        truths = {truth["name"] for truth in store.read("sealed", name)["truths"]}
        answer, proposed = answered(store, name, None)
        for effect, faults in proposed:
            for check in faults:
                row = rows[effect, check]
                row[effect in truths] += 1
                if faults == {check}:
                    row[2 + (effect in truths)] += 1
                    row[4] += answered(store, name, check)[0] != answer
    print("| effect | check | rejects, wrong | rejects, right | alone, wrong | alone, right | answers that change |")
    print("|---|---|---|---|---|---|---|")
    for (effect, check), counts in sorted(rows.items()):
        print(f"| `{effect}` | {check} | {' | '.join(map(str, counts))} |")


def answered(store: Store, name: str, off: str | None) -> tuple[list[str], set[tuple[str, frozenset[str]]]]:
    """Names of a record with one check off, and what was proposed with the checks that reject it."""
    proposed: set[tuple[str, frozenset[str]]] = set()
    plain = Finding.__init__

    def noted(self: Finding, effect: Effect, *given: Any, **named: Any) -> None:
        plain(self, effect, *given, **named)
        faults = {check for check, words in CHECKS.items() if any(words in fault for fault in self.faults)}
        proposed.add((effect.name, frozenset(faults)))
        if off is not None and faults == {off}:
            object.__setattr__(self, "faults", ())

    with patch.object(Finding, "__init__", noted):
        found = fluxtwin.diagnose(store.path("telemetry", name), **arguments(store.read("asked", name)))
    return [found.verdict, *sorted(effect.name for effect in found.effects)], proposed


if __name__ == "__main__":
    main()
