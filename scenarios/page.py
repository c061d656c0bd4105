"""What a study hands back: numbers, tables and one page, as records, and that page as Markdown. Nothing here writes a file.

The front door (`fluxtwin.studies`) writes `summary.json`, figures and `report.html` from these records, so
a study needs to know nothing of terminals or HTML. Text may hold anything, units in square brackets and
foreign names included: whoever shows it escapes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from fluxtwin.sim.base.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fluxtwin.plots.time_series import TimeSeries

Cell: TypeAlias = str | float | int | bool | None
"""One cell of a table: text stays as it is, a float is shown with four significant digits, None is blank."""


def as_markdown(page: Page, folder: str = "") -> str:
    """The page; figures are linked as `folder` + NAME.png."""
    parts = [f"# {page.title}", page.verdict]
    for section in page.sections:
        parts.append(f"## {section.title}")
        parts += [_escaped(paragraph) for paragraph in section.paragraphs]
        parts += [table_as_markdown(table) for table in section.tables]
        parts += [f"![{block.name}]({folder}{block.name}.png)\n\n{block.caption}" for block in section.figures]
    if page.provenance:
        parts.append("\n".join(["## Provenance", "", *(f"- {key}: {value}" for key, value in page.provenance.items())]))
    return "\n\n".join(parts) + "\n"


def table_as_markdown(table: Table) -> str:
    """Title, rows and note; numeric columns to the right."""
    numeric = [all(isinstance(row[place], int | float) for row in table.rows) for place in range(len(table.columns))]
    lines = [
        f"**{table.title}**",
        "",
        "| " + " | ".join(_escaped(name) for name in table.columns) + " |",
        "|" + "|".join("--:" if right else "---" for right in numeric) + "|",
        *("| " + " | ".join(_cell(cell) for cell in row) + " |" for row in table.rows),
    ]
    return "\n".join([*lines, "", _escaped(table.note)] if table.note else lines)


def _cell(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.4g}" if isinstance(cell, float) else _escaped(str(cell))


def _escaped(text: str) -> str:
    """Underscores inside names are left alone by Markdown; bars and angle brackets are not."""
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


@dataclass(frozen=True)
class Table:
    """A table to read; every numeric column says its unit in its heading, as `b [mG]`."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    """What the reader must know to read it: the paper's equation or table, the condition, the source."""

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows, start=1):
            if len(row) != len(self.columns):
                raise ValueError(
                    f"table {self.title!r}: row {number} has {len(row)} cells, the heading has {len(self.columns)}"
                )


@dataclass(frozen=True)
class FigureBlock:
    """One figure with the caption that makes it readable by itself."""

    name: str
    """File name without suffix, as `figure_2`."""
    caption: str
    figure: Figure | bytes | TimeSeries
    """A matplotlib Figure, the bytes of a PNG file, or series, which the page's script can zoom."""


@dataclass(frozen=True)
class PageSection:
    """A part of a page: a heading, paragraphs, then tables, then figures."""

    title: str
    paragraphs: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[FigureBlock] = ()


@dataclass(frozen=True)
class Page:
    """A study or a result as one page: the verdict first, the evidence below it."""

    title: str
    verdict: str
    """One sentence: what came out."""
    sections: Sequence[PageSection] = ()
    errata: Sequence[str] = ()
    """Slips found in the published source, one sentence each."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Versions, seed, field model, input files with their SHA-256."""
    next_step: str = ""
    """What to do now: a sentence or a command."""
    command: str = ""
    """What repeats it, as a shell takes it."""
    downloads: Mapping[str, str] = field(default_factory=dict)
    """Text files that the page carries, by name: parameters, the answer for machines."""
    links: Mapping[str, str] = field(default_factory=dict)
    """Other pages of the same folder: what the link says, and the file."""


@dataclass(frozen=True)
class StudyResult(Shown):
    """What `run` of a study returns."""

    name: str
    status_line: str
    """One sentence for the last line of the terminal."""
    summary: Mapping[str, Any]
    """The content of `summary.json`: numbers, strings, lists and mappings; no NaN, no arrays."""
    tables: Sequence[Table] = ()
    """The tables for the terminal, in order."""
    page: Page | None = None
    """The page that becomes `report.html`; its figures are also written as `NAME.png`."""
    written: Sequence[Path] = ()
    """Files the study has written itself (scenario, telemetry, calibration)."""
    more_pages: Mapping[str, Page] = field(default_factory=dict)
    """Further pages by file name without suffix, written as `NAME.html`; their figures as `NAME_FIGURE.png`."""
