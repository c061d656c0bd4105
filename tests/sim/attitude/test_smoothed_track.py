"""The smoothed attitude track, and motion along a record, against motions known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude import smoothed_track
from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.attitude.recorded_motion import RecordedAttitudes, RecordedMotion, carried
from fluxtwin.sim.attitude.smoothed_track import smoothed
from fluxtwin.sim.attitude.track_kernels import blended, turn_between, turned
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.orbit import Orbit

pytestmark = pytest.mark.reference

START = np.datetime64("2020-03-01T00:00:00", "ns")
ORBIT = Orbit(epoch_utc=START, altitude_km=650.0, inclination_rad=1.7, raan_rad=1.0)
Law = Callable[[FloatArray], Rotation]


def coning(spin_rad_s: float, nutation_deg: float = 3.0, ratio: float = 15.0 / 11.0) -> Law:
    """Torque-free symmetric top: precession at spin * ratio, body turned back (Goldstein, Classical Mechanics, 5.6)."""
    tilt = Rotation.from_rotvec([np.radians(nutation_deg), 0.0, 0.0])

    def at(t: FloatArray) -> Rotation:
        about_body = Rotation.from_rotvec(np.outer(-spin_rad_s * (1.0 - ratio) * t, [0.0, 0.0, 1.0]))
        return about_body * tilt * Rotation.from_rotvec(np.outer(-spin_rad_s * ratio * t, [0.0, 0.0, 1.0]))

    return at


def librating(t: FloatArray) -> Rotation:
    """Nadir pointing with 4 deg rms about each axis, the fastest with a period of ten minutes."""
    w = 2.0 * np.pi / 600.0
    angles = np.radians(4.0 * np.sqrt(2.0)) * np.stack(
        [np.sin(w * t), np.sin(0.7 * w * t + 1.0), np.sin(0.5 * w * t + 2.0)], axis=1
    )
    orbital = Rotation.from_rotvec(np.outer(2.0 * np.pi / 5800.0 * t, [0.0, 1.0, 0.0]))
    return Rotation.from_euler("ZXY", angles).inv() * orbital


LAWS: dict[str, Law] = {"spin": coning(0.15), "tumble": coning(np.radians(0.25), 35.0, 1.3), "libration": librating}


def uneven(step_s: float, rows: int = 500, seed: int = 1) -> FloatArray:
    """Stamps that wander by a tenth of the spacing, whole nanoseconds."""
    return np.round(np.cumsum(np.random.default_rng(seed).uniform(0.9, 1.1, rows)) * step_s, 9)


def perturbed(law: Law, t: FloatArray, sigma_deg: float, seed: int = 2) -> tuple[Rotation, Rotation]:
    """(error, attitude with that error): white, per axis, body axes."""
    theta = np.radians(sigma_deg) * np.random.default_rng(seed).standard_normal((t.size, 3))
    return Rotation.from_rotvec(theta), Rotation.from_rotvec(theta) * law(t)


def rms_deg(found: Rotation, expected: Rotation) -> float:
    """Of one component."""
    return float(np.degrees(np.sqrt(np.mean((found * expected.inv()).magnitude() ** 2) / 3.0)))


def moved(record: RecordedMotion, law: Law, t: FloatArray, offset_s: float, inside: slice) -> float:
    """rms error of the motion from each stamp to the moment offset_s later, deg."""
    found = record.at(offset_s)[2] * record.R_BN.inv()
    return rms_deg(found[inside], (law(t + offset_s) * law(t).inv())[inside])


def recorded(t: FloatArray, R_BN: Rotation, gyro: FloatArray | None = None, known: np.ndarray | None = None):
    time = epoch.add_seconds(START, t)
    r, v = ORBIT.propagate(time)
    return RecordedMotion(time, r, v, R_BN, gyro, known)


EXACT = [
    # The quintic over +-4 rows errs by the sixth power of w h: a thousandth of the noise usual in attitudes, or less.
    ("spin", 0.1, 1e-8),
    ("spin", 1.0, 1e-4),
    ("spin", 2.0, 5e-3),
    ("tumble", 1.0, 1e-9),
    ("tumble", 20.0, 1e-5),
    ("tumble", 60.0, 1e-2),
    ("libration", 0.1, 1e-9),
    ("libration", 5.0, 1e-7),
    ("libration", 30.0, 2e-3),
]


@pytest.mark.parametrize(("name", "step_s", "within_deg"), EXACT)
def test_without_noise_the_motion_is_followed(name: str, step_s: float, within_deg: float) -> None:
    law, t = LAWS[name], uneven(step_s)
    record = recorded(t, law(t))
    for steps in (-3.3, -0.5, 0.1, 0.5, 1.0, 1.7, 6.0):
        inside = slice(8, -8)
        assert moved(record, law, t, steps * step_s, inside) < within_deg
        half_as_far = (law(t + 0.5 * steps * step_s) * law(t).inv())[inside]
        found = (record.at(steps * step_s)[2] * record.R_BN.inv())[inside]
        assert rms_deg(found, half_as_far) > 5.0 * within_deg


@pytest.mark.parametrize(("name", "step_s"), [("spin", 1.3), ("tumble", 20.0), ("libration", 30.0), ("tumble", 1.0)])
def test_noise_is_averaged_and_the_own_error_stays(name: str, step_s: float) -> None:
    """With 0.1 deg of noise: what an offset adds has much less than the sqrt 2 of two attitudes' errors.

    Half a step on: the slope's noise, at most 0.35 sigma a step over thirteen rows and more of a quintic, so
    under 0.18 sigma; a straight line through nine rows is a degree off here for the libration.
    """
    law, t, sigma = LAWS[name], uneven(step_s), 0.1
    error, R_BN = perturbed(law, t, sigma)
    record = recorded(t, R_BN)
    inside = slice(20, -20)
    added = record.at(0.5 * step_s)[2] * R_BN.inv() * error * (law(t + 0.5 * step_s) * law(t).inv() * error).inv()
    assert np.degrees(added[inside].magnitude()).mean() / np.sqrt(3.0) < 0.3 * sigma
    far = record.at(6.0 * step_s)[2]
    assert rms_deg(far[inside], (law(t + 6.0 * step_s) * law(t).inv() * R_BN)[inside]) < 1.0 * sigma
    assert record.at(0.0)[2] is R_BN


def slowly_wrong(law: Law, t: FloatArray, tau_s: float) -> tuple[Rotation, Rotation]:
    """(error, attitude with that error): 0.1 deg per axis with a memory, body axes."""
    stamps = START + (t * 1e9).astype("timedelta64[ns]")
    theta = gauss_markov(stamps, np.radians(0.1), tau_s, np.random.default_rng(3), columns=3)
    return Rotation.from_rotvec(theta), Rotation.from_rotvec(theta) * law(t)


@pytest.mark.parametrize(("name", "step_s"), [("libration", 2.0), ("libration", 10.0), ("tumble", 30.0)])
def test_a_part_of_a_step_adds_little_to_slow_errors(name: str, step_s: float) -> None:
    """From row to row the error must hardly move more than that of the attitudes themselves (0.1 deg over 300 s): by 0.5 %.
    A line through three rows adds 2 % by the fit of each row, and 10 % from one fit to the next."""
    law, t, on = LAWS[name], uneven(step_s), 0.3 * step_s
    error, R_BN = slowly_wrong(law, t, 300.0)
    record = recorded(t, R_BN)
    there = law(t + on).inv()
    own = record.at(on)[2] * there
    along = record.track(on) * record.track(0.0).inv() * R_BN * there

    def jitter(of: Rotation) -> float:
        return float(np.sqrt(np.mean(np.diff(of.as_rotvec()[20:-20], axis=0) ** 2)))

    assert jitter(own) < 1.005 * jitter(error)
    assert jitter(along) < 1.005 * jitter(error)


SLOW = [
    ("libration", 2.0, 300.0),
    ("libration", 4.0, 300.0),
    ("libration", 4.0, 3000.0),
    ("libration", 10.0, 300.0),
    ("tumble", 4.0, 30.0),
    ("tumble", 4.0, 300.0),
    ("tumble", 20.0, 300.0),
]


@pytest.mark.parametrize(("name", "step_s", "tau_s"), SLOW)
def test_slow_errors_are_averaged_too(name: str, step_s: float, tau_s: float) -> None:
    """The motion over half a step is known twice as well as from three attitudes, which know it as well as the two steps.

    The error of a slope falls with the root of the rows: nine rows halve that of three, and motions so slow allow more.
    """
    law, t = LAWS[name], uneven(step_s)
    _, R_BN = slowly_wrong(law, t, tau_s)
    inside, share = slice(30, -30), 0.5 * step_s / (t[2:] - t[:-2])
    of_three = Rotation.from_rotvec(share[:, None] * (R_BN[2:] * R_BN[:-2].inv()).as_rotvec())
    true = law(t + 0.5 * step_s) * law(t).inv()
    found = moved(recorded(t, R_BN), law, t, 0.5 * step_s, inside)
    assert found < 0.5 * rms_deg(of_three[29:-29], true[inside])


@pytest.mark.parametrize("tau_s", [0.0, 5.0, 30.0, 300.0])
def test_the_track_stays_on_the_attitudes(tau_s: float) -> None:
    """A spin with 3 deg of nutation: the smoothest line through it is degrees off, and steps alone hardly tell. No track
    need be further off than the attitudes themselves, 0.1 deg."""
    law, t = LAWS["spin"], uneven(1.0, 3000)
    _, R_BN = slowly_wrong(law, t, tau_s)
    assert rms_deg(smoothed(t, R_BN).at(t), law(t)) < 0.12


def test_what_is_left_out_is_predicted_by_the_others() -> None:
    """Each innovation taken out by hand of turns about one axis, until a polynomial fit says that there is none."""
    half, degree, rows = 4, 3, 60
    t = np.arange(float(rows))
    angle = 1e-3 * np.random.default_rng(6).standard_normal(rows)
    R_BN = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0])
    course = smoothed_track._Course(t, np.zeros((rows, 3)))
    everyone = np.arange(rows, dtype=np.intp)
    shares = smoothed_track._KEPT
    sums = smoothed_track._moments(R_BN, np.zeros(rows, dtype=np.intp), course, everyone, half, degree, shares)
    for share, found in zip(shares, smoothed_track._trial(sums, degree, half).error, strict=True):
        squares = []
        for centre in range(half, rows - half):
            near = slice(centre - half, centre + half + 1)
            handed_on = np.where(t >= t[centre], float(share) ** np.maximum(t - t[centre], 0.0), 0.0)[near]

            def new(values: FloatArray, share: float = share) -> float:
                rest = values - np.polyval(
                    np.polyfit(np.arange(-half, half + 1), values, degree), np.arange(-half, half + 1)
                )
                return float(rest[half] - share * rest[half - 1])

            size = new(angle[near]) / new(handed_on)
            assert abs(new(angle[near] - size * handed_on)) < 1e-15
            squares.append(size**2)
        assert abs(found / np.mean(squares) - 1.0) < 1e-6


@pytest.mark.parametrize(("half", "degree"), [(4, 3), (6, 5), (20, 3)])
def test_what_white_and_slow_errors_leave_of_a_fit(half: int, degree: int) -> None:
    """The correlation of neighbours in 20,000 drawn windows, fitted by numpy; its sampling error is 0.007."""
    rows, rng = np.arange(2 * half + 1.0), np.random.default_rng(7)
    for share, expected in zip(smoothed_track._KEPT, smoothed_track._correlations(half, degree)[0], strict=True):
        new = rng.standard_normal((20_000, rows.size))
        new[:, 1:] *= np.sqrt(1.0 - share**2)
        errors = lfilter([1.0], [1.0, -share], new, axis=1)
        rest = errors - np.polynomial.polynomial.polyval(rows, np.polynomial.polynomial.polyfit(rows, errors.T, degree))
        assert abs(np.corrcoef(rest[:, half], rest[:, half - 1])[0, 1] - expected) < 0.03


def test_the_noise_of_a_row_hardly_moves_the_track_beside_it() -> None:
    """The response of the track at rows 0, 1, 2 away to a jolt of one attitude: flat near the middle, as a fit's is.

    A track that goes through the attitudes themselves would give 1, 0, 0.
    """
    law, t = LAWS["spin"], uneven(1.3)
    _, R_BN = perturbed(law, t, 0.1)
    before = smoothed(t, R_BN)
    jolt = np.zeros((t.size, 3))
    jolt[250] = [1e-4, 0.0, 0.0]
    after = smoothed(t, Rotation.from_rotvec(jolt) * R_BN)
    assert (after.degree, after.half) == (before.degree, before.half)
    moved_by = (after.at(t) * before.at(t).inv()).magnitude() / 1e-4
    assert 0.1 < moved_by[250] < 0.35
    assert abs(moved_by[251] - moved_by[250]) < 0.05
    assert moved_by[:200].max() < 1e-6


def test_the_window_follows_the_motion() -> None:
    """Quiet motion is smoothed over many rows, quick motion over few, noise-free motion over hardly any."""
    t = uneven(30.0)
    wide = smoothed(t, perturbed(coning(2e-4), t, 0.1)[1])
    narrow = smoothed(t, perturbed(librating, t, 0.1)[1])
    bare = smoothed(t, librating(t))
    assert wide.half > narrow.half >= bare.half
    assert narrow.half * 30.0 < 300.0  # half a period


@pytest.mark.parametrize("tau_s", [0.0, 60.0, 420.0, 3000.0])
@pytest.mark.parametrize(
    ("spin_rad_s", "nutation_deg", "ratio", "step_s"), [(0.36, 5.5, 1.3, 2.0), (0.5, 3.0, 1.2, 1.0)]
)
def test_a_wobble_is_no_slow_error(
    spin_rad_s: float, nutation_deg: float, ratio: float, step_s: float, tau_s: float
) -> None:
    """A long window leaves all of a nutation, which changes from row to row as a slow error would: the track was 1.2 deg off
    (0.4 in the second case), and the errors of the attitudes are 0.09 deg.

    A fit of degree 5 to 9 rows leaves at most 0.16 deg of the first motion (without errors; numpy), 0.01 of the second."""
    law, t = coning(spin_rad_s, nutation_deg, ratio), np.arange(1500) * step_s
    errors = gauss_markov(epoch.add_seconds(START, t), np.radians(0.09), tau_s, np.random.default_rng(3), columns=3)
    assert rms_deg(smoothed(t, Rotation.from_rotvec(errors) * law(t)).at(t), law(t)) < 0.2


def test_rows_of_a_denser_record_move_as_all_of_it() -> None:
    """Each fifth row of a record, 100 deg of a spin apart: the attitudes between tell the wobble."""
    law, t = coning(0.36, 5.5, 1.3), np.arange(2500) * 1.0
    R_BN = perturbed(law, t, 0.05)[1]
    sparse = recorded(t[::5], R_BN[::5])
    moved_deg = []
    for record in (sparse, replace(sparse, denser=RecordedAttitudes(epoch.add_seconds(START, t), R_BN))):
        moved_deg.append(moved(record, law, t[::5], 0.7, slice(2, -2)))
        along = record.along_track()
        assert rms_deg(along.R_BN, law(t[::5])) < (0.1 if record.denser else 10.0)
        assert (
            along.at(0.7)[2] * along.R_BN.inv() * (record.at(0.7)[2] * record.R_BN.inv()).inv()
        ).magnitude().max() < 1e-9
    assert moved_deg[1] < 0.03 < 0.1 < moved_deg[0]
    known = np.arange(t[::5].size) % 3 > 0
    partly = replace(
        record, attitude_known=known, R_BN=Rotation.from_rotvec(0.5 * ~known[:, None] * np.ones(3)) * record.R_BN
    )
    turned = partly.with_errors(lambda time: np.full((time.size, 3), 1e-3))
    assert np.allclose((turned.R_BN * partly.R_BN.inv()).as_rotvec(), 1e-3 * known[:, None] * np.ones(3), atol=1e-12)
    assert moved(partly, law, t[::5], 0.7, known) < 0.05
    assert np.degrees((turned.track(0.0) * record.track(0.0).inv()).magnitude()[known]).max() == pytest.approx(
        0.0992, rel=0.02
    )


def test_where_the_motion_is_slow_the_rows_alone_are_smoothed_longer() -> None:
    """Ten rows a second of a libration of minutes: the attitudes between say no more, and the longest window ends sooner."""
    t = np.arange(6000) * 0.1
    R_BN = perturbed(librating, t, 0.1)[1]
    sparse = recorded(t[::2], R_BN[::2])
    record = replace(sparse, denser=RecordedAttitudes(epoch.add_seconds(START, t), R_BN))
    assert record.smoothed.time_s.size == 3000
    assert (record.track(0.3) * sparse.track(0.3).inv()).magnitude().max() < 1e-12


def test_gaps_are_not_fitted_across() -> None:
    """A record in two parts with a turn by hand between them: each part as if it were alone."""
    t = np.concatenate([uneven(20.0, 60), 9000.0 + uneven(20.0, 60, seed=3)])
    law = LAWS["tumble"]
    turned = np.zeros((120, 3))
    turned[60:] = [0.0, 1.0, 0.5]
    R_BN = Rotation.from_rotvec(turned) * law(t)
    track = smoothed(t, R_BN)
    assert rms_deg(track.at(t + 7.0)[:59], law(t[:59] + 7.0)) < 1e-3
    assert rms_deg(track.at(t + 7.0)[60:119], Rotation.from_rotvec(turned[60:119]) * law(t[60:119] + 7.0)) < 1e-3
    reached = track.reaches(t + 25.0)
    assert reached[:58].all()
    assert not reached[59]
    assert not reached[-1]
    assert track.reaches(t + 9.0).all()


@pytest.mark.parametrize("rows", [1, 2, 3, 4, 6])
def test_a_few_rows_are_enough_for_something(rows: int) -> None:
    """One row stands still; with two or more the motion goes on at its rate."""
    t = 10.0 * np.arange(rows)
    law = coning(0.01, 0.0)
    found = smoothed(t, law(t)).at(t + 3.0)
    assert rms_deg(found, law(t + 3.0) if rows > 1 else law(t)) < 1e-9


def test_a_gyro_tells_a_spin_that_the_attitudes_are_too_far_apart_for() -> None:
    """2 rpm seen each 40 s, 480 deg a step: only the gyro knows. Its bias and noise are put right by the attitudes."""
    law, rate = coning(2.0 * np.pi / 30.0, 0.0), 2.0 * np.pi / 30.0
    t = uneven(40.0)
    rng = np.random.default_rng(5)
    gyro = np.array([0.0, 0.0, rate + np.radians(0.01)]) + np.radians(0.002) * rng.standard_normal((t.size, 3))
    gyro[::7] = np.nan
    _, R_BN = perturbed(law, t, 0.1)
    blind, with_gyro = recorded(t, R_BN), recorded(t, R_BN, gyro)
    inside = slice(5, -5)
    assert moved(blind, law, t, 9.0, inside) > 10.0
    assert moved(with_gyro, law, t, 9.0, inside) < 0.15


def test_a_gyro_shows_a_wobble_that_the_attitudes_are_too_far_apart_for() -> None:
    """130 deg a step: a course through the attitudes alone meets them all, and is another one between them."""
    law = coning(0.19, 0.7, 1.46)
    t = 12.0 * np.arange(400.0)
    stamps = START + (t * 1e9).astype("timedelta64[ns]")
    error = Rotation.from_rotvec(gauss_markov(stamps, np.radians(0.05), 270.0, np.random.default_rng(3), columns=3))
    gyro = -(law(t + 1e-3) * law(t - 1e-3).inv()).as_rotvec() / 2e-3
    inside = slice(20, -20)
    for offset_s in (-1.2, 3.0):
        blind, seeing = (moved(recorded(t, error * law(t), rate), law, t, offset_s, inside) for rate in (None, gyro))
        assert seeing < 0.02
        assert blind > 2.0 * seeing


def test_a_gyro_in_wrong_units_is_not_believed() -> None:
    law, t = LAWS["tumble"], uneven(20.0)
    gyro = -(law(t + 1e-3) * law(t - 1e-3).inv()).as_rotvec() / 2e-3
    assert moved(recorded(t, law(t), np.degrees(gyro)), law, t, 5.0, slice(20, -20)) < 1e-4


def test_a_poor_gyro_is_not_believed() -> None:
    law = LAWS["tumble"]
    t = uneven(20.0)
    _, R_BN = perturbed(law, t, 0.1)
    gyro = np.radians(0.25) + np.radians(0.5) * np.random.default_rng(5).standard_normal((t.size, 3))
    inside = slice(20, -20)
    assert moved(recorded(t, R_BN, gyro), law, t, 5.0, inside) < 0.03


@pytest.mark.parametrize("factor", [-1.0, 2.0, np.degrees(1.0)], ids=["sign", "twice", "deg/s as rad/s"])
@pytest.mark.parametrize("turn_rad", [1.2, 1.9])
def test_a_gyro_that_turns_another_way_is_not_believed(turn_rad: float, factor: float) -> None:
    """A steady spin is predicted at the stamps by any rate that is constant; between them it is not."""
    t = np.arange(200.0)
    spin = np.outer(turn_rad * t, [0.0, 0.0, 1.0])
    R_BN = Rotation.from_rotvec(1e-3 * np.random.default_rng(0).normal(size=(200, 3))) * Rotation.from_rotvec(-spin)
    middle = t[5:-5] + 0.5
    true = Rotation.from_rotvec(-np.outer(turn_rad * middle, [0.0, 0.0, 1.0]))
    for size, believed in ((1.0, True), (factor, False)):
        track = smoothed(t, R_BN, np.tile([0.0, 0.0, size * turn_rad], (200, 1)))
        assert (track.course.integrated is not None) == believed
        assert np.degrees((track.at(middle) * true.inv()).magnitude().max()) < 0.3


def test_rows_of_unknown_attitude_say_nothing() -> None:
    """Attitudes that only fit a reading: the others are followed as if these were not there."""
    law = LAWS["tumble"]
    t = uneven(20.0)
    known = np.random.default_rng(8).random(t.size) > 0.3
    pseudo = Rotation.random(t.size, random_state=4)
    mixed = Rotation.from_quat(np.where(known[:, None], law(t).as_quat(), pseudo.as_quat()))
    record = recorded(t, mixed, known=known)
    found = record.at(6.0)[2] * mixed.inv()
    assert rms_deg(found[10:-10], (law(t + 6.0) * law(t).inv())[10:-10]) < 1e-3
    assert record.reaches(3000.0)[~known].all()
    beyond = t[known][-1] - t + 0.5 * np.median(np.diff(t[known]))  # half a spacing beyond the last
    assert record.reaches(beyond - 0.1).all()
    assert not record.reaches(beyond + 0.1)[known].any()


def test_only_rows_without_attitude_are_followed_along_the_track(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others have a fit of their own, and positions need no attitude at all."""
    t = uneven(20.0)
    known = np.random.default_rng(8).random(t.size) > 0.3
    record = recorded(t, LAWS["tumble"](t), known=known)
    expected = (record.track(6.0) * record.track(0.0).inv() * record.R_BN)[~known]
    record.at(1.0)  # what is worked out once
    asked: list[int] = []
    at = smoothed_track.AttitudeTrack.at
    monkeypatch.setattr(
        smoothed_track.AttitudeTrack, "at", lambda track, moments: asked.append(moments.size) or at(track, moments)
    )
    r, v = record.orbit(6.0)
    assert not asked
    r_at, v_at, R_BN = record.at(6.0)
    assert sum(asked) == (~known).sum()
    assert (R_BN[~known] * expected.inv()).magnitude().max() < 1e-12
    assert np.array_equal(r, r_at) and np.array_equal(v, v_at)


def test_positions_between_the_stamps(close: Callable[..., None]) -> None:
    t = np.arange(0.0, 6000.0, 60.0)
    record = recorded(t, Rotation.identity(t.size))
    for offset_s in (-20.0, 0.5, 45.0, 600.0):
        r, v = ORBIT.propagate(epoch.add_seconds(START, t + offset_s))
        inside = (t + offset_s >= 0.0) & (t + offset_s <= t[-1])
        found_r, found_v, _ = record.at(offset_s)
        why = "short-period J2, 1.5e-5 km/s2, over half a step"
        close(found_r[inside], r[inside], atol=0.01, unit="km", because=why)
        close(found_v[inside], v[inside], atol=5e-4, unit="km/s", because=why)
        assert np.abs(found_r - record.r_N_km).max() > 3.0


def test_positions_beyond_the_last_stamp(close: Callable[..., None]) -> None:
    """Against an integrator that is not ours, of the same force written as the gradient of its potential."""
    r, v = (part[0] for part in ORBIT.propagate(epoch.add_seconds(START, np.zeros(1))))

    def potential(x: FloatArray) -> float:
        size = float(np.linalg.norm(x))
        return 398600.4418 / size * (1.0 - 1.08262668e-3 * (6378.137 / size) ** 2 * (1.5 * (x[2] / size) ** 2 - 0.5))

    def motion(_: float, state: FloatArray) -> FloatArray:
        steps = 0.5 * np.eye(3)
        slope = [potential(state[:3] + step) - potential(state[:3] - step) for step in steps]
        return np.concatenate([state[3:], slope])

    for after_s in (-37.0, 600.0):
        expected = solve_ivp(motion, (0.0, after_s), np.concatenate([r, v]), rtol=1e-10, atol=1e-9).y[:, -1]
        found = carried(r[None], v[None], np.array([after_s]))
        close(found[0][0], expected[:3], atol=2e-3, unit="km", because="steps of 60 s: (w h)^5 / 120 of 7000 km each")
        close(found[1][0], expected[3:], atol=2e-6, unit="km/s", because="the same, times w")
        bare = r + after_s * v - 0.5 * after_s**2 * 398600.4418 * r / np.linalg.norm(r) ** 3
        assert np.abs(found[0][0] - bare).max() > 5e-3


def test_what_is_blended_is_on_the_short_way() -> None:
    first, second = Rotation.random(5, random_state=3), Rotation.random(5, random_state=4)
    found = blended(first.as_quat(), second.as_quat(), np.full(5, 0.3))
    expected = Rotation.from_rotvec(0.3 * (second * first.inv()).as_rotvec()) * first
    assert np.allclose(np.abs(np.einsum("ij,ij->i", found, expected.as_quat())), 1.0, atol=1e-12)


def test_a_turn_by_rates_is_the_product_of_its_steps() -> None:
    """Against scipy's rotations, one after the other: exp of the mean rate and of the commutator of both points of Gauss.

    The rates are steady from shortly before one of these points to the next; before the first as at the first.
    """
    rng = np.random.default_rng(8)
    rates, after, start = rng.normal(0.0, 0.05, (3, 2, 40, 3)), rng.uniform(-5.0, 5.0, 40), 20.0 * np.arange(40.0)
    step, sides = after / 3, np.array([-0.5, 0.5]) / np.sqrt(3.0)
    moments = start + step * (np.arange(3)[:, None] + 0.5 + sides)[:, :, None]
    order = np.argsort(moments.ravel())
    breaks, pieces = moments.ravel()[order] - 1e-3, rates.reshape(-1, 3)[order]
    breaks[0] += 2e-3
    whole = Rotation.identity(40)
    for first, second in rates:
        bent = np.sqrt(3.0) / 12.0 * (step**2)[:, None] * np.cross(second, first)
        whole = Rotation.from_rotvec(-0.5 * step[:, None] * (first + second) + bent) * whole

    def missed(pieces: FloatArray) -> float:
        found = turned(breaks, pieces, start, after, 3)
        return float((Rotation.from_quat(found) * whole.inv()).magnitude().max())

    assert missed(pieces[None]) < 1e-14
    slope = np.stack([np.zeros_like(pieces), pieces])
    slope[0] = 0.01
    slope[1] -= 0.01 * (moments.ravel()[order] - breaks)[:, None]  # the same at the points of Gauss, but for the first
    slope[:, 0] = [[0.0] * 3, pieces[0]]
    assert missed(slope) < 1e-14
    assert missed(np.roll(pieces, 1, axis=0)[None]) > 1e-3


def test_the_turn_between_two_attitudes_is_the_short_way() -> None:
    first, second = Rotation.random(50, random_state=5), Rotation.random(50, random_state=6)
    found = turn_between(first.as_quat(), -second.as_quat())
    assert np.allclose(found, (second * first.inv()).as_rotvec(), atol=1e-12)
