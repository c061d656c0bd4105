"""Recognised layouts: column maps that travel with the package and say themselves which files they are for.

A file is recognised when its title, the names of all its variables, their shapes and their units are those that the
map states; one more variable, or another unit, and it is not. `check` reads such a file without `--map` and says so;
whatever computes from telemetry asks for the map all the same.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.telemetry.column_map import ColumnMap, Layout, load_column_map
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile

FOLDER = Path(__file__).parent / "data" / "layouts"


@cache
def packaged() -> dict[str, ColumnMap]:
    """The packaged maps by their names, without `.toml`."""
    return {path.stem: load_column_map(path) for path in sorted(FOLDER.glob("*.toml"))}


def recognised(path: Path | str) -> tuple[str, ColumnMap] | None:
    """Name and map of the one packaged layout that `path` has in every particular; None when there is none."""
    if not Path(path).name.lower().endswith((".nc", ".nc4", ".h5")):
        return None
    try:
        with NetcdfFile(path) as opened:
            fitting = [
                (name, column_map)
                for name, column_map in packaged().items()
                if column_map.layout is not None and _fits(opened, column_map.layout)
            ]
    except BadInput:  # damaged: the reader's own message is the better one
        return None
    return fitting[0] if len(fitting) == 1 else None


def _fits(opened: NetcdfFile, layout: Layout) -> bool:
    title = opened.attributes().get("title")
    if not (isinstance(title, str) and title.startswith(layout.title_begins)):
        return False
    if set(opened.names()) != set(layout.variables):
        return False
    rows = opened.shape("time")[0]
    for name, stated in layout.variables.items():
        units = opened.attributes(name).get("units")
        if name == "time" and isinstance(units, str):
            units = units.split(" since ")[0]
        shape = tuple(rows if size == "time" else size for size in stated.shape)
        if opened.shape(name) != shape or units != stated.units:
            return False
    return True
