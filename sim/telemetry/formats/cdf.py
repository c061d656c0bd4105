"""NASA's Common Data Format, through cdflib (optional: fluxtwin[cdf]): Swarm's MAGx_LR, ELFIN and their like.

CDF_EPOCH and CDF_EPOCH16 are calendar time (no leap seconds), CDF_TIME_TT2000 counts them; FILLVAL is missing.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES, require_expansion, require_rows
from fluxtwin.sim.telemetry.formats.table import Table, content_of, extra

_EPOCHS = ("CDF_EPOCH", "CDF_EPOCH16", "CDF_TIME_TT2000")


def read(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """All variables with one row a record. The first of CDF's own time types is also `time`."""
    cdflib = extra("cdflib", "cdf", path)
    content, digest = content_of(path)
    try:
        opened = cdflib.CDF(str(path))
        info = opened.cdf_info()
        names = [*info.rVariables, *info.zVariables]
        table = Table(str(path), {}, sha256=digest)
        claimed = 0
        for name in names:
            about = opened.varinq(name)
            if about.Rec_Vary and about.Last_Rec >= 0 and "CHAR" not in about.Data_Type_Description:
                rows = require_rows(about.Last_Rec + 1, max_samples, str(path))
                claimed += 8 * rows * math.prod(about.Dim_Sizes)
                require_expansion(claimed, len(content), str(path))
                _take(opened, cdflib, name, table)
    except BadInput:
        raise
    except Exception as error:  # a damaged CDF raises whatever the parser meets
        raise BadInput(
            f"cannot be read as CDF ({type(error).__name__}: {error})", where=str(path), wanted=".cdf"
        ) from None
    stamps = [name for name, value in table.columns.items() if value.dtype.kind == "M"]
    if stamps and "time" not in table.columns:
        table.columns = {"time": table.columns[stamps[0]], **table.columns}
    return table


def _take(opened: Any, cdflib: Any, name: str, table: Table) -> None:
    kind = opened.varinq(name).Data_Type_Description
    raw = np.asarray(opened.varget(name))
    attributes = opened.varattsget(name)
    if kind in _EPOCHS:
        known = np.ones(len(raw), dtype=bool)
        if raw.ndim == 1 and raw.dtype.kind == "f":
            known = np.isfinite(raw) & (raw > 0)
        elif raw.ndim == 1:
            known = raw > np.iinfo(np.int64).min + 1
        out = np.full(len(raw), np.datetime64("NaT", "ns"))
        if known.any():
            out[known] = np.asarray(cdflib.cdfepoch.to_datetime(raw[known])).astype("datetime64[ns]")
        table.columns[name] = out
        return
    if raw.ndim not in (1, 2) or raw.dtype.kind not in "iuf":
        return
    value = raw.astype(np.float64)
    fill = attributes.get("FILLVAL")
    if isinstance(fill, int | float | np.number) and fill == fill:
        value[raw == np.asarray(fill).astype(raw.dtype)] = np.nan
    table.columns[name] = value
    unit = attributes.get("UNITS", attributes.get("units"))
    if isinstance(unit, str) and unit.strip():
        table.units[name] = unit.strip()
