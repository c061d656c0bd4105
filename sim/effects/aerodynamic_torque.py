"""Torque of the air that the model of the surface lacks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect, vector_parameters
from fluxtwin.sim.effects.with_torque import plus, torque_of, with_torque
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques.drag_moment import DragMoment


@dataclass(frozen=True)
class AerodynamicTorque(DynamicsEffect):
    """Air drag torque that the surface model lacks.

    Torque of the air that the model of the surface lacks.
    """

    name: ClassVar[str] = "aerodynamic_torque"
    stage: ClassVar[str] = "dynamics"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a lower perigee, or a day of an active sun"
    about: ClassVar[str] = (
        "torque of a drag that acts beside the centre of mass, C_D A c, the same area and centre for every wind "
        "(Wertz 1978, section 17.2.3), in the air of the density table"
    )

    parameters = vector_parameters("moment", "m3", 0.1)

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        known = torque_of(vehicle, DragMoment)
        return with_torque(vehicle, DragMoment(moment_m3=plus(None if known is None else known.moment_m3, theta)))
