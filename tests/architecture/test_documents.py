"""What the documents promise is there: the README's scenario runs, every scenario key is described."""

from __future__ import annotations

import dataclasses
import re
import runpy
import tomllib
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel

from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.dynamics_sections import ControlSection, TorquesSection
from fluxtwin.sim.scenario.effect_sections import EffectsSection, keys_of
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

ROOT = Path(__file__).resolve().parents[2]


def test_the_scenario_in_the_readme_is_complete_and_flies():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    telemetry, _ = simulate(parse_scenario(block, where="README.md"))
    assert np.isfinite(telemetry.mag_B_nT).all()


def models_in(annotation: Any) -> set[type[BaseModel]]:
    """The sections that a type is made of, and theirs; effects, torques and control laws are described elsewhere."""
    found = set()
    elsewhere = (EffectsSection, TorquesSection, ControlSection)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation not in elsewhere:
        found = {annotation}
        for field in annotation.model_fields.values():
            found |= models_in(field.annotation)
    for part in get_args(annotation):
        found |= models_in(part)
    return found


def test_every_key_of_a_scenario_is_described():
    text = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    models = models_in(Scenario)
    assert {"StarTrackerSection", "SunSensorSection", "SegmentSection"} <= {model.__name__ for model in models}
    missing = [
        f"{model.__name__}.{key}"
        for model in models
        for key in model.model_fields
        if not re.search(rf"\b{re.escape(key)}\b", text)
    ]
    assert not missing


def test_every_effect_and_its_keys_are_described():
    text = (ROOT / "docs" / "catalogue.md").read_text(encoding="utf-8")
    for effect in CATALOGUE:
        (section,) = re.findall(rf"^### {effect.name}\n(.*?)(?=^##|\Z)", text, flags=re.MULTILINE | re.DOTALL)
        keys = keys_of(effect)
        listed = keys if len(keys) < 7 else (keys[0], keys[-1])  # of 18 or 30 alike the first and the last
        names = [key.name for key in listed] + [item.name for item in dataclasses.fields(effect)]
        assert [name for name in names if f"`{name}`" not in section] == []


def test_every_trap_is_described():
    text = (ROOT / "docs" / "telemetry.md").read_text(encoding="utf-8")
    traps = tomllib.loads((ROOT / "calib" / "checks" / "findings.toml").read_text(encoding="utf-8"))["trap"]
    assert [code for code in traps if f"`{code}`" not in text] == []


def test_links_in_the_documents_lead_somewhere():
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        for target in re.findall(r"\]\((?!http)([^)#\s]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_a_page_that_fetches_something_is_seen(tmp_path: Path):
    site = runpy.run_path(str(ROOT / ".ci" / "site.py"))
    page = tmp_path / "page.html"
    for harmless in (
        '<a href="https://example.org">',
        '<script src="_static/a.js">',
        '<link rel="stylesheet" href="a.css">',
    ):
        page.write_text(harmless, encoding="utf-8")
        assert site["remote"](tmp_path) == [], harmless
    for fetched in (
        '<script async src="https://cdn.example.org/a.js">',
        '<link href="//fonts.example.org/a.css" rel="stylesheet">',
        '<link rel="stylesheet" href="https://fonts.example.org/a.css">',
        '<img src="http://example.org/a.png">',
        "<style>@import url(https://example.org/a.css);</style>",
    ):
        page.write_text(fetched, encoding="utf-8")
        assert len(site["remote"](tmp_path)) == 1, fetched


def test_a_page_that_shows_its_marks_is_seen(tmp_path: Path):
    site = runpy.run_path(str(ROOT / ".ci" / "site.py"))
    page = tmp_path / "page.html"
    page.write_text("<p><code>`a`</code> costs <math>x</math></p><pre>$ ls</pre>", encoding="utf-8")
    assert site["unread"](tmp_path) == []
    for left in ("<p>numbers (`== &lt;</p>", "<p>the difference $B_1</p><ul><li>B_2</li></ul>"):
        page.write_text(left, encoding="utf-8")
        assert len(site["unread"](tmp_path)) == 1, left
