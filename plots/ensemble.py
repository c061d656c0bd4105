"""The pointing of an ensemble against time: the middle of the vehicles, nearly all, the worst."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray, TimeArray


def pointing_envelope(
    time: TimeArray,
    p5_deg: FloatArray,
    median_deg: FloatArray,
    p95_deg: FloatArray,
    max_deg: FloatArray,
    *,
    title: str,
    vehicles: int,
) -> Figure:
    """Percentiles over the vehicles at each time, shapes (T,), and the worst vehicle of that time; in logarithms."""
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 3.6)
    axes.fill_between(time, p5_deg, p95_deg, color=style.SKY, alpha=0.45, linewidth=0, label="5 to 95 %")
    axes.plot(time, median_deg, color=style.BLUE, linewidth=1.4, label="median")
    axes.plot(time, max_deg, color=style.VERMILION, linewidth=0.9, linestyle="--", label="worst of that moment")
    if min(float(np.min(part)) for part in (p5_deg, median_deg)) > 0.0:
        axes.set_yscale("log")
        style.log_ruler(axes.yaxis)
    style.utc(axes, time)
    style.label(axes, y="pointing error [deg]", title=f"{title}: {vehicles} vehicles")
    style.legend_below(figure, axes)
    return figure
