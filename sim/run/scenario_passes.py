"""Ground stations of a file, and the passes of a scenario over its stations, over the time of its schedule."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.section_types import Section
from fluxtwin.sim.base.toml_input import read_tree, validate
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.earth.stations import find_contacts
from fluxtwin.sim.run.world import ephemeris, schedule_times, stations_of
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


def list_passes(scenario: Scenario) -> list[dict[str, Any]]:
    """Every pass, in order of rise: station, rise, set, highest (UTC text), minutes, highest_deg, sunlit, cut.

    Raises BadInput for a scenario without stations, or whose orbit is that of a recorded file.
    """
    if not scenario.station:
        raise BadInput("the scenario has no station", where="passes", wanted="[station.NAME] sections")
    if scenario.orbit is None or scenario.schedule is None:
        raise BadInput("the orbit is that of a recorded file", where="passes", wanted="[orbit] and [schedule]")
    time, _ = schedule_times(scenario)
    found = find_contacts(stations_of(scenario), lambda when: ephemeris(scenario, when), time[0], time[-1])
    if not found:
        return []
    top = np.array([contact.highest for contact in found])
    order = np.argsort(top, kind="stable")
    r_N_km = ephemeris(scenario, top[order])[0]
    lit = np.empty(len(found))
    lit[order] = sun.illumination(r_N_km, sun.sun_N_km(top[order]))
    return [
        {
            "station": contact.station,
            "rise": epoch.iso(contact.rise),
            "set": epoch.iso(contact.set),
            "highest": epoch.iso(contact.highest),
            "minutes": contact.seconds / 60.0,
            "highest_deg": float(np.degrees(contact.highest_rad)),
            "sunlit": bool(lit[number] > 0.5),
            "cut": contact.cut,
        }
        for number, contact in enumerate(found)
    ]
