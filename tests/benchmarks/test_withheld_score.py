"""The scorer of the withheld effects: what counts as right, and that a run refuses, seals, resumes and logs as it says."""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import withheld
from withheld_cases import beside, promises, score, store
from withheld_cases.cases import POPULATIONS
from withheld_cases.judged import Judged

from fluxtwin.gap.report.words import APART_FROM_THEM

pytestmark = pytest.mark.property


def truth(name: str, visible: float = 1.0, stage: str = "sensor") -> dict[str, Any]:
    """A sealed truth."""
    return {"name": name, "stage": stage, "visible": visible, "signal": True, "parameters": {}}


def entry(
    name: str, *group: str, probability: float = 0.99, rivals: tuple[tuple[str, float], ...] = ()
) -> dict[str, Any]:
    """A named effect of an answer."""
    more = [{"name": n, "probability": p} for n, p in rivals]
    return {"name": name, "group": [name, *group], "probability": probability, "rivals": more}


def case(
    truths: list[dict[str, Any]],
    effects: list[dict[str, Any]],
    verdict: str = "effect",
    population: str = "singles",
    stage: str | None = "sensor",
    equivalent: tuple[str, ...] = (),
    closed: float | None = 0.95,
) -> Judged:
    """One case with its answer open."""
    sealed = {
        "case": "a",
        "population": population,
        "number": 0,
        "label": "x",
        "regime": "nadir",
        "truths": truths,
        "rows": 500,
        "step_s": 10.0,
        "bursts": False,
        "attitude_tau_s": 0.0,
    }
    where = {"stage": stage, "equivalent": list(equivalent), "condition": None}
    said = {"verdict": verdict, "effects": effects, "where": where, "gap": {"closed": closed}, "seconds": 1.0}
    return Judged(sealed, said | {"resembles": []})


def value(rows: list[dict[str, Any]], start: str) -> Any:
    """Figure of the row whose title begins so."""
    return next(row["value"] for row in rows if row["figure"].startswith(start))


def test_where_readings_are_wild_in_truth_saying_so_and_no_more_is_right() -> None:
    said = f"12 rows have outliers. {APART_FROM_THEM}"
    plain = case([], [], verdict="unknown", population="nulls")
    wild = Judged(plain.sealed | {"label": "outliers"}, plain.said | {"sentence": said})
    assert wild.quiet and score.right(wild)
    assert not Judged(wild.sealed, wild.said | {"sentence": "There is a gap."}).quiet
    assert not Judged(plain.sealed, wild.said).quiet


def test_a_name_is_right_by_itself_or_in_its_group() -> None:
    assert case([truth("sensor_lag")], [entry("time_tag_offset", "sensor_lag")]).list_right
    assert not case([truth("sensor_lag")], [entry("time_tag_offset")]).first_right
    two = case([truth("sensor_lag")], [entry("sensor_lag"), entry("bias_step")])
    assert two.first_right and two.extra and not two.list_right
    assert not case([truth("sensor_lag")], [entry("sensor_lag")], verdict="unknown").list_right


def test_pairs_are_matched_one_to_one() -> None:
    both = [truth("ring_current"), truth("sensor_lag")]
    assert case(both, [entry("time_tag_offset", "sensor_lag"), entry("ring_current")]).list_right
    assert not case(both, [entry("ring_current", "sensor_lag"), entry("bias_step")]).list_right
    assert not case(both, [entry("ring_current", "sensor_lag")]).list_right
    crossed = [entry("a", "ring_current", "sensor_lag"), entry("ring_current")]
    assert case(both, crossed).list_right, "the first may stand for either"


def test_stage_counts_equivalents_and_no_claim_is_wrong() -> None:
    assert case([truth("sensor_lag")], [], stage="time").stage_right, "the table holds them to be the same"
    assert case([truth("ring_current", stage="field")], [], stage="orbit", equivalent=("field",)).stage_right
    assert not case([truth("ring_current", stage="field")], [], stage=None).stage_right
    assert not case([truth("ring_current", stage="field")], [], stage="sensor").stage_right


def test_every_row_counts_what_it_names() -> None:
    cases = [
        case([], [], verdict="no_gap", population="nulls"),
        case([], [], verdict="unknown", population="nulls"),
        case([truth("ring_current", 0.9)], [entry("ring_current")]),
        case([truth("ring_current", 0.9)], [], "unknown"),
        case([truth("ring_current", 0.1)], [], "no_gap"),
        case([truth("excess_noise", 0.4)], [], "no_gap"),
        case([truth("excess_noise", 0.6)], [entry("excess_noise")]),
        case([truth("yaw_flex", 1.5)], [], "unknown", "outside"),
        case([truth("yaw_flex", 1.5)], [entry("yaw_drift")], "effect", "outside"),
    ]
    rows = score.rows_of(cases)
    assert value(rows, "no gap on a perfect simulation") == 0.5
    assert value(rows, "single, with a Jacobian") == 0.5
    assert value(rows, "known by distribution") == 1.0
    assert value(rows, "outside the catalogue, visible >= 1: unknown") == 0.5
    assert value(rows, "outside the catalogue: wrongly confirmed") == 0.5
    assert value(rows, "pairs, each") is None
    assert next(row["met"] for row in rows if row["figure"].startswith("no gap on")) is False


def sealed(one: Judged, **more: Any) -> Judged:
    """The same case with more in its answer."""
    return dataclasses.replace(one, sealed=one.sealed | more)


def test_rows_with_sun_and_nadir_stand_beside_those_without() -> None:
    head, other = [truth("horizon_scanner_bias")], [truth("along_track_error")]
    both = entry("horizon_scanner_bias", "yaw_drift")
    cases = [
        sealed(case([], [], "no_gap", "nulls"), sensors_deg={}),
        case([], [], "effect", "nulls"),
        sealed(case(head, [entry("horizon_scanner_bias")], population="sensed"), sensors_deg={}),
        case(head, [both], population="sensed"),
        case(head, [], "unknown", "sensed"),
        sealed(case(other, [entry("along_track_error"), both], population="sensed"), sensors_deg={}),
        case(other, [entry("along_track_error")], population="sensed"),
    ]
    rows = beside.second_channel(cases)
    found = [row["value"] for row in rows]
    assert [row["figure"].startswith("sun and nadir measured") for row in rows] == 6 * [True, False]
    assert found[:2] == [1.0, 0.0] and found[2] is None
    assert found[4:6] == [1.0, 0.5] and found[6:8] == [1.0, 0.0], "named; and named alone in its group"
    assert found[8:10] == [0.0, 1.0] and found[10:] == [1.0, 0.0]
    assert rows[10]["met"] is False


def test_flights_with_two_magnetometers_stand_beside_the_same_with_one() -> None:
    flex, ring, faint_one = (
        [truth("yaw_flex", 1.5, "attitude")],
        [truth("ring_current", 0.9)],
        [truth("bias_step", 0.1)],
    )
    cases = [
        case(flex, [], "unknown", "outside_two", stage="attitude"),
        case(flex, [entry("yaw_drift")], population="outside", stage="sensor"),
        sealed(case(flex, [entry("yaw_drift")], population="outside_two", stage=None), number=1),
        sealed(case(flex, [], "unknown", "outside"), number=7),
        case(ring, [entry("ring_current")], population="singles_two"),
        case(ring, [entry("ring_current"), entry("bias_step")], stage="time"),
        sealed(case(faint_one, [], "no_gap", "singles_two"), number=1),
    ]
    rows = beside.two_magnetometers(cases)
    assert [row["figure"].startswith("two magnetometers, ") for row in rows] == 6 * [True, False]
    assert [row["value"] for row in rows] == [0.5, 0.0, 0.5, 1.0, 0.5, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0]
    assert [row["of"] for row in rows] == [2, 1, 2, 1, 2, 1] + 6 * [1], "number 7 was not flown with two"
    assert [row["met"] for row in rows[::2]] == [False, False, False, True, True, True]
    assert [score.right(one) for one in cases[:3]] == [True, False, False]


def test_a_richer_field_has_rows_of_its_own() -> None:
    right = case([truth("ring_current")], [entry("ring_current")])
    wrong = case([truth("ring_current")], [entry("ring_current"), entry("field_truncation")])
    assert beside.richer_field([right, wrong]) == []
    rows = beside.richer_field([sealed(right, real_model="igrf14"), sealed(wrong, real_model="chaos")])
    assert [row["value"] for row in rows] == [1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0]


def test_torques_are_held_to_name_stage_and_closing() -> None:
    name = "residual_dipole_torque"
    one = case([truth(name, stage="dynamics")], [entry(name)], population="torques", stage="dynamics")
    one = dataclasses.replace(one, said=one.said | {"momentum": {"closed": 0.97}})
    other = case([truth(name, stage="dynamics")], [entry(name), entry("bias_step")], population="torques")
    other = dataclasses.replace(other, said=other.said | {"momentum": {"closed": None}})
    rows = beside.torques([one, other, case([], [], "no_gap", "torque_nulls")])
    assert [row["value"] for row in rows[:6]] == [1.0, 1.0, 0.5, 0.5, 0.5, 0.97]
    assert [row["of"] for row in rows] == [1, 2, 2, 2, 2, 1, 0, 0]


def test_stated_probabilities_are_held_to_the_truth() -> None:
    named = case([truth("ring_current")], [entry("ring_current", probability=0.8, rivals=(("field_epoch", 0.2),))])
    assert named.stated() == [(0.8, True), (0.2, False)]
    rows = score.rows_of([named] * 10)
    assert value(rows, "stated probabilities") == pytest.approx(0.2)


def faint(visible: float, verdict: str, effects: list[dict[str, Any]], **more: Any) -> Judged:
    """A single of 100 nT noise with a size of ring_current printed that makes 15 nT."""
    one = case([truth("ring_current", visible)], effects, verdict)
    printed = {"minimum_detectable": {"ring_current": {"nT": 15.0}}}
    return dataclasses.replace(one, sealed=one.sealed | {"noise_rms_nT": 100.0}, said=one.said | printed | more)


def test_silence_is_honest_below_the_size_that_is_printed() -> None:
    assert promises.honest_silence(faint(0.14, "no_gap", []))
    assert not promises.honest_silence(faint(0.16, "no_gap", [])), "it says that it would have seen this"
    assert not promises.honest_silence(faint(0.14, "unknown", []))
    assert promises.honest_silence(faint(0.19, "no_gap", [], untestable={"ring_current": "no column"}))
    assert not promises.honest_silence(faint(0.14, "no_gap", [], minimum_detectable={}))
    cases = [
        faint(0.14, "no_gap", []),
        faint(0.16, "no_gap", []),
        faint(0.16, "effect", [entry("ring_current")]),
        faint(0.16, "effect", [entry("bias_step")]),
        faint(0.21, "effect", [entry("bias_step")]),
    ]
    rows = promises.rows(cases)
    assert value(rows, "single, with a Jacobian, visible 0.1-0.2") == 0.5
    assert [row["value"] for row in rows if row["figure"].startswith("the same: wrong name")] == [0.25]


def test_what_is_stated_surely_is_counted_and_sets_and_time_are_said() -> None:
    hit, miss = ([truth("ring_current")], [entry("ring_current", "bias", probability=0.98)]), [truth("field_epoch")]
    cases = [case(*hit)] * 3 + [case(miss, [entry("ring_current", probability=0.976)])]
    cases += [case(miss, [entry("ring_current", probability=p)]) for p in (0.94, 0.949)]
    rows = {row["figure"]: row for row in promises.rows(cases)}
    sure = rows["names stated at 95 % or more: present"]
    assert (sure["value"], sure["of"]) == (0.75, 4)
    assert rows["mean group size, all names in records with a cause"]["value"] == 1.5
    slow = [dataclasses.replace(cases[0], said=cases[0].said | {"seconds": float(k)}) for k in range(101)]
    assert value(promises.rows(slow), "processor time") == pytest.approx(99.0)


def test_regimes_joining_effects_and_outside_kinds_have_rows_of_their_own() -> None:
    def null(label: str, verdict: str) -> Judged:
        return sealed(case([], [], verdict, "nulls"), label=label)

    kind = sealed(
        case([truth("yaw_flex")], [entry("yaw_drift")], "effect", "outside", stage="attitude"), label="yaw_flex"
    )
    cases = [null("short", "no_gap"), null("short", "effect"), null("gaps", "no_gap"), kind]
    cases += [case([truth("driver")], [entry("driver")], population="new_singles"), case([], [], "no_gap", "nulls_off")]
    rows = promises.rows(cases)
    alarms = {row["figure"]: (row["right"], row["of"]) for row in rows if row["figure"].startswith("false alarms")}
    assert alarms == {
        "false alarms on perfect flights: 300 to 600 rows, slow attitude error": (1, 2),
        "false alarms on perfect flights: gaps": (0, 1),
    }
    assert value(rows, "effects that join the table, visible >= 0.2: first name") == 1.0
    (line,) = [line for line in promises.outside_list(cases).splitlines() if line.startswith("| `yaw_flex`")]
    assert line.startswith("| `yaw_flex` | 1 | 0 | 0 | 0 | yaw_drift |")


def test_a_small_run_has_each_kind_once_and_a_frozen_run_enough_of_all() -> None:
    def count(name: str, of: int | None) -> int:
        return len(withheld._plan([name], of))

    small = {name: count(name, withheld._count("small")) for name in POPULATIONS}
    assert small | {"outside": 30, "shapes": 25, "new_singles": 14, "nulls": 10, "pairs": 4, "outside_two": 30} == small
    least = {"nulls": 2000, "singles": 150, "pairs": 60, "triples": 30, "shapes": 60, "outside": 100}
    assert all(count(name, None) >= wanted for name, wanted in least.items())
    for wrong in ("0", "-3", "few"):
        with pytest.raises(argparse.ArgumentTypeError, match="at least 1, or small"):
            withheld._count(wrong)


def test_the_seed_is_the_commit_and_a_dirty_tree_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    sha = "0123456789abcdef0123456789abcdef01234567"
    monkeypatch.setattr(store, "commit_of", lambda root: (sha, True))
    monkeypatch.setattr(sys, "argv", ["withheld.py", "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match="commit first"):
        withheld.main()
    seeds = []
    monkeypatch.setattr(store, "commit_of", lambda root: (sha, False))
    monkeypatch.setattr(store, "LOG", tmp_path / "log")
    monkeypatch.setattr(
        withheld, "_all", lambda word, work, jobs, processes: seeds.extend(jobs if word == "made" else [])
    )
    monkeypatch.setattr(store.Store, "seal", lambda self, names: "f" * 64)
    monkeypatch.setattr(score, "opened", lambda here, names: ([], 0))
    monkeypatch.setattr(sys, "argv", ["withheld.py", "--out", str(tmp_path / "run"), "--count", "1"])
    for _ in range(2):
        assert withheld.main() == 0
    assert {job[1] for job in seeds} == {0x0123456789AB}
    lines = (tmp_path / "log").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2 and json.loads(lines[1])["commit"] == sha
    monkeypatch.setattr(sys, "argv", ["withheld.py", "--out", str(tmp_path / "run"), "--count", "1", "--tune", "5"])
    with pytest.raises(SystemExit, match="another run"):
        withheld.main()
    monkeypatch.setattr(sys, "argv", ["withheld.py", "--out", str(tmp_path / "tune"), "--count", "1", "--tune", "5"])
    assert withheld.main() == 0
    assert len((tmp_path / "log").read_text(encoding="utf-8").splitlines()) == 2, "tuning logs nothing"


def test_the_tree_is_dirty_when_anything_but_the_log_changed(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        name = ["-c", "user.name=x", "-c", "user.email=x@x"]
        subprocess.run(["git", "-C", str(tmp_path), *name, *words], check=True, capture_output=True)

    git("init")
    (tmp_path / "benchmarks").mkdir()
    for name in ("benchmarks/withheld.log", "code.py"):
        (tmp_path / name).write_text("1\n", encoding="utf-8")
    git("add", ".")
    git("commit", "-m", "x")
    sha, dirty = store.commit_of(tmp_path)
    assert len(sha) == 40 and not dirty
    (tmp_path / "benchmarks/withheld.log").write_text("1\n2\n", encoding="utf-8")
    assert not store.commit_of(tmp_path)[1]
    (tmp_path / "code.py").write_text("2\n", encoding="utf-8")
    assert store.commit_of(tmp_path)[1]


def test_a_run_is_scored_again_without_a_seed_and_makes_its_page(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = store.Store(tmp_path / "run").prepared()
    here.agree({"seed": 5, "commit": None, "chaos": None})
    one = case([truth("ring_current", 0.9)], [entry("ring_current")])
    here.write("sealed", "a", one.sealed)
    here.write("said", "a", one.said)
    monkeypatch.setattr(withheld, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(sys, "argv", ["withheld.py", "--out", str(here.root), "--score", "--docs"])
    assert withheld.main() == 0
    assert "| single, with a Jacobian" in capsys.readouterr().out
    page = (tmp_path / "docs" / "withheld.md").read_text(encoding="utf-8")
    assert (
        "The real field is that of the model used on the ground." in page
        and "0 of 1 records that point to the Earth" in page
    )
    assert "seed 5" in page and "images/withheld_confusion.png" in page
    assert (tmp_path / "docs" / "images" / "withheld_confusion.png").stat().st_size > 1000


def test_a_run_that_was_stopped_before_its_first_case_leaves_nothing(tmp_path: Path) -> None:
    here = store.Store(tmp_path / "run").prepared()
    here.agree({"seed": 5})
    here.tidy()
    assert not here.root.exists()
    kept = store.Store(tmp_path / "other").prepared()
    kept.write("sealed", "a", {})
    kept.tidy()
    assert [path.name for path in kept.root.iterdir()] == ["sealed"]
