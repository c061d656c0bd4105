"""Checks that need no field model: stamps, missing and stuck values, orbit geometry, sunlit flags."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.checks.report import Finding, note, trap
from fluxtwin.calib.checks.stuck import length_s, runs
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.telemetry.build import velocity_from_positions
from fluxtwin.sim.telemetry.record import Telemetry

FEWEST_SAMPLES = 13
"""One more than the 12 parameters of b and S: below, nothing can be calibrated and left over."""
FEW_SAMPLES = 150
"""The smallest record the estimators are built and tested for."""
LOWEST_ORBIT_KM = 6430.0
"""Below about 70 km altitude nothing orbits; a smaller radius is no position."""
FASTEST_KM_S, HELD_KM = 11.2, 1000.0
"""What leaves the Earth from its surface, and two minutes of orbit, by which a position that was held may jump."""
FLAG_S, FLAG_ROWS = 120.0, 3
"""Shadow edges are uncertain by some tens of seconds (air, flattening, slow flags); longer is a contradiction."""
VELOCITY_RATIO = 0.02
"""Velocity against the derivative of position; Earth-fixed velocity labelled as inertial is off by 6 %."""
_MAX_ROWS = 4000
GAP_STEPS = 5.0
"""A step between stamps that is so many times the usual one is a gap."""


def check_readings(telemetry: Telemetry) -> list[Finding]:
    """Whether there are readings enough."""
    if not telemetry.has_reading.any():
        blank = [axis for axis, one in zip("xyz", telemetry.mag_B_nT.T, strict=True) if np.isnan(one).all()]
        return [trap("no_readings", axes=", ".join(blank) or "one or another")]
    missing, usable = _missing_rows(telemetry, "magnetometer", telemetry.has_reading), int(telemetry.has_reading.sum())
    if usable < FEWEST_SAMPLES:
        return [trap("too_few_samples", count=usable), *missing]
    if usable < FEW_SAMPLES:
        return [note("few_samples", count=usable, wanted=FEW_SAMPLES), *missing]
    return missing


def check_motion(telemetry: Telemetry) -> tuple[list[Finding], BoolArray]:
    """The checks that need no magnetometer: steps of time, positions, velocity, sunlit flag; and the rows (N,) whose
    position cannot be.

    What follows from wrong positions is not named beside them.
    """
    away = _unreachable(telemetry)
    findings = _steps(telemetry)
    if telemetry.r_N_km is not None:
        findings += _missing_rows(telemetry, "position", telemetry.has_position)
    if telemetry.q_NB is not None:
        findings += _missing_rows(telemetry, "attitude", telemetry.has_attitude)
    positions = _positions(telemetry, np.flatnonzero(away))
    if not positions and telemetry.sunlit is not None and telemetry.r_N_km is not None:
        positions = check_sunlit(telemetry.time, np.array(telemetry.r_N_km), np.array(telemetry.sunlit))
    return [*findings, *positions], away


def check_sunlit(time: TimeArray, r_N_km: FloatArray, sunlit: FloatArray) -> list[Finding]:
    """A sunlit flag that contradicts geometry for more than two minutes on end."""
    known = np.isfinite(r_N_km).all(axis=1) & np.isfinite(sunlit)
    seen = np.full(len(time), np.nan)
    if known.any():
        seen[known] = sun.illumination(r_N_km[known], sun.sun_N_km(time[known]))
    contradictions = []
    for wrong, said, truly in (
        ((sunlit == 0) & (seen > 0.99), "shadow", "sunlit"),
        ((sunlit == 1) & (seen < 0.01), "sunlit", "shadow"),
    ):
        found = [run for run in runs(wrong, time) if length_s(time, run) >= FLAG_S and np.ptp(run) >= FLAG_ROWS - 1]
        contradictions += [(run, f"{said} where geometry says {truly}") for run in found]
    if not contradictions:
        return []
    contradictions.sort(key=lambda one: int(one[0][0]))
    spans = ", ".join(
        f"{words}: {epoch.iso(time[run[0]])} to {epoch.iso(time[run[-1]])}" for run, words in contradictions[:5]
    )
    spans += " and more" if len(contradictions) > 5 else ""
    rows = [np.arange(first, last + 1) for (first, last), _ in contradictions]
    return [trap("sunlit_flag", np.concatenate(rows), spans=spans)]


def _steps(telemetry: Telemetry) -> list[Finding]:
    findings: list[Finding] = []
    if len(telemetry) < 3:
        return findings
    step = np.diff(telemetry.time.astype("int64")) * 1e-9
    usual = float(np.median(step))
    gaps = np.flatnonzero(step > GAP_STEPS * usual)
    if gaps.size:
        findings.append(note("gaps", gaps, count=gaps.size, usual=usual, longest=step.max()))
    steady = np.abs(step - usual) < 0.01 * usual
    slips = np.flatnonzero(~steady & (step < 1.5 * usual))
    if slips.size and steady.mean() > 0.9:
        worst = float(np.abs(step[slips] - usual).max())
        findings.append(note("clock_slips", slips, count=slips.size, usual=usual, worst=worst))
    return findings


def _missing_rows(telemetry: Telemetry, name: str, present: BoolArray) -> list[Finding]:
    rows = np.flatnonzero(~present)
    return [note(f"missing_{name}", rows, count=rows.size, rows=len(telemetry))] if rows.size else []


def _positions(telemetry: Telemetry, away: np.ndarray) -> list[Finding]:
    if telemetry.r_N_km is None:
        return []
    r, time = np.array(telemetry.r_N_km), telemetry.time
    size = np.linalg.norm(r, axis=1)
    low = np.flatnonzero(size < LOWEST_ORBIT_KM)
    if low.size:
        zero = (
            " (zero often means that there was no fix; in a column map: invalid = [0])"
            if (size[low] < 1.0).any()
            else ""
        )
        first = {"lowest": LOWEST_ORBIT_KM, "size": size[low[0]], "zero": zero}
        return [trap("position_inside_earth", low, count=low.size, **first)]
    if away.size:
        return [trap("position_jumps", away, count=away.size, fill=_fill_of_positions(r[away]))]
    return [*_orbit_plane(time, r), *_velocity(telemetry, r)]


def _unreachable(telemetry: Telemetry) -> BoolArray:
    """(N,) rows whose position nothing in orbit could reach from that of most others: faster than it leaves the Earth."""
    out = np.zeros(len(telemetry), dtype=np.bool_)
    known = np.flatnonzero(telemetry.has_position)
    if known.size < 3 or telemetry.r_N_km is None:
        return out
    seconds, r_km = (telemetry.time[known] - telemetry.time[0]) / np.timedelta64(1, "s"), telemetry.r_N_km[known]

    def far(one: np.ndarray, other: np.ndarray) -> BoolArray:
        reach_km = FASTEST_KM_S * np.abs(seconds[other] - seconds[one]) + HELD_KM
        return np.asarray(np.linalg.norm(r_km[other] - r_km[one], axis=1) > reach_km)

    row = np.arange(known.size)
    stretch = np.concatenate([[0], np.cumsum(far(row[:-1], row[1:]))])
    counts = np.bincount(stretch)
    good = stretch == counts.argmax()
    for one in np.argsort(-counts, kind="stable")[1:]:
        own, near = row[stretch == one], row[good]
        after = int(np.searchsorted(near, own[0]))
        before, ends = near[max(after - 1, 0) : after], near[after : after + 1]
        good[own] = not (far(before, own[: before.size]).any() or far(ends, own[-1:][: ends.size]).any())
    if good.sum() > known.size / 2:  # else unit or frame are wrong, and not single rows
        out[known[~good]] = True
    return out


def _fill_of_positions(r_km: FloatArray) -> str:
    """A sentence where one number stands in a component of several of the rows (n, 3); else empty."""
    for part in r_km.T:
        values, counts = np.unique(part, return_counts=True)
        if counts.max() > 1:
            return f"In {counts.max()} of them one component is {values[counts.argmax()]:.10g} km, a fill value. "
    return ""


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
        return [trap("position_frame", as_is=as_is, hours=hours, fixed=as_earth_fixed)]
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
    return [trap("velocity_frame", off=100 * off)]
