"""Good records that once were flagged, and why they are not: each rule here by what it must not do, and must still do."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from worlds import scenario_text

from fluxtwin.calib.checks.check import check_file, check_telemetry
from fluxtwin.calib.checks.evidence import scalar_evidence, slope_of_form
from fluxtwin.calib.checks.outliers import STANDS_OUT, _deviation, _limit
from fluxtwin.calib.checks.stuck import _stuck
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth.field import FieldModel, load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))

from traps_cases import GOOD, Case, fly, write

pytestmark = pytest.mark.property


@pytest.fixture(scope="module")
def model() -> FieldModel:
    return load_field("igrf14")


def flown(model: FieldModel, seed: int, number: int) -> Case:
    return fly(stream(seed, f"traps.{GOOD}.{number}"), model, GOOD)


@pytest.mark.parametrize(
    ("seed", "number"),
    [
        (131313, 118),  # a coarse step on a slow axis: runs of it are no stuck axis
        (131313, 204),  # an attitude that is held: another convention fits another draw of its errors
        (777, 684),
        (777, 1),  # |B| alone, on a short arc: the form takes the noise up, and a few readings stand out
        (777, 55),  # the first row, on a slope
        (777, 292),  # |B| alone: a wrong hour takes up more of the noise than the right one
        (777, 506),
        (777, 852),  # |B| alone: so do positions in another frame
    ],
)
def test_a_good_record_is_clean(seed: int, number: int, model: FieldModel, tmp_path: Path) -> None:
    case = flown(model, seed, number)
    found = check_file(write(case, tmp_path / "record.csv"), model)
    assert [(trap.code, trap.text) for trap in found.traps] == [], case.label


def test_a_stretch_of_zeros_is_one_trap_with_its_first_row(model: FieldModel, tmp_path: Path) -> None:
    case = flown(model, 777, 3)
    case.mag[60:100] = 0.0
    (found,) = check_file(write(case, tmp_path / "record.csv"), model).traps
    assert (found.code, found.row_count, found.rows[0]) == ("stuck_values", 40, 61), found.text


@pytest.mark.parametrize("moving", [10, 40, 400])
def test_a_reading_that_stands_still_to_the_end_is_stuck(moving: int, model: FieldModel, tmp_path: Path) -> None:
    """However few the rows before it are."""
    case = flown(model, 777, 3)
    case.mag[moving:] = case.mag[moving]
    (found,) = check_file(write(case, tmp_path / "record.csv"), model).traps
    assert (found.code, found.row_count, found.rows[0]) == ("stuck_values", len(case.time) - moving, moving + 1)


def test_fifty_stuck_runs_and_no_other_are_all_found() -> None:
    """Of 100 rows each, between twice as many that change: as many runs as are looked at, and no other to compare with."""
    rng = np.random.default_rng(2)
    values = rng.normal(0.0, 1e4, 15000)
    held = np.arange(15000) % 300 < 100
    values[held] = np.repeat(values[::300], 100)
    time = np.datetime64("2020-03-01", "ns") + np.arange(15000) * np.timedelta64(1, "s")
    found = _stuck(values[:, None], time)
    assert np.array_equal(found, held)


def test_the_slope_of_a_form_is_its_gradient() -> None:
    rng = np.random.default_rng(1)
    form, m = rng.normal(size=9), rng.normal(size=3)

    def value(at: np.ndarray) -> float:
        pairs = [at[i] * at[j] for i in range(3) for j in range(i, 3)]
        return float(np.dot(form, [*pairs, *at]))

    assert np.allclose(slope_of_form(m[None], form)[0], approx_fprime(m, value, 1e-7), atol=1e-5)  # differences of 1e-7


@pytest.mark.parametrize("S33", [0.0, 0.1])
def test_the_misfit_of_the_size_is_that_of_the_readings(S33: float) -> None:
    """A scale of 1.1 in the readings is no larger noise, and an arc of 50 deg does not make it smaller."""
    rng, noise_nT = np.random.default_rng(2), 40.0
    angle = np.linspace(0.0, 0.9, 300)
    field = 3e4 * np.stack([np.cos(angle), np.sin(angle), 0.2 + 0.1 * angle**2], axis=1)
    reading = field / np.array([1.0, 1.0, 1.0 + S33]) + 500.0 + rng.normal(0.0, noise_nT, field.shape)
    size = np.linalg.norm(field, axis=1)
    found = scalar_evidence(10.0 * np.arange(300.0), reading, size[None]).misfit_nT[0]
    assert abs(found / noise_nT - 1.0) < 4.0 / np.sqrt(2 * 300)  # four standard deviations of an rms of 300


def test_a_slope_deviates_nowhere_and_a_reading_far_off_does_at_the_ends_too() -> None:
    slope = np.outer(np.arange(40.0), [60.0, -30.0, 5.0])
    ends = np.array([0]), np.array([39])
    assert not _deviation(slope, *ends)[0].any()
    for rows in ([0], [3], [20], [39], [0, 1], [0, 6], [32, 39]):
        wrong = slope.copy()
        wrong[rows] += 30_000.0
        away = np.linalg.norm(_deviation(wrong, *ends)[0], axis=1)
        assert np.flatnonzero(away > 29_000.0).tolist() == rows


def test_the_ends_of_passes_are_no_outliers_and_a_reading_far_off_is_one(model: FieldModel) -> None:
    """Arcs of ten minutes, three hours apart: from one to the next the slow error of the attitude is another."""
    text = scenario_text(
        '[attitude]\nmode = "earth_pointing"\n[attitude.reference]\nsigma_deg = 0.3\ntau_s = 1500.0\n'
        "[magnetometer]\nS = [[0.03, 0.0, 0.0], [0.0, -0.02, 0.0], [0.0, 0.0, 0.03]]\nnoise_nT = 3.0\n",
        segment="samples = 7000, step_s = 10.0",
    )
    whole = simulate(parse_scenario(text))[0]
    record = whole.select(np.flatnonzero(np.arange(7000) % 1000 < 60))
    assert check_telemetry(record, model).traps == ()
    wrong = np.array(record.mag_B_nT)
    wrong[[60, 61, 119]] += 400.0  # the first two rows of the second arc, and its last one
    (found,) = check_telemetry(record.replace(mag_B_nT=wrong), model).traps
    assert found.code == "outliers" and found.rows == (61, 62, 120)


def test_readings_far_off_in_bursts_that_are_shorter_than_the_window_are_outliers(model: FieldModel) -> None:
    record = simulate(parse_scenario(scenario_text("", segment="samples = 4000, step_s = 10.0")))[0]
    record = record.select(np.flatnonzero(np.arange(4000) % 40 < 8))
    wrong = np.array(record.mag_B_nT)
    wrong[[100, 333, 500]] += 30_000.0
    assert check_telemetry(record, model).traps == ()
    (found,) = check_telemetry(record.replace(mag_B_nT=wrong), model).traps
    assert found.code == "outliers" and found.rows == (101, 334, 501)


def test_the_tail_of_one_scatter_is_no_outlier_and_a_reading_far_beyond_it_is() -> None:
    """Of Student's t with four degrees of freedom, one row in 750 lies beyond 8, and as many again between 6 and 8."""
    tail = np.abs(stream(3, "tail").standard_t(4.0, 20_000))
    assert np.count_nonzero(tail > STANDS_OUT) > 10
    beyond = _limit(tail)
    assert np.count_nonzero(tail > beyond) <= 3
    assert _limit(np.append(tail, 40.0 * tail.max())) < 40.0 * tail.max()
    assert _limit(np.append(np.abs(stream(3, "core").normal(size=4000)), [9.0, 12.0])) == STANDS_OUT


@pytest.mark.parametrize("attitude", [True, False])
def test_inertial_positions_under_earth_fixed_names_are_named(
    attitude: bool, model: FieldModel, tmp_path: Path
) -> None:
    case = flown(model, 777, 3)
    case.earth_fixed, case.q = False, case.q if attitude else None
    path = write(case, tmp_path / "record.csv")
    header, *rows = path.read_text("utf-8").splitlines()
    for axis in "xyz":
        header = header.replace(f"r_{axis}_km", f"ecef_{axis}_km")
    names = header.split(",")
    kept = [place for place, name in enumerate(names) if not name.startswith("v_")]
    lines = [",".join(line.split(",")[place] for place in kept) for line in (header, *rows)]
    path.write_text("\n".join([*lines, ""]), "utf-8")
    (found,) = check_file(path, model).traps
    assert found.code == "position_frame" and "inertial (GCRS), not Earth-fixed" in found.text


def test_sizes_have_two_digits_and_no_exponent(model: FieldModel, tmp_path: Path) -> None:
    case = flown(model, 777, 3)
    case.mag[70] += 40_000.0
    (found,) = check_file(write(case, tmp_path / "record.csv"), model).traps
    assert found.code == "outliers" and found.rows == (71,)
    assert re.search(r"neighbours by \d{5} nT, \d+ times the scatter", found.text), found.text
