"""A page as Markdown, for the documents: the same words, tables and figures as in report.html."""

from __future__ import annotations

from fluxtwin.scenarios.page import Cell, Page, Table


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
