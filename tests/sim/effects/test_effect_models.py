"""Forward models of the effects against answers known by algebra, by elementary physics, or by another formula."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.late import low_pass, restarts
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.calibration import ScaleMisalignment
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Chain
from fluxtwin.sim.effects.digits import BitErrors, CoarseQuantization
from fluxtwin.sim.effects.drivers import STANDARD_SWING_K, orbital_period_s, temperature_K
from fluxtwin.sim.effects.history import FieldHistory, play
from fluxtwin.sim.effects.response import CubicNonlinearity, Hysteresis, QuadraticNonlinearity, SensorLag
from fluxtwin.sim.effects.signal import Setting, Signal
from fluxtwin.sim.effects.spacecraft_field import EddyCurrent, SolarArrayCurrent, TorquerCoupling, WheelField
from fluxtwin.sim.effects.switched_field import HeaterSwitching
from fluxtwin.sim.effects.temperature import BoomBending, ThermalScaleDrift
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer

pytestmark = pytest.mark.reference

START = np.datetime64("2020-03-01T00:00:00", "ns")
PLAIN = Magnetometer(np.zeros((3, 3)), np.zeros(3))
CROOKED = Magnetometer(
    np.array([[0.02, 0.005, -0.003], [-0.004, -0.03, 0.002], [0.001, 0.006, 0.015]]), np.array([150.0, -80.0, 40.0])
)


@dataclass(frozen=True)
class Spinner:
    """A body held over one spot of the turning Earth that spins at a constant rate, about z unless stated otherwise."""

    time: TimeArray
    rate_rad_s: float
    axis_B: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        seconds = epoch.seconds_since(self.time, START) + offset_s
        R_NE = frames.rotation_EN(epoch.add_seconds(START, seconds)).inv()
        r = R_NE.apply(np.array([4000.0, 3000.0, 5000.0]))
        v = np.cross([0.0, 0.0, 7.292e-5], r)
        spin = Rotation.from_rotvec(np.outer(-self.rate_rad_s * seconds, self.axis_B))
        return r, v, spin * R_NE.inv()


def spinning(
    seconds: FloatArray, rate_rad_s: float = 0.0, instrument: Magnetometer = PLAIN, **columns: FloatArray
) -> Chain:
    time = epoch.add_seconds(START, np.asarray(seconds, dtype=float))
    motion = Spinner(time, rate_rad_s)
    return Chain(Setting(time, motion, "predict", load_field("igrf14"), instrument, columns))


def added(chain: Chain, effect: SignalEffect, theta: Any) -> FloatArray:
    return chain.reading_nT([(effect, np.asarray(theta, dtype=float))]) - chain.reading_nT()


def drawn(chain: Chain, effect: Any, theta: float, seed: int = 7) -> tuple[FloatArray, FloatArray]:
    before = chain.signal()
    after: Signal = effect.draw(before, np.array([theta]), np.random.default_rng(seed))
    return before.reading, after.reading


def test_a_bent_boom_turns_the_sensor(close: Callable[..., None]) -> None:
    """The sensor turned by +a about z: by plane geometry x' = x cos a + y sin a, y' = y cos a - x sin a.

    The torquers' field turns with it, and the instrument's S and b act on what the turned sensor sees.
    """
    warm, dipole = np.linspace(-10.0, 30.0, 40), np.tile([3.0, -1.0, 2.0], (40, 1))
    chain = spinning(np.arange(40) * 3.0, 0.4, CROOKED, temperature_degC=warm, dipole_B_Am2=dipole)
    coupling = (TorquerCoupling(), np.array([30.0, 5.0, 0.0, -4.0, 20.0, 8.0, 1.0, 0.0, -25.0]))
    bend = BoomBending(reference_degC=-10.0)
    found = chain.reading_nT([coupling, (bend, np.array([0.0, 0.0, 0.05]))])
    straight = chain.reading_nT([coupling]) @ (np.eye(3) + CROOKED.S).T + CROOKED.b_nT
    a = np.radians(0.05 * (warm + 10.0))
    x, y, z = straight.T
    turned = np.stack([x * np.cos(a) + y * np.sin(a), y * np.cos(a) - x * np.sin(a), z], axis=1)
    expected = np.linalg.solve(np.eye(3) + CROOKED.S, (turned - CROOKED.b_nT).T).T
    close(found, expected, atol=1e-6, unit="nT", because="the same algebra, rounding of 5e4 nT")
    assert np.abs(found - chain.reading_nT([coupling])).max() > 1000.0
    for wrong in (BoomBending(reference_degC=-9.0), BoomBending()):
        assert np.abs(chain.reading_nT([coupling, (wrong, np.array([0.0, 0.0, 0.05]))]) - expected).max() > 10.0
    back = chain.reading_nT([coupling, (bend, np.array([0.0, 0.0, -0.05]))])
    assert np.abs(back - expected).max() > 1000.0


def test_a_boom_without_thermometer_lags_behind_sun_and_shadow(close: Callable[..., None]) -> None:
    """After a step of sunlight the turn comes in as 1 - exp(-t/tau) of 20 K; what it began with dies out likewise."""
    seconds, tau_s = np.arange(0.0, 4000.0, 5.0), 300.0
    sunlit = (seconds >= 1000.0).astype(float)
    chain = spinning(seconds, 0.0, sunlit=sunlit)
    bend = BoomBending(time_constant_s=tau_s, reference_degC=0.0)
    turned = chain.reading_nT([(bend, np.array([0.0, 0.0, 0.1]))])
    field = chain.reading_nT()
    angle = np.degrees(np.arctan2(field[:, 1], field[:, 0]) - np.arctan2(turned[:, 1], turned[:, 0]))
    since = seconds - 1000.0 + 2.5  # between two stamps the light is their mean: half a step earlier
    step = np.where(since > 0.0, 2.0 * (1.0 - np.exp(-since / tau_s)), 0.0)
    expected = angle[0] * np.exp(-seconds / tau_s) + step
    close(angle, expected, atol=2e-3, unit="deg", because="(step / tau)^2 / 24 of 2 deg, and the edge row itself")
    assert np.abs(angle - np.roll(expected, 20)).max() > 0.1


def test_eddy_current_of_a_steady_spin(close: Callable[..., None]) -> None:
    """In a steady field a body spinning about z at w sees dB/dt = w (By, -Bx, 0): the minus of w z x B."""
    w = 0.4
    chain = spinning(np.arange(40) * 3.0, w)
    field = chain.reading_nT()
    x, y = field[:, 0], field[:, 1]
    expected = -0.05 * w * np.stack([y, x, 0.0 * x], axis=1)  # -K dB/dt with K = diag(k, -k, 0)
    # The sine of the two-second difference of positions and R_EN is exact; what is left is the Earth's turning of
    # the frame in which the spot is held, far below.
    found = added(chain, EddyCurrent(), [0.05, -0.05, 0.0, 0.0, 0.0])
    close(found, expected, atol=0.05, unit="nT", because="the difference over 2 s of a slowly turning frame")
    assert np.abs(expected).max() > 100.0
    for mutant in (-expected, 1.01 * expected, expected[:, [1, 0, 2]]):
        assert np.abs(found - mutant).max() > 1.0
    mixed = added(chain, EddyCurrent(), [0.0, 0.0, 0.03, 0.0, 0.0])  # K_xy = K_yx: -k (dBy/dt, dBx/dt, 0)
    close(mixed, -0.03 * w * np.stack([-x, y, 0.0 * x], axis=1), atol=0.05, unit="nT", because="as above")


def test_eddy_current_has_the_derivative_of_the_reading(close: Callable[..., None]) -> None:
    """All of K against differences of a densely sampled reading, z included through K_zz = -K_xx - K_yy."""
    time = epoch.add_seconds(START, np.arange(401) * 0.05)
    motion = Spinner(time, 0.3, (0.6, 0.0, 0.8))
    chain = Chain(Setting(time, motion, "predict", load_field("igrf14"), PLAIN, {}))
    slope = np.gradient(chain.reading_nT(), 0.05, axis=0)[5:-5]
    K = np.array([[0.02, 0.01, -0.03], [0.01, -0.05, 0.04], [-0.03, 0.04, 0.03]])
    found = added(chain, EddyCurrent(), [0.02, -0.05, 0.01, -0.03, 0.04])[5:-5]
    close(
        found,
        -slope @ K,
        atol=0.2,
        unit="nT",
        because="a difference over 0.1 s of a spin of 0.3 rad/s, 4e-5 of 1500 nT/s",
    )
    assert np.abs(found).max() > 100.0


def test_low_pass_of_a_ramp_lags_by_the_time_constant(close: Callable[..., None]) -> None:
    """Steady answer to x = c t is c (t - tau); started at x it is c (t - tau + tau exp(-t/tau))."""
    rng = np.random.default_rng(5)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 9.0, 300))])
    ramp, none = 3.0 * t[:, None], np.arange(t.size) == 0
    because = "a straight line is followed exactly; rounding of 1e4"
    for tau in (0.01, 4.0, 90.0):
        found = low_pass(t, ramp, tau, none)
        close(found, 3.0 * (t - tau + tau * np.exp(-t / tau))[:, None], atol=1e-8, unit="nT", because=because)
        with_slope = low_pass(t, ramp, tau, none, np.full_like(ramp, 3.0))
        close(with_slope, 3.0 * (t - tau)[:, None], atol=1e-8, unit="nT", because=because)


def test_low_pass_starts_anew_after_a_gap(close: Callable[..., None]) -> None:
    t = np.concatenate([np.arange(50.0), 500.0 + np.arange(50.0)])
    ramp, again = 3.0 * t[:, None], restarts(t)
    assert np.flatnonzero(again).tolist() == [0, 50]
    close(low_pass(t, ramp, 20.0, again)[50], ramp[50], atol=0.0, unit="nT", because="the start in balance")


@pytest.mark.parametrize(("step_s", "tau_s"), [(1.0, 8.0), (10.0, 0.2), (10.0, 15.0)])
def test_low_pass_of_a_sinusoid_has_its_gain(step_s: float, tau_s: float, close: Callable[..., None]) -> None:
    """H = 1 / (1 + i w tau). Cubics through values and slopes follow a sinusoid to (w h)^4 / 384 of its amplitude."""
    w = 0.05
    t = np.arange(0.0, 3000.0, step_s)
    wave, slope = np.sin(w * t)[:, None], w * np.cos(w * t)[:, None]
    gain = 1.0 / (1.0 + 1j * w * tau_s)
    expected = (gain * np.exp(1j * w * t)).imag[:, None]
    late = t > 15.0 * tau_s
    found = low_pass(t, wave, tau_s, t == 0.0, slope)
    # The same bound holds for the filtered cubic; for a lag below the step the second derivative at the stamp
    # counts too, tau^2 times its error (w h)^2 w^2 / 12.
    bound = (w * step_s) ** 4 / 384.0 + tau_s**2 * w**4 * step_s**2 / 12.0 * (tau_s < step_s) + 1e-6
    close(found[late], expected[late], atol=bound, unit="", because="the error of the cubic")
    assert np.abs(found[late] - np.sin(w * (t - 1.05 * tau_s))[late, None]).max() > bound


@pytest.mark.parametrize(("w", "step_s", "tau"), [(0.05, 5.0, 6.0), (0.25, 20.0, 3.0), (0.25, 20.0, 45.0)])
def test_sensor_lag_of_a_spin_turns_and_shrinks_the_field(
    w: float, step_s: float, tau: float, close: Callable[..., None]
) -> None:
    """A field that turns about z at -w in the body is multiplied, as x + iy, by 1 / (1 - i w tau).

    Also where it turns nearly once round from stamp to stamp.
    """
    chain = spinning(np.arange(200) * step_s, w, CROOKED)
    field = chain.reading_nT() @ (np.eye(3) + CROOKED.S).T + CROOKED.b_nT
    assert np.abs(field[:, 2] - field[0, 2]).max() < 1.0
    plane = (field[:, 0] + 1j * field[:, 1]) / (1.0 - 1j * w * tau)
    expected = CROOKED.ideal_reading(np.stack([plane.real, plane.imag, field[:, 2]], axis=1))
    found = chain.reading_nT([(SensorLag(), np.array([tau]))])
    late = slice(20, None)
    close(
        found[late],
        expected[late],
        atol=0.5,
        unit="nT",
        because="(w h)^4 / 384 = 1e-5 of 26,000 nT with w h of 0.3 at most, and the rest of the start",
    )
    assert np.abs(chain.reading_nT() - expected)[late].max() > 1000.0


def test_play_is_a_closed_loop_of_its_width(close: Callable[..., None]) -> None:
    """Driven between -X and X the play operator's loop is 2 w wide and encloses 4 w (X - w)."""
    X, w = 30000.0, 2000.0
    t = np.linspace(0.0, 3.0, 30001)
    x = X * np.sin(2.0 * np.pi * t)
    y = play(x[:, None], w, x[:1])[:, 0]
    cycle = slice(10000, 20001)
    close(y[cycle.start], y[cycle.stop - 1], atol=1e-6, unit="nT", because="the loop closes")
    area = abs(trapezoid(y[cycle], x[cycle]))
    close(area / (4.0 * w * (X - w)), 1.0, atol=1e-3, unit="", because="steps of 2 pi / 10,000 near the turning points")
    close(np.abs(x - y).max(), w, atol=1e-6, unit="nT", because="half the width")


def test_hysteresis_reads_low_on_the_way_up(close: Callable[..., None]) -> None:
    chain = spinning(np.linspace(0.0, 300.0, 2001), 2.0 * np.pi / 60.0)
    x = chain.reading_nT()[:, 0]
    found = added(chain, Hysteresis(width_nT=3000.0), [80.0, 0.0, 0.0])
    close(np.abs(found).max(), 80.0, atol=1e-9, unit="nT", because="the remanence is bounded by its amplitude")
    assert np.abs(found[:, 1:]).max() == 0.0
    peak, cycle = np.abs(x).max(), slice(501, 902)  # 60 s, from 75 s on, both ends counted
    wide = added(chain, Hysteresis(width_nT=20000.0), [80.0, 0.0, 0.0])[cycle, 0]
    area = abs(trapezoid(wide, x[cycle])) / (4.0 * 80.0 * (peak - 10000.0))
    close(area, 1.0, atol=2e-3, unit="", because="400 steps around the loop of 4 a (X - w)")
    rising = np.gradient(x) > 0
    middle = (np.abs(x) < 0.5 * np.abs(x).max()) & (np.arange(x.size) > 500)
    close(found[middle & rising, 0], -80.0, atol=1e-9, unit="nT", because="far from a turning point")
    close(found[middle & ~rising, 0], 80.0, atol=1e-9, unit="nT", because="far from a turning point")


@pytest.mark.parametrize("step_s", [1.0, 12.0])
def test_hysteresis_follows_the_field_between_stamps(step_s: float, close: Callable[..., None]) -> None:
    """Of a spin of 32 s, rows of 12 s hardly ever hold a turning point of the field. The play of the same sinusoid at steps
    of 0.01 s is what they show."""
    w, half_nT = 2.0 * np.pi / 32.0, 8000.0
    chain = spinning(np.arange(0.0, 600.0 + step_s / 2, step_s), w)
    plane = chain.reading_nT()[0, :2]
    fine_s = np.arange(60_001) * 0.01
    field = np.hypot(*plane) * np.cos(np.arctan2(plane[1], plane[0]) - w * fine_s)
    y = play(field[:, None], half_nT, field[:1] - half_nT * np.sign(field[1] - field[0]))[:, 0]
    expected = 80.0 * ((y - field) / half_nT)[:: round(step_s / 0.01)]
    found = added(chain, Hysteresis(width_nT=2.0 * half_nT), [80.0, 0.0, 0.0])[:, 0]
    close(
        found,
        expected,
        atol=0.3,
        unit="nT",
        because="5e-4 of 28,000 nT over 8000 nT, of 80 nT, and the Earth's turning",
    )
    assert np.ptp(expected) > 150.0


def test_what_the_body_has_seen_is_followed_once_whatever_the_spacecraft_adds(monkeypatch: pytest.MonkeyPatch) -> None:
    chain, followed = spinning(np.arange(0.0, 600.0, 12.0), 2.0 * np.pi / 32.0), []
    plain = FieldHistory.closely
    monkeypatch.setattr(FieldHistory, "closely", lambda self, parts: followed.append(self) or plain(self, parts))
    signal = chain.signal()
    for stray_nT in (10.0, 20.0, 30.0):
        field = np.full((signal.rows, 3), stray_nT)
        Hysteresis().apply(signal.with_stray(field), np.ones(3))
    SensorLag().apply(signal, np.array([2.0]))
    assert len(followed) == 1


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (Hysteresis(width_nT=0.0), "0 nT. Wanted: more than 0 nT"),
        (Hysteresis(start="oox"), "three letters of o, r and n"),
        (
            HeaterSwitching(switches_utc=("2020-03-01T00:10:00Z", "2020-03-01T00:05:00Z")),
            "switches_utc is out of order",
        ),
        (HeaterSwitching(sequence=(0, 1)), "2 entries for 50 rows"),
    ],
)
def test_settings_that_no_effect_has(effect: SignalEffect, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        added(spinning(np.arange(50.0)), effect, np.ones(3))


def test_an_effect_that_is_not_in_the_catalogue() -> None:
    with pytest.raises(BadInput, match=r"no effect is called 'magnet'.*lists"):
        find_effect("magnet")
    with pytest.raises(BadInput, match="did you mean bias"):
        find_effect("biass")
    assert find_effect("driver.payload") == replace(find_effect("driver.x"), column="payload")
    with pytest.raises(TypeError, match="does not say its"):
        type("Nameless", (SignalEffect,), {"name": "nameless"})


def test_wheel_line_is_aliased_to_where_sampling_puts_it(close: Callable[..., None]) -> None:
    """f = 50.337 Hz sampled every 10 s shows at |f - 503 / 10 s| = 0.037 Hz (sampling theorem)."""
    seconds = np.arange(1000) * 10.0
    chain = spinning(seconds)
    found = added(chain, WheelField(frequency_Hz=50.337), [100.0, 0, 0, 0, 50.0, 0])
    spectrum = np.abs(np.fft.rfft(found[:, 0]))
    close(np.fft.rfftfreq(1000, 10.0)[np.argmax(spectrum)], 0.037, atol=1e-9, unit="Hz", because="370 whole turns")
    ellipse = (found[:, 0] / 100.0) ** 2 + (found[:, 1] / 50.0) ** 2
    close(ellipse, 1.0, atol=1e-9, unit="", because="semi-axes 100 and 50 nT")


def test_wheel_phase_is_the_integral_of_its_speed(close: Callable[..., None]) -> None:
    """A speed that grows linearly turns the dipole by 2 pi (f t + a t^2 / 2)."""
    seconds = np.cumsum(np.random.default_rng(3).uniform(0.5, 2.0, 400))
    seconds = np.round(seconds - seconds[0], 3)
    speed = np.stack([np.zeros(400), 60.0 * (3.0 + 0.01 * seconds)], axis=1)
    chain = spinning(seconds, wheel_speed_rpm=speed)
    turns = 3.0 * seconds + 0.005 * seconds**2
    found = added(chain, WheelField(wheel=2), [10.0, 0, 0, 0, 0, 7.0])
    expected = np.stack([10 * np.cos(2 * np.pi * turns), 0 * turns, 7 * np.sin(2 * np.pi * turns)], axis=1)
    close(found, expected, atol=1e-6, unit="nT", because="trapezoids are exact for a linear speed")


def test_instrument_effects_are_the_instruments_own_parameters(close: Callable[..., None]) -> None:
    """S, T and a warm S against a magnetometer that is built with them."""
    rng = np.random.default_rng(2)
    dipole = rng.uniform(-50.0, 50.0, (60, 3))
    temperature = np.linspace(-20.0, 30.0, 60)
    chain = spinning(np.arange(60) * 20.0, 0.02, CROOKED, dipole_B_Am2=dipole, temperature_degC=temperature)
    field = chain.signal().field_B_nT
    because = "the same linear algebra in another order"
    dS = rng.normal(0.0, 0.02, (3, 3))
    other = Magnetometer(CROOKED.S + dS, CROOKED.b_nT).ideal_reading(field)
    close(chain.reading_nT([(ScaleMisalignment(), dS.ravel())]), other, atol=1e-7, unit="nT", because=because)
    C = rng.normal(0.0, 2.0, (3, 3))
    other = Magnetometer(CROOKED.S, CROOKED.b_nT, -C).ideal_reading(field, dipole)
    close(chain.reading_nT([(TorquerCoupling(), C.ravel())]), other, atol=1e-7, unit="nT", because=because)
    k = np.array([2e-4, -1e-4, 5e-5])
    warm = chain.reading_nT([(ThermalScaleDrift(reference_degC=10.0), k)])
    for row in (0, 35, 59):
        S = CROOKED.S + np.diag(k * (temperature[row] - 10.0))
        other = Magnetometer(S, CROOKED.b_nT).ideal_reading(field[row])
        close(warm[row], other[0], atol=1e-7, unit="nT", because=because)


def test_temperature_without_a_column_is_the_periodic_answer_to_a_square_wave(close: Callable[..., None]) -> None:
    """In sun for a, in shadow for b: T(end of shadow) = D e^(-b/tau) (1 - e^(-a/tau)) / (1 - e^(-(a+b)/tau))."""
    period = orbital_period_s(spinning(np.arange(10.0)).setting)
    seconds = np.arange(0.0, 3.0 * period, 2.0)
    sunlit = (np.mod(seconds, period) < 0.64 * period).astype(float)
    a, b, tau = 0.64 * period, 0.36 * period, 1200.0
    low = np.exp(-b / tau) * (1.0 - np.exp(-a / tau)) / (1.0 - np.exp(-(a + b) / tau))
    found = temperature_K(spinning(seconds, sunlit=sunlit).setting, tau)
    ends = np.flatnonzero(np.diff(sunlit) > 0)
    assert ends.size >= 2
    because = "an edge is known to a sampling interval, 2 s of 1200 s, of 20 K"
    close(found[ends], STANDARD_SWING_K * low, atol=0.04, unit="K", because=because)
    close(found[0], STANDARD_SWING_K * low, atol=0.04, unit="K", because="the record starts where an orbit ends")


def test_temperature_without_a_column_starts_from_the_mean_where_a_gap_follows_the_first_row() -> None:
    """One row shows no orbit: the lag starts from the mean of sun and shadow, 0.75 of the swing."""
    period = orbital_period_s(spinning(np.arange(10.0)).setting)
    seconds = np.concatenate([[0.0], 2.0 * period + np.array([0.0, 10.0, 20.0])])
    found = temperature_K(spinning(seconds, sunlit=np.array([0.0, 1.0, 1.0, 1.0])).setting, 60.0)
    assert found[0] == 0.75 * STANDARD_SWING_K and (np.diff(found[1:]) > 0.0).all()


def test_array_current_without_a_column_follows_the_cosine(close: Callable[..., None]) -> None:
    chain = spinning(np.arange(200) * 30.0, 0.01, sunlit=np.repeat([1.0, 0.0], 100))
    setting = chain.setting
    sun_B = setting.given[2].apply(setting.sun_N)
    expected = np.where(np.arange(200) < 100, np.maximum(-sun_B[:, 2], 0.0), 0.0)
    found = added(chain, SolarArrayCurrent(), [0.0, 30.0, 0.0])
    close(found[:, 1], 30.0 * expected, atol=1e-9, unit="nT", because="a panel on the -z face")
    tracked = added(chain, SolarArrayCurrent("tracking"), [0.0, 30.0, 0.0])[:100, 1]
    close(tracked, 30.0 * np.sqrt(1.0 - sun_B[:100, 1] ** 2), atol=1e-9, unit="nT", because="sine to the axis y")


def test_quantization_is_rounding(close: Callable[..., None]) -> None:
    chain = spinning(np.arange(3000) * 1.0, 0.05)
    before, after = drawn(chain, CoarseQuantization(), 300.0)
    close(np.mod(after / 300.0 + 0.5, 1.0), 0.5, atol=1e-9, unit="LSB", because="whole steps")
    error = after - before
    assert np.abs(error).max() <= 150.0 + 1e-9
    spread = float(error[:, :2].std())
    # 3000 x 2 errors spread evenly: their rms is known to 0.6 %; neighbours hop some 100 steps, so they are independent.
    close(spread, 300.0 / np.sqrt(12.0), atol=0.03 * 86.6, unit="nT", because="LSB / sqrt(12), Widrow & Kollar 2008")


def test_a_finer_step_than_the_declared_changes_nothing() -> None:
    chain = spinning(np.arange(50) * 10.0, 0.05, Magnetometer(np.zeros((3, 3)), np.zeros(3), lsb_nT=100.0))
    before, after = drawn(chain, CoarseQuantization(), 50.0)
    assert (before == after).all()


def test_flipped_bits_are_powers_of_two_of_the_lsb(close: Callable[..., None]) -> None:
    instrument = Magnetometer(np.zeros((3, 3)), np.zeros(3), lsb_nT=440.0)
    chain = spinning(np.arange(4000) * 1.0, 0.05, instrument)
    _, after = drawn(chain, BitErrors(), 0.2)
    steps = np.rint((after - chain.reading_nT()) / 440.0).astype(int)
    hit = steps != 0
    size = np.log2(np.abs(steps[hit]))
    assert (size == np.rint(size)).all()
    assert set(size.astype(int).tolist()) == set(range(8))  # 26,000 nT / 440 nT needs 6 bits; y, z decide: 7 and a sign
    # 12,000 components: 4 sigma of a binomial, missed by chance in 6e-5 of the runs.
    close(hit.mean(), 0.2, atol=4.0 * np.sqrt(0.2 * 0.8 / 12000), unit="", because="the rate")
    _, third = drawn(chain, BitErrors(bit=3), 1.0)
    close(np.abs(third - chain.reading_nT()), 8 * 440.0, atol=1e-6, unit="nT", because="bit 3 is 8 LSB")


def test_stuck_bits_are_stuck() -> None:
    chain = spinning(np.arange(500) * 1.0, 0.05, Magnetometer(np.zeros((3, 3)), np.zeros(3), lsb_nT=0.7))
    rounded = chain.signal().with_reading(0.7 * np.rint(chain.reading_nT() / 0.7))
    for effect, bit in ((BitErrors(4, "stuck_0"), 0), (BitErrors(4, "stuck_1"), 1)):
        stuck = effect.draw(rounded, np.array([1.0]), np.random.default_rng(1)).reading
        code = np.rint(stuck / 0.7).astype(int)
        assert ((code >> 4) & 1 == bit).all()
        change = np.rint((stuck - rounded.reading) / 0.7)
        assert set(np.unique(change).tolist()) == {0.0, 16.0 if bit else -16.0}


def test_a_lag_of_two_rows_is_that_of_more(close: Callable[..., None]) -> None:
    """A filter does not know how many rows will follow."""
    lag = [(SensorLag(), np.array([3.0]))]
    two, more = (spinning(np.arange(rows) * 5.0, 0.05, CROOKED).reading_nT(lag)[:2] for rows in (2, 50))
    close(two, more, atol=1e-6, unit="nT", because="the same field, which turns steadily")


def test_sensor_lag_smooths_a_torquer_edge(close: Callable[..., None]) -> None:
    """A dipole that comes on between two rows, h apart, is followed as a ramp and then an exponential."""
    h, tau = 2.0, 6.0
    dipole = np.zeros((60, 3))
    dipole[30:, 1] = 50.0
    instrument = Magnetometer(np.zeros((3, 3)), np.zeros(3), -3.0 * np.eye(3))
    chain = spinning(np.arange(60) * h, 0.0, instrument, dipole_B_Am2=dipole)
    found = chain.reading_nT([(SensorLag(), np.array([tau]))])[:, 1] - chain.signal().field_B_nT[:, 1]
    after = np.arange(30) * h
    # Ramp answer at its end: 150 (1 - tau/h (1 - e^(-h/tau))); the rest decays.
    missing = 150.0 * tau / h * (1.0 - np.exp(-h / tau)) * np.exp(-after / tau)
    close(found[:30], 0.0, atol=0.1, unit="nT", because="the field of the turning Earth over a spot moves by its own")
    close(found[30:], 150.0 - missing, atol=0.1, unit="nT", because="as above")


def test_nonlinearity_is_given_at_50_000_nT(close: Callable[..., None]) -> None:
    """At B = (50,000, 25,000, -100,000) nT the products xy and xyz are 0.5 and -1, and xzz is 4."""
    signal = spinning(np.arange(2.0)).signal()
    signal = signal.with_reading(np.tile([50000.0, 25000.0, -100000.0], (2, 1)))
    names = [parameter.name for parameter in QuadraticNonlinearity().parameters]
    for name, product in (("q_x_xy", 0.5), ("q_y_zz", 4.0), ("q_z_yz", -1.0)):
        theta = np.array([10.0 * (name == other) for other in names])
        change = QuadraticNonlinearity().apply(signal, theta).reading - signal.reading
        expected = np.array([10.0 * product * (axis == name[2]) for axis in "xyz"])
        close(change, expected, atol=1e-9, unit="nT", because="by hand")
    names = [parameter.name for parameter in CubicNonlinearity().parameters]
    for name, product in (("c_x_xyz", -1.0), ("c_z_xzz", 4.0), ("c_y_yyy", 0.125)):
        theta = np.array([10.0 * (name == other) for other in names])
        change = CubicNonlinearity().apply(signal, theta).reading - signal.reading
        expected = np.array([10.0 * product * (axis == name[2]) for axis in "xyz"])
        close(change, expected, atol=1e-9, unit="nT", because="by hand")


def test_what_a_field_follows_is_worked_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until so much else was asked for that there is no room for it."""
    asked, values = [], SolarArrayCurrent.values
    monkeypatch.setattr(SolarArrayCurrent, "values", lambda self, setting: asked.append(self) or values(self, setting))
    chain = spinning(np.arange(60_000.0))
    for size in (10.0, 20.0):
        for panel in ("constant", "cosine"):
            chain.reading_nT([(SolarArrayCurrent(panel), np.full(3, size))])
    assert [one.panel for one in asked] == ["constant", "cosine"]
    chain.setting.once("something else", lambda: None)
    chain.reading_nT([(SolarArrayCurrent("constant"), np.full(3, 30.0))])
    assert [one.panel for one in asked] == ["constant", "cosine", "constant"]
