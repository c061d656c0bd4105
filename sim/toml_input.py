"""A TOML file as checked data: size, encoding and syntax first, then a strict model; every fault in one message."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fluxtwin.sim.errors import BadInput

MAX_BYTES = 1_000_000


class Strict(BaseModel):
    """Base of models for user files: frozen, strict, finite numbers, no unknown keys."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False, defer_build=True)


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

_Model = TypeVar("_Model", bound=Strict)


def read_model(path: Path | str, model: type[_Model]) -> _Model:
    """The file as `model`. Raises BadInput listing every fault; an unknown key names the nearest known one."""
    return validate(read_tree(path), model, where=str(path))


def validate(tree: Mapping[str, Any], model: type[_Model], *, where: str) -> _Model:
    """A parsed tree as `model`; errors as `read_model`."""
    try:
        return model.model_validate(dict(tree))
    except ValidationError as error:
        faults = dict.fromkeys(_fault(detail, model) for detail in error.errors())
        raise BadInput("; ".join(faults), where=where) from None


def read_tree(path: Path | str) -> dict[str, Any]:
    """The file as plain tables and values. Raises BadInput: missing, too large, not UTF-8, not TOML."""
    path = Path(path)
    where = str(path)
    try:
        if path.is_dir():
            raise BadInput("is a folder", where=where, wanted="a TOML file")
        if path.stat().st_size > MAX_BYTES:
            raise BadInput(f"is larger than {MAX_BYTES} bytes", where=where, wanted="a TOML file")
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise BadInput("there is no such file", where=where, wanted="a TOML file") from None
    except UnicodeDecodeError:
        raise BadInput("is not UTF-8 text", where=where, wanted="a TOML file in UTF-8") from None
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", where=where) from None
    return parse_tree(text, where=where)


def parse_tree(text: str, *, where: str) -> dict[str, Any]:
    """TOML text as plain tables and values; BadInput when it is none."""
    try:
        return tomllib.loads(text)
    except (RecursionError, ValueError) as error:  # a number of 5,000 digits is a ValueError, not a TOML error
        raise BadInput(f"is not valid TOML ({str(error)[:120]})", where=where) from None


def _fault(detail: Any, model: type[BaseModel]) -> str:
    path = [str(part) for part in detail["loc"]]
    place = ".".join(path) or "the file"
    if detail["type"] == "extra_forbidden":
        known = _known(model, detail["loc"][:-1])
        near = difflib.get_close_matches(path[-1], known, n=1, cutoff=0.5)
        return f"unknown key {place}; " + (f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}")
    if detail["type"] == "missing":
        return f"{place} is missing"
    found = detail.get("input")
    said = _WANTED.get(detail["type"], str(detail["msg"]).removeprefix("Value error, "))
    return f"{place}: {said}{'' if detail['type'] == 'value_error' else _shown(found)}"


def _shown(found: Any) -> str:
    if isinstance(found, Mapping):
        return " (found a table)"
    return f" (found a list of {len(found)})" if isinstance(found, list | tuple) else f" (found {found!r:.60})"


def _known(model: Any, loc: tuple[Any, ...]) -> list[str]:
    """The keys of the part of `model` at `loc` (list indices and keys of a dict are passed over)."""
    for part in loc:
        fields = getattr(model, "model_fields", {})
        if isinstance(part, str) and part in fields:
            model = _inner(fields[part].annotation) or model
    return list(getattr(model, "model_fields", {}))


def _inner(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in getattr(annotation, "__args__", ()):
        found = _inner(part)
        if found is not None:
            return found
    return None
