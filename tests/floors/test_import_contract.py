"""Who may import whom: data flow from left to right, once; nothing on the left imports from its right."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

MAY_IMPORT = {
    "sim": {"sim"},
    "calib": {"sim", "calib"},
    "gap": {"sim", "calib", "gap"},
    "plots": {"sim", "calib", "gap", "plots"},
    "scenarios": {"sim", "calib", "gap", "plots", "scenarios"},
    "api": {"sim", "calib", "gap", "plots", "scenarios", "api"},
}
"""Folder by folder, as the table of folders in the design says."""

PURE_SIM = {
    "", "attitude", "constants", "epoch", "errors", "field", "field_design", "field_kernels", "field_models",
    "files", "frames", "interpolation", "kernel_cache", "orbit", "progress", "random_streams", "rigid_body", "sun",
    "telemetry", "tle", "toml_input", "types",
}  # fmt: skip
"""The parts of sim that an estimator may see: nothing here knows the truth of a run."""

TRUTH_SIDE = {
    "scenario", "scenario_config", "scenario_attitude", "simulate", "truth", "world", "sensors",
    "housekeeping", "effects", "scenario_spacecraft", "replay", "libration", "power", "thermal", "wheels",
    "torquer_schedule", "chain", "signal", "scenario_effects", "scenario_motion", "scenario_passes",
    "scenario_sampling", "scenario_stations", "scenario_dynamics", "scenario_dynamics_config", "dynamics", "torques",
    "control",
}  # fmt: skip
"""The parts of sim that an estimator must not reach, not even through others.

Dynamics, torques and control are among them: their records are sections of a scenario, and what a vehicle's torques
were is what an estimator is to find out. The pure part of the motion of a body, the free one, is `rigid_body`. The
diagnosis may use them, as it may use all of sim but the truth.
"""

RECORD_MODULES = {
    "fluxtwin.sim.telemetry", "fluxtwin.sim.types", "fluxtwin.sim.constants", "fluxtwin.sim.errors",
    "fluxtwin.sim.epoch", "fluxtwin.sim.check", "fluxtwin.calib.records", "fluxtwin.gap.records",
}  # fmt: skip
"""What a figure may be drawn from."""

ONLY_IN = {
    "typer": {"api"}, "rich": {"api"}, "click": set(), "jinja2": {"api"},
    "matplotlib": {"plots", "scenarios", "api"}, "pydantic": {"sim"}, "numba": {"sim", "calib", "gap"},
    "xarray": set(), "h5py": {"sim"}, "erfa": {"sim"}, "sgp4": {"sim"},
    "pickle": set(), "yaml": set(), "marshal": set(), "shelve": set(), "astropy": set(),
    "ppigrf": set(), "chaosmagpy": set(), "pytest": set(), "sim": set(), "calib": set(), "gap": set(),
    "plots": set(), "scenarios": set(), "api": set(),
}  # fmt: skip
"""Where a name from outside may be imported. The six folders are never imported by their short names."""


def folder_of(module: str) -> str:
    """The folder a module of ours lies in: the second part of its name, or api."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in MAY_IMPORT else "api"


def imports_of(source: str, known: set[str]) -> set[str]:
    """Every module a source imports, at its top, inside functions or for type checking."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= names & known or {str(node.module)}
    return found


def breaches(module: str, imported: str) -> list[str]:
    """What is wrong with `module` importing `imported`, in words; empty where it is allowed."""
    here, top = folder_of(module), imported.split(".")[0]
    if top != "fluxtwin":
        return [f"{module} imports {imported}"] if here not in ONLY_IN.get(top, {here}) else []
    there = folder_of(imported)
    if there not in MAY_IMPORT[here] and imported != "fluxtwin":
        return [f"{module} imports {imported}: {here} may not import {there}"]
    if here == "calib" and there == "sim" and part_of_sim(imported) not in PURE_SIM:
        return [f"{module} imports {imported}: an estimator may see only the pure parts of sim"]
    if here == "plots" and there != "plots" and imported not in RECORD_MODULES:
        return [f"{module} imports {imported}: a figure is drawn from records only"]
    return []


def part_of_sim(module: str) -> str:
    """`frames` for fluxtwin.sim.frames, `sensors` for fluxtwin.sim.sensors.gyro, empty for fluxtwin.sim."""
    return [*module.split("."), ""][2]


def reachable(start: str, graph: dict[str, set[str]]) -> set[str]:
    """All modules that importing `start` may bring in, itself included."""
    seen, waiting = set(), [start]
    while waiting:
        module = waiting.pop()
        if module not in seen:
            seen.add(module)
            waiting.extend(graph.get(module, set()))
    return seen


@pytest.fixture(scope="module")
def graph(sources: dict[str, Path]) -> dict[str, set[str]]:
    known = set(sources)
    return {name: imports_of(path.read_text(encoding="utf-8"), known) for name, path in sources.items()}


def test_every_import_is_allowed(graph: dict[str, set[str]]) -> None:
    assert len(graph) > 20, "the walk has not found the product"
    found = [text for module, targets in graph.items() for target in targets for text in breaches(module, target)]
    assert found == []


def test_no_estimator_reaches_the_truth_through_others(graph: dict[str, set[str]]) -> None:
    found = [
        f"{module} reaches {reached}"
        for module in graph
        if folder_of(module) == "calib"
        for reached in reachable(module, graph)
        if folder_of(reached) == "sim" and part_of_sim(reached) in TRUTH_SIDE
    ]
    assert found == []


def test_only_the_simulator_and_what_runs_it_touch_the_truth(graph: dict[str, set[str]]) -> None:
    touching = {m for m, targets in graph.items() if "fluxtwin.sim.truth" in targets}
    assert {folder_of(m) for m in touching} <= {"sim", "scenarios", "api"}


@pytest.mark.parametrize(
    ("module", "imported"),
    [
        ("fluxtwin.calib.linear", "fluxtwin.sim.simulate"),
        ("fluxtwin.calib.linear", "fluxtwin.sim.sensors.magnetometer"),
        ("fluxtwin.calib.linear", "fluxtwin.sim.truth"),
        ("fluxtwin.calib.linear", "fluxtwin.sim.dynamics.flight"),
        ("fluxtwin.calib.linear", "fluxtwin.scenarios.page"),
        ("fluxtwin.sim.field", "fluxtwin.calib.records"),
        ("fluxtwin.scenarios.page", "fluxtwin.report"),
        ("fluxtwin.plots.yaw", "fluxtwin.sim.simulate"),
        ("fluxtwin.plots.yaw", "fluxtwin.calib.linear"),
        ("fluxtwin.sim.field", "sim.frames"),
        ("fluxtwin.scenarios.page", "jinja2"),
        ("fluxtwin.sim.telemetry", "rich.table"),
        ("fluxtwin.sim.files", "pickle"),
        ("fluxtwin.sim.field", "ppigrf"),
    ],
)
def test_a_breach_is_seen(module: str, imported: str) -> None:
    assert breaches(module, imported)


def test_the_walk_sees_imports_inside_functions() -> None:
    source = "def f():\n    from fluxtwin.sim import truth\n    import pickle\n"
    assert imports_of(source, {"fluxtwin.sim", "fluxtwin.sim.truth"}) == {"fluxtwin.sim.truth", "pickle"}
