"""The torques there are, one line each. Their order is that of the packed parameters."""

from __future__ import annotations

from fluxtwin.sim.spacecraft.torques.aerodynamic import Aerodynamic
from fluxtwin.sim.spacecraft.torques.base import Torque
from fluxtwin.sim.spacecraft.torques.drag_moment import DragMoment
from fluxtwin.sim.spacecraft.torques.eddy_currents import EddyCurrents
from fluxtwin.sim.spacecraft.torques.gravity_gradient import GravityGradient
from fluxtwin.sim.spacecraft.torques.residual_dipole import ResidualDipole
from fluxtwin.sim.spacecraft.torques.solar_pressure import SolarPressure
from fluxtwin.sim.spacecraft.torques.sunlight_moment import SunlightMoment
from fluxtwin.sim.spacecraft.torques.torquers import Torquers

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
