"""The classic traps of foreign telemetry, each recognised by its own evidence."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    check="check_telemetry check_file repair",
    report="CheckReport",
)
