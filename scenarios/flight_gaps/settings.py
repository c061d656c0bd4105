"""What the study runs with: a packaged TOML, read strictly and saved again beside the results."""

from __future__ import annotations

from pathlib import Path

from fluxtwin.sim.base.toml_input import Strict, read_model

PACKAGED = Path(__file__).parent / "flight_gaps.toml"


class StormSettings(Strict):
    """Swarm A in a storm."""

    file: str
    rc_file: str


class MagsatSettings(Strict):
    """MAGSAT in 1980."""

    file: str
    kp_file: str
    every: int


class SwarmSettings(Strict):
    """Three satellites on one day."""

    files: list[str]
    every: int


class DmspSettings(Strict):
    """Two days of one-second residuals in spacecraft axes."""

    files: list[str]
    hours: float
    every: int


class AircraftSettings(Strict):
    """The published Tolles-Lawson compensation of an aircraft."""

    file: str
    rate_Hz: float


class Settings(Strict):
    """All of `flight_gaps.toml`."""

    name: str
    low_latitude_deg: float
    storm: StormSettings
    magsat: MagsatSettings
    swarm: SwarmSettings
    dmsp: DmspSettings
    aircraft: AircraftSettings

    @property
    def files(self) -> tuple[str, ...]:
        """Every file the study reads from the data folder."""
        return (
            self.storm.file, self.storm.rc_file, self.magsat.file, self.magsat.kp_file, *self.swarm.files,
            *self.dmsp.files, self.aircraft.file,
        )  # fmt: skip


def read_settings(path: Path = PACKAGED) -> Settings:
    """The settings in the file `path`; raises BadInput that lists every fault in it."""
    return read_model(path, Settings)
