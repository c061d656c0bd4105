"""`fluxtwin plan` as a person meets it: what to fly, a file that simulate flies, one message for each mistake."""

from __future__ import annotations

import inspect
import json
import re
from base64 import b64decode
from pathlib import Path

import pytest
from command_line import Cli
from worlds import THERMAL, scenario_text

import fluxtwin
from fluxtwin.gap.records.diagnosis import Diagnosis

SECTIONS = """
[attitude]
yaw_rms_deg = 1.0
[attitude.reference]
sigma_deg = 0.05
tau_s = 100.0
[magnetometer]
noise_nT = 50.0
lsb_nT = 10.0
[effects.time_tag_offset]
offset_s = 4.0
"""
FLAGS = ("--noise-nT", 50, "--lsb-nT", 10, "--attitude-sigma-deg", 0.05)
PAIR = "time_tag_offset,along_track_error"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record that leaves open whether the clock or the orbit is wrong, and its diagnosis."""
    place = tmp_path_factory.mktemp("plan")
    text = scenario_text(SECTIONS + THERMAL, seed=4, segment="duration_min = 80.0, step_s = 20.0")
    (place / "real.toml").write_text(text, encoding="utf-8")
    record, _ = fluxtwin.simulate(place / "real.toml")
    fluxtwin.write(record, place / "flight.nc")
    (place / "limits.toml").write_text('[limits]\nhours = 1.2\nattitudes = ["nadir", "tumble"]\n', encoding="utf-8")
    return place


@pytest.fixture(scope="module")
def diagnosis(folder: Path) -> Diagnosis:
    found = fluxtwin.diagnose(folder / "flight.nc", noise_nT=50, lsb_nT=10, attitude_sigma_deg=0.05)
    (folder / "diagnosis.json").write_text(json.dumps(found.to_dict()), encoding="utf-8")
    return found


def test_from_the_confusion_to_the_answer(folder: Path, diagnosis: Diagnosis, cli: Cli) -> None:
    """The record names both; the plan says to tumble; the tumble, flown with the same late clock, names the clock only."""
    assert set(diagnosis.effects[0].group) >= set(PAIR.split(","))
    out, page, said = folder / "plan.toml", folder / "plan.html", folder / "plan.json"
    limits = ("--limits", folder / "limits.toml")
    done = cli("plan", folder / "flight.nc", *FLAGS, *limits, "--out", out, "--html", page, "--json", said)
    assert done.status == 0 and "fly a tumble of 0.5 deg/s" in " ".join(done.out.split())
    plain = json.loads(said.read_text(encoding="utf-8"))
    first = plain["questions"][0]
    assert first["kind"] == "tell_apart" and set(first["names"]) == set(PAIR.split(","))
    assert first["courses"][0]["power"] >= 0.95 and first["courses"][0]["hours"] <= 1.2
    assert first["as_before"]["power"] < 0.6
    text = page.read_text(encoding="utf-8")
    (offered,) = re.findall(r'href="data:application/octet-stream;base64,(.*?)" download="plan.toml"', text)
    assert b64decode(offered).decode("utf-8") in out.read_text(encoding="utf-8") and "data:image/png" in text
    flown = fluxtwin.load_scenario(out).updated({"effects.time_tag_offset.offset_s": 4.0})
    after = fluxtwin.diagnose(fluxtwin.simulate(flown)[0], noise_nT=50, lsb_nT=10, attitude_sigma_deg=0.05)
    assert after.effects[0].name == "time_tag_offset" and "along_track_error" not in after.effects[0].group


def test_what_would_not_have_shown_is_asked_too_and_json_gives_the_same_plan(
    folder: Path, diagnosis: Diagnosis
) -> None:
    limits = {"hours": 1.2, "attitudes": ["nadir", "tumble"]}
    plan, other = (
        fluxtwin.plan(diagnosis, limits=limits),
        fluxtwin.plan(folder / "diagnosis.json", limits=limits, names=PAIR.split(",")),
    )
    said = [one.questions[0].best for one in (plan, other)]
    assert said[0] is not None and said[1] is not None and said[0].words == said[1].words
    assert other.report().startswith("To settle whether it is") and other.plot() is not None
    shown = {question.names[0]: question for question in plan.questions if question.kind == "show"}
    assert {"ring_current", "sun_sensor_head_misalignment"} <= set(shown)
    assert shown["sun_sensor_head_misalignment"].best is None and shown["sun_sensor_head_misalignment"].instead


def test_a_manoeuvre_that_settles_nothing_is_not_said_to(diagnosis: Diagnosis) -> None:
    plan = fluxtwin.plan(diagnosis, limits={"hours": 0.5, "attitudes": ["nadir"]}, names=["hysteresis"])
    best = plan.questions[0].best
    assert best is not None and not best.settles
    assert plan.sentence.startswith("No manoeuvre within the limits settles whether hysteresis is present")
    assert "After the best, nadir pointing for 0.5 h, 90 days later, the answer will be right with" in plan.sentence


def test_limits_that_leave_nothing_and_other_mistakes(folder: Path, diagnosis: Diagnosis, cli: Cli) -> None:
    wrong = folder / "wrong.toml"
    wrong.write_text("[limits]\nhours = 1.0\nmax_rate = 3.0\n", encoding="utf-8")
    done = cli("plan", folder / "flight.nc", *FLAGS, "--limits", wrong)
    assert done.status == 2 and "max_rate_deg_s" in done.err and "Traceback" not in done.err
    done = cli("plan", folder / "flight.nc", *FLAGS, "--for", "time_tag")
    assert done.status == 2 and "time_tag_offset" in done.err
    (folder / "other.json").write_text("{}", encoding="utf-8")
    done = cli("plan", folder / "other.json")
    assert done.status == 2 and "no diagnosis" in done.err
    sunward = {"hours": 1.0, "attitudes": ["nadir"], "keep_from_sun_B": [0.0, 0.0, -1.0], "keep_from_sun_deg": 89.0}
    with pytest.raises(fluxtwin.BadInput, match="no manoeuvre is allowed"):
        fluxtwin.plan(diagnosis, limits=sunward)


def test_its_signature_names_the_keywords() -> None:
    assert {"limits", "names", "scenario", "noise_nT", "where"} <= set(inspect.signature(fluxtwin.plan).parameters)


@pytest.fixture(scope="module")
def calibrated(folder: Path) -> Path:
    """The same flight with a right clock: what is to be calibrated."""
    record, _ = fluxtwin.simulate(fluxtwin.load_scenario(folder / "real.toml").updated({"effects": None}))
    return Path(fluxtwin.write(record, folder / "clean.nc"))


def test_what_halves_the_worst_sigma_of_a_calibration(calibrated: Path, folder: Path, cli: Cli) -> None:
    """Pointing at the Earth leaves an axis of S badly known; the plan says to tumble, and the sigma that it predicts is what
    the fit of both records gives. As the fit finds its errors from the record, its sigma differs from flight to flight by
    some 20 %: a third of four flights' mean is three sigma."""
    declared = {"noise_nT": 50, "lsb_nT": 10, "attitude_sigma_deg": 0.05, "attitude_tau_s": 100}
    out, said = folder / "calibration_plan.toml", folder / "calibration_plan.json"
    flags = ("--for", "calibration", "--attitude-tau-s", 100, "--limits", folder / "limits.toml")
    done = cli("plan", calibrated, *FLAGS, *flags, "--out", out, "--json", said, "--html", folder / "calibration.html")
    plain = json.loads(said.read_text(encoding="utf-8"))
    best, nadir = plain["courses"][0], next(one for one in plain["courses"] if one["words"] == "nadir pointing")
    assert done.status == 0 and best["words"] == "tumble of 0.5 deg/s"
    assert best["sigma"] < 0.5 * plain["sigma"] and best["sigma"] < 0.5 * nadir["sigma"]
    real = fluxtwin.load_scenario(folder / "real.toml").magnetometer
    flown = fluxtwin.load_scenario(out).updated({"magnetometer.S": real.S, "magnetometer.b_nT": real.bias_nT})
    sigmas = []
    for seed in (31, 32, 33, 34):
        fit = fluxtwin.calibrate([calibrated, fluxtwin.simulate(flown.updated({"seed": seed}))[0]], **declared)
        sigmas.append(float(fit.calibration.sigmas[list(fit.calibration.names).index(plain["worst"])]))
    assert sum(sigmas) / 4 == pytest.approx(best["sigma"], rel=0.33)


def test_a_diagnosis_cannot_be_calibrated(folder: Path, diagnosis: Diagnosis) -> None:
    for one in (diagnosis, folder / "diagnosis.json"):
        with pytest.raises(fluxtwin.BadInput, match="no readings"):
            fluxtwin.plan(one, names=["calibration"])
