"""`fluxtwin campaign`: truth enters the scores alone, runs repeat, and what is named is counted by its size."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli
from scipy.special import expit
from worlds import TUMBLING, tumbling

import fluxtwin
from fluxtwin import campaigning
from fluxtwin.campaign_page import sentences
from fluxtwin.campaign_scores import summarise, wilson
from fluxtwin.campaigning import one_run
from fluxtwin.scenarios.packaged import as_scenario
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario

pytestmark = [pytest.mark.property, pytest.mark.usefixtures("lawless", "small_figures")]

SECTIONS = """
[effects.time_tag_offset]
offset_s = 1.0
[draws]
"effects.time_tag_offset.offset_s" = { log_uniform = [0.001, 5.0] }
"""
TEXT = 'name = "late"\n' + tumbling(TUMBLING + SECTIONS, seed=4)


def test_a_campaign_and_its_page(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two parts, one of which is lost."""
    monkeypatch.setattr(campaigning, "_IN_PART", 2)
    (tmp_path / "s.toml").write_text(TEXT, encoding="utf-8")
    words = ("campaign", tmp_path / "s.toml", "--runs", 3, "--out", tmp_path / "out", "--jobs", 1)
    done = cli(*words)
    assert done.status == 0, done.err
    assert "time_tag_offset was named in" in done.out and "of 3 runs" in done.out
    assert "Effects in the runs, which no calibration models, add to them." in " ".join(done.out.split())
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "How often an effect is named" in page or "<img" in page
    rows = list(csv.DictReader((tmp_path / "out" / "runs.csv").read_text(encoding="utf-8").splitlines()))
    size = np.array([float(row["size of time_tag_offset [s]"]) for row in rows])
    said = np.array(["time_tag_offset" in row["names"] for row in rows])
    assert len(rows) == 3 and said[np.argmax(size)] and not said[np.argmin(size)]
    first = {name: (tmp_path / "out" / name).read_bytes() for name in ("runs.csv", "summary.json")}
    assert cli(*words).status == 2, "another campaign is not overwritten"
    (tmp_path / "out" / "part-00001.json").unlink()
    again = cli(*words, "--resume")
    assert again.status == 0, again.err
    assert first == {name: (tmp_path / "out" / name).read_bytes() for name in first}
    assert cli(*words, "--resume", "--seed", 5).status == 2
    flown = fluxtwin.campaign(tmp_path / "s.toml", 3, tmp_path / "out", jobs=1, resume=True)
    assert done.out.splitlines()[0][:40] in flown.report() and "time_tag_offset was named in" in flown._repr_html_()


def test_the_ground_does_not_know_what_was_drawn() -> None:
    """The answers are those of the record alone, with the scenario's own noise and nothing of its effects."""
    plan = parse_scenario(TEXT)
    known = plan.updated({"effects": None, "draws": None})
    flown = plan.updated({"draws": None, "effects.time_tag_offset.offset_s": 4.0, "magnetometer.b_nT": [5.0, 6.0, 7.0]})
    run = one_run(flown, known, 0, {})
    record = simulate(flown)[0]
    alone = fluxtwin.diagnose(record, scenario=known)
    assert (
        [one["name"] for one in run["diagnosis"]["names"]] == [one.name for one in alone.effects] == ["time_tag_offset"]
    )
    fit = fluxtwin.calibrate(record).calibration
    error, sigma = run["calibration"]["parameters"]["b1"]
    assert error == pytest.approx(fit.b_nT[0] - 5.0) and sigma == pytest.approx(fit.sigma["b1"])


def test_torquers_of_the_scenario_are_calibrated_with_bias_and_matrix() -> None:
    known = as_scenario("cubesat")
    fit = one_run(known, known, 0, {})["calibration"]
    assert len(fit["parameters"]) == 21
    assert max(abs(error) / sigma for error, sigma in fit["parameters"].values()) < 5.0  # 21 normal pulls: 1e-5


def drawn(seed: int, runs: int, at: float) -> list[dict[str, object]]:
    """Runs whose effect is named with a probability of 90 % at the size `at`."""
    rng = np.random.default_rng(seed)
    found = []
    for number, size in enumerate(np.exp(rng.uniform(np.log(0.1 * at), np.log(10.0 * at), runs))):
        named = rng.uniform() < expit(np.log(9.0) + 2.0 * np.log(size / at))
        names = [{"name": "bias_step", "group": ["bias_step"], "probability": 0.9}] if named else []
        fit = {"why": "", "parameters": {"b1": [rng.normal() * 2.0, 2.0]}, "nees": 1.0}
        said = {"why": "", "verdict": "effect" if named else "no_gap", "names": names}
        effects = {"bias_step": {"size": size, "unit": "nT", "parameter": "step_x"}}
        found.append({"run": number, "lost": "", "effects": effects, "calibration": fit, "diagnosis": said})
    return found


def test_the_size_that_is_named_in_nine_of_ten_is_found() -> None:
    """Of 400 runs: the logarithm of the size has a standard error of some 0.13; three of them, at a fixed seed."""
    found = summarise("x", 1, drawn(1, 400, 30.0))
    at = found["effects"]["bias_step"]["size_at_90_percent"]
    assert abs(np.log(at / 30.0)) < 0.4
    assert abs(found["sigmas"]["parameters"]["b1"]["pull_rms"] - 1.0) < 4.0 / np.sqrt(800.0)
    assert found["false_names"] == {}
    wrong = drawn(1, 40, 30.0)
    for run in wrong:
        run["effects"] = {}
    assert summarise("x", 1, wrong)["false_names"]["bias_step"] > 10


def test_few_runs_do_not_contradict_the_sigmas() -> None:
    """12 errors have squares of 0.37 to 1.94 times their expectation in 95 % of cases (chi squared: 4.404 to 23.337)."""
    fit = {"why": "", "parameters": {f"p{k}": [1.0, 1.0] for k in range(12)}, "nees": 1.3}
    run = {"run": 0, "lost": "", "effects": {}, "calibration": fit, "diagnosis": {"why": "no", "names": []}}
    for runs, words in ((1, "agree with its sigmas"), (200, "do not agree with its sigmas")):
        found = summarise("x", 1, [run] * runs)
        assert f"The errors of the calibration {words}" in " ".join(sentences(found))
    assert summarise("x", 1, [run])["sigmas"]["nees_by_chance"] == pytest.approx([4.404 / 12, 23.337 / 12], abs=1e-4)


def test_the_interval_is_wilsons() -> None:
    """The example of Newcombe 1998, Stat. Med. 17, 857, table I: 81 of 263 is 0.2553 to 0.3662; 0 of 20 ends at 0.1611."""
    assert wilson(81, 263) == (pytest.approx(0.2553, abs=5e-5), pytest.approx(0.3662, abs=5e-5))
    assert wilson(0, 20) == (0.0, pytest.approx(0.1611, abs=5e-5))


def test_what_makes_no_campaign_is_said(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"^runs: 0 runs"):
        fluxtwin.campaign(parse_scenario(TEXT), 0, tmp_path / "x")
    with pytest.raises(BadInput, match="processes"):
        fluxtwin.campaign(parse_scenario(TEXT), 2, tmp_path / "x", jobs=0)
