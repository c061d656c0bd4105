"""Modules and functions stay readable; public records say their units in their names."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import re
from pathlib import Path

LONGEST_MODULE = 500
LONGEST_FUNCTION = 70

UNIT = re.compile(
    r"_(nT|uT|mG|T|km|m|km_s|m_s|s|h|min|d|yr|days|rad|deg|rad_s|deg_s|deg_h|rpm|A|V|W|Wh|Ah|Am2|A_m2|Nm|N_m|Nms|kg"
    r"|kg_m2|degC|K|Hz|nT_per_Am2|nT_per_A|nT_per_K|nT_per_yr|km3_s2|W_m2|J_K|W_K|J|per_K|N_m_s|m2|mG2|nT2)$"
)
NO_UNIT = {
    # ratios, matrices of ratios, rotations, states of 0 and 1, counts and probabilities
    "S", "q_NB", "sunlit", "heater_on", "sun_sensor_head", "sun_B", "sun_N", "nadir_B", "illumination",
    "weights", "eccentricity", "condition", "covariance", "correlation", "singular_values", "state_of_charge",
    "probability", "significance", "efficiency", "duty", "R_BN", "segment", "eiv_shift", "relative_uncertainty",
    "directions_B", "lag_correlation", "sharpness", "taper_above_fraction", "G", "M", "D", "O",
    "taper_above", "rc_weights", "gram", "inertia_ratio",
    # directions, and a table whose columns have a unit each
    "axis", "axis_B", "nodes",
    # a parameter of an effect names its unit in a field of its own
    "scale", "low", "high",
    # a regression knows no units: its columns are nT and A m2 side by side
    "xx", "mean_x", "rr", "c",
}  # fmt: skip


def lengths(source: str) -> dict[str, int]:
    """Lines of each function of a source, without its signature and docstring."""
    found = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            first = body[0].lineno if body else 0
            found[f"{node.name}:{node.lineno}"] = (node.end_lineno or 0) - first + 1 if body else 0
    return found


def test_no_module_is_too_long(sources: dict[str, Path]) -> None:
    long = {n: len(p.read_text(encoding="utf-8").splitlines()) for n, p in sources.items()}
    assert {n: lines for n, lines in long.items() if lines > LONGEST_MODULE} == {}


def test_no_function_is_longer_than_a_screen(sources: dict[str, Path]) -> None:
    found = {
        f"{name}.{function}": lines
        for name, path in sources.items()
        for function, lines in lengths(path.read_text(encoding="utf-8")).items()
        if lines > LONGEST_FUNCTION
    }
    assert found == {}


def test_the_length_of_a_function_is_counted() -> None:
    source = 'def f():\n    """One.\n\n    Two."""\n    a = 1\n    return a\n'
    assert lengths(source) == {"f:1": 2}


def test_public_records_say_their_units(sources: dict[str, Path]) -> None:
    bare, seen = set(), 0
    for name in sources:
        if not name.startswith(("fluxtwin.sim.", "fluxtwin.calib.")):
            continue
        module = importlib.import_module(name)
        for record in vars(module).values():
            if not dataclasses.is_dataclass(record) or not isinstance(record, type):
                continue
            if record.__module__ != name or record.__name__.startswith("_"):
                continue
            for item in dataclasses.fields(record):
                if not re.search(r"\b(FloatArray|float)\b", str(item.type)):
                    continue
                seen += 1
                if not UNIT.search(item.name) and item.name not in NO_UNIT and "Mapping" not in str(item.type):
                    bare.add(f"{name}.{record.__name__}.{item.name}")
    assert seen > 20
    assert not bare, "\n".join(sorted(bare))


def test_every_module_and_public_function_has_a_docstring(sources: dict[str, Path]) -> None:
    bare = []
    for name, path in sources.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if not ast.get_docstring(tree):
            bare.append(name)
        bare += [
            f"{name}.{node.name}"
            for node in tree.body
            if isinstance(node, ast.FunctionDef | ast.ClassDef)
            and not node.name.startswith("_")
            and not ast.get_docstring(node)
        ]
    assert not bare, "\n".join(bare)
