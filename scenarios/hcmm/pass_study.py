"""Table 5: the 43 passes as the ground sees them after calibration, beside the printed rows.

Samples are those of the simulated flight in the window that each pass's printed sun-nadir range fixes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.hcmm.mission import Flight, quantity
from fluxtwin.scenarios.hcmm_orbit.geometry import angle_between
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.scenarios.hcmm_orbit.windows import PassWindows
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry

ANOMALOUS = (11, 12, 13, 34)
"""Rows whose printed residual exceeds 3 mG."""
LIMIT_MG = quantity("residual limit")
QUIET_ROWS = tuple(number for number in range(1, 44) if number not in ANOMALOUS)


@dataclass(frozen=True)
class Row:
    """Ours of one pass; angles in deg, None where the sun is not seen."""

    number: int
    samples: int
    eps_M_mG: float
    sun_field: tuple[float, float] | None
    delta_sun_field: float | None
    nadir_field: tuple[float, float]
    delta_nadir_field: float
    sun_nadir: tuple[float, float]
    delta_sun_nadir: float | None


@dataclass(frozen=True)
class PassStudy:
    """All rows, and the printed ones."""

    passes: tuple[Pass, ...]
    rows: tuple[Row, ...]
    field_model_eps_mG: FloatArray
    """(43,) rms of the error of IGRF 1975 in field strength along each pass: no simulation, only two field models."""
    eps_range_mG: FloatArray
    """(43, 2) 5 and 95 % of our residual over calibrations made with other passes: the choice of 1978 is not known."""

    def column(self, name: str) -> FloatArray:
        """(43,) of our rows, NaN where there is none."""
        return np.array([np.nan if getattr(row, name) is None else getattr(row, name) for row in self.rows])

    def rms(self, name: str, chosen: BoolArray) -> float:
        """Root mean square over chosen passes, as the last lines of the table."""
        values = self.column(name)[chosen]
        return float(np.sqrt(np.nanmean(values**2)))

    def printed_rms(self, name: str, chosen: BoolArray) -> float:
        """The same of the printed entries that are there; name: a field of `Pass`."""
        values = [getattr(item, name) for item in self.passes]
        known = np.array([np.nan if value is None else value for value in values])[chosen]
        return float(np.sqrt(np.nanmean(known**2)))

    @property
    def everything(self) -> BoolArray:
        """(43,) all passes."""
        return np.ones(len(self.passes), dtype=bool)

    @property
    def quiet(self) -> BoolArray:
        """(43,) the 39 passes of the first rms line."""
        return np.array([p.number not in ANOMALOUS for p in self.passes])

    @property
    def dawn(self) -> BoolArray:
        """(43,) the five dawn passes over Orroral."""
        return np.array([p.dawn for p in self.passes])

    @property
    def sunlit(self) -> BoolArray:
        """(43,) passes with printed sun-field angles."""
        return np.array([p.sunlit for p in self.passes])

    @property
    def lit(self) -> BoolArray:
        """(43,) the 19 sunlit passes that are not at dawn."""
        return self.sunlit & ~self.dawn


def run_passes(
    flight: Flight, calibration: Calibration, ground: FieldModel, windows: PassWindows, others: FloatArray
) -> PassStudy:
    """Ours of all 43 passes. others: (R, 12) S row by row and b [mG] of other calibrations."""
    passes = read_passes()
    difference = np.linalg.norm(flight.world.field_N_nT, axis=1) - np.linalg.norm(
        field_N_nT(ground, flight.world.time, flight.world.r_N_km), axis=1
    )
    inside = [rows_of(flight.telemetry, item, windows, k) for k, item in enumerate(passes)]
    eps = [float(np.sqrt(np.mean(difference[chosen] ** 2)) / NT_PER_MG) for chosen in inside]
    rows = rows_of_passes(flight.telemetry, calibration, ground, windows)
    return PassStudy(passes, rows, np.array(eps), _eps_range(flight, ground, others, inside))


def rows_of_passes(
    telemetry: Telemetry, calibration: Calibration, ground: FieldModel, windows: PassWindows
) -> tuple[Row, ...]:
    """Ours of all 43 passes, from the telemetry alone."""
    compared = compare(telemetry, calibration, ground)
    return tuple(_row(item, compared, rows_of(telemetry, item, windows, k)) for k, item in enumerate(read_passes()))


def _eps_range(flight: Flight, ground: FieldModel, others: FloatArray, inside: Sequence[np.ndarray]) -> FloatArray:
    model = np.linalg.norm(field_N_nT(ground, flight.world.time, flight.world.r_N_km), axis=1)
    found = np.empty((len(others), len(inside)))
    for run, parameters in enumerate(others):
        calibration = Calibration(parameters[:9].reshape(3, 3), parameters[9:] * NT_PER_MG)
        away = np.linalg.norm(calibration.apply(flight.telemetry.mag_B_nT), axis=1) - model
        found[run] = [np.sqrt(np.mean(away[rows] ** 2)) / NT_PER_MG for rows in inside]
    return np.asarray(np.percentile(found, [5.0, 95.0], axis=0).T)


def compare(telemetry: Telemetry, calibration: Calibration, ground: FieldModel) -> Numbers:
    """Equation 19 of the conference paper, sample by sample: measured less computed, NaN where a sensor gives nothing."""
    assert telemetry.r_N_km is not None and telemetry.nadir_B is not None and telemetry.sun_B is not None
    field_B = calibration.apply(telemetry.mag_B_nT)
    r_N_km = np.array(telemetry.r_N_km)
    model_N = field_N_nT(ground, telemetry.time, r_N_km)
    sun_N = sun.sun_direction_N(telemetry.time, r_N_km)
    computed = {
        "sun_field": angle_between(sun_N, model_N),
        "nadir_field": angle_between(-r_N_km, model_N),
        "sun_nadir": angle_between(-r_N_km, sun_N),
    }
    return Numbers(
        # [nT] Field strength, and [rad] angles; what orbit and model give for these.
        magnitude_nT=np.linalg.norm(field_B, axis=1) - np.linalg.norm(model_N, axis=1),
        sun_field=angle_between(telemetry.sun_B, field_B) - computed["sun_field"],
        nadir_field=angle_between(telemetry.nadir_B, field_B) - computed["nadir_field"],
        sun_nadir=angle_between(telemetry.sun_B, telemetry.nadir_B) - computed["sun_nadir"],
        computed_deg={name: np.degrees(angle) for name, angle in computed.items()},
    )


def rows_of(telemetry: Telemetry, item: Pass, windows: PassWindows, k: int) -> np.ndarray:
    """Rows of the telemetry in the window of pass number k of the table (from 0)."""
    minutes = epoch.seconds_since(telemetry.time, item.aos) / 60.0
    return np.flatnonzero((minutes >= windows.start_min[k]) & (minutes <= windows.end_min[k]))


def _row(item: Pass, found: Numbers, rows: np.ndarray) -> Row:
    seen = np.isfinite(found.sun_field[rows]).any() and item.sunlit
    return Row(
        number=item.number,
        samples=int(rows.size),
        eps_M_mG=float(np.sqrt(np.mean(found.magnitude_nT[rows] ** 2)) / NT_PER_MG),
        sun_field=_range(found.computed_deg["sun_field"][rows]) if item.sunlit else None,
        delta_sun_field=_rms_deg(found.sun_field[rows]) if seen else None,
        nadir_field=_range(found.computed_deg["nadir_field"][rows]),
        delta_nadir_field=_rms_deg(found.nadir_field[rows]),
        sun_nadir=_range(found.computed_deg["sun_nadir"][rows]),
        delta_sun_nadir=_rms_deg(found.sun_nadir[rows]) if seen else None,
    )


def _range(values: FloatArray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _rms_deg(values: FloatArray) -> float:
    return float(np.degrees(np.sqrt(np.nanmean(values**2))))
