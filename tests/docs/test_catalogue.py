"""The page of the catalogue is what the code says, and what looks like what is what the design says."""

from __future__ import annotations

import json
import runpy
from typing import Any

import pytest
from command_line import ROOT

import fluxtwin


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "examples" / "catalogue.py"))


@pytest.fixture(scope="module")
def stored(script: dict[str, Any]) -> dict[str, dict[str, dict[str, int]]]:
    return dict(json.loads(script["LIKENESS"].read_text(encoding="utf-8")))


def test_the_page_is_that_of_the_code(script: dict[str, Any], stored: Any) -> None:
    text = (ROOT / "docs" / "catalogue.md").read_text(encoding="utf-8")
    assert text == script["page"](stored), "python docs/examples/catalogue.py writes it anew"
    for effect in fluxtwin.effects():
        assert f"### {effect.name}\n" in text


def test_likeness_is_that_of_the_design(script: dict[str, Any], stored: Any) -> None:
    """Of the first design; three points are rounding and how far a search refines its settings on other hardware."""
    design = next(iter(script["DESIGNS"]))
    now, then = script["likeness"](design), stored[design]
    border = 100 * script["ALIKE"] + 3
    for name in {*now, *then}:
        for other in {*now.get(name, {}), *then.get(name, {})}:
            one, two = (shares.get(name, {}).get(other, 0) for shares in (now, then))
            assert abs(one - two) <= 3 or max(one, two) <= border, (name, other, one, two)
    assert now["time_tag_offset"]["sensor_lag"] > 98  # nadir pointing cannot tell them apart


def test_a_lane_holds_what_is_drawn_in_it(script: dict[str, Any]) -> None:
    lane = script["lane_nT"]
    assert [lane(nT) for nT in (0.0, 0.4, 0.5, 0.6, 1.1, 2.6, 80_000.0)] == [1.0, 1.0, 1.0, 2.0, 5.0, 10.0, 200_000.0]
