"""`fluxtwin run flight-gaps`: the diagnosis on records that flew, whose cause it is not given."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from fluxtwin.calib.common.digits import plain
from fluxtwin.gap.law.words import made_of
from fluxtwin.gap.report.words import at_the_end
from fluxtwin.scenarios.flight_gaps.compute import STORM_NT, compute, names_of
from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.recorded_files import Settings, run_on_files
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect

SETTINGS = Path(__file__).parent / "flight_gaps.toml"
"""What the study runs with; a copy lies beside its results."""
_AURORA_DEG = 60.0


def run(out: Path, data: Path | None, progress: Progress = silent) -> StudyResult:
    """The whole study, as `run_on_files`."""
    return run_on_files(SETTINGS, out, data, progress, compute, present)


def present(outcome: Numbers, settings: Settings) -> StudyResult:
    """What the study says of its outcome."""
    provenance = {
        "settings": "flight_gaps.toml beside this page",
        "files": ", ".join(settings.files),
        "effects in the catalogue": str(len(CATALOGUE)),
    }
    return words().result("flight-gaps", provenance, o=outcome, settings=settings.tree)


@cache
def words() -> Words:
    """The sections of `words.md`, with what speaks of an answer."""
    return Words(
        "fluxtwin.scenarios.flight_gaps",
        filters={
            "before_comma": lambda text: text.partition(",")[0],
            "unnamed": lambda found: words().say("unnamed", found=found),
        },
        known=(at_the_end, fits_of, find_effect, made_of, names_of, plain),
        aurora_deg=_AURORA_DEG,
        storm_nT=STORM_NT,
    )


def fits_of(tables: Mapping[str, Numbers]) -> list[dict[str, object]]:
    """One row for each fit of the tables: what is modelled alone, and each set of effects as well."""
    rows: list[dict[str, object]] = []
    for name, table in tables.items():
        rows.append({"table": name, "effects": ("b and S",), "left_nT": table.base_nT, "sizes": ()})
        rows += [{"table": "", **vars(share)} for share in table.shares.values()]
    return rows
