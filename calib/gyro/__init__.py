"""Calibration from gyro and magnetometer alone: no attitude, no position, no field model."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    calibrate="calibrate_gyro",
)
