"""A TOML file as checked data: size, encoding and syntax first, then a strict model; every fault in one message."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fluxtwin.sim.base.errors import BadInput, nearest
from fluxtwin.sim.base.limits import TEXT_BYTES, TOML_DEPTH, TOML_ITEMS, text_of
from fluxtwin.sim.base.seals import require_sealed


class Strict(BaseModel):
    """Base of models for user files: frozen, strict, finite numbers, no unknown keys."""

    file_kind: ClassVar[str] = ""
    """What a whole file of this model is called, as "a scenario"."""
    example: ClassVar[str] = ""
    """How it is written, for those who gave something else."""
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False, defer_build=True)


_SIGNS = {
    "a calibration file": ({"convention"}, {"S", "b_nT"}),
    "a scenario": ({"spacecraft"}, {"orbit", "schedule"}),
    "a column map": ({"file"},),
}
"""Keys at the top by which a file shows what it is."""
_WANTED = {
    "float_type": "one number is wanted",
    "int_type": "one whole number is wanted",
    "string_type": "text is wanted",
    "bool_type": "true or false is wanted",
    "tuple_type": "a list is wanted",
    "model_type": "a table of keys is wanted",
    "dict_type": "a table of keys is wanted",
}
"""What a key should have been, in the words of a scenario, by pydantic's kind of error."""

_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+"""
_DEEP_KEY = re.compile(rf"""(?<![\w.\\"'-])(?:{_PART}\.[ \t]*+){{{TOML_DEPTH}}}""")

_Model = TypeVar("_Model", bound=Strict)


def read_model(path: Path | str, model: type[_Model]) -> _Model:
    """The file as `model`. Raises BadInput listing every fault; an unknown key names the nearest known one."""
    return validate(read_tree(path), model, where=str(path))


def validate(tree: Mapping[str, Any], model: type[_Model], *, where: str) -> _Model:
    """A parsed tree as `model`; errors as `read_model`."""
    try:
        return model.model_validate(dict(tree))
    except ValidationError as error:
        require_kind(tree, model.file_kind, where=where)
        faults = dict.fromkeys(_fault(detail, model) for detail in error.errors())
        known = dict.fromkeys(_known_keys(detail, model) for detail in error.errors() if _is_unknown(detail))
        raise BadInput("; ".join(faults), where=where, details="\n".join(known) or None) from None


def require_kind(tree: Mapping[str, Any], wanted: str, *, where: str) -> None:
    """Refuse a TOML file that is plainly one of another kind. Raises BadInput that says what it is."""
    found = next((kind for kind, signs in _SIGNS.items() if any(sign <= set(tree) for sign in signs)), None)
    if wanted and found is not None and found != wanted:
        raise BadInput(f"this is {found}", where=where, wanted=wanted)


def read_tree(path: Path | str, *, sealed: bool = True) -> dict[str, Any]:
    """The file as plain tables and values. Raises BadInput: missing, too large, not UTF-8, not TOML, and, if sealed, not as
    fluxtwin wrote it."""
    text = text_of(path, wanted="a TOML file")
    if sealed:
        require_sealed(text, where=str(path))
    return parse_tree(text, where=str(path))


def parse_tree(text: str, *, where: str) -> dict[str, Any]:
    """TOML text as plain tables and values; BadInput when it is none, and for more than the parser takes in a moment (it
    takes minutes for a key of ten thousand parts)."""
    try:
        if len(text) > TEXT_BYTES:
            raise ValueError(f"more than {TEXT_BYTES} characters")
        if sum(map(text.count, "=,[{")) > TOML_ITEMS:
            raise ValueError(f"more than {TOML_ITEMS} values")
        if _DEEP_KEY.search(text):
            raise ValueError(f"a key of more than {TOML_DEPTH} parts")
        return tomllib.loads(text)
    except (RecursionError, ValueError) as error:  # a number of 5,000 digits is a ValueError, not a TOML error
        raise BadInput(f"is not valid TOML ({str(error)[:120]})", where=where) from None


def _fault(detail: Any, model: type[BaseModel]) -> str:
    path = [str(part) for part in detail["loc"]]
    place = ".".join(path) or "the file"
    if _is_unknown(detail):
        return f"unknown key {place}" + nearest(path[-1], _known(model, detail["loc"][:-1]))
    if detail["type"] == "missing":
        return f"{place} is missing"
    found = detail.get("input")
    if detail["type"] == "literal_error":
        return f"{place}: {_no_choice(found, str(detail['ctx']['expected']))}"
    if detail["type"] == "model_type" and (example := getattr(_part(model, detail["loc"]), "example", "")):
        return f"{place}: a table of keys is wanted, as {example}{_shown(found)}"
    said = _WANTED.get(detail["type"], str(detail["msg"]).removeprefix("Value error, "))
    return f"{place}: {said}{'' if detail['type'] == 'value_error' else _shown(found)}"


def _no_choice(found: Any, expected: str) -> str:
    """For a word that is none of the list; pydantic writes the list as 'a', 'b' or 'c'."""
    known = re.findall(r"'([^']*)'", expected)
    hint = nearest(str(found), known, "did you mean {}? ")
    return f"{found!r:.60} is not known; {hint}known: {', '.join(known) or expected}"


def _shown(found: Any) -> str:
    if isinstance(found, Mapping):
        return " (found a table)"
    return f" (found a list of {len(found)})" if isinstance(found, list | tuple) else f" (found {found!r:.60})"


def _is_unknown(detail: Any) -> bool:
    return bool(detail["type"] == "extra_forbidden")


def _known_keys(detail: Any, model: type[BaseModel]) -> str:
    place = ".".join(str(part) for part in detail["loc"][:-1])
    return f"known keys{f' of {place}' if place else ''}: {', '.join(_known(model, detail['loc'][:-1]))}"


def _known(model: Any, loc: tuple[Any, ...]) -> list[str]:
    """The keys of the part of `model` at `loc`."""
    return [field.alias or name for name, field in getattr(_part(model, loc), "model_fields", {}).items()]


def _part(model: Any, loc: tuple[Any, ...]) -> Any:
    """The model of the part of `model` at `loc` (list indices and keys of a dict are passed over)."""
    for part in loc:
        fields = getattr(model, "model_fields", {})
        if isinstance(part, str) and part in fields:
            model = _inner(fields[part].annotation) or model
    return model


def _inner(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in getattr(annotation, "__args__", ()):
        found = _inner(part)
        if found is not None:
            return found
    return None
