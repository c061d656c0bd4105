"""The picture of the README: the spacecraft of the tutorial on a day that no fit has seen, its gap open and closed.

    python docs/examples/closing_gap.py [--out FIGURE.png]

Monday's telemetry is calibrated as the tutorial does, without and with the column that the diagnosis names; both
calibrations correct Tuesday's. Along the field no attitude error acts: what is drawn is |B| corrected less |B| of the model.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import fluxtwin
from fluxtwin.plots import style
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_E_nT

TUTORIAL = Path(__file__).resolve().parents[1] / "tutorial.md"
HOURS = 9.0
MEAN = 10
"""Rows of a mean: five minutes."""


def telemetry(folder: Path) -> list[fluxtwin.Telemetry]:
    """Monday's and Tuesday's, by the script and the map on the page."""
    text = TUTORIAL.read_text(encoding="utf-8")
    for name, kind in (("make_flight.py", "python"), ("map.toml", "toml")):
        body = re.search(rf"`{name}`:\n\n```{kind}\n(.*?)```", text, re.DOTALL)
        if body is None:
            raise SystemExit(f"{TUTORIAL.name} has no {name}")
        (folder / name).write_text(body[1], encoding="utf-8")
    days = dict(re.findall(r"^\$ python make_flight\.py (\S+) (\S+)$", text, re.MULTILINE))
    for name, day in days.items():
        subprocess.run([sys.executable, "make_flight.py", name, day], cwd=folder, check=True)
    return [fluxtwin.read(folder / name, column_map=folder / "map.toml") for name in days]


def along_nT(record: fluxtwin.Telemetry) -> np.ndarray:
    """(N,) size of the reading less that of the field [nT]."""
    r_E_km = frames.rotation_EN(record.time).apply(np.array(record.r_N_km))
    field = field_E_nT(fluxtwin.load_field("igrf14"), record.time, r_E_km)
    return np.linalg.norm(record.mag_B_nT, axis=1) - np.linalg.norm(field, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=TUTORIAL.parent / "images" / "closing_gap.png")
    with tempfile.TemporaryDirectory() as folder:
        monday, tuesday = telemetry(Path(folder))
    without = fluxtwin.calibrate(monday, attitude_sigma_deg=0.1)
    named = fluxtwin.calibrate(monday, attitude_sigma_deg=0.1, driver=["array_current_A"])
    hours = (tuesday.time - tuesday.time[0]) / np.timedelta64(1, "h")
    shown = hours <= HOURS
    made, grid = style.figure(5.0, 3.3, rows=2, cols=1, share_x=True)  # a telephone shows it 3.6 inches wide
    for (axes,), fit, colour, title in (
        (grid[0], without, style.VERMILION, "S and b calibrated"),
        (grid[1], named, style.BLUE, "with the current that the diagnosis named"),
    ):
        left = along_nT(fluxtwin.apply(tuesday, fit.calibration))
        mean = np.convolve(left, np.ones(MEAN) / MEAN, mode="same")
        current = np.asarray(tuesday.array_current_A) > 0.05
        axes.fill_between(hours, -180, 180, where=current, color=style.ORANGE, alpha=0.18, linewidth=0, step="mid")
        axes.plot(hours[shown], left[shown], ".", color=style.GREY, markersize=2.0, alpha=0.5)
        axes.plot(hours[shown], mean[shown], color=colour, linewidth=1.8)
        style.zero_line(axes)
        axes.set_xlim(0.0, HOURS)
        axes.set_ylim(-180, 180)
        axes.set_title(f"{title}: {np.sqrt(np.mean(left**2)):.0f} nT rms", fontsize=style.LABEL_PT, loc="left")
        style.label(axes, y="residual along\nthe field [nT]")
    style.label(grid[1][0], x=f"hours of {str(tuesday.time[0])[:10]} (shaded: panels in the sun)")
    style.heading(made, "Telemetry of a day that the calibration has not seen")
    out = parser.parse_args().out
    made.savefig(out, dpi=216)
    print(out)


if __name__ == "__main__":
    main()
