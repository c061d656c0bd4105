"""The error of an attitude estimate along the time, about the three body axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.types import FloatArray

_MOST = 4000
"""Points drawn of a series."""


@dataclass(frozen=True)
class AttitudeError:
    """N samples."""

    seconds_s: FloatArray
    """(N,)."""
    error_deg: FloatArray
    """(N, 3) about body x, y, z."""


def draw_attitude_error(record: AttitudeError, *, title: str) -> Figure:
    """One panel, three lines, with the rms of each and their root sum of squares."""
    figure, grid = style.figure(7.2, 3.4)
    style.heading(figure, title)
    axes = grid[0][0]
    every = slice(None, None, max(1, len(record.seconds_s) // _MOST))
    rms = np.sqrt((record.error_deg**2).mean(axis=0))
    style.zero_line(axes)
    for k, name in enumerate("XYZ"):
        axes.plot(
            record.seconds_s[every] / 60.0, record.error_deg[every, k], linewidth=0.7, color=style.AXIS_COLOURS[k],
            linestyle=style.AXIS_LINES[k], alpha=0.8, label=f"{name}: rms {rms[k]:.3g} deg",
        )  # fmt: skip
    style.label(axes, x="time [min]", y="attitude error [deg]")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.15 * (high - low))  # room for the legend
    style.legend(axes, "upper right", columns=3)
    style.note(axes, f"RSS {np.sqrt((rms**2).sum()):.3g} deg", y=0.04)
    return figure
