"""What the tests of the architecture share: the source tree, the files in git, and a way to call the command line."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("api", "sim", "calib", "gap", "plots", "scenarios")


@dataclass(frozen=True)
class Outcome:
    """Exit status and the two streams of one call of the command line."""

    status: int
    out: str
    err: str


Cli = Callable[..., Outcome]
"""What the fixtures `cli` and `process` give."""


def as_read(page: str) -> str:
    """The HTML of a page without its marks of where a line may break, or may not."""
    return re.sub(r'<span class="whole">(.*?)</span>', r"\1", page.replace("<wbr>", ""))


def status_of(*arguments: object) -> int:
    """Exit status of the command line, called in this process; for fixtures that make files."""
    from fluxtwin.cli import main

    return main([str(argument) for argument in arguments])


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the source tree."""
    return ROOT


@pytest.fixture(scope="session")
def sources() -> dict[str, Path]:
    """Every Python module of the product by its import name, `fluxtwin.sim.earth.field` and so on."""
    found = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = list(path.relative_to(ROOT).with_suffix("").parts)
            if not all((ROOT.joinpath(*parts[:n]) / "__init__.py").exists() for n in range(1, len(parts))):
                continue  # a script beside data, not a module of the package
            parts = parts[1:] if parts[0] == "api" else parts
            parts = parts[:-1] if parts and parts[-1] == "__init__" else parts
            found[".".join(["fluxtwin", *parts])] = path
    return found


@pytest.fixture(scope="session")
def trees(sources: dict[str, Path]) -> dict[str, ast.Module]:
    """The syntax tree of every module of the product."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in sources.items()}


@pytest.fixture(scope="session")
def tracked() -> list[Path]:
    """The files that git holds or would hold; without git, all files of the source tree."""
    command = ["git", "-c", "safe.directory=*", "ls-files", "--cached", "--others", "--exclude-standard"]
    try:
        answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        names = [ROOT / name for name in answer.stdout.splitlines()]
    except (OSError, subprocess.CalledProcessError):
        names = [p for folder in (*FOLDERS, "tests", "benchmarks", "docs") for p in (ROOT / folder).rglob("*")]
        names = [p for p in names if "__pycache__" not in p.parts]
    return [path for path in names if path.is_file()]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Cli:
    """`cli("field", "--date", ...)`: call the command line in this process."""
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)  # put back what main changes

    def call(*arguments: object) -> Outcome:
        status = status_of(*arguments)
        streams = capsys.readouterr()
        return Outcome(status, streams.out, streams.err)

    return call


@pytest.fixture
def noting(cli: Cli) -> Cli:
    """`cli` that shows warnings as a process of its own does; in `cli` they are errors."""

    def show(message: Warning | str, kind: type[Warning], file: str, line: int, *_: object) -> None:
        sys.stderr.write(warnings.formatwarning(message, kind, file, line))

    def call(*arguments: object) -> Outcome:
        with warnings.catch_warnings():
            warnings.simplefilter("default", UserWarning)
            warnings.showwarning = show
            return cli(*arguments)

    return call


@pytest.fixture
def process() -> Cli:
    """`process("--help")`: call the installed command line in a process of its own."""

    def call(*arguments: object, **options: object) -> Outcome:
        command = [sys.executable, "-m", "fluxtwin", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
        return Outcome(done.returncode, done.stdout, done.stderr)

    return call
