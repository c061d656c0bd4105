"""The studies that `fluxtwin run NAME` knows: a new study is a module `NAME/study.py` and one line here.

A study module offers `run(out, data, progress) -> StudyResult`: `out` is an existing writable folder, `data`
a folder of recorded data or None, `progress` a `fluxtwin.sim.base.progress.Progress`.
One that lists `attitudes` takes the keyword `attitude` as well.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

from fluxtwin.scenarios.page import StudyResult
from fluxtwin.sim.base.errors import BadInput, nearest
from fluxtwin.sim.base.progress import Progress

ATTITUDES = ("dynamics", "prescribed")
"""What `fluxtwin run NAME --attitude` may be; the first is the default."""


@dataclass(frozen=True)
class Study:
    """One line of the list."""

    about: str
    needs_data: bool = False
    attitudes: tuple[str, ...] = ()
    """Where a vehicle may move in more than one way: what `--attitude` may be, the default first."""


STUDIES: dict[str, Study] = {
    "seasat": Study(
        "Seasat 1978: the in-flight calibration of its magnetometers, beside the published numbers",
        attitudes=ATTITUDES,
    ),
    "hcmm": Study(
        "HCMM 1978: an orbit from the record of 43 station passes, a test against what flew, and the calibration",
        attitudes=ATTITUDES,
    ),
    "st5": Study(
        "ST5, a spinner: its magnetometer calibrated from orbit, field and sun pulses, beside the abstract's numbers",
    ),
    "elfin": Study(
        "ELFIN-A 2022, a spinner in flight: what is unmodelled, and how far it shrinks on zones that were not used",
        needs_data=True,
    ),
    "flight-field": Study(
        "the field models against measurements in orbit (MAGSAT 1980, Swarm A in a storm)",
        needs_data=True,
    ),
    "flight-gaps": Study(
        "the diagnosis on records that flew, whose cause it is not given (MAGSAT, Swarm, DMSP, an aircraft)",
        needs_data=True,
    ),
}


class RunStudy(Protocol):
    """The verb of a study module."""

    def __call__(self, out: Path, data: Path | None, progress: Progress, **options: str) -> StudyResult: ...


def find_study(name: str) -> RunStudy:
    """The `run` of the study called `name`; raises BadInput that names the nearest one."""
    if name not in STUDIES:
        hint = nearest(name.lower(), STUDIES, " (did you mean {!r}?)")
        raise BadInput(f"no study is called {name!r}{hint}", where="run", wanted=" or ".join(STUDIES))
    return cast(RunStudy, importlib.import_module(f"fluxtwin.scenarios.{name.replace('-', '_')}.study").run)
