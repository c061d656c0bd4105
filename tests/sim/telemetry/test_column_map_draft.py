"""`fluxtwin map`: first maps from foreign headers; the words for frames; near misses are answered."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import fluxtwin
from fluxtwin.cli import main
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.earth.references import rotation_XN
from fluxtwin.sim.telemetry.column_map import load_column_map
from fluxtwin.sim.telemetry.column_map_draft import CONFIRM, draft
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

pytestmark = pytest.mark.property

START = np.datetime64("2022-03-01T00:00:00", "ns")
TIME = START + np.arange(200) * np.timedelta64(30, "s")
R, V = Orbit(epoch_utc=START, altitude_km=550.0, inclination_rad=1.7, raan_rad=1.0).propagate(TIME)
R_BN = Rotation.from_rotvec(np.outer(np.arange(200) * 0.02, [0.2, 0.5, 0.1]))
MAG = R_BN.apply(field_N_nT(load_field("igrf14"), TIME, R))
Q = frames.q_from_rotation(R_BN)
DARK = (np.arange(200) % 40 > 25).astype(float)
UNIX = TIME.astype("int64") * 1e-9
GPS = UNIX - 315964800.0 + 18.0
"""18 leap seconds since 1980."""


def table(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    text = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    return path


def triple(names: str, values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names.split(), values.T, strict=True))


HEADERS = {
    "milliseconds, uT, scalar first, ECEF metres": {
        "ts_unix_ms": UNIX * 1e3,
        **triple("magX magY magZ", MAG * 1e-3),
        **triple("q0 q1 q2 q3", Q[:, [3, 0, 1, 2]]),
        **triple("posECEF_x_m posECEF_y_m posECEF_z_m", frames.rotation_EN(TIME).apply(R) * 1e3),
    },
    "ISO, bracketed units, ECI": {
        "utc": np.datetime_as_string(TIME, unit="ms"),
        **triple("Bx[nT] By[nT] Bz[nT]", MAG),
        **triple("q_x q_y q_z q_w", Q),
        **triple("ECI_X_km ECI_Y_km ECI_Z_km", R),
        **triple("VX_km_s VY_km_s VZ_km_s", V),
    },
    "seconds and nanoseconds, mG, numbered": {
        "timeSeconds": np.floor(UNIX),
        "timeNs": (UNIX % 1.0) * 1e9,
        **triple("tam_1_mG tam_2_mG tam_3_mG", MAG * 1e-2),
        **triple("quat_1 quat_2 quat_3 quat_4", Q),
        **triple("pos_j2000_x pos_j2000_y pos_j2000_z", R),
    },
    "GPS week and second, capitals without a word": {
        "WN": np.floor(GPS / 604800.0),
        "SOW": GPS % 604800.0,
        **triple("MGX MGY MGZ", MAG * 1e-2),
        **triple("X_km Y_km Z_km", R),
        **triple("VX_kms VY_kms VZ_kms", V),
        **triple("Q0 Q1 Q2 Q3", Q[:, [3, 0, 1, 2]]),
    },
    "GPS week and milliseconds of a receiver": {
        "week": np.floor(GPS / 604800.0),
        "iTOW_ms": GPS % 604800.0 * 1e3,
        **triple("mag_x_nT mag_y_nT mag_z_nT", MAG),
        **triple("pos_j2000_x pos_j2000_y pos_j2000_z", R),
        **triple("q_x q_y q_z q_w", Q),
    },
    "small letters, seconds and nanoseconds, what is no reading first": {
        "sec": np.floor(UNIX),
        "nsec": (UNIX % 1.0) * 1e9,
        **triple("b_igrf_x b_igrf_y b_igrf_z", MAG[::-1]),
        **triple("omega_b_x omega_b_y omega_b_z", 0.001 * V),
        **triple("mx my mz", MAG * 1e-3),
        **triple("px py pz", R),
        **triple("qi qj qk qs", Q),
    },
    "names with marks and brackets, a shadow flag": {
        "t [s]": UNIX,
        **triple("adcs.mm1.x adcs.mm1.y adcs.mm1.z", MAG),
        **triple("nav.v_eci[0] nav.v_eci[1] nav.v_eci[2]", V),
        **triple("nav.r_eci[0] nav.r_eci[1] nav.r_eci[2]", R),
        **triple("st.q_i st.q_j st.q_k st.q_s", Q),
        "eclipse": DARK,
        "panel_cur_xp": 0.4 * (1.0 - DARK),
    },
    "a time tag, flux gate, orbit words, letters of a quaternion": {
        "TTAG": UNIX,
        **triple("MTQX MTQY MTQZ", 0.1 * V),
        **triple("FGX FGY FGZ", MAG),
        **triple("SCX SCY SCZ", R * 1e3),
        **triple("SCVX SCVY SCVZ", V * 1e3),
        **triple("ATT_A ATT_B ATT_C ATT_D", Q[:, [3, 0, 1, 2]]),
    },
    "a scalar and a vector part of the quaternion": {
        "t": UNIX,
        **triple("B_X B_Y B_Z", MAG),
        **triple("R_ECI_X R_ECI_Y R_ECI_Z", R * 1e3),
        **triple("QEST_S QEST_V1 QEST_V2 QEST_V3", Q[:, [3, 0, 1, 2]]),
    },
    "a vector part along axes, the scalar last": {
        "t": UNIX,
        **triple("B_X B_Y B_Z", MAG),
        **triple("R_ECI_X R_ECI_Y R_ECI_Z", R * 1e3),
        **triple("qVx qVy qVz qS", Q),
    },
}


@pytest.mark.parametrize("name", HEADERS)
def test_a_drafted_map_reads_the_file_where_its_guesses_are_right(
    name: str, tmp_path: Path, close: Callable[..., None]
) -> None:
    data = table(tmp_path / "foreign.csv", HEADERS[name])
    (tmp_path / "map.toml").write_text(draft([data]), encoding="utf-8")
    record = read_telemetry(data, column_map=tmp_path / "map.toml")
    close(record.mag_B_nT, MAG, atol=1e-6, unit="nT", because="the same numbers in another unit")
    assert record.r_N_km is not None
    close(record.r_N_km, R, atol=0.01, unit="km", because="J2000 axes are 23 mas from GCRS, 0.8 m")
    assert record.q_NB is not None
    inner = np.abs(np.sum(record.q_NB * Q, axis=1))
    close(inner, 1.0, atol=1e-9, unit="", because="the same quaternion in another order, to the digits of the file")
    assert np.abs(record.time - TIME).max() <= np.timedelta64(1, "us")  # doubles near 1.6e9 s
    off = (frames.rotation_from_q(record.q_NB) * R_BN.inv()).magnitude()
    close(off, 0.0, atol=1e-6, unit="rad", because="the same quaternion in another order")


def test_guesses_are_marked_and_what_is_plain_is_not(tmp_path: Path) -> None:
    data = table(tmp_path / "foreign.csv", HEADERS["ISO, bracketed units, ECI"])
    text = draft([data])
    marked = [line for line in text.splitlines() if line.startswith(CONFIRM)]
    assert any("relative_to" in line for line in marked)
    assert any("velocity: the frame" in line for line in marked)
    assert not any("unit" in line for line in marked), "the header states them"


def test_a_shadow_is_no_sunlight_and_a_panel_has_the_arrays_current(tmp_path: Path) -> None:
    data = table(tmp_path / "t.csv", HEADERS["names with marks and brackets, a shadow flag"])
    text = draft([data])
    assert f"{CONFIRM} sunlit: that eclipse is 1 in shadow" in text and "array_current" in text
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    found = read_telemetry(data, column_map=tmp_path / "map.toml")
    assert found.sunlit is not None and np.array_equal(found.sunlit, 1.0 - DARK)


def test_what_only_a_short_name_says_is_to_be_confirmed(tmp_path: Path) -> None:
    text = draft([table(tmp_path / "t.csv", HEADERS["GPS week and second, capitals without a word"])])
    for said in (
        "mag: that MGX, MGY, MGZ are one",
        "position: that X_km, Y_km, Z_km are one",
        "the week counts from 1980",
    ):
        assert f"{CONFIRM} {said}" in text


def test_numbers_about_a_quantity_are_not_the_quantity(tmp_path: Path) -> None:
    beside = {
        **triple("rpyCmdYaw rpyCmdPitch rpyCmdRoll", 0.01 * V),
        **triple("gyroBiasX gyroBiasY gyroBiasZ", V),
        **triple("gyroX gyroY gyroZ", V),
        "received_stamp_ms": UNIX * 1e3,
    }
    text = draft([table(tmp_path / "t.csv", {**beside, **HEADERS["milliseconds, uT, scalar first, ECEF metres"]})])
    assert '"gyroX", "gyroY", "gyroZ"' in text and '"q0", "q1", "q2", "q3"' in text
    assert "driver_" not in text  # a stamp has "amp" in it


def test_a_column_that_says_which_rows_count_is_offered(tmp_path: Path) -> None:
    good, on = np.arange(200) > 3, np.arange(200) % 40 > 20
    words = {"FIX VALID": np.where(good, "True", "False"), "TX_ON": np.where(on, "true", "false")}
    text = draft([table(tmp_path / "t.csv", {**HEADERS["ISO, bracketed units, ECI"], **words})])
    (line,) = [line for line in text.splitlines() if "which rows count" in line]
    stated = line.partition("if those with 1: ")[2]
    (tmp_path / "map.toml").write_text(text.replace(line, stated), encoding="utf-8")
    found = read_telemetry(tmp_path / "t.csv", column_map=tmp_path / "map.toml")
    assert len(found) == 196 and np.array_equal(found.drivers["tx_on"], on[good].astype(float))


def test_a_second_magnetometer_is_left_out_with_the_line_that_takes_it_in(tmp_path: Path) -> None:
    header = HEADERS["ISO, bracketed units, ECI"] | triple("mag2_x_uT mag2_y_uT mag2_z_uT", 2e-3 * MAG)
    data, path = table(tmp_path / "foreign.csv", header), tmp_path / "map.toml"
    text = draft([data])
    path.write_text(text, encoding="utf-8")
    assert read_telemetry(data, column_map=path).mag2_B_nT is None
    path.write_text(re.sub("# left out, a second mag: .*; if of another sensor: ", "", text), encoding="utf-8")
    assert np.allclose(read_telemetry(data, column_map=path).mag2_B_nT, 2.0 * MAG, atol=1e-6, rtol=0)


def test_a_second_sensor_is_taken_in_and_the_readings_of_the_first_in_other_axes_are_not(tmp_path: Path) -> None:
    """Another sensor has a noise of its own, whatever its columns are called; a rate is no magnetometer."""
    noise = np.random.default_rng(3).normal(0.0, 30.0, (2, *MAG.shape))
    turned = np.round(Rotation.from_rotvec([0.3, 2.0, -1.0]).apply(MAG + noise[1]) / 4.0 + np.array([300, -200, 100]))
    first = {"unix_s": UNIX, **triple("B_int_1 B_int_2 B_int_3", np.round((MAG + noise[0]) * 1e-3, 2))}
    text = draft([table(tmp_path / "a.csv", first | triple("mat_1 mat_2 mat_3", turned))])
    assert 'mag2 = { from = ["mat_1", "mat_2", "mat_3"], unit = "nT" }' in text
    assert f"{CONFIRM} mag2: that it is of another sensor" in text
    own = Rotation.from_rotvec([0.3, 2.0, -1.0]).apply(np.round((MAG + noise[0]) * 1e-3, 2)) * 250.0
    assert "\nmag2 =" not in draft([table(tmp_path / "b.csv", first | triple("cor_1 cor_2 cor_3", own))])
    turns = 2e4 * np.random.default_rng(4).normal(size=MAG.shape)
    assert "\nmag2 =" not in draft([table(tmp_path / "c.csv", first | triple("xx_1 xx_2 xx_3", turns))])


def test_a_draft_is_written_whatever_is_understood_and_says_what_to_fill_in(tmp_path: Path) -> None:
    data = table(tmp_path / "a.csv", {"time": UNIX, "volts": UNIX * 0.0})
    text = draft([data])
    assert 'recipe = "unix_s"' in text and f"{CONFIRM} no three columns of numbers look like a magnetometer" in text
    assert "# not used: volts" in text
    lines = (
        table(tmp_path / "x.csv", {"time": UNIX, **triple("mag_x mag_y mag_z", MAG)}).read_text("utf-8").splitlines()
    )
    lines[5] = re.sub(r",[^,]+$", ",-", lines[5])  # as a spreadsheet shows a missing value, and its two empty columns
    (tmp_path / "x.csv").write_text("".join(f"{line},,\n" for line in lines), encoding="utf-8")
    assert "# not used: mag_x, mag_y, mag_z (not all numbers: '-')\n" in draft([tmp_path / "x.csv"])
    shuffled = {"n": np.random.default_rng(1).permutation(UNIX), **triple("mag_x mag_y mag_z", MAG)}
    text = draft([table(tmp_path / "b.csv", shuffled)])
    assert f"{CONFIRM} no column looks like time: write it" in text and '\n# time = { recipe = "iso", columns' in text
    assert 'mag = { from = ["mag_x", "mag_y", "mag_z"], unit = "nT" }' in text and "# not used: n" in text
    (tmp_path / "m.toml").write_text(
        text.replace("# time = ", "time = ").replace("iso", "unix_s").replace("NAME", "n"), encoding="utf-8"
    )
    assert load_column_map(tmp_path / "m.toml").file[0].columns["mag"].unit == "nT"
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match="time"):
        load_column_map(tmp_path / "m.toml")


def test_elements_beside_the_tables_give_the_positions(tmp_path: Path) -> None:
    data = table(tmp_path / "a.csv", {"unix_s": UNIX, **triple("gas_x gas_y gas_z", MAG * 1e-3)})
    assert 'tle = "satellite.tle"' in draft([data])
    (tmp_path / "s.tle").write_text(
        "1 64559U 25135AH  25353.22331108  .00001201  00000+0  12504-3 0  9991\n"
        "2 64559  97.7592 104.5218 0002960 121.2529 238.8980 14.91647938 27010\n",
        encoding="utf-8",
    )
    (tmp_path / "m.toml").write_text(draft([data]), encoding="utf-8")
    record = read_telemetry(data, column_map=tmp_path / "m.toml")  # of another year: a notice, no error
    assert record.r_N_km is not None and np.allclose(record.mag_B_nT, MAG, atol=1e-6)
    assert f"{CONFIRM} mag: that gas_x, gas_y, gas_z are one (by their size)" in draft([data])
    (tmp_path / "other.tle").write_text("", encoding="utf-8")
    assert 'here `tle = "satellite.tle"`, of other.tle, s.tle' in draft([data])


def test_a_workbook_with_names_of_months_and_a_table_of_rows_out_of_order(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    words = pd.DatetimeIndex(TIME)
    stamps = {"Date": words.strftime("%d-%b-%Y"), "UTC": words.strftime("%H:%M:%S.%f").str[:-3]}
    currents = {"I_COOL_mA": UNIX % 7.0 * 100.0, "I_SA_mA": UNIX % 5.0, "T_MTM": UNIX * 0.0 + 20.0}
    with pd.ExcelWriter(tmp_path / "all.xlsx") as book:
        raw = triple("RAW_X RAW_Y RAW_Z", np.round(MAG * 0.075))
        pd.DataFrame(stamps | raw).to_excel(book, sheet_name="MTM", index=False)
        pd.DataFrame(stamps | currents).to_excel(book, sheet_name="PWR", index=False)
    text = draft([tmp_path / "all.xlsx"])
    assert 'columns = ["Date", "UTC"], format = "%d-%b-%Y %H:%M:%S.%f"' in text
    assert 'driver_i_cool_ma = { from = "I_COOL_mA", unit = "mA" }' in text and "counts by their name" in text
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    record = read_telemetry(tmp_path / "all.xlsx", column_map=tmp_path / "m.toml")
    assert np.array_equal(record.time, TIME) and np.allclose(record.mag_B_nT, np.round(MAG * 0.075))
    j2000 = GPS + 315964800.0 + 32.184 + 19.0 - 946728000.0  # TT of GPS, from noon of 2000-01-01
    twice = np.r_[np.arange(150), np.arange(140, 200)]
    rows = {"t_j2000": j2000[twice], **triple("magX magY magZ", MAG[twice])}
    (tmp_path / "m.toml").write_text(text := draft([table(tmp_path / "a.csv", rows)]), encoding="utf-8")
    assert f"{CONFIRM} that rows are out of order, or repeated\nsort = true" in text
    assert np.abs(
        read_telemetry(tmp_path / "a.csv", column_map=tmp_path / "m.toml").time - TIME
    ).max() < np.timedelta64(1, "us")


def test_what_is_missing_is_marked_beside_what_was_found(tmp_path: Path) -> None:
    """The attitude alone: the map says where readings and positions go."""
    data = table(tmp_path / "a.csv", {"ts_ns": UNIX * 1e9, **triple("qs q1 q2 q3", Q[:, [3, 0, 1, 2]])})
    text = draft([data])
    assert 'recipe = "unix_ns"' in text and 'order = "wxyz"' in text
    missing = [line for line in text.splitlines()[:6] if line.startswith(CONFIRM)]
    assert "magnetometer" in missing[0] and "[file.columns]" in missing[0]
    assert "positions" in missing[1] and "tle = " in missing[1]


def test_axes_and_weeks_of_other_names_are_found_and_doubts_said(tmp_path: Path) -> None:
    gps_s = (TIME - np.datetime64("1980-01-06")).astype("int64") * 1e-9 + 18.0
    weeks = {"WN": np.floor(gps_s / 604800.0), "TOW": gps_s % 604800.0}
    text = draft([table(tmp_path / "a.csv", {**weeks, **triple("fgm_a_cnt fgm_b_cnt fgm_c_cnt", MAG)})])
    assert 'recipe = "gps_week_tow", columns = ["WN", "TOW"]' in text and "counts by their name" in text
    stamps = np.datetime_as_string(TIME, unit="ms", timezone="UTC")
    text = draft([table(tmp_path / "b.csv", {"received_at": stamps, **triple("bu bv bw", MAG)})])
    assert 'from = ["bu", "bv", "bw"]' in text and "not that of the ground" in text


def test_a_folder_of_pieces_is_to_be_checked_as_a_folder(tmp_path: Path) -> None:
    for name in ("log_1.csv", "log_2.csv"):
        table(tmp_path / name, HEADERS["ISO, bracketed units, ECI"])
    assert f"fluxtwin check {shlex.quote(str(tmp_path))} --map" in draft([tmp_path])


def test_what_all_pieces_have_is_said_once(tmp_path: Path) -> None:
    for k in range(4):
        part = {name: column[45 * k : 45 * k + 45] for name, column in HEADERS["ISO, bracketed units, ECI"].items()}
        path = table(tmp_path / f"log_{k}.csv", part)
        path.write_text(path.read_text(encoding="utf-8").replace(",", ";"), encoding="utf-8")
    (tmp_path / "map.toml").write_text(draft([tmp_path]), encoding="utf-8")
    record = read_telemetry(tmp_path, column_map=tmp_path / "map.toml")
    assert len(record) == 180
    assert record.provenance["notices"].count("separated by semicolons") == 1
    assert "log_0.csv, log_1.csv, log_2.csv and 1 more: its columns are separated" in record.provenance["notices"]


def test_ephemerides_state_their_frame(tmp_path: Path) -> None:
    table(tmp_path / "mag.csv", {"utc": np.datetime_as_string(TIME, unit="ms"), **triple("bx_nT by_nT bz_nT", MAG)})
    head = "META_START\nOBJECT_NAME = X\nOBJECT_ID = 1\nCENTER_NAME = EARTH\nREF_FRAME = ITRF2000\nTIME_SYSTEM = UTC\n"
    stamps = np.datetime_as_string(TIME, unit="ms")
    rows = "\n".join(f"{t} {' '.join(map(str, [*r, *v]))}" for t, r, v in zip(stamps, R, V, strict=True))
    span = f"START_TIME = {stamps[0]}\nSTOP_TIME = {stamps[-1]}\nMETA_STOP\n"
    (tmp_path / "orbit.oem").write_text(f"CCSDS_OEM_VERS = 2.0\nORIGINATOR = T\n{head}{span}{rows}\n", encoding="utf-8")
    text = draft([tmp_path])
    assert 'frame = "ITRS"' in text or 'frame = "ITRF"' in text
    assert not any(line.startswith(CONFIRM) and "position" in line for line in text.splitlines())


def test_states_exactly_as_far_apart_as_allowed_are_bridged(tmp_path: Path) -> None:
    """A state a minute is what --tle takes too: seconds as floating-point numbers may be off in the last digit."""
    fine = START + np.arange(901) * np.timedelta64(2, "s")
    r, v = Orbit(epoch_utc=START, altitude_km=550.0, inclination_rad=1.7, raan_rad=1.0).propagate(fine)
    stamps = np.datetime_as_string(fine, unit="ms")
    table(
        tmp_path / "mag.csv", {"utc": stamps, **triple("bx_nT by_nT bz_nT", field_N_nT(load_field("igrf14"), fine, r))}
    )
    tai = np.datetime_as_string(fine[::30] + np.timedelta64(37, "s"), unit="ms")
    head = "META_START\nOBJECT_NAME = X\nOBJECT_ID = 1\nCENTER_NAME = EARTH\nREF_FRAME = GCRF\nTIME_SYSTEM = TAI\n"
    rows = "\n".join(f"{t} {' '.join(map(str, [*a, *b]))}" for t, a, b in zip(tai, r[::30], v[::30], strict=True))
    span = f"START_TIME = {tai[0]}\nSTOP_TIME = {tai[-1]}\nMETA_STOP\n"
    (tmp_path / "orbit.oem").write_text(f"CCSDS_OEM_VERS = 2.0\nORIGINATOR = T\n{head}{span}{rows}\n", encoding="utf-8")
    (tmp_path / "map.toml").write_text(draft([tmp_path]), encoding="utf-8")
    record = read_telemetry(tmp_path, column_map=tmp_path / "map.toml")
    assert record.has_position.all() and record.r_N_km is not None
    assert np.abs(record.r_N_km - r).max() < 0.001


def test_the_command_writes_the_map_and_check_accepts_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = table(tmp_path / "foreign.csv", HEADERS["ISO, bracketed units, ECI"])
    assert main(["map", str(data), "--out", str(tmp_path / "map.toml")]) == 0
    assert "to be confirmed" in capsys.readouterr().out
    assert main(["check", str(data), "--map", str(tmp_path / "map.toml")]) == 0
    assert "ECI was taken as GCRS" in capsys.readouterr().out


def one(tmp_path: Path, attitude: str, columns: dict[str, np.ndarray], frame: str = "ECI") -> Path:
    table(tmp_path / "a.csv", {"t": UNIX, **triple("bx by bz", MAG), **triple("x y z", R), **columns})
    (tmp_path / "map.toml").write_text(
        '[[file]]\ntime = { recipe = "unix_s", columns = "t" }\n[file.columns]\n'
        'mag = { from = ["bx", "by", "bz"], unit = "nT" }\n'
        f'position = {{ from = ["x", "y", "z"], unit = "km", frame = "{frame}" }}\n{attitude}\n',
        encoding="utf-8",
    )
    return tmp_path / "map.toml"


def test_an_attitude_relative_to_nec_is_read(tmp_path: Path, close: Callable[..., None]) -> None:
    """NEC by its definition (geocentric): the field's own components there are those of `field_NEC_nT`."""
    up = R / np.linalg.norm(R, axis=1)[:, None]
    pole = frames.rotation_EN(TIME).apply([0.0, 0.0, 1.0], inverse=True)
    east = np.cross(pole, up)
    east /= np.linalg.norm(east, axis=1)[:, None]
    axes = Rotation.from_matrix(np.stack([np.cross(up, east), east, -up], axis=1))
    q = frames.q_from_rotation(R_BN * axes.inv())
    spec = 'attitude = { from = ["q1", "q2", "q3", "q4"], order = "scalar_last", relative_to = "nec" }'
    column_map = one(tmp_path, spec, triple("q1 q2 q3 q4", q))
    record = read_telemetry(tmp_path / "a.csv", column_map=column_map)
    off = (frames.rotation_from_q(record.q_NB) * R_BN.inv()).magnitude()
    close(off, 0.0, atol=1e-7, unit="rad", because="rotations of float64 numbers printed in full")
    assert "position: ECI was taken as GCRS" in record.provenance["notices"]


@pytest.mark.parametrize(
    ("attitude", "frame", "said"),
    [
        ("", "ECIF", "'ECIF' is not known; did you mean ECI?"),
        ('attitude = { from = ["bx"], order = "xyzw", relative_to = "orbit" }', "GCRS", "did you mean orbital?"),
        ('attitude = { from = ["bx"], order = "wxzy", relative_to = "GCRS" }', "GCRS", "did you mean wxyz?"),
        ('sun = ["bx", "by", "bz"]', "GCRS", "sun wants a table, as { from ="),
    ],
)
def test_a_near_miss_is_answered(tmp_path: Path, attitude: str, frame: str, said: str) -> None:
    with pytest.raises(BadInput) as caught:
        load_column_map(one(tmp_path, attitude, {}, frame))
    assert said in str(caught.value)
    assert "Input should be" not in str(caught.value)


@pytest.mark.parametrize(
    ("time", "said"),
    [
        ('"ts_unix_ms"', 'as { recipe = "unix_ms", columns = "ts_unix_ms" }'),
        ('{ recipe = "unixms", columns = "t" }', "did you mean unix_ms?"),
    ],
)
def test_a_bare_time_column_is_answered_with_an_example(tmp_path: Path, time: str, said: str) -> None:
    (tmp_path / "map.toml").write_text(
        f'[[file]]\ntime = {time}\n[file.columns]\nmag = {{ from = ["a", "b", "c"], unit = "nT" }}\n', encoding="utf-8"
    )
    with pytest.raises(BadInput) as caught:
        load_column_map(tmp_path / "map.toml")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("head", "cells", "said"),
    [
        ("Date,Clock", ["2026/03/01,00:00:00.5", "2026/03/01,00:00:01.5"], 'format = "%Y/%m/%d %H:%M:%S.%f"'),
        ("stamp,n", ["13.03.2026 01:02:03,1", "13.03.2026 01:02:04,2"], 'format = "%d.%m.%Y %H:%M:%S"'),
        ("stamp,n", ["01/02/2026 01:02:03,1", "01/02/2026 01:02:04,2"], "could be %m/%d/%Y"),
        ("time,n", ["03/13/2026 12:59:59 PM,1", "03/13/2026 01:00:00 PM,2"], 'format = "%m/%d/%Y %I:%M:%S %p"'),
        ("day,utc", ["2026-060,01:02:03", "2026-060,01:02:04"], 'format = "%Y-%j %H:%M:%S"'),
        ("time,n", ["03/01/2026 12:59:59 PM,1", "03/01/2026 01:00:00 PM,2"], 'format = "%m/%d/%Y %I:%M:%S %p"'),
        ("time,n", ["2026:060:01:02:03,1", "2026:060:01:02:04,2"], 'format = "%Y:%j:%H:%M:%S"'),
        ("year,month,day,hour,minute,second", ["2026,3,1,1,2,3", "2026,3,1,1,2,4"], 'format = "%Y %m %d %H %M %S"'),
        ("year,doy,hh,mm,ss", ["2026,60,1,2,3.5", "2026,60,1,2,4.5"], 'format = "%Y %j %H %M %S.%f"'),
        ("gps_time,n", ["1456358418.5,1", "1456358419.5,2"], 'recipe = "gps_s"'),
    ],
)
def test_stamps_of_other_forms_are_guessed_and_read(tmp_path: Path, head: str, cells: list[str], said: str) -> None:
    rows = [f"{head},mag_x_nT,mag_y_nT,mag_z_nT", *(f"{cell},20000,1,-30000" for cell in cells)]
    (tmp_path / "a.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
    text = draft([tmp_path / "a.csv"])
    assert said in text and "# to be confirmed" in text
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    found = read_telemetry(tmp_path / "a.csv", column_map=tmp_path / "m.toml")
    assert (found.time[1] - found.time[0]) == np.timedelta64(1, "s") and str(found.time[0])[:4] == "2026"


@pytest.mark.parametrize(
    ("recipe", "noon"), [("excel", 46082.5), ("mjd", 61100.5), ("jd", 2461101.0), ("datenum", 740042.5)]
)
def test_days_are_known_by_their_size(tmp_path: Path, recipe: str, noon: float) -> None:
    """Noon of 2026-03-01 by the day counts of a spreadsheet, of astronomers and of MATLAB; as seconds it would be 1970."""
    days = noon + np.arange(9) / 8640.0
    table(tmp_path / "a.csv", {"time": days, **triple("mag_x mag_y mag_z", np.full((9, 3), 2e4))})
    text = draft([tmp_path / "a.csv"])
    assert f'recipe = "{recipe}"' in text and "that they are UTC is a guess" in text
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    found = read_telemetry(tmp_path / "a.csv", column_map=tmp_path / "m.toml").time
    right = np.datetime64("2026-03-01T12:00:00", "ns") + np.arange(9) * np.timedelta64(10, "s")
    assert np.abs(found - right).max() < np.timedelta64(1, "ms")


def test_seconds_of_a_spreadsheets_size_stay_seconds_and_milliseconds_are_said(tmp_path: Path) -> None:
    columns = {"t_ms": 46082.0 + 100.0 * np.arange(9.0), **triple("mag_x mag_y mag_z", np.full((9, 3), 2e4))}
    text = draft([table(tmp_path / "a.csv", columns)])
    assert 'recipe = "seconds_since"' in text and "unit_s = [0.001]" in text


def test_fill_values_are_guessed(tmp_path: Path) -> None:
    rows = ["t,bx_nT,by_nT,bz_nT", *(f"2026-03-01T00:00:0{k}Z,20000,{-9999 if k == 3 else 1},-30000" for k in range(9))]
    (tmp_path / "a.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
    text = draft([tmp_path / "a.csv"])
    assert "fill = [-9999.0]" in text and "that -9999.0 means missing" in text
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    assert list(np.flatnonzero(~read_telemetry(tmp_path / "a.csv", column_map=tmp_path / "m.toml").has_reading)) == [3]


def test_an_epoch_that_is_not_known_is_left_to_be_written(tmp_path: Path) -> None:
    """A guess would be decades off, and `check` would find some time zone in which the Earth is turned right."""
    table(tmp_path / "a.csv", {"t_s": np.arange(9.0), **triple("mag_x mag_y mag_z", np.full((9, 3), 2e4))})
    (tmp_path / "m.toml").write_text(draft([tmp_path / "a.csv"]), encoding="utf-8")
    with pytest.raises(BadInput, match="column map: epoch: 'YYYY-MM-DDThh:mm:ssZ' is not a time"):
        read_telemetry(tmp_path / "a.csv", column_map=tmp_path / "m.toml")


@pytest.mark.parametrize(("low", "high", "unit"), [(-4.0, 2.0, "deg"), (-3.0, 3.0, "rad"), (0.0, 6.2, "rad")])
def test_angles_beyond_a_half_turn_either_way_are_no_radians(
    tmp_path: Path, low: float, high: float, unit: str
) -> None:
    angles = np.linspace(low, high, 60)[:, None] * np.ones(3)
    columns = {"unix_s": UNIX[:60], **triple("mag_x mag_y mag_z", 2e4 + angles), **triple("yaw pitch roll", angles)}
    assert f'euler = "ZYX", unit = "{unit}"' in draft([table(tmp_path / "a.csv", columns)])


def test_a_fill_value_of_a_quaternion_is_guessed_too(tmp_path: Path) -> None:
    rows = [
        f"2026-03-01T00:00:0{k}Z,2e4,1,-3e4,{'-9999,-9999,-9999,-9999' if k == 3 else '0,0.6,0,0.8'}" for k in range(9)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["t,bx_nT,by_nT,bz_nT,q_x,q_y,q_z,q_w", *rows, ""]), encoding="utf-8")
    (tmp_path / "m.toml").write_text(draft([tmp_path / "a.csv"]), encoding="utf-8")
    found = read_telemetry(tmp_path / "a.csv", column_map=tmp_path / "m.toml")
    assert found.q_NB is not None and found.q_NB[3] == pytest.approx([0.0, 0.6, 0.0, 0.8]), "interpolated"


def test_a_place_in_radians_by_its_names_is_turned_into_degrees(tmp_path: Path) -> None:
    turns, high = np.linspace(-1.2, 1.2, 200), np.full(200, 550.0)
    records = []
    for ends, place in (("deg", np.degrees(turns)), ("rad", turns)):
        names = triple(f"lat_{ends} lon_{ends} alt_km", np.column_stack([place, place, high]))
        path = table(tmp_path / f"{ends}.csv", {"t": UNIX, **triple("bx_nT by_nT bz_nT", MAG), **names})
        (tmp_path / f"{ends}.toml").write_text(draft([path]), encoding="utf-8")
        records.append(read_telemetry(path, column_map=tmp_path / f"{ends}.toml"))
    assert np.allclose(*[record.r_N_km for record in records], rtol=1e-12, atol=1e-6)


@pytest.mark.parametrize(("size", "unit"), [(0.2, "Am2"), (200.0, "mAm2")])
def test_a_dipole_that_no_small_torquer_has_is_in_thousandths(tmp_path: Path, size: float, unit: str) -> None:
    rows = [f"2026-03-01T00:00:{second:02d}Z,{size},0,{-size}" for second in range(60)]
    (tmp_path / "t.csv").write_text("\n".join(["time,MTQ_X,MTQ_Y,MTQ_Z", *rows]) + "\n", encoding="utf-8")
    assert f'dipole = {{ from = ["MTQ_X", "MTQ_Y", "MTQ_Z"], unit = "{unit}" }}' in draft([tmp_path / "t.csv"])


def test_a_share_of_a_torquers_most_is_no_dipole(tmp_path: Path) -> None:
    names, share = "mag_x_nT,mag_y_nT,mag_z_nT,mtq_x_pct,mtq_y_pct,mtq_z_pct", [0, 100]
    rows = [f"2026-03-01T00:00:{second:02d}Z,2e4,{second},-3e4,{share[second % 2]},0,-100" for second in range(60)]
    (tmp_path / "t.csv").write_text("\n".join([f"time,{names}", *rows]) + "\n", encoding="utf-8")
    text = draft([tmp_path / "t.csv"])
    assert 'driver_mtq_x_pct = { from = "mtq_x_pct" }' in text and "dipole = { from" not in text


def test_bare_names_of_a_unit_norm_are_a_quaternion_and_a_place_has_fill_values(tmp_path: Path) -> None:
    place = np.column_stack([np.linspace(-70.0, 70.0, 200), np.linspace(0.0, 50.0, 200), np.full(200, 5.5e5)])
    place[7] = [-9999.0, 3.0, 5.5e5]
    columns = {
        "t": UNIX,
        **triple("bx by bz", MAG),
        **triple("w x y z", Q[:, [3, 0, 1, 2]]),
        **triple("lat lon alt", place),
    }
    text = draft([table(tmp_path / "data.csv", columns)])
    assert 'attitude = { from = ["w", "x", "y", "z"], order = "wxyz"' in text
    assert 'frame = "geodetic", fill = [-9999.0] }' in text
    columns["w"] = 2.0 * columns["w"]
    assert "attitude = { from" not in draft([table(tmp_path / "data.csv", columns)])


def test_a_draft_says_of_a_file_that_is_no_text_that_it_is_none(tmp_path: Path) -> None:
    for name, said in (("a.mat", "writetable makes a .csv"), ("a.fits", "damaged or not text")):
        (tmp_path / name).write_bytes(b"SIMPLE  =                    T\xc0\0\n")
        with pytest.raises(BadInput, match=said):
            draft([tmp_path / name])


def test_a_row_of_units_below_the_header_is_named(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    rows = ["2026-03-01 00:00:00,20.1,3.2,-30.5,1", "2026-03-01 00:00:10,20,3,-30,0", ""]
    path.write_text("\n".join(["t,Bx,By,Bz,flag", *rows]), encoding="utf-8")
    (tmp_path / "m.toml").write_text(draft([path]), encoding="utf-8")
    path.write_text("\n".join(["t,Bx,By,Bz,flag", "UTC,uT,uT,uT,", *rows]), encoding="utf-8")
    for reads in (lambda: draft([path]), lambda: read_telemetry(path, column_map=tmp_path / "m.toml")):
        with pytest.raises(BadInput, match="row below the header has words where the others have numbers: UTC, uT"):
            reads()


def test_a_number_that_only_looks_like_a_fill_value_is_none(tmp_path: Path) -> None:
    counts = np.round(MAG / 10.0)
    counts[5, 0] = -999.0
    assert "fill" not in draft([table(tmp_path / "a.csv", {"unix_s": UNIX, **triple("mag_x mag_y mag_z", counts)})])
    counts[7:9] = -4096.0
    assert "fill" not in draft([table(tmp_path / "a.csv", {"unix_s": UNIX, **triple("mag_x mag_y mag_z", counts)})])
    counts[9:11] = -4096.0
    text = draft([table(tmp_path / "a.csv", {"unix_s": UNIX, **triple("mag_x mag_y mag_z", counts)})])
    assert "fill = [-4096.0]" in text, "all three, more than twice"


def test_a_folder_with_a_packet_a_file(tmp_path: Path) -> None:
    """Names that say little: the file's own helps; pieces of one table are joined; currents come in; text is no table."""
    half = len(UNIX) // 2
    for k, part in enumerate((slice(0, half), slice(half, None))):
        table(tmp_path / f"MAG_{k}.csv", {"t_ms": UNIX[part] * 1e3, **triple("X Y Z", MAG[part] * 1e-3)})
    R_NB = R_BN.as_matrix().transpose(0, 2, 1).reshape(-1, 9)
    table(tmp_path / "att.csv", {"t_ms": UNIX * 1e3, **triple("R11 R12 R13 R21 R22 R23 R31 R32 R33", R_NB)})
    r_E = frames.rotation_EN(TIME).apply(R) * 1e3
    table(tmp_path / "GPS.csv", {"MJD": UNIX / 86400.0 + 40587.0, **triple("X_m Y_m Z_m", r_E)})
    power = {"I_SA": UNIX * 0.0 + 900.0, "I_BAT": UNIX * 0.0 - 0.2, "I_TX": UNIX % 7.0, "T_MAG": UNIX * 0.0 + 20.0}
    table(tmp_path / "eps.csv", {"t_ms": UNIX * 1e3, **power})
    (tmp_path / "README.txt").write_text("Hello.\n\n", encoding="utf-8")
    assert main(["map", str(tmp_path), "--out", str(tmp_path / "map.toml")]) == 0
    record = read_telemetry(tmp_path, column_map=tmp_path / "map.toml")
    assert np.allclose(record.mag_B_nT, MAG, atol=1e-6) and len(record) == len(TIME)
    assert record.r_N_km is not None and np.abs(record.r_N_km - R)[record.has_position].max() < 0.01
    assert (frames.rotation_from_q(np.array(record.q_NB)) * R_BN.inv()).magnitude().max() < 1e-6
    assert np.allclose(record.array_current_A, 0.9) and np.allclose(record.battery_current_A, -0.2)
    assert np.allclose(record.drivers["i_tx"], power["I_TX"]) and np.allclose(record.temperature_degC, 20.0)


def test_a_workbook_with_a_sheet_a_packet(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    tai = {"TAI2000 [s]": UNIX - 946684800.0 + 37.0 - 43200.0}
    orbital = R_BN * rotation_XN("orbital", TIME, R, V).inv()
    angles = triple("yaw_deg pitch_deg roll_deg", orbital.inv().as_euler("ZYX", degrees=True))
    sheets = {
        "INFO": {"Sheet": np.array(["ATT", "ORB"]), "Rows": np.array([200, 200])},
        "ATT": tai | angles,
        "ORB": tai | triple("X[km] Y[km] Z[km]", R) | triple("VX[km/s] VY[km/s] VZ[km/s]", V),
        "MAGM": tai | triple("Bx[uT] By[uT] Bz[uT]", MAG * 1e-3),
        "MAGI": tai | triple("H1[mG] H2[mG] H3[mG]", MAG * 2e-2),
    }
    with pd.ExcelWriter(tmp_path / "all.xlsx") as book:
        for name, columns in sheets.items():
            pd.DataFrame(columns).to_excel(book, sheet_name=name, index=False)
    assert [one.name for one in fluxtwin.info(tmp_path / "all.xlsx").columns][2] == "ATT: TAI2000 [s]"
    text = draft([tmp_path / "all.xlsx"])
    assert "# INFO: left out" in text and 'sheet = "MAGI"' in text
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    record = read_telemetry(tmp_path / "all.xlsx", column_map=tmp_path / "m.toml")
    assert np.abs(record.time - TIME).max() < np.timedelta64(1, "us")
    assert np.allclose(record.mag_B_nT, MAG, atol=1e-6) and np.allclose(record.mag2_B_nT, 2.0 * MAG, atol=1e-6)
    assert (frames.rotation_from_q(np.array(record.q_NB)) * R_BN.inv()).magnitude().max() < 1e-6
    (tmp_path / "m.toml").write_text(text.replace('"MAGI"', '"MAGX"'), encoding="utf-8")
    with pytest.raises(BadInput, match=r"no sheet 'MAGX'\. Wanted: INFO, ATT, ORB, MAGM, MAGI"):
        read_telemetry(tmp_path / "all.xlsx", column_map=tmp_path / "m.toml")
