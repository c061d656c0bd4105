"""The sections of a scenario: text to records and back, no physics."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    scenario="Scenario load_scenario parse_scenario save_scenario",
)
