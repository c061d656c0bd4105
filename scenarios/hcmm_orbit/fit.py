"""One circular J2 orbit through 43 acquisition times and the printed sun-nadir ranges.

Unknown are the semi-major axis, the node and the argument of latitude, and for every pass the stretch of time whose
data were used. Known are:

* the satellite rises at the printed acquisition time (whole minutes; masks and routine make it a minute either way);
* the data begin a certain time after that, the same for all passes up to a scatter, and end before it sets;
* the sun-nadir angles of that stretch have the printed range, to the rounding of print.

A few numbers of the scan are wrong, so large residuals count less (soft L1). The covariance comes from the scatter
of the passes' own pulls (the "sandwich"), not from the assumed sigmas. One error is common to many passes: the least
sun-nadir angle of a night pass is nearly the same in all of them, so all are rounded alike. What a shift of these ends by
the rms of rounding does to the elements is added.

The first guess is from acquisition times alone, by trying the whole sky: no starting value is needed.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.hcmm_orbit.geometry import (
    EPOCH,
    INCLINATION_DEG,
    fix_windows,
    look,
    make_grid,
    orbit_of,
    ranges_of_windows,
    rise_and_set_min,
    turning_ends,
)
from fluxtwin.scenarios.hcmm_orbit.record import Pass, Range, read_passes, read_stations
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.earth.orbit import Orbit, orbital_rates

Pair = tuple[FloatArray, FloatArray]
ELEMENTS = ("semi_major_axis_km", "raan_deg", "argument_of_latitude_deg")
_RISE_MIN, _START_MIN, _VISIBLE_MIN = 1.0, 0.4, 0.3
"""Scatter allowed for acquisition against rise, for the start of the data, and for data past the horizon [min]."""
_ANGLE_DEG = 0.4
"""Rounding of print and sampling of the data."""
_ROUNDING_DEG = 1.0 / float(np.sqrt(12.0))
_STEPS = (0.1, 0.02, 0.02, 0.02)
"""Steps of the differences: km, deg, deg, deg."""
_MOST_ROUNDS = 6
"""Of windows set anew; two or three are enough."""
_ROWS = 6
"""Residuals of a pass: rise, start, two visibility limits, two ends of the range."""
_ANGLES_DEG = np.arange(0.0, 360.0, 4.0)
_AXES_KM = np.arange(6930.0, 7070.1, 4.0)
"""Periods of 95.8 to 98.7 min: launch reports give 96.7."""
_MOST_DEG = 12.0
"""A pass further from its horizon than this counts no more: a wrong time must not decide."""
_LATER_S = 180.0


def fit_orbit(passes: tuple[Pass, ...] | None = None, *, free_inclination: bool = False) -> Numbers:
    """Fit the record, with the sun-nadir ranges as the scan shows them.

    Acquisition times are those of the table with its seven corrections: three minutes above 59, and four
    hours at which the satellite cannot be in view. No sun-field and no nadir-field angle enters.
    """
    passes = read_passes() if passes is None else passes
    ranges = [item.sun_nadir_read for item in passes]
    grid = make_grid(passes)
    problem = _Problem(grid, ranges, 4 if free_inclination else 3, np.array([*first_guess(passes), INCLINATION_DEG]))
    found = problem.solve()
    K = problem.free
    elements = problem.elements(found)
    orbit = orbit_of(*elements)
    sky = look(grid, orbit)
    covariance = problem.covariance(found)[:K, :K] + problem.common_rounding(found)[:K, :K]
    return Numbers(
        orbit=orbit,
        # (K,) km and deg, at the epoch, true equator and equinox of date; (K, K) from the scatter of the passes.
        names=(*ELEMENTS, "inclination_deg")[:K],
        values=elements[:K],
        covariance=covariance,
        sigmas=np.sqrt(np.diag(covariance)),
        node_apparent_h=_node_apparent_h(orbit),
        # Fixed from the sun-nadir ranges alone, along the fitted orbit.
        windows=fix_windows(grid, sky, ranges),
        # (P,) predicted rise less printed acquisition, and greatest elevation.
        rise_min=rise_and_set_min(grid, sky)[0],
        highest_deg=sky.elevation_deg.max(axis=1),
        # Mean time from acquisition to the first datum.
        start_offset_min=found[K],
    )


def _node_apparent_h(orbit: Orbit) -> float:
    """Local apparent solar time of the ascending node at the epoch [h]."""
    sun_T = frames.rotation_TN(orbit.epoch_utc).apply(sun.sun_N_km(orbit.epoch_utc))[0]
    hour_angle_rad = orbit.raan_rad - np.arctan2(sun_T[1], sun_T[0])
    return float((np.degrees(hour_angle_rad) / 15.0 + 12.0) % 24.0)


class _Problem:
    """Residuals of x = (K elements, mean start, P starts, P ends) and their Jacobian."""

    def __init__(self, grid: Numbers, ranges: Sequence[Range], free: int, start: FloatArray) -> None:
        self.grid, self.free, self.fixed = grid, free, start
        self.low, self.high = np.array(ranges).T
        self.count = len(ranges)
        self.scale = np.concatenate([[1.0, 0.1, 0.1, 0.1][:free], [0.1], np.full(2 * self.count, 0.1)])

    def elements(self, x: FloatArray) -> FloatArray:
        """All four elements."""
        return np.concatenate([x[: self.free], self.fixed[self.free :]])

    def solve(self) -> FloatArray:
        """The best x, from the first guess on."""
        sky = look(self.grid, orbit_of(*self.fixed))
        window = fix_windows(self.grid, sky, list(zip(self.low, self.high, strict=True)))
        offset = float(np.median(window.start_min))
        x = np.concatenate([self.fixed[: self.free], [offset], window.start_min, window.end_min])
        found = self._least(x)
        for _ in range(_MOST_ROUNDS):
            other = self._least(self._best_windows(found))
            if self.cost(other) >= self.cost(found):
                break
            found = other
        return found

    def cost(self, x: FloatArray) -> float:
        """What is made least: half the sum of the soft L1 losses."""
        return float(_losses(self.residuals(x)).sum())

    def _least(self, x: FloatArray, most: int = 60) -> FloatArray:
        return np.asarray(
            least_squares(self.residuals, x, self.jacobian, loss="soft_l1", x_scale=self.scale, max_nfev=most).x
        )

    def _best_windows(self, x: FloatArray) -> FloatArray:
        """The same elements, and of each pass the window that costs least along their orbit, of all on a grid.

        Beside a turning point of the angle several windows suit, and steps downhill find the nearest one only.
        """
        sky, x = look(self.grid, orbit_of(*self.elements(x))), x.copy()
        rise, fall = rise_and_set_min(self.grid, sky)
        for k in range(self.count):
            times, low, high = ranges_of_windows(self.grid.minutes, sky.sun_nadir_deg[k], (rise[k], fall[k]))
            start, end = times[:, None], times[None, :]
            misfits = self._misfits(k, x, (rise[k], fall[k]), (start, end), (low, high))
            cost = functools.reduce(np.add, map(_losses, misfits))
            first, last = np.unravel_index(int(np.nanargmin(cost)), cost.shape)
            x[self.free + 1 + k], x[self.free + 1 + self.count + k] = times[first], times[last]
        return x

    def common_rounding(self, x: FloatArray) -> FloatArray:
        """Covariance of x from ends at turning points that are all rounded the same way, lower and upper ones apart."""
        sky = look(self.grid, orbit_of(*self.elements(x)))
        turning = turning_ends(self.grid, sky, list(zip(self.low, self.high, strict=True)))
        total = np.zeros((x.size, x.size))
        for column, name in enumerate(("low", "high")):
            kept = getattr(self, name)
            setattr(self, name, kept + _ROUNDING_DEG * turning[:, column])
            moved = self._least(x, most=40)
            setattr(self, name, kept)
            total += np.outer(moved - x, moved - x)
        return total

    def residuals(self, x: FloatArray) -> FloatArray:
        """(6 P,)."""
        return self._of_windows(look(self.grid, orbit_of(*self.elements(x))), x).ravel()

    def _of_windows(self, sky: Numbers, x: FloatArray) -> FloatArray:
        """(P, 6)."""
        first = self.free + 1
        start, end = x[first : first + self.count], x[first + self.count :]
        rise, fall = rise_and_set_min(self.grid, sky)
        minutes, angle = self.grid.minutes, sky.sun_nadir_deg
        ends = np.stack([_interpolate(minutes, angle, start), _interpolate(minutes, angle, end)], axis=1)
        inside = (minutes[None, :] > start[:, None]) & (minutes[None, :] < end[:, None])
        low = np.minimum(np.where(inside, angle, np.inf).min(axis=1), ends.min(axis=1))
        high = np.maximum(np.where(inside, angle, -np.inf).max(axis=1), ends.max(axis=1))
        misfits = self._misfits(slice(None), x, (rise, fall), (start, end), (low, high))
        return np.stack([rise / _RISE_MIN, *misfits], axis=1)

    def _misfits(
        self, which: int | slice, x: FloatArray, visible: Pair, window: Pair, angles: Pair
    ) -> tuple[FloatArray, ...]:
        """Residuals of passes but that of the rise: of the start, of data before the rise and past the fall, of both ends of
        the range."""
        return (
            (window[0] - x[self.free]) / _START_MIN,
            np.maximum(visible[0] - window[0], 0.0) / _VISIBLE_MIN,
            np.maximum(window[1] - visible[1], 0.0) / _VISIBLE_MIN,
            (angles[0] - self.low[which]) / _ANGLE_DEG,
            (angles[1] - self.high[which]) / _ANGLE_DEG,
        )

    def jacobian(self, x: FloatArray) -> FloatArray:
        """(6 P, K + 1 + 2 P): elements by central differences, each pass's window by its own."""
        J = np.zeros((self.count, _ROWS, x.size))
        for k in range(self.free):
            step = np.zeros(x.size)
            step[k] = _STEPS[k]
            J[:, :, k] = (self.residuals(x + step) - self.residuals(x - step)).reshape(-1, _ROWS) / (2 * _STEPS[k])
        J[:, 1, self.free] = -1.0 / _START_MIN
        sky = look(self.grid, orbit_of(*self.elements(x)))
        rows, small = np.arange(self.count), 0.01
        for first in (self.free + 1, self.free + 1 + self.count):
            step = np.zeros(x.size)
            step[first : first + self.count] = small
            change = (self._of_windows(sky, x + step) - self._of_windows(sky, x - step)) / (2 * small)
            J[rows, :, first + rows] = change
        return J.reshape(-1, x.size)

    def covariance(self, x: FloatArray) -> FloatArray:
        """Covariance of x from the scatter of the passes: A^-1 (sum g g') A^-1 P/(P - K), g the pull of a pass.

        Huber 1967; the weights are those of the soft L1 loss. A window that nothing determines is held.
        """
        r = self.residuals(x)
        weight = 1.0 / np.sqrt(1.0 + r**2)
        J = self.jacobian(x)
        A = J.T @ (weight[:, None] * J) + 1e-6 * np.eye(x.size)
        pull = np.einsum("pr,prx->px", (weight * r).reshape(-1, _ROWS), J.reshape(self.count, _ROWS, -1))
        inverse = np.linalg.inv(A)
        return np.asarray(inverse @ (pull.T @ pull) @ inverse * self.count / (self.count - self.free - 1))


def _losses(residuals: FloatArray) -> FloatArray:
    """Half the soft L1 loss of each."""
    return np.asarray(np.sqrt(1.0 + residuals**2) - 1.0)


def _interpolate(minutes: FloatArray, table: FloatArray, at: FloatArray) -> FloatArray:
    """Row by row linear interpolation of a table (P, G) at one time a row (P,)."""
    place = np.clip((at - minutes[0]) / (minutes[1] - minutes[0]), 0.0, minutes.size - 1.000001)
    k = place.astype(int)
    rows = np.arange(len(at))
    return np.asarray(table[rows, k] + (place - k) * (table[rows, k + 1] - table[rows, k]))


def first_guess(passes: tuple[Pass, ...]) -> tuple[float, float, float]:
    """(a [km], RAAN [deg], argument of latitude [deg]) at EPOCH.

    A satellite that rises stands at the horizon: the angle at the Earth's centre between it and the station is
    acos(R/a), and shrinks. The score is the mean distance from that, of trial orbits on a grid of all three elements.
    """
    time = np.array([item.aos for item in passes])
    seconds = epoch.seconds_since(time, EPOCH)
    stations = read_stations()
    fixed = np.array([stations[item.station].r_E_km for item in passes])
    # The equator of date at the epoch serves for three days.
    up = (frames.rotation_TN(EPOCH) * frames.rotation_EN(time).inv()).apply(fixed)
    up = up / np.linalg.norm(up, axis=1)[:, None]
    later = Rotation.from_euler("z", 2.0 * np.pi * _LATER_S / 86164.2).apply(up)  # the Earth turns
    best = (np.inf, (0.0, 0.0, 0.0))
    for axis_km in _AXES_KM:
        score = _scores(float(axis_km), seconds, up, later)
        at = np.unravel_index(int(np.argmin(score)), score.shape)
        best = min(best, (float(score[at]), (float(axis_km), float(_ANGLES_DEG[at[0]]), float(_ANGLES_DEG[at[1]]))))
    return best[1]


def _scores(axis_km: float, seconds: FloatArray, up: FloatArray, later: FloatArray) -> FloatArray:
    """(nodes, latitudes) mean distance from the horizon in deg, passes that set instead of rising counted as lost."""
    horizon = float(np.degrees(np.arccos(EARTH_RADIUS_KM / axis_km)))
    now = _cosines(axis_km, seconds, up)
    then = _cosines(axis_km, seconds + _LATER_S, later)
    distance = np.minimum(np.abs(np.degrees(np.arccos(np.clip(now, -1.0, 1.0))) - horizon), _MOST_DEG)
    return np.asarray(np.where(then > now, distance, _MOST_DEG).mean(axis=-1))


def _cosines(axis_km: float, seconds: FloatArray, up: FloatArray) -> FloatArray:
    """(nodes, latitudes, P) cosine of the angle at the Earth's centre between satellite and station."""
    inclination = np.radians(INCLINATION_DEG)
    rates = orbital_rates(axis_km, 0.0, float(inclination))
    node = np.radians(_ANGLES_DEG)[:, None] + rates.raan_rad_s * seconds[None, :]
    u = np.radians(_ANGLES_DEG)[:, None] + (rates.argument_of_perigee_rad_s + rates.mean_anomaly_rad_s) * seconds
    cn, sn, ci, si = np.cos(node), np.sin(node), np.cos(inclination), np.sin(inclination)
    along = up[:, 0] * cn + up[:, 1] * sn
    across = ci * (-up[:, 0] * sn + up[:, 1] * cn) + si * up[:, 2]
    return np.asarray(along[:, None, :] * np.cos(u)[None, :, :] + across[:, None, :] * np.sin(u)[None, :, :])
