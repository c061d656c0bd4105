"""From the chunks of an ensemble to its tables: drawn parameters, figures a vehicle, percentiles, the envelope in time.

The chunks are read one after the other. What is held is a number for each figure of each vehicle and, for the
envelope, a block of times of all vehicles: never the series of the whole ensemble.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.processes import stop_if_asked
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth.epoch import iso
from fluxtwin.sim.run.ensemble import chunk
from fluxtwin.sim.run.ensemble.plan import Plan

VEHICLES, ENVELOPE, SUMMARY = "vehicles.csv", "envelope.csv", "summary.json"
PERCENTILES = (5.0, 50.0, 95.0, 99.0)
_ENVELOPE_ROWS = 480
_BLOCK_VALUES = 4_000_000


@dataclass(frozen=True)
class Envelope:
    """Pointing of all vehicles against time, T times."""

    time: TimeArray
    median_deg: FloatArray
    p5_deg: FloatArray
    p95_deg: FloatArray
    max_deg: FloatArray


def write_index(plan: Plan, folder: Path, figures: Mapping[str, FloatArray] | None = None) -> Path:
    """The table of vehicles: number, seed, what was drawn and, once they have flown, their figures."""
    return _write_table(folder / VEHICLES, _index_rows(plan, figures or {}))


def _write_table(path: Path, rows: Iterable[Iterable[Any]]) -> Path:
    def fill(temporary: Path) -> None:
        with open(temporary, "w", encoding="utf-8", newline="") as opened:
            csv.writer(opened, lineterminator="\n").writerows(rows)

    return files.write_with(path, fill)


def _index_rows(plan: Plan, figures: Mapping[str, FloatArray]) -> Iterator[Iterable[Any]]:
    yield [*plan.row(0), *figures]
    columns = [[value if isfinite(value) else "" for value in values.tolist()] for values in figures.values()]
    for vehicle in range(plan.vehicles):
        yield [*plan.row(vehicle).values(), *(column[vehicle] for column in columns)]


def gather(plan: Plan, folder: Path) -> tuple[dict[str, FloatArray], dict[int, str]]:
    """The figures of all vehicles by name, (vehicles,) each with NaN where lost, and why those were lost."""
    figures: dict[str, FloatArray] = {}
    lost: dict[int, str] = {}
    for number in range(plan.chunks):
        members = plan.members(number)
        found, missing = chunk.read_figures(folder, number)
        lost |= missing
        for name, values in found.items():
            whole = figures.setdefault(name, np.full(plan.vehicles, np.nan))
            whole[members.start : members.stop] = values
    return figures, lost


def envelope(plan: Plan, folder: Path) -> Envelope | None:
    """Percentiles of the pointing over the vehicles, at up to 480 samples; None where there is no pointing."""
    time = chunk.read_times(folder)
    rows = np.unique(np.linspace(0, time.size - 1, min(time.size, _ENVELOPE_ROWS)).round().astype(np.int64))
    block = max(1, _BLOCK_VALUES // plan.vehicles)
    parts = []
    for first in range(0, rows.size, block):
        stop_if_asked()
        picked = rows[first : first + block]
        pieces = [chunk.read_series(folder, number, "pointing_deg", picked) for number in range(plan.chunks)]
        there = [piece for piece in pieces if piece is not None]
        if not there:
            return None
        whole = np.concatenate(there).astype(np.float64)
        whole = whole[np.isfinite(whole).all(axis=1)]
        parts.append(np.percentile(whole, (5.0, 50.0, 95.0, 100.0), axis=0))
    low, middle, high, most = np.concatenate(parts, axis=1)
    return Envelope(time[rows], middle, low, high, most)


def write_envelope(found: Envelope, folder: Path) -> Path:
    """The envelope as a table."""
    header = ["time", "pointing_p5_deg", "pointing_median_deg", "pointing_p95_deg", "pointing_max_deg"]
    columns = [column.tolist() for column in (found.p5_deg, found.median_deg, found.p95_deg, found.max_deg)]
    return _write_table(folder / ENVELOPE, [header, *zip(map(iso, found.time), *columns, strict=True)])


def summarise(plan: Plan, folder: Path) -> dict[str, Any]:
    """The summary: each figure's mean, standard deviation, extremes and percentiles over the vehicles, and the worst.

    Raises NoAnswer where every vehicle was lost.
    """
    figures, lost = gather(plan, folder)
    write_index(plan, folder, figures)
    if len(lost) == plan.vehicles:
        raise NoAnswer(f"all {plan.vehicles} vehicles were lost; vehicle 0: {lost[0]}")
    time = chunk.read_times(folder)
    return {
        "name": plan.scenario.name,
        "seed": plan.seed,
        "vehicles": plan.vehicles,
        "lost": len(lost),
        "why_lost": [{"vehicle": vehicle, "reason": lost[vehicle]} for vehicle in sorted(lost)[:20]],
        "samples": int(time.size),
        "span": [iso(time[0]), iso(time[-1])],
        "chunks": plan.chunks,
        "fingerprint": plan.fingerprint,
        "figures": {name: _spread(values) for name, values in figures.items()},
    }


def _spread(values: FloatArray) -> dict[str, float | int]:
    good = values[np.isfinite(values)]
    spread: dict[str, float | int] = {"mean": float(good.mean()), "std": float(good.std())}
    spread |= {"min": float(good.min()), "max": float(good.max())}
    spread |= {f"p{p:g}": float(value) for p, value in zip(PERCENTILES, np.percentile(good, PERCENTILES), strict=True)}
    return spread | {"vehicle_of_max": int(np.nanargmax(values))}
