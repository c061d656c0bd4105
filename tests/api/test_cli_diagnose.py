"""`fluxtwin diagnose` as a person meets it: the answer, what it writes, and the one message for each mistake."""

from __future__ import annotations

import json
import re
import shlex
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Cli, status_of
from jsonschema import Draft202012Validator
from worlds import scenario_text

import fluxtwin
from fluxtwin.gap.records.diagnosis import diagnosis_schema
from fluxtwin.gap.report import input_warnings, words
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.effect_sections import active_effects
from fluxtwin.sim.scenario.scenario import load_scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.usefixtures("lawless", "small_figures")

SECTIONS = """
[attitude]
yaw_rms_deg = 4.0
roll_rms_deg = 4.0
pitch_rms_deg = 4.0
shortest_period_min = 40.0
[attitude.reference]
sigma_deg = 0.05
tau_s = 0.0
[magnetometer]
S = [[0.005, 0.002, 0.0], [0.0, -0.005, 0.0], [0.001, 0.0, 0.004]]
b_nT = [1000.0, -500.0, 200.0]
noise_nT = 30.0
lsb_nT = 10.0
"""
SCENARIO = scenario_text(SECTIONS, seed=5, name="Floor", segment="duration_min = 200.0, step_s = 30.0")
LATE = "[effects.time_tag_offset]\noffset_s = 15.0\n"
FLAGS = ("--noise-nT", 30, "--lsb-nT", 10, "--attitude-sigma-deg", 0.05)
WIDE = ("--noise-nT", 30, "--lsb-nT", 10, "--attitude-sigma-deg", 90)  # beside which nothing has to be searched for

# The keys of the contract, written down a second time on purpose: the schema is not its own witness.
TOP = {"verdict", "effects", "resembles", "where", "gap", "modelled", "untestable", "isolability"} | {
    "minimum_detectable",
    "samples",
    "provenance",
    "ranking",
    "transfers",
}
EFFECT = {"name", "group", "rivals", "probability", "parameters", "stage", "axis", "frame", "condition", "significance"}
GAP = {"left_nT", "before_nT", "after_nT", "floor_nT", "floor_with_effects_nT", "closed", "interval"} | {
    "prediction",
    "shape_incomplete",
    "per_axis",
}


@dataclass(frozen=True)
class Case:
    """A record with a late clock, and what the command answered and wrote."""

    folder: Path
    record: Telemetry
    telemetry: Path
    status: int
    out: str
    answer: dict[str, Any]


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("late")
    record, _ = simulate(parse_scenario(SCENARIO + LATE))
    write_telemetry(record, folder / "late.csv")
    written = ("--json", folder / "a.json", "--html", folder / "a.html", "--close", folder / "closed.toml")
    with redirect_stdout(StringIO()) as out:
        status = status_of("diagnose", folder / "late.csv", *FLAGS, *written)
    return Case(folder, record, folder / "late.csv", status, out.getvalue(), strict(folder / "a.json"))


def strict(path: Path) -> dict[str, Any]:
    def refuse(text: str) -> None:
        raise ValueError(f"{text} is not JSON")

    answer: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    return answer


def check_contract(answer: dict[str, Any]) -> None:
    """An answer against the packaged schema and against the contract's own list of keys."""
    Draft202012Validator(diagnosis_schema()).validate(answer)
    assert set(answer) >= TOP
    assert all(set(effect) >= EFFECT for effect in answer["effects"])
    assert set(answer["gap"]) == GAP
    assert set(answer["where"]) == {"stage", "axis", "frame", "condition", "equivalent", "probabilities"}
    assert set(answer["samples"]) == {"used", "cut", "without_attitude"}
    for shares in answer["where"]["probabilities"].values():
        assert sum(shares.values()) == pytest.approx(1.0, abs=1e-6)  # a sum of a dozen doubles, some rounded
    for effect in answer["effects"]:
        assert effect["name"] in effect["group"]
    if answer["verdict"] == "no_gap":
        assert answer["gap"]["after_nT"] == answer["gap"]["before_nT"]


def test_the_schema_is_one_and_refuses_what_breaks_the_contract(late: Case) -> None:
    schema = diagnosis_schema()
    Draft202012Validator.check_schema(schema)
    validator = Draft202012Validator(schema)
    for key in TOP:
        assert not validator.is_valid({k: v for k, v in late.answer.items() if k != key}), key
    wrong = [
        {"verdict": "perhaps"},
        {"verdict": "no_gap"},
        {"effects": []},
        {"gap": {**late.answer["gap"], "closed": 1.2}},
        {"gap": {**late.answer["gap"], "interval": [0.5]}},
        {"where": {**late.answer["where"], "stage": "none"}},
        {"samples": {"used": 1.5, "cut": 0, "without_attitude": 0}},
    ]
    assert [change for change in wrong if validator.is_valid({**late.answer, **change})] == []


def test_a_late_clock_is_named_and_the_answer_keeps_the_contract(late: Case) -> None:
    assert late.status == 0
    check_contract(late.answer)
    assert late.answer["verdict"] == "effect"
    assert [effect["name"] for effect in late.answer["effects"]] == ["time_tag_offset"]
    assert set(late.answer["effects"][0]["group"]) <= {"time_tag_offset", "sensor_lag"}  # alike to first order
    offset = late.answer["effects"][0]["parameters"]["offset"]
    assert offset["unit"] == "s"
    assert abs(offset["value"] - 15.0) < 4.0 * offset["sigma"]
    assert late.answer["modelled"] == ["bias", "scale_misalignment"]
    assert late.answer["provenance"]["notes"] == []
    # No current was recorded, so nothing is known per ampere.
    assert late.answer["minimum_detectable"]["battery_current"]["unit"] == "nT"


def test_the_page_stands_alone_and_answers_the_questions(late: Case) -> None:
    page = (late.folder / "a.html").read_text(encoding="utf-8")
    for title in (
        "Where the gap lies",
        "Which effect causes it",
        "How much of it is closed",
        "What could not be tested",
    ):
        assert f">{title}</h2>" in page
    figures = re.findall('<figure id="([a-z_]+)">', page)
    assert figures == ["field", "gap_series", "drivers", "gap_spectra", "coverage"]
    assert page.count("data:image/png;base64,") == len(figures)
    assert page.index('class="next"') < page.index("<h2>") < page.index("Places by probability")
    assert ">Where the closed scenario holds</h2>" in page
    assert "http" not in page.replace("http-equiv", "")
    assert "the state of the heater in the telemetry" in page  # what would settle an untestable effect
    assert late.answer["would_settle"]["eddy_current"].startswith("for ")
    assert "h of such data" in " ".join(late.answer["would_settle"].values())


def test_the_closed_scenario_simulates_and_closes_the_gap(late: Case, cli: Cli) -> None:
    closed = late.folder / "closed.toml"
    scenario = load_scenario(closed)
    assert [effect.name for effect, _ in active_effects(scenario)] == ["time_tag_offset"]
    again = late.folder / "again.csv"
    assert cli("simulate", closed, "--out", again).status == 0
    mine, theirs = read_telemetry(again), read_telemetry(late.telemetry)
    assert (mine.time == theirs.time).all()
    rms = float(np.sqrt(np.mean((mine.mag_B_nT - theirs.mag_B_nT) ** 2)))
    # two draws of the reading's noise, one attitude error of 0.05 deg in about 30,000 nT, fitted parameters
    assert rms < 1.2 * np.sqrt(2 * (30.0**2 + 10.0**2 / 12) + (np.radians(0.05) * 30_000.0) ** 2)
    assert rms < 0.7 * late.answer["gap"]["before_nT"]


def test_next_is_a_command_that_runs(late: Case, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A late clock cannot be taken out of the readings, a field of the torquers can."""
    simulate_it = (
        f"Next: fluxtwin simulate {late.folder / 'closed.toml'} --out simulated.nc simulates with the named effects; "
        f"fluxtwin plan {late.telemetry} --noise-nT 30.0 --lsb-nT 10.0 --attitude-sigma-deg 0.05 proposes what to fly to "
        "find out which it is."
    )
    assert " ".join(late.out.split()).endswith(simulate_it)
    page = (late.folder / "a.html").read_text(encoding="utf-8")
    assert simulate_it in re.sub("<[^>]*>", "", page)
    monkeypatch.chdir(tmp_path)
    flown, _ = simulate(fluxtwin.load_scenario("late_clock"))
    write_telemetry(flown.select(slice(0, len(flown) // 2)), tmp_path / "my flight.csv")
    answer = cli("diagnose", "my flight.csv", "--close", "my closed.toml")
    found = re.search(
        "Next: (fluxtwin apply .*) corrects the telemetry with (.*) taken out", " ".join(answer.out.split())
    )
    assert found is not None and found[2] == "torquer_coupling"
    again = cli(*shlex.split(found[1])[1:])
    assert again.status == 0 and "effects taken out: torquer_coupling\n" in again.out
    assert Path("my flight-corrected.nc").exists()


def test_the_next_command_has_the_options_of_this_one(late: Case, cli: Cli) -> None:
    (late.folder / "as built.toml").write_text(SCENARIO, encoding="utf-8")
    asked = ("--scenario", late.folder / "as built.toml", "--modelled", "scale_misalignment,bias", "--noise-nT", "30.0")
    out = " ".join(cli("diagnose", late.telemetry, *asked).out.split())
    again = re.escape(f"{late.telemetry} {shlex.join(map(str, asked))}")
    assert re.search(rf"Next: fluxtwin (plan {again},|diagnose {again} --close CLOSED\.toml;) ", out)


def test_the_closed_scenario_says_for_which_designs_it_is_good_enough(late: Case) -> None:
    said = late.answer["transfers"]
    assert {one["effect"] for one in said} == {"time_tag_offset"}
    assert [one["design"] for one in said][:3] == ["nadir, 12 h later", "nadir, 90 days later", "nadir, 182 days later"]
    assert all(one["why"] for one in said if not one["transfers"])
    written = load_scenario(late.folder / "closed.toml").closure
    assert written is not None and written.telemetry == "late.csv" and written.rows == len(late.record)
    assert [one.transfers for one in written.transfer] == [one["transfers"] for one in said]
    assert late.answer["ranking"][0]["name"] in {"time_tag_offset", "sensor_lag"}


def test_a_key_of_the_closure_table_that_does_not_exist_is_named(late: Case, tmp_path: Path, cli: Cli) -> None:
    _, _, closed = (late.folder / "closed.toml").read_text(encoding="utf-8").partition("\n")  # without its digest
    text = closed.replace("[closure]\n", "[closure]\nrow = 3\n")
    (tmp_path / "wrong.toml").write_text(text, encoding="utf-8")
    outcome = cli("simulate", tmp_path / "wrong.toml", "--out", tmp_path / "x.csv")
    assert outcome.status == 2
    assert "closure.row" in outcome.err and "rows" in outcome.err


def test_the_scenario_with_the_effect_has_no_gap_left_and_nothing_to_close(
    late: Case, cli: Cli, tmp_path: Path
) -> None:
    """Effects of --scenario are applied as they are."""
    (tmp_path / "with.toml").write_text(SCENARIO + LATE, encoding="utf-8")
    written = ("--close", tmp_path / "nothing.toml", "--json", tmp_path / "a.json")
    outcome = cli("diagnose", late.telemetry, "--scenario", tmp_path / "with.toml", *written)
    assert outcome.status == 0
    assert outcome.out.startswith("No gap")
    assert "nothing to close" in outcome.err
    assert not (tmp_path / "nothing.toml").exists()
    answer = strict(tmp_path / "a.json")
    check_contract(answer)
    assert answer["verdict"] == "no_gap"
    assert answer["gap"]["before_nT"] < late.answer["gap"]["before_nT"]


def test_modelled_none_makes_the_calibration_a_candidate(late: Case, cli: Cli, tmp_path: Path) -> None:
    write_telemetry(late.record.select(slice(0, 60)), tmp_path / "half.csv")
    outcome = cli("diagnose", tmp_path / "half.csv", *FLAGS, "--modelled", "none", "--json", "-")
    assert outcome.status == 0
    answer = json.loads(outcome.out)
    check_contract(answer)
    assert answer["modelled"] == []
    assert answer["transfers"] is None, "nobody asked for a closed scenario"
    assert answer["verdict"] != "no_gap"
    assert "bias" in {*answer["minimum_detectable"], *answer["untestable"]}


def test_what_is_re_estimated_is_printed_with_sigma_and_unit(late: Case, cli: Cli) -> None:
    outcome = cli("diagnose", late.telemetry, *FLAGS, "--modelled", "bias,scale_misalignment,time_tag_offset")
    assert outcome.status == 0
    rows = [line.split() for line in outcome.out.partition("Re-estimated")[2].splitlines()]
    found = {
        row[1]: row[2:] for row in rows if len(row) == 5 and row[0] in ("bias", "time_tag_offset", "scale_misalignment")
    }
    for name, truth, unit in (("offset", 15.0, "s"), ("b1", 1000.0, "nT"), ("b2", -500.0, "nT"), ("S22", -0.005, "1")):
        value, sigma = map(float, found[name][:2])
        assert abs(value - truth) < 4.0 * sigma and found[name][2] == unit
    assert late.out.startswith("The gap") and "Re-estimated" not in late.out


def test_one_file_takes_any_number_of_processes_and_says_that_it_uses_one(late: Case, cli: Cli, tmp_path: Path) -> None:
    write_telemetry(late.record.select(slice(0, 60)), tmp_path / "half.csv")
    one, two = (cli("diagnose", tmp_path / "half.csv", *WIDE, "--jobs", jobs) for jobs in (1, 2))
    assert one.status == two.status == 0 and one.out == two.out
    assert "--jobs" not in one.err and "one file is diagnosed by one process" in two.err


@pytest.fixture
def broken(late: Case, tmp_path: Path, cli: Cli) -> Cli:
    """Diagnose a changed record and demand that nothing was written."""

    def run(record: Telemetry, *options: object, suffix: str = ".csv") -> Any:
        path = write_telemetry(record, tmp_path / f"broken{suffix}") or tmp_path / f"broken{suffix}"
        before = sorted(tmp_path.iterdir())
        targets = ("--html", tmp_path / "x.html", "--close", tmp_path / "x.toml", "--json", tmp_path / "x.json")
        outcome = cli("diagnose", path, *FLAGS, *options, *targets)
        assert sorted(tmp_path.iterdir()) == before, "something half-written is left"
        assert "Traceback" not in outcome.err
        return outcome

    return run


def test_no_reading_at_all(late: Case, broken: Cli) -> None:
    outcome = broken(late.record.replace(mag_B_nT=np.full_like(late.record.mag_B_nT, np.nan)), suffix=".nc")
    assert outcome.status == 1
    assert "all 401 magnetometer readings are missing" in outcome.err


def test_an_unknown_modelled_effect_is_named_with_the_nearest(late: Case, broken: Cli) -> None:
    outcome = broken(late.record, "--modelled", "bias,scale_misalignmnt")
    assert outcome.status == 2
    assert "scale_misalignment" in outcome.err


def test_a_scenario_of_another_spacecraft(late: Case, tmp_path: Path, broken: Cli) -> None:
    (tmp_path / "other.toml").write_text(SCENARIO.replace('"Floor"', '"Ceiling"'), encoding="utf-8")
    outcome = broken(late.record, "--scenario", tmp_path / "other.toml", suffix=".nc")
    assert outcome.status == 2
    assert "'Floor'" in outcome.err and "'Ceiling'" in outcome.err


def test_too_few_rows_says_how_many_are_needed(late: Case, broken: Cli) -> None:
    outcome = broken(late.record.select(slice(0, 12)))
    assert outcome.status == 1
    assert "12 rows" in outcome.err
    assert "at least 24 are needed" in outcome.err  # 12 parameters and 30 to spare, three a row, and ten more


def test_no_position(late: Case, broken: Cli) -> None:
    placeless = broken(late.record.replace(r_N_km=None, v_N_km_s=None))
    assert placeless.status == 2
    assert "no position" in placeless.err


def test_a_record_without_any_attitude_is_diagnosed(late: Case, cli: Cli, tmp_path: Path) -> None:
    few = late.record.select(slice(0, 200))
    write_telemetry(few.replace(q_NB=None), tmp_path / "blind.csv")
    outcome = cli("diagnose", tmp_path / "blind.csv", *FLAGS, "--json", "-")
    assert outcome.status == 0
    answer = json.loads(outcome.out)
    check_contract(answer)
    assert answer["samples"]["without_attitude"] == 200
    assert answer["untestable"]["yaw_drift"] == "no row has a reference attitude"
    assert "200 of 200 rows have no reference attitude" in outcome.err


def test_numbers_and_folders_that_cannot_be(late: Case, cli: Cli, tmp_path: Path) -> None:
    negative = cli("diagnose", late.telemetry, "--noise-nT", -3)
    assert negative.status == 2
    assert "--noise-nT: -3" in negative.err
    (tmp_path / "file").write_text("", encoding="utf-8")
    nowhere = cli("diagnose", late.telemetry, *FLAGS, "--html", tmp_path / "file" / "x.html")
    assert nowhere.status == 2
    assert "is a file" in nowhere.err
    assert "noise" not in nowhere.err, "found before the work, not after it"


def test_rows_without_attitude_are_counted_and_said(late: Case, cli: Cli, tmp_path: Path) -> None:
    few = late.record.select(slice(0, 201))
    q = few.q_NB.copy()
    q[::8] = np.nan
    write_telemetry(few.replace(q_NB=q), tmp_path / "some.csv")
    outcome = cli("diagnose", tmp_path / "some.csv", *FLAGS, "--json", "-")
    assert outcome.status == 0
    answer = json.loads(outcome.out)
    check_contract(answer)
    assert answer["samples"]["without_attitude"] == 26  # ceil(201 / 8)
    assert "26 of 201 rows have no reference attitude" in outcome.err


def test_a_stuck_attitude_is_a_warning(late: Case, cli: Cli, tmp_path: Path) -> None:
    few = late.record.select(slice(0, 60))
    q = few.q_NB.copy()
    q[20:54] = q[20]
    write_telemetry(few.replace(q_NB=q), tmp_path / "stuck.csv")
    outcome = cli("diagnose", tmp_path / "stuck.csv", *WIDE, "--json", "-")
    assert outcome.status == 0
    check_contract(json.loads(outcome.out))
    assert "the reference attitude looks stuck" in outcome.err
    assert "56 % of the rows" in outcome.err  # 33 of 59 steps


def test_a_trap_in_the_file_is_named_before_the_answer(late: Case, cli: Cli, tmp_path: Path) -> None:
    record = late.record.select(slice(0, 60))  # half an hour shows the trap; the search has less to explain
    assert record.q_NB is not None
    write_telemetry(record.replace(q_NB=record.q_NB * np.array([-1.0, -1.0, -1.0, 1.0])), tmp_path / "turned.csv")
    result = cli("diagnose", tmp_path / "turned.csv", *WIDE)
    said = " ".join((result.out + result.err).split())
    assert result.status == 0
    assert "conjugated" in said
    assert "fluxtwin check" in said


@pytest.mark.parametrize(
    ("flag", "value", "wanted"),
    [
        ("--attitude-sigma-deg", "1e300", "a number from 0 to 180"),
        ("--noise-nT", "-1", "a number from 0 to"),
        ("--degree", "0", "1 to 13"),
    ],
)
def test_a_number_that_means_nothing_is_refused(late: Case, cli: Cli, flag: str, value: str, wanted: str) -> None:
    result = cli("diagnose", late.folder / "late.csv", flag, value)
    assert result.status == 2
    assert wanted in " ".join(result.err.split())


def test_a_budget_far_too_large_is_said(late: Case, cli: Cli, tmp_path: Path) -> None:
    write_telemetry(late.record.select(slice(0, 120)), tmp_path / "hour.csv")
    result = cli("diagnose", tmp_path / "hour.csv", "--noise-nT", 5000, "--lsb-nT", 10, "--attitude-sigma-deg", 0.05)
    assert "they are too large" in " ".join((result.out + result.err).split())


def test_noise_that_is_half_of_what_was_declared_is_said(late: Case, cli: Cli, tmp_path: Path) -> None:
    write_telemetry(late.record.select(slice(0, 120)), tmp_path / "hour.csv")
    result = cli("diagnose", tmp_path / "hour.csv", "--noise-nT", 60, "--lsb-nT", 10, "--attitude-sigma-deg", 0.05)
    assert result.status == 0
    assert "60 nT were declared" in " ".join((result.out + result.err).split())


def test_a_wrong_file_without_a_gap_says_no_numbers_of_it() -> None:
    """Microtesla as nT: S of a thousand takes up all but 60,000 nT, and the rest is noise."""
    said = words.wrong_file(["the unit is wrong"], "no_gap", "No gap: the residual of the fit is 60862.8 nT.")
    assert said.startswith(words.FIRST) and "No gap" not in said


def test_a_noise_that_nobody_declared_is_not_called_declared() -> None:
    found, given = (input_warnings.far_below_budget(50.0, 3000.0, declared) for declared in (False, True))
    assert found is not None and "declared" not in found and "Declare --noise-nT" in found
    assert given is not None and "declared noise" in given


def test_a_wrong_unit_is_to_be_corrected_before_anything_is_flown(late: Case, cli: Cli, tmp_path: Path) -> None:
    """Milligauss under the name of nT."""
    record = read_telemetry(late.folder / "late.csv")
    write_telemetry(record.replace(mag_B_nT=record.mag_B_nT / 100.0), tmp_path / "unit.csv")
    page = tmp_path / "unit.html"
    result = cli("diagnose", tmp_path / "unit.csv", "--html", page, "--json", tmp_path / "unit.json")
    said, shown = " ".join(result.out.split()), page.read_text(encoding="utf-8")
    assert said.startswith("First correct the file as fluxtwin check says")
    assert "note: First correct the file as fluxtwin check says: " in result.err
    for untrue in ("fluxtwin plan", "Where:", "law", "The gap, rms", "Untestable", "estimated from these data"):
        assert untrue not in said, untrue
    assert shown.index("First correct the file") < shown.index('id="gap_series"')
    assert 'id="drivers"' not in shown and 'id="gap_spectra"' not in shown  # their words are of a gap
    assert "Minimum detectable sizes" not in shown and "Where the gap lies" not in shown
    assert "law" not in json.loads((tmp_path / "unit.json").read_text(encoding="utf-8"))


def test_a_wrong_file_is_never_without_a_gap() -> None:
    """Half an hour of a tumble, in which the noise that is found would make up any wrong axes."""
    world = '[attitude]\nmode = "tumble"\nrate_deg_s = [0.12, 0.08, 0.2]\n[magnetometer]\nnoise_nT = 20.0\n'
    inertia = [[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]]
    text = scenario_text(world, seed=3, inertia_kg_m2=inertia, segment="duration_min = 30.0, step_s = 20.0")
    record = simulate(parse_scenario(text))[0]
    for wrong in (-record.mag_B_nT, record.mag_B_nT[:, [1, 0, 2]]):
        steps: list[str] = []
        flipped = record.replace(mag_B_nT=wrong)
        found = fluxtwin.diagnose(
            flipped, said=steps.append, progress=lambda words, share, into=steps: into.append(words)
        )
        assert found.verdict == "unknown"
        trap = fluxtwin.check(flipped).traps[0]
        assert steps[0].startswith(f"First correct the file as fluxtwin check says: {trap.text.removesuffix('.')}")
        assert steps[1:] and all(f"as fluxtwin check says ({trap.code})" in words for words in steps[1:])
    with pytest.raises(fluxtwin.NoAnswer, match=r"^First correct the file as fluxtwin check says"):
        fluxtwin.diagnose(record.replace(mag_B_nT=record.mag_B_nT * 1e9))


def test_a_value_that_no_instrument_gives_is_named(late: Case, cli: Cli, tmp_path: Path) -> None:
    text = [
        line.rpartition(",")[0] for line in (late.folder / "late.csv").read_text(encoding="utf-8").splitlines()
    ]  # without checks
    row = text[5].split(",")
    row[text[0].split(",").index("mag_x_nT")] = "1e300"
    (tmp_path / "damaged.csv").write_text("\n".join([*text[:5], ",".join(row), *text[6:]]) + "\n", encoding="utf-8")
    result = cli("diagnose", tmp_path / "damaged.csv", *FLAGS)
    assert result.status == 2
    assert "1e+300" in result.err
    assert "row 5" in result.err


def test_a_result_that_cannot_be_written_is_said_before_the_work(late: Case, cli: Cli, tmp_path: Path) -> None:
    outcome = cli("diagnose", late.folder / "late.csv", *FLAGS, "--json", tmp_path)
    assert outcome.status == 2
    assert "is a folder" in outcome.err
    assert "every effect" not in outcome.err
