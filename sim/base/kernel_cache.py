"""Compiled kernels that start quickly and never fail for their cache.

numba keeps compiled code on disk. Left alone it writes beside the source (impossible in a read-only install),
gives up where there is no home folder, and raises at every start once a cache file is damaged. Here the cache
is a private folder of the user (mode 0700, its files are pickles: never shared), a damaged file is dropped
and compiled again, and where no folder can be had the kernel is compiled for this process only.
NUMBA_CACHE_DIR, if set, is honoured.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

import numba
from numba.core.caching import FunctionCache

P = ParamSpec("P")
R = TypeVar("R")
_config: Any = numba.config


def kernel(*, uses: Iterable[ModuleType] = (), **options: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """`numba.njit(**options)` with the safe cache of this module.

    uses: other modules whose functions or constants are compiled into this one; when their text changes, the kernel
    is compiled again (numba itself looks at the kernel's own file alone).
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        compiled: Any = numba.njit(**options)(function)
        folder = cache_folder()
        if folder is not None and not _config.DISABLE_JIT:
            before = _config.CACHE_DIR
            _config.CACHE_DIR = folder  # read when the cache object is made, and only then
            try:
                with contextlib.suppress(OSError, RuntimeError):
                    compiled._cache = _cache_type(function)
                    _stamp_with(compiled._cache, uses)
            finally:
                _config.CACHE_DIR = before
        same_signature: Callable[P, R] = compiled
        return same_signature

    return decorate


def part(**options: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """`numba.njit(**options)` for a function that other kernels call: it is kept in their caches, and has none."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        compiled: Callable[P, R] = numba.njit(**options)(function)
        return compiled

    return decorate


class _ForgivingCache(FunctionCache):
    """A cache whose every failure means: compile."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        parent: Any = super()
        try:
            return parent.load_overload(sig, target_context)
        except Exception:  # a damaged pickle may raise anything
            self._drop()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        parent: Any = super()
        try:
            parent.save_overload(sig, data)
        except Exception:
            self._drop()

    def _drop(self) -> None:
        with contextlib.suppress(Exception):
            Path(self._cache_file._index_path).unlink(missing_ok=True)


_cache_type: Any = _ForgivingCache


def _stamp_with(cached: Any, modules: Iterable[ModuleType]) -> None:
    """Make the text of other modules part of what the cache is good for."""
    texts = [Path(module.__file__).read_bytes() for module in modules if module.__file__ is not None]
    if texts:
        digest = hashlib.sha256(b"\0".join(texts)).hexdigest()
        cached._cache_file._source_stamp = (cached._cache_file._source_stamp, digest)


@cache
def cache_folder() -> str | None:
    """The private folder for compiled code, made if need be; None where there can be none."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return os.environ["NUMBA_CACHE_DIR"]
    version = f"numba-{numba.__version__}-py{sys.version_info.major}{sys.version_info.minor}"
    with contextlib.suppress(OSError, RuntimeError):
        folder = _user_cache() / "fluxtwin" / version
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if _private(folder) and os.access(folder, os.W_OK | os.X_OK):
            return str(folder)
    return None


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _private(folder: Path) -> bool:
    """True if nobody else can write there: what lies in the folder is loaded as code."""
    if os.name == "nt":
        return True
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022
