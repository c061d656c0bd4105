"""Build the pages of docs into a site, strictly: a broken link or anchor, a docstring that does not parse, a figure that is
not there fail, and so does a page that would fetch something or shows the marks of code or formulas.

Usage: python .ci/site.py FOLDER
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FETCHED = (
    r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*\bsrc=["']?(?:https?:)?//[^"' >]+"""
    r"""|<link\b(?![^>]*\brel=["']?canonical)[^>]*\bhref=["']?(?:https?:)?//[^"' >]+"""
    r"""|@import\s+(?:url\()?["']?(?:https?:)?//[^;]+|url\(["']?(?:https?:)?//[^)]+"""
)


def remote(folder: Path) -> list[str]:
    """What pages and styles in the folder would fetch from elsewhere."""
    return [
        f"{path.relative_to(folder)}: {hit.group()}"
        for path in sorted([*folder.rglob("*.html"), *folder.rglob("*.css")])
        for hit in re.finditer(FETCHED, path.read_text(encoding="utf-8"))
    ]


def unread(folder: Path) -> list[str]:
    """Marks of code or formulas that are left in the text of pages, as where a line of Markdown begins with a dash."""
    found = []
    for path in sorted(folder.rglob("*.html")):
        text = re.sub(r"<(pre|code|math|script|style)\b.*?</\1>", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        hits = re.finditer(r".{0,30}[`$].{0,30}", re.sub(r"<[^>]*>", "", text))
        found += [f"{path.relative_to(folder)}: not read as code or formula: {hit.group()}" for hit in hits]
    return found


def main(folder: Path) -> int:
    """The exit status of the build, or 1 where a page is not offline."""
    strict = ["-W", "--keep-going", "-q", "-E", "-b", "html", "-d", str(folder / ".doctrees")]
    built = subprocess.run([sys.executable, "-m", "sphinx", *strict, str(ROOT / "docs"), str(folder)], check=False)
    if built.returncode:
        return built.returncode
    found = remote(folder) + unread(folder)
    print("\n".join(found) or f"{len(list(folder.rglob('*.html')))} pages, none fetches anything")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
