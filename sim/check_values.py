"""Checks that need no field model: stamps, missing and stuck values, orbit geometry, sunlit flags."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim import epoch, frames, sun
from fluxtwin.sim.check_report import Finding, note, trap
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.telemetry_build import velocity_from_positions
from fluxtwin.sim.types import BoolArray, FloatArray, TimeArray

FEWEST_SAMPLES = 13
"""One more than the 12 parameters of b and S: below, nothing can be calibrated and left over."""
FEW_SAMPLES = 150
"""The smallest record the estimators are built and tested for."""
LOWEST_ORBIT_KM = 6430.0
"""Below about 70 km altitude nothing orbits; a smaller radius is no position."""
STUCK_S, STUCK_ROWS = 60.0, 10
"""Shorter runs of one reading come from coarse steps or fast sampling."""
STUCK_STEPS = 3.0
"""A run is stuck when elsewhere 95 % of the changes over the same number of rows exceed this many least steps."""
FLAG_S, FLAG_ROWS = 120.0, 3
"""Shadow edges are uncertain by some tens of seconds (air, flattening, slow flags); longer is a contradiction."""
VELOCITY_RATIO = 0.02
"""Velocity against the derivative of position; Earth-fixed velocity sold as inertial is off by 6 %."""
_MAX_ROWS = 4000


def check_values(telemetry: Telemetry) -> list[Finding]:
    """All checks of this module."""
    readings = [*_usable(telemetry), *_missing_rows(telemetry, "magnetometer", telemetry.has_reading)]
    if not telemetry.has_reading.any():
        readings = [trap("no_readings", "every magnetometer reading is missing (blank or NaN)"), *readings[:1]]
    return [*readings, *_constant(telemetry), *_stuck(telemetry), *check_motion(telemetry)]


def check_motion(telemetry: Telemetry) -> list[Finding]:
    """The checks that need no magnetometer: steps of time, positions, velocity, sunlit flag."""
    findings = [*_steps(telemetry), *_missing(telemetry), *_positions(telemetry)]
    if telemetry.sunlit is not None and telemetry.r_N_km is not None:
        findings += check_sunlit(telemetry.time, np.array(telemetry.r_N_km), np.array(telemetry.sunlit))
    return findings


def check_sunlit(time: TimeArray, r_N_km: FloatArray, sunlit: FloatArray) -> list[Finding]:
    """A sunlit flag that contradicts geometry for more than two minutes on end."""
    known = np.isfinite(r_N_km).all(axis=1) & np.isfinite(sunlit)
    seen = np.full(len(time), np.nan)
    if known.any():
        seen[known] = sun.illumination(r_N_km[known], sun.sun_N_km(time[known]))
    findings = []
    for code, wrong, said, truly in (
        ("sunlit_flag", (sunlit == 0) & (seen > 0.99), "shadow", "sunlit"),
        ("sunlit_flag", (sunlit == 1) & (seen < 0.01), "sunlit", "shadow"),
    ):
        runs = [run for run in _runs(wrong, time) if _length_s(time, run) >= FLAG_S and run.size >= FLAG_ROWS]
        if runs:
            spans = ", ".join(f"{epoch.iso(time[run[0]])} to {epoch.iso(time[run[-1]])}" for run in runs[:5])
            findings.append(
                trap(
                    code,
                    f"the sunlit flag says {said} where geometry says {truly}: {spans}"
                    f"{' and more' if len(runs) > 5 else ''}. Leave the column out (it is then computed) or mend it",
                    np.concatenate(runs),
                )
            )
    return findings


def _usable(telemetry: Telemetry) -> list[Finding]:
    usable = int(telemetry.has_reading.sum())
    if usable < FEWEST_SAMPLES:
        text = f"{usable} rows have a reading; b and S alone are 12 unknowns. Give a longer record"
        return [trap("too_few_samples", text)]
    if usable < FEW_SAMPLES:
        return [note("few_samples", f"{usable} rows have a reading; {FEW_SAMPLES} or more are recommended")]
    return []


def _steps(telemetry: Telemetry) -> list[Finding]:
    findings: list[Finding] = []
    if len(telemetry) < 3:
        return findings
    step = np.diff(telemetry.time.astype("int64")) * 1e-9
    usual = float(np.median(step))
    gaps = np.flatnonzero(step > 5.0 * usual)
    if gaps.size:
        findings.append(
            note("gaps", f"{gaps.size} gaps longer than 5 steps of {usual:g} s; longest {step.max():g} s", gaps)
        )
    steady = np.abs(step - usual) < 0.01 * usual
    slips = np.flatnonzero(~steady & (step < 1.5 * usual))
    if slips.size and steady.mean() > 0.9:
        worst = float(np.abs(step[slips] - usual).max())
        findings.append(
            note(
                "clock_slips",
                f"{slips.size} steps are off the usual {usual:g} s by up to {worst:.3g} s (clock slips): readings "
                "there may be stamped wrongly",
                slips,
            )
        )
    return findings


def _missing(telemetry: Telemetry) -> list[Finding]:
    findings: list[Finding] = []
    columns = {}
    if telemetry.r_N_km is not None:
        columns["position"] = telemetry.has_position
    if telemetry.q_NB is not None:
        columns["attitude"] = telemetry.has_attitude
    for name, present in columns.items():
        findings += _missing_rows(telemetry, name, present)
    return findings


def _missing_rows(telemetry: Telemetry, name: str, present: BoolArray) -> list[Finding]:
    rows = np.flatnonzero(~present)
    text = f"{rows.size} of {len(telemetry)} rows have no {name}"
    return [note(f"missing_{name}", text, rows)] if rows.size else []


def _constant(telemetry: Telemetry) -> list[Finding]:
    values = telemetry.mag_B_nT[telemetry.has_reading]
    if len(values) < FEWEST_SAMPLES:
        return []
    spread = np.ptp(values, axis=0)
    if (spread == 0).all():
        return [trap("constant_field", "the magnetometer never changes: the reading is stuck or a placeholder")]
    if spread.max() < 20.0 * _least_step(values):
        return []
    return [
        trap("stuck_axis", f"mag_{'xyz'[axis]} is {values[0, axis]:g} nT in every row while other axes change")
        for axis in np.flatnonzero(spread == 0)
    ]


def _stuck(telemetry: Telemetry) -> list[Finding]:
    """Runs of unchanged readings of all three axes, long enough that the field must have changed."""
    mag, time = telemetry.mag_B_nT, telemetry.time
    if int(telemetry.has_reading.sum()) < FEWEST_SAMPLES or not np.ptp(mag[telemetry.has_reading], axis=0).any():
        return []
    same = np.zeros(len(mag), dtype=bool)
    same[1:] = (mag[1:] == mag[:-1]).all(axis=1)
    runs = [run for run in _runs(same, time) if run.size >= STUCK_ROWS and _length_s(time, run) >= STUCK_S]
    least = _least_step(mag)
    runs = [run for run in runs if _must_have_changed(mag, same, run.size, least)]
    if not runs:
        return []
    longest = max(_length_s(time, run) for run in runs)
    text = (
        f"the reading does not change for up to {longest:g} s ({len(runs)} stretch{'es' if len(runs) > 1 else ''})"
        ": stuck values. Blank those cells"
    )
    return [trap("stuck_values", text, np.concatenate(runs))]


def _must_have_changed(mag: FloatArray, same: np.ndarray, rows: int, least_step_nT: float) -> bool:
    """Whether the reading practically always changes over that many rows, runs of one value left out."""
    rows = min(rows, len(mag) // 2)
    start = np.arange(0, len(mag) - rows, max(1, len(mag) // 20_000))  # a sample is enough for a percentile
    start = start[~(same[start + rows] & same[start])]
    change = np.linalg.norm(mag[start + rows] - mag[start], axis=1)
    change = change[np.isfinite(change)]
    return change.size >= STUCK_ROWS and float(np.percentile(change, 5)) > STUCK_STEPS * least_step_nT


def _least_step(mag: FloatArray) -> float:
    """Smallest change [nT] seen between neighbouring rows of an axis: the LSB, or less."""
    step = np.abs(np.diff(mag, axis=0))
    step = step[np.isfinite(step) & (step > 0)]
    return float(step.min()) if step.size else 0.0


def _positions(telemetry: Telemetry) -> list[Finding]:
    if telemetry.r_N_km is None:
        return []
    r, time = np.array(telemetry.r_N_km), telemetry.time
    size = np.linalg.norm(r, axis=1)
    low = np.flatnonzero(size < LOWEST_ORBIT_KM)
    if low.size:
        zero = " (zero often means that there was no fix)" if (size[low] < 1.0).any() else ""
        return [
            trap(
                "position_inside_earth",
                f"{low.size} positions lie below {LOWEST_ORBIT_KM:g} km from the Earth's centre, the first at "
                f"{size[low[0]]:.6g} km{zero}. Blank them, or state the unit and frame in a column map",
                low,
            )
        ]
    return [*_orbit_plane(time, r), *_velocity(telemetry, r)]


def _orbit_plane(time: TimeArray, r_N_km: FloatArray) -> list[Finding]:
    """Positions in Earth-fixed axes under an inertial name: the orbit plane then turns once a day."""
    rows = np.flatnonzero(np.isfinite(r_N_km).all(axis=1))[:_MAX_ROWS]
    v = velocity_from_positions(time[rows], r_N_km[rows])
    rows_v = np.flatnonzero(np.isfinite(v).all(axis=1))
    if rows_v.size < 10:
        return []
    t, r = time[rows][rows_v], r_N_km[rows][rows_v]
    as_is = _plane_wander(r, v[rows_v])
    turned = frames.rotation_EN(t).apply(r, inverse=True)
    v_turned = velocity_from_positions(t, turned)
    good = np.isfinite(v_turned).all(axis=1)
    as_earth_fixed = _plane_wander(turned[good], v_turned[good])
    hours = float((t[-1] - t[0]).astype("int64")) / 3.6e12
    if as_is > 0.3 + 0.35 * hours and as_earth_fixed < as_is / 3.0:  # J2 turns a node by at most 0.35 deg/h
        return [
            trap(
                "position_frame",
                f"the orbit plane wanders by {as_is:.2f} deg rms in {hours:.2g} h; read as Earth-fixed positions it "
                f"stays within {as_earth_fixed:.3f} deg. Name the columns ecef_x_km ecef_y_km ecef_z_km",
            )
        ]
    return []


def _plane_wander(r: FloatArray, v: FloatArray) -> float:
    """Rms angle [deg] of the orbit normals from their mean."""
    normal = np.cross(r, v)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    mean = normal.mean(axis=0)
    mean /= np.linalg.norm(mean)
    return float(np.degrees(np.sqrt(np.mean(np.sum((normal - mean) ** 2, axis=1)))))


def _velocity(telemetry: Telemetry, r_N_km: FloatArray) -> list[Finding]:
    if telemetry.v_N_km_s is None:
        return []
    rows = slice(0, _MAX_ROWS)
    v = np.array(telemetry.v_N_km_s[rows])
    derived = velocity_from_positions(telemetry.time[rows], r_N_km[rows])
    good = np.isfinite(v).all(axis=1) & np.isfinite(derived).all(axis=1)
    step = np.diff(telemetry.time[rows].astype("int64")) * 1e-9
    if good.sum() < 10 or np.median(step) > 150.0:
        return []
    off = float(
        np.median(np.linalg.norm(v[good] - derived[good], axis=1)) / np.median(np.linalg.norm(derived[good], axis=1))
    )
    if off <= VELOCITY_RATIO:
        return []
    return [
        trap(
            "velocity_frame",
            f"the velocity differs from the derivative of the position by {100 * off:.1f} % (median): another frame "
            "(Earth-fixed velocity differs by about 6 %), unit or time. Leave the velocity out, or map its frame",
        )
    ]


def _runs(mask: np.ndarray, time: TimeArray) -> list[np.ndarray]:
    """Stretches of rows where `mask` holds, broken at gaps of more than five usual steps."""
    rows = np.flatnonzero(mask)
    if rows.size == 0:
        return []
    step = np.diff(time.astype("int64"))
    usual = int(np.median(step)) if step.size else 0
    breaks = (np.diff(rows) > 1) | (np.diff(time[rows].astype("int64")) > 5 * usual)
    return list(np.split(rows, np.flatnonzero(breaks) + 1))


def _length_s(time: TimeArray, run: np.ndarray) -> float:
    return float((time[run[-1]] - time[run[0]]).astype("int64")) * 1e-9
