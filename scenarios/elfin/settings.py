"""What the study runs with: a packaged TOML, read strictly and saved again beside the results."""

from __future__ import annotations

from pathlib import Path

from fluxtwin.scenarios.recorded_files import FlightSettings
from fluxtwin.sim.base.toml_input import read_model

PACKAGED = Path(__file__).parent / "elfin.toml"
MAP = Path(__file__).parent / "map.toml"


class Settings(FlightSettings):
    """All of `elfin.toml`."""

    name: str
    file: str
    state_file: str
    field_model: str
    shortest_spin_s: float
    longest_spin_s: float
    packet_rows: int
    switch_on_s: float
    phase_degree: int
    every: int
    settle_s: list[float]
    pairs_s: list[list[float]]
    printed: dict[str, float | list[float]]
    """Figures of an independent look at the same files."""


def read_settings() -> Settings:
    """The packaged settings."""
    return read_model(PACKAGED, Settings)
