"""Replay: orbit, attitude and housekeeping from a recorded file, the magnetometers simulated anew."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.run import chain
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import world_along
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.build import velocity_from_positions
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry


def simulate_replay(scenario: Scenario, progress: Progress = silent) -> tuple[Telemetry, Truth]:
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
