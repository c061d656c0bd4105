"""The grade sheet is what the tests earn."""

from __future__ import annotations

import pytest
from trust import grades

pytestmark = pytest.mark.property


def test_every_test_that_earns_a_level_is_there() -> None:
    wrong = [grades.lacking(test) for levels in grades.factors().values() for one in levels for test in one["tests"]]
    assert [one for one in wrong if one] == []
    assert grades.lacking("api/test_start.py::test_that_nobody_wrote") and grades.lacking("none.py::*")


def test_the_sheet_is_made_from_them_with_the_worst_on_top() -> None:
    page = grades.page()
    assert grades.PAGE.read_text(encoding="utf-8") == page, "run python -m benchmarks.trust.grades"
    levels = [
        int(line.split("|")[2])
        for line in page.splitlines()
        if line.startswith("| ") and not line.startswith("| factor")
    ]
    assert levels == sorted(levels) and len(levels) == len(grades.factors())


def test_a_level_whose_test_is_gone_is_not_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = grades.factors()
    plain["Verification"][0]["tests"] = ["none.py::test_x"]
    monkeypatch.setattr(grades, "factors", lambda: plain)
    assert "| Verification | 0 |" in grades.page()
