"""Is this file what it says? The classic traps of foreign telemetry, named with their evidence; and a plain repair.

One cause, one name: stuck values and positions that contradict themselves are looked for first, then unit, position,
attitude and clock against the field model, then outliers; what follows from a trap is not named beside it. Thresholds
stand beside their reasons in the modules of this folder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np

from fluxtwin.calib.checks.copies import check_clipped, check_copied
from fluxtwin.calib.checks.field import check_field
from fluxtwin.calib.checks.outliers import check_outliers
from fluxtwin.calib.checks.report import CheckReport, Finding, note, report, trap
from fluxtwin.calib.checks.sample import comparable
from fluxtwin.calib.checks.stuck import check_held, check_stuck, check_stuck_attitude
from fluxtwin.calib.checks.unit import check_calibrated
from fluxtwin.calib.checks.values import check_motion, check_readings
from fluxtwin.calib.common.records import Onboard
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.build import record
from fluxtwin.sim.telemetry.column_map import mapped_table, recognised
from fluxtwin.sim.telemetry.columns import FileTable
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.selection import Selection, selection
from fluxtwin.sim.telemetry.telemetry_files import read_table, write_telemetry

ORBIT_SPREAD = 0.15
"""Relative spread of |r| up to an eccentricity of 0.2."""
RECOGNISED = "recognised_layout"
"""Code of the note that a packaged column map was used."""
POSITION_TRAPS = {"position_frame", "position_inside_earth"}
"""With these nothing else can be compared with the field model."""
_VAGUE = {"field_mismatch", "vector_mismatch", "outliers"}
"""Traps that name no cause."""
_REPAIR = "`fluxtwin check FILE --repair OUT`"
"""What sorts rows and drops exact duplicates."""
_QUIET_ROWS = 100
"""As many as the comparison with the field takes at once: with fewer it says little."""
__all__ = ["RECOGNISED", "CheckReport", "Finding", "check_file", "check_telemetry", "repair"]


def check_columns(table: FileTable) -> list[Finding]:
    """The trap `shifted_columns`: the numbers make sense only under the names one place further."""
    names = list(table.columns)
    if not all(_sense(table, names, 0).values()):
        for shift in (1, -1):
            moved = _sense(table, names, shift)
            if all(moved.values()) and (len(moved) >= 2 or "q_x" in moved):  # four columns of norm 1 are no chance
                first, second = (names[0], names[1]) if shift > 0 else (names[1], names[0])
                return [trap("shifted_columns", first=first, second=second)]
    return []


def _sense(table: FileTable, names: list[str], shift: int) -> dict[str, bool]:
    """For each quantity that is there, by its first column: whether the numbers `shift` places further can be it."""
    out = {}
    for stems, possible in _POSSIBLE:
        if not set(stems) <= set(names):
            continue
        places = [names.index(stem) + shift for stem in stems]
        if min(places) >= 0 and max(places) < len(names):
            with np.errstate(over="ignore", invalid="ignore"):
                values = np.stack([table.columns[names[place]] for place in places], axis=1)
                size = np.linalg.norm(values[np.isfinite(values).all(axis=1)], axis=1)
                out[stems[0]] = bool(size.size) and possible(size)
    return out


def _orbit(size: FloatArray) -> bool:
    """In km or m."""
    typical = float(np.median(size))
    return typical > 6_400.0 and float(np.std(size)) < ORBIT_SPREAD * typical


def _speed(size: FloatArray) -> bool:
    return 0.5 < float(np.median(size)) < 12_000.0 and float(np.std(size)) < 0.5 * float(np.median(size))


def _unit(size: FloatArray) -> bool:
    return float(np.median(np.abs(size - 1.0))) < 1e-3


_POSSIBLE: tuple[tuple[tuple[str, ...], Callable[[FloatArray], bool]], ...] = (
    (("r_x_km", "r_y_km", "r_z_km"), _orbit),
    (("ecef_x_km", "ecef_y_km", "ecef_z_km"), _orbit),
    (("v_x_km_s", "v_y_km_s", "v_z_km_s"), _speed),
    (("q_x", "q_y", "q_z", "q_w"), _unit),
    (("sun_x", "sun_y", "sun_z"), _unit),
)


def check_telemetry(telemetry: Telemetry, model: FieldModel, *, onboard: Onboard | None = None) -> CheckReport:
    """Every check that the record's columns allow. Traps first in the report.

    onboard: what is said to have been applied to the readings on board.
    """
    held, telemetry = check_held(telemetry)
    clipped, beyond = check_clipped(telemetry)
    copied, again = check_copied(telemetry)
    named, others = beyond | again, telemetry
    if named.any():  # what stands still in them has its name
        blanked = np.where(named[:, None], np.nan, telemetry.mag_B_nT)
        others = telemetry.replace(mag_B_nT=blanked)
    stuck, faulty = check_stuck(others)
    motion, away = check_motion(telemetry)
    faulty = faulty | away | named
    findings = [*clipped, *copied, *stuck, *motion, *check_readings(telemetry)]
    if held:
        findings = [*held, *(finding for finding in findings if not finding.code.startswith("missing_"))]
    lost = any(finding.severity == "trap" and finding.code in POSITION_TRAPS for finding in motion)
    if not lost and (telemetry.has_reading & ~faulty).any():
        still, telemetry = check_stuck_attitude(telemetry, model, ~faulty)
        usable, against_field = _against_field(telemetry, model, ~faulty)
        if any(finding.code == "clock" and finding.severity == "trap" for finding in against_field):
            findings = [finding for finding in findings if finding.code != "sunlit_flag"]  # the sun is elsewhere, then
        if not any(finding.severity == "trap" for finding in against_field):
            against_field += check_calibrated(telemetry, model, usable, onboard)
        findings = [*still, *against_field, *findings]
    return report(telemetry.provenance.get("source", "telemetry"), len(telemetry), findings)


def _against_field(telemetry: Telemetry, model: FieldModel, usable: BoolArray) -> tuple[BoolArray, list[Finding]]:
    """The findings of `check_field`, and the rows (N,) that they are of.

    Where a trap is named and torquers were on, it is looked for again in the rows in which they were off, or, where these
    are few, without the steps that the readings make as the torquers switch: what couples may be as large as the field.
    """
    found = check_field(telemetry, model, usable)
    dipole = telemetry.dipole_B_Am2
    if dipole is None or not any(finding.severity == "trap" for finding in found):
        return usable, found
    on = np.any(np.abs(np.nan_to_num(dipole)) > 0.0, axis=1)
    quiet = usable & ~on
    if not on.any():
        return usable, found
    few = int(quiet.sum()) < _QUIET_ROWS
    if few:
        telemetry, quiet = telemetry.replace(mag_B_nT=_without_steps(telemetry, np.nan_to_num(dipole))), usable
    again = check_field(telemetry, model, quiet)
    named = {finding.code for finding in again if finding.severity == "trap"} - {"outliers"}
    if named:  # a cause that the quiet rows have, beside which a mere misfit in all rows says nothing
        vague = {finding.code for finding in found if finding.severity == "trap"} <= _VAGUE and not named & _VAGUE
        return (quiet, again) if vague else (usable, found)
    posed = comparable(telemetry, model, usable, with_attitude=True)
    if posed is not None:  # their field is fitted then, so that all rows can be looked at
        again = [finding for finding in again if finding.code not in ("outliers", "rough_readings")]
        again = [*check_outliers(telemetry, posed, model, usable)[0], *again]
    return quiet & ~on, [
        *again,
        note(f"torquers_on.{'steps' if few else 'off'}", on=int(on.sum()), rows=len(telemetry)),
    ]


def _without_steps(telemetry: Telemetry, dipole_B_Am2: FloatArray) -> FloatArray:
    """(N, 3) readings less what they change by, from row to row, in proportion to the dipole.

    By second differences over even steps: of the field next to nothing is left in these, whatever the attitude.
    """
    step = np.diff(epoch.seconds_since(telemetry.time, telemetry.time[0]))
    bend = telemetry.mag_B_nT[2:] - 2.0 * telemetry.mag_B_nT[1:-1] + telemetry.mag_B_nT[:-2]
    switched = dipole_B_Am2[2:] - 2.0 * dipole_B_Am2[1:-1] + dipole_B_Am2[:-2]
    even = np.isclose(step[1:], step[:-1], rtol=0.1) & np.isfinite(bend).all(axis=1)
    coupling = np.linalg.lstsq(switched[even], bend[even], rcond=None)[0]
    return np.asarray(telemetry.mag_B_nT - dipole_B_Am2 @ coupling)


def check_file(
    path: Path | str,
    model: FieldModel,
    *,
    column_map: Path | str | None = None,
    tle: Path | str | None = None,
    attitude: Path | str | None = None,
    max_samples: int | None = None,
    start: np.datetime64 | date | str | None = None,
    end: np.datetime64 | date | str | None = None,
    where: str | None = None,
    magnetometer: int = 1,
    onboard: Onboard | None = None,
) -> CheckReport:
    """As `check_telemetry`, from a file; rows out of order or doubled are a trap here, not an error.

    How it is read: as `read_telemetry`.

    Raises BadInput for a file that cannot be read at all.
    """
    chosen = selection(start, end, where)
    table, how = _read(path, column_map, tle, max_samples or MAX_SAMPLES, chosen)
    mapped = column_map is not None or bool(how)
    order = _order(table, "`sort = true` in the [[file]] of a column map" if mapped else _REPAIR)
    ordered, left_out = _ordered(table)
    order += left_out
    shifted = check_columns(table)
    if shifted:
        return report(str(path), table.time.size, [*how, *order, *shifted])
    blind = bool(how) and "mag_x_nT" not in table.columns
    if blind:
        ordered.columns.update({f"mag_{axis}_nT": np.full(ordered.time.size, np.nan) for axis in "xyz"})
    telemetry = record(ordered, tle=None if mapped else tle, attitude=attitude).with_magnetometer(magnetometer)
    inner = (
        [*check_motion(telemetry)[0], note("no_magnetometer")]
        if blind
        else check_telemetry(telemetry, model, onboard=onboard).findings
    )
    notices = telemetry.provenance.get("notices", "").split("; ")
    how += [note("two_magnetometers", other=3 - magnetometer)] * (telemetry.mag2_B_nT is not None)
    said = [note("on_reading", text=text) for text in notices if text and not (blind and text.startswith("mag_"))]
    return report(str(path), table.time.size, [*how, *order, *inner, *said])


def _read(
    path: Path | str, column_map: Path | str | None, tle: Path | str | None, max_samples: int, chosen: Selection
) -> tuple[FileTable, list[Finding]]:
    """The columns of `path`, and a note where a packaged map was needed and fits to the letter."""
    if column_map is not None:
        return chosen.cut(mapped_table(path, column_map, tle=tle, max_samples=max_samples, any_order=True)), []
    try:
        table = read_table(path, max_samples=max_samples, others=chosen.columns)
    except BadInput:
        found = recognised(path)
        if found is None:
            raise
    else:
        return chosen.cut(table), []
    name, packaged = found
    table = chosen.cut(mapped_table(path, packaged, tle=tle, max_samples=max_samples, any_order=True))
    layout = packaged.layout
    taken = f", which takes {layout.taken_as}" if layout else ""
    return table, [note(RECOGNISED, layout=layout.name if layout else name, name=name, taken=taken)]


def repair(path: Path | str, out: Path | str, *, max_samples: int | None = None) -> CheckReport:
    """Write a file with the rows of another sorted by time and exact duplicates dropped; the rest is reported.

    path: of the file that is read, with the columns of docs/telemetry.md. out: as the path of `fluxtwin.write`.
    max_samples: the largest number of rows to read; None for 5,000,000.

    Rows without a time, and rows that repeat a time with other values, do not belong in a record;
    they are left out and named. Raises BadInput when `out` is the input, or nothing is left.
    """
    if Path(out).resolve() == Path(path).resolve():
        raise BadInput("would overwrite the input", where=str(out), wanted="another name for the repaired file")
    try:
        table = read_table(path, max_samples=max_samples or MAX_SAMPLES)
    except BadInput:
        if recognised(path) is None:
            raise
        wanted = "a file that has the columns of docs/telemetry.md"
        raise BadInput("a file read through a column map cannot be repaired", where=str(path), wanted=wanted) from None
    findings = _order(table, _REPAIR)
    ordered, left_out = _ordered(table)
    telemetry = record(ordered)
    write_telemetry(telemetry, out)
    findings += left_out
    findings += [note("on_reading", text=text) for text in table.notices]
    return report(str(path), len(telemetry), findings)


def _order(table: FileTable, mend: str) -> list[Finding]:
    """Stamps that do not increase, as a trap; `mend` is what sorts them and drops exact duplicates."""
    stamps = table.time
    missing = np.flatnonzero(np.isnat(stamps))
    findings = []
    if missing.size:
        findings.append(trap("time_missing", missing, count=missing.size))
    known = np.flatnonzero(~np.isnat(stamps))
    step = np.diff(stamps[known].astype("int64"))
    back, same = known[1:][step < 0], known[1:][step == 0]
    if back.size:
        row, many = int(np.flatnonzero(step < 0)[0]), {"count": back.size}
        before, after = (epoch.iso(stamps[known[at]], "ms") for at in (row, row + 1))
        findings.append(trap("time_not_increasing", back, before=before, after=after, mend=mend, **many))
    if same.size:
        findings.append(trap("time_repeated", same, count=same.size, mend=mend))
    return findings


def _ordered(table: FileTable) -> tuple[FileTable, list[Finding]]:
    """The table sorted, one row an instant; and what had to be left out beyond exact duplicates."""
    rows = np.flatnonzero(~np.isnat(table.time))
    rows = rows[np.argsort(table.time[rows], kind="stable")]
    if rows.size == 0:
        raise BadInput("no row has a time", where=table.where, wanted="UTC stamps")
    step = np.diff(table.time[rows].astype("int64"))
    instant = np.concatenate([[0], np.cumsum(step > 0)])
    first = np.flatnonzero(np.concatenate([[True], step > 0]))[instant]
    content = np.stack(list(table.columns.values()), axis=1)
    mine, kept = content[rows], content[rows[first]]
    equal = ((mine == kept) | (np.isnan(mine) & np.isnan(kept))).all(axis=1)
    is_first = first == np.arange(rows.size)
    rivals, doubles = rows[~is_first & ~equal], rows[~is_first & equal]
    findings = []
    if doubles.size:
        findings.append(note("duplicates_dropped", np.sort(doubles), count=doubles.size, rows=table.time.size))
    if rivals.size:
        findings.append(trap("conflicting_rows", np.sort(rivals), count=rivals.size))
    keep = rows[is_first]
    columns = {name: value[keep] for name, value in table.columns.items()}
    return replace(table, time=table.time[keep], columns=columns), findings
