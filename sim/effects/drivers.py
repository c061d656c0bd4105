"""What drives the effects of the spacecraft: recorded columns, and what replaces them where they are absent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Literal, get_args

import numpy as np

from fluxtwin.sim.base.late import late, varies
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.earth.orbit import kepler_period_s
from fluxtwin.sim.effects.base import known_column
from fluxtwin.sim.effects.history import relax
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.spacecraft.power import Panel, incidence_cosine

ArrayKind = Literal["zenith", "tracking", "constant"]
"""A panel on the -z face, an array that turns about y, or a current that only shadow cuts."""
PanelKind = Literal[ArrayKind, "balance"]
"""These, or what the battery says."""
BatteryKind = Literal[ArrayKind, "tapered"]
"""These, or a charging current that falls as the battery fills."""
Face = tuple[float, float, float]
"""Outward normal of a panel that is fixed to the body, body axes."""

TIME_CONSTANTS_S = (300.0, 900.0, 2700.0)
"""Thermal time constants tried where no temperature was recorded: a boom's sensor to one inside the body."""
STANDARD_SWING_K = 20.0
"""Swing of the equilibrium temperature between shadow and sun where no temperature was recorded."""


def lit(setting: Setting) -> FloatArray:
    """(N,) 1 in sunlight, 0 in shadow: the column `sunlit`, else the share of the disc from geometry."""
    column = known_column(setting, "sunlit")
    return setting.illumination if column is None else column


def array_current_A(setting: Setting, panel: PanelKind | Face) -> FloatArray:
    """(N,) recorded current of the solar array, else that of an array of 1 A in full sun."""
    column = known_column(setting, "array_current_A")
    if column is not None:
        return column
    if panel == "constant":
        return lit(setting)
    if panel == "balance":  # array = battery + load, and the load of a bus hardly changes
        battery = known_column(setting, "battery_current_A")
        return lit(setting) if battery is None else battery
    sun_B, known = sun_in_body(setting)
    if isinstance(panel, tuple):
        shape = Panel(panel, 1.0)
    else:
        shape = Panel((0.0, 0.0, -1.0), 1.0) if panel == "zenith" else Panel((0.0, 1.0, 0.0), 1.0, tracks=True)
    cosine = incidence_cosine(sun_B, shape)
    if not known.all():
        seen = known & (lit(setting) > 0.5)
        cosine = np.where(known, cosine, float(cosine[seen].mean()) if seen.any() else 1.0)
    return np.asarray(lit(setting) * cosine)


def panels_that_show(setting: Setting) -> tuple[ArrayKind, ...]:
    """The panels worth trying where no current of the array was recorded: those whose current changes."""
    # Where no incidence is known all are alike. Panels on every face would be named for causes of other kinds: another
    # face is tried only where a field that follows the sun's direction has shown it.
    kinds: tuple[ArrayKind, ...] = get_args(ArrayKind) if sun_in_body(setting)[1].any() else ("constant",)
    return tuple(kind for kind in kinds if varies(array_current_A(setting, kind)))


def faces_beside(panel: Face) -> tuple[Face, ...]:
    """Faces tilted from one by 20, 10 and 5 degrees, to four sides each."""
    normal = np.array(panel)
    across = np.linalg.svd(normal[None, :])[2][1:]
    tilts = np.tan(np.radians([20.0, 10.0, 5.0]))
    return tuple(face(normal + tilt * side) for tilt in tilts for side in (*across, *-across))


def face(normal: FloatArray) -> Face:
    """The face of this normal (3,), to a thousandth."""
    x, y, z = np.round(normal / np.linalg.norm(normal), 3).tolist()
    return x, y, z


def sun_in_body(setting: Setting) -> tuple[FloatArray, BoolArray]:
    """Unit vectors to the sun in body axes (N, 3), and where they are known (N,): by the attitude, else as measured."""
    sun_B = setting.given[2].apply(setting.sun_N)
    known = np.ones(len(sun_B), dtype=np.bool_) if setting.attitude_known is None else setting.attitude_known.copy()
    measured = setting.column("sun_B")
    if measured is not None:
        instead = ~known & np.isfinite(measured).all(axis=1)
        sun_B = np.where(instead[:, None], measured, sun_B)
        known |= instead
    return sun_B, known


def battery_column_A(setting: Setting, panel: BatteryKind | Face) -> FloatArray | None:
    """(N,) recorded current of the battery, else that of the array, whose load hardly changes, unless the battery tapers."""
    own = known_column(setting, "battery_current_A")
    return own if own is not None or panel == "tapered" else known_column(setting, "array_current_A")


def battery_current_A(setting: Setting, panel: ArrayKind | Face = "constant") -> FloatArray:
    """(N,) recorded current of the battery, positive when charging; else that of the array, but for a constant load; else
    that of an array of 2 A in full sun less a load of 1 A."""
    column = battery_column_A(setting, panel)
    return 2.0 * array_current_A(setting, panel) - 1.0 if column is None else column


def tapered_A(setting: Setting, taper_s: float, trickle: float) -> FloatArray:
    """(N,) current of a battery that is charged with 1 A at sunrise, falling with a time constant to the share `trickle`,
    and that gives in the shadow what it took in the sun."""
    since_s, sunlit_s = _since_sunrise_s(setting)
    charging = trickle + (1.0 - trickle) * np.exp(-since_s / taper_s)
    taken = trickle * sunlit_s - (1.0 - trickle) * taper_s * np.expm1(-sunlit_s / taper_s)
    dark_s = orbital_period_s(setting) - sunlit_s
    given = np.divide(taken, dark_s, out=np.zeros_like(taken), where=dark_s > 0.0)
    light = lit(setting)
    return np.asarray(light * charging - (1.0 - light) * given)


def _since_sunrise_s(setting: Setting) -> tuple[FloatArray, FloatArray]:
    """(N,) time since the satellite last left the shadow, and how long its orbit is in the sun.

    From the geometry of each row, with a circular orbit and a cylindrical shadow: a record may start in the sun, or lack
    the sunrise.
    """
    r, v, _ = setting.given
    normal = np.cross(r, v)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    noon = setting.sun_N - np.einsum("ij,ij->i", setting.sun_N, normal)[:, None] * normal
    eastward = np.cross(normal, noon)
    since_midnight = np.arctan2(-np.einsum("ij,ij->i", eastward, r), -np.einsum("ij,ij->i", noon, r))
    # In the shadow the distance to the axis is less than the Earth's radius: cos(angle from midnight) |noon| > horizon.
    horizon = np.sqrt(np.maximum(1.0 - (EARTH_RADIUS_KM / np.linalg.norm(r, axis=1)) ** 2, 0.0))
    half = np.arccos(np.minimum(horizon / np.maximum(np.linalg.norm(noon, axis=1), horizon), 1.0))
    rad_s = 2.0 * np.pi / orbital_period_s(setting)
    return np.mod(since_midnight - half, 2.0 * np.pi) / rad_s, 2.0 * (np.pi - half) / rad_s


def temperature_K(setting: Setting, time_constant_s: float) -> FloatArray:
    """(N,) recorded temperature [degC], else a first-order lag behind sun and shadow of the standard swing.

    Where the record covers an orbit, the lag starts from the state that its first orbit, repeated for ever,
    leads back to, so that there is no transient; else (or where a gap follows its first row) from the mean.
    """
    column = known_column(setting, "temperature_degC")
    if column is not None:
        return column
    return setting.once(("temperature_K", time_constant_s), partial(_lag_K, setting, time_constant_s))


def _lag_K(setting: Setting, time_constant_s: float) -> FloatArray:
    goal = STANDARD_SWING_K * lit(setting)
    seconds, period_s = setting.seconds, orbital_period_s(setting)
    start, orbit = float(goal.mean()), setting.seconds <= period_s
    if seconds[-1] >= period_s and np.count_nonzero(orbit) > 1:
        kept = float(np.exp(-seconds[orbit][-1] / time_constant_s))
        end = float(relax(seconds[orbit], goal[orbit], time_constant_s, start=start)[-1])
        start = (end - kept * start) / (1.0 - kept)
    return relax(seconds, goal, time_constant_s, start=start)


def orbital_period_s(setting: Setting) -> float:
    """Kepler period of the first row's orbit."""
    return kepler_period_s(setting.given[0][0], setting.given[1][0])


def followed(setting: Setting, name: str, delay_s: float | FloatArray, lag_s: float) -> FloatArray | None:
    """(N,) a recorded column `delay_s` (or (N,)) before, then behind a first-order lag, as by `late`; None when it is
    absent or wholly missing."""
    column = setting.column(name)
    return None if column is None or not np.isfinite(column).any() else late(setting.seconds, column, delay_s, lag_s)


STAND_INS: Mapping[str, tuple[Callable[[Setting], FloatArray], ...]] = {
    "array_current_A": tuple(partial(array_current_A, panel=panel) for panel in get_args(PanelKind)),
    "battery_current_A": tuple(partial(battery_current_A, panel=panel) for panel in get_args(ArrayKind)),
    "temperature_degC": tuple(partial(temperature_K, time_constant_s=tau_s) for tau_s in TIME_CONSTANTS_S),
}
"""What may stand in for a column where it was not recorded, by its name."""
