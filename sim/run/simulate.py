"""From a scenario to telemetry and truth: orbit, field, attitude, spacecraft, sensors, in that order; or, along a recorded
file, the magnetometers alone.

Rows that hold a sun pulse alone: when the sun crosses the slit of a spinning spacecraft, between the readings.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.attitude.rigid_body import torque_free
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.run import chain
from fluxtwin.sim.run.housekeeping import run_housekeeping
from fluxtwin.sim.run.true_attitude import ScenarioMotion, true_attitude
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, build_world, ephemeris, world_along
from fluxtwin.sim.scenario.sampling import interleaved, sampled_rows
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.build import velocity_from_positions
from fluxtwin.sim.telemetry.record import Telemetry, concatenate, named_columns, recorded_columns
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry


def simulate(scenario: Scenario, *, world: World | None = None, progress: Progress = silent) -> tuple[Telemetry, Truth]:
    """Run the scenario once.

    world: the world of this scenario if it was built before (it does not depend on the seed); a caller that
    runs many seeds builds it once. Returns the telemetry and, apart from it, the truth; the sun pulses of
    [slit_sun_sensor] are rows of the telemetry alone.
    Raises BadInput for a scenario that cannot be run and OutOfRange for epochs outside the field model.
    """
    if scenario.replay is not None:
        return _replayed(scenario, progress)
    progress("orbit, sun and field", 0.0)
    world = build_world(scenario) if world is None else world
    progress("attitude", 0.4)
    motion = ScenarioMotion(scenario, world, true_attitude(scenario, world))
    progress("housekeeping", 0.6)
    attitude = motion.attitude
    columns = run_housekeeping(scenario, world)
    progress("sensors", 0.8)
    columns |= chain.fly_sensors(scenario, world, attitude)
    q_NB = columns.pop("q_NB")
    columns["dipole_B_Am2"] = chain.torquer_dipole_B_Am2(scenario, world.time)
    signal = chain.fly_magnetometer(scenario, world, motion, columns)
    progress("done", 1.0)
    telemetry = _as_read(scenario, world, chain.to_telemetry(scenario, signal, columns, q_NB))
    truth = chain.to_truth(scenario, world, attitude, signal)
    return with_pulses(telemetry, scenario, world, truth), truth


def _as_read(scenario: Scenario, world: World, telemetry: Telemetry) -> Telemetry:
    """With blanks where a sensor with a rate of its own was not read."""
    if scenario.schedule is None or not scenario.sampling.rates:
        return telemetry
    rows = sampled_rows(scenario.sampling, scenario.schedule, world.time, world.segment)
    return interleaved(telemetry, rows, attitude_from_sensors=scenario.attitude.reference.source == "sensors")


def _replayed(scenario: Scenario, progress: Progress) -> tuple[Telemetry, Truth]:
    """Run a scenario with [replay]: the recorded readings are replaced, everything else stays as recorded.

    Those of a second magnetometer are left out where the scenario has none: they belong to another field.
    The recorded attitude stays the reported one; the true one is that less an error drawn from
    [attitude.reference]. Likewise the effects of the scenario change what was true, not what was recorded: the truth
    gives orbit and attitude without those on orbit and attitude. Rows without position, velocity or attitude are left out; a
    velocity that was not recorded is that of the positions. Raises BadInput when the file has no position or no attitude.
    """
    assert scenario.replay is not None
    progress("reading the recorded file", 0.0)
    path = scenario.path_of(scenario.replay.telemetry)
    column_map = scenario.replay.column_map
    recorded = read_telemetry(path, column_map=None if column_map is None else scenario.path_of(column_map))
    missing = [name for name in ("r_N_km", "q_NB") if getattr(recorded, name) is None]
    if missing:
        raise BadInput(
            f"the recorded file lacks {', '.join(missing)}",
            where=str(path),
            wanted="position and attitude columns to replay",
        )
    assert recorded.r_N_km is not None
    if recorded.v_N_km_s is None:
        recorded = recorded.replace(v_N_km_s=velocity_from_positions(recorded.time, np.asarray(recorded.r_N_km)))
    assert recorded.v_N_km_s is not None and recorded.q_NB is not None
    whole = recorded.has_position & recorded.has_attitude & np.isfinite(recorded.v_N_km_s).all(axis=1)
    if not whole.any():
        raise BadInput("no row has position, velocity and attitude", where=str(path))
    recorded = recorded.select(whole)
    progress("field and sensors", 0.3)
    segment = np.zeros(len(recorded))
    # copies: a record is read-only, and scipy turns only vectors it could write to
    r_N_km, v_N_km_s = np.array(recorded.r_N_km), np.array(recorded.v_N_km_s)
    world = world_along(scenario, recorded.time, segment, r_N_km, v_N_km_s)
    attitude = _true_motion(scenario, recorded)
    motion = RecordedMotion(recorded.time, world.r_N_km, world.v_N_km_s, attitude.R_BN, recorded.rate_B_rad_s)
    columns = recorded_columns(recorded)
    if recorded.dipole_B_Am2 is None:
        columns["dipole_B_Am2"] = chain.torquer_dipole_B_Am2(scenario, world.time)
    signal = chain.fly_magnetometer(scenario, world, motion, columns, direction="predict")
    provenance = {"source": "simulation along a recorded file", "spacecraft": scenario.spacecraft.name}
    second_B_nT = chain.second_reading_B_nT(scenario, signal)
    telemetry = recorded.replace(mag_B_nT=signal.reading_B_nT, mag2_B_nT=second_B_nT, provenance=provenance)
    progress("done", 1.0)
    return telemetry, chain.to_truth(scenario, world, attitude, signal)


def _true_motion(scenario: Scenario, recorded: Telemetry) -> Attitude:
    reference = scenario.attitude.reference
    theta = gauss_markov(
        recorded.time,
        float(np.radians(reference.sigma_deg)),
        reference.tau_s,
        stream(scenario.seed, "attitude.reference"),
        columns=3,
    )
    assert recorded.q_NB is not None
    error = Rotation.from_rotvec(-theta)
    R_BN = error * frames.rotation_from_q(recorded.q_NB)
    rate = recorded.rate_B_rad_s
    return Attitude(R_BN, _differenced_rate(recorded.time, R_BN) if rate is None else rate)


def _differenced_rate(time: np.ndarray, R_BN: Rotation) -> FloatArray:
    """Body rate from attitude differences, carried to the later row; good where rows are close together."""
    if len(R_BN) < 2:
        return np.zeros((len(R_BN), 3))
    seconds = epoch.seconds_since(time, time[0])
    turn = -(R_BN[1:] * R_BN[:-1].inv()).as_rotvec() / np.diff(seconds)[:, None]
    return np.concatenate([turn[:1], turn])


_FINE_S, _PART_OF_TURN = 0.25, 0.125


def with_pulses(magnetometer: Telemetry, scenario: Scenario, world: World, truth: Truth) -> Telemetry:
    """The record with a row for each pulse of [slit_sun_sensor], in order of time; itself where there is no such section.

    A pulse on the very stamp of a reading goes a nanosecond later.
    """
    if scenario.slit_sun_sensor is None:
        return magnetometer
    return _merged(magnetometer, pulses(scenario, world, truth))


def pulses(scenario: Scenario, world: World, truth: Truth) -> Telemetry:
    """Rows with the measured sun alone, at the times of the crossings; the motion between the rows is the free one."""
    slit = scenario.slit_sun_sensor
    assert slit is not None and scenario.spacecraft.inertia_kg_m2 is not None
    start = truth.time[0]
    inertia = np.array(scenario.spacecraft.inertia_kg_m2)
    stamps_s = epoch.seconds_since(truth.time, start)
    length_s = float(stamps_s[-1])
    R_BN0 = frames.rotation_from_q(truth.q_NB[:1])[0]

    def sun_B(seconds: FloatArray) -> FloatArray:
        R_BN, _ = torque_free(seconds, inertia, R_BN0, truth.rate_B_rad_s[0])
        sun_N = np.stack([np.interp(seconds, stamps_s, world.sun_N[:, i]) for i in range(3)], axis=1)
        return np.asarray(R_BN.apply(sun_N))

    turn_s = 2.0 * np.pi / max(float(np.linalg.norm(truth.rate_B_rad_s[0])), 1e-9)
    grid = np.arange(0.0, length_s, min(_FINE_S, _PART_OF_TURN * turn_s))
    seconds, seen_B = slit.crossings(grid, sun_B, stream(scenario.seed, "sun_sensor.slit"))
    inside = (seconds > 0.0) & (seconds < length_s)
    stamps = epoch.add_seconds(start, seconds[inside])
    r_N_km, v_N_km_s = ephemeris(scenario, stamps)
    nothing = np.full((stamps.size, 3), np.nan)
    return Telemetry(time=stamps, mag_B_nT=nothing, r_N_km=r_N_km, v_N_km_s=v_N_km_s, sun_B=seen_B[inside])


def _merged(magnetometer: Telemetry, sun_rows: Telemetry) -> Telemetry:
    """Both in order of time; a column that one of them lacks is missing in its rows."""
    if not len(sun_rows):
        return magnetometer
    late = np.isin(sun_rows.time, magnetometer.time)
    time = np.concatenate([magnetometer.time, sun_rows.time + late.astype("timedelta64[ns]")])
    order = np.argsort(time, kind="stable")
    # Joined one after the other first, which fills what is absent; then put in order.
    after = sun_rows.replace(time=sun_rows.time - sun_rows.time[0] + magnetometer.time[-1] + np.timedelta64(1, "s"))
    joined = concatenate([magnetometer, after])
    changes: dict[str, object] = {
        name: value[order] for name, value in vars(joined).items() if isinstance(value, np.ndarray)
    }
    changes["time"] = time[order]
    changes |= named_columns(joined, lambda value: value[order])
    return joined.replace(**changes, provenance=dict(magnetometer.provenance))
