"""The one atomic writer: a file is written whole or not at all.

The bytes go to a temporary file in the target's own folder, are flushed to the disk, and take the
final name in one step; a crash leaves the old file, or none, never half of one.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fluxtwin.sim.errors import BadInput

_PREFIX = ".fluxtwin-"


def write_with(path: Path | str, write: Callable[[Path], None]) -> Path:
    """Let `write(temporary_path)` make the file, then give it its name in one step.

    Raises BadInput when the folder is missing, is not a folder or cannot be written.
    """
    path = Path(path)
    folder = path.parent if str(path.parent) else Path(".")
    if path.is_dir():
        raise BadInput("is a folder", where=str(path), wanted="the name of a file to write")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _sweep(folder)
        handle, name = tempfile.mkstemp(prefix=f"{_PREFIX}{os.getpid()}-", suffix=path.suffix, dir=folder)
    except OSError as error:
        raise BadInput(
            f"cannot write here ({error.strerror or error})",
            where=str(path),
            wanted="a folder that exists or can be made, and is not write-protected",
        ) from None
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        with open(temporary, "rb+") as opened:
            os.fsync(opened.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        raise BadInput(
            f"cannot write this file ({error.strerror or error})",
            where=str(path),
            wanted="free space and permission to write",
        ) from None
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_bytes(path: Path | str, content: bytes) -> Path:
    """Write `content` atomically."""
    return write_with(path, lambda temporary: _plain(temporary, content))


def write_text(path: Path | str, text: str) -> Path:
    """Write `text` atomically as UTF-8 with LF line ends."""
    return write_bytes(path, text.encode("utf-8"))


def to_json(value: Any) -> str:
    """JSON with two-space indent and a final newline; NaN and infinity are refused, never written."""
    return json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(path: Path | str, value: Any) -> Path:
    """Write `value` atomically as JSON (see `to_json`)."""
    return write_text(path, to_json(value))


def writable_folder(path: Path | str) -> Path:
    """Make the folder if need be and prove that a file can be written there, before long work starts.

    Raises BadInput when it cannot.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise BadInput("is a file", where=str(path), wanted="a folder for the results")
    try:
        write_bytes(path / f"{_PREFIX}probe", b"")
    except BadInput:
        raise BadInput(
            "cannot write in this folder", where=str(path), wanted="a folder that is not write-protected (see --out)"
        ) from None
    (path / f"{_PREFIX}probe").unlink(missing_ok=True)
    return path


def writable_file(path: Path | str) -> Path:
    """Prove that a file of this name can be written, before long work starts. Raises BadInput when it cannot."""
    path = Path(path)
    if path.is_dir():
        raise BadInput("is a folder", where=str(path), wanted="the name of a file to write")
    writable_folder(path.parent)
    return path


def _sweep(folder: Path) -> None:
    """Remove temporaries that a killed process left here; its number is in their names."""
    for leftover in folder.glob(f"{_PREFIX}[0-9]*-*"):
        number = leftover.name.removeprefix(_PREFIX).split("-", 1)[0]
        if number.isdigit() and int(number) != os.getpid() and not _alive(int(number)):
            leftover.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    if os.name != "posix":
        return True  # no harmless way to ask; a leftover does no harm either
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _plain(path: Path, content: bytes) -> None:
    with open(path, "wb") as opened:
        opened.write(content)


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
