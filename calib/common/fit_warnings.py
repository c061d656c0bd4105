"""What about a finished fit should make a person look again; `verdict` says whether it is good."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.robust import find_outliers
from fluxtwin.sim.telemetry.record import Telemetry

F = TypeVar("F", bound=Fit)


def with_warnings(fit: F, telemetry: Telemetry, *, robust: bool) -> F:
    """The fit of a record with its warnings among the messages; none for a fit that looks sound."""
    found = []
    dipole = telemetry.dipole_B_Am2
    if fit.calibration.T_nT_per_Am2 is None and dipole is not None and bool((np.nanstd(dipole, axis=0) > 0).any()):
        found.append("the torquers fired in these data and T was not asked for: compare with parameters b,S,T")
    outliers = 0 if robust else int(find_outliers(fit.residuals_nT).sum())
    if outliers:
        found.append(f"{outliers} rows are outliers (bit errors?): compare with robust weights (tukey)")
    return replace(fit, messages=(*fit.messages, *found))
