"""Which frame and condition each effect of the catalogue belongs to."""

from __future__ import annotations

from dataclasses import dataclass

from fluxtwin.sim.effects.base import Effect
from fluxtwin.sim.effects.signal import Setting


@dataclass(frozen=True)
class EffectPlace:
    """Frame in which an effect is coherent and the condition it follows; None where there is none."""

    frame: str | None
    condition: str | None


_PLACES: dict[str, tuple[str | None, str | None]] = {
    "bias": ("body", None),
    "scale_misalignment": ("body", "field_strength"),
    "torquer_coupling": ("body", "torquer"),
    "quadratic_nonlinearity": ("body", "field_strength"),
    "cubic_nonlinearity": ("body", "field_strength"),
    "hysteresis": ("body", "field_strength"),
    "saturation": ("body", "field_strength"),
    "sensor_lag": (None, None),
    "coarse_quantization": ("body", None),
    "excess_noise": ("body", None),
    "thermal_bias_drift": ("body", "temperature"),
    "thermal_scale_drift": ("body", "temperature"),
    "bias_step": ("body", "after_time"),
    "bias_random_walk": ("body", "time"),
    "bit_errors": ("body", None),
    "time_tag_offset": (None, None),
    "along_track_error": ("orbital", None),
    "field_epoch": ("earth", None),
    "field_truncation": ("earth", None),
    "ring_current": ("earth", None),
    "solar_array_current": ("body", "current"),
    "battery_current": ("body", "current"),
    "heater_switching": ("body", "flag:heater_on"),
    "wheel_field": ("body", None),
    "eddy_current": ("body", "rate"),
    "switched_field": ("body", None),
    "boom_bending": ("body", "temperature"),
    "sun_sensor_head_misalignment": ("body", "head"),
    "horizon_scanner_bias": ("orbital", "latitude"),
    "yaw_drift": ("orbital", "time"),
    "residual_dipole_torque": ("body", "field_strength"),
    "aerodynamic_torque": ("body", None),
    "solar_pressure_torque": ("body", "sunlit"),
    "eddy_torque": ("body", "rate"),
    "gravity_gradient_inertia_error": ("body", None),
    "torquer_gain_error": ("body", "torquer"),
}

_WITHOUT_COLUMN = {
    "solar_array_current": ("array_current_A", "sunlit"),
    "battery_current": ("battery_current_A", "sunlit"),
    "heater_switching": ("heater_on", None),
    "thermal_bias_drift": ("temperature_degC", "temperature"),
}


def place_of(effect: Effect, setting: Setting) -> EffectPlace:
    """Frame and condition of an effect on this design.

    A current that was not recorded is a matter of sunlight; an effect with a discrete setting called `flag`,
    `condition` or `when` follows that.
    """
    frame, condition = _PLACES.get(effect.name, (None, None))
    if effect.name in _WITHOUT_COLUMN:
        column, otherwise = _WITHOUT_COLUMN[effect.name]
        condition = condition if setting.column(column) is not None else otherwise
    flag = getattr(effect, "flag", None)
    if isinstance(flag, str) and flag:
        condition = f"flag:{flag.removeprefix('flag_')}"
    when = getattr(effect, "condition", None) or getattr(effect, "when", None)
    if isinstance(when, str):
        lowered = "region" if getattr(effect, "region_deg", None) else when.lower().replace("night", "eclipse")
        for name in ("eclipse", "region", "sunlit", "latitude", "time"):
            if name in lowered:
                condition = name
                break
        if lowered.startswith("flag"):
            condition = "flag:" + when.removeprefix("flag_").removeprefix("flag:")
    return EffectPlace(frame, condition)
