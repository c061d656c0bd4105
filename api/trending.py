"""The verb `trend`, and its page: calibrations of several days side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fluxtwin.calib.common.digits import measured
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.methods import with_options
from fluxtwin.notebook import usual
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.verbs import as_record, calibrate, reading_of, with_reading

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fluxtwin.calib.trend import Trend

DAY_H = 24.0
_MEND = "Take longer stretches (--every), or cut this one off (--from, --to, --where)."


@with_options
@with_reading
def trend(
    files: Calibration | Telemetry | Path | str | Sequence[Calibration | Telemetry | Path | str],
    *,
    every_h: float | None = None,
    field: str | FieldModel = "igrf14",
    degree: int | None = None,
    progress: Progress = usual,
    **options: Any,
) -> Trend:
    """Does last month's calibration still hold? From calibrations, or from telemetry that is calibrated here.

    files: calibrations, records, or the paths of their files; or one record of several days.
    every_h: telemetry is cut into stretches of so many hours, from midnight of its first day. None cuts a single record by
    days and takes several records as one stretch each.

    Raises BadInput for fewer than two, or for those that cannot be compared; NoAnswer where a stretch cannot be calibrated.
    """
    from fluxtwin.calib.trend import trend as found

    reading = reading_of(options)
    known: list[Calibration] = []
    records: list[Telemetry] = []
    alone = Calibration | Telemetry | Path | str
    for one in [files] if isinstance(files, alone) or not isinstance(files, Sequence) else files:  # a table is a record
        if isinstance(one, Calibration):
            known.append(one)
        elif isinstance(one, Path | str) and Path(one).suffix.lower() == ".toml":
            known.append(Calibration.from_toml(one))
        else:
            records.append(as_record(one, **reading))
    hours = every_h if every_h is not None else DAY_H if len(records) == 1 and not known else None
    parts = records if hours is None else [part for record in records for part in _cut(record, hours)]
    for place, part in enumerate(parts):
        progress(f"calibrating {place + 1} of {len(parts)}", place / len(parts))
        since = f"telemetry from {np.datetime_as_string(part.time[0], 's')}Z"
        try:
            fit = calibrate(part, field=field, degree=degree, **options)
            if fit.verdict is not None and fit.verdict.impossible:
                raise NoAnswer(fit.verdict.lines[0])
        except NoAnswer as refusal:
            raise NoAnswer(f"{since}: {str(refusal).rstrip('.')}. {_MEND}", evidence=refusal.evidence) from None
        known.append(fit.calibration)
    return found(known)


def _cut(record: Telemetry, hours: float) -> list[Telemetry]:
    """The record in stretches of so many hours from midnight of its first day; the short ends are joined to a neighbour."""
    if not hours > 0:
        raise BadInput(f"{hours:g}", where="--every", wanted="hours, positive")
    start = record.time[0].astype("datetime64[D]").astype("datetime64[ns]")
    number = ((record.time - start).astype(np.float64) / (hours * 3.6e12)).astype(np.int64)
    parts = [np.flatnonzero(number == one) for one in np.unique(number)]
    typical = float(np.median([len(rows) for rows in parts]))
    joined: list[np.ndarray] = []
    for rows in parts:
        if joined and (len(rows) < 0.5 * typical or len(joined[-1]) < 0.5 * typical):
            joined[-1] = np.concatenate([joined[-1], rows])
        else:
            joined.append(rows)
    return [record.select(rows) for rows in joined]


def trend_table(found: Trend) -> Table:
    """A row a parameter: mean, whether it held, and what it did."""
    from fluxtwin.calib.trend import chance

    rows = []
    for one in found.histories:
        what = {"drift": "a day", "temperature": "a degC", "step": f"after {one.after} of them"}.get(one.kind)
        size = "" if what is None else f"{measured(one.size, one.size_sigma)} {what}"
        mean, probability = measured(one.mean, one.mean_sigma), chance(one.probability)
        rows.append([one.name, mean, one.unit, f"{one.q:.1f}", probability, one.kind, size])
    freedom = len(found.time) - 1
    note = (
        f"Q: Cochran's statistic with {freedom} degree{'s' if freedom > 1 else ''} of freedom. Probability: that Q is "
        "as large if nothing changed. A step, drift or line in temperature is given only where it is significant at 1 % for "
        "all parameters together, corrected for all that were tried; what changed otherwise varies."
    )
    columns = ["parameter", "mean", "unit", "Q", "probability", "history", "size"]
    return Table("Parameters over the calibrations", columns, rows, note)


def trend_figure(found: Trend) -> Figure:
    """Every parameter over time."""
    from fluxtwin.plots.calibration import draw_trend

    courses = {}
    for one in found.histories:
        x = (found.time - found.time[0]) / np.timedelta64(1, "D")
        if one.kind == "step":
            x = (np.arange(x.size) >= one.after).astype(np.float64)
        elif one.kind == "temperature" and found.temperature_degC is not None:
            x = found.temperature_degC
        weight = one.sigmas**-2.0
        fitted = one.mean + one.size * (x - (weight * x).sum() / weight.sum())
        name = one.name if one.unit == "1" else f"{one.name} [{one.unit}]"
        courses[name] = (one.values, one.sigmas, fitted, one.kind)
    return draw_trend(found.time, courses)


def trend_page(found: Trend) -> Page:
    """The page of one trend."""
    caption = (
        "Dots: values with 1 sigma. Line: the history that fits each parameter best (the mean where it varies), grey where "
        "it is constant and red where the parameter changed."
    )
    return Page(
        title=f"{len(found.time)} calibrations compared",
        verdict=found.lines[0],
        next_step="keep the calibration in use."
        if found.holds
        else "calibrate anew with the telemetry after the change.",
        sections=[
            PageSection("What it means", list(found.lines[1:])),
            PageSection("Parameters", [], [trend_table(found)], [FigureBlock("trend", caption, trend_figure(found))]),
        ],
    )
