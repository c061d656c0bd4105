"""Telemetry from recorded files that have a layout of their own, read strictly, and field models with a known error.

Body axes are those of the orbit (x forward, y against the orbit normal, z to nadir) wherever a file gives the field in
geocentric axes: that is how these satellites fly, and the attitude is then exact by construction. To a file that has
residuals only the field of IGRF-14 is added again, so that its gap is the residual of the file. The full vectors of
MAGSAT and Swarm are read by `flight_field.tracks`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.flight_field.tracks import Track
from fluxtwin.scenarios.recorded_files import ORBIT_KM, increasing, none_wrong, numbers, opened
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field import field_N_nT, field_NEC_nT
from fluxtwin.sim.earth.field_models import FieldModel, linear_model, load_field
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.time_stamps import parse_iso

_DIPOLE_NT = 30_000.0


def field_model(name: str) -> FieldModel:
    """The model of a case: `igrf14`, `igrf14, degree 8`, `igrf1975, held back`, `igrf1975, carried on` or `dipole`."""
    base, _, change = name.partition(", ")
    if base == "dipole":
        # a centred dipole along the Earth's axis that does not change: the field of an aircraft at an unknown place
        knots = np.array(["2000-01-01", "2100-01-01"], dtype="datetime64[ns]")
        return linear_model("dipole", "a centred dipole, fixed", knots, np.array([[-_DIPOLE_NT, 0.0, 0.0]] * 2))
    if change.startswith("degree"):
        return load_field(base, int(change.removeprefix("degree ")))
    model = load_field(base)
    return held_back(model) if change == "held back" else carried_on(model) if change == "carried on" else model


def held_back(model: FieldModel) -> FieldModel:
    """The model as it was one whole validity earlier, with its secular variation: IGRF 1975 of 1975.0 in 1980.0."""
    return replace(model, title=f"{model.title}, used as if it were five years ago", knots=_later(model))


def carried_on(model: FieldModel) -> FieldModel:
    """The model with its straight secular variation carried on for one whole validity more."""
    polynomial = model.polynomial_nT.copy()
    polynomial[-1, 1:] *= 2.0
    knots = np.append(model.knots[:-1], _later(model)[-1])
    title = f"{model.title}, its secular variation carried on"
    return replace(model, title=title, knots=knots, polynomial_nT=polynomial)


def _later(model: FieldModel) -> np.ndarray:
    return np.asarray(model.knots + (model.knots[-1] - model.knots[0]))


_DMSP = Rotation.from_matrix([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Spacecraft axes of DMSP from those of the orbit: x down, y forward, z along -orbit normal."""
_DMSP_VARIABLES = ("time", "dB", "position_ecef_60")
_MINUTE = 60  # samples of DMSP from one position to the next
_START = np.datetime64("2020-07-01", "ns")  # the aircraft's file has no date
_LATITUDE_RAD = 0.3  # nor a place
_NODE_S = 60.0  # a recorded position jitters by some 0.05 km; over a minute that is 0.01 deg of the direction of motion


@dataclass(frozen=True)
class Compensation:
    """An aircraft's fluxgate and scalar magnetometer and what the published compensation takes off; N rows."""

    fluxgate_B_nT: FloatArray
    """(N, 3)."""
    raw_nT: FloatArray
    """(N,) scalar magnetometer."""
    taken_nT: FloatArray
    """(N,) the compensation: raw minus compensated."""


def of_track(track: Track, axes: str = "orbit") -> Telemetry:
    """The record of a vector magnetometer along its orbit. axes: "orbit", or "NEC" for north, east, centre."""
    return _of_field(track.time, track.r_E_km, track.b_NEC_nT, axes)


def of_residual_day(path: Path, model: FieldModel) -> Telemetry:
    """Swarm's residual file (geocentric degrees and metres, N, E, C in nT), as the record with that gap to the model.

    Raises BadInput naming file and fault.
    """
    places, residual = ("Latitude", "Longitude", "Radius"), ("N_res", "E_res", "C_res")
    table = opened(path, ("time_utc", *places, *residual))
    latitude_deg, longitude_deg, radius_m = numbers(table, places).T
    radius_km = radius_m / 1e3
    outside = (radius_km <= ORBIT_KM[0]) | (radius_km >= ORBIT_KM[1])
    what, wanted = "has a Radius of {:.6g} km, which is no orbit's", "metres from the centre of the Earth"
    none_wrong(outside, table.where, radius_km, what, wanted)
    time = increasing(parse_iso(table.text("time_utc"), table.where), table.where)
    r_E_km = frames.from_geocentric(np.radians(latitude_deg), np.radians(longitude_deg), radius_km)
    return _of_field(time, r_E_km, field_NEC_nT(model, time, r_E_km) + numbers(table, residual), "orbit")


def of_body_residuals(path: Path, model: FieldModel, hours: float, every: int) -> Telemetry:
    """DMSP's residual file (dB in spacecraft axes, a position for every 60th sample): the first hours of its day.

    Every so many rows, fill values included. Raises BadInput naming file and fault.
    """
    with NetcdfFile(path) as source:
        missing = [name for name in _DMSP_VARIABLES if name not in source.names()]
        if missing:
            raise BadInput(f"no variable {', '.join(missing)}", where=source.where, wanted="dB and position_ecef_60")
        time, body_nT, r_E_km = source.times(), source.numbers("dB"), source.numbers("position_ecef_60")
    if body_nT.shape != (time.size, 3) or r_E_km.shape != (-(-time.size // _MINUTE), 3):
        found = f"shapes {body_nT.shape} and {r_E_km.shape} with {time.size} stamps"
        raise BadInput(found, where=str(path), wanted="dB (N, 3) and a position for every 60th of N samples")
    seconds = epoch.seconds_since(increasing(time, str(path)), time[0])
    nodes = seconds[::_MINUTE]
    rows = np.flatnonzero(seconds <= min(3600.0 * hours, float(nodes[-1])))[::every]
    orbit = CubicSpline(nodes, frames.rotation_EN(time[::_MINUTE]).inv().apply(r_E_km))
    r_N_km, v_N_km_s = orbit(seconds[rows]), orbit.derivative()(seconds[rows])
    R_BN = _DMSP * frames.rotation_ON(r_N_km, v_N_km_s)
    reading = R_BN.apply(field_N_nT(model, time[rows], r_N_km)) + body_nT[rows]
    q_NB = frames.q_from_rotation(R_BN)
    return Telemetry(time=time[rows], mag_B_nT=reading, r_N_km=r_N_km, v_N_km_s=v_N_km_s, q_NB=q_NB)


def read_compensation(path: Path) -> Compensation:
    """The aircraft's file. Raises BadInput naming the fault, as raw less compensation that is not the compensated."""
    names = ("flux_a_x", "flux_a_y", "flux_a_z", "mag_1_uc", "mag_1_comp", "mag_1_c")
    table = opened(path, names)
    values = numbers(table, names)
    apart_nT = np.abs(values[:, 3] - values[:, 4] - values[:, 5]).max()
    if apart_nT > 1e-3:
        found = f"mag_1_uc - mag_1_comp differs from mag_1_c by {apart_nT:.3g} nT"
        raise BadInput(found, where=table.where, wanted="0.001 nT")
    return Compensation(values[:, :3], values[:, 3], values[:, 4])


def of_aircraft(given: Compensation, rate_Hz: float) -> Telemetry:
    """The scalar reading along the fluxgate's direction, without attitude, where the dipole has the compensated size.

    The size of the field is then what the compensation says it is without the aircraft, so that the gap is what the
    aircraft adds along the field, as published; nothing across the field is known.
    """
    compensated_nT = given.raw_nT - given.taken_nT
    time = _START + (np.arange(compensated_nT.size) * 1e9 / rate_Hz).astype("timedelta64[ns]")
    at_reference = _DIPOLE_NT * float(np.sqrt(1.0 + 3.0 * np.sin(_LATITUDE_RAD) ** 2))
    radius_km: FloatArray = FIELD_RADIUS_KM * np.cbrt(at_reference / compensated_nT)
    latitude, longitude = np.full(radius_km.shape, _LATITUDE_RAD), np.zeros(radius_km.shape)
    r_N_km = frames.rotation_EN(time).inv().apply(frames.from_geocentric(latitude, longitude, radius_km))
    direction = given.fluxgate_B_nT / np.linalg.norm(given.fluxgate_B_nT, axis=1)[:, None]
    v_N_km_s = np.gradient(r_N_km, 1.0 / rate_Hz, axis=0)
    return Telemetry(time=time, mag_B_nT=given.raw_nT[:, None] * direction, r_N_km=r_N_km, v_N_km_s=v_N_km_s)


def _of_field(time: TimeArray, r_E_km: FloatArray, field_NEC_nT: FloatArray, axes: str) -> Telemetry:
    """The velocity is the slope of a spline through positions a minute apart."""
    R_EN = frames.rotation_EN(time)
    r_N_km, seconds = R_EN.inv().apply(r_E_km), epoch.seconds_since(time, time[0])
    nodes = [0]
    for row, moment in enumerate(seconds):
        if moment - seconds[nodes[-1]] >= _NODE_S:
            nodes.append(row)
    if len(nodes) > 1 and nodes[-1] != seconds.size - 1:
        nodes[-1] = seconds.size - 1
    v_N_km_s: FloatArray = CubicSpline(seconds[nodes], r_N_km[nodes]).derivative()(seconds)
    R_NEC_N = frames.rotation_NEC_E(r_E_km) * R_EN
    R_BN = R_NEC_N if axes == "NEC" else frames.rotation_ON(r_N_km, v_N_km_s)
    reading, q_NB = (R_BN * R_NEC_N.inv()).apply(field_NEC_nT), frames.q_from_rotation(R_BN)
    return Telemetry(time=time, mag_B_nT=reading, r_N_km=r_N_km, v_N_km_s=v_N_km_s, q_NB=q_NB)
