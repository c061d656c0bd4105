"""Telemetry as NetCDF-4: CF attributes, a checksum on every chunk, and a SHA-256 over all arrays and attributes.

Written through h5netcdf. Read with h5py alone, after looking at what the file holds: link class, type,
size and storage of each variable are checked before a value is read, because an HDF5 file can point at other
files, claim any size, or be damaged in ways that a higher reader follows silently.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import escaped
from fluxtwin.sim.base.limits import MAX_COLUMNS, MAX_SAMPLES, require_expansion, require_kind, require_rows
from fluxtwin.sim.base.netcdf_out import TRUTH_TITLE, Variable, write_netcdf
from fluxtwin.sim.base.seals import FORMAT, require_format
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth.epoch import parse_time
from fluxtwin.sim.telemetry.columns import PROVENANCE, FileTable, clip, describe, file_columns, resolve
from fluxtwin.sim.telemetry.quantities import DRIVERS, MAG
from fluxtwin.sim.telemetry.record import Telemetry

TIME_UNITS = "nanoseconds since 1970-01-01"
_TIME = {
    "standard_name": "time",
    "long_name": "UTC; leap seconds are not counted",
    "units": TIME_UNITS,
    "calendar": "proleptic_gregorian",
}
_SHA = "fluxtwin_sha256"
_FORMAT = "fluxtwin_format"
_CHUNK = 65_536
_UNIT_NS = {
    word: nanoseconds
    for words, nanoseconds in (
        ("nanosecond ns", 1),
        ("microsecond us", 10**3),
        ("millisecond ms", 10**6),
        ("second sec s", 10**9),
        ("minute min", 60 * 10**9),
        ("hour h", 3600 * 10**9),
        ("day d", 86400 * 10**9),
    )
    for word in words.split()
}
_SINCE = re.compile(r"\s*([A-Za-z]+)\s+since\s+(\S.*?)\s*")
_NOT_SIGNED = {_SHA, "_NCProperties"}
_DIMENSION_ATTRIBUTES = {"DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME", "_Netcdf4Dimid", "_Netcdf4Coordinates"}


class NetcdfFile:
    """An opened NetCDF-4 file, looked at before it is read. Use as a context manager; errors are BadInput."""

    def __init__(self, path: Path | str, *, max_samples: int = MAX_SAMPLES) -> None:
        self.where = str(path)
        self.path = Path(path)
        self.max_samples = max_samples
        self._claimed: dict[str, int] = {}
        self._verified: dict[str, np.ndarray] = {}  # read for the digest, handed on once

    def __enter__(self) -> NetcdfFile:
        import h5py

        self.bytes = _size(self.path, self.where)
        with self._reading("is not a NetCDF-4 file, or is damaged"):
            self._file = h5py.File(self.path, "r")
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(Exception):
            self._file.close()

    @cached_property
    def sha256(self) -> str:
        """Digest of the file, which is read through for it."""
        try:
            with open(self.path, "rb") as opened:
                return hashlib.file_digest(opened, "sha256").hexdigest()
        except OSError as error:
            raise BadInput(f"cannot be read ({error.strerror or error})", where=self.where) from None

    def names(self) -> list[str]:
        """Variables of the root group. Raises BadInput for links that leave the file."""
        import h5py

        names, group = [], self._file.id
        with self._reading("its list of variables cannot be read"):
            for name, key in zip(self._file, group, strict=True):
                if group.links.get_info(key).type != h5py.h5l.TYPE_HARD:
                    raise BadInput(
                        f"{clip(name)} is a link to another place ({type(self._file.get(name, getlink=True)).__name__})",
                        where=self.where,
                        wanted="a file that holds its own data",
                    )
                if h5py.h5o.get_info(group, key).type == h5py.h5o.TYPE_DATASET:
                    names.append(str(name))
                if len(names) > MAX_COLUMNS:
                    raise BadInput(f"has more than {MAX_COLUMNS} variables", where=self.where)
        return names

    def shape(self, name: str) -> tuple[int, ...]:
        with self._reading(f"{clip(name)} cannot be read"):
            return tuple(int(n) for n in self._file[name].shape or ())

    def attributes(self, name: str | None = None) -> dict[str, Any]:
        """Attributes of a variable, or of the file: text as str, arrays of one number as that number."""
        with self._reading("an attribute cannot be read"):
            node = self._file if name is None else self._file[name]
            return {str(key): _plain(node.attrs[key]) for key in node.attrs if key not in _DIMENSION_ATTRIBUTES}

    def described(self, name: str) -> str:
        """Name, shape and unit for a message: `B_raw (32536, 3) [count]`."""
        unit = self.attributes(name).get("units")
        size = f" {self.shape(name)}" if len(self.shape(name)) != 1 else ""
        return f"{name}{size}" + (f" [{unit}]" if isinstance(unit, str) else "")

    def raw(self, name: str) -> np.ndarray:
        """The stored array of a variable, after its storage, type and size are found harmless."""
        if name in self._verified:
            return self._verified.pop(name)
        with self._reading(f"{clip(name)} cannot be read"):
            data = self._file[name]
            wanted = "plain numeric variables stored in the file itself"
            if data.external or data.is_virtual:
                raise BadInput(f"{clip(name)} is stored in another file", where=self.where, wanted=wanted)
            if data.dtype.kind not in "iuf" or data.dtype.itemsize > 8:
                raise BadInput(f"{clip(name)} has the type {data.dtype}", where=self.where, wanted=wanted)
            require_rows(int(data.shape[0]) if data.shape else 0, self.max_samples, self.where, f"{clip(name)} claims")
            chunk = math.prod(data.chunks) if data.chunks else 0
            self._claimed[name] = max(math.prod(data.shape), chunk) * 8  # read as float64
            require_expansion(sum(self._claimed.values()), self.bytes, self.where)
            return np.asarray(data[()])

    def numbers(self, name: str) -> FloatArray:
        """A variable as float64: CF fill values are NaN, scale_factor and add_offset are applied."""
        raw, attributes = self.raw(name), self.attributes(name)
        value = np.asarray(raw, dtype=np.float64)
        for key in ("_FillValue", "missing_value"):
            fill = attributes.get(key)
            if isinstance(fill, (int, float)) and fill == fill:
                value = np.where(raw == fill, np.nan, value)
        scale, offset = attributes.get("scale_factor", 1.0), attributes.get("add_offset", 0.0)
        if not (isinstance(scale, (int, float)) and isinstance(offset, (int, float))):
            raise BadInput(f"scale_factor or add_offset of {clip(name)} is no number", where=self.where)
        if scale != 1.0 or offset != 0.0:
            value = value * float(scale) + float(offset)
        if np.isinf(value).any():
            raise BadInput(f"{clip(name)} has infinite values", where=self.where, wanted="finite numbers or NaN")
        return value

    def times(self, name: str = "time") -> TimeArray:
        """A time variable as datetime64[ns], from its CF `units` ("seconds since 1970-01-01"); NaN is NaT."""
        raw, attributes = self.raw(name), self.attributes(name)
        match = _SINCE.fullmatch(str(attributes.get("units", "")))
        if match is None or (match[1].lower().removesuffix("s") not in _UNIT_NS and match[1] not in _UNIT_NS):
            raise BadInput(
                f"the unit of {clip(name)} is {clip(attributes.get('units', 'missing'))!r}",
                where=self.where,
                wanted="as 'seconds since 1970-01-01' (CF conventions), UTC",
            )
        calendar = str(attributes.get("calendar", "standard"))
        if calendar not in ("standard", "gregorian", "proleptic_gregorian"):
            raise BadInput(f"the calendar of {clip(name)} is {clip(calendar)!r}", where=self.where, wanted="standard")
        word = match[1] if match[1] in _UNIT_NS else match[1].lower().removesuffix("s")
        origin = parse_time(_origin(match[2]), where=f"{self.where}: units of {clip(name)}")
        return _counted(raw, _UNIT_NS[word], origin, self.where)

    def verify(self, names: list[str]) -> bool:
        """True when the file carries our digest and it fits; False when it has none. Raises BadInput otherwise."""
        attributes = self.attributes()
        stated = attributes.get(_SHA)
        if not isinstance(stated, str):
            return False
        require_format(attributes.get(_FORMAT, FORMAT), self.where)
        arrays = {name: (self.raw(name), self.attributes(name)) for name in names}
        if stated != _digest(arrays, attributes):
            raise BadInput(
                "its content does not agree with the SHA-256 stored in it: damaged, or changed by another program",
                where=self.where,
                wanted=f"the file as it was written (or remove the attribute {_SHA} if the change was meant)",
            )
        self._verified = {name: value for name, (value, _) in arrays.items()}
        return True

    @contextlib.contextmanager
    def _reading(self, what: str) -> Iterator[None]:
        """Say what cannot be read: damaged files raise OSError, RuntimeError, KeyError and ValueError alike."""
        try:
            yield
        except BadInput:
            raise
        except Exception as error:
            reason = clip(str(error).split("\n")[0], 100) or type(error).__name__
            raise BadInput(f"{what} ({reason})", where=self.where) from None


def read_table(path: Path | str, *, max_samples: int = MAX_SAMPLES, others: Sequence[str] = ()) -> FileTable:
    """The contract columns of a NetCDF file, and `others` where it has them. BadInput names the file and the fault."""
    with NetcdfFile(path, max_samples=max_samples) as opened:
        names, attributes = opened.names(), opened.attributes()
        if str(attributes.get("title")) == TRUTH_TITLE:
            raise BadInput("is the truth of a simulation", where=opened.where, wanted="its telemetry (simulate --out)")
        if "time" not in names:
            listed = ", ".join(clip(name) for name in names[:12])
            raise BadInput(
                f"variable time is missing; the variables are: {listed or 'none'}",
                where=opened.where,
                wanted="time, or a column map (--map; `fluxtwin map` drafts one)",
            )
        found = resolve(names, opened.where, {name: opened.described(name) for name in names})
        sealed = opened.verify(names)
        columns = {name: opened.numbers(name) for name in found.used}
        beside = {name: opened.numbers(name) for name in others if name in names and name not in columns}
        time = opened.times()
        for name, value in [("time", time), *columns.items(), *beside.items()]:
            if value.shape != (len(time),) or time.ndim != 1:
                raise BadInput(
                    f"{name} has the shape {value.shape}, time has {time.shape}", where=opened.where, wanted="(time,)"
                )
        stated = {name: opened.attributes(name).get("units") for name in found.named[DRIVERS.field].values()}
        units = {name: unit for name, unit in stated.items() if isinstance(unit, str) and unit != "1"}
        notices = list(found.notices)
        if not sealed:
            notices.append("the file carries no digest, so damage would not be noticed")
        return FileTable(opened.where, time, columns, notices, _provenance(opened, attributes), units, beside)


def write(telemetry: Telemetry, path: Path | str) -> Path:
    """Write the record as NetCDF-4 atomically. Numbers and stamps read back bit-equal."""
    columns = file_columns(telemetry)
    storage = {"compression": "gzip", "compression_opts": 4, "shuffle": True, "fletcher32": True}
    storage |= {"chunks": (min(len(telemetry), _CHUNK),)}
    stamps = telemetry.time.astype("int64")
    variables = {"time": Variable(("time",), stamps, _TIME, storage=storage)}
    for name, value in columns.items():
        long_name, units = describe(name)
        units = telemetry.driver_units.get(DRIVERS.name_in(name) or "", units)
        if telemetry.corrected_by and name in MAG.written:
            long_name = f"magnetic field, nominal body axes, corrected by {telemetry.corrected_by}, {name[4]} component"
        variables[name] = Variable(("time",), value, {"long_name": long_name, "units": units}, True, storage)
    attributes: dict[str, Any] = {"Conventions": "CF-1.11", "title": "spacecraft magnetometer and attitude telemetry"}
    attributes[_FORMAT] = FORMAT
    for key, text in sorted(telemetry.provenance.items()):
        attributes[f"{PROVENANCE}{key}"] = escaped(str(text)).replace("\0", "\\x00")  # HDF5 has no such character
    arrays: dict[str, Any] = {"time": (stamps, _TIME)}
    for name, value in columns.items():
        arrays[name] = (value, {**variables[name].attributes, "_FillValue": np.nan})
    attributes[_SHA] = _digest(arrays, attributes)
    return write_netcdf(path, variables, attributes)


def is_own(path: Path | str) -> bool:
    """Whether fluxtwin wrote a NetCDF file: telemetry by its digest, which an edited file breaks; a truth by its title."""
    try:
        with NetcdfFile(path) as opened:
            title = opened.attributes().get("title")
            return (isinstance(title, str) and title == TRUTH_TITLE) or opened.verify(opened.names())
    except BadInput:
        return False


def _provenance(opened: NetcdfFile, attributes: dict[str, Any]) -> dict[str, str]:
    """What the file says of its origin, then which file this was; the file's own source becomes `origin`."""
    stated = {k[len(PROVENANCE) :]: str(v) for k, v in attributes.items() if k.startswith(PROVENANCE)}
    stated.pop("notices", None)
    stated.pop("sha256", None)
    origin = stated.pop("source", None)
    if origin is not None and "origin" not in stated:
        stated["origin"] = origin
    return {**stated, "source": opened.path.name, "sha256": opened.sha256}


def _digest(arrays: dict[str, tuple[np.ndarray, dict[str, Any]]], attributes: dict[str, Any]) -> str:
    """SHA-256 over names, types, shapes, bytes and attributes; NaN counts by its bits."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        value, own = arrays[name]
        total.update(f"{name}|{value.dtype.str}|{value.shape}|".encode())
        total.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
        total.update(repr(sorted((k, _canonical(v)) for k, v in own.items())).encode())
    signed = sorted((k, _canonical(v)) for k, v in attributes.items() if k not in _NOT_SIGNED)
    total.update(repr(signed).encode())
    return total.hexdigest()


def _canonical(value: Any) -> str:
    return repr(float(value)) if isinstance(value, (int, float)) else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return value


def _counted(raw: np.ndarray, unit_ns: int, origin: np.datetime64, where: str) -> TimeArray:
    """Stamps from counts; whole numbers exactly, others rounded to 1 ns."""
    if raw.dtype.kind in "iu":
        if raw.size and np.abs(raw.astype(np.float64)).max() * unit_ns > 9.0e18:
            raise BadInput("a time stamp is beyond the years 1678 to 2262", where=where)
        return origin + (raw.astype("int64") * unit_ns).astype("timedelta64[ns]")
    good = np.isfinite(raw) & (np.abs(raw) * float(unit_ns) < 9.0e18)
    value = np.where(good, raw, 0.0).astype(np.float64)
    whole = np.floor(value)
    rest = np.rint((value - whole) * unit_ns).astype("int64")
    stamps: TimeArray = origin + (whole.astype("int64") * unit_ns + rest).astype("timedelta64[ns]")
    stamps[~good] = np.datetime64("NaT", "ns")
    return stamps


def _origin(text: str) -> str:
    """`1970-01-01 00:00:00.0 UTC` and its short forms as ISO."""
    return re.sub(r"\s*(UTC|Z|\+?00:?00)$", "", text.strip()) if not text.strip().endswith(":00") else text.strip()


def _size(path: Path, where: str) -> int:
    """Bytes of a file that can be opened and read."""
    try:
        found = path.stat()
        require_kind(found, where, "a telemetry file (.csv, .csv.gz or .nc)", pipe=False)
        if found.st_size == 0:
            raise BadInput("the file is empty", where=where, wanted="a NetCDF-4 file")
        with open(path, "rb"):
            return found.st_size
    except FileNotFoundError:
        raise BadInput("there is no such file", where=where) from None
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", where=where) from None
