"""Tables of pandas and xarray as they are, and records as theirs; Parquet through pandas and pyarrow (optional:
fluxtwin[parquet])."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import write_bytes
from fluxtwin.sim.base.limits import MAX_SAMPLES, require_expansion, require_rows
from fluxtwin.sim.telemetry.columns import PROVENANCE, clip, describe, file_columns, file_texts
from fluxtwin.sim.telemetry.csv_files import require_no_units
from fluxtwin.sim.telemetry.formats.table import Table, content_of, extra, in_ns
from fluxtwin.sim.telemetry.quantities import RECORDED

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.record import Telemetry

_CF_UNITS = {"degree s-1": "deg_s", "km s-1": "km_s", "degree": "deg", "A m2": "Am2", "degree_Celsius": "degC"}


def _pandas() -> Any:
    return extra("pandas", "pandas", "a DataFrame")


def of_file(path: Path, what: str, ending: str, unpack: Callable[[bytes], Any]) -> Table:
    """The columns of a file whose bytes `unpack` makes a DataFrame of. Raises BadInput where it cannot, as it says or in
    general words: the packages for such files raise whatever they meet."""
    content, digest = content_of(path)
    try:
        frame = unpack(content)
    except BadInput:
        raise
    except Exception as error:
        raise BadInput(f"cannot be read as {what} ({type(error).__name__})", where=str(path), wanted=ending) from None
    table = of_pandas(frame, str(path))
    table.sha256 = digest
    return table


def read_parquet(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """The columns of a Parquet file."""
    pyarrow = extra("pyarrow.parquet", "parquet", path)
    pd = extra("pandas", "parquet", path)

    def unpack(content: bytes) -> Any:
        about = pyarrow.read_metadata(io.BytesIO(content))
        require_rows(about.num_rows, max_samples, str(path))
        require_expansion(8 * about.num_rows * about.num_columns, len(content), str(path))
        return pd.read_parquet(io.BytesIO(content), engine="pyarrow", page_checksum_verification=True)

    return of_file(path, "Parquet", ".parquet", unpack)


def write_parquet(telemetry: Telemetry, path: Path | str) -> Path:
    """The record; numbers and stamps read back bit-equal."""
    extra("pyarrow", "parquet", path)
    frame = to_pandas(telemetry)
    frame = frame.reset_index().assign(**file_texts(telemetry))
    return write_bytes(path, frame.to_parquet(None, engine="pyarrow", index=False, write_page_checksum=True))


def of_pandas(frame: Any, where: str = "DataFrame") -> Table:
    """The columns of a DataFrame; a DatetimeIndex is `time`, units are in `frame.attrs["units"]` or a column's attrs.

    Stamps with a zone are taken to UTC. Raises BadInput for columns of other things than numbers, stamps and text.
    """
    pd = _pandas()
    columns: dict[str, np.ndarray] = {}
    units = dict(frame.attrs.get("units", {}))
    if frame.columns.nlevels > 1:
        found = f"its columns have {frame.columns.nlevels} levels of names"
        raise BadInput(found, where=where, wanted="one, with units in the names, as mag_x_nT")
    if not frame.columns.is_unique:
        twice = frame.columns[frame.columns.duplicated()][0]
        raise BadInput(f"column {clip(twice)} is there twice", where=where, wanted="every name once")
    timed = frame.get("time")
    usual = isinstance(frame.index, pd.DatetimeIndex)
    if timed is None and not usual and "time" in frame.index.names:  # stamps of any type, and one level of several
        frame = frame.reset_index("time")  # older pandas copies the frame here
        timed = frame["time"]
    if usual and timed is None:
        timed = frame.index.to_series()
        columns["time"] = _stamps(timed, "time", where)
    for name in frame.columns:
        series = frame[name]
        if isinstance(series.attrs.get("units"), str):  # a frame's own attributes are also those of its columns
            units[name] = series.attrs["units"]
        columns[str(name)] = _column(series, str(name), where)
    first, second = ([_cell(value[row : row + 1]) for value in columns.values()] for row in (0, 1))
    require_no_units(first, second, where)
    stamped = timed is not None and pd.api.types.is_datetime64_any_dtype(timed.dtype)
    notices = ["column time has no zone: taken as UTC"] if stamped and timed.dt.tz is None else []
    return Table(where, columns, {str(k): str(v) for k, v in units.items()}, _stated(frame.attrs), notices)


def of_xarray(dataset: Any, where: str = "Dataset") -> Table:
    """The variables of a Dataset along its dimension of time, which may be called Timestamp, with their units.

    Raises BadInput for a Dataset without stamps.
    """
    zoned = {name: index for name, index in dataset.indexes.items() if getattr(index, "tz", None) is not None}
    # xarray keeps stamps with a zone as objects, or as an extension type whose values are bare counts
    dataset = dataset.assign_coords({name: index.tz_convert("UTC").tz_localize(None) for name, index in zoned.items()})
    coordinates = {str(name): dataset[name] for name in dataset.variables}
    stamps = [name for name, one in coordinates.items() if one.dtype.kind == "M" and one.ndim == 1]
    if not stamps:
        raise BadInput("no variable holds stamps", where=where, wanted="a Dataset with time along a dimension")
    name = "time" if "time" in stamps else stamps[0]
    along = coordinates[name].dims[0]
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for key, one in coordinates.items():
        if one.dims[:1] != (along,) or one.ndim > 2 or one.dtype.kind not in "iufbM":
            continue
        value = np.asarray(one.values)
        columns["time" if key == name else key] = in_ns(value, key, where) if value.dtype.kind == "M" else value
        unit = str(one.attrs.get("units", ""))
        if unit:
            units[key] = _CF_UNITS.get(unit, unit)
    return Table(where, columns, units, _stated(dataset.attrs))


def to_pandas(telemetry: Telemetry) -> Any:
    """A DataFrame with the record's columns, units in their names, time [UTC] as its index; provenance in `attrs`."""
    pd = _pandas()
    index = pd.DatetimeIndex(telemetry.time, name="time").tz_localize("UTC")
    frame = pd.DataFrame(dict(file_columns(telemetry)), index=index, copy=False)
    frame.attrs.update(_attributes(telemetry))
    return frame


def to_xarray(telemetry: Telemetry) -> Any:
    """A Dataset with the record's own arrays (no copies), units and long names; provenance in its attributes."""
    xr = extra("xarray", "xarray", "a Dataset")
    variables: dict[str, Any] = {}
    for quantity in RECORDED:
        value = getattr(telemetry, quantity.name)
        if value is None:
            continue
        dims = ("time",) if value.ndim == 1 else ("time", f"{quantity.name.split('_')[0]}_axis")
        unit = next(unit for unit, factor in quantity.units.items() if factor == 1.0)
        attributes = {"long_name": quantity.long_name, "units": unit.replace("_", "/") or "1"}
        variables[quantity.name] = (dims, value, attributes)
    for column, value in file_columns(telemetry).items():
        if column.startswith(("flag_", "driver_")):
            long_name, unit = describe(column)
            unit = telemetry.driver_units.get(column.removeprefix("driver_"), unit)
            variables[column] = ("time", value, {"long_name": long_name, "units": unit})
    return xr.Dataset(variables, coords={"time": telemetry.time}, attrs=_attributes(telemetry))


def _attributes(telemetry: Telemetry) -> dict[str, str]:
    return {f"{PROVENANCE}{key}": text for key, text in telemetry.provenance.items()}


def _stated(attributes: Mapping[Any, Any]) -> dict[str, str]:
    """Provenance of a table: what fluxtwin wrote, and the name of the spacecraft. In the attributes of others `calibration`
    may mean anything, and is no proof that the readings are corrected."""
    texts = {str(key): value for key, value in attributes.items() if isinstance(value, str)}
    ours = {key.removeprefix(PROVENANCE): value for key, value in texts.items() if key.startswith(PROVENANCE)}
    return ({"spacecraft": texts["spacecraft"]} if "spacecraft" in texts else {}) | ours


def _cell(value: np.ndarray) -> str:
    """The one cell of a column, or none, as a CSV has it; 0 stands for any number or stamp, and what is missing is blank."""
    if value.dtype.kind == "S":
        return b"".join(value.tolist()).decode("utf-8").strip()
    missing = np.isnat(value) if value.dtype.kind == "M" else np.isnan(value)
    return "" if missing.all() else "0"


def _column(series: Any, name: str, where: str) -> np.ndarray:
    pd = _pandas()
    if pd.api.types.is_datetime64_any_dtype(series.dtype):
        return _stamps(series, name, where)
    if pd.api.types.is_numeric_dtype(series.dtype) or pd.api.types.is_bool_dtype(series.dtype):
        return np.asarray(series.to_numpy(dtype=np.float64, na_value=np.nan))
    values = series.to_numpy()
    if len(values) and all(isinstance(cell, list | tuple | np.ndarray) for cell in values):
        try:
            return np.array([np.asarray(cell, dtype=np.float64) for cell in values])
        except ValueError:
            raise BadInput(f"{name} holds lists of different lengths", where=where, wanted="one vector a row") from None
    return np.array(
        [b"" if pd.isna(cell) else str(cell).encode("utf-8", "replace") for cell in values], dtype=np.bytes_
    )


def _stamps(series: Any, name: str, where: str) -> np.ndarray:
    pd = _pandas()
    return in_ns(pd.to_datetime(series, utc=True).dt.tz_localize(None).to_numpy(), name, where)
