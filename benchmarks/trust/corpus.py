"""One good file of every kind that is read, made in a folder, and who reads it."""

from __future__ import annotations

import io
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from sgp4.io import compute_checksum

import fluxtwin
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.onboard.export import export_calibration, import_calibration
from fluxtwin.sim.base.files import write_json, write_toml
from fluxtwin.sim.base.limits import text_of
from fluxtwin.sim.base.seals import sealed_json, unsealed_json
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.earth.tle import read_elements
from fluxtwin.sim.run.scenario_passes import read_stations
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import load_scenario, parse_scenario, save_scenario
from fluxtwin.sim.telemetry.formats.catalogue import format_of
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

SCENARIO = """name = "trust"
seed = 7
[spacecraft]
name = "cubesat"
inertia_kg_m2 = [[0.03, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.05]]
[orbit]
epoch_utc = "2026-03-01T00:00:00Z"
altitude_km = 520.0
inclination_deg = 97.5
raan_deg = 20.0
argument_of_latitude_deg = 0.0
[attitude]
mode = "tumble"
rate_deg_s = [0.11, 0.07, 0.05]
[magnetometer]
noise_nT = 30.0
lsb_nT = 10.0
b_nT = [500.0, -300.0, 200.0]
[schedule]
segments = [{ start_utc = "2026-03-01T00:00:00Z", samples = ROWS, step_s = 20.0 }]
"""
MAP = """[[file]]
time = { recipe = "iso", columns = "time" }
[file.columns]
mag = { from = ["mag_x_nT", "mag_y_nT", "mag_z_nT"], unit = "nT" }
position = { from = ["r_x_km", "r_y_km", "r_z_km"], unit = "km", frame = "GCRS" }
attitude = { from = ["q_x", "q_y", "q_z", "q_w"], order = "xyzw", relative_to = "GCRS" }
"""
STATIONS = """[station.kiruna]
latitude_deg = 67.86
longitude_deg = 20.96
altitude_km = 0.4
"""
_LINES = (
    "1 25544U 98067A   26060.50000000  .00010000  00000-0  18000-3 0  999",
    "2 25544  51.6400 150.0000 0005000 100.0000 260.0000 15.5000000040000",
)

Read = Callable[[Path], object]
HAS_PARQUET = find_spec("pyarrow") is not None


def scenario(rows: int) -> str:
    """The scenario with that many samples."""
    return SCENARIO.replace("ROWS", str(rows))


def make(folder: Path, rows: int = 60) -> dict[str, Read]:
    """The files by name, each with its reader."""
    record, _ = simulate(parse_scenario(scenario(rows)))
    for name in ("t.csv", "t.csv.gz", "t.nc", "t.aem", "t.oem", "t.xlsx", *(["t.parquet"] if HAS_PARQUET else [])):
        write_telemetry(record, folder / name)
    rows_only = [line.rpartition(",")[0] for line in (folder / "t.csv").read_text(encoding="utf-8").splitlines()]
    (folder / "foreign.csv").write_text("\n".join([*rows_only, ""]), encoding="utf-8")
    (folder / "map.toml").write_text(MAP, encoding="utf-8")
    (folder / "hand.toml").write_text(scenario(rows), encoding="utf-8")
    save_scenario(parse_scenario(scenario(rows)), folder / "saved.toml")
    (folder / "stations.toml").write_text(STATIONS, encoding="utf-8")
    known = fluxtwin.calibrate(record, method="linear").calibration
    known.to_toml(folder / "c.toml")
    (folder / "flat.toml").write_text(_without_digest(folder / "c.toml"), encoding="utf-8")
    exports = {"e.json": "json", "e.parm": "ardupilot", "e.h": "c-header", "e.m": "matlab"}
    for name, target in exports.items():
        export_calibration(known, target, force=True).write(folder / name)
    (folder / "e.tle").write_text(
        "".join(f"{line}{compute_checksum(line + '0')}\n" for line in _LINES), encoding="utf-8"
    )
    (folder / "m.mat").write_bytes(mat())
    write_json(folder / "r.json", sealed_json({"fluxtwin": "0", "x": {"a": [1.5, 2]}, "words": "units [nT]"}))
    write_toml(folder / "draft.toml", MAP, draft=True)
    return {name: READERS[name] for name in READERS if (folder / name).exists()}


def mat() -> bytes:
    """A small field of CHAOS's layout, of MATLAB 5."""
    rng = np.random.default_rng(0)
    pp = {"order": 3, "pieces": 3, "dim": 8, "breaks": np.linspace(0, 1000, 4), "coefs": rng.normal(0, 1, (24, 3))}
    content = io.BytesIO()
    scipy.io.savemat(content, {"pp": pp, "g": rng.normal(0, 1, (24, 1))})
    return content.getvalue()


def _without_digest(path: Path) -> str:
    lines = path.read_text(encoding="utf-8").splitlines()[1:]
    return "\n".join([line for line in lines if not line.startswith("sha256")] + [""])


def _record(path: Path) -> Any:
    return content(read_telemetry(path))


def content(read: Telemetry) -> Any:
    """What a record says, to be compared."""
    return [read.time.tobytes()] + [
        None if value is None else np.ascontiguousarray(value).tobytes()
        for value in (read.mag_B_nT, read.r_N_km, read.v_N_km_s, read.q_NB)
    ]


def _table(path: Path) -> Any:
    found = format_of(path)
    assert found is not None
    return {name: value.tobytes() for name, value in found.read(path, 1000).columns.items()}


def _mapped(path: Path) -> Any:
    if path.suffix == ".csv":
        return content(read_telemetry(path, column_map=path.with_name("map.toml")))
    return content(read_telemetry(path.with_name("foreign.csv"), column_map=path))


def _json(path: Path) -> Any:
    read = unsealed_json(text_of(path, wanted="JSON"), where=str(path), wanted="JSON")
    return read.get("x"), read.get("words")


def _plain(known: Calibration) -> Any:
    return known.S.tolist(), known.b_nT.tolist()


READERS: dict[str, Read] = {
    "t.csv": _record,
    "t.csv.gz": _record,
    "t.nc": _record,
    "foreign.csv": _mapped,
    "map.toml": _mapped,
    "draft.toml": _mapped,
    "hand.toml": lambda path: load_scenario(path).model_dump(),
    "saved.toml": lambda path: load_scenario(path).model_dump(),
    "stations.toml": lambda path: {name: sorted(one.items()) for name, one in read_stations(path).items()},
    "c.toml": lambda path: _plain(Calibration.from_toml(path)),
    "flat.toml": lambda path: _plain(Calibration.from_toml(path)),
    "e.json": lambda path: _plain(import_calibration(path)),
    "e.parm": lambda path: _plain(import_calibration(path)),
    "e.h": lambda path: _plain(import_calibration(path)),
    "e.m": lambda path: _plain(import_calibration(path)),
    "e.tle": lambda path: [one.line1 + one.line2 for one in read_elements(path).sets],
    "t.aem": _table,
    "t.oem": _table,
    "r.json": _json,
    "t.xlsx": _record,
    "t.parquet": _record,
    "m.mat": lambda path: load_field(f"chaos:{path}").static_nT.tolist(),
}
SLOW = ("t.xlsx", "t.parquet", "m.mat")
"""Tens of milliseconds a file, or a process: fewer trials."""
OWN = (
    "t.csv",
    "t.csv.gz",
    "t.nc",
    "saved.toml",
    "c.toml",
    "t.aem",
    "t.oem",
    "e.json",
    "e.parm",
    "e.h",
    "e.m",
    "r.json",
)
"""Written by fluxtwin, with a digest."""
