"""What a control law is: a section of a scenario with its gains, and a function that a kernel can run."""

from __future__ import annotations

from typing import ClassVar

from fluxtwin.sim.base.section_types import Section
from fluxtwin.sim.base.types import FloatArray


class Control(Section):
    """Base of all control laws: a frozen record, checked as a section [control.NAME] of a scenario."""

    name: ClassVar[str]
    needs_torquers: ClassVar[bool] = False
    needs_wheels: ClassVar[bool] = False
    """Without them the law could do nothing of what it is for."""

    @staticmethod
    def decide(packed: FloatArray, at: int, reading: FloatArray, memory: FloatArray, command: FloatArray) -> None:
        """Add to `command` what the law wants at this tick.

        packed[at ...] holds the gains; reading, memory and command are as in `dynamics.layout`. Compiled like the
        torques, so under the same restrictions.
        """
        raise NotImplementedError

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The numbers that `decide` finds at packed[at ...]; inertia_kg_m2 is that of the whole body, (3, 3) in B."""
        raise NotImplementedError
