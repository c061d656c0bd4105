"""Every command of the tutorial, the how-tos and the page on diagnosis is run, and prints what the page shows."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest
from command_line import ROOT, Cli
from pages import Command, differs, follow, steps

pytestmark = pytest.mark.usefixtures("small_figures")

PAGES = [ROOT / "docs" / "tutorial.md", ROOT / "docs" / "diagnosis.md", *sorted((ROOT / "docs" / "howto").glob("*.md"))]


@pytest.mark.filterwarnings("default::UserWarning")  # a note for the user, which the page does not show
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_says_what_is_printed(page: Path, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def run(words: list[str]) -> tuple[int, str]:
        program, *rest = words
        if program == "fluxtwin":
            done = cli(*rest)
            return done.status, done.out if done.status != 2 else done.out + done.err
        assert program == "python", f"{program}: a page may run fluxtwin and python"
        with monkeypatch.context() as changed:
            changed.setattr(sys, "argv", rest)
            runpy.run_path(rest[0], run_name="__main__")
        return 0, ""

    assert "\n\n".join(follow(page, tmp_path, run)) == ""


@pytest.mark.filterwarnings("default::UserWarning")
def test_the_examples_of_the_interface_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert len(examples) == text.count("\n## ") + 1, "one for each part, and the first"
    names: dict[str, object] = {}
    for example in examples:
        exec(compile(example, "api.md", "exec"), names)


def test_pages_have_commands() -> None:
    for page in PAGES:
        assert any(isinstance(step, Command) for step in steps(page.read_text(encoding="utf-8"))), page.name


def test_a_page_that_shows_something_else_is_seen() -> None:
    printed = "Good. The residual is 50.5 nT.\nname   value\n────────────\nb1      1514\n  made by 0123456789ab\n"
    for same in (
        printed,
        "Good. The residual\nis 50.5 nT.\n...\n",
        "Good. The residual is 50.6 nT.\nname value\nb1 1513\n  made by ba9876543210\n",
        "...\nb1      1514\n...\n",
    ):
        assert differs(same, printed) == "", same
    for other in (
        "Good. The residual is 50.7 nT.\n...\n",
        "Good. The residual is 51 nT.\n...\n",
        "Bad. The residual is 50.5 nT.\n...\n",
        "Good. The residual is 50.5 nT.\n",
        "...\nb1      1514\n",
        "...\nb2      1514\n...\n",
        "",
    ):
        assert differs(other, printed) != "", other
