"""A calibration as a page and as tables to read: the verdict, degrees, parameters, residuals, what is not observable."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.calib.common.calibration_file import calibration_text
from fluxtwin.calib.common.digits import plain, with_sigma
from fluxtwin.calib.common.direction import CONFIDENCE
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.onboard import for_record
from fluxtwin.calib.common.records import CONVENTION, Calibration, parameter_unit
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table, with_rows
from fluxtwin.sim.base.seals import FORMAT, sealed
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.record import Telemetry

if TYPE_CHECKING:
    from fluxtwin.plots.time_series import TimeSeries


def calibration_page(fit: Fit, title: str, *, next_step: str, record: Telemetry, refused: bool = False) -> Page:
    """The page of one calibration.

    next_step: with the names of the files; record: the readings that were fitted, all their rows; refused: no calibration
    file was made of it.
    """
    verdict = fit.verdict
    lines = () if verdict is None else verdict.lines
    unseen = [_sentence(one) for one in fit.observability] or ["These data determine all requested parameters."]
    written = {} if refused else {"calibration.toml": calibration_text(fit.calibration)}
    return Page(
        title=title,
        verdict=lines[0] if lines else fit.calibration.method,
        next_step=next_step,
        sections=[
            PageSection(
                "What it means",
                [*lines[1:-1], *(["No calibration file was written."] if refused else [])],
                [] if verdict is None or verdict.impossible else [_angles(fit)],
            ),
            *([PageSection("Methods compared", [], comparison_tables(fit))] if fit.comparison else []),
            *_seen(fit, record),
            *_coverage(fit),
            PageSection("Parameters", [], parameter_tables(fit.calibration)),
            *_followed(fit, record),
            PageSection("What these data do not determine", unseen, correlation_tables(fit)),
            PageSection("How it was made", [_sentence(message) for message in fit.messages]),
        ],
        provenance={key: value for key, value in _provenance(fit).items() if not (refused and "SHA-256" in key)},
        downloads={name: sealed(text, "#", f"format {FORMAT}") for name, text in written.items()},
    )


def _seen(fit: Fit, record: Telemetry) -> list[PageSection]:
    """The field as it was measured and predicted, and the residual."""
    from fluxtwin.evidence import field_block

    rows = record.select(fit.rows)
    here = for_record(fit.calibration, rows)
    corrected = here.apply(rows.mag_B_nT, rows.dipole_B_Am2, here.columns_of(record, fit.rows, fitted=True))
    reading = rows.mag_B_nT
    if fit.residuals_nT.shape[1] != 3:
        corrected, reading = (np.linalg.norm(field, axis=1, keepdims=True) for field in (corrected, reading))
    predicted = corrected - reading_minus_model(fit)
    before = reading - predicted
    aside = ~fit.kept
    words = "Measured: the readings as received. Predicted: the model field, rotated by the attitude if there is one."
    of = "in body axes" if fit.residuals_nT.shape[1] == 3 else "in size"
    caption = (
        f"Residuals of {len(fit.time)} rows: calibrated reading minus model, {of}. The first panel has those of the "
        "readings as received."
    )
    if not fit.kept.all():
        caption += " Crosses: rows set aside as outliers. Arrows at the edge: values beyond it."
    return [
        PageSection("Measured and predicted", [], [], [field_block(rows, rows.mag_B_nT, predicted, words, aside)]),
        PageSection(
            "Residuals", [], [_residuals(fit)], [FigureBlock("residuals", caption, residual_series(fit, before))]
        ),
    ]


def reading_minus_model(fit: Fit) -> FloatArray:
    """(N, K) residuals with the sign of a diagnosis, so that they rise with a column as the field in the reading does."""
    return -fit.residuals_nT if fit.residuals_nT.shape[1] == 3 else fit.residuals_nT


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def _followed(fit: Fit, record: Telemetry) -> list[PageSection]:
    """The residual against what it may follow."""
    from fluxtwin.evidence import driver_blocks

    left = np.where(fit.kept[:, None], reading_minus_model(fit), np.nan)
    blocks = driver_blocks(record.select(fit.rows), {"residual": left})
    return [PageSection("What the residual follows", [], [], blocks)] if blocks else []


def pair_page(first: Page, second: Page, shared: str) -> Page:
    """The pages of two magnetometers as one; shared: what their residuals have in common, a sentence."""
    of_second = [
        replace(
            section,
            title=f"The other magnetometer: {section.title[0].lower()}{section.title[1:]}",
            figures=[replace(one, name=f"{one.name}_2") for one in section.figures],
        )
        for section in second.sections
    ]
    opening = PageSection("The other magnetometer", [second.verdict, f"Next: {second.next_step}", shared])
    downloads = {**first.downloads, **{f"2-{name}": text for name, text in second.downloads.items()}}
    return replace(first, sections=[*first.sections, opening, *of_second], downloads=downloads)


def tables(fit: Fit) -> list[Table]:
    """The tables for the terminal, in order."""
    return [*comparison_tables(fit), *parameter_tables(fit.calibration), *correlation_tables(fit)]


def comparison_tables(fit: Fit) -> list[Table]:
    """The methods side by side, where they were compared."""
    compared = fit.comparison
    if compared is None:
        return []
    note = (
        "rms over rows that were not fitted (every other twelfth of the record), the error of the reference attitude "
        f"included; angle: 95 % of them. {compared.why}."
    )
    return [Table("Methods compared", compared.columns, compared.rows, note)]


def parameter_tables(calibration: Calibration) -> list[Table]:
    """Parameters with sigma and unit, to the second digit of sigma, and the fields that follow a column."""
    rows = [
        [name, *with_sigma(float(value), calibration.sigma[name]), parameter_unit(name)]
        for name, value in zip(calibration.names, calibration.values, strict=True)
    ]
    return [Table(CONVENTION, ["parameter", "value", "sigma", "unit"], rows), *_bias_tables(calibration)]


def correlation_tables(fit: Fit) -> list[Table]:
    """The worst five of the correlated pairs; nothing where there are none."""
    pairs = () if fit.verdict is None else fit.verdict.correlated
    rows = [[f"{one}, {other}", f"{value:+.3f}"] for one, other, value in pairs]
    return with_rows(Table("The most correlated pairs of parameters, at most five", ["pair", "correlation"], rows))


def residual_series(fit: Fit, before_nT: FloatArray | None = None) -> TimeSeries:
    """The residuals along the record, with the rows set aside marked; before_nT: (N, K) those without the calibration."""
    from fluxtwin.plots.time_series import TimeSeries, residual_panels

    aside = ~fit.kept
    names = "xyz" if fit.residuals_nT.shape[1] == 3 else ("|B|",)
    title = "Residuals of the calibration" + (f"; {int(aside.sum())} rows set aside" if aside.any() else "")
    return TimeSeries(title, fit.time, residual_panels(reading_minus_model(fit), names, aside, before_nT=before_nT))


def _coverage(fit: Fit) -> list[PageSection]:
    """The sky of the body, and what to fly."""
    from fluxtwin.evidence import coverage_block

    seen = fit.coverage
    if seen is None:
        return []
    rows = [
        [p.words, "" if p.rows is None else str(p.rows), "" if p.ratio is None else plain(p.ratio, 2)]
        for p in seen.plans
    ]
    tables = with_rows(
        Table(
            f"To halve the sigma of {seen.worst}",
            ["more data", "rows", "of this record"],
            rows,
            "Predicted from the Jacobian of this fit, with errors as they are in this record; blank: more than a hundred "
            "records.",
        )
    )
    blocks = [coverage_block(seen.directions_B, seen.counts)]
    return [PageSection("Directions and what to fly", list(seen.lines), tables, blocks)]


def _bias_tables(calibration: Calibration) -> list[Table]:
    rows, late = [], []
    for name, one in calibration.to_dict().get("telemetry_bias", {}).items():
        how = [f"{plain(one['delay_s'])} s later"] if "delay_s" in one else []
        how += [f"behind a lag of {plain(one['lag_s'])} s"] if "lag_s" in one else []
        late += [f"The field follows {name} {' and '.join(how)}."] if how else []
        for axis, value, sigma in zip("xyz", one["nT_per_unit"], one["sigma"], strict=True):
            rows.append([f"{name} {axis}", *with_sigma(value, sigma)])
    title = "Field in the reading per unit of the column [nT]"
    return with_rows(Table(title, ["column", "value", "sigma"], rows, note=" ".join(late)))


def _angles(fit: Fit) -> Table:
    assert fit.verdict is not None
    d = fit.verdict.direction
    rows: list[list[str]] = [
        ["before: readings as received", plain(d.before_deg, 2)],
        ["after: calibrated reading", plain(d.after_deg, 2)],
        ["of that, errors of the calibration", plain(d.calibration_deg, 2)],
        ["of that, noise of one reading", plain(d.noise_deg, 2)],
        ["errors of the calibration in any attitude", plain(d.calibration_anywhere_deg, 2)],
    ]
    if d.against_reference_deg is not None:
        rows.append(["relative to the reference attitude, including its error", plain(d.against_reference_deg, 2)])
    if d.rotation_deg is not None:
        rows.append(["rotation of the sensor, according to the attitude of the record", plain(d.rotation_deg, 2)])
    note = (
        "AKE as in ECSS-E-ST-60-10C, mixed interpretation: over the instants of the record and over the calibrations that "
        "the covariance allows. Only the last row includes the error of the reference attitude."
    )
    if not d.rotation_counted:
        note = (
            "Over the instants of the record and over the calibrations that the covariance allows. No absolute knowledge "
            "error of ECSS-E-ST-60-10C: |B| does not show how the sensor is turned in the body, and these angles do not "
            "count it."
        )
    name = "absolute knowledge error" if d.rotation_counted else "knowledge error without a rotation of the sensor"
    return Table(f"Direction of the field, {name} at {100 * CONFIDENCE:.0f} %", ["of", "angle [deg]"], rows, note)


def _residuals(fit: Fit) -> Table:
    names = "xyz" if fit.residuals_nT.shape[1] == 3 else ["|B|"]
    kept = reading_minus_model(fit)[fit.kept]
    rows = [
        [name, plain(float(series.mean())), plain(float((series**2).mean() ** 0.5)), plain(float(abs(series).max()))]
        for name, series in zip(names, kept.T, strict=True)
    ]
    aside = len(fit.time) - len(kept)
    note = (
        f"{len(kept)} rows; {aside} excluded as outliers are not in these figures." if aside else f"{len(kept)} rows."
    )
    return Table("Residuals [nT]", ["component", "mean", "rms", "largest"], rows, note)


def _provenance(fit: Fit) -> dict[str, str]:
    known = fit.calibration
    span = "" if known.span is None else f"{epoch.iso(known.span[0])} to {epoch.iso(known.span[1])}"
    lines = {
        "spacecraft": known.spacecraft,
        "span": span,
        "samples": str(known.samples),
        "field model": known.field_model,
        "method": known.method,
        "covariance": known.covariance_kind,
        "SHA-256 of the calibration": known.digest,
        "residual to": known.residual_to,
    }
    return {key: value for key, value in lines.items() if value}
