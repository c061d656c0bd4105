"""Attitude from the magnetometer and other sensors: yaw, three axes, the horizon scanner."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    yaw="yaw_from_field YawSolution",
    three_axis="estimate_attitude AttitudeSolution",
    horizon_scanner="calibrate_scanner",
    recursive="calibrate_recursive",
)
