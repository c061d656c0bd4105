"""Figures of a record that the pages of calibration, check and diagnosis share."""

from __future__ import annotations

import numpy as np

from fluxtwin.plots.evidence import draw_drivers, draw_field_coverage
from fluxtwin.plots.time_series import TimeSeries, field_panels
from fluxtwin.scenarios.page import FigureBlock
from fluxtwin.sim.base.types import BoolArray, FloatArray, IntArray
from fluxtwin.sim.telemetry.quantities import BY_NAME, FAMILIES, WHEELS
from fluxtwin.sim.telemetry.record import Telemetry

_NO_DRIVERS = ("r_N_km", "v_N_km_s", "mag_B_nT", "mag2_B_nT", "q_NB", "sun_B", "nadir_B")


def field_block(
    record: Telemetry,
    measured_nT: FloatArray,
    predicted_nT: FloatArray | None,
    words: str,
    aside: BoolArray | None = None,
) -> FigureBlock:
    """|B| and components, (N, 3) or (N, 1), of a record of N rows; words: what predicts them, a sentence; aside: (N,) rows
    that were set aside."""
    if aside is not None and aside.any():
        words += " Crosses: rows set aside. Arrows at the edge: values beyond it."
    panels = field_panels(measured_nT, predicted_nT, aside)
    return FigureBlock("field", words, TimeSeries("The field, measured and predicted", record.time, panels))


def coverage_block(directions_B: FloatArray, counts: IntArray) -> FigureBlock:
    """The sky of the body: equal areas of directions, their middles (K, 3), and the rows (K,) in each."""
    caption = (
        "Directions of the field in body axes, an equal-area map: longitude from body x to y, latitude towards z. Each dot "
        f"is one of {counts.size} equal areas, coloured by its rows; open where there was none."
    )
    return FigureBlock("coverage", caption, draw_field_coverage(directions_B, counts))


def driver_blocks(record: Telemetry, residuals: dict[str, FloatArray]) -> list[FigureBlock]:
    """Residuals (N, K) [nT], by what they are called, against what the record of N rows has beside the field."""
    figure = draw_drivers(_columns(record), residuals)
    caption = (
        "Small dots: samples. Large dots: means over similar values, with 1 sigma. A slope or a step indicates an effect "
        "that is not modelled. The quantity that explains most of the residual comes first."
    )
    return [] if figure is None else [FigureBlock("drivers", caption, figure)]


def _columns(record: Telemetry) -> dict[str, FloatArray]:
    """What may drive a field, (N,) by name with unit; |B| too."""
    found = {"|B| [nT]": np.linalg.norm(record.mag_B_nT, axis=1)}
    for quantity in (*BY_NAME.values(), WHEELS):
        values = None if quantity.name in _NO_DRIVERS else getattr(record, quantity.name, None)
        if values is None:
            continue
        parts = np.reshape(values, (len(record), -1)).T
        unit = next(unit for unit, factor in quantity.units.items() if factor == 1.0)
        stems = quantity.stems if len(parts) == len(quantity.stems) else [f"wheel_{k + 1}" for k in range(len(parts))]
        found |= {f"{stem} [{unit.replace('_', '/') or 1}]": part for stem, part in zip(stems, parts, strict=True)}
    for family in FAMILIES:
        unit = "1" if family.binary else "unit"  # of the user's column, whose unit no file has
        found |= {f"{family.prefix}{name} [{unit}]": of for name, of in getattr(record, family.field).items()}
    return {name: np.asarray(values, dtype=np.float64) for name, values in found.items()}
