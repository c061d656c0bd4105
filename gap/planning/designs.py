"""Manoeuvres that a spacecraft may fly, each a whole scenario: what `simulate` flies is what the power is computed of.

`[limits]` says what is allowed; what it does not say has a default.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from fluxtwin.gap.held_out.targets import INERTIA_KG_M2
from fluxtwin.sim.base.section_types import Direction, NonNegative, Positive, Section, as_tuple
from fluxtwin.sim.base.toml_input import Strict
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.scenario.scenario import Scenario

Kind = Literal["nadir", "yaw_slews", "slews", "tumble", "spin", "inertial_hold"]
_MOST_TURN_DEG = 30.0
"""Of the body between two rows: half of what a motion between recorded attitudes can be made of without a gyro."""
_PEAK = 1.875
"""Fastest rate of a rest-to-rest slew over its mean rate: 15 / 8, of its polynomial of fifth order."""
_LEG_DEG = 90.0
_TILT_DEG = 80.0
"""Of roll and pitch at the most: at a right angle the angles of the papers lose one."""
_NUTATION_DEG = 10.0
_LOAD_SHARE = 0.25
_PERIODS_S = (10.0, 3600.0)


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
    pulse_s: Annotated[float, Field(ge=_PERIODS_S[0], le=_PERIODS_S[1])] = 120.0
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
    rate = min(limits.max_rate_deg_s, _MOST_TURN_DEG / step_s)
    free = limits.max_off_nadir_deg >= 180.0
    as_flown = base.attitude if base.attitude.mode == "earth_pointing" else None
    for kind in limits.attitudes:
        if kind == "nadir":
            kept = {} if as_flown is None else as_flown.model_dump(exclude_defaults=True, exclude={"reference"})
            yield kind, "nadir pointing", kept
        elif kind == "yaw_slews":
            yield kind, f"yaw slews at up to {rate:.2g} deg/s", _slews([(90.0, 0.0, 0.0)] * 4, rate, hours)
        elif kind == "slews":
            tilt = min(limits.max_off_nadir_deg, _TILT_DEG)
            if tilt > 0:
                legs = [(90.0, 0.0, 0.0), (0.0, tilt, 0.0), (0.0, -tilt, 0.0), (0.0, 0.0, tilt), (0.0, 0.0, -tilt)]
                yield kind, f"slews about three axes at up to {rate:.2g} deg/s", _slews(legs, rate, hours)
        elif kind == "tumble" and free:
            turn = rate * np.array([0.8, 0.36, 0.48])  # a unit vector of three unlike components
            yield kind, f"tumble of {rate:.2g} deg/s", {"mode": "tumble", "rate_deg_s": turn.tolist()}
        elif kind == "spin" and free:
            spun = {"mode": "spin", "spin_rate_rpm": rate / 6.0, "nutation_deg": _NUTATION_DEG}
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
    duration_s = _LEG_DEG / rate_deg_s * _PEAK
    count = int(np.ceil(3600.0 * hours / duration_s)) + 1
    points, turned = [], 0.0
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
            load_A = base.power.switched_load_A or _LOAD_SHARE * base.power.full_sun_current_A
            changes = {"power.switched_load_A": load_A, "power.switched_every_s": limits.pulse_s}
        for name, section in base.drivers.items():
            if section.high is not None and section.high != (section.low or 0.0):
                between = {"high": section.high, "low": section.low or 0.0, "unit": section.unit}
                changes[f"drivers.{name}"] = {"pattern": "random", "duty": 0.5, "dwell_s": limits.pulse_s, **between}
        if changes:
            yield "loads on and off", changes
