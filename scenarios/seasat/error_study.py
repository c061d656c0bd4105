"""Table 2: what makes up the residual, each source twice: simulated alone, and by the papers' arithmetic."""

from __future__ import annotations

import numpy as np

from fluxtwin.scenarios.calibration_records import error_square_mG2, papers_regression
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.seasat import mission
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.torquers import coupling_nT_per_Am2

KNOWN = ("lsb", "attitude", "torquer", "field")
RUNS = 20


def run_errors(config: Scenario, ground: FieldModel, progress: Progress, runs: int = RUNS) -> Numbers:
    """Switch the sources on one at a time, then together."""
    worlds = {True: build_world(config), False: build_world(mission.only(config))}
    squares: dict[str, list[float]] = {}
    cases: dict[str, tuple[str, ...]] = {source: (source,) for source in (*KNOWN, "unknown")}
    cases |= {"known": KNOWN, "all": (*KNOWN, "unknown")}
    for number, (case, sources) in enumerate(cases.items()):
        progress(f"error budget: {case}", 0.7 * number / len(cases))
        switched = mission.only(config, *sources)
        world = worlds["field" in sources]
        squares[case] = [_error_square(switched, world, ground, config.seed + run) for run in range(runs)]
    progress("error budget: residual of the fit", 0.75)
    fit_known = _fit_rms(mission.only(config, *KNOWN), worlds[True], ground, runs)
    fit_all = _fit_rms(config, worlds[True], ground, runs)
    printed = mission.printed_value("errors", "rms_mG", source="observed rms")
    progress("error budget: the unknown that the papers' residual needs", 0.8)
    unknown, fit_with_that = _unknown_for(printed, config, worlds[True], ground, (fit_known, fit_all), runs)
    return Numbers(
        # [mG, rms per component over the 325 samples] Error of equation 1 at the true S, b, T = 0, with that source alone:
        # mean square over seeds, and standard deviation.
        simulated={case: float(np.sqrt(np.mean(values))) for case, values in squares.items()},
        simulated_spread={case: float(np.std(np.sqrt(values))) for case, values in squares.items()},
        paper_rule=paper_rule(config),
        # Residual of the 12-parameter fit with the known sources, and with the unknown of 2.6 mG.
        fit_known=fit_known,
        fit_all=fit_all,
        # The unknown that should bring it to the printed 3.7 mG, and what it then is.
        unknown_for_paper=unknown,
        fit_with_that=fit_with_that,
        torquer_bounds=torquer_bounds(config),
        # (12,) shift of S and b [mG] that the error of the ground's field model alone causes.
        field_shift=_field_shift(mission.only(config, "field"), worlds[True], ground),
    )


def paper_rule(config: Scenario) -> dict[str, float]:
    """The papers' arithmetic: LSB/sqrt 12, and the printed 0.5, 1.7 (a bound), 1.4 and 2.6 used as rms values."""
    rule = {
        "lsb": config.magnetometer.step_nT / NT_PER_MG / np.sqrt(12.0),
        "attitude": mission.printed_value("errors", "rms_mG", source="reference attitude error"),
        "torquer": mission.printed_value("errors", "rms_mG", source="electromagnet activity"),
        "field": mission.printed_value("errors", "rms_mG", source="field model error"),
    }
    rule["known"] = float(np.sqrt(sum(value**2 for value in rule.values())))
    rule["unknown"] = mission.printed_value("errors", "rms_mG", source="unknown")
    rule["all"] = float(np.hypot(rule["known"], rule["unknown"]))
    return {name: float(value) for name, value in rule.items()}


def torquer_bounds(config: Scenario) -> tuple[float, float, float]:
    """Field of one dipole broadside and axial, and the largest of three orthogonal ones over all signs [mG]."""
    assert config.torquers is not None
    coupling = coupling_nT_per_Am2(np.array(config.torquers.positions_m)) * config.torquers.Am2 / NT_PER_MG
    columns = np.sort(np.linalg.norm(coupling, axis=0))
    distance = float(np.linalg.norm(config.torquers.positions_m[0]))
    return float(columns[0]), float(columns[-1]), _worst_of_three(config.torquers.Am2, distance)


def _worst_of_three(dipole_Am2: float, distance_m: float) -> float:
    """Three equal orthogonal dipoles together are one of sqrt 3 times the size; the worst place is on its axis."""
    together = np.sqrt(3.0) * dipole_Am2 * np.array([0.0, 0.0, 1.0])
    at = np.tile([0.0, 0.0, distance_m], (3, 1))
    return float(np.linalg.norm(coupling_nT_per_Am2(at) @ together) / NT_PER_MG)


def _error_square(config: Scenario, world: World, ground: FieldModel, seed: int) -> float:
    flight = mission.fly(config.updated({"seed": seed}), world)
    return error_square_mG2(flight, flight.telemetry, ground)


def _fit_rms(config: Scenario, world: World, ground: FieldModel, runs: int) -> float:
    squares = []
    for run in range(runs):
        flight = mission.fly(config.updated({"seed": config.seed + run}), world)
        fit = papers_regression(flight.telemetry, ground)
        squares.append(np.mean(fit.residuals_nT**2))
    return float(np.sqrt(np.mean(squares)) / NT_PER_MG)


def _unknown_for(
    printed: float, config: Scenario, world: World, ground: FieldModel, fits: tuple[float, float], runs: int
) -> tuple[float, float]:
    """The unknown [mG] with which the residual of the fit is the printed one, and that residual.

    The fit takes up part of a slow unknown; what is left grows in proportion, so two scalings suffice.
    """
    assert config.magnetometer.unknown is not None
    known, residual = fits
    unknown = config.magnetometer.unknown.nT / NT_PER_MG
    for _ in range(2):
        unknown *= float(np.sqrt((printed**2 - known**2) / (residual**2 - known**2)))
        residual = _fit_rms(config.updated({"magnetometer.unknown.rms_mG": unknown}), world, ground, runs)
    return unknown, residual


def _field_shift(config: Scenario, world: World, ground: FieldModel) -> FloatArray:
    flight = mission.fly(config, world)
    fit = papers_regression(flight.telemetry, ground)
    shift_S = fit.calibration.S - flight.truth.S
    return np.concatenate([shift_S.ravel(), (fit.calibration.b_nT - flight.truth.b_nT) / NT_PER_MG])
