"""Torques that turn the body: they move the attitude itself, not what is reported of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect, Effect, vector_parameters
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques import (
    DragMoment,
    EddyCurrents,
    GravityGradient,
    ResidualDipole,
    SunlightMoment,
    Torque,
    Torquers,
)

_Kind = TypeVar("_Kind", bound=Torque)


def torque_of(vehicle: Vehicle, kind: type[_Kind]) -> _Kind | None:
    """The vehicle's torque of a kind, None where it has none."""
    return next((torque for torque in vehicle.torques if isinstance(torque, kind)), None)


def with_torque(vehicle: Vehicle, torque: Torque) -> Vehicle:
    """The vehicle with this torque, in place of one of its kind."""
    others = tuple(one for one in vehicle.torques if one.name != torque.name)
    return dataclasses.replace(vehicle, torques=(*others, torque))


def with_more(vehicle: Vehicle, kind: type[Torque], key: str, more: FloatArray) -> Vehicle:
    """The vehicle with `more` in one key of a torque, a vector or a matrix, beyond what it has there already."""
    known: Any = torque_of(vehicle, kind)
    whole = more if known is None else np.asarray(getattr(known, key)) + more
    return with_torque(vehicle, kind.model_validate({key: whole.tolist()}))


@dataclass(frozen=True)
class AddedTorque(DynamicsEffect):
    """Base of the effects that are one vector of a torque, more of it or the whole."""

    torque: ClassVar[type[Torque]]
    key: ClassVar[str]

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        return with_more(vehicle, self.torque, self.key, theta)


@dataclass(frozen=True)
class ResidualDipoleTorque(AddedTorque):
    """Torque of an unknown magnetic dipole."""

    name = "residual_dipole_torque"
    follows = "field_strength"
    settled_by = "wheels and torquers undisturbed for an orbit or two, with a better reference attitude"
    about = (
        "torque m x B of a residual magnetic dipole m fixed in the body (Wertz 1978, section 17.2.4); NASA SP-8018 "
        "gives about 1e-3 A m2 per kilogram for an ordinary spacecraft"
    )
    parameters = vector_parameters("dipole", "A m2", 0.5)
    torque, key = ResidualDipole, "dipole_Am2"


@dataclass(frozen=True)
class AerodynamicTorque(AddedTorque):
    """Air drag torque that the surface model lacks."""

    name = "aerodynamic_torque"
    settled_by = "a lower perigee, or a day with an active sun"
    about = (
        "torque of drag acting off the centre of mass, C_D A c, with the same area and centre for every wind direction "
        "(Wertz 1978, section 17.2.3), in the air of the density table"
    )
    parameters = vector_parameters("moment", "m3", 0.1)
    torque, key = DragMoment, "moment_m3"


@dataclass(frozen=True)
class SolarPressureTorque(AddedTorque):
    """Sunlight torque that the surface model lacks."""

    name = "solar_pressure_torque"
    follows = "sunlit"
    settled_by = "the sun kept on one side for whole orbits, with wheels absorbing the momentum"
    about = (
        "torque of sunlight acting off the centre of mass, C_R A c, with the same area and centre for every "
        "direction of the sun (Wertz 1978, section 17.2.2), none in the shadow"
    )
    parameters = vector_parameters("moment", "m3", 0.5)
    torque, key = SunlightMoment, "moment_m3"


@dataclass(frozen=True)
class EddyTorque(DynamicsEffect):
    """Torque of eddy currents in a rotating body."""

    name = "eddy_torque"
    follows = "rate"
    settled_by = "a spin of several rpm"
    about = (
        "braking torque (K (w x B)) x B of eddy currents, K diagonal in body axes (Wertz 1978, section 17.2.4; a thin "
        "spherical shell has 2 pi / 3 r^4 s d about each axis)"
    )
    parameters = vector_parameters("K", "A m2 s/T", 1000.0, low=0.0)

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        return with_more(vehicle, EddyCurrents, "K_Am2_s_per_T", np.diag(theta))


@dataclass(frozen=True)
class GravityGradientInertiaError(DynamicsEffect):
    """The inertia tensor differs from the scenario's."""

    name = "gravity_gradient_inertia_error"
    settled_by = "slews about all three axes, or a slow tumble"
    about = (
        "true inertia tensor minus that of the scenario. With acts_in = both it acts in the gravity gradient 3 GM / r^3 "
        "(r x dJ r) and in the gyroscopic torque; with acts_in = torque in the gravity gradient alone, where the trace "
        "is not observable (Wertz 1978, section 17.2.1)"
    )
    parameters = vector_parameters("inertia", "kg m2", 0.5, axes=("xx", "yy", "zz", "xy", "xz", "yz"))
    acts_in: Literal["both", "torque"] = "both"
    """both: the tensor of the body; torque: that of the gravity gradient alone."""

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        xx, yy, zz, xy, xz, yz = (float(value) for value in theta)
        change = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if self.acts_in == "both":
            return dataclasses.replace(vehicle, inertia_kg_m2=np.asarray(vehicle.inertia_kg_m2) + change)
        if self.idle(vehicle):
            return vehicle
        return with_more(vehicle, GravityGradient, "inertia_error_kg_m2", change)

    def step(self, vehicle: Vehicle) -> FloatArray:
        return np.full(6, 0.002 * float(np.trace(vehicle.inertia_kg_m2)))

    def idle(self, vehicle: Vehicle) -> str | None:
        if self.acts_in == "both" or torque_of(vehicle, GravityGradient) is not None:
            return None
        return "the scenario has no [torques.gravity_gradient]"

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        return (self, GravityGradientInertiaError("torque"))


@dataclass(frozen=True)
class TorquerGainError(DynamicsEffect):
    """Torquers differ from what telemetry says."""

    name = "torquer_gain_error"
    follows = "torquer"
    settled_by = "each torquer fully on in turn, with its dipole in the telemetry at every switching"
    about = (
        "true dipole of a torquer divided by that in the telemetry, minus 1, for each axis; affects its "
        "torque only (the field at the sensor is torquer_coupling)"
    )
    parameters = vector_parameters("gain", "1", 0.05, low=-2.0, high=2.0)

    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        known = torque_of(vehicle, Torquers)
        if known is None:
            return vehicle
        return with_torque(vehicle, known.model_copy(update={"gain": tuple((np.array(known.gain) + theta).tolist())}))

    def idle(self, vehicle: Vehicle) -> str | None:
        return "the scenario has no [torquers]" if torque_of(vehicle, Torquers) is None else None
