"""Do the tests bite? Small faults put into the product one at a time, each against the tests that stand nearest to it.

    python benchmarks/mutants.py --number 300 --seed 1 --record FILE   an hour or two; begun again, it goes on
    python benchmarks/mutants.py --quick                               three of them: does it still run?

A mutant is one expression of `sim`, `calib` or `gap`, changed in one of the ways of `changes`. Only functions that give or
fill numbers are changed, and nothing in what they raise or say. Mutants are drawn by a seed: every package in turn, and
there the modules and kinds of change met least. Their tests are those of the folder of `tests` that mirrors the package, in
the order of the imports between them and the module: the nearest first, until one fails. One that fails with the mutant
must pass without it. What no test notices in LIMIT_S of processor time has survived, but where the tests end
without it in half of that: kernels are compiled anew.
"""

from __future__ import annotations

import argparse
import ast
import compileall
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
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from fluxtwin.sim.base.kernel_cache import cache_folder

ROOT = Path(__file__).resolve().parent.parent
WANTED = 0.95
MOST = 4
"""Mutants of a module, at most."""
LIMIT_S = 30
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


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> frozenset[Path]:
    """The files of the product that a file imports."""
    found = set[str]()
    for node in ast.walk(parsed(path)):
        match node:
            case ast.Import(names):
                found |= {one.name for one in names}
            case ast.ImportFrom(str() as module, names):
                found |= {module} | {f"{module}.{one.name}" for one in names}
            case ast.Call(ast.Name("door"), _, modules):  # what a package hands on
                found |= {".".join(("fluxtwin", *path.parent.relative_to(ROOT).parts, str(one.arg))) for one in modules}
    words = [one.removeprefix("fluxtwin").strip(".").replace(".", "/") for one in found if one.startswith("fluxtwin")]
    homes = [folder / word for word in words for folder in (ROOT, ROOT / "api") if word or folder != ROOT]
    return frozenset(
        file for home in homes for file in (home.with_suffix(".py"), home / "__init__.py") if file.is_file()
    )


def nearest(file: str, function: str) -> tuple[list[str], list[str]]:
    """Tests that use the function by name, then those of its module; the files of the mirrored folder, by imports."""
    module, folder = "fluxtwin." + file[:-3].replace("/", "."), ROOT / "tests" / Path(file).parent
    while not list(folder.glob("test_*.py")):
        folder = folder.parent
    by_name, files = [], []
    for path in sorted((ROOT / "tests").rglob("test_*.py"), key=lambda path: (folder not in path.parents, path)):
        steps, seen, test = 0, imports(path), path.relative_to(ROOT).as_posix()
        tree = parsed(path) if folder in path.parents or ROOT / file in seen else ast.Module([])
        made = [one for one in tree.body if isinstance(one, ast.ImportFrom)]
        names = {name.name for one in made for name in one.names if module in (one.module, f"{one.module}.{name.name}")}
        for one in tree.body:
            words = {_name(node) for node in ast.walk(one) if isinstance(node, ast.Name | ast.Attribute)}
            if isinstance(one, ast.FunctionDef) and one.name.startswith("test") and words & {*names, function}:
                by_name.append((function not in words, f"{test}::{one.name}"))
        while ROOT / file not in seen and steps < 9:
            steps, seen = steps + 1, seen.union(*map(imports, seen))
        files += [(steps, len(imports(path)), test)] if folder in path.parents else []
    return [test for _, test in sorted(by_name, key=lambda one: one[0])], [test for *_, test in sorted(files)]


class Checkout:
    """A copy of the checkout in which tests are run: its own code is imported in place of what is installed."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "fluxtwin"
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
        by_name, files = nearest(mutant.file, mutant.function)
        by = (self.failing(*by_name) if by_name else "") or self.failing(*files)
        path.write_text(right, encoding="utf-8")
        if by.startswith("tests") and self.sound(by):
            raise SystemExit(f"{by}: does not pass as it is, so it tells nothing")
        return "" if by == "no end" == self.sound(*sorted(files), limit_s=LIMIT_S // 2) else by


def main() -> int:
    """Try the mutants one by one; 1 if too few were noticed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--record", type=Path, metavar="FILE", help="JSON lines; what is in it is not tried again")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    old = options.record.read_text(encoding="utf-8").splitlines() if options.record and options.record.exists() else []
    known = {(one["file"], one["change"], one["right"], one["wrong"]): one["by"] for one in map(json.loads, old)}
    missed, mutants = [], drawn(3 if options.quick else options.number, options.seed)
    with TemporaryDirectory() as folder:
        checkout = Checkout(Path(folder))
        for mutant in mutants:
            by = known.get((mutant.file, *mutant[3:6]))
            if by is None:
                by = checkout.noticed(mutant)
                if options.record:
                    with options.record.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({**mutant._asdict(), "by": by}) + "\n")
            print(f"{mutant.file}:{mutant.line}: {mutant.change}: {by or 'SURVIVED: ' + mutant.wrong}", flush=True)
            missed += [mutant] if not by else []
    print(f"{len(mutants)} mutants, {len(missed)} survived")
    return 0 if options.quick or len(missed) <= (1.0 - WANTED) * len(mutants) else 1


if __name__ == "__main__":
    sys.exit(main())
