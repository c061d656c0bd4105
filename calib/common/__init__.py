"""What all methods of calibration share: rows, noise, covariance, the record, its file and the verdict."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    records="Calibration TelemetryBias",
    apply="apply_calibration",
    fit="Fit",
)
