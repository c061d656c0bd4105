"""How often the diagnosis is right about effects that it does not know of.

    python benchmarks/withheld.py [--population NAME ...] [--count N|small] [--jobs N] [--out DIR] [--chaos FILE]
    python benchmarks/withheld.py --tune SEED ...     any other seed (or --seed), on any tree; nothing is logged
    python benchmarks/withheld.py --out DIR --score   score what is there again
    ... --score --docs                                and write docs/withheld.md with its figure
    ... --score --fit                                 and write the table of what is stated of a name, from a tuning run
    ... --closing                                     and put the closed scenarios to the test: twin, loop, control
    ... --rival                                       and let the rival answer the same questions

A run makes its cases by forward models of its own, seals the answers and prints their SHA-256, puts the questions
through `fluxtwin.diagnose`, then opens the answers and prints the table. Its seed is `int(sha[:12], 16)` of the
commit; a tree that differs from the commit is refused; a row is added to benchmarks/withheld.log when it is scored.
Stopped runs go on where they were when started again with the same --out, and populations may be run one by one into
the same folder: a case depends on seed, population and number alone. Loops and rivals take the first cases only.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import json
import signal
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from withheld_cases import laws, laws_judged, laws_rival, limits, null_regimes, page, printed, score, stated, store
from withheld_cases.ask import ask, ask_rival
from withheld_cases.cases import KINDS, LAWS, PLAIN, POPULATIONS, SENSED, TWO, identity
from withheld_cases.control import wrong
from withheld_cases.joining import JOINING, NAMES
from withheld_cases.loop import again
from withheld_cases.make import make
from withheld_cases.outside import OUTSIDE, WHY
from withheld_cases.shapes import SHAPES
from withheld_cases.twins import judge
from withheld_cases.worlds import REGIMES

from fluxtwin.sim.base import files

ROOT = Path(__file__).resolve().parent.parent
FROZEN = {
    "nulls": 2000,
    "nulls_off": 60,
    "singles": 5 * len(PLAIN),
    "faint": 2 * len(PLAIN),
    "pairs": 60,
    "triples": 30,
    "shapes": 3 * len(SHAPES),
    "outside": 4 * len(OUTSIDE),
    "new_singles": 4 * len(JOINING),
    "sensed": 10 * len(SENSED),
    "torque_nulls": 40,
    "torques": 24,
    "torque_pairs": 12,
    "nulls_undeclared": 300,
    "singles_undeclared": 3 * len(PLAIN),
    "passes_only": 100,
    "short": 100,
    "coarse": 100,
    "limits": 100 * len(limits.SIZED),
    "undetermined": 40,
    "laws": 8 * len(laws.FORMS),
    "laws_nulls": 100,
    "laws_catalogue": 60,
    "outside_two": 2 * len(OUTSIDE),
    "singles_two": 2 * len(PLAIN),
}
"""Cases of a frozen run."""
SMALL = 0
"""`--count small`: as many cases as a population has kinds."""
RIVAL = {"nulls": 200, "singles": 40, "pairs": 15, "triples": 6, "laws": 22, "laws_nulls": 11}
"""How many of them the rival is asked, the first ones."""
LOOPS = {"singles": len(PLAIN)}
"""How many of them are put to the test on another day."""
SECONDS = {
    "nulls": 3.5,
    "nulls_off": 3.5,
    "singles": 6.5,
    "faint": 5.5,
    "pairs": 9.5,
    "triples": 12.0,
    "shapes": 6.0,
    "outside": 10.0,
    "new_singles": 8.0,
    "sensed": 5.0,
    "rival": 2.0,
    "loops": 10.0,
    "torque_nulls": 5.0,
    "torques": 22.0,
    "torque_pairs": 22.0,
    "nulls_undeclared": 8.0,
    "singles_undeclared": 8.0,
    "passes_only": 11.0,
    "short": 3.0,
    "coarse": 5.0,
    "limits": 13.0,
    "undetermined": 3.0,
    "laws": 12.0,
    "laws_nulls": 5.0,
    "laws_catalogue": 8.0,
    "outside_two": 7.0,
    "singles_two": 3.0,
}
"""Mean CPU time of one answer on a busy core of 2026 (tuning rounds), to tell how long a run will take."""
DOCS = ROOT / "docs"
QUICK = {"tune": 1, "population": ["nulls", "singles", "undetermined"], "count": 1}

Plan = list[tuple[str, int]]


def main() -> int:
    """Make, seal, ask, open, score."""
    given = _arguments()
    if given.list:
        return _tell()
    if given.quick:
        with TemporaryDirectory() as folder:
            _run(argparse.Namespace(**(vars(given) | QUICK | {"out": Path(folder)})))
        return 0
    return _run(given)


def _run(given: argparse.Namespace) -> int:
    sha, dirty = ("", True) if given.tune is not None or given.score else store.commit_of(ROOT)
    if given.tune is None and not given.score and dirty:
        raise SystemExit("the tree differs from the commit: commit first, or tune with --tune SEED")
    out = given.out or Path(f"withheld-{'tune' if given.tune is not None else sha[:12]}-results")
    here = store.Store(out)
    if given.score:
        return _score(here, _identities(here), docs=given.docs, fit=given.fit)
    seed = int(sha[:12], 16) if given.tune is None else given.tune
    plan = _plan(given.population, given.count)
    names = [identity(seed, *one) for one in plan]
    try:
        here.prepared().agree({"seed": seed, "commit": None if given.tune is not None else sha, "chaos": given.chaos})
        sealed = _answered(here, seed, plan, given)
    except KeyboardInterrupt:
        here.tidy()
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    status = _score(here, names)
    if given.tune is None:
        row = {"date": datetime.now(UTC).isoformat(timespec="seconds"), "commit": sha, "seed": seed, "sealed": sealed}
        row |= {
            "counts": _counts(plan),
            "chaos": given.chaos is not None,
            "cases": len(names),
            "rows": [one for one in score.table_rows(here, names) if one["of"]],
        }
        store.append_log(row)
    return status


def _answered(here: store.Store, seed: int, plan: Plan, given: argparse.Namespace) -> str:
    """Everything made, sealed and asked; the seal."""
    names = [identity(seed, *one) for one in plan]
    root = str(here.root)
    print(f"about {_minutes(plan, given):.0f} CPU minutes", file=sys.stderr, flush=True)
    _all("made", make, [(root, seed, *one, given.chaos) for one in plan], given.jobs)
    sealed = here.seal(names)
    print(f"answers sealed: sha256 {sealed}", flush=True)
    waiting = [name for name in names if here.has("asked", name) and not here.has("said", name)]
    _all("asked", ask, [(root, name) for name in waiting], given.jobs)
    sizes = [name for name, (population, _) in zip(names, plan, strict=True) if population == "limits"]
    _all("printed sizes flown", printed.again, [(root, name) for name in sizes], given.jobs)
    flown = [name for name, (population, _) in zip(names, plan, strict=True) if population == "laws"]
    _all("laws flown on another day", laws_judged.judge, [(root, name) for name in flown], given.jobs)
    if given.rival:
        if any(population in LAWS for population, _ in plan) and not laws_rival.installed():
            print(laws_rival.MISSING, file=sys.stderr, flush=True)
        some = [name for name in _first(seed, plan, RIVAL) if here.has("asked", name)]
        _all("rival asked", ask_rival, [(root, name) for name in some], given.jobs)
    if given.closing:
        for word, work in (("twins judged", judge), ("loops closed", again), ("controls run", wrong)):
            _all(word, work, [(root, name) for name in _first(seed, plan, LOOPS)], given.jobs)
    return sealed


def _first(seed: int, plan: Plan, most: dict[str, int]) -> list[str]:
    """The first cases of each population, in the plan's order."""
    return [identity(seed, *one) for one in plan if one[1] < most.get(one[0], 0)]


def _minutes(plan: Plan, given: argparse.Namespace) -> float:
    """CPU time that a whole run takes."""
    total = sum(SECONDS[population] for population, _ in plan)
    total += SECONDS["rival"] * len(_first(0, plan, RIVAL)) * given.rival
    return (total + SECONDS["loops"] * len(_first(0, plan, LOOPS)) * given.closing) / 60.0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--population", nargs="+", choices=POPULATIONS, default=list(POPULATIONS))
    parser.add_argument(
        "--count", type=_count, help="cases of each population, or small: each kind once (default: a frozen run's)"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, help="folder of the run")
    parser.add_argument("--chaos", metavar="FILE", help="half of the truths (no nulls) have this richer field")
    parser.add_argument("--tune", "--seed", type=int, metavar="SEED", help="any other seed; nothing is logged")
    parser.add_argument("--list", action="store_true", help="tell the populations and the outside set, and stop")
    parser.add_argument("--score", action="store_true", help="only score what is in --out")
    parser.add_argument(
        "--closing", action="store_true", help="run the closed scenarios: twin, loop on another day, control"
    )
    parser.add_argument("--quick", action="store_true", help="a null, a single and a fast spinner, to see that it runs")
    parser.add_argument("--docs", action="store_true", help="with --score: write the page and its figure")
    parser.add_argument("--fit", action="store_true", help="with --score: write the table of what is stated of a name")
    parser.add_argument("--rival", action="store_true", help="put the questions to the rival as well")
    given = parser.parse_args()
    if given.score and given.out is None:
        parser.error("--score needs --out DIR")
    if (given.docs or given.fit) and not given.score:
        parser.error("--docs and --fit go with --score")
    return given


def _count(text: str) -> int:
    """A count; of `small` none, which no number stands for. Raises ArgumentTypeError."""
    if text == "small":
        return SMALL
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: a number, at least 1, or small")
    return int(text)


def _tell() -> int:
    print("cases of a frozen run: " + ", ".join(f"{name} {count}" for name, count in FROZEN.items()))
    print("other shapes: " + ", ".join(SHAPES))
    print("effects that join the table: " + ", ".join(f"{kind} ({name})" for kind, name in NAMES.items()))
    print("outside the catalogue, and why no entry can express it:")
    for name, why in WHY.items():
        print(f"  {name}: {why}")
    return 0


def _plan(populations: Sequence[str], count: int | None) -> Plan:
    def many(name: str) -> int:
        if count == SMALL:
            return len(null_regimes.REGIMES if name == "nulls" else KINDS.get(TWO.get(name, name), REGIMES))
        return FROZEN[name] if count is None else count

    return [(name, number) for name in populations for number in range(many(name))]


def _counts(plan: Plan) -> dict[str, int]:
    return {name: sum(one == name for one, _ in plan) for name in dict.fromkeys(one for one, _ in plan)}


def _all(word: str, work: Callable[..., str], jobs: Sequence[tuple[Any, ...]], processes: int) -> None:
    """Run all, in processes; a line now and then."""
    began = time.time()
    if not jobs:
        return
    pool = ProcessPoolExecutor(processes, initializer=_quiet)
    try:
        waiting = [pool.submit(work, *job) for job in jobs]
        for done, one in enumerate(as_completed(waiting), start=1):
            one.result()
            if done % max(1, len(jobs) // 40) == 0 or done == len(jobs):
                took = time.time() - began
                more = f", about {took / done * (len(jobs) - done):.0f} s to go" if done < len(jobs) else ""
                print(f"{word} {done} of {len(jobs)}, {took:.0f} s{more}", file=sys.stderr, flush=True)
    finally:
        pool.shutdown(cancel_futures=True)


def _quiet() -> None:
    """A worker leaves the interrupt to the parent, which lets it finish what it is at."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _identities(here: store.Store) -> list[str]:
    return sorted(path.stem for path in (here.root / "sealed").glob("*.json"))


def _score(here: store.Store, names: Sequence[str], *, docs: bool = False, fit: bool = False) -> int:
    text, record = score.report(here, names)
    if fit:
        run = json.loads((here.root / "run.json").read_text(encoding="utf-8"))
        stated.write(score.opened(here, names)[0], run["seed"], store.commit_of(ROOT)[0])
    if docs:
        run = json.loads((here.root / "run.json").read_text(encoding="utf-8"))
        page.write(*score.opened(here, names), run, DOCS)
    files.write_json(here.root / "score.json", record)
    files.write_text(here.root / "score.md", text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
