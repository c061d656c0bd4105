"""What drifts, jumps, or reaches the axes at different times, against what rows, calculus and geometry say."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import fluxtwin
from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.effects import response
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.calibration import LinearDrift, MountingStep, TurningStep
from fluxtwin.sim.effects.chain import Chain, jacobian
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError, TimeTagOffset
from fluxtwin.sim.effects.reference_attitude import AttitudeStep
from fluxtwin.sim.effects.response import AxisSkew, SensorLag
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.spacecraft_field import StrayField
from fluxtwin.sim.effects.temperature import CommonGainDrift
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer

pytestmark = pytest.mark.property

START = np.datetime64("2020-03-01T00:00:00", "ns")
STEP_S = 20.0
ROWS = 400
S = np.array([[0.02, 0.004, 0.0], [0.0, -0.01, 0.003], [0.002, 0.0, 0.03]])
B_NT = np.array([1000.0, -500.0, 200.0])
Close = Callable[..., None]


def chain(S: FloatArray = S, b_nT: FloatArray = B_NT, **columns: FloatArray) -> Chain:
    """A slowly turning body on an orbit through the shadow."""
    time = epoch.add_seconds(START, np.arange(ROWS) * STEP_S)
    r, v = Orbit(
        epoch_utc=START, altitude_km=600.0, inclination_rad=1.7, raan_rad=0.5, argument_of_latitude_rad=0.3
    ).propagate(time)
    turn = Rotation.from_rotvec(np.outer(np.arange(ROWS) * STEP_S, [5e-4, -8e-4, 3e-4]))
    motion = RecordedMotion(time, r, v, turn * frames.rotation_ON(r, v)[0])
    return Chain(Setting(time, motion, "predict", load_field("igrf14"), Magnetometer(S, b_nT), columns))


def reading(of: Chain, effect: SignalEffect, *theta: float) -> FloatArray:
    return of.reading_nT([(effect, np.array(theta))])


def test_an_axis_read_a_row_later_reads_what_the_next_row_has(close: Close) -> None:
    plain = chain(np.diag(np.diag(S)))
    skewed = reading(plain, AxisSkew(), STEP_S, 2.0 * STEP_S)
    inside = slice(10, -12)
    for axis, rows in ((0, 0), (1, 1), (2, 2)):
        later = np.roll(plain.reading_nT()[:, axis], -rows)
        close(skewed[inside, axis], later[inside], atol=0.01, unit="nT", because="the track between rows is a fit")
    assert np.abs(skewed[:-1, 1] - plain.reading_nT()[:-1, 1]).max() > 100.0
    wrong = np.roll(plain.reading_nT()[:, 1], 1)
    assert np.abs(skewed[inside, 1] - wrong[inside]).max() > 100.0


def test_where_a_record_is_given_the_model_is_asked_once_for_all_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    plain, asked = chain(), []
    late = [(TimeTagOffset(), np.array([3.0]))]
    plain.reading_nT(late)
    monkeypatch.setattr(response, "field_N_nT", lambda *given: asked.append(given) or field_N_nT(*given))
    for dt_y, dt_z in ((0.1, 0.2), (0.1, 0.3), (0.4, 0.0)):
        plain.reading_nT([*late, (AxisSkew(), np.array([dt_y, dt_z]))])
    assert len(asked) == 1 + 4  # there, and where each delay leads


def test_the_lag_of_one_axis_is_that_axis_of_the_common_lag() -> None:
    plain = chain()
    common = reading(plain, SensorLag(), 3.0)
    for axis, name in enumerate("xyz"):
        late = reading(plain, SensorLag(name), 3.0)  # type: ignore[arg-type]
        others = [other for other in range(3) if other != axis]
        np.testing.assert_array_equal(late[:, axis], common[:, axis])
        np.testing.assert_array_equal(late[:, others], plain.reading_nT()[:, others])
    assert {one.axis for one in SensorLag().alternatives(plain.setting)} == {"all", "x", "y", "z"}
    assert SensorLag("x").alternatives(plain.setting) == (SensorLag("x"),)


@pytest.mark.parametrize("ahead_km", [-20_000.0, -900.0, 40.0, 7000.0, 20_000.0])
def test_half_an_orbit_along_the_track_is_the_two_body_motion(ahead_km: float, close: Close) -> None:
    """An orbit of eccentricity 0.1 at two places, integrated numerically for the time ahead / speed."""
    plain = chain()
    r, v = np.array([[7000.0, 0.0, 100.0], [-6500.0, 2500.0, 900.0]]), np.array([[0.5, 5.2, 5.6], [-2.0, -5.0, 5.5]])
    setting = dataclasses.replace(plain.setting, direction="simulate")
    signal = dataclasses.replace(plain.signal(), setting=setting, r_reported_N_km=r, v_reported_N_km_s=v)
    moved = signal.position_reported_ahead(ahead_km)

    def pull(_: float, state: FloatArray) -> FloatArray:
        return np.concatenate([state[3:], -GM_EARTH_KM3_S2 * state[:3] / np.linalg.norm(state[:3]) ** 3])

    for row in range(2):
        end_s = ahead_km / float(np.linalg.norm(v[row]))
        state = solve_ivp(pull, (0.0, end_s), np.concatenate([r[row], v[row]]), rtol=1e-12, atol=1e-9).y[:, -1]
        close(moved.r_reported_N_km[row], state[:3], atol=1e-3, unit="km", because="the integrator's own error")
        close(moved.v_reported_N_km_s[row], state[3:], atol=1e-6, unit="km/s", because="the integrator's own error")


@pytest.mark.parametrize(
    ("effect", "first", "rate", "unit_s"), [(TimeTagOffset, 0.4, 30.0, 86400.0), (AlongTrackError, 5.0, 40.0, 3600.0)]
)
def test_a_linear_course_is_at_each_row_the_constant_of_that_moment(
    effect: type[SignalEffect], first: float, rate: float, unit_s: float, close: Close
) -> None:
    plain = chain()
    drifting = reading(plain, effect(course="linear"), first, rate)  # type: ignore[call-arg]
    for row in (0, 130, 399):
        now = first + rate * row * STEP_S / unit_s
        close(
            drifting[row],
            reading(plain, effect(), now)[row],
            atol=1e-5,
            unit="nT",
            because="rounding of 5e4 nT and its track",
        )
    assert np.abs(drifting[399] - reading(plain, effect(), first)[399]).max() > 1.0
    since = epoch.iso(plain.setting.time[130])
    close(
        reading(plain, effect(course="linear", since=since), 0.0, rate)[130],  # type: ignore[call-arg]
        plain.reading_nT()[130],
        atol=1e-6,
        unit="nT",
        because="nothing has grown at its own beginning",
    )


def test_drifts_of_the_sensor_are_equation_1_with_what_has_grown(close: Close) -> None:
    plain, days = chain(), np.arange(ROWS) * STEP_S / 86400.0
    field_B = plain.signal().field_B_nT
    b, s = np.array([900.0, -300.0, 400.0]), np.array([0.3, -0.2, 0.1])
    for row in (0, 200, 399):
        drifted = reading(plain, LinearDrift("bias"), *b)[row]
        want = np.linalg.solve(np.eye(3) + S, field_B[row] - B_NT - days[row] * b)
        close(drifted, want, atol=1e-6, unit="nT", because="rounding of 5e4 nT")
        drifted = reading(plain, LinearDrift("scale"), *s)[row]
        want = np.linalg.solve(np.eye(3) + S + days[row] * np.diag(s), field_B[row] - B_NT)
        close(drifted, want, atol=1e-6, unit="nT", because="rounding of 5e4 nT")


def test_a_common_gain_multiplies_the_bias_too(close: Close) -> None:
    warm = 10.0 + 8.0 * np.sin(np.arange(ROWS) / 60.0)
    plain = chain(temperature_degC=warm)
    found = reading(plain, CommonGainDrift(), 0.003)
    want = (1.0 + 0.003 * (warm - warm.mean()))[:, None] * plain.reading_nT()
    close(found, want, atol=1e-6, unit="nT", because="rounding of 5e4 nT")
    assert len(CommonGainDrift().alternatives(plain.setting)) == 1
    assert [one.time_constant_s for one in CommonGainDrift().alternatives(chain().setting)] == [600.0, 1500.0, 3600.0]


@pytest.mark.parametrize("effect", [AttitudeStep, MountingStep])
def test_a_quarter_turn_at_a_moment_swaps_axes_from_then_on(effect: type[TurningStep], close: Close) -> None:
    """The axes turn right-handed about z, so x has what y had, and y less what x had."""
    plain = chain(np.zeros((3, 3)))
    stepped = effect(at=epoch.iso(plain.setting.time[250]))
    x, y, z = (plain.reading_nT() + B_NT).T
    want = np.stack([y, -x, z], axis=1) - B_NT
    found = reading(plain, stepped, 0.0, 0.0, 90.0)
    close(found[:250], plain.reading_nT()[:250], atol=1e-9, unit="nT", because="rounding of 5e4 nT")
    close(found[250:], want[250:], atol=1e-6, unit="nT", because="rounding of 5e4 nT")


def test_the_image_of_what_is_modulated_is_its_own() -> None:
    """By the definition: of a step, and of a rate."""
    plain = chain()
    step = AttitudeStep(at=epoch.iso(plain.setting.time[77]))
    for effect in (step, TimeTagOffset("linear"), AlongTrackError("linear")):
        whole, share = effect.modulates(plain.setting) or pytest.fail("it has no other")
        assert isinstance(whole, SignalEffect)
        own, made = jacobian(plain, effect), jacobian(plain, whole) * share[:, None, :]
        assert np.abs(own - made).max() < 1e-4 * np.abs(own).max()
        assert np.abs(own - jacobian(plain, whole)[:, :, : own.shape[2]]).max() > 0.1 * np.abs(own).max()


def test_moments_are_moved_by_less_and_less() -> None:
    setting = chain().setting
    tried = AttitudeStep().alternatives(setting)
    rows = [int(np.flatnonzero(one.after(setting))[0]) for one in tried[3].variants(setting)]
    assert len(tried) == 7 and rows == [232, 168, 216, 184, 208, 192, 204, 196, 202, 198, 201, 199]
    assert AttitudeStep().variants(setting) == ()
    near = dataclasses.replace(tried[3], at=epoch.iso(setting.time[3]))
    assert {int(np.flatnonzero(one.after(setting))[0]) for one in near.variants(setting)} >= {
        1,
        35,
    }  # never out of the record
    assert len(near.variants(setting)) == len(rows)


def test_stray_field_follows_the_sun_in_the_body_while_it_shines(close: Close) -> None:
    plain = chain(np.zeros((3, 3)), np.zeros(3))
    setting = plain.setting
    F = np.arange(9.0).reshape(3, 3) * 20.0
    found = reading(plain, StrayField(), *F.ravel()) - plain.reading_nT()
    sun_B = setting.given[2].apply(sun.sun_direction_N(setting.time, setting.given[0]))
    lit = setting.illumination
    assert 0.1 < (lit == 0.0).mean() < 0.9
    close(found, (sun_B @ F.T) * lit[:, None], atol=1e-6, unit="nT", because="rounding of 5e4 nT")
    assert np.abs(found - (sun_B @ F) * lit[:, None]).max() > 10.0


def test_a_key_of_another_setting_is_refused() -> None:
    cubesat = fluxtwin.load_scenario("cubesat")
    with pytest.raises(BadInput, match="rate_km_h goes with another setting; with these the keys are ahead_km"):
        cubesat.updated({"effects.along_track_error": {"ahead_km": 5.0, "rate_km_h": 2.0}})
    flown = cubesat.updated({"effects.linear_drift": {"of": "scale", "S_xx_per_day": 0.01}})
    assert flown.effects.linear_drift.S_xx_per_day == 0.01  # type: ignore[attr-defined]
