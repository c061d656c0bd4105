"""The telemetry record: what the ground gets, whether it flew or was simulated.

One frozen record of time-first float64 arrays. Simulated and recorded data pass the same constructor, so
that nobody downstream can tell which it was. Missing values are NaN; a column that is absent is None.
What each column is says `quantities`; `csv_files`, `netcdf_files` and `column_map` read and write them.

A file is read as its columns or its map say. Whoever asks whether that was right must know what was done: `Origin`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from fluxtwin.sim.earth.tle import TleSeries

import dataclasses
import itertools
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import fields
from datetime import date
from functools import partial
from types import MappingProxyType
from typing import Any, TypeGuard

import numpy as np

from fluxtwin.sim.base.errors import BadInput, amount
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.telemetry.quantities import DRIVERS, FAMILIES, RECORDED


@dataclass(frozen=True)
class Origin:
    """What a record's GCRS positions and attitude were made from with the help of its stamps.

    A wrong stamp turns the Earth under a GCRS position; it leaves an Earth-fixed position in place, but turns what is
    computed from it; and it moves a position that two-line elements gave along the orbit.
    """

    position: Literal["GCRS", "ITRS"] = "GCRS"
    attitude: Literal["GCRS", "ITRS", "NEC", "NED", "orbital"] = "GCRS"
    """What it was recorded relative to; for the stamps sun and nadir are as good as the orbital frame."""
    scalar_first: bool = False
    """The map took the quaternion's first component for the scalar."""
    elements: TleSeries | None = None
    conjugated: bool = False
    """The map took the stored quaternion for the conjugate."""
    matrix: Sequence[Sequence[float]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """(3, 3) by which the map turned the stored readings."""
    count_nT: float | None = 1.0
    """Reading [nT] for a stored number of 1; None where it is not one factor for all axes."""
    paths: tuple[str, ...] = field(default=(), compare=False)
    """Of the files that were read, which are not written over."""


_SHAPES = {quantity.name: quantity.components for quantity in RECORDED}

TEXT_BYTES = 80
"""Width of a text cell in a CSV at most: a fixed width spares a Python object a cell."""
_LARGEST = 1e15  # of any unit in the columns: beyond it a cell is corrupt, and squares overflow


_OTHER = {"calibration": "calibration_2", "calibration_note": "calibration_note_2"}
_OTHER |= {other: key for key, other in _OTHER.items()}
_OF_MAGNETOMETER = tuple(_OTHER)
_CORRECTED = ("calibration", "calibration_2")
"""What the provenance says of the readings of one magnetometer."""


@dataclass(frozen=True)
class Telemetry(Shown):
    """One record; N rows. Arrays are read-only float64, `time` is datetime64[ns] UTC, strictly increasing."""

    time: TimeArray
    """(N,) UTC."""
    mag_B_nT: FloatArray
    """(N, 3) magnetometer reading in nominal body axes, as the preflight calibration gives it."""
    r_N_km: FloatArray | None = None
    """(N, 3) position, GCRS."""
    v_N_km_s: FloatArray | None = None
    """(N, 3) velocity, GCRS."""
    q_NB: FloatArray | None = None
    """(N, 4) reference attitude: textbook quaternion of B relative to N, scalar last; NaN where unknown."""
    dipole_B_Am2: FloatArray | None = None
    """(N, 3) torquer dipole."""
    sunlit: FloatArray | None = None
    """(N,) 1 in sunlight, 0 in shadow."""
    heater_on: FloatArray | None = None
    """(N,) 0 or 1."""
    flags: Mapping[str, FloatArray] = field(default_factory=dict)
    """`flag_NAME` columns by NAME, each (N,) of 0 or 1."""
    drivers: Mapping[str, FloatArray] = field(default_factory=dict)
    """`driver_NAME` columns by NAME, each (N,): a current, a duty, on or off, whatever a field may follow."""
    driver_units: Mapping[str, str] = field(default_factory=dict)
    """Units of drivers by NAME, as the user spells them, where given."""
    array_current_A: FloatArray | None = None
    """(N,) current of the solar array."""
    battery_current_A: FloatArray | None = None
    """(N,) positive when charging."""
    temperature_degC: FloatArray | None = None
    """(N,) temperature of the magnetometer."""
    wheel_speed_rpm: FloatArray | None = None
    """(N, W), one column per wheel."""
    sun_sensor_head: FloatArray | None = None
    """(N,) number of the head that gave the reference attitude; 0 none."""
    sun_B: FloatArray | None = None
    """(N, 3) measured unit vector to the sun."""
    nadir_B: FloatArray | None = None
    """(N, 3) measured unit vector to nadir."""
    rate_B_rad_s: FloatArray | None = None
    """(N, 3) body rate relative to N from the gyro."""
    mag2_B_nT: FloatArray | None = None
    """(N, 3) reading of a second magnetometer, in nominal body axes; see `with_magnetometer`."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Where the record comes from: source file and SHA-256, or the generator, and notes about columns; never the truth.

    `spacecraft` is the name of the spacecraft. `calibration` names the calibration that has corrected the readings, if any,
    and `calibration_2` that of the second magnetometer. `magnetometer` is 2 where the second has
    taken the place of the first.
    """
    origin: Origin = field(default_factory=Origin)
    """What positions, attitude and readings were made from on reading; a file that is written does not keep it."""

    def __post_init__(self) -> None:
        if np.asarray(self.time).dtype.kind in "biufc":  # numpy would count them in nanoseconds
            raise BadInput("holds numbers, no stamps", where="time", wanted="UTC stamps, as datetime64")
        time = np.array(self.time, dtype="datetime64[ns]").reshape(-1)
        rows = time.size
        _check_time(time)
        time.setflags(write=False)
        object.__setattr__(self, "time", time)
        for name, width in _SHAPES.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _frozen_array(name, value, rows, width))
        for family in FAMILIES:
            named = getattr(self, family.field).items()
            arrays = {name: _frozen_array(family.prefix + name, value, rows, 0) for name, value in named}
            object.__setattr__(self, family.field, MappingProxyType(arrays))
        units = {name: unit for name, unit in self.driver_units.items() if name in self.drivers and unit}
        object.__setattr__(self, "driver_units", MappingProxyType(units))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    def __len__(self) -> int:
        return int(self.time.size)

    def __reduce__(self) -> tuple[Any, ...]:
        """For a process elsewhere: mappings that cannot be changed cannot be sent either."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        plain: dict[str, Any] = {
            key: dict(value) if isinstance(value, Mapping) else value for key, value in values.items()
        }
        return partial(Telemetry, **plain), ()

    @property
    def spacecraft(self) -> str:
        """Name of the spacecraft; empty where the file does not say."""
        return self.provenance.get("spacecraft", "")

    @property
    def corrected_by(self) -> str:
        """The calibration that has corrected the readings, in words; empty for readings as the sensor gave them."""
        return self.provenance.get("calibration", "")

    @property
    def magnetometer(self) -> int:
        """Number of the magnetometer whose readings `mag_B_nT` are: 1, or 2 after `with_magnetometer(2)`."""
        return 2 if self.provenance.get("magnetometer") == "2" else 1

    def with_magnetometer(self, number: int) -> Telemetry:
        """The record with the readings of magnetometer 1 or 2 as `mag_B_nT`, and those of the other as `mag2_B_nT`.

        Raises BadInput where there is no such magnetometer.
        """
        if number == self.magnetometer:
            return self
        if number not in (1, 2) or self.mag2_B_nT is None:
            there = "one magnetometer" if self.mag2_B_nT is None else "two magnetometers"
            wanted = "mag2_x_nT mag2_y_nT mag2_z_nT, or mag2 in a column map" if number == 2 else "magnetometer 1 or 2"
            where = self.provenance.get("source", "telemetry")
            raise BadInput(f"has {there}, number {number} was asked for", where=where, wanted=wanted)
        swapped = {key: self.provenance.get(key, "") for key in _OF_MAGNETOMETER}
        swapped = {_OTHER[key]: text for key, text in swapped.items()} | {"magnetometer": "2" if number == 2 else ""}
        kept = {key: text for key, text in self.provenance.items() if key not in swapped}
        provenance = kept | {key: text for key, text in swapped.items() if text}
        return self.replace(mag_B_nT=self.mag2_B_nT, mag2_B_nT=self.mag_B_nT, provenance=provenance)

    @property
    def has_attitude(self) -> BoolArray:
        """(N,) True where the reference attitude is known."""
        return self._known(self.q_NB)

    @property
    def has_reading(self) -> BoolArray:
        """(N,) True where all three magnetometer components are finite."""
        return self._known(self.mag_B_nT)

    @property
    def has_position(self) -> BoolArray:
        """(N,) True where the position is known."""
        return self._known(self.r_N_km)

    def _known(self, value: FloatArray | None) -> BoolArray:
        known = np.zeros(len(self)) if value is None else np.isfinite(value).all(axis=1)
        return np.asarray(known, dtype=bool)

    @classmethod
    def from_pandas(cls, frame: Any) -> Telemetry:
        """The record of a DataFrame with the columns of a file, units in their names or attributes. Raises BadInput.

        A record cannot change, so it shares only arrays that nobody can write to, as those of `to_pandas`; whatever may
        still be written to is copied once, and so are stamps, and components that do not lie side by side in memory.
        """
        from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

        return read_telemetry(frame)

    @classmethod
    def from_xarray(cls, dataset: Any) -> Telemetry:
        """The record of a Dataset, copied and shared likewise; vectors may be variables of three components."""
        from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

        return read_telemetry(dataset)

    def to_pandas(self) -> Any:
        """A DataFrame with the columns that a file would have, units in their names, time as index.

        They are the record's own arrays, not copied and read-only, except angular rates, which are converted to degrees.
        """
        from fluxtwin.sim.telemetry.formats.frame import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> Any:
        """A Dataset with the record's own arrays, not copied and read-only, with units and long names."""
        from fluxtwin.sim.telemetry.formats.frame import to_xarray

        return to_xarray(self)

    def between(
        self, start: np.datetime64 | date | str | None = None, end: np.datetime64 | date | str | None = None
    ) -> Telemetry:
        """The rows from `start` (included) to `end` (not included), UTC unless a datetime has a zone.

        Raises BadInput where none is left.
        """
        from fluxtwin.sim.telemetry.selection import selected

        return selected(self, start, end)

    def where(self, condition: str) -> Telemetry:
        """The rows in which the condition on columns holds, as `sunlit == 1`. Raises BadInput where none is left."""
        from fluxtwin.sim.telemetry.selection import selected

        return selected(self, where=condition)

    def __getitem__(self, rows: Any) -> Telemetry:
        """`select`, or `between` for a slice of times: `record[record.sunlit == 1]`, `record["2026-03-01":"2026-03-02"]`."""
        ends = (rows.start, rows.stop) if isinstance(rows, slice) else ()
        if any(isinstance(one, str | date | np.datetime64) for one in ends):
            return self.between(*ends)
        try:
            return self.select(rows if isinstance(rows, slice) else np.atleast_1d(rows))
        except BadInput:
            raise
        except (IndexError, TypeError, ValueError) as error:
            wanted = "a mask, indices or times as record['2026-03-01':'2026-03-02']; columns are in record.to_pandas()"
            raise BadInput(f"{reprlib.repr(rows)} chooses no rows ({error})", where="record", wanted=wanted) from None

    __iter__ = None  # rows are no records

    def select(self, rows: BoolArray | slice | np.ndarray) -> Telemetry:
        """The record cut to `rows` (a mask, a slice or increasing indices)."""
        changes: dict[str, object] = {"time": self.time[rows]}
        for name in _SHAPES:
            value = getattr(self, name)
            changes[name] = None if value is None else value[rows]
        changes |= named_columns(self, lambda value: value[rows])
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def replace(self, **changes: object) -> Telemetry:
        """A copy with some fields changed; every check of the constructor runs again."""
        other: dict[str, Any] = {"position": "GCRS", "elements": None} if "r_N_km" in changes else {}
        other |= {"attitude": "GCRS", "scalar_first": False, "conjugated": False} if "q_NB" in changes else {}
        changes.setdefault("origin", dataclasses.replace(self.origin, **other))
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]


def named_columns(telemetry: Telemetry, change: Callable[[FloatArray], FloatArray]) -> dict[str, object]:
    """The fields of the record whose columns have names of the user's, each array (N,) changed."""
    return {
        family.field: {name: change(value) for name, value in getattr(telemetry, family.field).items()}
        for family in FAMILIES
    }


def recorded_columns(telemetry: Telemetry) -> dict[str, FloatArray]:
    """Everything recorded beside time, orbit, attitude and readings, by name; as `flag_NAME`, `driver_NAME` too."""
    names = [name for name in _SHAPES if name not in ("r_N_km", "v_N_km_s", "mag_B_nT", "mag2_B_nT", "q_NB")]
    columns = {name: np.array(value) for name in names if (value := getattr(telemetry, name)) is not None}
    for family in FAMILIES:
        columns |= {family.prefix + name: np.array(value) for name, value in getattr(telemetry, family.field).items()}
    return columns


def plain_text(text: str) -> str:
    """`text` as written in a CSV cell: no comma, quote or control character, no formula of a spreadsheet, at most 80 bytes
    of UTF-8."""
    kept = "".join({",": ";", '"': "'"}.get(c, c if c.isprintable() else " ") for c in text).strip()
    kept = f"'{kept}" if kept.startswith(("=", "+", "-", "@")) else kept
    return kept.encode("utf-8")[:TEXT_BYTES].decode("utf-8", "ignore").strip()


def concatenate(records: list[Telemetry]) -> Telemetry:
    """Several records, one after the other in time, as one.

    A column is kept if any record has it; the others get NaN there. Raises BadInput for an empty list, records that
    overlap in time, records of two spacecraft or two magnetometers, and corrected readings beside uncorrected ones.
    """
    if not records:
        raise BadInput(
            "there is no record to join", where="telemetry", wanted="a record, a file, or a list with one at least"
        )
    ordered = sorted(records, key=lambda record: record.time[0])
    _check_one_origin(ordered)
    for one, other in itertools.pairwise(ordered):
        if other.time[0] <= one.time[-1]:
            raise BadInput(
                f"two records overlap in time: one ends at {one.time[-1]}, another begins at {other.time[0]}",
                where=other.provenance.get("source", "telemetry"),
                wanted="records that follow each other, each given once",
            )
    columns: dict[str, object] = {"time": np.concatenate([r.time for r in ordered])}
    for name in _SHAPES:
        parts = [getattr(r, name) for r in ordered]
        known = [p for p in parts if p is not None]
        if known:
            shape = known[0].shape[1:]
            filled = [
                np.full((len(r), *shape), np.nan) if p is None else p for p, r in zip(parts, ordered, strict=True)
            ]
            columns[name] = np.concatenate(filled)
    for family in FAMILIES:
        named = [(getattr(r, family.field), np.full(len(r), np.nan)) for r in ordered]
        names = sorted({name for values, _ in named for name in values})
        columns[family.field] = {n: np.concatenate([of.get(n, absent) for of, absent in named]) for n in names}
    columns["driver_units"] = _same_units(ordered)
    origin = ordered[0].origin if all(r.origin == ordered[0].origin for r in ordered) else Origin()
    paths = dict.fromkeys(path for r in ordered for path in r.origin.paths)
    columns["origin"] = dataclasses.replace(origin, paths=tuple(paths))
    sources = "; ".join(dict.fromkeys(r.provenance.get("source", "") for r in ordered))
    columns["provenance"] = {**ordered[0].provenance, **_same_origin(ordered), "source": sources}
    return Telemetry(**columns)  # type: ignore[arg-type]


def _same_origin(records: list[Telemetry]) -> dict[str, str]:
    """Spacecraft and calibration of all records, where any record states them."""
    spacecraft = next((r.spacecraft for r in records if r.spacecraft), "")
    stated = {"spacecraft": spacecraft}
    for key in _CORRECTED:
        stated[key] = "; ".join(dict.fromkeys(filter(None, (r.provenance.get(key, "") for r in records))))
    return {key: text for key, text in stated.items() if text}


def _same_units(records: list[Telemetry]) -> dict[str, str]:
    """Units of the drivers of all records. Raises BadInput where two differ."""
    units: dict[str, str] = {}
    for record in records:
        for name, unit in record.driver_units.items():
            if units.setdefault(name, unit) != unit:
                raise BadInput(
                    f"is in {units[name]} in one record, in {unit} in another",
                    where=DRIVERS.prefix + name,
                    wanted="one unit",
                )
    return units


def _check_one_origin(records: list[Telemetry]) -> None:
    names = sorted({plain_text(r.spacecraft) for r in records if r.spacecraft})
    if len(names) > 1:
        raise BadInput(
            f"the records are of different spacecraft: {', '.join(names)}", where="telemetry", wanted="one spacecraft"
        )
    if len({r.magnetometer for r in records}) > 1:
        raise BadInput(
            "the readings are of magnetometer 1 in one record, of 2 in another", where="telemetry", wanted="one of them"
        )
    for key in _CORRECTED:
        corrected = [r for r in records if r.provenance.get(key)]
        if corrected and len(corrected) < len(records):
            raise BadInput(
                f"the readings of one record are corrected ({corrected[0].provenance[key]}), those of another are not",
                where=corrected[0].provenance.get("source", "telemetry"),
                wanted="all of them corrected, or none",
            )


def _check_time(time: TimeArray) -> None:
    if time.size == 0:
        raise BadInput("the record has no rows", where="time", wanted="at least one row")
    if np.isnat(time).any():
        row = int(np.flatnonzero(np.isnat(time))[0])
        raise BadInput(f"the time is missing in row {row + 1}", where="time", wanted="a UTC stamp in every row")
    backwards = np.flatnonzero(np.diff(time.astype("int64")) <= 0)
    if backwards.size:
        row = int(backwards[0])
        raise BadInput(
            f"time does not increase: row {row + 1} is {time[row]}, row {row + 2} is {time[row + 1]}"
            f" ({amount(backwards.size, 'such step|such steps')})",
            where="time",
            wanted="strictly increasing UTC; `fluxtwin check FILE --repair OUT` sorts and drops exact duplicates, as "
            'sort_values("time").drop_duplicates() in pandas',
        )


def is_frozen(value: object) -> TypeGuard[FloatArray]:
    """Whether it is an array of numbers that nobody can change, so that records may share it."""
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or not value.flags.c_contiguous:
        return False
    base: object = value
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return False
        base = base.base
    return base is None


def _frozen_array(name: str, value: object, rows: int, width: int) -> FloatArray:
    array = value if is_frozen(value) else np.array(value, dtype=np.float64)
    if width == -1 and array.ndim == 1:
        array = array.reshape(rows, -1)
    wanted = (rows,) if width == 0 else (rows, array.shape[-1] if width == -1 else width)
    if array.shape != wanted:
        raise BadInput(f"has shape {array.shape}", where=name, wanted=f"shape {wanted}")
    most = max(np.fmax.reduce(array, axis=None, initial=0.0), -np.fmin.reduce(array, axis=None, initial=0.0))
    if np.isinf(most):
        row = int(np.flatnonzero(np.isinf(array).reshape(rows, -1).any(axis=1))[0])
        raise BadInput(f"the value in row {row + 1} is infinite", where=name, wanted="finite numbers or blank")
    if most > _LARGEST:
        row = int(np.flatnonzero((np.abs(array) > _LARGEST).reshape(rows, -1).any(axis=1))[0])
        worst = float(np.nanmax(np.abs(array[row])))
        raise BadInput(f"{worst:.3g} in row {row + 1} is no measurement", where=name, wanted="a blank cell")
    array.setflags(write=False)
    return array
