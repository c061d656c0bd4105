"""A chunk: some vehicles flown one after the other, and written as one whole NetCDF file.

No more than a chunk is ever held in memory. Series are kept as float32 (a quaternion within 1e-5 deg); figures as
float64. A vehicle whose flight fails (it spins up beyond what the step can follow) is lost, not an error: its series
are NaN and the file gives the reason.

What is kept of the flight of one vehicle: series at the samples of the schedule, and a figure or two of each.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.record import ephemeris_rate_O_rad_s
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.netcdf_out import Variable, write_netcdf
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.run.ensemble.plan import Plan
from fluxtwin.sim.run.flights import target_of
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, build_world, ephemeris
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.wheels import RPM_PER_RAD_S
from fluxtwin.sim.telemetry.netcdf_files import TIME_UNITS, NetcdfFile
from fluxtwin.sim.telemetry.record import Telemetry


@dataclass(frozen=True)
class Around:
    """What vehicles on one orbit share."""

    world: World
    orbital_rate_O_rad_s: FloatArray
    """(R, 3) of the orbital frame."""


def around(scenario: Scenario) -> Around:
    """The surroundings of a scenario at its samples."""
    world = build_world(scenario)
    return Around(world, ephemeris_rate_O_rad_s(lambda time: ephemeris(scenario, time), world.time))


def series(scenario: Scenario, shared: Around, telemetry: Telemetry, truth: Truth) -> dict[str, FloatArray]:
    """Columns (R,) or (R, n) by name, with units in it; which ones is decided by the scenario alone."""
    kept = {
        "q_NB": truth.q_NB,
        "rate_B_deg_s": np.degrees(truth.rate_B_rad_s),
        "mag_B_nT": telemetry.mag_B_nT,
        **_pointing(scenario, shared, truth),
    }
    if scenario.torquers is not None:
        kept["dipole_B_Am2"] = truth.dipole_B_Am2
    if telemetry.wheel_speed_rpm is not None:
        kept["wheel_speed_rpm"] = telemetry.wheel_speed_rpm
    if scenario.spacecraft.inertia_kg_m2 is not None:
        kept["momentum_Nms"] = np.linalg.norm(_momentum_B_Nms(scenario, telemetry, truth), axis=1)
    return kept


def figures(scenario: Scenario, kept: dict[str, FloatArray], truth: Truth) -> dict[str, float]:
    """The figures of one vehicle by name, over all its samples."""
    found: dict[str, float] = {}
    if "pointing_deg" in kept:
        angle = kept["pointing_deg"]
        found |= {"pointing_rms_deg": _rms(angle), "pointing_median_deg": float(np.median(angle))}
        found |= {"pointing_p95_deg": float(np.percentile(angle, 95.0)), "pointing_max_deg": float(angle.max())}
    found |= {
        f"{name}_rms_deg": _rms(kept[f"{name}_deg"]) for name in ("yaw", "roll", "pitch") if f"{name}_deg" in kept
    }
    found |= {"rate_rms_deg_s": _rms(kept["rate_error_deg_s"]), "rate_max_deg_s": float(kept["rate_error_deg_s"].max())}
    if scenario.torquers is not None:
        for axis, dipole in zip("xyz", np.abs(kept["dipole_B_Am2"]).T, strict=True):
            found[f"torquer_{axis}_on_percent"] = 100.0 * float(np.mean(dipole > 0.0))
            found[f"torquer_{axis}_duty_percent"] = 100.0 * float(dipole.mean()) / scenario.torquers.Am2
    for number, speed in enumerate(kept.get("wheel_speed_rpm", np.zeros((1, 0))).T, start=1):
        found[f"wheel_{number}_max_rpm"] = float(np.abs(speed).max())
    if "momentum_Nms" in kept:
        found |= {"momentum_mean_Nms": float(kept["momentum_Nms"].mean())}
        found |= {"momentum_max_Nms": float(kept["momentum_Nms"].max())}
    found["reading_error_rms_nT"] = _rms(np.linalg.norm(kept["mag_B_nT"] - truth.field_B_nT, axis=1))
    return found


def _pointing(scenario: Scenario, shared: Around, truth: Truth) -> dict[str, FloatArray]:
    """Turn and rate against the target; rate against N where there is none."""
    R_BN, R_ON = frames.rotation_from_q(truth.q_NB), shared.world.R_ON
    frame, target, axis = _target(scenario)
    rate_B = truth.rate_B_rad_s
    if frame == "orbital" and axis is None:
        rate_B = rate_B - frames.product(R_BN, R_ON.inv()).apply(shared.orbital_rate_O_rad_s)
    kept = {"rate_error_deg_s": np.degrees(np.linalg.norm(rate_B, axis=1))}
    if axis is not None:
        axis_N = np.broadcast_to(axis, (len(R_BN), 3)) if frame == "inertial" else R_ON.inv().apply(axis)
        off = np.cross(R_BN.apply(axis_N), [0.0, 0.0, 1.0]), R_BN.apply(axis_N)[:, 2]
        kept["pointing_deg"] = np.degrees(np.arctan2(np.linalg.norm(off[0], axis=1), off[1]))
    elif target is not None:
        R_TN = frames.product(target, R_ON) if frame == "orbital" else target
        turn = frames.product(R_BN, R_TN.inv())
        kept["pointing_deg"] = np.degrees(turn.magnitude())
        angles = np.degrees(frames.yaw_roll_pitch(turn))
        kept |= {f"{name}_deg": angle for name, angle in zip(("yaw", "roll", "pitch"), angles, strict=True)}
    return kept


def _target(scenario: Scenario) -> tuple[str, Rotation | None, FloatArray | None]:
    """The frame (orbital or inertial) in which a body wants a whole attitude, or body z an axis, or nothing."""
    mode = scenario.attitude.mode
    if mode == "dynamics":
        control = scenario.control
        target = target_of(scenario)
        law = None if control is None or control.law is None else control.law.name
        if law == "b_dot":
            return "inertial", None, None
        if law == "spin":
            axis = np.array(target.axis)
            return target.frame, None, axis / np.linalg.norm(axis)
        return target.frame, target.attitude, None
    if mode == "inertial_hold":
        return "inertial", frames.rotation_from_q(np.array([scenario.attitude.q_NB]))[0], None
    if mode == "spin":
        axis = np.array(scenario.attitude.spin_axis_N)
        return "inertial", None, axis / np.linalg.norm(axis)
    return ("inertial", None, None) if mode == "tumble" else ("orbital", Rotation.identity(), None)


def _momentum_B_Nms(scenario: Scenario, telemetry: Telemetry, truth: Truth) -> FloatArray:
    """(R, 3) of the whole body: its inertia holds the wheels as if locked, their speed against it comes on top."""
    momentum = truth.rate_B_rad_s @ np.array(scenario.spacecraft.inertia_kg_m2, dtype=np.float64)
    section = scenario.wheels
    if section is not None and telemetry.wheel_speed_rpm is not None:
        axes = np.array(section.axes_B, dtype=np.float64)
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        momentum = momentum + section.inertia_kg_m2 * (telemetry.wheel_speed_rpm / RPM_PER_RAD_S) @ axes
    return np.asarray(momentum)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


FIGURES = "figures"
_MOST = 10_000_000
_UNIT = re.compile(r"_(deg_s|deg|nT|Am2|rpm|Nms|percent)$")
_CF = {"deg_s": "degree s-1", "deg": "degree", "Am2": "A m2", "rpm": "rpm", "Nms": "N m s", "percent": "percent"}


@dataclass
class Chunk:
    """The vehicles of one chunk, V of them at R samples."""

    members: range
    time: TimeArray
    series: dict[str, np.ndarray] = field(default_factory=dict)
    """(V, R) or (V, R, n) float32."""
    figures: dict[str, np.ndarray] = field(default_factory=dict)
    """(V,) each."""
    lost: dict[int, str] = field(default_factory=dict)
    """Why a vehicle was lost, by its number."""
    notices: list[str] = field(default_factory=list)

    def put(self, row: int, kept: Mapping[str, FloatArray], found: Mapping[str, float]) -> None:
        for name, column in kept.items():
            whole = self.series.setdefault(name, np.full((len(self.members), *column.shape), np.nan, dtype=np.float32))
            whole[row] = column
        for name, value in found.items():
            self.figures.setdefault(name, np.full(len(self.members), np.nan))[row] = value


class Flyer:
    """Flies vehicles of a plan; what those on the same orbit share is made once."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._around: tuple[str, Around] | None = None

    def chunk(self, number: int) -> Chunk:
        """Fly a chunk. Raises BadInput where the surroundings cannot be made."""
        members = self.plan.members(number)
        made = Chunk(members, self.surroundings(self.plan.vehicle(members[0])).world.time)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for row, vehicle in enumerate(members):
                scenario = self.plan.vehicle(vehicle)
                try:
                    shared = self.surroundings(scenario)
                    telemetry, truth = simulate(scenario, world=shared.world)
                    kept = series(scenario, shared, telemetry, truth)
                    made.put(row, kept, figures(scenario, kept, truth))
                except BadInput as error:
                    made.lost[vehicle] = str(error)
        made.notices = list(dict.fromkeys(str(one.message) for one in caught))
        return made

    def surroundings(self, scenario: Scenario) -> Around:
        """World and rate of the orbital frame; kept until another orbit is asked for."""
        key = repr((scenario.orbit, scenario.field, scenario.schedule, scenario.station))
        if self._around is None or self._around[0] != key:
            self._around = key, around(scenario)
        return self._around[1]


def chunk_path(folder: Path, number: int) -> Path:
    """Where a chunk lies."""
    return folder / f"chunk-{number:05d}.nc"


def check_chunk(record: Mapping[str, Any], number: int) -> None:
    """Check every vehicle of a chunk of a recorded plan, for a process anywhere. Raises BadInput for one that cannot be."""
    _flyer(json.dumps(record)).plan.check(number)


def fly_chunk(record: Mapping[str, Any], folder: str | None, number: int) -> dict[str, Any]:
    """Fly one chunk of a recorded plan, for a process anywhere; it is written where that process sees the folder.

    Returns its number, vehicles, notices, why some were lost, and without a folder the chunk itself.
    """
    flyer = _flyer(json.dumps(record))
    made = flyer.chunk(number)
    event = {"done": number, "flown": len(made.members), "notices": made.notices, "lost": list(made.lost.values())}
    if folder is None:
        return {**event, "chunk": made}
    write_chunk(flyer.plan, made, Path(folder), number)
    return event


@lru_cache(maxsize=1)
def _flyer(record: str) -> Flyer:
    """A process flies many chunks of one plan, mostly around one Earth."""
    return Flyer(Plan.from_record(json.loads(record)))


def write_chunk(plan: Plan, chunk: Chunk, folder: Path, number: int) -> Path:
    """Write a chunk, whole or not at all. Equal chunks are equal in every value."""
    numbers = np.array(chunk.members, dtype=np.int64)
    variables = {
        "time": Variable(
            ("time",), chunk.time.astype("int64"), {"units": TIME_UNITS, "calendar": "proleptic_gregorian"}
        ),
        "vehicle": Variable(("vehicle",), numbers, {"units": "1"}),
    }
    for name, value in chunk.series.items():
        rest = tuple(f"of_{size}" for size in value.shape[2:])
        dimensions = ("vehicle", "time", *rest)  # noise does not compress
        variables[name] = Variable(dimensions, value, _attributes(name), True, {"fletcher32": True})
    if chunk.figures:  # one variable: a file takes a time for each that it has
        columns = {"columns": " ".join(chunk.figures), "units": "as the name of each column ends"}
        whole = np.stack(list(chunk.figures.values()), axis=1)
        variables[FIGURES] = Variable(("vehicle", "figure"), whole, columns, True)
    attributes = {
        "Conventions": "CF-1.11",
        "title": f"vehicles {chunk.members[0]} to {chunk.members[-1]} of an ensemble of {plan.scenario.name}",
        "fingerprint": plan.fingerprint,
        "lost": json.dumps(chunk.lost),
    }
    return write_netcdf(chunk_path(folder, number), variables, attributes)


def _attributes(name: str) -> dict[str, str]:
    unit = _UNIT.search(name)
    return {"units": "1" if unit is None else _CF.get(unit[1], unit[1])}


def is_whole(plan: Plan, folder: Path, number: int) -> bool:
    """Whether this chunk is there, of this plan, of these vehicles, and every value of it can be read."""
    path = chunk_path(folder, number)
    if not path.is_file():
        return False
    try:
        with NetcdfFile(path, max_samples=_MOST) as opened:
            if opened.attributes().get("fingerprint") != plan.fingerprint:
                return False
            if not np.array_equal(opened.raw("vehicle"), np.array(plan.members(number))):
                return False
            for name in opened.names():
                if name in ("time", "vehicle", FIGURES) or len(opened.shape(name)) > 1:
                    opened.raw(name)
    except BadInput:
        return False
    return True


def read_figures(folder: Path, number: int) -> tuple[dict[str, FloatArray], dict[int, str]]:
    """The figures of a chunk's vehicles by name, (V,) each, and why some were lost."""
    with NetcdfFile(chunk_path(folder, number), max_samples=_MOST) as opened:
        found: dict[str, FloatArray] = {}
        if FIGURES in opened.names():
            table = np.asarray(opened.raw(FIGURES), dtype=np.float64)
            found = dict(zip(str(opened.attributes(FIGURES)["columns"]).split(), table.T, strict=True))
        lost = json.loads(str(opened.attributes().get("lost", "{}")))
    return found, {int(vehicle): str(reason) for vehicle, reason in lost.items()}


def read_series(folder: Path, number: int, name: str, rows: np.ndarray) -> np.ndarray | None:
    """One series of a chunk's vehicles at some rows, (V, rows); None where the chunk has none."""
    with NetcdfFile(chunk_path(folder, number), max_samples=_MOST) as opened:
        return np.asarray(opened.raw(name)[:, rows]) if name in opened.names() else None


def read_times(folder: Path) -> TimeArray:
    """(R,) the samples."""
    with NetcdfFile(chunk_path(folder, 0), max_samples=_MOST) as opened:
        return opened.times()
