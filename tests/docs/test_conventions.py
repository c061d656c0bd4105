"""The table of nine systems: each row, read as its map's keys say, is the attitude of the page."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from command_line import ROOT
from scipy.spatial.transform import Rotation

import fluxtwin
from fluxtwin.sim.earth import frames

pytestmark = pytest.mark.reference
ROWS = {
    row[0].partition(",")[0]: ([float(x) for x in row[1].split(",")], row[2], row[3])
    for line in (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8").splitlines()
    if len(row := [cell.strip() for cell in line.strip("|").split("|")]) == 6 and re.match(r"-?[\d.]+,", row[1])
}
A = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Its rows are the axes of the body in inertial components: x along inertial y, y against inertial x."""


def test_there_are_nine() -> None:
    assert len(ROWS) == 9


@pytest.mark.parametrize("system", ROWS)
def test_a_map_reads_each(system: str, tmp_path: Path) -> None:
    q, order, sense = ROWS[system]
    (tmp_path / "t.csv").write_text(
        "t,a,b,c,d,rx,ry,rz,bx,by,bz\n"
        + "".join(f"2026-03-01T00:0{k}:00Z,{','.join(map(str, q))},7000,0,{k},1,2,3\n" for k in range(3)),
        encoding="utf-8",
    )
    (tmp_path / "m.toml").write_text(
        f"""[[file]]
time = {{ recipe = "iso", columns = "t" }}
[file.columns]
mag = {{ from = ["bx", "by", "bz"], unit = "nT" }}
position = {{ from = ["rx", "ry", "rz"], unit = "km", frame = "GCRS" }}
attitude = {{ from = ["a", "b", "c", "d"], order = "{order}", sense = "{sense}", relative_to = "GCRS" }}
""",
        encoding="utf-8",
    )
    record = fluxtwin.read(tmp_path / "t.csv", column_map=tmp_path / "m.toml")
    assert np.abs(frames.rotation_from_q(record.q_NB).as_matrix() - A).max() < 1e-5  # five digits are printed


def axes_turned(x: float, y: float, z: float, w: float) -> np.ndarray:
    """Wertz 1978, eq. 12-13, and Basilisk's EP2C: components in the turned axes."""
    v = np.array([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) - 2 * w * cross


def vectors_turned(x: float, y: float, z: float, w: float) -> np.ndarray:
    """SPICE's q2m, and what PX4 multiplies body components by."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.parametrize(
    ("system", "formula", "matrix"),
    [
        ("this project", axes_turned, A),
        ("CCSDS AEM", axes_turned, A),
        ("42", axes_turned, A),
        ("STK", axes_turned, A),
        ("CubeADCS", axes_turned, A),
        ("Basilisk", axes_turned, A),
        ("PX4", vectors_turned, A.T),
        ("SPICE", vectors_turned, A),
        ("scipy", lambda *q: Rotation.from_quat(q).as_matrix(), A),
    ],
)
def test_each_system_means_the_attitude_of_the_page(system, formula, matrix) -> None:
    q, order, _ = ROWS[system]
    x, y, z, w = q if order == "xyzw" else [*q[1:], q[0]]
    assert np.abs(formula(x, y, z, w) - matrix).max() < 1e-5
    assert np.abs(formula(x, y, z, w) - matrix.T).max() > 1
