"""What every effect of the catalogue owes: zero is absent, Jacobians hold, what is simulated is what is predicted."""

from __future__ import annotations

import dataclasses
import json
import warnings

import numpy as np
import pytest
from pydantic import ValidationError
from worlds import scenario_text

from fluxtwin.gap.problem.problem import pose
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.base import STAGES, DistributionEffect, DynamicsEffect, SignalEffect
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect
from fluxtwin.sim.effects.chain import Chain, jacobian
from fluxtwin.sim.run import spacecraft as scenario_spacecraft
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.effect_sections import (
    _section_type,
    active_effects,
    effect_section,
    effect_toml,
    keys_of,
    unit_suffix,
)
from fluxtwin.sim.scenario.scenario import Scenario, load_scenario, parse_scenario
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
yaw_rms_deg = 1.0
roll_rms_deg = 1.0
[magnetometer]
S = [[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]
b_nT = [1000.0, -500.0, 200.0]
[sun_sensor.1]
azimuth_deg = 0.0
elevation_deg = 45.0
[sun_sensor.2]
azimuth_deg = 180.0
elevation_deg = 45.0
[torquers]
dipole_Am2 = 50.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [1.5, 0.0, 0.0]]
[power]
full_sun_current_A = 8.0
load_A = 3.0
[thermal]
sunlit_degC = 15.0
eclipse_degC = -60.0
time_constant_min = 20.0
heater_on_below_degC = -5.0
heater_off_above_degC = 0.0
heater_rise_degC = 60.0
[wheels]
axes_B = [[0.0, 1.0, 0.0]]
inertia_kg_m2 = 0.01
bias_rpm = [2000.0]
[drivers.payload]
pattern = "ramp"
low = -1.0
high = 3.0
period_s = 2900.0
"""
DESIGN = scenario_text(SECTIONS, seed=5, raan_deg=100.0, segment="duration_min = 200.0, step_s = 10.0")
"""Everything that any effect acts on, and no noise at all."""

STAGE_OF = {
    "residual_dipole_torque": "dynamics",
    "aerodynamic_torque": "dynamics",
    "solar_pressure_torque": "dynamics",
    "eddy_torque": "dynamics",
    "gravity_gradient_inertia_error": "dynamics",
    "torquer_gain_error": "dynamics",
    "bias": "sensor",
    "scale_misalignment": "sensor",
    "torquer_coupling": "spacecraft",
    "quadratic_nonlinearity": "sensor",
    "cubic_nonlinearity": "sensor",
    "hysteresis": "sensor",
    "saturation": "sensor",
    "sensor_lag": "sensor",
    "coarse_quantization": "sensor",
    "excess_noise": "sensor",
    "thermal_bias_drift": "sensor",
    "thermal_scale_drift": "sensor",
    "bias_step": "sensor",
    "linear_drift": "sensor",
    "common_gain_drift": "sensor",
    "mounting_step": "sensor",
    "axis_skew": "sensor",
    "bias_random_walk": "sensor",
    "bit_errors": "telemetry",
    "time_tag_offset": "time",
    "along_track_error": "orbit",
    "field_epoch": "field",
    "field_truncation": "field",
    "ring_current": "field",
    "solar_array_current": "spacecraft",
    "battery_current": "spacecraft",
    "driver": "spacecraft",
    "law": "spacecraft",
    "heater_switching": "spacecraft",
    "wheel_field": "spacecraft",
    "eddy_current": "spacecraft",
    "switched_field": "spacecraft",
    "boom_bending": "spacecraft",
    "sun_sensor_head_misalignment": "attitude",
    "horizon_scanner_bias": "attitude",
    "yaw_drift": "attitude",
    "attitude_step": "attitude",
    "attitude_lag": "attitude",
    "stray_field": "spacecraft",
}
"""The names that are promised, and where in the chain each acts."""

ALSO_LOOKS_LIKE = {
    "bias": {"spacecraft"},
    "scale_misalignment": {"attitude"},
    "hysteresis": {"spacecraft"},
    "sensor_lag": {"time"},
    "coarse_quantization": {"telemetry"},
    "bias_step": {"spacecraft"},
    "linear_drift": {"spacecraft"},
    "mounting_step": {"attitude", "spacecraft"},
    "attitude_step": {"sensor", "spacecraft"},
    "axis_skew": {"time"},
    "bias_random_walk": {"spacecraft"},
    "boom_bending": {"attitude", "sensor"},
}

NOT_EXACT_NT = {
    # The prediction knows the motion between stamps only from the record, here by quintics over four rows to either
    # side. Libration of 1 deg rms, periods from 10 min: the straight part is right to 1e-9 rad/s; times 0.5 s and
    # 45,000 nT that is 2e-5 nT; at the ends, where fits are one-sided, ten times that.
    "time_tag_offset": 1e-3,
    "axis_skew": 1e-3,
    "attitude_lag": 1e-3,
    "eddy_current": 1e-4,
    "sensor_lag": 1e-3,
    # The history is that of the smoothed attitudes.
    "hysteresis": 1e-4,
}
"""Largest difference of simulation and prediction, nT; all others agree to rounding (1e-6 nT)."""

NOT_LINEAR = {
    # The model's rates change at the knot of 2020, two months before these stamps: a year back is not a year ahead.
    "field_epoch": 0.05,
    # Clipping deeper reaches rows that are not clipped at half the depth; the search linearises at several depths.
    "saturation": 1.0,
}
"""Share by which the Jacobian may change when its step is halved; 0.001 for all others."""


def scale_of(effect) -> np.ndarray:
    return np.array([parameter.scale for parameter in effect.parameters])


def switched_on(scenario: Scenario, effect, theta) -> Scenario:
    return scenario.updated({f"effects.{effect.name}": effect_section(effect, theta)})


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(DESIGN)


@pytest.fixture(scope="module")
def run(scenario):
    return simulate(scenario)


def predicting(scenario, telemetry) -> Chain:
    instrument = scenario_spacecraft.magnetometer(scenario)
    return pose(telemetry, load_field(), instrument=instrument).chain


@pytest.fixture(scope="module")
def chain(scenario, run) -> Chain:
    return predicting(scenario, run[0])


LAW = {"law": {"of": ("driver_payload", "not sunlit"), "axes": "orbital", "lag_s": 100.0}}
EFFECTS = [
    effect
    if effect.keyed_by is None
    else dataclasses.replace(effect, **{effect.keyed_by: "payload"}, **LAW.get(effect.name, {}))
    for effect in CATALOGUE
    if not isinstance(effect, DynamicsEffect)
]
"""Those of which there may be several as that of the design's one driver."""


@pytest.fixture(params=EFFECTS, ids=lambda effect: effect.name)
def effect(request):
    """Those on the dynamics move the spacecraft itself, and have tests of their own."""
    return request.param


@pytest.fixture(params=[effect for effect in EFFECTS if isinstance(effect, SignalEffect)], ids=lambda e: e.name)
def signal_effect(request):
    return request.param


def alternatives(effect, chain):
    """The first and the last setting worth trying on this design."""
    found = effect.alternatives(chain.setting)
    return tuple(dict.fromkeys((found[0], found[-1])))


def test_the_catalogue_is_what_is_promised():
    assert {effect.name: effect.stage for effect in CATALOGUE} == STAGE_OF
    assert {e.name: set(e.equivalent_stages) for e in CATALOGUE if e.equivalent_stages} == ALSO_LOOKS_LIKE
    order = [STAGES.index(effect.stage) for effect in CATALOGUE]
    assert order == sorted(order)


def test_parameters_have_units_and_a_scale_within_their_range(effect):
    assert effect.parameters
    assert len({parameter.name for parameter in effect.parameters}) == len(effect.parameters)
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.low <= 0.0 <= parameter.high
        assert 0.0 < parameter.scale <= parameter.high
    assert len(effect.about) > 20
    assert hash(effect) is not None
    with pytest.raises(dataclasses.FrozenInstanceError):
        effect.anything = 1


def test_the_design_can_show_every_effect(effect, chain):
    assert effect.untestable(chain.setting) is None


def test_zero_is_absent(effect, chain):
    """Bit for bit: in the chain, and for a draw of size zero."""
    zero = np.zeros(len(effect.parameters))
    for alternative in alternatives(effect, chain):
        assert np.array_equal(chain.reading_nT([(alternative, zero)]), chain.reading_nT())
        if isinstance(alternative, DistributionEffect):
            drawn = alternative.draw(chain.signal(), zero, stream(1, "effects.test"))
            assert np.array_equal(drawn.reading, chain.reading_nT())


def test_a_signal_effect_grows_from_zero(signal_effect, chain, close):
    """A billionth of the typical size moves the reading by a billionth of what the typical size does, or so."""
    for alternative in alternatives(signal_effect, chain):
        whole = chain.reading_nT([(alternative, scale_of(alternative))]) - chain.reading_nT()
        little = chain.reading_nT([(alternative, 1e-9 * scale_of(alternative))]) - chain.reading_nT()
        assert np.abs(whole).max() > 1.0
        close(little, 0.0, atol=1e-8 * np.abs(whole).max() + 1e-9, unit="nT", because="tenfold, and rounding of 5e4 nT")


def test_the_jacobian_does_not_depend_on_its_step(signal_effect, chain, monkeypatch):
    """At half the step it is the same to a share of its rms."""
    for alternative in alternatives(signal_effect, chain):
        whole = jacobian(chain, alternative)
        halved = tuple(dataclasses.replace(p, scale=0.5 * p.scale) for p in alternative.parameters)
        with monkeypatch.context() as patch:
            patch.setattr(type(alternative), "parameters", halved)
            half = jacobian(chain, alternative)
        assert whole.shape == (chain.setting.time.size, 3, len(halved))
        assert np.isfinite(whole).all()
        share = np.sqrt(np.mean((whole - half) ** 2) / np.mean(whole**2))
        assert share <= NOT_LINEAR.get(signal_effect.name, 1e-3)


def test_what_is_simulated_is_what_is_predicted(signal_effect, chain, scenario, close):
    """Noise-free telemetry with the effect in it, and the chain run on the motion as reported, with the same theta.

    Half the parameters and a wrong sign do not do.
    """
    for alternative in alternatives(signal_effect, chain):
        theta = 0.9 * scale_of(alternative)
        flown = switched_on(scenario, alternative, theta)
        ((found, parameters),) = active_effects(flown)
        assert found == alternative
        telemetry, _ = simulate(flown)
        reported = predicting(scenario, telemetry)
        atol = NOT_EXACT_NT.get(signal_effect.name, 1e-6)
        predicted = reported.reading_nT([(found, parameters)])
        close(predicted, telemetry.mag_B_nT, atol=atol, unit="nT", because="rounding, or as NOT_EXACT_NT says")
        for wrong in (0.0, 0.5, -1.0):
            assert np.abs(reported.reading_nT([(found, wrong * parameters)]) - telemetry.mag_B_nT).max() > 2 * atol


@pytest.fixture(scope="module")
def plain(run, tmp_path_factory):
    """The file without any effect, which has a column battery_current_A, say."""
    return write_telemetry(run[0], tmp_path_factory.mktemp("plain") / "plain.nc").read_bytes()


def test_switched_on_the_telemetry_changes_and_carries_no_name_of_it(effect, scenario, run, plain, tmp_path):
    theta = scale_of(effect)
    flown = switched_on(scenario, effect, theta)
    telemetry, truth = simulate(flown)
    others = {"flags", "drivers", "driver_units", "provenance", "origin"}
    columns = {item.name for item in dataclasses.fields(telemetry)} - others
    same = [
        getattr(telemetry, name) is None
        or np.array_equal(getattr(telemetry, name), getattr(run[0], name), equal_nan=True)
        for name in columns
    ]
    assert not all(same)
    assert telemetry.provenance == run[0].provenance
    content = write_telemetry(telemetry, tmp_path / "t.nc").read_bytes()
    for word in (effect.name, "effect", *(key.name for key in keys_of(effect) if len(key.name) > 6)):
        assert word.encode() not in content or word.encode() in plain
    recorded = json.loads(truth.effects)
    assert list(recorded) == [effect.name]
    assert recorded[effect.name] == {**recorded[effect.name], **json.loads(json.dumps(effect_section(effect, theta)))}
    again = simulate(flown)[0]
    assert np.array_equal(again.mag_B_nT, telemetry.mag_B_nT)


def test_a_section_survives_saving(effect, chain, scenario):
    for alternative in alternatives(effect, chain):
        flown = switched_on(scenario, alternative, 0.37 * scale_of(alternative))
        again = parse_scenario(flown.to_toml())
        assert again == flown
        ((before, one),), ((after, other),) = active_effects(flown), active_effects(again)
        assert before == after == alternative
        assert np.array_equal(one, other)
        assert effect_toml(alternative, one).startswith(f"[effects.{effect.name}]")


def test_a_section_has_a_matrix_row_by_row():
    section, matrix = _section_type(find_effect("scale_misalignment")), (1e-3 * np.arange(9.0)).reshape(3, 3).tolist()
    assert np.array_equal(section.model_validate({"S": matrix}).S, matrix)
    for wrong in (matrix[:2], [*matrix[:2], matrix[2][:2]], np.ravel(matrix).tolist()):
        with pytest.raises(ValidationError):
            section.model_validate({"S": wrong})


def test_a_covariance_is_carried_along_and_changes_nothing(scenario):
    theta, covariance = np.array([1.0, 2.0, 3.0]), np.diag([4.0, 5.0, 6.0])
    bias = find_effect("bias")
    flown = scenario.updated({"effects.bias": effect_section(bias, theta, covariance)})
    again = parse_scenario(flown.to_toml())
    assert again.effects.bias is not None and np.array_equal(again.effects.bias.covariance, covariance)
    without = simulate(switched_on(scenario, bias, theta))
    telemetry, truth = simulate(again)
    assert np.array_equal(telemetry.mag_B_nT, without[0].mag_B_nT)
    assert truth.effects == without[1].effects
    with pytest.raises(BadInput, match="covariance is 3 x 3"):
        scenario.updated({"effects.bias": effect_section(bias, theta, covariance[:2])})


def test_an_effect_with_nothing_to_act_on_is_left_out_with_a_word(scenario):
    flown = scenario.updated(
        {"sun_sensor": None, "effects.sun_sensor_head_misalignment": {"head": 1, "turn_deg": [0.1, 0.0, 0.0]}}
    )
    with pytest.warns(UserWarning, match="effects.sun_sensor_head_misalignment is left out: .* no column"):
        telemetry, _ = simulate(flown)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(telemetry.q_NB, simulate(scenario.updated({"sun_sensor": None}))[0].q_NB)


def test_effects_move_no_stream(scenario):
    """With noise everywhere: a drawn effect changes readings only, and two draws are those of each alone."""
    noisy = scenario.updated(
        {"magnetometer.noise_nT": 20.0, "attitude.reference": {"sigma_deg": 0.1, "tau_s": 60.0}, "gyro": {}}
    )
    walk, extra = {"rate_nT_per_sqrt_s": 1.0}, {"rms_nT": 30.0}
    none = simulate(noisy)[0]
    one = simulate(noisy.updated({"effects.bias_random_walk": walk}))[0]
    other = simulate(noisy.updated({"effects.excess_noise": extra}))[0]
    both = simulate(noisy.updated({"effects.bias_random_walk": walk, "effects.excess_noise": extra}))[0]
    assert np.array_equal(none.q_NB, both.q_NB)
    assert np.array_equal(none.rate_B_rad_s, both.rate_B_rad_s)
    sum_of_both = one.mag_B_nT + other.mag_B_nT - none.mag_B_nT
    assert np.abs(both.mag_B_nT - sum_of_both).max() < 1e-9
    assert np.abs(one.mag_B_nT - none.mag_B_nT).max() > 10.0


def test_several_effects_of_all_stages_at_once_are_predicted(scenario, close):
    """Two attitude effects, whose turns do not commute, among others."""
    flown = scenario.updated(
        {
            "effects.along_track_error": {"ahead_km": 7.0},
            "effects.ring_current": {"external_nT": -80.0, "decay_h": 7.7},
            "effects.horizon_scanner_bias": {"roll_sin_deg": 0.5, "pitch_cos2_deg": -0.4},
            "effects.yaw_drift": {"rate_deg_h": 1.0},
            "effects.sun_sensor_head_misalignment": {"head": 2, "turn_deg": [0.5, -1.0, 0.3]},
            "effects.battery_current": {"s_nT_per_A": [10.0, 0.0, -5.0]},
            "effects.bias": {"b_nT": [100.0, 50.0, -20.0]},
        }
    )
    telemetry, _ = simulate(flown)
    predicted = predicting(scenario, telemetry).reading_nT(active_effects(flown))
    # Latitude for the scanner's error is that of the reported position: 7 km are 0.0011 rad, times 0.015 rad of error
    # and 45,000 nT that is 0.7 nT.
    close(predicted, telemetry.mag_B_nT, atol=0.7, unit="nT", because="second order of position and attitude errors")


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"attitude": {"mode": "tumble", "rate_deg_s": [0.2, -0.1, 0.3]}},
        {"attitude": {"mode": "spin", "spin_rate_rpm": 2.0, "nutation_deg": 1.0}},
        {"attitude": {"mode": "inertial_hold"}},
        {"attitude": {"mode": "slews", "waypoints": [{"after_s": 0.0}, {"after_s": 900.0, "yaw_deg": 30.0}]}},
    ],
    ids=lambda changes: changes.get("attitude", {}).get("mode", "earth_pointing"),
)
def test_sampled_one_step_late_is_the_next_row(scenario, changes, close):
    """Ten seconds late at one reading every ten seconds: the same readings, one row up."""
    inertia = [[10.0, 0, 0], [0, 10.0, 0], [0, 0, 15.0]]
    plain = scenario.updated({"torquers": None, "spacecraft.inertia_kg_m2": inertia, **changes})
    late = plain.updated({"effects.time_tag_offset": {"offset_s": 10.0}})
    one, other = simulate(plain)[0], simulate(late)[0]
    # The tumble is integrated by steps that end at the stamps: 1e-10 rad at 45,000 nT.
    close(other.mag_B_nT[:-1], one.mag_B_nT[1:], atol=1e-5, unit="nT", because="rounding, and the tumble's integration")
    assert np.array_equal(one.q_NB, other.q_NB)
    assert np.array_equal(one.r_N_km, other.r_N_km)


def test_sampled_one_step_early_is_the_row_before_and_the_words_say_so(scenario, close):
    """The words and the sign agree: positive is later than the stamp, negative earlier."""
    plain = scenario.updated({"torquers": None})
    early = plain.updated({"effects.time_tag_offset": {"offset_s": -10.0}})
    one, other = simulate(plain)[0], simulate(early)[0]
    close(other.mag_B_nT[1:], one.mag_B_nT[:-1], atol=1e-5, unit="nT", because="rounding")
    assert find_effect("time_tag_offset").title == "The time stamps are early (+) or late (-)"


def test_under_replay_what_is_reported_stays_and_the_reading_follows(scenario, run, tmp_path, close):
    write_telemetry(run[0], tmp_path / "recorded.nc")
    (tmp_path / "replay.toml").write_text(
        'seed = 8\n[spacecraft]\nname = "test"\n[replay]\ntelemetry = "recorded.nc"\n'
        "[effects.along_track_error]\nahead_km = 20.0\n[effects.yaw_drift]\nrate_deg_h = 2.0\n"
        "[effects.time_tag_offset]\noffset_s = 1.0\n",
        encoding="utf-8",
    )
    replay = load_scenario(tmp_path / "replay.toml")
    telemetry, truth = simulate(replay)
    recorded = read_telemetry(tmp_path / "recorded.nc")
    for name in ("r_N_km", "v_N_km_s", "q_NB", "dipole_B_Am2"):
        assert np.array_equal(getattr(telemetry, name), getattr(recorded, name)), name
    chain = pose(telemetry, load_field()).chain
    close(chain.reading_nT(active_effects(replay)), telemetry.mag_B_nT, atol=1e-6, unit="nT", because="the same chain")
    assert np.abs(chain.reading_nT() - telemetry.mag_B_nT).max() > 100.0
    assert set(json.loads(truth.effects)) == {"along_track_error", "yaw_drift", "time_tag_offset"}


@pytest.mark.parametrize(
    ("section", "said"),
    [
        (
            "[effects.time_tag_ofset]\noffset_s = 1.0",
            "unknown key effects.time_tag_ofset; did you mean time_tag_offset?",
        ),
        (
            "[effects.time_tag_offset]\noffset = 1.0",
            "unknown key effects.time_tag_offset.offset; did you mean offset_s?",
        ),
        ("[effects.time_tag_offset]", "effects.time_tag_offset: give offset_s"),
        ("[effects.bias]", "effects.bias: give b_nT"),
        ("[effects.time_tag_offset]\noffset_s = 1e9", "effects.time_tag_offset.offset_s"),
        ("[effects.time_tag_offset]\noffset_s = nan", "effects.time_tag_offset.offset_s"),
        ('[effects.time_tag_offset]\noffset_s = "1"', "effects.time_tag_offset.offset_s"),
        ("[effects.bias]\nb_nT = [1.0, 2.0]", "effects.bias.b_nT"),
        ("[effects.field_truncation]\ndegree = 8.5\nshare = 1.0", "effects.field_truncation.degree"),
        ('[effects.yaw_drift]\nrate_deg_h = 1.0\nwhen = "never"', "effects.yaw_drift.when"),
        ("[efects.bias]\nb_nT = [1.0, 2.0, 3.0]", "unknown key efects; did you mean effects?"),
    ],
)
def test_faults_in_an_effects_section_are_named(section, said):
    with pytest.raises(BadInput) as caught:
        parse_scenario(DESIGN + section, where="my.toml")
    assert said in str(caught.value)
    assert "my.toml" in str(caught.value)


def test_units_become_suffixes():
    wanted = {
        "nT": "nT",
        "deg/h": "deg_h",
        "nT/(A m2)": "nT_per_Am2",
        "1/K": "per_K",
        "nT/sqrt(s)": "nT_per_sqrt_s",
        "1": "",
        "nT/K": "nT_per_K",
    }
    assert {unit: unit_suffix(unit) for unit in wanted} == wanted


@pytest.fixture(scope="module")
def replayed(scenario, run, tmp_path_factory) -> Scenario:
    """The same spacecraft along its own noise-free record."""
    path = write_telemetry(run[0], tmp_path_factory.mktemp("replay") / "recorded.nc")
    return scenario.updated({"orbit": None, "schedule": None, "replay.telemetry": str(path)})


def test_a_replay_has_every_effect(effect, replayed, chain, run, close):
    """Along a record every effect acts, and as the chain of a diagnosis predicts it; what was recorded stays."""
    theta = 0.9 * scale_of(effect)
    telemetry, _ = simulate(switched_on(replayed, effect, theta))
    for name in ("time", "r_N_km", "v_N_km_s", "q_NB", "sun_B", "dipole_B_Am2", "temperature_degC"):
        assert np.array_equal(getattr(telemetry, name), getattr(run[0], name), equal_nan=name != "time")
    assert np.abs(telemetry.mag_B_nT - chain.reading_nT()).max() > 1.0
    if isinstance(effect, SignalEffect):
        predicted = chain.reading_nT([(effect, theta)])
        close(telemetry.mag_B_nT, predicted, atol=1e-6, unit="nT", because="one chain: rounding of 5e4 nT")


@pytest.fixture(scope="module")
def beside(replayed):
    """Two perfect magnetometers, the torquers' own field apart, and what they read without any effect."""
    perfect = {"T_nT_per_Am2": np.zeros((3, 3)).tolist()}
    both = replayed.updated({"magnetometer": perfect, "magnetometer_2": {**perfect, "spacecraft_field_factor": 0.4}})
    return both, simulate(both)[0]


def test_a_second_magnetometer_sees_the_field_whole_the_spacecraft_in_part_and_the_sensor_not(effect, beside, close):
    """What every effect changes in the second reading, over what it changes in the first: 1, 0.4 or 0 by its stage."""
    both, plain = beside
    spoiled, _ = simulate(switched_on(both, effect, 0.9 * scale_of(effect)))
    share = {"spacecraft": 0.4, "sensor": 0.0, "telemetry": 0.0}.get(effect.stage, 1.0) * (
        effect.name != "boom_bending"
    )
    first, second = spoiled.mag_B_nT - plain.mag_B_nT, spoiled.mag2_B_nT - plain.mag2_B_nT
    assert np.abs(first).max() > 1.0
    close(second, share * first, atol=1e-9, unit="nT", because="rounding of sums of 5e4 nT, 7e-12 each")


def test_a_bent_boom_takes_no_other_field_from_the_second_magnetometer(beside, close):
    both, plain = beside
    bent = switched_on(both, find_effect("boom_bending"), [0.01, -0.02, 0.03])
    spoiled, _ = simulate(
        switched_on(bent, find_effect("bias_step"), [5.0, 6.0, 7.0]).updated(
            {"effects.switched_field": {"f_nT": [100.0, -50.0, 20.0], "condition": "eclipse"}}
        )
    )
    dark = np.array(plain.sunlit)[:, None] < 0.5
    wanted = plain.mag2_B_nT + 0.4 * np.array([100.0, -50.0, 20.0]) * dark
    close(spoiled.mag2_B_nT, wanted, atol=1e-9, unit="nT", because="rounding of sums of 5e4 nT, 7e-12 each")


def test_what_a_chain_remembers_changes_no_answer(scenario, run):
    """Whatever was asked before, a chain that has been used answers as a fresh one does, to the last bit."""
    used, rng = predicting(scenario, run[0]), np.random.default_rng(7)
    signals = [effect for effect in EFFECTS if isinstance(effect, SignalEffect)]
    on = []
    for _ in range(40):
        place = int(rng.integers(len(signals)))
        effect = signals[place]
        on = [pair for pair in on if pair[0] is not effect]  # moved, switched off, or switched on
        if rng.random() < 0.7:
            size = [min(max(0.1 * rng.normal() * p.scale, p.low), p.high) for p in effect.parameters]
            on = sorted([*on, (effect, np.array(size))], key=lambda pair: signals.index(pair[0]))
        assert np.array_equal(used.reading_nT(on), Chain(used.setting).reading_nT(on), equal_nan=True)
