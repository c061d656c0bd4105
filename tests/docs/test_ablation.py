"""The script that switches the rules of the diagnosis off names what there is."""

from __future__ import annotations

import pkgutil
import runpy

import pytest
from command_line import ROOT


def test_every_rule_that_is_switched_off_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    rules = runpy.run_path(str(ROOT / "docs" / "design" / "ablation.py"))["RULES"]
    assert len(rules) > 20
    for target in (target for rule in rules.values() for target in rule):
        pkgutil.resolve_name(target)  # raises AttributeError or ImportError
