"""What the study runs with: a packaged TOML, read strictly and saved again beside the results."""

from __future__ import annotations

from pathlib import Path

from fluxtwin.scenarios.recorded_files import FlightSettings
from fluxtwin.sim.base.toml_input import Strict, read_model

PACKAGED = Path(__file__).parent / "flight_gaps.toml"


class _Storm(Strict):
    file: str
    rc_file: str


class _Magsat(Strict):
    file: str
    kp_file: str
    every: int


class _Swarm(Strict):
    files: list[str]
    every: int


class _Dmsp(Strict):
    files: list[str]
    hours: float
    every: int


class _Aircraft(Strict):
    file: str
    rate_Hz: float


class Settings(FlightSettings):
    """All of `flight_gaps.toml`."""

    name: str
    low_latitude_deg: float
    storm: _Storm
    magsat: _Magsat
    swarm: _Swarm
    dmsp: _Dmsp
    aircraft: _Aircraft


def read_settings() -> Settings:
    """The packaged settings."""
    return read_model(PACKAGED, Settings)
