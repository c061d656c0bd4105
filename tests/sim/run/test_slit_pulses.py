"""[slit_sun_sensor]: a scenario alone makes the sun pulses of a spinner."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.scenarios.st5 import mission
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.run.simulate import _merged, simulate
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.spacecraft.sensors.slit_sun_sensor import SlitSunSensor
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

SHORT = {"schedule.segments": [{"start_utc": "2006-04-15T00:00:00Z", "samples": 960, "step_s": 0.125}]}


def test_a_saved_scenario_makes_the_pulses(close) -> None:
    """Two minutes at 26 rpm are 52 turns, so 51 to 53 pulses; each sees the sun at the slit's azimuth but for noise."""
    scenario = parse_scenario(mission.scenario().updated(SHORT).to_toml())
    telemetry, truth = simulate(scenario)
    bare, _ = simulate(scenario.updated({"slit_sun_sensor": None}))
    pulse = ~telemetry.has_reading
    assert 51 <= pulse.sum() <= 53
    assert telemetry.sun_B is not None and bare.sun_B is None
    spacing_s = float(np.diff(telemetry.time[pulse]).astype(float).mean()) * 1e-9
    # Free motion: the body turns about its axis at lam = w (1 - 1.4) and that about the momentum at 1.4 w / cos 2 deg.
    turn_s = 60.0 / 26.0 / (1.0 - 1.4 + 1.4 / np.cos(np.radians(2.0)))
    because = "2 deg of nutation and 0.18 deg of noise at the two ends of 51 turns of 2.3 s"
    close(spacing_s, turn_s, atol=3e-4, unit="s", because=because)
    assert abs(turn_s - 60.0 / 26.0) > 1e-3
    assert np.array_equal(telemetry.mag_B_nT[~pulse], bare.mag_B_nT)
    assert np.array_equal(telemetry.time[~pulse], bare.time) and np.array_equal(truth.time, bare.time)
    assert np.isnan(telemetry.sun_B[~pulse]).all() and np.isnan(telemetry.q_NB[pulse]).all()
    azimuth = np.degrees(np.arctan2(telemetry.sun_B[pulse][:, 1], telemetry.sun_B[pulse][:, 0]))
    close(azimuth, 0.0, atol=1e-6, unit="deg", because="the sensor knows where its slit is; the noise is in the time")
    # Against the true attitude at the readings around: the sun turns by 156 deg/s, a slit of half a turn more is wrong.
    before = np.searchsorted(bare.time, telemetry.time[pulse]) - 1
    turn = (telemetry.time[pulse] - bare.time[before]).astype(float) * 1e-9
    R_BN = frames.rotation_from_q(truth.q_NB[before])
    world = build_world(scenario)
    sun_B = R_BN.apply(world.sun_N[before])
    late = np.arctan2(sun_B[:, 1], sun_B[:, 0]) - np.linalg.norm(truth.rate_B_rad_s[before], axis=1) * turn
    off = np.degrees(np.angle(np.exp(1j * late)))
    close(off, 0.0, atol=6.0, unit="deg", because="nutation of 2 deg moves the azimuth within a step, noise 0.18 deg")


def test_a_fast_spinner_has_a_pulse_a_turn() -> None:
    """At 120 rpm 12 s are 24 turns, so 23 to 25 pulses."""
    twelve_s = {"schedule.segments": [{"start_utc": "2006-04-15T00:00:00Z", "samples": 96, "step_s": 0.125}]}
    telemetry, _ = simulate(mission.scenario().updated(twelve_s | {"attitude.spin_rate_rpm": 120.0}))
    assert 23 <= (~telemetry.has_reading).sum() <= 25


def test_a_slit_wants_a_spinner() -> None:
    with pytest.raises(BadInput, match=r"\[slit_sun_sensor\] needs a free spin"):
        mission.scenario().updated({"attitude": {"mode": "earth_pointing"}})


def test_a_pulse_at_the_stamp_of_a_reading_is_a_row_of_its_own() -> None:
    time = np.datetime64("2020-03-01", "ns") + np.array([0, 10]) * np.timedelta64(1, "s")
    nothing = np.full((2, 3), np.nan)
    pulses = time + np.array([4, 0]) * np.timedelta64(1, "s")
    found = _merged(Telemetry(time, np.ones((2, 3))), Telemetry(pulses, nothing, sun_B=np.eye(3)[:2]))
    assert ((found.time - time[0]).astype("int64") == [0, 4 * 10**9, 10 * 10**9, 10 * 10**9 + 1]).all()


def test_the_noise_of_a_slit_moves_the_pulse_and_the_elevation_by_as_much() -> None:
    """A spin of 0.5 rad/s, the sun at an elevation of 0.4 rad: a turn of e across the slit takes e / (0.5 cos 0.4) s."""

    def sun_B(t: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(0.5 * t), np.sin(0.5 * t), np.full(t.size, np.tan(0.4))], axis=1) * np.cos(0.4)

    grid = np.arange(0.0, 25_000.0)
    found = {
        noise: SlitSunSensor(noise_deg=float(np.degrees(noise))).crossings(grid, sun_B, np.random.default_rng(1))
        for noise in (0.0, 1e-3)
    }
    late, raised = (noisy - still for noisy, still in zip(found[1e-3], found[0.0], strict=True))
    across, along = late * 0.5 * np.cos(0.4), raised[:, 2] / np.cos(0.4)
    assert len(late) > 1900 and np.std([across, along]) == pytest.approx(1e-3, rel=4.0 / np.sqrt(8000.0) * 0.99)


def test_a_slit_lies_at_its_azimuth() -> None:
    """30 deg from +x to +y; at an elevation of 60 deg half of the unit vector lies in the xy plane."""
    seen = SlitSunSensor(azimuth_deg=30.0).direction(np.array([np.pi / 3.0]))
    assert seen == pytest.approx(np.array([[0.5 * np.sqrt(0.75), 0.25, np.sqrt(0.75)]]))
