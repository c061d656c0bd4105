"""Scenario files by path, or a packaged scenario by its name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fluxtwin.sim.base.errors import BadInput, nearest

if TYPE_CHECKING:
    from fluxtwin.sim.scenario.scenario import Scenario

_FOLDER = Path(__file__).parent
_OF_STUDIES = ("hcmm", "seasat", "st5")
SCENARIOS: dict[str, Path] = {path.stem: path for path in sorted(_FOLDER.glob("*.toml"))} | {
    name: _FOLDER / name / f"{name}.toml" for name in _OF_STUDIES
}
"""The packaged scenarios by name: those that lie beside this file, and what the studies fly."""
NAMES = f"{', '.join(sorted(SCENARIOS)[:-1])} or {max(SCENARIOS)}"
"""The names as a list to read."""


def as_scenario(scenario: Scenario | Path | str) -> Scenario:
    """A scenario, loaded first where a file or a name is given."""
    from fluxtwin.sim.scenario.scenario import Scenario

    return scenario if isinstance(scenario, Scenario) else load_scenario(scenario)


def load_scenario(scenario: Path | str) -> Scenario:
    """The scenario file, or, where there is no file of that name, the packaged scenario.

    Raises BadInput as `fluxtwin.sim.scenario.scenario.load_scenario`; for what is neither a file nor a name, one that
    lists the names.
    """
    from fluxtwin.sim.scenario import scenario as files
    from fluxtwin.sim.telemetry.telemetry_files import as_path

    name, path = str(scenario), as_path(scenario, "scenario", f"the path of a scenario as TOML, or {NAMES}")
    if path.exists() and not (path.is_dir() and name in SCENARIOS):
        return files.load_scenario(path)
    if name not in SCENARIOS:
        hint = nearest(path.stem.lower(), SCENARIOS, " (did you mean {!r}?)")
        raise BadInput(
            f"there is no such file, and no packaged scenario of that name{hint}",
            where=name,
            wanted=f"a scenario as a TOML file, or {NAMES}",
        )
    return files.load_scenario(SCENARIOS[name])
