"""The published record: 43 passes with acquisition time, station and the ranges of three angles.

Source: Table 5 of AIAA 79-1695. Columns `..._read` hold what the scan shows; the others hold the value used, and `why`
says what was changed and from what. The record is in `passes.csv`; the stations are those of HCMM's scenario.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from fluxtwin.scenarios.flights import Mission
from fluxtwin.scenarios.packaged import SCENARIOS, load_scenario
from fluxtwin.sim.earth.stations import Station
from fluxtwin.sim.run.world import stations_of

Range = tuple[float, float]


@dataclass(frozen=True)
class Pass:
    """One row of Table 5. Angles in deg, each a (lowest, highest) of the pass, whole degrees in print."""

    number: int
    aos: np.datetime64
    """Printed acquisition of signal, whole minutes UTC."""
    aos_read: str
    """As the scan shows it, hhmm."""
    station: str
    dawn: bool
    """A dawn pass over Orroral, where head 1 sees the sun."""
    eps_M_mG: float
    sun_nadir: Range
    sun_nadir_read: Range
    sun_field: Range | None
    """None at night, when no sensor sees the sun."""
    sun_field_read: Range | None
    nadir_field_read: Range
    delta_sun_field_deg: float | None
    delta_nadir_field_deg: float
    delta_sun_nadir_deg: float | None
    why: str

    @property
    def sunlit(self) -> bool:
        """A sun-field angle was measured."""
        return self.sun_field is not None

    @property
    def label(self) -> str:
        """As 11-29 1400 ORR."""
        stamp = str(self.aos.astype("datetime64[m]"))
        return f"{stamp[5:10]} {stamp[11:13]}{stamp[14:16]} {self.station}"


@cache
def read_passes() -> tuple[Pass, ...]:
    """All 43 passes, in the order of the table."""
    return tuple(map(_pass, Mission("fluxtwin.scenarios.hcmm_orbit").table("passes")))


@cache
def read_stations() -> dict[str, Station]:
    """The seven stations of `hcmm.toml` by their letters, horizon at zero elevation."""
    return {station.name: station for station in stations_of(load_scenario(SCENARIOS["hcmm"]))}


def _pass(row: dict[str, str]) -> Pass:
    hour, minute = row["aos"][:2], row["aos"][2:]
    return Pass(
        number=int(row["n"]),
        aos=np.datetime64(f"{row['date']}T{hour}:{minute}", "ns"),
        aos_read=row["aos_read"],
        station=row["station"],
        dawn=row["dawn"] == "1",
        eps_M_mG=float(row["eps_M_mG"]),
        sun_nadir=_range(row, "se"),
        sun_nadir_read=_range(row, "se", "_read"),
        sun_field=_range(row, "sm") if row["sm_lo"] else None,
        sun_field_read=_range(row, "sm", "_read") if row["sm_lo_read"] else None,
        nadir_field_read=_range(row, "em", "_read"),
        delta_sun_field_deg=float(row["dSM"]) if row["dSM"] else None,
        delta_nadir_field_deg=float(row["dEM_read"]),
        delta_sun_nadir_deg=float(row["dSE"]) if row["dSE"] else None,
        why=row["why"],
    )


def _range(row: dict[str, str], name: str, kind: str = "") -> Range:
    return float(row[f"{name}_lo{kind}"]), float(row[f"{name}_hi{kind}"])
