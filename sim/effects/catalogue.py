"""The list of effects: adding one is a module and a line here."""

from __future__ import annotations

import difflib

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.effects.aerodynamic_torque import AerodynamicTorque
from fluxtwin.sim.effects.along_track_error import AlongTrackError
from fluxtwin.sim.effects.base import Effect
from fluxtwin.sim.effects.battery_current import BatteryCurrent
from fluxtwin.sim.effects.bias import Bias
from fluxtwin.sim.effects.bias_random_walk import BiasRandomWalk
from fluxtwin.sim.effects.bias_step import BiasStep
from fluxtwin.sim.effects.bit_errors import BitErrors
from fluxtwin.sim.effects.boom_bending import BoomBending
from fluxtwin.sim.effects.coarse_quantization import CoarseQuantization
from fluxtwin.sim.effects.cubic_nonlinearity import CubicNonlinearity
from fluxtwin.sim.effects.eddy_current import EddyCurrent
from fluxtwin.sim.effects.eddy_torque import EddyTorque
from fluxtwin.sim.effects.excess_noise import ExcessNoise
from fluxtwin.sim.effects.field_epoch import FieldEpoch
from fluxtwin.sim.effects.field_truncation import FieldTruncation
from fluxtwin.sim.effects.gravity_gradient_inertia_error import GravityGradientInertiaError
from fluxtwin.sim.effects.heater_switching import HeaterSwitching
from fluxtwin.sim.effects.horizon_scanner_bias import HorizonScannerBias
from fluxtwin.sim.effects.hysteresis import Hysteresis
from fluxtwin.sim.effects.quadratic_nonlinearity import QuadraticNonlinearity
from fluxtwin.sim.effects.residual_dipole_torque import ResidualDipoleTorque
from fluxtwin.sim.effects.ring_current import RingCurrent
from fluxtwin.sim.effects.saturation import Saturation
from fluxtwin.sim.effects.scale_misalignment import ScaleMisalignment
from fluxtwin.sim.effects.sensor_lag import SensorLag
from fluxtwin.sim.effects.solar_array_current import SolarArrayCurrent
from fluxtwin.sim.effects.solar_pressure_torque import SolarPressureTorque
from fluxtwin.sim.effects.sun_sensor_head_misalignment import SunSensorHeadMisalignment
from fluxtwin.sim.effects.switched_field import SwitchedField
from fluxtwin.sim.effects.thermal_bias_drift import ThermalBiasDrift
from fluxtwin.sim.effects.thermal_scale_drift import ThermalScaleDrift
from fluxtwin.sim.effects.time_tag_offset import TimeTagOffset
from fluxtwin.sim.effects.torquer_coupling import TorquerCoupling
from fluxtwin.sim.effects.torquer_gain_error import TorquerGainError
from fluxtwin.sim.effects.wheel_field import WheelField
from fluxtwin.sim.effects.yaw_drift import YawDrift

CATALOGUE: tuple[Effect, ...] = (
    ResidualDipoleTorque(),
    AerodynamicTorque(),
    SolarPressureTorque(),
    EddyTorque(),
    GravityGradientInertiaError(),
    TorquerGainError(),
    TimeTagOffset(),
    AlongTrackError(),
    FieldEpoch(),
    FieldTruncation(),
    RingCurrent(),
    SunSensorHeadMisalignment(),
    HorizonScannerBias(),
    YawDrift(),
    TorquerCoupling(),
    SolarArrayCurrent(),
    BatteryCurrent(),
    HeaterSwitching(),
    WheelField(),
    EddyCurrent(),
    SwitchedField(),
    BoomBending(),
    Bias(),
    ScaleMisalignment(),
    ThermalBiasDrift(),
    ThermalScaleDrift(),
    BiasStep(),
    BiasRandomWalk(),
    Hysteresis(),
    QuadraticNonlinearity(),
    CubicNonlinearity(),
    SensorLag(),
    ExcessNoise(),
    Saturation(),
    CoarseQuantization(),
    BitErrors(),
)
"""Every effect with its default settings, in stage order."""


def find_effect(name: str, *, where: str = "effects") -> Effect:
    """The effect called `name`; raises BadInput that names the nearest one."""
    for effect in CATALOGUE:
        if effect.name == name:
            return effect
    names = [effect.name for effect in CATALOGUE]
    near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.6)
    hint = f"; did you mean {near[0]}?" if near else ""
    wanted = None if near else "a name that `fluxtwin effects` lists"
    raise BadInput(
        f"no effect is called {name!r}{hint}", where=where, wanted=wanted, details=f"effects: {', '.join(names)}"
    )
