"""`fluxtwin passes`: when the scenario's stations see the spacecraft."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output
from fluxtwin.scenarios.packaged import NAMES

BRIEF = "List when the stations of a scenario see the spacecraft."


def command(
    output: Output,
    scenario: Annotated[
        Path, of.argument("SCENARIO.toml", f"Orbit, schedule and stations: a TOML file, or by name {NAMES}.")
    ],
    stations: Annotated[
        Path | None, of.option("FILE.toml", "Stations as [station.NAME] sections, instead of those in the scenario.")
    ] = None,
) -> None:
    """List every pass over every [station.NAME] from the first to the last sample of the schedule.

    A pass counts from the elevation mask_deg of its station on, without refraction. A pass that the span cuts is marked.
    """
    with output.progress(f"reading {scenario}"):
        from fluxtwin.sim.run.scenario_passes import list_passes
        from fluxtwin.verbs import with_stations

        output.claim({}, [scenario, stations])
        plan = with_stations(scenario, stations)
        found = list_passes(plan)
    columns = ("station", "rise [UTC]", "set [UTC]", "minutes", "highest [deg]", "sunlit", "cut")
    rows = [
        (
            item["station"],
            item["rise"],
            item["set"],
            f"{item['minutes']:.1f}",
            f"{item['highest_deg']:.1f}",
            "yes" if item["sunlit"] else "no",
            "yes" if item["cut"] else "",
        )
        for item in found
    ]
    if rows:
        output.table(f"Passes of {plan.spacecraft.name}", columns, rows, "Sunlit: the spacecraft, at its highest.")
    total, count = sum(item["minutes"] for item in found), len(plan.station)
    passes = f"{len(found)} pass{'' if len(found) == 1 else 'es'}"
    output.say(f"{passes} over {count} station{'' if count == 1 else 's'}, {total:.0f} min in all")
    output.result({"name": plan.name, "passes": found})
