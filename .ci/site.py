"""Build the pages of docs into a site, strictly: a broken link or anchor, a docstring that does not parse, a figure that is
not there fail, and so does a page that would fetch something.

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


def main(folder: Path) -> int:
    """The exit status of the build, or 1 where a page is not offline."""
    strict = ["-W", "--keep-going", "-q", "-E", "-b", "html", "-d", str(folder / ".doctrees")]
    built = subprocess.run([sys.executable, "-m", "sphinx", *strict, str(ROOT / "docs"), str(folder)], check=False)
    if built.returncode:
        return built.returncode
    found = remote(folder)
    print("\n".join(found) or f"{len(list(folder.rglob('*.html')))} pages, none fetches anything")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
