"""The notebooks run from top to bottom, hold no outputs, and find what they say."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import ROOT

NOTEBOOKS = ROOT / "docs" / "notebooks"


def run(name: str) -> tuple[dict[str, Any], list[object]]:
    """The names that a notebook leaves, and what its cells show (the value of a last expression)."""
    notebook = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    names: dict[str, Any] = {"__name__": "__main__"}
    shown: list[object] = []
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [] and cell["execution_count"] is None, f"{name}: strip the outputs"
        tree = ast.parse("".join(cell["source"]), filename=f"{name}, {cell['id']}")
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, name, "exec"), names)
        if isinstance(last, ast.Expr):
            shown.append(eval(compile(ast.Expression(last.value), name, "eval"), names))
    for value in shown:
        assert value is None or hasattr(value, "_repr_html_") or isinstance(value, np.ndarray), type(value)
        if hasattr(value, "_repr_html_"):
            assert "<" in value._repr_html_()
    return names, shown


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_all_notebooks_are_run() -> None:
    assert {path.stem for path in NOTEBOOKS.glob("*.ipynb")} == {"first_calibration", "first_diagnosis"}


def test_first_calibration(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.warns(UserWarning, match="of another time"):
        names, shown = run("first_calibration")
    assert names["fit"].verdict.level == "good"
    sigma_nT = np.sqrt(np.diag(names["fit"].calibration.covariance))[9:12]
    assert len(shown) >= 5
    assert names["later"].time[0] - names["record"].time[0] == np.timedelta64(1, "D"), "the next day"
    assert (
        np.abs(names["b_nT"] - names["true_nT"]) < 4 * sigma_nT
    ).all()  # of three Gaussian numbers once in 5,000 more
    assert "FLUXTWIN_MAG_M" in capsys.readouterr().out


def test_first_diagnosis(capsys: pytest.CaptureFixture[str]) -> None:
    names, _ = run("first_diagnosis")
    found, control = names["found"], names["control"]
    assert found.verdict == "effect" and "solar_array_current" in (*found.effects[0].group, found.effects[0].name)
    assert control.verdict == "no_gap"
    assert "No gap" in capsys.readouterr().out
