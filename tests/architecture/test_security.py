"""What SECURITY.md promises of the source: no way from a file to code, and the limits that it names."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from fluxtwin.sim.base import limits
from fluxtwin.sim.earth import mat_reader

pytestmark = pytest.mark.property

FORBIDDEN = {"eval", "exec", "compile", "__import__"}
MODULES = {"pickle", "marshal", "shelve", "yaml", "dill", "joblib", "socket", "urllib", "http", "requests", "ftplib"}
METHODS = {"system", "popen", "read_pickle", "to_pickle", "query"}


def breaches(tree: ast.Module) -> list[str]:
    """Calls and imports by which a file, or the network, could become code."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [one.name for one in node.names if one.name.partition(".")[0] in MODULES]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in MODULES:
            found.append(str(node.module))
        elif isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            plain = isinstance(node.func, ast.Name)
            if name in (FORBIDDEN if plain else METHODS):
                found.append(name)
            words = {one.arg: one.value for one in node.keywords}
            for word in ("shell", "allow_pickle"):
                if word in words and not (isinstance(words[word], ast.Constant) and words[word].value is False):
                    found.append(word)
            if name == "load" and ast.unparse(node.func) == "np.load" and "allow_pickle" not in words:
                found.append("np.load")
    return found


def test_nothing_that_is_read_can_become_code(trees: dict[str, ast.Module]) -> None:
    assert {name: found for name, tree in trees.items() if (found := breaches(tree))} == {}


@pytest.mark.parametrize(
    "text", ["import pickle", "eval(x)", "np.load(f)", "np.load(f, allow_pickle=True)", "from urllib import request"]
)
def test_a_way_to_code_is_seen(text: str) -> None:
    assert breaches(ast.parse(text))


def test_the_page_names_the_limits(root: Path) -> None:
    page = (root / "SECURITY.md").read_text(encoding="utf-8")
    for number in (
        limits.MAX_SAMPLES,
        limits.MAX_COLUMNS,
        limits.LINE_BYTES,
        limits.TABLE_BYTES,
        limits.TEXT_BYTES,
        limits.TOML_ITEMS,
        limits.TOML_DEPTH,
        limits.MODEL_BYTES,
        limits._EXPANSION,
        limits._FREE_BYTES,
        mat_reader.SECONDS,
    ):
        assert f"{number:,}" in page
    assert f"{limits._PATIENCE_S:g} s" in page
