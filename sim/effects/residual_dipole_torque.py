"""Torque of a dipole that the spacecraft has and nobody knows of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect, vector_parameters
from fluxtwin.sim.effects.with_torque import plus, torque_of, with_torque
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques.residual_dipole import ResidualDipole


@dataclass(frozen=True)
class ResidualDipoleTorque(DynamicsEffect):
    """Torque of a magnetic dipole nobody knows of.

    Torque of a dipole that the spacecraft has and nobody knows of.
    """

    name: ClassVar[str] = "residual_dipole_torque"
    stage: ClassVar[str] = "dynamics"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "field_strength"
    settled_by: ClassVar[str] = "wheels and torquers left alone for an orbit or two, with a better reference attitude"
    about: ClassVar[str] = (
        "torque m x B of a residual magnetic dipole m fixed in the body (Wertz 1978, section 17.2.4); NASA SP-8018 "
        "gives about 1e-3 A m2 a kilogram for an ordinary spacecraft"
    )

    parameters = vector_parameters("dipole", "A m2", 0.5)

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        known = torque_of(vehicle, ResidualDipole)
        return with_torque(vehicle, ResidualDipole(dipole_Am2=plus(None if known is None else known.dipole_Am2, theta)))
