"""Modules and functions stay readable; public records say their units in their names."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import re
from pathlib import Path

LONGEST_MODULE = 600
LONGEST_FUNCTION = 70

UNIT = re.compile(
    r"_(nT|uT|mG|T|km|m|km_s|m_s|s|h|min|d|yr|days|rad|deg|rad_s|deg_s|deg_h|rpm|A|V|W|Wh|Ah|Am2|A_m2|Nm|N_m|Nms|kg"
    r"|kg_m2|degC|K|Hz|nT_per_Am2|nT_per_A|nT_per_K|nT_per_unit|nT_per_yr|km3_s2|W_m2|J_K|W_K|J|per_K|N_m_s|m2|mG2|nT2)$"
)
NO_UNIT = (
    # ratios, matrices of ratios, rotations, states of 0 and 1, counts and probabilities
    {"S", "matrix", "q_NB", "sunlit", "heater_on", "sun_sensor_head", "sun_B", "sun_N", "nadir_B", "nadir_N"}
    | {
        "illumination",
        "passes",
        "weights",
        "own_weight",
        "eccentricity",
        "trickle",
        "condition",
        "covariance",
        "driver_covariance",
        "correlation",
        "singular_values",
    }
    | {"state_of_charge", "probability", "significance", "efficiency", "duty", "R_BN", "segment", "eiv_shift"}
    | {"relative_uncertainty", "directions_B", "lag_correlation", "sharpness", "taper_above_fraction", "G", "M"}
    | {"D", "O", "taper_above", "rc_weights", "gram", "inertia_ratio", "overlap_ratio", "misfit", "flattening"}
    # logarithms of likelihoods and odds; a distance in standard deviations
    | {"log", "cost", "distance"}
    # directions, and a table whose columns have a unit each
    | {"axis", "axis_B", "nodes"}
    # of a parameter, in the parameter's own unit; of two lengths; statistics and probabilities
    | {"sigma", "sigmas", "values", "mean", "mean_sigma", "size", "size_sigma", "ratio"}
    | {"q", "last_q", "last_probability", "explained"}
    # a parameter of an effect names its unit in a field of its own
    | {"scale", "low", "high"}
    # a regression knows no units: its columns are nT and A m2 side by side
    | {"xx", "mean_x", "rr", "c"}
)


def lengths(tree: ast.Module) -> dict[str, int]:
    """Lines of each function of a module, without its signature and docstring."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            first = body[0].lineno if body else 0
            found[f"{node.name}:{node.lineno}"] = (node.end_lineno or 0) - first + 1 if body else 0
    return found


def test_no_module_is_too_long(sources: dict[str, Path]) -> None:
    long = {n: len(p.read_text(encoding="utf-8").splitlines()) for n, p in sources.items()}
    assert {n: lines for n, lines in long.items() if lines > LONGEST_MODULE} == {}


def test_no_function_is_longer_than_a_screen(trees: dict[str, ast.Module]) -> None:
    found = {
        f"{name}.{function}": lines
        for name, tree in trees.items()
        for function, lines in lengths(tree).items()
        if lines > LONGEST_FUNCTION
    }
    assert found == {}


def test_the_length_of_a_function_is_counted() -> None:
    source = 'def f():\n    """One.\n\n    Two."""\n    a = 1\n    return a\n'
    assert lengths(ast.parse(source)) == {"f:1": 2}


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


def test_every_module_and_public_function_has_a_docstring(trees: dict[str, ast.Module]) -> None:
    bare = []
    for name, tree in trees.items():
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


def bare_calendar_steps(tree: ast.Module) -> list[int]:
    """Lines that add an integer without a unit to a date, or subtract one, as far as a function's own names tell."""
    lines = []
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            dates = {
                target.id
                for node in ast.walk(function)
                if isinstance(node, ast.Assign) and _is_date(node.value, set())
                for target in node.targets
                if isinstance(target, ast.Name)
            }
            for node in ast.walk(function):
                if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
                    sides = (node.left, node.right)
                    if any(_is_date(side, dates) for side in sides) and any(_is_integer(side) for side in sides):
                        lines.append(node.lineno)
    return lines


def _is_date(node: ast.expr, dates: set[str]) -> bool:
    if isinstance(node, ast.Name):
        return node.id in dates
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return False
    first = node.args[0] if node.args else None
    to_date = isinstance(first, ast.Constant) and str(first.value).startswith("datetime64")
    return node.func.attr == "datetime64" or (node.func.attr == "astype" and to_date)


def _is_integer(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int)


def test_a_step_of_the_calendar_names_its_unit(trees: dict[str, ast.Module]) -> None:
    # numpy 2.5 deprecates integers without a unit beside datetime64; the numpy that Python 3.11 gets is silent.
    found = {name: bare_calendar_steps(tree) for name, tree in trees.items()}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_a_bare_calendar_step_is_seen() -> None:
    source = 'def f(t):\n    y = t.astype("datetime64[Y]")\n    n = y.astype("int64") + 1\n    return (y + 1) - t'
    assert bare_calendar_steps(ast.parse(source)) == [4]
