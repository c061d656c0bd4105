"""How the pages become a site: `pip install '.[docs]' && python .ci/site.py FOLDER`. They read as plain Markdown, too."""

from __future__ import annotations

import inspect
import itertools
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from pygments.lexers import TextLexer
from sphinx.application import Sphinx

import fluxtwin
from fluxtwin.report import POWER, TOGETHER

HERE = Path(__file__).resolve().parent
project = "fluxtwin"
version = release = fluxtwin.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]
nitpicky = True
html_theme = "furo"  # its styles and scripts travel with the pages, which fetch nothing
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_title = f"fluxtwin {version}"
html_show_copyright = html_show_sphinx = html_copy_source = False
highlight_language = "none"  # what a fence does not name is not guessed
smartquotes_action = "qe"  # an option keeps its two dashes

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # the anchors that forges make, so that a link leads to the same place there and here

default_role = "code"  # `name` in a docstring
autodoc_typehints = "none"
autodoc_member_order = "bysource"
add_module_names = False

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MINUS = re.compile(r"(?<=[\de])-(?=\d)")
LONG = re.compile(r"[\w.:/|,]{25,}(?![^<]*>)")
PARAMETERS = re.compile(r"(?:^|(?<=[.;] ))([a-z_]\w*(?:, [a-z_]\w*)*): ")
OUTCOME = re.compile(r"(?<=[.;] )(?:Raises|Returns) ")


def parameters_as_list(_app: Any, _what: str, _name: str, thing: Any, _options: Any, lines: list[str]) -> None:
    """In a paragraph of a docstring that begins with parameters and a colon, each parameter is an item of a list, and what
    is raised or returned a paragraph of its own; bars (|B|) are bars."""
    try:
        known = {name.lstrip("*") for name in inspect.signature(thing).parameters}
    except (TypeError, ValueError):
        known = set()
    escaped = [re.sub(r"\|(?=[^`]*(?:`[^`]*`[^`]*)*$)", r"\|", line) for line in lines]
    made: list[str] = []
    for paragraph in "\n".join(escaped).split("\n\n"):
        made += [*_items(paragraph, known), ""]
    lines[:] = made


def _items(paragraph: str, known: set[str]) -> list[str]:
    text = paragraph.replace("\n", " ").strip()
    entries = {entry.start(): entry for entry in PARAMETERS.finditer(text) if known.issuperset(entry[1].split(", "))}
    if 0 not in entries:
        return paragraph.split("\n")
    starts = sorted([*entries, *(outcome.start() for outcome in OUTCOME.finditer(text))])
    made: list[str] = []
    for start, end in itertools.pairwise([*starts, len(text)]):
        piece = text[start:end].rstrip("; ")
        if start in entries:
            names = entries[start][1]
            made.append(f"* ``{names.replace(', ', '``, ``')}``: {piece[len(names) + 2 :]}")
        else:
            made += ["", piece]
    return made


def without_addresses(*event: Any) -> tuple[str | None, str | None]:
    """A default that is a function, or made by one, is dots."""
    signature, returned = event[-2:]
    return signature and re.sub(r"=<(?:function \S+|factory)>", "=...", signature), returned


def outside_as_files(_app: Any, name: str, source: list[str]) -> None:
    """A link to a page outside this folder (../CONTRIBUTING.md) leads to the file itself, which the site then holds."""

    def changed(link: re.Match[str]) -> str:
        inside = (HERE / name).parent.joinpath(link[2]).resolve().is_relative_to(HERE)
        return link[0] if inside else f"{{download}}`{link[1]} <{link[2]}>`"

    source[0] = re.sub(r"\[([^\]]+)\]\((\.\./[\w./-]+\.md)\)", changed, source[0])


def kept_together(_app: Any, doctree: nodes.document, _name: str) -> None:
    """Powers are raised; a line does not end between a number and its unit, within a range, or within an exponent."""
    for text in list(doctree.findall(nodes.Text)):
        if not isinstance(
            text.parent, nodes.literal | nodes.FixedTextElement | nodes.math | nodes.math_block | nodes.raw
        ):
            raised = POWER.sub(lambda power: power[1].translate(RAISED), str(text))
            kept = MINUS.sub("-\u2060", TOGETHER.sub("\u00a0", raised))
            if kept != text:
                text.parent.replace(text, nodes.Text(kept))


def divided(_app: Any, _page: str, _template: str, context: dict[str, Any], _doctree: Any) -> None:
    """A long name of code, or any in a table, may be divided after its signs; one of code that fits a line stays whole.
    Long texts in tables of many columns are marked, for narrow screens."""

    def parts(name: str) -> str:
        return re.sub(r"(?<=\w)([_.,:/|]+)(?=\w)", r"\1<wbr>", name)

    def whole(name: re.Match[str]) -> str:
        return parts(name[0])

    def code(word: re.Match[str]) -> str:
        size = "long" if len(word[1]) > 36 else "middling"
        return f'<span class="pre {size}">{parts(word[1])}</span>' if len(word[1]) > 24 else word[0]

    def row(cells: re.Match[str]) -> str:
        columns = cells[0].count("<td")
        most = 60 if columns > 4 else 150 if columns == 4 else len(cells[0])
        return re.sub(r"<td\b.*?</td>", lambda cell: marked(cell[0], most), cells[0], flags=re.DOTALL)

    def marked(cell: str, most: int) -> str:
        return cell.replace("<td", "<td data-long", 1) if len(re.sub(r"<[^>]*>", "", cell)) > most else cell

    body = re.sub(r"<td\b.*?</td>", lambda cell: LONG.sub(whole, cell[0]), context.get("body", ""), flags=re.DOTALL)
    body = re.sub(r"<tr\b.*?</tr>", row, body, flags=re.DOTALL)
    context["body"] = re.sub(r'<span class="pre">(.*?)</span>', code, body)
    context["toc"] = LONG.sub(whole, context.get("toc", ""))


def mathml(self: Any, node: nodes.Element) -> None:
    """A formula as MathML, which browsers draw by themselves: no script, nothing to fetch."""
    inline = isinstance(node, nodes.math)
    markup = tex2mathml(node.astext(), as_block=not inline)
    markup = re.sub(r"<mo>&ApplyFunction;</mo>(?!\s*<mo[^>]*>\()", '<mspace width="0.17em"></mspace>', markup)
    self.body.append(markup if inline else f'<div class="math">{markup}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", outside_as_files)
    app.connect("autodoc-process-docstring", parameters_as_list)
    app.connect("autodoc-process-signature", without_addresses)
    app.connect("doctree-resolved", kept_together)
    app.connect("html-page-context", divided)
    for shell in ("console", "sh"):  # words of other commands and halves of numbers are not coloured
        app.add_lexer(shell, TextLexer)
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))
