"""A page from a file of words: sections, tables by expression or by rows, captions; what is missing is an error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from jinja2 import UndefinedError
from matplotlib.figure import Figure

from fluxtwin.scenarios import words
from fluxtwin.scenarios.words import Words

pytestmark = pytest.mark.property

TEXT = """{# About the file, which nobody reads. #}

## page
# The whole

### A title

Words over
two lines with {{ '%.1f' % x }} nT.

[table plain]

[table drawn north]

[figure one]
Caption of {{ x }}.

## plain
Plain

for row in plain
a = row[0]
{% for n in (1, 2) %}
c{{ n }} = row[{{ n }}]
{% endfor %}

## drawn
By expression

for item in items
name = item.name ~ argument
half [nT] = round(item.size / 2, 2)
missing = none

A note
in two lines.
"""


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Words:
    (tmp_path / "words.md").write_text(TEXT, encoding="utf-8")
    monkeypatch.setattr(words.resources, "files", lambda _: tmp_path)
    return Words("anything")


def test_a_page_is_built_in_the_order_of_the_file(page: Words) -> None:
    items = [{"name": "A", "size": 3.0}, {"name": "B", "size": 0.25}]
    figure = Figure()
    made = page.page("verdict", {"one": lambda: figure}, {}, x=1.25, items=items, plain=[[1, 2, 3]])
    (section,) = made.sections
    assert section.title == "A title"
    assert section.paragraphs == ["Words over two lines with 1.2 nT."]
    plain, drawn = section.tables
    assert (plain.columns, plain.rows, plain.note) == (["a", "c1", "c2"], [[1, 2, 3]], "")
    assert drawn.columns == ["name", "half [nT]", "missing"]
    assert drawn.rows == [["Anorth", 1.5, None], ["Bnorth", 0.12, None]]
    assert drawn.note == "A note in two lines."
    (block,) = section.figures
    assert (block.name, block.caption, block.figure) == ("one", "Caption of 1.25.", figure)


def test_a_value_that_is_missing_is_an_error(page: Words) -> None:
    with pytest.raises(UndefinedError, match="size"):
        page.table("drawn", items=[{"name": "A"}])
    with pytest.raises(UndefinedError, match="'x' is undefined"):
        page.page("verdict", {}, {}, items=[])
    with pytest.raises(KeyError):
        page.table("absent")


def test_a_record_in_a_sentence_is_an_error() -> None:
    """A page once printed a whole answer where the number of cut rows was meant."""
    sentence = words._environment().from_string("{{ x }} rows")
    assert sentence.render(x=np.int64(58)) == "58 rows"
    with pytest.raises(TypeError, match="ndarray: words want a number or a text"):
        sentence.render(x=np.zeros(3))
