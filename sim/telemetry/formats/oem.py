"""CCSDS orbit ephemeris messages as KVN: positions [km] and velocities [km/s] at epochs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES
from fluxtwin.sim.telemetry.formats import ccsds
from fluxtwin.sim.telemetry.formats.table import Table
from fluxtwin.sim.telemetry.record import Telemetry


def read(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """Columns `time`, `x`, `y`, `z` [km], `vx`, `vy`, `vz` [km/s]; attribute `frame`, the same in all segments."""
    message = ccsds.read_message(path, "OEM", 6, max_samples)
    where = str(path)
    frames = {ccsds.frame_of(one, "REF_FRAME", where) for one in message.segments}
    centres = {one.meta.get("CENTER_NAME", "EARTH").upper() for one in message.segments}
    if len(frames) > 1 or centres != {"EARTH"}:
        found = ", ".join(sorted(frames) if len(frames) > 1 else sorted(centres))
        raise BadInput(f"its segments are in {found}", where=where, wanted="one frame with the Earth at its centre")
    time = np.concatenate([ccsds.times(one, where) for one in message.segments])
    values = np.array([row[:6] for one in message.segments for row in one.rows])
    time, first = np.unique(time, return_index=True)  # segments may share their ends
    columns = dict(zip(("x", "y", "z", "vx", "vy", "vz"), values[first].T, strict=True))
    units = dict.fromkeys(("x", "y", "z"), "km") | dict.fromkeys(("vx", "vy", "vz"), "km/s")
    attributes = {"frame": frames.pop(), "spacecraft": message.segments[0].meta.get("OBJECT_NAME", "")}
    return Table(where, {"time": time, **columns}, units, attributes, sha256=message.sha256)


def write(telemetry: Telemetry, path: Path | str) -> Path:
    """Positions and velocities in GCRF. Raises BadInput where there are none."""
    from fluxtwin.sim.telemetry.build import velocity_from_positions

    r = telemetry.r_N_km
    if r is None:
        where = telemetry.provenance.get("source", "telemetry")
        raise BadInput("has no positions", where=where, wanted="positions (columns, or --tle) for an OEM")
    v = telemetry.v_N_km_s
    v = velocity_from_positions(telemetry.time, r) if v is None else v
    return ccsds.write_message(telemetry, path, "OEM", [("REF_FRAME", "GCRF")], np.hstack([r, v]))
