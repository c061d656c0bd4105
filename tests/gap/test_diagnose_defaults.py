"""What a diagnosis says when nobody declared the noise, and when what is left is more than was declared."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomli_w
from worlds import scenario_text

import fluxtwin
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.held_out.held_out import predict_blocks
from fluxtwin.gap.hypotheses.blocks import Block, blocks
from fluxtwin.gap.hypotheses.candidates import PerturbedDesign
from fluxtwin.gap.noise.whitening import NoiseModel, make_whitener
from fluxtwin.gap.posterior import explanations
from fluxtwin.gap.posterior.structured import Structured
from fluxtwin.gap.problem.problem import Budget, Problem, _velocity
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.gap.report import words
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = [pytest.mark.closure, pytest.mark.usefixtures("lawless")]

README = Path(__file__).parents[2] / "README.md"
DECLARED = Budget(20.0, 10.0, float(np.radians(0.1)), 300.0)


def readme_scenario(seed: int = 1) -> Scenario:
    """The scenario that the README shows."""
    text = re.search(r"```toml\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    assert text is not None
    return parse_scenario(text.group(1), where="README.md").model_copy(update={"seed": seed})


HALF = {"schedule.segments": [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 300.0, "step_s": 20.0}]}
"""The same five hours in half the rows, where what is put in stands far above the noise."""


@pytest.fixture(scope="module")
def record() -> Telemetry:
    return simulate(readme_scenario())[0]


@pytest.fixture(scope="module")
def declared(record: Telemetry) -> Diagnosis:
    return asked(record, DECLARED)


def asked(record: Telemetry, budget: Budget | None = None) -> Diagnosis:
    return diagnose(record, load_field("igrf14"), budget=budget)


def test_the_readme_scenario_has_no_gap_without_any_flag(record: Telemetry) -> None:
    """0.1 deg over 300 s, declared by nobody: found to a third, and named as what was assumed."""
    found = asked(record)
    assert found.verdict == "no_gap"
    sigma, tau = (found.assumed[name] for name in ("attitude_sigma_deg", "attitude_tau_s"))
    assert sigma["source"] == tau["source"] == "found"
    assert abs(np.log(sigma["value"] / 0.1)) < 0.3 and abs(np.log(tau["value"] / 300.0)) < 0.7
    assert "Not declared, so estimated from these data" in found.sentence and "--attitude-sigma-deg" in found.sentence


def test_a_clock_that_is_a_little_late_is_not_called_the_orbit_alone() -> None:
    """Pointing to the Earth, 3 s late are 23 km along the track and a turn of 0.2 deg that the calibration takes: the two
    images have a correlation of 0.99. That of the clock is made of an attitude with errors, and must not lose by them."""
    late = readme_scenario().updated({"effects.time_tag_offset": {"offset_s": 3.0}})
    found = asked(simulate(late)[0])
    assert found.verdict == "effect" and set(found.effects[0].group) >= {"along_track_error", "time_tag_offset"}
    stages = found.where.probabilities["stage"]
    assert min(stages["time"], stages["orbit"]) > 0.3 and {found.where.stage, *found.where.equivalent} >= {
        "time",
        "orbit",
    }


def test_a_sure_name_whose_share_is_not_measured_says_why() -> None:
    """Before and after differ by less than chance does: what is sure, what is not, and what would measure it."""
    late = readme_scenario().updated({"effects.time_tag_offset": {"offset_s": 1.0}})
    found = asked(simulate(late)[0])
    assert found.verdict == "effect" and found.gap.closed is None
    for part in (
        "the probability that this is chance is less than 1e-12",
        f"its signal is {found.effects[0].visible_nT:.1f} nT rms",
        f"{found.gap.before_nT:.1f} nT rms where {found.gap.floor_nT:.1f} nT are expected without it",
        "more data of the same kind would measure it",
    ):
        assert part in found.sentence


def test_an_attitude_error_that_would_explain_all_is_given_with_its_size(declared: Diagnosis) -> None:
    gap = declared.gap
    assert "undeclared error of the reference attitude of 0.3 deg" in words.no_gap(gap, float(np.radians(0.3)))
    assert "undeclared" not in words.no_gap(gap, None)


def test_rounding_that_lasts_over_rows_is_no_gap() -> None:
    """Rows a second apart, a step of 117 nT: a reading stays in a step for four rows of five, and so does its error."""
    segment = {"start_utc": "2026-03-01T00:00:00Z", "duration_min": 60.0, "step_s": 1.0}
    coarse = {"magnetometer.noise_nT": 13.7, "magnetometer.lsb_nT": 117.0, "schedule.segments": [segment]}
    budget = replace(DECLARED, noise_nT=13.7, lsb_nT=117.0)
    found = asked(simulate(readme_scenario().updated(coarse))[0], budget)
    assert found.verdict == "no_gap" and found.provenance["rounding_lasts_rows"] == 4


def test_a_late_sensor_is_not_blamed_on_the_orbit_alone() -> None:
    """10 s on a vehicle that keeps to the Earth look nearly like 77 km along the orbit; the linear image of the clock is
    made of an attitude that errs itself, so only the refit distinguishes the two."""
    config = readme_scenario().updated({"effects.time_tag_offset": {"offset_s": 10.0}, **HALF})
    found = asked(simulate(config)[0])
    assert found.verdict == "effect"
    assert "time_tag_offset" in found.effects[0].group
    assert [one.name for one in found.effects] in (["time_tag_offset"], ["sensor_lag"])


def test_fewer_blocks_are_no_reason_to_search_again(record: Telemetry, monkeypatch: pytest.MonkeyPatch) -> None:
    """An attitude error that nobody declared makes some blocks of it: the search asked nothing of them."""
    half = record.select(slice(None, None, 2))
    line_nT = 150.0 * np.outer(np.cos(0.0233 * 20.0 * np.arange(len(half))), [0.6, -0.5, 0.62])
    structured = half.replace(mag_B_nT=half.mag_B_nT + line_nT)
    begin = explanations.begin
    searches: list[object] = []
    asked_for: list[object] = []

    def fewer(problem: Problem, perturbed: PerturbedDesign | None = None) -> tuple[Block, ...]:
        asked_for.append(problem)
        return blocks(problem, perturbed)[len(asked_for) - 1 :]

    monkeypatch.setattr(explanations, "begin", lambda *args, **given: searches.append(args) or begin(*args, **given))
    monkeypatch.setattr(Structured, "_one_more", lambda self, answer: None)
    found = asked(structured)
    usual, searches[:] = len(searches), []
    monkeypatch.setattr("fluxtwin.gap.diagnose.blocks", fewer)
    assert asked(structured).verdict == found.verdict == "unknown"
    assert len(asked_for) == 2
    assert len(searches) == usual


def test_what_is_declared_is_not_said_to_be_found(declared: Diagnosis) -> None:
    assert declared.verdict == "no_gap"
    assert {one["source"] for one in declared.assumed.values()} == {"declared"}
    assert "Not declared" not in declared.sentence


def test_outliers_are_a_finding(record: Telemetry) -> None:
    """Two axes exchanged in twelve rows, here and there: no single bit, no structure, and not silence."""
    reading, rows = np.array(record.mag_B_nT), np.arange(100, 1800, 140)[:12]
    reading[rows] = reading[rows][:, [2, 1, 0]]
    found = asked(record.replace(mag_B_nT=reading), DECLARED)
    assert found.verdict == "unknown" and found.where.stage == "telemetry"
    stages = found.where.probabilities["stage"]
    assert stages["sensor"] + stages["telemetry"] >= 0.9 - 1e-9
    assert found.samples["cut"] == 12
    assert "12 rows have outliers of more than six sigma, from 2026-03-01T00:16:40" in found.sentence
    assert "apart from these rows there is no gap" in found.sentence
    assert found.law is None and "law" not in found.sentence, "of what is as expected there is none to look for"


def test_outliers_of_a_long_record_are_counted_in_every_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """One row in two is enough for what is slow; outliers are found in any, here of just as many as are looked at."""
    for module in ("diagnose.MOST_ROWS_FAST", "detectors.lines.MOST_ROWS_FAST"):
        monkeypatch.setattr(f"fluxtwin.gap.{module}", 3000)
    monkeypatch.setattr("fluxtwin.gap.diagnose.MOST_ROWS", 2500)
    segment = {"start_utc": "2026-03-01T00:00:00Z", "step_s": 5.0, "samples": 3000}
    record = simulate(readme_scenario().updated({"schedule.segments": [segment]}))[0]
    reading, rows = np.array(record.mag_B_nT), np.arange(101, 2900, 305)
    assert {*(rows % 2)} == {0, 1}
    reading[rows, rows % 3] += 8000.0
    found = asked(record.replace(mag_B_nT=reading), DECLARED)
    assert found.provenance["rows_thinned_by"] == 2
    assert f"{rows.size} rows have outliers of more than six sigma" in found.sentence


def test_a_faint_fast_line_does_not_take_the_name_from_a_large_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that only the full rate shows: alone it is unknown, beside a hundred times its energy it is what is left."""
    monkeypatch.setattr("fluxtwin.gap.diagnose.MOST_ROWS", 1500)
    segment = {"start_utc": "2026-03-01T00:00:00Z", "step_s": 5.0, "samples": 2000}
    record = simulate(readme_scenario().updated({"schedule.segments": [segment]}))[0]
    line_nT = 7.0 * np.sin(2.0 * np.pi / 13.0 * 5.0 * np.arange(2000))[:, None] * [1.0, 0.0, 0.0]
    step_nT = np.where(np.arange(2000) > 950, 500.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    alone = asked(record.replace(mag_B_nT=record.mag_B_nT + line_nT), DECLARED)
    both = asked(record.replace(mag_B_nT=record.mag_B_nT + line_nT + step_nT), DECLARED)
    assert alone.verdict == "unknown" and "a line at a period of 13 s, in the full rate" in alone.sentence
    assert both.verdict == "effect" and [one.name for one in both.effects] == ["bias_step"]
    assert both.gap.shape_incomplete and both.sentence.startswith("The gap is explained in part by ")
    assert "some smaller structure remains" in both.sentence


def test_a_large_step_and_loud_noise_beside_it_are_measured() -> None:
    """The first fit takes a part of the step for S, and some smaller structure is no reason to be silent on the noise."""
    record = simulate(readme_scenario().updated(HALF))[0]
    row = np.arange(len(record))
    step_nT = np.where(row > len(record) // 2, 800.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    line_nT = 20.0 * np.sin(2.0 * np.pi * 20.0 * row / 130.0)[:, None] * [1.0, 0.0, 0.0]
    (step,) = asked(record.replace(mag_B_nT=record.mag_B_nT + step_nT), DECLARED).effects
    b_y = step.parameters["b_y"]
    assert step.name == "bias_step" and b_y.value == pytest.approx(-0.99 * 800.0, abs=4.0 * b_y.sigma)  # S_yy is -0.01
    louder_nT = 60.0 * np.random.default_rng(7).standard_normal((len(record), 3))
    loud = asked(record.replace(mag_B_nT=record.mag_B_nT + step_nT + line_nT + louder_nT), DECLARED)
    assert loud.gap.shape_incomplete
    found = {one.name: one for one in loud.effects}
    assert set(found) == {"bias_step", "excess_noise"}
    # Of the 20 nT that were declared, 10 % are not known: 0.7 nT of what is added.
    assert found["excess_noise"].parameters["rms"].value == pytest.approx(60.0, abs=3.0)


def test_a_stuck_axis_is_a_finding_and_no_effect(record: Telemetry) -> None:
    """One axis repeats for half an hour: attitude_step and switched_field describe it well, and neither is there."""
    reading = np.array(record.mag_B_nT)
    reading[600:780, 1] = reading[600, 1]
    found = asked(record.replace(mag_B_nT=reading), DECLARED)
    assert found.verdict == "unknown" and not found.effects and found.where.stage == "telemetry"
    assert "180 rows have a stuck reading or a fill value, from 2026-03-01T01:40:00" in found.sentence
    assert "apart from these rows there is no gap" in found.sentence


@pytest.mark.parametrize("rows", [4, 8])
def test_a_few_fill_values_on_end_are_no_noise(record: Telemetry, rows: int) -> None:
    """More than a median over seven rows passes over, fewer than make a stuck reading."""
    reading = np.array(record.mag_B_nT)
    reading[600 : 600 + rows] = -9999.0
    found = asked(record.replace(mag_B_nT=reading))
    assert not found.effects and f"{rows} rows have a stuck reading or a fill value" in found.sentence
    assert "apart from these rows there is no gap" in found.sentence
    assert found.assumed["attitude_sigma_deg"]["value"] < 1.0


def test_more_noise_than_declared_is_never_no_gap(record: Telemetry) -> None:
    """Twice the declared noise, from a heavy-tailed source: no excess_noise, which is Gaussian, and not nothing."""
    heavy = np.random.default_rng(5).standard_t(4, size=(len(record), 3)) / np.sqrt(2.0)
    found = asked(record.replace(mag_B_nT=np.array(record.mag_B_nT) + 35.0 * heavy), DECLARED)
    assert found.verdict == "unknown"
    assert {found.where.stage, *found.where.equivalent} == {"sensor", "telemetry"}
    assert "were expected" in found.sentence


def test_an_attitude_error_reaches_the_reading_through_the_matrix_of_the_sensor() -> None:
    """Whitened by its own image, an error under a matrix of 4 % is white; by theta x B it is not."""
    rng = np.random.default_rng(3)
    rows, sigma_nT, theta_rad = 4000, 2.0, 0.004
    field = 3e4 * np.stack([np.cos(np.arange(rows) / 200.0), np.sin(np.arange(rows) / 170.0), np.ones(rows)], axis=1)
    matrix = np.linalg.inv(np.eye(3) + 0.04 * rng.standard_normal((3, 3)))
    error = np.cross(theta_rad * rng.standard_normal((rows, 3)), field) @ matrix.T
    reading = error + sigma_nT * rng.standard_normal((rows, 3))
    seconds, segment, noise = 10.0 * np.arange(rows), np.zeros(rows), NoiseModel(sigma_nT, theta_rad, 0.0)
    right, wrong = (
        float(np.mean(make_whitener(turn_images(field, m), seconds, segment, noise).apply(reading) ** 2))
        for m in (matrix, None)
    )
    assert abs(right - 1.0) < 4.0 * np.sqrt(2.0 / (3 * rows))  # four standard deviations of a mean of chi-squares
    assert wrong > 2.0


UNIT: Any = SimpleNamespace(apply=lambda columns: columns)


def rows_of(seconds: np.ndarray) -> Any:
    """Rows that all have an attitude, as far as a prediction of blocks looks at them."""
    measured = np.ones((seconds.size, 3), dtype=bool)
    setting = SimpleNamespace(seconds=seconds)
    return SimpleNamespace(setting=setting, measured=measured, axes=None, in_row_axes=lambda columns: columns)


def test_a_block_that_the_others_do_not_determine_is_not_predicted() -> None:
    """One column lives in the last fifth alone: nothing is held out there, and nothing explodes."""
    rng = np.random.default_rng(2)
    seconds, kept = np.arange(500.0), np.ones(500, dtype=bool)
    y = rng.standard_normal((500, 3))
    x = np.where(np.arange(500)[:, None, None] >= 400, rng.standard_normal((500, 3, 1)), 1e-9 * np.ones((500, 3, 1)))
    problem = rows_of(seconds)
    known = predict_blocks(problem, UNIT, kept, 1.0, (y, x), (y, x)).counted
    assert known[:400].all() and not known[400:].any()
    five = (5.0 * y, y[..., None])  # five times a column: the others give it exactly
    assert np.abs(predict_blocks(problem, UNIT, kept, 1.0, five, five).before_nT).max() < 1e-9


def test_where_no_part_determines_another_the_residual_is_that_of_the_fit() -> None:
    """A column of its own in each fifth, and one that a waveform has, whose signal of 50 still stands in the residual."""
    rng = np.random.default_rng(3)
    seconds, kept = np.arange(500.0), np.ones(500, dtype=bool)
    noise, signal = rng.standard_normal((500, 3)), rng.standard_normal((500, 3, 1))
    parts = np.eye(5)[np.arange(500) // 100][:, None, :] * rng.standard_normal((500, 3, 1))
    before, after = (noise + 50.0 * signal[..., 0], parts), (noise + 50.0 * signal[..., 0], np.dstack([parts, signal]))
    held = predict_blocks(rows_of(seconds), UNIT, kept, 1.0, before, after)
    assert held.of == "fit"
    assert np.sqrt(np.mean(held.before_nT**2)) > 45.0
    assert np.sqrt(np.mean(held.after_nT**2)) == pytest.approx(np.sqrt(1.0 - 6.0 / 1500.0), abs=4.0 / np.sqrt(3000.0))


def test_what_a_block_predicts_of_another_is_as_wrong_as_it_says() -> None:
    """White noise of 2 nT and twelve columns in 60 rows: held-out residuals have the noise and the error of the prediction,
    whose variance averages to that of the textbook, sigma^2 tr(X_h (X_t' X_t)^-1 X_h') over the components."""
    rng = np.random.default_rng(5)
    seconds, kept = np.arange(60.0), np.ones(60, dtype=bool)
    half: Any = SimpleNamespace(apply=lambda columns: columns / 2.0)
    squares, expected = [], []
    for _ in range(300):
        y, x = 2.0 * rng.standard_normal((60, 3)), rng.standard_normal((60, 3, 12))
        held = predict_blocks(rows_of(seconds), half, kept, 2.0, (y, x), (y, x))
        squares.append(np.mean(held.after_nT[held.counted] ** 2))
        expected.append(4.0 + held.unsure_nT[1] ** 2)
    difference = np.array(squares) - np.array(expected)
    assert abs(difference.mean()) < 4.0 * difference.std() / np.sqrt(300.0)
    assert np.mean(expected) - 4.0 > 8.0 * difference.std() / np.sqrt(300.0)  # without it the test would fail


def test_a_spinner_without_attitude_that_leaves_b_open_is_refused() -> None:
    """Four minutes of a pure spin: the part of b along the axis shows by nothing but the slow change of the field."""
    tree = readme_scenario().model_dump(exclude_none=True, mode="json")
    tree["spacecraft"]["inertia_kg_m2"] = [[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]]
    tree["magnetometer"] |= {"noise_nT": 120.0, "b_nT": [60_000.0, -80_000.0, 50_000.0]}
    tree["attitude"] = {"mode": "spin", "spin_axis_N": [0.0, 0.0, 1.0], "spin_rate_rpm": 8.0}
    tree["schedule"] = {"segments": [{"start_utc": "2026-03-01T00:00:00Z", "duration_min": 4.0, "step_s": 1.0}]}
    spun = simulate(parse_scenario(tomli_w.dumps(tree), where="spinner"))[0]
    with pytest.raises(NoAnswer, match=r"b\d by .* open"):
        diagnose(spun.replace(q_NB=None), load_field("igrf14"))


def test_passes_over_stations_with_a_fine_sensor_have_no_gap() -> None:
    """Ten minutes a pass, hours apart, S of some per cent: plain least squares takes the slow attitude errors up in S, and
    the noise must not be built on that S: built so, there is a gap."""
    config = readme_scenario().updated(
        {
            "magnetometer": {
                "S": [[0.03, 0.01, -0.006], [-0.008, -0.025, 0.01], [0.006, -0.01, 0.02]],
                "b_nT": [1500.0, -800.0, 300.0],
                "noise_nT": 2.0,
                "lsb_nT": 0.5,
            },
            "attitude.reference": {"sigma_deg": 0.25, "tau_s": 500.0},
            "schedule.segments": [
                {"start_utc": f"2026-03-01T{hour:02d}:{minute:02d}:00Z", "duration_min": 10.0, "step_s": 2.4}
                for hour, minute in ((0, 0), (3, 10), (8, 40), (14, 20), (19, 50))
            ],
        }
    )
    found = asked(simulate(config)[0], Budget(2.0, 0.5, float(np.radians(0.25))))
    assert found.verdict == "no_gap", found.sentence


def test_the_velocity_of_two_rows_is_the_slope_of_their_positions() -> None:
    r_N_km = np.array([[7e3, 0.0, 0.0], [7e3, 15.0, 1.0]])
    two = Telemetry(np.array([0, 2], dtype="datetime64[s]"), np.zeros((2, 3)), r_N_km=r_N_km)
    assert np.array_equal(_velocity(two), [[0.0, 7.5, 0.5]] * 2)


def test_what_could_not_be_tested_is_said_beside_what_follows_the_same() -> None:
    assert words.not_tested([]) == ""
    one = words.not_tested(["axis_skew"])
    assert one == " These data cannot test axis_skew, which follows the same quantity and may be the cause instead."
    assert "which follow the same" in words.not_tested(["axis_skew", "sensor_lag"])


def test_wrong_readings_close_no_share_of_a_gap(record: Telemetry) -> None:
    """A few flipped bits, and an attitude error half as large again as declared: they are excluded, and close nothing."""
    reading, rows = np.array(record.mag_B_nT), np.arange(90, 1700, 270)
    code = np.rint(reading[rows, 0] / 10.0).astype(np.int64)
    reading[rows, 0] += 10.0 * ((code ^ 1024) - code)
    declared = replace(DECLARED, attitude_sigma_rad=0.7 * (DECLARED.attitude_sigma_rad or 0.0))
    found = asked(record.replace(mag_B_nT=reading), declared)
    assert [one.name for one in found.effects] == ["bit_errors"]
    assert "the wrong readings are excluded from the figures" in found.sentence and "closes" not in found.sentence


def test_many_bits_that_flip_are_no_noise_though_few_of_them_stand_out(record: Telemetry) -> None:
    """One reading in thirty has a bit of 160 nT turned round: eight times its noise, but four and a half times the noise
    that there seems to be."""
    lsb_nT, bit, rng = 10.0, 4, np.random.default_rng(8)
    code = np.rint(record.mag_B_nT / lsb_nT).astype(np.int64)
    hit = rng.random(code.shape) < 1.0 / 30.0
    turned = record.replace(mag_B_nT=lsb_nT * np.where(hit, code ^ (1 << bit), code))
    found = asked(turned, DECLARED)
    (bits,) = found.effects
    assert (bits.name, bits.settings["bit"]) == ("bit_errors", bit), found.sentence
    rate = bits.parameters["rate"]
    assert rate.value == pytest.approx(hit.mean(), abs=4.0 * rate.sigma) and rate.sigma < 0.1 * rate.value


def test_flips_that_the_noise_hides_are_named_and_counted_as_noise(record: Telemetry) -> None:
    """One reading in forty has a bit of 80 nT turned round, four times its noise: few stand out, and the others stay in the
    figures, in what is expected too."""
    lsb_nT, bit, rng = 10.0, 3, np.random.default_rng(9)
    code = np.rint(record.mag_B_nT / lsb_nT).astype(np.int64)
    hit = rng.random(code.shape) < 1.0 / 40.0
    found = asked(record.replace(mag_B_nT=lsb_nT * np.where(hit, code ^ (1 << bit), code)), DECLARED)
    (bits,) = found.effects
    assert (bits.name, bits.settings["bit"]) == ("bit_errors", bit), found.sentence
    assert bits.parameters["rate"].value == pytest.approx(hit.mean(), abs=4.0 * bits.parameters["rate"].sigma)
    assert found.gap.after_nT == pytest.approx(found.gap.floor_with_effects_nT, rel=0.05)
    assert "excluded from the figures" not in found.sentence


@pytest.mark.parametrize("with_scenario", [False, True])
def test_the_roll_of_a_star_tracker_is_no_noise_of_the_magnetometer(with_scenario: bool) -> None:
    text = scenario_text(
        """
[attitude]
mode = "earth_pointing"
yaw_rms_deg = 6.0
roll_rms_deg = 6.0
pitch_rms_deg = 6.0
[attitude.reference]
source = "star_tracker"
[star_tracker]
noise_arcsec = 72.0
roll_noise_arcsec = 360.0
[magnetometer]
S = [[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]
b_nT = [900.0, -500.0, 250.0]
noise_nT = 20.0
lsb_nT = 10.0
""",
        seed=1,
        segment="duration_min = 300.0, step_s = 20.0",
    )
    scenario = parse_scenario(text)
    record, _ = simulate(scenario)
    found = fluxtwin.diagnose(record, scenario=scenario if with_scenario else None)
    assert found.verdict == "no_gap"
    assert found.gap.before_nT == pytest.approx(found.gap.floor_nT, rel=0.05)  # 0.6 % by chance of 2,700 readings


def test_a_body_rate_made_of_attitude_errors_is_no_gap() -> None:
    """Ten turns a minute: of the rate only what errors of the attitude add varies. The fit alone says how large."""
    text = scenario_text(
        """
[attitude]
mode = "spin"
spin_rate_rpm = 10.0
[attitude.reference]
sigma_deg = 0.2
tau_s = 600.0
[magnetometer]
noise_nT = 20.0
lsb_nT = 10.0
""",
        inertia_kg_m2=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.4]],
        segment="samples = 1200, step_s = 1.0",
    )
    assert asked(simulate(parse_scenario(text))[0]).verdict == "no_gap"


@pytest.mark.parametrize(
    ("altitude_km", "limit_nT", "rate_deg_s", "step_s"),
    [
        pytest.param(550.0, 42_500.0, [0.02, 0.03, 0.9], 8.0, id="an axis repeats its limit to the last digit"),
        pytest.param(650.0, 42_000.0, [0.6, 0.5, 2.9], 10.0, id="a few rows of every turn"),
    ],
)
def test_a_range_that_is_too_small_is_named(
    altitude_km: float, limit_nT: float, rate_deg_s: list[float], step_s: float
) -> None:
    text = scenario_text(
        f'[attitude]\nmode = "tumble"\nrate_deg_s = {rate_deg_s}\n[attitude.reference]\nsigma_deg = 0.08\n'
        "[magnetometer]\nnoise_nT = 120.0\nlsb_nT = 25.0\n"
        f"[effects.saturation]\ndepth_nT = 1.0\nfull_scale_nT = {limit_nT}\n",
        segment=f"samples = 1900, step_s = {step_s}",
        altitude_km=altitude_km,
        inertia_kg_m2=[[0.05, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.04]],
    )
    record = simulate(parse_scenario(text))[0]
    found = fluxtwin.diagnose(record, noise_nT=120.0, lsb_nT=25.0, attitude_sigma_deg=0.08)
    assert [effect.name for effect in found.effects] == ["saturation"]
    # The depth is that below the largest field of an axis, which the record does not hold.
    depth = found.effects[0].parameters["depth"]
    largest = np.abs(
        simulate(parse_scenario(text.split("[effects.saturation]")[0] + text[text.index("[schedule]") :]))[1].field_B_nT
    ).max()
    assert abs(largest - depth.value - limit_nT) < 150.0 + 3.0 * depth.sigma


@pytest.mark.parametrize(("rate_deg_s", "rows"), [([0.02, 0.03, 0.12], 3), ([0.1, 0.05, 0.02], 4)])
def test_a_few_rows_beyond_the_range_are_no_spikes(rate_deg_s: list[float], rows: int) -> None:
    """They stand out by tens of sigma, all towards nought, and nothing repeats."""
    text = scenario_text(
        f'[attitude]\nmode = "tumble"\nrate_deg_s = {rate_deg_s}\n[attitude.reference]\nsigma_deg = 0.05\n'
        "[magnetometer]\nnoise_nT = 45.0\nlsb_nT = 16.0\n",
        segment="samples = 660, step_s = 60.0",
        altitude_km=600.0,
        inertia_kg_m2=[[0.05, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.04]],
    )
    size_nT = np.sort(np.abs(simulate(parse_scenario(text))[1].field_B_nT).ravel())[::-1]
    limit_nT = float(size_nT[rows - 1 : rows + 1].mean())
    clipped = text.replace(
        "[schedule]", f"[effects.saturation]\ndepth_nT = 1.0\nfull_scale_nT = {limit_nT}\n[schedule]"
    )
    record = simulate(parse_scenario(clipped))[0]
    found = fluxtwin.diagnose(record, noise_nT=45.0, lsb_nT=16.0, attitude_sigma_deg=0.05)
    assert [effect.name for effect in found.effects] == ["saturation"], found.sentence
