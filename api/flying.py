"""The verbs that fly a scenario, which may be given as such, as a file or by the name of a packaged one."""

from __future__ import annotations

from functools import wraps
from pathlib import Path
from typing import Any

from fluxtwin.notebook import usual
from fluxtwin.scenarios.packaged import as_scenario
from fluxtwin.sim.run.ensemble.run import Ensemble, fly_ensemble
from fluxtwin.sim.run.simulate import simulate as fly
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry


@wraps(fly)
def simulate(scenario: Scenario | Path | str, **options: Any) -> tuple[Telemetry, Truth]:
    """As `fluxtwin.sim.run.simulate.simulate`."""
    return fly(as_scenario(scenario), **{"progress": usual, **options})


@wraps(fly_ensemble)
def ensemble(scenario: Scenario | Path | str, vehicles: int, out: Path | str, **options: Any) -> Ensemble:
    """As `fluxtwin.sim.run.ensemble.run.fly_ensemble`."""
    return fly_ensemble(as_scenario(scenario), vehicles, out, **{"progress": usual, **options})
