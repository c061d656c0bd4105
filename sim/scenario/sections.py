"""What a scenario may say: one pydantic model a section, every quantity with its unit in the key.

Strict: no unknown key, no text where a number is wanted, no infinity, no NaN. Reading and saving is in
`scenario`; nothing here computes physics.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from fluxtwin.sim.base.section_types import (
    ZERO3,
    ZERO33,
    Direction,
    Matrix3,
    NonNegative,
    Positive,
    Quaternion,
    Section,
    Vector3,
    as_tuple,
    one_of,
)
from fluxtwin.sim.earth.constants import AM2_PER_POLE_CM, EARTH_RADIUS_KM, NT_PER_MG
from fluxtwin.sim.earth.epoch import iso, parse_time

_DATE_AND_TIME = re.compile(r"\d{4}-\d\d-\d\d(T\d\d:\d\d(:\d\d(\.\d+)?)?)?")


def _stamp(value: Any) -> Any:
    if isinstance(value, str):
        if not value.strip().endswith(("Z", "z")):
            stamp = value.strip().replace(" ", "T")
            said = f'; for UTC write "{stamp}Z"' if _DATE_AND_TIME.fullmatch(stamp) else ""
            raise ValueError(f"{value!r} does not say its time zone{said}")
        return iso(parse_time(value, where="a time in the scenario"), "ns")
    if hasattr(value, "utcoffset"):
        if value.utcoffset() is None or value.utcoffset().total_seconds() != 0:
            raise ValueError("a time needs UTC: end it with Z, as 1978-07-24T06:00:00Z")
        return iso(np.datetime64(value.replace(tzinfo=None), "ns"), "ns")
    raise ValueError("a time is needed, as 1978-07-24T06:00:00Z")


Stamp = Annotated[str, BeforeValidator(_stamp)]


class OrbitSection(Section):
    """Mean elements on the true equator and equinox of date at `epoch_utc`, or a file with a TLE."""

    tle: str | None = None
    epoch_utc: Stamp | None = None
    altitude_km: Annotated[float, Field(gt=80, lt=1e6)] | None = None
    """Semi-major axis less 6378.137 km."""
    eccentricity: Annotated[float, Field(ge=0, lt=1)] = 0.0
    inclination_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    raan_deg: float | None = None
    argument_of_perigee_deg: float = 0.0
    argument_of_latitude_deg: float | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.altitude_km is not None and self.altitude_km > 100_000:
            raise ValueError(f"altitude_km = {self.altitude_km:g} looks like metres; it is in km")
        names = ("epoch_utc", "altitude_km", "inclination_deg", "raan_deg", "argument_of_latitude_deg")
        missing = [name for name in names if getattr(self, name) is None]
        if self.tle is None and missing:
            raise ValueError(f"missing {', '.join(missing)} (or give tle = FILE)")
        if self.tle is not None and len(missing) < len(names):
            raise ValueError("give either tle or elements, not both")
        if self.altitude_km is not None:
            perigee = (self.altitude_km + EARTH_RADIUS_KM) * (1 - self.eccentricity) - EARTH_RADIUS_KM
            if perigee < 80:
                raise ValueError(f"the perigee is at {perigee:.0f} km altitude; at least 80 km is wanted")
        return self


class FieldSection(Section):
    """`truth` is the field that acts; `model` is what the ground uses. igrf14, igrf1975 or chaos:FILE."""

    truth: str = "igrf14"
    truth_degree: Annotated[int, Field(ge=1)] | None = None
    model: str = "igrf14"
    degree: Annotated[int, Field(ge=1)] | None = None


class SpacecraftSection(Section):
    """The name, and the inertia tensor where the attitude mode needs it."""

    name: str
    inertia_kg_m2: Matrix3 | None = None


class ReferenceAttitudeSection(Section):
    """The attitude that the ground is given, and its error (first-order Gauss-Markov per body axis)."""

    sigma_deg: NonNegative = 0.0
    tau_s: NonNegative = 0.0
    """Time constant of the error; 0 is white."""
    source: Literal["error_model", "sensors", "star_tracker"] = "error_model"
    """error_model: truth turned by the error; sensors: computed from sun-sensor and scanner readings; star_tracker: as the
    [star_tracker] gives it."""
    needs_sun: bool = False
    """Rows in which no sun-sensor head sees the sun have no attitude."""


class WaypointSection(Section):
    """One attitude of a slew plan, relative to the orbital frame: reached at rest `after_s` from the first
    sample and held for `hold_s`."""

    after_s: NonNegative
    hold_s: NonNegative = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0


class AttitudeSection(Section):
    """Prescribed attitude, or mode dynamics: then [dynamics], [torques] and [control] say what moves the body.

    Keys that the mode does not use keep their defaults.
    """

    mode: Literal["earth_pointing", "inertial_hold", "slews", "tumble", "spin", "dynamics"] = "earth_pointing"
    yaw_rms_deg: NonNegative = 0.0
    roll_rms_deg: NonNegative = 0.0
    pitch_rms_deg: NonNegative = 0.0
    shortest_period_min: Positive = 10.0
    longest_period_min: Positive = 100.0
    yaw_offset_deg: float = 0.0
    roll_offset_deg: float = 0.0
    pitch_offset_deg: float = 0.0
    q_NB: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """inertial_hold and tumble: attitude at the start, textbook quaternion, scalar last."""
    rate_deg_s: Vector3 = ZERO3
    """tumble: body rate at the start."""
    waypoints: Annotated[tuple[WaypointSection, ...], BeforeValidator(as_tuple)] = ()
    spin_axis_N: Direction = (0.0, 0.0, 1.0)
    """spin: direction of the angular momentum, GCRS."""
    spin_rate_rpm: float = 0.0
    nutation_deg: NonNegative = 0.0
    phase_deg: float = 0.0
    reference: ReferenceAttitudeSection = ReferenceAttitudeSection()

    @model_validator(mode="after")
    def _band(self) -> Self:
        if self.shortest_period_min > self.longest_period_min:
            raise ValueError("shortest_period_min is longer than longest_period_min")
        if self.mode == "slews" and len(self.waypoints) < 2:
            raise ValueError("slews need at least two waypoints")
        return self


class UnknownSection(Section):
    """A field nobody has explained, at the sensor: a switchable source with a kind and an rms per axis."""

    kind: Literal["white", "gauss_markov"] = "white"
    rms_mG: NonNegative | None = None
    rms_nT: NonNegative | None = None
    tau_s: Positive = 600.0

    @model_validator(mode="after")
    def _unit(self) -> Self:
        one_of(self, "rms_mG", "rms_nT")
        return self

    @property
    def nT(self) -> float:
        return _nT(self.rms_nT, self.rms_mG)


class MagnetometerSection(Section):
    """S, b, T of equation 1 (corrections, measured to true), noise, range and LSB; one unit a quantity."""

    S: Matrix3 = ZERO33
    b_nT: Vector3 | None = None
    b_mG: Vector3 | None = None
    T_nT_per_Am2: Matrix3 | None = None
    """Given here it stands for the whole torquer coupling; else the torquers' positions decide."""
    noise_nT: NonNegative | None = None
    noise_mG: NonNegative | None = None
    lsb_nT: NonNegative | None = None
    lsb_mG: NonNegative | None = None
    range_nT: Positive | None = None
    range_mG: Positive | None = None
    unknown: UnknownSection | None = None

    @model_validator(mode="after")
    def _units(self) -> Self:
        for name in ("b", "noise", "lsb", "range"):
            if getattr(self, f"{name}_nT") is not None and getattr(self, f"{name}_mG") is not None:
                raise ValueError(f"give {name}_nT or {name}_mG, not both")
        return self

    @property
    def bias_nT(self) -> tuple[float, float, float]:
        if self.b_mG is not None:
            x, y, z = (component * NT_PER_MG for component in self.b_mG)
            return (x, y, z)
        return self.b_nT if self.b_nT is not None else ZERO3

    @property
    def white_nT(self) -> float:
        return _nT(self.noise_nT, self.noise_mG)

    @property
    def step_nT(self) -> float:
        return _nT(self.lsb_nT, self.lsb_mG)

    @property
    def full_scale_nT(self) -> float | None:
        return None if self.range_nT is None and self.range_mG is None else _nT(self.range_nT, self.range_mG)


class SecondMagnetometerSection(MagnetometerSection):
    """Another one, at a place of its own: the same ambient field, less or more of the spacecraft's, no effect on sensors.

    The field of a dipole falls with the cube of the distance, so along one boom the second sees a share (r1/r2)^3 of what
    the first sees of each source (Ness et al. 1971, J. Geophys. Res. 76, 3564).
    """

    spacecraft_field_factor: NonNegative = 0.3
    """The field of the spacecraft here, over that at the first; 0.3 is half as far again from the source."""
    position_m: Vector3 | None = None
    """Where it sits as seen from the first, body axes: the torquers' field is then that of the dipole law."""


class TorquersSection(Section):
    """Three torquers along x, y, z; their field at the magnetometer by the dipole law."""

    dipole_Am2: Positive | None = None
    dipole_pole_cm: Positive | None = None
    positions_m: Annotated[tuple[Vector3, Vector3, Vector3], BeforeValidator(as_tuple)]
    """Where the x, y and z torquer sit, as seen from the magnetometer, body axes."""
    compensation: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of their field that the electronics take out of the reading, in proportion to each current."""
    activity: Literal["random", "off", "constant", "control"] = "random"
    """control: what the law of [control] commands, in attitude mode dynamics."""
    duty: Annotated[float, Field(ge=0, le=1)] = 0.5
    dwell_s: Positive = 300.0
    drive: Literal["linear", "saturated", "on_off"] = "saturated"
    """control: what a torquer makes of its command."""
    threshold_Am2: NonNegative = 0.0
    """on_off: off while the command is no larger than this."""
    telemetered: bool = True

    @model_validator(mode="after")
    def _unit(self) -> Self:
        one_of(self, "dipole_Am2", "dipole_pole_cm")
        return self

    @property
    def Am2(self) -> float:
        return self.dipole_Am2 if self.dipole_Am2 is not None else (self.dipole_pole_cm or 0) * AM2_PER_POLE_CM


class PowerSection(Section):
    """Solar array and battery. `normal_B` is the panel's normal; a tracking array turns about `axis_B`."""

    full_sun_current_A: Positive
    normal_B: Vector3 = (0.0, 0.0, -1.0)
    axis_B: Vector3 | None = None
    load_A: NonNegative = 0.0
    switched_load_A: NonNegative = 0.0
    """More load, on and off in turn, `switched_every_s` each."""
    switched_every_s: Positive = 600.0
    battery_capacity_Ah: Positive = 20.0
    charge_efficiency: Annotated[float, Field(gt=0, le=1)] = 0.9
    taper_above: Annotated[float, Field(gt=0, lt=1)] = 0.9


class WheelsSection(Section):
    """Reaction wheels, one spin axis each, that carry a momentum profile, or what the dynamics gives them."""

    axes_B: Annotated[tuple[Direction, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    inertia_kg_m2: Positive
    bias_rpm: Annotated[tuple[float, ...], BeforeValidator(as_tuple)]
    """Mean speeds; in attitude mode dynamics those at the start."""
    momentum_amplitude_Nms: Vector3 = ZERO3
    """Orbit-periodic momentum about each body axis that the wheels take up."""
    max_rpm: NonNegative = 0.0
    """dynamics: limit of the speed, as of the torque below; 0 is none."""
    max_torque_Nm: NonNegative = 0.0
    viscous_Nm_s: NonNegative = 0.0
    """dynamics: friction per rad/s, and that against the sense of turning."""
    coulomb_Nm: NonNegative = 0.0

    @model_validator(mode="after")
    def _one_speed_each(self) -> Self:
        if len(self.bias_rpm) != len(self.axes_B):
            raise ValueError(f"{len(self.bias_rpm)} speeds in bias_rpm for {len(self.axes_B)} wheels in axes_B")
        return self


_NEEDED = {
    "constant": ("high",),
    "square": ("high", "period_s", "duty"),
    "ramp": ("high", "period_s"),
    "random": ("high", "duty", "dwell_s"),
    "sunlit": ("high",),
    "file": ("file", "column"),
}
_ALSO = {"square": ("low", "offset_s"), "ramp": ("low", "offset_s"), "random": ("low",), "sunlit": ("low",)}


class DriverSection(Section):
    """A column `driver_NAME` of the telemetry: what something on board does, which a field may follow."""

    pattern: Literal["constant", "square", "ramp", "random", "sunlit", "file"]
    high: float | None = None
    low: float | None = None
    """Absent: 0."""
    period_s: Positive | None = None
    offset_s: float | None = None
    """From the first sample to the start of a period; absent: 0."""
    duty: Annotated[float, Field(ge=0, le=1)] | None = None
    dwell_s: Positive | None = None
    file: str | None = None
    """CSV with a column `time`, relative to the scenario's folder."""
    column: str | None = None
    unit: str = ""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        needed, also = _NEEDED[self.pattern], _ALSO.get(self.pattern, ())
        given = {name for name in type(self).model_fields if getattr(self, name) is not None} - {"pattern", "unit"}
        if not set(needed) <= given <= {*needed, *also}:
            wanted = ", ".join(needed) + (f" (and {', '.join(also)})" if also else "")
            raise ValueError(f'pattern = "{self.pattern}" wants {wanted}; found {", ".join(sorted(given)) or "none"}')
        return self


class SegmentSection(Section):
    """A run of samples `step_s` apart: so many `samples`, or a `duration_min`."""

    start_utc: Stamp
    step_s: Positive
    samples: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    duration_min: Positive | None = None

    @model_validator(mode="after")
    def _length(self) -> Self:
        one_of(self, "samples", "duration_min")
        return self

    @property
    def count(self) -> int:
        if self.samples is not None:
            return self.samples
        assert self.duration_min is not None
        return int(np.floor(self.duration_min * 60 / self.step_s + 1e-9)) + 1


class ScheduleSection(Section):
    """When samples are taken: one segment or more, in order."""

    segments: Annotated[tuple[SegmentSection, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    in_view_of_stations: bool = False
    """Only samples while some [station.NAME] sees the spacecraft: no tape recorder."""


class StationSection(Section):
    """One ground station, WGS 84."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-360, le=360)]
    """East."""
    altitude_km: Annotated[float, Field(gt=-12, lt=12)] = 0.0
    mask_deg: Annotated[float, Field(gt=-10, lt=90)] = 0.0
    """Elevation from which the station has contact."""


class TransferSection(Section):
    """Whether one effect of a closed scenario is good enough for another design; written by a diagnosis."""

    effect: str
    design: str
    transfers: bool
    chance: Annotated[float, Field(ge=0, le=1)] | None = None
    """That a diagnosis there would call the error of the effect a gap."""
    uncertainty_nT: NonNegative | None = None
    floor_nT: NonNegative | None = None
    detectable_nT: NonNegative | None = None
    why: str = ""


class ClosureSection(Section):
    """Where the effects and calibration of a closed scenario were learnt, and where they hold. Simulations ignore it."""

    telemetry: str = ""
    from_utc: Stamp | None = None
    to_utc: Stamp | None = None
    rows: Annotated[int, Field(ge=0)] = 0
    incomplete: str | None = None
    """Why the effects are not the whole gap."""
    transfer: Annotated[tuple[TransferSection, ...], BeforeValidator(as_tuple)] = ()


class ReplaySection(Section):
    """Take time, orbit, attitude and housekeeping from a recorded file instead of simulating them."""

    telemetry: str
    column_map: str | None = None


def _nT(in_nT: float | None, in_mG: float | None) -> float:
    if in_mG is not None:
        return in_mG * NT_PER_MG
    return 0.0 if in_nT is None else in_nT
