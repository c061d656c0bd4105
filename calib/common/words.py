"""The sentences of calibrations, kept in `words.toml`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from string import Formatter
from typing import Any

from fluxtwin.calib.common.digits import plain
from fluxtwin.sim.base.errors import amount


class _Plain(Formatter):
    """Python's format, with `~2` for two significant digits as `digits.plain` writes them, and with `one|many` for the words
    that fit a number, as `amount` has them."""

    def format_field(self, value: Any, spec: str) -> str:
        if "|" in spec:
            return amount(value, spec)
        return plain(float(value), int(spec[1:])) if spec.startswith("~") else str(format(value, spec))


@cache
def texts(package: str, file: str) -> dict[str, Any]:
    """Texts of a packaged TOML file, by section and name."""
    return tomllib.loads(resources.files(package).joinpath(file).read_text(encoding="utf-8"))


def say(name: str, /, **values: Any) -> str:
    """The sentence of that name in `words.toml`, as `section.name`, with its values. Raises KeyError for what is missing."""
    section, _, one = name.partition(".")
    text: str = texts("fluxtwin.calib.common", "words.toml")[section][one]
    return filled(text, values)


def filled(text: str, values: Mapping[str, Any]) -> str:
    """The text with its values."""
    return _Plain().vformat(text, (), values)
