"""Torque of the sunlight that the model of the surface lacks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect, vector_parameters
from fluxtwin.sim.effects.with_torque import plus, torque_of, with_torque
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques.sunlight_moment import SunlightMoment


@dataclass(frozen=True)
class SolarPressureTorque(DynamicsEffect):
    """Sunlight torque that the surface model lacks.

    Torque of the sunlight that the model of the surface lacks.
    """

    name: ClassVar[str] = "solar_pressure_torque"
    stage: ClassVar[str] = "dynamics"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "sunlit"
    settled_by: ClassVar[str] = "the sun held on one side for whole orbits, wheels taking up the momentum"
    about: ClassVar[str] = (
        "torque of sunlight that pushes beside the centre of mass, C_R A c, the same area and centre for every "
        "direction of the sun (Wertz 1978, section 17.2.2), none in the shadow"
    )

    parameters = vector_parameters("moment", "m3", 0.5)

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        known = torque_of(vehicle, SunlightMoment)
        return with_torque(vehicle, SunlightMoment(moment_m3=plus(None if known is None else known.moment_m3, theta)))
