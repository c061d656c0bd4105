"""How the vehicle of a study moves: by the dynamics of its scenario, or as the scenario prescribes; and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.scenarios.page import Table
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

ATTITUDES = ("dynamics", "prescribed")
"""What `fluxtwin run NAME --attitude` may be; the first is the default."""
_NAMES = ("yaw", "roll", "pitch")


def with_attitude(config: Scenario, attitude: str) -> Scenario:
    """The scenario with one of ATTITUDES; BadInput for another word."""
    if attitude not in ATTITUDES:
        raise BadInput(f"{attitude!r}", where="--attitude", wanted=" or ".join(ATTITUDES))
    return config if attitude == "dynamics" else prescribed(config)


def prescribed(config: Scenario) -> Scenario:
    """The same spacecraft with the libration of its [attitude] section, torquers that act at random, and no wheels."""
    gone = dict.fromkeys(
        ("dynamics", "torques", "control", "wheels", "torquers.drive", "torquers.threshold_Am2", "attitude.mode")
    )
    return config.updated({**gone, "torquers.activity": "random"})


def is_dynamic(config: Scenario) -> bool:
    """Whether torques move the body."""
    return config.attitude.mode == "dynamics"


@dataclass(frozen=True)
class Motion:
    """How the vehicle moved in one flight, and what its actuators did."""

    dynamic: bool
    rms_deg: FloatArray
    """(3,) of the true yaw, roll, pitch."""
    largest_deg: FloatArray
    """(3,)."""
    torquers_on: FloatArray
    """(3,) share of the samples in which the torquer along x, y, z does more than a hundredth of the most that any did."""
    dipole_Am2: FloatArray
    """(3,) mean size of what it does."""
    wheel_rpm: FloatArray | None
    """(W, 2) slowest and fastest."""

    def summary(self) -> dict[str, Any]:
        """For `summary.json`."""
        return {
            "attitude": ATTITUDES[0] if self.dynamic else ATTITUDES[1],
            "rms_deg": dict(zip(_NAMES, self.rms_deg.tolist(), strict=True)),
            "largest_deg": dict(zip(_NAMES, self.largest_deg.tolist(), strict=True)),
            "torquers_on_share": self.torquers_on.tolist(),
            "torquers_mean_Am2": self.dipole_Am2.tolist(),
            "wheel_speed_rpm": None if self.wheel_rpm is None else self.wheel_rpm.tolist(),
        }

    def table(self, note: str = "") -> Table:
        """To read."""
        rows: list[list[str | float]] = [
            [name, f"{rms:.2f}", f"{largest:.2f}"]
            for name, rms, largest in zip(_NAMES, self.rms_deg, self.largest_deg, strict=True)
        ]
        what = "by torques, wheels and control" if self.dynamic else "as prescribed"
        on = "/".join(f"{100 * share:.0f}" for share in self.torquers_on)
        mean = "/".join(f"{value:.2g}" for value in self.dipole_Am2)
        said = [f"Torquers along x/y/z on for {on} % of the samples, {mean} A m2 on average."]
        if self.wheel_rpm is not None:
            said.append(
                "Wheels " + ", ".join(f"{low:.0f} to {high:.0f}" for low, high in self.wheel_rpm.tolist()) + " rpm."
            )
        return Table(
            f"The true motion, {what}", ["angle", "rms [deg]", "largest [deg]"], rows, " ".join([note, *said]).strip()
        )


def motion_of(config: Scenario, telemetry: Telemetry, truth: Truth) -> Motion:
    """What one flight of a scenario did."""
    angles = np.degrees(np.stack([truth.yaw_rad, truth.roll_rad, truth.pitch_rad], axis=1))
    dipole = np.abs(truth.dipole_B_Am2)
    speed = telemetry.wheel_speed_rpm
    return Motion(
        dynamic=is_dynamic(config),
        rms_deg=np.sqrt(np.mean(angles**2, axis=0)),
        largest_deg=np.abs(angles).max(axis=0),
        torquers_on=(dipole > 0.01 * dipole.max()).mean(axis=0),
        dipole_Am2=dipole.mean(axis=0),
        wheel_rpm=None if speed is None else np.stack([speed.min(axis=0), speed.max(axis=0)], axis=1),
    )
