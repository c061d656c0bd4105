"""Flight telemetry as it was sent: a folder of CubeSat packets and raw fluxgate counts become records and are checked.

Sources: PADRE attitude-computer packets (github PADRESat/padre_craft, b1c01b47) and ELFIN-A fluxgate data of
2022-01-12 (github jiashuwu89/elf_fgm, fbaba5dd); see flight/README.md in the shared folder.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.spatial.transform import Rotation

from fluxtwin.calib.checks.check import check_file, check_telemetry
from fluxtwin.calib.checks.values import check_sunlit
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.earth.field import FieldModel, field_N_nT, load_field
from fluxtwin.sim.earth.frames import rotation_from_N
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.reference

DOCS = Path(__file__).resolve().parents[3] / "docs" / "telemetry.md"


@pytest.fixture(scope="module")
def model() -> FieldModel:
    return load_field("igrf14")


@pytest.fixture
def maps(tmp_path: Path) -> tuple[Path, Path]:
    """The two column maps of the docs, the first with the name of PADRE's elements."""
    shown = re.findall(r"```toml\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    (padre,) = [text for text in shown if "satellite.tle" in text]
    (elfin,) = [text for text in shown if "position_gei" in text]
    for name, text in (("padre", padre.replace("satellite.tle", "20251219_padre.tle")), ("elfin", elfin)):
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    return tmp_path / "padre.toml", tmp_path / "elfin.toml"


def test_the_padre_folder_becomes_a_record_by_one_map(
    shared: Path, maps: tuple[Path, Path], model: FieldModel, close: Callable[..., None]
) -> None:
    folder = shared / "flight" / "padre"
    read = read_telemetry(folder, column_map=maps[0])
    # first row of packet 177 by eye: 1760270411 s + 800000000 ns, (-8.76, 2.39, -18.98) microtesla
    assert read.time[0] == np.datetime64("2025-10-12T12:00:11.800")
    close(read.mag_B_nT[0], [-8760.0, 2390.0, -18980.0], atol=1e-9, unit="nT", because="1000 nT in a microtesla")
    assert len(read) == 10
    # attitude: packet 211 at the same instant, relative to the orbital frame; the packet's own angles in packet 210
    # are roll -0.05, pitch 0.03, yaw -0.13 deg
    assert read.q_NB is not None
    assert read.r_N_km is not None
    assert read.v_N_km_s is not None
    R_BO = frames.rotation_from_q(read.q_NB[:1]) * frames.rotation_ON(read.r_N_km[:1], read.v_N_km_s[:1]).inv()
    angles = np.degrees(np.concatenate(frames.yaw_roll_pitch(R_BO)))
    close(angles, [-0.13, -0.05, 0.03], atol=0.006, unit="deg", because="the packet's angles have two decimals")
    # the reading fits the model's magnitude at positions from elements 68 days younger than the data: 15 %
    ratio = np.linalg.norm(read.mag_B_nT, axis=1) / np.linalg.norm(field_N_nT(model, read.time, read.r_N_km), axis=1)
    close(np.median(ratio), 1.0, atol=0.15, unit="1", because="old elements and an uncalibrated magnetometer")
    assert "elements in 20251219_padre.tle" in read.provenance["notices"]
    assert "67.7 days before the epoch" in read.provenance["notices"]


def test_the_preset_reads_every_packet_of_padre(shared: Path, close: Callable[..., None]) -> None:
    read = read_telemetry(shared / "flight" / "padre", column_map="preset:padre")
    assert read.rate_B_rad_s is not None
    assert read.wheel_speed_rpm is not None
    assert read.temperature_degC is not None
    # at 12:00:11.8, packets 210 and 172: (0, -0.07, 0) deg/s and 31.783485 rad/s, at the magnetometer's own stamp
    close(np.degrees(read.rate_B_rad_s[0]), [0.0, -0.07, 0.0], atol=1e-12, unit="deg/s", because="no interpolation")
    close(read.wheel_speed_rpm[0, 0], 31.783485412597656 * 30.0 / np.pi, atol=1e-9, unit="rpm", because="the same")
    assert np.isfinite(read.temperature_degC).any()


def test_gnss_packets_with_gps_weeks_and_metres(shared: Path, tmp_path: Path, close: Callable[..., None]) -> None:
    """GNSS BESTXYZ: week 2390, 588626.625 s; the ground stamp of the same packet shows which scale it is."""
    name = "padre_get_GNSS_BESTXYZ_Data_1762025414752_1762106689224.csv"
    (tmp_path / "map.toml").write_text(
        '[[file]]\ntime = { recipe = "gps_week_tow", columns = ["week", "seconds"] }\nsort = true\n[file.columns]\n'
        'mag = { from = ["vx", "vy", "vz"], unit = "nT" }\n'  # no magnetometer in this packet: a stand-in
        'position = { from = ["px", "py", "pz"], unit = "m", frame = "ITRS" }\n',
        encoding="utf-8",
    )
    read = read_telemetry(shared / "flight" / "padre" / name, column_map=tmp_path / "map.toml")
    ground = np.datetime64(1762025414752, "ms")
    assert abs((read.time[0] - ground).astype("timedelta64[s]").astype(int)) < 10, "18 leap seconds would show"
    assert read.r_N_km is not None
    back = frames.rotation_EN(read.time[:1]).apply(np.array(read.r_N_km[:1]))
    close(back, [[1572.89525, 5323.9725, 3130.080]], atol=1e-9, unit="km", because="the packet's metres, by eye")


def test_elfin_counts_become_nT_and_agree_with_the_model(
    shared: Path, maps: tuple[Path, Path], model: FieldModel, close: Callable[..., None]
) -> None:
    path = shared / "flight" / "elfin_a_20220112.nc"
    read = read_telemetry(path, column_map=maps[1])
    assert len(read) == 32536
    with xarray.open_dataset(path, engine="h5netcdf") as source:
        assert np.array_equal(read.time, source["time"].values)
        assert np.array_equal(read.mag_B_nT, source["B_raw"].values * 0.01)
        ecef = source["position_ecef"].values
    assert read.r_N_km is not None
    back = frames.rotation_EN(read.time).apply(np.array(read.r_N_km))
    close(back, ecef, atol=0.75, unit="km", because="the source leaves out nutation (0.6 km) and polar motion")
    other = frames.rotation_EN(read.time).apply(rotation_from_N("true_of_date", read.time).apply(np.array(read.r_N_km)))
    assert np.abs(other - ecef).max() > 20.0, "axes of date would have passed"
    found = check_telemetry(read, model)
    assert found.exit_status == 0
    assert {"clock_slips", "gaps"} <= {finding.code for finding in found.notes}


def test_elfin_counts_sold_as_nT_are_named(
    shared: Path, maps: tuple[Path, Path], model: FieldModel, tmp_path: Path
) -> None:
    path = shared / "flight" / "elfin_a_20220112.nc"
    sold = tmp_path / "sold.toml"
    sold.write_text(maps[1].read_text(encoding="utf-8").replace(", scale = 0.01", ""), encoding="utf-8")
    found = check_file(path, model, column_map=sold)
    assert found.exit_status == 1
    assert [finding.code for finding in found.traps] == ["magnetometer_unit"]
    assert "an impossible |B|" in found.traps[0].text
    assert "counts of 0.01 nT labelled as nT" in found.traps[0].text
    # and as a file of the contract, the way the source sells it
    contract = write_telemetry(read_telemetry(path, column_map=sold).select(slice(0, 3000)), tmp_path / "sold.csv")
    assert "counts of 0.01 nT labelled as nT" in check_file(contract, model).traps[0].text


def test_elfin_counts_without_positions_are_named(shared: Path, model: FieldModel, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(
        '[[file]]\ntime = { recipe = "cf", columns = "time" }\n[file.columns]\nmag = { from = "B_raw", unit = "nT" }\n',
        encoding="utf-8",
    )
    path = shared / "flight" / "elfin_a_20190721_raw_no_position.nc"
    found = check_file(path, model, column_map=tmp_path / "map.toml")
    assert "magnetometer_unit" in {finding.code for finding in found.traps}
    assert "counts of 0.01 nT" in next(f.text for f in found.traps if f.code == "magnetometer_unit")


def test_elfin_files_without_a_map_are_refused_with_what_to_do(shared: Path) -> None:
    with pytest.raises(BadInput, match=r"mag_x_nT is missing.*B_raw.*--map"):
        read_telemetry(shared / "flight" / "elfin_a_20220112.nc")


def test_elfin_wrong_sunlit_flags_are_named(shared: Path) -> None:
    """The state file says shadow while sunlit in three blocks: from 00:00:00, 02:00:01 and 23:35:58."""
    with xarray.open_dataset(shared / "flight" / "elfin_a_20220112_state.nc", engine="h5netcdf") as state:
        time = state["time"].values.astype("datetime64[ns]")
        r = rotation_from_N("J2000", time).apply(state["position_gei"].values.astype(float), inverse=True)
        flag = state["sunlit_flag"].values.astype(float)
    (found,) = check_sunlit(time, r, flag)
    assert found.severity == "trap"
    spans = re.findall(r"(2022-01-12T[\d:]+Z) to", found.text)
    assert len(spans) >= 3
    for start in ("00:00", "02:00", "23:3"):
        assert any(span.startswith(f"2022-01-12T{start}") for span in spans), (start, spans)
    geometry = (sun.illumination(r, sun.sun_N_km(time)) > 0.5).astype(float)
    assert check_sunlit(time, r, geometry) == []


def test_elfin_positions_sold_in_another_frame_are_named(
    shared: Path, maps: tuple[Path, Path], model: FieldModel
) -> None:
    """The Earth-fixed positions of the source under the inertial name."""
    read = read_telemetry(shared / "flight" / "elfin_a_20220112.nc", column_map=maps[1]).select(slice(None, None, 10))
    with xarray.open_dataset(shared / "flight" / "elfin_a_20220112.nc", engine="h5netcdf") as source:
        ecef = source["position_ecef"].values[::10]
    assert "position_frame" in {finding.code for finding in check_telemetry(read.replace(r_N_km=ecef), model).traps}


def test_a_real_orbit_with_a_false_attitude_is_named(shared: Path, maps: tuple[Path, Path], model: FieldModel) -> None:
    """Real positions, the model's field seen by a turning body, and the quaternion transposed."""
    read = read_telemetry(shared / "flight" / "elfin_a_20220112.nc", column_map=maps[1]).select(slice(None, None, 25))
    seconds = (read.time - read.time[0]).astype("int64") * 1e-9
    R_BN = Rotation.from_rotvec(np.outer(seconds / 500.0, [0.3, 0.5, 0.8])) * Rotation.from_rotvec([0.4, -1.0, 0.7])
    mag = R_BN.apply(field_N_nT(model, read.time, np.array(read.r_N_km)))
    right = Telemetry(read.time, mag, r_N_km=read.r_N_km, q_NB=frames.q_from_rotation(R_BN))
    assert check_telemetry(right, model).exit_status == 0
    wrong = right.replace(q_NB=frames.q_from_rotation(R_BN.inv()))
    assert [finding.code for finding in check_telemetry(wrong, model).traps] == ["attitude_convention"]
