"""What a user may trust in, measured: one table.

python -m benchmarks.trust                 all of it: several hours; the table also goes to docs/trust.md
python -m benchmarks.trust --quick         a little of each: does it still hold?
python -m benchmarks.trust --mutants 200000 --only hostile
python -m benchmarks.trust --only tests --record FILE    what benchmarks/mutants.py has found about the tests
python -m benchmarks.trust --only reached --coverage FILE   what `coverage json` has found (CONTRIBUTING.md)
python -m benchmarks.trust --only sigmas --sigmas FILE      what benchmarks/sigmas.py has found about the calibrations
python -m benchmarks.trust --only answers    false alarms and printed sizes, from the log of benchmarks/withheld.py
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .. import mutants
from . import disk, hostile, orders, repeat
from .harness import Row

UNNOTICED = "small faults in sim, calib and gap that the nearest tests do not notice"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "trust.md"
LIST = PAGE.parent / "design" / "unnoticed.md"
LOG = Path(__file__).resolve().parents[1] / "withheld.log"
LISTED = """# Small faults that no test notices

`benchmarks/mutants.py` puts one small fault at a time into the product and runs the nearest tests. These are the
faults of the newest run that no test noticed ([their share](../trust.md)), with file, function, change and line:

"""
ABOUT = """# Robustness tests

`python -m benchmarks.trust` makes this table. It damages files, fills disks, stops processes and runs the program in
unusual places, and counts everything that should not have happened. Each trial runs in a subprocess, alone or with
others; a crash by a signal is noticed.
[SECURITY.md](../SECURITY.md) says what is refused, with the limits.

- *While a file is written*: the old or the new file must be whole, with a message and exit 2, and nothing else left.
- *Commit*: the one that was tried. A row that was not tried again keeps its own.
- The rows on tests: `benchmarks/mutants.py` puts one small fault at a time into the product
  ([those not noticed](design/unnoticed.md)), and coverage.py counts what they reach, compiled code run as Python.
- *An older processor*: the instructions of newer ones are switched off in OpenBLAS and numpy.
- The rows on answers are counted from the newest frozen runs of `benchmarks/withheld.py` and from `benchmarks/sigmas.py`.

| trial | how many | faults | wanted | found | commit |
|---|---|---|---|---|---|
"""


def sections(options: argparse.Namespace) -> dict[str, Callable[[Path], list[Row]]]:
    """The parts by name."""
    quick = options.quick
    return {
        "hostile": lambda place: hostile.readers(place, options.mutants, options.slow),
        "commands": lambda place: [hostile.commands(place, options.commands)],
        "bits": lambda place: [hostile.bits(place, options.bits)],
        "bombs": lambda place: [hostile.bombs(place, 20_000_000 if quick else 200_000_000)],
        "disk": lambda place: disk.rows(place, options.disk),
        "texts": lambda place: [repeat.texts(place, quick=quick)],
        "same bits": lambda place: repeat.same_bits(place, quick=quick),
        "places": lambda place: [repeat.places(place, quick=quick)],
        "orders": lambda place: [
            orders.orders(
                place,
                runs=options.runs,
                loaded=options.loaded,
                tests="tests/sim/base/test_seals.py" if quick else "tests",
            )
        ],
        **({"tests": lambda place: [unnoticed(options.record)]} if options.record else {}),
        "answers": lambda place: [healthy(), sizes()],
        **({"sigmas": lambda place: [pulls(options.sigmas)]} if options.sigmas else {}),
        **({"reached": lambda place: reached(options.coverage)} if options.coverage else {}),
    }


def unnoticed(record: Path) -> Row:
    """What no test notices of the small faults of a record."""
    answers = mutants.recorded(record).values()
    row = Row(UNNOTICED, len(answers), reach=f"{100.0 * (1.0 - mutants.WANTED):.0f} % at most")
    for mutant, _, last in answers:
        if not last:
            row.fault(f"`{mutant.file}`, {mutant.function}, {mutant.change}: `{mutant.right}`")
    seed = json.loads(record.read_text(encoding="utf-8").splitlines()[0])["seed"]
    first = sum(not one.first for one in answers)
    row.note = f"drawn with seed {seed}; {first} when first tried, before tests were written for them"
    return row


def reached(report: Path) -> list[Row]:
    """Statements, branches and messages of sim, calib and gap that no test reached, from the JSON of coverage.py."""
    found = json.loads(report.read_text(encoding="utf-8"))["files"]
    row = Row("statements and branches of sim, calib and gap that no test reaches", reach="5 % at most of each")
    said = Row("messages of errors in sim, calib and gap that no test produces")
    shares: dict[str, list[int]] = {}
    for name, file in found.items():
        counts, total = file["summary"], shares.setdefault(name.split("/")[0], [0, 0])
        total[0] += counts["covered_lines"] + counts["covered_branches"]
        total[1] += counts["num_statements"] + counts["num_branches"]
        row.faults += [f"{name}: {place}" for place in (*file["missing_lines"], *file["missing_branches"])]
        for one in ast.walk(ast.parse((PAGE.parents[1] / name).read_text(encoding="utf-8"))):
            if isinstance(one, ast.Raise) and isinstance(one.exc, ast.Call):
                said.trials += 1
                if not set(range(one.lineno, (one.end_lineno or 0) + 1)) & set(file["executed_lines"]):
                    said.fault(f"{name}: {one.lineno}: {ast.unparse(one.exc)}")
    row.trials = sum(whole for _, whole in shares.values())
    row.note = ", ".join(f"{name} {100.0 * part / whole:.1f} % reached" for name, (part, whole) in shares.items())
    return [row, said]


def healthy() -> Row:
    """False alarms on perfect flights."""
    row, found = _logged(
        "nulls", "no gap on a perfect simulation", "perfect flights in which the diagnosis finds a gap", "1 % at most"
    )
    alarms = {
        one["figure"].split(": ")[1]: one["right"] for one in found if one["figure"].startswith("false alarms on")
    }
    named = ", ".join(f"{name}: {count}" for name, count in alarms.items() if count)
    row.note = f"{len(alarms)} kinds of flight" + (f"; {named}" if named else "")
    return row


def sizes() -> Row:
    """Printed smallest sizes, flown: are they detected nine times in ten?"""
    figure = "printed smallest size, all of them: detected"
    row, found = _logged(
        "limits", figure, "smallest sizes that a diagnosis printed and that are not detected when flown", "4 to 16 %"
    )
    each = {one["figure"].split(",")[0].split()[-1]: one for one in found if one["figure"].endswith("flown: detected")}
    row.note = ", ".join(f"{name} {one['right']} of {one['of']} detected" for name, one in each.items())
    return row


def _logged(population: str, figure: str, name: str, reach: str) -> tuple[Row, list[dict[str, Any]]]:
    """A row with what the newest frozen run of a population says of a figure, and all that it says."""
    runs = [json.loads(line) for line in LOG.read_text(encoding="utf-8").splitlines()]
    newest = [run for run in runs if population in run["counts"]][-1]
    found = next(one for one in newest["rows"] if one["figure"] == figure)
    row = Row(name, found["of"], reach=reach, commit=newest["commit"][:7])
    row.faults = [figure] * (found["of"] - found["right"])
    return row, newest["rows"]


def pulls(report: Path) -> Row:
    """Cases of benchmarks/sigmas.py that miss a limit."""
    from .. import sigmas  # sets the threads of this process to one

    cases = json.loads(report.read_text(encoding="utf-8"))["cases"]
    row = Row("cases of calibrations whose sigmas miss a limit", len(cases), reach="0 cases")
    for one in cases:
        if missed := sigmas.misses(one):
            row.fault(f"{one['words']}: {', '.join(missed)}")
    fewest = min(one["seeds"] for one in cases)
    row.note = f"at least {fewest} records each; [which, and by how much](calibration.md#the-sigmas)"
    return row


def measured(options: argparse.Namespace) -> Iterator[Row]:
    """The rows, one after the other."""
    for name, part in sections(options).items():
        if options.only and name not in options.only:
            continue
        with TemporaryDirectory(prefix="fluxtwin-trust-") as folder:
            for row in part(Path(folder)):
                row.commit = row.commit or _commit()
                yield row


def _commit() -> str:
    """Of this checkout; nothing where it has none."""
    command = ["git", "rev-parse", "--verify", "--quiet", "--short=7", "HEAD"]
    return subprocess.run(command, cwd=PAGE.parent, capture_output=True, text=True, check=False).stdout.strip()


def as_line(row: Row) -> str:
    """One line of the table in Markdown."""
    return f"| {row.name} | {row.trials} | {len(row.faults)} | {row.reach} | {row.note} | {row.commit} |"


def page(rows: list[Row], in_part: bool) -> str:
    """The page with these rows. in_part: with the other rows that it has already, too."""
    old = PAGE.read_text(encoding="utf-8").splitlines() if in_part and PAGE.exists() else []
    lines = {line.split("|")[1].strip(): line for line in old if line.startswith("| ") and "| how many |" not in line}
    lines |= {row.name: as_line(row) for row in rows}
    return ABOUT + "\n".join([*lines.values(), ""])


def main() -> int:
    """Measure, print and write; exit status 1 where a fault was found."""
    if sys.platform == "win32":
        sys.exit("this needs fork and signals of POSIX")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a little of each; docs/trust.md stays")
    parser.add_argument("--mutants", type=int, help="damaged files through the fast readers, together")
    parser.add_argument("--slow", type=int, help="damaged files through each slow reader")
    parser.add_argument("--commands", type=int, help="damaged files through the commands")
    parser.add_argument("--bits", type=int, help="flipped bits")
    parser.add_argument("--disk", type=int, help="faults while a file is written")
    parser.add_argument("--runs", type=int, help="runs of the tests in random order")
    parser.add_argument("--loaded", type=int, help="how many of these have busy processes beside them")
    parser.add_argument("--only", action="append", help="this part alone; repeatable")
    parser.add_argument("--record", type=Path, metavar="FILE", help="what benchmarks/mutants.py wrote")
    parser.add_argument("--coverage", type=Path, metavar="FILE", help="what `coverage json` wrote")
    parser.add_argument("--sigmas", type=Path, metavar="FILE", help="what benchmarks/sigmas.py wrote")
    parser.add_argument("--json", type=Path, help="write the rows here")
    options = parser.parse_args()
    sizes = {
        "mutants": (50_000, 380),
        "slow": (2_000, 4),
        "commands": (400, 34),
        "bits": (1_500, 120),
        "disk": (300, 12),
        "runs": (10, 1),
        "loaded": (4, 0),
    }
    for name, (full, quick) in sizes.items():
        if getattr(options, name) is None:
            setattr(options, name, quick if options.quick else full)
        least = 0 if name == "loaded" else 1
        if getattr(options, name) < least:
            parser.error(f"--{name} is {least} or more")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rows = []
    for row in measured(options):
        rows.append(row)
        print(
            f"{row.name}: {row.trials} trials, {len(row.faults)} faults ({row.seconds:.0f} s). {row.note}", flush=True
        )
        for fault in row.faults[:10]:
            print(f"    {fault}", flush=True)
    if not options.quick:
        PAGE.write_text(page(rows, bool(options.only)), encoding="utf-8")
        for row in (one for one in rows if one.name == UNNOTICED):
            LIST.write_text(LISTED + "\n".join([*(f"- {fault}" for fault in row.faults), ""]), encoding="utf-8")
    record: dict[str, Any] = {"rows": [vars(row) for row in rows], "faults": sum(len(row.faults) for row in rows)}
    if options.json is not None:
        options.json.write_text(json.dumps(record, indent=1), encoding="utf-8")
    print(f"{sum(row.trials for row in rows)} trials, {record['faults']} faults")
    return 1 if record["faults"] else 0


if __name__ == "__main__":
    sys.exit(main())
