"""The ST5 study end to end with a small Monte Carlo: what it promises, and the reach of its methods."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.spin.calibrate import fit_spin
from fluxtwin.calib.spin.rows import assemble_spin
from fluxtwin.calib.spin.start import blind_start
from fluxtwin.plots.spinners import draw_attitude_error
from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.st5 import mission, study
from fluxtwin.scenarios.st5.mission import terms_of, truth_terms
from fluxtwin.scenarios.st5.study import filtered, options, settings, words
from fluxtwin.scenarios.words import Claim
from fluxtwin.sim.earth.field import load_field

pytestmark = pytest.mark.closure

COARSE = {"walks_rad_s": np.geomspace(5e-5, 1e-2, 3).tolist(), "factors": np.geomspace(1.0, 12.0, 3).tolist()}
"""The search over the study's range with fewer points; the choices move by 0.2 %."""


@pytest.fixture(scope="module")
def results() -> Numbers:
    return study.compute(runs=3, starts=2, **COARSE)


@pytest.fixture(scope="module")
def claims(results: Numbers) -> dict[int, Claim]:
    return {claim.id: claim for claim in words().judge(hour=results.hour)}


@pytest.fixture(scope="module")
def summary(results: Numbers) -> dict[str, Any]:
    return json.loads(json.dumps(study.present(results).summary, allow_nan=False))


def test_the_scenario_holds_the_abstracts_truth() -> None:
    """S and b of equation 1 in the scenario are the abstract's b and turn, to the digits written there."""
    printed, meter = mission.published(), mission.scenario().magnetometer
    R = Rotation.from_rotvec(-np.radians(printed["misalignment_deg"])).as_matrix()
    assert np.abs(np.array(meter.S) - (R.T - np.eye(3))).max() < 1e-11
    truth = Calibration(R.T - np.eye(3), -R.T @ np.array(printed["b_mG"]) * 100.0)
    terms = terms_of(truth)
    assert np.abs(terms.b_mG - printed["b_mG"]).max() < 1e-9
    assert np.abs(terms.misalignment_deg - printed["misalignment_deg"]).max() < 1e-9
    assert np.abs(np.degrees(Rotation.from_matrix(R.T).as_rotvec()) + printed["misalignment_deg"]).max() > 1.0


def test_the_shared_figures_are_the_packaged_ones(shared: Path) -> None:
    theirs = json.loads((shared / "reference" / "papers" / "st5.json").read_text(encoding="utf-8"))
    ours = mission.published()
    for mine, other in (
        ("inertia_kg_m2", "inertia_kgm2"),
        ("b_mG", "bias_true_mG"),
        ("misalignment_deg", "misalign_true_deg"),
        ("pre_rms_deg", "pre_rms_deg"),
        ("pre_rss_deg", "pre_rss_deg"),
        ("post_rss_deg", "post_rss_deg"),
        ("b_estimated_mG", "bias_est_mG"),
        ("misalignment_estimated_deg", "misalign_est_deg"),
        ("noise_mG", "tam_noise_mG"),
        ("sun_noise_deg", "sun_noise_deg"),
        ("spin_rpm", "spin_rpm"),
    ):
        assert np.array_equal(ours[mine], theirs[other]), mine


def test_the_reach(summary: dict[str, Any]) -> None:
    truth_b, truth_v = summary["truth"]["b_mG"], summary["truth"]["misalignment_deg"]
    assert summary["iterative"]["post_rss_deg"] <= 0.02
    assert summary["batch"]["post_rss_deg"] <= 0.02
    assert np.abs(np.subtract(summary["batch"]["b_mG"], truth_b)).max() < 0.04
    assert np.abs(np.subtract(summary["batch"]["misalignment_deg"], truth_v)).max() < 0.02
    assert summary["pre_rss_deg"] > 5.0 * summary["steps_alone"]["post_rss_deg"]
    assert summary["blind_start"] == {"tried": 2, "found": 2}
    for way in ("iterative", "batch"):
        assert abs(summary[way]["squared_over_noise"] - 1.0) < 0.03
        assert abs(summary[way]["motion"]["inertia_ratio"] - 1.4) < 1e-5


RECOVERED = np.array(
    [-0.00061, -0.01792, 0.02593, 0.01708, -0.00080, 0.03542, -0.02643, -0.03468, -0.00088, -1.12659, 1.86915, -3.07950]
)
"""S row by row and b [mG] of equation 1, by the batch, seed of the scenario; no torquers, so no T."""


def test_the_recovered_S_and_b(results: Numbers, close: Callable[..., None]) -> None:
    """Within the stated sigmas of what was put in, and the numbers themselves, frozen.

    The hour of the scenario's seed is an unkind one: its noise along z has a mean of 2.8 sigma, and b3 and S23 are off by
    3.1 and 3.6. So 4 sigma (one false alarm in 1300 for twelve) here, and 3 sigma for the other seeds, of which none was
    chosen (one in 21 for eighteen).
    """
    for solved in (results.hour.batch, results.hour.iterative):
        assert solved.fit is not None
        found, truth = solved.fit.calibration, results.hour.flight.truth
        off = found.values - np.concatenate([truth.S.ravel(), truth.b_nT])
        assert found.T_nT_per_Am2 is None
        assert np.abs(off / found.sigmas).max() < 4.0
        assert off @ np.linalg.solve(found.covariance, off) < chi2.ppf(0.999, 12)
        values = found.values * np.repeat([1.0, 0.01], [9, 3])
        close(
            values,
            RECOVERED,
            atol=np.repeat([5e-5, 5e-4], [9, 3]),
            unit="1, mG for b",
            because="a tenth of a sigma: both ways solve the same rows",
        )
        misread = values * np.repeat([1.01, 1.0], [9, 3])
        assert np.abs(misread - RECOVERED).max() > 2e-4
    assert np.abs(results.many.pulls).max() < 3.0
    assert (results.many.nees < chi2.ppf(0.999, 12)).all()


def test_the_sigmas_of_b_and_of_the_turn(results: Numbers, close: Callable[..., None]) -> None:
    """b: 2 mG over the root of 28,800 is 0.0118 mG; the turn about the spin also hangs on the sun's 1562 pulses."""
    assert results.hour.batch.fit is not None
    terms = terms_of(results.hour.batch.fit.calibration)
    sizes = [0.01179, 0.01179, 0.01254, 0.00327, 0.00327, 0.00620]
    close(terms.sigma, sizes, atol=2e-5, unit="mG, deg", because="five digits written")
    assert (np.abs(terms.values - truth_terms()) < 4.0 * terms.sigma).all()


STATUS = {55: "put in", 56: "differs", 57: "reproduced", 58: "put in"}
"""Each as it is in a full run; a change is a change of what the report says, and wants a reason."""


def test_every_claim_has_its_status_a_number_and_a_reason(claims: dict[int, Claim]) -> None:
    assert {number: claim.status for number, claim in claims.items()} == STATUS
    assert words().say("counted", claims=list(claims.values())) == (
        "1 of 4 claims reproduced, 2 put in, 0 definitions, 1 differs, 0 not testable"
    )
    assert all(claim.why for claim in claims.values() if claim.status != "reproduced")


def test_the_two_choices_of_settings(results: Numbers, close: Callable[..., None]) -> None:
    """What was used is met, what was not is predicted: 0.24 deg for the printed 0.151, axes off by 0.10 deg."""
    found, printed = results.hour.search, mission.published()
    reason = "the search ends within 1e-3 of its range, and begins on another grid than the report's"
    one, two = found.by_axes, found.by_rss
    near = {"unit": "of the frozen one", "because": reason}
    for choice, pair, axes, sums in (
        (one, (2.40e-3, 3.10), (0.878, 0.849, 1.061), (1.618, 0.2407)),
        (two, (1.97e-4, 8.02), (0.817, 0.816, 1.157), (1.635, 0.1510)),
    ):
        close(np.divide((choice.walk_rad_s, choice.sun_factor), pair), 1.0, atol=0.01, **near)
        close(np.divide(choice.pre_deg, axes), 1.0, atol=0.005, **near)
        close(np.divide((choice.pre_rss_deg, choice.post_rss_deg), sums), 1.0, atol=0.005, **near)
    assert np.abs(one.pre_deg - printed["pre_rms_deg"]).max() < 0.05
    for setting in found.grid:  # no neighbour on the grid is nearer
        assert np.linalg.norm(one.pre_deg - printed["pre_rms_deg"]) < np.linalg.norm(
            setting.pre_deg - printed["pre_rms_deg"]
        )
    exact = [[0.8975, 1.2101, 1.7329], [1.2572, 1.4505, 5.8226], [1.8083, 1.8683, 6.7515]]
    close(found.rss_deg["pre"], exact, atol=1e-3 * np.abs(exact), unit="deg", because="a filter's pass has no choices")
    exact = [[0.0678, 0.0929, 0.1135], [0.1427, 0.1766, 0.2103], [0.3780, 0.3897, 0.4251]]
    close(found.rss_deg["post"], exact, atol=1e-3 * np.abs(exact), unit="deg", because="four digits written")


def test_the_error_after_is_the_filters_not_the_calibrations(results: Numbers) -> None:
    """The abstract's steps and the batch's calibration, 20 times better, give the same with the chosen settings."""
    assert abs(results.hour.steps_alone.rss_deg / results.hour.search.by_axes.post_rss_deg - 1.0) < 0.01


def _met(results: Numbers, changed: Callable[..., Any]) -> Numbers:
    """A world in which the error after calibration came out as the abstract's."""
    scale = mission.published()["post_rss_deg"] / results.hour.steps_alone.rss_deg
    return changed(results, "hour.steps_alone.rss_deg", lambda rss_deg: scale * rss_deg)


def _statuses(results: Numbers) -> dict[int, str]:
    return {claim.id: claim.status for claim in words().judge(hour=results.hour)}


def test_claim_55_in_a_stronger_field_and_another_nutation(results: Numbers, changed: Callable[..., Any]) -> None:
    assert _statuses(changed(results, "hour.flight.truth.field_N_nT", lambda field: 1.34 * field))[55] == "differs"
    other = changed(results, "hour.batch.fit.motion.nutation_deg", 2.1)
    assert _statuses(other)[55] == "differs"


def test_claim_56_could_have_come_out_and_goes_with_noise_or_without_misalignment(
    results: Numbers, changed: Callable[..., Any]
) -> None:
    met = _met(results, changed)
    assert _statuses(met)[56] == "reproduced"
    assert _statuses(changed(met, "hour.steps_alone.rss_deg", lambda rss_deg: 2.0 * rss_deg))[56] == "differs"
    aligned = mission.scenario().updated({"magnetometer.S": np.zeros((3, 3)).tolist(), "magnetometer.b_mG": [0.0] * 3})
    chosen, flight = results.hour.search.by_axes, mission.fly(aligned)
    rows = assemble_spin(flight.telemetry, load_field("igrf14"))
    start = blind_start(rows, mission.noises(), np.eye(3), np.zeros(3)).state.motion
    passed = filtered(rows, rows.B_nT, start, settings(chosen.walk_rad_s, chosen.sun_factor))
    before = np.sqrt((mission.attitude_error_deg(passed.A, flight.truth.q_NB) ** 2).mean(axis=0))
    assert np.linalg.norm(before) < 0.3 * chosen.pre_rss_deg
    assert _statuses(changed(met, "hour.search.by_axes.pre_deg", before))[56] == "differs"


def test_claim_57_with_twice_the_noise_and_with_turns_that_stay(results: Numbers, changed: Callable[..., Any]) -> None:
    """The iteration settles on noisier readings as well, but they leave four times what the stated noise does."""
    segment = {"start_utc": "2006-04-15T00:00:00Z", "samples": 7200, "step_s": 0.125}
    noisy = mission.scenario().updated({"magnetometer.noise_mG": 4.0, "schedule.segments": [segment]})
    fit = fit_spin(assemble_spin(mission.fly(noisy).telemetry, load_field("igrf14")), options("iterative"))
    assert abs(fit.quality["nis_last"] - 4.0) < 0.3
    assert _statuses(changed(results, "hour.iterative.nis", fit.quality["nis_last"]))[57] == "differs"
    assert _statuses(changed(results, "hour.iterative.fit.steps_deg", (2.7, 0.17, 0.03)))[57] == "differs"


@pytest.mark.parametrize(
    ("key", "value"),
    [("b_mG", [1.0, -2.0, 31.0]), ("misalignment_deg", [-2.0, 1.5, 13.0]), ("pre_rms_deg", [0.87, 0.896, 1.156])],
)
def test_claim_58_with_digits_for_brackets_and_another_axis(
    results: Numbers, monkeypatch: pytest.MonkeyPatch, key: str, value: list[float]
) -> None:
    printed = {**mission.published(), key: value}
    monkeypatch.setattr(mission, "published", lambda: printed)
    assert _statuses(results)[58] == "differs"


CURVES = {
    "figure_1": [(0.878, 2.75), (0.849, 2.69), (1.061, 4.43)],
    "figure_2": [(0.0893, 0.596), (0.0893, 0.758), (0.2047, 1.025)],
    "batch": [(0.00666, 0.0149), (0.00666, 0.0151), (0.00699, 0.0142)],
}
"""rms and largest size of X, Y, Z as drawn [deg]."""


def test_the_page_and_the_sizes_of_its_curves(results: Numbers, close: Callable[..., None]) -> None:
    made = study.present(results).page
    assert made is not None
    blocks = {block.name: block for section in made.sections for block in section.figures}
    assert list(blocks) == ["figure_1", "figure_2", "batch", "settings"]
    for name, sizes in CURVES.items():
        drawn = [axes.lines[1].get_ydata() for axes in blocks[name].figure.axes]
        found = [(np.sqrt(np.mean(y**2)), np.abs(y).max()) for y in drawn]
        close(
            np.divide(found, sizes), 1.0, atol=0.01, unit="1", because="three digits written; another grid to begin on"
        )
        assert "simulated" in blocks[name].figure.get_suptitle().lower()
        assert "2006-04-15" in blocks[name].figure.axes[-1].get_xlabel()
    said = " ".join(words for section in made.sections for words in section.paragraphs)
    assert "The abstract's 0.151 deg should be compared with its steps alone" in said
    assert "of its sigma. Chance alone" in said
    assert "only a figure that was not used for the choice counts" in said


def test_what_leaves_the_frame_is_marked() -> None:
    """Five seconds of six times the size do not flatten the hour: an arrow and the panel's title say how far they go."""
    seconds = np.arange(0.0, 3600.0, 0.125)
    error = np.stack([np.sin(2.7 * seconds), np.cos(2.7 * seconds), np.full_like(seconds, 0.3)], axis=1)
    error[:40, 1] *= np.linspace(6.0, 1.0, 40)
    made = draw_attitude_error(np.datetime64("2006-04-15T00:00:00", "ns"), seconds, error, title="simulated")
    titles = [axes.get_title(loc="left") for axes in made.axes]
    assert [len(axes.lines) for axes in made.axes] == [2, 4, 2]
    assert "beyond the frame +6 deg at 0.0 min" in titles[1]
    assert "beyond" not in titles[0] + titles[2]
    assert made.axes[1].get_ylim()[1] < 1.2
