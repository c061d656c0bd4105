"""Closing: eq. 1 takes what was re-estimated exactly, effects keep nothing of their record, chances are what they say."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm, poisson
from worlds import scenario_text

from fluxtwin.diagnosis_page import effects_table
from fluxtwin.gap.detectors.codes import floor_noise, stochastic_nT, with_frozen_noise
from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.held_out.closing import Declared, calibration, closed_scenario, settle
from fluxtwin.gap.held_out.held_out import Prediction, closed_share
from fluxtwin.gap.held_out.transfer import DAYS, _others, _seen_by_chance, targets, transfers
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA, RobustRows
from fluxtwin.gap.noise.whitening import NoiseModel, make_whitener
from fluxtwin.gap.problem.problem import Budget, Problem, pose
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.records.diagnosis import Closure
from fluxtwin.gap.report.verdict import expected, too_many_outliers
from fluxtwin.gap.report.words import _cause
from fluxtwin.gap.selection.refit import Readings, refit
from fluxtwin.gap.selection.search import Support, found_effect
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect
from fluxtwin.sim.effects.chain import Chain
from fluxtwin.sim.effects.digits import BitErrors, ExcessNoise
from fluxtwin.sim.effects.response import Saturation
from fluxtwin.sim.effects.spacecraft_field import BatteryCurrent, Driver, SolarArrayCurrent
from fluxtwin.sim.effects.switched_field import HeaterSwitching, SwitchedField
from fluxtwin.sim.effects.temperature import ThermalBiasDrift
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.effect_sections import active_effects
from fluxtwin.sim.scenario.scenario import Scenario, load_scenario, parse_scenario, save_scenario
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
yaw_rms_deg = 4.0
roll_rms_deg = 4.0
pitch_rms_deg = 4.0
[thermal]
sunlit_degC = 25.0
eclipse_degC = -20.0
time_constant_min = 20.0
[torquers]
dipole_Am2 = 10.0
positions_m = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
"""
SCENARIO = scenario_text(SECTIONS, seed=4, inclination_deg=97.9932, segment="duration_min = 200.0, step_s = 60.0")
NOISE = NoiseModel(100.0, np.radians(0.1), 150.0)
MODELLED = ("bias", "scale_misalignment", "torquer_coupling")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(SCENARIO)


@pytest.fixture(scope="module")
def problem(scenario: Scenario) -> Problem:
    base = Magnetometer(
        np.array([[0.01, 0.002, 0.0], [0.0, -0.02, 0.0], [0.003, 0.0, 0.01]]),
        np.array([300.0, -200.0, 100.0]),
        np.diag([1.0, 2.0, 3.0]),
    )
    record = simulate(scenario)[0]
    return pose(record, load_field("igrf14", degree=6), modelled=MODELLED, instrument=base)


def closure_of(problem: Problem, modelled=(), chosen=(), stochastic=()) -> Closure:
    problem = dataclasses.replace(problem, modelled=tuple(effect for effect, _ in modelled))
    whitener = make_whitener(turn_images(problem.field_B_nT), problem.setting.seconds, problem.segment, NOISE)
    return Closure(problem, whitener, modelled, chosen, tuple(() for _ in chosen), stochastic, 1.0, 40, None)


def test_the_closed_magnetometer_reads_what_the_fit_read(problem: Problem, close) -> None:
    """b, S and C re-estimated as effects, against one magnetometer with eq. 1's b + db, S + dS, T - C."""
    rng = np.random.default_rng(1)
    modelled = tuple(
        (find_effect(name), scale * rng.standard_normal(size))
        for name, scale, size in (("bias", 500.0, 3), ("scale_misalignment", 0.05, 9), ("torquer_coupling", 20.0, 9))
    )
    closed = settle(closure_of(problem, modelled))
    fitted = problem.chain.reading_nT(modelled)
    again = Chain(dataclasses.replace(problem.setting, instrument=closed.instrument)).reading_nT()
    close(again, fitted, atol=1e-6, unit="nT", because="eq. 1 holds both exactly; rounding of 5e4 nT")
    assert closed.modelled == ()
    wrong = dataclasses.replace(closed.instrument, T_nT_per_Am2=-np.asarray(closed.instrument.T_nT_per_Am2))
    assert np.abs(Chain(dataclasses.replace(problem.setting, instrument=wrong)).reading_nT() - fitted).max() > 100.0


def test_sigmas_of_the_calibration_are_those_of_a_magnetometer(problem: Problem, close) -> None:
    """Against the information in what each number of eq. 1's S, b and T changes of the reading, one after the other."""
    theta = {
        "bias": np.array([50.0, -20.0, 10.0]),
        "scale_misalignment": np.full(9, 0.01),
        "torquer_coupling": np.ones(9),
    }
    closure = closure_of(problem, tuple((find_effect(name), theta[name]) for name in MODELLED))
    found, instrument = calibration(closure), settle(closure).instrument
    close(found.S, instrument.S, atol=1e-12, unit="1", because="one sum")
    close(found.T_nT_per_Am2, instrument.T_nT_per_Am2, atol=1e-12, unit="nT/Am^2", because="one sum")
    changed, steps = [], np.repeat([1e-4, 1.0, 0.01], [9, 3, 9])
    for number, step in enumerate(steps):
        both = []
        for sign in (0.5, -0.5):
            S, b, T = np.split(found.values + sign * step * (np.arange(21) == number), [9, 12])
            moved = dataclasses.replace(instrument, S=S.reshape(3, 3), b_nT=b, T_nT_per_Am2=T.reshape(3, 3))
            both.append(Chain(dataclasses.replace(problem.design.setting, instrument=moved)).reading_nT())
        changed.append((both[0] - both[1]) / step)
    white = closure.whitener.apply(np.stack(changed, axis=2)).reshape(-1, 21)
    expected = np.linalg.inv(white.T @ white)
    ratio = found.covariance / np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    own = expected / np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    close(ratio, own, atol=3e-4, unit="1", because="S is moved by 0.01, whose square twice is left of a variance")
    assert np.abs(np.diag(np.delete(np.delete(found.covariance, 0, 0), 0, 1))).min() > 0.0
    alone = calibration(closure_of(problem, ((find_effect("bias"), theta["bias"]),)))
    assert alone.sigma["S11"] is None and alone.sigma["T12"] is None and alone.sigma["b1"] is not None


def test_the_scenario_takes_S_b_and_T_and_survives_the_file(
    problem: Problem, scenario: Scenario, tmp_path: Path
) -> None:
    modelled = ((find_effect("bias"), np.array([1.0, 2.0, 3.0])), (find_effect("torquer_coupling"), np.arange(9.0)))
    noise, sure = find_effect("excess_noise"), Support(0.0, 1.0, ("excess_noise",))
    noisy = (found_effect(noise, np.array([50.0]), np.array([5.0]), problem.setting, sure, "all"),)
    closure = closure_of(problem, modelled, stochastic=noisy)
    closed = settle(closure)
    made = closed_scenario(closure, closed, [], scenario, Path("flight.csv"), None, Declared())
    again = load_scenario(save_scenario(made, tmp_path / "closed.toml"))
    assert np.array_equal(again.magnetometer.b_nT, [301.0, -198.0, 103.0])
    assert np.array_equal(again.magnetometer.T_nT_per_Am2, np.diag([1.0, 2.0, 3.0]) - np.arange(9.0).reshape(3, 3))
    assert again.magnetometer.S == scenario.magnetometer.S  # it was not re-estimated
    assert again.effects.excess_noise.rms_nT == 50.0 and again.effects.excess_noise.covariance == ((25.0,),)
    assert again.closure.rows == problem.rows and again.closure.telemetry == "flight.csv"


def test_of_a_current_that_nobody_recorded_nothing_is_per_ampere(problem: Problem, scenario: Scenario) -> None:
    """The number is that of full sun on the panel that was assumed, in the sentence, the table and the JSON; the closed
    scenario, which has the panel too, gives that very field. Beside a recorded current it is per ampere."""
    sizes, sigma = np.array([181.0, -104.0, 102.0]), np.array([17.0, 20.0, 7.0])
    recorded = replace(problem.setting, columns={**problem.setting.columns, "array_current_A": problem.setting.seconds})
    charged = replace(
        problem.setting, columns={**problem.setting.columns, "battery_current_A": problem.setting.seconds}
    )
    sun, known = "in full sun on an assumed", "as no current was recorded"
    opposite = "and the opposite in shadow"
    tapers = "at sunrise on an assumed charging current that tapers, as that of the battery was not recorded"
    for effect, setting, unit, assumed in [
        (SolarArrayCurrent(), problem.setting, "nT", f"{sun} panel on -z, {known}"),
        (SolarArrayCurrent("tracking"), problem.setting, "nT", f"{sun} array that turns about y, {known}"),
        (SolarArrayCurrent("constant"), charged, "nT", f"{sun} array that always faces the sun, {known}"),
        (BatteryCurrent(), problem.setting, "nT", f"{sun} array that always faces the sun, {opposite}, {known}"),
        (BatteryCurrent("zenith"), problem.setting, "nT", f"{sun} panel on -z, {opposite}, {known}"),
        (SolarArrayCurrent(), recorded, "nT/A", ""),
        (SolarArrayCurrent("balance"), charged, "nT/A", ""),
        (BatteryCurrent(), recorded, "nT/A", ""),
        (BatteryCurrent(), charged, "nT/A", ""),
        (BatteryCurrent("tapered", 900.0, 0.1), recorded, "nT", tapers),
        (BatteryCurrent("tapered", 900.0, 0.1), charged, "nT/A", ""),
    ]:
        found = found_effect(effect, sizes, sigma, setting, Support(1e-9, 0.9, (effect.name,)), "all")
        said = f"{effect.name} (s_x 181 {unit}, s_y -104 {unit}, s_z 102 {unit}{f' {assumed}' if assumed else ''})"
        assert _cause(found) == said
        table = effects_table(SimpleNamespace(effects=[found]))  # type: ignore[arg-type]
        assert [row[1] for row in table.rows] == [f"s_{axis} [{unit}]" for axis in "xyz"]
        assert table.note.endswith(f"are the field {assumed}." if assumed else "number of tests.")
        plain = found.to_dict()
        assert plain["parameters"]["s_x"]["unit"] == unit and plain["settings"].get("assumed", "") == assumed
    closure = closure_of(problem, chosen=((SolarArrayCurrent("tracking"), sizes),))
    closed = replace(settle(closure), named=((SolarArrayCurrent("tracking"), sizes, np.eye(3)),))
    made = closed_scenario(closure, closed, [], scenario, Path("x.csv"), None, Declared())
    ((again, theta),) = active_effects(made)
    assert again == SolarArrayCurrent("tracking") and np.array_equal(theta, sizes)


def test_the_scenario_of_a_record_has_the_step_of_its_readings(problem: Problem, tmp_path: Path, close) -> None:
    """Without it the next record's own step would be a gap, `coarse_quantization`; what was declared comes first."""
    record = problem.telemetry
    stepped = record.replace(mag_B_nT=np.rint(record.mag_B_nT / 40.0) * 40.0)
    late = find_effect("time_tag_offset")
    closure = closure_of(dataclasses.replace(problem, telemetry=stepped))
    closed = dataclasses.replace(settle(closure), named=((late, np.ones(1), np.eye(1)),))
    closure = dataclasses.replace(closure, chosen=((late, np.ones(1)),))
    steps = [
        closed_scenario(closure, closed, [], None, tmp_path / "x.csv", None, declared).magnetometer.lsb_nT
        for declared in (Declared(), Declared(lsb_nT=25.0))
    ]
    close(steps, [40.0, 25.0], atol=1e-6, unit="nT", because="the readings are multiples of it")
    declared = Declared(field=load_field("igrf14", degree=6))  # one that was loaded has a name and a degree
    field = closed_scenario(closure, closed, [], None, tmp_path / "x.csv", None, declared).field
    assert (field.model, field.degree, field.truth, field.truth_degree) == ("igrf14", 6) * 2


def test_an_effect_that_the_scenario_has_is_added_to_or_refused(problem: Problem, scenario: Scenario) -> None:
    lag, late = find_effect("sensor_lag"), find_effect("time_tag_offset")
    had = dataclasses.replace(problem, frozen=((late, np.array([2.0])), (SwitchedField("night"), np.ones(3))))
    closure = closure_of(had)
    closed = dataclasses.replace(
        settle(closure), named=((late, np.array([1.5]), np.eye(1)), (lag, np.ones(1), np.eye(1)))
    )
    closure = dataclasses.replace(closure, chosen=((late, np.array([1.5])),))
    made = closed_scenario(closure, closed, [], scenario, Path("x.csv"), None, Declared())
    assert made.effects.time_tag_offset.offset_s == 3.5 and made.effects.sensor_lag.lag_s == 1.0
    other = dataclasses.replace(closed, named=((SwitchedField("eclipse"), np.ones(3), np.eye(3)),))
    with pytest.raises(BadInput, match="other settings"):
        closed_scenario(closure, other, [], scenario, Path("x.csv"), None, Declared())


def test_pinned_effects_say_the_same_and_keep_it_on_another_record(problem: Problem) -> None:
    setting, reading = problem.setting, problem.chain.reading_nT()
    half = dataclasses.replace(setting, time=setting.time[100:])
    sequence = tuple(int(n % 7 < 3) for n in range(setting.time.size))
    heater = HeaterSwitching(sequence).pinned(setting, reading)
    assert np.array_equal(heater.values(setting), sequence)
    assert np.array_equal(heater.values(half), sequence[100:])
    theta = np.array([20.0, -10.0, 5.0])
    for effect, size in ((ThermalBiasDrift(), theta), (Saturation(), np.array([3000.0]))):
        pinned = effect.pinned(setting, reading)
        assert pinned != effect
        assert np.array_equal(problem.chain.reading_nT([(pinned, size)]), problem.chain.reading_nT([(effect, size)]))
    clip = Saturation().pinned(setting, reading)
    assert clip.full_scale_nT == np.abs(reading).max()


def test_effects_of_a_moment_say_that_they_are() -> None:
    bound = {effect.name for effect in CATALOGUE if effect.bound}
    steps = {"bias_step", "attitude_step", "mounting_step"}
    assert bound == {*steps, "linear_drift", "bias_random_walk", "ring_current", "wheel_field"}
    assert "2020" in find_effect("bias_step").__class__(at="2020-03-01T00:00:00Z").bound
    assert SwitchedField("interval", "2020-03-01T00:00:00Z", "2020-03-02T00:00:00Z").bound
    assert HeaterSwitching((0, 1, 0)).bound and not HeaterSwitching().bound


def test_what_the_record_did_not_excite_does_not_transfer(problem: Problem) -> None:
    """Covariances are NaN where a torquer never fired; a well-known effect on the same design does transfer."""
    coupling, late = find_effect("torquer_coupling"), find_effect("time_tag_offset")
    covariance = np.full((9, 9), np.nan)
    covariance[np.ix_([0, 3, 6], [0, 3, 6])] = 0.1 * np.eye(3)
    theta = np.array([8.0, 0.0, 0.0, 5.0, 0.0, 0.0, -6.0, 0.0, 0.0])
    modelled = ((find_effect("bias"), np.zeros(3)),)
    closure = closure_of(problem, modelled, ((coupling, theta), (late, np.array([5.0]))))
    found = transfers(closure, [(coupling, theta, covariance), (late, np.array([5.0]), np.array([[1e-4]]))])
    unseen = [one for one in found if one.effect == "torquer_coupling"]
    assert unseen and not any(one.transfers for one in unseen)
    assert all(one.why == "these data did not excite C_xy, C_xz, C_yy, C_yz, C_zy, C_zz" for one in unseen)
    nadir = next(one for one in found if one.effect == "time_tag_offset")
    assert nadir.transfers and 0.0 < nadir.uncertainty_nT < nadir.detectable_nT
    vague = transfers(closure, [(coupling, theta, covariance), (late, np.array([5.0]), np.array([[100.0]]))])
    assert not next(one for one in vague if one.effect == "time_tag_offset").transfers


def test_chance_of_being_seen_is_that_of_the_score(close) -> None:
    """With equal variances 1 + l the score is (1 + l) times chi-square: an exact witness."""
    for spread, rank in ((0.0, 1), (3.0, 3), (0.5, 9)):
        bar = float(chi2.isf(0.01, rank))
        close(
            _seen_by_chance(np.full(rank, spread), bar),
            chi2.sf(bar / (1.0 + spread), rank),
            atol=0.01,
            unit="1",
            because="20,000 draws: 0.0035 at most, one sigma",
        )
    assert _seen_by_chance(np.ones(3), 0.0) == 1.0


def test_targets_keep_the_motion_and_follow_the_sun(problem: Problem) -> None:
    """A sun-synchronous node (97.99 deg at 650 km: Wertz, 360 deg in 365.24 days) keeps its local time all year."""
    found = targets(problem)
    names = [target.name for target in found]
    assert names == [
        "nadir, 12 h later",
        "nadir, 90 days later",
        "nadir, 182 days later",
        "tumble of 0.25 deg/s, 90 days later",
        "spin of 1.9 rpm, 90 days later",
    ]
    here = problem.setting
    R_BO = here.given[2] * here.R_ON.inv()
    for target, days in zip(found[:3], DAYS, strict=True):
        there = target.setting
        assert epoch.seconds_since(there.time[:1], here.time[0])[0] == pytest.approx(86400.0 * days, abs=1e-3)
        assert ((there.given[2] * there.R_ON.inv()) * R_BO.inv()).magnitude().max() < 1e-6  # rad
        assert abs(local_hours(there) - local_hours(here)) < 0.6  # the equation of time alone moves it by 0.5 h
    assert not np.allclose(found[1].setting.columns["temperature_degC"], here.columns["temperature_degC"])
    assert np.array_equal(found[1].setting.columns["dipole_B_Am2"], here.columns["dipole_B_Am2"])
    turned = found[3].setting.given[2]
    assert np.degrees((turned[1:] * turned[:-1].inv()).magnitude()).mean() == pytest.approx(0.25 * 60.0, rel=0.05)


def test_a_tumble_that_hides_a_panel_from_the_sun_is_flown_the_other_way_up(problem: Problem) -> None:
    """At the end of May the sun is on the side of +z of both: a panel on -z is in the shade of the body. What no start can
    show is said of the one flight that was tried, and of no other."""
    panel, absent = SolarArrayCurrent("zenith"), Driver(column="pump")
    hidden = targets(problem)[-2:]
    assert all(panel.untestable(one.setting) for one in hidden)
    assert "never sees the sun" in str(panel.untestable(hidden[0].setting))
    shown = targets(problem, [panel])
    assert [one.name for one in shown] == [one.name for one in targets(problem)]
    for one, before in zip(shown[-2:], hidden, strict=True):
        assert panel.untestable(one.setting) is None and panel.values(one.setting).max() > 0.3
        rates = [np.linalg.norm(s.rate_B_rad_s, axis=1).mean() for s in (one.setting, before.setting)]
        assert rates[0] == pytest.approx(rates[1], rel=1e-6)
    closure = closure_of(problem, ((find_effect("bias"), np.zeros(3)),), ((absent, np.zeros(3)),))
    said = {one.why for one in transfers(closure, [(absent, np.zeros(3), np.eye(3))])}
    assert said == {"it has no effect in the one flight that was tried (the telemetry has no driver_pump)"}


def test_a_body_that_keeps_any_attitude_to_the_orbit_points_to_nadir(problem: Problem) -> None:
    """What its axes are called is no matter: turned by a third of a turn it flies as it did."""
    turn = Rotation.from_rotvec(np.radians([70.0, -60.0, 80.0]))
    record = problem.telemetry
    assert record.q_NB is not None
    q_NB = frames.q_from_rotation(turn * frames.rotation_from_q(record.q_NB))
    turned = pose(record.replace(q_NB=q_NB), problem.setting.model, modelled=MODELLED)
    assert [target.name for target in targets(turned)] == [target.name for target in targets(problem)]


def test_what_else_it_may_be_is_weighed_by_what_it_costs(problem: Problem, close) -> None:
    """Against a name with one parameter another with three has exp(drop / 2) / N of the weight (Schwarz 1978)."""
    one, three = find_effect("time_tag_offset"), find_effect("thermal_bias_drift")
    modelled = tuple((find_effect(name), np.zeros(size)) for name, size in zip(MODELLED, (3, 9, 9), strict=True))
    closure = dataclasses.replace(closure_of(problem, modelled, ((one, np.zeros(1)),)), alternatives=((three,),))
    readings = Readings(problem, closure.whitener)
    fits = [refit(readings, [(e, np.zeros(len(e.parameters)))], modelled=modelled) for e in (one, three)]
    (other,) = _others(closure, 0)
    wanted = np.exp((fits[0].chi2 - fits[1].chi2) / 2.0) / problem.rows
    close(other.weight / (1.0 - other.weight), wanted, atol=1e-3 * wanted, unit="1", because="where the refits end")


def local_hours(setting) -> float:
    """True local solar time of the ascending node [h]."""
    r, v, _ = setting.given
    normal = np.cross(r[0], v[0])
    pole = frames.rotation_TN(setting.time[0]).inv().apply([0.0, 0.0, 1.0]).reshape(3)
    node, to_sun = np.cross(pole, normal), sun.sun_direction_N(setting.time[:1])[0]
    flat = to_sun - (to_sun @ pole) * pole
    return float(np.degrees(np.arctan2(np.cross(flat, node) @ pole, flat @ node))) / 15.0


def test_an_effect_of_a_few_stretches_is_measured() -> None:
    """A clip acts near the poles only: how much it closes is known though few stretches show it."""
    rng = np.random.default_rng(2)
    after = 100.0 * rng.standard_normal((480, 3))
    signal = np.zeros((480, 3))
    signal[200:208] = 800.0
    kept = np.ones(480, dtype=bool)
    found = Prediction(after + signal, after, kept, 100.0, 100.0).shrinkage(named=True)
    assert found.closed is not None and found.closed > 0.9
    nothing = Prediction(after, after, kept, 100.0, 100.0).shrinkage(named=True)
    assert nothing.closed is None  # nothing is left of spikes that are cut: not measurable, not zero and not one


@pytest.mark.parametrize(
    ("signal_nT", "share_left", "log_sd", "low", "high"),
    [
        (300.0, 0.02, 0.0, 1.0, 5.0),  # a shape error of 0.14: as an effect of the right name leaves
        (
            300.0,
            0.60,
            0.0,
            -np.inf,
            -3.5,
        ),  # no shape error of 0.15 leaves so much: 20 to 1 for something unknown and more
        (300.0, 1.20, 0.0, -np.inf, -1e300),  # worse than nothing: never
        (5.0, 1.00, 0.0, -0.3, 0.3),  # a signal that held-out samples do not measure says neither
        (80.0, 0.60, 0.4, -1.5, 0.5),  # nor what a budget that is so unsure may have made
    ],
)
def test_what_is_left_of_held_out_samples_speaks_for_or_against_the_names(
    signal_nT: float, share_left: float, log_sd: float, low: float, high: float
) -> None:
    rng = np.random.default_rng(4)
    noise, wave = 100.0 * rng.standard_normal((1200, 3)), np.sqrt(2.0) * np.sin(np.arange(3600.0)).reshape(-1, 3)
    before, after = noise + signal_nT * wave, noise + np.sqrt(share_left) * signal_nT * wave
    kept = np.ones(1200, dtype=bool)
    assert low <= Prediction(before, after, kept, 100.0, 100.0, floor_log_sd=log_sd).log_ratio < high


def test_noise_of_the_scenario_is_expected_and_no_other() -> None:
    frozen = [(find_effect("excess_noise"), np.array([150.0])), (find_effect("coarse_quantization"), np.array([400.0]))]
    assert with_frozen_noise(frozen, 100.0, 100.0) == (pytest.approx(np.hypot(100.0, 150.0)), 400.0)
    assert with_frozen_noise(frozen, None, None) == (None, 400.0)
    assert with_frozen_noise([], 100.0, None) == (100.0, None)
    alike = Finding(ExcessNoise(), np.array([165.0]), np.array([10.0]))
    assert expected(alike, frozen) and not expected(alike, [])
    assert not expected(Finding(ExcessNoise(), np.array([300.0]), np.array([10.0])), frozen)
    found = NoiseModel(130.0, 1e-3, 0.0, sigma_prior_nT=50.0)
    assert stochastic_nT([alike], found, None) == pytest.approx(120.0)  # beyond the declared, in variance
    assert replace(alike, worth=2.0).probability == pytest.approx(1.0 - np.exp(-1.0), rel=1e-12)
    assert replace(alike, worth=100.0).probability == pytest.approx(1.0, abs=1e-12)
    assert not expected(Finding(BitErrors(), np.array([0.01]), np.array([0.001])), frozen)


def test_the_floor_is_that_of_the_declared_noise() -> None:
    """A strong clip was noise to the choice of the noise; the floor must not rise with it. A stuck bit has its own."""
    noise, budget = (
        NoiseModel(900.0, np.radians(0.8), 150.0, sigma_prior_nT=104.0),
        Budget(100.0, 100.0, np.radians(0.1)),
    )
    white, theta = floor_noise([], noise, budget)
    assert white == pytest.approx(104.0) and np.degrees(theta) == pytest.approx(0.1)
    assert floor_noise([], noise, Budget()) == (pytest.approx(900.0), noise.theta_rad)
    stuck = Finding(BitErrors(4, "stuck_1", 100.0), np.ones(1), np.zeros(1))
    assert floor_noise([stuck], noise, budget)[0] == pytest.approx(np.hypot(104.0, 800.0))


def test_readings_set_aside_are_too_many_where_chance_gives_one_in_a_thousand() -> None:
    """Of 30,000 components chance sets some aside: the least count that it reaches less than once in a thousand."""
    time = np.datetime64("2020-03-01", "ns") + np.arange(10_000)
    problem: Any = SimpleNamespace(time=time, measured=np.ones((10_000, 3)))
    chance = 2.0 * norm.sf(CUT_SIGMA) * 30_000
    count = next(n for n in range(1, 1000) if poisson.sf(n - 1, chance) <= 1e-3)
    for cut, said in ((count, True), (count - 1, False)):
        weights = np.ones((10_000, 3))
        weights[:cut, 0] = 0.0
        assert (too_many_outliers(problem, RobustRows(weights)) is not None) == said


def test_a_bootstrap_of_stretches_is_about_what_was_measured() -> None:
    rng = np.random.default_rng(3)
    after = rng.normal(0.0, 10.0, (600, 3))
    before = after + 30.0 * np.sin(np.arange(600) / 50.0)[:, None]
    held = Prediction(before, after, np.ones(600, dtype=bool), 10.0, 10.0)
    for drawn, rows in zip(held._draws(after), (before, after), strict=True):
        assert drawn.mean() == pytest.approx((rows**2).mean(), rel=0.02) and 0.0 < drawn.std() < 0.1 * drawn.mean()


def test_the_closed_share_is_of_the_power_above_the_floors() -> None:
    """50 nT above a floor of 10 nT, and 30 nT above one of 20 nT: of 2400 nT^2 500 stay. A bootstrap that draws what stays
    evenly from 0 to 1000 nT^2 has its 5 and 95 % at 50 and 950 nT^2. What is below its floor leaves nothing."""
    before, after = np.full(101, 2500.0), np.linspace(400.0, 1400.0, 101)
    closed, between = closed_share(50.0, 30.0, 10.0, 20.0, before, after)
    assert (closed, *between) == pytest.approx((1.0 - 500.0 / 2400.0, 1.0 - 950.0 / 2400.0, 1.0 - 50.0 / 2400.0))
    assert closed_share(50.0, 15.0, 10.0, 20.0, before, np.full(101, 225.0)) == (1.0, (1.0, 1.0))


def test_draws_of_held_out_samples_scatter_about_what_was_held_out() -> None:
    """A bootstrap is unbiased: 100 and 25 nT^2 a component, with a scatter over the draws of some percent."""
    rng = np.random.default_rng(9)
    after = 5.0 * rng.standard_normal((900, 3))
    before = 2.0 * after
    one = Prediction(before, after, np.ones(900, dtype=bool), 5.0, 5.0)
    before2, after2 = one._draws(after)
    assert before2.mean() == pytest.approx(np.mean(before**2), rel=0.02)
    assert after2.mean() == pytest.approx(np.mean(after**2), rel=0.02)
