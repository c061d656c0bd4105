"""`fluxtwin run flight-field`: the field models against MAGSAT in 1980 and Swarm A in a storm."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from fluxtwin.scenarios.flight_field import pages
from fluxtwin.scenarios.flight_field.compute import compute, found_figures
from fluxtwin.scenarios.flight_field.figures import compare, read_figures
from fluxtwin.scenarios.flight_field.settings import read_settings
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.recorded_files import check_folder
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings()
    folder = check_folder(data, settings.files)
    outcome = compute(folder, settings, part_of(progress, 0.0, 0.8))
    here = found_figures(outcome, settings)
    findings = compare(read_figures(), here, pages.explanations(outcome))
    progress("drawing the residuals", 0.85)
    summary = pages.summary(outcome, findings, settings)
    page = pages.page(outcome, findings, settings)
    saved = write_text(out / "flight_field.toml", tomli_w.dumps(settings.model_dump()))
    return StudyResult(
        name="flight-field",
        status_line=page.verdict,
        summary=summary,
        tables=pages.tables(outcome, findings, settings),
        page=page,
        written=[saved],
    )
