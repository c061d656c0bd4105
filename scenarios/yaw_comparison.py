"""Yaw by the magnetometer beside yaw by the sun sensor, as the papers' figures 1 to 3 show it."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.attitude.yaw import AVERAGE_S, YawSolution, average_yaw
from fluxtwin.plots.yaw import YawComparison
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.telemetry.record import Telemetry

NEAR_NODE_DEG = 10.0


def compare_yaw(telemetry: Telemetry, solution: YawSolution) -> YawComparison:
    """The record of a figure: `solution` of the N rows of `telemetry`, which has an orbit; M windows of AVERAGE_S.

    A window is NaN in `mean_sun_deg` where a sample of it has no reference attitude.
    """
    assert telemetry.r_N_km is not None
    change = np.diff(telemetry.mag_B_nT[solution.rows], axis=0, prepend=telemetry.mag_B_nT[solution.rows[:1]]) != 0
    r_E_km = frames.rotation_EN(solution.time).apply(np.array(telemetry.r_N_km)[solution.rows])
    latitude_rad = average_yaw(solution.time, frames.geocentric(r_E_km)[0], AVERAGE_S).yaw_rad
    return YawComparison(
        minutes=epoch.seconds_since(solution.time, solution.time[0]) / 60.0,
        sun_deg=np.degrees(solution.yaw_reference_rad),
        magnetometer_deg=np.degrees(solution.yaw_first_order_rad),
        change_x=change[:, 0],
        change_y=change[:, 1],
        mean_minutes=epoch.seconds_since(solution.averages.time, solution.time[0]) / 60.0,
        mean_deg=np.degrees(solution.averages.yaw_rad),
        mean_sun_deg=np.degrees(average_yaw(solution.time, solution.yaw_reference_rad, AVERAGE_S).yaw_rad),
        near_node=np.abs(latitude_rad) < np.radians(NEAR_NODE_DEG),
        window_s=AVERAGE_S,
    )
