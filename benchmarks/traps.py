"""How often `fluxtwin check` names the right trap, and how often it flags a good record.

    python benchmarks/traps.py                     500 corrupted and 250 good records, on a seed of the day's commit
    python benchmarks/traps.py --quick             a few records: does it still run?
    python benchmarks/traps.py --seed N [--kind NAME ...] [--count N] [--good N] [--wrong]

Each record is flown on its own orbit (500 to 800 km, elliptic too) in its own attitude mode, with its own sampling,
length, noise, step, bias and attitude errors, corrupted in one way, written to a CSV file and given to `check_file`. A
name is right when the *first* trap is the right one, with the right words, and no other trap is named. The code that
corrupts shares nothing with the code that checks: frames come from ERFA and plain vector algebra.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import re
import subprocess
import sys
import time as clock
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from traps_cases import GOOD, KINDS, Case, Wanted, corrupt, fly, write

from fluxtwin.calib.checks.check import CheckReport, check_file
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth.field import FieldModel, load_field

ROOT = Path(__file__).resolve().parent.parent
QUICK = ["microtesla", "attitude to NEC", "mounting 45 deg", "clock 1 h", "outliers of 30 to 65 uT", "one axis stuck"]


def main() -> int:
    options = _options()
    seed = options.seed if options.seed is not None else _commit_seed()
    kinds = options.kind or (QUICK if options.quick else list(KINDS))
    count, good = (1, 2) if options.quick else (options.count, options.good)
    model = load_field("igrf14")
    start = clock.process_time()
    print(f"seed {seed}; {count} records a kind, {good} good ones")
    totals: dict[str, list[int]] = {}
    for kind in [*kinds, *([GOOD] if good else [])]:
        for number in range(good if kind == GOOD else count):
            verdict, words = outcome(kind, seed, number, model)
            row = totals.setdefault(kind, [0, 0, 0, 0])
            row[("right", "not visible", "nothing named", "wrong").index(verdict)] += 1
            if options.wrong and verdict not in ("right", "not visible"):
                print(f"  {kind} {number}: {verdict}: {words}")
    _table(totals, clock.process_time() - start)
    return 0


def outcome(kind: str, seed: int, number: int, model: FieldModel) -> tuple[str, str]:
    """The verdict on one record, and what was said of it."""
    case = fly(stream(seed, f"traps.{kind}.{number}"), model, kind)
    wanted = corrupt(case, kind)
    with TemporaryDirectory() as folder:
        path = write(case, Path(folder) / "record.csv")
        try:
            report = check_file(path, model, tle=case.tle_file(Path(folder)))
        except BadInput as error:
            hit = wanted is not None and wanted.refusal is not None and re.search(wanted.refusal, str(error))
            return ("right" if hit else "wrong"), f"{case.label}: refused: {error}"
    return _verdict(report, wanted, case)


def _verdict(report: CheckReport, wanted: Wanted | None, case: Case) -> tuple[str, str]:
    traps = list(report.traps)
    words = f"{case.label}: " + " | ".join(f"{trap.code}: {trap.text}" for trap in traps)
    if wanted is None:
        return ("wrong" if traps else "right"), words
    if not traps:
        said = [note.text for note in report.notes if wanted.unseen and re.search(wanted.unseen, note.text)]
        return ("not visible" if said else "nothing named"), f"{case.label}: " + " | ".join(said)
    right = len(traps) == 1 and traps[0].code in wanted.codes and re.search(wanted.words, traps[0].text)
    return ("right" if right else "wrong"), f"{words} (wanted {wanted.codes} {wanted.words})"


def _table(totals: dict[str, list[int]], seconds: float) -> None:
    print(f"{'kind':34s} {'right':>6s} {'unseen*':>8s} {'silent':>7s} {'wrong':>6s}  of")
    for kind, row in totals.items():
        print(f"{kind:34s} {row[0]:6d} {row[1]:8d} {row[2]:7d} {row[3]:6d}  {sum(row)}")
    corrupted = np.array([row for kind, row in totals.items() if kind != GOOD and not KINDS[kind].apart])
    if len(corrupted):
        right, n = int(corrupted[:, 0].sum()), int(corrupted.sum())
        print(f"named right: {right} of {n} = {100 * right / n:.1f} %  (the rows 'seconds' apart)")
    if GOOD in totals:
        row = totals[GOOD]
        print(f"good records flagged: {sum(row) - row[0]} of {sum(row)} = {100 * (1 - row[0] / sum(row)):.2f} %")
    print("* the report says that a shift of this size would not show in this record")
    print(f"{seconds:.0f} s of processor time")


def _commit_seed() -> int:
    """Of the commit; 1 where there is none."""
    command = ["git", "rev-parse", "--verify", "--quiet", "HEAD"]
    sha = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout
    return int(sha[:8] or "1", 16)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="default: made of the commit")
    parser.add_argument("--kind", action="append", choices=list(KINDS), help="only these")
    parser.add_argument("--count", type=int, default=-(-500 // sum(not kind.apart for kind in KINDS.values())))
    parser.add_argument("--good", type=int, default=250)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--wrong", action="store_true", help="print what was said where it was wrong")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
