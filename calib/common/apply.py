"""Corrected telemetry: the reading replaced by the estimate of the true field, and what a record says of it."""

from __future__ import annotations

import re
import warnings

import numpy as np

from fluxtwin.calib.common.onboard import for_record
from fluxtwin.calib.common.records import CONVENTION, Calibration
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.late import varies
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.record import Telemetry, plain_text, recorded_columns

_DIGEST_SHOWN = 12  # hexadecimal digits: of a million calibrations two agree by chance with a probability of 0.2 %
_NEAR_DEGC = 1.0  # no magnetometer that is worth calibrating changes within a degree
_STAMP = re.compile(
    r"calibration ([0-9a-f]{12}(?: then [0-9a-f]{12})*)(?: \((?:residual|noise) ([0-9.eE+-]+) nT\))?(?: with (.+))?"
)


def apply_calibration(
    telemetry: Telemetry, calibration: Calibration, *, force: bool = False, sigma_is: str = "residual"
) -> Telemetry:
    """The same telemetry with `mag_B_nT` replaced by (I+S) B + b + T D (journal eq. 1); its provenance says so.

    sigma_is: what the calibration's `sigma_nT` is: the residual of its fit, or the `noise` of a reading.
    Raises BadInput when the calibration does not fit the record (`require_applicable`; force lets it pass), has a T and
    the telemetry no dipole, or a column that it needs is missing. Warns where the record leaves the time or the temperatures
    that the calibration has seen, and where it has expired.
    """
    if not force:
        require_applicable(telemetry, calibration)
    _warn_outside(telemetry, calibration)
    here = for_record(calibration, telemetry)
    corrected = here.apply(telemetry.mag_B_nT, telemetry.dipole_B_Am2, here.columns_of(telemetry))
    span = "" if calibration.span is None else f", {_span_words(calibration)}"
    note = (
        f"{CONVENTION!r} by {calibration.method or 'hand'}, of {calibration.spacecraft or 'unnamed spacecraft'}{span}"
    )
    own = calibration.digest[:_DIGEST_SHOWN]
    match = _STAMP.match(telemetry.corrected_by)
    chain = f"{match[1]} then {own}" if match else own
    of_before = match[3].split("; ") if match and match[3] else []
    of_this = [
        *(["T"] if here.T_nT_per_Am2 is not None and here.T_nT_per_Am2.any() else []),
        *calibration.telemetry_bias,
    ]
    also = "; ".join(dict.fromkeys([*of_before, *of_this]))
    known = f" ({sigma_is} {calibration.sigma_nT:.3g} nT)" if calibration.sigma_nT else ""
    words = f"calibration {chain}{known}{f' with {also}' if also else ''}"
    stamped = {"calibration": plain_text(words), "calibration_note": note}  # the same in every kind of file
    return telemetry.replace(mag_B_nT=corrected, provenance={**telemetry.provenance, **stamped})


def require_applicable(telemetry: Telemetry, calibration: Calibration) -> None:
    """Raises BadInput for readings that are corrected already, another spacecraft and another magnetometer."""
    before, of_before = telemetry.corrected_by, calibration.residual_to
    ours, theirs = plain_text(telemetry.spacecraft), plain_text(calibration.spacecraft)
    found, wanted = "", ""
    if before and of_before != before:
        found = f"the readings are corrected already (by {before})"
        wanted = "the record as the sensor gave it; --force corrects them once more"
    elif of_before and not before:
        found = f"the calibration was made of readings that {of_before} had corrected; these are not corrected"
        wanted = "that calibration applied first; --force applies this one anyway"
    elif ours and theirs and ours != theirs:
        found = f"the telemetry is of {ours!r}, the calibration of {theirs!r}"
        wanted = "telemetry and calibration of one spacecraft; --force applies it anyway"
    elif (one := calibration.magnetometer) != telemetry.magnetometer:
        found = f"the readings are of magnetometer {telemetry.magnetometer}, the calibration is of {one}"
        wanted = f"--magnetometer {one}, or the other calibration; --force applies it anyway"
    if found:
        raise BadInput(found, where=telemetry.provenance.get("source", "telemetry"), wanted=wanted)


def waived(telemetry: Telemetry, calibration: Calibration) -> str | None:
    """What `require_applicable` would refuse, in words, for a caller that goes on all the same; None where it would not."""
    try:
        require_applicable(telemetry, calibration)
    except BadInput as refusal:
        return str(refusal)
    return None


def outside_span(telemetry: Telemetry, calibration: Calibration) -> int:
    """Rows before or after the data from which the calibration was made."""
    if calibration.span is None:
        return 0
    first, last = calibration.span
    return int(((telemetry.time < first) | (telemetry.time > last)).sum())


def _warn_outside(telemetry: Telemetry, calibration: Calibration) -> None:
    """Where a record leaves the time or the temperatures from which the calibration was made, or the calibration expires."""
    beyond, ends = outside_span(telemetry, calibration), calibration.expires
    late = 0 if ends is None else int((telemetry.time >= ends).sum())
    if beyond or late:
        made = (
            ""
            if calibration.span is None
            else f"the calibration was made from the data of {_span_words(calibration)}; "
        )
        rows = f"{beyond} of the {len(telemetry)} rows here are of another time, "
        held = "in which it is assumed to hold unchanged"
        if ends is not None and late:
            held = (
                f"{late} are after {epoch.iso(ends, 's')}, when it expires: the drift that `fluxtwin trend` found has then "
                "made it wrong by three of its sigmas"
            )
        warnings.warn(f"{made}{rows}{held}", stacklevel=5)
    seen, known = telemetry.temperature_degC, calibration.temperature_degC
    if seen is None or known is None:
        return
    off = np.maximum(known[0] - seen, seen - known[1])
    if hot_or_cold := int(np.nansum(off > _NEAR_DEGC)):
        warnings.warn(
            f"{hot_or_cold} of {len(telemetry)} rows have the magnetometer at temperatures that the calibration has not "
            f"seen ({known[0]:.1f} to {known[1]:.1f} degC), by up to {np.nanmax(off):.1f} degC",
            stacklevel=5,
        )


def _span_words(calibration: Calibration) -> str:
    assert calibration.span is not None
    return f"{epoch.iso(calibration.span[0])} to {epoch.iso(calibration.span[1])}"


def calibration_of(telemetry: Telemetry, calibration: Calibration | None, *, force: bool = False) -> Calibration:
    """What still has to be applied to a record: the calibration, or nothing where its readings are corrected.

    None is for a corrected record: S = 0, b = 0, and the residual or noise that its mark states. Raises BadInput for
    None with readings that are not corrected, and as `require_applicable`, unless force.
    """
    if calibration is not None:
        if not force:
            require_applicable(telemetry, calibration)
        _warn_outside(telemetry, calibration)
        return for_record(calibration, telemetry)
    if not telemetry.corrected_by:
        raise BadInput(
            "the readings are not corrected, and no calibration is given",
            where=telemetry.provenance.get("source", "telemetry"),
            wanted="--calibration FILE.toml, or a record that fluxtwin apply has written",
        )
    return Calibration(np.zeros((3, 3)), np.zeros(3), sigma_nT=known_sigma_nT(telemetry) or 0.0)


def corrected_effects(telemetry: Telemetry) -> tuple[str, ...]:
    """Names of the effects, beside b and S, of which the calibration of corrected readings had estimates, by their mark.

    Of those whose columns are known and change where there are readings: what the estimates are wrong by is still in these.
    """
    match = _STAMP.match(telemetry.corrected_by)
    names = match[3].split("; ") if match and match[3] else []
    read = telemetry.has_reading if telemetry.r_N_km is None else telemetry.has_reading & telemetry.has_position
    columns = {name: np.atleast_2d(column[read].T) for name, column in recorded_columns(telemetry).items()}
    columns["T"] = columns.pop("dipole_B_Am2", np.zeros((0, 0)))
    moving = [name for name in names if read.any() and any(map(varies, columns.get(name, ())))]
    return tuple("torquer_coupling" if name == "T" else f"driver.{name.removeprefix('driver_')}" for name in moving)


def known_sigma_nT(telemetry: Telemetry) -> float | None:
    """Residual or noise of a component [nT] that the mark of corrected readings states; None where unknown."""
    match = _STAMP.match(telemetry.corrected_by)
    return None if match is None or match[2] is None else float(match[2])
