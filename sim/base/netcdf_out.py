"""NetCDF-4 files are written here, by h5netcdf alone: xarray and pandas would take a third of a second to load."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base.files import write_bytes

TRUTH_TITLE = "truth behind telemetry simulated by fluxtwin"


@dataclass(frozen=True, eq=False)
class Variable:
    """One variable of a file."""

    dimensions: tuple[str, ...]
    values: np.ndarray | str
    """Text is a single value, without dimensions."""
    attributes: Mapping[str, Any]
    may_miss: bool = False
    """NaN stands for missing numbers: `_FillValue`."""
    storage: Mapping[str, Any] = field(default_factory=dict)
    """Chunks, compression and checksums, as h5py names them."""


def write_netcdf(path: Path | str, variables: Mapping[str, Variable], attributes: Mapping[str, Any]) -> Path:
    """Write a file that netCDF4, xarray and h5py read alike. Sizes of dimensions are those of the values.

    It is made in memory, compressed as it will lie on the disk: the HDF5 library ends the whole process when the disk
    is full, and locks files in ways of its own.
    """
    import h5netcdf
    import h5py

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as opened:
        opened.attrs.update(attributes)
        for variable in variables.values():
            for name, size in zip(variable.dimensions, np.shape(variable.values), strict=True):
                if name not in opened.dimensions:
                    opened.dimensions[name] = size
        for name, variable in variables.items():
            if isinstance(variable.values, str):
                made = opened.create_variable(
                    name, (), dtype=h5py.string_dtype(), data=np.array(variable.values, object)
                )
            else:
                fill = np.nan if variable.may_miss else None
                made = opened.create_variable(
                    name, variable.dimensions, data=variable.values, fillvalue=fill, **variable.storage
                )
            made.attrs.update(variable.attributes)
    return write_bytes(path, content.getbuffer())
