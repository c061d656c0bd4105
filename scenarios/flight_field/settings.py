"""What the study runs with: a packaged TOML, read strictly and saved again beside the results."""

from __future__ import annotations

from pathlib import Path

from fluxtwin.scenarios.recorded_files import FlightSettings
from fluxtwin.sim.base.toml_input import Strict, read_model

PACKAGED = Path(__file__).parent / "flight_field.toml"


class _Magsat(Strict):
    file: str
    kp_file: str
    model: str
    epoch_utc: str


class _Swarm(Strict):
    file: str
    model: str
    chaos_file: str
    rc_file: str
    crust_degree: int


class Settings(FlightSettings):
    """All of `flight_field.toml`."""

    name: str
    low_latitude_deg: float
    ring_current_induced_share: float
    magsat: _Magsat
    swarm: _Swarm


def read_settings(path: Path = PACKAGED) -> Settings:
    """The settings in the file `path`; raises BadInput that lists every fault in it."""
    return read_model(path, Settings)
