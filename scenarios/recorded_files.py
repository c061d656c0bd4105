"""Files of recorded data that a study reads: are they there, do they have the columns, is every number there?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.csv_files import CsvFile, open_csv


def check_folder(data: Path | None, files: Sequence[str]) -> Path:
    """The folder, once it is sure that every file is there. Raises BadInput naming those that are not."""
    wanted = f"--data DIR, a folder with the recorded files {', '.join(files)}"
    if data is None:
        raise BadInput("this study reads recorded flight data, and no folder was given", where="--data", wanted=wanted)
    folder = Path(data)
    if not folder.is_dir():
        raise BadInput("there is no such folder", where=f"--data {folder}", wanted=wanted)
    missing = [name for name in files if not (folder / name).is_file()]
    if missing:
        raise BadInput(f"missing there: {', '.join(missing)}", where=f"--data {folder}", wanted=wanted)
    return folder


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
