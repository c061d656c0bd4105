"""What was applied to the readings on board: undone before a fit, and composed with what the fit finds.

With m what the sensor read, the telemetry holds m' = M' (m - o'). A calibration of the sensor, A B0 = (I+S) m + b + T D,
acts on the telemetry as

    A B0 = (I+S) M'^-1 m' + b + (I+S) o' + T D
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fluxtwin.calib.common.conventions import OffsetFirst, offset_first_from_correction
from fluxtwin.calib.common.records import Calibration, Onboard
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.telemetry.record import Telemetry

UNDONE = "onboard_undone"
"""Key of a record's provenance: what was taken back out of its readings."""


def onboard_of(calibration: Calibration, name: str) -> Onboard:
    """What a calibration did on board, under a name.

    Raises BadInput for one with torquers or fields of a column, and for one of readings that another had corrected.
    """
    if calibration.residual_to:
        raise BadInput(
            f"it acts on readings that {calibration.residual_to} had corrected",
            where=name,
            wanted="a calibration of the sensor",
        )
    T = calibration.T_nT_per_Am2
    if (T is not None and T.any()) or calibration.telemetry_bias:
        raise BadInput(
            "the calibration on board also corrects for torquers or a column; only offset and matrix can be undone",
            where=name,
            wanted="a calibration of offset and matrix alone",
        )
    held = offset_first_from_correction(calibration.correction)
    return Onboard(name, held.M, held.o_nT)


def undone(telemetry: Telemetry, onboard: Onboard) -> Telemetry:
    """The record with what the sensor read. Raises BadInput for readings that were corrected on the ground as well."""
    if telemetry.corrected_by:
        raise BadInput(
            f"the readings are corrected already on the ground (by {telemetry.corrected_by})",
            where="--onboard",
            wanted="the record as it came down",
        )
    reading = OffsetFirst(onboard.M, onboard.o_nT).undo(telemetry.mag_B_nT)
    return telemetry.replace(mag_B_nT=reading, provenance={**telemetry.provenance, UNDONE: onboard.name})


def for_record(calibration: Calibration, telemetry: Telemetry) -> Calibration:
    """The calibration as it acts on the readings of a record: composed, unless what was done on board is undone there."""
    before = calibration.onboard
    if before is None or telemetry.provenance.get(UNDONE):
        return calibration
    return composed(calibration, before)


def composed(calibration: Calibration, onboard: Onboard) -> Calibration:
    """The calibration of readings that `onboard` has corrected; its covariance is carried over."""
    A = np.linalg.inv(onboard.M)
    M = np.eye(3) + calibration.S
    J = np.eye(len(calibration.names))
    J[:9, :9] = np.kron(np.eye(3), A.T)
    J[9:12, :9] = np.kron(np.eye(3), onboard.o_nT[None, :])
    biases = {
        name: replace(bias, value_nT=onboard.M @ bias.value_nT, sigma_nT=np.sqrt(onboard.M**2 @ bias.sigma_nT**2))
        for name, bias in calibration.telemetry_bias.items()
    }
    return replace(
        calibration,
        S=M @ A - np.eye(3),
        b_nT=calibration.b_nT + M @ onboard.o_nT,
        covariance=J @ calibration.covariance @ J.T,
        telemetry_bias=biases,
        onboard=None,
    )
