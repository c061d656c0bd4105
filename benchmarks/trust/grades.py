"""The grade sheet after NASA-STD-7009: levels that tests earn, the worst on top.

python -m benchmarks.trust.grades        write docs/credibility.md
"""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "credibility.md"
HEAD = """# How credible the models are

This is a self-assessment according to NASA-STD-7009 (2008, appendix B), with levels 0 to 4 for each factor. A level counts
if tests show it and all levels below it; what no test can show is not claimed. The credibility of the whole is that of its
worst factor, which is in the first row. `python -m benchmarks.trust.grades` writes this page from
`benchmarks/trust/grades.toml`, and a test checks that it is up to date.

| factor | level | what it rests on | what the next level would need |
|---|---|---|---|
"""


def factors() -> dict[str, list[dict[str, Any]]]:
    """The levels of each factor, ascending."""
    return tomllib.loads((Path(__file__).parent / "grades.toml").read_text(encoding="utf-8"))


def lacking(test: str) -> str | None:
    """What is wrong with the name of a test; None where it is there. `FILE::*` stands for all tests of a file."""
    file, _, name = test.partition("::")
    path = ROOT / "tests" / file
    if not path.is_file():
        return f"no file {file}"
    found = {one.name for one in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(one, ast.FunctionDef)}
    return (
        None if (name == "*" and any(one.startswith("test_") for one in found)) or name in found else f"no test {test}"
    )


def _link(test: str) -> str:
    file, _, name = test.partition("::")
    return f"[{Path(file).stem if name == '*' else name}](../tests/{file})"


def page() -> str:
    """The sheet."""
    rows = []
    for factor, levels in factors().items():
        reached: dict[str, Any] = {"level": 0, "words": "", "tests": []}
        missing = ""
        for number, one in enumerate(levels, 1):
            if not one["tests"] or one["level"] != number or any(map(lacking, one["tests"])):
                missing = str(one.get("missing", ""))
                break
            reached = one
        shown = ", ".join(map(_link, reached["tests"]))
        words = f"{reached['words']}: {shown}" if shown else "nothing that a test can show"
        rows.append((reached["level"], f"| {factor} | {reached['level']} | {words} | {missing} |"))
    return HEAD + "\n".join(line for _, line in sorted(rows, key=lambda row: row[0])) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
