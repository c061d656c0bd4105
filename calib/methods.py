"""Which estimator a `--method` names, and what each takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from fluxtwin.calib.common.design import joined
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.verdict import judge
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

WITH_ATTITUDE = ("linear", "forward")
WITHOUT_ATTITUDE = ("center", "twostep", "scalar")
SPINNING = ("iterative", "batch")
RECURSIVE = "recursive"
METHODS = (*WITH_ATTITUDE, *WITHOUT_ATTITUDE, *SPINNING, RECURSIVE)
_OF_SPINNERS = ("sun_sigma_deg", "sun_alignment_deg", "inertia_ratio", "torque_walk_rad_s")
_OF_REGRESSIONS = ("block_s", "field_error_nT", "passes")
_OF_ATTITUDE = ("attitude_sigma_deg", "attitude_tau_s")


def default_method(records: Telemetry | Sequence[Telemetry]) -> str:
    """`linear` where any row has reading, position and attitude, else `scalar`."""
    telemetry = joined(records)
    return (
        "linear" if bool((telemetry.has_attitude & telemetry.has_reading & telemetry.has_position).any()) else "scalar"
    )


def calibrate_by(
    records: Telemetry | Sequence[Telemetry], model: FieldModel, method: str | None = None, **options: Any
) -> Fit:
    """Calibrate by the method of that name, None for `default_method`.

    options: those of `linear.calibrate_linear`, `scalar.calibrate_scalar`, `spin.calibrate_spin` or
    `recursive.calibrate_recursive`; one that is None is as if not given.
    Raises BadInput for an unknown method, and for an option that the method does not take.
    """
    if method is not None and method not in METHODS:
        raise BadInput(f"{method!r} is no method", where="--method", wanted=" or ".join(METHODS))
    chosen = default_method(records) if method is None else method
    given = {name: value for name, value in options.items() if value is not None}
    telemetry = joined(records)
    fit = _named(_fit(telemetry, model, chosen, given), telemetry)
    sigma_deg, reference = given.get("attitude_sigma_deg"), chosen in WITH_ATTITUDE
    return replace(fit, verdict=judge(fit, telemetry, attitude_sigma_deg=sigma_deg, against_attitude=reference))


def _named(fit: Fit, telemetry: Telemetry) -> Fit:
    """The fit with whose magnetometer it is, and by what its readings had been corrected."""
    calibration = replace(fit.calibration, spacecraft=telemetry.spacecraft, residual_to=telemetry.corrected_by)
    if not telemetry.corrected_by:
        return replace(fit, calibration=calibration)
    residual = (
        f"the readings are corrected already (by {telemetry.corrected_by}): S, b and T are what that calibration has left, "
        "and act on readings that it has corrected"
    )
    return replace(fit, calibration=calibration, messages=(residual, *fit.messages))


def _fit(records: Telemetry, model: FieldModel, chosen: str, given: dict[str, Any]) -> Fit:
    if chosen in SPINNING:
        return _calibrate_spinner(records, model, chosen, given)
    if chosen == RECURSIVE:
        return _calibrate_recursive(records, model, given)
    _refuse(given, _OF_SPINNERS, chosen, "batch")
    if chosen in WITH_ATTITUDE:
        from fluxtwin.calib.linear.calibrate import calibrate_linear

        _refuse(given, ("telemetry_bias",), chosen, "scalar")
        return calibrate_linear(records, model, direction=chosen, **given)
    from fluxtwin.calib.scalar.calibrate import calibrate_scalar

    _refuse(given, ("errors_in_variables", "weights", "direction", *_OF_ATTITUDE), chosen, "linear")
    return calibrate_scalar(records, model, method=chosen, **given)


def _calibrate_recursive(records: Telemetry, model: FieldModel, given: dict[str, Any]) -> Fit:
    from fluxtwin.calib.attitude.recursive import calibrate_recursive

    _refuse(given, _OF_SPINNERS[1:], RECURSIVE, "iterative")
    _refuse(given, ("errors_in_variables", "weights", "direction", *_OF_REGRESSIONS), RECURSIVE, "linear")
    _refuse(given, ("telemetry_bias",), RECURSIVE, "scalar")
    return calibrate_recursive(records, model, **given)


def _calibrate_spinner(
    records: Telemetry | Sequence[Telemetry], model: FieldModel, method: str, given: dict[str, Any]
) -> Fit:
    from fluxtwin.calib.spin.calibrate import calibrate_spin

    _refuse(given, ("errors_in_variables", "weights", "direction", *_OF_REGRESSIONS, *_OF_ATTITUDE), method, "linear")
    _refuse(given, ("telemetry_bias",), method, "scalar")
    parameters = given.pop("parameters", "b,S")
    if parameters != "b,S":
        raise BadInput(f"{parameters!r}", where="--parameters", wanted=f"'b,S': method {method} finds both")
    return calibrate_spin(records, model, method=method, **given)


def _refuse(given: dict[str, Any], names: tuple[str, ...], method: str, other: str) -> None:
    for name in names:
        value = given.get(name)
        if value is not None and not (isinstance(value, tuple | list) and not value):
            option = name.replace("_", "-")
            raise BadInput(
                f"the method {method} has no use for it",
                where=f"--{option}",
                wanted=f"--method {other}, or leave it out",
            )
        given.pop(name, None)
