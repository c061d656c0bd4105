"""Warnings about the input: they do not stop a diagnosis but must be said."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from fluxtwin.calib.checks.check import check_telemetry
from fluxtwin.calib.checks.copies import without_stuck
from fluxtwin.calib.checks.report import Finding
from fluxtwin.gap.noise.choice import NOISE_LOG_SD, NoiseModel
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.effects.response import Saturation
from fluxtwin.sim.telemetry.record import Telemetry

MISFIT = 0.05
"""Residual over field: a reference that is 3 degrees off."""


def far_below_budget(before_nT: float, floor_nT: float, declared: bool) -> str | None:
    """Words for a budget, declared or found, that promises far more noise than there is, or None."""
    if before_nT * 2.0 > floor_nT:  # a declared noise is trusted to a factor 1.5 at most
        return None
    whose, mend = ("declared", "Correct") if declared else ("estimated", "Declare")
    return (
        f"the residual is {before_nT:.1f} nT rms, but the {whose} noise and attitude error would give {floor_nT:.1f} nT: "
        f"they are too large and hide smaller effects. {mend} --noise-nT and --attitude-sigma-deg"
        f"{', or leave them out' if declared else ''}"
    )


def noise_below(noise: NoiseModel, declared_nT: float | None) -> str | None:
    """Words for white noise that is less than was declared, by three standard deviations of both, or None.

    A declared noise is trusted to 10 %. Rounding is part of what was found, and not of what was declared.
    """
    found_nT = noise.white_rms_nT
    if not declared_nT or found_nT >= declared_nT * np.exp(-3.0 * np.hypot(NOISE_LOG_SD, noise.sigma_log_sd)):
        return None
    return (
        f"the white noise of these readings is {found_nT:.3g} +- {found_nT * noise.sigma_log_sd:.1g} nT per axis, and "
        f"{declared_nT:.3g} nT were declared, which is trusted to {100 * NOISE_LOG_SD:.0f} %: too much noise hides smaller "
        "effects. Correct --noise-nT, or leave it out"
    )


def without_unknown_dipole(telemetry: Telemetry, estimated: bool) -> tuple[Telemetry, int]:
    """The record without the readings of rows whose torquer dipole is missing, and how many these are; where that is missing
    throughout, the record without a dipole, or BadInput where its field is to be estimated."""
    dipole = telemetry.dipole_B_Am2
    known: BoolArray = np.asarray(dipole is not None and np.isfinite(dipole).all(axis=1))
    if not known.any():
        if estimated:
            raise BadInput(
                "torquer_coupling follows the torquer dipole, and the telemetry has none",
                where="--modelled",
                wanted="dipole_x_Am2 dipole_y_Am2 dipole_z_Am2 in the telemetry, or --modelled without torquer_coupling",
            )
        return telemetry.replace(dipole_B_Am2=None), 0
    mag_B_nT = np.where(known[:, None], telemetry.mag_B_nT, np.nan)
    return telemetry.replace(mag_B_nT=mag_B_nT), int((telemetry.has_reading & ~known).sum())


def traps(telemetry: Telemetry, model: FieldModel) -> list[Finding]:
    """The traps that `fluxtwin check` finds, but outliers and what is stuck at times: the diagnosis sets them aside and says
    so itself."""
    found = check_telemetry(without_stuck(telemetry)[0], model).traps
    return [finding for finding in found if finding.code != "outliers"]


def unnamed(traps: Sequence[Finding], names: Collection[str]) -> list[str]:
    """What the traps say, but for a range that is too small where that is what a diagnosis names."""
    return [one.text for one in traps if one.code != "saturated" or Saturation.name not in names]


def stuck_attitude(telemetry: Telemetry, attitude_sigma_rad: float | None) -> str | None:
    """Words for a reference attitude that stands still, or None.

    An inertial hold stands still rightly. So the quaternion must be the same to the last digit over more than half of
    the rows, or over a long stretch while it changes elsewhere, and something must speak against a hold: an error
    was declared (errors do not repeat), or a gyro that turns; where neither is there, see `stuck_and_misfit`.
    """
    if (standing := _standing(telemetry)) is None:
        return None
    (stretch, share, same), against = standing, None
    if attitude_sigma_rad is not None and attitude_sigma_rad > 0.0:
        against = f"with the declared error of {np.degrees(attitude_sigma_rad):.3g} deg it would change from row to row"
    elif telemetry.rate_B_rad_s is not None:
        rate = np.linalg.norm(telemetry.rate_B_rad_s[same], axis=1)
        turned = float(np.nanmedian(rate)) * stretch if np.isfinite(rate).any() else 0.0
        if turned > MISFIT:
            against = f"according to the gyro the body turned by {np.degrees(turned):.3g} deg meanwhile"
    return None if against is None else _words(stretch, share, against)


def stuck_and_misfit(telemetry: Telemetry, before_nT: float) -> str | None:
    """The same after the fit: an attitude that stands still, and readings that do not fit it. before_nT: residual rms."""
    standing = _standing(telemetry)
    field_nT = float(np.sqrt(np.nanmean(telemetry.mag_B_nT**2)))
    if standing is None or before_nT < MISFIT * field_nT:
        return None
    return _words(*standing[:2], f"the readings do not fit it ({before_nT:.0f} nT rms residual)")


def _words(stretch_s: float, share: float, against: str) -> str:
    length = f"{stretch_s / 3600.0:.2g} h" if stretch_s >= 3600.0 else f"{stretch_s / 60.0:.2g} min"
    return (
        f"the reference attitude looks stuck: it repeats to the last digit in {100.0 * share:.0f} % of the rows, for up "
        f"to {length}, and {against}. Blank those cells"
    )


def _standing(telemetry: Telemetry) -> tuple[float, float, np.ndarray] | None:
    """Longest stretch [s] and share of suspicious rows, and the rows (N,); None where nothing is suspicious."""
    if telemetry.q_NB is None or len(telemetry) < 2:
        return None
    same = np.zeros(len(telemetry), dtype=bool)
    same[1:] = (telemetry.q_NB[1:] == telemetry.q_NB[:-1]).all(axis=1)
    known = max(int(telemetry.has_attitude.sum()) - 1, 1)
    share = float(same.sum()) / known
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    if not edges.size:
        return None
    first, last = edges[::2] - 1, edges[1::2] - 1
    longest = int(np.argmax(last - first))
    # Thirty rows with the same quaternion to the last digit do not happen while a sensor measures.
    if share <= 0.5 and last[longest] - first[longest] + 1 < 30:
        return None
    times = epoch.seconds_since(telemetry.time, telemetry.time[0])
    return float(times[last[longest]] - times[first[longest]]), share, same
