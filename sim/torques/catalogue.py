"""The torques there are, one line each. Their order is that of the packed parameters."""

from __future__ import annotations

from fluxtwin.sim.torques.aerodynamic import Aerodynamic
from fluxtwin.sim.torques.base import Torque
from fluxtwin.sim.torques.drag_moment import DragMoment
from fluxtwin.sim.torques.eddy_currents import EddyCurrents
from fluxtwin.sim.torques.gravity_gradient import GravityGradient
from fluxtwin.sim.torques.residual_dipole import ResidualDipole
from fluxtwin.sim.torques.solar_pressure import SolarPressure
from fluxtwin.sim.torques.sunlight_moment import SunlightMoment
from fluxtwin.sim.torques.torquers import Torquers

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
