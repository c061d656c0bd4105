"""The chain of the sensors: field, attitude and spacecraft become readings, readings become telemetry.

Each source draws only from the random streams that carry its own name, so switching one off moves no other. What
the scenario's effects do is in `effects`; the same chain predicts readings for a diagnosis.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping

import numpy as np

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.base import DynamicsEffect
from fluxtwin.sim.effects.chain import Chain
from fluxtwin.sim.effects.signal import Direction, Motion, Setting, Signal
from fluxtwin.sim.run import spacecraft
from fluxtwin.sim.run.flights import flights, vehicle_of
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World
from fluxtwin.sim.scenario.effect_sections import active_effects, effects_record
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.sensors.base import Surroundings
from fluxtwin.sim.spacecraft.sensors.reference_attitude import (
    attitude_from_sun_and_nadir,
    attitude_with_error,
)
from fluxtwin.sim.telemetry.quantities import DRIVERS
from fluxtwin.sim.telemetry.record import Telemetry


def torquer_dipole_B_Am2(scenario: Scenario, time: TimeArray) -> FloatArray:
    """(N, 3) what the torquers do."""
    if scenario.attitude.mode == "dynamics":
        return flights(scenario).dipole_B_Am2(time)
    return spacecraft.torquer_schedule(scenario).dipole_B_Am2(time)


def fly_magnetometer(
    scenario: Scenario,
    world: World,
    motion: Motion,
    columns: Mapping[str, FloatArray],
    direction: Direction = "simulate",
) -> Signal:
    """The chain of the magnetometer, with the scenario's effects.

    columns: everything that was recorded or will be, by telemetry name, `dipole_B_Am2` as it really was. An effect
    that has nothing to act on is left out with a warning that says why.
    """
    instrument = spacecraft.magnetometer(scenario)
    setting = Setting(
        time=world.time,
        motion=motion,
        direction=direction,
        model=load_field(scenario.field.truth, degree=scenario.field.truth_degree),
        instrument=instrument,
        columns=columns,
        full_scale_nT=scenario.magnetometer.full_scale_nT,
        field_N_nT=world.field_N_nT,
        unknown_B_nT=_unknown_field_nT(scenario, world.time, "magnetometer"),
    )
    noise_nT = instrument.noise_nT * stream(scenario.seed, "magnetometer.noise").standard_normal((world.time.size, 3))
    kept = []
    for effect, theta in active_effects(scenario):
        reason = effect.untestable(setting)
        if isinstance(effect, DynamicsEffect):
            flown = scenario.attitude.mode == "dynamics"
            reason = effect.idle(vehicle_of(scenario)) if flown else 'no torque turns the body: mode is not "dynamics"'
        if reason is None:
            kept.append((effect, theta))
        else:
            warnings.warn(f"effects.{effect.name} is left out: {reason}", stacklevel=2)
    return Chain(setting).simulated(kept, scenario.seed, noise_nT)


def fly_sensors(scenario: Scenario, world: World, motion: Attitude) -> dict[str, FloatArray]:
    """What the sensors beside the magnetometer give, by telemetry name, and the reference attitude `q_NB`."""
    around = Surroundings(
        time=world.time,
        r_N_km=world.r_N_km,
        R_BN=motion.R_BN,
        R_ON=world.R_ON,
        rate_B_rad_s=motion.rate_B_rad_s,
        sun_N=world.sun_N,
        illumination=world.illumination,
    )
    columns = scenario.measure(around, lambda name: stream(scenario.seed, name))
    reference = scenario.attitude.reference
    if reference.source == "sensors":
        columns["q_NB"] = attitude_from_sun_and_nadir(columns["sun_B"], columns["nadir_B"], world.sun_N, around.nadir_N)
    elif reference.source == "error_model":
        reported = attitude_with_error(
            world.time,
            motion.R_BN,
            float(np.radians(reference.sigma_deg)),
            reference.tau_s,
            stream(scenario.seed, "attitude.reference"),
        )
        columns["q_NB"] = frames.q_from_rotation(reported)
    if reference.needs_sun:
        columns["q_NB"][columns["sun_sensor_head"] == 0] = np.nan
    return columns


def second_reading_B_nT(scenario: Scenario, signal: Signal) -> FloatArray | None:
    """(N, 3) what [magnetometer_2] reads beside the first, whose signal this is; None where there is none.

    Effects on time, orbit, field and attitude are in the field that both see, those of the spacecraft reach it by its
    factor, those of the sensor not at all.
    """
    section, name, setting = scenario.magnetometer_2, "magnetometer_2", signal.setting
    if section is None:
        return None
    at_sensor = signal.field_B_nT + section.spacecraft_field_factor * signal.spacecraft_B_nT
    at_sensor += _unknown_field_nT(scenario, setting.time, name)
    noise = stream(scenario.seed, f"{name}.noise")
    return spacecraft.magnetometer(scenario, name).reading(at_sensor, setting.column("dipole_B_Am2"), noise)


def _unknown_field_nT(scenario: Scenario, time: TimeArray, name: str) -> FloatArray:
    """(N, 3) field that nobody has explained at the magnetometer of this section."""
    source = getattr(scenario, name).unknown
    if source is None:
        return np.zeros((time.size, 3))
    tau_s = source.tau_s if source.kind == "gauss_markov" else 0.0
    return gauss_markov(time, source.nT, tau_s, stream(scenario.seed, f"{name}.unknown"), columns=3)


def to_telemetry(scenario: Scenario, signal: Signal, columns: Mapping[str, FloatArray], q_NB: FloatArray) -> Telemetry:
    """What reaches the ground; no truth in it, not even in the provenance.

    columns: all that is recorded beside orbit, attitude and reading, by name; q_NB (N, 4): the reference attitude.
    """
    telemetered = dict(columns)
    if scenario.torquers is None or not scenario.torquers.telemetered:
        del telemetered["dipole_B_Am2"]
    for name, turn in signal.measured_turns.items():
        if name in telemetered:
            telemetered[name] = turn.apply(telemetered[name])
    drivers = {name: telemetered.pop(DRIVERS.prefix + name) for name in scenario.drivers}
    return Telemetry(
        time=signal.setting.time,
        mag_B_nT=signal.reading,
        mag2_B_nT=second_reading_B_nT(scenario, signal),
        r_N_km=signal.r_reported_N_km,
        v_N_km_s=signal.v_reported_N_km_s,
        q_NB=_reported_q_NB(signal, q_NB),
        drivers=drivers,
        driver_units={name: section.unit for name, section in scenario.drivers.items()},
        provenance={"source": "simulation", "spacecraft": scenario.spacecraft.name},
        **telemetered,  # type: ignore[arg-type]
    )


def _reported_q_NB(signal: Signal, q_NB: FloatArray) -> FloatArray:
    """The reference attitude, turned by what the effects on it do; rows without one stay so."""
    given = signal.setting.given[2]
    if signal.R_reported_BN is given:
        return q_NB
    known = np.isfinite(q_NB).all(axis=1)
    turned = np.array(q_NB)
    effect = frames.product(signal.R_reported_BN, given.inv())[np.flatnonzero(known)]
    turned[known] = frames.q_from_rotation(frames.product(effect, frames.rotation_from_q(q_NB[known])))
    return turned


def to_truth(scenario: Scenario, world: World, attitude: Attitude, signal: Signal) -> Truth:
    """What really happened, row by row; it is written to a file of its own, or nowhere."""
    yaw, roll, pitch = frames.yaw_roll_pitch(frames.product(attitude.R_BN, world.R_ON.inv()))
    instrument = spacecraft.magnetometer(scenario)
    dipole, unknown = signal.setting.column("dipole_B_Am2"), signal.setting.unknown_B_nT
    assert dipole is not None and unknown is not None
    assert signal.field_N_nT is not None and signal.ideal_B_nT is not None
    return Truth(
        time=world.time,
        r_N_km=world.r_N_km,
        v_N_km_s=world.v_N_km_s,
        q_NB=attitude.q_NB,
        rate_B_rad_s=attitude.rate_B_rad_s,
        yaw_rad=yaw,
        roll_rad=roll,
        pitch_rad=pitch,
        field_N_nT=signal.field_N_nT,
        field_B_nT=signal.field_B_nT,
        unknown_B_nT=unknown,
        ideal_B_nT=signal.ideal_B_nT,
        dipole_B_Am2=dipole,
        illumination=world.illumination,
        S=instrument.S,
        b_nT=instrument.b_nT,
        T_nT_per_Am2=spacecraft.torquer_correction(scenario),
        effects=json.dumps(effects_record(scenario)),
    )
