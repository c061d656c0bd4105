"""What would settle a question that these data leave open: hours of like data, or a manoeuvre.

More of the same lowers the smallest size that shows as the square root of the time, so hours scale with the square of
size detectable over size wanted. A manoeuvre changes the geometry instead. The manoeuvres come from a study of
confusions over five designs (nadir pointing for one and for six orbits, inertial hold, a tumble of 0.25 deg/s, a spin
of 2 rpm): the tumble gains three to ten times on what nadir geometry hides in bias and matrix.
"""

from __future__ import annotations

from collections.abc import Mapping

from fluxtwin.gap.records import Detectable
from fluxtwin.sim.effects.catalogue import CATALOGUE

MOST_HOURS = 24.0 * 14
"""Beyond two weeks of like data a manoeuvre is the better advice alone."""

_TUMBLE = "a slow tumble of 0.25 deg/s"
MANOEUVRES: Mapping[str, str] = {
    "bias": _TUMBLE,
    "scale_misalignment": _TUMBLE,
    "torquer_coupling": "firing each torquer alone, on and off at full dipole, with the dipole in the telemetry",
    "quadratic_nonlinearity": _TUMBLE,
    "cubic_nonlinearity": _TUMBLE,
    "hysteresis": _TUMBLE,
    "saturation": "turning the axis concerned along the strongest field, near the poles (a level axis by 90 deg)",
    "sensor_lag": "a spin of 2 rpm, or torquer edges sampled fast",
    "coarse_quantization": "slower motion, so that single steps of the reading show",
    "excess_noise": "a quiet stretch with torquers and payload off",
    "thermal_bias_drift": "warming and cooling through a full range, over several sun angles",
    "thermal_scale_drift": "a slow tumble of 0.25 deg/s, at several temperatures",
    "bias_step": "data from well before and well after the jump",
    "bias_random_walk": _TUMBLE,
    "bit_errors": "the raw counts",
    "time_tag_offset": "a spin of 2 rpm (milliseconds show), or a slow tumble of 0.25 deg/s",
    "along_track_error": "any body rate; a slow tumble of 0.25 deg/s is enough",
    "field_epoch": _TUMBLE,
    "field_truncation": "a whole day, so that all longitudes are flown over",
    "ring_current": "a slow tumble of 0.25 deg/s, or days of different Dst",
    "solar_array_current": "steps of the load, or panels turned off the sun, with the current in the telemetry",
    "battery_current": "steps of the load, or the taper at the end of charge, with the current in the telemetry",
    "heater_switching": "the state of the heater in the telemetry, or an orbit with the thermostat off",
    "wheel_field": "the wheel speed in the telemetry, or a few speeds held in turn",
    "eddy_current": "a spin of 2 rpm",
    "switched_field": "switching it on and off in sunlight and in shadow, with its flag in the telemetry",
    "boom_bending": "a slow tumble of 0.25 deg/s through sun and shadow, with the boom's temperature in the telemetry",
    "sun_sensor_head_misalignment": "the number of the head in the telemetry, and turns of 90 deg that bring each head "
    "to the sun for half an orbit",
    "horizon_scanner_bias": "a second attitude sensor beside the scanner",
    "yaw_drift": "a second attitude sensor through the eclipse",
    "residual_dipole_torque": "wheels and torquers left alone for an orbit or two, with a better reference attitude",
    "aerodynamic_torque": "a lower perigee, or a day of an active sun",
    "solar_pressure_torque": "the sun held on one side for whole orbits, wheels taking up the momentum",
    "eddy_torque": "a spin of several rpm",
    "gravity_gradient_inertia_error": "slews about all three axes, or a slow tumble",
    "torquer_gain_error": "each torquer full on in turn, with its dipole in the telemetry at every switch",
}


def hours_needed(found: Detectable, wanted: float, hours: float) -> float:
    """Hours of like data after which a size `wanted` shows, when `hours` of them show `found`."""
    return hours * (found.value / abs(wanted)) ** 2


def typical_size(name: str, parameter: str) -> float | None:
    """The typical size of a parameter in the catalogue, None for what is not there."""
    for effect in CATALOGUE:
        if effect.name == name:
            return next((p.scale for p in effect.parameters if p.name == parameter), None)
    return None


def would_settle(detectable: Mapping[str, Detectable], untestable: Mapping[str, str], hours: float) -> dict[str, str]:
    """For each effect that these data do not show at its typical size: what would, in words.

    hours: of data that were used.
    """
    advice = {}
    for name, found in detectable.items():
        wanted = typical_size(name, found.parameter)
        if wanted is None or found.value <= abs(wanted):
            continue
        unit = "" if found.unit == "1" else f" {found.unit}"
        needed = hours_needed(found, wanted, hours)
        data = "more than two weeks of such data"
        if needed <= MOST_HOURS:
            data = f"about {_plain(needed)} h of such data in place of {_plain(hours)} h"
        advice[name] = f"for {found.parameter} {abs(wanted):.3g}{unit}: {data}, or {MANOEUVRES[name]}"
    advice |= {name: MANOEUVRES[name] for name in untestable if name in MANOEUVRES}
    return advice


def _plain(value: float) -> str:
    """Two digits, never as a power of ten."""
    return f"{float(f'{value:.2g}'):g}"


def hours_of(seconds_per_row: float, rows: int) -> float:
    """Hours that so many rows cover."""
    return seconds_per_row * rows / 3600.0
