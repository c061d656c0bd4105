"""A scenario with attitude mode dynamics: flown once, sampled anywhere, telemetered as any other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import scenario_text

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.run.flights import flights, vehicle_of
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.true_attitude import true_attitude
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.dynamics_sections import ControlSection, DynamicsSection
from fluxtwin.sim.scenario.scenario import Scenario, load_scenario, parse_scenario
from fluxtwin.sim.spacecraft.control import CONTROLS
from fluxtwin.sim.spacecraft.torques import TORQUES, Plate

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
mode = "dynamics"
[dynamics]
settle_min = 5.0
yaw_deg = 3.0
[torques.gravity_gradient]
[torques.residual_dipole]
dipole_Am2 = [0.5, 0.2, -0.3]
[torques.aerodynamic]
plates = [{ area_m2 = 2.0, normal_B = [1.0, 0.0, 0.0], centre_m = [0.5, 0.1, 0.0] }]
[torques.solar_pressure]
plates = [{ area_m2 = 2.0, normal_B = [0.0, 1.0, 0.0], centre_m = [0.5, 0.1, 0.0] }]
[control]
attitude_sigma_deg = 0.05
attitude_tau_s = 60.0
[control.three_axis]
frequency_rad_s = 0.05
unloading_per_s = 1e-3
[torquers]
dipole_Am2 = 20.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]
activity = "control"
drive = "on_off"
threshold_Am2 = 2.0
[wheels]
axes_B = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
inertia_kg_m2 = 0.01
bias_rpm = [500.0, -300.0, 200.0]
max_rpm = 4000.0
max_torque_Nm = 0.1
[gyro]
[power]
full_sun_current_A = 10.0
[schedule]
segments = [
    { start_utc = "2022-01-01T00:00:00Z", duration_min = 20.0, step_s = 10.0 },
    { start_utc = "2022-01-03T00:00:00Z", duration_min = 10.0, step_s = 10.0 },
]
"""
TEXT = scenario_text(
    SECTIONS,
    seed=3,
    inertia_kg_m2=[[100.0, 0.0, 2.0], [0.0, 120.0, 0.0], [2.0, 0.0, 80.0]],
    epoch_utc="2022-01-01T00:00:00Z",
    altitude_km=600.0,
    inclination_deg=97.0,
    segment=None,
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


def test_telemetry_carries_what_the_dynamics_did(scenario: Scenario, close) -> None:
    telemetry, truth = simulate(scenario)
    assert telemetry.dipole_B_Am2 is not None and telemetry.wheel_speed_rpm is not None
    assert set(np.unique(np.abs(telemetry.dipole_B_Am2))) == {0.0, 20.0}
    assert telemetry.wheel_speed_rpm.shape == (telemetry.time.size, 3) and np.ptp(telemetry.wheel_speed_rpm) > 100.0
    close(telemetry.rate_B_rad_s, truth.rate_B_rad_s, atol=1e-15, unit="rad/s", because="a gyro without errors")
    pointing = np.degrees(np.sqrt(np.mean([truth.yaw_rad**2, truth.roll_rad**2, truth.pitch_rad**2])))
    assert 0.005 < pointing < 0.2, "held to about what the law is given, 0.05 deg"
    # The rate is the derivative of the attitude, and the field in the body that of the world seen through it.
    field_B_nT = frames.rotation_from_q(truth.q_NB).apply(truth.field_N_nT)
    close(field_B_nT, truth.field_B_nT, atol=1e-9, unit="nT", because="rounding")
    # The torquers' field reaches the sensor: 20 A m2 at 2 m, on the axis 100 2 m / r^3.
    stray = truth.ideal_B_nT - truth.field_B_nT
    on = np.abs(telemetry.dipole_B_Am2[:, 2]) > 0.0
    close(np.abs(stray[on, 2]), 500.0, atol=1e-6, unit="nT", because="the dipole law")


def test_the_motion_is_the_same_at_any_stamps(scenario: Scenario, close) -> None:
    world = build_world(scenario)
    motion = true_attitude(scenario, world)
    flown = flights(scenario)
    picked = np.array([7, 60, 130])
    again = flown.attitude(world.time[picked])
    assert np.array_equal(again.q_NB, motion.q_NB[picked])
    # A later sample is the rate times the time away.
    later = flown.attitude(epoch.add_seconds(world.time[0], epoch.seconds_since(world.time, world.time[0]) + 0.01))
    turn = -(later.R_BN * motion.R_BN.inv()).as_rotvec() / 0.01
    close(
        turn, motion.rate_B_rad_s, atol=1e-5, unit="rad/s", because="0.01 s of the control's acceleration, 1e-3 rad/s2"
    )


def test_the_example_in_the_documents_flies_within_its_pointing() -> None:
    telemetry, truth = simulate(load_scenario(Path(__file__).resolve().parents[3] / "scenarios/momentum_bias.toml"))
    rms = np.degrees(np.sqrt(np.mean(np.square([truth.yaw_rad, truth.roll_rad, truth.pitch_rad]), axis=1)))
    assert (rms < [2.0, 0.7, 0.5]).all(), rms
    assert telemetry.dipole_B_Am2 is not None and np.ptp(telemetry.dipole_B_Am2) > 0.1
    assert telemetry.rate_B_rad_s is not None and telemetry.wheel_speed_rpm is not None


def test_a_flight_that_settles_beside_the_segment_before_does_not_disturb_it(scenario: Scenario) -> None:
    """The second segment starts two minutes after the first has ended, and settles for five."""
    first, second = (
        {"start_utc": f"2022-01-01T00:{m}:00Z", "duration_min": 10.0, "step_s": 10.0} for m in ("00", "12")
    )
    both = scenario.updated({"schedule.segments": (first, second)})
    alone = scenario.updated({"schedule.segments": (first,)})
    world = build_world(alone)
    assert np.array_equal(true_attitude(both, world).q_NB, true_attitude(alone, world).q_NB)
    late = epoch.add_seconds(np.datetime64("2022-01-01T00:12:00", "ns"), np.array([-1.0, 0.0]))
    flown = flights(both)
    assert np.array_equal(flown.attitude(late).q_NB, flown.flights[1].attitude(np.array([299.0, 300.0])).q_NB)


def test_before_and_after_a_flight_the_body_turns_on(scenario: Scenario) -> None:
    flown = flights(scenario)
    start = flown.flights[0].start
    early = flown.attitude(epoch.add_seconds(start, np.array([-3600.0, -10.0])))
    late = flown.attitude(epoch.add_seconds(flown.flights[1].start, np.array([1e5])))
    assert np.isfinite(early.q_NB).all() and np.isfinite(late.q_NB).all()
    assert np.array_equal(early.rate_B_rad_s[0], early.rate_B_rad_s[1])


def test_a_seed_moves_what_is_random_and_nothing_else(scenario: Scenario) -> None:
    other = scenario.updated({"seed": 4})
    assert not np.array_equal(flights(other).flights[0].q_NB, flights(scenario).flights[0].q_NB)
    sure, same = (s.updated({"control.attitude_sigma_deg": 0.0}) for s in (scenario, other))
    assert np.array_equal(flights(sure).flights[0].q_NB, flights(same).flights[0].q_NB)
    assert stream(3, "control.attitude.0").random() != stream(3, "control.attitude.1").random()


def test_a_saved_scenario_flies_again(scenario: Scenario) -> None:
    again = parse_scenario(scenario.to_toml())
    assert (
        again.torques == scenario.torques and again.control == scenario.control and again.dynamics == scenario.dynamics
    )
    assert vehicle_of(again).packed()[0].tolist() == vehicle_of(scenario).packed()[0].tolist()
    assert {torque.name for torque in vehicle_of(scenario).torques} == {
        "gravity_gradient",
        "residual_dipole",
        "aerodynamic",
        "solar_pressure",
        "torquers",
    }


def test_a_scheduled_dipole_turns_the_body(scenario: Scenario) -> None:
    """Without a law the torquers' schedule acts on the motion, and is what telemetry says."""
    tree: dict[str, Any] = {"control": None, "wheels": None, "torquers.activity": "random", "torquers.dwell_s": 30.0}
    free = scenario.updated(tree)
    still = free.updated({"torquers.activity": "off"})
    telemetry, _ = simulate(free)
    assert telemetry.dipole_B_Am2 is not None and set(np.unique(telemetry.dipole_B_Am2)) == {-20.0, 0.0, 20.0}
    assert not np.allclose(flights(free).flights[0].q_NB[-1], flights(still).flights[0].q_NB[-1], atol=1e-4)


def test_the_law_may_read_the_instrument(scenario: Scenario) -> None:
    """Its bias turns the dipole that unloads; a perfect one, and an instrument without errors, are the same."""
    sure = scenario.updated({"control.attitude_sigma_deg": 0.0, "torquers.drive": "linear"})
    same = sure.updated({"control.magnetometer": "instrument"})
    biased = same.updated({"magnetometer.b_nT": [7000.0, -3000.0, -6000.0]})
    ideal = sure.updated({"magnetometer.b_nT": [7000.0, -3000.0, -6000.0]})
    first_nT = 5000.0 * stream(sure.seed, "control.magnetometer.0").standard_normal(3)
    noisy, moved = (
        same.updated({f"magnetometer.{name}": x}) for name, x in (("noise_nT", 5000.0), ("b_nT", (-first_nT).tolist()))
    )
    every = {"sure": sure, "same": same, "biased": biased, "ideal": ideal, "noisy": noisy, "moved": moved}
    dipole = {name: flights(s).flights[0].dipole_B_Am2 for name, s in every.items()}
    np.testing.assert_allclose(dipole["noisy"][0], dipole["moved"][0], rtol=1e-9)
    assert np.abs(dipole["noisy"][0] - dipole["sure"][0]).max() > 0.01 * np.abs(dipole["sure"][0]).max()
    assert np.array_equal(dipole["sure"], dipole["same"]) and np.array_equal(dipole["sure"], dipole["ideal"])
    assert np.abs(dipole["biased"] - dipole["sure"]).max() > 0.1 * np.abs(dipole["sure"]).max()


WRONG = {
    "mode dynamics wants an inertia": ({"spacecraft.inertia_kg_m2": None}, "inertia_kg_m2"),
    "sections of another mode": ({"attitude.mode": "earth_pointing", "torquers.activity": "off"}, r'mode = "dynamics"'),
    "two laws": ({"control.b_dot": {"gain_Am2_s_per_T": 1.0}}, "one law at most"),
    "a law that does not exist": ({"control.bdot": {"gain_Am2_s_per_T": 1.0}}, "did you mean"),
    "a torque that does not exist": ({"torques.gravity": {}}, "did you mean gravity_gradient"),
    "torquers that the law does not have": ({"torquers.activity": "random"}, "its own"),
    "torquers steered by nothing": ({"control.three_axis": None}, "a law in"),
    "a law without its wheels": ({"wheels": None}, r"three_axis\] acts through \[wheels\]"),
    "a law without its torquers": (
        {"control.three_axis": None, "control.b_dot": {"gain_Am2_s_per_T": 1.0}, "torquers": None},
        r"b_dot\] acts through \[torquers\]",
    ),
    "no direction": ({"control.axis": [0.0, 0.0, 0.0]}, "control.axis: .*no such direction"),
    "a wheel without a direction": ({"wheels.axes_B": [[0.0, 0.0, 0.0]]}, r"wheels\.axes_B\.0: .*no such direction"),
    "no wheels in their section": ({"wheels.axes_B": [], "wheels.bias_rpm": []}, r"wheels\.axes_B"),
    "a speed too few": ({"wheels.bias_rpm": [1.0, 2.0]}, r"wheels: 2 speeds in bias_rpm for 3 wheels in axes_B"),
    "no attitude": ({"dynamics.q_NB": [0.0, 0.0, 0.0, 0.0]}, r"dynamics\.q_NB: .*no such"),
    "half a tensor": (
        {"torques.gravity_gradient.inertia_error_kg_m2": [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]},
        "not symmetric",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_said(name: str, scenario: Scenario) -> None:
    changes, words = WRONG[name]
    with pytest.raises(BadInput, match=words):
        scenario.updated(changes)


def test_times_that_are_no_whole_steps_are_refused(scenario: Scenario) -> None:
    with pytest.raises(BadInput, match="whole fraction"):
        flights(scenario.updated({"dynamics.record_s": 2.0}))
    for key in ("control.period_s", "dynamics.record_s"):
        with pytest.raises(BadInput, match="whole number of steps"):
            flights(scenario.updated({key: 1.5}))


def test_a_vehicle_that_cannot_be_is_refused(scenario: Scenario) -> None:
    with pytest.raises(BadInput, match=r"inertia_kg_m2: not symmetric"):
        flights(
            scenario.updated({"spacecraft.inertia_kg_m2": [[100.0, 5.0, 0.0], [0.0, 120.0, 0.0], [0.0, 0.0, 80.0]]})
        )
    mirror = [[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    with pytest.raises(BadInput, match=r"magnetometer S: I \+ S cannot be inverted"):
        flights(scenario.updated({"control.magnetometer": "instrument", "magnetometer.S": mirror}))


def test_surroundings_too_far_apart_are_refused(scenario: Scenario) -> None:
    """A cubic through nodes ten minutes apart would be off by some tens of km, and nobody would know."""
    with pytest.raises(BadInput, match=r"dynamics\.surroundings_s: 600 s\. Wanted: 120 s or less"):
        flights(scenario.updated({"dynamics.surroundings_s": 600.0}))


def test_a_body_too_fast_for_its_step_is_refused(scenario: Scenario) -> None:
    free = scenario.updated(
        {"control": None, "torquers": None, "wheels": None, "dynamics.rate_deg_s": [0.0, 0.0, 30.0]}
    )
    with pytest.raises(BadInput, match=r"dynamics\.step_s: the body turns by 0.5"):
        flights(free)
    with pytest.raises(BadInput, match=r"dynamics\.record_s"):
        flights(free.updated({"dynamics.step_s": 0.1, "dynamics.record_s": 2.0}))
    spun = flights(free.updated({"dynamics.step_s": 0.1})).flights[0]
    assert np.isfinite(spun.q_NB).all()
    unlimited = {"wheels.max_torque_Nm": None, "wheels.max_rpm": None}
    with pytest.raises(BadInput, match="the motion ran away"):
        flights(scenario.updated({"control.three_axis.frequency_rad_s": 50.0, **unlimited}))
    with pytest.raises(BadInput, match="states to record"):
        flights(free.updated({"dynamics.step_s": 1e-4}))


def test_every_torque_and_law_has_its_section() -> None:
    """And all of it is described where the other keys are."""
    text = (Path(__file__).resolve().parents[3] / "docs" / "scenario.md").read_text(encoding="utf-8")
    for kind in (*TORQUES, *CONTROLS):
        if kind.name == "torquers":
            continue
        group = "control" if kind in CONTROLS else "torques"
        (row,) = re.findall(rf"^\| `\[{group}.{kind.name}\]` \|.*$", text, flags=re.MULTILINE)
        assert [key for key in kind.model_fields if f"`{key}`" not in row] == []
    laws = {kind.name for kind in CONTROLS}
    for section in (DynamicsSection, ControlSection, Plate):
        keys = [key for key in section.model_fields if key not in laws]
        assert [key for key in keys if not re.search(rf"\b{key}\b", text)] == []
