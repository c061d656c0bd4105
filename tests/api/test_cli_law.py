"""The walk of docs/diagnosis.md: a field that nobody has listed is found, written, flown, and frozen leaves no gap."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import as_read

from fluxtwin.cli import main
from fluxtwin.sim.scenario.scenario import load_scenario, save_scenario

pytestmark = pytest.mark.usefixtures("small_figures")
DECLARED = ("--noise-nT", "10", "--lsb-nT", "10", "--attitude-sigma-deg", "0.05")
Cli = Callable[..., object]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flight, page, closed scenario and JSON, as the documents make them; and a flight without the field."""
    there = tmp_path_factory.mktemp("law")
    files = ("--html", there / "gap.html", "--close", there / "closed.toml", "--json", there / "gap.json")
    assert main(["simulate", "hidden_law", "--out", str(there / "flight.csv")]) == 0
    assert main(["diagnose", str(there / "flight.csv"), *DECLARED, *map(str, files)]) == 0
    bare = load_scenario(there / "flight.scenario.toml").updated({"effects": None})
    save_scenario(bare, there / "bare.toml")
    assert main(["simulate", str(there / "bare.toml"), "--out", str(there / "bare.csv")]) == 0
    return there


def test_the_law_stands_in_the_sentence_the_json_and_the_page(folder: Path) -> None:
    answer = json.loads((folder / "gap.json").read_text(encoding="utf-8"))
    assert answer["verdict"] == "unknown" and answer["law"]["sentence"] in answer["sentence"]
    (term,) = answer["law"]["terms"]
    assert (term["of"], term["axes"], term["lag_s"]) == (["driver_payload", "sunlit"], "body", 0.0)
    assert abs(term["delay_s"] - 40.0) < 20.0, "within a row"
    for axis, k in zip("xyz", (24.0, -12.0, 6.0), strict=True):
        found = term["coefficients"][axis]
        assert abs(found["value"] - k) < 4.0 * found["sigma"], axis
    page = as_read((folder / "gap.html").read_text(encoding="utf-8"))
    assert "A law for what the catalogue does not explain" in page and "law.payload_sunlit" in page


def test_the_closed_scenario_flies_and_frozen_leaves_no_gap(cli: Cli, folder: Path, tmp_path: Path) -> None:
    tree = tomllib.loads((folder / "closed.toml").read_text(encoding="utf-8"))
    assert tree["effects"]["law"]["payload_sunlit"]["of"] == ["driver_payload", "sunlit"]
    assert {row["effect"] for row in tree["closure"]["transfer"]} == {"law.payload_sunlit"}
    assert cli("simulate", folder / "closed.toml", "--out", tmp_path / "twin.csv").status == 0  # type: ignore[attr-defined]
    outcome = cli("diagnose", folder / "flight.csv", "--scenario", folder / "closed.toml")
    assert outcome.out.startswith("No gap")  # type: ignore[attr-defined]


def test_without_the_field_there_is_no_word_of_a_law(cli: Cli, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "none.toml"
    outcome = cli("diagnose", folder / "bare.csv", *DECLARED, "--close", out, "--json", tmp_path / "none.json")
    answer = json.loads((tmp_path / "none.json").read_text(encoding="utf-8"))
    assert answer["verdict"] == "no_gap" and "law" not in answer and not out.exists()
    assert "law" not in outcome.out  # type: ignore[attr-defined]
