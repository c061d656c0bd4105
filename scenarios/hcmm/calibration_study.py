"""Table 3: sets A, B and both, with sigmas that allow for errors lasting a pass; and the wandering bias of the flight
software, which could solve for b alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.linear.calibrate import LinearFit
from fluxtwin.scenarios.calibration_records import (
    NAMES,
    bias_alone,
    papers_regression,
    truth_vector,
    vector,
    vector_sigma,
)
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.mission import DAYS, SAMPLES, Flight
from fluxtwin.scenarios.motion import prescribed
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.earth.stations import in_view
from fluxtwin.sim.run.scenario_stations import stations_of
from fluxtwin.sim.scenario.scenario import Scenario

RUNS = 60
SETS = ("A", "B", "AB")
KINDS = ("white", "pass", "pass and field")
"""What the stated sigma allows for: nothing that lasts; errors that last a pass; these and the field model's."""
FIELD_ERROR_NT = 125.0
"""What the papers give for IGRF 1975, 1.0 to 1.5 mG: the ground of 1979 could have allowed for it."""
_FEWEST_IN_PASS = 4
"""Samples a pass must have for a bias of its own."""


@dataclass(frozen=True)
class CalibrationStudy:
    """Fits by set, and the scatter over many runs; K = 12 parameters (S, then b in mG)."""

    fits: Mapping[str, LinearFit]
    """The papers' regression, sigmas by pass with an allowance for the field model."""
    white_sigma: Mapping[str, FloatArray]
    """(K,) of the same fits, had every sample an error of its own."""
    pass_sigma: Mapping[str, FloatArray]
    """(K,) with blocks by pass, the field model taken as right."""
    passes: Mapping[str, int]
    estimates: FloatArray
    """(RUNS, sets, K); every run has its own seed and orbital phase, so other passes; the motion is prescribed."""
    sigmas: Mapping[str, FloatArray]
    """(RUNS, sets, K) stated sigmas of each of KINDS."""
    bias_only: Numbers
    truth: FloatArray
    """(K,)."""
    field_shift: FloatArray
    """(K,) shift of the fit to both sets that the error of the ground's field model alone causes."""

    def scatter(self, name: str) -> FloatArray:
        """(K,) standard deviation of the estimates over the runs."""
        return np.asarray(self.estimates[:, SETS.index(name)].std(axis=0, ddof=1))

    def rms_error(self, name: str) -> FloatArray:
        """(K,) root mean square of estimate less truth over the runs: the error of the field model is in it."""
        return np.asarray(np.sqrt(((self.estimates[:, SETS.index(name)] - self.truth) ** 2).mean(axis=0)))

    def sigma_ratio(self, name: str, kind: str) -> float:
        """Error over stated sigma, root mean square over runs and parameters; 1 is honest."""
        stated = np.sqrt((self.sigmas[kind][:, SETS.index(name)] ** 2).mean(axis=0))
        return float(np.sqrt(np.mean((self.rms_error(name) / stated) ** 2)))


def run_calibrations(flight: Flight, ground: FieldModel, progress: Progress, runs: int = RUNS) -> CalibrationStudy:
    """Fit the sets of one flight over the days of Table 3, then of many with other seeds and phases.

    The many have the prescribed motion: ten days each by torques would take longer than all else in the study, and
    the scatter of calibrations comes from passes, sensors and field model (a test sets both motions side by side).
    """
    days = flight.scenario
    rows = {name: choose_rows(flight, name) for name in SETS}
    fits = {name: fit_rows(flight, rows[name], ground) for name in SETS}
    estimates = np.empty((runs, len(SETS), len(NAMES)))
    sigmas = {kind: np.empty_like(estimates) for kind in KINDS}
    for run in range(runs):
        progress(f"calibration {run + 1} of {runs}", run / runs)
        other = mission.fly(with_random_phase(prescribed(days), days.seed + 1 + run))
        for place, name in enumerate(SETS):
            chosen = choose_rows(other, name)
            white, by_pass, with_field = (
                fit_rows(other, chosen, ground, kind) for kind in ("white", "pass", "white and field")
            )
            estimates[run, place] = vector(white)
            # The allowance for the field model adds the same variance to any covariance: the dear one, by pass, is
            # worked out once.
            pair = vector_sigma(white), vector_sigma(by_pass)
            with_both = np.sqrt(pair[1] ** 2 + vector_sigma(with_field) ** 2 - pair[0] ** 2)
            for kind, sigma in zip(KINDS, (*pair, with_both), strict=True):
                sigmas[kind][run, place] = sigma
    truth = truth_vector(days)
    alone = mission.fly(mission.only(days, "field"), flight.world)
    return CalibrationStudy(
        fits=fits,
        white_sigma={name: vector_sigma(fit_rows(flight, rows[name], ground, "white")) for name in SETS},
        pass_sigma={name: vector_sigma(fit_rows(flight, rows[name], ground, "pass")) for name in SETS},
        passes={name: len(np.unique(pass_labels(flight)[rows[name]])) for name in SETS},
        estimates=estimates,
        sigmas=sigmas,
        bias_only=_bias_only(flight, ground, truth[:9].reshape(3, 3)),
        truth=truth,
        field_shift=vector(fit_rows(alone, choose_rows(alone, "AB"), ground, "white")) - truth,
    )


def with_random_phase(config: Scenario, seed: int) -> Scenario:
    """Another seed, and the spacecraft elsewhere on its orbit, so that other passes are flown."""
    phase = float(stream(seed, "hcmm.phase").uniform(0.0, 360.0))
    return config.updated({"seed": seed, "orbit.argument_of_latitude_deg": phase})


def choose_rows(flight: Flight, name: str) -> np.ndarray:
    """Rows of a set: of each of its days sunlit passes in random order, until the printed number of samples is reached.

    The papers give days and numbers, not passes.
    """
    if name == "AB":
        return np.sort(np.concatenate([choose_rows(flight, part) for part in ("A", "B")]))
    days, total = DAYS[name], SAMPLES[name]
    labels = pass_labels(flight)
    number = (flight.telemetry.time - mission.day(1)).astype("timedelta64[D]").astype(int) + 1
    rng = stream(flight.scenario.seed, f"hcmm.passes.{name}")
    chosen: list[np.ndarray] = []
    for place, today in enumerate(days):
        share = total * (place + 1) // len(days) - sum(map(len, chosen))
        usable = np.flatnonzero((number == today) & flight.telemetry.has_attitude)
        order = rng.permutation(np.unique(labels[usable]))
        rows = np.concatenate([usable[labels[usable] == label] for label in order])
        chosen.append(rows[:share])
    return np.sort(np.concatenate(chosen))


def pass_labels(flight: Flight) -> np.ndarray:
    """(N,) one number for each stretch in view and the station that stands best in it."""
    height = in_view(stations_of(flight.scenario), frames.rotation_EN(flight.world.time).apply(flight.world.r_N_km))
    return np.asarray(flight.world.segment.astype(int) * height.shape[1] + height.argmax(axis=1))


def fit_rows(flight: Flight, rows: np.ndarray, ground: FieldModel, kind: str = "pass and field") -> LinearFit:
    """The papers' regression with a covariance `white`, by `pass`, or either `and field`."""
    return papers_regression(
        flight.telemetry.select(rows),
        ground,
        covariance="white" if kind.startswith("white") else "blocks",
        passes=None if kind.startswith("white") else pass_labels(flight)[rows],
        field_error_nT=FIELD_ERROR_NT if kind.endswith("and field") else None,
    )


def _bias_only(flight: Flight, ground: FieldModel, S: FloatArray) -> Numbers:
    found, means = [], []
    usable = flight.telemetry.has_attitude
    labels = pass_labels(flight)
    for label in np.unique(labels[usable]):
        rows = np.flatnonzero(usable & (labels == label))
        if rows.size < _FEWEST_IN_PASS:
            continue
        record = flight.telemetry.select(rows)
        found.append(bias_alone(record, ground).b_nT / NT_PER_MG)
        means.append(record.mag_B_nT.mean(axis=0) / NT_PER_MG)
    b, mean = np.array(found), np.array(means)
    explained, by_scale = (1.0 - (b[:, 0] - part).var() / b[:, 0].var() for part in (mean @ S[0], mean[:, 0] * S[0, 0]))
    return Numbers(
        # (Q, 3) bias that each pass alone gives with S = T = 0, and its mean reading; half the range of the bias.
        b_mG=b,
        mean_field_mG=mean,
        half_range_mG=np.ptp(b, axis=0) / 2.0,
        # Of b1 against the mean X reading: what S11 would make it.
        slope=np.polyfit(mean[:, 0], b[:, 0], 1)[0],
        # Share of the variance of b1 that the first row of the printed S explains, and S11 alone.
        explained=explained,
        explained_by_scale=by_scale,
    )
