"""The chain of the sensors: field, attitude and spacecraft become readings, readings become telemetry.

The stages pass one frozen `Signal` on; each draws only from the random streams that carry its own name, so
switching one source off moves no other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim import frames
from fluxtwin.sim import scenario_spacecraft as spacecraft
from fluxtwin.sim.attitude import Attitude
from fluxtwin.sim.gauss_markov import gauss_markov
from fluxtwin.sim.housekeeping import Housekeeping
from fluxtwin.sim.random_streams import stream
from fluxtwin.sim.scenario import Scenario
from fluxtwin.sim.sensors.reference_attitude import (
    attitude_from_sun_and_nadir,
    attitude_with_error,
    q_where,
)
from fluxtwin.sim.sensors.sun_sensor import measure_sun
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.truth import Truth
from fluxtwin.sim.types import FloatArray
from fluxtwin.sim.world import World


@dataclass(frozen=True)
class Signal:
    """What has become of the field on its way from the world to the reading; N rows, body axes."""

    attitude: Attitude
    """The true motion."""
    field_B_nT: FloatArray
    """(N, 3) ambient field."""
    dipole_B_Am2: FloatArray
    """(N, 3) what the torquers do."""
    unknown_B_nT: FloatArray
    """(N, 3) field of the unexplained source."""
    ideal_B_nT: FloatArray
    """(N, 3) reading before noise, saturation and rounding."""
    reading_B_nT: FloatArray
    """(N, 3) reading as it is telemetered."""


@dataclass(frozen=True)
class Attached:
    """What the other sensors say."""

    q_NB: FloatArray
    sun_sensor_head: FloatArray | None
    sun_B: FloatArray | None
    nadir_B: FloatArray | None
    rate_B_rad_s: FloatArray | None


def fly_magnetometer(
    scenario: Scenario, world: World, motion: Attitude, dipole_B_Am2: FloatArray | None = None
) -> Signal:
    """The chain of the magnetometer. dipole_B_Am2 (N, 3): recorded torquer activity instead of the schedule's."""
    instrument = spacecraft.magnetometer(scenario)
    field = motion.R_BN.apply(world.field_N_nT)
    dipole = dipole_B_Am2
    if dipole is None:
        dipole = spacecraft.torquer_schedule(scenario).dipole_B_Am2(world.time, field)
    unknown = _unknown_field_nT(scenario, world)
    return Signal(
        attitude=motion,
        field_B_nT=field,
        dipole_B_Am2=dipole,
        unknown_B_nT=unknown,
        ideal_B_nT=instrument.ideal_reading(field + unknown, dipole),
        reading_B_nT=instrument.reading(field + unknown, dipole, stream(scenario.seed, "magnetometer.noise")),
    )


def fly_others(scenario: Scenario, world: World, motion: Attitude) -> Attached:
    """Sun sensors, horizon scanner, gyro and the reference attitude made from them."""
    seed, reference = scenario.seed, scenario.attitude.reference
    heads = spacecraft.sun_sensor_heads(scenario)
    head = sun_B = nadir_B = None
    if heads:
        head, sun_B = measure_sun(heads, motion.R_BN.apply(world.sun_N), world.illumination, stream(seed, "sun_sensor"))
    nadir_N = -world.r_N_km / np.linalg.norm(world.r_N_km, axis=1)[:, None]
    scanner = spacecraft.horizon_scanner(scenario)
    if scanner is not None:
        *_, nadir_B = scanner.measure(world.time, motion.R_BN.apply(nadir_N), stream(seed, "horizon_scanner"))
    gyro = spacecraft.gyro(scenario)
    rate = None if gyro is None else gyro.measure(world.time, motion.rate_B_rad_s, stream(seed, "gyro"))
    if reference.source == "sensors":
        assert sun_B is not None and nadir_B is not None
        q = attitude_from_sun_and_nadir(sun_B, nadir_B, world.sun_N, nadir_N)
    else:
        reported = attitude_with_error(
            world.time,
            motion.R_BN,
            float(np.radians(reference.sigma_deg)),
            reference.tau_s,
            stream(seed, "attitude.reference"),
        )
        known = np.ones(world.time.size, dtype=bool)
        if reference.needs_sun:
            assert head is not None
            known = head > 0
        q = q_where(reported, known)
    return Attached(q, head, sun_B, nadir_B, rate)


def _unknown_field_nT(scenario: Scenario, world: World) -> FloatArray:
    source = scenario.magnetometer.unknown
    if source is None:
        return np.zeros((world.time.size, 3))
    tau_s = source.tau_s if source.kind == "gauss_markov" else 0.0
    rng = stream(scenario.seed, "magnetometer.unknown")
    return gauss_markov(world.time, source.nT, tau_s, rng, columns=3)


def to_telemetry(
    scenario: Scenario, world: World, signal: Signal, attached: Attached, housekeeping: Housekeeping
) -> Telemetry:
    """What reaches the ground; no truth in it, not even in the provenance."""
    telemetered = scenario.torquers is not None and scenario.torquers.telemetered
    return Telemetry(
        time=world.time,
        mag_B_nT=signal.reading_B_nT,
        r_N_km=world.r_N_km,
        v_N_km_s=world.v_N_km_s,
        q_NB=attached.q_NB,
        dipole_B_Am2=signal.dipole_B_Am2 if telemetered else None,
        sunlit=(world.illumination > 0.5).astype(np.float64),
        heater_on=housekeeping.heater_on,
        array_current_A=housekeeping.array_current_A,
        battery_current_A=housekeeping.battery_current_A,
        temperature_degC=housekeeping.temperature_degC,
        wheel_speed_rpm=housekeeping.wheel_speed_rpm,
        sun_sensor_head=attached.sun_sensor_head,
        sun_B=attached.sun_B,
        nadir_B=attached.nadir_B,
        rate_B_rad_s=attached.rate_B_rad_s,
        provenance={"source": "simulation", "spacecraft": scenario.spacecraft.name},
    )


def to_truth(scenario: Scenario, world: World, signal: Signal) -> Truth:
    """What really happened, row by row; it is written to a file of its own, or nowhere."""
    R_BN: Rotation = signal.attitude.R_BN
    yaw, roll, pitch = frames.yaw_roll_pitch(R_BN * world.R_ON.inv())
    instrument = spacecraft.magnetometer(scenario)
    return Truth(
        time=world.time,
        r_N_km=world.r_N_km,
        v_N_km_s=world.v_N_km_s,
        q_NB=signal.attitude.q_NB,
        rate_B_rad_s=signal.attitude.rate_B_rad_s,
        yaw_rad=yaw,
        roll_rad=roll,
        pitch_rad=pitch,
        field_N_nT=world.field_N_nT,
        field_B_nT=signal.field_B_nT,
        unknown_B_nT=signal.unknown_B_nT,
        ideal_B_nT=signal.ideal_B_nT,
        dipole_B_Am2=signal.dipole_B_Am2,
        illumination=world.illumination,
        S=instrument.S,
        b_nT=instrument.b_nT,
        T_nT_per_Am2=spacecraft.torquer_correction(scenario),
    )
