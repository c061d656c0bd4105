"""Telemetry from what flew.

Body axes are those of the orbit (x forward, y against the orbit normal, z to nadir) wherever a file gives the field in
geocentric axes: that is how these satellites fly, and the attitude is then exact by construction. A file that has
residuals only is made whole again with IGRF-14, so that its gap is what the file says.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.flight_field.tracks import Track
from fluxtwin.scenarios.flight_gaps.models import dipole, dipole_radius_km
from fluxtwin.scenarios.flight_gaps.readers import BodyResiduals, Compensation, ResidualDay
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field import field_N_nT, field_NEC_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

_DMSP = Rotation.from_matrix([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Spacecraft axes of DMSP from those of the orbit: x down, y forward, z along -orbit normal."""
_START = np.datetime64("2020-07-01", "ns")  # the aircraft's file has no date
_LATITUDE_RAD = 0.3  # nor a place
_NODE_S = 60.0  # a recorded position jitters by some 0.05 km; over a minute that is 0.01 deg of the direction of motion


def of_track(track: Track, axes: str = "orbit") -> Telemetry:
    """The record of a vector magnetometer along its orbit. axes: "orbit", or "NEC" for north, east, centre."""
    return _of_field(track.time, track.r_E_km, track.b_NEC_nT, axes)


def of_residual_day(day: ResidualDay, model: FieldModel) -> Telemetry:
    """The record whose gap to the model is the residual of the file."""
    field_NEC = field_NEC_nT(model, day.time, day.r_E_km)
    return _of_field(day.time, day.r_E_km, field_NEC + day.NEC_nT, "orbit")


def of_body_residuals(day: BodyResiduals, model: FieldModel, hours: float, every: int) -> Telemetry:
    """The first hours of a day in spacecraft axes, every so many rows, fill values and all."""
    seconds = epoch.seconds_since(day.time, day.time[0])
    nodes = epoch.seconds_since(day.position_time, day.time[0])
    rows = np.flatnonzero(seconds <= min(3600.0 * hours, float(nodes[-1])))[::every]
    orbit = CubicSpline(nodes, frames.rotation_EN(day.position_time).inv().apply(day.r_E_km))
    time, r_N_km, v_N_km_s = day.time[rows], orbit(seconds[rows]), orbit.derivative()(seconds[rows])
    R_BN = _DMSP * frames.rotation_ON(r_N_km, v_N_km_s)
    reading = R_BN.apply(field_N_nT(model, time, r_N_km)) + day.body_nT[rows]
    return Telemetry(
        time=time, mag_B_nT=reading, r_N_km=r_N_km, v_N_km_s=v_N_km_s, q_NB=frames.q_from_rotation(R_BN)
    )  # fmt: skip


def of_aircraft(given: Compensation, rate_Hz: float) -> Telemetry:
    """The scalar reading along the fluxgate's direction, without attitude, where the dipole has the compensated size.

    The size of the field is then what the compensation says it is without the aircraft, so that the gap is what the
    aircraft adds along the field, as published; nothing across the field is known, nor judged.
    """
    compensated_nT = given.raw_nT - given.taken_nT
    time = _START + (np.arange(compensated_nT.size) * 1e9 / rate_Hz).astype("timedelta64[ns]")
    radius_km = dipole_radius_km(compensated_nT, _LATITUDE_RAD, FIELD_RADIUS_KM)
    latitude, longitude = np.full(radius_km.shape, _LATITUDE_RAD), np.zeros(radius_km.shape)
    r_E_km = frames.from_geocentric(latitude, longitude, radius_km)
    r_N_km = frames.rotation_EN(time).inv().apply(r_E_km)
    direction = given.fluxgate_B_nT / np.linalg.norm(given.fluxgate_B_nT, axis=1)[:, None]
    v_N_km_s = np.gradient(r_N_km, 1.0 / rate_Hz, axis=0)
    return Telemetry(time=time, mag_B_nT=given.raw_nT[:, None] * direction, r_N_km=r_N_km, v_N_km_s=v_N_km_s)


def aircraft_model() -> FieldModel:
    """The model in which `of_aircraft` has its place."""
    return dipole()


def _of_field(time: TimeArray, r_E_km: FloatArray, field_NEC_nT: FloatArray, axes: str) -> Telemetry:
    R_EN = frames.rotation_EN(time)
    r_N_km = R_EN.inv().apply(r_E_km)
    seconds = epoch.seconds_since(time, time[0])
    v_N_km_s = _velocity_km_s(seconds, r_N_km)
    R_NEC_N = frames.rotation_NEC_E(r_E_km) * R_EN
    R_BN = R_NEC_N if axes == "NEC" else frames.rotation_ON(r_N_km, v_N_km_s)
    reading = (R_BN * R_NEC_N.inv()).apply(field_NEC_nT)
    return Telemetry(
        time=time, mag_B_nT=reading, r_N_km=r_N_km, v_N_km_s=v_N_km_s, q_NB=frames.q_from_rotation(R_BN)
    )  # fmt: skip


def _velocity_km_s(seconds: FloatArray, r_N_km: FloatArray) -> FloatArray:
    """(N, 3) slope of the spline through positions a minute apart."""
    nodes = [0]
    for row, moment in enumerate(seconds):
        if moment - seconds[nodes[-1]] >= _NODE_S:
            nodes.append(row)
    if len(nodes) > 1 and nodes[-1] != seconds.size - 1:
        nodes[-1] = seconds.size - 1
    velocity: FloatArray = CubicSpline(seconds[nodes], r_N_km[nodes]).derivative()(seconds)
    return velocity
