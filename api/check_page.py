"""What a check found as a page and as a table: the traps, then what was measured and predicted."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np

from fluxtwin.calib.checks.report import CheckReport
from fluxtwin.calib.common.design import reference_field_B_nT
from fluxtwin.evidence import field_block
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table
from fluxtwin.sim.base.errors import FluxtwinError, amount
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry


def check_page(
    found: CheckReport, path: Path, record: Telemetry | str, model: FieldModel, *, reading: str = ""
) -> Page:
    """The page of one check; record: what was read, or why it cannot be; reading: the options that read it."""
    again = "correct what is named (conventions in a column map), and check again."
    return Page(
        title=f"Check: {path.name}",
        verdict=verdict(found),
        next_step=again if found.traps else f"fluxtwin calibrate {shlex.quote(str(path))} {reading}",
        sections=[
            PageSection("What was found", [], [findings_table(found)]),
            PageSection("Measured and predicted", *_readings(record, model)),
        ],
        provenance={"source": found.source, "rows": str(found.samples), "field model": model.name},
    )


def verdict(found: CheckReport) -> str:
    """In a sentence."""
    said, count = found.clean, len(found.traps)
    if count:
        said = f"{count} {'trap' if count == 1 else 'traps'} found: {', '.join(one.code for one in found.traps)}"
    return f"{found.source}: {amount(found.samples, 'row|rows')}; {said}"


def findings_table(found: CheckReport) -> Table:
    """Traps and notes."""
    rows = [(one.severity, one.code, one.text, one.row_count or "") for one in found.findings]
    columns = ("", "code", "finding", "rows") if any(row[-1] for row in rows) else ("", "code", "finding")
    return Table("Findings", columns, [row[: len(columns)] for row in rows])


def _readings(record: Telemetry | str, model: FieldModel) -> tuple[list[str], list[Table], list[FigureBlock]]:
    if isinstance(record, str):
        return [f"They cannot be drawn: {record}"], [], []
    rows = record.select(record.has_reading)
    if not len(rows):
        return ["There is none."], [], []
    predicted, words = None, "Measured only: without a position there is no model field."
    try:
        if rows.has_attitude.any() and rows.has_position.any():
            predicted = reference_field_B_nT(rows, model)
            words = "Measured, and the model field at the position and in the attitude of the file."
        elif rows.r_N_km is not None and rows.has_position.all():
            predicted = np.linalg.norm(field_N_nT(model, rows.time, rows.r_N_km), axis=1, keepdims=True)
            words = "Measured, and the size of the model field at the position in the file."
    except FluxtwinError as refusal:
        words = f"Measured alone. {refusal}"
    return [], [], [field_block(rows, rows.mag_B_nT, predicted, f"{words} Neither is calibrated.")]
