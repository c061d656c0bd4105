"""The project speaks of itself alone: no path of the machine it was written on, no private package index."""

from __future__ import annotations

import re
from pathlib import Path

TOP_FOLDERS = "home|root|work|opt|srv|mnt|media|tmp|var|usr|Users"
FORBIDDEN = re.compile(rf"""(?<![\w.~/\]-])/(?:{TOP_FOLDERS})(?=[/\s"'`:),]|$)|index-url""", re.MULTILINE)
TEXT = {".py", ".md", ".toml", ".cff", ".html", ".css", ".csv", ".json", ".txt", ".c", ""}
SHEBANG = "#!/usr/bin/env"


def test_no_path_or_index_of_a_machine(tracked: list[Path], root: Path) -> None:
    texts = {
        path.relative_to(root): path.read_text(encoding="utf-8", errors="replace").replace(SHEBANG, "")
        for path in tracked
        if path.suffix in TEXT and path != Path(__file__)
    }
    assert len(texts) > 30
    found = [
        f"{path}: line {text.count(chr(10), 0, hit.start()) + 1}: {hit.group()}"
        for path, text in texts.items()
        for hit in FORBIDDEN.finditer(text)
    ]
    assert found == []


def test_a_path_of_a_machine_is_seen() -> None:
    for bad in ("see /" + "work/main", "'/" + "root/.cache'", "(/" + "opt/x)", "pip --index-" + "url x"):
        assert FORBIDDEN.search(bad), bad
    for good in ("framework/root", "../work", "the work/root", "a /workshop", "km/s", "and/or"):
        assert not FORBIDDEN.search(good), good
