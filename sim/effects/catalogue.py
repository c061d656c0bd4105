"""The list of effects: adding one is a class and a line here."""

from __future__ import annotations

from dataclasses import replace

from fluxtwin.sim.base.errors import BadInput, nearest
from fluxtwin.sim.effects import (
    ambient_field,
    calibration,
    clock_and_orbit,
    digits,
    law,
    reference_attitude,
    response,
    spacecraft_field,
    switched_field,
    temperature,
    torques,
)
from fluxtwin.sim.effects.base import Effect

CATALOGUE: tuple[Effect, ...] = (
    torques.ResidualDipoleTorque(),
    torques.AerodynamicTorque(),
    torques.SolarPressureTorque(),
    torques.EddyTorque(),
    torques.GravityGradientInertiaError(),
    torques.TorquerGainError(),
    clock_and_orbit.TimeTagOffset(),
    clock_and_orbit.AlongTrackError(),
    ambient_field.FieldEpoch(),
    ambient_field.FieldTruncation(),
    ambient_field.RingCurrent(),
    reference_attitude.SunSensorHeadMisalignment(),
    reference_attitude.HorizonScannerBias(),
    reference_attitude.YawDrift(),
    reference_attitude.AttitudeStep(),
    reference_attitude.AttitudeLag(),
    spacecraft_field.TorquerCoupling(),
    spacecraft_field.SolarArrayCurrent(),
    spacecraft_field.StrayField(),
    spacecraft_field.BatteryCurrent(),
    spacecraft_field.Driver(),
    law.Law(),
    switched_field.HeaterSwitching(),
    spacecraft_field.WheelField(),
    spacecraft_field.EddyCurrent(),
    switched_field.SwitchedField(),
    temperature.BoomBending(),
    calibration.Bias(),
    calibration.ScaleMisalignment(),
    temperature.ThermalBiasDrift(),
    temperature.ThermalScaleDrift(),
    temperature.CommonGainDrift(),
    calibration.LinearDrift(),
    calibration.MountingStep(),
    calibration.BiasStep(),
    calibration.BiasRandomWalk(),
    response.Hysteresis(),
    response.QuadraticNonlinearity(),
    response.CubicNonlinearity(),
    response.SensorLag(),
    response.AxisSkew(),
    digits.ExcessNoise(),
    response.Saturation(),
    digits.CoarseQuantization(),
    digits.BitErrors(),
)
"""Every effect with its default settings, in stage order."""


def title_of(name: str) -> str:
    """What the effect called `name` is, for a person; empty for a name that is not in the catalogue."""
    return next((effect.title for effect in CATALOGUE if effect.family == name.partition(".")[0]), "")


def find_effect(name: str, *, where: str = "effects") -> Effect:
    """The effect called `name`, as `bias` or `driver.payload`; raises BadInput that names the nearest one."""
    kind, _, key = name.partition(".")
    for effect in CATALOGUE:
        if effect.name == kind and not key:
            return effect
        if effect.name == kind and effect.keyed_by is not None:
            return replace(effect, **{effect.keyed_by: key})
    names = [effect.name for effect in CATALOGUE]
    hint = nearest(name.lower(), names, cutoff=0.6)
    wanted = None if hint else "a name that `fluxtwin effects` lists"
    raise BadInput(
        f"no effect is called {name!r}{hint}", where=where, wanted=wanted, details=f"effects: {', '.join(names)}"
    )
