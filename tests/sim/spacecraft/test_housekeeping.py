"""Power, temperature and wheels against balances and analytic solutions."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import sun
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.earth.orbit import Orbit, argument_of_latitude
from fluxtwin.sim.spacecraft.power import (
    Battery,
    Panel,
    array_current_A,
    battery_history,
    incidence_cosine,
)
from fluxtwin.sim.spacecraft.thermal import ThermalSection
from fluxtwin.sim.spacecraft.wheels import periodic_momentum_B_Nms, wheel_speed_rpm

pytestmark = pytest.mark.reference

START = np.datetime64("1978-09-01T00:00:00", "ns")
PERIOD_S = 6000.0
BATTERY = Battery(capacity_Ah=20.0, efficiency=0.9, taper_above=0.9)


def stamps(seconds: np.ndarray) -> np.ndarray:
    return START + np.rint(np.asarray(seconds) * 1e9).astype("int64").astype("timedelta64[ns]")


def test_a_tracking_array_sees_the_sunlit_share_of_the_orbit(close) -> None:
    """Sun in the orbital plane: the dark share is asin(Re/a)/pi, a tracking array gives full current else."""
    epoch = np.datetime64("1978-03-21T00:00:00", "ns")
    sun_N = sun.sun_direction_N(np.array([epoch]))[0]
    node = float(np.arctan2(sun_N[1], sun_N[0]))  # at the equinox a polar orbit with its node at the sun
    orbit = Orbit(epoch_utc=epoch, altitude_km=790.0, inclination_rad=0.5 * np.pi, raan_rad=node)
    time = epoch + (np.arange(0.0, orbit.nodal_period_s, 2.0) * 1e9).astype("int64").astype("timedelta64[ns]")
    r, v = orbit.propagate(time)
    lit = sun.illumination(r, sun.sun_N_km(time))
    direction = sun.sun_direction_N(time, r)
    normal = np.cross(r[0], v[0])
    current = array_current_A(direction, lit, Panel(tuple(normal), 10.0, tracks=True))
    dark = np.arcsin(EARTH_RADIUS_KM / orbit.semi_major_axis_km) / np.pi
    why = "penumbra 0.3 % of the orbit, flattening and refraction left out, sun 0.3 deg off the plane"
    close(current.mean() / 10.0, 1.0 - dark, atol=0.004, unit="of full sun", because=why)
    u = argument_of_latitude(time, r, v)
    middle = np.angle(np.mean(np.exp(1j * u[lit < 0.5])))
    close(abs(middle), np.pi, atol=0.02, unit="rad", because="the shadow lies opposite the sun")


def test_incidence_of_fixed_and_tracking_panels(close) -> None:
    angle = np.radians([0.0, 30.0, 60.0, 90.0, 120.0, 180.0])
    sun_B = np.stack([np.sin(angle), np.zeros(6), np.cos(angle)], axis=1)
    fixed = incidence_cosine(sun_B, Panel((0.0, 0.0, 2.0), 1.0))
    close(fixed, [1.0, np.sqrt(0.75), 0.5, 0.0, 0.0, 0.0], atol=1e-15, unit="1", because="cosine law, dark side 0")
    tracking = incidence_cosine(sun_B, Panel((1.0, 0.0, 0.0), 1.0, tracks=True))
    close(tracking, np.abs(np.cos(angle)), atol=1e-15, unit="1", because="sine of the angle to the axis")
    across = incidence_cosine(sun_B, Panel((0.0, 3.0, 0.0), 1.0, tracks=True))
    close(across, 1.0, atol=1e-15, unit="1", because="an axis across the sun loses nothing")
    both = sum(array_current_A(sun_B, 0.5, Panel((0, 0, side), 2.0)) for side in (1, -1))
    close(both, np.abs(np.cos(angle)), atol=1e-15, unit="A", because="half sun on two sides of 2 A")


def orbits(n: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and array current: 12 A for two thirds of each orbit, then shadow."""
    seconds = np.arange(0.0, n * PERIOD_S, step)
    return stamps(seconds), np.where(np.mod(seconds, PERIOD_S) < 4000.0, 12.0, 0.0)


def test_charge_balances_over_an_orbit_in_the_steady_state(close) -> None:
    """Charge out = efficiency x charge in, once the cycle repeats; the array has more than enough."""
    time, array = orbits(40, 10.0)
    current, state = battery_history(time, array, 5.0, BATTERY, initial_state_of_charge=0.4)
    rows = int(PERIOD_S / 10.0)
    close(state[-rows:], state[-2 * rows : -rows], atol=1e-9, unit="of the capacity", because="steady by orbit 40")
    last = current[-rows:]
    put_in, taken = last[last > 0].sum() * 10.0 / 3600.0, -last[last < 0].sum() * 10.0 / 3600.0
    close(taken, 5.0 * 2000.0 / 3600.0, atol=1e-9, unit="A h", because="the load through 2000 s of shadow")
    why = "the current at each stamp stands for the 10 s after it, though the taper bends within them"
    close(0.9 * put_in, taken, atol=0.01 * taken, unit="A h", because=why)
    assert state.max() <= 1.0
    assert last.max() < 7.0 + 1e-12, "no more than array less load"
    with pytest.raises(AssertionError):
        close(put_in, taken, atol=0.01 * taken, unit="A h", because="a battery without loss must fail")


def test_an_array_too_small_drains_the_battery_at_the_rate_of_the_books(close) -> None:
    time, array = orbits(4, 10.0)
    _, state = battery_history(time, array, 8.5, BATTERY, initial_state_of_charge=0.6)
    rows = int(PERIOD_S / 10.0)
    per_orbit = (0.9 * 3.5 * 4000.0 - 8.5 * 2000.0) / 3600.0 / 20.0
    close(np.diff(state[::rows]), per_orbit, atol=1e-12, unit="of the capacity", because="linear below the taper")


def test_state_of_charge_is_the_same_at_any_sampling(close) -> None:
    fine, coarse = orbits(3, 1.0), orbits(3, 100.0)
    a = battery_history(*fine, 5.0, BATTERY, initial_state_of_charge=0.85)[1]
    b = battery_history(*coarse, 5.0, BATTERY, initial_state_of_charge=0.85)[1]
    close(a[::100], b, atol=1e-12, unit="of the capacity", because="steps are exact")


def test_taper_against_the_differential_equation(close) -> None:
    """Charging at a 30 A surplus: limit 10 A below 0.9, then 10 A (1 - s)/0.1; midpoint rule, 0.1 s steps."""

    def slope(state: float) -> float:
        return 0.9 * min(30.0, 10.0, 10.0 * (1.0 - state) / 0.1) / 20.0 / 3600.0

    state, states = 0.85, []
    for step in range(60_000):
        if step % 1_000 == 0:
            states.append(state)
        state += 0.1 * slope(state + 0.05 * slope(state))
    seconds = 100.0 * np.arange(60)
    current, found = battery_history(stamps(seconds), np.full(60, 35.0), 5.0, BATTERY, initial_state_of_charge=0.85)
    close(found, states, atol=1e-9, unit="of the capacity", because="midpoint rule: 0.1^2 / 6 x (1.25e-3)^2")
    assert (np.diff(current) <= 0).all()
    close(current[-1], 10.0 * (1.0 - found[-1]) / 0.1, atol=1e-12, unit="A", because="on the taper")


def test_an_empty_battery_gives_nothing() -> None:
    current, state = battery_history(
        stamps(np.arange(5) * 3600.0), np.zeros(5), 15.0, BATTERY, initial_state_of_charge=1.0
    )
    np.testing.assert_allclose(state, [1.0, 0.25, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(current, [-15.0, -15.0, 0.0, 0.0, 0.0])


def node(sunlit_degC: float, time_constant_s: float, **heater: float) -> ThermalSection:
    """At -20 degC in shadow."""
    return ThermalSection(
        sunlit_degC=sunlit_degC, eclipse_degC=-20.0, time_constant_min=time_constant_s / 60.0, **heater
    )


def test_step_response_of_the_lag(close) -> None:
    seconds = np.array([0.0, 10.0, 300.0, 301.0, 1500.0, 6000.0])
    found, heater = node(30.0, 600.0).history(stamps(seconds), np.ones(6), initial_degC=-10.0)
    close(found, 30.0 - 40.0 * np.exp(-seconds / 600.0), atol=1e-12, unit="K", because="exact at any step")
    assert (heater == 0.0).all()
    slower, _ = node(30.0, 606.0).history(stamps(seconds), np.ones(6), initial_degC=-10.0)
    with pytest.raises(AssertionError):
        close(slower, found, atol=1e-3, unit="K", because="a 1 % longer time constant must fail")


def test_lag_behind_sun_and_shadow_repeats_with_the_analytic_swing(close) -> None:
    """A square wave of period P = ts + te through a lag: crest and trough of the periodic solution."""
    seconds = np.arange(0.0, 30 * PERIOD_S, 20.0)
    lit = (np.mod(seconds, PERIOD_S) < 4000.0).astype(float)
    found, _ = node(40.0, 1800.0).history(stamps(seconds), lit)
    es, ee = np.exp(-4000.0 / 1800.0), np.exp(-2000.0 / 1800.0)
    crest = 40.0 - 60.0 * (1.0 - ee) * es / (1.0 - es * ee)
    trough = -20.0 + 60.0 * (1.0 - es) * ee / (1.0 - es * ee)
    last = found[-int(PERIOD_S / 20.0) :]
    close(last.max(), crest, atol=1e-9, unit="K", because="sunset falls on a stamp")
    close(last.min(), trough, atol=1e-9, unit="K", because="sunrise falls on a stamp")


def test_thermostat_cycle_against_the_analytic_one(close) -> None:
    """Passive equilibrium -20, heater lifts it to 20; on at 4, off at 6 degC; tau 1000 s."""
    tau = 1000.0
    on_s = tau * np.log((20.0 - 4.0) / (20.0 - 6.0))
    off_s = tau * np.log((6.0 + 20.0) / (4.0 + 20.0))
    heated = node(0.0, tau, heater_on_below_degC=4.0, heater_off_above_degC=6.0, heater_rise_degC=40.0)
    cycles = 1000
    seconds = np.linspace(0.0, cycles * (on_s + off_s), 36_997, endpoint=False)
    found, heater = heated.history(stamps(seconds), np.zeros(seconds.size), initial_degC=4.0)
    close(
        heater.mean(),
        on_s / (on_s + off_s),
        atol=2e-4,
        unit="duty",
        because="37 samples a cycle, never in step with it: 1 in 37,000",
    )
    switched_on = int(np.sum(np.diff(heater) > 0))
    assert switched_on in (cycles - 1, cycles), "the first cycle begins switched on"
    assert found.min() > 4.0 - 1e-9
    assert found.max() < 6.0 + 1e-9
    # Where the samples fall must not matter: one long step holds hundreds of switches.
    jump = stamps(np.array([0.0, seconds[31_007]]))
    once, state = heated.history(jump, np.zeros(2), initial_degC=4.0)
    close(once[1], found[31_007], atol=1e-6, unit="K", because="stamps are rounded to the nanosecond")
    assert state[1] == heater[31_007]


def test_heater_stays_on_when_too_weak_and_off_when_warm() -> None:
    time = stamps(np.arange(0.0, 20_000.0, 100.0))
    weak = node(15.0, 500.0, heater_on_below_degC=4.0, heater_off_above_degC=6.0, heater_rise_degC=10.0)
    _, heater = weak.history(time, np.zeros(200), initial_degC=20.0)
    assert heater[0] == 0.0
    assert (heater[10:] == 1.0).all()
    _, heater = weak.history(time, np.ones(200))
    assert (heater == 0.0).all()


def test_wheels_hold_the_momentum_that_they_are_given(close) -> None:
    axes = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])  # a pyramid
    u = np.linspace(0.0, 2.0 * np.pi, 50)
    momentum = periodic_momentum_B_Nms(u, (0.1, 0.2, 0.05))
    speed = wheel_speed_rpm(momentum, axes, 0.01)
    unit = axes / np.sqrt(3.0)
    held = (speed * 2.0 * np.pi / 60.0 * 0.01) @ unit
    close(held, momentum, atol=1e-14, unit="N m s", because="three directions, four wheels")
    close(speed @ [1.0, -1.0, 1.0, -1.0], 0.0, atol=1e-9, unit="rpm", because="least squares: no null motion")
    biased = wheel_speed_rpm(momentum, axes, 0.01, [2000.0, -2000.0, 2000.0, -2000.0])
    close(biased - speed, [[2000.0, -2000.0, 2000.0, -2000.0]], atol=1e-9, unit="rpm", because="added")
    close(
        wheel_speed_rpm([[0.0, 1.0, 0.0]], [[0.0, 2.0, 0.0]], 0.1),
        10.0 * 30.0 / np.pi,
        atol=1e-12,
        unit="rpm",
        because="1 N m s / 0.1 kg m2 = 10 rad/s",
    )


def test_impossible_housekeeping_is_refused() -> None:
    with pytest.raises(ValueError, match=r"at least 0\.01 K under"):
        node(0.0, 600.0, heater_on_below_degC=6.0, heater_off_above_degC=4.0, heater_rise_degC=1.0)
    with pytest.raises(BadInput, match="panel normal"):
        array_current_A(np.eye(3), 1.0, Panel((0.0, 0.0, 0.0), 1.0))
