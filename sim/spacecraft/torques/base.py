"""What a torque is: a section of a scenario with its parameters, and a function that a kernel can run."""

from __future__ import annotations

from typing import ClassVar

from fluxtwin.sim.base.section_types import Section
from fluxtwin.sim.base.types import FloatArray


class Torque(Section):
    """Base of all torques: a frozen record, checked as a section [torques.NAME] of a scenario."""

    name: ClassVar[str]
    # Without one of these the middle of a step has a new position, attitude and rate, and nothing else.
    needs_field: ClassVar[bool] = False
    needs_sun: ClassVar[bool] = False
    needs_air: ClassVar[bool] = False

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """Add the torque to stage[TORQUE ...], with the parameters at packed[at ...].

        It is compiled, so it uses numbers, `math` and the indices of `dynamics.layout` alone. Uncompiled it runs as
        well: that is what the reference path and the tests do.
        """
        raise NotImplementedError

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The numbers that `add` finds at packed[at ...]; inertia_kg_m2 is that of the whole body, (3, 3) in B."""
        raise NotImplementedError
