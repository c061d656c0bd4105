"""One self-contained page from a `Page` record: no script, nothing fetched, figures inside.

Every text goes through jinja2's autoescape, so foreign names stay text.
"""

from __future__ import annotations

import base64
import io
from functools import cache
from typing import TYPE_CHECKING, Any

from fluxtwin.console import clean, is_number, shown

if TYPE_CHECKING:
    from jinja2 import Template
    from matplotlib.figure import Figure

    from fluxtwin.scenarios.page import Page

FIGURE_DPI = 140


def render_report(page: Page) -> str:
    """The page as HTML, one file: style, tables and figures inside.

    Raises ValueError for a figure that is neither a matplotlib Figure nor the bytes of a PNG.
    """
    import fluxtwin

    html: str = _template().render(page=page, version=fluxtwin.__version__)
    return html


def png_bytes(figure: Figure | bytes) -> bytes:
    """The figure as a PNG without a date inside; bytes of a PNG come back as they are."""
    if isinstance(figure, bytes):
        if not figure.startswith(b"\x89PNG\r\n\x1a\n"):
            raise ValueError("a figure given as bytes must be a PNG")
        return figure
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=FIGURE_DPI, metadata={"Software": "fluxtwin"})
    return buffer.getvalue()


def _data_uri(figure: Figure | bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png_bytes(figure)).decode("ascii")


@cache
def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("fluxtwin", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters: dict[str, Any] = {"shown": shown, "clean": clean, "data_uri": _data_uri}
    environment.filters.update(filters)
    environment.tests["numeric"] = is_number
    return environment.get_template("report.html")
