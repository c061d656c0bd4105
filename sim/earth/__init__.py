"""The world outside: time, frames, orbits, sun, stations, upper air and the geomagnetic field."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    epoch="parse_time iso add_seconds seconds_since decimal_year",
    frames="rotation_EN rotation_ON rotation_BO rotation_from_q q_from_rotation yaw_roll_pitch "
    "geodetic from_geodetic geocentric from_geocentric",
    orbit="Orbit argument_of_latitude",
    tle="Tle read_tle parse_tle",
    sun="sun_N_km sun_direction_N illumination",
    stations="Station find_contacts",
    field="field_E_nT field_N_nT field_NEC_nT",
    field_models="FieldModel load_field",
)
