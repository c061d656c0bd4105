"""From a scenario's sections to the magnetometer and the torquers."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.sensors.torquers import coupling_nT_per_Am2
from fluxtwin.sim.spacecraft.torquer_schedule import ConstantDipole, TorquerSchedule, draw_random_duty


def magnetometer(scenario: Scenario) -> Magnetometer:
    """The magnetometer with S, b, T of equation 1 and its noise, range and LSB."""
    section = scenario.magnetometer
    return Magnetometer(
        S=np.array(section.S),
        b_nT=np.array(section.bias_nT),
        T_nT_per_Am2=torquer_correction(scenario),
        noise_nT=section.white_nT,
        lsb_nT=section.step_nT,
        range_nT=section.full_scale_nT,
    )


def torquer_correction(scenario: Scenario) -> FloatArray:
    """T of equation 1, (3, 3) nT/(A m2): given, or minus the dipole-law coupling of the torquers' positions, as far as
    the electronics do not take it out."""
    if scenario.magnetometer.T_nT_per_Am2 is not None:
        return np.array(scenario.magnetometer.T_nT_per_Am2)
    if scenario.torquers is None:
        return np.zeros((3, 3))
    left = 1.0 - scenario.torquers.compensation
    return -left * coupling_nT_per_Am2(np.array(scenario.torquers.positions_m))


def torquer_schedule(scenario: Scenario) -> TorquerSchedule:
    """What the torquers do in this scenario with this seed."""
    section = scenario.torquers
    if section is None or section.activity == "off":
        return ConstantDipole()
    if section.activity == "constant":
        return ConstantDipole((section.Am2, section.Am2, section.Am2))
    return draw_random_duty(section.Am2, section.duty, section.dwell_s, stream(scenario.seed, "torquers.schedule"))
