"""A study's report from Markdown: tables, pages and claims are sections of files beside it, numbers are put in by jinja.

A table is a title, the rows of a Markdown table, and a note. A page is `# title`, `### section`s of paragraphs,
`[table name]`, and `[figure name]` with its caption below; `### Errata` is a list. A claim sets `value`, `unit` and
`holds`, says what is found here, and, where it needs to, `otherwise:` and `remark:`. What stands before the first section
of a file (as `{% set e = r.errors %}`) holds for each.
"""

from __future__ import annotations

import builtins
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, StrictUndefined, Undefined, UndefinedError

from fluxtwin.scenarios.claims import Claim, judged
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table
from fluxtwin.scenarios.printed import Printed
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.earth.constants import NT_PER_MG

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINE_END = re.compile(r"[ \t]*\n[ \t]*")
_BLOCK = re.compile(r"\n[ \t]*\n+")
_BUILTINS = (
    "abs",
    "any",
    "all",
    "enumerate",
    "float",
    "int",
    "len",
    "list",
    "max",
    "min",
    "round",
    "sorted",
    "sum",
    "zip",
)


class Report(Words):
    """Sections of a study's Markdown file, rendered as text, tables and pages."""

    def __init__(
        self, package: str, file: str = "words.md", filters: Mapping[str, Any] | None = None, **names: Any
    ) -> None:
        """names: functions and constants that every section may use; filters: further ones of jinja's kind."""
        self._names, self._filters = names, filters or {}
        self._made = self._new_environment()
        super().__init__(package, file)

    def say(self, name: str, /, **values: Any) -> str:
        """One section as running text: line ends become spaces."""
        return _one_line(super().say(name, **values))

    def table(self, name: str, /, **values: Any) -> Table:
        """One section as a table; cells are text."""
        blocks = _BLOCK.split(super().say(name, **values).strip())
        place = next(k for k, block in enumerate(blocks) if block.startswith("|"))
        heading, _, *rows = blocks[place].splitlines()
        note = _one_line(" ".join(blocks[place + 1 :]))
        return Table(_one_line(blocks[0]), _cells(heading), [_cells(row) for row in rows if row.strip()], note)

    def tables(self, names: Sequence[str], /, **values: Any) -> dict[str, Table]:
        """Several sections as tables."""
        return {name: self.table(name, **values) for name in names}

    def page(
        self,
        name: str,
        verdict: str,
        tables: Mapping[str, Table],
        figures: Mapping[str, Callable[[], Figure]],
        provenance: Mapping[str, str],
        links: Mapping[str, str] | None = None,
        **values: Any,
    ) -> Page:
        """One section as a page, with the tables and figures that it names; a figure is drawn where it is named."""
        title, *blocks = _BLOCK.split(super().say(name, **values).strip())
        sections: list[tuple[str, list[str], list[Table], list[FigureBlock]]] = []
        for block in blocks:
            words = _one_line(block)
            if words.startswith("### "):
                sections.append((words[4:], [], [], []))
                continue
            _, paragraphs, shown, drawn = sections[-1]
            if found := re.fullmatch(r"\[table (\w+)\]", words):
                shown.append(tables[found[1]])
            elif found := re.fullmatch(r"\[figure (\w+)\] (.+)", words):
                drawn.append(FigureBlock(found[1], found[2], figures[found[1]]()))
            elif words:
                paragraphs.append(block)
        errata = [_one_line(item) for part in sections if part[0] == "Errata" for item in _items(part[1])]
        return Page(
            title=_one_line(title).removeprefix("# "),
            verdict=verdict,
            sections=[
                PageSection(part[0], [_one_line(p) for p in part[1]], *part[2:])
                for part in sections
                if part[0] != "Errata"
            ],
            errata=errata,
            provenance=provenance,
            links=links or {},
        )

    def judge(self, printed: Printed, **values: Any) -> list[Claim]:
        """The packaged claims, each judged by the section with its number."""
        return judged(printed.claims(), lambda number: self._verdict(str(number), values))

    def summary(self, **values: Any) -> dict[str, Any]:
        """The content of `summary.json` from `summary.toml`, which says of each entry what it is, as an expression of jinja.

        `let` names parts. In a table `with` is a mapping whose entries it has as well; with `each` the table is made of
        every entry of a mapping (`key`, `one`) or of a list (`place`, `one`).
        """
        tree = tomllib.loads(resources.files(self._package).joinpath("summary.toml").read_text(encoding="utf-8"))
        names = dict(values)
        for name, expression in tree.pop("let").items():
            names[name] = self._value(expression, names)
        made: dict[str, Any] = _plain(self._entry(tree, names))
        return made

    def _entry(self, node: Any, names: Mapping[str, Any]) -> Any:
        if isinstance(node, str):
            return self._value(node, names)
        table = {key: part for key, part in node.items() if key not in ("each", "with")}
        if "each" in node:
            items = self._value(node["each"], names)
            inner = table if "with" not in node else {**table, "with": node["with"]}
            if isinstance(items, Mapping):
                return {key: self._entry(inner, {**names, "key": key, "one": one}) for key, one in items.items()}
            return [self._entry(inner, {**names, "place": place, "one": one}) for place, one in enumerate(items)]
        more = self._value(node["with"], names) if "with" in node else {}
        return {**more, **{key: self._entry(part, names) for key, part in table.items()}}

    def _value(self, expression: str, names: Mapping[str, Any]) -> Any:
        found = self._made.compile_expression(expression, undefined_to_none=False)(**names)
        if isinstance(found, Undefined):
            raise UndefinedError(f"summary.toml: {expression}")
        return found

    def _verdict(self, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
        module = self._sections[name].make_module(dict(values))
        said = {"here": "", "otherwise": "", "remark": ""}
        for block in _BLOCK.split(str(module).strip()):
            found = re.match(r"(otherwise|remark):\s*", block)
            said[found[1] if found else "here"] = _one_line(block[found.end() if found else 0 :])
        return {**said, "value": module.value, "unit": module.unit, "holds": module.holds}  # type: ignore[attr-defined]

    def _environment(self) -> Environment:
        return self._made

    def _new_environment(self) -> Environment:
        made = Environment(
            undefined=StrictUndefined,
            autoescape=False,
            trim_blocks=True,
            lstrip_blocks=True,
            extensions=["jinja2.ext.do"],
        )
        made.globals |= {name: getattr(builtins, name) for name in _BUILTINS} | {"np": np, "nT_per_mG": NT_PER_MG}
        made.globals |= self._names
        made.filters |= {
            "f": _fixed,
            "listed": lambda values, digits=2, between=", ": between.join(_fixed(value, digits) for value in values),
            "fmt": format,
            "cell": _cell,
            "cells": lambda values: " | ".join(map(_cell, values)),
            "g": lambda value: f"{value:g}",
            "column": lambda values, place: values[:, place],  # jinja knows no slice inside an index
            **self._filters,
        }
        return made

    def _source(self, first: str, body: str) -> str:
        return first + body.strip() + "\n"


def _plain(value: Any) -> Any:
    """Numbers and lists of Python at any depth, as JSON knows them."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _fixed(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}"


def _cell(value: float) -> str:
    """A number as tables show it where its digits are not chosen."""
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.1f}"


def _one_line(text: str) -> str:
    return _LINE_END.sub(" ", text.strip("\n \t"))


def _items(paragraphs: Sequence[str]) -> list[str]:
    return [item for part in paragraphs for item in re.split(r"(?m)^- ", part) if item.strip()]


def _cells(line: str) -> list[str]:
    """Of a row of a Markdown table; a bar without a space on both sides belongs to its cell."""
    return [cell.strip(" ") for cell in f"{line.strip(' ')} ".removeprefix("| ").removesuffix(" | ").split(" | ")]


def matrix(values: np.ndarray) -> str:
    """Of a 3 x 3 matrix, as `0.066, 0.008, -0.003; ...`."""
    return "; ".join(", ".join(f"{value:.3f}" for value in row) for row in values)


def plus_minus(values: Sequence[float], spreads: Sequence[float]) -> str:
    """As `1.2 ± 0.1, ...`."""
    return ", ".join(f"{value:.1f} ± {spread:.1f}" for value, spread in zip(values, spreads, strict=True))
