"""Sections, tables and figures of a page whose words stand in the `words.md` of a study."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from matplotlib.figure import Figure

from fluxtwin.scenarios.page import Cell, FigureBlock, Section, Table
from fluxtwin.scenarios.words import Words


class PageWords(Words):
    """The words of a page; paragraphs are parted by blank lines, and their lines are joined."""

    def paragraphs(self, name: str, **values: Any) -> list[str]:
        """The paragraphs of a section of the file; raises as `Words.say`."""
        return [" ".join(part.split()) for part in self.say(name, **values).split("\n\n") if part.strip()]

    def sentence(self, name: str, **values: Any) -> str:
        """The whole section as one paragraph."""
        return " ".join(self.say(name, **values).split())

    def section(
        self, name: str, tables: Sequence[Table] = (), figures: Sequence[FigureBlock] = (), **values: Any
    ) -> Section:
        """`## NAME`: a title, then the paragraphs."""
        title, *paragraphs = self.paragraphs(name, **values)
        return Section(title, paragraphs, tables, figures)

    def table(self, name: str, rows: Iterable[Sequence[Cell]], more: Sequence[str] = (), **values: Any) -> Table:
        """`## table_NAME`: a title, the headings with bars between them, perhaps a note. more: the last headings."""
        title, headings, *note = self.paragraphs(f"table_{name}", **values)
        return Table(title, [*headings.split(" | "), *more], list(rows), " ".join(note))

    def figure(self, name: str, drawn: Figure, **values: Any) -> FigureBlock:
        """`## figure_NAME`: the caption."""
        return FigureBlock(name, self.sentence(f"figure_{name}", **values), drawn)
