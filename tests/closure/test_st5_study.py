"""The ST5 study end to end with a small Monte Carlo: what it promises, and the reach of its methods."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.records import Calibration
from fluxtwin.scenarios.claims import STATUSES
from fluxtwin.scenarios.registry import STUDIES
from fluxtwin.scenarios.st5 import mission, study
from fluxtwin.scenarios.st5.claims import judge_claims
from fluxtwin.scenarios.st5.terms import terms_of


@pytest.fixture(scope="module")
def results() -> study.Results:
    return study.compute(runs=3, starts=2)


@pytest.fixture(scope="module")
def summary(results: study.Results) -> dict[str, Any]:
    made = study.summary(results, judge_claims(results.hour))
    return json.loads(json.dumps(made, allow_nan=False))


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
        ("inertia_kg_m2", "inertia_kgm2"), ("b_mG", "bias_true_mG"), ("misalignment_deg", "misalign_true_deg"),
        ("pre_rms_deg", "pre_rms_deg"), ("pre_rss_deg", "pre_rss_deg"), ("post_rss_deg", "post_rss_deg"),
        ("b_estimated_mG", "bias_est_mG"), ("misalignment_estimated_deg", "misalign_est_deg"),
        ("noise_mG", "tam_noise_mG"), ("sun_noise_deg", "sun_noise_deg"), ("spin_rpm", "spin_rpm"),
    ):  # fmt: skip
        assert np.array_equal(ours[mine], theirs[other]), mine


def test_the_reach(summary: dict[str, Any]) -> None:
    truth_b, truth_v = summary["truth"]["b_mG"], summary["truth"]["misalignment_deg"]
    assert summary["steps_alone"]["post_rss_deg"] <= 0.151
    assert summary["iterative"]["post_rss_deg"] <= 0.151
    assert summary["batch"]["post_rss_deg"] <= 0.01
    assert np.abs(np.subtract(summary["batch"]["b_mG"], truth_b)).max() < 0.04
    assert np.abs(np.subtract(summary["batch"]["misalignment_deg"], truth_v)).max() < 0.02
    assert summary["pre_rss_deg"] > 5.0 * summary["steps_alone"]["post_rss_deg"]
    assert summary["blind_start"] == {"tried": 2, "found": 2}
    for way in ("iterative", "batch"):
        found = summary[way]
        off_b = np.subtract(found["b_mG"], truth_b) / found["sigma_b_mG"]
        off_v = np.subtract(found["misalignment_deg"], truth_v) / found["sigma_misalignment_deg"]
        assert np.abs(np.concatenate([off_b, off_v])).max() < 4.5
        assert abs(found["squared_over_noise"] - 1.0) < 0.03
        assert abs(found["motion"]["inertia_ratio"] - 1.4) < 1e-5


def test_the_claims(results: study.Results, summary: dict[str, Any]) -> None:
    assert [claim["id"] for claim in summary["claims"]] == [55, 56, 57, 58]
    for claim in summary["claims"]:
        assert claim["status"] in STATUSES
        assert claim["status"] == "reproduced" or claim["why"]
    assert "differs" in {claim["status"] for claim in summary["claims"] if claim["id"] == 56}
    assert len(summary["settings"]) == len(results.hour.sweep) == 8
    assert max(row["pre_rss_deg"] for row in summary["settings"]) > 2.0 * min(
        row["pre_rss_deg"] for row in summary["settings"]
    )


def test_the_page_and_its_figures(results: study.Results) -> None:
    made = study.page(results, judge_claims(results.hour), "verdict")
    names = [block.name for section in made.sections for block in section.figures]
    assert names == ["figure_1", "figure_2", "batch"]
    said = " ".join(words for section in made.sections for words in section.paragraphs)
    assert "Like for like with the abstract's 0.151 deg are its steps alone, 0.02" in said
    assert "of its sigma. Chance alone" in said
    assert any("can be bounded, not matched" in words for section in made.sections for words in section.paragraphs)
    assert "st5" in STUDIES
