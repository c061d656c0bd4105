"""Torquers that are stronger or weaker than telemetry says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect, Parameter
from fluxtwin.sim.effects.with_torque import plus, torque_of, with_torque
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques.torquers import Torquers


@dataclass(frozen=True)
class TorquerGainError(DynamicsEffect):
    """Torquers are not as strong as telemetry says.

    Torquers that are stronger or weaker than telemetry says.
    """

    name: ClassVar[str] = "torquer_gain_error"
    stage: ClassVar[str] = "dynamics"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "torquer"
    settled_by: ClassVar[str] = "each torquer full on in turn, with its dipole in the telemetry at every switch"
    about: ClassVar[str] = (
        "true dipole of a torquer over the one that telemetry says, less 1, each axis; its torque alone (the field at "
        "the sensor is torquer_coupling)"
    )

    parameters = tuple(Parameter(f"gain_{axis}", "1", 0.05, low=-2.0, high=2.0) for axis in "xyz")

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        known = torque_of(vehicle, Torquers)
        if known is None:
            return vehicle
        return with_torque(vehicle, known.model_copy(update={"gain": plus(known.gain, theta)}))

    def idle(self, vehicle: Vehicle) -> str | None:
        return "the scenario has no [torquers]" if torque_of(vehicle, Torquers) is None else None
