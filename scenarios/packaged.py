"""Scenario files by path, or the packaged scenario of a study by its name."""

from __future__ import annotations

import difflib
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from fluxtwin.sim.base.errors import BadInput

if TYPE_CHECKING:
    from fluxtwin.sim.scenario.scenario import Scenario

SCENARIOS = ("hcmm", "seasat", "st5")
"""Studies with a packaged scenario; the first has stations of its own."""


def open_scenario(path: Path) -> Scenario:
    """The scenario file, or, where there is none of that name, the packaged one of a study.

    Raises BadInput as `load_scenario`; for a name that is neither, one that lists what there is.
    """
    from fluxtwin.sim.scenario.scenario import load_scenario, parse_scenario

    name = str(path)
    if path.exists():
        return load_scenario(path)
    if name not in SCENARIOS:
        near = difflib.get_close_matches(name.lower(), SCENARIOS, n=1, cutoff=0.5)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise BadInput(
            f"there is no such file, and no packaged scenario is called so{hint}",
            where=name,
            wanted=f"a scenario as a TOML file, or {' or '.join(SCENARIOS)}",
        )
    text = resources.files(f"fluxtwin.scenarios.{name}").joinpath(f"{name}.toml").read_text(encoding="utf-8")
    return parse_scenario(text, where=f"{name}.toml")
