"""Which manoeuvre halves the sigma of a calibration's worst parameter: each is flown, and calibrated with the record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.records import parameter_unit
from fluxtwin.calib.methods import calibrate_by
from fluxtwin.gap.planning.choose import shortened
from fluxtwin.gap.planning.designs import Design, LimitsSection
from fluxtwin.gap.records.plan import CalibrationPlan, SigmaCourse
from fluxtwin.planning import fly, with_article
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

HALF = 0.5
_SHARES = (0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Of the longest flight; shorter ones have too few memories of an attitude error for the fit to know its own sigma."""
_AGAIN = 7
"""Flights with other noise, of which the median is taken of what is proposed: a fit finds its errors, and so its sigma, to
some 20 %, and the shortest that happened to be enough was lucky."""
_KEPT = 3
_NEARLY = 1.1


def plan_calibration(
    record: Telemetry,
    base: Scenario,
    limits: LimitsSection,
    model: FieldModel,
    declared: Mapping[str, Any],
    notes: Sequence[str],
    progress: Progress,
) -> CalibrationPlan:
    """What to fly to halve the largest sigma among S (in parts of the field) and b.

    The manoeuvre is flown by a magnetometer as this record may have had it, and both records are calibrated together, by the
    method of `calibrate` and with the errors that are declared, or that it finds. Raises NoAnswer as `calibrate` does,
    and where its method gives no sigmas.
    """

    def fitted(*records: Telemetry) -> Fit:
        return calibrate_by(list(records), model, **declared)

    fit = fitted(record)
    worst = "" if fit.coverage is None else fit.coverage.worst
    if not worst:
        raise NoAnswer("this calibration has no sigmas, so nothing can be said of what would halve them")
    now = sigma_of(fit, worst)
    made = fly(
        drawn(base, fit, 0).updated({"magnetometer.b_mG": None}),
        limits,
        lambda words, share: progress(words, 0.2 * share),
    )
    courses = []
    for place, (design, flown) in enumerate(made.flown):
        progress(f"calibrating with {design.words}", 0.2 + 0.8 * place / len(made.flown))
        if not design.tests:  # pulses of torquers say nothing of S and b
            courses.append(_course(design, record, flown, fitted, worst, HALF * now))
    courses.sort(key=lambda one: _rank(one, HALF * now))
    again = [_again(one, record, fit, fitted, worst) for one in courses[:_KEPT]]
    nominal = {"magnetometer.S": np.asarray(fit.calibration.S).tolist()}
    nominal |= {"magnetometer.b_nT": np.asarray(fit.calibration.b_nT).tolist(), "seed": base.seed}
    courses = [
        replace(one, scenario=one.scenario.updated(nominal)) for one in [*again, *courses[_KEPT:]] if one.scenario
    ]
    progress("done", 1.0)
    unit = parameter_unit(worst)
    return CalibrationPlan(
        _sentence(worst, now, unit, courses), worst, now, unit, courses, made.limits, made.refused, list(notes)
    )


def sigma_of(fit: Fit, name: str) -> float:
    """Sigma of a parameter of S or b."""
    return float(fit.calibration.sigmas[list(fit.calibration.names).index(name)])


def _course(
    design: Design, record: Telemetry, flown: Telemetry, fitted: Callable[..., Fit], worst: str, wanted: float
) -> SigmaCourse:
    """As short as halves it."""
    hours = (flown.time - flown.time[0]) / np.timedelta64(1, "h")
    curve: list[tuple[float, float]] = []
    for share in [1.0, *_SHARES[:-1]]:
        rows = max(int(share * len(flown)), 2)
        part = flown.select(np.arange(len(flown)) < rows)
        sigma = sigma_of(fitted(record, part), worst)
        curve.append((float(hours[rows - 1]), sigma))
        if (share == 1.0 and sigma > wanted) or (share < 1.0 and sigma <= wanted):
            break
    reached = curve[-1]
    scenario = shortened(design.scenario, reached[0])
    return SigmaCourse(design.words, reached[0], design.wait_days, reached[1], sorted(curve), scenario)


def _rank(course: SigmaCourse, wanted: float) -> tuple[bool, bool, float, float]:
    enough = course.sigma <= wanted
    return (not enough, course.wait_days > 0, round(course.hours, 1) if enough else 0.0, course.sigma)


def _again(course: SigmaCourse, record: Telemetry, fit: Fit, fitted: Callable[..., Fit], worst: str) -> SigmaCourse:
    """With the sigma that the manoeuvre gives in the middle."""
    assert course.scenario is not None
    flown = [simulate(drawn(course.scenario, fit, number))[0] for number in range(1, _AGAIN + 1)]
    return replace(course, sigma=float(np.median([sigma_of(fitted(record, one), worst) for one in flown])))


def drawn(scenario: Scenario, fit: Fit, number: int) -> Scenario:
    """The scenario with other noise, and with S and b as they may well be, given the record: were they those of the fit, the
    errors of the record that the fit has taken for S and b would never show."""
    known = fit.calibration
    values, vectors = np.linalg.eigh(known.covariance[:12, :12])
    normal = np.random.default_rng([number, scenario.seed]).standard_normal(12)
    off = vectors @ (np.sqrt(np.maximum(values, 0.0)) * normal)
    changes = {
        "magnetometer.S": (np.asarray(known.S) + off[:9].reshape(3, 3)).tolist(),
        "magnetometer.b_nT": (np.asarray(known.b_nT) + off[9:]).tolist(),
        "seed": scenario.seed + number,
    }
    return scenario.updated(changes)


def _sentence(worst: str, now: float, unit: str, courses: Sequence[SigmaCourse]) -> str:
    best, of = courses[0], "" if unit == "1" else f" {unit}"
    flown = with_article(best.words)
    wait = f", {best.wait_days:g} days from now" if best.wait_days else ""
    if best.sigma <= _NEARLY * HALF * now:
        return (
            f"To halve the sigma of {worst}, now {now:.2g}{of}, fly {flown} for {best.hours:.2g} h{wait}. Calibrated "
            f"together with this record, it then falls to {best.sigma:.2g}{of}."
        )
    return (
        f"No manoeuvre within the limits halves the sigma of {worst}, now {now:.2g}{of}. The best one, {flown} for "
        f"{best.hours:.2g} h, lowers it to {best.sigma:.2g}{of}."
    )
