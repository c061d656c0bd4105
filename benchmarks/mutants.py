"""Do the tests bite? Small faults put into the product one at a time, each against the tests that call what is changed.

    python benchmarks/mutants.py --map MAP --number 300 --seed 1 --record FILE   an hour or two; begun again, it goes on
    python benchmarks/mutants.py --map MAP --record FILE --again                 what survived, against the tests of now
    python benchmarks/mutants.py --quick                                         three of them: does it still run?

A mutant is one expression of `sim`, `calib` or `gap`, changed in one of the ways of `changes`. Only functions that give or
fill numbers are changed, and nothing in what they raise or say. Mutants are drawn by a seed: every package in turn, and
there the modules and kinds of change met least. MAP says which functions each test calls; it is made once, in half an hour,
where the file is not there. The tests that call the function (or, for kernels that only kernels call, the file) are run in
the order of seconds times functions called, until one fails or BUDGET_S would be spent. One that fails with the mutant must
pass without it. What ends in no LIMIT_S of processor time is noticed where the same tests end without it in half of that.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import cProfile
import json
import os
import py_compile
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from types import CodeType
from typing import Any, NamedTuple

import pytest

from fluxtwin.sim.base.kernel_cache import cache_folder

ROOT = Path(__file__).resolve().parent.parent
WANTED = 0.95
MOST = 4
"""Mutants of a module, at most."""
FOLDERS = ("sim/", "calib/", "gap/")
SUITE = ("sim", "reference", "gap", "calib", "api")
FIRST_S, BUDGET_S, LIMIT_S = 3.0, 15.0, 240
"""Seconds of tests that are run first, of all that are run, and of processor time after which a mutant has no end."""
NUMBERS = re.compile(r"[fF]loat|[aA]rray|Rotation|datetime64")
NO_NUMBERS = re.compile(r"\b(str|bool|int|bytes|Path|Any|Callable|Findings?|Header|BadInput)\b|^(None|Self)$")
SAID = ("where", "wanted", "tol", "atol", "rtol", "rcond")
"""Arguments by name that are words of messages, or tolerances."""
COUNT = re.compile(r"n|rows|samples|count|rank|dof|freedom\w*|len")
INSTANT = re.compile(r"(\w*_)?(t|dt|time|tau|step|seconds|period|delay|lag)_s|seconds")
NOISE = re.compile(r"\w*(noise|sigma)\w*")
PAIRS = ("roll pitch", "min max", "minimum maximum", "argmin argmax", "nanmin nanmax")
OTHER = {a: b for pair in PAIRS for a, b in (pair.split(), pair.split()[::-1])}
BOUND = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">"}
SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}


class Mutant(NamedTuple):
    """One expression of a file, from `start` to `end` (characters), and what stands there instead."""

    file: str
    line: int
    function: str
    change: str
    right: str
    wrong: str
    start: int
    end: int


def changes(node: ast.AST, returned: str) -> Iterator[tuple[str, str]]:
    """The ways in which an expression of a function that returns this may be wrong: the name, the wrong text."""
    match node:
        case ast.BinOp(a, ast.Add() | ast.Sub() as op, b) if not (_is_list(a) or _is_list(b)):
            yield "sign", f"({_text(a)}) {'-' if isinstance(op, ast.Add) else '+'} ({_text(b)})"
            if not isinstance(b, ast.Constant):
                yield "dropped term", _text(a)
    match node:
        case ast.BinOp(a, op, b) if type(op) in SIGNS:
            for change, kind, wrong in (
                ("one second", INSTANT, "({}) + 1.0"),
                ("noise x 1.05", NOISE, "1.05 * ({})"),
                ("off by one", COUNT, "({}) - 1"),
            ):
                for side in (one for one in (a, b) if kind.fullmatch(_name(one))):
                    x, y = (f"({wrong.format(_text(one)) if one is side else _text(one)})" for one in (a, b))
                    yield change, f"{x} {SIGNS[type(op)]} {y}"
        case ast.UnaryOp(ast.USub(), a) if not isinstance(a, ast.Constant):
            yield "sign", _text(a)
        case ast.Compare(a, [op], [b]) if type(op) in BOUND and (
            COUNT.fullmatch(_name(a)) or COUNT.fullmatch(_name(b))
        ):
            yield "< for <=", f"({_text(a)}) {BOUND[type(op)]} ({_text(b)})"
        case ast.Call(ast.Attribute(_, "radians" | "degrees" | "deg2rad" | "rad2deg"), [a]):
            yield "degrees for radians", _text(a)
        case ast.Call(ast.Attribute(_, "normal" | "standard_normal")):
            yield "noise x 1.05", f"1.05 * {_text(node)}"
        case ast.Call(ast.Attribute(a, "inv"), []) | ast.Attribute(a, "T", ast.Load()):
            yield "transposed", _text(a)
        case ast.Call(ast.Attribute(a, name), given, named) if name in OTHER:
            yield "min for max", _text(ast.Call(ast.Attribute(a, OTHER[name]), given, named))
        case ast.Call(ast.Name(name), given, named) if name in OTHER:
            yield "min for max", _text(ast.Call(ast.Name(OTHER[name]), given, named))
        case ast.Subscript(a, ast.Tuple([*first, ast.Constant(0 | 1 | 2 as k)])) if first:
            yield "axes exchanged", _text(ast.Subscript(a, ast.Tuple([*first, ast.Constant((k + 1) % 3)])))
        case ast.Attribute(a, name, ast.Load()) if turned := [word for word in ("roll", "pitch") if word in name]:
            yield "axes exchanged", f"{_text(a)}.{name.replace(turned[0], OTHER[turned[0]])}"
        case ast.Name(name, ast.Load()) if "_PER_" in name:
            yield "no change of unit", "1.0"
        case ast.Return(ast.expr() as a) if re.match("float|FloatArray", returned) and not _is_plain(a):
            yield "1 % scale", f"return 1.01 * ({_text(a)})"
        case ast.Assign([ast.Subscript() as a], ast.BinOp(_, ast.Mult() | ast.Div() | ast.MatMult()) as b):
            yield "1 % scale", f"{_text(a)} = 1.01 * ({_text(b)})"


_text = ast.unparse


def _name(node: ast.expr) -> str:
    """Of a variable or attribute; `len` for a length."""
    match node:
        case ast.Call(ast.Name("len")) | ast.Subscript(ast.Attribute(_, "shape")) | ast.Attribute(_, "size"):
            return "" if _text(node).startswith("self.") else "len"
        case ast.Name(name) | ast.Attribute(_, name):
            return name
    return ""


def _is_list(node: ast.expr) -> bool:
    listed = isinstance(node, ast.List | ast.ListComp | ast.Tuple | ast.JoinedStr)
    return listed or isinstance(getattr(node, "value", None), str)


def _is_plain(node: ast.expr) -> bool:
    """What stays what it was when scaled, or is no number of its own: constants, zeros, nothing."""
    return isinstance(node, ast.Constant) or bool(re.search(r"zeros|empty|nan|inf\b|None", _text(node)))


def _gives_numbers(function: ast.FunctionDef) -> bool:
    """Numbers, or an object made of them, are what it returns or fills: not words, decisions, files or nothing."""
    given = _text(function.returns) if function.returns else ""
    kernel = any(re.match("kernel|part", _text(one)) for one in function.decorator_list)
    return kernel or bool(NUMBERS.search(given)) or not NO_NUMBERS.search(given)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """All mutants of a module."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)

    def place(row: int, column: int) -> int:
        return sum(map(len, lines[: row - 1])) + len(lines[row - 1].encode()[:column].decode())

    def walk(node: Any, returned: str | None, function: str = "") -> Iterator[Mutant]:
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr) or getattr(node, "arg", None) in SAID:
            return
        if isinstance(node, ast.Call) and re.search(r"isnan|isfinite", _text(node.func)):
            return  # a row is whole or missing, whichever component is asked
        if isinstance(node, ast.FunctionDef):
            returned, function = _text(node.returns) if node.returns and _gives_numbers(node) else None, node.name
        elif returned is not None and isinstance(node, ast.expr | ast.stmt):
            for change, wrong in changes(node, returned):
                start, end = place(node.lineno, node.col_offset), place(node.end_lineno, node.end_col_offset)
                right, wrong = text[start:end], wrong if isinstance(node, ast.stmt) else f"({wrong})"
                if f"{right[:-2]} + {right}" not in text:  # a matrix made symmetric: with or without .T, the same
                    file = path.relative_to(ROOT).as_posix()
                    yield Mutant(file, node.lineno, function, change, right, wrong, start, end)
        for child in node.body if isinstance(node, ast.FunctionDef) else ast.iter_child_nodes(node):
            yield from walk(child, returned, function)

    return walk(ast.parse(text), None)


def drawn(number: int, seed: int) -> list[Mutant]:
    """So many mutants, from every package in turn."""
    packages: dict[Path, list[Mutant]] = defaultdict(list)
    for path in sorted(path for folder in ("sim", "calib", "gap") for path in (ROOT / folder).rglob("[!_]*.py")):
        if path.parent.name != "data":  # how packaged files were made
            packages[path.parent] += mutants_of(path)
    rng, met, chosen = random.Random(seed), Counter[str](), list[Mutant]()
    for package in packages.values():
        rng.shuffle(package)
    while len(chosen) < number and any(packages.values()):
        for package in rng.sample(sorted(packages), len(packages)):
            left = packages[package] = [one for one in packages[package] if met[one.file] < MOST]
            if left and len(chosen) < number:
                chosen.append(least := min(left, key=lambda one: (met[one.file], met[one.change])))
                left.remove(least)
                met.update((least.file, least.change))
    return chosen


Fixture = tuple[str, str]
"""Where it is seen, and its name: two files may have one of the same name."""


def _fixture(definition: Any) -> Fixture:
    return definition.baseid, definition.argname


class Calls:
    """A plugin of pytest that writes, one line of JSON a test, which functions of the product it calls and its seconds."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.profile = cProfile.Profile(subcalls=False, builtins=False)
        self.made: dict[Fixture, set[str]] = defaultdict(set)
        self.cost, self.begun = dict[Fixture, float](), set[Fixture]()

    def called(self) -> Counter[str]:
        """How often since the test began: `FILE NAME`; compiled kernels too, where they are called from outside."""
        counts = Counter[str]()
        for one in self.profile.getstats():
            if isinstance(one.code, CodeType) and str(ROOT) in one.code.co_filename:
                counts[f"{one.code.co_filename} {one.code.co_name}".removeprefix(f"{ROOT}/")] += one.callcount
        return counts

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        """What a fixture calls and takes counts for every test that asks for it, not only for the first."""
        began, before, fixture = process_time(), self.called(), _fixture(fixturedef)
        try:
            return (yield)
        finally:
            self.made[fixture] |= set(self.called() - before)  # not what others called before it
            self.cost[fixture] = process_time() - began
            self.begun.add(fixture)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
        self.profile.clear()
        self.begun.clear()
        began = process_time()
        self.profile.enable()
        try:
            return (yield)
        finally:
            self.profile.disable()
            fixtures = [_fixture(one[-1]) for one in item._fixtureinfo.name2fixturedefs.values()]
            called = set(self.called()).union(*(self.made[one] for one in fixtures))
            functions = sorted(one for one in called if one.startswith(FOLDERS) and "<" not in one)
            seconds = process_time() - began
            seconds += sum(self.cost.get(one, 0.0) for one in fixtures if one not in self.begun)
            record = {"test": item.nodeid, "seconds": seconds, "functions": functions}
            with self.file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")


class Tests:
    """Which tests call a function, by the lines of `Calls`."""

    def __init__(self, file: Path) -> None:
        self.of: dict[str, list[tuple[float, float, str]]] = defaultdict(list)
        for one in map(json.loads, file.read_text(encoding="utf-8").splitlines()):
            rank = (one["seconds"] + 0.01) * len(one["functions"])
            for name in {*one["functions"], *(name.split()[0] for name in one["functions"])}:
                self.of[name].append((rank, one["seconds"], one["test"]))

    def nearest(self, mutant: Mutant) -> tuple[list[str], list[str]]:
        """The quick ones that call little else, and the others by file, until BUDGET_S is spent."""
        found = self.of.get(f"{mutant.file} {mutant.function}") or self.of.get(mutant.file, [])
        spent, first, others = 0.0, list[str](), defaultdict[str, list[str]](list)
        for _, seconds, test in sorted(found):
            if spent + seconds < BUDGET_S:
                (first if spent < FIRST_S else others[test.split("::")[0]]).append(test)
                spent += seconds
        return first, [test for tests in others.values() for test in tests]


class Checkout:
    """A copy of the checkout in which tests are run: its own code is imported in place of what is installed."""

    def __init__(self, folder: Path, tests: Tests) -> None:
        self.root, self.tests = folder / "fluxtwin", tests
        ignored = shutil.ignore_patterns(".git", ".types", "build", "__pycache__", "*-results", ".venv")
        shutil.copytree(ROOT, self.root, ignore=ignored)
        kernels = folder / "kernels"  # not where sound ones are kept
        shutil.copytree(cache_folder() or folder, kernels, ignore=shutil.ignore_patterns("fluxtwin"))
        subprocess.run([sys.executable, ".ci/link_types.py"], cwd=self.root, check=True, capture_output=True)
        for part in ("sim", "calib", "gap", "plots", "scenarios", "api"):  # valid by content, not by age and length
            mode = py_compile.PycInvalidationMode.CHECKED_HASH
            compileall.compile_dir(self.root / part, quiet=1, invalidation_mode=mode)
        shared = os.environ.get("FLUXTWIN_SHARED", str(ROOT.parent / "shared"))
        own = {"PYTHONPATH": str(self.root / ".types"), "NUMBA_CACHE_DIR": str(kernels), "FLUXTWIN_SHARED": shared}
        self.environment = {**os.environ, **own}
        self.sound = cache(self.failing)

    def failing(self, *tests: str, limit_s: int = LIMIT_S) -> str:
        """The first test that fails, `a crash`, `no end`, or nothing."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "--tb=no", "-p", "no:cacheprovider", *tests]
        ended = partial(resource.setrlimit, resource.RLIMIT_CPU, (limit_s, limit_s))
        where = {"cwd": self.root, "env": self.environment, "preexec_fn": ended}
        done = subprocess.run(command, capture_output=True, text=True, check=False, **where)  # type: ignore[call-overload]
        if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
            return "no end"
        if done.returncode == 0:
            return ""
        first = re.search(r"^(?:FAILED|ERROR) (tests/.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
        return first[1] if first else "a crash"

    def noticed(self, mutant: Mutant) -> str:
        """The test that notices the mutant, or nothing."""
        path = self.root / mutant.file
        right = path.read_text(encoding="utf-8")
        path.write_text(right[: mutant.start] + mutant.wrong + right[mutant.end :], encoding="utf-8")
        first, others = self.tests.nearest(mutant)
        by = next((by for part in (first, others) if part and (by := self.failing(*part))), "")
        path.write_text(right, encoding="utf-8")
        alone = self.sound(by) if by.startswith("tests") else by and self.sound(*first, *others, limit_s=LIMIT_S // 2)
        if alone and by != "no end":
            raise SystemExit(f"{by}: does not pass as it is, so it shows nothing")
        return "" if alone else by


class Answer(NamedTuple):
    """A mutant, and the test that noticed it the first and the last time that it was tried; empty: none."""

    mutant: Mutant
    first: str
    last: str


def recorded(file: Path | None) -> dict[Mutant, Answer]:
    """What a record holds."""
    answers = dict[Mutant, Answer]()
    for line in file.read_text(encoding="utf-8").splitlines() if file and file.exists() else []:
        one = json.loads(line)
        if "seed" in one:  # the first line
            continue
        by, mutant = one.pop("by"), Mutant(**one)
        answers[mutant] = Answer(mutant, answers[mutant].first if mutant in answers else by, by)
    return answers


def tried(mutants: Iterable[Mutant], tests: Tests, record: Path | None, *, again: bool) -> Iterator[Answer]:
    """Each mutant against its tests, but for those in the record (again: that were noticed); written there one by one."""
    known = recorded(record)
    with TemporaryDirectory() as folder:
        checkout = Checkout(Path(folder), tests)
        for mutant in mutants:
            if mutant not in known or (again and not known[mutant].last):
                now = min(  # where it stands now
                    (one for one in mutants_of(ROOT / mutant.file) if one[2:6] == mutant[2:6]),
                    key=lambda one: abs(one.line - mutant.line),
                    default=None,
                )
                if now is None:
                    continue
                by = checkout.noticed(now)
                known[mutant] = Answer(mutant, known[mutant].first if mutant in known else by, by)
                if record:
                    with record.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({**mutant._asdict(), "by": by}) + "\n")
            yield known[mutant]


def main() -> int:
    """Try the mutants one by one; 1 if too few were noticed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--map", type=Path, metavar="FILE", help="JSON lines: which functions each test calls")
    parser.add_argument("--record", type=Path, metavar="FILE", help="JSON lines; what is in it is not tried again")
    parser.add_argument("--again", action="store_true", help="try what survived in the record, and draw nothing new")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        calls = options.map or Path(folder) / "map.jsonl"
        if not calls.exists():
            suite = ["tests/sim/base"] if options.quick else [f"tests/{one}" for one in SUITE]
            pytest.main(["-q", "-p", "no:cacheprovider", *suite], plugins=[Calls(calls)])
        tests = Tests(calls)
    if options.record and not options.record.exists():
        options.record.write_text(json.dumps({"seed": options.seed}) + "\n", encoding="utf-8")
    if options.quick:
        mutants = [one for one in drawn(300, options.seed) if f"{one.file} {one.function}" in tests.of][:3]
    else:
        mutants = list(recorded(options.record)) if options.again else drawn(options.number, options.seed)
    answers = []
    for one in tried(mutants, tests, options.record, again=options.again):
        answers.append(one)
        name = f"{one.mutant.file}:{one.mutant.line}: {one.mutant.change}"
        print(f"{name}: {one.last or 'SURVIVED: ' + one.mutant.wrong}", flush=True)
    first, last = (sum(not by for by in bys) for bys in ((one.first for one in answers), (one.last for one in answers)))
    print(f"{len(answers)} mutants, {last} survived; {first} when first tried")
    return 0 if options.quick or last <= (1.0 - WANTED) * len(answers) else 1


if __name__ == "__main__":
    sys.exit(main())
