"""What the checks say stands in one file: a call names a text there, with just what it takes; no text is left over."""

from __future__ import annotations

import ast
from pathlib import Path
from string import Formatter

import pytest
from worlds import small_record

import fluxtwin
from fluxtwin.calib import checks
from fluxtwin.calib.checks.report import note
from fluxtwin.calib.common.words import texts

pytestmark = pytest.mark.property


def test_every_text_is_asked_for_with_what_it_takes() -> None:
    taken = {}
    for severity, of_severity in texts("fluxtwin.calib.checks", "findings.toml").items():
        for code, text in of_severity.items():
            for variant, one in text.items() if isinstance(text, dict) else [("", text)]:
                fields = {name for _, name, _, _ in Formatter().parse(one) if name}
                taken[severity, f"{code}.{variant}" if variant else code] = fields
    asked = set()
    for path in Path(str(checks.__file__)).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("trap", "note")):
                continue
            given, whole = {word.arg for word in node.keywords}, None not in {word.arg for word in node.keywords}
            begun = isinstance(node.args[0], ast.JoinedStr)
            names = [str(one.value) for one in ast.walk(node.args[0]) if isinstance(one, ast.Constant)]
            for key in taken:
                if key[0] != node.func.id or not any(key[1].startswith(x) if begun else key[1] == x for x in names):
                    continue
                asked.add(key)
                assert given == taken[key] if whole else given - {None} <= taken[key], (path.name, key)
    left = {key for key in taken if key not in asked}
    assert left == {("note", "recognised_layout")}, left  # by its constant


def test_a_text_without_its_number_is_seen() -> None:
    with pytest.raises(KeyError):
        note("few_samples", count=3)
    with pytest.raises(KeyError):
        note("no_such_text")


@pytest.mark.parametrize(("rows", "counted", "said"), [(1, "1 row", "has"), (2, "2 rows", "have")])
def test_one_row_is_not_in_the_plural(rows: int, counted: str, said: str) -> None:
    found = fluxtwin.check(small_record(rows)).report()
    assert f": {counted}; " in found and f"{counted} {said} a reading" in found
