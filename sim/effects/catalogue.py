"""The list of effects: adding one is a class and a line here."""

from __future__ import annotations

import difflib

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.effects.ambient_field import FieldEpoch, FieldTruncation, RingCurrent
from fluxtwin.sim.effects.base import Effect
from fluxtwin.sim.effects.calibration import Bias, BiasRandomWalk, BiasStep, ScaleMisalignment
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError, TimeTagOffset
from fluxtwin.sim.effects.digits import BitErrors, CoarseQuantization, ExcessNoise
from fluxtwin.sim.effects.reference_attitude import HorizonScannerBias, SunSensorHeadMisalignment, YawDrift
from fluxtwin.sim.effects.response import CubicNonlinearity, Hysteresis, QuadraticNonlinearity, Saturation, SensorLag
from fluxtwin.sim.effects.spacecraft_field import (
    BatteryCurrent,
    EddyCurrent,
    SolarArrayCurrent,
    TorquerCoupling,
    WheelField,
)
from fluxtwin.sim.effects.switched_field import HeaterSwitching, SwitchedField
from fluxtwin.sim.effects.temperature import BoomBending, ThermalBiasDrift, ThermalScaleDrift
from fluxtwin.sim.effects.torques import (
    AerodynamicTorque,
    EddyTorque,
    GravityGradientInertiaError,
    ResidualDipoleTorque,
    SolarPressureTorque,
    TorquerGainError,
)

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
