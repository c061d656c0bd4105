"""Simulation: from a scenario to telemetry and truth, one vehicle or an ensemble of them."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    world="World build_world",
    truth="Truth",
    scenario_passes="list_passes",
)
