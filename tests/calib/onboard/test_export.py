"""Calibrations for flight software: what the software's own formula makes of the file, and what is read back."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import fluxtwin
from fluxtwin.calib.common.conventions import OffsetFirst, correction_from_offset_first, offset_first_from_correction
from fluxtwin.calib.common.records import Calibration, TelemetryBias
from fluxtwin.calib.onboard.export import FIELDS_NT, NAMES, TARGETS, export_calibration
from fluxtwin.flight_software import as_onboard
from fluxtwin.sim.base.errors import BadInput

pytestmark = pytest.mark.property

READINGS_NT = np.random.default_rng(1).normal(size=(40, 3)) * 25_000.0
SMALL = arrays(np.float64, (3, 3), elements=st.floats(-0.08, 0.08))
OFFSET = arrays(np.float64, (3,), elements=st.floats(-40_000.0, 40_000.0))


def calibration_of(S: np.ndarray, o_nT: np.ndarray, **more: object) -> Calibration:
    correction = correction_from_offset_first(OffsetFirst(np.eye(3) + S, o_nT))
    return Calibration(correction.S, correction.b_nT, **more)  # type: ignore[arg-type]


def ardupilot_flies(text: str, reading_nT: np.ndarray) -> np.ndarray:
    """`AP_Compass_Backend::correct_field`, in mGauss and float32, of a file as Mission Planner reads it."""
    rows = [row for row in csv.reader(io.StringIO(text)) if not row[0].startswith("#")]
    p = {name: np.float32(value) for name, value in rows}
    diagonal, off = ([p[f"COMPASS_{kind}_{axis}"] for axis in "XYZ"] for kind in ("DIA", "ODI"))
    matrix = np.array(
        [[diagonal[0], off[0], off[1]], [off[0], diagonal[1], off[2]], [off[1], off[2], diagonal[2]]], dtype=np.float32
    )
    field = reading_nT.astype(np.float32) / np.float32(100) + np.array([p[f"COMPASS_OFS_{axis}"] for axis in "XYZ"])
    return (field * p["COMPASS_SCALE"]) @ matrix.T * 100


def px4_flies(text: str, reading_nT: np.ndarray) -> np.ndarray:
    """`Magnetometer::Correct`, in Gauss, of a file as QGroundControl reads it; every number taken up."""
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    assert {row[4] for row in rows} == {"9"}
    p = {row[2]: np.float32(row[3]) for row in rows}
    xy, xz, yz = (p[f"CAL_MAG0_{axis}ODIAG"] for axis in "XYZ")
    scale = np.diag([p[f"CAL_MAG0_{axis}SCALE"] for axis in "XYZ"])
    scale = scale + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    offset = np.array([p[f"CAL_MAG0_{axis}OFF"] for axis in "XYZ"])
    return (reading_nT / 1e5 - offset) @ scale.T * 1e5


def gomspace_flies(text: str, reading_nT: np.ndarray) -> np.ndarray:
    """`calibrate_mag` of the operators' tools, in mGauss."""
    p: dict[str, list[np.float32]] = {}
    for name, value in re.findall(r"rparam set (\w+)\[\d\] (\S+)", text):
        p.setdefault(name, []).append(np.float32(value))
    turn = np.array(p["mag_rotation"]).reshape(3, 3)
    turned = (reading_nT / 100 + np.array(p["mag_offset"])) @ turn.T
    return (turned * np.array(p["mag_scale"])) @ turn * 100


FLIES = {"ardupilot": ardupilot_flies, "px4": px4_flies, "gomspace": gomspace_flies}


@pytest.mark.parametrize("to", FLIES)
@given(S=SMALL, o_nT=OFFSET)
def test_the_software_corrects_as_the_calibration_does(to: str, S: np.ndarray, o_nT: np.ndarray) -> None:
    """The formula of the software, written anew from its source, in single precision."""
    known = calibration_of(S + S.T, o_nT)
    flown = FLIES[to](export_calibration(known, to).text, READINGS_NT)
    assert np.abs(flown - known.apply(READINGS_NT)).max() < 0.1  # nT: float32 of 150,000 nT has 0.02


def cubeadcs_flies(to: str, text: str, reading_nT: np.ndarray) -> np.ndarray:
    """The stated formula, of the int16 that the telecommand has."""
    sign, (form, unit) = -1.0 if "-" in to else 1.0, to.removeprefix("cubeadcs:").split(",")
    raw = dict(line.split(",") for line in text.splitlines() if not line.startswith("#"))
    p = {name: float(np.int16(int(value))) / 1000 for name, value in raw.items()}
    S = np.array([[p[f"S{row}{column}"] for column in "123"] for row in "123"])
    offset = sign * np.array([p[f"offset_{n}"] for n in "123"])
    m = reading_nT / {"uT": 1000, "mG": 100}[unit]
    return ((m + offset) @ S.T if "(" in form else m @ S.T + offset) * {"uT": 1000, "mG": 100}[unit]


@pytest.mark.parametrize("to", [name for name in TARGETS if name.startswith("cubeadcs")])
@given(S=SMALL, o_nT=arrays(np.float64, (3,), elements=st.floats(-2_500.0, 2_500.0)))
def test_a_cubeadcs_corrects_by_the_stated_formula(
    to: str, S: np.ndarray, o_nT: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> None:
    known, path = calibration_of(S, o_nT), tmp_path_factory.mktemp("flight") / "x.csv"
    made = export_calibration(known, to)
    made.write(path)
    flown = cubeadcs_flies(to, made.text, READINGS_NT)
    within_nT = 0.0005 * (
        np.abs(READINGS_NT).sum(axis=1).max() + 1.1e3 + 3 * 2_500
    )  # half a step of S and of the offset
    assert np.abs(flown - known.apply(READINGS_NT)).max() <= within_nT
    assert np.allclose(fluxtwin.import_calibration(path).apply(READINGS_NT), flown, rtol=0, atol=1e-6)
    assert pytest.approx(np.eye(3) + S, abs=0.0005 + 1e-12) == as_onboard(path).M


def test_a_cubeadcs_formula_must_be_stated_and_its_numbers_fit() -> None:
    with pytest.raises(BadInput, match="in what unit"):
        export_calibration(calibration_of(np.zeros((3, 3)), np.zeros(3)), "cubeadcs")
    with pytest.raises(BadInput, match="in what unit"):
        export_calibration(calibration_of(np.zeros((3, 3)), np.zeros(3)), "cubeadcs:Sm-o,T")
    with pytest.raises(BadInput, match=r"offset_2 beyond 32\.767 \(int16 in thousandths, mG\)"):
        export_calibration(calibration_of(np.zeros((3, 3)), np.array([0.0, 3_300.0, 0.0])), "cubeadcs:S(m-o),mG")


@pytest.mark.parametrize("to", [name for name in TARGETS if ":" not in name])
@given(S=SMALL, o_nT=OFFSET)
def test_what_is_read_back_is_within_the_rounding(
    to: str, S: np.ndarray, o_nT: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> None:
    known = calibration_of(S + S.T if TARGETS[to].symmetric else S, o_nT)
    made = export_calibration(known, to)
    path = made.write(tmp_path_factory.mktemp("flight") / f"x{TARGETS[to].ending}")
    back = fluxtwin.import_calibration(path)
    field_nT = READINGS_NT / np.linalg.norm(READINGS_NT, axis=1)[:, None] * np.linspace(*FIELDS_NT, 40)[:, None]
    difference = np.linalg.norm(
        back.apply(offset_first_from_correction(known.correction).undo(field_nT)) - field_nT, axis=1
    )
    assert difference.max() <= 1.05 * made.rounding.largest_nT + 1e-9  # the 500 directions need not hold the worst one
    assert made.rounding.largest_nT < (1e-9 if to in ("json", "matlab") else 0.1)
    wrong = calibration_of(S + 1e-3 * np.diag([1.0, 2.0, 3.0]), o_nT)
    assert np.abs(wrong.apply(READINGS_NT) - back.apply(READINGS_NT)).max() > 10 * made.rounding.largest_nT


@given(S=SMALL)
def test_a_symmetric_form_keeps_the_size_of_the_field_and_says_the_angle(S: np.ndarray) -> None:
    known = calibration_of(S, np.array([1000.0, -2000.0, 500.0]))
    made = export_calibration(known, "ardupilot", force=True)
    flown, exact = ardupilot_flies(made.text, READINGS_NT), known.apply(READINGS_NT)
    assert np.allclose(np.linalg.norm(flown, axis=1), np.linalg.norm(exact, axis=1), rtol=1e-6)
    cosine = (flown * exact).sum(axis=1) / np.linalg.norm(flown, axis=1) / np.linalg.norm(exact, axis=1)
    angle_deg = np.degrees(np.arccos(np.clip(cosine, -1, 1))).max()
    assert angle_deg <= 1.001 * made.form.largest_deg + 0.03  # arccos of float32 near 1
    if made.form.largest_deg > 1.0:
        with pytest.raises(BadInput, match=r"rotation of up to .* deg would be lost"):
            export_calibration(known, "ardupilot")


def test_px4_passes_over_what_seems_small_to_it() -> None:
    """Magnetometer.cpp: a change is taken up only beyond 0.01, of the vector of three."""
    made = export_calibration(calibration_of(np.diag([0.004, -0.005, 0.006]), np.array([500.0, 0.0, 0.0])), "px4")
    directions = np.random.default_rng(3).normal(size=(20_000, 3))
    field_nT = FIELDS_NT[1] * directions / np.linalg.norm(directions, axis=1)[:, None]
    as_read = field_nT / (1 + np.array([0.004, -0.005, 0.006])) + [500.0, 0.0, 0.0]  # and nothing is taken out of it
    assert made.passed_over.largest_nT == pytest.approx(np.linalg.norm(as_read - field_nT, axis=1).max(), rel=0.01)
    assert "OFF and SCALE" in made.notes[0]
    taken = export_calibration(calibration_of(0.1 * np.eye(3), np.array([5000.0, 0.0, 0.0])), "px4")
    assert taken.passed_over.largest_nT < 1e-9 and taken.notes == ()


def test_what_a_target_cannot_hold_is_refused_by_name() -> None:
    with pytest.raises(BadInput, match="COMPASS_OFFS_MAX"):
        export_calibration(calibration_of(np.zeros((3, 3)), np.array([2e5, 0.0, 0.0])), "ardupilot")
    with pytest.raises(BadInput, match="scale of"):
        export_calibration(calibration_of(2.5 * np.eye(3), np.zeros(3)), "px4")
    with pytest.raises(BadInput, match=r"not within 0\.5 to 2"):
        export_calibration(calibration_of(1.2 * np.eye(3), np.zeros(3)), "gomspace")
    coupled = calibration_of(np.zeros((3, 3)), np.zeros(3), T_nT_per_Am2=np.eye(3))
    with pytest.raises(BadInput, match="no place for the torquers"):
        export_calibration(coupled, "px4")
    assert "T" in json.loads(export_calibration(coupled, "json").text)
    bias = {"array_current_A": TelemetryBias(np.ones(3), np.ones(3))}
    with pytest.raises(BadInput, match="array_current_A"):
        export_calibration(calibration_of(np.zeros((3, 3)), np.zeros(3), telemetry_bias=bias), "json")
    with pytest.raises(BadInput, match="1 to 3"):
        export_calibration(calibration_of(np.zeros((3, 3)), np.zeros(3)), "ardupilot", instance=4)


def test_a_file_of_several_magnetometers_and_a_damaged_one(tmp_path: Path) -> None:
    one, two = (calibration_of(s * np.eye(3), np.zeros(3)) for s in (0.01, 0.02))
    both = "\n".join(export_calibration(c, "ardupilot", instance=n).text for n, c in ((1, one), (2, two)))
    path = tmp_path / "all.param"
    path.write_text(both, encoding="utf-8")
    assert fluxtwin.import_calibration(path, instance=2).S[0, 0] == pytest.approx(0.02, rel=1e-5)
    assert as_onboard(path, magnetometer=2).M[0, 0] == pytest.approx(1.02, rel=1e-5)
    alone = export_calibration(one, "matlab").write(tmp_path / "one.m")
    assert as_onboard(alone, magnetometer=2).M[0, 0] == pytest.approx(1.01, rel=1e-5)  # it holds only one
    path.write_text(both.replace("COMPASS_DIA_Z", "COMPASS_D_Z"), encoding="utf-8")
    with pytest.raises(BadInput, match="COMPASS_DIA_Z not in the file"):
        fluxtwin.import_calibration(path)
    path.write_text(both.replace("1.01,", "x", 1).replace("COMPASS_DIA_X,1.01", "COMPASS_DIA_X,one"), encoding="utf-8")
    with pytest.raises(BadInput, match="is no number"):
        fluxtwin.import_calibration(path)
    path.write_text("hello", encoding="utf-8")
    with pytest.raises(BadInput, match="no calibration that is known"):
        fluxtwin.import_calibration(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"formula": "", "M": "one"}', "is not the JSON of fluxtwin export"),
        ("M = [1 0 x; 0 1 0; 0 0 1];\n", "is no array of numbers"),
        ("M = [1 0 0; 0 1 0; 0 0 1];\n", "o is missing"),
        ("M = [1 0 0; 0 1 0];\no = [1 2 3];\n", "M is not 9 finite numbers"),
        ("rparam set gain 1.0\n", r"\[0\] is not set"),
        ("COMPASS_OFS_X,1.0\nCOMPASS_OFS_X,2.0\n", "COMPASS_OFS_X stands twice"),
    ],
)
def test_files_of_flight_software_that_hold_no_calibration(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "held.txt").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=said) as caught:
        fluxtwin.import_calibration(tmp_path / "held.txt")
    assert "held.txt" in str(caught.value)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_header_compiles_and_corrects(tmp_path: Path) -> None:
    known = calibration_of(0.05 * np.random.default_rng(2).normal(size=(3, 3)), np.array([100.0, -2000.0, 30.0]))
    export_calibration(known, "c-header").write(tmp_path / "mag.h")
    lines = [
        '#include "mag.h"',
        "#include <stdio.h>",
        "int main(void) { const float m[3] = {30000.0f, -10000.0f, 5000.0f}; int i, j;",
        "for (i = 0; i < 3; i++) { float B = 0; for (j = 0; j < 3; j++)",
        'B += FLUXTWIN_MAG_M[i][j] * (m[j] - FLUXTWIN_MAG_o[j]); printf("%f\\n", B); } return 0; }',
    ]
    (tmp_path / "x.c").write_text("\n".join(lines), encoding="utf-8")
    subprocess.run(["cc", "-o", "x", "x.c"], cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "x"], capture_output=True, text=True, check=True).stdout
    expected = known.apply(np.array([[30000.0, -10000.0, 5000.0]]))[0]
    assert np.allclose([float(line) for line in printed.split()], expected, rtol=0, atol=0.02)


def test_the_command_prints_the_formula_first_and_overwrites_only_its_own(tmp_path: Path, cli: Cli) -> None:
    calibration_of(np.diag([0.01, 0.02, -0.01]), np.array([500.0, 0.0, 0.0])).to_toml(tmp_path / "c.toml")
    out = tmp_path / "mag.params"
    done = cli("export", tmp_path / "c.toml", "--to", "px4", "--out", out)
    assert done.status == 0 and done.out.startswith("B = M (m - OFF)") and "Gauss" in done.out
    assert "nT" in done.out and "deg by the rounding" in done.out
    assert cli("export", tmp_path / "c.toml", "--to", "px4", "--out", out).status == 0
    out.write_text(out.read_text(encoding="utf-8") + "# mine\n", encoding="utf-8")
    refused = cli("export", tmp_path / "c.toml", "--to", "px4", "--out", out)
    assert refused.status == 2 and "--force" in refused.err
    wrong = cli("export", tmp_path / "c.toml", "--to", "px4", "--out", tmp_path / "mag.toml")
    assert wrong.status == 2 and ".params" in wrong.err
    described = cli("export", "--help")
    assert all(name in described.out for name in NAMES)
