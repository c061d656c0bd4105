"""The flights of the withheld benchmark: momentum is kept, and the simulator's own integrator agrees."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from withheld_cases.flight import Surroundings, fly, gravity_gradient
from withheld_cases.of_dynamics import WHERE, draw_craft, truth
from withheld_cases.torque_visible import WINDOW_S, Ground, Seen, seen
from withheld_cases.worlds import draw_world

from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.flights import vehicle_of
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.spacecraft.dynamics.environment import environment_along
from fluxtwin.sim.spacecraft.dynamics.flight import Start
from fluxtwin.sim.spacecraft.dynamics.flight import fly as compiled
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.torques import GravityGradient, ResidualDipole

pytestmark = pytest.mark.property

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
        craft.body,
        around,
        [gravity_gradient, lambda now: np.cross(vector, now["field"])],
        craft.q,
        craft.rate,
        0.0,
        LENGTH_S,
    )
    vehicle = Vehicle(craft.body.inertia, torques=(GravityGradient(), ResidualDipole(dipole_Am2=dipole)))
    nodes = environment_along(craft.orbit.propagate, craft.orbit.epoch_utc, LENGTH_S, field=load_field("igrf14"))
    start = Start(craft.q, craft.rate, np.zeros(0))
    peer = compiled(vehicle, nodes, start, duration_s=LENGTH_S, step_s=0.25, log_every=400)
    R = frames.rotation_from_q(peer.q_NB)
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
        "r": values[:3],
        "v": values[3:6],
        "field": values[6:9],
        "sun": values[9:12],
        "rate": np.array([0.1, 0.2, 0.3]),
        "J": craft.body.inertia,
        "dipole": np.array([0.1, 0.2, -0.3]),
        "light": np.array(1.0),
        "density": np.array(density),
    }
    assert np.allclose(drawn.torque(2.0)(now), 2.0 * drawn.torque(1.0)(now), rtol=1e-12)
    assert np.abs(drawn.torque(1.0)(now)).max() > 0.0
    assert not np.any(drawn.torque(0.0)(now))


def test_another_start_is_not_visible_and_a_torque_is(close) -> None:
    craft = draw_craft(np.random.default_rng(5), "wheels", low=False)
    length = 1.2 * WINDOW_S
    around = Surroundings(craft.orbit, load_field("igrf14"), craft.orbit.epoch_utc, length)
    ground = Ground(craft.body, [gravity_gradient], around)
    vector = np.array([0.05, 0.03, -0.04])
    pushed = fly(
        craft.body,
        around,
        [gravity_gradient, lambda now: np.cross(vector, now["field"])],
        craft.q,
        craft.rate,
        0.0,
        length,
    )
    found = seen(pushed, ground, length)
    assert len(found.turn_rad) == 1 and found.design[0].shape == (120, 9)
    raw = np.sqrt(np.mean(np.square(found.turn_rad[0])))
    assert 0.005 * raw < found.visible(1.0) < raw
    started = [A[:, :6] @ (1e-3 * np.arange(1.0, 7.0)) for A in found.design]
    other = Seen([turn.reshape(-1, 3) for turn in started], found.design, found.moments_s, length)
    close(other.visible(1.0), 0.0, atol=1e-9, unit="rad", because="what another start does is taken out")
    moved = fly(craft.body, around, [gravity_gradient], craft.q, craft.rate + 3e-6, 0.0, length)
    alone = ground.window(pushed.attitude(np.zeros(1))[0][0].inv(), craft.rate, found.moments_s)
    turn = (moved.attitude(found.moments_s)[0].inv() * alone).as_rotvec()
    really = Seen([turn], found.design, found.moments_s, length)
    assert really.visible(1.0) < 0.02 * np.sqrt(np.mean(turn**2)), "the design holds a start that was really flown"


def test_chi_square_is_the_sum_of_squares_where_errors_are_white(close) -> None:
    rng = np.random.default_rng(0)
    turn, design = rng.standard_normal((40, 3)), rng.standard_normal((120, 9))
    one = Seen([turn], [design], np.linspace(0.0, WINDOW_S, 40), WINDOW_S)
    left = turn.ravel() - design @ np.linalg.lstsq(design, turn.ravel(), rcond=None)[0]
    close(one.chi_square(2.0, 0.0), np.sum(left**2) / 4.0, atol=1e-9, unit="1", because="least squares")
    close(one.visible(2.0), np.sqrt(np.mean(left**2)) / 2.0, atol=1e-12, unit="1", because="least squares")
    steady = Seen([np.ones((40, 3))], [np.zeros((120, 9))], one.moments_s, WINDOW_S)
    assert steady.chi_square(1.0, 1e4) < 4.0 < steady.chi_square(1.0, 0.0), "an error that lasts hides what lasts"
