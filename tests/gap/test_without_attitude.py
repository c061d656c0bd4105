"""Rows without a reference attitude: what they say of each effect, and what a turn of the body cannot do to it.

The witness is the same record with its attitude: along the field, or in the plane of field and nadir, the two must agree.
"""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds import scenario_text

from fluxtwin.gap.held_out.held_out import floor_rms_nT, one_step
from fluxtwin.gap.hypotheses.candidates import candidates
from fluxtwin.gap.noise.robust_rows import first_weights, standing_out
from fluxtwin.gap.noise.whitening import NoiseModel, make_whitener
from fluxtwin.gap.problem import row_axes as rows_without_attitude
from fluxtwin.gap.problem.problem import Budget, Problem, pose, realigned
from fluxtwin.gap.problem.row_axes import RowAxes, calibrated, row_axes, start_without_attitude
from fluxtwin.gap.selection.refit import settled
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
mode = "tumble"
rate_deg_s = [0.12, 0.08, 0.2]
[magnetometer]
CALIBRATION
"""
SCENARIO = scenario_text(
    SECTIONS,
    seed=3,
    inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
    inclination_deg=70.0,
    segment="duration_min = 100.0, step_s = 20.0",
)
TRUE_S = np.array([[0.02, 0.01, 0.0], [0.0, -0.02, 0.01], [0.005, 0.0, 0.01]])
TRUE_B_NT = np.array([3000.0, -2000.0, 1000.0])
SEED_ROWS = 5


@cache
def flight(calibration: str = "") -> Telemetry:
    """Without noise or rounding, so what is compared is geometry alone."""
    return simulate(parse_scenario(SCENARIO.replace("CALIBRATION", calibration)))[0]


def wrongly_calibrated() -> Telemetry:
    return flight(f"S = {TRUE_S.tolist()}\nb_nT = {TRUE_B_NT.tolist()}")


def without(record: Telemetry, rows: np.ndarray, nadir: bool = False) -> Telemetry:
    q = np.array(record.q_NB)
    q[rows] = np.nan
    changes: dict[str, object] = {"q_NB": q}
    if nadir:
        down_N = -np.array(record.r_N_km) / np.linalg.norm(record.r_N_km, axis=1)[:, None]
        changes["nadir_B"] = frames.rotation_from_q(np.array(record.q_NB)).apply(down_N)
    return record.replace(**changes)


def posed(record: Telemetry) -> Problem:
    return pose(record, load_field("igrf14"), budget=Budget(10.0, 0.0, 1e-3))


def everywhere(record: Telemetry) -> np.ndarray:
    return np.ones(len(record), dtype=bool)


def along(problem: Problem) -> np.ndarray:
    return problem.field_B_nT / np.linalg.norm(problem.field_B_nT, axis=1)[:, None]


@pytest.fixture(scope="module")
def pair() -> tuple[Problem, Problem]:
    """The same record with its attitude and without any."""
    return posed(flight()), posed(without(flight(), everywhere(flight())))


def test_every_effect_shows_along_the_field_as_it_does_with_the_attitude(pair):
    known, unknown = pair
    there = {c.label: c.jacobian for c in candidates(known)[0]}
    here, untestable = candidates(unknown)
    unit, compared = along(known), 0
    for one in here:
        if one.label not in there or one.name == "solar_array_current":  # the sun's incidence needs the attitude
            continue
        wanted = np.einsum("ni,nip->np", unit, there[one.label])
        found = unknown.in_row_axes(one.jacobian)[:, 0]
        # Rates of the body come from nine rows of readings or attitudes and differ by a few thousandths.
        least = 1e-3 * float(np.abs(there[one.label]).max())
        assert np.abs(found - wanted).max() < 0.01 * np.abs(wanted).max() + least, one.label
        compared += 1
    assert compared > 20
    assert {"horizon_scanner_bias", "yaw_drift"} <= set(untestable)
    assert untestable["yaw_drift"] == "no row has a reference attitude"


def test_an_axis_that_reads_nothing_does_not_stop_the_fit():
    """Of |B| it is no part: what rounding leaves of its derivative must not be divided by."""
    record = flight()
    problem = settled(posed(without(record, everywhere(record)).replace(mag_B_nT=record.mag_B_nT * [0.0, 1.0, 1.0])))
    assert np.abs(problem.setting.instrument.b_nT).max() < 1e5


@pytest.mark.parametrize("factor", [(1.0, 1.0, 1.0), (0.8, 1.0, 3.0)])
def test_what_is_not_measured_is_zero_and_never_whitened(pair, factor):
    """And the size of the field has the noise of the axes that it lies along."""
    _, unknown = pair
    axes = unknown.axes
    assert axes is not None
    noise = NoiseModel(10.0, 0.1, 100.0, axis_factor=factor)
    whitener = make_whitener(unknown.noise_image_nT, unknown.setting.seconds, unknown.segment, noise, None, axes)
    random = np.random.default_rng(SEED_ROWS).standard_normal((unknown.rows, 3, 2))
    white = whitener.apply(random)
    assert whitener.measured == unknown.rows
    assert np.all(white[:, 1:] == 0.0)
    sigma_nT = 10.0 * np.linalg.norm(along(unknown) * factor, axis=1)[:, None]
    np.testing.assert_allclose(white[:, 0], np.einsum("ni,nip->np", along(unknown), random) / sigma_nT, atol=1e-12)


def test_a_large_bias_and_matrix_are_found_from_the_size_of_the_field_alone(close):
    record = wrongly_calibrated()
    assert start_without_attitude(flight(), load_field()) is None  # near the field as it is
    problem = settled(posed(without(record, everywhere(record))))
    left = problem.in_row_axes(problem.residual_nT)
    close(
        left,
        np.zeros_like(left),
        atol=0.5,
        unit="nT",
        because="four steps of Gauss and Newton from zero leave 1e-5 of the 3700 nT of bias",
    )
    b, S = (np.asarray(one) for one in (problem.setting.instrument.b_nT, problem.setting.instrument.S))
    field = (np.eye(3) + S) @ np.array(record.mag_B_nT).T + b[:, None]
    unit = field.T / np.linalg.norm(field, axis=0)[:, None]
    close(along(realigned(problem)), unit, atol=1e-6, unit="1", because="the pseudo attitudes fit it")
    true = (np.eye(3) + TRUE_S) @ np.array(record.mag_B_nT).T + TRUE_B_NT[:, None]
    turn, _ = Rotation.align_vectors(true.T, field.T)
    close(
        turn.apply(field.T),
        true.T,
        atol=5.0,
        unit="nT",
        because="but for a turn of all axes, which a size cannot show, the calibration is the true one to 1e-4",
    )
    assert not np.allclose(b, 0.0, atol=500.0)


@pytest.mark.parametrize(("share", "refused"), [(0.0195, False), (0.0205, True)])
def test_a_bias_open_by_a_fiftieth_of_the_field_is_no_start(
    monkeypatch: pytest.MonkeyPatch, share: float, refused: bool
) -> None:
    """Half its square over |B| is then 8 nT in 40,000."""
    record = flight("b_nT = [12000.0, 9000.0, 0.0]")
    size_nT = np.median(np.linalg.norm(field_N_nT(load_field(), record.time, np.asarray(record.r_N_km)), axis=1))
    known = SimpleNamespace(names=("b_x", "S_xx"), sigmas=np.array([share * size_nT, 0.001]), S=TRUE_S, b_nT=TRUE_B_NT)
    monkeypatch.setattr(rows_without_attitude, "calibrate_scalar", lambda *_: SimpleNamespace(calibration=known))
    if refused:
        with pytest.raises(NoAnswer, match="b_x by"):
            start_without_attitude(record, load_field())
    else:
        found = start_without_attitude(record, load_field())
        assert found is not None and np.array_equal(found.S, TRUE_S) and np.array_equal(found.b_nT, TRUE_B_NT)


def test_any_turn_of_the_body_leaves_the_residual_of_a_row_without_attitude_alone(close):
    """Size: all turns. Size and angle: turns about nadir. The same turns move the residual of rows with attitude."""
    rng = np.random.default_rng(7)
    record = flight()
    rows = np.arange(len(record)) >= 150
    for nadir in (False, True):
        problem = posed(without(record, rows, nadir))
        axes, field = problem.axes, problem.field_B_nT
        assert axes is not None and axes.with_nadir.sum() > (100 if nadir else -1)
        axis = axes.nadir_B if nadir else rng.standard_normal((problem.rows, 3))
        use = axes.with_nadir if nadir else ~axes.known
        turned = Rotation.from_rotvec(0.05 * axis).apply(field) + 40.0 - field
        still = axes.in_row_axes(axes.without_turn(turned, field))[use]
        # The same addition seen from the turned body, as large as it is: sizes compared by hand.
        F, G = field[use], field[use] + turned[use]
        close(
            still[:, 0]
            if not nadir
            else np.einsum("ni,ni->n", axes.turn[use][:, 0], axes.without_turn(turned, field)[use]),
            np.linalg.norm(G, axis=1) - np.linalg.norm(F, axis=1) if not nadir else still[:, 0],
            atol=1e-6,
            unit="nT",
            because="both are the same geometry",
        )
        alone = axes.in_row_axes(axes.without_turn(Rotation.from_rotvec(0.05 * axis).apply(field) - field, field))
        assert np.abs(alone[use]).max() < 1e-6
        assert np.abs(alone[axes.known]).max() > (100.0 if not nadir else -1.0)


def test_calibrated_is_the_field_of_a_reading(close):
    rng = np.random.default_rng(11)
    field, dipole = rng.normal(0.0, 3e4, (9, 3)), rng.normal(0.0, 5.0, (9, 3))
    sensor = Magnetometer(rng.normal(0.0, 0.05, (3, 3)), np.array([700.0, -90.0, 40.0]), rng.normal(0.0, 30.0, (3, 3)))
    found = calibrated(sensor.ideal_reading(field, dipole), sensor, dipole)
    close(found, field, atol=1e-9, unit="nT", because="rounding")


def test_the_pseudo_attitude_takes_the_model_field_and_nadir_to_what_was_measured(close):
    record = flight()
    rows = np.arange(len(record)) % 3 > 0
    problem = posed(without(record, rows))
    R_BN = problem.setting.given[2]
    true = frames.rotation_from_q(np.array(record.q_NB))
    assert np.allclose((R_BN[~rows] * true[~rows].inv()).magnitude(), 0.0, atol=1e-12)
    unit = np.array(record.mag_B_nT) / np.linalg.norm(record.mag_B_nT, axis=1)[:, None]
    close(along(problem), unit, atol=1e-9, unit="1", because="the rotation is built to do that")
    off_deg = np.degrees((R_BN * true.inv()).magnitude())
    assert off_deg[rows].max() < 12.0  # two rows of 20 s after a known one, at 0.25 deg/s about the field: 10 degrees
    angle = posed(without(record, everywhere(record), nadir=True))
    use = angle.axes.with_nadir
    assert use.sum() > 200
    close(
        (angle.setting.given[2] * true.inv()).magnitude()[use],
        np.zeros(use.sum()),
        atol=1e-6,
        unit="rad",
        because="without noise nadir and field together are the whole attitude",
    )


def test_nadir_is_used_only_where_it_can_be_weighed():
    record = flight()
    late = np.arange(len(record)) >= 150
    both = without(record, late, nadir=True)
    assert posed(both).axes.with_nadir.sum() > 100
    unchecked = np.array(both.nadir_B)
    unchecked[~late] = np.nan
    assert not posed(both.replace(nadir_B=unchecked)).axes.with_nadir.any()
    every_second = without(record, np.arange(len(record)) % 2 > 0, nadir=True)
    assert not posed(every_second).axes.with_nadir.any()  # its error has no stretch to go on over


def test_a_constant_turn_of_the_nadir_sensor_is_taken_out_and_its_scatter_weighs(close):
    record = flight()
    both = without(record, np.arange(len(record)) >= 150, nadir=True)
    rng = np.random.default_rng(11)
    off = Rotation.from_rotvec([0.01, -0.02, 0.015])
    noisy = off.apply(np.array(both.nadir_B)) + 2e-3 * rng.standard_normal((len(record), 3))
    axes = posed(both.replace(nadir_B=noisy)).axes
    use = axes.with_nadir
    angle = np.linalg.norm(np.cross(axes.nadir_B, np.array(both.nadir_B)), axis=1)[use]
    close(
        np.sqrt(np.mean(angle**2) / 2.0),
        2e-3,
        atol=4e-4,
        unit="rad",
        because="the turn of 27 mrad is gone, the noise of 2 mrad an axis stays (150 rows: 6 %)",
    )
    close(axes.nadir_error, np.hypot(1.0, 2.0), atol=0.3, unit="1", because="2 mrad on top of the declared 1 mrad")
    assert np.unique(posed(both.replace(nadir_B=noisy)).segment).size == 2  # where the sensor changes


def test_an_attitude_error_reaches_nadir_rows_in_the_plane_only(pair):
    _, unknown = pair
    assert not unknown.noise_field_nT.any()
    angle = posed(without(flight(), everywhere(flight()), nadir=True))
    use = angle.axes.with_nadir
    size = np.linalg.norm(angle.field_B_nT, axis=1)
    reached = np.cross(np.eye(3)[2], angle.noise_field_nT)
    np.testing.assert_allclose(reached[use], np.outer(size[use], [0.0, 1.0, 0.0]), rtol=1e-12)


def test_the_floor_counts_measured_components_alone(close):
    field = np.array([[30000.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    measured = np.array([[True, True, True], [True, False, False]])
    close(
        floor_rms_nT(field, 10.0, 1e-3, measured),
        np.sqrt(100.0 + 900.0 * 2 / 4),
        atol=1e-9,
        unit="nT",
        because="two of four components feel 30 nT of attitude error",
    )


def test_a_walk_is_predicted_alike_one_axis_at_a_time_or_together(close):
    rng = np.random.default_rng(2)
    rows, seconds = 80, 10.0 * np.arange(80)
    data = rng.standard_normal((rows, 3)).cumsum(axis=0) * 20.0
    kept = np.ones(rows, dtype=bool)
    kept[10] = False
    axes = RowAxes(
        kept, np.broadcast_to(np.eye(3), (rows, 3, 3)), np.ones((rows, 3), dtype=bool), np.zeros((rows, 3)), np.eye(3)
    )
    wanted = one_axis_at_a_time(data, seconds, kept, 3.0, 15.0)
    for found in (one_step(data, seconds, kept, 3.0, 15.0, axes), one_step(data, seconds, kept, 3.0, 15.0)):
        for value, witness in zip(found, wanted, strict=True):
            close(value, witness, atol=1e-6, unit="nT", because="the same filter")


def one_axis_at_a_time(residual_nT, seconds, kept, rate, noise_nT):
    """The Kalman filter of a local level with the same scalar variance on each axis."""
    left, level, variance, unsure = residual_nT.copy(), np.zeros(3), 1e6 * noise_nT**2, []
    for row, since in enumerate(np.diff(seconds, prepend=seconds[0])):
        variance += rate**2 * since
        left[row] = residual_nT[row] - level
        if not kept[row]:
            continue
        if variance < 1e3 * noise_nT**2:
            unsure.append(variance)
        gain = variance / (variance + noise_nT**2)
        level = level + gain * left[row]
        variance *= 1.0 - gain
    return left, float(np.sqrt(np.mean(unsure)))


def test_a_spike_stands_out_among_rows_of_which_half_are_not_measured():
    rng = np.random.default_rng(4)
    rows = 300
    measured = np.ones((rows, 3), dtype=bool)
    measured[::2, 1:] = False
    residual = np.where(measured, 10.0 * rng.standard_normal((rows, 3)), 0.0)
    residual[101, 1] = 400.0
    assert standing_out(residual, measured=measured)[101, 1] > 6.0
    weights = first_weights(residual, np.zeros((rows, 3, 0)), measured)
    assert weights[101, 1] == 0.0 and np.all(weights[~measured] == 0.0)
    assert int(((weights <= 0) & measured).sum()) == 1


def test_what_a_turn_does_to_a_row_with_attitude_comes_through_the_matrix_of_the_sensor(close):
    sensor = Magnetometer(TRUE_S, TRUE_B_NT)
    problem = pose(flight(), load_field("igrf14"), budget=Budget(10.0, 0.0, 1e-3), instrument=sensor)
    theta, field = np.array([2e-6, -1e-6, 3e-6]), problem.field_B_nT
    moved = (Rotation.from_rotvec(theta).apply(field) - field) @ np.linalg.inv(np.eye(3) + TRUE_S).T
    close(problem.noise_image_nT @ theta, moved, atol=1e-6, unit="nT", because="second order: 7e-12 of 5e4 nT")


def test_axes_do_not_see_what_a_turn_does_through_a_wrong_matrix(close):
    rng = np.random.default_rng(9)
    matrix = np.eye(3) + 0.05 * rng.standard_normal((3, 3))
    field = 30000.0 * rng.standard_normal((50, 3))
    known = np.zeros(50, dtype=bool)
    axes = row_axes(known, field, np.zeros((50, 3)), matrix, 1.0)
    moved = np.cross(rng.standard_normal((50, 3)), field) @ np.linalg.inv(matrix).T
    close(
        axes.in_row_axes(moved)[:, 0],
        np.zeros(50),
        atol=1e-9 * 3e4,
        unit="nT",
        because="(I + S)^T B is across (I + S)^-1 (theta x B)",
    )
    nadir = np.where(np.arange(50)[:, None] < 25, Rotation.random(50, random_state=9).apply([0.0, 0.0, 1.0]), 0.0)
    turn = np.where(nadir == 0.0, rng.standard_normal((50, 3)), 0.7 * nadir)  # about nadir where it is known
    axes = row_axes(known, field, nadir, matrix, 1.0)
    turned = (Rotation.from_rotvec(turn).apply(field) - field) @ np.linalg.inv(matrix).T
    close(axes.without_turn(turned, field), np.zeros((50, 3)), atol=1e-9 * 3e4, unit="nT", because="sizes are kept")
    longer = 100.0 * nadir @ np.linalg.inv(matrix).T  # along nadir nothing turns
    close(axes.without_turn(longer, field)[:25], longer[:25], atol=1e-9 * 3e4, unit="nT", because="rounding")
    close(axes.fitting_turn(turned, field)[:25], turn[:25], atol=1e-9, unit="rad", because="an angle about nadir")
