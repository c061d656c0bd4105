"""What the study runs with: a packaged TOML, read strictly and saved again beside the results."""

from __future__ import annotations

from pathlib import Path

from fluxtwin.sim.base.toml_input import Strict, read_model

PACKAGED = Path(__file__).parent / "elfin.toml"
MAP = Path(__file__).parent / "map.toml"


class Printed(Strict):
    """Figures of an independent look at the same files."""

    static_nT: list[float]
    linear_nT: float
    quadratic_nT: float
    harmonic_nT: float
    sunlit_static_nT: list[float]
    sunlit_last_nT: list[float]
    noise_nT: list[float]
    outliers_nT: list[float]
    response_X: list[float]
    turn_XZ_deg: float
    slip_s: float


class Settings(Strict):
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
    printed: Printed

    @property
    def files(self) -> tuple[str, ...]:
        """Every file the study reads from the data folder."""
        return self.file, self.state_file


def read_settings(path: Path = PACKAGED) -> Settings:
    """The settings in the file `path`; raises BadInput that lists every fault in it."""
    return read_model(path, Settings)
