"""Compiled kernels that start quickly and never fail for their cache.

numba keeps compiled code on disk. Left alone it writes beside the source (impossible in a read-only install),
gives up where there is no home folder, compiles again for every copy and reinstall, and raises at every start once a
cache file is damaged. Here the cache is a private folder of the user (mode 0700, its files are pickles: never shared)
where a kernel lies under the digest of its text and of the versions that compile it: wherever the text was installed,
and whenever, it is found again. A damaged file is dropped and compiled again, and where no folder can be had the kernel
is compiled for this process only. NUMBA_CACHE_DIR, if set, is honoured.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

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
            with contextlib.suppress(OSError, RuntimeError):
                compiled._cache = _cache_type(function, _Place(function, uses, folder))
        same_signature: Callable[P, R] = compiled
        return same_signature

    return decorate


def part(**options: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """`numba.njit(**options)` for a function that other kernels call: it is kept in their caches, and has none."""
    compiled: Callable[[Callable[P, R]], Callable[P, R]] = numba.njit(**options)
    return compiled


class _Place(_CacheLocator):
    """The folder of a kernel: the digest of all that it is compiled from, but not of where that lies."""

    def __init__(self, function: Any, uses: Iterable[ModuleType], folder: str) -> None:
        self._py_file = function.__code__.co_filename
        self._lineno = function.__code__.co_firstlineno
        said = [function.__module__, numba.__version__, np.__version__, str(sys.implementation.cache_tag)]
        self.files = [self._py_file, *(module.__file__ for module in uses if module.__file__ is not None)]
        parts = [word.encode() for word in said] + [Path(file).read_bytes() for file in self.files]
        self._stamp = hashlib.sha256(b"".join(hashlib.sha256(one).digest() for one in parts)).hexdigest()
        self._folder = os.path.join(folder, f"{function.__module__.rpartition('.')[2]}_{self._stamp[:32]}")

    def get_cache_path(self) -> str:
        return self._folder

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return str(self._lineno)


class _Kept(CompileResultCacheImpl):
    """What numba keeps of a kernel, at the place given."""

    def __init__(self, function: Any, place: _Place) -> None:
        self._locator, self._lineno, parent = place, place._lineno, cast(Any, super())
        self._filename_base = parent.get_filename_base(function.__qualname__, getattr(sys, "abiflags", ""))


class _ForgivingCache(FunctionCache):
    """A cache whose every failure means: compile."""

    def __init__(self, function: Any, place: _Place) -> None:
        own, parent = cast(Any, self), cast(Any, super())
        own._impl_class = partial(_Kept, place=place)
        parent.__init__(function)

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


@cache
def cache_folder() -> str | None:
    """The private folder for compiled code, made if need be; None where there can be none."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return os.environ["NUMBA_CACHE_DIR"]
    with contextlib.suppress(OSError, RuntimeError):
        folder = _user_cache() / "fluxtwin" / "kernels"
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
