"""The words of a study: sections of a Markdown file beside it, with the study's numbers put in."""

from __future__ import annotations

import re
from importlib import resources
from typing import Any

from jinja2 import Environment, StrictUndefined, Template

_SECTION = re.compile(r"^## (\w+)\n", re.MULTILINE)


class Words:
    """The sections of `words.md` in a package: `## name`, then text with `{{ expressions }}` of jinja."""

    def __init__(self, package: str, file: str = "words.md") -> None:
        """Read the file once. package: `fluxtwin.scenarios.seasat`."""
        text = resources.files(package).joinpath(file).read_text(encoding="utf-8")
        first, *parts = _SECTION.split(text)
        self._package = package
        environment = self._environment()
        self._sections: dict[str, Template] = {
            name: environment.from_string(self._source(first, body))
            for name, body in zip(parts[::2], parts[1::2], strict=True)
        }

    def say(self, name: str, /, **values: Any) -> str:
        """One section with `values` put in. Raises KeyError without such a section, UndefinedError without a value."""
        return self._sections[name].render(**values)

    def names(self) -> list[str]:
        """The sections, in the order of the file."""
        return list(self._sections)

    def _environment(self) -> Environment:
        return Environment(undefined=StrictUndefined, autoescape=False, keep_trailing_newline=False)

    def _source(self, first: str, body: str) -> str:
        """The template of a section; first: what stands in the file before all sections."""
        return body.strip()
