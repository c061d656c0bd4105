"""A study's report from Markdown: cells, pages, claims and the summary come out as they are written."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from fluxtwin.scenarios.words import Words

pytestmark = pytest.mark.property

WORDS = """{% set size = 2.5 %}

## sizes
Sizes of {{ name_of }}

| name | |value| [nT] | left |
|---|
{% for one in values %}
| {{ name_of }} | |{{ one|f(1) }}| |  |
{% endfor %}

Said
twice.

## page
# A title

### First

One paragraph
in two lines.

[table sizes]

[figure drawn]
Its caption.

### Errata

- One slip
  in two lines.
- Another.

## 7
{% set value, unit, holds = size, 'nT', size < limit %}
{{ value }} nT

otherwise: too large

remark: as printed
"""
CLAIMS = '[[claim]]\nid = 7\nwhere = "Table 1"\npaper = "2 nT"\n'
SUMMARY = """
study = "'toy'"
[let]
twice = "2 * values[0]"
[found]
with = "dict(more=twice)"
mean = "np.mean(values)"
[found.squares]
each = "dict(a=1, b=2)"
key = "key"
square = "one**2"
"""
FIGURES = """
[let]
half = "0.5 * size_nT"
[bars]
draw = "gap.left_alone"
title = "{{ who }} alone"
let.names = "['first', 'second']"
names = "names"
left_nT = "[half, size_nT]"
parameters = "[1, 2]"
limit_nT = "2 * size_nT"
"""


@pytest.fixture
def report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Words:
    folder = tmp_path / "toy_study"
    folder.mkdir()
    for name, text in {
        "__init__.py": "",
        "words.md": WORDS,
        "summary.toml": SUMMARY,
        "figures.toml": FIGURES,
    }.items():
        (folder / name).write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    return Words("toy_study", limit=3.0)


def test_cells_keep_their_bars_and_their_place(report: Words) -> None:
    table = report.table("sizes", name_of="x", values=[1.0, -2.25])
    assert (table.title, table.note) == ("Sizes of x", "Said twice.")
    assert list(table.columns) == ["name", "|value| [nT]", "left"]
    assert list(table.rows) == [["x", "|1.0|", ""], ["x", "|-2.2|", ""]]


def test_a_page_has_its_parts(report: Words) -> None:
    figures = {"drawn": lambda: b"PNG"}
    page = report.page("The verdict.", figures, {"seed": "1"}, name_of="x", values=[])  # type: ignore[arg-type]
    (section,) = page.sections
    assert (page.title, section.title, list(section.paragraphs)) == (
        "A title",
        "First",
        ["One paragraph in two lines."],
    )
    assert [table.title for table in section.tables] == ["Sizes of x"]
    assert [(block.name, block.caption) for block in section.figures] == [("drawn", "Its caption.")]
    assert list(page.errata) == ["One slip in two lines.", "Another."]


@pytest.mark.parametrize(
    ("limit", "status", "why"), [(3.0, "reproduced", "as printed"), (1.0, "differs", "as printed; too large")]
)
def test_a_claim_is_judged_by_its_section(report: Words, limit: float, status: str, why: str) -> None:
    (claim,) = report.judge(tomllib.loads(CLAIMS)["claim"], limit=limit)
    assert (claim.here, claim.value, claim.unit, claim.status, claim.why) == ("2.5 nT", 2.5, "nT", status, why)


def test_the_summary_is_what_its_expressions_say(report: Words) -> None:
    found = report.summary(values=[1.0, 2.0])
    each = {"a": {"key": "a", "square": 1}, "b": {"key": "b", "square": 4}}
    assert found == {"study": "toy", "found": {"more": 2.0, "mean": 1.5, "squares": each}}
    with pytest.raises(UndefinedError):
        report.summary(other=1.0)


def test_a_figure_is_what_its_expressions_say(report: Words) -> None:
    drawn = report.figures(size_nT=3.0, who="each effect")["bars"]()
    (axes,) = drawn.axes
    assert axes.get_title(loc="left") == "each effect alone"
    assert [bar.get_width() for bar in axes.patches] == [1.5, 3.0]
    assert [text.get_text() for text in axes.texts] == ["1.5 nT, 1 parameter", "3.0 nT, 2 parameters"]
    with pytest.raises(UndefinedError):
        report.figures(who="each effect")["bars"]()
