"""A study's mission: its scenario as it is flown, what is printed of it, and a flight's files."""

from __future__ import annotations

import csv
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata, resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fluxtwin.calib.attitude.yaw import AVERAGE_S, YawSolution, average_yaw
from fluxtwin.calib.common.calibration_file import write_calibration
from fluxtwin.calib.common.records import Calibration
from fluxtwin.plots.yaw import YawComparison
from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

NEAR_NODE_DEG = 10.0
ATTITUDES = ("dynamics", "prescribed")
"""How a vehicle may move: by torques, or as its [attitude] section says; the first is the default."""


class Numbers(SimpleNamespace):
    """What a part of a study has found, by name; what each number is stands where it is made. Scalars become Python's."""

    def __init__(self, **found: Any) -> None:
        super().__init__(**{name: v.item() if isinstance(v, np.generic) else v for name, v in found.items()})

    def model_copy(self, update: Mapping[str, Any]) -> Numbers:
        """The same with some of them replaced."""
        return Numbers(**{**vars(self), **update})


@dataclass(frozen=True)
class Flight:
    """One run of a scenario."""

    scenario: Scenario
    world: World
    telemetry: Telemetry
    truth: Truth


def fly(config: Scenario, world: World | None = None) -> Flight:
    """Run a scenario; `world` if it is known already."""
    world = build_world(config) if world is None else world
    return Flight(config, world, *simulate(config, world=world))


@dataclass(frozen=True)
class Mission:
    """The packaged files of a study: the scenario NAME.toml, and what papers print, which is never written into code."""

    package: str
    off: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """What switches each source of error off."""

    def text(self, name: str) -> str:
        """A file of the package, as it is."""
        return resources.files(self.package).joinpath(name).read_text(encoding="utf-8")

    def table(self, name: str) -> list[dict[str, str]]:
        """A table of the papers, one mapping a row."""
        return list(csv.DictReader(self.text(f"data/{name}.csv").splitlines()))

    def value(self, table: str, key: str, **match: str) -> float:
        """The one number of column `key` in the row of a table that matches; LookupError unless there is just one."""
        rows = [row for row in self.table(table) if all(row[k] == v for k, v in match.items())]
        if len(rows) != 1:
            raise LookupError(f"{len(rows)} rows of {table} match {match}")
        return float(rows[0][key])

    def quantity(self, name: str) -> float:
        """A single printed number, by its name in `quantities.csv`; LookupError for another name."""
        return self.value("quantities", "value", quantity=name)

    def size(self, source: str) -> str:
        """What the papers print of a source of error, as they print it."""
        return next(row["magnitude"] for row in self.table("errors") if row["source"] == source)

    def scenario(self, attitude: str = ATTITUDES[0]) -> Scenario:
        """The packaged scenario: its vehicle moved by torques, or as `prescribed`; BadInput for another word."""
        if attitude not in ATTITUDES:
            raise BadInput(f"{attitude!r}", where="--attitude", wanted=" or ".join(ATTITUDES))
        config = parse_scenario(self.text(self._file), where=self._file)
        return config if attitude == ATTITUDES[0] else prescribed(config)

    def scenario_text(self, attitude: str = ATTITUDES[0]) -> str:
        """As it is written, with the source of each number, or every key of the prescribed one."""
        return self.text(self._file) if attitude == ATTITUDES[0] else self.scenario(attitude).to_toml()

    def only(self, config: Scenario, *sources: str) -> Scenario:
        """The scenario with all sources of error off but these."""
        changes: dict[str, Any] = {}
        for source, change in self.off.items():
            changes |= {} if source in sources else change
        return config.updated(changes)

    @property
    def _file(self) -> str:
        return f"{self.package.rsplit('.', 1)[1]}.toml"


def prescribed(config: Scenario) -> Scenario:
    """The same spacecraft with the libration of its [attitude] section, torquers that act at random, and no wheels."""
    gone = dict.fromkeys(
        ("dynamics", "torques", "control", "wheels", "torquers.drive", "torquers.threshold_Am2", "attitude.mode")
    )
    return config.updated({**gone, "torquers.activity": "random"})


def is_dynamic(config: Scenario) -> bool:
    """Whether torques move the body."""
    return config.attitude.mode == "dynamics"


def motion_of(flight: Flight) -> Numbers:
    """How the vehicle moved in one flight, and what its actuators did."""
    truth, speed = flight.truth, flight.telemetry.wheel_speed_rpm
    angles = {name: np.degrees(getattr(truth, f"{name}_rad")) for name in ("yaw", "roll", "pitch")}
    dipole = np.abs(truth.dipole_B_Am2)
    return Numbers(
        attitude=ATTITUDES[0] if is_dynamic(flight.scenario) else ATTITUDES[1],
        # Of the true yaw, roll and pitch.
        rms_deg={name: rms(angle) for name, angle in angles.items()},
        largest_deg={name: float(np.abs(angle).max()) for name, angle in angles.items()},
        # (3,) share of the samples in which the torquer along x, y, z does more than a hundredth of the most that any did,
        # and the mean size of what it does.
        torquers_on_share=(dipole > 0.01 * dipole.max()).mean(axis=0),
        torquers_mean_Am2=dipole.mean(axis=0),
        # (W, 2) slowest and fastest.
        wheel_speed_rpm=None if speed is None else np.stack([speed.min(axis=0), speed.max(axis=0)], axis=1),
    )


def day(number: int, hour: float = 0.0) -> np.datetime64:
    """UTC stamp of a day of the year 1978 (1 is 1 January)."""
    return np.datetime64("1978-01-01", "ns") + np.timedelta64(number - 1, "D") + np.timedelta64(round(hour * 3600), "s")


def rms(values: FloatArray) -> float:
    """Root mean square; NaN is left out, and what comes of nothing else."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(np.square(known)))) if known.size else float("nan")


def rms_along(values: FloatArray, axis: int) -> FloatArray:
    """Root mean square over an axis; NaN is left out."""
    return np.asarray(np.sqrt(np.nanmean(np.square(values), axis=axis)))


def wrapped_deg(angle_rad: FloatArray) -> FloatArray:
    """Angles within half a turn [deg]."""
    return np.asarray(np.degrees(np.arctan2(np.sin(angle_rad), np.cos(angle_rad))))


def latitude_deg(along: World | Telemetry) -> FloatArray:
    """(N,) geocentric latitude along the orbit."""
    r_E_km = frames.rotation_EN(along.time).apply(np.array(along.r_N_km))
    return np.asarray(np.degrees(frames.geocentric(r_E_km)[0]))


def compare_yaw(telemetry: Telemetry, solution: YawSolution) -> YawComparison:
    """Yaw by the magnetometer beside yaw by the sun sensor, as the papers' figures 1 to 3 show it.

    `solution` of the N rows of `telemetry`, which has an orbit; M windows of AVERAGE_S, NaN in `mean_sun_deg` where a sample
    of the window has no reference attitude.
    """
    assert telemetry.r_N_km is not None
    change = np.diff(telemetry.mag_B_nT[solution.rows], axis=0, prepend=telemetry.mag_B_nT[solution.rows[:1]]) != 0
    r_E_km = frames.rotation_EN(solution.time).apply(np.array(telemetry.r_N_km)[solution.rows])
    latitude_rad = average_yaw(solution.time, frames.geocentric(r_E_km)[0], AVERAGE_S).yaw_rad
    return YawComparison(
        minutes=epoch.seconds_since(solution.time, solution.time[0]) / 60.0,
        sun_deg=np.degrees(solution.yaw_reference_rad),
        magnetometer_deg=np.degrees(solution.yaw_first_order_rad),
        change_x=change[:, 0],
        change_y=change[:, 1],
        mean_minutes=epoch.seconds_since(solution.averages.time, solution.time[0]) / 60.0,
        mean_deg=np.degrees(solution.averages.yaw_rad),
        mean_sun_deg=np.degrees(average_yaw(solution.time, solution.yaw_reference_rad, AVERAGE_S).yaw_rad),
        near_node=np.abs(latitude_rad) < np.radians(NEAR_NODE_DEG),
        window_s=AVERAGE_S,
    )


def write_flight(out: Path, scenario_text: str, telemetry: Telemetry, calibration: Calibration) -> list[Path]:
    """`scenario.toml`, `telemetry.nc` and `calibration.toml` in the folder; their paths."""
    return [
        files.write_text(out / "scenario.toml", scenario_text),
        write_telemetry(telemetry, out / "telemetry.nc"),
        write_calibration(calibration, out / "calibration.toml"),
    ]


def provenance(config: Scenario) -> dict[str, str]:
    """Seed, fields and versions."""
    return {
        "seed": str(config.seed),
        "truth field": config.field.truth,
        "ground field": config.field.model,
        "fluxtwin": metadata.version("fluxtwin"),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
