"""Fly an ensemble: thousands of vehicles with drawn parameters in one call, on all cores, to a folder.

The folder holds `ensemble.json` (the plan), `vehicles.csv` (a row a vehicle: what was drawn, and its figures), the
chunks, and at the end `envelope.csv` and `summary.json`. What a vehicle does depends on the scenario, the seed and its
number: not on how many fly beside it, on how many cores, or on an interruption.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.seals import sealed_json
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.workers import require_workers, team
from fluxtwin.sim.run.ensemble import chunk, summary
from fluxtwin.sim.run.ensemble.plan import (
    RECORD,
    Plan,
    make_plan,
    recorded_chunk,
    require_same,
    write_record,
)
from fluxtwin.sim.run.ensemble.summary import Envelope
from fluxtwin.sim.scenario.scenario import Scenario, load_scenario


@dataclass(frozen=True)
class Ensemble(Shown):
    """An ensemble that has flown; everything else is in its folder."""

    folder: Path
    plan: Plan
    summary: dict[str, Any]
    envelope: Envelope | None


def fly_ensemble(
    scenario: Scenario | Path | str,
    vehicles: int,
    out: Path | str,
    *,
    seed: int | None = None,
    jobs: int | None = None,
    in_chunk: int | None = None,
    resume: bool = False,
    scheduler: str | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Ensemble:
    """Fly vehicles of a scenario with [draws] and leave the results in a folder.

    vehicles: how many, from 1. out: the path of the folder. seed: of the draws and of all that is random; the scenario's own
    where not given. jobs: processes, all cores where not given. in_chunk: vehicles that are held in memory and written at a
    time, and the step of the progress. resume: go on with what is in the folder, if it is the same ensemble. scheduler: the
    address of a Dask scheduler whose workers fly the chunks. executor: one like those of `concurrent.futures` that flies
    them; the chunks are written here. Raises BadInput for an impossible scenario or vehicle, or a folder with another
    ensemble, and NoAnswer where every vehicle was lost.
    """
    plan_of = load_scenario(scenario) if isinstance(scenario, Path | str) else scenario
    require_workers(jobs, scheduler)
    folder = Path(out)
    if resume and in_chunk is None:
        in_chunk = recorded_chunk(folder)
    plan = make_plan(plan_of, vehicles, seed, in_chunk)
    _require_free(plan, folder, resume)
    todo = [number for number in range(plan.chunks) if not (resume and chunk.is_whole(plan, folder, number))]
    place = None if executor or scheduler else str(folder.resolve())
    record = plan.record()
    try:
        with team(len(todo), jobs=jobs, scheduler=scheduler, executor=executor) as ask:
            progress(f"checking {plan.vehicles} vehicles", 0.0)
            list(ask(chunk.check_chunk, [(record, number) for number in todo]))
            _begin(plan, folder)
            _keep(plan, folder, todo, ask(chunk.fly_chunk, [(record, place, number) for number in todo]), progress)
    except BaseException:
        files.sweep(folder)  # a process may have been ended while it wrote
        raise
    progress("tables", 0.98)
    found = summary.summarise(plan, folder)
    around = summary.envelope(plan, folder)
    if around is not None:
        summary.write_envelope(around, folder)
    files.write_json(folder / summary.SUMMARY, sealed_json(found))
    return Ensemble(folder, plan, found, around)


def whole_chunks(folder: Path | str) -> int:
    """How many chunks lie in a folder."""
    return len(list(Path(folder).glob("chunk-*.nc")))


def _require_free(plan: Plan, folder: Path, resume: bool) -> None:
    if (folder / RECORD).exists() or whole_chunks(folder):
        if not resume:
            raise BadInput(
                "an ensemble lies here already",
                where=str(folder),
                wanted="--resume to go on with it, or another folder",
            )
        require_same(plan, folder)


def _begin(plan: Plan, folder: Path) -> None:
    files.writable_folder(folder)
    (folder / summary.SUMMARY).unlink(missing_ok=True)  # it says that all is done
    write_record(plan, folder)
    summary.write_index(plan, folder)


def _keep(plan: Plan, folder: Path, todo: list[int], events: Iterable[dict[str, Any]], progress: Progress) -> None:
    """Tell how far the chunks to do have come, and write those that were flown elsewhere.

    Raises NoAnswer where the whole first one was lost: it is the scenario, and the others need not try.
    """
    done = plan.vehicles - sum(len(plan.members(number)) for number in todo)
    said: set[str] = set()
    for event in events:
        if (made := event.pop("chunk", None)) is not None:
            chunk.write_chunk(plan, made, folder, event["done"])
        done += int(event.get("flown", 0))
        progress(f"vehicle {done} of {plan.vehicles}", 0.98 * done / plan.vehicles)
        for notice in event.get("notices", ()):
            if notice not in said:
                said.add(notice)
                warnings.warn(notice, stacklevel=3)
        if "done" in event and len(todo) > 1 and event["done"] == todo[0]:
            members, lost = plan.members(todo[0]), event["lost"]
            if len(lost) == len(members):
                raise NoAnswer(f"all of the first {len(members)} vehicles were lost; vehicle {members[0]}: {lost[0]}")
