"""Table 5: the 43 passes as the ground sees them after calibration, beside the printed rows; the dawn passes many times.

Samples are those of the simulated flight in the window that each pass's printed sun-nadir range fixes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.flights import Numbers, prescribed, rms, rms_along
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.mission import Flight, quantity
from fluxtwin.scenarios.hcmm_orbit.geometry import PassWindows
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

ANOMALOUS = (11, 12, 13, 34)
"""Rows whose printed residual exceeds 3 mG."""
LIMIT_MG = quantity("residual limit")
DAWN_FLIGHTS = 40


def column_of(rows: Sequence[Numbers] | Sequence[Pass], name: str) -> FloatArray:
    """(43,) of our rows or the printed ones, NaN where there is none."""
    return np.array([np.nan if getattr(row, name) is None else getattr(row, name) for row in rows], dtype=np.float64)


def rms_of(rows: Sequence[Numbers] | Sequence[Pass], name: str, chosen: BoolArray) -> float:
    """Root mean square over chosen passes, as the last lines of the table."""
    return float(rms(column_of(rows, name)[chosen]))


def run_passes(
    flight: Flight, calibration: Calibration, ground: FieldModel, windows: PassWindows, others: FloatArray
) -> Numbers:
    """Ours of all 43 passes. others: (R, 12) S row by row and b [mG] of other calibrations."""
    passes, telemetry = read_passes(), flight.telemetry
    model_nT = np.linalg.norm(field_N_nT(ground, flight.world.time, flight.world.r_N_km), axis=1)
    inside = [rows_of(telemetry, item, windows, k) for k, item in enumerate(passes)]

    def eps_mG(strength_nT: FloatArray) -> list[float]:
        return [rms((strength_nT - model_nT)[rows]) / NT_PER_MG for rows in inside]

    found = [
        eps_mG(
            np.linalg.norm(Calibration(one[:9].reshape(3, 3), one[9:] * NT_PER_MG).apply(telemetry.mag_B_nT), axis=1)
        )
        for one in others
    ]
    dawn, sunlit = (np.array([getattr(item, name) for item in passes]) for name in ("dawn", "sunlit"))
    return Numbers(
        passes=passes,
        rows=rows_of_passes(telemetry, calibration, ground, windows),
        # (43,) rms of the error of IGRF 1975 in field strength along each pass: no simulation, only two field models.
        field_model_eps_mG=np.array(eps_mG(np.linalg.norm(flight.world.field_N_nT, axis=1))),
        # (43, 2) 5 and 95 % of our residual over calibrations made with other passes: the choice of 1978 is not known.
        eps_range_mG=np.percentile(found, [5.0, 95.0], axis=0).T,
        # (43,) all passes; the 39 of the first rms line; the five dawn passes over Orroral; those with printed sun-field
        # angles; the 19 of these that are not at dawn.
        everything=np.ones(len(passes), dtype=bool),
        quiet=np.array([item.number not in ANOMALOUS for item in passes]),
        dawn=dawn,
        sunlit=sunlit,
        lit=sunlit & ~dawn,
    )


def rows_of_passes(
    telemetry: Telemetry, calibration: Calibration, ground: FieldModel, windows: PassWindows
) -> tuple[Numbers, ...]:
    """Ours of all 43 passes, from the telemetry alone."""
    compared = compare(telemetry, calibration, ground)
    return tuple(_row(item, compared, rows_of(telemetry, item, windows, k)) for k, item in enumerate(read_passes()))


def sun_nadir_deg(telemetry: Telemetry) -> FloatArray:
    """(N,) measured less computed angle between sun and nadir; NaN where a sensor gives nothing."""
    assert telemetry.r_N_km is not None and telemetry.nadir_B is not None and telemetry.sun_B is not None
    r_N_km = np.array(telemetry.r_N_km)
    computed = frames.angle_between(-r_N_km, sun.sun_direction_N(telemetry.time, r_N_km))
    return np.asarray(np.degrees(frames.angle_between(telemetry.sun_B, telemetry.nadir_B) - computed))


def compare(telemetry: Telemetry, calibration: Calibration, ground: FieldModel) -> Numbers:
    """Equation 19 of the conference paper, sample by sample: measured less computed, NaN where a sensor gives nothing."""
    assert telemetry.r_N_km is not None and telemetry.nadir_B is not None and telemetry.sun_B is not None
    field_B = calibration.apply(telemetry.mag_B_nT)
    r_N_km = np.array(telemetry.r_N_km)
    model_N = field_N_nT(ground, telemetry.time, r_N_km)
    sun_N = sun.sun_direction_N(telemetry.time, r_N_km)
    pairs = {"sun_field": (sun_N, model_N), "nadir_field": (-r_N_km, model_N), "sun_nadir": (-r_N_km, sun_N)}
    computed_deg = {name: np.degrees(frames.angle_between(*pair)) for name, pair in pairs.items()}
    return Numbers(
        # [nT] Field strength, and [deg] angles; what orbit and model give for these.
        magnitude_nT=np.linalg.norm(field_B, axis=1) - np.linalg.norm(model_N, axis=1),
        sun_field=np.degrees(frames.angle_between(telemetry.sun_B, field_B)) - computed_deg["sun_field"],
        nadir_field=np.degrees(frames.angle_between(telemetry.nadir_B, field_B)) - computed_deg["nadir_field"],
        sun_nadir=sun_nadir_deg(telemetry),
        computed_deg=computed_deg,
    )


def rows_of(telemetry: Telemetry, item: Pass, windows: PassWindows, k: int) -> np.ndarray:
    """Rows of the telemetry in the window of pass number k of the table (from 0)."""
    minutes = epoch.seconds_since(telemetry.time, item.aos) / 60.0
    return np.flatnonzero((minutes >= windows.start_min[k]) & (minutes <= windows.end_min[k]))


def _row(item: Pass, found: Numbers, rows: np.ndarray) -> Numbers:
    """Ours of one pass, with the names of `Pass`; angles in deg, None where the sun is not seen."""
    seen = np.isfinite(found.sun_field[rows]).any() and item.sunlit
    ranges = {name: (float(v[rows].min()), float(v[rows].max())) for name, v in found.computed_deg.items()}
    return Numbers(
        samples=int(rows.size),
        eps_M_mG=rms(found.magnitude_nT[rows]) / NT_PER_MG,
        sun_field=ranges["sun_field"] if item.sunlit else None,
        delta_sun_field_deg=rms(found.sun_field[rows]) if seen else None,
        nadir_field=ranges["nadir_field"],
        delta_nadir_field_deg=rms(found.nadir_field[rows]),
        sun_nadir=ranges["sun_nadir"],
        delta_sun_nadir_deg=rms(found.sun_nadir[rows]) if seen else None,
    )


def run_dawn(config: Scenario, windows: PassWindows, flights: int = DAWN_FLIGHTS) -> Numbers:
    """The sun-nadir residual that a turned head 1 leaves in the dawn passes over Orroral, in the prescribed motion.

    Only the end of such a pass is sunlit, a minute or three, so one flight's residual scatters by a sixth. The windows are
    flown again with other seeds of sensors and motion, every row seeing what it can; the claim is about the mean.
    """
    passes = read_passes()
    dawn = [k for k, item in enumerate(passes) if item.dawn]
    assert config.schedule is not None
    step_s = config.schedule.segments[0].step_s
    segments = [
        {
            "start_utc": f"{epoch.add_seconds(passes[k].aos, 60.0 * windows.start_min[k])[0]}Z",
            "duration_min": float(windows.end_min[k] - windows.start_min[k]),
            "step_s": step_s,
        }
        for k in dawn
    ]
    plain = prescribed(config).updated({"schedule.segments": segments, "schedule.in_view_of_stations": None})
    residual, samples, world = np.full((flights, len(dawn)), np.nan), [0] * len(dawn), build_world(plain)
    for number in range(flights):
        telemetry = mission.fly(plain.updated({"seed": config.seed + 1 + number}), world).telemetry
        away = sun_nadir_deg(telemetry)
        for place, k in enumerate(dawn):
            inside = away[rows_of(telemetry, passes[k], windows, k)]
            samples[place] = int(np.isfinite(inside).sum())
            if samples[place]:
                residual[number, place] = rms(inside)
    labels, seen = [passes[k].label for k in dawn], residual[:, np.array(samples) > 0]
    mean_deg, each = seen.mean(axis=0), rms_along(seen, axis=1)
    means = iter(mean_deg.tolist())
    return Numbers(
        # Of the dawn passes: their samples with the sun in view, 0 where the sun rises as the window ends.
        labels=labels,
        samples=samples,
        # (flights, passes) rms of measured less computed sun-nadir angle; NaN where there is no sample.
        residual_deg=residual,
        # Of the passes that see the sun: mean over the flights, and its standard error; and the mean, else None, by pass.
        mean_deg=mean_deg,
        standard_error_deg=seen.std(axis=0, ddof=1) / np.sqrt(flights),
        by_label={label: next(means) if count else None for label, count in zip(labels, samples, strict=True)},
        # rms over the passes of one flight: mean and standard deviation over the flights.
        together_deg=(float(each.mean()), float(each.std(ddof=1))),
    )
