"""Estimators that see telemetry and the field model, never truth."""

if __name__ == "calib":
    raise ImportError("import fluxtwin.calib, never the bare folder name: two copies of every class would exist")
