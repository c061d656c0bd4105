"""One hour of ST5: the scenario, the magnetometer's telemetry without attitude, and the sun pulses between its rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fluxtwin.calib.spin.batch import Noise
from fluxtwin.scenarios import flights
from fluxtwin.scenarios.flights import Flight
from fluxtwin.scenarios.printed import Printed
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

PRINTED = Printed("fluxtwin.scenarios.st5")
"""The abstract's numbers and claims, as packaged."""


def scenario() -> Scenario:
    """The packaged scenario."""
    return parse_scenario(scenario_text(), where="st5.toml")


def scenario_text() -> str:
    """The packaged scenario as it is written, with the source of each number."""
    return PRINTED.text("st5.toml")


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
    told = Telemetry(
        whole.time,
        whole.mag_B_nT,
        r_N_km=whole.r_N_km,
        v_N_km_s=whole.v_N_km_s,
        sun_B=whole.sun_B,
        provenance=dict(whole.provenance),
    )
    return replace(flight, telemetry=told)


world_of = build_world
"""Orbit, sun and field; the same for any seed and attitude."""
