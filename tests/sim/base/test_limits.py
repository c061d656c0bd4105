"""What is refused before it is read: devices, pipes, endless lines, claims of more than a file can hold."""

from __future__ import annotations

import os
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from worlds import small_record

from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base import limits
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.tle import read_tle
from fluxtwin.sim.scenario.scenario import load_scenario
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile, read_table
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = [pytest.mark.property, pytest.mark.skipif(os.name != "posix", reason="devices and pipes of POSIX")]

READERS: dict[str, Callable[[Path], object]] = {
    "a.csv": read_telemetry,
    "a.csv.gz": read_telemetry,
    "a.nc": read_telemetry,
    "a.aem": read_telemetry,
    "a.xlsx": read_telemetry,
    "a.toml": load_scenario,
    "c.toml": Calibration.from_toml,
    "a.tle": read_tle,
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null"])
def test_a_device_is_no_file(tmp_path: Path, name: str, device: str) -> None:
    (tmp_path / name).symlink_to(device)
    with pytest.raises(BadInput, match=f"{name}: is a device"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_into_which_nobody_writes_is_given_up(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_PATIENCE_S", 0.1)
    os.mkfifo(tmp_path / name)
    with pytest.raises(BadInput, match=f"{name}: is a pipe"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("silent_s", [0.0, 0.3])
def test_a_pipe_with_a_writer_is_read_to_its_end_however_slow(
    tmp_path: Path, silent_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_PATIENCE_S", 0.1)
    whole = write_telemetry(small_record(40), tmp_path / "a.csv").read_bytes()
    os.mkfifo(tmp_path / "p.csv")

    def slowly() -> None:
        with open(tmp_path / "p.csv", "wb", buffering=0) as pipe:
            for part in (whole[:700], whole[700:]):
                threading.Event().wait(silent_s)
                pipe.write(part)

    writer = threading.Thread(target=slowly)
    writer.start()
    read = read_telemetry(tmp_path / "p.csv")
    writer.join()
    assert len(read) == 40 and np.array_equal(read.mag_B_nT, read_telemetry(tmp_path / "a.csv").mag_B_nT)


def test_a_table_is_given_up_at_the_line_that_is_too_long_or_too_many() -> None:
    seen = limits.Lines(10, "t", beside=0)
    seen(b"a,b\n" * 10)
    with pytest.raises(BadInput, match=r"t: has more than 11 rows\. Wanted: at most 10"):
        seen(b"a\n")
    seen = limits.Lines(10, "t")
    seen(b"a\n" + b"1" * (limits.LINE_BYTES - 10))
    with pytest.raises(BadInput, match="t: line 2 is longer than 1000000 bytes"):
        seen(b"1" * 20)


def test_what_unpacks_to_far_more_than_its_size_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """Fifty-four flags of five million rows of which nothing is stored; one cell at the far corner of a sheet."""
    nothing = tmp_path / "nothing.nc"
    with h5py.File(nothing, "w") as made:
        time = made.create_dataset("time", (5_000_000,), "f8", chunks=(500_000,), compression="gzip")
        time.attrs["units"] = "seconds since 2020-01-01"
        for name in ["mag_x_nT", "mag_y_nT", "mag_z_nT", *(f"flag_{k}" for k in range(54))]:
            made.create_dataset(name, (5_000_000,), "f8", chunks=(500_000,), compression="gzip")
    sheet = tmp_path / "far.xlsx"
    write_telemetry(small_record(40), tmp_path / "a.xlsx")
    with zipfile.ZipFile(tmp_path / "a.xlsx") as good, zipfile.ZipFile(sheet, "w") as bad:
        for one in good.namelist():
            content = good.read(one)
            if one.endswith("sheet1.xml"):
                content = content.replace(
                    b"</sheetData>", b'<row r="1000000"><c r="ALM1000000"><v>1</v></c></row></sheetData>'
                )
            bad.writestr(one, content)
    for path in (nothing, sheet):
        with pytest.raises(BadInput, match=rf"{path.name}: unpacks to .* MB or more.*at most 100 MB, or 200 times"):
            read_telemetry(path)


@pytest.mark.parametrize("name", ["a.aem", "a.oem", "a.xlsx", "a.csv", "a.csv.gz", "a.nc"])
def test_the_limit_of_rows_is_named_by_every_format(tmp_path: Path, name: str) -> None:
    from fluxtwin.sim.telemetry.formats.catalogue import format_of

    path = write_telemetry(small_record(40), tmp_path / name)
    found = format_of(path)
    assert len(read_telemetry(path, max_samples=40)) == 40 if found is None else found.read(path, 40)
    with pytest.raises(BadInput, match=r"rows.*at most 30 .--max-samples N reads more"):
        read_telemetry(path, max_samples=30) if found is None else found.read(path, 30)


def test_a_pipe_that_brings_too_much_and_a_link_to_itself(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "p")
    writer = threading.Thread(target=lambda: (tmp_path / "p").write_bytes(b"12345"))
    writer.start()
    with pytest.raises(BadInput, match="p: is larger than 4 bytes"):
        limits.content_of(tmp_path / "p", most=4, wanted="a word")
    writer.join()
    for name in ("a.csv", "a.nc"):
        (tmp_path / name).symlink_to(name)
        with pytest.raises(BadInput, match=rf"{name}: cannot be read \(.*symbolic links"):
            READERS[name](tmp_path / name)
    (tmp_path / "b.nc").mkdir()
    with pytest.raises(BadInput, match=r"b\.nc: is a folder"):
        read_table(tmp_path / "b.nc")
    with h5py.File(tmp_path / "gone.nc", "w"):
        pass
    with NetcdfFile(tmp_path / "gone.nc") as opened, pytest.raises(BadInput, match=r"gone\.nc: cannot be read"):
        opened.path.unlink()
        _ = opened.sha256
