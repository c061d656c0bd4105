"""An inertia tensor that is not the one of the scenario."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect, Effect, Parameter
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.with_torque import torque_of, with_torque
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques.gravity_gradient import GravityGradient

_PLACES = ("xx", "yy", "zz", "xy", "xz", "yz")


@dataclass(frozen=True)
class GravityGradientInertiaError(DynamicsEffect):
    """The inertia tensor is not the scenario's.

    An inertia tensor that is not the one of the scenario.
    """

    name: ClassVar[str] = "gravity_gradient_inertia_error"
    stage: ClassVar[str] = "dynamics"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "slews about all three axes, or a slow tumble"
    about: ClassVar[str] = (
        "true inertia tensor less that of the scenario; acts_in = both: in the gravity gradient 3 GM / r^3 (r x dJ r) "
        "and in the gyroscopic torque; acts_in = torque: in the gravity gradient alone, where the trace is not seen "
        "(Wertz 1978, section 17.2.1)"
    )

    acts_in: Literal["both", "torque"] = "both"
    """both: the tensor of the body; torque: that of the gravity gradient alone."""

    parameters = tuple(Parameter(f"inertia_{place}", "kg m2", 0.5) for place in _PLACES)

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        xx, yy, zz, xy, xz, yz = (float(value) for value in theta)
        change = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if self.acts_in == "both":
            return dataclasses.replace(vehicle, inertia_kg_m2=np.asarray(vehicle.inertia_kg_m2) + change)
        known = torque_of(vehicle, GravityGradient)
        if known is None:
            return vehicle
        whole = tuple(map(tuple, (np.array(known.inertia_error_kg_m2) + change).tolist()))
        return with_torque(vehicle, GravityGradient.model_validate({"inertia_error_kg_m2": whole}))

    def step(self, vehicle: Vehicle) -> FloatArray:
        return np.full(len(_PLACES), 0.002 * float(np.trace(vehicle.inertia_kg_m2)))

    def idle(self, vehicle: Vehicle) -> str | None:
        if self.acts_in == "both" or torque_of(vehicle, GravityGradient) is not None:
            return None
        return "the scenario has no [torques.gravity_gradient]"

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        return (self, GravityGradientInertiaError("torque"))
