"""From a scenario's [dynamics], [torques] and [control] to flights, and from flights to attitude, dipole, wheels."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.attitude.record import Attitude, ephemeris_rate_O_rad_s
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.base import DynamicsEffect
from fluxtwin.sim.run.spacecraft import magnetometer, torquer_schedule
from fluxtwin.sim.run.world import ephemeris
from fluxtwin.sim.scenario.dynamics_sections import ControlSection, DynamicsSection
from fluxtwin.sim.scenario.effect_sections import active_effects
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import SegmentSection
from fluxtwin.sim.spacecraft.dynamics.environment import Environment, environment_along
from fluxtwin.sim.spacecraft.dynamics.flight import Flight, Start, fly
from fluxtwin.sim.spacecraft.dynamics.vehicle import PERFECT, Target, Vehicle, Wheel
from fluxtwin.sim.spacecraft.torques import Torque, Torquers
from fluxtwin.sim.spacecraft.wheels import RPM_PER_RAD_S

_MOST_SPACING_S = 120.0
"""Of the nodes of the surroundings: a cubic is then off by 60 nT and 1e-5 of the position in low orbit."""
_BEYOND_S = 120.0
"""Flown after the last sample of a segment, for readings that are taken late."""
_KEPT_NODES = 500_000
_MOST_ROWS = 5_000_000


@dataclass(frozen=True)
class Flights:
    """The flights of a scenario, one a segment, in order of time."""

    flights: tuple[Flight, ...]
    since: TimeArray
    """From when on each holds, the first apart."""

    def attitude(self, time: TimeArray) -> Attitude:
        """Attitude at each stamp, from the flight of the segment that it belongs to."""
        stamps = epoch.as_times(time)
        number, q, rate = self._number(stamps), np.empty((stamps.size, 4)), np.empty((stamps.size, 3))
        for k in np.unique(number):
            rows = number == k
            part = self.flights[k].attitude(epoch.seconds_since(stamps[rows], self.flights[k].start))
            q[rows], rate[rows] = part.q_NB, part.rate_B_rad_s
        return Attitude(frames.rotation_from_q(q), rate)

    def dipole_B_Am2(self, time: TimeArray) -> FloatArray:
        return self._each(time, "dipole", 3)

    def wheel_speed_rpm(self, time: TimeArray) -> FloatArray:
        return RPM_PER_RAD_S * self._each(time, "wheel_speed", self.flights[0].wheel_speed_rad_s.shape[1])

    def _each(self, time: TimeArray, what: str, columns: int) -> FloatArray:
        stamps = epoch.as_times(time)
        number, values = self._number(stamps), np.empty((stamps.size, columns))
        for k in np.unique(number):
            rows = number == k
            values[rows] = getattr(self.flights[k], what)(epoch.seconds_since(stamps[rows], self.flights[k].start))
        return values

    def _number(self, stamps: TimeArray) -> np.ndarray:
        return np.clip(np.searchsorted(self.since, stamps, side="right") - 1, 0, None)


_latest: list[tuple[Scenario, str, Flights]] = []
"""What was asked for last; the scenario itself is looked for first: to write it down takes half a millisecond."""


def flights(scenario: Scenario) -> Flights:
    """The flights of this scenario and seed; the last ones are kept, because several parts of a run ask for them."""
    if _latest and _latest[0][0] is scenario:
        return _latest[0][2]
    assert scenario.schedule is not None
    field, wheels = scenario.field, scenario.wheels
    moving = (
        scenario.seed,
        scenario.spacecraft.inertia_kg_m2,
        scenario.orbit,
        field.truth,
        field.truth_degree,
        scenario.schedule.segments,
        wheels,
        scenario.dynamics,
        scenario.torques,
        scenario.control,
        _actuators(scenario),
        scenario.path_of("."),
        _moving_effects(scenario),
    )
    key = repr(moving)
    if _latest and _latest[0][1] == key:
        made = _latest[0][2]
    else:
        _latest.clear()  # the next ones can take the same memory
        segments = scenario.schedule.segments
        parts = tuple(_flight(scenario, k, segment) for k, segment in enumerate(segments))
        made = Flights(parts, _boundaries(parts, segments))
    _latest[:] = [(scenario, key, made)]
    return made


def _actuators(scenario: Scenario) -> tuple[object, ...]:
    """What of torquers and magnetometer has a hand in the motion: not where they sit, nor what telemetry makes of them."""
    torquers, meter = scenario.torquers, scenario.magnetometer
    seen = (meter.S, meter.bias_nT, meter.white_nT) if _control(scenario).magnetometer == "instrument" else None
    if torquers is None:
        return (seen,)
    steered = (torquers.Am2, torquers.activity, torquers.drive, torquers.threshold_Am2)
    return (seen, *steered, torquers.duty, torquers.dwell_s)


def _boundaries(made: Sequence[Flight], segments: Sequence[SegmentSection]) -> TimeArray:
    """A flight holds from the middle of the gap before its segment on, or from its own start if that is later.

    While it settles it may run beside the samples of the segment before.
    """
    first = [epoch.parse_time(segment.start_utc) for segment in segments]
    last = [epoch.add_seconds(t, (s.count - 1) * s.step_s)[0] for t, s in zip(first, segments, strict=True)]
    middle = [before + (after - before) // 2 for before, after in zip(last[:-1], first[1:], strict=True)]
    since = [made[0].start, *(max(flight.start, m) for flight, m in zip(made[1:], middle, strict=True))]
    return np.array(since, dtype="datetime64[ns]")


def vehicle_of(scenario: Scenario) -> Vehicle:
    """The body, wheels, torques and law of a scenario, with what its effects do to them."""
    torques: list[Torque] = [] if scenario.torques is None else [*scenario.torques.acting]
    section = scenario.torquers
    if section is not None:
        torques.append(Torquers(dipole_Am2=section.Am2, drive=section.drive, threshold_Am2=section.threshold_Am2))
    vehicle = Vehicle(
        inertia_kg_m2=np.array(scenario.spacecraft.inertia_kg_m2),
        wheels=_wheels(scenario),
        torques=tuple(torques),
        control=_control(scenario).law,
        target=target_of(scenario),
        compass=PERFECT if _control(scenario).magnetometer == "perfect" else magnetometer(scenario),
    )
    for effect, theta in _moving_effects(scenario):
        vehicle = effect.on(vehicle, theta)
    return vehicle


def _moving_effects(scenario: Scenario) -> list[tuple[DynamicsEffect, FloatArray]]:
    return [(effect, theta) for effect, theta in active_effects(scenario) if isinstance(effect, DynamicsEffect)]


def _wheels(scenario: Scenario) -> tuple[Wheel, ...]:
    section = scenario.wheels
    if section is None:
        return ()
    return tuple(
        Wheel(
            axis_B=axis,
            inertia_kg_m2=section.inertia_kg_m2,
            max_speed_rad_s=section.max_rpm / RPM_PER_RAD_S,
            max_torque_Nm=section.max_torque_Nm,
            viscous_Nm_s=section.viscous_Nm_s,
            coulomb_Nm=section.coulomb_Nm,
        )
        for axis in section.axes_B
    )


def target_of(scenario: Scenario) -> Target:
    """What the law of a scenario steers to."""
    section = _control(scenario)
    if section.target == "inertial":
        attitude = frames.rotation_from_q(np.array([section.q_NB]))[0]
    else:
        attitude = _from_O(section.yaw_deg, section.roll_deg, section.pitch_deg)
    return Target(section.target, attitude, section.axis)


def _from_O(yaw_deg: float, roll_deg: float, pitch_deg: float) -> Rotation:
    return frames.rotation_BO(*np.radians([[yaw_deg], [roll_deg], [pitch_deg]]))[0]


def _flight(scenario: Scenario, number: int, segment: SegmentSection) -> Flight:
    section, period_s = _dynamics(scenario), _control(scenario).period_s
    step_s = section.step_s
    every = _whole(period_s, step_s, "control.period_s")
    record = _whole(section.record_s or step_s, step_s, "dynamics.record_s")
    if scenario.torquers is not None and every % record:
        raise BadInput(
            f"{record * step_s:g} s", where="dynamics.record_s", wanted="control.period_s or a whole fraction of it"
        )
    spacing_s = max(1, round(section.surroundings_s / step_s)) * step_s
    if spacing_s > _MOST_SPACING_S:
        key = "surroundings_s" if step_s <= _MOST_SPACING_S else "step_s"
        raise BadInput(f"{spacing_s:g} s", where=f"dynamics.{key}", wanted=f"{_MOST_SPACING_S:g} s or less")
    begin = epoch.add_seconds(epoch.parse_time(segment.start_utc), -60.0 * section.settle_min)[0]
    length_s = 60.0 * section.settle_min + (segment.count - 1) * segment.step_s + _BEYOND_S
    length_s = np.ceil(length_s / (record * step_s)) * record * step_s
    vehicle = vehicle_of(scenario)
    around = _surroundings(scenario, vehicle.torques, begin, float(length_s), spacing_s)
    if length_s / (record * step_s) > _MOST_ROWS:
        raise BadInput(
            f"{length_s / (record * step_s):.3g} states to record in segment {number + 1}",
            where="dynamics",
            wanted=f"no more than {_MOST_ROWS:.0g}: a longer record_s",
        )
    ticks = epoch.add_seconds(begin, period_s * np.arange(np.floor(length_s / period_s) + 1.0))
    flight = fly(
        vehicle,
        around.environment,
        _start(scenario, around),
        duration_s=length_s,
        step_s=step_s,
        control_every=every,
        log_every=record,
        dipoles_B_Am2=None if vehicle.control else torquer_schedule(scenario).dipole_B_Am2(ticks),
        knowledge=_knowledge(scenario, number, ticks),
    )
    _check_step(flight, step_s)
    return flight


@dataclass(frozen=True)
class _Around:
    """What lies along an orbit from some moment on, and how the orbital frame stands and turns then."""

    environment: Environment
    R_ON: Rotation
    rate_O_rad_s: FloatArray


_around: OrderedDict[str, _Around] = OrderedDict()


def _surroundings(
    scenario: Scenario, torques: Sequence[Torque], begin: np.datetime64, length_s: float, spacing_s: float
) -> _Around:
    """The last ones are kept: many vehicles fly through the same."""
    with_sun, with_air = any(torque.needs_sun for torque in torques), any(torque.needs_air for torque in torques)
    key = repr((scenario.orbit, scenario.path_of("."), scenario.field, begin, length_s, spacing_s, with_sun, with_air))
    if key not in _around:
        along, first = partial(ephemeris, scenario), np.array([begin])
        environment = environment_along(
            along,
            begin,
            length_s,
            spacing_s=spacing_s,
            field=load_field(scenario.field.truth, degree=scenario.field.truth_degree),
            with_sun=with_sun,
            with_air=with_air,
        )
        _around[key] = _Around(environment, frames.rotation_ON(*along(first)), ephemeris_rate_O_rad_s(along, first)[0])
        while len(_around) > 1 and sum(len(one.environment.nodes) for one in _around.values()) > _KEPT_NODES:
            _around.popitem(last=False)
    _around.move_to_end(key)
    return _around[key]


def _check_step(flight: Flight, step_s: float) -> None:
    """BadInput where the body turns so fast that the step cannot follow, or the motion between rows is unknown."""
    fastest = float(np.sqrt(np.max(np.einsum("ij,ij->i", flight.rate_B_rad_s, flight.rate_B_rad_s))))
    if not np.isfinite(fastest):
        raise BadInput(
            "the motion ran away: a rate is no longer a number",
            where="dynamics.step_s",
            wanted="a shorter step, or a gentler control",
        )
    for key, long_s, most_rad in (("step_s", step_s, 0.3), ("record_s", flight.spacing_s, 1.0)):
        if not fastest * long_s < most_rad:
            raise BadInput(
                f"the body turns by {fastest * long_s:.2g} rad in {long_s:g} s",
                where=f"dynamics.{key}",
                wanted=f"under {most_rad:g} rad: {0.1 * most_rad / fastest:.1g} s would be safe (or a gentler control)",
            )


def _dynamics(scenario: Scenario) -> DynamicsSection:
    return scenario.dynamics or DynamicsSection()


def _control(scenario: Scenario) -> ControlSection:
    return scenario.control or ControlSection()


def _whole(long_s: float, step_s: float, key: str) -> int:
    count = round(long_s / step_s)
    if count < 1 or abs(count * step_s - long_s) > 1e-9 * long_s:
        raise BadInput(f"{long_s:g} s", where=key, wanted=f"a whole number of steps of {step_s:g} s")
    return count


def _start(scenario: Scenario, around: _Around) -> Start:
    section = _dynamics(scenario)
    rate = np.radians(section.rate_deg_s)
    if section.start_frame == "orbital":
        R_BO = _from_O(section.yaw_deg, section.roll_deg, section.pitch_deg)
        rate = rate + R_BO.apply(around.rate_O_rad_s)
        q = frames.q_from_rotation(R_BO * around.R_ON)[0]
    else:
        q = np.array(section.q_NB)
    speeds_rpm = () if scenario.wheels is None else scenario.wheels.bias_rpm
    return Start(q, rate, np.array(speeds_rpm, dtype=np.float64) / RPM_PER_RAD_S)


def _knowledge(scenario: Scenario, number: int, ticks: TimeArray) -> FloatArray | None:
    section = _control(scenario)
    sigma, noise_nT = float(np.radians(section.attitude_sigma_deg)), 0.0
    if section.magnetometer == "instrument":
        noise_nT = scenario.magnetometer.white_nT
    if section.law is None or (sigma == 0.0 and noise_nT == 0.0):
        return None
    errors = np.empty((ticks.size, 6))
    rng = stream(scenario.seed, f"control.attitude.{number}")
    errors[:, :3] = gauss_markov(ticks, sigma, section.attitude_tau_s, rng, columns=3)
    noise = stream(scenario.seed, f"control.magnetometer.{number}").standard_normal((ticks.size, 3))
    np.multiply(1e-9 * noise_nT, noise, out=errors[:, 3:])
    return errors
