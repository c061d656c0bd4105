"""The commands on a page, run as a reader runs them, and what they print compared with what the page shows.

A fence of `console` has commands behind "$ " and, below each, its standard output; a line "..." stands for lines left out.
A fence whose text before ends in "`NAME`:" is a file that the reader saves. How long lines are broken, rules and gaps of
tables do not count, and neither do names made of a content's digest; a number may differ by one unit of its last digit,
which other processors and libraries round the other way.

    python tests/pages.py docs/tutorial.md      # what the commands print now, for whoever writes the page
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SAVED = re.compile(r"`([\w.-]+\.\w+)`:\s*$")
DIGEST = re.compile(r"\b(?=[0-9a-f]*[a-f])(?=[0-9a-f]*\d)[0-9a-f]{12,64}\b")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w]*\d)")
ROOT = Path(__file__).parents[1]
Run = Callable[[list[str]], tuple[int, str]]
"""A command's words to its exit status and standard output."""


@dataclass(frozen=True)
class Command:
    """A command of a page, its words, and what the page shows below it."""

    line: int
    words: list[str]
    shown: str


@dataclass(frozen=True)
class File:
    """A file that the reader saves."""

    name: str
    text: str


def steps(text: str) -> Iterator[Command | File]:
    """What a page asks its reader to do, in order."""
    for fence in FENCE.finditer(text):
        kind, body = fence.groups()
        named = SAVED.search(text[: fence.start()].rstrip())
        if kind == "console":
            yield from _commands(body, text.count("\n", 0, fence.start(2)) + 1)
        elif named and kind in ("python", "toml", "csv"):
            yield File(named[1], body)


def _commands(body: str, line: int) -> Iterator[Command]:
    for part in re.split(r"^(?=\$ )", body, flags=re.MULTILINE):
        asked = re.match(r"\$ ((?:.*\\\n)*.*)\n?", part)
        if asked:
            yield Command(line, shlex.split(asked[1].replace("\\\n", " ")), part[asked.end() :])
        line += part.count("\n")


def differs(shown: str, printed: str) -> str:
    """Empty where a page shows what was printed, else the first piece of it that was not."""
    rest = _words(printed)
    pieces = [_words(piece) for piece in re.split(r"^\.\.\.$", shown, flags=re.MULTILINE)]
    for number, piece in enumerate(pieces):
        fixed = number == 0
        last = number == len(pieces) - 1
        starts = [0] if fixed else range(len(rest) - len(piece) + 1)
        if last and piece and not fixed:
            starts = [len(rest) - len(piece)]
        place = next((k for k in starts if k >= 0 and _alike(piece, rest[k : k + len(piece)])), None)
        if (
            place is None
            or (last and piece and place + len(piece) != len(rest))
            or (last and fixed and len(rest) > len(piece))
        ):
            return " ".join(piece) or "(nothing)"
        rest = rest[place + len(piece) :]
    return ""


def _words(text: str) -> list[str]:
    return DIGEST.sub("<digest>", text.replace("─", " ")).split()


def _alike(one: list[str], other: list[str]) -> bool:
    return len(one) == len(other) and all(a == b or _same_numbers(a, b) for a, b in zip(one, other, strict=True))


def _same_numbers(one: str, other: str) -> bool:
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    return all(
        _unit(a) == _unit(b) and abs(float(a) - float(b)) < 1.5 * _unit(a)
        for a, b in zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    )


def _unit(number: str) -> float:
    """Of the last digit of a number: 0.01 of 2.35, and 1 of 120."""
    digits, _, power = number.partition("e")
    return float(f"1e{int(power or 0) - len(digits.partition('.')[2])}")


def follow(page: Path, folder: Path, run: Run) -> list[str]:
    """Do what the page says in an empty folder; each difference as "page, line N: ..."."""
    wrong = []
    for step in steps(page.read_text(encoding="utf-8")):
        if isinstance(step, File):
            (folder / step.name).write_text(step.text, encoding="utf-8")
            continue
        # The reader of a path below docs stands in a copy of the source.
        status, printed = run([str(ROOT / word) if word.startswith("docs/") else word for word in step.words])
        missed = differs(step.shown, printed)
        if missed or status == 2:
            said = f"the page shows\n{missed}\nand this was printed (status {status}):\n{printed}"
            wrong.append(f"{page.name}, line {step.line}: $ {shlex.join(step.words)}\n{said}")
    return wrong


def in_a_process(folder: Path) -> Run:
    """Commands as a shell runs them."""

    def run(words: list[str]) -> tuple[int, str]:
        start = [sys.executable, "-m", "fluxtwin"] if words[0] == "fluxtwin" else [sys.executable]
        done = subprocess.run([*start, *words[1:]], cwd=folder, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout if done.returncode != 2 else done.stdout + done.stderr

    return run


if __name__ == "__main__":
    for name in sys.argv[1:]:
        with tempfile.TemporaryDirectory() as made:
            print("\n\n".join(follow(Path(name), Path(made), in_a_process(Path(made)))) or f"{name}: as it says")
