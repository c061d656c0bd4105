"""What no record can be made of: each message says what is wrong, where, and what is wanted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from worlds import small_record

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_COLUMNS
from fluxtwin.sim.telemetry.column_map import load_column_map
from fluxtwin.sim.telemetry.column_map_draft import draft
from fluxtwin.sim.telemetry.formats import ccsds, frame, xlsx
from fluxtwin.sim.telemetry.formats.table import Table

pytestmark = pytest.mark.property

STAMPS = np.array(["2026-03-01T00:00:00", "2026-03-01T00:00:01"], dtype="datetime64[ns]")
ISO = "2026-03-01T00:00:0{}Z"
MAG = 'mag = { from = ["bx", "by", "bz"], unit = "nT" }\n'
TIME = '{ recipe = "iso", columns = "t" }'


def entry(columns: str, time: str = TIME, path: str = "") -> str:
    return f"[[file]]\n{path}\ntime = {time}\n[file.columns]\n{columns}\n"


@pytest.mark.parametrize("kind", ["f", "i"])
def test_numbers_are_no_stamps(kind: str) -> None:
    """Seconds, which numpy would take for nanoseconds since 1970."""
    with pytest.raises(BadInput, match="time: holds numbers, no stamps"):
        fluxtwin.Telemetry(time=np.arange(2).astype(kind), mag_B_nT=np.ones((2, 3)))


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        (entry(MAG + 'temperature = { from = "T", unit = "parsec" }'), "temperature has the unit 'parsec'"),
        (entry(MAG + 'flag_x = { from = "f", unit = "nT" }'), "flag_x takes no unit"),
        (
            entry(MAG) + entry('position = { from = ["x", "y", "z"], unit = "km", frame = "GCRS" }') * 2,
            "comes from two",
        ),
        (entry(MAG + 'attitude = { from = ["a", "b", "c"], order = "xyzw", relative_to = "GCRS" }'), "takes 4 columns"),
        (entry(MAG + 'sunlit = { from = "e", matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }'), "takes no matrix"),
        (entry('mag = { from = ["bx", "by", "bz"], unit = "nT", frame = "geodetic" }'), "mag cannot be geodetic"),
        (
            '[layout]\nname = "a"\ntaken_as = "a"\ntitle_begins = "aaaaaaaaaa"\nvariables = {}\n' + entry(MAG),
            "variable time",
        ),
    ],
)
def test_a_column_map_that_cannot_be_meant(tmp_path: Path, toml: str, said: str) -> None:
    (tmp_path / "m.toml").write_text(toml, encoding="utf-8")
    with pytest.raises(BadInput, match=said):
        load_column_map(tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("toml", "data", "said"),
    [
        (entry(MAG), "", "is a folder"),
        (entry(MAG, path='path = "*.csv"'), "nowhere/x.csv", "there is no such folder"),
        (entry(MAG, path='path = "**.csv"'), "t.csv", r"path '\*\*\.csv'"),
        (entry(MAG, time='{ recipe = "cf", columns = "t" }'), "t.csv", "time recipe cf does not fit"),
        (entry(MAG, time='{ recipe = "text", columns = "t", format = "%Q" }'), "t.csv", "format"),
        (entry('mag = { from = "bx", unit = "nT" }'), "t.nc", "mag has 1 components"),
        (
            entry('mag = { from = "b", unit = "nT" }\nattitude = { from = "b", order = "xyzw", relative_to = "GCRS" }'),
            "t.nc",
            "attitude has 3",
        ),
        (entry(MAG + 'attitude = { from = "q", order = "xyzw", relative_to = "orbital" }'), "t.csv", "needs positions"),
        (
            entry(MAG + 'velocity = { from = ["bx", "by", "bz"], unit = "km/s", frame = "ITRS" }'),
            "t.csv",
            "needs the position",
        ),
        (entry('mag = { from = "deep", unit = "nT" }'), "t.nc", "one row per sample"),
        (entry('mag = { from = "short", unit = "nT" }'), "t.nc", "mag has 1 row, time has 2"),
        (entry('mag = { from = "short", unit = "nT" }', path='where = "bx > 0"'), "t.nc", "1 and 2 rows"),
    ],
)
def test_a_file_that_does_not_fit_its_map(tmp_path: Path, toml: str, data: str, said: str) -> None:
    lines = ["t,bx,by,bz,q", *(f"{ISO.format(k)},1,2,3,0;0;0;1" for k in range(2)), ""]
    (tmp_path / "t.csv").write_text("\n".join(lines), encoding="utf-8")
    with h5py.File(tmp_path / "t.nc", "w") as made:
        made.create_dataset("t", data=[0.0, 1.0]).attrs["units"] = "seconds since 2026-03-01"
        for name, value in {
            "bx": np.ones(2),
            "b": np.ones((2, 3)),
            "deep": np.ones((2, 3, 2)),
            "short": np.ones((1, 3)),
        }.items():
            made[name] = value
    toml = toml.replace('"iso"', '"cf"') if data == "t.nc" else toml
    (tmp_path / "m.toml").write_text(toml, encoding="utf-8")
    with pytest.raises(BadInput, match=said):
        fluxtwin.read(tmp_path / data, column_map=tmp_path / "m.toml")


ROW = f"{ISO.format(0)},1,2,3"
HEAD = "time,mag_x_nT,mag_y_nT,mag_z_nT"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD, "there are no rows"),
        (",".join(f"c{k}" for k in range(MAX_COLUMNS + 1)) + "\n1\n", "has more than"),
        (f'"{HEAD}\n{ROW}\n', "header cannot be split"),
        (f'{HEAD},note\n{ROW},"a\n', "quotes do not match"),
        (f'{HEAD},note\n{ROW},"a",b\n', "row 1 has 6 fields, the header has 5"),
        (f"{HEAD},mag_x_mG,mag_y_mG,mag_z_mG\n{ROW},1,2,3\n", "given in two units"),
        (f"{HEAD},wheel_1_speed\n{ROW},1\n", "wheel_1_speed has no unit"),
        (f"{HEAD},yaw_deg,roll_deg,pitch_deg\n{ROW},1,2,3\n", "need the position"),
        (f"{HEAD},spacecraft\n{ROW},a\n{ISO.format(1)},1,2,3,b\n", "'a' and 'b' in different rows"),
        (f"{HEAD}\n,1,2,3\n", "time is missing in row 1"),
    ],
)
def test_a_csv_that_is_no_record(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=said) as caught:
        fluxtwin.read(tmp_path / "t.csv")
    assert "t.csv" in str(caught.value)


def _scaled(made: h5py.File) -> None:
    made["mag_x_nT"].attrs["scale_factor"] = "two"


def _infinite(made: h5py.File) -> None:
    made["mag_x_nT"][...] = np.inf


def _calendar(made: h5py.File) -> None:
    made["time"].attrs["calendar"] = "noleap"


def _late(made: h5py.File) -> None:
    made["time"].attrs["units"] = "days since 2026-03-01"
    made["time"][...] = [0, 2**40]


def _timeless(made: h5py.File) -> None:
    del made["time"]


def _many(made: h5py.File) -> None:
    for number in range(MAX_COLUMNS):
        made[f"v{number}"] = 0.0


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (_scaled, "of mag_x_nT is no number"),
        (_infinite, "mag_x_nT has infinite values"),
        (_calendar, "calendar of time is 'noleap'"),
        (_late, "beyond the years 1678 to 2262"),
        (_timeless, "variable time is missing"),
        (_many, "has more than"),
    ],
)
def test_a_netcdf_file_that_is_no_record(tmp_path: Path, damage: Callable[[h5py.File], None], said: str) -> None:
    with h5py.File(tmp_path / "t.nc", "w") as made:
        made.create_dataset("time", data=[0, 1], dtype="i8").attrs["units"] = "seconds since 2026-03-01"
        for axis in "xyz":
            made[f"mag_{axis}_nT"] = [1.0, 2.0]
        damage(made)
    with pytest.raises(BadInput, match=said) as caught:
        fluxtwin.read(tmp_path / "t.nc")
    assert "t.nc" in str(caught.value)


def test_a_netcdf_file_of_no_bytes(tmp_path: Path) -> None:
    (tmp_path / "t.nc").write_bytes(b"")
    with pytest.raises(BadInput, match="the file is empty"):
        fluxtwin.read(tmp_path / "t.nc")
    (tmp_path / "t.aem").write_bytes(b"")
    with pytest.raises(BadInput, match="the file is empty"):
        fluxtwin.read(tmp_path / "t.aem")


XYZ = {f"mag_{axis}_nT": [1.0, 2.0] for axis in "xyz"}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (pd.DataFrame({"time": [1.0, 2.0], **XYZ}), "time holds numbers, no stamps"),
        (pd.DataFrame({"time": STAMPS, **XYZ, "mag_x_nT": STAMPS}), "mag_x_nT holds stamps, no numbers"),
        (pd.DataFrame({"time": STAMPS, "mag": [[1.0, 2.0, 3.0], [1.0]]}), "mag holds lists of different lengths"),
        (xr.Dataset({"mag": ("k", [1.0])}), "no variable holds stamps"),
        (pd.DataFrame({"time": STAMPS[:0], **{name: STAMPS[:0].astype(float) for name in XYZ}}), "there are no rows"),
        (3, "an object of type int was given"),
    ],
)
def test_a_table_in_memory_that_is_no_record(given: Any, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        fluxtwin.read(given)


def test_a_column_of_numbers_is_no_text_and_another_shape_is_no_column() -> None:
    table = Table("t.x", {"time": STAMPS, "bx": np.ones(2), **{name: np.ones(1) for name in XYZ}})
    with pytest.raises(BadInput, match="bx holds no text"):
        table.text("bx")
    with pytest.raises(BadInput, match=r"has the shape \(1,\), time has \(2,\)"):
        fluxtwin.sim.telemetry.formats.table.contract(table)


def test_what_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = small_record(2).replace(r_N_km=None, v_N_km_s=None)
    with pytest.raises(BadInput, match="has no positions"):
        ccsds.write_oem(bare, tmp_path / "t.oem")
    pd.DataFrame([[1.0]], index=[0], columns=["t"]).to_excel(tmp_path / "wide.xlsx", startcol=MAX_COLUMNS)
    with pytest.raises(BadInput, match=rf"wide\.xlsx: has {MAX_COLUMNS + 2} columns"):
        fluxtwin.read(tmp_path / "wide.xlsx")
    (tmp_path / "wide.xlsx").unlink()
    monkeypatch.setattr(xlsx, "_MOST_ROWS", 1)
    with pytest.raises(BadInput, match="has 2 rows"):
        xlsx.write(bare, tmp_path / "t.xlsx")
    assert not list(tmp_path.iterdir())
    with pytest.raises(BadInput, match="has one magnetometer, number 2"):
        bare.with_magnetometer(2)
    assert bare.with_magnetometer(1) is bare


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"time": np.array(["2026-03-01", "NaT"], dtype="datetime64[ns]")}, "the time is missing in row 2"),
        ({"mag_B_nT": [[1.0, 2.0, 3.0], [1.0, -np.inf, 3.0]]}, "the value in row 2 is infinite"),
    ],
)
def test_values_that_no_record_has(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        small_record(2).replace(**changes)


def test_a_sheet_of_what_has_none_and_a_folder_without_tables(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"{HEAD}\n{ROW}\n", encoding="utf-8")
    (tmp_path / "m.toml").write_text(entry(MAG, path='sheet = "one"'), encoding="utf-8")
    with pytest.raises(BadInput, match="has no sheets, and the map names 'one'"):
        fluxtwin.read(tmp_path / "t.csv", column_map=tmp_path / "m.toml")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match="has no tables"):
        draft([tmp_path / "empty"])
    with pytest.raises(BadInput, match="is not telemetry"):
        fluxtwin.read(tmp_path / "m.toml")


def test_files_of_42_with_words(tmp_path: Path) -> None:
    (tmp_path / "DynTime.42").write_text("0.0\nword\n", encoding="utf-8")
    with pytest.raises(BadInput, match="rows that are no numbers"):
        fluxtwin.read(tmp_path)


def test_a_frame_says_what_its_lists_hold() -> None:
    held = frame.of_pandas(pd.DataFrame({"time": STAMPS, "mag": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]}))
    assert held.columns["mag"].shape == (2, 3)


def test_elements_and_attitudes_that_are_not_there_are_refused_where_they_are_not_needed(tmp_path: Path) -> None:
    path = fluxtwin.write(small_record(20), tmp_path / "t.nc")
    there = fluxtwin.write(small_record(20), tmp_path / "o.oem")
    assert "elements in o.oem were not used" in fluxtwin.read(path, tle=there).provenance["notices"]
    for name in ("tle", "attitude"):
        for verb in (fluxtwin.read, fluxtwin.check):
            with pytest.raises(BadInput, match=r"none\.txt: there is no such file"):
                verb(path, **{name: tmp_path / "none.txt"})
    columns = 'position = { from = ["r_x_km", "r_y_km", "r_z_km"], unit = "km", frame = "GCRS" }'
    mag = 'mag = { from = ["mag_x_nT", "mag_y_nT", "mag_z_nT"], unit = "nT" }\n'
    table = fluxtwin.write(small_record(20), tmp_path / "t.csv")
    (tmp_path / "m.toml").write_text(entry(mag + columns, '{ recipe = "iso", columns = "time" }'), encoding="utf-8")
    with pytest.raises(BadInput, match=r"none\.txt: there is no such file"):
        fluxtwin.read(table, column_map=tmp_path / "m.toml", tle=tmp_path / "none.txt")
