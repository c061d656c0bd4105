"""Pairs of names that a record of an Earth-pointing spacecraft confuses: one of each is flown."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.gap.linear.projection import projected
from fluxtwin.gap.planning.power import Cause, Flown
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active

QUIET = {"torquers.activity": "off"}
PAIRS: dict[tuple[str, str], dict[str, Any]] = {
    ("time_tag_offset", "along_track_error"): {},
    ("sensor_lag", "time_tag_offset"): QUIET,
    ("sensor_lag", "along_track_error"): QUIET,
    ("solar_array_current", "battery_current"): {},
    ("quadratic_nonlinearity", "thermal_scale_drift"): {},
    ("quadratic_nonlinearity", "thermal_bias_drift"): {},
    ("common_gain_drift", "thermal_scale_drift"): {},
    ("quadratic_nonlinearity", "solar_array_current"): {},
    ("cubic_nonlinearity", "quadratic_nonlinearity"): {},
    ("cubic_nonlinearity", "hysteresis"): {},
    ("thermal_bias_drift", "thermal_scale_drift"): {},
    ("linear_drift", "thermal_bias_drift"): {},
}
"""By pair: what the spacecraft does in its record beside what is drawn."""
ENERGY = (35.0, 70.0)
"""Squared size of the cause in the record over the noise, beside what is re-estimated: seen, and no more."""
_EACH = 1.5
"""More of it for each parameter: so much more is asked of those with many."""
_MANY = 6


def cause(name: str, rng: np.random.Generator, flown: Flown) -> Cause | None:
    """An effect in a drawn direction (of many parameters, one alone), of a drawn energy in a record; None where the record
    cannot have it."""
    effect = find_effect(name)
    assert isinstance(effect, SignalEffect)
    if name in flown.untestable:
        return None
    drawn = rng.standard_normal(len(effect.parameters))
    if drawn.size > _MANY:
        drawn *= np.arange(drawn.size) == rng.integers(drawn.size)
    drawn /= np.linalg.norm(drawn) / np.sqrt(drawn.size)
    theta = np.array([p.scale * value for p, value in zip(effect.parameters, drawn, strict=True)])
    low, high = (np.array([getattr(p, end) for p in effect.parameters]) for end in ("low", "high"))
    theta = np.where((theta < low) | (theta > high), np.abs(theta), theta)
    wanted = rng.uniform(*ENERGY) + _EACH * drawn.size
    for _ in range(4):
        has = _energy(flown, (effect, theta))
        if not has > 1e-6:
            return None
        theta = theta * np.sqrt(wanted / has)
    return Cause(effect, theta) if ((theta >= low) & (theta <= high)).all() else None


def _energy(flown: Flown, active: Active) -> float:
    problem = flown.problem
    on = [*problem.frozen, *problem.modelled_active]
    signal = problem.chain.reading_nT([*on, active]) - problem.chain.reading_nT(on)
    return projected(flown.whitener, signal, problem.nuisance).energy
