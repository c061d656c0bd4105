"""The sentences of calibrations stand in one file: a call names one there, with just what it takes; none is left over."""

from __future__ import annotations

import ast
from pathlib import Path
from string import Formatter

import pytest

from fluxtwin import calib
from fluxtwin.calib.common.words import say, texts

pytestmark = pytest.mark.property


def test_every_sentence_is_asked_for_with_what_it_takes() -> None:
    taken = {
        f"{section}.{name}": {field.split(".")[0] for _, field, _, _ in Formatter().parse(text) if field}
        for section, of_section in texts("fluxtwin.calib.common", "words.toml").items()
        for name, text in of_section.items()
    }
    asked = set()
    for path in Path(str(calib.__file__)).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "say"):
                continue
            given = {word.arg for word in node.keywords}
            names = [one.value for one in ast.walk(node.args[0]) if isinstance(one, ast.Constant)]
            for name in (str(one) for one in names):
                asked.add(name)
                assert given == taken[name] if None not in given else given - {None} <= taken[name], (path.name, name)
    assert asked == set(taken)


def test_digits_of_a_sentence_are_plain() -> None:
    assert say("gyro.no_S", sigma=0.000123456).startswith("S is not determined (sigma 0.00012)")
    with pytest.raises(KeyError):
        say("gyro.no_S")
