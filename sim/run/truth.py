"""What only the simulation knows. It goes to a file apart, for tests; estimators never see it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from fluxtwin.sim.base.netcdf_out import TRUTH_TITLE, Variable, write_netcdf
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import FloatArray, TimeArray

_UNITS = (
    ("_nT_per_Am2", "nT/(A m2)"),
    ("_nT", "nT"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("_km_s", "km/s"),
    ("_km", "km"),
    ("_Am2", "A m2"),
)
"""Unit by the end of a name, longest first."""
_PACKING = {"compression": "gzip", "compression_opts": 4, "shuffle": True, "fletcher32": True}


@dataclass(frozen=True)
class Truth(Shown):
    """The true history behind a simulated record; rows as in the telemetry."""

    time: TimeArray
    r_N_km: FloatArray
    v_N_km_s: FloatArray
    q_NB: FloatArray
    """(N, 4) true attitude, textbook quaternion."""
    rate_B_rad_s: FloatArray
    yaw_rad: FloatArray
    roll_rad: FloatArray
    pitch_rad: FloatArray
    field_N_nT: FloatArray
    field_B_nT: FloatArray
    """(N, 3) ambient field at the spacecraft, body axes."""
    unknown_B_nT: FloatArray
    """(N, 3) field of the unexplained source at the sensor."""
    ideal_B_nT: FloatArray
    """(N, 3) reading without noise, saturation and rounding."""
    dipole_B_Am2: FloatArray
    illumination: FloatArray
    S: FloatArray
    b_nT: FloatArray
    T_nT_per_Am2: FloatArray
    effects: str = "{}"
    """The scenario's effects as JSON: names, settings and parameters with their units."""

    def write(self, path: Path | str) -> Path:
        stamps = {"units": "nanoseconds since 1970-01-01", "calendar": "proleptic_gregorian"}
        columns = {
            "time": Variable(("time",), self.time.astype("int64"), stamps, storage=_PACKING),
            "effects": Variable((), self.effects, {"units": "1"}),
        }
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in ("time", "effects"):
                continue
            constant = item.name in ("S", "b_nT", "T_nT_per_Am2")
            rows = () if constant else ("time",)
            rest = tuple(f"axis_{place}_of_{size}" for place, size in enumerate(value.shape[len(rows) :]))
            unit = next((words for end, words in _UNITS if item.name.endswith(end)), "1")
            columns[item.name] = Variable((*rows, *rest), value, {"units": unit}, True, _PACKING)
        return write_netcdf(path, columns, {"title": TRUTH_TITLE})
