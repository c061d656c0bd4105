"""From a scenario's [station.NAME] sections to stations, and which samples of a schedule they see."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.section_types import Section
from fluxtwin.sim.base.toml_input import read_tree, validate
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.stations import Station, in_view
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import StationSection


class _StationsFile(Section):
    """A file of nothing but [station.NAME] sections."""

    station: dict[str, StationSection] = Field(min_length=1)


def read_stations(path: Path | str) -> dict[str, dict[str, Any]]:
    """The [station.NAME] sections of a file, checked, as a scenario takes them.

    Raises BadInput: no such file, not TOML, no station, an unknown key, an impossible value.
    """
    return validate(read_tree(path), _StationsFile, where=str(path)).model_dump()["station"]  # type: ignore[no-any-return]


def stations_of(scenario: Scenario) -> list[Station]:
    """The stations in the order of the scenario."""
    return [
        Station(
            name,
            float(np.radians(entry.latitude_deg)),
            float(np.radians(entry.longitude_deg)),
            entry.altitude_km,
            float(np.radians(entry.mask_deg)),
        )
        for name, entry in scenario.station.items()
    ]


def seen_from_stations(
    scenario: Scenario, time: TimeArray, segment: FloatArray, r_N_km: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """(N,) True in the rows that some station sees, and for those rows the number of the stretch in view, from 0.

    Raises BadInput where no row is seen.
    """
    r_E_km = frames.rotation_EN(time).apply(r_N_km)
    seen: BoolArray = np.asarray((in_view(stations_of(scenario), r_E_km) > 0).any(axis=1))
    if not seen.any():
        raise BadInput(
            "no sample is in view of any station",
            where="schedule.in_view_of_stations",
            wanted="a longer schedule, a lower mask_deg, or other stations",
        )
    fresh = np.concatenate([[True], ~seen[:-1] | (np.diff(segment) != 0)])
    stretch = np.cumsum(fresh & seen) - 1.0
    return seen, np.asarray(stretch[seen])
