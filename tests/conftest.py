"""Fixtures shared by all tests: the shared reference folder, and a comparison whose tolerance has a meaning."""

from __future__ import annotations

import gc
import importlib
import os
import random

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy loads: small matrices, and the same bits everywhere

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

matplotlib.use("Agg")

ROOT = Path(__file__).resolve().parent.parent

pytest_plugins = ["worlds", "command_line", "witnessed"]

# The same examples on every run; a fixture that only names a folder may serve all of them.
settings.register_profile(
    "fluxtwin",
    max_examples=50,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.load_profile("fluxtwin")


def pytest_addoption(parser: pytest.Parser) -> None:
    """--as-python: coverage.py sees a kernel as Python only, and with all others compiled few tests take long.
    --shuffle: a test that needs another to run before it fails."""
    words = "run the kernels of fluxtwin.MODULE as Python; repeatable"
    parser.addoption("--as-python", action="append", default=[], metavar="MODULE", help=words)
    parser.addoption("--shuffle", type=int, metavar="SEED", help="files, and the tests of each, in a random order")


def pytest_configure(config: pytest.Config) -> None:
    """With pytest-xdist, the tests of a file run in one worker: what they share is computed once. (Its groups by marks
    would let the others go anywhere; pytest-xdist 3.8 loses them with pytest 9.2.)"""
    if getattr(config.option, "dist", "no") == "load":
        config.option.dist = "loadfile"
        config.option.loadscopereorder = False
    for name in config.getoption("--as-python"):
        module = importlib.import_module(f"fluxtwin.{name}")
        kernels = {name: value.py_func for name, value in vars(module).items() if hasattr(value, "py_func")}
        vars(module).update(kernels)


@pytest.hookimpl(hookwrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is collected stays to the end, and the collector of garbage need not go through all of it each time: never while
    it grows, and then once in a million new objects. (Nothing is frozen: an old hypothesis counts on what it sees.)"""
    gc.disable()
    yield
    gc.enable()
    gc.set_threshold(10_000, 10, 10)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The studies begin: their files take longest, and one begun last would keep one worker busy and the others idle."""
    if (seed := config.getoption("--shuffle")) is None:
        items.sort(key=lambda item: item.path.parent.name != "scenarios")
        return
    random.Random(seed).shuffle(items)
    files = list(dict.fromkeys(item.path for item in items))
    # A file's tests stay together: they share what it computed.
    items.sort(key=lambda item: files.index(item.path))


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of reference and flight data beside the project; tests that need it skip without it."""
    folder = Path(os.environ.get("FLUXTWIN_SHARED", ROOT.parent / "shared"))
    if not (folder / "reference").is_dir():
        pytest.skip("the shared folder is absent: no reference or flight data here")
    return folder


@pytest.fixture(scope="session")
def close() -> Callable[..., None]:
    """`close(actual, expected, atol=..., unit=..., because=...)`: absolute tolerance with unit and reason."""
    return assert_close


def assert_close(actual: Any, expected: Any, *, atol: Any, unit: str, because: str) -> None:
    """Fail with the largest difference, the tolerance, its unit and the reason for it."""
    from witnessed import note  # a plugin, which pytest imports first

    a, e = np.broadcast_arrays(np.asarray(actual, dtype=float), np.asarray(expected, dtype=float))
    assert a.size, "nothing was compared"
    gap = np.abs(a - e)
    worst = np.unravel_index(int(np.argmax(np.where(np.isnan(gap), np.inf, gap))), gap.shape)
    assert bool((gap <= atol).all()), (
        f"differs by {gap[worst]:.6g} {unit} at {worst}: found {a[worst]:.9g}, expected {e[worst]:.9g}, "
        f"tolerance {np.broadcast_to(atol, gap.shape)[worst]:g} {unit} ({because})"
    )
    note(a, e, atol, unit)
