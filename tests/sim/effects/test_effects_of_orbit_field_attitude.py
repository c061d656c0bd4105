"""Effects on orbit, field and attitude against answers that do not come from them."""

from __future__ import annotations

import dataclasses
from datetime import datetime, timedelta

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.earth import epoch, field_external, frames, sun
from fluxtwin.sim.earth.field import field_beyond_E_nT, field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.effects.ambient_field import FieldEpoch, FieldTruncation, RingCurrent, unit_storm_E
from fluxtwin.sim.effects.chain import Chain
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError
from fluxtwin.sim.effects.reference_attitude import (
    AttitudeLag,
    HorizonScannerBias,
    SunSensorHeadMisalignment,
    YawDrift,
    seconds_in_eclipse,
)
from fluxtwin.sim.effects.signal import Setting, _along_orbit
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer

pytestmark = pytest.mark.reference

START = np.datetime64("2022-05-10T00:00:00", "ns")
PLAIN = Magnetometer(np.zeros((3, 3)), np.zeros(3))
ORBIT = Orbit(
    epoch_utc=START, altitude_km=650.0, inclination_rad=np.radians(97.9), raan_rad=1.0, argument_of_latitude_rad=0.3
)


def setting_at(seconds, *, model=None, direction="simulate", columns=None, start=START, R_BO=None) -> Setting:
    time = epoch.add_seconds(start, np.asarray(seconds, dtype=float))
    r, v = ORBIT.propagate(time)
    R_BN = frames.rotation_ON(r, v)
    motion = RecordedMotion(time, r, v, R_BN if R_BO is None else R_BO * R_BN)
    return Setting(time, motion, direction, model or load_field(), PLAIN, columns or {})


def standing_at(r_E_km, time=START, model=None) -> Setting:
    """A body at rest on the turning Earth, its axes those of GCRS; the velocity is of no consequence here."""
    stamps = np.full(len(r_E_km), time, dtype="datetime64[ns]") + np.arange(len(r_E_km)) * np.timedelta64(1, "ns")
    r = frames.rotation_EN(stamps).inv().apply(r_E_km)
    motion = RecordedMotion(stamps, r, np.cross([0.1, 0.2, 0.3], r), Rotation.identity(len(r)))
    return Setting(stamps, motion, "predict", model or load_field(), PLAIN)


def change_E(setting, effect, theta):
    """What the effect adds to the reading, Earth-fixed; the body axes are those of GCRS."""
    chain = Chain(setting)
    return setting.R_EN.apply(chain.reading_nT([(effect, np.atleast_1d(theta))]) - chain.reading_nT())


def places(count=200, seed=4):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((count, 3))
    return u / np.linalg.norm(u, axis=1)[:, None] * rng.uniform(6571.2, 7871.2, count)[:, None]


def test_along_track_error_of_one_second_is_the_orbit_one_second_later(close):
    """At 650 km the spacecraft does 7.53 km/s: so far ahead is one second along the orbit."""
    seconds = np.arange(0.0, 6000.0, 60.0)
    setting = setting_at(seconds)
    speed = np.linalg.norm(setting.given[1], axis=1).mean()
    assert 7.5 < speed < 7.56
    reported = Chain(setting).simulated([(AlongTrackError(), np.array([speed]))], seed=0)
    r, v = ORBIT.propagate(epoch.add_seconds(START, seconds + 1.0))
    # In GCRS the orbit's plane turns by 1 deg a day: 0.0014 km a second; J2 changes radius and speed by 0.01 km/s.
    close(reported.r_reported_N_km, r, atol=0.02, unit="km", because="J2 in one second")
    close(reported.v_reported_N_km_s, v, atol=2e-4, unit="km/s", because="J2 in one second, 1e-5 km/s2")
    assert reported.r_N_km is setting.given[0]
    assert reported.R_reported_BN is setting.given[2]
    for mutant in (-speed, 1.01 * speed):
        wrong = Chain(setting).simulated([(AlongTrackError(), np.array([mutant]))], seed=0)
        with pytest.raises(AssertionError):
            close(wrong.r_reported_N_km, r, atol=0.02, unit="km", because="mutant")


def test_along_track_error_follows_an_eccentric_orbit(close):
    """90 km ahead on 600 by 1200 km: where the orbit is after the time that takes, its radius included."""
    eccentric = dataclasses.replace(ORBIT, altitude_km=900.0, eccentricity=0.041)
    seconds = np.arange(0.0, 6000.0, 60.0)
    r, v = eccentric.propagate(epoch.add_seconds(START, seconds))
    later = 90.0 / np.linalg.norm(v, axis=1)
    wanted, _ = eccentric.propagate(epoch.add_seconds(START, seconds + later))
    moved, _ = _along_orbit(r, v, np.array(90.0))
    close(moved, wanted, atol=0.02, unit="km", because="J2 in twelve seconds")
    with pytest.raises(AssertionError):
        close(_along_orbit(r, v, np.array(-90.0))[0], wanted, atol=0.02, unit="km", because="mutant")


def test_along_track_error_leaves_the_reading_of_the_true_place(close):
    """Predicting from the reported orbit with the same error gives the field of the true one."""
    seconds = np.arange(0.0, 6000.0, 60.0)
    setting = setting_at(seconds)
    flown = Chain(setting).simulated([(AlongTrackError(), np.array([7.5]))], seed=0)
    motion = RecordedMotion(setting.time, flown.r_reported_N_km, flown.v_reported_N_km_s, flown.R_reported_BN)
    chain = Chain(Setting(setting.time, motion, "predict", setting.model, PLAIN))
    close(
        chain.reading_nT([(AlongTrackError(), np.array([7.5]))]),
        flown.reading,
        atol=1e-6,
        unit="nT",
        because="there and back by a series that ends with the fourth power of 1e-3 rad: a millimetre and less",
    )
    # Stolle et al. and others give 20-90 nT for a second of low orbit.
    off = np.linalg.norm(chain.reading_nT() - flown.reading, axis=1)
    assert 20 < np.sqrt(np.mean(off**2)) < 90


@pytest.mark.parametrize("years", [1.0, -3.0])
def test_field_epoch_is_the_difference_of_two_epochs_of_ppigrf(years, close):
    import ppigrf

    r_E_km = places()
    latitude, longitude, radius = frames.geocentric(r_E_km)

    def theirs(when):
        up, south, east = ppigrf.igrf_gc(radius, 90 - np.degrees(latitude), np.degrees(longitude), when)
        return frames.rotation_NEC_E(r_E_km).inv().apply(np.stack([-south[0], east[0], -up[0]], axis=1))

    when = datetime(2022, 5, 10)
    expected = theirs(when + timedelta(days=365.25 * years)) - theirs(when)
    found = change_E(standing_at(r_E_km), FieldEpoch(), years)
    close(found, expected, atol=1e-5, unit="nT", because="both exact; 200 ns of stamps and 1e-11 nT of rounding")
    assert np.abs(expected).max() > 50
    for mutant in (-found, 1.01 * found):
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=1e-5, unit="nT", because="mutant")


def test_field_beyond_the_last_knot_goes_on_in_a_straight_line(close):
    model, r_E_km = load_field(), places(5)
    knots = [np.datetime64("2025-01-01", "ns"), model.valid_to]
    early, late = (field_beyond_E_nT(model, np.repeat(knot, 5), r_E_km) for knot in knots)
    beyond = field_beyond_E_nT(model, np.repeat(knots[1] + (knots[1] - knots[0]), 5), r_E_km)
    close(beyond, 2 * late - early, atol=1e-6, unit="nT", because="IGRF is linear from 2025 to 2030")
    assert np.abs(late - early).max() > 100


@pytest.mark.parametrize("degree", [4, 8, 12])
def test_truncated_truth_is_the_truncated_model(degree, close):
    setting = setting_at(np.arange(0.0, 6000.0, 60.0), direction="predict")
    with_effect = Chain(setting).reading_nT([(FieldTruncation(degree), np.array([1.0]))])
    poorer = Chain(dataclasses.replace(setting, model=load_field(degree=degree))).reading_nT()
    close(with_effect, poorer, atol=1e-8, unit="nT", because="the same sum in two parts")
    with pytest.raises(AssertionError):
        close(Chain(setting).reading_nT(), poorer, atol=1e-8, unit="nT", because="mutant: no truncation")


def test_richer_truth_is_the_whole_model_and_half_a_share_is_half(close):
    setting = setting_at(np.arange(0.0, 6000.0, 60.0), model=load_field(degree=8), direction="predict")
    chain, richer = Chain(setting), FieldTruncation(8, "richer")
    whole = Chain(dataclasses.replace(setting, model=load_field())).reading_nT()
    close(
        chain.reading_nT([(richer, np.array([1.0]))]), whole, atol=1e-8, unit="nT", because="the same sum in two parts"
    )
    half = 0.5 * (whole + chain.reading_nT())
    close(chain.reading_nT([(richer, np.array([0.5]))]), half, atol=1e-8, unit="nT", because="linear")
    assert richer in FieldTruncation().alternatives(setting)
    assert {e.degree for e in FieldTruncation().alternatives(setting)} == {4, 5, 6, 7, 8}
    full = dataclasses.replace(setting, model=load_field())
    assert [e.degree for e in FieldTruncation().alternatives(full)] == list(range(4, 13))


def test_ring_current_is_a_uniform_field_and_the_dipole_it_induces(close):
    """By hand, along the dipole axis: at the equator of the ground the external field and 0.27 of it add up, above the
    pole they oppose, and far out the external field is left alone and uniform."""
    z = np.array([0.0, 0.0, 1.0])
    a = 6371.2
    equator, pole = np.array([[a, 0.0, 0.0], [0.0, -a, 0.0]]), np.array([[0.0, 0.0, a], [0.0, 0.0, -a]])
    close(unit_storm_E(z, equator), 1.27 * z, atol=1e-12, unit="nT", because="1 + 0.27")
    close(unit_storm_E(z, pole), (1 - 2 * 0.27) * z, atol=1e-12, unit="nT", because="1 - 2 x 0.27")
    close(unit_storm_E(z, 1e4 * places(20)), z, atol=1e-12, unit="nT", because="the induced part falls with the cube")


def test_ring_current_along_the_dipole_of_the_model(close):
    """IGRF-14 for 2020 has g10 = -29403.41, g11 = -1451.37, h11 = 4653.35 nT: the pole lies at 80.59 N, 72.68 W.

    A field of -100 nT along it, written out here from those three numbers, and its induced dipole as -grad of
    0.27 E a (a/r)^2 cos(colatitude) from differences.
    """
    time = np.datetime64("2020-01-01T00:00:00", "ns")
    latitude, longitude = np.radians([80.59, -72.68])
    axis = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    r_E_km = places(50)

    def potential(r):
        return 0.27 * 100.0 * 6371.2**3 * (r @ axis) / np.linalg.norm(r, axis=1) ** 3

    steps = 0.5 * np.eye(3)
    induced = -np.stack([potential(r_E_km + step) - potential(r_E_km - step) for step in steps], axis=1)
    found = change_E(standing_at(r_E_km, time), RingCurrent(), -100.0)
    # The external field -100 axis is that of V = +100 r.axis; the induced one starts with 0.27 of this V at r = a.
    expected = -100.0 * axis + induced
    close(found, expected, atol=0.02, unit="nT", because="pole rounded to 0.005 deg (0.01 nT), differences over 1 km")
    for mutant in (-found, 1.01 * found, found[:, [1, 0, 2]]):
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=0.02, unit="nT", because="mutant")


def test_ring_current_is_the_symmetric_ring_current_of_chaos(close):
    """The magnetospheric field of CHAOS with q10 = -RC alone, and 0.27 RC induced, in solar magnetic coordinates."""
    model = load_field()
    dipole = model.coefficients_nT(START)[0, :3]
    edges = np.array(["2022-01-01", "2023-01-01"], dtype="datetime64[ns]")
    storm = field_external.MagnetosphericModel(
        "RC", dipole, np.zeros(5), np.zeros(2), (-1.0, 0.0, 0.0), (edges, edges), (np.zeros(1), np.zeros((1, 2)))
    )
    r_E_km = places(50)
    setting = standing_at(r_E_km)
    rc = np.full(50, -60.0)
    expected = field_external.magnetospheric_field_E_nT(storm, setting.time, r_E_km, rc, 0.27 * rc)
    close(
        change_E(setting, RingCurrent(), -60.0), expected, atol=1e-6, unit="nT", because="the same field, other algebra"
    )


def test_ring_current_decays_by_e_in_its_time(close):
    setting = setting_at([0.0, 3600.0, 7.7 * 3600.0], direction="predict")
    chain = Chain(setting)
    steady, decaying = (
        chain.reading_nT([(RingCurrent(hours), np.array([-50.0]))]) - chain.reading_nT() for hours in (0.0, 7.7)
    )
    share = np.exp([0.0, -1.0 / 7.7, -1.0])[:, None]
    close(decaying, steady * share, atol=1e-7, unit="nT", because="rounding of 5e4 nT")


def reported_angles_deg(setting, effect, theta):
    """Reported less true yaw, roll and pitch, the 3-1-2 set."""
    signal = Chain(setting).simulated([(effect, np.asarray(theta, dtype=float))], seed=0)
    pairs = [frames.yaw_roll_pitch(R * setting.R_ON.inv()) for R in (signal.R_reported_BN, signal.R_BN)]
    assert signal.R_BN is setting.given[2]
    return np.degrees(np.array(pairs[0]) - np.array(pairs[1]))


@pytest.mark.parametrize("lean_rad", [0.0, 0.4])
def test_horizon_scanner_bias_makes_reported_roll_and_pitch_too_large(lean_rad, close):
    """Angles add in the 3-1-2 set, however far the body leans."""
    setting = setting_at(np.arange(0.0, 6000.0, 30.0), R_BO=Rotation.from_rotvec([lean_rad, -lean_rad, -0.5]))
    latitude = np.arcsin(setting.R_EN.apply(setting.given[0])[:, 2] / np.linalg.norm(setting.given[0], axis=1))
    yaw, roll, pitch = reported_angles_deg(setting, HorizonScannerBias(), [0.1, 0.05, -0.2, 0.3])
    because = "exact turns about the roll axis, then about pitch"
    close(roll, 0.1 * np.sin(latitude) + 0.05 * np.cos(2 * latitude), atol=1e-9, unit="deg", because=because)
    close(pitch, -0.2 * np.sin(latitude) + 0.3 * np.cos(2 * latitude), atol=1e-9, unit="deg", because=because)
    close(yaw, 0.0, atol=1e-9, unit="deg", because=because)
    assert np.abs(roll).max() > 0.05


@pytest.mark.parametrize("lean_rad", [0.0, 0.4])
def test_yaw_drift_makes_reported_yaw_grow(lean_rad, close):
    """Angles add in the 3-1-2 set, however far the body leans."""
    setting = setting_at(np.arange(0.0, 7201.0, 30.0), R_BO=Rotation.from_rotvec([lean_rad, -lean_rad, -0.5]))
    yaw, roll, pitch = reported_angles_deg(setting, YawDrift(), [2.0])
    close(yaw, 2.0 * setting.seconds / 3600.0, atol=1e-9, unit="deg", because="an exact turn about nadir")
    close(np.stack([roll, pitch]), 0.0, atol=1e-9, unit="deg", because="an exact turn about nadir")


def test_yaw_drift_about_body_z_turns_the_attitude_about_body_z(close):
    setting = setting_at(np.arange(0.0, 7201.0, 30.0), R_BO=Rotation.from_rotvec([0.4, -0.4, -0.5]))
    signal = Chain(setting).simulated([(YawDrift(axis="body_z"), np.array([2.0]))], seed=0)
    turned = np.degrees((signal.R_reported_BN * signal.R_BN.inv()).as_rotvec())
    expected = np.outer(-2.0 * setting.seconds / 3600.0, [0.0, 0.0, 1.0])
    close(turned, expected, atol=1e-9, unit="deg", because="exact; vectors turn against the axes")
    _, roll, pitch = reported_angles_deg(setting, YawDrift(axis="body_z"), [2.0])
    assert np.abs(roll).max() > 0.5
    assert np.abs(pitch).max() > 0.5


@pytest.mark.parametrize(
    ("effect", "theta"),
    [
        (YawDrift(axis="nadir"), [20.0]),
        (YawDrift(axis="body_z"), [20.0]),
        (HorizonScannerBias(), [1.5, -2.0, 3.0, 1.0]),
    ],
)
def test_an_error_of_the_reported_angles_predicts_what_it_simulates(effect, theta, close):
    """From the reported attitude back to the true one."""
    setting = setting_at(np.arange(0.0, 7201.0, 30.0), R_BO=Rotation.from_rotvec([0.4, -0.4, -0.5]))
    signal = Chain(setting).simulated([(effect, np.array(theta))], seed=0)
    reported = setting_at(setting.seconds, R_BO=signal.R_reported_BN * setting.R_ON.inv(), direction="predict")
    found = Chain(reported).signal([(effect, np.array(theta))]).R_BN
    error = np.degrees((found * signal.R_BN.inv()).magnitude())
    close(error, 0.0, atol=1e-9, unit="deg", because="the same turn, the other way")


def test_yaw_drift_offers_body_z_where_the_body_leans():
    seconds = np.arange(0.0, 7201.0, 30.0)
    straight, leaning = (setting_at(seconds, R_BO=Rotation.from_rotvec([lean, 0.0, 0.3])) for lean in (0.01, 0.05))
    assert {one.axis for one in YawDrift().alternatives(straight)} == {"nadir"}
    assert [(one.when, one.axis) for one in YawDrift().alternatives(leaning)] == [
        ("always", "nadir"),
        ("eclipse", "nadir"),
        ("always", "body_z"),
        ("eclipse", "body_z"),
    ]


def test_a_late_attitude_is_behind_the_motion(close):
    """A body that turns about its z at 0.5 deg/s is reported 3.5 deg behind by 7 s; other axes are not touched."""
    seconds = np.arange(0.0, 1201.0, 10.0)
    at_rest = setting_at(seconds)
    turned = Rotation.from_rotvec(np.outer(np.radians(-0.5) * seconds, [0.0, 0.0, 1.0]))  # vectors, against the axes
    setting = setting_at(seconds, R_BO=turned * at_rest.R_ON.inv())
    signal = Chain(setting).simulated([(AttitudeLag(), np.array([7.0]))], seed=0)
    behind = np.degrees((signal.R_reported_BN * signal.R_BN.inv()).as_rotvec())
    close(behind, [0.0, 0.0, 3.5], atol=1e-6, unit="deg", because="a steady rotation between the stamps")
    assert signal.r_reported_N_km is setting.given[0] and not np.any(signal.sample_offset_s)


@pytest.mark.parametrize("spacing_s", [60.0, 7.0])
@pytest.mark.parametrize("begin_s", [0.0, 1700.0, 2500.0])
def test_time_in_eclipse_whatever_the_sampling_and_the_start(spacing_s, begin_s, close):
    """Entries found on a one-second grid of the orbit, by the sun's disc as it is seen."""
    fine = np.arange(-6000.0, 12001.0)
    time = epoch.add_seconds(START, fine)
    dark = sun.illumination(ORBIT.propagate(time)[0], sun.sun_N_km(time)) <= 0.5
    begin = np.maximum.accumulate(np.where(dark & ~np.roll(dark, 1), fine, -np.inf))
    expected = np.where(dark, fine - begin, 0.0)
    seconds = np.arange(begin_s, 12000.0, spacing_s)
    setting = setting_at(seconds - begin_s, start=epoch.add_seconds(START, begin_s)[0])
    found = seconds_in_eclipse(setting)
    close(found, expected[(seconds + 6000.0).astype(int)], atol=12.0, unit="s", because="found in steps of 10 s")
    assert found.max() > 1500.0
    lit = (found == 0).astype(float)
    recorded = dataclasses.replace(setting, columns={"sunlit": lit})
    close(seconds_in_eclipse(recorded), found, atol=12.0, unit="s", because="the same rows are dark")


def test_yaw_drift_in_eclipse_starts_from_zero_at_each_entry():
    setting = setting_at(np.arange(0.0, 12000.0, 10.0))
    yaw, *_ = reported_angles_deg(setting, YawDrift("eclipse"), [3.0])
    dark = setting.illumination <= 0.5
    assert np.abs(yaw[~dark]).max() < 1e-12
    entering = np.flatnonzero(dark & ~np.roll(dark, 1))
    assert len(entering) == 2
    assert np.abs(yaw[entering]).max() <= 3.0 * 20.0 / 3600.0  # within a sample and a step of the search
    assert yaw.max() > 3.0 * 1500.0 / 3600.0


def test_sun_sensor_head_turns_the_rows_of_its_head_only(close):
    head = np.repeat([0.0, 1.0, 2.0, np.nan], 10)
    setting = setting_at(np.arange(0.0, 4000.0, 100.0), columns={"sun_sensor_head": head})
    turn_deg = np.array([0.2, -0.1, 0.3])
    for effect, rows in (
        (SunSensorHeadMisalignment(2), head == 2),
        (SunSensorHeadMisalignment(1), head == 1),
        (SunSensorHeadMisalignment(), head > 0),
    ):
        signal = Chain(setting).simulated([(effect, turn_deg)], seed=0)
        turned = np.degrees((signal.R_reported_BN * signal.R_BN.inv()).as_rotvec())
        expected = np.where(rows[:, None], turn_deg, 0.0)
        close(turned, expected, atol=1e-9, unit="deg", because="exact")
    assert [e.head for e in SunSensorHeadMisalignment().alternatives(setting)] == [1, 2]
    assert "never in use" in str(SunSensorHeadMisalignment(3).untestable(setting))
    assert "no column" in str(SunSensorHeadMisalignment().untestable(setting_at([0.0, 1.0])))


def test_field_at_the_stamps_may_be_given(close):
    """It spares an evaluation and changes nothing; an effect that moves place or moment does not use it."""
    setting = setting_at(np.arange(0.0, 600.0, 60.0), direction="predict")
    known = dataclasses.replace(setting, field_N_nT=field_N_nT(setting.model, setting.time, setting.given[0]))
    for active in ([], [(AlongTrackError(), np.array([50.0]))]):
        one, other = (Chain(s).reading_nT(active) for s in (setting, known))
        close(one, other, atol=0.0, unit="nT", because="bit for bit")
