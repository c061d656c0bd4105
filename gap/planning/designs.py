"""Manoeuvres that a spacecraft may fly, each a whole scenario: what `simulate` flies is what the power is computed of.

`[limits]` says what is allowed; what it does not say has a default. Without a scenario of the user's own, which is better,
one is made of the record: its orbit, noise, calibration and housekeeping, and something usual for what it does not say.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from fluxtwin.gap.held_out.transfer import INERTIA_KG_M2
from fluxtwin.gap.problem.problem import Problem, corrected
from fluxtwin.gap.records.diagnosis import Closure
from fluxtwin.sim.base.section_types import Direction, NonNegative, Positive, Section, as_tuple
from fluxtwin.sim.base.toml_input import Strict
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2
from fluxtwin.sim.earth.orbit import argument_of_latitude, orbital_rates
from fluxtwin.sim.scenario.scenario import Scenario

Kind = Literal["nadir", "yaw_slews", "slews", "tumble", "spin", "inertial_hold"]


def base_tree(closure: Closure, lsb_nT: float | None, field: str) -> dict[str, Any]:
    """The tables of a scenario, as TOML has them; [schedule] is the record's own span."""
    problem, noise = closure.problem, closure.whitener.noise
    time, r, v = problem.time, *problem.setting.given[:2]
    instrument = corrected(problem.setting.instrument, closure.modelled)
    step = lsb_nT or 0.0
    white = float(np.sqrt(max(float(np.mean(noise.white_nT**2)) - step**2 / 12.0, 0.0)))
    S, b_nT = np.asarray(instrument.S).tolist(), np.asarray(instrument.b_nT).tolist()
    magnetometer: dict[str, Any] = {"S": S, "b_nT": b_nT, "noise_nT": white, "lsb_nT": step}
    tree: dict[str, Any] = {
        "name": "plan",
        "seed": 1,
        "spacecraft": {"name": problem.telemetry.spacecraft or "the spacecraft of the record"},
        "field": {"truth": field, "model": field},
        "orbit": _orbit(time, r, v),
        "attitude": {"reference": {"sigma_deg": float(np.degrees(noise.theta_rad)), "tau_s": float(noise.tau_s)}},
        "magnetometer": magnetometer,
    }
    span_min = float((time[-1] - time[0]) / np.timedelta64(1, "s")) / 60.0
    step_s = float(np.median(np.diff(problem.setting.seconds)))
    start = epoch.iso(time[0], "ms")
    tree["schedule"] = {"segments": [{"start_utc": start, "duration_min": span_min, "step_s": step_s}]}
    columns = problem.setting.columns
    dipole = columns.get("dipole_B_Am2")
    if dipole is not None and np.nanmax(np.abs(dipole)) > 0:
        # Anywhere: only the coupling matters, which is given.
        far_m = [[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [2.0, 0.0, 0.0]]
        tree["torquers"] = {"dipole_Am2": float(np.nanmax(np.abs(dipole))), "positions_m": far_m}
        coupling = np.zeros((3, 3)) if instrument.T_nT_per_Am2 is None else np.asarray(instrument.T_nT_per_Am2)
        magnetometer["T_nT_per_Am2"] = coupling.tolist()
    return tree | _housekeeping(problem) | _drivers(problem)


def _orbit(time: TimeArray, r_N_km: FloatArray, v_N_km_s: FloatArray) -> dict[str, Any]:
    """Through the last row, with the mean motion of the record: good to some tens of km, which is nothing to a plan. Of a
    short arc with that of its energy, good to half a percent."""
    last = slice(-1, None)
    T = frames.rotation_TN(time[last])
    r, v = T.apply(r_N_km[last])[0], T.apply(v_N_km_s[last])[0]
    normal = np.cross(r, v)
    node = float(np.arctan2(normal[0], -normal[1]))
    tilt = float(np.arccos(np.clip(normal[2] / np.linalg.norm(normal), -1.0, 1.0)))
    shape = np.cross(v, normal) / GM_EARTH_KM3_S2 - r / np.linalg.norm(r)
    e = float(np.linalg.norm(shape))
    axis_km = float(np.median(1.0 / (2.0 / np.linalg.norm(r_N_km, axis=1) - (v_N_km_s**2).sum(1) / GM_EARTH_KM3_S2)))
    found = {"epoch_utc": epoch.iso(time[-1], "ms"), "inclination_deg": float(np.degrees(tilt))}
    latitude = argument_of_latitude(time, r_N_km, v_N_km_s)
    if e > 0.01:  # the Earth's oblateness alone makes a tenth of that of a circle
        along = np.array([np.cos(node), np.sin(node), 0.0])
        across = np.cross(normal / np.linalg.norm(normal), along)
        perigee = float(np.arctan2(shape @ across, shape @ along))
        E = 2.0 * np.arctan(np.tan(0.5 * (latitude - perigee)) * np.sqrt((1.0 - e) / (1.0 + e)))
        latitude = perigee + E - e * np.sin(E)
        found |= {"eccentricity": e, "argument_of_perigee_deg": float(np.degrees(perigee))}
    latitude = np.unwrap(latitude)
    if np.ptp(latitude) > 1.0 and np.diff(latitude).max() < np.pi / 2:
        seconds = epoch.seconds_since(time, time[0])
        for _ in range(3):  # the rates change little with the axis: a digit or two more each time
            rates = orbital_rates(axis_km, e, tilt)
            known = rates.mean_anomaly_rad_s + rates.argument_of_perigee_rad_s
            seen = float(np.polyfit(seconds, latitude, 1)[0])
            if not 0.5 < seen / known < 2.0:  # arcs far apart, between which nobody counted the orbits
                break
            axis_km *= (known / seen) ** (2.0 / 3.0)
    u = float(latitude[-1])
    angles = {"raan_deg": float(np.degrees(node)) % 360.0, "argument_of_latitude_deg": float(np.degrees(u)) % 360.0}
    return found | angles | {"altitude_km": axis_km - EARTH_RADIUS_KM}


def _housekeeping(problem: Problem) -> dict[str, Any]:
    columns, found = problem.setting.columns, {}
    array, battery = columns.get("array_current_A"), columns.get("battery_current_A")
    if array is not None and np.nanmax(array) > 0:
        load = 0.0 if battery is None else float(np.clip(np.nanmedian(array - battery), 0.0, None))
        found["power"] = {"full_sun_current_A": float(np.nanmax(array)), "load_A": load}
    temperature = columns.get("temperature_degC")
    if temperature is not None and np.isfinite(temperature).any():
        low, high = (float(value) for value in np.nanpercentile(temperature, (2.0, 98.0)))
        sunlit = max(high, low + 1.0)
        found["thermal"] = {"sunlit_degC": sunlit, "eclipse_degC": low, "time_constant_min": 20.0}
    return found


def _drivers(problem: Problem) -> dict[str, Any]:
    found = {}
    for name, column in problem.telemetry.drivers.items():
        low, high = float(np.nanmin(column)), float(np.nanmax(column))
        if high > low:
            found[name] = {"pattern": "random", "high": high, "low": low, "duty": 0.5, "dwell_s": 600.0}
    return {"drivers": found} if found else {}


class LimitsSection(Section):
    """What may be flown, and for how long."""

    hours: Positive | None = None
    """Longest flight; absent: two orbits."""
    attitudes: Annotated[tuple[Kind, ...], BeforeValidator(as_tuple), Field(min_length=1)] = Kind.__args__  # type: ignore[attr-defined]
    max_rate_deg_s: Positive = 0.5
    max_off_nadir_deg: Annotated[float, Field(ge=0, le=180)] = 180.0
    """Of body z; below 180 there is no tumble, no spin and no inertial hold."""
    torquer_test: bool = True
    """Pulses of all torquers, each axis by itself."""
    load_test: bool = True
    """Recorded drivers on and off, and a load of a quarter of the array's current."""
    pulse_s: Annotated[float, Field(ge=10.0, le=3600.0)] = 120.0
    """How long a torquer or a load keeps its state."""
    wait_days: Annotated[tuple[NonNegative, ...], BeforeValidator(as_tuple)] = (90.0,)
    """Other seasons that may be waited for."""
    step_s: Positive | None = None
    """Between two rows; absent: as recorded."""
    keep_from_sun_B: Direction | None = None
    """A body axis that must not point at the sun ..."""
    keep_from_sun_deg: Annotated[float, Field(ge=0, lt=90)] = 30.0
    """... to within so much, in sunlight."""


class LimitsFile(Strict):
    """A file with `[limits]`."""

    file_kind: ClassVar[str] = "a file of limits"
    example: ClassVar[str] = "[limits]\nhours = 3.0"
    limits: LimitsSection = LimitsSection()


@dataclass(frozen=True, eq=False)
class Design:
    """One manoeuvre."""

    words: str
    kind: Kind
    scenario: Scenario
    wait_days: float
    tests: bool
    """Whether torquers or loads are worked for it."""

    @property
    def step_h(self) -> float:
        """Hours between two rows."""
        assert self.scenario.schedule is not None
        return self.scenario.schedule.segments[0].step_s / 3600.0


def designs(base: Scenario, limits: LimitsSection, hours: float, step_s: float, start: np.datetime64) -> list[Design]:
    """All manoeuvres within the limits, `hours` long, rows `step_s` apart, from `start`; the simplest first."""
    found = []
    tests = dict(_tests(base, limits))
    for kind, words, attitude in _attitudes(base, limits, hours, step_s):
        flown = _prescribed(base, kind, attitude, hours, step_s, start)
        found.append(Design(words, kind, flown, 0.0, False))
        if tests:
            worked = flown.updated({key: value for changes in tests.values() for key, value in changes.items()})
            found.append(Design(f"{words}, {' and '.join(tests)}", kind, worked, 0.0, True))
        for days in limits.wait_days if kind == "nadir" else ():
            later = _prescribed(base, kind, attitude, hours, step_s, epoch.add_seconds(start, 86400.0 * days)[0])
            found.append(Design(f"{words}, {days:g} days later", kind, later, days, False))
    return found


def _attitudes(
    base: Scenario, limits: LimitsSection, hours: float, step_s: float
) -> Iterator[tuple[Kind, str, Mapping[str, Any]]]:
    # Between two rows half of what a motion between recorded attitudes can be made of without a gyro.
    rate = min(limits.max_rate_deg_s, 30.0 / step_s)
    free = limits.max_off_nadir_deg >= 180.0
    as_flown = base.attitude if base.attitude.mode == "earth_pointing" else None
    for kind in limits.attitudes:
        if kind == "nadir":
            kept = {} if as_flown is None else as_flown.model_dump(exclude_defaults=True, exclude={"reference"})
            yield kind, "nadir pointing", kept
        elif kind == "yaw_slews":
            yield kind, f"yaw slews at up to {rate:.2g} deg/s", _slews([(90.0, 0.0, 0.0)] * 4, rate, hours)
        elif kind == "slews":
            tilt = min(limits.max_off_nadir_deg, 80.0)  # at a right angle the angles of the papers lose one
            if tilt > 0:
                legs = [(90.0, 0.0, 0.0), (0.0, tilt, 0.0), (0.0, -tilt, 0.0), (0.0, 0.0, tilt), (0.0, 0.0, -tilt)]
                yield kind, f"slews about three axes at up to {rate:.2g} deg/s", _slews(legs, rate, hours)
        elif kind == "tumble" and free:
            turn = rate * np.array([0.8, 0.36, 0.48])  # a unit vector of three unlike components
            yield kind, f"tumble of {rate:.2g} deg/s", {"mode": "tumble", "rate_deg_s": turn.tolist()}
        elif kind == "spin" and free:
            spun = {"mode": "spin", "spin_rate_rpm": rate / 6.0, "nutation_deg": 10.0}
            yield kind, f"spin of {rate:.2g} deg/s", spun
        elif kind == "inertial_hold" and free:
            yield kind, "inertial hold", {"mode": "inertial_hold"}


def _slews(legs: list[tuple[float, float, float]], rate_deg_s: float, hours: float) -> dict[str, Any]:
    """Through yaw in quarters (legs of yaw alone add up), to and from each tilt, without rest."""
    places, yaw = [(0.0, 0.0, 0.0)], 0.0
    for leg in legs:
        if leg[0]:
            yaw = (yaw + leg[0]) % 360.0
            places.append((yaw, 0.0, 0.0))
        else:
            places += [(yaw, leg[1], leg[2]), (yaw, 0.0, 0.0)]
    duration_s = 90.0 / rate_deg_s * 1.875  # 15 / 8: the fastest rate of its polynomial of fifth order over the mean
    count = int(np.ceil(3600.0 * hours / duration_s)) + 1
    points = []
    for number in range(max(count, 2)):
        round_, place = divmod(number, len(places) - 1)
        y, r, p = places[place]
        turned = round_ * places[-1][0] + y
        points.append({"after_s": number * duration_s, "yaw_deg": turned % 360.0, "roll_deg": r, "pitch_deg": p})
    return {"mode": "slews", "waypoints": points}


def _prescribed(
    base: Scenario, kind: Kind, attitude: Mapping[str, Any], hours: float, step_s: float, start: np.datetime64
) -> Scenario:
    reference = base.attitude.reference.model_dump(exclude_defaults=True)
    segment = {"start_utc": epoch.iso(start, "ms"), "duration_min": 60.0 * hours, "step_s": step_s}
    changes: dict[str, Any] = {
        "attitude": {**attitude, "reference": reference},
        "schedule": {"segments": [segment]},
        **dict.fromkeys(("dynamics", "torques", "control", "sampling", "closure", "slit_sun_sensor"), None),
    }
    if kind in ("tumble", "spin") and base.spacecraft.inertia_kg_m2 is None:
        changes["spacecraft.inertia_kg_m2"] = np.diag(INERTIA_KG_M2).tolist()
    if base.torquers is not None and base.torquers.activity == "control":
        changes["torquers.activity"] = "random"
    return base.updated(changes)


def _tests(base: Scenario, limits: LimitsSection) -> Iterator[tuple[str, dict[str, Any]]]:
    """By words: changes of the scenario."""
    if base.torquers is not None and limits.torquer_test:
        pulses = {"activity": "random", "duty": 0.5, "dwell_s": limits.pulse_s}
        yield f"torquers pulsed every {limits.pulse_s:g} s", {f"torquers.{key}": v for key, v in pulses.items()}
    if limits.load_test and (base.drivers or base.power is not None):
        changes: dict[str, Any] = {}
        if base.power is not None:
            load_A = base.power.switched_load_A or 0.25 * base.power.full_sun_current_A
            changes = {"power.switched_load_A": load_A, "power.switched_every_s": limits.pulse_s}
        for name, section in base.drivers.items():
            if section.high is not None and section.high != (section.low or 0.0):
                between = {"high": section.high, "low": section.low or 0.0, "unit": section.unit}
                changes[f"drivers.{name}"] = {"pattern": "random", "duty": 0.5, "dwell_s": limits.pulse_s, **between}
        if changes:
            yield "loads on and off", changes
