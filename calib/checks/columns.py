"""Columns that stand one place beside their names."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fluxtwin.calib.checks.report import Finding, trap
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.columns import FileTable

ORBIT_SPREAD = 0.15
"""Relative spread of |r| up to an eccentricity of 0.2."""


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
