"""What a study says: sections of Markdown files beside it, in which jinja puts the study's numbers.

`## name` begins a section. A table is a title, a block and a note; the block is a Markdown table, whose cells are text, or
`for ROW in ROWS` and a line `heading = expression` for each column, whose cells stay numbers. A page is `# title` and
`### section`s of paragraphs, `[table NAME]` or `[table NAME WORD]` (the word is its `argument`), and `[figure NAME]` with
its caption below; `### Errata` is a list. A claim sets `value`, `unit` and `holds`, says what is found here, and, where it
needs to, `otherwise:` and `remark:`. What stands before the first section of a file (as `{% set e = r.errors %}`) holds
for each.

What a paper claims beside what a study finds, in five statuses.

`reproduced`: an outcome that could have come out otherwise, and came out as printed. `put in`: an input of the scenario
read back. `definition`: a formula or a frame, true of any data. `differs`: with its computed reason.
`not testable`: with what would test it. The kind of a claim, where it is no outcome, is in the study's `claims.toml`;
whether it holds is said with its words.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property, partial
from importlib import import_module, resources
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, StrictUndefined, Template, Undefined, UndefinedError, pass_context
from jinja2.runtime import Context

from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, StudyResult, Table
from fluxtwin.sim.base.files import plain_tree
from fluxtwin.sim.earth.constants import NT_PER_MG

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATUSES = REPRODUCED, PUT_IN, DEFINITION, DIFFERS, NOT_TESTABLE = (
    "reproduced",
    "put in",
    "definition",
    "differs",
    "not testable",
)
_SECTION = re.compile(r"^## (\w+)\n", re.MULTILINE)
_LINE_END = re.compile(r"[ \t]*\n[ \t]*")
_BLOCK = re.compile(r"\n[ \t]*\n+")
_BUILTINS = (abs, any, all, enumerate, float, int, len, list, max, min, round, sorted, sum, vars, zip)
_CLAIMS = "Claim by claim"
_NEXT = f"read {_CLAIMS}: it gives the reason for every difference from the papers."


@dataclass(frozen=True)
class Claim:
    """One claim with its status."""

    id: int
    where: str
    paper: str
    here: str
    value: float
    unit: str
    status: str
    why: str = ""

    def to_dict(self) -> dict[str, object]:
        """As it is in `summary.json`."""
        return {name: value for name, value in vars(self).items() if name != "why" or value}


def claim_of(entry: Mapping[str, Any], found: Mapping[str, Any]) -> Claim:
    """A claim of a paper (id, where, paper, and kind where it is no outcome) with its status.

    found: `here` (text with the number and its unit), `value`, `unit`, `holds` (None: it cannot be tested), `otherwise` (why
    not; what would test it), `remark` (to be said in any case). Raises ValueError without a number or without a reason.
    """
    kind = entry.get("kind", REPRODUCED)
    if kind not in (REPRODUCED, PUT_IN, DEFINITION):
        raise ValueError(f"claim {entry['id']}: there is no kind {kind!r}")
    if not np.isfinite(found["value"]):
        raise ValueError(f"claim {entry['id']}: no finite number was computed")
    status = NOT_TESTABLE if found["holds"] is None else kind if found["holds"] else DIFFERS
    if not found["holds"] and not found["otherwise"]:
        raise ValueError(f"claim {entry['id']}: {status} without a reason")
    return Claim(
        **{key: entry[key] for key in ("id", "where", "paper")},
        **{key: found[key] for key in ("here", "unit")},
        value=float(found["value"]),
        status=status,
        why="; ".join(filter(None, (found["remark"], "" if found["holds"] else found["otherwise"]))),
    )


class Words:
    """The sections of a study's Markdown file, as text, tables, claims and pages.

    All raise KeyError for a section that is not there, UndefinedError for a value that is not.
    """

    def __init__(
        self,
        package: str,
        *files: str,
        filters: Mapping[str, Any] | None = None,
        known: Iterable[Any] = (),
        **names: Any,
    ) -> None:
        """package: as `fluxtwin.scenarios.seasat`; files: `words.md` where there is no other; filters: further ones of
        jinja's. What every section may use, besides `say`, which gives another section, and `table`, which gives it as a
        table of what the caller knows: names, and the functions and modules in `known` under their own."""
        self._package, self._jinja = package, _environment()

        @pass_context
        def table(context: Context, name: str) -> Table:
            return self.table(name, **context.get_all())

        self._jinja.globals |= {
            "say": self.say,
            "table": table,
            **{one.__name__.rpartition(".")[2]: one for one in known},
            **names,
        }
        self._jinja.filters |= filters or {}
        self._sections: dict[str, Template] = {}
        self._expressions: dict[str, Callable[..., Any]] = {}
        for file in files or ("words.md",):
            first, *parts = _SECTION.split(self._text(file))
            for name, body in zip(parts[::2], parts[1::2], strict=True):
                self._sections[name] = self._jinja.from_string(f"{first}{body.strip()}\n")

    def say(self, name: str, /, **values: Any) -> str:
        """One section as running text: line ends become spaces."""
        return _one_line(self._sections[name].render(**values))

    def table(self, name: str, /, **values: Any) -> Table:
        """One section as a table; a word after its name is the `argument` of its expressions."""
        section, _, argument = name.partition(" ")
        values = {**values, "argument": argument}
        title, block, *rest = self._blocks(section, values)
        lines, note = block.splitlines(), _one_line(" ".join(rest))
        if lines[0].startswith("|"):
            return Table(_one_line(title), _cells(lines[0]), [_cells(row) for row in lines[2:] if row.strip()], note)
        variable, _, over = lines[0].removeprefix("for ").partition(" in ")
        columns = [line.strip().split(" = ", 1) for line in lines[1:]]
        rows = [
            [self._value(cell, {**values, variable: one}) for _, cell in columns]
            for one in self._value(over, values) or ()
        ]
        return Table(_one_line(title), [heading for heading, _ in columns], rows, note)

    def page(
        self,
        verdict: str,
        figures: Mapping[str, Callable[[], Figure]],
        provenance: Mapping[str, str],
        links: Mapping[str, str] | None = None,
        /,
        *,
        name: str = "page",
        **values: Any,
    ) -> Page:
        """A section as a page; a table or figure is made where it is named."""
        title, *blocks = self._blocks(name, values)
        sections: list[tuple[str, list[str], list[Table], list[FigureBlock]]] = []
        errata: list[str] = []
        for block in blocks:
            words = _one_line(block)
            if words.startswith("### "):
                sections.append((words[4:], [], [], []))
                continue
            heading, paragraphs, shown, drawn = sections[-1]
            if found := re.fullmatch(r"\[table ([\w ]+)\]", words):
                shown.append(self.table(found[1], **values))
            elif found := re.fullmatch(r"\[figure (\w+)\] (.+)", words):
                drawn.append(FigureBlock(found[1], found[2], figures[found[1]]()))
            elif heading == "Errata":
                errata += [_one_line(item) for item in re.split(r"(?m)^- ", block) if item.strip()]
            elif words:
                paragraphs.append(words)
        return Page(
            title=_one_line(title).removeprefix("# "),
            verdict=verdict,
            sections=[PageSection(*one) for one in sections if one[0] != "Errata"],
            errata=errata,
            provenance=provenance,
            links=links or {},
            next_step=_NEXT if any(one[0] == _CLAIMS for one in sections) else "",
        )

    def judge(self, entries: Sequence[Mapping[str, Any]] = (), /, **values: Any) -> list[Claim]:
        """The claims of a paper, by default those of the package's `data/claims.toml` (id, where, paper), each from the
        section with its number. Raises KeyError for a claim without words."""
        entries = entries or tomllib.loads(self._text("data/claims.toml"))["claim"]
        return [claim_of(entry, self._verdict(str(entry["id"]), values)) for entry in entries]

    def summary(self, **values: Any) -> dict[str, Any]:
        """The content of `summary.json` from `summary.toml`, which says of each entry what it is, as an expression of jinja.

        `let` names parts, which all of a `result` may use; `terminal` the tables of the terminal, in order. In a table
        `with` is a mapping whose entries it has as well; with `each` it is made of every entry of a mapping (`key`, `one`)
        or of a list (`place`, `one`).
        """
        tree = {key: part for key, part in self._summary.items() if key not in ("let", "terminal")}
        made: dict[str, Any] = plain_tree(self._entry(tree, self._with_parts(self._summary.get("let", {}), values)))
        return made

    @cached_property
    def _summary(self) -> dict[str, Any]:
        return tomllib.loads(self._text("summary.toml"))

    def figures(self, file: str = "figures.toml", /, **values: Any) -> dict[str, Callable[[], Figure]]:
        """By name, what draws each figure of the file: `draw`, a function of `fluxtwin.plots`, with what else its entry has.

        That is written as in `summary.toml`, but for the title, which is a template; `let` names parts.
        """
        tree = tomllib.loads(self._text(file))
        let = tree.pop("let", {})
        return {name: partial(self._drawn, entry, let, values) for name, entry in tree.items()}

    def result(
        self,
        name: str,
        provenance: Mapping[str, str],
        /,
        *,
        claims: Sequence[Claim] = (),
        links: Mapping[str, str] | None = None,
        more_pages: Mapping[str, Page] | None = None,
        **values: Any,
    ) -> StudyResult:
        """All that the study `name` hands back but the files that it writes.

        claims: with their statuses, for the tables `claims`, `statuses` and `whys` of `studies.md`.
        """
        values = self._with_parts(self._summary.get("let", {}), {"claims": claims, **values})
        line = self.say("status", **values)
        return StudyResult(
            name=name,
            status_line=line,
            summary=self.summary(**values) | ({"claims": [claim.to_dict() for claim in claims]} if claims else {}),
            tables=[self.table(one, **values) for one in self._summary["terminal"]],
            page=self.page(line, self.figures(**values), provenance, links, **values),
            more_pages=more_pages or {},
        )

    def _text(self, file: str) -> str:
        return resources.files(self._package).joinpath(file).read_text(encoding="utf-8")

    def _blocks(self, name: str, values: Mapping[str, Any]) -> list[str]:
        return _BLOCK.split(self._sections[name].render(**values).strip())

    def _with_parts(self, let: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, Any]:
        names = dict(values)
        for name, expression in let.items():
            names[name] = self._value(expression, names)
        return names

    def _drawn(self, entry: Mapping[str, Any], let: Mapping[str, str], values: Mapping[str, Any]) -> Figure:
        names = self._with_parts({**let, **entry.get("let", {})}, values)
        module, _, function = entry["draw"].partition(".")
        taken = self._entry({key: part for key, part in entry.items() if key not in ("draw", "let", "title")}, names)
        if "title" in entry:
            taken["title"] = self._jinja.from_string(entry["title"]).render(**names)
        made: Figure = getattr(import_module(f"fluxtwin.plots.{module}"), function)(**taken)
        return made

    def _entry(self, node: Any, names: Mapping[str, Any]) -> Any:
        if isinstance(node, str):
            return self._value(node, names)
        table = {key: part for key, part in node.items() if key != "each"}
        if "each" in node:
            items = self._value(node["each"], names)
            if isinstance(items, Mapping):
                return {key: self._entry(table, {**names, "key": key, "one": one}) for key, one in items.items()}
            return [self._entry(table, {**names, "place": place, "one": one}) for place, one in enumerate(items)]
        more = self._value(table.pop("with"), names) if "with" in table else {}
        return {**more, **{key: self._entry(part, names) for key, part in table.items()}}

    def _value(self, expression: str, names: Mapping[str, Any]) -> Any:
        if expression not in self._expressions:  # a column has the same one in each row
            self._expressions[expression] = self._jinja.compile_expression(expression, undefined_to_none=False)
        found = self._expressions[expression](**names)
        if isinstance(found, Undefined):
            raise UndefinedError(f"{self._package}: {expression}")
        return found

    def _verdict(self, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
        module = self._sections[name].make_module(dict(values))
        said = {"here": "", "otherwise": "", "remark": ""}
        for block in _BLOCK.split(str(module).strip()):
            found = re.match(r"(otherwise|remark):\s*", block)
            said[found[1] if found else "here"] = _one_line(block[found.end() if found else 0 :])
        return {**said, "value": module.value, "unit": module.unit, "holds": module.holds}  # type: ignore[attr-defined]


def _environment() -> Environment:
    """Jinja with what every study's words may use."""
    made = Environment(
        undefined=StrictUndefined,
        autoescape=False,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
        finalize=_said,
    )
    made.globals |= {one.__name__: one for one in _BUILTINS}
    made.globals |= {"np": np, "nT_per_mG": NT_PER_MG, "matrix": _matrix, "some": _some}
    made.filters |= {
        "f": _fixed,
        "listed": lambda values, digits=2, between=", ": between.join(_fixed(value, digits) for value in values),
        "fmt": format,
        "cell": _cell,
        "cells": lambda values: " | ".join(map(_cell, values)),
        "g": lambda value: f"{value:g}",
        "column": lambda values, place: values[:, place],  # jinja knows no slice inside an index
    }
    return made


def _said(value: Any) -> Any:
    """A value that is printed in words. Raises TypeError for a record or an array, which would be printed as code."""
    if is_dataclass(value) or isinstance(value, np.ndarray):
        raise TypeError(f"{type(value).__name__}: words want a number or a text")
    return value


def _fixed(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}"


def _cell(value: float) -> str:
    """A number as tables show it where its digits are not chosen."""
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.1f}"


def _one_line(text: str) -> str:
    return _LINE_END.sub(" ", text.strip("\n \t"))


def _cells(line: str) -> list[str]:
    """Of a row of a Markdown table; a bar without a space on both sides belongs to its cell."""
    return [cell.strip(" ") for cell in f"{line.strip(' ')} ".removeprefix("| ").removesuffix(" | ").split(" | ")]


def _matrix(values: np.ndarray) -> str:
    """Of a 3 x 3 matrix, as `0.066, 0.008, -0.003; ...`."""
    return "; ".join(", ".join(f"{value:.3f}" for value in row) for row in values)


def _some(parts: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """Those of the parts."""
    return {name: parts[name] for name in names}
