"""One self-contained page from a `Page` record: nothing fetched, figures inside.

Every text goes through jinja2's autoescape, so foreign names stay text. Where a page has series it has one script, ours,
which the content policy allows by its digest alone; without it the figures stand as they are.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
from dataclasses import replace
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fluxtwin.console import clean, command_line, is_number, shown
from fluxtwin.sim.base.files import write_bytes, write_text

if TYPE_CHECKING:
    from jinja2 import Template
    from matplotlib.figure import Figure

    from fluxtwin.plots.time_series import TimeSeries
    from fluxtwin.scenarios.page import FigureBlock, Page, Table

FIGURE_DPI = 140
_HYPHENED = re.compile(r"(--\w[\w-]*|\b\w+(?:-\w+)+\b)")
_UNITS = r"%|(?:[nµu]T|mG|deg|[mu]?s|min|h|[km]?m|m?Hz|rpm|MB|m?A|rad)\b"
TOGETHER = re.compile(
    rf"(?<=\d) (?={_UNITS}|± )|(?<=±) |(?<=[\d%]) (?=(?:of|to) -?\d)|(?<=[\d%] (?:of|to)) (?=-?\d)|(?<=\w) (?=x\d)"
    r"|(?<=\bstatus) (?=\d)|(?<=\bN) (?=m\b)|(?<=N m) (?=s\b)|(?<=[Ag]) (?=m2\b)"
)
"""Spaces at which no line of a page ends."""
POWER = re.compile(r"(?<=[|;>\w)])\^(-?\d+)")
_CODE = re.compile("`([^`]+)`")
_LONG = re.compile(r"(?<=\w{3})_(?=\w{3})")  # C_yy stays whole
_TELEPHONE = 46  # letters in a row of a table on a telephone of 390 px
_READABLE_PX = 9.1  # of the smallest text of a figure, on whatever screen; its frame takes a little


def render_report(page: Page) -> str:
    """The page as HTML, one file: style, tables and figures inside."""
    import fluxtwin

    template, style, script = _parts()
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    html: str = template.render(page=page, version=fluxtwin.__version__, style=style, script=script, digest=digest)
    return html


def write_page(page: Page, path: Path, command: str | None = None) -> Path:
    """Write the page as HTML, with what repeats it: `command`, else this call of the command line. Returns the path."""
    return write_text(path, render_report(replace(page, command=command_line() if command is None else command)))


def write_figures(page: Page, folder: Path, prefix: str = "") -> list[Path]:
    """Write each figure of the page as `NAME.png`; returns the paths."""
    blocks = [block for section in page.sections for block in section.figures]
    return [write_bytes(folder / f"{prefix}{block.name}.png", png_bytes(block.figure)) for block in blocks]


def png_bytes(figure: Figure | TimeSeries) -> bytes:
    """The figure as a PNG without a date inside."""
    buffer = io.BytesIO()
    _drawn(figure).savefig(buffer, format="png", dpi=FIGURE_DPI, metadata={"Software": "fluxtwin"})
    return buffer.getvalue()


def _drawn(figure: Figure | TimeSeries) -> Figure:
    from fluxtwin.plots.time_series import TimeSeries, draw_time_series

    return draw_time_series(figure) if isinstance(figure, TimeSeries) else figure


def _shown(block: FigureBlock) -> dict[str, Any]:
    """A figure as the template takes it: the picture, the width [px] below which it is scrolled instead of shrunk, and the
    data of its series."""
    from PIL import Image

    from fluxtwin.plots.time_series import TimeSeries

    series = block.figure.to_dict() if isinstance(block.figure, TimeSeries) else None
    figure = _drawn(block.figure)
    png = png_bytes(figure)
    # The same picture in 64 colours, a quarter of the size.
    buffer = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(buffer, "png", optimize=True)
    uri = "data:image/png;base64," + base64.b64encode(min(png, buffer.getvalue(), key=len)).decode("ascii")
    width = round(_READABLE_PX * 72.0 * figure.get_figwidth() / _smallest(figure))
    data = "" if series is None else json.dumps(series, separators=(",", ":")).replace("<", "\\u003c")
    return {"uri": uri, "width": width, "data": data}


def _smallest(figure: Figure) -> float:
    """Size of the smallest text of a figure [pt]."""
    from matplotlib.text import Text

    seen = [text for text in figure.findobj(Text) if isinstance(text, Text) and text.get_text() and text.get_visible()]
    return min((float(text.get_fontsize()) for text in seen), default=8.0)


def _command(text: str) -> str:
    """The text as HTML: words that stay on one line though they have a hyphen, lines that may end behind an underscore."""
    parts = [
        f'<span class="whole">{part}</span>' if k % 2 else _LONG.sub("_<wbr>", part)
        for k, part in enumerate(_HYPHENED.split(escape(clean(text))))
    ]
    return "".join(parts)


def _whole(text: str) -> str:
    """As `_command`, with code between its marks, powers raised and numbers beside their units, as no shell takes them."""
    return _CODE.sub(r"<code>\1</code>", POWER.sub(r"<sup>\1</sup>", _command(TOGETHER.sub("\u00a0", text))))


def _broad(table: Table) -> bool:
    """Whether a table is broader than a telephone: then each row is a block there. A matrix of numbers stays one."""
    columns = [[shown(row[k]) for row in table.rows] for k in range(len(table.columns))]
    least = 24 if len(columns) > 3 else 60
    if any(" " in text and len(text) > least for column in columns for text in column):
        return True
    texts = [" ".join([name, *column]) for name, column in zip(table.columns, columns, strict=True)]
    words = [TOGETHER.sub("\u00a0", text).replace("_", "_ ").split(" ") for text in texts]
    return len(columns) <= 8 and sum(max(map(len, column)) + 2 for column in words) > _TELEPHONE  # 2: its margins


def _titled(text: str) -> list[tuple[str, str]]:
    """The parts of a cell that lists effects and nothing else, each with what it is; any other text whole, with nothing."""
    from fluxtwin.sim.effects.catalogue import title_of

    parts = re.split(r"(?<=,) |(?<= /) |(?<= or) ", text)
    titles = [title_of(re.sub(r",$| /$| or$| \(named\)$", "", part)) for part in parts]
    return list(zip(parts, titles, strict=True)) if all(titles) else [(text, "")]


def _download(text: str) -> str:
    return "data:application/octet-stream;base64," + base64.b64encode(text.encode("utf-8")).decode("ascii")


@cache
def _parts() -> tuple[Template, str, str]:
    """The template, the style and the script of every page."""
    from importlib.resources import files

    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("fluxtwin", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters: dict[str, Any] = {"shown": shown, "clean": clean, "whole": _whole, "command": _command}
    environment.filters |= {**filters, "titled": _titled, "drawn": _shown, "broad": _broad, "download": _download}
    environment.tests["numeric"] = is_number
    style, script = ((files("fluxtwin") / "templates" / f"report.{end}").read_text("utf-8") for end in ("css", "js"))
    return environment.get_template("report.html"), style, script
