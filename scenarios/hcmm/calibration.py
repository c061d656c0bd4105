"""Tables 3 and 4: sets A, B and both, with sigmas that allow for errors lasting a pass; the wandering bias of the flight
software, which could solve for b alone; and what makes up the residual."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.calib.linear.calibrate import LinearFit
from fluxtwin.scenarios import regression
from fluxtwin.scenarios.flights import Numbers, latitude_deg, prescribed, rms, rms_along
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.mission import DAYS, SAMPLES, Flight
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.earth.stations import in_view
from fluxtwin.sim.run.world import build_world, stations_of
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.torquers import coupling_nT_per_Am2

RUNS = 60
SETS = ("A", "B", "AB")
KINDS = ("white", "pass", "pass and field")
"""What the stated sigma allows for: nothing that lasts; errors that last a pass; these and the field model's."""
FIELD_ERROR_NT = 125.0
"""What the papers give for IGRF 1975, 1.0 to 1.5 mG: the ground of 1979 could have allowed for it."""
BUDGET_RUNS = 12
NEAR_EQUATOR_DEG, NEAR_POLES_DEG = 5.0, 75.0
"""Geocentric latitudes that count as near the equator and near the poles."""
_FEWEST_IN_PASS = 4
"""Samples a pass must have for a bias of its own."""


def run_calibrations(flight: Flight, ground: FieldModel, progress: Progress, runs: int = RUNS) -> Numbers:
    """Fit the sets of one flight over the days of Table 3, then of many with other seeds and phases.

    The many have the prescribed motion: ten days each by torques would take longer than all else in the study, and
    the scatter of calibrations comes from passes, sensors and field model (a test sets both motions side by side).
    """
    days = flight.scenario
    rows = {name: choose_rows(flight, name) for name in SETS}
    estimates, sigmas = [], []
    for run in range(runs):
        progress(f"calibration {run + 1} of {runs}", run / runs)
        other = mission.fly(with_random_phase(prescribed(days), days.seed + 1 + run))
        found = [_with_sigmas(other, choose_rows(other, name), ground) for name in SETS]
        estimates.append([one for one, _ in found])
        sigmas.append([one for _, one in found])
    truth, stated = regression.truth_vector(days), np.array(sigmas)
    alone = mission.fly(mission.only(days, "field"), flight.world)
    labels = pass_labels(flight)
    return Numbers(
        # The papers' regression by set, sigmas by pass with an allowance for the field model.
        fits={name: fit_rows(flight, rows[name], ground) for name in SETS},
        # (12,) of the same fits, had every sample an error of its own; with blocks by pass, the field model taken as right.
        white_sigma={name: regression.vector_sigma(fit_rows(flight, rows[name], ground, "white")) for name in SETS},
        pass_sigma={name: regression.vector_sigma(fit_rows(flight, rows[name], ground, "pass")) for name in SETS},
        passes={name: len(np.unique(labels[rows[name]])) for name in SETS},
        # In `runs` flights, each with its own seed and orbital phase, so other passes, in the prescribed motion; and the
        # sigmas (R, sets, 12) stated there, of each of KINDS.
        many=regression.Estimates(SETS, np.array(estimates), truth),
        sigmas={kind: stated[:, :, place] for place, kind in enumerate(KINDS)},
        bias_only=_bias_only(flight, ground, truth[:9].reshape(3, 3)),
        truth=truth,
        # (12,) shift of the fit to both sets that the error of the ground's field model alone causes.
        field_shift=regression.vector(fit_rows(alone, choose_rows(alone, "AB"), ground, "white")) - truth,
    )


def sigma_ratio(study: Numbers, name: str, kind: str) -> float:
    """Error over stated sigma, root mean square over runs and parameters; 1 is honest."""
    stated = rms_along(study.sigmas[kind][:, SETS.index(name)], axis=0)
    return float(rms(study.many.rms_error(name) / stated))


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
    return regression.papers_regression(
        flight.telemetry.select(rows),
        ground,
        covariance="white" if kind.startswith("white") else "blocks",
        passes=None if kind.startswith("white") else pass_labels(flight)[rows],
        field_error_nT=FIELD_ERROR_NT if kind.endswith("and field") else None,
    )


def _with_sigmas(flight: Flight, rows: np.ndarray, ground: FieldModel) -> tuple[FloatArray, list[FloatArray]]:
    """Estimate, and stated sigmas of each of KINDS."""
    fits = [fit_rows(flight, rows, ground, kind) for kind in ("white", "pass", "white and field")]
    white, by_pass, with_field = map(regression.vector_sigma, fits)
    # The allowance for the field model adds the same variance to any covariance: the dear one, by pass, is worked out once.
    return regression.vector(fits[0]), [white, by_pass, np.sqrt(by_pass**2 + with_field**2 - white**2)]


def _bias_only(flight: Flight, ground: FieldModel, S: FloatArray) -> Numbers:
    found, means = [], []
    usable, labels = flight.telemetry.has_attitude, pass_labels(flight)
    for label in np.unique(labels[usable]):
        rows = np.flatnonzero(usable & (labels == label))
        if rows.size >= _FEWEST_IN_PASS:
            record = flight.telemetry.select(rows)
            found.append(regression.bias_alone(record, ground).b_nT / NT_PER_MG)
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


def run_errors(config: Scenario, ground: FieldModel, progress: Progress, runs: int = BUDGET_RUNS) -> Numbers:
    """Table 4, each source twice, simulated alone and by the papers' arithmetic: one at a time, then together."""
    days = mission.on_days(config)
    cases = {source: (source,) for source in mission.SOURCES} | {"all": mission.SOURCES}
    squares: dict[str, list[float]] = {case: [] for case in cases}
    fits, turned = [], []
    for run in range(runs):
        progress(f"error budget, run {run + 1} of {runs}", run / runs)
        moved = with_random_phase(days, config.seed + 1 + run)
        worlds = {True: build_world(moved), False: build_world(mission.only(moved))}
        for case, sources in cases.items():
            flight = mission.fly(mission.only(moved, *sources), worlds["field" in sources])
            rows = choose_rows(flight, "AB")
            squares[case].append(regression.error_square_mG2(flight, flight.telemetry.select(rows), ground))
        fits.append(regression.rms_mG(fit_rows(flight, rows, ground, "white")))
        assert flight.telemetry.q_NB is not None
        R_NO = flight.world.R_ON.inv()[rows]
        reported = frames.yaw_roll_pitch(frames.rotation_from_q(np.array(flight.telemetry.q_NB)[rows]) * R_NO)
        true = (flight.truth.yaw_rad, flight.truth.roll_rad, flight.truth.pitch_rad)
        turned.append(np.array([np.mean((seen - real[rows]) ** 2) for seen, real in zip(reported, true, strict=True)]))
    assert config.torquers is not None
    coupling = np.linalg.norm(coupling_nT_per_Am2(np.array(config.torquers.positions_m)), axis=0).max()
    axial_mG = coupling * config.torquers.Am2 / NT_PER_MG
    return Numbers(
        flights=runs,
        # [mG, rms per component over the 443 samples] Error of equation 1 at the true S, b, T = 0, with that source alone.
        **regression.budget(squares),
        paper_rule=paper_rule(config),
        # Residual of the 12-parameter fit with all sources.
        fit=rms(np.array(fits)),
        # Field of one coil at the magnetometer on its axis, and what the compensation leaves of it.
        coil_axial_mG=axial_mG,
        coil_left_mG=axial_mG * (1.0 - config.torquers.compensation),
        # (3,) rms error of the reference attitude in yaw, roll, pitch; sunlit rows, heads 2 and 3.
        reference_deg=np.degrees(np.sqrt(np.mean(turned, axis=0))),
        **_field_model(config, ground),
    )


def paper_rule(config: Scenario) -> dict[str, tuple[float, float]]:
    """LSB/sqrt 12, the printed 1.1, below 1, and 1.0 to 1.5; and their root sums of squares."""
    lsb = config.magnetometer.step_nT / NT_PER_MG / float(np.sqrt(12.0))
    attitude = mission.printed_value("errors", "rms_lo_mG", source="reference attitude error")
    torquer = mission.printed_value("errors", "rms_hi_mG", source="electromagnet activity")
    low, high = (mission.printed_value("errors", f"rms_{k}_mG", source="field model error") for k in ("lo", "hi"))
    rule = {"lsb": (lsb, lsb), "attitude": (attitude, attitude), "torquer": (0.0, torquer), "field": (low, high)}
    total = np.linalg.norm(list(rule.values()), axis=0)
    return rule | {"all": (float(total[0]), float(total[1]))}


def _field_model(config: Scenario, ground: FieldModel) -> dict[str, Any]:
    """The error of the ground's model along three days of the orbit, at 30 s."""
    assert config.schedule is not None
    segment = config.schedule.segments[0]
    whole = {"start_utc": segment.start_utc, "duration_min": segment.duration_min, "step_s": 30.0}
    world = build_world(config.updated({"schedule.in_view_of_stations": None, "schedule.segments": [whole]}))
    model = field_N_nT(ground, world.time, world.r_N_km)
    strength_nT, latitude = np.linalg.norm(world.field_N_nT, axis=1), np.abs(latitude_deg(world))
    angle, seen_rad = (
        frames.angle_between(field_N_nT(ground, one.time, one.r_N_km), one.field_N_nT)
        for one in (world, build_world(config))
    )
    ends = [strength_nT[rows].mean() for rows in (latitude < NEAR_EQUATOR_DEG, latitude > NEAR_POLES_DEG)]
    return {
        # rms error of IGRF 1975 in field strength, and per axis.
        "field_scalar_mG": rms(np.linalg.norm(model, axis=1) - strength_nT) / NT_PER_MG,
        "field_axis_mG": rms(model - world.field_N_nT) / NT_PER_MG,
        # Mean strength of the field of 1978 near the equator and near the poles.
        "field_ends_mG": tuple(float(end) / NT_PER_MG for end in ends),
        # rms, three times that, largest of the three days, and largest over the passes of Table 5's stations.
        "field_direction_deg": np.degrees([rms(angle), 3.0 * rms(angle), angle.max(), seen_rad.max()]),
    }
