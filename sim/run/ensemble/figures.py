"""What is kept of the flight of one vehicle: series at the samples of the schedule, and a figure or two of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.record import ephemeris_rate_O_rad_s
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.run.flights import target_of
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, build_world, ephemeris
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.wheels import RPM_PER_RAD_S
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
