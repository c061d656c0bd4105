"""What a study hands back: numbers, tables and one page, as records. Nothing here writes a file.

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


def with_rows(*tables: Table) -> list[Table]:
    """Those of the tables that have any."""
    return [table for table in tables if table.rows]


@dataclass(frozen=True)
class FigureBlock:
    """One figure with the caption that makes it readable by itself."""

    name: str
    """File name without suffix, as `figure_2`."""
    caption: str
    figure: Figure | TimeSeries
    """A matplotlib Figure, or series, which the page's script can zoom."""


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
