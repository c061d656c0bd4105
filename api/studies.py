"""Run a study and write its page: `summary.json`, the figures as PNG, `report.html`."""

from __future__ import annotations

import shlex
from pathlib import Path

import fluxtwin
from fluxtwin.notebook import usual
from fluxtwin.outputs import JSON_MARK
from fluxtwin.report import png_bytes, write_page
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.registry import STUDIES, find_study
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import writable_folder, write_bytes, write_json
from fluxtwin.sim.base.progress import Progress, part_of
from fluxtwin.sim.base.seals import sealed_json


def run_study(
    name: str,
    out: Path | str | None = None,
    data: Path | str | None = None,
    progress: Progress = usual,
    *,
    attitude: str | None = None,
) -> tuple[StudyResult, list[Path]]:
    """Run the study `name`; returns its result and every file written, its own and ours.

    out: folder for the results, `./NAME-results` by default. data: folder of recorded data, for the studies
    that need one. attitude: for the studies of a vehicle that torques move, "dynamics" (the default) or
    "prescribed". Raises BadInput for an unknown name or attitude, a missing data folder or a folder that cannot be
    written, before the work starts.
    """
    run = find_study(name)
    study = STUDIES.get(name)
    if data is None and study is not None and study.needs_data:
        raise BadInput(
            f"the study {name} compares with recorded data",
            where="run",
            wanted="--data DIR, the folder that holds them",
        )
    if data is not None and not Path(data).is_dir():
        raise BadInput("no such folder", where=f"--data {data}", wanted="the folder that holds the recorded data")
    options = _options(name, attitude)
    target = Path(f"{name}-results") if out is None else Path(out)
    found = target.exists()
    try:
        folder = writable_folder(target)
        result = run(folder, None if data is None else Path(data), part_of(progress, 0.0, 0.97), **options)
        progress("writing the report", 0.97)
        again = ["fluxtwin", "run", name, *(["--data", str(data)] if data is not None else [])]
        again += [] if attitude is None else ["--attitude", attitude]
        pages = {} if result.page is None else {"report": result.page}
        written = [
            write_json(folder / "summary.json", sealed_json({JSON_MARK: fluxtwin.__version__, **result.summary}))
        ]
        for stem, page in {**pages, **result.more_pages}.items():
            prefix = "" if stem == "report" else f"{stem}_"
            blocks = [block for section in page.sections for block in section.figures]
            written += [write_bytes(folder / f"{prefix}{block.name}.png", png_bytes(block.figure)) for block in blocks]
            written.append(write_page(page, folder / f"{stem}.html", shlex.join(again)))
        return result, [*result.written, *written]
    except BaseException:  # an interrupt too
        if not found and target.is_dir() and not any(target.iterdir()):
            target.rmdir()
        raise


def _options(name: str, attitude: str | None) -> dict[str, str]:
    if attitude is None:
        return {}
    offered = STUDIES[name].attitudes
    if attitude not in offered:
        wanted = " or ".join(offered) or f"no --attitude: the study {name} has one motion"
        raise BadInput(f"{attitude!r}", where="--attitude", wanted=wanted)
    return {"attitude": attitude}
