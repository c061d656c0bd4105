"""One hour of ST5: the scenario, the magnetometer's telemetry without attitude and the sun pulses between its rows, and the
abstract's own terms: raw = R A H + b, R = exp(-[v x]) the passive turn of the misalignment v."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fluxtwin.calib.common.conventions import Correction, forward_from_correction, polar_split
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.spin.batch import Noise
from fluxtwin.calib.spin.motion import turn_vector
from fluxtwin.scenarios import flights
from fluxtwin.scenarios.flights import Flight, Mission, Numbers
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.run.world import World
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

PRINTED = Mission("fluxtwin.scenarios.st5")
"""The abstract's numbers and claims, as packaged."""
scenario, scenario_text = PRINTED.scenario, PRINTED.scenario_text
_STEP = 1e-6


def published() -> Mapping[str, Any]:
    """What the abstract prints, as packaged."""
    content: Mapping[str, Any] = json.loads(PRINTED.text("data/published.json"))
    return content


def noises() -> Noise:
    """What the abstract states of the sensors."""
    printed = published()
    return Noise(float(printed["noise_mG"]) * NT_PER_MG, float(np.radians(printed["sun_noise_deg"])))


def attitude_error_deg(A: FloatArray, q_NB: FloatArray) -> FloatArray:
    """(N, 3) e of A = exp(-[e x]) A_true, in B [deg]; A (N, 3, 3) from N to B, q_NB (N, 4) the truth."""
    true = frames.rotation_from_q(q_NB).as_matrix()
    d = A @ true.transpose(0, 2, 1)
    axial = np.stack([d[:, 1, 2] - d[:, 2, 1], d[:, 2, 0] - d[:, 0, 2], d[:, 0, 1] - d[:, 1, 0]], axis=1)
    return np.asarray(np.degrees(0.5 * axial))


def fly(config: Scenario, world: World | None = None) -> Flight:
    """Run a scenario in mode spin; `world` if it is known already.

    The telemetry has the rows of the magnetometer, and rows that hold a sun pulse alone; no attitude. The truth has the
    rows of the magnetometer.
    """
    flight = flights.fly(config, world)
    whole = flight.telemetry
    assert whole.sun_B is not None
    kept = {name: getattr(whole, name) for name in ("time", "mag_B_nT", "r_N_km", "v_N_km_s", "sun_B")}
    return replace(flight, telemetry=Telemetry(**kept, provenance=dict(whole.provenance)))


def terms_of(calibration: Calibration) -> Numbers:
    """From S, b of equation 1. R is the rotation in (I+S)^-1; scale and non-orthogonality stay out of it."""
    x = calibration.values[:12]
    scale = np.where(np.arange(12) < 9, _STEP, _STEP * 1e5)
    slope = np.stack([(_terms(x + h) - _terms(x - h)) / (2.0 * h.max()) for h in np.diag(scale)], axis=1)
    values = _terms(x)
    return Numbers(
        # (6,) b [mG] and v [deg], and 1 sigma.
        values=values,
        sigma=np.sqrt(np.diag(slope @ calibration.covariance[:12, :12] @ slope.T)),
        b_mG=values[:3],
        misalignment_deg=values[3:],
    )


def _terms(x: FloatArray) -> FloatArray:
    forward = forward_from_correction(Correction(x[:9].reshape(3, 3), x[9:]))
    R, _ = polar_split(forward.G)
    return np.concatenate([forward.o_nT / NT_PER_MG, np.degrees(-turn_vector(R))])


def truth_terms() -> FloatArray:
    """(6,) b [mG] and misalignment [deg] of the abstract."""
    printed = published()
    return np.array([*printed["b_mG"], *printed["misalignment_deg"]])
