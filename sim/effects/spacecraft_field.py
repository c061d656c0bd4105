"""The spacecraft's own field at the magnetometer: torquers, currents, wheels, eddy currents."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.late import bridged, lateness_near, lateness_tried, restarts, varies
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.base import MATRIX, Parameter, SpacecraftField, held, known_column, mapped, vector_parameters
from fluxtwin.sim.effects.drivers import (
    TIME_CONSTANTS_S,
    BatteryKind,
    Face,
    PanelKind,
    array_current_A,
    battery_column_A,
    battery_current_A,
    face,
    faces_beside,
    followed,
    lit,
    panels_that_show,
    sun_in_body,
    tapered_A,
)
from fluxtwin.sim.effects.signal import Setting, Signal

_PREFIX = "driver_"
_PANELS = {
    "zenith": "panel on -z",
    "tracking": "array that turns about y",
    "constant": "array that always faces the sun",
}


def _in_words(panel: PanelKind | Face) -> str:
    if isinstance(panel, tuple):
        return f"panel that faces ({', '.join(f'{one:.2f}' for one in panel)}) in body axes"
    return _PANELS[panel]


TYPICAL_NT = 100.0
"""A usual field of whatever a column records."""


@dataclass(frozen=True)
class TorquerCoupling(SpacecraftField):
    """Field of the torquers at the sensor."""

    name = "torquer_coupling"
    follows = "torquer"
    settled_by = "firing each torquer alone, on and off at full dipole, with the dipole in the telemetry"
    about = "the field is C m of their dipole m (T = -C of Lerner & Shuster 1981, eq. 1; Seasat 1.7 nT/(A m2) at 6 m)"
    parameters = vector_parameters("C", "nT/(A m2)", 2.0, axes=MATRIX)

    def values(self, setting: Setting) -> FloatArray | None:
        return known_column(setting, "dipole_B_Am2")

    def untestable(self, setting: Setting) -> str | None:
        dipole = self.values(setting)
        if dipole is None:
            return "the telemetry has no torquer dipole"
        return None if (dipole != 0.0).any() else "the torquers never fired"


@dataclass(frozen=True)
class SolarArrayCurrent(SpacecraftField):
    """Field in proportion to the array's current.

    Without the column `array_current_A` the current is that of an array of 1 A in full sun, so the parameter
    is the field in full sun: `panel` says whether it sits on the -z face (zenith), tracks about the y axis, or
    gives a constant current in sunlight, or is the outward normal of a fixed panel. Where the battery's current was
    recorded, the array's may be that and a constant load (balance).
    """

    name = "solar_array_current"
    follows = "current"
    settled_by = "steps of the load, or panels turned away from the sun, with the current in the telemetry"
    about = (
        "current of the solar array; the field is positive along the axis. Where no current was recorded, s is the field in "
        "full sun [nT], on the panel that is assumed (RAX: Springmann & Cutler 2012, doi 10.2514/1.56726; CryoSat-2: Olsen "
        "et al. 2020)"
    )
    panel: PanelKind | Face = "zenith"

    parameters = vector_parameters("s", "nT/A", 20.0)

    def alternatives(self, setting: Setting) -> tuple[SolarArrayCurrent, ...]:
        if known_column(setting, "array_current_A") is not None:
            return (self,)
        choices = tuple(SolarArrayCurrent(kind) for kind in panels_that_show(setting))
        balance = SolarArrayCurrent("balance")
        if known_column(setting, "battery_current_A") is not None and varies(balance.values(setting)):
            choices += (balance,)
        return choices or (self,)

    def variants(self, setting: Setting) -> tuple[SolarArrayCurrent, ...]:
        return tuple(map(SolarArrayCurrent, faces_beside(self.panel))) if isinstance(self.panel, tuple) else ()

    def suggested(self, setting: Setting, theta: FloatArray) -> tuple[SpacecraftField, ...]:
        battery = BatteryCurrent(self.panel) if isinstance(self.panel, tuple) else None
        return (battery,) if battery is not None and battery.stands_in(setting) else ()

    def condition_on(self, setting: Setting) -> str | None:
        recorded = self.panel == "balance" or setting.column("array_current_A") is not None
        return self.follows if recorded else "sunlit"

    def values(self, setting: Setting) -> FloatArray:
        return array_current_A(setting, self.panel)

    def stands_in(self, setting: Setting) -> str:
        if self.panel == "balance" or known_column(setting, "array_current_A") is not None:
            return ""
        return f"in full sun on an assumed {_in_words(self.panel)}, as no current was recorded"

    def untestable(self, setting: Setting) -> str | None:
        values = self.values(setting)
        if varies(values):
            return None
        if known_column(setting, "array_current_A") is not None:
            return "the solar array's current never changes: its field is a bias"
        if not values.any():
            return "no array current was recorded, and the panel that is assumed never sees the sun"
        return "no array current was recorded, and neither sunlight nor the sun's incidence changes"


@dataclass(frozen=True)
class StrayField(SpacecraftField):
    """Field that follows the direction of the sun.

    F s while sunlit, s the unit vector to the sun in body axes: what currents in loops behind the lit faces make, to first
    harmonics of the sun's direction.
    """

    name = "stray_field"
    follows = "sunlit"
    settled_by = "a slow tumble of 0.25 deg/s in sunlight, with the currents of the panels in the telemetry"
    about = (
        "field F s at the sensor while sunlit, s the unit vector to the sun in body axes: the currents of panels on "
        "several faces (RAX: Springmann & Cutler 2012, doi 10.2514/1.56726, hundreds of nT)"
    )
    parameters = vector_parameters("F", "nT", 100.0, axes=MATRIX)

    def values(self, setting: Setting) -> FloatArray:
        """(N, 3) unit vectors to the sun, zero in the shadow and where they are not known."""
        direction, known = sun_in_body(setting)
        return np.where(known[:, None], direction * lit(setting)[:, None], 0.0)

    def suggested(self, setting: Setting, theta: FloatArray) -> tuple[SpacecraftField, ...]:
        """One panel on the face, of two that are opposite, whose incidence the field follows best."""
        if known_column(setting, "array_current_A") is not None:
            return ()
        normal = np.linalg.svd(theta.reshape(3, 3))[2][0]
        return SolarArrayCurrent(face(normal)), SolarArrayCurrent(face(-normal))

    def untestable(self, setting: Setting) -> str | None:
        return None if self.values(setting).any() else "the sun is never seen, or its direction in the body never known"


@dataclass(frozen=True)
class BatteryCurrent(SpacecraftField):
    """Field in proportion to the battery's current.

    Without the column `battery_current_A` the current is that of the array less a constant load, or, where that is not
    recorded either, that of an array of 2 A in full sun less a load of 1 A: `panel` says how its current follows the sun, as
    in `solar_array_current`. A `panel` that is "tapered" stands for a battery that limits its charging current itself: 1 A
    at sunrise, falling with the time constant `taper_s` to the share `trickle`, and the charge given back in the shadow.
    """

    name = "battery_current"
    follows = "current"
    settled_by = "steps of the load, or the taper at the end of charge, with the current in the telemetry"
    about = (
        "the current is positive when charging, the field positive along the axis. Where no current was recorded, s is the "
        "field in full sun [nT], on the panel that is assumed, and -s that in shadow (CryoSat-2: Olsen et al. 2020, doi "
        "10.1186/s40623-020-01171-9)"
    )
    panel: BatteryKind | Face = "constant"
    taper_s: float | None = None
    trickle: float | None = None
    """Share of the current at sunrise, 0 to 1."""

    parameters = vector_parameters("s", "nT/A", 20.0)

    def alternatives(self, setting: Setting) -> tuple[BatteryCurrent, ...]:
        if known_column(setting, "battery_current_A") is not None:
            return (self,)
        like_the_array = panels_that_show(setting) if self.stands_in(setting) else (self.panel,)
        kinds = tuple(BatteryCurrent(kind) for kind in like_the_array)
        tapers = tuple(BatteryCurrent("tapered", tau_s, 0.0) for tau_s in TIME_CONSTANTS_S[1:])
        return (*kinds, *(one for one in tapers if varies(one.values(setting)))) or (self,)

    def between(self, setting: Setting, ratio: float) -> BatteryCurrent | None:
        return None if self.taper_s is None else replace(self, taper_s=ratio * self.taper_s)

    def variants(self, setting: Setting) -> tuple[BatteryCurrent, ...]:
        """Other shares of the charging current that stay, to a twentieth."""
        if self.trickle is None:
            return ()
        moves = [round(self.trickle + step, 2) for step in (0.2, -0.2, 0.1, -0.1, 0.05, -0.05)]
        return tuple(replace(self, trickle=share) for share in moves if 0.0 <= share < 1.0)

    def condition_on(self, setting: Setting) -> str | None:
        return "sunlit" if battery_column_A(setting, self.panel) is None else self.follows

    def values(self, setting: Setting) -> FloatArray:
        if self.panel != "tapered":
            return battery_current_A(setting, self.panel)
        recorded = battery_column_A(setting, self.panel)
        if recorded is not None:
            return recorded
        taper_s, trickle = self.taper_s or 0.0, self.trickle or 0.0
        if taper_s <= 0.0 or not 0.0 <= trickle <= 1.0:
            given = f"taper_s {taper_s:g} and trickle {trickle:g} of a tapered current"
            raise BadInput(given, where=self.name, wanted="taper_s above 0 s and trickle from 0 to 1")
        return tapered_A(setting, taper_s, trickle)

    def stands_in(self, setting: Setting) -> str:
        if battery_column_A(setting, self.panel) is not None:
            return ""
        if self.panel == "tapered":
            return "at sunrise on an assumed charging current that tapers, as that of the battery was not recorded"
        return (
            f"in full sun on an assumed {_in_words(self.panel)}, and the opposite in shadow, as no current was recorded"
        )

    def untestable(self, setting: Setting) -> str | None:
        if varies(self.values(setting)):
            return None
        if self.condition_on(setting) == "sunlit":
            return "no current was recorded, and the sunlight never changes"
        return "the battery neither charges and discharges in turn, nor changes its current: its field is a bias"


@dataclass(frozen=True)
class Driver(SpacecraftField):
    """Field in proportion to a recorded column.

    Field in body axes in proportion to the column `driver_NAME`, of whatever unit: k times its value `delay_s` before,
    behind a first-order lag `lag_s`.
    """

    name = "driver"
    follows = "driver"
    by_definition = True
    keyed_by = "column"
    settled_by = "switching what it records on and off, in several attitudes"
    about = (
        "late or smoothed where its settings say so, positive along the axis (current loops: RAX, "
        "Springmann & Cutler 2012, doi 10.2514/1.56726; Swarm-Echo, Broadfoot et al. 2022, doi 10.5194/gi-11-323-2022)"
    )
    column: str = ""
    """NAME of the column `driver_NAME`, or of another column with one number a row."""
    delay_s: float = 0.0
    lag_s: float = 0.0
    typical_nT_per_unit: float = field(default=20.0, compare=False)
    """What is taken for a usual size of k: no column says what its unit is worth."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return vector_parameters("k", "nT/unit", self.typical_nT_per_unit)

    def instances(self, setting: Setting) -> tuple[Driver, ...]:
        """One for each column, of which `TYPICAL_NT` is a usual field."""
        if self.column:
            return (self,)
        names = sorted(name.removeprefix(_PREFIX) for name in setting.columns if name.startswith(_PREFIX))
        found = []
        for name in names:
            one = replace(self, column=name)
            values = one.values(setting)
            swing = 0.0 if values is None else float(np.ptp(values))
            found.append(replace(one, typical_nT_per_unit=TYPICAL_NT / swing) if swing > 0.0 else one)
        return tuple(found) or (self,)

    def values(self, setting: Setting, later_s: float | FloatArray = 0.0) -> FloatArray | None:
        """(N,) what the field follows, `later_s` after the stamps; None when nothing tells."""
        return followed(setting, self._recorded(setting), self.delay_s - later_s, self.lag_s)

    def invented(self, setting: Setting) -> BoolArray:
        column = setting.column(self._recorded(setting))
        none = super().invented(setting)
        return none if column is None else bridged(setting.seconds, column, self.delay_s, self.lag_s)

    def _recorded(self, setting: Setting) -> str:
        """The column `driver_NAME`; where there is none, the one that is called NAME."""
        other = setting.column(self.column)
        own = _PREFIX + self.column in setting.columns or other is None or other.ndim > 1
        return _PREFIX + self.column if own else self.column

    def alternatives(self, setting: Setting) -> tuple[Driver, ...]:
        if self.delay_s or self.lag_s:
            return (self,)
        return tuple(replace(self, delay_s=delay, lag_s=lag) for delay, lag in lateness_tried(setting.seconds))

    def between(self, setting: Setting, ratio: float) -> Driver | None:
        if not (self.delay_s or self.lag_s):
            return None
        return replace(self, delay_s=ratio * self.delay_s, lag_s=ratio * self.lag_s)

    def variants(self, setting: Setting) -> tuple[Driver, ...]:
        """As late in all, with other shares of delay and lag."""
        return tuple(replace(self, delay_s=delay, lag_s=lag) for delay, lag in lateness_near(self.delay_s, self.lag_s))

    def condition_on(self, setting: Setting) -> str | None:
        return f"{self.follows}:{self.column}"

    def untestable(self, setting: Setting) -> str | None:
        values = self.values(setting)
        if values is None:
            return f"the telemetry has no {_PREFIX}{self.column or 'NAME'}"
        swing, size = float(np.ptp(values)), float(np.abs(values).max())
        return None if swing > 1e-6 * size else f"{_PREFIX}{self.column} never changes: its field is a bias"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        values = self.values(signal.setting, signal.sample_offset_s)
        return signal if values is None else signal.with_stray(values[:, None] * theta)


@dataclass(frozen=True)
class WheelField(SpacecraftField):
    """Field of a dipole that rotates with a wheel.

    The phase is the integral of the recorded speed of wheel number `wheel` (linear between stamps, smooth over gaps), or,
    where `frequency_Hz` is given, of that constant frequency; the sampling aliases both. A speed known to d rpm holds
    the phase for about 60 / (2 pi d) seconds only.
    """

    name = "wheel_field"
    settled_by = "the wheel speed in the telemetry, or a few speeds held in turn"
    about = "the field is a cos(phase) + b sin(phase), aliased by the sampling (dipole law: Jackson, section 5.6)"
    wheel: int = 1
    """Number of the wheel, from 1."""
    frequency_Hz: float | None = None
    """Constant frequency; None: the recorded speed."""

    parameters = vector_parameters("cos", "nT", 50.0) + vector_parameters("sin", "nT", 50.0)
    bound = "the phase is counted from the first sample of this record: only the amplitude is carried over"

    def phase_rad(self, setting: Setting, offset_s: float | FloatArray = 0.0) -> FloatArray | None:
        """(N,) phase since the first stamp, `offset_s` after each stamp; None when nothing tells."""
        if self.frequency_Hz is not None:
            return np.asarray(2.0 * np.pi * self.frequency_Hz * (setting.seconds + offset_s))
        rate = self._rate_rad_s(setting)
        if rate is None:
            return None
        turned = 0.5 * (rate[1:] + rate[:-1]) * np.diff(setting.seconds)
        # Over five minutes a straight line misses a turn or two of a wheel that takes up the torques of an orbit.
        for row in np.flatnonzero(restarts(setting.seconds)[1:]).tolist():
            turned[row] = _turned_over_gap(setting.seconds, rate, row)
        return np.concatenate([[0.0], np.cumsum(turned)]) + rate * offset_s

    def _rate_rad_s(self, setting: Setting) -> FloatArray | None:
        speeds = setting.column("wheel_speed_rpm")
        if speeds is None:
            return None
        columns = speeds[:, None] if speeds.ndim == 1 else speeds
        if not 1 <= self.wheel <= columns.shape[1]:
            return None
        one = held(columns[:, self.wheel - 1])
        return None if one is None else one * (2.0 * np.pi / 60.0)

    def alternatives(self, setting: Setting) -> tuple[WheelField, ...]:
        speeds = setting.column("wheel_speed_rpm")
        if self.frequency_Hz is not None or speeds is None:
            return (self,)
        wheels = 1 if speeds.ndim == 1 else speeds.shape[1]
        choices = tuple(WheelField(number) for number in range(1, wheels + 1))
        return tuple(choice for choice in choices if choice.untestable(setting) is None) or (self,)

    def untestable(self, setting: Setting) -> str | None:
        phase = self.phase_rad(setting)
        if phase is None:
            return "the telemetry has no wheel speed; only a line in the residual can show it"
        return None if varies(phase) else "the wheel never turns"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        phase = self.phase_rad(signal.setting, signal.sample_offset_s)
        if phase is None:
            return signal
        return signal.with_stray(np.cos(phase)[:, None] * theta[:3] + np.sin(phase)[:, None] * theta[3:])


def _turned_over_gap(seconds: FloatArray, rate: FloatArray, row: int) -> float:
    """The integral of a rate over the gap after a row, by the cubic nearest to the rows within a gap's length of it."""
    begin, end = seconds[row], seconds[row + 1]
    first, last = np.searchsorted(seconds, [2.0 * begin - end, 2.0 * end - begin])
    near = slice(int(first), int(last))
    course = np.polynomial.Polynomial.fit(seconds[near], rate[near], min(3, int(last - first) - 1)).integ()
    return float(course(end) - course(begin))


@dataclass(frozen=True)
class EddyCurrent(SpacecraftField):
    """Field of currents that a changing field induces.

    Good while the currents decay much faster than the field changes. The part of K that is a multiple of the
    identity is left out: it is a time tag (-K dB/dt is a delay by K).
    """

    name = "eddy_current"
    follows = "rate"
    settled_by = "a spin of 2 rpm"
    about = (
        "field -K dB/dt of the dipole that a changing field induces in a conductor, K_zz = -K_xx - K_yy "
        "(Landau & Lifshitz, Electrodynamics of Continuous Media, section 59)"
    )

    # At most that of a solid sphere of aluminium, one metre in radius, at its surface: its currents have the moment
    # 2 pi sigma a^5 / 15 dB/dt, with the field mu_0 sigma a^2 / 15 = 3.2 s on its axis (Landau & Lifshitz, section 59).
    parameters = vector_parameters("K", "s", 0.05, -3.2, 3.2, axes=("xx", "yy", "xy", "xz", "yz"))

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        xx, yy, xy, xz, yz = theta
        K = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, -xx - yy]])
        return signal.with_stray(-mapped(K, signal.field_rate_B_nT_s))
