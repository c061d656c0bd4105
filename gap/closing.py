"""Closing the loop: the named effects as sections of a scenario, so that the simulation has them too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.gap.records import Closure
from fluxtwin.sim.errors import NoAnswer
from fluxtwin.sim.scenario import Scenario, parse_scenario
from fluxtwin.sim.scenario_effects import effect_section


def closed_scenario(
    closure: Closure,
    scenario: Scenario | None,
    telemetry: Path,
    column_map: Path | None,
    *,
    noise_nT: float | None = None,
    lsb_nT: float | None = None,
) -> Scenario:
    """The scenario with the named effects, their parameters and covariance in it.

    Without a scenario one is made that replays the telemetry, with the noise and step given.
    S and b take what was re-estimated beside the effects.
    Raises NoAnswer when nothing was named.
    """
    if not closure.effects:
        raise NoAnswer("no effect was named, so there is nothing to put into a scenario")
    base = _replaying(telemetry, column_map) if scenario is None else scenario
    changes: dict[str, Any] = {
        f"effects.{effect.name}": effect_section(effect, theta, _whole(covariance))
        for effect, theta, covariance in closure.effects
    }
    S = np.array(base.magnetometer.S) + closure.S_change
    b = np.array(base.magnetometer.bias_nT) + closure.b_change_nT
    changes |= {"magnetometer.S": S.tolist(), "magnetometer.b_mG": None, "magnetometer.b_nT": b.tolist()}
    if scenario is None:
        declared = {"magnetometer.noise_nT": noise_nT, "magnetometer.lsb_nT": lsb_nT}
        changes |= {key: value for key, value in declared.items() if value}
    return base.updated(changes)


def _replaying(telemetry: Path, column_map: Path | None) -> Scenario:
    mapped = "" if column_map is None else f"column_map = {str(column_map.resolve())!r}\n"
    return parse_scenario(
        f'name = "closed"\nseed = 1\n[spacecraft]\nname = {telemetry.stem!r}\n'
        f"[replay]\ntelemetry = {str(telemetry.resolve())!r}\n{mapped}",
        where="closing",
    )


def _whole(covariance: np.ndarray | None) -> np.ndarray | None:
    """A covariance without gaps, or none: a parameter that was not estimated has no finite entry."""
    return covariance if covariance is not None and np.isfinite(covariance).all() else None
