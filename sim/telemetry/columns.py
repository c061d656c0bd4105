"""The columns of a telemetry file: which quantity each one is, and the refusals where that is not plain.

A file column is `stem_unit`, as `mag_x_nT`; dimensionless columns have no unit. `resolve` turns the names found
in a file into the quantities of the record, or says in one message what is missing, doubled or without a unit.
`file_columns` is the way back. Nothing here guesses: a column without its unit is refused, a column the contract
does not name is left out and said so.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from fluxtwin.sim.base.errors import BadInput, nearest
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.telemetry.quantities import (
    ANGLES,
    FAMILIES,
    MAG,
    POSITION,
    POSITION_E,
    QUANTITIES,
    QUATERNION,
    Quantity,
    family_of,
)
from fluxtwin.sim.telemetry.record import Origin, Telemetry, plain_text

TORQUER = r"mtq|torquer|mag_?(rod|torq)"
"""What names of torquers contain, in small letters."""
WHEEL = re.compile(r"wheel_([1-9][0-9]?)_speed_rpm")
_WHEEL_NO_UNIT = re.compile(r"wheel_[1-9][0-9]?_speed(_rad_s|_rps|_Hz)?", re.IGNORECASE)
_UNIT_LIKE = re.compile(
    "nt|mg|ut|t|g|mt|pt|m?gauss|(nano|micro)?tesla|counts?|raw|lsb|adu|km|m|met(re|er)s?|km_s|m_s|kms|ms|[mu]?a"
    "|k|c|f|degc|celsius|kelvin|deg|rad|(degree|radian)s?|deg_s|rad_s|dps|am2|a_m2|mam2|polecm"
)
"""What may be meant for a unit at the end of a name."""

PROVENANCE = "provenance_"
"""How the attributes begin that hold a record's provenance."""
TEXTS = {"spacecraft": "spacecraft", "mag_corrected_by": "calibration", "mag2_corrected_by": "calibration_2"}
"""Columns of a CSV that hold one text in every row, and what the provenance calls it. NetCDF has attributes for them.

A column, not a comment line: it stays in the file when another program sorts, cuts or joins it, and every reader of CSV
takes it.
"""
TRUTHS = {"true": 1.0, "false": 0.0}
"""Words, in any case, of a column that holds nothing else."""


@dataclass
class FileTable:
    """What a file holds, before it is a record: rows may still be in any order and values missing (NaN)."""

    where: str
    """The file, for messages."""
    time: TimeArray
    """(N,) UTC."""
    columns: MutableMapping[str, FloatArray]
    """Contract columns by file name, each (N,), in the file's own units."""
    notices: list[str] = field(default_factory=list)
    provenance: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    """Units of columns whose names do not say them, by file name."""
    others: MutableMapping[str, FloatArray] = field(default_factory=dict)
    """Columns that no record has, each (N,), where a condition on rows asks for them."""
    origin: Origin = field(default_factory=Origin)
    """What a column map made these columns from."""


@dataclass(frozen=True)
class Resolution:
    """Which columns of a file carry which quantity."""

    found: dict[str, tuple[tuple[str, ...], str]]
    """Quantity name: (file columns, unit suffix)."""
    named: dict[str, dict[str, str]]
    """By field of the record, the columns that the user has named: {"flags": {NAME: "flag_NAME"}, ...}."""
    wheels: tuple[str, ...]
    unknown: tuple[str, ...]

    @property
    def used(self) -> tuple[str, ...]:
        plain = [column for columns, _ in self.found.values() for column in columns]
        return (*plain, *(column for columns in self.named.values() for column in columns.values()), *self.wheels)

    @property
    def notices(self) -> list[str]:
        """A sentence on the columns left out, if any, and one on torquers among them."""
        if not self.unknown:
            return []
        more = f" and {len(self.unknown) - 8} more" if len(self.unknown) > 8 else ""
        shown = ", ".join(clip(name) or "one without a name" for name in self.unknown[:8])
        how = "a column map reads them, or call one driver_NAME to test its field"
        said = [f"columns of other names were left out ({how}): {shown}{more}"]
        torquers = [clip(name) for name in self.unknown if re.search(TORQUER, name.lower())]
        if torquers and "dipole_B_Am2" not in self.found:
            said.append(
                f"{', '.join(torquers[:3])} look like torquers, whose field follows their dipole (dipole_x_Am2 ...): a "
                "column map makes it of currents or duty cycles, as dipole with scale = Am2 per unit"
            )
        return said


def resolve(names: Iterable[str], where: str, described: Mapping[str, str] | None = None) -> Resolution:
    """Match file column names (without `time`) to the contract.

    described: what to show for a name in the message that lists the file's columns.

    Raises BadInput for a quantity with a component missing, given in two units, or named without a unit; and when
    the magnetometer is absent.
    """
    return _resolved(tuple(name for name in names if name != "time"), where, tuple((described or {}).items()))


@lru_cache(maxsize=16)
def _resolved(present: tuple[str, ...], where: str, described: tuple[tuple[str, str], ...]) -> Resolution:
    """A stream has the same columns again and again; nobody changes what was found."""
    known = set(present)
    found: dict[str, tuple[tuple[str, ...], str]] = {}
    for quantity in QUANTITIES:
        unit = _unit_of(quantity, known, where)
        if unit is not None:
            found[quantity.name] = (quantity.columns(unit), unit)
    for one, other in ((POSITION, POSITION_E), (QUATERNION, ANGLES)):
        if one.name in found and other.name in found:
            raise BadInput(
                f"both {', '.join(one.written)} and {', '.join(other.written)} are given",
                where=where,
                wanted="one of the two",
            )
    named = {family.field: {n: name for name in present if (n := family.name_in(name))} for family in FAMILIES}
    wheels = tuple(sorted((n for n in present if WHEEL.fullmatch(n)), key=_wheel_number))
    bare = sorted(name for name in known if _WHEEL_NO_UNIT.fullmatch(name))
    if bare:
        raise BadInput(f"column {bare[0]} has no unit in its name", where=where, wanted="wheel_N_speed_rpm")
    if MAG.name not in found:
        raise _missing_magnetometer(list(present), where, dict(described))
    taken = Resolution(found, named, wheels, ())
    return replace(taken, unknown=tuple(name for name in present if name not in set(taken.used)))


def file_columns(telemetry: Telemetry) -> dict[str, FloatArray]:
    """The record as contract columns in the units that are written (angular rates in deg/s), which are the record's own
    arrays where the unit is the same. Without `time`."""
    columns: dict[str, FloatArray] = {}
    for quantity in QUANTITIES:
        value = getattr(telemetry, quantity.name, None)
        if value is None:
            continue
        factor = next(iter(quantity.units.values()))
        parts = np.asarray(value).reshape(len(telemetry), -1).T
        for name, part in zip(quantity.written, parts, strict=True):
            columns[name] = part if factor == 1.0 else part / factor
    for family in FAMILIES:
        named = getattr(telemetry, family.field)
        columns |= {family.prefix + name: np.asarray(named[name]) for name in sorted(named)}
    if telemetry.wheel_speed_rpm is not None:
        for number, speed in enumerate(telemetry.wheel_speed_rpm.T, start=1):
            columns[f"wheel_{number}_speed_rpm"] = speed
    return columns


def file_texts(telemetry: Telemetry) -> dict[str, str]:
    """The text columns of a CSV: free of what would need quotes, as short as the reader takes them."""
    stated = {column: telemetry.provenance.get(key, "") for column, key in TEXTS.items()}
    return {column: plain_text(text) for column, text in stated.items() if text}


def texts_in(columns: Mapping[str, Iterable[bytes]], where: str) -> dict[str, str]:
    """What the text columns of a file say, by key of the provenance. Raises BadInput where rows differ."""
    stated = {}
    for column, cells in columns.items():
        texts = sorted({cell.decode("utf-8", "ignore").strip() for cell in cells})
        if len(texts) > 1:
            listed = " and ".join(repr(clip(text)) if text else "nothing" for text in texts[:2])
            wanted = "one spacecraft, and all readings corrected by one calibration or none, in one file"
            raise BadInput(f"{column} says {listed} in different rows", where=where, wanted=wanted)
        stated[TEXTS[column]] = "".join(texts)
    return stated


def truths_in(text: np.ndarray) -> FloatArray | None:
    """A column of text, bytes (N,), that holds nothing but true, false and blanks, as 1, 0 and NaN; None for any other."""
    known = TRUTHS | {"": np.nan, "nan": np.nan}
    words = [bytes(cell).decode("utf-8", "replace").strip().lower() for cell in text.tolist()]
    fits = known.keys() >= set(words) and not TRUTHS.keys().isdisjoint(words)
    return np.array([known[word] for word in words]) if fits else None


def describe(column: str) -> tuple[str, str]:
    """(long_name, CF units) of a written column."""
    family = family_of(column)
    if family is not None:
        return f"{family.name_in(column)}: {family.about}", "1"
    if WHEEL.fullmatch(column):
        return f"speed of wheel {_wheel_number(column)}", "rpm"
    quantity = next(one for one in QUANTITIES if column in one.written)
    axis = f", {column.split('_')[1]} component" if len(quantity.stems) > 1 and "_" in column else ""
    return quantity.long_name + axis, quantity.cf_units


def _unit_of(quantity: Quantity, known: set[str], where: str) -> str | None:
    """The unit suffix in which all components are there; None when the quantity is absent."""
    complete = [unit for unit in quantity.units if known.issuperset(quantity.columns(unit))]
    if len(complete) > 1:
        raise BadInput(
            f"{quantity.stems[0]} is given in two units: {', '.join(complete)}", where=where, wanted="one of them"
        )
    if complete:
        return complete[0]
    partial = {unit: [c for c in quantity.columns(unit) if c in known] for unit in quantity.units}
    some = {unit: columns for unit, columns in partial.items() if columns}
    if len(some) > 1:
        names = ", ".join(c for columns in some.values() for c in columns)
        raise BadInput(f"components in different units: {names}", where=where, wanted="one unit for all of them")
    for unit, columns in some.items():
        lacking = [c for c in quantity.columns(unit) if c not in known]
        raise BadInput(
            f"column {lacking[0]} is missing (found {', '.join(columns)})",
            where=where,
            wanted=", ".join(quantity.columns(unit)),
        )
    _refuse_missing_unit(quantity, known, where)
    return None


def _refuse_missing_unit(quantity: Quantity, known: set[str], where: str) -> None:
    if "" in quantity.units:
        return
    for stem in quantity.stems:
        for name in sorted(known):
            bare = name == stem
            foreign = name.startswith(f"{stem}_") and _UNIT_LIKE.fullmatch(name[len(stem) + 1 :].lower())
            if bare or foreign:
                what = "has no unit in its name" if bare else "has a unit that is not accepted"
                accepted = " or ".join(f"{stem}_{unit}" for unit in quantity.units)
                raise BadInput(f"column {name} {what}", where=where, wanted=f"{accepted}, or a column map (--map)")


def _wheel_number(name: str) -> int:
    match = WHEEL.fullmatch(name)
    return int(match[1]) if match else 0


def _missing_magnetometer(present: list[str], where: str, described: Mapping[str, str]) -> BadInput:
    listed = ", ".join(clip(described.get(n, n)) for n in present[:12]) + (" ..." if len(present) > 12 else "")
    hint = nearest("mag_x_nT", map(clip, present), " (nearest: {})", cutoff=0.6)
    return BadInput(
        f"column mag_x_nT is missing{hint}; the columns are: {listed or 'none'}",
        where=where,
        wanted="mag_x_nT, mag_y_nT, mag_z_nT (or _mG, _uT, _T), or a column map (--map; `fluxtwin map` drafts one)",
    )


def clip(text: object, length: int = 60) -> str:
    """Foreign text for a message: printable, at most `length` characters."""
    plain = "".join(c if c.isprintable() else "?" for c in str(text))
    return plain if len(plain) <= length else plain[: length - 3] + "..."
