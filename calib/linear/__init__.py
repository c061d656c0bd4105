"""Linear regression for S, b and T against a reference attitude."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    calibrate="calibrate_linear",
)
