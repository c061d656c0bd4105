"""From a scenario's sections to the magnetometer and the torquers."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import MagnetometerSection, SecondMagnetometerSection
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.torquers import RandomDuty, coupling_nT_per_Am2, draw_random_duty


def magnetometer(scenario: Scenario, name: str = "magnetometer") -> Magnetometer:
    """The magnetometer of this section with S, b, T of equation 1 and its noise, range and LSB."""
    section: MagnetometerSection = getattr(scenario, name)
    return Magnetometer(
        S=np.array(section.S),
        b_nT=np.array(section.bias_nT),
        T_nT_per_Am2=torquer_correction(scenario, section),
        noise_nT=section.white_nT,
        lsb_nT=section.step_nT,
        range_nT=section.full_scale_nT,
    )


def torquer_correction(scenario: Scenario, section: MagnetometerSection | None = None) -> FloatArray:
    """T of equation 1, (3, 3) nT/(A m2): given, or minus the dipole-law coupling of the torquers' positions, as far as
    the electronics do not take it out. That of a second magnetometer whose place is not given is a share of the first's."""
    section = scenario.magnetometer if section is None else section
    if section.T_nT_per_Am2 is not None:
        return np.array(section.T_nT_per_Am2)
    if scenario.torquers is None:
        return np.zeros((3, 3))
    positions_B_m = np.array(scenario.torquers.positions_m)
    if isinstance(section, SecondMagnetometerSection):
        if section.position_m is None:
            return section.spacecraft_field_factor * torquer_correction(scenario)
        positions_B_m -= section.position_m
    return (scenario.torquers.compensation - 1.0) * coupling_nT_per_Am2(positions_B_m)


def torquer_schedule(scenario: Scenario) -> RandomDuty:
    """What the torquers do in this scenario with this seed: at random, always or never."""
    section, rng = scenario.torquers, stream(scenario.seed, "torquers.schedule")
    if section is None or section.activity == "off":
        return draw_random_duty(0.0, 0.0, 1.0, rng)
    if section.activity == "constant":
        return draw_random_duty(section.Am2, 1.0, section.dwell_s, rng, both_signs=False)
    return draw_random_duty(section.Am2, section.duty, section.dwell_s, rng)
