"""The balance of the momentum: silent where torques are as modelled, and it names what turns the body instead.

Truth is flown by the compiled integrator with steps of half a second and less; the balance integrates short arcs by its
own, from recorded rows ten seconds apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from jsonschema import Draft202012Validator
from scipy.spatial.transform import Rotation
from worlds import scenario_text

from fluxtwin import diagnosing, diagnosis_page
from fluxtwin.gap.channels import momentum
from fluxtwin.gap.channels.momentum import MomentumChannel, MomentumNoise, plain_torques, unresolved
from fluxtwin.gap.channels.momentum_arcs import Arcs, Craft, Windows, _filled, arcs, windows
from fluxtwin.gap.posterior.torques import Momentum, balanced
from fluxtwin.gap.problem.problem import Budget, Problem, pose
from fluxtwin.gap.records.diagnosis import Diagnosis, diagnosis_schema
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.flights import vehicle_of
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.effect_sections import active_effects
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario, save_scenario
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.closure

COMMON = """
[attitude]
mode = "dynamics"
[attitude.reference]
sigma_deg = 0.05
tau_s = 60.0
[torques.gravity_gradient]
[torques.residual_dipole]
dipole_Am2 = [0.02, -0.02, 0.02]
[magnetometer]
noise_nT = 20.0
b_nT = [-300.0, 500.0, 100.0]
lsb_nT = 50.0
"""
BIAS = """
[dynamics]
step_s = 0.5
settle_min = 120.0
roll_deg = 1.0
[control]
attitude_sigma_deg = 0.02
attitude_tau_s = 60.0
[control.momentum_bias]
momentum_Nms = 2.5
nutation_gain_Am2_s_per_T = 5e7
precession_gain_Am2_per_rad = 100.0
momentum_gain_per_T = 100.0
field_use = "proportional"
[wheels]
axes_B = [[0.0, 1.0, 0.0]]
inertia_kg_m2 = 0.0119366
bias_rpm = [-2000.0]
max_rpm = 3800.0
max_torque_Nm = 0.02
[torquers]
dipole_Am2 = 10.0
positions_m = [[0.5, 0.0, 0.6], [0.5, 0.3, 0.6], [0.5, -0.3, 0.6]]
activity = "control"
"""
THREE = """
[dynamics]
step_s = 0.5
settle_min = 60.0
yaw_deg = 3.0
[control]
attitude_sigma_deg = 0.02
attitude_tau_s = 60.0
[control.three_axis]
frequency_rad_s = 0.03
integral_s = 300.0
unloading_per_s = 1e-3
[wheels]
axes_B = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
inertia_kg_m2 = 0.01
bias_rpm = [500.0, -300.0, 200.0]
max_rpm = 6000.0
max_torque_Nm = 0.1
[torquers]
dipole_Am2 = 30.0
positions_m = [[0.5, 0.0, 0.6], [0.5, 0.3, 0.6], [0.5, -0.3, 0.6]]
activity = "control"
"""
TUMBLE = """
[dynamics]
step_s = 0.25
rate_deg_s = [0.8, -0.6, 0.7]
[control.b_dot]
gain_Am2_s_per_T = 3e4
[torquers]
dipole_Am2 = 0.3
positions_m = [[0.5, 0.0, 0.6], [0.5, 0.3, 0.6], [0.5, -0.3, 0.6]]
activity = "control"
"""
SPIN = """
[dynamics]
step_s = 0.1
roll_deg = 95.0
rate_deg_s = [0.3, 0.0, 25.0]
"""


def text(sections: str, inertia_kg_m2: list[list[float]], segment: str) -> str:
    """A spacecraft four hours after the epoch of its orbit."""
    return scenario_text(
        COMMON + sections.lstrip(),
        seed=11,
        inertia_kg_m2=inertia_kg_m2,
        epoch_utc="2022-03-05T00:00:00Z",
        altitude_km=450.0,
        inclination_deg=97.0,
        raan_deg=40.0,
        argument_of_latitude_deg=10.0,
        start_utc="2022-03-05T04:00:00Z",
        segment=segment,
    )


DESIGNS = {
    "bias": text(BIAS, [[25.0, 0.3, 0.0], [0.3, 20.0, 0.0], [0.0, 0.0, 22.0]], "duration_min = 120.0, step_s = 10.0"),
    "three_axis": text(
        THREE, [[100.0, 0.0, 2.0], [0.0, 120.0, 0.0], [2.0, 0.0, 80.0]], "duration_min = 120.0, step_s = 20.0"
    ),
    "tumble": text(TUMBLE, [[1.0, 0.02, 0.0], [0.02, 1.3, 0.0], [0.0, 0.0, 0.8]], "duration_min = 90.0, step_s = 5.0"),
    "spin": text(SPIN, [[1.0, 0.0, 0.0], [0.0, 1.05, 0.0], [0.0, 0.0, 1.4]], "duration_min = 80.0, step_s = 2.0"),
}


def posed(telemetry: Telemetry, scenario: Scenario) -> Problem:
    reference = scenario.attitude.reference
    budget = Budget(attitude_sigma_rad=float(np.radians(reference.sigma_deg)), attitude_tau_s=reference.tau_s)
    return pose(telemetry, load_field(), budget=budget)


def alone(telemetry: Telemetry, scenario: Scenario) -> Momentum:
    """The balance by itself: a magnetometer's channel without rows, of thirty alternatives."""
    nothing: Any = SimpleNamespace(
        modelled=(),
        chosen=(),
        named=(),
        candidates=(),
        residual_nT=np.zeros((3, 3)),
        tested=30,
        apply=lambda columns: np.zeros((0, 3, *columns.shape[2:])),
        measured=0,
    )
    craft = Craft(vehicle_of(scenario))
    return balanced(posed(telemetry, scenario), craft, nothing, nothing, np.zeros((3, 3, 0)))


def flown(name: str, **changes: Any) -> tuple[Telemetry, Scenario]:
    scenario = parse_scenario(DESIGNS[name])
    return simulate(scenario.updated({key.replace("__", "."): value for key, value in changes.items()}))[0], scenario


def test_wheels_between_rows_follow_a_parabola(close: Callable[..., None]) -> None:
    """The cubic with the slopes of the neighbours has every parabola exactly; dipoles are drawn straight or held."""
    t = np.array([0.0, 10.0, 25.0, 40.0, 60.0])
    here = np.array([[1], [2]])
    arcs: Any = SimpleNamespace(problem=SimpleNamespace(setting=SimpleNamespace(seconds=t)), resolved=False)
    arcs._ends, arcs._shares = (here, here + 1), np.linspace(0.0, 1.0, 5)[:, None, None]
    arcs.wheels_B, arcs.dipole_B_Am2 = np.outer(t**2, [1.0, 0.0, -2.0]), np.outer(t, [1.0, 1.0, 1.0])
    arcs.held, arcs._straight = np.zeros((2, 1, 1, 1), dtype=bool), lambda values: Arcs._straight(arcs, values)
    wheels, dipole = Arcs.driven.func(arcs)
    between = (t[here] + arcs._shares[:, :, 0].T * (t[here + 1] - t[here]))[:, :, None, None]
    close(wheels, between**2 * [1.0, 0.0, -2.0], atol=1e-9, unit="N m s", because="rounding")
    close(dipole, between * [1.0, 1.0, 1.0], atol=1e-9, unit="A m2", because="rounding")


def test_a_body_of_another_tensor_has_another_momentum_at_the_same_rates() -> None:
    """J w of the body and h of the wheels, in N: of the two only J w changes."""
    R_BN, rng = Rotation.random(4, random_state=3), np.random.default_rng(3)
    one, two = np.diag([2.0, 3.0, 4.0]), np.diag([3.0, 4.5, 6.0])
    rate, wheels = rng.normal(size=(2, 4, 3))
    two[0, 1] = two[1, 0] = 0.2
    craft = SimpleNamespace(vehicle=SimpleNamespace(inertia_kg_m2=one))
    arcs: Any = SimpleNamespace(craft=craft, track=R_BN, wheels_B=wheels)
    arcs.momentum_N = R_BN.inv().apply(rate @ one + wheels)
    other: Any = SimpleNamespace(inertia_kg_m2=two)
    assert Arcs.momentum_of(arcs, other) == pytest.approx(R_BN.inv().apply(rate @ two + wheels), abs=1e-12)


def test_the_columns_of_a_cause_are_its_image() -> None:
    images = np.arange(12.0).reshape(2, 1, 3, 2)
    causes = [SimpleNamespace(effect=effect, jacobian=image) for effect, image in zip("ab", images, strict=True)]
    channel: Any = SimpleNamespace(causes=causes)
    wanted: Any = "b"
    assert np.array_equal(MomentumChannel.columns(channel, wanted), images[1])
    as_it_is = SimpleNamespace(left=lambda turned: turned)
    channel.balance, channel.below, channel.columns = (
        SimpleNamespace(by_attitude=as_it_is),
        as_it_is.left,
        lambda _: images[1],
    )
    signal = MomentumChannel.signal(channel, wanted, np.array([2.0, -1.0]))
    assert np.array_equal(signal, 2.0 * images[1][:, :, 0] - images[1][:, :, 1])


def test_a_steady_torque_is_pushed_along_the_axes_of_its_frame() -> None:
    R_BN, R_ON = Rotation.random(3, random_state=1), Rotation.random(3, random_state=2)
    r, v = np.eye(3) * 7e3, np.roll(np.eye(3), 1, axis=1) * 7.5
    setting = SimpleNamespace(
        given=(r, v, R_BN), seconds=np.arange(3.0), illumination=np.array([1.0, 0.0, 1.0]), R_ON=R_ON
    )
    arcs = SimpleNamespace(rows=np.array([[0, 1], [1, 2]]), track=R_BN, seconds=np.array([20.0, 30.0]))
    arcs.problem, arcs.pushed = (
        SimpleNamespace(time=np.datetime64("2020-03-01", "ns") + np.arange(3), setting=setting),
        lambda at, impulse: impulse,
    )
    windows: Any = SimpleNamespace(arcs=arcs, chained=lambda turns: turns)
    found = plain_torques(windows)
    for frame, R in (("body", R_BN), ("orbital", R_ON)):  # its x axis, in N
        assert np.allclose(found[None, frame][1][:, 0], 30.0 * R[1].inv().apply([1.0, 0.0, 0.0]))


def test_slow_torques_push_for_as_long_as_an_arc_lasts() -> None:
    """One that stands, one from -1 to 1 and its square, over arcs of 10, 20 and 30 s."""
    arcs = SimpleNamespace(seconds=np.array([10.0, 20.0, 30.0]), pushed=lambda arc, impulse: impulse)
    windows: Any = SimpleNamespace(arcs=arcs)
    found = Windows._slow_torques(windows, slice(None))
    for part, course in enumerate(([10.0, 20.0, 30.0], [-10.0, 0.0, 30.0], [10.0, 0.0, 30.0])):
        assert found[:, :, 3 * part : 3 * part + 3] == pytest.approx(np.eye(3) * np.array(course)[:, None, None])


def test_torquers_that_turn_nothing_between_the_rows_leave_no_column() -> None:
    """Only rounding would be in it, which differs between processors, and takes up a random direction of the residual."""
    turns = np.array([1e-13, 1e-4, 0.0])
    arcs: Any = SimpleNamespace(resolved=False, wheels_B=np.zeros((4, 3)), base=np.ones((4, 3)))
    arcs.craft, arcs.held = SimpleNamespace(vehicle=None), np.zeros((4, 3), dtype=bool)
    arcs.dipole_B_Am2 = np.arange(4.0)[:, None] * [1.0, 1.0, 0.0]
    arcs.but = lambda held: SimpleNamespace(flown=lambda _: arcs.base + (held * turns).sum(axis=1)[:, None])
    cut: Any = SimpleNamespace(arcs=arcs, rows=np.arange(4), chained=lambda columns: columns)
    assert unresolved(cut) == pytest.approx(np.full((4, 3, 1), 1e-4), abs=1e-12)


def test_a_perfect_record_balances(close) -> None:
    """True attitudes, and rows at the ticks: two integrators agree to a hundred-thousandth of a degree in half an hour."""
    scenario = (
        parse_scenario(DESIGNS["bias"])
        .updated({"attitude.reference": {}, "dynamics.step_s": 0.25})
        .updated({"schedule.segments": [{"start_utc": "2022-03-05T04:00:00Z", "duration_min": 70.0, "step_s": 1.0}]})
    )
    problem = posed(simulate(scenario)[0], scenario)
    vehicle = vehicle_of(scenario)
    made = arcs(problem, Craft(vehicle), problem.setting.given[:2])
    assert not isinstance(made, str)
    cut = windows(made)
    assert not isinstance(cut, str)
    cut = cut.followed().followed()
    left = []
    for window in cut.windows:
        starts = cut.starts[window_number(cut, window)].reshape(-1, 6)
        starts = starts / np.linalg.norm(starts, axis=0)
        y = cut.residual()[window.place].ravel()
        left.append(y - starts @ np.linalg.lstsq(starts, y, rcond=None)[0])
    rms_deg = np.degrees(np.sqrt(np.mean(np.concatenate(left) ** 2)))
    assert rms_deg < 1e-5
    # A dipole of 1 mA m2 that the model lacks is seen against that.
    lacking = vehicle_of(scenario.updated({"torques.residual_dipole.dipole_Am2": [0.021, -0.02, 0.02]}))
    assert np.degrees(np.abs(cut.image(lacking)).max()) > 100 * 1e-5


def test_an_attitude_finer_than_any_leaves_what_wanders_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """The likeliest ratios of variances, 0.1 and 0.01, are of the sigma that was found, not of the one that is believed."""
    nothing: Any = None
    for sigma in (1e-3, 1e-12):

        def likelihood(*given: Any, sigma: float = sigma) -> tuple[float, float]:
            ratios = np.array([given[3].torque, given[3].rate]) / [0.1, 0.01]
            return -float(np.sum(np.log10(np.maximum(ratios, 1e-9)) ** 2)), sigma

        monkeypatch.setattr(momentum, "_likelihood", likelihood)
        found = momentum.choose_noise(nothing, nothing, nothing, Budget())
        assert found.sigma_rad == max(sigma, momentum._FINEST_RAD)
        wander = np.array([found.torque, found.rate]) * found.sigma_rad**2
        assert wander == pytest.approx(np.array([0.1, 0.01]) * sigma**2, rel=1e-9)


def window_number(cut: Any, window: Any) -> int:
    return list(cut.windows).index(window)


@pytest.mark.parametrize("name", list(DESIGNS))
def test_a_perfect_simulation_is_silent(name: str) -> None:
    telemetry, scenario = flown(name)
    found = alone(telemetry, scenario)
    assert found.gap is not None
    assert found.named == ()
    assert not found.left.structured
    assert not found.unexplained
    assert found.gap.after_deg == found.gap.before_deg
    # What is left is the attitude's error, 0.05 deg, of which a hundred rows or more tell the size to 15 %.
    assert (found.gap.before_deg, found.gap.floor_deg) == pytest.approx((0.05, 0.05), rel=0.15)
    assert found.gap.closed is None


def test_what_is_noise_by_itself_is_no_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside all possible causes at once a slow attitude error looks smaller and quicker than it is, and what is left of it
    turned the body."""
    telemetry, scenario = flown("bias", attitude__reference__tau_s=500.0)
    choose = momentum.choose_noise

    def too_small(windows: Windows, residual: np.ndarray, saturated: np.ndarray, budget: Budget) -> MomentumNoise:
        noise = choose(windows, residual, saturated, budget)
        beside_all = saturated.shape[2] > 12
        return replace(noise, sigma_rad=0.5 * noise.sigma_rad, tau_s=60.0) if beside_all else noise

    monkeypatch.setattr(momentum, "choose_noise", too_small)
    found = alone(telemetry, scenario.updated({"attitude.reference.tau_s": 500.0}))
    assert found.named == () and not found.unexplained


CASES = {
    "residual_dipole_torque": ("bias", {"dipole_Am2": [0.2, 0.0, -0.1]}),
    "aerodynamic_torque": ("three_axis", {"moment_m3": [0.0, 2.0, -1.0]}),
    "solar_pressure_torque": ("bias", {"moment_m3": [1.0, 0.0, 0.5]}),
    "eddy_torque": ("spin", {"K_Am2_s_per_T": [2000.0, 2000.0, 2000.0]}),
    "gravity_gradient_inertia_error": ("three_axis", {"inertia_xx_kg_m2": 4.0, "inertia_xy_kg_m2": -3.0}),
    "torquer_gain_error": ("tumble", {"gain": [0.2, 0.2, -0.3]}),
}
LONGER = {  # two orbits tell the elements of the inertia apart
    "gravity_gradient_inertia_error": {
        "schedule__segments": [{"start_utc": "2022-03-05T04:00:00Z", "duration_min": 200.0, "step_s": 20.0}]
    }
}


@pytest.mark.parametrize("effect", list(CASES))
def test_each_effect_is_named_with_its_size(effect: str) -> None:
    design, section = CASES[effect]
    telemetry, scenario = flown(design, **{f"effects__{effect}": section}, **LONGER.get(effect, {}))
    found = alone(telemetry, scenario)
    assert [one.name for one in found.named] == [effect]
    assert found.standing == found.named
    (one,) = found.named
    ((_, wanted),) = active_effects(scenario.updated({f"effects.{effect}": section}))
    sigma = np.sqrt(np.diag(one.covariance))
    known = np.isfinite(sigma)
    assert known.any()
    assert (np.abs(one.theta - wanted)[known] < 4.0 * sigma[known]).all()  # false alarm 6e-5 each
    if effect not in ("gravity_gradient_inertia_error", "eddy_torque"):  # their diagonals are not seen wholly here
        assert known.all()
    assert found.gap is not None
    assert found.gap.closed is not None
    assert found.gap.closed > 0.9


def test_an_effect_that_the_scenario_has_is_no_gap() -> None:
    telemetry, scenario = flown("bias", effects__residual_dipole_torque={"dipole_Am2": [0.2, 0.0, -0.1]})
    known = scenario.updated({"effects.residual_dipole_torque": {"dipole_Am2": [0.2, 0.0, -0.1]}})
    assert alone(telemetry, known).named == ()


@pytest.fixture(scope="module")
def mixed() -> tuple[Telemetry, Scenario, Diagnosis]:
    """A torque and a storm, through the front door."""
    telemetry, scenario = flown(
        "bias",
        effects__residual_dipole_torque={"dipole_Am2": [0.2, 0.0, -0.1]},
        effects__ring_current={"external_nT": -300.0},
    )
    return telemetry, scenario, diagnosing.diagnose(telemetry, scenario=scenario)


def test_a_torque_and_a_field_are_both_named(mixed) -> None:
    answer = mixed[2].to_dict()
    Draft202012Validator(diagnosis_schema()).validate(answer)
    assert answer["verdict"] == "effect"
    assert {one["name"] for one in answer["effects"]} == {"residual_dipole_torque", "ring_current"}
    stages = {one["name"]: one["stage"] for one in answer["effects"]}
    assert stages["residual_dipole_torque"] == "dynamics"
    assert answer["momentum"]["closed"] > 0.9
    assert answer["momentum"]["floor_deg"] == pytest.approx(0.05, rel=0.2)  # the error of the reference attitude
    assert answer["gap"]["closed"] > 0.5
    page = diagnosis_page.tables(mixed[2])
    assert any("momentum balance" in table.title.lower() for table in page)


def test_the_closed_scenario_flies_with_the_torque(mixed, tmp_path) -> None:
    telemetry, scenario, found = mixed
    save_scenario(scenario, tmp_path / "plan.toml")
    _, made = diagnosing.close(found, scenario=tmp_path / "plan.toml", telemetry=tmp_path / "t.nc")
    assert made is not None
    (torque,) = [theta for effect, theta in active_effects(made) if effect.name == "residual_dipole_torque"]
    assert np.abs(torque - [0.2, 0.0, -0.1]).max() < 0.02
    assert alone(telemetry, made).named == ()


def test_a_turned_reference_is_told_from_a_turned_magnetometer() -> None:
    """The momentum leans with the reference attitude; the readings, and what S makes of them, leave it alone."""
    telemetry, scenario = flown("bias", magnetometer__S=[[0.0, 0.0, 0.004], [0.0, 0.0, 0.0], [-0.004, 0.0, 0.0]])
    turn_deg = np.array([0.3, 0.0, -0.2])
    turn = Rotation.from_rotvec(np.radians(turn_deg))
    reported = frames.q_from_rotation(turn * frames.rotation_from_q(telemetry.q_NB))
    for record, wanted in ((telemetry, 0.0 * turn_deg), (telemetry.replace(q_NB=reported), turn_deg)):
        found = alone(record, scenario)
        assert found.gap is not None
        assert found.named == ()
        for axis, value in zip("xz", wanted[[0, 2]], strict=True):
            error, sigma = found.gap.standing_error_deg[axis]
            assert sigma is not None
            assert sigma < 0.05
            assert abs(error - value) < 4.0 * sigma


def test_sensors_at_rates_of_their_own_are_diagnosed(tmp_path) -> None:
    """From the scenario through a file to a named torque and a named field; few rows have reading and attitude."""
    scenario = parse_scenario(DESIGNS["bias"]).updated(
        {
            "schedule.segments": [{"start_utc": "2022-03-05T04:00:00Z", "duration_min": 120.0, "step_s": 4.0}],
            "sampling.magnetometer": {"every_s": 8.0},
            "sampling.attitude": {"every_s": 20.0, "offset_s": 4.0},
            "sampling.housekeeping": {"every_s": 20.0},
        }
    )
    torque = {"effects.residual_dipole_torque": {"dipole_Am2": [0.2, 0.0, -0.1]}}
    made = simulate(scenario.updated({**torque, "effects.ring_current": {"external_nT": -300.0}}))[0]
    telemetry = read_telemetry(write_telemetry(made, tmp_path / "interleaved.nc"))
    assert (telemetry.has_reading & telemetry.has_attitude).sum() < 0.25 * telemetry.has_reading.sum()
    found = {one.name: one for one in diagnosing.diagnose(telemetry, scenario=scenario).effects}
    assert set(found) == {"residual_dipole_torque", "ring_current"}
    wanted = {"dipole_x": 0.2, "dipole_y": 0.0, "dipole_z": -0.1, "external": -300.0}
    for name, parameter in (pair for one in found.values() for pair in one.parameters.items()):
        if parameter.sigma is not None:
            assert abs(parameter.value - wanted[name]) < 4.0 * parameter.sigma  # false alarm 6e-5 each
    assert found["ring_current"].parameters["external"].sigma is not None


ALIKE = {"along_track_error", "time_tag_offset", "sensor_lag"}


@pytest.mark.parametrize(
    ("effect", "size", "sigma_deg", "group"),
    [
        ("along_track_error", {"ahead_km": 40.0}, 0.005, {"along_track_error"}),
        ("time_tag_offset", {"offset_s": 6.0}, 0.005, {"time_tag_offset", "sensor_lag"}),
        ("time_tag_offset", {"offset_s": 6.0}, 0.05, ALIKE),
    ],
)
def test_torques_tell_a_clock_from_the_orbit(effect: str, size: Any, sigma_deg: float, group: set[str]) -> None:
    """Readings of a body that keeps to the Earth show both alike; a star tracker's attitude has the torques decide, which
    know the place to 7 km here. With an attitude ten times as rough they do not, and nothing is ruled out."""
    scenario = parse_scenario(DESIGNS["three_axis"]).updated(
        {"attitude.reference": {"sigma_deg": sigma_deg, "tau_s": 60.0}}
    )
    telemetry = simulate(scenario.updated({f"effects.{effect}": size}))[0]
    found = diagnosing.diagnose(telemetry, scenario=scenario)
    assert found.verdict == "effect"
    (one,) = found.effects
    assert set(one.group) == group
    if group != ALIKE:  # else any of the three may come first
        assert one.name == effect
        (parameter,), (wanted,) = one.parameters.values(), size.values()
        assert parameter.sigma is not None
        assert abs(parameter.value - wanted) < 4.0 * parameter.sigma  # false alarm 6e-5
    for name in ALIKE - group:
        assert "the momentum balance" in found.untestable[name]


def test_without_what_it_needs_nothing_changes_and_the_reason_is_said() -> None:
    telemetry, scenario = flown("bias")
    names = set(CASES)
    whole = diagnosing.diagnose(telemetry).to_dict()
    assert "momentum" not in whole
    assert names <= set(whole["untestable"])
    assert not names & {*whole["would_settle"], *whole["minimum_detectable"], *(r["name"] for r in whole["ranking"])}
    for column, word in (("dipole_B_Am2", "torquers"), ("wheel_speed_rpm", "wheel speeds")):
        found = alone(telemetry.replace(**{column: None}), scenario)
        assert found.gap is None
        assert word in found.untestable["eddy_torque"]
        assert set(found.untestable) == names
    short = alone(telemetry.select(slice(0, 30)), scenario)
    assert "too short" in short.untestable["eddy_torque"]


def test_blanks_are_filled_as_pandas_fills_them() -> None:
    rng = np.random.default_rng(1)
    for rows in (1, 2, 5, 40):
        t, values = np.cumsum(rng.uniform(0.1, 3.0, rows)), rng.normal(size=(rows, 3))
        values[rng.random(values.shape) < [0.3, 0.8, 1.0]] = np.nan
        table = pd.DataFrame(values, index=t)
        straight, held = table.interpolate("index", limit_area="inside"), table.ffill(limit_area="inside")
        assert np.array_equal(_filled(t, values, straight=True), straight.to_numpy(), equal_nan=True)
        assert np.array_equal(_filled(t, values, straight=False), held.to_numpy(), equal_nan=True)
