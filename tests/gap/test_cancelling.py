"""A pair whose signals undo each other is seen, one that adds up is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from worlds import scenario_text

from fluxtwin.gap.noise.whitening import NoiseModel, make_whitener
from fluxtwin.gap.problem.problem import Problem, pose
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.selection.collinear import undone
from fluxtwin.gap.selection.refit import Readings, refit
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
mode = "spin"
spin_axis_N = [0.36, 0.48, 0.8]
spin_rate_rpm = 1.6
nutation_deg = 3.0
"""
SPIN = scenario_text(
    SECTIONS,
    seed=1,
    inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
    altitude_km=600.0,
    inclination_deg=97.8,
    segment="samples = 300, step_s = 1.5",
)


@pytest.fixture(scope="module")
def spin() -> Problem:
    return pose(simulate(parse_scenario(SPIN))[0], load_field("igrf14"))


@pytest.mark.parametrize(
    ("offset_s", "lag_s", "expected"), [(0.8, 0.8, True), (0.8, 0.4, False), (-0.8, 0.8, False), (0.0, 0.8, False)]
)
def test_an_offset_and_a_lag(spin: Problem, offset_s: float, lag_s: float, expected: bool) -> None:
    """Sampled later and answering later: equal ones leave what goes with the square of time times rate, 0.13 here."""
    active = [(find_effect("time_tag_offset"), np.array([offset_s])), (find_effect("sensor_lag"), np.array([lag_s]))]
    noise = 5.0 * np.random.default_rng(3).standard_normal((spin.rows, 3))
    telemetry = spin.telemetry.replace(mag_B_nT=spin.chain.reading_nT(active) + noise)
    problem = dataclasses.replace(spin, telemetry=telemetry)
    whitener = make_whitener(
        turn_images(problem.field_B_nT), problem.setting.seconds, problem.segment, NoiseModel(5.0, 0.0, 1.0)
    )
    channel = Readings(problem, whitener)
    base = refit(channel)
    fit = refit(channel, active)
    found = undone(channel, fit, base.jacobian, [False, False])
    assert found is expected
    assert not undone(channel, fit, base.jacobian, [True, True])
