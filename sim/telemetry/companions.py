"""Orbit and attitude from files of their own: two-line elements, CCSDS orbit and attitude ephemerides.

They are brought to the record's stamps as the sources of a column map are: positions by a cubic with the velocities,
attitude by slerp, nothing across more than `ORBIT_GAP_S` and `ATTITUDE_GAP_S`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.telemetry.formats import ccsds

if TYPE_CHECKING:
    from fluxtwin.sim.earth.tle import TleSeries

ORBIT_GAP_S = 300.0
"""In low orbit a cubic through positions and velocities 300 s apart is 0.02 km off."""
ATTITUDE_GAP_S = 60.0
ALONG_TRACK_KM = "along_track_sigma_km"
"""Key of a record's provenance: the error along the track of positions from two-line elements, 1 sigma."""
ATTITUDE_OF_ORBIT = "attitude_relative_to"
"""Likewise, beside it: the axes of the orbit or of the place that the attitude was recorded relative to."""


class Positions(NamedTuple):
    """GCRS, each (N, 3)."""

    r_N_km: FloatArray
    v_N_km_s: FloatArray
    said: list[str]
    """What is to be said of them."""
    stated: dict[str, str]
    """For the provenance."""
    elements: TleSeries | None
    """What they were computed from; None for an OEM."""


def positions(path: Path | str, time: TimeArray) -> Positions:
    """Positions and velocities at the stamps.

    path: two-line elements, one set or many, or a CCSDS OEM. Rows out of an OEM's reach are NaN. Raises BadInput.
    """
    file = Path(path)
    if ccsds.is_oem(file):
        return Positions(*_from_oem(file, time), {}, None)
    from fluxtwin.sim.earth.tle import along_track_sigma_km, read_elements

    elements = read_elements(path)
    said = f"positions and velocities were computed from the elements in {file.name}"
    sizes_km = np.array([along_track_sigma_km(days) for days in np.unique(elements.age_days(time).round(2))])
    stated = {ALONG_TRACK_KM: f"{np.sqrt(np.mean(sizes_km**2)):.3g}"}
    return Positions(*elements.propagate(time), [said, *elements.notices(time)], stated, elements)


def not_used(path: Path | str, said: str) -> str:
    """The notice `said`, with {} for its name, of a file that is not needed. Raises BadInput where there is none."""
    if not Path(path).exists():
        raise BadInput("there is no such file", where=str(path))
    return said.format(Path(path).name)


def attitude(
    path: Path | str, time: TimeArray, r_N_km: FloatArray | None, v_N_km_s: FloatArray | None
) -> tuple[FloatArray, list[str]]:
    """Quaternions q_NB (N, 4) at the stamps from a CCSDS AEM, NaN out of its reach, and what is to be said of them."""
    from fluxtwin.sim.telemetry.column_map_merge import attitude_at

    table = ccsds.read_aem(Path(path))
    columns = {
        "attitude": {
            "from": ["q_x", "q_y", "q_z", "q_w"],
            "order": "xyzw",
            "relative_to": table.attributes["frame"],
        }
    }
    entry = {"time": {"recipe": "cf"}, "columns": columns, "max_gap_s": ATTITUDE_GAP_S}
    notices = [f"the attitude is that of {Path(path).name}"]
    return attitude_at(table, entry, time, r_N_km, v_N_km_s, notices), notices


def _from_oem(path: Path, time: TimeArray) -> tuple[FloatArray, FloatArray, list[str]]:
    from fluxtwin.sim.telemetry.column_map_merge import orbit_at

    table = ccsds.read_oem(path)
    frame = table.attributes["frame"]
    columns = {
        "position": {"from": ["x", "y", "z"], "unit": "km", "frame": frame},
        "velocity": {"from": ["vx", "vy", "vz"], "unit": "km/s", "frame": frame},
    }
    r, v, notices = orbit_at(table, {"time": {"recipe": "cf"}, "columns": columns, "max_gap_s": ORBIT_GAP_S}, time)
    lost = int((~np.isfinite(r).all(axis=1)).sum())
    said = [f"positions and velocities are those of {path.name}", *notices]
    if lost:
        said.append(f"{lost} of {time.size} rows have no position in it, or none within {ORBIT_GAP_S:g} s")
    return r, v, said
