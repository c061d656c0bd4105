"""From a scenario to telemetry and truth: orbit, field, attitude, spacecraft, sensors, in that order."""

from __future__ import annotations

from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.run import chain, replay
from fluxtwin.sim.run.housekeeping import run_housekeeping
from fluxtwin.sim.run.slit_pulses import with_pulses
from fluxtwin.sim.run.true_attitude import ScenarioMotion, true_attitude
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.sampling import interleaved, sampled_rows
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry


def simulate(scenario: Scenario, *, world: World | None = None, progress: Progress = silent) -> tuple[Telemetry, Truth]:
    """Run the scenario once.

    world: the world of this scenario if it was built before (it does not depend on the seed); a caller that
    runs many seeds builds it once. Returns the telemetry and, apart from it, the truth; the sun pulses of
    [slit_sun_sensor] are rows of the telemetry alone.
    Raises BadInput for a scenario that cannot be run and OutOfRange for epochs outside the field model.
    """
    if scenario.replay is not None:
        return replay.simulate_replay(scenario, progress)
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
