"""What reaches the eye: units in brackets stay, foreign text stays text, the page fetches nothing."""

from __future__ import annotations

import base64
import hashlib
import html.parser
import io
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import fluxtwin
from fluxtwin.console import Manners, Output, clean, shown
from fluxtwin.plots.time_series import Line, Panel, TimeSeries, field_panels, residual_panels
from fluxtwin.report import png_bytes, render_report
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, StudyResult, Table
from fluxtwin.sim.base.seals import digest_of

HOSTILE = [
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    '"><svg onload=alert(1)>',
    "' onmouseover='alert(1)",
    "{{ 7*7 }}{% raw %}",
    "[bold red]mag_x [nT][/bold red]",
    "[/tmp].csv",
    "\x1b[2J\x1b]0;title\x07",
    "javascript:alert(1)",
    "</style><script src=//example.org/x.js></script>",
    "left\u202eright",
    "$\\frac{$",
]


class Reader(html.parser.HTMLParser):
    """Collects the tags, their attributes and the text a reader sees."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if (tag, attrs) not in (("wbr", []), ("span", [("class", "whole")])):  # where a line may break, or may not
            self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def page_with(text: str) -> Page:
    figure = Figure(figsize=(1, 1))
    table = Table(text, [text, "b [mG]"], [[text, 1.23456]], note=text)
    return Page(
        title=text,
        verdict=text,
        sections=[PageSection(text, [text], [table], [FigureBlock("one", text, figure)]), PageSection("other")],
        errata=[text],
        provenance={text: text},
    )


@pytest.mark.parametrize("text", HOSTILE)
def test_foreign_text_stays_text_on_the_page(text: str) -> None:
    page = render_report(page_with(text))
    plain = render_report(page_with("harmless"))
    found, wanted = Reader(), Reader()
    found.feed(page)
    wanted.feed(plain)
    assert [tag for tag, _ in found.tags] == [tag for tag, _ in wanted.tags], "foreign text made an element"
    assert [sorted(a) for _, a in found.tags] == [sorted(a) for _, a in wanted.tags], "foreign text made an attribute"
    assert clean(text) in "".join(found.text)
    assert "\x1b" not in page


def test_a_page_without_series_fetches_nothing_and_runs_nothing() -> None:
    reader = Reader()
    reader.feed(render_report(page_with("x")))
    assert "script" not in {tag for tag, _ in reader.tags}
    for tag, attributes in reader.tags:
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "href"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:image/png;base64,", "#")), (tag, value)
    policy = [a["content"] for tag, a in reader.tags if tag == "meta" and "http-equiv" in a]
    assert policy[0] is not None
    assert "default-src 'none'" in policy[0]


def test_the_page_shows_units_numbers_and_figures() -> None:
    page = render_report(page_with("B [nT]"))
    assert page.count("B [nT]") > 5
    assert '<td class="number" data-of="b [mG]">1.235</td>' in page
    assert '<th scope="col" class="number">b [mG]</th>' in page
    assert page.count("data:image/png;base64,") == 1


def test_the_same_figure_gives_the_same_bytes() -> None:
    assert png_bytes(Figure(figsize=(1, 1))) == png_bytes(Figure(figsize=(1, 1)))


def test_a_row_that_does_not_fit_its_heading_is_refused() -> None:
    with pytest.raises(ValueError, match="row 2 has 1 cells, the heading has 2"):
        Table("t", ["a", "b"], [[1, 2], [3]])


def test_units_reach_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    output = Output()
    output.table("Table 2 [mG]", ["mag_x [nT]", "name"], [[1.5, "[red]x[/red] [nT]"], [None, "[/x].csv"]], "[deg]")
    output.say("yaw [deg]")
    text = capsys.readouterr().out
    for wanted in ("Table 2 [mG]", "mag_x [nT]", "[red]x[/red] [nT]", "[/x].csv", "[deg]", "yaw [deg]"):
        assert wanted in text
    assert "\x1b" not in text


def test_a_wide_table_is_not_cut_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    Output().table("t", ["a", "b"], [["x" * 300, "end [nT]"]])
    assert "x" * 300 + "  " in capsys.readouterr().out


def test_a_long_sentence_wraps_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    Output().table("t", ["a", "why"], [["x", "word " * 60]], note="note " * 60)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 120
    assert " ".join(lines).count("word") == 60


@pytest.mark.parametrize("text", ["\x1b[31m", "a\rb", "\x9b1m", "\u202e", "\u2066", "\x00", "\x08"])
def test_control_characters_become_visible(text: str) -> None:
    assert "\\" in clean(text)
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e\u2066]", clean(text))


def test_numbers_are_shown_with_four_digits() -> None:
    cells = [1.23456, -0.00012345, 123456.789, 12, None, True, "1.23456", 0.0, float("nan")]
    assert [shown(c) for c in cells] == [
        "1.235",
        "-0.0001234",
        "123457",
        "12",
        "",
        "yes",
        "1.23456",
        "0",
        "nan",
    ]


class Terminal(io.StringIO):
    """Standard error as a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("kind", "quiet"), [(Terminal, False), (Terminal, True), (io.StringIO, False)])
def test_progress_is_shown_on_a_terminal_when_work_lasts_and_never_in_a_log(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, kind: type[io.StringIO], quiet: bool
) -> None:
    monkeypatch.setattr("fluxtwin.console._QUIET_SECONDS", 0.0)
    monkeypatch.setattr("fluxtwin.console.manners", Manners(quiet=quiet))
    monkeypatch.setattr(sys, "stderr", kind())
    monkeypatch.setenv("TERM", "xterm")
    shows = kind is Terminal and not quiet
    with Output().progress("first step [nT]") as progress:
        deadline = time.monotonic() + (10 if shows else 0.5)
        while "first step" not in sys.stderr.getvalue() and time.monotonic() < deadline:
            time.sleep(0.05)
        progress("second step", 0.5)
        shown = sys.stderr.getvalue() if shows else ""
    assert ("first step [nT]" in shown) == shows
    if not shows:
        assert sys.stderr.getvalue() == ""
    assert capsys.readouterr().out == ""


def test_a_terminal_of_80_columns_keeps_names_and_numbers_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    name = "gravity_gradient_inertia_error"
    Output().table("t", ["effect", "why", "p"], [[name, "a sentence of many words " * 5, 1.2345e-12]])
    assert name in sys.stdout.getvalue()
    assert "1.235e-12" in sys.stdout.getvalue()
    assert "…" not in sys.stdout.getvalue()


def test_a_note_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    output = Output()
    for text in ("note: a", "note: b", "note: a"):
        output.note(text)
    assert capsys.readouterr().err == "note: a\nnote: b\n"


def test_json_alone_goes_to_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    output = Output("-")
    output.say("words")
    output.table("t", ["a"], [[1]])
    output.result({"F_nT": 1.0})
    digest = digest_of({"fluxtwin": fluxtwin.__version__, "format": 1, "F_nT": 1.0})
    head = f'{{\n  "fluxtwin": "{fluxtwin.__version__}",\n  "format": 1,\n  "F_nT": 1.0,\n'
    assert capsys.readouterr().out == f'{head}  "sha256": "{digest}"\n}}\n'


def test_a_study_is_written_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fluxtwin import studies

    own = tmp_path / "scenario.toml"

    def run(out: Path, data: Path | None, progress: object) -> StudyResult:
        own.write_text("seed = 1\n", encoding="utf-8")
        return StudyResult("s", "done", {"a": 1}, [], page_with("x"), [own])

    monkeypatch.setattr(studies, "find_study", lambda name: run)
    result, written = studies.run_study("s", tmp_path / "out")
    assert result.status_line == "done"
    assert {p.name for p in written} == {"scenario.toml", "one.png", "report.html", "summary.json"}
    assert all(p.stat().st_size for p in written)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"one.png", "report.html", "summary.json"}


def test_series_bring_one_script_which_the_policy_names_by_its_digest() -> None:
    time = np.datetime64("2026-03-01", "ns") + np.arange(9) * np.timedelta64(10, "s")
    lines = [Line("</script><script>alert(1)</script>", np.arange(9.0), "#000000")]
    series = TimeSeries("t", time, [Panel("<b>x</b> [nT]", lines)])
    page = render_report(Page("t", "v", sections=[PageSection("s", figures=[FigureBlock("one", "c", series)])]))
    (policy,) = re.findall("script-src '(sha256-[^']+)';", page)
    scripts = re.findall("<script([^>]*)>(.*?)</script>", page, flags=re.DOTALL)
    assert [kind for kind, _ in scripts] == [' type="application/json"', ""], "foreign text made no script"
    assert policy == "sha256-" + base64.b64encode(hashlib.sha256(scripts[1][1].encode()).digest()).decode()
    assert json.loads(scripts[0][1])["panels"][0]["lines"][0]["name"] == lines[0].name
    assert "unsafe-inline" not in page.partition("style-src")[0] and "http://" not in scripts[1][1] + scripts[0][1]
    assert page.count("data:image/png;base64,") == 1, "without scripts the figure stands"


def test_two_magnetometers_of_a_long_record_leave_room_on_a_page_of_two_megabytes() -> None:
    """Field and residual of each, of noise, which nothing can compress; maps and drivers of both take 0.45 MB."""
    count = 100_000
    time = np.datetime64("2026-03-01", "ns") + np.arange(count) * np.timedelta64(5, "s")
    noise = np.random.default_rng(1).normal(0.0, 100.0, (2, count, 3))
    field = 30_000.0 * np.cos(np.arange(count)[:, None] / 180.0 + np.arange(3)) + noise[0]
    aside = np.arange(count) % 1000 == 0
    panels = [field_panels(field, field + noise[1], aside), residual_panels(noise[0], "xyz", aside, before_nT=noise[1])]
    blocks = [FigureBlock(f"f{k}", "c", TimeSeries("t", time, panels[k % 2])) for k in range(4)]
    assert len(render_report(Page("t", "v", sections=[PageSection("s", figures=blocks)]))) < 1_550_000


@pytest.mark.parametrize("size_pt", [6.0, 12.0])
def test_a_figure_is_never_so_narrow_that_its_text_is_below_nine_pixels(size_pt: float) -> None:
    figure = Figure(figsize=(5, 2))
    figure.text(0.5, 0.5, "words", fontsize=size_pt)
    page = render_report(Page("t", "v", sections=[PageSection("s", figures=[FigureBlock("one", "c", figure)])]))
    (width,) = re.findall(r'style="min-width:(\d+)px"', page)
    assert 9.0 < size_pt * (int(width) - 2) / (5 * 72) < 9.3  # px: points of the figure at that width, less its frame


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_note_is_read_while_the_work_goes_on(unbuffered: str) -> None:
    """The process ends as if it were killed: what is not written by then is lost."""
    work = (
        "import os; from fluxtwin import console; console.heed_no_reader(); console.Output().note('soon'); os._exit(0)"
    )
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run([sys.executable, "-c", work], env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == "soon\n"
