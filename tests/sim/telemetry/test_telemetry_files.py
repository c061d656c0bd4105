"""Telemetry files: what is written reads back bit-equal, damage is refused, bad input gets one clear message."""

from __future__ import annotations

import dataclasses
import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.telemetry import csv_files as telemetry_csv
from fluxtwin.sim.telemetry import netcdf_files as telemetry_netcdf
from fluxtwin.sim.telemetry.build import velocity_from_positions
from fluxtwin.sim.telemetry.record import Telemetry, concatenate
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.property

START = np.datetime64("1978-07-24T06:00:00", "ns")
ORBIT = Orbit(epoch_utc=START, altitude_km=790.0, inclination_rad=np.radians(108.0), raan_rad=1.0)
KINDS = ("a.csv", "a.csv.gz", "a.nc")


def full_record(rows: int = 40) -> Telemetry:
    """Every column, awkward values, some missing ones."""
    rng = stream(3, "telemetry.files")
    time = START + np.cumsum(rng.integers(1, 2_000_000_000, rows)).astype("timedelta64[ns]")
    r, v = ORBIT.propagate(time)
    q = rng.normal(size=(rows, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    q[5] = np.nan
    mag = rng.normal(0.0, 3e4, (rows, 3)) * 10.0 ** rng.integers(-12, 1, (rows, 3))
    mag[7, 1] = np.nan
    mag[8] = [0.1 + 0.2, -0.0, 5e-324]
    bits = (rng.random((rows, 3)) > 0.5).astype(float)
    return Telemetry(
        time=time,
        mag_B_nT=mag,
        r_N_km=r,
        v_N_km_s=v,
        q_NB=q,
        dipole_B_Am2=rng.normal(0, 100, (rows, 3)),
        sunlit=bits[:, 0],
        heater_on=bits[:, 1],
        flags={"transmitter": bits[:, 2]},
        drivers={"payload": np.where(bits[:, 0] > 0, rng.normal(size=rows), np.nan), "2": bits[:, 1]},
        driver_units={"payload": "A"},
        array_current_A=rng.normal(size=rows),
        battery_current_A=rng.normal(size=rows),
        temperature_degC=rng.normal(size=rows),
        wheel_speed_rpm=rng.normal(0, 2000, (rows, 3)),
        sun_sensor_head=rng.integers(0, 5, rows).astype(float),
        sun_B=rng.normal(size=(rows, 3)),
        nadir_B=rng.normal(size=(rows, 3)),
        rate_B_rad_s=rng.normal(0, 1e-3, (rows, 3)),
        mag2_B_nT=mag[::-1, [1, 2, 0]],
        provenance={"generator": "test"},
    )


def small_record(rows: int) -> Telemetry:
    """The needed columns only, so that hundreds of damaged copies are read quickly."""
    full = full_record(rows)
    return Telemetry(full.time, full.mag_B_nT, r_N_km=full.r_N_km, q_NB=full.q_NB)


def plain_lines(rows: int = 4) -> list[str]:
    """A minimal good CSV file as lines."""
    head = "time,r_x_km,r_y_km,r_z_km,mag_x_nT,mag_y_nT,mag_z_nT,q_x,q_y,q_z,q_w"
    return [head] + [f"1978-07-24T06:{k:02d}:00Z,7168.1,0,{k},1e4,-2e4,3.5e4,0,0,0,1" for k in range(rows)]


def save(folder: Path, lines: list[str], name: str = "t.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    return path


def assert_same(one: Telemetry, other: Telemetry) -> None:
    for item in dataclasses.fields(Telemetry):
        a, b = getattr(one, item.name), getattr(other, item.name)
        if item.name in ("provenance", "driver_units", "origin") or (a is None and b is None):
            continue
        if item.name in ("flags", "drivers"):
            assert {k: v.tobytes() for k, v in a.items()} == {k: v.tobytes() for k, v in b.items()}
        elif item.name == "rate_B_rad_s":  # kept in deg/s in files
            assert np.allclose(a, b, rtol=4e-16, atol=0)
        else:
            assert np.array_equal(a, b, equal_nan=item.name != "time"), item.name
            if item.name != "time":
                assert np.array_equal(np.signbit(a[~np.isnan(a)]), np.signbit(b[~np.isnan(b)])), item.name


@pytest.mark.parametrize("name", KINDS)
def test_a_record_with_every_column_reads_back_bit_equal(tmp_path: Path, name: str) -> None:
    record = full_record()
    back = read_telemetry(write_telemetry(record, tmp_path / name))
    assert_same(record, back)
    assert back.provenance["source"] == name
    assert len(back.provenance["sha256"]) == 64
    (said,) = (one for one in back.provenance["notices"].split("; ") if one.startswith("missing of 40 rows: "))
    assert "mag_x_nT ... in 1," in said and f"driver_payload in {np.isnan(record.drivers['payload']).sum()}" in said
    assert back.driver_units == ({"payload": "A"} if name == "a.nc" else {})  # a CSV has no place for a unit


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=15)
@given(
    st.lists(st.tuples(st.integers(1, 10**16), *6 * [st.floats(-1e9, 1e9) | st.just(np.nan)]), min_size=1, max_size=9),
)
def test_whatever_the_numbers_they_read_back_bit_equal(
    tmp_path: Path, name: str, rows: list[tuple[float, ...]]
) -> None:
    """Subnormal, a negative zero, missing, nanoseconds apart or four months."""
    time = START + np.cumsum([row[0] for row in rows]).astype("timedelta64[ns]")
    r_N_km, _ = ORBIT.propagate(time)
    both = np.array([row[1:] for row in rows])
    record = Telemetry(time, both[:, :3], r_N_km=r_N_km, mag2_B_nT=both[:, 3:])
    path = tmp_path / name
    path.unlink(missing_ok=True)
    assert_same(record, read_telemetry(write_telemetry(record, path)))


@pytest.mark.parametrize("name", KINDS)
def test_the_same_record_gives_the_same_bytes(tmp_path: Path, name: str) -> None:
    first = write_telemetry(full_record(), tmp_path / name).read_bytes()
    assert write_telemetry(full_record(), tmp_path / f"2{name}").read_bytes() == first


def test_csv_and_netcdf_agree(tmp_path: Path) -> None:
    record = full_record()
    a = read_telemetry(write_telemetry(record, tmp_path / "a.csv"))
    assert_same(a, read_telemetry(write_telemetry(a, tmp_path / "a.nc")))


def test_xarray_reads_our_netcdf_and_every_variable_is_packed_with_a_checksum(tmp_path: Path) -> None:
    record = full_record()
    path = write_telemetry(record, tmp_path / "a.nc")
    with xarray.open_dataset(path, engine="h5netcdf") as dataset:
        assert np.array_equal(dataset["time"].values.astype("datetime64[ns]"), record.time)
        assert np.array_equal(dataset["mag_x_nT"].values, record.mag_B_nT[:, 0], equal_nan=True)
        assert dataset["mag_x_nT"].attrs["units"] == "nT"
        assert np.array_equal(dataset["mag2_z_nT"].values, record.mag2_B_nT[:, 2], equal_nan=True)
        said = "reading of the second magnetometer, nominal body axes, z component"
        assert dataset["mag2_z_nT"].attrs == {"units": "nT", "long_name": said}
        assert dataset.attrs["Conventions"].startswith("CF-")
    with h5py.File(path) as opened:
        for name, variable in opened.items():
            assert variable.fletcher32, name
            assert variable.shuffle, name
            assert variable.compression == "gzip", name


def test_spellings_that_must_not_matter(tmp_path: Path) -> None:
    lines = plain_lines()
    plain = read_telemetry(save(tmp_path, lines))
    order = [4, 5, 6, 0, 1, 2, 3, 7, 8, 9, 10]
    turned = [",".join(line.split(",")[k] for k in order) for line in lines]
    variants = {
        "bom": b"\xef\xbb\xbf" + "\n".join([*lines, ""]).encode(),
        "crlf": "\r\n".join([*lines, ""]).encode(),
        "order": "\n".join([*turned, ""]).encode(),
        "no_z": "\n".join([*lines, ""]).replace(":00Z", ":00").encode(),
        "offset": "\n".join([*lines, ""]).replace(":00Z", ":00.000+00:00").encode(),
        "blank_for_t": "\n".join([*lines, ""]).replace("T06", " 06").encode(),
    }
    for name, content in variants.items():
        path = tmp_path / f"{name}.csv"
        path.write_bytes(content)
        read = read_telemetry(path)
        assert np.array_equal(read.time, plain.time), name
        assert np.array_equal(read.mag_B_nT, plain.mag_B_nT), name
    packed = tmp_path / "p.csv.gz"
    packed.write_bytes(gzip.compress("\n".join([*lines, ""]).encode()))
    assert np.array_equal(read_telemetry(packed).mag_B_nT, plain.mag_B_nT)


def test_a_last_row_without_line_end_is_left_out_with_a_notice(tmp_path: Path) -> None:
    path = tmp_path / "cut.csv"
    path.write_text("\n".join(plain_lines())[:-3], encoding="utf-8")
    read = read_telemetry(path)
    assert len(read) == 3
    assert "last row has no line end" in read.provenance["notices"]


@pytest.mark.parametrize("form", ["{0} {1} UTC", '"{0}T{1},000"', "{0}T{2}Z", "{0} {1}.000+0000", "{0}T{1}UTC"])
def test_usual_forms_of_iso_stamps_are_read(tmp_path: Path, form: str) -> None:
    """As databases and spreadsheets write them: UTC in letters, a decimal comma, no seconds."""
    lines = plain_lines()
    stamps = [form.format(*(stamp := line[:19].split("T")), stamp[1][:5]) for line in lines[1:]]
    other = [lines[0], *(stamp + line[20:] for stamp, line in zip(stamps, lines[1:], strict=True))]
    assert np.array_equal(read_telemetry(save(tmp_path, other)).time, read_telemetry(save(tmp_path, lines)).time)


def test_unknown_columns_are_left_out_with_a_notice(tmp_path: Path) -> None:
    lines = [f"{line},{extra}" for line, extra in zip(plain_lines(), ["mood", "a", "b", "c", "d"], strict=True)]
    assert (
        "left out (a column map reads them, or call one driver_NAME to test its field): mood"
        in read_telemetry(save(tmp_path, lines)).provenance["notices"]
    )


@pytest.mark.parametrize(("unit", "factor"), [("nT", 1.0), ("mG", 100.0), ("uT", 1e3), ("T", 1e9)])
def test_units_of_the_magnetometer(tmp_path: Path, unit: str, factor: float) -> None:
    second = [f",mag2_x_{unit},mag2_y_{unit},mag2_z_{unit}", *4 * [",1e4,,3"]]
    lines = [line + more for line, more in zip(plain_lines(), second, strict=True)]
    lines[0] = lines[0].replace("_nT", f"_{unit}")
    record = read_telemetry(save(tmp_path, lines))
    assert np.array_equal(record.mag_B_nT[0], np.array([1e4, -2e4, 3.5e4]) * factor)
    assert np.array_equal(record.mag2_B_nT[0], np.array([1e4, np.nan, 3.0]) * factor, equal_nan=True)


def test_four_positions_of_a_piece_are_enough_for_a_velocity(close: Callable[..., None]) -> None:
    """A cubic through four has the derivative of the cubic that they lie on; a gap parts them from three others."""
    t = np.array([0.0, 10.0, 25.0, 40.0, 5000.0, 5010.0, 5020.0])
    found = velocity_from_positions(START + (1e9 * t).astype("timedelta64[ns]"), np.outer(t**3, [1e-3, 0.0, -2e-3]))
    close(found[:4], np.outer(3.0 * t[:4] ** 2, [1e-3, 0.0, -2e-3]), atol=1e-9, unit="km/s", because="rounding")
    assert np.isnan(found[4:]).all()


def test_earth_fixed_positions_and_orbital_angles(tmp_path: Path, close: Callable[..., None]) -> None:
    time = START + np.arange(200) * np.timedelta64(30, "s")
    r, v = ORBIT.propagate(time)
    angles = np.array([0.3, -0.1, 0.05])
    truth = frames.q_from_rotation(frames.rotation_BO(*np.tile(angles, (200, 1)).T) * frames.rotation_ON(r, v))
    ecef = frames.rotation_EN(time).apply(r)
    head = "time,ecef_x_km,ecef_y_km,ecef_z_km,mag_x_nT,mag_y_nT,mag_z_nT,yaw_deg,roll_deg,pitch_deg"
    rows = [
        ",".join([str(t), *(repr(float(x)) for x in e), "1", "2", "3", *(repr(float(a)) for a in np.degrees(angles))])
        for t, e in zip(time, ecef, strict=True)
    ]
    read = read_telemetry(save(tmp_path, [head, *rows]))
    close(read.r_N_km, r, atol=1e-9, unit="km", because="rounding of one rotation there and back")
    angle = (frames.rotation_from_q(read.q_NB) * frames.rotation_from_q(truth).inv()).magnitude()
    close(angle[3:-3], 0.0, atol=1e-5, unit="rad", because="cubic spline of 30 s samples: (n h)^4/24 of the velocity")
    assert "differentiating the positions" in read.provenance["notices"]


FAULTS: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "missing column": (lambda x: [s.replace("mag_y_nT", "other") for s in x], "column mag_y_nT is missing"),
    "no magnetometer": (lambda x: [s.replace("mag_", "b_") for s in x], "column mag_x_nT is missing"),
    "no time": (lambda x: [s.replace("time", "when") for s in x], "column time is missing"),
    "no unit": (lambda x: [s.replace("mag_x_nT", "mag_x") for s in x], "column mag_x_nT is missing"),
    "no unit at all": (lambda x: [s.replace("_nT", "") for s in x], "mag_x has no unit in its name. Wanted: mag_x_nT"),
    "no unit for position": (lambda x: [s.replace("_km", "") for s in x], "r_x has no unit in its name. Wanted: r_x_"),
    "other unit": (lambda x: [s.replace("_nT", "_gauss") for s in x], "mag_x_gauss has a unit that is not accepted"),
    "two units": (lambda x: [s.replace("mag_x_nT", "mag_x_mG") for s in x], "components in different units"),
    "part of a second": (
        lambda x: [x[0] + ",mag2_x_nT,mag2_z_nT", *(s + ",1,2" for s in x[1:])],
        "column mag2_y_nT is missing",
    ),
    "no unit for a second": (
        lambda x: [x[0] + ",mag2_x", *(s + ",1" for s in x[1:])],
        "mag2_x has no unit in its name",
    ),
    "time not increasing": (lambda x: [x[0], x[2], x[1], *x[3:]], "time does not increase: row 1 is"),
    "time repeated": (lambda x: [*x, x[-1]], "time does not increase"),
    "bad time": (lambda x: [s.replace("06:02:00Z", "noon") for s in x], "time in row 3 is '1978-07-24Tnoon'"),
    "leap second": (lambda x: [s.replace("06:02:00Z", "06:02:60Z") for s in x], "leap second"),
    "other zone": (lambda x: [s.replace("06:02:00Z", "06:02:00 CET") for s in x], "time in row 3"),
    "no such zone": (lambda x: [s.replace("06:02:00Z", "06:02:00+99:99") for s in x], "time in row 3"),
    "no such day": (lambda x: [s.replace("07-24T06:02", "02-29T06:02") for s in x], "time in row 3"),
    "blank time": (lambda x: [s.replace("1978-07-24T06:02:00Z", "") for s in x], "time is missing in row 3"),
    "a title": (
        lambda x: ["MYSAT,pass 12" + "," * (x[0].count(",") - 1), *x],
        "has no header: its first line names 2 of 11 columns (MYSAT, pass 12)",
    ),
    "no header": (lambda x: x[1:], "has no header: its first line is a row of numbers"),
    "no rows": (lambda x: x[:1], "there are no rows"),
    "short row": (lambda x: [*x[:2], x[2].rsplit(",", 1)[0], *x[3:]], "row 2 has 10 fields, the header has 11"),
    "every row too long": (lambda x: [x[0], *(s + ",1" for s in x[1:])], "row 1 has 12 fields"),
    "blank row": (lambda x: [*x[:2], "", *x[2:]], "row 2 is blank"),
    "doubled column": (lambda x: [s.replace("r_y_km", "r_x_km") for s in x], "column r_x_km is there twice"),
    "text for a number": (lambda x: [s.replace(",2,1e4", ",2,#REF!") for s in x], "mag_x_nT in row 3 is '#REF!'"),
    "hexadecimal": (lambda x: [s.replace(",2,1e4", ",2,0x10") for s in x], "is '0x10', which is no number"),
    "infinite": (lambda x: [s.replace(",2,1e4", ",2,1e400") for s in x], "mag_x_nT in row 3 is infinite"),
    "semicolons and thousands": (
        lambda x: [s.replace(",", ";").replace("7168.1", "7.168,1") for s in x],
        "line 2 has '7.168,'",
    ),
    "semicolons and words": (
        lambda x: [s.replace(",", ";").replace("7168.1", "near, 7168.1") for s in x],
        "line 2 has ",
    ),
    "semicolons and quotes": (
        lambda x: [s.replace(",", ";").replace("7168.1", '"7168.1"') for s in x],
        "it has quotes",
    ),
    "a row of units": (lambda x: [x[0], "UTC" + ",km" * x[0].count(","), *x[1:]], "a file without that row"),
    "Unix time": (lambda x: [x[0], "1770696000" + x[1][x[1].index(",") :], *x[2:]], "`fluxtwin map` drafts one"),
    "no such year": (lambda x: [s.replace("1978-", "1826-") for s in x], "of a day that exists and a year from 1900"),
    "metres": (lambda x: [s.replace("7168.1", "7168100.0") for s in x], "positions look like metres"),
    "zero quaternion": (
        lambda x: [s.replace(",2,1e4,-2e4,3.5e4,0,0,0,1", ",2,1,1,1,0,0,0,0") for s in x],
        "in row 3 has norm 0 (1 such row). Wanted: unit quaternions, norm 1 within 0.001 (0.02 in",
    ),
    "long quaternion": (lambda x: [s.replace(",0,0,0,1", ",0,0,0,1.01") for s in x], "in row 1 has norm 1.01"),
    "flag of 2": (lambda x: [x[0] + ",sunlit", *(s + ",2" for s in x[1:])], "sunlit is 2 in row 1"),
    "NUL": (lambda x: [s.replace(",2,1e4", ",2,1\0") for s in x], "NUL byte in line 4"),
    "two frames": (lambda x: [x[0] + ",ecef_x_km,ecef_y_km,ecef_z_km", *(s + ",1,1,1" for s in x[1:])], "both r_x_km"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_csv_gets_one_message_that_names_file_and_place(tmp_path: Path, fault: str) -> None:
    change, said = FAULTS[fault]
    path = save(tmp_path, change(plain_lines()))
    with pytest.raises(BadInput) as caught:
        read_telemetry(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mark", [";", "\t", "|"])
def test_other_marks_between_columns_and_decimal_commas_are_read_and_said(tmp_path: Path, mark: str) -> None:
    """As spreadsheets of half the world write them, their own first line included."""
    plain = read_telemetry(save(tmp_path, plain_lines()))
    other = [line.replace(",", mark).replace(".", ",") for line in plain_lines()]
    for lines in (other, [f"sep={mark}", *other]):
        found = read_telemetry(save(tmp_path, lines))
        assert np.array_equal(found.mag_B_nT, plain.mag_B_nT) and np.array_equal(found.r_N_km, plain.r_N_km)
        assert "decimals by commas" in found.provenance["notices"]
    points = read_telemetry(save(tmp_path, [line.replace(",", mark) for line in plain_lines()]))
    assert np.array_equal(points.mag_B_nT, plain.mag_B_nT) and "decimals" not in points.provenance["notices"]


@pytest.mark.parametrize("name", ["a.dat", "a.txt"])
def test_columns_between_blanks_are_read_and_said(tmp_path: Path, name: str) -> None:
    """As Fortran and MATLAB write them, in columns that line up, and as numpy.savetxt does by default."""
    plain = read_telemetry(save(tmp_path, plain_lines()))
    cells = [line.split(",") for line in plain_lines()]
    aligned = ["  " + "   ".join(f"{cell:>24}" for cell in row) + " " for row in cells]
    for lines in (aligned, ["# a title", "# " + " ".join(cells[0]), *map(" ".join, cells[1:])]):
        found = read_telemetry(save(tmp_path, lines, name))
        assert np.array_equal(found.mag_B_nT, plain.mag_B_nT) and np.array_equal(found.r_N_km, plain.r_N_km)
        assert "separated by blanks" in found.provenance["notices"]
    (tmp_path / name).write_text("\n".join(aligned)[:-60], encoding="utf-8")
    cut = read_telemetry(tmp_path / name)
    assert len(cut) == len(plain) - 1 and "no line end" in cut.provenance["notices"]
    stamps = [line.replace("Z ", " UTC ") for line in aligned]
    with pytest.raises(BadInput, match=r"line 2 has 12 words, the header 11\. Wanted: the header first"):
        read_telemetry(save(tmp_path, stamps, name))


def test_empty_columns_of_a_spreadsheet_are_passed_over(tmp_path: Path) -> None:
    plain = read_telemetry(save(tmp_path, plain_lines()))
    found = read_telemetry(save(tmp_path, [line.replace(",", ";") + ";;" for line in plain_lines()]))
    assert np.array_equal(found.mag_B_nT, plain.mag_B_nT) and np.array_equal(found.r_N_km, plain.r_N_km)


@pytest.mark.parametrize("mark", [",", ";"])
def test_comments_above_the_header_are_passed_over(tmp_path: Path, mark: str) -> None:
    """With or without marks of columns in them; numpy.savetxt makes a comment of the header itself."""
    plain = read_telemetry(save(tmp_path, plain_lines()))
    lines = [line.replace(",", mark) for line in plain_lines()]
    for head, said in ((["# a title", "# field: nT; axes, body"], "2 lines above"), (["# one, two"], "1 line above")):
        found = read_telemetry(save(tmp_path, [*head, *lines]))
        assert np.array_equal(found.mag_B_nT, plain.mag_B_nT) and said in found.provenance["notices"]
    found = read_telemetry(save(tmp_path, ["# a title", "# " + lines[0], *lines[1:]]))
    assert np.array_equal(found.mag_B_nT, plain.mag_B_nT) and "1 line above" in found.provenance["notices"]
    with pytest.raises(BadInput, match="there are no rows"):
        read_telemetry(save(tmp_path, ["# a title", lines[0]]))


def test_commas_beside_decimal_points_are_not_guessed(tmp_path: Path) -> None:
    """1,234 in a table that has 0.5 as well: a thousand and more, or one and a bit."""
    head, *rows = plain_lines()
    column = head.split(",").index("mag_x_nT")
    lines = [head.replace(",", ";")]
    for row in rows:
        cells = row.split(",")
        cells[column] = "18,123"
        lines.append(";".join(cells))
    with pytest.raises(
        BadInput, match=r"separated by semicolons, there are commas in cells, and line 2 has '-?\d+\.\d+'"
    ):
        read_telemetry(save(tmp_path, lines))


def test_bad_bytes_get_one_message(tmp_path: Path) -> None:
    text = "\n".join([*plain_lines(), ""])
    cases = {
        "utf16": (text.encode("utf-16"), "UTF-16"),
        "latin": (text.replace("mag_x_nT", "mag_x_nT,é").encode("latin-1"), "latin-1"),
        "cr": (text.replace("\n", "\r\r\n", 1).encode(), "bare carriage return"),
        "empty": (b"", "the file is empty"),
        "gz": (gzip.compress(text.encode())[:-20], "gzip data are damaged"),
        "bomb": (gzip.compress((b"1" * 99_999 + b"\n") * 1100), "unpacks to 1.* MB or more, from 0.1"),
        "line": (b"," * 3_000_000, "line 1 is longer than"),
    }
    for name, (content, said) in cases.items():
        path = tmp_path / f"{name}.csv"
        path.write_bytes(content)
        with pytest.raises(BadInput, match=said):
            read_telemetry(path)


def test_missing_folder_and_unknown_kinds(tmp_path: Path) -> None:
    for path, said in (
        (tmp_path / "absent.csv", "there is no such file"),
        (tmp_path / "absent.nc", "there is no such file"),
        (tmp_path, "is a folder"),
        (tmp_path / "a.log", "not known from its name"),
        (tmp_path / "a.mat", "writetable makes a .csv"),
    ):
        with pytest.raises(BadInput, match=said):
            read_telemetry(path)


def test_what_is_no_record_is_not_written(tmp_path: Path) -> None:
    """As the pair that `simulate` returns."""
    both: Any = (full_record(), None)
    with pytest.raises(BadInput, match="an object of type tuple was given"):
        write_telemetry(both, tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.csv", "a.nc"])
def test_more_rows_than_allowed_are_refused_before_they_are_read(tmp_path: Path, name: str) -> None:
    path = write_telemetry(full_record(), tmp_path / name)
    with pytest.raises(BadInput, match="at most 39"):
        read_telemetry(path, max_samples=39)
    assert len(read_telemetry(path, max_samples=40)) == 40


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.nc"])
def test_a_failure_while_writing_leaves_the_old_file(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_telemetry(full_record(), tmp_path / name)
    old = path.read_bytes()

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("power lost")

    monkeypatch.setattr(telemetry_csv, "_write_rows", fail)
    monkeypatch.setattr(h5netcdf.File, "create_variable", fail)
    with pytest.raises(RuntimeError):
        write_telemetry(full_record(20), path)
    assert path.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_one_flipped_bit_in_a_netcdf_file_is_refused_or_harmless(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    content = bytearray(write_telemetry(small_record(300), tmp_path / "a.nc").read_bytes())
    original = read_telemetry(tmp_path / "a.nc")
    rng = stream(5, "bits")
    path, messages = tmp_path / "b.nc", []
    for place in rng.integers(0, len(content) * 8, 250):
        content[place // 8] ^= 1 << (place % 8)
        path.write_bytes(content)
        content[place // 8] ^= 1 << (place % 8)
        try:
            assert_same(read_telemetry(path), original)
        except BadInput as error:
            messages.append(str(error))
    assert len(messages) > 125
    assert [text for text in messages if str(path) not in text] == []
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["a.csv", "a.nc"])
def test_mutated_files_give_bad_input_or_a_record(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    content = write_telemetry(small_record(40), tmp_path / name).read_bytes()
    rng = stream(6, name)
    path, messages = tmp_path / f"m{name}", []
    for trial in range(300):
        path.write_bytes(mutated(content, rng, trial % 5))
        try:
            read_telemetry(path)
        except BadInput as error:
            messages.append(str(error))
    assert len(messages) > 100
    assert [text for text in messages if str(path) not in text] == []
    assert capfd.readouterr().err == ""


def mutated(content: bytes, rng: np.random.Generator, kind: int) -> bytes:
    data = bytearray(content)
    if kind == 0:  # a few random bytes
        for place in rng.integers(0, len(data), 5):
            data[place] = int(rng.integers(0, 256))
    elif kind == 1:  # truncated
        del data[int(rng.integers(0, len(data))) :]
    elif kind == 2:  # a piece repeated elsewhere
        start = int(rng.integers(0, len(data)))
        data[int(rng.integers(0, len(data))) :] += data[start : start + 100]
    elif kind == 3:  # a piece gone
        start = int(rng.integers(0, len(data)))
        del data[start : start + int(rng.integers(1, 50))]
    else:  # damage near the start, where the structure is
        for place in rng.integers(0, min(len(data), 4000), 3):
            data[place] = int(rng.integers(0, 256))
    return bytes(data)


def test_netcdf_that_points_elsewhere_or_claims_too_much_is_refused(tmp_path: Path) -> None:
    good = write_telemetry(full_record(), tmp_path / "good.nc")

    def variant(name: str, change: Callable[[h5py.File], None]) -> Path:
        path = tmp_path / name
        path.write_bytes(good.read_bytes())
        with h5py.File(path, "r+") as opened:
            change(opened)
        return path

    def external_link(opened: h5py.File) -> None:
        del opened["mag_x_nT"]
        opened["mag_x_nT"] = h5py.ExternalLink("good.nc", "/mag_x_nT")

    def soft_link(opened: h5py.File) -> None:
        del opened["mag_x_nT"]
        opened["mag_x_nT"] = h5py.SoftLink("/mag_y_nT")

    def external_storage(opened: h5py.File) -> None:
        del opened["mag_x_nT"]
        opened.create_dataset("mag_x_nT", shape=(40,), dtype="f8", external=[("good.nc", 0, 320)])

    def text(opened: h5py.File) -> None:
        del opened["mag_x_nT"]
        opened["mag_x_nT"] = np.array([b"1.0"] * 40)

    def huge(opened: h5py.File) -> None:
        del opened["mag_x_nT"]
        opened.create_dataset("mag_x_nT", shape=(10**13,), dtype="f8", chunks=(1000,))

    def shorter(opened: h5py.File) -> None:
        del opened["mag_x_nT"], opened.attrs["fluxtwin_sha256"]
        opened["mag_x_nT"] = np.zeros(39)

    def changed(opened: h5py.File) -> None:
        opened["mag_x_nT"][3] = 1.0

    def attribute(opened: h5py.File) -> None:
        opened["mag_x_nT"].attrs["units"] = "mG"

    def no_units(opened: h5py.File) -> None:
        del opened.attrs["fluxtwin_sha256"]
        opened["time"].attrs["units"] = "fortnights since the flood"

    for change, said in (
        (external_link, "link to another place"),
        (soft_link, "link to another place"),
        (external_storage, "stored in another file"),
        (text, "has the type"),
        (huge, "claims 10000000000000 rows"),
        (shorter, r"has the shape \(39,\)"),
        (changed, "SHA-256"),
        (attribute, "SHA-256"),
        (no_units, "the unit of time is"),
    ):
        path = variant(f"{change.__name__}.nc", change)
        with pytest.raises(BadInput, match=said):
            read_telemetry(path)


def test_a_foreign_netcdf_of_the_contract_without_digest_is_read_with_a_notice(tmp_path: Path) -> None:
    record = full_record()
    names = ["mag_x_nT", "mag_y_nT", "mag_z_nT"]
    stamps = record.time.astype("datetime64[ms]").astype("datetime64[ns]")
    data = {name: ("time", np.nan_to_num(record.mag_B_nT[:, k])) for k, name in enumerate(names)}
    dataset = xarray.Dataset(data, coords={"time": stamps})
    path = tmp_path / "foreign.nc"
    dataset.to_netcdf(
        path, engine="h5netcdf", encoding={"mag_x_nT": {"dtype": "i4", "scale_factor": 0.5, "_FillValue": -9}}
    )
    read = read_telemetry(path)
    assert np.array_equal(read.time, stamps)
    assert np.allclose(read.mag_B_nT, np.nan_to_num(record.mag_B_nT), atol=0.25)
    assert "no digest" in read.provenance["notices"]


def test_a_netcdf_3_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "old.nc"
    path.write_bytes(b"CDF\x01" + bytes(200))
    with pytest.raises(BadInput, match="not a NetCDF-4 file"):
        telemetry_netcdf.read_table(path)


def test_two_line_elements_give_the_position_a_file_lacks(tmp_path: Path) -> None:
    line1 = "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927"
    line2 = "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537"
    (tmp_path / "iss.tle").write_text(f"{line1}\n{line2}\n", encoding="utf-8")
    lines = [",".join(line.split(",")[:1] + line.split(",")[4:7]) for line in plain_lines()]
    lines = [line.replace("1978-07-24", "2008-09-20") for line in lines]
    read = read_telemetry(save(tmp_path, lines), tle=tmp_path / "iss.tle")
    assert read.r_N_km is not None
    assert np.all(np.abs(np.linalg.norm(read.r_N_km, axis=1) - 6730.0) < 30.0)
    assert "elements in iss.tle" in read.provenance["notices"]


def test_records_with_other_drivers_join_unless_their_units_differ() -> None:
    record = full_record()
    first, second = record.select(slice(0, 15)), record.select(slice(15, None))
    assert_same(concatenate([first, second]), record)
    bare = second.replace(drivers={"heater": second.drivers["2"]})
    joined = concatenate([bare, first])
    assert sorted(joined.drivers) == ["2", "heater", "payload"]
    assert np.isnan(joined.drivers["heater"][:15]).all()
    assert np.isfinite(joined.drivers["heater"][15:]).all()
    assert joined.driver_units == {"payload": "A"}
    with pytest.raises(BadInput, match=r"driver_payload: is in A in one record, in mA in another"):
        concatenate([first, second.replace(driver_units={"payload": "mA"})])


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 1.0])
def test_numbers_and_blanks_of_a_csv_are_those_of_another_parser(tmp_path: Path, share: float) -> None:
    """Python's, to the bit: blanks at both ends of a row and side by side, every form of a number."""
    rng, forms = np.random.default_rng(1), (repr, "{:.3e}".format, "{:+.17g}".format, "{:.0f}".format, " {:f} ".format)
    rows = [[forms[rng.integers(len(forms))](v) for v in row.tolist()] for row in rng.normal(0.0, 1e5, (60, 4))]
    rows = [["" if rng.random() < share else cell for cell in row] for row in rows]
    path = save(tmp_path, ["a,b,c,d", *map(",".join, rows)])
    found = telemetry_csv.open_csv(path).numbers(["d", "a", "c"])
    for name, values in found.items():
        witness = [float(row["abcd".index(name)] or "nan") for row in rows]
        assert np.array_equal(values, witness, equal_nan=True)


TRUTHS = """time,mag_x_nT,mag_y_nT,mag_z_nT,sunlit,flag_ok
2026-03-01T00:00:00Z,20000,2,3,true,TRUE
2026-03-01T00:00:10Z,20001,2,3,,False
2026-03-01T00:00:20Z,20002,2,3,false,True
"""


@pytest.mark.parametrize("quote", ["", '"'])
def test_true_and_false_are_one_and_zero_where_a_column_has_nothing_else(tmp_path: Path, quote: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(TRUTHS.replace("2026-03-01T00:00:00Z", f"{quote}2026-03-01T00:00:00Z{quote}"), encoding="utf-8")
    found = read_telemetry(path)
    assert np.array_equal(found.sunlit, [1, np.nan, 0], equal_nan=True)
    assert list(found.flags["ok"]) == [1, 0, 1]
    path.write_text(TRUTHS.replace("20001", f"{quote}true{quote}"), encoding="utf-8")
    with pytest.raises(BadInput, match="mag_x_nT in row 2 is 'true', which is no number"):
        read_telemetry(path)


def test_blanks_of_a_sun_sensor_in_shadow_are_not_missing(tmp_path: Path) -> None:
    head = "time,mag_x_nT,mag_y_nT,mag_z_nT,sunlit,sun_x,sun_y,sun_z\n"
    rows = ["2026-03-01T00:00:00Z,1,2,3,1,0,0,1", "2026-03-01T00:00:10Z,1,2,3,0,,,"]
    for extra, said in (("", None), ("\n2026-03-01T00:00:20Z,1,2,3,1,,,", "sun_x ... is missing in 1 of 3 rows")):
        (tmp_path / "t.csv").write_text(head + "\n".join(rows) + extra + "\n", encoding="utf-8")
        assert read_telemetry(tmp_path / "t.csv").provenance.get("notices") == said


def test_no_file_that_a_record_was_read_from_is_written_over(tmp_path: Path) -> None:
    """Neither one of several that were joined, nor what a map names, nor the orbit; through links too."""
    rows = small_record(40)
    first, second = write_telemetry(rows[:20], tmp_path / "a.csv"), write_telemetry(rows[20:], tmp_path / "b.nc")
    orbit = write_telemetry(rows, tmp_path / "o.oem")
    joined = concatenate([read_telemetry(first), read_telemetry(second, tle=orbit)])
    columns = '[file.columns]\nmag = { from = ["mag_x_nT", "mag_y_nT", "mag_z_nT"], unit = "nT" }\n'
    plan = f'tle = "o.oem"\n[[file]]\npath = "a.csv"\ntime = {{ recipe = "iso", columns = "time" }}\n{columns}'
    (tmp_path / "m.toml").write_text(plan, encoding="utf-8")
    mapped = read_telemetry(tmp_path, column_map=tmp_path / "m.toml")
    (tmp_path / "link.nc").symlink_to(second)
    before = {path: path.read_bytes() for path in (first, second, orbit)}
    for record, path in ((joined, first), (joined, second), (joined, orbit), (joined, tmp_path / "link.nc")):
        with pytest.raises(BadInput, match="this record was read from it"):
            write_telemetry(record, path)
    for path in (first, orbit):
        with pytest.raises(BadInput, match="this record was read from it"):
            write_telemetry(mapped, path)
    assert before == {path: path.read_bytes() for path in before}
    write_telemetry(mapped, second)
