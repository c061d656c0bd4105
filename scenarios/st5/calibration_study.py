"""The hour calibrated three ways: not at all, by the abstract's iteration, by one batch.

The first two run the filter with the settings that the printed errors before calibration choose (`open_settings`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.spin.calibrate import SpinFit, SpinOptions, fit_spin, scalar_start
from fluxtwin.calib.spin.rows import SpinRows, assemble_spin
from fluxtwin.calib.spin.sedlak import iterate
from fluxtwin.calib.spin.start import blind_start
from fluxtwin.scenarios.flights import Flight
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.mission import attitude_error_deg
from fluxtwin.scenarios.st5.open_settings import Search, Setting, filtered, search, settings
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel


@dataclass(frozen=True)
class Solved:
    """One way: the fit where there is one, and the attitude's error."""

    fit: SpinFit | None
    error_deg: FloatArray
    """(N, 3) about body x, y, z, at the readings."""
    nis: float
    """Mean squared innovation (iterative, none) or residual (batch) of the field over its noise."""

    @property
    def rms_deg(self) -> FloatArray:
        """(3,) over the hour."""
        return np.asarray(np.sqrt((self.error_deg**2).mean(axis=0)), dtype=np.float64)

    @property
    def rss_deg(self) -> float:
        """Root sum of squares of the three."""
        return float(np.sqrt((self.rms_deg**2).sum()))


@dataclass(frozen=True)
class Hour:
    """All of one run."""

    flight: Flight
    rows: SpinRows
    search: Search
    before: Solved
    """Readings as they come, the filter with the settings that the printed errors before calibration choose."""
    steps_alone: Solved
    """The abstract's three steps with those settings, without the regression at the end."""
    alone: Calibration
    """What they give; no covariance."""
    iterative: Solved
    """The steps with no process noise and the sun's own noise, and our regression after them."""
    batch: Solved


def options(method: str) -> SpinOptions:
    """The abstract's inputs: noise of the sensors, and for the iteration the inertia."""
    printed, known = mission.published(), mission.noises()
    inertia = printed["inertia_kg_m2"]
    return SpinOptions(
        method=method,
        noise_nT=known.field_nT,
        lsb_nT=0.0,
        sun_sigma_deg=float(np.degrees(known.sun_rad)),
        robust="none",
        inertia_ratio=inertia[2] / inertia[0] if method == "iterative" else None,
    )


def run_hour(flight: Flight, ground: FieldModel, progress: Progress = silent, **grid: Sequence[float]) -> Hour:
    """The search and the three ways. `grid`: `walks_rad_s` and `factors` of another search."""
    rows = assemble_spin(flight.telemetry, ground)
    q_true = flight.truth.q_NB
    start = blind_start(rows, mission.noises(), np.eye(3), np.zeros(3)).state.motion
    solved = {}
    for share, method in ((0.0, "iterative"), (0.1, "batch")):
        progress(method, share)
        fit = fit_spin(rows, options(method), model_name=ground.name)
        A = frames.rotation_from_q(fit.q_NB).as_matrix()
        last = fit.quality["nis_last" if method == "iterative" else "field_chi2"]
        solved[method] = Solved(fit, attitude_error_deg(A, q_true), last)
    found = solved["batch"].fit
    assert found is not None
    true_side = found.calibration.apply(rows.B_nT)

    def before(walk: float, factor: float, field_B_nT: FloatArray = rows.B_nT) -> Solved:
        passed = filtered(rows, field_B_nT, start, settings(walk, factor))
        return Solved(None, attitude_error_deg(passed.A, q_true), passed.field_nis)

    def run(walk: float, factor: float) -> Setting:
        both = (before(walk, factor), before(walk, factor, true_side))
        return Setting(walk, factor, both[0].rms_deg, both[1].rms_deg)

    searched = search(run, mission.published(), progress=part_of(progress, 0.15, 0.95), **grid)
    chosen = searched.by_axes
    steps_alone, alone = _steps_alone(rows, q_true, chosen)
    return Hour(
        flight,
        rows,
        searched,
        before(chosen.walk_rad_s, chosen.sun_factor),
        steps_alone,
        alone,
        solved["iterative"],
        solved["batch"],
    )


def _steps_alone(rows: SpinRows, q_true: FloatArray, chosen: Setting) -> tuple[Solved, Calibration]:
    """TWOSTEP, filter and alignment as the abstract has them."""
    known = options("iterative")
    G, o_nT, _, _ = scalar_start(rows, known)
    motion = blind_start(rows, mission.noises(), G, o_nT).state.motion
    true_side = np.linalg.inv(G)
    assert known.inertia_ratio is not None
    done = iterate(
        rows,
        (rows.B_nT - o_nT) @ true_side.T,
        motion,
        known.inertia_ratio,
        settings(chosen.walk_rad_s, chosen.sun_factor),
        np.radians(known.sun_alignment_deg),
    )
    M = done.turn.T @ true_side
    error = attitude_error_deg(done.last.A, q_true)
    return Solved(None, error, done.last.field_nis), Calibration(M - np.eye(3), -M @ o_nT)
