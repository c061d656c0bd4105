"""Who may import whom: data flow from left to right, once; nothing on the left imports from its right."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

ESTIMATORS_SEE = {"sim.base", "sim.earth", "sim.attitude", "sim.telemetry"}
"""The folders of sim that an estimator may see, and through which it can see no other: nothing here knows the truth."""

SIM = ESTIMATORS_SEE | {"sim", "sim.spacecraft", "sim.effects", "sim.scenario"}
CALIB = {
    "calib",
    "calib.common",
    "calib.gyro",
    "calib.linear",
    "calib.onboard",
    "calib.scalar",
    "calib.spin",
    "calib.attitude",
    "calib.checks",
}
GAP = (
    *("gap.linear", "gap.problem", "gap.hypotheses", "gap.noise", "gap.records", "gap.selection", "gap.detectors"),
    *("gap.held_out", "gap.planning", "gap.channels", "gap.posterior", "gap.law", "gap.report", "gap"),
)
"""In the order in which they may import: each those before it."""
ALL = SIM | CALIB | {"sim.run", *GAP, "plots", "scenarios"}

MAY_IMPORT = {
    "sim": set(),
    "sim.base": set(),
    "sim.earth": {"sim.base"},
    "sim.attitude": {"sim.base", "sim.earth"},
    "sim.telemetry": {"sim.base", "sim.earth"},
    "sim.spacecraft": {"sim.base", "sim.earth", "sim.attitude"},
    "sim.effects": {"sim.base", "sim.earth", "sim.attitude", "sim.spacecraft"},
    "sim.scenario": {"sim.base", "sim.earth", "sim.telemetry", "sim.spacecraft", "sim.effects"},
    "sim.run": SIM,
    **dict.fromkeys(CALIB, ESTIMATORS_SEE | CALIB),
    **{room: SIM | CALIB | {*GAP[:place]} for place, room in enumerate(GAP)},
    "plots": SIM | CALIB | {"gap.records"},
    "scenarios": ALL,
    "api": ALL,
}
"""Room by room; `python .ci/layers.py` draws what is imported. `sim.run` runs a scenario and knows
the truth; the diagnosis may see all of sim but that."""

RECORD_MODULES = {
    "fluxtwin.sim.telemetry.record",
    "fluxtwin.sim.base.types",
    "fluxtwin.sim.earth.constants",
    "fluxtwin.sim.base.errors",
    "fluxtwin.sim.earth.epoch",
    "fluxtwin.calib.checks.check",
    "fluxtwin.calib.common.records",
    "fluxtwin.gap.records.diagnosis",
    "fluxtwin.gap.records.plan",
}
"""What a figure may be drawn from."""

NOWHERE = {"click", "xarray", "pickle", "yaml", "marshal", "shelve", "astropy", "ppigrf", "chaosmagpy", "pytest"}
SHORT_NAMES = {"sim", "calib", "gap", "plots", "scenarios", "api"}
ONLY_IN = {
    "threadpoolctl": {"api"},
    "typer": {"api"},
    "rich": {"api"},
    "jinja2": {"scenarios", "api"},
    "matplotlib": {"plots", "scenarios", "api"},
    "pydantic": {"sim", "calib", "gap"},
    "numba": {"sim", "calib", "gap"},
    "h5py": {"sim"},
    "erfa": {"sim"},
    "sgp4": {"sim"},
    **{name: set() for name in NOWHERE | SHORT_NAMES},
}
"""Where a name from outside may be imported. The six folders are never imported by their short names."""


def _layers() -> ModuleType:
    spec = spec_from_file_location("layers", Path(__file__).resolve().parents[2] / ".ci" / "layers.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


layers = _layers()
KNOWN: dict[str, Path] = layers.sources()


def breaches(module: str, imported: str) -> list[str]:
    """What is wrong with `module` importing `imported`, in words; empty where it is allowed."""
    room, top = layers.room_of(module, KNOWN), imported.split(".")[0]
    here = room.split(".")[0]
    if top != "fluxtwin":
        return [f"{module} imports {imported}"] if here not in ONLY_IN.get(top, {here}) else []
    there = layers.room_of(imported, KNOWN)
    if there != room and there not in MAY_IMPORT[room] and imported != "fluxtwin":
        return [f"{module} imports {imported}: {room} may not import {there}"]
    if here == "plots" and there != "plots" and imported not in RECORD_MODULES:
        return [f"{module} imports {imported}: a figure is drawn from records only"]
    return []


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    known = set(KNOWN)
    return {name: layers.imports_of(path.read_text(encoding="utf-8"), known) for name, path in KNOWN.items()}


def test_every_import_is_allowed(graph: dict[str, set[str]]) -> None:
    assert len(graph) > 20, "the walk has not found the product"
    found = [text for module, targets in graph.items() for target in targets for text in breaches(module, target)]
    assert found == []


def test_what_estimators_see_sees_nothing_else() -> None:
    """So that no estimator reaches the truth through others."""
    assert all(MAY_IMPORT[room] <= ESTIMATORS_SEE for room in ESTIMATORS_SEE)
    assert all(MAY_IMPORT[room] <= ESTIMATORS_SEE | CALIB for room in CALIB)
    assert not any("sim.run" in MAY_IMPORT[room] for room in GAP)


def test_only_the_simulator_and_what_runs_it_touch_the_truth(graph: dict[str, set[str]]) -> None:
    touching = {layers.room_of(m, KNOWN) for m, targets in graph.items() if "fluxtwin.sim.run.truth" in targets}
    assert touching <= {"sim.run", "scenarios", "api"}


def test_a_circle_is_seen() -> None:
    assert layers.circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": set()}) == ["a", "b", "c", "a"]
    assert layers.circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_a_room_stands_one_floor_above_the_highest_it_imports() -> None:
    assert layers.floors({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {"a": 3, "b": 2, "c": 1}


@pytest.mark.parametrize(
    ("module", "imported"),
    [
        ("fluxtwin.calib.linear.calibrate", "fluxtwin.sim.run.simulate"),
        ("fluxtwin.calib.linear.calibrate", "fluxtwin.sim.spacecraft.sensors.magnetometer"),
        ("fluxtwin.calib.linear.calibrate", "fluxtwin.sim.run.truth"),
        ("fluxtwin.gap.diagnose", "fluxtwin.sim.run.truth"),
        ("fluxtwin.gap.selection.refit", "fluxtwin.gap.posterior.where"),
        ("fluxtwin.sim.telemetry.record", "fluxtwin.sim.effects.base"),
        ("fluxtwin.calib.linear.calibrate", "fluxtwin.sim.spacecraft.dynamics.flight"),
        ("fluxtwin.calib.linear.calibrate", "fluxtwin.scenarios.page"),
        ("fluxtwin.sim.earth.field", "fluxtwin.calib.common.records"),
        ("fluxtwin.scenarios.page", "fluxtwin.report"),
        ("fluxtwin.plots.yaw", "fluxtwin.sim.run.simulate"),
        ("fluxtwin.plots.yaw", "fluxtwin.calib.linear.calibrate"),
        ("fluxtwin.sim.earth.field", "sim.frames"),
        ("fluxtwin.sim.base.files", "jinja2"),
        ("fluxtwin.sim.telemetry.record", "rich.table"),
        ("fluxtwin.sim.base.files", "pickle"),
        ("fluxtwin.sim.earth.field", "ppigrf"),
    ],
)
def test_a_breach_is_seen(module: str, imported: str) -> None:
    assert breaches(module, imported)


def test_the_walk_sees_imports_inside_functions() -> None:
    source = "def f():\n    from fluxtwin.sim.run import truth\n    import pickle\n"
    assert layers.imports_of(source, {"fluxtwin.sim.run", "fluxtwin.sim.run.truth"}) == {
        "fluxtwin.sim.run.truth",
        "pickle",
    }
