"""What the positions, the attitude and the readings of a record were made from when it was read.

A file is read as its columns or its map say. Whoever asks whether that was right must know what was done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from fluxtwin.sim.earth.tle import TleSeries


@dataclass(frozen=True)
class Origin:
    """What a record's GCRS positions and attitude were made from with the help of its stamps.

    A wrong stamp turns the Earth under a GCRS position; it leaves an Earth-fixed position in place, but turns what is
    computed from it; and it moves a position that two-line elements gave along the orbit.
    """

    position: Literal["GCRS", "ITRS"] = "GCRS"
    attitude: Literal["GCRS", "ITRS", "NEC", "NED", "orbital"] = "GCRS"
    """What it was recorded relative to; for the stamps sun and nadir are as good as the orbital frame."""
    scalar_first: bool = False
    """The map took the quaternion's first component for the scalar."""
    elements: TleSeries | None = None
    conjugated: bool = False
    """The map took the stored quaternion for the conjugate."""
    matrix: Sequence[Sequence[float]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """(3, 3) by which the map turned the stored readings."""
    count_nT: float | None = 1.0
    """Reading [nT] for a stored number of 1; None where it is not one factor for all axes."""
    path: str = field(default="", compare=False)
    """Of the file that was read, which is not written over; empty where there was none."""
