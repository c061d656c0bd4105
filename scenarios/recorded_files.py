"""Recorded data that a study reads: is every file there, with its columns, and is every number one that can be?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import tomli_w

from fluxtwin.scenarios.page import StudyResult
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.toml_input import read_tree
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.telemetry.csv_files import CsvFile, open_csv

F = TypeVar("F")

ORBIT_KM = (6480.0, 8400.0)
"""Distance from the centre of the Earth: altitudes of about 100 to 2,000 km, where these satellites fly."""


class Settings:
    """The settings of a study, as its packaged TOML has them: `settings.magsat.file`."""

    def __init__(self, tree: dict[str, Any]) -> None:
        """tree: tables and values."""
        self.tree = tree

    def __getattr__(self, name: str) -> Any:
        if name not in self.__dict__.get("tree", {}):
            raise AttributeError(f"the settings have no {name!r}")
        value = self.tree[name]
        return Settings(value) if isinstance(value, dict) else value

    @property
    def files(self) -> list[str]:
        """Every recorded file that the study reads: the keys that end in `file` or `files`."""
        found: list[str] = []
        for key, value in self.tree.items():
            if isinstance(value, dict):
                found += Settings(value).files
            elif key.endswith(("file", "files")):
                found += value if isinstance(value, list) else [value]
        return found


def read_settings(path: Path) -> Settings:
    """The settings in a TOML file. Raises BadInput as `read_tree`."""
    return Settings(read_tree(path))


def check_folder(data: Path | None, files: Sequence[str]) -> Path:
    """The folder, once it is sure that every file is there. Raises BadInput naming those that are not."""
    wanted = f"--data DIR, a folder with the recorded files {', '.join(files)}"
    if data is None:
        raise BadInput("this study reads recorded flight data, and no folder was given", where="--data", wanted=wanted)
    missing = [name for name in files if not (data / name).is_file()]
    if missing:
        raise BadInput(f"missing there: {', '.join(missing)}", where=f"--data {data}", wanted=wanted)
    return data


def run_on_files(
    settings_file: Path,
    compute: Callable[[Path, Settings, Progress], F],
    present: Callable[[F, Settings], StudyResult],
    out: Path,
    data: Path | None,
    progress: Progress = silent,
) -> StudyResult:
    """The whole of a study of recorded files. out: an existing folder, which receives the settings too; data: their folder.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings(settings_file)
    found = compute(check_folder(data, settings.files), settings, part_of(progress, 0.0, 0.95))
    progress("drawing", 0.95)
    written = [write_text(out / settings_file.name, tomli_w.dumps(settings.tree))]
    return replace(present(found, settings), written=written)


def opened(path: Path, wanted: Sequence[str]) -> CsvFile:
    """A CSV file with these columns. Raises BadInput naming those that are missing."""
    table = open_csv(path)
    missing = [name for name in wanted if name not in table.names]
    if missing:
        raise BadInput(f"columns missing: {', '.join(missing)}", where=table.where, wanted=", ".join(wanted))
    return table


def numbers(table: CsvFile, names: Sequence[str]) -> FloatArray:
    """(N, len(names)) columns in which every row has a number. Raises BadInput naming the first that has none."""
    columns = table.numbers(list(names))
    values = np.stack([columns[name] for name in names], axis=1)
    blank = np.argwhere(~np.isfinite(values))
    if blank.size:
        row, column = blank[0]
        raise BadInput(f"{names[column]} in row {row + 1} is missing", where=table.where, wanted="a number")
    return values


def increasing(time: TimeArray, where: str) -> TimeArray:
    """The stamps (N,), each later than the one before. Raises BadInput naming the first that is missing or is not."""
    missing, back = np.isnat(time), np.diff(time) <= np.timedelta64(0, "ns")
    if missing.any():
        wanted = "a stamp in every row"
        raise BadInput(f"time in row {np.argmax(missing) + 1} is missing", where=where, wanted=wanted)
    if back.any():
        wanted = "strictly increasing UTC"
        raise BadInput(f"time does not increase in row {np.argmax(back) + 2}", where=where, wanted=wanted)
    return time


def none_wrong(wrong: BoolArray, where: str, value: FloatArray, what: str, wanted: str) -> None:
    """Raises BadInput for the first row (N,) that is wrong. what: as "has |B| = {:.6g} nT", for its value."""
    if wrong.any():
        row = int(np.argmax(wrong))
        raise BadInput(f"row {row + 1} {what.format(value[row])}", where=where, wanted=wanted)
