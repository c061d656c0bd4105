"""A run of 42 (Stoneking, NASA Goddard): its folder of files, one a signal, without headers.

Units and order are those of its `42report.c`: PosN.42 [m], VelN.42 [m/s], qbn.42 (x y z w, the textbook quaternion of body
relative to N), wbn.42 [rad/s], svb.42 (sun, body axes), MTB.42 [A m2], MagBVB.42 (nine columns, the last three the measured
field in body axes [T]; written where MagReport is called), DynTime.42 (seconds since J2000, TT). N is J2000.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES, Lines
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.formats.table import Table, content_of
from fluxtwin.sim.telemetry.time_stamps import J2000

_SIGNALS = {
    "PosN": (("r_x_km", "r_y_km", "r_z_km"), 1e-3),
    "VelN": (("v_x_km_s", "v_y_km_s", "v_z_km_s"), 1e-3),
    "qbn": (("q_x", "q_y", "q_z", "q_w"), 1.0),
    "wbn": (("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"), 1.0),
    "svb": (("sun_x", "sun_y", "sun_z"), 1.0),
    "MagBVB": (("mag_x_nT", "mag_y_nT", "mag_z_nT"), 1e9),
    "MTB": (("dipole_x_Am2", "dipole_y_Am2", "dipole_z_Am2"), 1.0),
}
"""By file: the columns and their factor. Of more numbers a row the last ones count."""


def read(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """The signals that are there, as columns of a record. BadInput for a run without DynTime.42 or with other rows."""
    seconds = _numbers(path / "DynTime.42", max_samples)[:, 0]
    whole = np.floor(seconds)
    count = (whole.astype("int64") * 10**9 + np.rint((seconds - whole) * 1e9).astype("int64")).astype("timedelta64[ns]")
    table = Table(str(path), {"time": epoch.utc_of(J2000 + count, "TT")})
    for name, (columns, factor) in _SIGNALS.items():
        file = path / f"{name}.42"
        if not file.is_file():
            continue
        value = _numbers(file, max_samples)
        if value.shape[1] < len(columns):
            table.notices.append(f"{file.name} has {value.shape[1]} columns, {len(columns)} are needed: left out")
            continue
        if len(value) != seconds.size:
            raise BadInput(
                f"{file.name} has {len(value)} rows, DynTime.42 has {seconds.size}",
                where=str(path),
                wanted="signals of one run, written at the same steps",
            )
        table.columns |= dict(zip(columns, (value[:, -len(columns) :] * factor).T, strict=True))
    table.notices.append("the axes N of 42 (J2000) were taken as GCRS, 0.02 arcsec off")
    digests = "".join(content_of(file)[1] for file in sorted(path.glob("*.42")))
    table.sha256 = hashlib.sha256(digests.encode()).hexdigest()
    return table


def _numbers(file: Path, max_samples: int) -> np.ndarray:
    content, _ = content_of(file, Lines(max_samples, str(file)))
    lines = content.decode("ascii", "replace").splitlines()
    try:
        rows = np.array([[float(word) for word in line.split()] for line in lines if line.strip()], dtype=np.float64)
    except ValueError:
        raise BadInput("has rows that are no numbers, or of different lengths", where=str(file)) from None
    if rows.ndim != 2:
        raise BadInput("has no rows", where=str(file))
    return rows
