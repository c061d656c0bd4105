"""Where an output may go: decided here, once, before any work starts.

An output is never a file that the same call reads, nor that such a file names (through links, too); two outputs never
share a file; the ending of the name fits what is written; the folder exists; and an existing file is replaced without
`--force` only where it is empty or fluxtwin wrote it. How a file is replaced is the business of `files.py`.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import followed, is_stream, writable_file
from fluxtwin.sim.base.limits import TEXT_BYTES
from fluxtwin.sim.base.seals import is_sealed
from fluxtwin.sim.base.toml_input import parse_tree
from fluxtwin.sim.telemetry.formats.catalogue import WRITTEN

JSON_MARK = "fluxtwin"
"""First key of every JSON result; its value is the version."""
_HEAD_BYTES = 65_536  # every mark but that of NetCDF stands at the beginning
_LONGEST_NAME = 4096  # bytes of a path, as Linux has it


@dataclass(frozen=True)
class Kind:
    """What is written, and how the name of such a file ends; `others` may end as they like, but not as another kind."""

    words: str
    endings: tuple[str, ...]
    others: bool = False
    inside: str = ""
    """The file that is written, where the option names a folder for it, which need not exist yet."""


_NETCDF = (".nc", ".nc4", ".h5")
TELEMETRY = Kind("telemetry", (".csv", ".csv.gz", *_NETCDF, *WRITTEN))
TRUTH = Kind("the truth of a simulation", _NETCDF)
CALIBRATION = Kind("a calibration", (".toml",))
SCENARIO = Kind("a scenario", (".toml",))
COLUMN_MAP = Kind("a column map", (".toml",))
PAGE = Kind("a page", (".html", ".htm"))
RESIDUALS = Kind("a figure", (".png",), inside="residuals.png")
SECOND_RESIDUALS = Kind("a figure", (".png",), inside="residuals-2.png")
TABLE = Kind("a table", (".csv",))
JSON = Kind("JSON", (".json",), others=True)
STUDY = Kind("the results of a study", ())
ENSEMBLE = Kind("the results of an ensemble", ())
CAMPAIGN = Kind("the results of a campaign", ())
_FOLDERS = {STUDY: "summary.json", ENSEMBLE: "ensemble.json", CAMPAIGN: "campaign.json"}
"""Kinds that are folders, and the file by which each is known."""
_ALL_ENDINGS = (*TELEMETRY.endings, ".toml", *PAGE.endings, ".png", ".gz")

_Identity: TypeAlias = tuple[int, int] | Path


def claim(
    outputs: Mapping[str, tuple[Path | str | None, Kind]], inputs: Iterable[Path | str | None], *, force: bool = False
) -> None:
    """Make sure that every output may go where it was sent. Raises BadInput that names the option at fault.

    outputs: by option, path and kind; None and "-" (standard output) are passed over. inputs: what the call reads, None
    passed over, a field model as `chaos:FILE`; files that a scenario or a column map names are found here. force: the
    user's word that files which fluxtwin did not write may be replaced; an input never is.
    """
    read: dict[_Identity, Path] = {}
    for path in _with_named_files(inputs):
        read.setdefault(_identity(path), path)
    taken: dict[_Identity, tuple[str, Path]] = {}
    for option, (given, kind) in outputs.items():
        if given is None or str(given) == "-":
            continue
        path, where = Path(given) / kind.inside, f"{option} {given}"
        identity = _identity(path)
        if identity in read and _identity(read[identity]) == _identity(path):
            same = read[identity]
            via = "" if os.path.abspath(same) == os.path.abspath(path) else f": it is {same}"
            raise BadInput(f"is an input of this command{via}", where=where, wanted="another name; inputs are kept")
        other, its_path = taken.get(identity, ("", path))
        if other and _identity(its_path) == _identity(path) and not _is_character_device(path):
            raise BadInput(f"is the same file as that of {other}", where=where, wanted="a file for each")
        taken[identity] = option, path
        _fitting_name(path, kind, where)
        _free(path, kind, where, force)


def written_by_fluxtwin(path: Path | str) -> bool:
    """Whether an existing file is empty or bears the marks of what fluxtwin writes; not, where it cannot be read.

    Telemetry as NetCDF and TOML carry a digest, so that a file edited since counts as the editor's. PNG, HTML, JSON and the
    truth of a simulation carry a name. CSV has no place for a mark: it never counts as fluxtwin's.
    """
    try:
        with open(path, "rb") as opened:
            head = opened.read(_HEAD_BYTES)
            if head.startswith(b"\x89HDF"):
                from fluxtwin.sim.telemetry.netcdf_files import is_own

                return is_own(path)
            if b" Written by fluxtwin, " in head:
                return is_sealed((head + opened.read()).decode("utf-8", "replace")) is True
    except OSError:
        return False
    return (
        not head
        or (head.startswith(b"\x89PNG") and b"fluxtwin" in head)
        or head.lstrip().startswith(b'{\n  "%s": ' % JSON_MARK.encode())
        or b'<meta name="generator" content="fluxtwin' in head
    )


def _fitting_name(path: Path, kind: Kind, where: str) -> None:
    name = path.name.lower()
    if not (kind.endings and path.suffix) and (kind.others or not kind.endings):
        return
    if is_stream(path) or name.endswith(kind.endings) or (kind.others and not name.endswith(_ALL_ENDINGS)):
        return
    wanted = ", ".join(kind.endings)
    raise BadInput(f"this is not a name for {kind.words}", where=where, wanted=f"a name that ends in {wanted}")


def _free(path: Path, kind: Kind, where: str, force: bool) -> None:
    """BadInput unless something may be written there, and what lies there may go."""
    if kind in _FOLDERS:
        record = path / _FOLDERS[kind]
        # the others have a summary.json too
        own = record.is_file() and (kind is not STUDY or written_by_fluxtwin(record))
        if path.is_dir() and not force and any(path.iterdir()) and not own:
            raise BadInput(
                f"holds files, but not {kind.words}",
                where=where,
                wanted="a new or empty folder, or --force to write here",
            )
        return
    if kind.inside and not path.parent.exists():
        path = path.parent  # made later; here it is proved that it can be
    writable_file(path)
    target = followed(path)
    if is_stream(path) or not target.exists():
        return
    if not target.is_file():
        raise BadInput("is neither a file nor a device or pipe", where=where, wanted="another name")
    if not force and not written_by_fluxtwin(target):
        csv = target.name.lower().endswith((".csv", ".csv.gz"))
        why = "a CSV does not say who wrote it" if csv else "fluxtwin did not write it, or it was edited since"
        raise BadInput(f"exists, and {why}", where=where, wanted="another name, or --force to replace it")


def _identity(path: Path | str) -> _Identity:
    """What two names of one file share: device and number where it exists, else the name behind all links.

    Where another process replaces a file, its number is soon another file's: what was equal is compared once more.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return followed(path)
    return found.st_dev, found.st_ino


def _is_character_device(path: Path) -> bool:
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except OSError:
        return False


def _with_named_files(inputs: Iterable[Path | str | None]) -> Iterator[Path]:
    """The inputs, and every file that a TOML file among them names: relative to it, to another input, or to here."""
    todo = [Path(str(one).removeprefix("chaos:")) for one in inputs if one is not None]
    folders = [Path(), *(path if path.is_dir() else path.parent for path in todo)]
    seen: set[_Identity] = set()
    while todo:
        path = todo.pop(0)
        if (identity := _identity(path)) in seen:
            continue
        seen.add(identity)
        yield path
        texts = [text.removeprefix("chaos:") for text in _texts(_tree(path))]
        for folder in dict.fromkeys([path.parent, *folders] if texts else []):
            for text in texts:
                todo += _named(folder, text)


def _named(folder: Path, text: str) -> list[Path]:
    """The files that a text means in a folder: a name, or a pattern as in a column map."""
    if not 0 < len(text) < _LONGEST_NAME or "\n" in text or "\0" in text:
        return []
    try:
        if any(sign in text for sign in "*?["):
            return [path for path in folder.glob(text) if path.is_file()]
        return [folder / text] if (folder / text).is_file() else []
    except (OSError, ValueError, NotImplementedError):
        return []


def _tree(path: Path) -> Any:
    """The file as parsed TOML; nothing where it is none. A pipe is not looked into: that would empty it."""
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode) or found.st_size > TEXT_BYTES:
            return None
        return parse_tree(path.read_bytes().decode("utf-8-sig"), where=str(path))
    except (OSError, ValueError, BadInput):
        return None


def _texts(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    for part in tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ():
        yield from _texts(part)
