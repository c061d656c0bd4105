"""The verbs that fly a scenario, which may be given as such, as a file or by the name of a packaged one."""

from __future__ import annotations

from functools import wraps
from pathlib import Path
from typing import Any

from fluxtwin.notebook import usual
from fluxtwin.scenarios.packaged import as_scenario
from fluxtwin.scenarios.page import Table
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.run.ensemble.run import Ensemble, fly_ensemble
from fluxtwin.sim.run.simulate import simulate as fly
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

_ROUNDING = 1e-12  # in units of any quantity: below it nothing was simulated
_SHOWN = ("mean", "std", "p5", "p50", "p95", "p99", "max", "vehicle_of_max")


def simulate(
    scenario: Scenario | Path | str, *, world: World | None = None, progress: Progress = usual
) -> tuple[Telemetry, Truth]:
    """Run the scenario, its file or the packaged one of that name, once.

    world: the world of this scenario if it was built before (it does not depend on the seed); a caller that
    runs many seeds builds it once. Returns the telemetry and, apart from it, the truth; the sun pulses of
    [slit_sun_sensor] are rows of the telemetry alone.
    Raises BadInput for a scenario that cannot be run and OutOfRange for epochs outside the field model.
    """
    return fly(as_scenario(scenario), world=world, progress=progress)


@wraps(fly_ensemble)
def ensemble(scenario: Scenario | Path | str, vehicles: int, out: Path | str, **options: Any) -> Ensemble:
    """As `fluxtwin.sim.run.ensemble.run.fly_ensemble`."""
    return fly_ensemble(as_scenario(scenario), vehicles, out, **{"progress": usual, **options})


def ensemble_sentence(flown: Ensemble) -> str:
    """How many vehicles flew to the end, and how well they pointed."""
    found, pointing = flown.summary, flown.summary["figures"].get("pointing_rms_deg")
    said = f"{found['vehicles'] - found['lost']} of {found['vehicles']} vehicles flew to the end."
    if pointing is not None and pointing["vehicle_of_max"] is not None:
        said += (
            f" Pointing error, rms over the flight: median {pointing['p50']:.2g} deg; 95 % of the vehicles are below "
            f"{pointing['p95']:.2g} deg; the worst, vehicle {pointing['vehicle_of_max']}, has {pointing['max']:.2g} deg."
        )
    return said


def ensemble_table(flown: Ensemble) -> Table:
    """Spread of each quantity over the vehicles."""
    found = flown.summary
    rows = [[name, *(_seen(spread[key]) for key in _SHOWN)] for name, spread in found["figures"].items()]
    columns = ("quantity of a vehicle", "mean", "std", "5 %", "50 %", "95 %", "99 %", "max", "max in vehicle")
    return Table(f"{found['vehicles']} vehicles of {found['name']}, seed {found['seed']}", columns, rows)


def _seen(value: Any) -> Any:
    """Rounding errors of what is zero, some 1e-15, as zero."""
    return 0.0 if isinstance(value, float) and abs(value) < _ROUNDING else value
