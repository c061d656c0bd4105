"""How long `diagnose --follow` is silent where nothing changes, and how soon it rings where something does.

    python benchmarks/follow.py [--runs R] [--rows N] [--seed S] [--quick] [--json FILE|-]

Null: R flights in each world, each of N rows after the first orbit, in which nothing changes; the worlds differ in attitude
(what is declared of its error, how slow it is, how large), rounding, motion, and in whether the calibration is given. An
alarm ends a flight. Printed are rows watched, alarms, and the 95 % interval of the mean run (Poisson; the stated one is 1e6
rows at least). Delay: of a step of the bias in x of 1, 2, 5 sigma, of noise twice as large, and of a scale of 0.2 %, rows
from the change to the alarm, median and 90 % of the flights. Readings are made here, not by `fluxtwin simulate`; the field
is IGRF-14 in both.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import fluxtwin
import fluxtwin.following
from fluxtwin.calib.common.records import Calibration
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.watch import FIRST_ROWS, FIRST_S, RUN, begin
from fluxtwin.sim.base import files
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.telemetry.record import Telemetry

SIGMA_nT = 20.0
MODEL = load_field("igrf14")
START = np.datetime64("2026-03-01T00:00:00", "ns")
CHANGES = {"bias 1 sigma": 1.0, "bias 2 sigma": 2.0, "bias 5 sigma": 5.0, "noise x 2": None, "scale 0.2 %": 0.0}


class World(NamedTuple):
    """One kind of flight."""

    theta_deg: float
    tau_s: float
    declared: bool
    lsb_nT: float
    motion: str
    step_s: float = 10.0
    given: bool = False
    """The calibration is given with its covariance; else it is found in the first rows."""

    @property
    def first(self) -> int:
        """Rows that the watch begins with."""
        return max(FIRST_ROWS, round(FIRST_S / self.step_s) + 1)


WORLDS = {
    "slow attitude error, not declared": World(0.1, 300.0, False, 10.0, "nadir"),
    "slow attitude error, declared": World(0.1, 300.0, True, 10.0, "nadir"),
    "fine attitude, declared": World(0.01, 60.0, True, 10.0, "nadir"),
    "white attitude error, declared": World(0.05, 0.0, True, 10.0, "tumble"),
    "very slow attitude error, not declared": World(0.5, 2000.0, False, 10.0, "tumble"),
    "steps of three sigma": World(0.1, 300.0, False, 60.0, "nadir"),
    "a row a second": World(0.1, 300.0, False, 10.0, "nadir", 1.0),
    "calibration given": World(0.1, 300.0, False, 10.0, "tumble", 10.0, True),
}


def flight(world: World, rows: int, rng: np.random.Generator) -> tuple[Telemetry, Calibration]:
    """A record, and the calibration with which it was made, known to its sigma."""
    seconds = np.arange(rows) * world.step_s
    angle = seconds * (2.0 * np.pi / 5_860.0) + rng.uniform(0, 2 * np.pi)
    plane = Rotation.from_euler("ZX", [rng.uniform(0, 360), rng.uniform(50, 130)], degrees=True)
    turn = plane * Rotation.from_euler("Z", angle[:, None])
    r_N_km = turn.apply([7_028.0, 0.0, 0.0])
    stamps = START + (seconds * 1e9).astype("timedelta64[ns]")
    wobble = np.radians(5.0) * np.sin(seconds[:, None] / [900.0, 1300.0, 2100.0] + rng.uniform(0, 6, 3))
    body = turn.inv() if world.motion == "nadir" else Rotation.from_rotvec(seconds[:, None] * rng.normal(0, 2e-3, 3))
    R_BN = Rotation.from_rotvec(wobble) * body
    field_B = R_BN.apply(field_N_nT(MODEL, stamps, r_N_km))
    S, b_nT = rng.normal(0, 0.01, (3, 3)), rng.normal(0, 1500.0, 3)
    reading = (field_B - b_nT) @ np.linalg.inv(np.eye(3) + S).T + rng.normal(0, SIGMA_nT, (rows, 3))
    kept = np.exp(-world.step_s / world.tau_s) if world.tau_s else 0.0
    drive = np.radians(world.theta_deg) * rng.normal(size=(rows, 3))
    drive[1:] *= np.sqrt(1.0 - kept**2)
    error = lfilter([1.0], [1.0, -kept], drive, axis=0)
    q_NB = frames.q_from_rotation(Rotation.from_rotvec(error) * R_BN)
    sigmas = np.concatenate([np.full(9, 2e-4), np.full(3, 5.0)])
    off = rng.normal(size=12) * sigmas
    known = Calibration(S + off[:9].reshape(3, 3), b_nT + off[9:], covariance=np.diag(sigmas**2))
    mag = np.round(reading / world.lsb_nT) * world.lsb_nT
    return Telemetry(time=stamps, mag_B_nT=mag, r_N_km=r_N_km, q_NB=q_NB), known


def changed(record: Telemetry, change: str, at: int, rng: np.random.Generator) -> Telemetry:
    """The record with a change from row `at` on."""
    mag, after = np.array(record.mag_B_nT), slice(at, None)
    if change == "noise x 2":
        mag[after] += rng.normal(0, np.sqrt(3.0) * SIGMA_nT, mag[after].shape)
    elif change == "scale 0.2 %":
        mag[after] *= 1.002
    else:
        mag[after, 0] += float(CHANGES[change] or 0.0) * SIGMA_nT
    return record.replace(mag_B_nT=mag)


def watched(world: World, record: Telemetry, known: Calibration) -> tuple[int, bool]:
    """Rows that were watched, and whether it rang."""
    theta = np.radians(world.theta_deg) if world.declared else None
    first, rest = record.select(slice(0, world.first)), record.select(slice(world.first, None))
    watch = begin(first, MODEL, Budget(attitude_sigma_rad=theta), known if world.given else None)
    if world.given and watch.take(first) is not None:
        return watch.rows, True
    rang = watch.take(rest) is not None
    return watch.rows, rang


def null(arguments: argparse.Namespace) -> dict[str, Any]:
    """Rows and alarms of each world."""
    out = {}
    for number, (name, world) in enumerate(WORLDS.items()):
        rows, alarms = 0, 0
        for run in range(arguments.runs):
            rng = np.random.default_rng([arguments.seed, number, run])
            here, rang = watched(world, *flight(world, world.first + arguments.rows, rng))
            rows, alarms = rows + here, alarms + rang
        low = rows / (0.5 * float(chi2.ppf(0.975, 2 * alarms + 2)))
        high = rows / (0.5 * float(chi2.ppf(0.025, 2 * alarms))) if alarms else None
        out[name] = {"flights": arguments.runs, "rows": rows, "alarms": alarms, "mean_run_95": [low, high]}
    return out


def delays(arguments: argparse.Namespace) -> dict[str, Any]:
    """Rows from a change to the alarm; after 2,000 it is missed."""
    out: dict[str, Any] = {}
    for number, name in enumerate(
        ("slow attitude error, not declared", "fine attitude, declared", "calibration given")
    ):
        world = WORLDS[name]
        for change in CHANGES:
            late, early = [], 0
            for run in range(arguments.delays):
                rng = np.random.default_rng([arguments.seed, 100 + number, run])
                record, known = flight(world, 2 * world.first + 2000, rng)
                quiet = world.first if not world.given else 2 * world.first
                rows, rang = watched(world, changed(record, change, 2 * world.first, rng), known)
                early += rang and rows <= quiet
                late.append(rows - quiet if rang else np.inf)
            out.setdefault(name, {})[change] = {
                "median": float(np.median(late)),
                "of_90_percent": float(np.quantile(late, 0.9, method="higher")),
                "missed": int(np.isinf(late).sum()),
                "before_it": early,
            }
    return out


def cost() -> float:
    """Microseconds of a row, one core, in blocks of a thousand."""
    world = WORLDS["fine attitude, declared"]
    record, _ = flight(world, world.first + 21_000, np.random.default_rng(1))
    watch = begin(record.select(slice(0, world.first)), MODEL, Budget())
    blocks = [record.select(slice(i, i + 1000)) for i in range(world.first, len(record), 1000)]
    watch.take(blocks[0])
    started = time.process_time()
    for block in blocks[1:]:
        watch.take(block)
    return (time.process_time() - started) / sum(len(block) for block in blocks[1:]) * 1e6


def cost_alone() -> float:
    """Microseconds of a row that comes by itself, one core, the reader included."""
    world = WORLDS["fine attitude, declared"]
    record, _ = flight(world, world.first + 400, np.random.default_rng(1))
    watch = begin(record.select(slice(0, world.first)), MODEL, Budget())
    with tempfile.TemporaryDirectory() as folder:
        path = fluxtwin.write(record, Path(folder) / "t.csv")
        lines = [line for line in path.read_bytes().splitlines(keepends=True) if not line.startswith(b"#")]
    following: Any = fluxtwin.following
    pieces = [lines[0] + lines[1], *lines[1 + world.first :]]
    kept, following._whole_lines = following._whole_lines, lambda _: iter(pieces)
    try:
        parts = following._later(following._records("t.csv", {}))
        watch.take(next(parts))
        started = time.process_time()
        count = sum(watch.take(part) is None for part in parts)
        return (time.process_time() - started) / count * 1e6
    finally:
        following._whole_lines = kept


def show(record: dict[str, Any]) -> None:
    """The record on the terminal."""
    print(f"stated: a mean run of {RUN:.0e} rows at least")
    print(f"{'nothing changes':<42}{'rows':>12}{'alarms':>8}   mean run, 95 %")
    for name, row in record["null"].items():
        low, high = row["mean_run_95"]
        print(f"{name:<42}{row['rows']:>12,}{row['alarms']:>8}   {low:.1e} to {'' if high is None else f'{high:.1e}'}")
    for name, changes in record["delay_rows"].items():
        print(f"\nrows from the change to the alarm: {name}")
        for change, row in changes.items():
            print(
                f"  {change:<16} median {row['median']:.0f}, 90 % within {row['of_90_percent']:.0f},"
                f" missed {row['missed']}, before it {row['before_it']}"
            )
    print(f"\na row takes {record['us_a_row']:.1f} us in blocks of 1,000, {record['us_a_row_alone']:.0f} us alone")


def main() -> None:
    """Parse the command line, run, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=50, help="flights in each world (50; --quick 2)")
    parser.add_argument("--rows", type=int, default=50_000, help="rows of each (50,000; --quick 2,000)")
    parser.add_argument("--delays", type=int, default=40, help="flights for each delay (40; --quick 2)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="some seconds: to see that it runs")
    parser.add_argument("--json", metavar="FILE", help="write the record to FILE, or to standard output for -")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.runs, arguments.rows, arguments.delays = 2, 2000, 2
    if min(arguments.runs, arguments.rows, arguments.delays) < 1:
        parser.error("--runs, --rows and --delays: 1 or more")
    record = {"benchmark": "follow", "null": null(arguments), "delay_rows": delays(arguments), "us_a_row": cost()}
    record["us_a_row_alone"] = cost_alone()
    if arguments.json == "-":
        print(files.to_json(record), end="")
        return
    show(record)
    if arguments.json:
        files.write_json(arguments.json, record)


if __name__ == "__main__":
    main()
