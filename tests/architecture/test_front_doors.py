"""Every estimator has a front door, and `fluxtwin` has every verb of the command line with its real signature."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

import pytest

import fluxtwin
from fluxtwin.sim.base.doors import door

OTHER_NAMES = {"map": "draft_map", "run": "run_study"}
"""`fluxtwin.map` would hide Python's own from whoever imports all names; a study is run, not everything."""


def test_every_command_is_a_verb_of_the_package(root: Path) -> None:
    commands = {path.stem for path in (root / "api" / "commands").glob("*.py")} - {"__init__", "options", "reading"}
    assert len(commands) > 10
    assert [name for name in commands if OTHER_NAMES.get(name, name) not in fluxtwin.__all__] == []


def test_a_verb_shows_its_options() -> None:
    for name in fluxtwin.__all__:
        verb = getattr(fluxtwin, name)
        if inspect.isfunction(verb):
            kinds = {parameter.kind for parameter in inspect.signature(verb).parameters.values()}
            assert inspect.Parameter.VAR_KEYWORD not in kinds, f"fluxtwin.{name}(<TAB>) shows no options"
            assert verb.__doc__


def test_every_name_is_on_the_page_of_the_api(root: Path) -> None:
    page = (root / "docs" / "api.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\.\. auto\w+:: fluxtwin\.(\w+)$", page, re.MULTILINE)
    assert sorted(shown) == sorted(set(fluxtwin.__all__) - {"__version__"})


def test_help_names_the_diagnosis_first() -> None:
    assert fluxtwin.__doc__ is not None
    assert fluxtwin.__doc__.index("fluxtwin.diagnose(") < fluxtwin.__doc__.index("fluxtwin.check(")


def test_every_name_behind_a_door_is_there(root: Path) -> None:
    doors = [path for path in (root / "calib").rglob("__init__.py") if "door(" in path.read_text(encoding="utf-8")]
    assert len(doors) > 5
    for path in doors:
        name = ".".join(("fluxtwin", *path.parent.relative_to(root).parts))
        module = importlib.import_module(name)
        for shown in dir(module):
            getattr(module, shown)


def test_a_door_says_what_it_has() -> None:
    get, listed = door("fluxtwin.sim.earth", orbit="Orbit")
    assert get("Orbit").__name__ == "Orbit"
    assert "Orbit" in listed()
    for name, hint in (("Planet", ""), ("orbit", "; did you mean Orbit\\?")):
        with pytest.raises(AttributeError, match=f"has no '{name}'{hint}; it has Orbit"):
            get(name)


def test_help_explains_every_parameter() -> None:
    for name in fluxtwin.__all__:
        verb = getattr(fluxtwin, name)
        if inspect.isfunction(verb):
            said = inspect.getdoc(verb) or ""
            unsaid = [one for one in inspect.signature(verb).parameters if not re.search(rf"\b{one}(, \w+)*: ", said)]
            assert not unsaid, f"fluxtwin.{name}"
            assert "<function" not in str(inspect.signature(verb)), name
