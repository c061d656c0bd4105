"""The verb `fleet`, and its tables."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from fluxtwin.calib.checks.copies import SHORTEST_COPY
from fluxtwin.calib.common.digits import measured, plain
from fluxtwin.diagnosing import Assumed, diagnose, with_assumed
from fluxtwin.notebook import usual
from fluxtwin.scenarios.page import Table
from fluxtwin.sim.base.errors import BadInput, amount
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.workers import answers, require_workers
from fluxtwin.sim.telemetry.telemetry_files import Readable
from fluxtwin.verbs import as_record

if TYPE_CHECKING:
    from fluxtwin.gap.fleet import Fleet
    from fluxtwin.gap.records.diagnosis import Diagnosis
    from fluxtwin.sim.scenario.scenario import Scenario
    from fluxtwin.sim.telemetry.record import Telemetry


@with_assumed
def fleet(
    vehicles: Mapping[str, Readable],
    *,
    scenario: Scenario | Path | str | None = None,
    modelled: Sequence[str] | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    executor: Executor | None = None,
    progress: Progress = usual,
    **assumed: Unpack[Assumed],
) -> Fleet:
    """Which effect is common to vehicles of one design, and which belongs to one.

    vehicles: a record, or its file, by the name of the vehicle, three or more. scenario, modelled: as for `diagnose`, the
    same for all. jobs, scheduler, executor: who does the diagnoses, as for `ensemble`. Raises BadInput and NoAnswer as
    `diagnose` does.
    """
    from fluxtwin.gap.fleet import fleet as together

    if len(vehicles) < 3:
        wanted = "three or more: with two, nothing says which one differs"
        raise BadInput(amount(len(vehicles), "vehicle|vehicles"), where="fleet", wanted=wanted)
    options = {"scenario": scenario, "modelled": modelled, **assumed}
    records = {name: as_record(one) for name, one in vehicles.items()}
    for one, other in itertools.combinations(records, 2):  # noise that is counted twice looks like an effect in common
        if _share_readings(records[one], records[other]):
            raise BadInput(f"has the same readings as {one}", where=other, wanted="a record of each vehicle's own")
    found = diagnoses(records, options, jobs=jobs, scheduler=scheduler, executor=executor, progress=progress)
    return together(list(found), list(found.values()))


def _share_readings(one: Telemetry, other: Telemetry) -> bool:
    """Whether two records have the same readings, or the shorter one has most of its readings from the other, at the same
    times or in the same order: two sensors do not repeat each other to the last digit."""
    if np.array_equal(one.mag_B_nT, other.mag_B_nT, equal_nan=True):
        return True
    _, mine, theirs = np.intersect1d(one.time, other.time, return_indices=True)
    same = int((one.mag_B_nT[mine] == other.mag_B_nT[theirs]).all(axis=1).sum())
    fewer, more = sorted((_runs(one), _runs(other)), key=len)
    again = 0 < len(fewer) < 2 * np.isin(fewer, more).sum()
    return again or 2 * same > min(int(one.has_reading.sum()), int(other.has_reading.sum()))


def _runs(record: Telemetry) -> np.ndarray:
    """A number for each `SHORTEST_COPY` readings in a row; only the same readings have the same."""
    parts = np.ascontiguousarray(record.mag_B_nT[record.has_reading]).view(np.uint64)
    runs = np.zeros(max(len(parts) - SHORTEST_COPY + 1, 0), dtype=np.uint64)
    for first, axis in itertools.product(range(SHORTEST_COPY), range(3)):
        runs = runs * np.uint64(6364136223846793005) + parts[first : first + len(runs), axis]
    return runs


def diagnoses(
    records: Mapping[str, Readable],
    options: Mapping[str, Any],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    executor: Executor | None = None,
    progress: Progress = usual,
) -> dict[str, Diagnosis]:
    """The diagnosis of each record by itself, in their order; options: of `diagnose`."""
    require_workers(jobs, scheduler)
    names = list(records)
    calls = [(number, as_record(records[name]), options) for number, name in enumerate(names)]
    found: dict[int, Diagnosis] = {}
    for number, diagnosis in answers(one, calls, jobs=jobs, scheduler=scheduler, executor=executor):
        found[number] = diagnosis
        progress(f"diagnosed {len(found)} of {len(names)}", 0.98 * len(found) / len(names))
    return {name: found[number] for number, name in enumerate(names)}


def one(number: int, record: Telemetry, options: Mapping[str, Any]) -> tuple[int, Diagnosis]:
    """The diagnosis of one vehicle, for a process anywhere; without the parts that only its own report needs."""
    from dataclasses import replace

    return number, replace(diagnose(record, **options), series=None, closure=None)


def tables(found: Fleet) -> list[Table]:
    """The common effect by vehicle, and the ranking."""
    out = []
    common = found.common
    if common is not None:
        shown = [p for p in range(len(common.parameters)) if np.isfinite(common.mean[p])]
        shown = sorted(shown, key=lambda p: -abs(common.mean[p] / common.mean_sigma[p]))[:3]
        columns = ["vehicle", *(f"{common.parameters[p]} [{common.units[p]}]" for p in shown), "its own diagnosis"]
        rows = [
            [
                Path(name).name,
                *(
                    measured(common.each[v, p], common.each_sigma[v, p]) if np.isfinite(common.each[v, p]) else "none"
                    for p in shown
                ),
                ", ".join(" / ".join(one.group) for one in found.diagnoses[v].effects) or found.diagnoses[v].verdict,
            ]
            for v, name in enumerate(found.vehicles)
        ]
        rows.append(["all", *(measured(common.mean[p], common.mean_sigma[p]) for p in shown), ""])
        note = (
            "With 1 sigma. Each vehicle's size is shrunk towards the mean, the more so the less its data determine it."
        )
        out.append(Table(common.name, columns, rows, note))
    ranking = [[name, plain(value, 3), str(rank)] for name, value, rank in found.ranking[:8]]
    if ranking:
        note = "Evidence: twice the log of the Bayes factor for a common effect; above 6 the effect counts as common."
        out.append(Table("What the vehicles could have in common", ["effect", "evidence", "directions"], ranking, note))
    return out
