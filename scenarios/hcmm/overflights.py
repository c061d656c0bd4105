"""Which passes are one overflight, and random orders of overflights.

Two stations that see one overflight hear the same satellite at the same time, so their residuals are not independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.scenarios.hcmm_orbit.record import Pass
from fluxtwin.sim.earth import epoch

_SAME_OVERFLIGHT_S = 720.0


def overflights_of(passes: Sequence[Pass]) -> np.ndarray:
    """(P,) numbers: passes acquired within minutes of each other are one overflight."""
    seconds = epoch.seconds_since(np.array([p.aos for p in passes]), passes[0].aos)
    return np.concatenate([[0], np.cumsum(np.diff(seconds) > _SAME_OVERFLIGHT_S)])


def orders_of(overflight: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, P) rows in random order; overflights of as many passes change places as a whole."""
    members = [np.flatnonzero(overflight == n) for n in np.unique(overflight)]
    orders = np.tile(np.arange(overflight.size), (count, 1))
    for size in {len(rows) for rows in members}:
        blocks = np.array([rows for rows in members if len(rows) == size])
        shuffled = rng.permuted(np.tile(np.arange(len(blocks)), (count, 1)), axis=1)
        for place, rows in enumerate(blocks):
            orders[:, rows] = blocks[shuffled[:, place]]
    return orders
