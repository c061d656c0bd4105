"""Every example in a docstring is true, and every module can be imported by its real name."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path


def test_all_modules_import_and_their_examples_hold(sources: dict[str, Path]) -> None:
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    for name in sources:
        if name.endswith("__main__"):
            continue
        for test in finder.find(importlib.import_module(name), name):
            if test.examples:  # for each that is run, with examples or without, the runner looks at all files again
                runner.run(test)
    assert runner.failures == 0
    assert runner.tries > 0, "no example was found: the front door has some"
