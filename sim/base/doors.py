"""The front door of a package: the names that others may use, each imported when it is first asked for."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import reprlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import partial, wraps
from numbers import Integral, Real
from typing import Any

from fluxtwin.sim.base.errors import BadInput, FluxtwinError, kind_of, nearest


def door(
    package: str, through: Callable[[str, Any], Any] = lambda name, value: value, /, **modules: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of `package`. modules: names to re-export, parted by blanks, by the module they are in;
    `a:b` is called b here. through: what is done to each, with its name.

    To import all of them at once would make every start as slow as the slowest of them.
    """
    parts = [
        (f"{package}.{module}", *name.partition(":")[::2])
        for module, names in modules.items()
        for name in names.split()
    ]
    homes = {shown or name: (module, name) for module, name, shown in parts}

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"{package} has no {name!r}{nearest(name, homes)}; it has {', '.join(homes)}")
        module, own = homes[name]
        value = through(name, getattr(importlib.import_module(module), own))
        setattr(sys.modules[package], name, value)
        return value

    return get, lambda: sorted({*vars(sys.modules[package]), *homes})


def as_verb(package: str, name: str, value: Any, flags: Mapping[str, str], lines: Mapping[str, str]) -> Any:
    """A function as others call it: what it is given is held against its signature, and its refusals and answers name
    keywords.

    None for a keyword that has another default means that default. flags: the keyword that an option of the command line
    stands for, where it is spelled otherwise. lines: what is said of a parameter that the docstring does not explain. Raises
    BadInput for an argument of the wrong type, and TypeError, with the nearest keyword, for one that there is not.
    """
    if not inspect.isfunction(value):
        return value
    own = inspect.signature(value)
    known = own.parameters
    said_here = partial(_as_keywords, known=known, flags=flags)

    @wraps(value)
    def verb(*arguments: Any, **keywords: Any) -> Any:
        try:
            bound = own.bind(*arguments, **keywords)
        except TypeError as error:
            hints = [nearest(one, known, "; did you mean {}?") for one in keywords if one not in known]
            raise TypeError(f"{package}.{name}: {error}{''.join(hints[:1])}") from None
        for one, given in list(bound.arguments.items()):
            if given is None and known[one].default not in (None, inspect.Parameter.empty):
                del bound.arguments[one]
                continue
            annotation = str(known[one].annotation)
            if "Sequence[str]" in annotation.split(" | "):
                given = bound.arguments[one] = _listed(given)
            _require_kind(one, given, annotation)
        try:
            return _in_words_of(value(*bound.args, **bound.kwargs), said_here)
        except FluxtwinError as error:
            error.args = tuple(map(said_here, error.args))
            if isinstance(error, BadInput):
                error.where, error.wanted = said_here(error.where), said_here(error.wanted)
            raise

    shown = [
        one.replace(default=None, annotation=f"{one.annotation} | None") if inspect.isfunction(one.default) else one
        for one in known.values()
    ]
    verb.__signature__ = own.replace(parameters=shown)  # type: ignore[attr-defined]
    said = inspect.getdoc(value) or ""
    added = [f"{one}: {lines[one]}" for one in known if one in lines and not re.search(rf"\b{one}(, \w+)*: ", said)]
    verb.__doc__ = "\n\n".join([said, *filter(None, ["\n".join(added)])])
    verb.__module__, verb.__name__, verb.__qualname__ = package, name, name  # as it is found again in another process
    return verb


def _is_bool(given: Any) -> bool:
    return type(given).__name__ in ("bool", "bool_")  # numpy's too


def _is_of(name: str, given: Any) -> bool:
    return name in [one.__name__ for one in type(given).__mro__]  # the class itself is imported where it is used


def _listed(given: Any) -> Any:
    """A list of what an array or an iterator holds, which may be looked at again; text and what is none, as it is."""
    try:
        return given if isinstance(given, str) else list(given)
    except TypeError:
        return given


def _are_names(given: Any) -> bool:
    return isinstance(given, str) or (isinstance(given, list | tuple) and all(isinstance(one, str) for one in given))


def _are_numbers(given: Any) -> bool:
    import numpy as np

    try:
        return np.asarray(given).dtype.kind in "iuf"
    except ValueError:  # rows of different lengths
        return False


_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "float": ("one number", lambda given: isinstance(given, Real) and not _is_bool(given)),
    "int": ("a whole number", lambda given: isinstance(given, Integral) and not _is_bool(given)),
    "bool": ("True or False", _is_bool),
    "str": ("text", lambda given: isinstance(given, str)),
    "Path": ("a path", lambda given: isinstance(given, str | os.PathLike)),
    "Sequence[str]": ("a list of names", _are_names),
    "Mapping[str, Any]": ("a dict", lambda given: isinstance(given, Mapping)),
    "Mapping[str, Readable]": (
        "a dict of records by the name of the vehicle",
        lambda given: isinstance(given, Mapping),
    ),
    "FloatArray": ("an array of numbers", _are_numbers),
    "Progress": ("a function", callable),
    "Callable[[str], None]": ("a function", callable),
    "Executor": ("an executor", lambda given: hasattr(given, "submit")),
    "None": ("None", lambda given: given is None),
} | {
    name: (f"a {name}", partial(_is_of, name))
    for name in ("Declared", "Diagnosis", "FieldModel", "LimitsSection", "World")
}
"""What an argument may be, by its annotation: in words, and whether something is that. What has no row the verb judges."""
_UNIT = re.compile(r"_(nT|deg|s|h|km)$")
_FLAG = re.compile(
    r"fluxtwin [a-z]+(?: [\w./]+)?(?: --[\w-]+(?: [\w./,:]+)?)*|"  # a command stays one
    r"--(?P<flag>[a-z][\w-]*)(?: (?:(?P<number>\d+)|(?P<text>[A-Z]{3,}(?:\.[a-z]+)?|b(?:,[ST])*|tukey))(?![\w-]))?"
)
_SAID = (
    "sentence",
    "line",
    "notes",
    "messages",
    "warnings",
    "reasons",
    "not_observable",
    "verdict",
    "diagnosis",
    "findings",
)
"""The parts of an answer that are words, or that have such parts; of one in a list also `text`, elsewhere a file."""


def _require_kind(name: str, given: Any, annotation: str) -> None:
    parts = annotation.split(" | ")
    if not set(parts) <= set(_KINDS) or any(_KINDS[part][1](given) for part in parts):
        return
    words = [_KINDS[part][0] for part in parts if not (part == "str" and "Path" in parts)]
    unit = _UNIT.search(name)
    wanted = " or ".join([words[0] + (f" [{unit[1]}]" if unit else ""), *words[1:]])
    if words[0] == "text" and isinstance(given, list | tuple) and _are_names(given):
        wanted = f"text, as {','.join(given)!r}"
    plain = type(given).__module__ == "builtins"
    said = f"{reprlib.repr(given)} is not {words[0]}" if plain else f"an object of type {kind_of(given)} was given"
    raise BadInput(said, where=name, wanted=wanted)


def _as_keywords(text: Any, known: Mapping[str, inspect.Parameter], flags: Mapping[str, str]) -> Any:
    """The text with the keywords in place of the options of the command line that they are, where the verb has them; what
    stands for a value (`FILE.toml`, `b,S`, `2`) is written as Python writes it. A whole command is left as it is."""

    def keyword(flag: re.Match[str]) -> str:
        name = (flag["flag"] or "").replace("-", "_")
        one = known.get(name) or known.get(flags.get(name, ""))
        if one is None:
            return flag[0]
        if one.annotation == "bool":
            return f"{one.name}=True"
        value = flag["number"] or (f'"{flag["text"]}"' if flag["text"] else "")
        return f"{one.name}={value}" if value else one.name

    return _FLAG.sub(keyword, text) if isinstance(text, str) else text


def _in_words_of(answer: Any, said: Callable[[Any], Any], names: tuple[str, ...] = _SAID) -> Any:
    """An answer with its words as `said`; itself where nothing changes."""
    if not is_dataclass(answer) or isinstance(answer, type):
        return answer
    new = {}
    for name in {*names} & {one.name for one in fields(answer)}:
        part = getattr(answer, name)
        listed = isinstance(part, list | tuple)
        every = [_in_words_of(said(one), said, (*_SAID, "text")) for one in (part if listed else [])]
        spoken = type(part)(every) if listed else _in_words_of(said(part), said)
        if spoken is not part and (not listed or spoken != part):
            new[name] = spoken
    return replace(answer, **new) if new else answer
