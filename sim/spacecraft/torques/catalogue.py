"""The torques there are, one line each. Their order is that of the packed parameters."""

from __future__ import annotations

from fluxtwin.sim.spacecraft.torques.base import Torque
from fluxtwin.sim.spacecraft.torques.gravity_gradient import GravityGradient
from fluxtwin.sim.spacecraft.torques.magnetic import EddyCurrents, ResidualDipole, Torquers
from fluxtwin.sim.spacecraft.torques.surface import Aerodynamic, DragMoment, SolarPressure, SunlightMoment

TORQUES: tuple[type[Torque], ...] = (
    GravityGradient,
    ResidualDipole,
    Torquers,
    Aerodynamic,
    SolarPressure,
    EddyCurrents,
    DragMoment,
    SunlightMoment,
)
