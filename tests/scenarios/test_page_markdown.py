"""A page as Markdown: tables keep their columns, and nothing in a cell ends it."""

from __future__ import annotations

from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table, as_markdown, table_as_markdown


def test_a_table_keeps_its_columns() -> None:
    table = Table("Sizes", ["|lat| [deg]", "rms [nT]"], [["a | b", 1.23456], ["< 50", 2.0]], note="p < 0.1")
    title, _, heading, rule, *rows, _, note = table_as_markdown(table).splitlines()
    assert title == "**Sizes**"
    assert heading == r"| \|lat\| [deg] | rms [nT] |"
    assert rule == "|---|--:|"
    assert rows == [r"| a \| b | 1.235 |", "| &lt; 50 | 2 |"]
    assert note == "p &lt; 0.1"


def test_a_page_has_its_words_and_figures_in_order() -> None:
    block = FigureBlock("fig", "what it shows", b"")
    page = Page("Title", "The verdict.", [PageSection("One", ["said"], [], [block])], provenance={"seed": "1"})
    text = as_markdown(page, "images/")
    places = [
        text.index(part) for part in ("# Title", "The verdict.", "## One", "said", "(images/fig.png)", "- seed: 1")
    ]
    assert places == sorted(places)
    assert table_as_markdown(Table("T", ["a"], [[None], [True]])).splitlines()[-2:] == ["|  |", "| yes |"]
