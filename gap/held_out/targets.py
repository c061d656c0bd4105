"""Other designs of the same spacecraft: later days, other seasons, other attitude motions.

A day later the orbit is the recorded one with its node moved by the Earth's flattening (J2, secular), over another
ground and under another sun. What was recorded of the housekeeping repeats in time; a current or temperature that
follows the sunlight is recomputed from the sunlight of that day.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import FEWEST
from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.attitude.libration import draw_libration
from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.earth.orbit import orbital_rates
from fluxtwin.sim.effects.drivers import STAND_INS
from fluxtwin.sim.effects.signal import Motion, Setting

DAYS = (0.5, 90.0, 182.0)
"""Half a day turns the ground below, a quarter and half a year the sun."""
TUMBLE_DEG_S = (0.12, 0.08, 0.2)
SPIN_RPM = 1.9
"""Near 2 rpm, and no whole number of turns between samples of the usual spacings."""
INERTIA_KG_M2 = np.array([10.0, 12.0, 15.0])
"""Of a body without symmetry: only ratios matter to a torque-free tumble."""
_NADIR_WITHIN_RAD = np.radians(30.0)
"""Median angle to a mean attitude in the orbital frame; of a tumble it is above 90 degrees."""
_LIBRATION_RAD, _LIBRATION_S = np.radians(2.0), (600.0, 6000.0)
"""Size and range of periods of the pointing error of a nadir pointer: up to that of an orbit."""
_NUTATION_RAD = np.radians(5.0)
_FOLLOWS = 0.5
"""Share of a column's variance that sunlight explains, to be called driven by it: most of it."""


@dataclass(frozen=True, eq=False)
class Target:
    """One other design; N rows, as many as the record has with an attitude."""

    name: str
    setting: Setting
    segment: FloatArray
    """(N,) number of the stretch without gaps."""


@dataclass(frozen=True)
class PlannedMotion:
    """Motion along known positions with an attitude that is a function of time."""

    time: TimeArray
    r_N_km: FloatArray
    v_N_km_s: FloatArray
    turned: Callable[[TimeArray, FloatArray, FloatArray], Rotation]
    """R_BN at stamps, positions and velocities."""

    def at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position, velocity (N, 3) and R_BN `offset_s` after each stamp (seconds to minutes)."""
        after = np.broadcast_to(offset_s, self.time.shape)[:, None]
        pull = -GM_EARTH_KM3_S2 * self.r_N_km / np.linalg.norm(self.r_N_km, axis=1)[:, None] ** 3
        r = self.r_N_km + after * self.v_N_km_s + 0.5 * after**2 * pull
        v = self.v_N_km_s + after * pull
        seconds = epoch.seconds_since(self.time, self.time[0]) + after[:, 0]
        return r, v, self.turned(epoch.add_seconds(self.time[0], seconds), r, v)


def targets(problem: Problem) -> list[Target]:
    """The designs for which a closed scenario says whether its parameters are good enough.

    The attitude as flown on three other days, then nadir (if that was not flown), a tumble and a spin. Days outside
    the field model's validity are left out.
    """
    known = problem.telemetry.has_attitude
    if int(known.sum()) < FEWEST:
        return []
    flown = _cut(problem.setting, known)
    segment = problem.segment[known]
    R_BO = flown.given[2] * flown.R_ON.inv()
    nadir = bool(np.median((R_BO * R_BO.mean().inv()).magnitude()) < _NADIR_WITHIN_RAD)
    tumble, spin = f"tumble of {np.linalg.norm(TUMBLE_DEG_S):.2g} deg/s", f"spin of {SPIN_RPM:g} rpm"
    recorded, regime = ("nadir", None) if nadir else ("attitude as flown", "same")
    made = [(recorded, days, regime) for days in DAYS] + ([] if nadir else [("nadir", DAYS[1], "nadir")])
    made += [(tumble, DAYS[1], "tumble"), (spin, DAYS[1], "spin")]
    found = []
    for name, days, regime in made:
        setting, model = _moved(flown, days, regime), problem.setting.model
        later = f"{24 * days:g} h later" if days < 1 else f"{days:g} days later"
        if model.valid_from <= setting.time[0] and setting.time[-1] <= model.valid_to:
            found.append(Target(f"{name}, {later}", setting, segment))
    return found


def _cut(setting: Setting, rows: np.ndarray) -> Setting:
    """The setting at some of its rows, with the motion as it was recorded there."""
    r, v, R_BN = setting.given
    number = np.flatnonzero(rows)
    columns = {name: column[rows] for name, column in setting.columns.items()}
    denser = setting.motion.denser if isinstance(setting.motion, RecordedMotion) else None
    gyro = columns.get("rate_B_rad_s")
    motion = RecordedMotion(setting.time[rows], r[rows], v[rows], R_BN[number], gyro, denser=denser)
    return Setting(setting.time[rows], motion, "predict", setting.model, setting.instrument, columns)


def _moved(flown: Setting, days: float, regime: str | None) -> Setting:
    """Another day, in a regime: None the recorded motion about the orbital frame, "same" that about the stars."""
    time = epoch.add_seconds(flown.time[0], flown.seconds + 86400.0 * days)
    r, v, R_BN = flown.given
    turn = _node_turn(flown.time[0], r, v, 86400.0 * days)
    r, v = turn.apply(r), turn.apply(v)
    columns = {name: column for name, column in flown.columns.items() if name not in ("sunlit", "sun_B", "nadir_B")}
    motion: Motion
    if regime in (None, "same"):
        R = R_BN if regime == "same" else R_BN * flown.R_ON.inv() * frames.rotation_ON(r, v)
        denser = flown.motion.denser if regime == "same" and isinstance(flown.motion, RecordedMotion) else None
        if denser is not None:
            since_s = epoch.seconds_since(denser.time, flown.time[0])
            denser = dataclasses.replace(denser, time=epoch.add_seconds(time[0], since_s))
        motion = RecordedMotion(time, r, v, R, columns.get("rate_B_rad_s"), denser=denser)
    else:
        columns.pop("rate_B_rad_s", None)
        motion = PlannedMotion(time, r, v, _regime(str(regime), time[0]))
    bare = Setting(time, motion, "predict", flown.model, flown.instrument, columns)
    return dataclasses.replace(bare, columns=columns | _driven(flown, bare))


def _node_turn(time: np.datetime64, r_N_km: FloatArray, v_N_km_s: FloatArray, later_s: float) -> Rotation:
    """The turn of the orbital plane about the pole in so many seconds, from the first row's osculating orbit."""
    pole_N = frames.rotation_TN(time).inv().apply([0.0, 0.0, 1.0]).reshape(3)
    r, v = r_N_km[0], v_N_km_s[0]
    momentum = np.cross(r, v)
    axis_km = 1.0 / (2.0 / np.linalg.norm(r) - float(v @ v) / GM_EARTH_KM3_S2)
    shape = 1.0 - float(momentum @ momentum) / (GM_EARTH_KM3_S2 * axis_km)
    tilt = np.arccos(np.clip(float(momentum @ pole_N) / np.linalg.norm(momentum), -1.0, 1.0))
    if not axis_km > 0:
        return Rotation.identity()
    rates = orbital_rates(float(axis_km), float(np.sqrt(np.clip(shape, 0.0, 0.99))), float(tilt))
    return Rotation.from_rotvec(pole_N * rates.raan_rad_s * later_s)


def _regime(name: str, start: np.datetime64) -> Callable[[TimeArray, FloatArray, FloatArray], Rotation]:
    if name == "tumble":
        tumbling = (INERTIA_KG_M2, np.array([0.0, 0.0, 0.0, 1.0]), np.radians(TUMBLE_DEG_S))
        return lambda time, r, v: attitude.tumble(time, *tumbling, epoch=start).R_BN
    if name == "spin":
        spun = (INERTIA_KG_M2, np.array([1.0, 0.0, 0.0]), SPIN_RPM * 2.0 * np.pi / 60.0)
        tilt = float(_NUTATION_RAD)
        return lambda time, r, v: attitude.spin(time, *spun, nutation_rad=tilt, epoch=start).R_BN
    librations = draw_libration((_LIBRATION_RAD,) * 3, *_LIBRATION_S, np.random.default_rng(0))
    return lambda time, r, v: attitude.librating(time, r, v, librations).R_BN


def _driven(flown: Setting, moved: Setting) -> dict[str, FloatArray]:
    """Recorded columns that follow the sunlight, as they follow it on the other day."""
    found = {}
    for name, choices in STAND_INS.items():
        column = flown.columns.get(name)
        if column is not None:
            made = _best_shape(column, [(one(_without(flown, name)), one(_without(moved, name))) for one in choices])
            if made is not None:
                found[name] = made
    return found


def _without(setting: Setting, name: str) -> Setting:
    return dataclasses.replace(setting, columns={key: v for key, v in setting.columns.items() if key != name})


def _best_shape(column: FloatArray, shapes: Sequence[tuple[FloatArray, FloatArray]]) -> FloatArray | None:
    """a + c shape, with a and c fitted here and the shape there; None where no shape explains the column."""
    known = np.isfinite(column)
    best, made = _FOLLOWS, None
    for here, there in shapes:
        if known.sum() < FEWEST or np.ptp(here[known]) == 0.0 or np.ptp(column[known]) == 0.0:
            continue
        slope, level = np.polyfit(here[known], column[known], 1)
        explained = 1.0 - float(np.var(column[known] - slope * here[known] - level) / np.var(column[known]))
        if explained > best:
            best, made = explained, slope * there + level
    return made
