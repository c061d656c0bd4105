"""How results look: as text, as HTML for a notebook, as one picture. `Shown` in `sim.base` calls this by its name."""

from __future__ import annotations

import html as html_
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from fluxtwin import calibration_page, campaign_page, check_page, describing, diagnosis_page, fleets, flying, plan_page
from fluxtwin.calib.attitude.three_axis import AttitudeSolution
from fluxtwin.calib.attitude.yaw import YawSolution
from fluxtwin.calib.checks.report import CheckReport
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.onboard.export import Export
from fluxtwin.calib.trend import Trend
from fluxtwin.campaigning import Campaign
from fluxtwin.console import shown
from fluxtwin.following import Followed
from fluxtwin.gap.fleet import Fleet
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.gap.records.plan import CalibrationPlan, Plan
from fluxtwin.plots import on_axes, style
from fluxtwin.plots.plan import power_on, sigma_on
from fluxtwin.scenarios.page import StudyResult, Table, with_rows
from fluxtwin.sim.base.errors import BadInput, amount
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.run.ensemble.run import Ensemble
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.trending import trend_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Presented:
    """A result in words: sentences, then tables."""

    sentences: Sequence[str]
    tables: Sequence[Table]


def report(result: object) -> str:
    """The result as text, a line a sentence, tables in columns."""
    seen = presented(result)
    return "\n".join([*seen.sentences, *("\n" + _text(table) for table in seen.tables)]) + "\n"


def html(result: object) -> str:
    """The result as HTML without scripts; every text is escaped."""
    seen = presented(result)
    sentences = "".join(f"<p>{html_.escape(text)}</p>" for text in seen.sentences)
    return f'<div class="fluxtwin">{sentences}{"".join(map(_html, seen.tables))}</div>'


def plot(result: object, axes: Axes | None = None) -> Axes:
    """One picture of the result in `axes` or new ones. Raises BadInput where there is nothing to draw."""
    if not isinstance(result, tuple(_PICTURES)) or (isinstance(result, Telemetry) and not result.has_reading.any()):
        raise BadInput(f"there is nothing to draw in this {type(result).__name__}", where="plot")
    if axes is None:
        _, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 3.0)
    if not hasattr(axes, "plot"):
        raise BadInput(
            f"an object of type {type(axes).__name__} was given", where="axes", wanted="one Axes of matplotlib"
        )
    drawn: Axes = _of(result, _PICTURES)(axes, result)
    return drawn


def presented(result: object) -> Presented:
    """What a result says of itself."""
    found: Presented = _of(result, _WORDS)(result)
    return found


def _of(result: object, by_type: dict[type, Callable[..., Any]]) -> Callable[..., Any]:
    return next(make for kind, make in by_type.items() if isinstance(result, kind))


def _diagnosis(found: Diagnosis) -> Presented:
    sentences = [found.sentence, *diagnosis_page.lines(found), *found.notes]
    return Presented(sentences, diagnosis_page.tables(found))


def _followed(found: Followed) -> Presented:
    whole = _diagnosis(found.diagnosis)
    return Presented([found.line, *whole.sentences], whole.tables)


def _inventory(found: describing.Inventory) -> Presented:
    span = "" if found.start is None else f", {found.start} to {found.end}"
    columns = ("column", "unit", "known", "every [s]", "lowest", "median", "highest")
    rows = [(c.name, c.unit, c.known, c.step_s, c.low, c.median, c.high) for c in found.columns]
    lacking = [f"{verb} lacks {', '.join(missing)}" for verb, missing in found.lacks.items() if missing]
    unread = [found.unread] if found.unread else []
    return Presented(
        [f"{found.source}: {amount(found.rows, 'row|rows')}{span}", *unread, *lacking],
        [Table("Columns", columns, rows)],
    )


def _yaw(found: YawSolution) -> Presented:
    summary = found.summary
    left_out = [f"- {amount(count, 'row|rows')} left out: {reason}" for reason, count in found.left_out.items()]
    columns = ("smallest [deg]", "median [deg]", "largest [deg]")
    tables = [Table("Sigma of yaw", columns, [[*summary["sigma_deg"].values()]])]
    rms = summary["rms_against_reference_deg"]
    if rms["full"] is not None:
        columns = ("full solution [deg]", "first order [deg]", "yaw = 0 [deg]")
        tables.append(Table("Yaw error against the reference attitude, rms", columns, [[*rms.values()]]))
    return Presented([amount(summary["samples"], "sample|samples"), *left_out], tables)


def _attitude(found: AttitudeSolution) -> Presented:
    def degrees(aided: bool) -> str:
        sizes = found.expected_deg(aided)
        return "no row" if sizes is None else ", ".join(plain(size, 2) for size in sizes) + " deg"

    head = {
        "good": "Good: nothing contradicts the attitude",
        "usable": f"Usable: the innovations are as predicted, but {'; '.join(found.limits)}",
        "bad": "Bad: the attitude does not hold",
    }[found.level]
    aside = f"; {found.set_aside} not used" if found.set_aside else ""
    nis = ", ".join(f"{sensor} {plain(value)}" for sensor, value in found.nis.items())
    sentences = [
        f"{head}. 1 sigma about body x, y, z: {degrees(True)} with the {found.aid}, {degrees(False)} without.",
        f"Used: {found.source} and the calibrated field{aside}.",
        *found.reasons,
        f"Squared innovations divided by their prediction (1 is right): {nis}; the field's have a correlation of "
        f"{found.lag_correlation:.2f} from row to row.",
        f"Errors, 1 sigma, declared or found: {_sizes(found)}.",
    ]
    return Presented(sentences, [])


def _sizes(found: AttitudeSolution) -> str:
    """The errors that matter; one far below its neighbour is not determined by the data."""
    n, parts = found.noises, []
    other, drift_deg = "reference" if "reference" in found.source else "nadir", np.degrees(n.drift_rad)
    for name, white, slow, slow_s, unit in (
        ("field", n.field_nT, n.slow_nT, n.slow_s, "nT"),
        (other, np.degrees(n.white_rad), drift_deg, n.drift_s, "deg"),
    ):
        if name == "field" or "attitude" in found.nis:
            size = [f"{plain(white, 2)} {unit} white"] if white > 0.1 * slow else []
            size += [f"{plain(slow, 2)} {unit} over {plain(slow_s, 2)} s"] if slow > 0.1 * white else []
            parts.append(f"{name} {' and '.join(size)}")
    if "sun" in found.nis:
        parts.append(f"sun {plain(np.degrees(n.sun_rad), 2)} deg white")
    walks = ", ".join(f"{walk:.2g}" for walk in (n.walk_x_rad_s, n.walk_y_rad_s, n.walk_z_rad_s))
    return "; ".join([*parts, f"random walk of the rate about x, y, z {walks} rad/s in a second"])


def _draw_fit(axes: Axes, fit: Fit) -> Axes:
    title = f"Residuals of {fit.method}: {fit.statistics.component_rms_nT:.3g} nT rms"
    residual_nT = calibration_page.reading_minus_model(fit)
    return on_axes.components(axes, fit.time, residual_nT, y="residual [nT]", title=title, aside=~fit.kept)


def _draw_diagnosis(axes: Axes, found: Diagnosis) -> Axes:
    stages = found.where.to_dict()["probabilities"]["stage"]
    named = sorted(stages.items(), key=lambda one: -one[1])[:7]
    return on_axes.shares(axes, named, title=f"Where the gap lies: {found.verdict}")


def _draw_yaw(axes: Axes, found: YawSolution) -> Axes:
    yaw_deg = np.degrees(found.yaw_rad)[:, None]
    return on_axes.components(axes, found.time, yaw_deg, y="yaw [deg]", title="Yaw", names=("yaw",))


def _draw_attitude(axes: Axes, found: AttitudeSolution) -> Axes:
    sigma_deg, title = np.degrees(found.sigma_rad), "Error of the attitude about body x, y, z"
    return on_axes.components(axes, found.time, sigma_deg, y="1 sigma [deg]", title=title)


def _draw_record(axes: Axes, record: Telemetry) -> Axes:
    title = f"Readings{f' of {record.spacecraft}' if record.spacecraft else ''}"
    y = "magnetometer, body axes [nT]"
    return on_axes.components(axes, record.time, np.array(record.mag_B_nT), y=y, title=title)


def _calibration(known: Calibration) -> Presented:
    span = [] if known.span is None else [f"Data of {' to '.join(epoch.iso(one, 's') for one in known.span)}."]
    method = [f"{known.method[0].upper()}{known.method[1:]}."] if known.method else []
    said = [*method, *span, *known.unobservable] or ["Stated, not estimated."]
    return Presented(said, calibration_page.parameter_tables(known))


def _truth(known: Truth) -> Presented:
    first, last = (epoch.iso(one, "s") for one in known.time[[0, -1]])
    rows = [(part.name, " x ".join(map(str, np.shape(getattr(known, part.name))))) for part in fields(known)[:-1]]
    return Presented(
        [f"The truth: {known.time.size} rows, {first} to {last}."], [Table("Arrays", ("name", "size"), rows)]
    )


def _export(made: Export) -> Presented:
    sentences = [made.formula, f"source: {made.source}", *made.lines, *made.notes]
    return Presented(sentences, [Table("Numbers", ("number", "value", "unit"), made.numbers)])


def _draw_ensemble(axes: Axes, flown: Ensemble) -> Axes:
    if flown.envelope is None:
        raise BadInput("its vehicles have no pointing to draw", where="plot", wanted="a scenario that points")
    around, title, names = flown.envelope, "Pointing error over the vehicles", ("median", "95 %", "largest")
    size_deg = np.stack([around.median_deg, around.p95_deg, around.max_deg], axis=1)
    return on_axes.components(axes, around.time, size_deg, y="pointing error [deg]", title=title, names=names)


def _draw_trend(axes: Axes, found: Trend) -> Axes:
    bias = [one for one in found.histories if one.name in ("b1", "b2", "b3")]
    moved_nT = np.stack([one.values - one.mean for one in bias], axis=1)
    return on_axes.components(axes, found.time, moved_nT, y="b less its mean [nT]", title="Bias over the calibrations")


_WORDS: dict[type, Callable[[Any], Presented]] = {
    Fit: lambda fit: Presented([*getattr(fit.verdict, "lines", ()), *fit.messages], calibration_page.tables(fit)),
    Calibration: _calibration,
    Diagnosis: _diagnosis,
    Plan: lambda found: Presented([found.sentence, *found.notes], [plan_page.plan_table(found)]),
    CalibrationPlan: lambda found: Presented([found.sentence, *found.notes], [plan_page.plan_table(found)]),
    CheckReport: lambda found: Presented([check_page.verdict(found)], with_rows(check_page.findings_table(found))),
    YawSolution: _yaw,
    AttitudeSolution: _attitude,
    Followed: _followed,
    Fleet: lambda found: Presented(found.lines, fleets.tables(found)),
    Campaign: lambda found: Presented(campaign_page.sentences(found.summary), campaign_page.tables(found.summary)),
    Trend: lambda found: Presented(found.lines, [trend_table(found)]),
    Export: _export,
    Ensemble: lambda found: Presented([flying.ensemble_sentence(found)], [flying.ensemble_table(found)]),
    StudyResult: lambda found: Presented([found.status_line], found.tables),
    Telemetry: lambda record: _inventory(describing.of_record(record)),
    Truth: _truth,
    describing.Inventory: _inventory,
}
_PICTURES: dict[type, Callable[[Axes, Any], Axes]] = {
    Fit: _draw_fit,
    Diagnosis: _draw_diagnosis,
    Followed: lambda axes, found: _draw_diagnosis(axes, found.diagnosis),
    Plan: lambda axes, found: power_on(axes, found.questions[0]),
    CalibrationPlan: sigma_on,
    YawSolution: _draw_yaw,
    Trend: _draw_trend,
    AttitudeSolution: _draw_attitude,
    Ensemble: _draw_ensemble,
    Telemetry: _draw_record,
}


def _text(table: Table) -> str:
    cells = [[*map(str, table.columns)], *([shown(cell) for cell in row] for row in table.rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(table.columns))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
    return "\n".join([table.title, *lines, *([table.note] if table.note else [])])


def _html(table: Table) -> str:
    head = "".join(f"<th>{html_.escape(str(name))}</th>" for name in table.columns)
    rows = "".join(
        "<tr>" + "".join(f"<td>{html_.escape(shown(cell))}</td>" for cell in row) + "</tr>" for row in table.rows
    )
    note = f"<p>{html_.escape(table.note)}</p>" if table.note else ""
    return (
        f"<h4>{html_.escape(table.title)}</h4><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{note}"
    )
