"""Formats besides CSV and NetCDF: what others wrote is read, what we write others read, and numbers come back."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation
from worlds import scenario_text

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.telemetry.formats import ccsds, cdf

pytestmark = pytest.mark.reference

# The examples of the blue books: CCSDS 504.0-B-1 (figure 4-2) and 502.0-B-2 (figure 5-1), the latter about the Earth here.
AEM = """CCSDS_AEM_VERS = 1.0
CREATION_DATE = 2002-11-04T17:22:31
ORIGINATOR = NASA/JPL
META_START
COMMENT This file was produced by M.R. Somebody, MSOO NAV/JPL, 2002 OCT 04.
OBJECT_NAME = MARS GLOBAL SURVEYOR
OBJECT_ID = 1996-062A
CENTER_NAME = EARTH
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = UTC
START_TIME = 1996-11-28T21:29:07.2555
STOP_TIME = 1996-11-30T01:28:02.5555
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = LAST
INTERPOLATION = hermite
INTERPOLATION_DEGREE = 7
META_STOP
DATA_START
1996-11-28T21:29:07.2555 0.56748 0.03146 0.45689 0.68427
1996-11-28T22:08:03.5555 0.42319 -0.45697 0.23784 0.74533
1996-11-28T22:08:04.5555 -0.84532 0.26974 -0.06532 0.45652
DATA_STOP
"""
OEM = """CCSDS_OEM_VERS = 2.0
CREATION_DATE = 1996-11-04T17:22:31
ORIGINATOR = NASA/JPL
META_START
OBJECT_NAME = MARS GLOBAL SURVEYOR
OBJECT_ID = 1996-062A
CENTER_NAME = EARTH
REF_FRAME = EME2000
TIME_SYSTEM = UTC
START_TIME = 1996-12-18T12:00:00.331
STOP_TIME = 1996-12-28T21:28:00.331
META_STOP
COMMENT This file was produced by M.R. Somebody
1996-12-18T12:00:00.331 2789.619 -280.045 -1746.755 4.73372 -2.49586 -1.04195
1996-12-18T12:01:00.331 2783.419 -308.143 -1877.071 5.18604 -2.42124 -1.99608
1996-353T12:02:00.331 2776.033 -336.859 -2008.682 5.63678 -2.33951 -1.94687
COVARIANCE_START
EPOCH = 1996-12-28T21:29:07.267
COV_REF_FRAME = EME2000
3.3313494e-04
4.6189273e-04 6.7824216e-04
COVARIANCE_STOP
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> fluxtwin.Telemetry:
    places = "[[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [1.5, 0.0, 0.0]]"
    sensors = f"\n[magnetometer]\nnoise_nT = 20.0\n[torquers]\ndipole_Am2 = 5.0\npositions_m = {places}\n"
    path = tmp_path_factory.mktemp("formats") / "s.toml"
    path.write_text(scenario_text(sensors, segment="samples = 60, step_s = 10.0"), encoding="utf-8")
    telemetry, _ = fluxtwin.simulate(path)
    q = np.array(telemetry.q_NB)
    q[7] = np.nan
    driver = {"payload": np.linspace(0.0, 1.0, len(telemetry))}
    return telemetry.replace(
        q_NB=q, drivers=driver, driver_units={"payload": "A"}, flags={"safe": np.ones(len(telemetry))}
    )


def same(one: fluxtwin.Telemetry, other: fluxtwin.Telemetry, relative: float = 0.0) -> None:
    assert np.array_equal(one.time, other.time)
    for name in ("mag_B_nT", "r_N_km", "v_N_km_s", "q_NB", "dipole_B_Am2", "sunlit"):
        assert np.allclose(getattr(one, name), getattr(other, name), rtol=relative, atol=0.0, equal_nan=True), name
    assert np.allclose(one.drivers["payload"], other.drivers["payload"], rtol=relative, atol=0.0)
    assert np.array_equal(one.flags["safe"], other.flags["safe"])
    assert one.spacecraft == other.spacecraft


@pytest.fixture(params=[("openpyxl", ".xlsx"), ("pyarrow", ".parquet")], ids=[".xlsx", ".parquet"])
def ending(request: pytest.FixtureRequest) -> str:
    """Of a kind of file that an extra reads; pyarrow is large, and not installed with the tests."""
    needed, ending = request.param
    pytest.importorskip(needed, reason=f"the extra fluxtwin[{ending[1:]}] is not installed")
    return str(ending)


def test_a_record_comes_back_whole(record: fluxtwin.Telemetry, tmp_path: Path, ending: str) -> None:
    found = fluxtwin.read(fluxtwin.write(record, tmp_path / f"t{ending}"))
    assert "sheets was read" not in str(found.provenance)
    same(record, found, relative=1e-14 if ending == ".xlsx" else 0.0)  # a workbook has decimals, of 15 or 16 digits


def test_a_damaged_file_is_named(tmp_path: Path, ending: str) -> None:
    (tmp_path / f"t{ending}").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(BadInput, match="cannot be read as"):
        fluxtwin.read(tmp_path / f"t{ending}")


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (pd.DataFrame([[1, 2]], columns=["mag_x_nT"] * 2), "mag_x_nT is there twice"),
        (pd.DataFrame({"time": np.array(["2026", "2500"], dtype="datetime64[s]")}), "time in row 2 is 2500-01-01"),
        (pd.DataFrame({("time", "UTC"): [1], ("mag_x", "nT"): [2]}), "its columns have 2 levels of names"),
        (
            pd.DataFrame({"time": ["UTC", "2026-03-01"], "mag_x": ["nT", 3.0], "mode": [None, "safe"]}),
            "words where the others have numbers: UTC, nT. Wanted",
        ),
    ],
)
def test_a_frame_that_cannot_be_meant_is_refused(frame: pd.DataFrame, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        fluxtwin.read(frame)


def test_a_row_of_units_is_named_whatever_reads_it(record: fluxtwin.Telemetry, tmp_path: Path, ending: str) -> None:
    """As the CSV says it, to `read` and to `draft_map`."""
    frame = pd.read_csv(fluxtwin.write(record, tmp_path / "t.csv"), dtype=str)
    units = pd.DataFrame([{name: name.rpartition("_")[2] for name in frame}])
    path = tmp_path / f"t{ending}"
    getattr(pd.concat([units, frame]), {".xlsx": "to_excel", ".parquet": "to_parquet"}[ending])(path, index=False)
    for verb in (fluxtwin.read, fluxtwin.draft_map):
        with pytest.raises(
            BadInput, match="the row below the header has words where the others have numbers: time, km"
        ):
            verb(path)


def test_stamps_are_found_in_any_index_of_their_name(record: fluxtwin.Telemetry) -> None:
    frame = record.to_pandas()
    periods = frame.set_axis(frame.index.tz_localize(None).to_period("s").rename("time"))
    for given in (periods, frame.assign(spacecraft="A").set_index("spacecraft", append=True)):
        assert (fluxtwin.read(given).time == record.time).all()


def test_foreign_texts_stand_in_no_ones_way(record: fluxtwin.Telemetry) -> None:
    frame = record.to_pandas().assign(note="5 °C, naïve")
    frame.attrs["magnetometer"] = "fluxgate"
    found = fluxtwin.read(frame)
    same(record, found)
    assert found.magnetometer == 1


def test_the_blue_books_attitude(tmp_path: Path) -> None:
    path = tmp_path / "a.aem"
    path.write_text(AEM, encoding="utf-8")
    table = ccsds.read_aem(path)
    q = np.column_stack([table.numbers(f"q_{axis}") for axis in "xyzw"])
    assert list(q[0]) == [0.56748, 0.03146, 0.45689, 0.68427] and table.attributes["frame"] == "EME2000"
    assert str(table.times()[0]) == "1996-11-28T21:29:07.255500000"
    first = AEM.replace("TYPE = LAST", "TYPE = FIRST").replace(
        " 0.56748 0.03146 0.45689 0.68427", " 0.68427 0.56748 0.03146 0.45689"
    )
    flipped = AEM.replace("A2B", "B2A").replace("0.56748 0.03146 0.45689", "-0.56748 -0.03146 -0.45689")
    swapped = flipped.replace("FRAME_A = EME2000", "FRAME_A = X").replace("FRAME_B = SC_BODY_1", "FRAME_B = EME2000")
    for text in (first, flipped, swapped.replace("FRAME_A = X", "FRAME_A = SC_BODY_1").replace("B2A", "A2B")):
        path.write_text(text, encoding="utf-8")
        assert [ccsds.read_aem(path).numbers(f"q_{axis}")[0] for axis in "xyzw"] == list(q[0])


def test_an_attitude_from_a_file_of_its_own(record: fluxtwin.Telemetry, tmp_path: Path) -> None:
    """Relative to ITRS, twenty seconds apart, in TAI: brought to GCRS, to the stamps, to UTC."""
    R_BE = frames.rotation_from_q(np.array(record.q_NB)[::2][4:]) * frames.rotation_EN(record.time[::2][4:]).inv()
    rows = zip(
        np.datetime_as_string(record.time[::2][4:] + np.timedelta64(37, "s")), frames.q_from_rotation(R_BE), strict=True
    )
    text = AEM.replace("EME2000", "ITRF2000").replace("TIME_SYSTEM = UTC", "TIME_SYSTEM = TAI")
    text = text[: text.index("1996-11-28T21:29:07.2555 0")] + "\n".join(
        f"{t} {' '.join(map(repr, q.tolist()))}" for t, q in rows
    )
    (tmp_path / "a.aem").write_text(text + "\nDATA_STOP\n", encoding="utf-8")
    fluxtwin.write(record.replace(q_NB=None), tmp_path / "t.nc")
    found = fluxtwin.read(tmp_path / "t.nc", attitude=tmp_path / "a.aem")
    assert found.q_NB is not None and not found.has_attitude[:8].any() and found.has_attitude[8:59].all()
    off = frames.rotation_from_q(np.array(found.q_NB)[8:59]) * frames.rotation_from_q(np.array(record.q_NB)[8:59]).inv()
    assert off.magnitude().max() < 1e-5  # the slerp of a libration over 20 s
    assert "that of a.aem" in found.provenance["notices"]


def test_the_blue_books_orbit(tmp_path: Path) -> None:
    (tmp_path / "o.oem").write_text(OEM, encoding="utf-8")
    table = ccsds.read_oem(tmp_path / "o.oem")
    assert list(table.numbers("x")) == [2789.619, 2783.419, 2776.033] and table.numbers("vz")[2] == -1.94687
    assert str(table.times()[2]) == "1996-12-18T12:02:00.331000000", "353 is the day of the year"
    (tmp_path / "o.oem").write_text(OEM.replace("= EARTH", "= MARS BARYCENTER"), encoding="utf-8")
    with pytest.raises(BadInput, match="MARS BARYCENTER"):
        ccsds.read_oem(tmp_path / "o.oem")


def test_orbit_and_attitude_go_out_and_come_back(record: fluxtwin.Telemetry, tmp_path: Path) -> None:
    fluxtwin.write(record, tmp_path / "a.aem")
    fluxtwin.write(record, tmp_path / "o.oem")
    bare = record.replace(q_NB=None, r_N_km=None, v_N_km_s=None)
    found = fluxtwin.read(fluxtwin.write(bare, tmp_path / "t.nc"), tle=tmp_path / "o.oem", attitude=tmp_path / "a.aem")
    assert np.allclose(found.r_N_km, record.r_N_km, atol=1e-9) and np.allclose(
        found.v_N_km_s, record.v_N_km_s, atol=1e-12
    )
    known = record.has_attitude
    assert np.allclose(np.array(found.q_NB)[known], np.array(record.q_NB)[known], atol=1e-12)
    assert found.has_attitude[7], "the one that was missing is interpolated"
    (tmp_path / "a.aem").rename(tmp_path / "attitude.txt")
    (tmp_path / "o.oem").rename(tmp_path / "orbit.txt")
    other = fluxtwin.read(tmp_path / "t.nc", tle=tmp_path / "orbit.txt", attitude=tmp_path / "attitude.txt")
    same(other, found)  # whatever their names end in
    late = fluxtwin.read(tmp_path / "t.nc", tle=tmp_path / "orbit.txt", start=str(record.time[30]))
    assert late.has_position.all()
    with pytest.raises(BadInput, match="no row has attitude"):
        fluxtwin.write(bare, tmp_path / "none.aem")


def test_messages_go_through_another_reader_and_writer_and_come_back(
    record: fluxtwin.Telemetry, tmp_path: Path
) -> None:
    """The witness is the strict parser of ccsds-ndm-py: what we write it reads, and what it then writes we read."""
    ccsds_ndm = pytest.importorskip("ccsds_ndm")
    attitude = ccsds_ndm.Aem.from_file(str(fluxtwin.write(record, tmp_path / "a.aem")))
    orbit = ccsds_ndm.Oem.from_file(str(fluxtwin.write(record, tmp_path / "o.oem")))
    assert attitude.segments[0].metadata.ref_frame_a == "GCRF" and orbit.segments[0].metadata.time_system == "UTC"
    states = orbit.segments[0].data.state_vector
    theirs = [states[3].x, states[3].y, states[3].z]
    assert np.allclose(theirs, np.array(record.r_N_km)[3], atol=1e-9)
    for message, name in ((attitude, "theirs.aem"), (orbit, "theirs.oem")):
        lines = message.to_str("kvn").splitlines(keepends=True)
        (tmp_path / name).write_text("".join(line for line in lines if "SHA-256" not in line), encoding="utf-8")
    bare = fluxtwin.write(record.replace(q_NB=None, r_N_km=None, v_N_km_s=None), tmp_path / "t.nc")
    ours, found = (
        fluxtwin.read(bare, tle=tmp_path / f"{name}.oem", attitude=tmp_path / f"{other}.aem")
        for name, other in (("o", "a"), ("theirs", "theirs"))
    )
    assert np.allclose(found.r_N_km, ours.r_N_km, atol=1e-9) and np.allclose(found.v_N_km_s, ours.v_N_km_s, atol=1e-12)
    assert np.allclose(found.q_NB, ours.q_NB, atol=1e-12, equal_nan=True)


@pytest.mark.skipif(importlib.util.find_spec("brahe") is None, reason="brahe (200 MB with its polars) is not installed")
def test_what_we_write_is_what_brahe_reads(record: fluxtwin.Telemetry, tmp_path: Path) -> None:
    from brahe import ccsds  # type: ignore[import-not-found,unused-ignore]

    attitude = ccsds.AEM.from_file(str(fluxtwin.write(record, tmp_path / "a.aem")))
    states = attitude.segments[0].states
    orbit = ccsds.OEM.from_file(str(fluxtwin.write(record, tmp_path / "o.oem")))
    assert len(states) == len(record) - 1 and len(orbit.segments[0].states) == len(record)
    matrix = np.array(states[3].quaternion.to_rotation_matrix().to_matrix())
    expected = frames.rotation_from_q(np.array(record.q_NB)[3:4]).as_matrix()[0]
    assert np.allclose(matrix, expected, atol=1e-12), "components of N to those of B"
    assert np.allclose(np.array(orbit.segments[0].states[3].position) * 1e-3, np.array(record.r_N_km)[3], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (AEM.replace("CCSDS_AEM_VERS = 1.0\n", ""), "does not begin with CCSDS_AEM_VERS"),
        (AEM.replace("TIME_SYSTEM = UTC", "TIME_SYSTEM = MRT"), "TIME_SYSTEM is MRT"),
        (AEM.replace("= QUATERNION\n", "= SPIN\n"), "ATTITUDE_TYPE is SPIN"),
        (AEM.replace("EME2000", "LVLH_ROTATING"), "REF_FRAME_A"),
        (
            AEM + AEM[AEM.index("META_START") :].replace("EME2000", "ITRF2000"),
            "its segments are relative to EME2000, ITRS.*Wanted: one frame",
        ),
        (AEM.replace("SC_BODY_1", "EME2000"), "one of them the spacecraft"),
        (AEM.replace("A2B", "FORWARD"), "ATTITUDE_DIR is FORWARD"),
        (AEM.replace("= LAST", "= THIRD"), "QUATERNION_TYPE is THIRD"),
        (AEM.replace("1996-11-28T22:08:03.5555", "1996-367T22:08:03"), "no day of that year"),
        (AEM.replace("0.45689 0.68427", "0.45689"), "line 21.*at least 4"),
        (AEM.replace("0.56748", "abc"), "no row of numbers"),
        (AEM.replace("1996-11-28T22:08:03.5555", "yesterday"), "'yesterday' is not a time"),
        (AEM[: AEM.index("DATA_START")], "holds no rows"),
    ],
)
def test_a_broken_message_is_named(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.aem").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=said):
        ccsds.read_aem(tmp_path / "a.aem")


def test_cdf_as_missions_write_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Written by cdflib: CDF_EPOCH, a vector with a fill value, a scalar; read through a map."""
    cdflib = pytest.importorskip("cdflib")
    from cdflib.cdfwrite import CDF

    stamps = ["2014-05-02T12:00:00.000", "2014-05-02T12:00:01.000", "2014-05-02T12:00:02.500"]
    epochs = np.array([cdflib.cdfepoch.parse(text) for text in stamps]).reshape(-1)
    made = CDF(str(tmp_path / "s.cdf"), cdf_spec={"Compressed": 0})
    vector = np.array([[1e4, 2e4, 3e4], [-1e31, 2e4, 3e4], [4e4, 5e4, 6e4]], dtype=np.float32)

    def put(name: str, kind: int, dims: list[int], data: np.ndarray, **attributes: object) -> None:
        spec = {"Variable": name, "Data_Type": kind, "Num_Elements": 1, "Rec_Vary": True, "Dim_Sizes": dims}
        made.write_var(spec, var_attrs=attributes, var_data=data)

    put("Timestamp", 31, [], epochs)
    put("B_VFM", 44, [3], vector, UNITS="nT", FILLVAL=np.float32(-1e31))
    put("Latitude", 45, [], np.array([10.0, 11.0, 12.0]), UNITS="deg")
    made.close()
    claimed: list[int] = []
    monkeypatch.setattr(cdf, "require_expansion", lambda size, *_: claimed.append(size))
    table = cdf.read(tmp_path / "s.cdf")
    assert claimed == [24, 24 + 72, 24 + 72 + 24]  # eight bytes for each of three numbers, nine and three
    monkeypatch.undo()
    assert [str(t)[:23] for t in table.times()] == stamps
    assert np.isnan(table.numbers("B_VFM")[1, 0]) and table.units["B_VFM"] == "nT"
    (tmp_path / "m.toml").write_text(
        '[[file]]\ntime = { recipe = "cf" }\n[file.columns]\nmag = { from = "B_VFM", unit = "nT" }\n', encoding="utf-8"
    )
    found = fluxtwin.read(tmp_path / "s.cdf", column_map=tmp_path / "m.toml")
    assert list(found.has_reading) == [True, False, True] and found.mag_B_nT[2, 1] == 5e4
    assert "[[file]]" in fluxtwin.draft_map(tmp_path / "s.cdf")
    (tmp_path / "bad.cdf").write_bytes((tmp_path / "s.cdf").read_bytes()[:300])
    with pytest.raises(BadInput, match="cannot be read as CDF"):
        fluxtwin.read(tmp_path / "bad.cdf")


def test_a_run_of_42(record: fluxtwin.Telemetry, tmp_path: Path) -> None:
    """The files as 42report.c prints them; its qbn turns N into B by Wertz's matrix, scalar last."""
    since = (record.time - np.datetime64("2000-01-01T12:00:00")).astype("int64") * 1e-9 + 37.0 + 32.184
    q = np.where(np.isnan(record.q_NB), [0.0, 0.0, 0.0, 1.0], record.q_NB)

    def put(name: str, value: np.ndarray, form: str = "%.17e") -> None:
        np.savetxt(tmp_path / f"{name}.42", value, fmt=form)

    put("DynTime", since, "%.6f")
    put("PosN", np.array(record.r_N_km) * 1e3)
    put("VelN", np.array(record.v_N_km_s) * 1e3)
    put("qbn", q)
    put("MagBVB", np.hstack([np.zeros((len(record), 6)), np.array(record.mag_B_nT) * 1e-9]))
    found = fluxtwin.read(tmp_path)
    assert np.abs(found.time - record.time).max() <= np.timedelta64(1, "us")
    assert np.allclose(found.mag_B_nT, record.mag_B_nT, rtol=1e-12) and np.allclose(
        found.r_N_km, record.r_N_km, rtol=1e-12
    )
    assert np.allclose(found.q_NB, q, atol=1e-15)
    put("VelN", np.zeros((3, 3)))
    with pytest.raises(BadInput, match=r"VelN\.42 has 3 rows"):
        fluxtwin.read(tmp_path)


def test_frames_of_pandas_and_xarray_as_they_are(record: fluxtwin.Telemetry) -> None:
    dataset, frame = record.to_xarray(), record.to_pandas()
    for back in (fluxtwin.Telemetry.from_pandas(frame), fluxtwin.Telemetry.from_xarray(dataset)):
        same(record, back)
        for name in ("mag_B_nT", "r_N_km", "q_NB"):
            assert np.shares_memory(getattr(back, name), getattr(record, name)), f"{name} can be written to by nobody"
    turned = fluxtwin.Telemetry.from_pandas(frame.rename(columns={"mag_x_nT": "mag_y_nT", "mag_y_nT": "mag_x_nT"}))
    assert np.array_equal(turned.mag_B_nT, record.mag_B_nT[:, [1, 0, 2]])
    assert np.shares_memory(dataset["mag_B_nT"].values, record.mag_B_nT), "not copied"
    column = record.to_pandas()["mag_y_nT"].to_numpy()
    assert np.shares_memory(column, record.mag_B_nT) and not column.flags.writeable
    assert np.shares_memory(record.replace(dipole_B_Am2=None).mag_B_nT, record.mag_B_nT)
    own = np.array(record.mag_B_nT)
    kept = record.replace(mag_B_nT=own)
    view = own[:]
    view.setflags(write=False)
    shown = record.replace(mag_B_nT=view)
    own[0] = 7.0
    assert np.array_equal(kept.mag_B_nT, record.mag_B_nT), "what its owner may change is copied"
    assert np.array_equal(shown.mag_B_nT, record.mag_B_nT), "also behind a view that he may not"
    assert dataset["mag_B_nT"].attrs["units"] == "nT" and dataset["mag_B_nT"].dims[0] == "time"
    assert record.driver_units == fluxtwin.read(dataset).driver_units


@pytest.mark.parametrize(
    "rows", [slice(30), slice(30, None), slice(None, None, 2), slice(10, 50, 3), slice(1)], ids=str
)
def test_some_rows_of_a_frame_are_those_rows(record: fluxtwin.Telemetry, tmp_path: Path, rows: slice) -> None:
    """However the record was made: of an array of its own, or of the columns of a file."""
    fluxtwin.write(record, tmp_path / "r.csv")
    for whole in (record, fluxtwin.read(tmp_path / "r.csv")):
        for part in (whole.to_pandas().iloc[rows], whole.to_xarray().isel(time=rows)):
            taken = fluxtwin.read(part)
            assert (taken.time == whole.time[rows]).all()
            for name in ("mag_B_nT", "q_NB", "r_N_km", "sunlit"):
                assert np.array_equal(getattr(taken, name), getattr(whole, name)[rows], equal_nan=True), name


def test_only_what_fluxtwin_wrote_says_that_readings_are_corrected(record: fluxtwin.Telemetry) -> None:
    corrected = record.replace(
        provenance={**record.provenance, "calibration": "calibration 0123456789ab (residual 5 nT)"}
    )
    frame, dataset = record.to_pandas(), record.to_xarray()
    frame.attrs["calibration"] = dataset.attrs["calibration"] = "ground v3"
    assert fluxtwin.read(frame).corrected_by == fluxtwin.read(dataset).corrected_by == ""
    assert fluxtwin.read(corrected.to_pandas()).corrected_by == corrected.corrected_by
    assert fluxtwin.read(corrected.to_xarray()).corrected_by == corrected.corrected_by


def test_stamps_without_a_zone_are_noticed(record: fluxtwin.Telemetry) -> None:
    frame = record.to_pandas()
    assert "no zone" not in fluxtwin.read(frame).provenance.get("notices", "")
    bare = fluxtwin.read(frame.tz_localize(None))
    assert "column time has no zone: taken as UTC" in bare.provenance["notices"]
    same(bare, record)


@pytest.mark.parametrize("zone", ["UTC", "Europe/Amsterdam"])
def test_a_dataset_of_a_frame_keeps_its_instants(record: fluxtwin.Telemetry, zone: str) -> None:
    assert (fluxtwin.read(record.to_pandas().tz_convert(zone).to_xarray()).time == record.time).all()


def test_segments_of_two_objects_are_refused(tmp_path: Path) -> None:
    more = OEM[OEM.index("META_START") :].replace("1996", "1997").replace("OBJECT_ID = ", "OBJECT_ID = X")
    (tmp_path / "o.oem").write_text(OEM + "\n" + more, encoding="utf-8")
    with pytest.raises(BadInput, match="different objects"):
        ccsds.read_oem(tmp_path / "o.oem")


def test_units_in_attributes_and_lists_in_cells() -> None:
    stamps = pd.date_range("2026-03-01", periods=3, freq="10s", tz="Europe/Berlin")
    frame = pd.DataFrame({"mag_x": [1.0, 2.0, np.nan], "mag_y": [1, 2, 3], "mag_z": [0.1, 0.2, 0.3]}, index=stamps)
    frame.attrs["units"] = dict.fromkeys(frame.columns, "uT")
    found = fluxtwin.read(frame)
    assert found.mag_B_nT[1].tolist() == [2000.0, 2000.0, 200.0] and str(found.time[0])[:19] == "2026-02-28T23:00:00"
    listed = pd.DataFrame({"time": stamps, "mag": [[1, 2, 3], [4, 5, 6], [7, 8, 9]]})
    listed.attrs["units"] = {"mag": "nT"}
    assert fluxtwin.read(listed).mag_B_nT[2].tolist() == [7.0, 8.0, 9.0]
    dataset = xr.Dataset(
        {"mag": (("t", "axis"), np.ones((3, 3)), {"units": "mG"})}, coords={"t": stamps.tz_convert(None)}
    )
    assert fluxtwin.read(dataset, start="2026-02-28T23:00:10Z").mag_B_nT.tolist() == [[100.0] * 3] * 2
    bare = pd.DataFrame({"mag_x": [1.0], "mag_y": [1.0], "mag_z": [1.0]}, index=stamps[:1])
    with pytest.raises(BadInput, match="no unit in its name"):
        fluxtwin.read(bare)
    with pytest.raises(BadInput, match="an object of type list was given"):
        fluxtwin.read([1, 2, 3])  # type: ignore[arg-type]


def test_words_of_truth_in_a_frame_are_one_and_zero(record: fluxtwin.Telemetry) -> None:
    frame = record.to_pandas().assign(flag_ok=["true", "False"] * (len(record) // 2))
    assert list(fluxtwin.read(frame).flags["ok"][:2]) == [1.0, 0.0]
    with pytest.raises(BadInput, match="mag_x_nT in row 2 is 'true', which is no number"):
        fluxtwin.read(frame.assign(mag_x_nT=["1.5", "true"] * (len(record) // 2)))


def test_rows_by_time_and_by_condition(record: fluxtwin.Telemetry) -> None:
    part = record.between(str(record.time[10]), str(record.time[20]))
    stamps = [pd.Timestamp(record.time[row]) for row in (10, 20)]
    assert np.array_equal(record.between(*stamps).time, part.time)
    there = [stamp.tz_localize("UTC").tz_convert("Asia/Tokyo") for stamp in stamps]
    assert np.array_equal(record.between(*there).time, part.time)
    assert len(part) == 10 and part.time[0] == record.time[10]
    assert len(record.where("driver_payload >= 0.5")) == 30
    with pytest.raises(BadInput, match="no row is left"):
        record.between("1990-01-01", "1991-01-01")


def test_the_textbook_quaternion_is_the_one_of_the_messages() -> None:
    """CCSDS 504.0-B-1 annex: M of q = (0, 0, sin 45 deg, cos 45 deg) takes (1, 0, 0) of A to (0, -1, 0) of B."""
    q = np.array([[0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    assert np.allclose(frames.rotation_from_q(q).apply([1.0, 0.0, 0.0]), [[0.0, -1.0, 0.0]])
    assert isinstance(frames.rotation_from_q(q), Rotation)


def test_info_says_where_an_attitude_goes(tmp_path: Path) -> None:
    (tmp_path / "a.aem").write_text(AEM, encoding="utf-8")
    found = fluxtwin.info(tmp_path / "a.aem")
    assert "--attitude" in found.unread and [column.name for column in found.columns][-1] == "q_w"


def test_without_pandas_a_csv_is_read_and_the_rest_says_what_to_install(
    record: fluxtwin.Telemetry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)  # as if it were not installed
    assert len(fluxtwin.read(fluxtwin.write(record, tmp_path / "t.csv"))) == len(record)
    with pytest.raises(BadInput, match=r"the package pandas is needed.*fluxtwin\[pandas\]"):
        record.to_pandas()


def test_rows_of_a_frame_that_are_out_of_order_are_told_how_pandas_sorts_them() -> None:
    stamps = pd.date_range("2026-03-01", periods=4, freq="10s", tz="UTC")
    plain = pd.DataFrame({"time": stamps, "mag_x_nT": 2e4, "mag_y_nT": [1.0, 2.0, 3.0, 4.0], "mag_z_nT": 3e4})
    frame = pd.concat([plain.iloc[::-1], plain.iloc[:1]])
    with pytest.raises(BadInput, match=r'sort_values\("time"\)\.drop_duplicates\(\) in pandas'):
        fluxtwin.read(frame)
    assert fluxtwin.read(frame.sort_values("time").drop_duplicates()).mag_B_nT[:, 1].tolist() == [1.0, 2.0, 3.0, 4.0]
