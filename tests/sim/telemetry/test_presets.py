"""Packaged maps: a simulated flight in the form of each export, read by the preset, is the flight again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from command_line import Cli
from scipy.spatial.transform import Rotation

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.earth.references import rotation_XN
from fluxtwin.sim.telemetry.column_map import load_column_map, presets

pytestmark = pytest.mark.property
TIME = np.datetime64("2022-03-01T00:00:00", "ns") + np.arange(0, 6000, 20) * np.timedelta64(1, "s")
R_N, V_N = Orbit(epoch_utc=TIME[0], altitude_km=500.0, inclination_rad=1.7, raan_rad=2.0).propagate(TIME)
R_BN = Rotation.from_rotvec(np.arange(TIME.size)[:, None] * np.radians([[1.1, 0.4, -0.3]]))
NOISE = np.random.default_rng(3).normal(0.0, 20.0, (TIME.size, 3))
FIELD = R_BN.apply(field_N_nT(load_field("igrf14"), TIME, R_N)) + np.array([80.0, -30.0, 20.0]) + NOISE


def as_flown(record: fluxtwin.Telemetry, *, attitude: bool = True) -> None:
    """The record is the flight, and `check` finds nothing in it."""
    assert np.abs(record.time - TIME).max() <= np.timedelta64(1, "us")
    assert np.allclose(record.mag_B_nT, FIELD, atol=1e-3)
    if attitude:
        assert record.q_NB is not None
        off = frames.rotation_from_q(np.array(record.q_NB)) * R_BN.inv()
        assert off.magnitude().max() < 1e-6
        assert fluxtwin.check(record).traps == ()


def test_every_preset_is_valid_and_described(cli: Cli, root: Path, tmp_path: Path) -> None:
    text = (root / "docs" / "telemetry.md").read_text(encoding="utf-8")
    for name in presets():
        assert load_column_map(f"preset:{name}").layout is None
        assert f"| `{name}` |" in text
        assert cli("map", "--preset", name, "--out", tmp_path / f"{name}.toml").status == 0
        assert load_column_map(tmp_path / f"{name}.toml") == load_column_map(f"preset:{name}")
    listed = cli("map", "--preset", "list", "--json", tmp_path / "l.json")
    assert (
        "preset:swarm" in listed.out
        and json.loads((tmp_path / "l.json").read_text(encoding="utf-8"))["presets"] == presets()
    )
    with pytest.raises(BadInput, match=r"no preset 'swarmm'.*preset:swarm"):
        load_column_map("preset:swarmm")
    assert cli("map").status == 2


def swarm() -> xr.Dataset:
    """As viresclient gives it: radius in m, geocentric latitude, a quaternion from body to NEC, zeros for no reading."""
    r_E = frames.rotation_EN(TIME).apply(R_N)
    latitude, longitude, radius = frames.geocentric(r_E)
    q = frames.q_from_rotation(R_BN * rotation_XN("NEC", TIME, R_N).inv())
    return xr.Dataset(
        {
            "B_VFM": (("Timestamp", "VFM"), FIELD, {"units": "nT"}),
            "q_NEC_CRF": (("Timestamp", "quaternion"), q),
            "Latitude": ("Timestamp", np.degrees(latitude), {"units": "deg"}),
            "Longitude": ("Timestamp", np.degrees(longitude), {"units": "deg"}),
            "Radius": ("Timestamp", radius * 1e3, {"units": "m"}),
            "Spacecraft": ("Timestamp", np.full(TIME.size, "A")),
        },
        coords={"Timestamp": TIME},
    )


def test_swarm_as_dataset_and_as_frame() -> None:
    as_flown(fluxtwin.read(swarm(), column_map="preset:swarm"))
    dataset = swarm()
    frame = pd.DataFrame({name: dataset[name].values for name in ("Latitude", "Longitude", "Radius")}, index=TIME)
    frame["B_VFM"], frame["q_NEC_CRF"] = list(dataset["B_VFM"].values), list(dataset["q_NEC_CRF"].values)
    as_flown(fluxtwin.read(frame, column_map="preset:swarm"))
    fit = fluxtwin.calibrate(frame, column_map="preset:swarm", start=str(TIME[10]))
    assert fit.calibration.b_nT == pytest.approx([-80.0, 30.0, -20.0], abs=10.0)


def test_xact_with_the_prefixes_of_its_packets(tmp_path: Path) -> None:
    tai = (TIME - np.datetime64("2000-01-01T12:00:00")).astype("int64") * 1e-9 + 37.0
    table = {"SOH_TIME__TAI_SECONDS": tai, "SOH_TIME__TIME_VALID": np.ones(TIME.size)}
    for stem, value in (
        ("soh_mag__mag_vector_body", FIELD * 1e-9),
        ("SOH_REFS__POSITION_WRT_ECI", R_N),
        ("SOH_REFS__VELOCITY_WRT_ECI", V_N),
        ("SOH_ATT_DET__Q_BODY_WRT_ECI", frames.q_from_rotation(R_BN)),
        ("SOH_ATT_DET__BODY_RATE", np.zeros((TIME.size, 3))),
        ("SOH_RW_DRIVE__FILTERED_SPEED_RPM", np.zeros((TIME.size, 3))),
    ):
        table |= {f"{stem}{k + 1}": column for k, column in enumerate(value.T)}
    pd.DataFrame(table).to_csv(tmp_path / "soh.csv", index=False)
    as_flown(fluxtwin.read(tmp_path / "soh.csv", column_map="preset:xact"))
    pd.DataFrame(table | {"OTHER_TAI_SECONDS": tai}).to_csv(tmp_path / "soh.csv", index=False)
    with pytest.raises(BadInput, match="fits 2 columns: SOH_TIME__TAI_SECONDS, OTHER_TAI_SECONDS"):
        fluxtwin.read(tmp_path / "soh.csv", column_map="preset:xact")


def test_cubeadcs_frames_in_a_folder_with_both_magnetometers(tmp_path: Path) -> None:
    seconds = (TIME - np.datetime64("1970-01-01")).astype("int64") // 10**9
    stamp = {"timeSeconds": seconds, "timeNs": np.zeros(TIME.size, dtype=int)}
    q = frames.q_from_rotation(R_BN * rotation_XN("orbital", TIME, R_N, V_N).inv())
    readings = {f"mag{n}CalVec{a}": FIELD[:, k] * 1e-3 * (1 - 2 * n) for n in (0, 1) for k, a in enumerate("XYZ")}
    valid = {"mag0IsValid": np.ones(TIME.size, dtype=int), "mag1IsValid": (np.arange(TIME.size) != 5).astype(int)}
    pd.DataFrame({**stamp, **readings, **valid}).to_csv(tmp_path / "x_TLM_FRAME_177_y.csv", index=False)
    estimate = {f"estQuatQ{k}": q[:, k] for k in range(4)}
    pd.DataFrame({**stamp, **estimate}).to_csv(tmp_path / "x_TLM_FRAME_211_y.csv", index=False)
    orbit = fluxtwin.Telemetry(time=TIME, mag_B_nT=FIELD, r_N_km=R_N, v_N_km_s=V_N)
    found = fluxtwin.read(tmp_path, column_map="preset:cubeadcs", tle=fluxtwin.write(orbit, tmp_path / "o.oem"))
    as_flown(found)
    assert found.mag2_B_nT is not None and np.isnan(found.mag2_B_nT[5]).all()
    assert np.allclose(found.mag2_B_nT[6], -FIELD[6]) and found.rate_B_rad_s is None  # frames 210 and 172 are not there


def test_a_gomspace_log_with_both_magnetometers(tmp_path: Path) -> None:
    """Mirrors test_mo_data.csv of github.com/FaBa-GS/leop_tools: stamps in whole seconds, nan for what a beacon had not."""
    seconds = (TIME - np.datetime64("1970-01-01")).astype("int64") // 10**9
    rate = np.array([1.1, 0.4, -0.3]) / 20.0
    table = {"ts": seconds, "gyro_temp": np.full(TIME.size, 32.7), "status_str": np.full(TIME.size, np.nan)}
    for name, value in (("mag", FIELD * 1e-2), ("extmag", -FIELD * 1e-2), ("extgyro", np.tile(rate, (TIME.size, 1)))):
        table |= {f"{name}_{k}": column for k, column in enumerate(value.T)}
    table["extmag_1"][5] = np.nan
    pd.DataFrame(table).sort_values("ts", ascending=False).to_csv(tmp_path / "adcs.csv", index=False, na_rep="nan")
    orbit = fluxtwin.Telemetry(time=TIME, mag_B_nT=FIELD, r_N_km=R_N, v_N_km_s=V_N)
    reading = {"column_map": "preset:gomspace", "tle": fluxtwin.write(orbit, tmp_path / "o.oem")}
    found = fluxtwin.read(tmp_path / "adcs.csv", **reading)
    as_flown(found, attitude=False)
    assert found.mag2_B_nT is not None and np.allclose(found.mag2_B_nT[6], -FIELD[6])
    assert np.isnan(found.mag2_B_nT[5]).any() and found.rate_B_rad_s is not None
    both = [fluxtwin.calibrate(tmp_path / "adcs.csv", magnetometer=n, **reading) for n in (1, 2)]
    assert [np.sign(fit.calibration.b_nT[0]) for fit in both] == [-1.0, 1.0]
    assert np.allclose(found.rate_B_rad_s, np.radians(rate))


def test_a_log_of_the_sense_hat(tmp_path: Path) -> None:
    table = {"ROW_ID": np.arange(TIME.size), "yaw": np.zeros(TIME.size)}
    table |= {f"mag_{a}": FIELD[:, k] * 1e-3 for k, a in enumerate("xyz")} | {
        f"gyro_{a}": np.full(TIME.size, 0.1) for a in "xyz"
    }
    stamps = [str(t)[:19].replace("T", " ") for t in TIME]
    pd.DataFrame(table | {"Time_Stamp": stamps}).to_csv(tmp_path / "log.csv", index=False)
    found = fluxtwin.read(tmp_path / "log.csv", column_map="preset:sense_hat")
    as_flown(found, attitude=False)
    assert found.rate_B_rad_s is not None and np.allclose(found.rate_B_rad_s, 0.1) and found.q_NB is None
