"""`fluxtwin run flight-gaps`: the diagnosis on records that flew, whose cause it is not told."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from fluxtwin.scenarios.flight_gaps import pages, words
from fluxtwin.scenarios.flight_gaps.compute import compute
from fluxtwin.scenarios.flight_gaps.settings import read_settings
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.page_markdown import as_markdown
from fluxtwin.scenarios.recorded_files import check_folder
from fluxtwin.sim.base.files import write_text
from fluxtwin.sim.base.progress import Progress, part_of, silent


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study. out: an existing folder for the results; data: the folder of recorded flight data.

    Raises BadInput, before anything is written, for a missing folder or file or one that cannot be used.
    """
    settings = read_settings()
    folder = check_folder(data, settings.files)
    outcome = compute(folder, settings, part_of(progress, 0.0, 0.95))
    progress("drawing", 0.95)
    page = pages.page(outcome, settings)
    saved = [
        write_text(out / "flight_gaps.toml", tomli_w.dumps(settings.model_dump())),
        write_text(out / "report.md", as_markdown(page)),
    ]
    return StudyResult(
        name="flight-gaps",
        status_line=words.verdict(outcome),
        summary=pages.summary(outcome, settings),
        tables=pages.tables(outcome),
        page=page,
        written=saved,
    )
