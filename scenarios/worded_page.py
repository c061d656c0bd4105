"""A page whose words, tables and captions stand in the `words.md` of a study.

`## section_NAME` is a part of the page: a title, then paragraphs with blank lines between them, of which `[table NAME]`
and `[figure NAME]` are replaced by what they name; `[table NAME WORD]` gives the table that word as its `argument`.

`## table_NAME` has a title, a block, perhaps a note. Its block is `for ROW in ROWS`, then a line `heading = expression`
for each column; or it is the headings with bars between them, and the rows are `rows[NAME]` of the values.

`## figure_NAME` is a caption. All is rendered by jinja first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, StrictUndefined

from fluxtwin.scenarios.page import FigureBlock, PageSection, Table
from fluxtwin.scenarios.words import Words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CELLS = Environment(undefined=StrictUndefined, autoescape=False)
_CELLS.globals["round"] = round


class PageWords(Words):
    """The words of a page; raises as `Words.say`, and UndefinedError for a cell without its value."""

    def sentence(self, name: str, **values: Any) -> str:
        """A whole section of the file as one paragraph."""
        return " ".join(self.say(name, **values).split())

    def sections(self, values: Mapping[str, Any], figures: Mapping[str, Figure]) -> list[PageSection]:
        """The parts of the page, in the order of the file."""
        return [self._section(name, values, figures) for name in self.names() if name.startswith("section_")]

    def table(self, name: str, values: Mapping[str, Any]) -> Table:
        """One table; a word after its name is the `argument` of its expressions."""
        section, _, argument = name.partition(" ")
        values = {**values, "argument": argument}
        title, block, *rest = self._parts(f"table_{section}", values)
        lines, note = block.splitlines(), " ".join(" ".join(rest).split())
        if not lines[0].startswith("for "):
            return Table(title, " ".join(lines).split(" | "), values["rows"][name], note)
        variable, _, over = lines[0].removeprefix("for ").partition(" in ")
        columns = dict(line.split(" = ", 1) for line in lines[1:])
        source, *cells = (
            _CELLS.compile_expression(text, undefined_to_none=False) for text in (over, *columns.values())
        )
        rows = [[cell(**values, **{variable: one}) for cell in cells] for one in source(**values) or ()]
        return Table(title, list(columns), rows, note)

    def _section(self, name: str, values: Mapping[str, Any], figures: Mapping[str, Figure]) -> PageSection:
        title, *parts = self._parts(name, values)
        words, tables, blocks = [], [], []
        for part in parts:
            what = part.strip("[]").partition(" ")[2]
            if part == f"[table {what}]":
                tables.append(self.table(what, values))
            elif part == f"[figure {what}]":
                blocks.append(FigureBlock(what, self.sentence(f"figure_{what}", **values), figures[what]))
            else:
                words.append(" ".join(part.split()))
        return PageSection(title, words, tables, blocks)

    def _parts(self, name: str, values: Mapping[str, Any]) -> list[str]:
        return [part.strip() for part in self.say(name, **values).split("\n\n") if part.strip()]
