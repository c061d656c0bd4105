"""The test against flight: sun-field angles of 1978 that entered no fit, predicted from orbit, sun and field.

Each sunlit pass's window is fixed from its printed sun-nadir range. The lowest and highest sun-field angle in that
window are then predicted and compared with the two printed numbers: 24 passes, 48 ends. What counts are the ends whose
digits nobody has touched: the few that were read anew had the prediction as one of the reasons. The same is done with
fields and an orbit that are known to be wrong; if the test could not tell them, it would test nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.hcmm_orbit.angles import angles_along
from fluxtwin.scenarios.hcmm_orbit.fit import OrbitFit
from fluxtwin.scenarios.hcmm_orbit.geometry import look, make_grid
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows, fix_windows
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import FieldModel, load_field
from fluxtwin.sim.earth.orbit import Orbit

NODE_MINUTES = 15.0
FIELD_TURN_DEG = 10.0


@dataclass(frozen=True)
class FlightTest:
    """Predicted less printed, deg. Q = 24 sunlit passes, two ends each."""

    labels: tuple[str, ...]
    predicted_deg: FloatArray
    """(Q, 2) lowest and highest sun-field angle."""
    error_as_scanned_deg: FloatArray
    """(Q, 2) against the digits of the scan."""
    error_deg: FloatArray
    """(Q, 2) against the digits with the documented corrections."""
    nulls_deg: Mapping[str, float]
    """Median error of the untouched ends with one thing wrong; of two directions of a turn the better one."""

    @property
    def untouched(self) -> BoolArray:
        """(Q, 2) ends whose digits are those of the scan."""
        return np.asarray(self.error_deg == self.error_as_scanned_deg, dtype=np.bool_)

    @property
    def median_deg(self) -> float:
        """Median error of the untouched ends."""
        return float(np.median(np.abs(self.error_deg[self.untouched])))

    @property
    def median_as_scanned_deg(self) -> float:
        """Median error of all 48 ends, digits as scanned."""
        return float(np.median(np.abs(self.error_as_scanned_deg)))

    @property
    def median_corrected_deg(self) -> float:
        """The same with the documented corrections."""
        return float(np.median(np.abs(self.error_deg)))

    def ends_within(self, limit_deg: float, *, as_scanned: bool = False) -> int:
        """Ends with an error of at most this."""
        error = self.error_as_scanned_deg if as_scanned else self.error_deg
        return int((np.abs(error) <= limit_deg).sum())


def run_flight_test(fit: OrbitFit, model: FieldModel | None = None) -> FlightTest:
    """Predict with IGRF-14 unless told otherwise, and with four wrong fields and a wrong node."""
    model = load_field("igrf14") if model is None else model
    passes = tuple(item for item in read_passes() if item.sunlit)
    windows = windows_of(passes, fit.orbit)
    predicted = angles_along(passes, windows, fit.orbit, model).range_of("sun_field_deg")
    scanned, used = (_printed(passes, as_scanned=flag) for flag in (True, False))
    untouched = scanned == used

    def median(orbit: Orbit, other: FieldModel, turn_deg: float = 0.0) -> float:
        seen = windows_of(passes, orbit) if orbit is not fit.orbit else windows
        found = angles_along(passes, seen, orbit, other, turned_east_deg=turn_deg).range_of("sun_field_deg")
        return float(np.median(np.abs(found - used)[untouched]))

    turned = [median(fit.orbit, model, sign * FIELD_TURN_DEG) for sign in (-1.0, 1.0)]
    nodes = [median(_with_node(fit.orbit, sign * NODE_MINUTES), model) for sign in (-1.0, 1.0)]
    nulls = {
        "dipole": median(fit.orbit, model.truncated(1)),
        "degree2": median(fit.orbit, model.truncated(2)),
        "degree4": median(fit.orbit, model.truncated(4)),
        "field_10deg": min(turned),
        "node_15min": min(nodes),
    }
    return FlightTest(tuple(p.label for p in passes), predicted, predicted - scanned, predicted - used, nulls)


def windows_of(passes: tuple[Pass, ...], orbit: Orbit, *, as_scanned: bool = True) -> PassWindows:
    """Windows along an orbit, from the printed sun-nadir ranges."""
    grid = make_grid(passes)
    return fix_windows(grid, look(grid, orbit), [p.sun_nadir_read if as_scanned else p.sun_nadir for p in passes])


def _printed(passes: tuple[Pass, ...], *, as_scanned: bool) -> FloatArray:
    return np.array([p.sun_field_read if as_scanned else p.sun_field for p in passes], dtype=np.float64)


def _with_node(orbit: Orbit, minutes: float) -> Orbit:
    """The orbit with its node so many minutes of local time later."""
    return dataclasses.replace(orbit, raan_rad=orbit.raan_rad + float(np.radians(minutes / 4.0)))
