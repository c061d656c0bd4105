"""The hour calibrated three ways: not at all, by the abstract's iteration, by one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.records import Calibration
from fluxtwin.calib.sedlak import iterate
from fluxtwin.calib.spin import SpinFit, SpinOptions, fit_spin, scalar_start
from fluxtwin.calib.spin_batch import Noise
from fluxtwin.calib.spin_filter import FilterSettings, spin_filter
from fluxtwin.calib.spin_motion import Motion
from fluxtwin.calib.spin_rows import SpinRows, assemble_spin
from fluxtwin.calib.spin_start import blind_start
from fluxtwin.scenarios.st5 import mission
from fluxtwin.sim import frames
from fluxtwin.sim.constants import NT_PER_MG
from fluxtwin.sim.field import FieldModel
from fluxtwin.sim.progress import Progress, silent
from fluxtwin.sim.types import FloatArray

WALKS_RAD_S = (0.0, 1e-4, 4e-4, 2e-3)
"""Process noise tried: random walk of L/Jt in a second. 4e-4 is 1e-7 (N m s)^2/s."""
SUN_FACTORS = (1.0, 5.0)
"""The sun's noise as the filter takes it, over what it is."""


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
class SweepRow:
    """The filter with one setting."""

    walk_rad_s: float
    sun_factor: float
    pre_deg: FloatArray
    """(3,) rms before calibration."""
    pre_rss_deg: float
    post_rss_deg: float
    """With the batch's calibration."""


@dataclass(frozen=True)
class Hour:
    """All of one run."""

    flight: mission.Flight
    rows: SpinRows
    before: Solved
    steps_alone: Solved
    """The abstract's three steps, without the regression at the end."""
    alone: Calibration
    """What they give; no covariance."""
    iterative: Solved
    batch: Solved
    sweep: tuple[SweepRow, ...]


def noises() -> Noise:
    """What the abstract states of the sensors."""
    printed = mission.published()
    return Noise(float(printed["noise_mG"]) * NT_PER_MG, float(np.radians(printed["sun_noise_deg"])))


def options(method: str) -> SpinOptions:
    """The abstract's inputs: noise of the sensors, and for the iteration the inertia."""
    printed, known = mission.published(), noises()
    inertia = printed["inertia_kg_m2"]
    return SpinOptions(
        method=method, noise_nT=known.field_nT, lsb_nT=0.0, sun_sigma_deg=float(np.degrees(known.sun_rad)),
        robust="none",
        inertia_ratio=inertia[2] / inertia[0] if method == "iterative" else None,
    )  # fmt: skip


def attitude_error_deg(A: FloatArray, q_NB: FloatArray) -> FloatArray:
    """(N, 3) e of A = exp(-[e x]) A_true, in B."""
    true = frames.rotation_from_q(q_NB).as_matrix()
    d = A @ true.transpose(0, 2, 1)
    axial = np.stack([d[:, 1, 2] - d[:, 2, 1], d[:, 2, 0] - d[:, 0, 2], d[:, 0, 1] - d[:, 1, 0]], axis=1)
    return np.asarray(np.degrees(0.5 * axial))


def run_hour(flight: mission.Flight, ground: FieldModel, progress: Progress = silent) -> Hour:
    """The three ways and the sweep."""
    rows = assemble_spin(flight.telemetry, ground)
    q_true = flight.truth.q_NB
    progress("before calibration", 0.0)
    start = blind_start(rows, noises(), np.eye(3), np.zeros(3)).state.motion
    before = _filter(rows, rows.B_nT, start, 0.0, 1.0, q_true)
    steps_alone, alone = _steps_alone(rows, q_true)
    solved = {}
    for share, method in ((0.1, "iterative"), (0.4, "batch")):
        progress(method, share)
        fit = fit_spin(rows, options(method), model_name=ground.name)
        A = frames.rotation_from_q(fit.q_NB).as_matrix()
        last = fit.quality["nis_last" if method == "iterative" else "field_chi2"]
        solved[method] = Solved(fit, attitude_error_deg(A, q_true), last)
    progress("the filter's settings", 0.5)
    found = solved["batch"].fit
    assert found is not None
    true_side = found.calibration.apply(rows.B_nT)
    sweep = [_swept(rows, true_side, start, walk, factor, q_true) for walk in WALKS_RAD_S for factor in SUN_FACTORS]
    return Hour(flight, rows, before, steps_alone, alone, solved["iterative"], solved["batch"], tuple(sweep))


def _steps_alone(rows: SpinRows, q_true: FloatArray) -> tuple[Solved, Calibration]:
    """TWOSTEP, filter and alignment as the abstract has them."""
    chosen = options("iterative")
    G, o_nT, _, _ = scalar_start(rows, chosen)
    motion = blind_start(rows, noises(), G, o_nT).state.motion
    true_side = np.linalg.inv(G)
    known = noises()
    settings = FilterSettings(known.field_nT, known.sun_rad)
    assert chosen.inertia_ratio is not None
    done = iterate(
        rows,
        (rows.B_nT - o_nT) @ true_side.T,
        motion,
        chosen.inertia_ratio,
        settings,
        np.radians(chosen.sun_alignment_deg),
    )
    M = done.turn.T @ true_side
    error = attitude_error_deg(done.last.A, q_true)
    return Solved(None, error, done.last.field_nis), Calibration(M - np.eye(3), -M @ o_nT)


def _filter(
    rows: SpinRows, field_B_nT: FloatArray, motion: Motion, walk: float, sun_factor: float, q_true: FloatArray
) -> Solved:
    inertia: Sequence[float] = mission.published()["inertia_kg_m2"]
    begin = np.array([min(rows.t_s[0], rows.pulse_s[0])])
    A0 = motion.attitude(begin)[0]
    rate = A0 @ motion.Om_N_rad_s + np.array([0.0, 0.0, motion.lam_rad_s])
    known = noises()
    settings = FilterSettings(known.field_nT, known.sun_rad * sun_factor, walk)
    filtered = spin_filter(rows, field_B_nT, A0, rate, np.array(inertia), settings)
    return Solved(None, attitude_error_deg(filtered.A, q_true), filtered.field_nis)


def _swept(
    rows: SpinRows, true_side: FloatArray, motion: Motion, walk: float, factor: float, q_true: FloatArray
) -> SweepRow:
    before = _filter(rows, rows.B_nT, motion, walk, factor, q_true)
    after = _filter(rows, true_side, motion, walk, factor, q_true)
    return SweepRow(walk, factor, before.rms_deg, before.rss_deg, after.rss_deg)
