"""The verb `plan`: from a diagnosis to what to fly next; the command and `fluxtwin.plan` both call it.

For a calibration: which manoeuvre halves the sigma of its worst parameter; each is flown, and calibrated with the record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from fluxtwin import diagnosing
from fluxtwin.calib.common.digits import percent
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.records import parameter_unit
from fluxtwin.calib.methods import calibrate_by
from fluxtwin.diagnosing import AssumedAndReading, with_assumed
from fluxtwin.gap.noise.whitening import NoiseModel
from fluxtwin.gap.planning import questions
from fluxtwin.gap.planning.designs import Design, LimitsFile, LimitsSection, designs
from fluxtwin.gap.planning.power import Flown
from fluxtwin.gap.planning.questions import choose, shortened
from fluxtwin.gap.problem.problem import ALIKE, DEFAULT_MODELLED, pose
from fluxtwin.gap.records.diagnosis import Diagnosis, diagnosis_schema
from fluxtwin.gap.records.plan import CalibrationPlan, Course, Plan, Question, SigmaCourse
from fluxtwin.notebook import usual
from fluxtwin.scenarios.packaged import as_scenario
from fluxtwin.sim.base.errors import BadInput, NoAnswer, names_in
from fluxtwin.sim.base.limits import text_of
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.seals import unsealed_json
from fluxtwin.sim.base.toml_input import read_model, validate
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.earth.orbit import kepler_period_s
from fluxtwin.sim.run import spacecraft
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import ephemeris
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import Readable
from fluxtwin.verbs import as_model, as_record, on_one_blas_thread, reading_of, with_reading

HALF = 0.5
_SHARES = (0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Of the longest flight; shorter ones have too few memories of an attitude error for the fit to know its own sigma."""
_AGAIN = 7
"""Flights with other noise, of which the median is taken of what is proposed: a fit finds its errors, and so its sigma, to
some 20 %, and the shortest that happened to be enough was lucky."""
_KEPT = 3
_NEARLY = 1.1
_MOST_ROWS = 1_200
"""Of a design: two orbits at ten seconds."""
_ORBITS = 2.0
_DAY_S = 86400.0
_KEYS = {
    "noise_nT": "magnetometer.noise_nT",
    "lsb_nT": "magnetometer.lsb_nT",
    "attitude_sigma_deg": "attitude.reference.sigma_deg",
    "attitude_tau_s": "attitude.reference.tau_s",
}
"""Where a scenario has what may be declared of the errors."""
_INFERRED = (
    "orbit, noise, calibration, torquers and housekeeping of the manoeuvres were inferred from the record; --scenario FILE "
    "states them more accurately"
)


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
    flown, refused, allowed = fly(
        drawn(base, fit, 0).updated({"magnetometer.b_mG": None}),
        limits,
        lambda words, share: progress(words, 0.2 * share),
    )
    courses = []
    for place, (design, one) in enumerate(flown):
        progress(f"calibrating with {design.words}", 0.2 + 0.8 * place / len(flown))
        if not design.tests:  # pulses of torquers say nothing of S and b
            courses.append(_course(design, record, one, fitted, worst, HALF * now))
    courses.sort(key=lambda one: _rank(one, HALF * now))
    again = [_again(one, record, fit, fitted, worst) for one in courses[:_KEPT]]
    nominal = {"magnetometer.S": np.asarray(fit.calibration.S).tolist()}
    nominal |= {"magnetometer.b_nT": np.asarray(fit.calibration.b_nT).tolist(), "seed": base.seed}
    courses = [
        replace(one, scenario=one.scenario.updated(nominal)) for one in [*again, *courses[_KEPT:]] if one.scenario
    ]
    progress("done", 1.0)
    unit = parameter_unit(worst)
    sentence = _sentence(worst, now, unit, courses)
    return CalibrationPlan(sentence, worst, now, unit, courses, allowed, refused, list(notes))


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
    if best.sigma <= _NEARLY * HALF * now:
        return (
            f"To halve the sigma of {worst}, now {now:.2g}{of}, fly {manoeuvre(best)}. Calibrated "
            f"together with this record, it then falls to {best.sigma:.2g}{of}."
        )
    return (
        f"No manoeuvre within the limits halves the sigma of {worst}, now {now:.2g}{of}. The best one, {manoeuvre(best)}, "
        f"lowers it to {best.sigma:.2g}{of}."
    )


@on_one_blas_thread
@with_reading
@with_assumed
def plan(
    telemetry: Readable | Diagnosis,
    *,
    limits: LimitsSection | Mapping[str, Any] | Path | str | None = None,
    scenario: Scenario | Path | str | None = None,
    names: Sequence[str] = (),
    modelled: Sequence[str] | None = None,
    progress: Progress = usual,
    **options: Unpack[AssumedAndReading],
) -> Plan | CalibrationPlan:
    """What to fly next to settle what a diagnosis leaves open, with the power of each manoeuvre.

    telemetry: a record or its file, which is diagnosed first with the options of `fluxtwin.diagnose`; or a diagnosis, or
    the JSON of one. limits: what may be flown, as `[limits]` in a file. scenario: the spacecraft as it is flown; without
    one its orbit, noise and housekeeping are taken from the record. names: only these effects: one, to
    be shown at its typical size, or several, to be distinguished; `["calibration"]` asks what halves the sigma of the least
    known S or b, by the method that `fluxtwin.calibrate` chooses. modelled: as for `diagnose`.
    Raises BadInput for limits that leave nothing to fly, NoAnswer where nothing is left open.
    """
    assumed: Any = dict(options)
    reading, names = reading_of(assumed), names_in(names)
    field, degree = assumed.get("field"), assumed.get("degree")
    allowed = limits_of(limits)
    config = None if scenario is None else as_scenario(scenario)
    notes = [_INFERRED] if config is None else []
    if names == ["calibration"]:
        if isinstance(telemetry, Diagnosis) or (isinstance(telemetry, Path | str) and str(telemetry).endswith(".json")):
            raise BadInput("a diagnosis has no readings to calibrate", where="plan", wanted="telemetry")
        record = as_record(telemetry, **reading)
        declared = {name: value for name in _KEYS if (value := assumed.get(name)) is not None}
        base = config if config is not None and config.orbit is not None else None
        if base is None:
            base = base_of(diagnosing.diagnose(record, **assumed).to_dict())
            base = base.updated({_KEYS[name]: value for name, value in declared.items()})
        model = as_model(field or base.field.model, degree)
        return plan_calibration(record, base, allowed, model, declared, notes, progress)
    diagnosis: Diagnosis | None
    if isinstance(telemetry, Diagnosis):
        diagnosis, plain = telemetry, telemetry.to_dict()
    elif isinstance(telemetry, Path | str) and str(telemetry).lower().endswith(".json"):
        diagnosis, plain = None, _read(Path(telemetry))
    else:
        diagnosis = diagnosing.diagnose(
            as_record(telemetry, **reading),
            scenario=config,
            modelled=modelled,
            progress=lambda words, share: progress(words, 0.3 * share),
            **assumed,
        )
        plain = diagnosis.to_dict()
    base = config if config is not None and config.orbit is not None else base_of(plain)
    where = View(base, plain["modelled"], field, degree)
    made, refused, limited = fly(base, allowed, lambda words, share: progress(words, 0.35 + 0.4 * share))
    flown = [(design, where.flown(record, design.scenario)) for design, record in made]
    closure = None if diagnosis is None else diagnosis.closure
    here = flown[0][1] if closure is None else Flown(closure.problem, closure.whitener.noise)
    recorded = closure is not None
    open_ = _about(names, plain, here, recorded) if names else questions.asked(plain, here, recorded)
    if not open_:
        raise NoAnswer(
            "the diagnosis leaves nothing open: each named effect is distinguished from the others, and each effect would "
            "show at its typical size"
        )
    found = []
    for place, question in enumerate(open_):
        progress(question.words, 0.75 + 0.25 * place / len(open_))
        found.append(choose(question, flown))
        best = found[-1].best
        if len(question.causes) > 2 and (best is None or not best.settles):
            parts = [choose(part, flown) for part in questions.by_pairs(question)]
            found[-1:] = [*parts, found[-1]]
    progress("done", 1.0)
    return Plan(sentence(found[0]), found, limits=limited, refused=refused, notes=notes)


def sentence(question: Question) -> str:
    """What to do, in one line."""
    best = question.best
    if best is None:
        also = f" The catalogue suggests: {question.instead}." if question.instead else ""
        return f"No manoeuvre within the limits settles {question.words}.{also}"
    sure = f"right with a probability of {percent(best.power)}"
    if not best.settles:
        none = f"No manoeuvre within the limits settles {question.words}."
        return f"{none} After the best, {manoeuvre(best)}, the answer will be {sure}."
    return f"To settle {question.words}, fly {manoeuvre(best)}; the answer will then be {sure}."


def manoeuvre(course: Course | SigmaCourse) -> str:
    """A course as the object of a sentence, with its hours and when it begins."""
    wait = f", {course.wait_days:g} days later" if course.wait_days else ""
    return f"{with_article(course.words.removesuffix(wait))} for {course.hours:.2g} h{wait}"


def with_article(words: str) -> str:
    """A manoeuvre as the object of a sentence: fly a tumble, fly yaw slews."""
    article = {"spin": "a ", "tumble": "a ", "inertial": "an "}.get(words.partition(" ")[0], "")
    return f"{article}{words}"


class View:
    """How a later diagnosis will look at what is flown; field and degree are by default those of the scenario."""

    def __init__(
        self,
        base: Scenario,
        modelled: Sequence[str] = DEFAULT_MODELLED,
        field: str | FieldModel | None = None,
        degree: int | None = None,
    ) -> None:
        self.modelled = modelled
        self.model = as_model(field or base.field.model, base.field.degree if degree is None else degree)
        section, known = base.magnetometer, diagnosing.budget_of(base, (), diagnosing.Declared())
        sigma_rad, tau_s = known.attitude_sigma_rad or 0.0, known.attitude_tau_s or 0.0
        self.budget = replace(known, attitude_sigma_rad=sigma_rad, attitude_tau_s=tau_s)
        white = float(np.hypot(section.white_nT, section.step_nT / np.sqrt(12.0)))
        self.noise = NoiseModel(max(white, 1e-3), sigma_rad, tau_s, roll=known.attitude_roll or ALIKE)

    def flown(self, record: Telemetry, scenario: Scenario) -> Flown:
        """What a diagnosis of a record would see, given the scenario that it was flown by."""
        problem = pose(
            record,
            self.model,
            modelled=self.modelled,
            budget=self.budget,
            instrument=spacecraft.magnetometer(scenario),
            frozen=diagnosing.frozen(scenario),
        )
        return Flown(problem, self.noise)


def _about(names: Sequence[str], plain: Mapping[str, Any], here: Flown, recorded: bool) -> list[questions.Open]:
    for name in names:
        questions.signal(name)
    if len(names) == 1:
        return [questions.to_show(names[0])]
    known = [one for one in plain["effects"] if one["name"] in names]
    likely = here.likeliest(names) if recorded else None
    first = here.plausible(questions.cause_of(known[0])) if known else likely or questions.typical(names[0])
    found = questions.ambiguous([first.name, *names], here, first)
    if not found:
        others = ", ".join(name for name in names if name != first.name)
        raise NoAnswer(f"these data distinguish {first.name} from {others}: nothing needs to be flown for that")
    return found


def limits_of(given: LimitsSection | Mapping[str, Any] | Path | str | None) -> LimitsSection:
    """What may be flown, read and checked."""
    if isinstance(given, LimitsSection):
        return given
    if given is None:
        return LimitsSection()
    if isinstance(given, Mapping):
        return validate({"limits": given}, LimitsFile, where="limits").limits
    return read_model(given, LimitsFile).limits


def _read(path: Path) -> dict[str, Any]:
    wanted = "what fluxtwin diagnose --json wrote"
    found = unsealed_json(text_of(path, wanted=wanted), where=str(path), wanted=wanted)
    if not set(diagnosis_schema()["required"]) <= set(found):
        raise BadInput("this is no diagnosis", where=str(path), wanted=wanted)
    return found


def base_of(plain: Mapping[str, Any]) -> Scenario:
    """The spacecraft of a diagnosis, as its record shows it."""
    tree = plain["provenance"].get("design")
    if tree is None:
        raise BadInput(
            "the diagnosis does not say which orbit was flown", where="plan", wanted="--scenario FILE with [orbit]"
        )
    return validate(tree, Scenario, where="the design of the diagnosis")


def _when(base: Scenario, limits: LimitsSection) -> tuple[np.datetime64, float, float]:
    """A day after the record ends; hours; seconds between rows."""
    assert base.schedule is not None
    last = base.schedule.segments[-1]
    end = epoch.add_seconds(epoch.parse_time(last.start_utc), last.step_s * (last.count - 1))[0]
    start = epoch.add_seconds(end, _DAY_S)[0].astype("datetime64[m]").astype("datetime64[ns]")
    r, v = ephemeris(base, np.array([start]))
    hours = limits.hours or _ORBITS * kepler_period_s(r[0], v[0]) / 3600.0
    step_s = limits.step_s or max(last.step_s, float(np.ceil(3600.0 * hours / _MOST_ROWS)))
    return start, hours, step_s


def fly(
    base: Scenario, limits: LimitsSection, progress: Progress
) -> tuple[list[tuple[Design, Telemetry]], dict[str, str], dict[str, Any]]:
    """Every manoeuvre within the limits, flown; why others are not, by their words; and the limits with hours and step.

    Raises BadInput where none is left.
    """
    start, hours, step_s = _when(base, limits)
    every = designs(base, limits, hours, step_s, start)
    flown, refused = [], {}
    for place, design in enumerate(every):
        progress(design.words, place / len(every))
        record, truth = simulate(design.scenario)
        share = _towards_sun(truth, limits)
        if share:
            refused[design.words] = f"the axis is too near the sun for {100 * share:.0f} % of the time"
        else:
            flown.append((design, record))
    if not flown:
        raise BadInput("no manoeuvre is allowed", where="[limits]", wanted="attitudes that keep the axis from the sun")
    return flown, refused, limits.model_dump(exclude_none=True) | {"hours": hours, "step_s": step_s}


def _towards_sun(truth: Truth, limits: LimitsSection) -> float:
    """Share of the rows in which the axis that must not is too near the sun."""
    if limits.keep_from_sun_B is None:
        return 0.0
    axis = np.array(limits.keep_from_sun_B) / np.linalg.norm(limits.keep_from_sun_B)
    cosine = frames.rotation_from_q(truth.q_NB).apply(sun.sun_direction_N(truth.time, truth.r_N_km)) @ axis
    near = cosine > np.cos(np.radians(limits.keep_from_sun_deg))
    return float(np.mean(near & (truth.illumination > 0.5)))
