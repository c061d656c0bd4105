"""The pages in a headless browser: nothing complains, every figure is there, zoom works, text can be read."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, browser, find_browser
from command_line import status_of
from worlds import TUMBLING, scenario_text, tumbling

import fluxtwin

pytestmark = [pytest.mark.property, pytest.mark.usefixtures("lawless")]

SENSORS = """
[attitude]
yaw_rms_deg = 5.0
[magnetometer]
b_nT = [1000.0, -500.0, 300.0]
noise_nT = 20.0
"""
DRAWN = """
[effects.time_tag_offset]
offset_s = 1.0
[draws]
"effects.time_tag_offset.offset_s" = { log_uniform = [0.001, 5.0] }
"""
FIGURES = {
    "check": ["field"],
    "calibrate": ["field", "residuals", "coverage", "drivers"],
    "scalar": ["field", "residuals", "coverage", "drivers"],
    "diagnose": ["field", "gap_series", "drivers", "gap_spectra", "coverage"],
    "plan": ["power_time_tag_offset"],
    "trend": ["trend"],
    "campaign/report": ["power"],
    "ensemble/report": ["envelope"],
}
"""By page, the figures that it must have."""
LIVE = {"field", "residuals", "gap_series"}
LEAST_CONTRAST = 4.5  # of text to its ground: WCAG 2.1, level AA

CONTRASTS = """(() => {
  const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
  const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const light = (rgb) => [0.2126, 0.7152, 0.0722].reduce((sum, weight, k) => sum + weight * linear(rgb[k] / 255), 0);
  const ground = (e) => {
    if (!e) return null;
    const colour = numbers(getComputedStyle(e).backgroundColor);
    return colour.length < 4 || colour[3] > 0 ? colour : ground(e.parentElement);
  };
  const worst = {};
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const e = walk.currentNode.parentElement;
    if (!walk.currentNode.textContent.trim() || e.tagName === "SCRIPT" || !e.checkVisibility()) continue;
    const [a, b] = [light(numbers(getComputedStyle(e).color)), light(ground(e) || [255, 255, 255])];
    const key = `${e.tagName} ${e.className}`, ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    worst[key] = Math.min(worst[key] ?? 99, ratio, parseFloat(getComputedStyle(e).fontSize) < 9 ? 0 : 99);
  }
  return worst;
})()"""
"""The least contrast of text by element and class; 0 for text that is too small to be read."""


@pytest.fixture(scope="module")
def pages(lawless: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    (folder / "s.toml").write_text(scenario_text(SENSORS, segment="samples = 300, step_s = 40.0"), encoding="utf-8")
    (folder / "late.toml").write_text(tumbling(TUMBLING + DRAWN, seed=4), encoding="utf-8")
    record = fluxtwin.simulate(folder / "s.toml")[0]
    reading = np.array(record.mag_B_nT)
    reading[100] += 30_000.0
    fluxtwin.write(record.replace(mag_B_nT=reading), folder / "t.nc")
    telemetry, ends = folder / "t.nc", np.datetime_as_string(record.time[[199, 249, 299]], "s")
    for words in (
        ("check", telemetry, "--html", folder / "check.html"),
        ("calibrate", telemetry, "--html", folder / "calibrate.html"),
        ("calibrate", telemetry, "--method", "scalar", "--html", folder / "scalar.html"),
        ("diagnose", telemetry, "--html", folder / "diagnose.html"),
        ("plan", telemetry, "--for", "time_tag_offset", "--html", folder / "plan.html"),
        *(("calibrate", telemetry, "--to", f"{end}Z", "--out", folder / f"to-{end}.toml", "--force") for end in ends),
        ("trend", *(folder / f"to-{end}.toml" for end in ends), "--html", folder / "trend.html"),
        ("campaign", folder / "late.toml", "--runs", 2, "--out", folder / "campaign", "--jobs", 1),
        ("ensemble", folder / "s.toml", "--vehicles", 2, "--out", folder / "ensemble", "--jobs", 1),
    ):
        assert status_of(*words) in (0, 1), words
    return folder


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium here to look at the pages with")
    with browser(program, tmp_path_factory.mktemp("profile")) as one:
        yield one


def _text(pages: Path, name: str) -> str:
    return (pages / f"{name}.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", FIGURES)
def test_a_page_is_one_small_file_that_fetches_nothing(pages: Path, name: str) -> None:
    """Also without a browser: what a page may load is said by its policy, and it names nothing elsewhere."""
    text = _text(pages, name)
    assert len(text.encode("utf-8")) < 2_000_000
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="(.*?)">', text)
    allowed = dict(part.strip().split(" ", 1) for part in html.unescape(policy).split(";") if part.strip())
    assert allowed.pop("default-src") == "'none'" and allowed.pop("img-src") == "data:"
    assert allowed.pop("style-src") == "'unsafe-inline'"
    assert re.fullmatch(r"'none'|'sha256-[A-Za-z0-9+/]{43}='", allowed.pop("script-src", "'none'"))
    assert set(allowed.values()) <= {"'none'"}
    linked = re.findall(r'\s(?:src|href|srcset|action|poster|data)="(.*?)"', text)
    assert linked and all(where.startswith(("data:", "#")) for where in linked)
    assert not re.search(r"@import|url\((?!data:)|<(?:link|iframe|object|embed|form|base)\b", text)


@pytest.mark.parametrize("name", FIGURES)
def test_every_page_can_be_read(tab: Browser, pages: Path, name: str) -> None:
    path = pages / f"{name}.html"
    for width, scheme in ((390, "light"), (390, "dark"), (1400, "light")):
        tab.problems.clear()
        tab.open(path, width, scheme=scheme)
        assert tab.problems == []
        assert tab.run("[...document.querySelectorAll('figure')].map((f) => f.id)") == FIGURES[name]
        assert tab.run("document.documentElement.scrollWidth") <= width, "nothing hangs out of the page"
        assert tab.run("[...document.images].every((i) => i.complete && i.naturalWidth > 300)")
        poor = {what: ratio for what, ratio in tab.run(CONTRASTS).items() if ratio < LEAST_CONTRAST}
        assert poor == {}
        live = tab.run("[...document.querySelectorAll('figure.live')].map((f) => f.id)")
        assert set(live) == LIVE & set(FIGURES[name])
        images = "[...document.querySelectorAll('figure:not(.live) img')]"
        bare = "[...document.querySelectorAll('.stacked td:empty')].filter((td) => td.checkVisibility()).length"
        assert width > 640 or tab.run(bare) == 0, "no name of a column without a value"
        shrunk = tab.run(f"{images}.filter((i) => i.offsetWidth < parseInt(i.style.minWidth)).length")
        assert shrunk == 0, "a figure is scrolled before its text is too small"


def _panels(pages: Path, name: str, figure: str) -> list[dict[str, Any]]:
    """The series of a figure, as its script has them."""
    pattern = rf'<figure id="{figure}">.*?application/json">(.*?)</script>'
    (data,) = re.findall(pattern, _text(pages, name), re.DOTALL)
    found: list[dict[str, Any]] = json.loads(data)["panels"]
    return found


@pytest.mark.parametrize(
    ("name", "figure", "panels"), [("calibrate", "field", 4), ("diagnose", "field", 4), ("diagnose", "gap_series", 3)]
)
def test_the_row_set_aside_is_a_cross(pages: Path, name: str, figure: str, panels: int) -> None:
    """One reading is wrong by 30 uT on every axis: it alone is a cross, and its residual is that error but for b and S."""
    crosses = [line for panel in _panels(pages, name, figure) for line in panel["lines"] if line["look"] == "cross"]
    assert [line["rows"] for line in crosses] == [[100]] * panels
    if figure == "gap_series":
        assert all(abs(line["values"][0] - 30_000.0) < 1000.0 for line in crosses)


def test_residuals_of_a_calibration_are_readings_less_the_model(pages: Path) -> None:
    """As in a diagnosis. The corrections that were put in are b = 1000, -500, 300 nT, so the reading lacks them; S is zero,
    and noise and attitude error average to some nT."""
    before = _panels(pages, "calibrate", "residuals")[0]["lines"]
    dots = {line["name"]: np.mean(line["values"]) for line in before if line["look"] == "dots"}
    assert [dots[axis] for axis in "xyz"] == [pytest.approx(value, abs=30.0) for value in (-1000.0, 500.0, -300.0)]


def test_an_effect_has_its_title_beside_its_name(pages: Path) -> None:
    named = re.findall(r">time_<wbr>tag_<wbr>offset(?: /)?<small>(.*?)</small>", _text(pages, "diagnose"))
    assert named and set(named) == {"The time stamps are early (+) or late (-)"}


def test_the_diagnosis_has_the_parameters_of_the_calibration(pages: Path) -> None:
    """The same table; the diagnosis weighs the readings otherwise, so values agree within a few of the larger sigmas."""
    found = []
    for name in ("calibrate", "diagnose"):
        rows = re.findall(r"<td[^>]*>(S\d\d|b\d)</td>\s*<td[^>]*>(.*?)</td>\s*<td[^>]*>(.*?)</td>", _text(pages, name))
        assert [row[0] for row in rows] == [*(f"S{i}{j}" for i in "123" for j in "123"), "b1", "b2", "b3"], name
        found.append(np.array([[float(value), float(sigma)] for _, value, sigma in rows]))
    (one, s1), (other, s2) = (part.T for part in found)
    assert (np.abs(one - other) < 5.0 * np.hypot(s1, s2)).all() and (np.abs(other[-3:]) > 100.0).all()


def test_zoom_moves_every_figure_and_can_be_copied(tab: Browser, pages: Path) -> None:
    tab.problems.clear()
    tab.open(pages / "calibrate.html", 900)
    words = "[...document.querySelectorAll('.tools code')].map((c) => c.textContent)"
    whole = tab.run(words)
    assert len(whole) == 2 and whole[0] == whole[1] and whole[0].startswith("--from ")
    before = tab.run("document.querySelector('canvas').toDataURL()")
    left, top = tab.run(
        "(() => { scrollTo(0, document.querySelector('canvas').getBoundingClientRect().top);"
        " const b = document.querySelector('canvas').getBoundingClientRect(); return [b.left, b.top]; })()"
    )
    tab.drag((left + 300, top + 80), (left + 500, top + 80))
    settle = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    tab.run(settle)
    zoomed = tab.run(words)
    assert zoomed != whole and zoomed[0] == zoomed[1], "linked"
    assert tab.run("document.querySelector('canvas').toDataURL()") != before
    (start, end), (first, last) = (
        [np.datetime64(stamp.removesuffix("Z"), "ms") for stamp in text.split()[1::2]] for text in (zoomed[0], whole[0])
    )
    across = tab.run("document.querySelector('canvas').clientWidth") - 82.0
    share = (end - start) / (last - first)
    assert abs(share - 200.0 / across) < 0.01, "as much as was dragged over"
    assert first < start < end < last
    record = fluxtwin.read(pages / "t.nc")
    assert first <= record.time[0] and record.time[-1] < last, "--to is the first instant that is left out"
    assert status_of("info", pages / "t.nc", *zoomed[0].split()) == 0, "the command line takes what is copied"
    shown = tab.run("document.querySelector('.readout').textContent")
    assert "(UTC)" in shown and "measured" in shown and "nT" in shown
    row = int(np.flatnonzero(record.time == np.datetime64(shown[:23], "ns"))[0])
    (said,) = re.findall(r"; x: measured (-?[\d.]+), predicted", shown)
    assert abs(float(said) - record.mag_B_nT[row, 0]) < 0.06  # nT: the last digit that is shown
    tab.run("document.querySelectorAll('.tools button')[1].click()")
    tab.run(settle)
    assert tab.run(words) == whole
    assert tab.problems == []


def test_without_scripts_the_figures_stand(tab: Browser, pages: Path) -> None:
    tab.open(pages / "calibrate.html", 900, script=False)
    tab.call("Emulation.setScriptExecutionDisabled", value=False)
    assert tab.run("[...document.images].map((i) => i.checkVisibility() && i.naturalWidth > 300)") == [True] * 4
    assert tab.run("document.querySelectorAll('canvas').length") == 0


def test_the_browser_does_complain(tab: Browser, tmp_path: Path) -> None:
    """Else the tests above could not fail."""
    policy = "<meta http-equiv='Content-Security-Policy' content=\"default-src 'none'; style-src 'unsafe-inline'\">"
    text = f"{policy}<p style='color:#999'>pale</p><script>document.title = 'ran'</script>"
    (tmp_path / "poor.html").write_text(text, encoding="utf-8")
    tab.problems.clear()
    tab.open(tmp_path / "poor.html", 390)
    assert tab.problems and "Content Security Policy" in tab.problems[0]
    assert tab.run("document.title") != "ran"
    assert min(tab.run(CONTRASTS).values()) < LEAST_CONTRAST
