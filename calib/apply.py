"""Corrected telemetry: the reading replaced by the estimate of the true field."""

from __future__ import annotations

from fluxtwin.calib.records import CONVENTION, Calibration
from fluxtwin.sim.telemetry import Telemetry, recorded_columns


def apply_calibration(telemetry: Telemetry, calibration: Calibration) -> Telemetry:
    """The same telemetry with `mag_B_nT` replaced by (I+S) B + b + T D (journal eq. 1), noted in provenance.

    Raises BadInput when the calibration has a T and the telemetry no dipole, or a column that it needs is missing.
    """
    corrected = calibration.apply(telemetry.mag_B_nT, telemetry.dipole_B_Am2, recorded_columns(telemetry))
    note = f"(I+S) B + b + T D of {CONVENTION!r}, made by {calibration.method or 'hand'}"
    return telemetry.replace(mag_B_nT=corrected, provenance={**telemetry.provenance, "calibration": note})
