"""Are these readings raw, or calibrated already? |B| tells, without attitude."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.checks.report import Finding, note
from fluxtwin.calib.checks.sample import FEWEST, comparable
from fluxtwin.calib.common.conventions import OffsetFirst
from fluxtwin.calib.common.records import Onboard
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

CALIBRATED_NT, RAW_NT = 300.0, 1000.0
"""Misfit of |B| up to which readings look calibrated (a field model is off by 150 nT, 1 sigma, and noise comes on top), and
from which they do not (magnetometers fly with biases of thousands). Between them nothing is said."""
NOT_APPLIED = "the readings are raw, it was not applied"
CLEAR = 1.5
"""One way of taking an on-board calibration must fit so many times better than the others."""


def check_calibrated(
    telemetry: Telemetry, model: FieldModel, usable: BoolArray, onboard: Onboard | None
) -> list[Finding]:
    """The note `calibrated_or_raw`; none where positions are missing, the record says it itself, or the data do not show it.

    usable: (N,) rows. onboard: what is said to have been applied on board: then it is also undone, and applied once more.
    """
    sample = comparable(telemetry, model, usable, with_attitude=False)
    if sample is None or len(sample) < FEWEST or telemetry.corrected_by:
        return []
    size_nT = np.linalg.norm(sample.field_N_nT, axis=1)
    as_is = _misfit_nT(sample.mag_nT, size_nT)
    if onboard is not None:
        held = OffsetFirst(onboard.M, onboard.o_nT)
        undone, applied = (_misfit_nT(change(sample.mag_nT), size_nT) for change in (held.undo, held.apply))
        said = "these data do not tell whether it was applied"
        if CLEAR * applied < min(as_is, undone):
            said = f"{NOT_APPLIED}; calibrate without --onboard"
        elif CLEAR * as_is < min(applied, undone):
            said = "the readings are corrected by it already; calibrate --onboard undoes that"
        elif CLEAR * undone < min(applied, as_is):
            said = "it was applied and makes the readings worse, or it belongs to another sensor"
        return [
            note("calibrated_or_raw.onboard", as_is=as_is, undone=undone, applied=applied, name=onboard.name, said=said)
        ]
    if CALIBRATED_NT < as_is < RAW_NT:
        return []
    calibrated = as_is <= CALIBRATED_NT
    return [note("calibrated_or_raw.calibrated" if calibrated else "calibrated_or_raw.raw", misfit=as_is)]


def _misfit_nT(mag_nT: FloatArray, size_nT: FloatArray) -> float:
    """Of |B|, as an rms that single outliers do not move."""
    return float(1.4826 * np.median(np.abs(np.linalg.norm(mag_nT, axis=1) - size_nT)))
