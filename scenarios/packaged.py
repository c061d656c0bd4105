"""Scenario files by path, or the packaged scenario of a study by its name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fluxtwin.sim.scenario import Scenario

SCENARIOS = ("hcmm",)
"""Studies whose packaged scenario has stations."""


def open_scenario(path: Path) -> Scenario:
    """The scenario file, or, where there is none of that name, the packaged one of a study.

    Raises BadInput as `load_scenario`.
    """
    from fluxtwin.sim.scenario import load_scenario, parse_scenario

    name = str(path)
    if name not in SCENARIOS or path.exists():
        return load_scenario(path)
    text = resources.files(f"fluxtwin.scenarios.{name}").joinpath(f"{name}.toml").read_text(encoding="utf-8")
    return parse_scenario(text, where=f"{name}.toml")
