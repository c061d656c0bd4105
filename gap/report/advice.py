"""What would settle a question that these data leave open: hours of like data, or a manoeuvre.

More of the same lowers the smallest size that shows as the square root of the time, so hours scale with the square of
size detectable over size wanted. A manoeuvre changes the geometry instead: each effect says which (`settled_by`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fluxtwin.gap.records.diagnosis import Detectable
from fluxtwin.sim.base.types import TimeArray
from fluxtwin.sim.effects.catalogue import CATALOGUE

MOST_HOURS = 24.0 * 14
"""Beyond two weeks of like data a manoeuvre is the better advice alone."""


def hours_needed(found: Detectable, wanted: float, hours: float) -> float:
    """Hours of like data after which a size `wanted` shows, when `hours` of them show `found`."""
    return hours * (found.value / abs(wanted)) ** 2


def typical_size(name: str, parameter: str) -> float | None:
    """The typical size of a parameter in the catalogue, None for what is not there."""
    known = (p for effect in CATALOGUE if effect.name == name for p in effect.parameters if p.name == parameter)
    return next((one.scale for one in known), None)


def would_settle(detectable: Mapping[str, Detectable], untestable: Mapping[str, str], hours: float) -> dict[str, str]:
    """For each effect that these data do not show at its typical size: what would, in words.

    hours: of data that were used.
    """
    settled_by = {effect.name: effect.settled_by for effect in CATALOGUE}
    advice = {}
    for name, found in detectable.items():
        wanted = typical_size(name, found.parameter)
        if wanted is None or found.value <= abs(wanted):
            continue
        unit = "" if found.unit == "1" else f" {found.unit}"
        needed = hours_needed(found, wanted, hours)
        data = "more than two weeks of such data"
        if needed <= MOST_HOURS:
            data = f"about {_plain(needed)} h of such data instead of {_plain(hours)} h"
        advice[name] = f"for {found.parameter} {abs(wanted):.3g}{unit}: {data}, or {settled_by[name]}"
    return advice | {name: settled_by[name] for name in untestable if name in settled_by}


def _plain(value: float) -> str:
    """Two digits, never as a power of ten."""
    return f"{float(f'{value:.2g}'):g}"


def hours_of(time: TimeArray) -> float:
    """Hours of data that rows at these times (N,) cover, gaps left out."""
    if time.size < 2:
        return 0.0
    return float(np.median(np.diff(time)) / np.timedelta64(1, "s")) * time.size / 3600.0
