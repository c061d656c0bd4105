"""A vehicle with one of its torques put in, or another in its place."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques.base import Torque

_Kind = TypeVar("_Kind", bound=Torque)


def torque_of(vehicle: Vehicle, kind: type[_Kind]) -> _Kind | None:
    """The vehicle's torque of a kind, None where it has none."""
    return next((torque for torque in vehicle.torques if isinstance(torque, kind)), None)


def with_torque(vehicle: Vehicle, torque: Torque) -> Vehicle:
    """The vehicle with this torque, in place of one of its kind."""
    others = tuple(one for one in vehicle.torques if one.name != torque.name)
    return dataclasses.replace(vehicle, torques=(*others, torque))


def plus(vector: Sequence[float] | None, more: FloatArray) -> tuple[float, float, float]:
    """The sum of two vectors; None is zero."""
    x, y, z = (np.zeros(3) if vector is None else np.asarray(vector)) + more
    return (float(x), float(y), float(z))
