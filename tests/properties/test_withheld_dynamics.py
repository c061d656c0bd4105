"""The flights of the withheld benchmark: momentum is kept, and the simulator's own integrator agrees."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from fluxtwin.sim import frames
from fluxtwin.sim.dynamics.environment import environment_along
from fluxtwin.sim.dynamics.flight import Start
from fluxtwin.sim.dynamics.flight import fly as compiled
from fluxtwin.sim.dynamics.vehicle import Vehicle
from fluxtwin.sim.field import load_field
from fluxtwin.sim.scenario import parse_scenario
from fluxtwin.sim.scenario_dynamics import vehicle_of
from fluxtwin.sim.torques.gravity_gradient import GravityGradient
from fluxtwin.sim.torques.residual_dipole import ResidualDipole

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from withheld_cases.flight import Surroundings, fly, gravity_gradient
from withheld_cases.of_dynamics import WHERE, draw_craft, truth
from withheld_cases.worlds import draw_world

LENGTH_S = 400.0


@pytest.fixture(scope="module")
def craft():
    return draw_craft(np.random.default_rng(3), "tumble", low=False)


@pytest.fixture(scope="module")
def around(craft):
    return Surroundings(craft.orbit, load_field("igrf14"), craft.orbit.epoch_utc, LENGTH_S)


def test_without_torque_the_momentum_stays(around) -> None:
    craft = draw_craft(np.random.default_rng(5), "wheels", low=False)
    flown = fly(craft.body, around, [], craft.q, craft.rate, 0.0, 300.0)
    t = np.linspace(0.0, 300.0, 7)
    R, rate = flown.attitude(t)
    speeds = np.array([craft.body.speed_rad_s(one) for one in t])
    own = craft.body.wheel_inertia * speeds @ craft.body.axes
    momentum = R.inv().apply(rate @ craft.body.inertia + own)
    assert np.abs(momentum - momentum[0]).max() < 1e-7 * np.abs(momentum).max()
    wheels_only = R.inv().apply(own)
    assert np.abs(wheels_only - wheels_only[0]).max() > 1e-3 * np.abs(momentum).max()  # they do pass it on


def test_the_simulator_flies_the_same(craft, around, close) -> None:
    """Another integrator and another way to draw the surroundings: 1e-5 deg in 400 s."""
    dipole = (0.2, -0.1, 0.3)
    vector = np.array(dipole)
    flown = fly(
        craft.body, around, [gravity_gradient, lambda now: np.cross(vector, now["field"])], craft.q, craft.rate, 0.0,
        LENGTH_S,
    )  # fmt: skip
    vehicle = Vehicle(craft.body.inertia, torques=(GravityGradient(), ResidualDipole(dipole_Am2=dipole)))
    nodes = environment_along(craft.orbit.propagate, craft.orbit.epoch_utc, LENGTH_S, field=load_field("igrf14"))
    start = Start(craft.q, craft.rate, np.zeros(0))
    peer = compiled([vehicle], [nodes], [start], duration_s=LENGTH_S, step_s=0.25, log_every=400)
    R = frames.rotation_from_q(peer.q_NB[0])
    turn = np.degrees((flown.attitude(peer.seconds_s)[0] * R.inv()).as_rotvec())
    close(turn, 0.0, atol=1e-5, unit="deg", because="splines through nodes 10 and 20 s apart")
    lacking = fly(craft.body, around, [gravity_gradient], craft.q, craft.rate, 0.0, LENGTH_S)
    assert np.degrees(np.abs((lacking.attitude(peer.seconds_s)[0] * R.inv()).as_rotvec()).max()) > 0.01


def test_the_ground_has_the_vehicle_without_the_truth(craft) -> None:
    world = dataclasses.replace(draw_world(np.random.default_rng(1), "nadir"), orbit=craft.orbit)
    vehicle = vehicle_of(parse_scenario(craft.text(world)))
    assert np.array_equal(vehicle.inertia_kg_m2, craft.body.inertia)
    assert {torque.name for torque in vehicle.torques} == {"gravity_gradient", "torquers"}


@pytest.mark.parametrize("name", list(WHERE))
def test_each_truth_grows_with_its_size(name, craft, around) -> None:
    drawn = truth(name, np.random.default_rng(2), craft.body.inertia)
    assert drawn.name == name
    if drawn.torque is None:
        assert drawn.change is not None
        assert np.allclose(drawn.change, drawn.change.T)
        return
    values, _, density = around.at(10.0)
    now = {
        "r": values[:3], "v": values[3:6], "field": values[6:9], "sun": values[9:12], "rate": np.array([0.1, 0.2, 0.3]),
        "J": craft.body.inertia, "dipole": np.array([0.1, 0.2, -0.3]), "light": np.array(1.0),
        "density": np.array(density),
    }  # fmt: skip
    assert np.allclose(drawn.torque(2.0)(now), 2.0 * drawn.torque(1.0)(now), rtol=1e-12)
    assert np.abs(drawn.torque(1.0)(now)).max() > 0.0
    assert not np.any(drawn.torque(0.0)(now))
