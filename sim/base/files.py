"""The one atomic writer: a file is written whole or not at all.

The bytes go to a temporary file in the target's own folder, are flushed to the disk, and take the
final name in one step; a crash leaves the old file, or none, never half of one. The temporary is locked while
its writer lives, so that only what a dead one left is ever swept. Whether an output may go where it was sent is
decided in `outputs.py`.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.processes import unfinished
from fluxtwin.sim.base.seals import FORMAT, sealed

_PREFIX = ".fluxtwin-unfinished-"
_LEFTOVER = re.compile(re.escape(_PREFIX) + r"[a-z0-9_]{8}(\..*)?")  # as `mkstemp` makes them
_HAS_LOCKS = importlib.util.find_spec("fcntl") is not None  # not on Windows: a leftover then stays, and does no harm
_STREAM = re.compile(r"/dev/(?P<name>stdout|stderr)|/(dev|proc/self)/fd/(?P<number>[0-9]+)")


def write_with(path: Path | str, write: Callable[[Path], object]) -> Path:
    """Let `write(temporary_path)` make the file, then give it its name in one step.

    A symbolic link keeps its place and its target is replaced; an existing file keeps its mode and owner. A device, a
    pipe and the process's own streams (/dev/stdout, /dev/fd/N) are written to, never replaced.
    Raises BadInput when the folder is missing, is not a folder or cannot be written.
    """
    path = Path(path)
    if is_stream(path):
        return _into_stream(path, write)
    target = _target(path)
    with _temporary(target.parent, path) as (temporary, handle):
        try:
            with unfinished(temporary):
                write(temporary)
                os.fsync(handle)
                _take_after(target, temporary)
                os.replace(temporary, target)
        except OSError as error:
            raise _unwritable(path, error) from None
    return path


def write_bytes(path: Path | str, content: bytes | memoryview) -> Path:
    """Write `content` atomically."""
    return write_with(path, lambda temporary: temporary.write_bytes(content))


def write_text(path: Path | str, text: str) -> Path:
    """Write `text` atomically as UTF-8 with LF line ends; see `escaped`."""
    return write_bytes(path, escaped(text).encode("utf-8"))


def write_toml(path: Path | str, text: str, *, comment: str = "#", draft: bool = False) -> Path:
    """Write text under a first line that says who wrote it, with a digest of the rest: see `sealed`.

    draft: the text is meant to be edited, and no reader holds a change against it.
    """
    try:
        content = sealed(text, comment, "to be edited" if draft else f"format {FORMAT}").encode("utf-8")
    except UnicodeEncodeError:
        raise BadInput(
            "a name in it is not UTF-8, which TOML requires", where=str(path), wanted="files with UTF-8 names"
        ) from None
    return write_bytes(path, content)


def plain_tree(
    value: Any, leaf: Callable[[Any], Any] = lambda one: one.tolist() if hasattr(one, "tolist") else one
) -> Any:
    """`value` with dicts and lists of Python at any depth, and what `leaf` makes of all else: of arrays, lists."""
    if isinstance(value, Mapping):
        return {key: plain_tree(one, leaf) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain_tree(one, leaf) for one in value]
    return leaf(value)


def to_json(value: Any) -> str:
    """JSON with two-space indent and a final newline; NaN and infinity are refused, never written.

    Bytes of a file name that are not UTF-8 become escapes that JSON reads back as Python's own name of that file.
    """
    return escaped(json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def escaped(text: str) -> str:
    """`text` with the bytes of a file name that are not UTF-8 (Python's lone surrogates) as escapes `\\udcNN`."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def write_json(path: Path | str, value: Any) -> Path:
    """Write `value` atomically as JSON (see `to_json`)."""
    return write_text(path, to_json(value))


def writable_folder(path: Path | str) -> Path:
    """Make the folder, inside one that exists, and prove that a file can be written there, before long work starts.

    Raises BadInput when it cannot.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise BadInput("is a file", where=str(path), wanted="a folder for the results")
    if not path.exists() and not path.parent.is_dir():
        raise BadInput(f"there is no folder {path.parent}", where=str(path), wanted="a folder inside one that exists")
    try:
        path.mkdir(exist_ok=True)
        with _temporary(path, path):
            pass
    except (BadInput, OSError):
        raise BadInput(
            "cannot write in this folder", where=str(path), wanted="a folder that is not write-protected (see --out)"
        ) from None
    return path


def writable_file(path: Path | str) -> Path:
    """Prove that a file of this name can be written, before long work starts. Raises BadInput when it cannot."""
    path = Path(path)
    if is_stream(path):
        return path
    with _temporary(_target(path).parent, path):
        return path


def is_stream(path: Path | str) -> bool:
    """Whether writing to `path` means handing bytes on: a device, a pipe, or a stream of this process."""
    if _descriptor(path) is not None:
        return True
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    return stat.S_ISCHR(mode) or stat.S_ISFIFO(mode)


def followed(path: Path | str) -> Path:
    """The file that `path` is in the end, through all symbolic links, whether it exists or not."""
    return Path(os.path.realpath(path))


def _target(path: Path) -> Path:
    target = followed(path)
    if target.is_dir():
        raise BadInput("is a folder", where=str(path), wanted="the name of a file to write")
    return target


def _descriptor(path: Path | str) -> int | None:
    """The number behind /dev/stdout, /dev/stderr, /dev/fd/N: opening these anew would cut what was written before."""
    found = _STREAM.fullmatch(os.path.abspath(path))
    if found is None:
        return None
    return int(found["number"]) if found["number"] else {"stdout": 1, "stderr": 2}[found["name"]]


def _into_stream(path: Path, write: Callable[[Path], object]) -> Path:
    """The whole of what `write` makes, then into the device or pipe in one go."""
    with tempfile.TemporaryDirectory(prefix=_PREFIX) as folder:
        temporary = Path(folder) / path.name
        write(temporary)
        try:
            for stream in filter(None, (sys.stdout, sys.stderr)):
                stream.flush()
            number = _descriptor(path)
            with open(temporary, "rb") as source, open(path if number is None else os.dup(number), "wb") as sink:
                shutil.copyfileobj(source, sink)
        except BrokenPipeError:  # the reader had enough: of what else there is to write others may want more
            pass
        except OSError as error:
            raise _unwritable(path, error) from None
    return path


@contextmanager
def _temporary(folder: Path, path: Path) -> Iterator[tuple[Path, int]]:
    """An empty file in `folder`, locked as long as it is at work, gone afterwards. `path` is for the messages."""
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise BadInput(f"the folder {folder} {what}", where=str(path), wanted="a file in a folder that exists")
    try:
        sweep(folder)
        handle, name = _locked(folder, path.suffix)
    except OSError as error:
        raise BadInput(
            f"cannot write here ({error.strerror or error})",
            where=str(path),
            wanted="a folder that exists and is not write-protected",
        ) from None
    try:
        yield Path(name), handle
    finally:
        Path(name).unlink(missing_ok=True)
        os.close(handle)


def _locked(folder: Path, suffix: str) -> tuple[int, str]:
    """A temporary whose lock is held before another's sweep could take it for a leftover."""
    while True:
        handle, name = tempfile.mkstemp(prefix=_PREFIX, suffix=suffix, dir=folder)
        if not _HAS_LOCKS:
            return handle, name
        import fcntl

        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:  # a sweep looks at it right now, and will remove it
            os.close(handle)
            continue
        except OSError:  # no locks on this file system: then no sweep removes anything either
            return handle, name
        if os.path.exists(name):
            return handle, name
        os.close(handle)


def sweep(folder: Path) -> None:
    """Remove what a killed process left here: temporaries that nobody holds a lock on, wherever that process ran."""
    if not _HAS_LOCKS:
        return
    import fcntl

    for leftover in folder.glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if not (_LEFTOVER.fullmatch(leftover.name) and stat.S_ISREG(leftover.lstat().st_mode)):
                continue
            handle = os.open(leftover, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                leftover.unlink(missing_ok=True)
            finally:
                os.close(handle)


def _take_after(target: Path, temporary: Path) -> None:
    """Mode and owner of the file that is replaced; those of a new file where there is none."""
    try:
        old = target.stat()
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        return
    if hasattr(os, "chown") and (old.st_uid, old.st_gid) != (os.geteuid(), os.getegid()):
        with suppress(OSError):
            os.chown(temporary, old.st_uid, old.st_gid)
    os.chmod(temporary, stat.S_IMODE(old.st_mode))


def _unwritable(path: Path, error: OSError) -> BadInput:
    return BadInput(
        f"cannot write this file ({error.strerror or error})",
        where=str(path),
        wanted="free space and permission to write",
    )
