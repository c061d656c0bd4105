"""The methods of calibration: the registry, and what a method takes.

A new method is its options in `common/options.py`, the function that fits, and an entry of `ESTIMATORS`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from fluxtwin.calib.common.options import (
    OPTIONS,
    Estimator,
    GyroOptions,
    LinearOptions,
    Option,
    RecursiveOptions,
    ScalarOptions,
    SpinOptions,
)
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.progress import Progress, part_of, silent

if TYPE_CHECKING:
    import numpy as np

    from fluxtwin.calib.common.fit import Fit
    from fluxtwin.sim.earth.field import FieldModel
    from fluxtwin.sim.telemetry.record import Telemetry

F = TypeVar("F", bound=Callable[..., Any])

_LINEAR = "fluxtwin.calib.linear.calibrate:calibrate_linear"
_SCALAR = "fluxtwin.calib.scalar.calibrate:calibrate_scalar"
_SPIN = "fluxtwin.calib.spin.calibrate:calibrate_spin"
_RECURSIVE = "fluxtwin.calib.attitude.recursive:calibrate_recursive"
_GYRO = "fluxtwin.calib.gyro.calibrate:calibrate_gyro"
# |B| knows nothing of the attitude, so no error of an attitude is in what `scalar` says of a column.
ESTIMATORS: dict[str, Estimator] = {
    one.name: one
    for one in (
        Estimator("linear", ("positions", "attitude"), LinearOptions, _LINEAR),
        Estimator("forward", ("positions", "attitude"), LinearOptions, _LINEAR),
        Estimator("center", ("positions",), ScalarOptions, _SCALAR, drivers_by=_SCALAR),
        Estimator("twostep", ("positions",), ScalarOptions, _SCALAR, drivers_by=_SCALAR),
        Estimator("scalar", ("positions",), ScalarOptions, _SCALAR),
        Estimator("batch", ("positions", "sun pulses"), SpinOptions, _SPIN, drivers_by=_SCALAR),
        Estimator("iterative", ("positions", "sun pulses"), SpinOptions, _SPIN, drivers_by=_SCALAR),
        Estimator("recursive", ("positions", "attitude, or nadir and sun"), RecursiveOptions, _RECURSIVE, _SCALAR),
        Estimator("gyro", ("body rates",), GyroOptions, _GYRO),
    )
}
ALL = "all"
"""In place of a method's name: all of them, compared."""


class Offered(NamedTuple):
    """One option as the command line and the signature of `fluxtwin.calibrate` offer it."""

    name: str
    option: Option
    annotation: str
    default: Any
    """That of the methods where all of them share it; else None, which is the method's own."""


def offered() -> list[Offered]:
    """The method and the options of all methods, each once."""
    out = [Offered("method", OPTIONS["method"], "str | None", None)]
    for name, option in OPTIONS.items():
        items = [estimator.takes[name] for estimator in ESTIMATORS.values() if name in estimator.takes]
        if not items:
            continue
        of_all = len(items) == len(ESTIMATORS) and len({str(item.default) for item in items}) == 1
        default = items[0].default if of_all else None
        kind = items[0].type.removesuffix(" | None")
        out.append(Offered(name, option, kind if default is not None else f"{kind} | None", default))
    return out


def with_parameters(verb: F, added: Sequence[inspect.Parameter], said: str) -> F:
    """The verb with these in the place of its `**` keywords, in its signature and, as `said`, in its docstring."""
    own = inspect.signature(verb)
    kept = [one for one in own.parameters.values() if one.kind is not one.VAR_KEYWORD]
    keywords = [one.replace(kind=one.KEYWORD_ONLY) for one in added]
    verb.__signature__ = own.replace(parameters=[*kept, *keywords])  # type: ignore[attr-defined]
    verb.__doc__ = f"{inspect.cleandoc(verb.__doc__ or '')}\n\n{said}\n"
    return verb


def with_options(verb: F) -> F:
    """The verb, whose `**options` are those of the methods: its signature and its docstring name them."""
    kind = inspect.Parameter.KEYWORD_ONLY
    added = [inspect.Parameter(one.name, kind, default=one.default, annotation=one.annotation) for one in offered()]
    return with_parameters(verb, added, "\n".join(f"{one.name}: {one.option.help}" for one in offered()))


def require(method: str | None, given: Mapping[str, Any]) -> None:
    """Raises BadInput for an unknown method or a value that is not allowed, before anything is read.

    Where no method is named the options are held against those of `linear`, which takes the most values.
    """
    if method is not None and method not in (*ESTIMATORS, ALL):
        raise BadInput(f"{method!r} is not a method", where="--method", wanted=" or ".join((*ESTIMATORS, ALL)))
    if method == ALL:
        return  # each method judges its own
    estimator = ESTIMATORS[method or "linear"]
    if method is None:
        given = {name: value for name, value in given.items() if name in estimator.takes}
    estimator.options(method=estimator.name, **_taken(estimator, given))


def default_method(records: Telemetry | Sequence[Telemetry]) -> str:
    """`linear` where any row has reading, position and attitude, else `scalar`."""
    from fluxtwin.calib.common.design import joined

    telemetry = joined(records)
    complete = telemetry.has_attitude & telemetry.has_reading & telemetry.has_position
    return "linear" if bool(complete.any()) else "scalar"


def calibrate_by(
    records: Telemetry | Sequence[Telemetry],
    model: FieldModel,
    method: str | None = None,
    *,
    progress: Progress = silent,
    **given: Any,
) -> Fit:
    """Calibrate by the method of that name, None for `default_method`, with the verdict on the answer. Rows in which an axis
    is stuck are left out, and the verdict says so.

    `all` compares the methods by their errors on rows that they have not seen, and takes one (`comparison`).

    given: options of the method, by the fields of its options; one that is None is as if not given.
    Raises BadInput for an unknown method, and for an option that the method does not take.
    """
    from fluxtwin.calib.checks.copies import saying_stuck, stuck_words, without_stuck
    from fluxtwin.calib.common.coverage import coverage_of
    from fluxtwin.calib.common.design import joined, reference_field_B_nT
    from fluxtwin.calib.common.orbit_error import with_orbit_error
    from fluxtwin.calib.common.verdict import assess

    require(method, given)
    whole = joined(records)
    telemetry, stuck = without_stuck(whole)
    if method == ALL:
        from fluxtwin.calib.common.comparison import compare

        wanted = {name: value for name, value in given.items() if value is not None}
        compared = compare(telemetry, model, ESTIMATORS, wanted, part_of(progress, 0.0, 0.8))
        taken = {name: value for name, value in wanted.items() if name in ESTIMATORS[compared.chosen].takes}
        fit = calibrate_by(whole, model, compared.chosen, progress=part_of(progress, 0.8, 1.0), **taken)
        return replace(fit, comparison=compared)
    estimator = ESTIMATORS[default_method(telemetry) if method is None else method]
    taken = _taken(estimator, given)
    with saying_stuck(telemetry, stuck):
        fit = estimator.fit(telemetry, model, taken, progress)
    fit = with_orbit_error(fit, telemetry, lambda moved: estimator.fit(moved, model, taken, sigmas=False))
    fit = _named(fit, telemetry)
    if stuck.any():
        fit = replace(fit, warnings=(*fit.warnings, f"{stuck_words(telemetry.time, stuck)}."))
    sigma_deg, reference = given.get("attitude_sigma_deg"), "attitude" in estimator.needs
    of_size = fit.residuals_nT.shape[1] == 1
    verdict = assess(
        fit,
        telemetry,
        attitude_sigma_deg=sigma_deg,
        against_attitude=reference,
        reference_nT=reference_field_B_nT(telemetry, model) if of_size else None,
    )
    return replace(fit, verdict=verdict, coverage=coverage_of(fit, telemetry))


def _taken(estimator: Estimator, given: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are given. Raises BadInput for one that the method does not take."""
    taken = {}
    for name, value in given.items():
        if name == "method" or value is None or (isinstance(value, tuple | list) and not value):
            continue
        if name not in estimator.takes:
            others = [other.name for other in ESTIMATORS.values() if name in other.takes]
            raise BadInput(
                f"the method {estimator.name} has no use for it",
                where=f"--{name.replace('_', '-')}",
                wanted=f"--method {' or '.join(others)}, or leave it out" if others else "nothing of that name",
            )
        taken[name] = value
    return taken


def _named(fit: Fit, telemetry: Telemetry) -> Fit:
    """The fit with whose magnetometer it is, and by what its readings had been corrected."""
    calibration = replace(
        fit.calibration,
        spacecraft=telemetry.spacecraft,
        magnetometer=telemetry.magnetometer,
        residual_to=telemetry.corrected_by,
        temperature_degC=_temperature(telemetry, fit.rows),
    )
    if not telemetry.corrected_by:
        return replace(fit, calibration=calibration)
    residual = (
        f"the readings are corrected already (by {telemetry.corrected_by}): S, b and T are what that calibration has left, "
        "and act on readings that it has corrected"
    )
    return replace(fit, calibration=calibration, messages=(residual, *fit.messages))


def _temperature(telemetry: Telemetry, rows: np.ndarray) -> tuple[float, float] | None:
    """Lowest and highest in the rows that were used, to a hundredth; None where it is not known."""
    import numpy as np

    if telemetry.temperature_degC is None:
        return None
    seen = telemetry.temperature_degC[rows]
    seen = seen[np.isfinite(seen)]
    return (round(float(seen.min()), 2), round(float(seen.max()), 2)) if seen.size else None
