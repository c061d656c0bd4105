"""Sources at their own rates, brought onto the magnetometer's stamps.

Attitude: slerp. Position: cubic Hermite where the source has velocity, else a cubic spline. Rates, currents,
temperature, wheel speeds: linear. Flags, dipole, sensor head: the last value holds. Drivers: as the map says. Beyond
`max_gap_s` of the source the value is missing. Magnetometers are never interpolated: a second one counts where the
stamps agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from fluxtwin.sim.base.errors import BadInput, amount
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import frames, references
from fluxtwin.sim.telemetry import companions
from fluxtwin.sim.telemetry.build import velocity_from_positions
from fluxtwin.sim.telemetry.column_map import ColumnMap, ColumnSpec, FileEntry, matches
from fluxtwin.sim.telemetry.column_map_read import Source, read_source, require_increasing
from fluxtwin.sim.telemetry.columns import FileTable
from fluxtwin.sim.telemetry.formats.table import Table
from fluxtwin.sim.telemetry.quantities import BY_MAP_NAME, DRIVERS, MAG2, POSITION, VELOCITY, family_of
from fluxtwin.sim.telemetry.record import Origin

if TYPE_CHECKING:
    from fluxtwin.sim.earth.tle import TleSeries

_ROUNDED_S = 1e-6  # by which seconds as floating-point numbers, and stamps from another time scale, may be off
_LARGEST_TURN_RAD = np.pi / 2.0
"""A turn beyond this between two attitude samples is not interpolated: the way it went is not known."""


def merged_table(
    path: Path | Table, column_map: ColumnMap, *, tle: Path | str | None, max_samples: int, any_order: bool = False
) -> FileTable:
    """All sources of the map as one table of contract columns on the magnetometer's stamps.

    Without a magnetometer the first source gives the stamps. any_order: see `column_map.mapped_table`.
    """
    there = [one for one in column_map.file if isinstance(path, Table) or not one.optional or matches(path, one)]
    sources = [read_source(path, entry, max_samples) for entry in there]
    master = next((source for source in sources if "mag" in source.values), sources[0])
    if not any_order or len(sources) > 1 or "attitude" in master.values:
        require_increasing(master)
    time = master.time
    notices = [text for source in sources for text in source.notices]
    columns: dict[str, FloatArray] = {}
    attitude: tuple[ColumnSpec, Rotation, BoolArray] | None = None
    for source in sources:
        if source is not master:
            require_increasing(source)
        for name in source.values:
            if name == "attitude":
                attitude = (source.entry.columns[name], *_slerped(source, time, notices))
            elif name != "velocity" or "position" not in source.values:
                _put(columns, name, _resampled(source, name, time, source is master))
        if {"position", "velocity"} <= source.values.keys():
            rows = _known(source.values["position"], source.values["velocity"])
            moved = source.values["velocity"] if source is master else _along_orbit(source, rows, time, 1)
            _put(columns, "velocity", moved)
    r, v, stated, elements = _orbit(columns, time, tle, notices)
    if attitude is not None and attitude[0].reference in references.OF_POSITION and stated:
        stated |= {companions.ATTITUDE_OF_ORBIT: str(attitude[0].reference)}
    if attitude is not None:
        q = _absolute(attitude, time, r, v, master.where, notices)
        columns.update(zip(("q_x", "q_y", "q_z", "q_w"), q.T, strict=True))
    digests = "+".join(digest for source in sources for digest in source.digests)
    units: dict[str, str] = {}
    for source in sources:
        drivers = {name: spec for name, spec in source.entry.columns.items() if family_of(name) is DRIVERS}
        units |= {name: spec.unit for name, spec in drivers.items() if spec.unit}
        guessed = [name for name, spec in drivers.items() if spec.between is None and source is not master]
        if guessed:
            notices.append(f'linear between its samples: {", ".join(guessed)} (between = "hold" holds the last value)')
    where = path.where if isinstance(path, Table) else str(path)
    provenance = {"source": Path(where).name, "sha256": digests, **stated}
    specs = {name: source.entry.columns[name] for source in sources for name in source.values}
    read = [] if isinstance(path, Table) else [file for entry in there for file in matches(path, entry)]
    origin = replace(_origin(specs, elements), paths=tuple(str(one) for one in (*read, tle) if one is not None))
    return FileTable(where, time, columns, notices, provenance, units, origin=origin)


def _origin(specs: Mapping[str, ColumnSpec], elements: TleSeries | None) -> Origin:
    """What the map made of what is stored, from what it says of each quantity that there is.

    elements: those that gave the positions.
    """
    mag, position, attitude = specs.get("mag"), specs.get("position"), specs.get("attitude")
    stored: dict[str, Any] = {"elements": elements}
    if position is not None:
        stored["position"] = "ITRS" if position.axes == "ITRS" else "GCRS"
    if attitude is not None:
        local = "orbital" if attitude.reference in ("orbital", "sun_nadir", "nadir_sun") else "GCRS"
        stored["attitude"] = attitude.reference if attitude.reference in ("ITRS", "NEC", "NED") else local
        stored |= {"scalar_first": attitude.order == "wxyz", "conjugated": attitude.sense == "conjugate"}
    if mag is not None:
        known = not isinstance(mag.scale, list) and not np.any(mag.offset)
        unit_nT = BY_MAP_NAME["mag"].map_units.get(mag.unit or "", 1.0)
        stored["count_nT"] = float(np.asarray(mag.scale)) * unit_nT if known else None
        stored |= {} if mag.matrix is None else {"matrix": tuple(map(tuple, mag.matrix))}
    return Origin(**stored)


def attitude_at(
    table: Table,
    entry: Mapping[str, object],
    time: TimeArray,
    r_N_km: FloatArray | None,
    v_N_km_s: FloatArray | None,
    notices: list[str],
) -> FloatArray:
    """Quaternions q_NB (N, 4) at the stamps from a table of its own, read as `entry`, a [[file]] with `attitude`, says."""
    source = read_source(table, FileEntry.model_validate(entry), len(table.columns["time"]))
    require_increasing(source)
    stored, known = _slerped(source, time, notices)
    notices.extend(source.notices)
    return _absolute((source.entry.columns["attitude"], stored, known), time, r_N_km, v_N_km_s, table.where, notices)


def orbit_at(table: Table, entry: Mapping[str, object], time: TimeArray) -> tuple[FloatArray, FloatArray, list[str]]:
    """Positions and velocities, GCRS, each (N, 3), at the stamps from a table of its own; likewise."""
    source = read_source(table, FileEntry.model_validate(entry), len(table.columns["time"]))
    require_increasing(source)
    rows = _known(source.values["position"], source.values["velocity"])
    return _along_orbit(source, rows, time, 0), _along_orbit(source, rows, time, 1), source.notices


def _put(columns: dict[str, FloatArray], name: str, value: FloatArray) -> None:
    if name == "wheel_speed":
        names = tuple(f"wheel_{k}_speed_rpm" for k in range(1, value.shape[1] + 1))
    else:
        names = BY_MAP_NAME[name].plain if name in BY_MAP_NAME else (name,)
    columns.update(zip(names, value.T, strict=True))


def _seconds(time: TimeArray, origin: np.datetime64) -> FloatArray:
    return (time - origin).astype("int64") * 1e-9


def _brackets(have: FloatArray, want: FloatArray, max_gap_s: float) -> tuple[np.ndarray, BoolArray]:
    """Index of the sample at or before each wanted instant, and whether the pair around it is close enough."""
    place = np.clip(np.searchsorted(have, want, side="right") - 1, 0, max(have.size - 2, 0))
    after = np.minimum(place + 1, have.size - 1)
    inside = (want >= have[place]) & (want <= have[after]) & (have[after] - have[place] <= max_gap_s + _ROUNDED_S)
    return place, inside | (want == have[place]) | (want == have[after])


def _resampled(source: Source, name: str, time: TimeArray, same: bool) -> FloatArray:
    value = source.values[name]
    if same:
        return value
    rows = _known(value)
    if name == "position":
        return _along_orbit(source, rows, time, 0)
    out = np.full((time.size, value.shape[1]), np.nan)
    if rows.size == 0:
        return out
    origin = time[0]
    have, want = _seconds(source.time[rows], origin), _seconds(time, origin)
    gap = 0.0 if name == MAG2.mapped else source.entry.max_gap_s
    if _held(source, name):
        place = np.searchsorted(have, want, side="right") - 1
        fresh = (place >= 0) & (want - have[np.maximum(place, 0)] <= gap)
        out[fresh] = value[rows][place[fresh]]
        return out
    place, inside = _brackets(have, want, gap)
    for axis in range(value.shape[1]):
        out[inside, axis] = np.interp(want[inside], have, value[rows, axis])
    if name in ("sun", "nadir"):
        out /= np.linalg.norm(out, axis=1, keepdims=True)
    return out


def _held(source: Source, name: str) -> bool:
    """Whether the last value of a quantity holds until the next one."""
    family = family_of(name)
    if family is None:
        return BY_MAP_NAME[name].held
    return family.binary or source.entry.columns[name].between == "hold"


def _known(*values: FloatArray) -> np.ndarray:
    """Numbers of the rows in which all of these (N, k) are finite."""
    return np.flatnonzero(np.isfinite(np.hstack(values)).all(axis=1))


def _along_orbit(source: Source, rows: np.ndarray, time: TimeArray, order: int) -> FloatArray:
    """(N, 3) positions (order 0) or velocities (1) between the samples in these rows, piece by piece between gaps."""
    out = np.full((time.size, 3), np.nan)
    if rows.size == 0:
        return out
    gap, origin = source.entry.max_gap_s, time[0]
    have, want = _seconds(source.time[rows], origin), _seconds(time, origin)
    r, v = source.values["position"][rows], source.values.get("velocity")
    v = None if v is None or not np.isfinite(v[rows]).all() else v[rows]
    near = _brackets(have, want, gap)[1]
    for piece in np.split(np.arange(have.size), np.flatnonzero(np.diff(have) > gap + _ROUNDED_S) + 1):
        at = have[piece]
        inside = near & (want >= at[0]) & (want <= at[-1])
        if piece.size >= (2 if v is not None else 4) and inside.any():
            curve = CubicSpline(at, r[piece]) if v is None else CubicHermiteSpline(at, r[piece], v[piece])
            out[inside] = curve(want[inside], order)
        elif inside.any() and order == 0:
            exact = np.searchsorted(at, want[inside])
            hit = at[np.minimum(exact, piece.size - 1)] == want[inside]
            out[np.flatnonzero(inside)[hit]] = r[piece][exact[hit]]
    return out


def _slerped(source: Source, time: TimeArray, notices: list[str]) -> tuple[Rotation, BoolArray]:
    """The attitude at the wanted stamps as scipy rotations of the stored quaternion, and where it is known."""
    q = source.values["attitude"]
    rows = _known(q)
    out = Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1)))
    known: BoolArray = np.zeros(time.size, dtype=bool)
    if rows.size == 0:
        return out, known
    have, want = _seconds(source.time[rows], time[0]), _seconds(time, time[0])
    have_R = Rotation.from_quat(q[rows])
    place, known = _brackets(have, want, source.entry.max_gap_s)
    if rows.size > 1:
        turn = np.atleast_1d((have_R[1:] * have_R[:-1].inv()).magnitude())
        exact = (want == have[place]) | (want == have[np.minimum(place + 1, have.size - 1)])
        wild = known & ~exact & (turn[np.minimum(place, turn.size - 1)] > _LARGEST_TURN_RAD)
        known &= ~wild
        if wild.any():
            notices.append(
                f"attitude turns more than 90 deg between samples; {amount(int(wild.sum()), 'row has|rows have')} none"
            )
        out = Slerp(have, have_R)(np.clip(want, have[0], have[-1]))
    elif known.any():
        out = Rotation.from_quat(np.tile(q[rows[0]], (time.size, 1)))
    lost = int((~known).sum())
    if lost:
        notices.append(f"{lost} of {time.size} rows have no attitude within {source.entry.max_gap_s:g} s")
    return out, known


def _orbit(
    columns: dict[str, FloatArray], time: TimeArray, tle: Path | str | None, notices: list[str]
) -> tuple[FloatArray | None, FloatArray | None, dict[str, str], TleSeries | None]:
    stated: dict[str, str] = {}
    elements: TleSeries | None = None
    if "r_x_km" not in columns and tle is not None:
        r, v, said, stated, elements = companions.positions(tle, time)
        _put(columns, "position", r)
        _put(columns, "velocity", v)
        notices.extend(said)
    elif tle is not None:
        notices.append(companions.not_used(tle, "the files have positions, so the elements in {} were not used"))
    position, velocity = (
        np.stack([columns[c] for c in quantity.plain], axis=1) if quantity.plain[0] in columns else None
        for quantity in (POSITION, VELOCITY)
    )
    return position, velocity, stated, elements


def _absolute(
    attitude: tuple[ColumnSpec, Rotation, BoolArray],
    time: TimeArray,
    r: FloatArray | None,
    v: FloatArray | None,
    where: str,
    notices: list[str],
) -> FloatArray:
    """Quaternions q_NB (N, 4) from the attitude relative to the map's reference; NaN where unknown."""
    spec, stored, known = attitude
    q = np.full((time.size, 4), np.nan)
    if spec.reference in references.OF_POSITION:
        if r is None:
            what = {"orbital": "the orbital frame", "NEC": "north, east, centre"}.get(spec.reference, spec.reference)
            raise BadInput(f"an attitude relative to {what} needs positions", where=where, wanted="a TLE")
        known = known & np.isfinite(r).all(axis=1)
    if spec.reference == "orbital" and r is not None:
        if v is None:
            v = velocity_from_positions(time, r)
            notices.append("the orbital frame of the attitude was found by differentiating the positions")
        known = known & np.isfinite(np.hstack([r, v])).all(axis=1)
    rows = np.flatnonzero(known)
    if rows.size == 0:
        return q
    R_BX = stored[rows].inv()
    at = (None if one is None else one[rows] for one in (r, v))
    R_XN = references.rotation_XN(str(spec.reference), time[rows], *at)
    q[rows] = frames.q_from_rotation(R_BX * R_XN)
    return q
