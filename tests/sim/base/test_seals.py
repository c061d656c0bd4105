"""A flipped bit in a file that fluxtwin wrote is refused, or changes nothing; a change that was meant may stay."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import scenario_text, small_record

from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.onboard.export import export_calibration, import_calibration
from fluxtwin.sim.base import seals
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import write_json, write_text, write_toml
from fluxtwin.sim.base.limits import text_of
from fluxtwin.sim.scenario.scenario import load_scenario, parse_scenario, save_scenario
from fluxtwin.sim.telemetry.formats.catalogue import format_of
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.property

CALIBRATION = Calibration(S=np.diag([0.01, 0.02, 0.03]), b_nT=np.array([100.0, -200.0, 300.5]), samples=5, sigma_nT=3.0)


def _record(path: Path) -> Any:
    read = read_telemetry(path)
    return read.time.tobytes(), *(part.tobytes() for part in (read.mag_B_nT, read.r_N_km, read.v_N_km_s, read.q_NB))


def _table(path: Path) -> Any:
    found = format_of(path)
    assert found is not None
    return {name: value.tobytes() for name, value in found.read(path, 100).columns.items()}


def _json(path: Path) -> Any:
    content = seals.unsealed_json(text_of(path, wanted="JSON"), where=str(path), wanted="JSON")
    return content.get("x"), content.get("fluxtwin")  # another key is nobody's


Case = tuple[Callable[[Path], object], Callable[[Path], Any]]
FILES: dict[str, Case] = {
    "t.csv": (lambda path: write_telemetry(small_record(30), path), _record),
    "t.csv.gz": (lambda path: write_telemetry(small_record(30), path), _record),
    "t.nc": (lambda path: write_telemetry(small_record(30), path), _record),
    "t.aem": (lambda path: write_telemetry(small_record(30), path), _table),
    "t.oem": (lambda path: write_telemetry(small_record(30), path), _table),
    "s.toml": (
        lambda path: save_scenario(parse_scenario(scenario_text()), path),
        lambda path: load_scenario(path).model_dump(),
    ),
    "c.toml": (CALIBRATION.to_toml, lambda path: Calibration.from_toml(path).digest),
    "ardupilot.parm": (lambda path: export_calibration(CALIBRATION, "ardupilot").write(path), import_calibration),
    "c.h": (lambda path: export_calibration(CALIBRATION, "c-header").write(path), import_calibration),
    "m.m": (lambda path: export_calibration(CALIBRATION, "matlab").write(path), import_calibration),
    "e.json": (lambda path: export_calibration(CALIBRATION, "json").write(path), import_calibration),
    "r.json": (lambda path: write_json(path, seals.sealed_json({"fluxtwin": "0", "x": [1.5, None, "a"]})), _json),
}


def plain(value: Any) -> Any:
    """Comparable, whatever the reader gives."""
    return (value.S.tolist(), value.b_nT.tolist()) if isinstance(value, Calibration) else value


@pytest.mark.parametrize("name", FILES)
def test_no_flipped_bit_is_read_as_something_else(tmp_path: Path, name: str) -> None:
    write, read = FILES[name]
    write(tmp_path / name)
    content, good = (tmp_path / name).read_bytes(), plain(read(tmp_path / name))
    refused = 0
    for bit in np.random.default_rng(7).choice(8 * len(content), 120, replace=False).tolist():
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        (tmp_path / name).write_bytes(damaged)
        try:
            assert plain(read(tmp_path / name)) == good, (name, bit)
        except BadInput:
            refused += 1
    assert refused > (30 if name == "t.nc" else 60)  # in HDF5 much is padding


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("t.csv", ",7000.0,", ",7001.0,", "row 1 is not as fluxtwin wrote it.*without the column row_crc32_v1"),
        ("t.aem", " 0.0", " 0.1", "is not as fluxtwin wrote it.*without line 2, which holds the SHA-256"),
        ("s.toml", "altitude_km = 650", "altitude_km = 651", "damaged, or changed by hand.*without line 1"),
        ("ardupilot.parm", "_OFS_X", "_OFS_X ", "without line 1"),
        ("e.json", '"o": [', '"o": [1.0, ', "without the key sha256"),
    ],
)
def test_a_change_by_hand_is_told_how_to_go_on(tmp_path: Path, name: str, old: str, new: str, said: str) -> None:
    write, read = FILES[name]
    write(tmp_path / name)
    text = (tmp_path / name).read_text(encoding="utf-8")
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(BadInput, match=said):
        read(tmp_path / name)


def test_a_changed_scenario_is_read_once_its_first_line_is_gone(tmp_path: Path) -> None:
    path = save_scenario(parse_scenario(scenario_text()), tmp_path / "s.toml")
    changed = path.read_text(encoding="utf-8").replace("altitude_km = 650", "altitude_km = 651")
    path.write_text(changed.partition("\n")[2], encoding="utf-8")
    orbit = load_scenario(path).orbit
    assert orbit is not None and orbit.altitude_km == 651.0


def test_a_table_without_the_column_of_checks_and_one_whose_rows_were_sorted_are_read(tmp_path: Path) -> None:
    path = write_telemetry(small_record(30), tmp_path / "t.csv")
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    assert head.endswith(",row_crc32_v1")
    meant = [line.rpartition(",")[0].replace(",7000.0,", ",7001.0,") for line in (head, *rows)]
    (tmp_path / "meant.csv").write_text("\n".join([*meant, ""]), encoding="utf-8")
    assert read_telemetry(tmp_path / "meant.csv").r_N_km[0, 0] == 7001.0  # type: ignore[index]
    (tmp_path / "some.csv").write_text("\r\n".join([head, *rows[3:9], ""]), encoding="utf-8", newline="")
    assert len(read_telemetry(tmp_path / "some.csv")) == 6
    assert "row_crc32" not in read_telemetry(path).provenance.get("notices", "")


def test_line_ends_of_another_system_are_no_change(tmp_path: Path) -> None:
    path = save_scenario(parse_scenario(scenario_text()), tmp_path / "s.toml")
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert load_scenario(path).name == "scenario"


def test_a_draft_is_there_to_be_edited(tmp_path: Path) -> None:
    from fluxtwin.sim.base.toml_input import read_tree

    path = write_toml(tmp_path / "m.toml", "x = 1\n", draft=True)
    path.write_text(path.read_text(encoding="utf-8").replace("x = 1", "x = 2"), encoding="utf-8")
    assert read_tree(path) == {"x": 2}


@pytest.mark.parametrize("name", ["t.csv", "s.toml", "c.toml", "r.json"])
def test_a_file_of_a_later_format_asks_for_a_newer_program(tmp_path: Path, name: str) -> None:
    write, read = FILES[name]
    write(tmp_path / name)
    text = (tmp_path / name).read_text(encoding="utf-8")
    for old, new in (("_v1\n", "_v2\n"), ("format 1;", "format 2;"), ("format = 1", "format = 2"), ('": 1,', '": 2,')):
        text = text.replace(old, new, 1)
    write_text(tmp_path / name, text)
    with pytest.raises(
        BadInput, match=rf"{name}.*its format is 2; this fluxtwin knows format 1\. Wanted: a newer fluxtwin"
    ):
        read(tmp_path / name)


def test_a_name_that_is_a_formula_is_none_in_a_table(tmp_path: Path) -> None:
    for text in ("=1+1", "+cmd", "-2", "@SUM(A1)", " =1"):
        record = small_record(12).replace(provenance={"spacecraft": text})
        path = write_telemetry(record, tmp_path / "t.csv")
        assert path.read_text(encoding="utf-8").splitlines()[1].split(",")[-2] == f"'{text.strip()}"
        assert write_telemetry(read_telemetry(path), tmp_path / "again.csv").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("name", ["t.nc", "t.csv", "t.xlsx", "t.aem"])
def test_any_name_of_a_spacecraft_can_be_written(tmp_path: Path, name: str) -> None:
    for text in ("a\0b", "\x1b[31m", "\udcff", "a\nMETA_STOP", "x" * 5000, "</a>"):
        record = small_record(12).replace(provenance={"spacecraft": text})
        read = format_of(write_telemetry(record, tmp_path / name))
        assert (
            len(read_telemetry(tmp_path / name) if read is None else read.read(tmp_path / name, 99).columns["time"])
            == 12
        )


def test_a_workbook_has_no_date_inside(tmp_path: Path) -> None:
    """The hour at which it was made would give the same record other bytes."""
    with zipfile.ZipFile(write_telemetry(small_record(12), tmp_path / "a.xlsx")) as book:
        assert {one.date_time for one in book.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        dates = re.findall(rb"<dcterms:[^>]*>([^<]*)", book.read("docProps/core.xml"))
    assert dates == [b"1980-01-01T00:00:00Z"] * 2
    assert len(read_telemetry(tmp_path / "a.xlsx")) == 12
