"""Every example in a docstring is true, and every module can be imported by its real name."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path


def test_all_modules_import_and_their_examples_hold(sources: dict[str, Path]) -> None:
    failed, examples = {}, 0
    for name in sources:
        if name.endswith("__main__"):
            continue
        outcome = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
        examples += outcome.attempted
        if outcome.failed:
            failed[name] = outcome.failed
    assert failed == {}
    assert examples > 0, "no example was found: the front door has some"
