"""Compiled kernels start whatever the state of their cache: damaged, unwritable, homeless, or shared."""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from fluxtwin.sim.base import kernel_cache
from fluxtwin.sim.spacecraft.dynamics.kernels import PART

MODULE = """
from fluxtwin.sim.base.kernel_cache import kernel

@kernel()
def double(x):
    return 2.0 * x
"""


def run(folder: Path, **environment: str) -> list[str]:
    """Result, cache hits and cache folder of a small kernel, imported anew with that environment."""
    folder.mkdir(exist_ok=True)
    if not (folder / "tiny.py").exists():
        (folder / "tiny.py").write_text(MODULE, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("NUMBA_CACHE_DIR", raising=False)
        for name, value in environment.items():
            patch.setenv(name, value)
        patch.setattr(sys, "dont_write_bytecode", True)
        patch.setattr(kernel_cache, "cache_folder", kernel_cache.cache_folder.__wrapped__)
        patch.syspath_prepend(folder)
        for name in ("tiny", "other"):
            sys.modules.pop(name, None)
        double = importlib.import_module("tiny").double
        return [str(double(21.0)), str(sum(double._cache_hits.values())), str(kernel_cache.cache_folder())]


pytestmark = [
    pytest.mark.property,
    pytest.mark.skipif(os.name == "nt", reason="the folders and modes tested are those of POSIX"),
]


def test_a_damaged_cache_is_compiled_again(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(tmp_path / "src", XDG_CACHE_HOME=str(cache))[:2] == ["42.0", "0"]
    assert not list((tmp_path / "src").rglob("*.nb?"))  # and not beside the source
    for pattern in ("*.nbi", "*.nbc"):
        for damaged in cache.rglob(pattern):
            damaged.write_bytes(damaged.read_bytes()[:40])
        assert run(tmp_path / "src", XDG_CACHE_HOME=str(cache))[:2] == ["42.0", "0"]
        assert run(tmp_path / "src", XDG_CACHE_HOME=str(cache))[:2] == ["42.0", "1"]  # mended: it is a cache
    code = "import tiny; print(tiny.double(21.0), sum(tiny.double._cache_hits.values()))"
    beside = {"PYTHONPATH": str(tmp_path / "src"), "XDG_CACHE_HOME": str(cache)}
    said = subprocess.run([sys.executable, "-B", "-c", code], env=beside, capture_output=True, text=True, check=True)
    assert said.stdout == "42.0 1\n"  # of other processes too


def test_no_folder_means_no_cache_and_no_failure(tmp_path: Path) -> None:
    blocked = tmp_path / "a_file"
    blocked.write_text("", encoding="utf-8")
    assert run(tmp_path / "src", XDG_CACHE_HOME=str(blocked)) == ["42.0", "0", "None"]


def test_a_folder_others_may_write_is_not_trusted(tmp_path: Path) -> None:
    """What lies in the cache is loaded as code."""
    cache = tmp_path / "cache"
    folder = Path(run(tmp_path / "src", XDG_CACHE_HOME=str(cache))[2])
    assert folder.is_relative_to(cache)
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o777)
    assert run(tmp_path / "src", XDG_CACHE_HOME=str(cache)) == ["42.0", "0", "None"]


USING = """
import other
from fluxtwin.sim.base.kernel_cache import kernel, part

scale = part()(other.scale)

@kernel(uses=[other])
def double(x):
    return scale(x)
"""


def test_a_kernel_is_compiled_again_when_what_it_uses_has_changed(tmp_path: Path) -> None:
    """numba looks at the kernel's own file alone, and would go on with the old constant."""
    cache, source = str(tmp_path / "cache"), tmp_path / "src"
    source.mkdir()
    (source / "tiny.py").write_text(USING, encoding="utf-8")
    for factor, answer in ((2.0, "42.0"), (3.0, "63.0")):
        (source / "other.py").write_text(f"def scale(x):\n    return {factor} * x\n", encoding="utf-8")
        assert run(source, XDG_CACHE_HOME=cache)[:2] == [answer, "0"]
    assert run(source, XDG_CACHE_HOME=cache)[:2] == ["63.0", "1"]


def test_a_copy_or_a_reinstall_finds_what_was_compiled_elsewhere(tmp_path: Path) -> None:
    """What counts is the text: not its folder, nor its age; and two versions of it do not drive each other out."""
    cache = str(tmp_path / "cache")
    assert run(tmp_path / "first", XDG_CACHE_HOME=cache)[:2] == ["42.0", "0"]
    os.utime(tmp_path / "first" / "tiny.py", (0, 0))
    assert run(tmp_path / "first", XDG_CACHE_HOME=cache)[:2] == ["42.0", "1"]
    assert run(tmp_path / "second", XDG_CACHE_HOME=cache)[:2] == ["42.0", "1"]
    (tmp_path / "second" / "tiny.py").write_text(MODULE.replace("2.0", "3.0"), encoding="utf-8")
    assert run(tmp_path / "second", XDG_CACHE_HOME=cache)[:2] == ["63.0", "0"]
    assert run(tmp_path / "first", XDG_CACHE_HOME=cache)[:2] == ["42.0", "1"]


def test_a_kernel_of_another_name_or_of_other_versions_is_another(tmp_path: Path) -> None:
    """The compiled code looks its globals up by the name of its module, and is laid out as numba and numpy have it."""

    def place(module: str = "tiny") -> str:
        function: Any = types.FunctionType(codes.__code__, {"__name__": module})
        return kernel_cache._Place(function, (), str(tmp_path)).get_cache_path()

    with pytest.MonkeyPatch.context() as patch:
        found = [place(), place("huge.tiny")]
        for package in (np, numba):
            patch.setattr(package, "__version__", "0.1")
            found.append(place())
    assert place() == found[0]
    assert len(set(found)) == 4


def test_a_part_of_the_flight_counts_no_references() -> None:
    """To count those to an array at every call took half the time of a flight; numba by itself counts them."""

    def first(one: Any, other: Any) -> float:
        for row in range(one.shape[0]):
            if one[row] > 0.0:
                return float(other[row])
        return 0.0

    signature = (numba.float64[::1], numba.float64[::1])
    for options, counts in (({}, True), (PART, False)):
        compiled: Any = kernel_cache.part(**options)(first)
        compiled.compile(signature)
        assert ("call void @NRT_incref" in compiled.inspect_llvm(signature)) is counts


def wanted(function: Any, trees: Mapping[str, ast.Module], found: dict[Any, None]) -> set[str]:
    """Modules of the product from which something is compiled into a function, its own among them."""
    function = getattr(function, "py_func", function)
    if not isinstance(function, types.FunctionType) or function in found:
        return set()
    found[function] = None
    names = {name for code in codes(function.__code__) for name in code.co_names}
    needed = {function.__module__} & set(trees)
    for node in ast.walk(trees.get(function.__module__, ast.Module([], []))):
        if isinstance(node, ast.ImportFrom):
            for alias in (one for one in node.names if (one.asname or one.name) in names):
                whole = f"{node.module}.{alias.name}"
                needed |= {whole if whole in trees else str(node.module)} & set(trees)
    inside = [cell.cell_contents for cell in function.__closure__ or ()]
    for one in [*inside, *(function.__globals__[name] for name in names & set(function.__globals__))]:
        needed |= wanted(one, trees, found)
    return needed


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for one in code.co_consts:
        if isinstance(one, types.CodeType):
            yield from codes(one)


def installed(module: str) -> Path:
    """The file that is imported, wherever the package is installed."""
    return Path(str(importlib.import_module(module).__file__)).resolve()


def test_every_kernel_names_what_is_compiled_into_it(trees: dict[str, ast.Module]) -> None:
    """Else an old copy of it is taken from the cache when only that has changed."""
    kernels = {
        f"{name}.{label}": value
        for name in trees
        if name.endswith(("kernel", "kernels"))
        for label, value in vars(importlib.import_module(name)).items()
        if isinstance(getattr(value, "_cache", None), kernel_cache._ForgivingCache)
    }
    assert len(kernels) > 20
    missing = {}
    for name, value in kernels.items():
        named = {Path(file).resolve() for file in value._cache._impl.locator.files}
        if left := {one for one in wanted(value, trees, {}) if installed(one) not in named}:
            missing[name] = left
    assert not missing
    assert "fluxtwin.sim.earth.constants" in wanted(kernels["fluxtwin.sim.earth.field_kernels.synthesize"], trees, {})
