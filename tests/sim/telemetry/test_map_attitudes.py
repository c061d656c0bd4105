"""Attitudes of column maps: every form and every reference of one known motion becomes the same quaternion."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fluxtwin
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.earth.references import rotation_XN
from fluxtwin.sim.earth.sun import sun_direction_N

pytestmark = pytest.mark.property
START = np.datetime64("2020-03-01T00:00:00", "ns")
TIME = START + np.arange(0, 5400, 30) * np.timedelta64(1, "s")
R_N, V_N = Orbit(epoch_utc=START, altitude_km=500.0, inclination_rad=1.7, raan_rad=2.0).propagate(TIME)
ANGLES = np.linspace([10.0, -40.0, 5.0], [300.0, 60.0, -80.0], TIME.size)
SEQUENCES = ["".join(s) for axes in ("xyz", "XYZ") for s in itertools.product(axes, repeat=3) if s[0] != s[1] != s[2]]


def elementary(axis: str, angle_deg: float) -> np.ndarray:
    """Turns vectors about a coordinate axis: the matrix that every textbook prints."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def body_to_reference(sequence: str) -> Rotation:
    """About fixed axes the later turn stands on the left, about the body's own axes on the right."""
    out = []
    for row in ANGLES:
        parts = [elementary(axis.lower(), angle) for axis, angle in zip(sequence, row, strict=True)]
        out.append(np.linalg.multi_dot(parts if sequence.isupper() else parts[::-1]))
    return Rotation.from_matrix(np.array(out))


def read(folder: Path, spec: str, columns: np.ndarray, mag: np.ndarray | None = None) -> fluxtwin.Telemetry:
    names = [f"c{k}" for k in range(columns.shape[1])]
    table = np.hstack([columns, R_N, V_N, np.full((TIME.size, 3), 1.0) if mag is None else mag])
    head = ",".join(["t", *names, "rx,ry,rz,vx,vy,vz,bx,by,bz"])
    rows = [",".join([f"{t}Z", *map(repr, row)]) for t, row in zip(TIME.astype(str), table.tolist(), strict=True)]
    (folder / "t.csv").write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    listed = ", ".join(f'"{name}"' for name in names)
    (folder / "m.toml").write_text(
        f"""[[file]]
time = {{ recipe = "iso", columns = "t" }}
[file.columns]
mag = {{ from = ["bx", "by", "bz"], unit = "nT" }}
position = {{ from = ["rx", "ry", "rz"], unit = "km", frame = "GCRS" }}
velocity = {{ from = ["vx", "vy", "vz"], unit = "km/s", frame = "GCRS" }}
attitude = {{ from = [{listed}], {spec} }}
""",
        encoding="utf-8",
    )
    return fluxtwin.read(folder / "t.csv", column_map=folder / "m.toml")


def off_rad(record: fluxtwin.Telemetry, R_BN: Rotation) -> float:
    assert record.q_NB is not None
    return float((frames.rotation_from_q(record.q_NB) * R_BN.inv()).magnitude().max())


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_angles_of_every_sequence(tmp_path: Path, sequence: str) -> None:
    truth = body_to_reference(sequence).inv()
    found = read(tmp_path, f'euler = "{sequence}", unit = "deg", relative_to = "GCRS"', ANGLES)
    assert off_rad(found, truth) < 1e-9
    wrong = read(tmp_path, f'euler = "{sequence}", unit = "deg", relative_to = "GCRS", sense = "conjugate"', ANGLES)
    assert off_rad(wrong, truth.inv()) < 1e-9 and off_rad(wrong, truth) > 0.1


def test_twelve_sequences_about_the_body_and_twelve_about_fixed_axes() -> None:
    assert len(SEQUENCES) == 24


@pytest.mark.parametrize("vectors", ["x z", "z x", "y x"])
def test_where_two_body_axes_point(tmp_path: Path, vectors: str) -> None:
    R_BN = body_to_reference("ZYX").inv()
    axes = [R_BN.inv().apply(np.eye(3)["xyz".index(axis)]) for axis in vectors.split()]
    slack = axes[1] + 0.3 * axes[0]  # the second only says the plane
    found = read(tmp_path, f'vectors = "{vectors}", relative_to = "GCRS"', np.hstack([2.0 * axes[0], slack]))
    assert off_rad(found, R_BN) < 1e-9


def test_sun_and_nadir_as_measured(tmp_path: Path) -> None:
    R_BN = body_to_reference("ZYX").inv()
    sun, nadir = R_BN.apply(sun_direction_N(TIME, R_N)), R_BN.apply(-R_N)
    tilted = nadir / 6800.0 + 0.05 * sun  # an error of the second towards the first does not matter
    assert off_rad(read(tmp_path, 'vectors = "sun nadir"', np.hstack([sun, tilted])), R_BN) < 1e-9
    assert off_rad(read(tmp_path, 'vectors = "nadir sun"', np.hstack([tilted, sun])), R_BN) > 0.01


@pytest.mark.parametrize("reference", ["J2000", "true_of_date", "ITRS", "NEC", "NED", "orbital"])
def test_an_attitude_relative_to_any_axes(tmp_path: Path, reference: str) -> None:
    R_BN = body_to_reference("ZYX").inv()
    R_XN = rotation_XN(reference, TIME, R_N, V_N)
    q = frames.q_from_rotation(R_BN * R_XN.inv())
    found = read(tmp_path, f'order = "xyzw", relative_to = "{reference}"', q)
    assert off_rad(found, R_BN) < 1e-7


def test_north_east_down_is_geodetic() -> None:
    """At 45 deg latitude the ellipsoid's normal is 0.19 deg off the geocentric direction (known flattening 1/298.257)."""
    r_E = frames.from_geodetic(np.radians([45.0]), np.radians([10.0]), np.array([500.0]))
    r_N = frames.rotation_EN(TIME[:1]).apply(r_E, inverse=True)
    between = rotation_XN("NED", TIME[:1], r_N) * rotation_XN("NEC", TIME[:1], r_N).inv()
    assert np.degrees(between.magnitude()[0]) == pytest.approx(0.1924 * 6371.0 / 6871.0, abs=0.003)


@pytest.mark.parametrize(
    ("true", "stated"), [("GCRS", "NEC"), ("NEC", "orbital"), ("orbital", "ITRS"), ("ITRS", "GCRS")]
)
def test_check_names_what_an_attitude_is_really_relative_to(tmp_path: Path, true: str, stated: str) -> None:
    R_BN = Rotation.from_rotvec(np.arange(TIME.size)[:, None] * np.radians([[1.1, 0.4, -0.3]]))
    field = R_BN.apply(field_N_nT(load_field("igrf14"), TIME, R_N)) + np.array([800.0, -300.0, 200.0])
    field += np.random.default_rng(3).normal(0.0, 50.0, field.shape)
    q = frames.q_from_rotation(R_BN * rotation_XN(true, TIME, R_N, V_N).inv())
    read(tmp_path, f'order = "xyzw", relative_to = "{stated}"', q, field)
    words = {"GCRS": "inertial", "ITRS": "Earth-fixed", "NEC": "north, east", "orbital": "orbital frame"}[true]
    traps = fluxtwin.check(tmp_path / "t.csv", column_map=tmp_path / "m.toml").traps
    assert [trap.code for trap in traps] == ["attitude_convention"] and words in traps[0].text
    read(tmp_path, f'order = "wxyz", relative_to = "{true}"', q, field)
    traps = fluxtwin.check(tmp_path / "t.csv", column_map=tmp_path / "m.toml").traps
    assert [trap.code for trap in traps] == ["attitude_convention"] and "scalar last" in traps[0].text
    read(tmp_path, f'order = "xyzw", relative_to = "{true}"', q, field)
    assert fluxtwin.check(tmp_path / "t.csv", column_map=tmp_path / "m.toml").traps == ()


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ('euler = "ZZX", unit = "deg", relative_to = "GCRS"', "no sequence"),
        ('euler = "ZyX", unit = "deg", relative_to = "GCRS"', "no sequence"),
        ('euler = "ZYX", relative_to = "GCRS"', "wants a unit"),
        ('order = "xyzw", relative_to = "GCRS", unit = "deg"', "takes no unit"),
        ('euler = "ZYX", unit = "deg"', "wants relative_to"),
        ('euler = "ZYX", order = "xyz", unit = "deg", relative_to = "GCRS"', "order and euler"),
        ('vectors = "sun moon"', "known: sun nadir"),
        ('vectors = "sun nadir", relative_to = "GCRS"', "define the reference"),
    ],
)
def test_what_says_no_attitude_is_refused(tmp_path: Path, spec: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read(tmp_path, spec, ANGLES)
