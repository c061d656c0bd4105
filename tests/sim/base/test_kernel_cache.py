"""Compiled kernels start whatever the state of their cache: damaged, unwritable, homeless, or shared."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import pickle, sys
from fluxtwin.sim.base import kernel_cache
sys.path.insert(0, {folder!r})
import tiny
print(tiny.double(21.0), sum(tiny.double._cache_hits.values()), kernel_cache.cache_folder())
"""
MODULE = """
from fluxtwin.sim.base.kernel_cache import kernel

@kernel()
def double(x):
    return 2.0 * x
"""


def run(folder: Path, **environment: str) -> list[str]:
    """Result, cache hits and cache folder of a small kernel in a fresh process with that environment."""
    folder.mkdir(exist_ok=True)
    module = folder / "tiny.py"
    if not module.exists():
        module.write_text(MODULE, encoding="utf-8")
    kept = {key: os.environ[key] for key in ("PATH", "SYSTEMROOT", "LD_LIBRARY_PATH") if key in os.environ}
    done = subprocess.run(
        [sys.executable, "-B", "-c", SCRIPT.format(folder=str(folder))],
        env=kept | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


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


def test_no_folder_means_no_cache_and_no_failure(tmp_path: Path) -> None:
    blocked = tmp_path / "a_file"
    blocked.write_text("")
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
