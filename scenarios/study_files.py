"""What the studies of a paper share: the files of their flight, and the provenance."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path

import numpy as np

from fluxtwin.calib.common.calibration_file import write_calibration
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base import files
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry


def write_flight(out: Path, scenario_text: str, telemetry: Telemetry, calibration: Calibration) -> list[Path]:
    """`scenario.toml`, `telemetry.nc` and `calibration.toml` in the folder; their paths."""
    return [
        files.write_text(out / "scenario.toml", scenario_text),
        write_telemetry(telemetry, out / "telemetry.nc"),
        write_calibration(calibration, out / "calibration.toml"),
    ]


def provenance(config: Scenario) -> dict[str, str]:
    """Seed, fields and versions."""
    return {
        "seed": str(config.seed),
        "truth field": config.field.truth,
        "ground field": config.field.model,
        "fluxtwin": metadata.version("fluxtwin"),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
