"""Effects on the dynamics: zero is absent, each is the torque it says it is, and a scenario flies with it."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
from adaptive_flight import torques_B_Nm
from scipy.spatial.transform import Rotation
from worlds import scenario_text

from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S, SOLAR_CONSTANT_W_M2, SPEED_OF_LIGHT_M_S
from fluxtwin.sim.effects.base import DynamicsEffect
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.effects.torques import GravityGradientInertiaError
from fluxtwin.sim.run.flights import vehicle_of
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.effect_sections import active_effects, effect_section
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

pytestmark = pytest.mark.property

EFFECTS = {effect.name: effect for effect in CATALOGUE if isinstance(effect, DynamicsEffect)}
SECTIONS = """
[attitude]
mode = "dynamics"
[dynamics]
rate_deg_s = [0.1, 0.2, -0.3]
[torques.gravity_gradient]
[torques.residual_dipole]
dipole_Am2 = [0.1, 0.0, 0.0]
[torques.eddy_currents]
K_Am2_s_per_T = [[100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 100.0]]
[torquers]
dipole_Am2 = 5.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]
"""
DESIGN = scenario_text(
    SECTIONS,
    seed=4,
    inertia_kg_m2=[[10.0, 0.0, 0.2], [0.0, 12.0, 0.0], [0.2, 0.0, 8.0]],
    epoch_utc="2022-01-01T00:00:00Z",
    altitude_km=400.0,
    inclination_deg=97.0,
    segment="duration_min = 40.0, step_s = 20.0",
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(DESIGN)


@pytest.fixture(params=[*EFFECTS.values(), GravityGradientInertiaError("torque")], ids=repr)
def effect(request: pytest.FixtureRequest) -> DynamicsEffect:
    return request.param


def scale_of(effect: DynamicsEffect) -> np.ndarray:
    return np.array([parameter.scale for parameter in effect.parameters])


@pytest.fixture(scope="module")
def moment() -> tuple[Attitude, np.ndarray, np.ndarray]:
    """Three attitudes and rates, surroundings in SI, dipoles; nothing special."""
    rng = stream(1, "moment")
    around = np.zeros((3, 14))
    around[:, 0:3] = [[6.8e6, 1e5, -2e5], [-1e6, 6.6e6, 1e6], [2e6, -3e6, 5.7e6]]
    around[:, 3:6] = 7.6e3 * rng.standard_normal((3, 3))
    around[:, 6:9] = 3e-5 * rng.standard_normal((3, 3))
    sun = rng.standard_normal((3, 3))
    around[:, 9:12] = sun / np.linalg.norm(sun, axis=1)[:, None]
    around[:, 12], around[:, 13] = [1.0, 0.5, 0.0], 3e-12
    motion = Attitude(Rotation.random(3, random_state=rng), 0.1 * rng.standard_normal((3, 3)))
    return motion, around, rng.standard_normal((3, 3))


def more(effect: DynamicsEffect, scenario: Scenario, moment, theta) -> np.ndarray:
    """Torque with the effect less that without."""
    vehicle, (motion, around, dipole) = vehicle_of(scenario), moment
    with_it = torques_B_Nm(effect.on(vehicle, np.asarray(theta)), motion, around, dipole)
    return with_it - torques_B_Nm(vehicle, motion, around, dipole)


def packed(vehicle: Vehicle) -> tuple[list[float], list[list[float]]]:
    return sorted(number for torque in vehicle.torques for number in torque.packed(vehicle.inertia_kg_m2)), np.asarray(
        vehicle.inertia_kg_m2
    ).tolist()


def test_zero_is_absent_and_a_scale_is_not(effect, scenario, moment):
    vehicle = vehicle_of(scenario)
    zero = np.zeros(len(effect.parameters))
    assert effect.idle(vehicle) is None
    assert not np.any(more(effect, scenario, moment, zero))
    assert np.asarray(effect.on(vehicle, zero).inertia_kg_m2).tolist() == np.asarray(vehicle.inertia_kg_m2).tolist()
    for axis in range(zero.size):
        theta = np.where(np.arange(zero.size) == axis, effect.step(vehicle), 0.0)
        assert packed(effect.on(vehicle, theta)) != packed(vehicle)


def test_each_is_the_torque_that_it_says(scenario, moment, close):
    """m x B and the like, written down a second time, with products of vectors."""
    motion, around, dipole = moment
    R = motion.R_BN
    field, sun = R.apply(around[:, 6:9]), R.apply(around[:, 9:12])
    air = around[:, 3:6] - np.cross([0.0, 0.0, EARTH_RATE_RAD_S], around[:, 0:3])
    speed = np.linalg.norm(air, axis=1)[:, None]
    theta = np.array([0.3, -0.7, 0.2])
    drag = -0.5 * around[:, 13:14] * speed * R.apply(air)  # for C_D A = 1
    push = -SOLAR_CONSTANT_W_M2 / SPEED_OF_LIGHT_M_S * around[:, 12:13] * sun
    induced = np.cross(np.abs(theta) * np.cross(motion.rate_B_rad_s, field), field)
    wanted = {
        "residual_dipole_torque": np.cross(theta, field),
        "aerodynamic_torque": np.cross(theta, drag),
        "solar_pressure_torque": np.cross(theta, push),
        "torquer_gain_error": np.cross(theta * dipole, field),
    }
    for name, torque in wanted.items():
        found = more(EFFECTS[name], scenario, moment, theta)
        size = np.abs(torque).max()
        close(found, torque, atol=1e-9 * size, unit="N m", because=f"rounding; {name}")
        with pytest.raises(AssertionError):
            close(found, 1.01 * torque, atol=1e-9 * size, unit="N m", because="a hundredth more")
    found = more(EFFECTS["eddy_torque"], scenario, moment, np.abs(theta))
    close(found, induced, atol=1e-9 * np.abs(induced).max(), unit="N m", because="rounding")


def test_a_wrong_tensor_shows_in_the_gravity_gradient_and_in_the_body(scenario, moment, close):
    motion, around, _ = moment
    r = motion.R_BN.apply(around[:, 0:3])
    size = np.linalg.norm(r, axis=1)[:, None]
    theta = np.array([1.0, 0.4, -0.3, 0.2, 0.1, -0.2])
    change = np.array([[1.0, 0.2, 0.1], [0.2, 0.4, -0.2], [0.1, -0.2, -0.3]])
    torque = 3.0 * 3.986004418e14 / size**5 * np.cross(r, r @ change)
    for acts_in in ("both", "torque"):
        effect = GravityGradientInertiaError(acts_in)
        found = more(effect, scenario, moment, theta)
        close(found, torque, atol=1e-6 * np.abs(torque).max(), unit="N m", because="GM of another source")
        moved = np.asarray(effect.on(vehicle_of(scenario), theta).inertia_kg_m2) - vehicle_of(scenario).inertia_kg_m2
        close(moved, change if acts_in == "both" else 0.0, atol=1e-12, unit="kg m2", because="rounding")


def test_a_scenario_flies_with_it_and_telemetry_says_nothing(effect, scenario):
    still, truth = simulate(scenario)
    theta = 2.0 * effect.step(vehicle_of(scenario))
    flown = scenario.updated({f"effects.{effect.name}": effect_section(effect, theta)})
    assert parse_scenario(flown.to_toml()) == flown
    ((found, parameters),) = active_effects(flown)
    assert found == effect
    assert np.array_equal(parameters, theta)
    telemetry, moved = simulate(flown)
    assert np.abs(moved.q_NB - truth.q_NB).max() > 1e-9
    assert telemetry.provenance == still.provenance
    assert effect.name in moved.effects


def test_where_no_torque_turns_the_body_it_is_left_out_with_a_word(effect, scenario):
    prescribed = {"attitude": {"mode": "inertial_hold"}, "dynamics": None, "torques": None}
    theta = effect_section(effect, scale_of(effect))
    with pytest.warns(UserWarning, match=f'effects.{effect.name} is left out: .* mode is not "dynamics"'):
        moved = simulate(scenario.updated({**prescribed, f"effects.{effect.name}": theta}))[0]
    assert np.array_equal(moved.mag_B_nT, simulate(scenario.updated(prescribed))[0].mag_B_nT)


def test_nothing_to_act_on_is_said(scenario):
    bare = scenario.updated({"torquers": None, "torques.gravity_gradient": None})
    vehicle = vehicle_of(bare)
    assert EFFECTS["torquer_gain_error"].idle(vehicle) == "the scenario has no [torquers]"
    assert "gravity_gradient" in str(GravityGradientInertiaError("torque").idle(vehicle))
    assert GravityGradientInertiaError("both").idle(vehicle) is None
    gain = {"effects.torquer_gain_error": {"gain": [0.1, 0.1, 0.1]}}
    with pytest.warns(UserWarning, match="effects.torquer_gain_error is left out: the scenario has no"):
        moved = simulate(bare.updated(gain))[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(moved.q_NB, simulate(bare)[0].q_NB)


def test_effects_are_frozen(effect):
    with pytest.raises(dataclasses.FrozenInstanceError):
        effect.anything = 1
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.low <= 0.0 < parameter.scale <= parameter.high
