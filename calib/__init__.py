"""Estimators that see telemetry and the field model, never truth."""

from fluxtwin.sim.base.doors import door

if __name__ == "calib":
    raise ImportError("import fluxtwin.calib, never the bare folder name: two copies of every class would exist")

__getattr__, __dir__ = door(
    __name__,
    methods="calibrate_by default_method",
)
