"""The star tracker: its errors about and across the boresight, and the rows in which it sees no stars."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fluxtwin
from fluxtwin.sim.earth import frames
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.spacecraft.sensors.base import Surroundings
from fluxtwin.sim.spacecraft.sensors.star_tracker import StarTrackerSection

pytestmark = pytest.mark.reference

ROWS = 20_000
ARCSEC = np.radians(1.0 / 3600.0)
SCENARIO = """
seed = 3
[spacecraft]
name = "tracked"
[orbit]
epoch_utc = "2026-03-01T00:00:00Z"
altitude_km = 700.0
inclination_deg = 98.0
raan_deg = 20.0
argument_of_latitude_deg = 0.0
[schedule]
segments = [{ start_utc = "2026-03-01T00:00:00Z", duration_min = 100.0, step_s = 10.0 }]
[attitude.reference]
source = "star_tracker"
[star_tracker]
boresight_B = [0.0, -1.0, -1.0]
noise_arcsec = 10.0
roll_noise_arcsec = 80.0
sun_exclusion_deg = 35.0
"""


def around(R_BN: Rotation, *, sun_N: tuple[float, float, float] = (0.0, 1.0, 0.0), lit: float = 1.0) -> Surroundings:
    """A vehicle on the x axis, 7000 km out, with N of the orbit's axes left at the identity."""
    n = len(R_BN)
    return Surroundings(
        time=np.datetime64("2026-03-01", "ns") + np.arange(n) * np.timedelta64(1, "s"),
        r_N_km=np.tile([7000.0, 0.0, 0.0], (n, 1)),
        R_BN=R_BN,
        R_ON=Rotation.identity(n),
        rate_B_rad_s=np.tile([0.0, 0.0, np.radians(1.0)], (n, 1)),
        sun_N=np.tile(sun_N, (n, 1)),
        illumination=np.full(n, lit),
    )


@pytest.mark.parametrize("boresight", [(0.0, 0.0, -1.0), (3.0, 0.0, 4.0), (1.0, -1.0, 1.0)])
def test_errors_are_as_stated_about_and_across_the_boresight(
    boresight: tuple[float, float, float], close: Callable[..., None]
) -> None:
    R_BN = Rotation.random(ROWS, random_state=1)
    tracker = StarTrackerSection(boresight_B=boresight, noise_arcsec=7.0, roll_noise_arcsec=60.0)
    q = tracker.measure(around(R_BN), np.random.default_rng(2))["q_NB"]
    known = np.isfinite(q).all(axis=1)
    theta = (frames.rotation_from_q(q[known]) * R_BN[np.flatnonzero(known)].inv()).as_rotvec() / ARCSEC
    axis = np.array(boresight) / np.linalg.norm(boresight)
    about = theta @ axis
    across = theta - about[:, None] * axis
    because = "4 sigma of a standard deviation from this many draws is 2.6 %"
    close(about.std(), 60.0, atol=60.0 * 0.026, unit="arcsec", because=because)
    close(np.sqrt((across**2).sum(axis=1).mean() / 2.0), 7.0, atol=7.0 * 0.026, unit="arcsec", because=because)
    assert abs(np.corrcoef(about, across[:, 0])[0, 1]) < 0.04


def test_it_sees_no_stars_towards_earth_sun_or_in_a_fast_turn() -> None:
    """The limb stands arcsin(6378.137 / 7000) = 65.7 deg from nadir, which is -x."""
    angles = np.radians([0.0, 60.0, 85.0, 100.0, 113.5, 115.0, 180.0])
    # Body z is turned from zenith towards z of N by each angle; the sun lies on +y, 90 deg away.
    turned = Rotation.from_matrix([[[0, 1, 0], [-np.sin(a), 0, np.cos(a)], [np.cos(a), 0, np.sin(a)]] for a in angles])
    z_N = turned.inv().apply([0.0, 0.0, 1.0])
    nadir = np.degrees(np.arccos(np.clip(z_N @ [-1.0, 0.0, 0.0], -1.0, 1.0)))
    seen = StarTrackerSection(boresight_B=(0.0, 0.0, 1.0)).sees(around(turned))
    np.testing.assert_array_equal(seen, nadir > 65.67)
    assert seen.tolist() == [True, True, True, True, True, False, False]
    seen = StarTrackerSection(boresight_B=(0.0, 0.0, 1.0), earth_exclusion_deg=20.0).sees(around(turned))
    np.testing.assert_array_equal(seen, nadir > 85.67)
    up = Rotation.from_matrix([[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]])  # body z away from the Earth
    near_sun = (np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 0.0)
    tracker = StarTrackerSection(boresight_B=(0.0, 0.0, 1.0), sun_exclusion_deg=35.0)
    assert not tracker.sees(around(up, sun_N=near_sun))[0]
    assert tracker.sees(around(up, sun_N=near_sun, lit=0.0))[0], "an eclipsed sun blinds nothing"
    assert tracker.model_copy(update={"sun_exclusion_deg": 29.0}).sees(around(up, sun_N=near_sun))[0]
    # The body turns by 1 deg/s about its z: that blurs a tracker along x, not one along z.
    slow = tracker.model_copy(update={"max_rate_deg_s": 0.5})
    assert slow.sees(around(up))[0]
    assert not slow.model_copy(update={"boresight_B": (0.0, 1.0, 0.0)}).sees(around(up, sun_N=(0.0, 1.0, 0.0)))[0]


def test_a_scenario_flies_it_and_its_attitude_is_the_reference() -> None:
    scenario = parse_scenario(SCENARIO)
    telemetry, truth = fluxtwin.simulate(scenario)
    assert telemetry.q_NB is not None
    known = telemetry.has_attitude
    error = frames.rotation_from_q(telemetry.q_NB[known]) * frames.rotation_from_q(truth.q_NB[known]).inv()
    # rms of the whole turn: sqrt(80^2 + 2 x 10^2) = 81.2 arcsec; 600 rows know it to 3 %
    assert np.sqrt(np.mean(error.magnitude() ** 2)) / ARCSEC == pytest.approx(81.2, rel=0.12)  # 4 sigma
    assert 0.0 < known.mean() < 1.0, "for part of this orbit the sun stands in the way"
    assert parse_scenario(scenario.to_toml()) == scenario


def test_rows_without_sun_have_no_attitude_where_it_is_needed() -> None:
    heads = {"1": {"azimuth_deg": 0.0, "half_fov_deg": 40.0}}
    scenario = parse_scenario(SCENARIO).updated({"attitude.reference.needs_sun": True, "sun_sensor": heads})
    telemetry, _ = fluxtwin.simulate(scenario)
    assert telemetry.sun_sensor_head is not None
    seen = telemetry.sun_sensor_head > 0
    assert 0 < seen.sum() < len(seen)
    assert not telemetry.has_attitude[~seen].any() and telemetry.has_attitude[seen].any()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"attitude.reference.source": "error_model"}, "give both or neither"),
        ({"star_tracker": None}, "give both or neither"),
        ({"attitude.reference.sigma_deg": 0.1}, "leave sigma_deg and tau_s out"),
        ({"star_tracker.boresight_B": [0.0, 0.0, 0.0]}, "no such direction"),
        ({"star_tracker.noise": 1.0}, "unknown key star_tracker.noise"),
        (
            {"orbit": None, "schedule": None, "replay.telemetry": "t.nc"},
            "takes the attitude from the recorded file",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_words(change: dict[str, object], said: str) -> None:
    with pytest.raises(fluxtwin.BadInput, match=said):
        parse_scenario(SCENARIO).updated(change)
