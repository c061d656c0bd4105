"""Run a study and write its page: `summary.json`, the figures as PNG, `report.html`.

A study is a module `scenarios/NAME/study.py` and a name here. It offers `run(out, data, progress) -> StudyResult`: `out` is
an existing writable folder, `data` a folder of recorded data or None.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import fluxtwin
from fluxtwin.notebook import usual
from fluxtwin.outputs import JSON_MARK
from fluxtwin.report import write_figures, write_page
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.sim.base.errors import BadInput, nearest
from fluxtwin.sim.base.files import writable_folder, write_json
from fluxtwin.sim.base.progress import Progress, part_of
from fluxtwin.sim.base.seals import sealed_json

STUDIES = ("seasat", "hcmm", "st5", "elfin", "flight-field", "flight-gaps")
_MOVED = ("seasat", "hcmm")
"""Those whose `run` takes the keyword `attitude` too: their vehicle may move in more than one way."""


def run_study(
    name: str,
    out: Path | str | None = None,
    data: Path | str | None = None,
    progress: Progress = usual,
    *,
    attitude: str | None = None,
) -> tuple[StudyResult, list[Path]]:
    """Run a study; returns its result and every file written, its own and ours.

    name: seasat, hcmm, st5, elfin, flight-field or flight-gaps. out: folder for the results, `./NAME-results` by default.
    data: folder of recorded data, for the studies that need one. attitude: for the studies of a vehicle that torques move,
    "dynamics" (the default) or "prescribed". Raises BadInput for an unknown name or attitude, a missing data folder or a
    folder that cannot be written, before the work starts.
    """
    run = find_study(name)
    if data is not None and not Path(data).is_dir():
        raise BadInput("no such folder", where=f"--data {data}", wanted="the folder that holds the recorded data")
    if attitude is not None and name not in _MOVED:
        raise BadInput(f"{attitude!r}", where="--attitude", wanted=f"no --attitude: the study {name} has one motion")
    options = {} if attitude is None else {"attitude": attitude}
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
            written += write_figures(page, folder, prefix)
            written.append(write_page(page, folder / f"{stem}.html", shlex.join(again)))
        return result, [*result.written, *written]
    except BaseException:  # an interrupt too
        if not found and target.is_dir() and not any(target.iterdir()):
            target.rmdir()
        raise


def find_study(name: str) -> Callable[..., StudyResult]:
    """The `run` of the study called `name`; raises BadInput that names the nearest one."""
    if name not in STUDIES:
        hint = nearest(name.lower(), STUDIES, " (did you mean {!r}?)")
        raise BadInput(f"no study is called {name!r}{hint}", where="run", wanted=" or ".join(STUDIES))
    run: Callable[..., StudyResult] = import_module(f"fluxtwin.scenarios.{name.replace('-', '_')}.study").run
    return run
