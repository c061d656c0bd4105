"""`pytest --witnesses FILE`: run the tests of `reference/witnesses.toml`, and write down what they compared with what.

A plugin of the tests: it listens to the fixture `close`, and keeps of each named test the comparison that came nearest to
its tolerance. Comparisons that a test expects to fail are not kept.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

HERE = Path(__file__).parent
REGISTRY = HERE / "reference" / "witnesses.toml"
HEAD = """# Independent reference values

This table has every public function of the physics, with the test that compares it with a published value, another library,
an analytic solution or flight data. Of each test it shows the comparison that came closest to its tolerance: the value of
`fluxtwin`, the reference value, their difference and the difference that is allowed. It is made by

```sh
python -m pytest -q --witnesses docs/witnesses.md tests
```

| function | fluxtwin | reference | difference (allowed) | source, and test |
|---|---|---|---|---|
"""
_seen: dict[str, dict[str, Any]] = {}
_sources: dict[str, str] = {}


def registry() -> dict[str, Any]:
    """`scope`, `none` and `witness` of the registry."""
    return tomllib.loads(REGISTRY.read_text(encoding="utf-8"))


def note(actual: np.ndarray, expected: np.ndarray, atol: Any, unit: str) -> None:
    """A comparison that held, of the test at work."""
    test = _name(os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0])
    allowed = np.broadcast_to(np.asarray(atol, dtype=float), actual.shape)
    gap = np.abs(actual - expected)
    share = gap / np.where(allowed > 0, allowed, 1.0)
    at = np.unravel_index(int(np.argmax(share)), share.shape)
    found = {"share": float(share[at]), "ours": float(actual[at]), "theirs": float(expected[at])}
    found |= {"gap": float(gap[at]), "allowed": float(allowed[at]), "unit": unit}
    if test not in _seen or found["share"] >= _seen[test]["share"]:
        _seen[test] = found


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option."""
    parser.addoption(
        "--witnesses", metavar="FILE", help="run the tests of reference/witnesses.toml, write a table here"
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Only the named tests, and what their docstrings say of the source."""
    if config.getoption("--witnesses"):
        wanted = set(registry()["witness"].values())
        items[:] = [item for item in items if _name(item.nodeid) in wanted]
        for item in items:
            words = (getattr(item, "function").__doc__ or item.getparent(pytest.Module).obj.__doc__ or "").strip()  # type: ignore[union-attr]  # noqa: B009
            _sources[_name(item.nodeid)] = " ".join(words.split("\n\n")[0].split()).replace("|", "/")


@pytest.hookimpl(wrapper=True)
def pytest_sessionfinish(session: pytest.Session) -> Iterator[None]:
    """Write the table, where all of its tests passed."""
    target = session.config.getoption("--witnesses")
    if target and not session.testsfailed:
        lines = [_line(name, test) for name, test in sorted(registry()["witness"].items())]
        Path(target).write_text(HEAD + "\n".join([*lines, ""]), encoding="utf-8")
    return (yield)


def _line(function: str, test: str) -> str:
    one = _seen.get(test)
    where = f"[{test.partition('::')[2]}](../tests/{test.partition('::')[0]})"
    if one is None:
        return f"| `{function}` | | | | not run here (its data are absent): {where} |"
    ours, theirs, gap, allowed = (f"{one[key]:.{9 if key in ('ours', 'theirs') else 2}g}" for key in _KEYS)
    unit = "" if one["unit"] == "1" else f" {one['unit']}"
    return f"| `{function}` | {ours} | {theirs} | {gap} ({allowed}){unit} | {_sources.get(test, '')} {where} |"


_KEYS = ("ours", "theirs", "gap", "allowed")


def _name(node: str) -> str:
    """A test as the registry has it: below `tests`, without its parameters."""
    return node.partition("[")[0].removeprefix("tests/")
