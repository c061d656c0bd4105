"""No public function of the physics without a value that somebody else made."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from witnessed import registry

pytestmark = pytest.mark.property

ROOT = Path(__file__).resolve().parents[2]
NUMBERS = ("FloatArray", "Rotation", "float", "TimeArray", "datetime64")


def public_functions(folder: Path) -> Iterator[str]:
    """Functions of modules (but kernels and data) that give numbers, by their dotted names."""
    for path in sorted(folder.rglob("*.py")):
        inside = path.relative_to(ROOT).with_suffix("").parts
        if "kernel" in path.name or path.name in ("__init__.py", "mat_reader.py") or "data" in inside:
            continue
        for one in ast.parse(path.read_text(encoding="utf-8")).body:
            given = ast.unparse(one.returns) if isinstance(one, ast.FunctionDef) and one.returns is not None else ""
            if isinstance(one, ast.FunctionDef) and one.name[0] != "_" and any(word in given for word in NUMBERS):
                yield ".".join([*inside, one.name])


def test_every_public_function_has_its_witness_or_a_reason() -> None:
    known = registry()
    public = {name for folder in known["scope"] for name in public_functions(ROOT / folder)}
    assert len(public) > 60
    assert public - set(known["witness"]) - set(known["none"]) == set(), "add a line to tests/reference/witnesses.toml"
    assert set(known["none"]) <= public and not set(known["none"]) & set(known["witness"])


def test_every_witness_is_a_reference_test_that_compares() -> None:
    for name, test in registry()["witness"].items():
        file, _, wanted = test.partition("::")
        text = (ROOT / "tests" / file).read_text(encoding="utf-8")
        found = [one for one in ast.parse(text).body if isinstance(one, ast.FunctionDef) and one.name == wanted]
        assert len(found) == 1, f"{name}: no test {test}"
        assert "mark.reference" in text, f"{name}: {file} is no reference"
        assert "close(" in ast.unparse(found[0]), f"{name}: {test} compares nothing"


def test_the_page_lists_every_witness() -> None:
    page = (ROOT / "docs" / "witnesses.md").read_text(encoding="utf-8")
    for name, test in registry()["witness"].items():
        assert f"| `{name}` |" in page and test.partition("::")[2] in page, "run pytest --witnesses docs/witnesses.md"
