"""From a scenario's sections to the parts of the spacecraft: magnetometer, torquers, heads, scanner, gyro."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import HorizonScannerSection, SunSensorSection
from fluxtwin.sim.spacecraft.sensors.gyro import Gyro
from fluxtwin.sim.spacecraft.sensors.horizon_crossings import ConicalScanner
from fluxtwin.sim.spacecraft.sensors.horizon_scanner import HorizonScanner
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.sensors.sun_sensor import SunSensorHead
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


def sun_sensor_heads(scenario: Scenario) -> list[SunSensorHead]:
    """The heads in order of their numbers."""
    return [_head(int(number), scenario.sun_sensor[number]) for number in sorted(scenario.sun_sensor, key=int)]


def horizon_scanner(scenario: Scenario) -> HorizonScanner | None:
    """The scanner, if the scenario has one."""
    section = scenario.horizon_scanner
    if section is None:
        return None
    correlated = section.tau_s > 0
    return HorizonScanner(
        noise_rad=0.0 if correlated else float(np.radians(section.noise_deg)),
        lsb_rad=float(np.radians(section.lsb_deg)),
        bias_rad=(float(np.radians(section.roll_bias_deg)), float(np.radians(section.pitch_bias_deg))),
        wander_rad=float(np.radians(section.noise_deg)) if correlated else 0.0,
        wander_tau_s=section.tau_s,
    )


def conical_scanner(section: HorizonScannerSection) -> ConicalScanner:
    """The scans of a horizon scanner."""
    axes = {"pair": (1, -1), "+y": (1,), "-y": (-1,)}[section.scans]
    return ConicalScanner(axes, float(np.radians(section.half_cone_deg)))


def gyro(scenario: Scenario) -> Gyro | None:
    """The gyro, if the scenario has one."""
    section = scenario.gyro
    if section is None:
        return None
    x, y, z = (float(np.radians(rate) / 3600.0) for rate in section.bias_deg_h)
    return Gyro(
        bias_rad_s=(x, y, z),
        noise_rad_s=float(np.radians(section.noise_deg_s)),
        random_walk_rad_s_per_sqrt_s=float(np.radians(section.random_walk_deg_h_per_sqrt_h) / 3600.0 / 60.0),
    )


def _head(number: int, section: SunSensorSection) -> SunSensorHead:
    azimuth, elevation = np.radians(section.azimuth_deg), np.radians(section.elevation_deg)
    flat = float(np.cos(elevation))
    x, y, z = (float(np.radians(angle)) for angle in section.misalignment_deg)
    return SunSensorHead(
        number=number,
        boresight_B=(flat * float(np.cos(azimuth)), flat * float(np.sin(azimuth)), -float(np.sin(elevation))),
        x_axis_B=(-float(np.sin(azimuth)), float(np.cos(azimuth)), 0.0),
        half_fov_rad=float(np.radians(section.half_fov_deg)),
        lsb_rad=float(np.radians(section.lsb_deg)),
        noise_rad=float(np.radians(section.noise_deg)),
        misalignment_B_rad=(x, y, z),
    )
