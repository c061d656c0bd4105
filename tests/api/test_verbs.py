"""The verbs of Python as a person types them: files as text, scenarios by name."""

from __future__ import annotations

import inspect
import json
import pickle
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from worlds import scenario_text, tumbling

import fluxtwin
from fluxtwin.sim.base.doors import as_verb
from fluxtwin.sim.scenario.scenario import parse_scenario

MAGNETOMETER = "\n[magnetometer]\nb_nT = [1000.0, -500.0, 300.0]\nnoise_nT = 20.0\n"


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("verbs")
    (folder / "s.toml").write_text(scenario_text(MAGNETOMETER), encoding="utf-8")
    telemetry, _ = fluxtwin.simulate(str(folder / "s.toml"))
    return str(fluxtwin.write(telemetry, str(folder / "t.nc")))


@pytest.fixture(scope="module")
def known() -> tuple[fluxtwin.Telemetry, Any]:
    record, _ = fluxtwin.simulate("cubesat")
    return record, fluxtwin.calibrate(record)


def test_yaw_of_a_file(flown: str) -> None:
    fit = fluxtwin.calibrate(flown)
    solution = fluxtwin.yaw(flown, fit.calibration, attitude_sigma_deg=0.05, average_s=60.0)
    error = solution.rms_error_rad()
    assert error is not None and 0.0 < np.degrees(error) < 2.0
    with pytest.raises(fluxtwin.BadInput):
        fluxtwin.yaw(flown)  # neither corrected nor a calibration


def test_the_number_of_threads_changes_no_bit(flown: str) -> None:
    """BLAS adds up in another order with another number of threads; inside the verbs it has one, and after them as many as
    before."""
    said = []
    for threads in (1, 2):
        with threadpool_limits(threads, user_api="blas"):
            said.append(json.dumps(fluxtwin.diagnose(flown).to_dict()) + repr(fluxtwin.calibrate(flown).calibration))
            assert {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"} == {threads}
    assert said[0] == said[1]
    assert "noise_nT" in inspect.signature(fluxtwin.diagnose).parameters


def test_lists_may_be_typed_as_on_the_command_line(flown: str) -> None:
    with pytest.raises(fluxtwin.BadInput, match="no effect is called 'biass'"):
        fluxtwin.diagnose(flown, modelled="biass,scale_misalignment")
    record = fluxtwin.read(flown)
    load = record.replace(drivers={"load": np.arange(len(record)) % 10 < 5.0})
    assert "driver_load" in fluxtwin.calibrate(load, driver="load").calibration.telemetry_bias
    assert not fluxtwin.calibrate(load, driver="all").calibration.telemetry_bias, "it drives nothing"
    with pytest.raises(fluxtwin.BadInput, match="no effect is called 'biass'"):
        apart = {str(row): record.replace(mag_B_nT=record.mag_B_nT + row) for row in range(3)}
        fluxtwin.fleet(apart, modelled="biass", jobs=1)
    with pytest.raises(fluxtwin.BadInput, match="b: has the same readings as a"):
        fluxtwin.fleet(dict.fromkeys("abc", flown), jobs=1)
    with pytest.raises(fluxtwin.BadInput, match="2: has the same readings as 1"):  # most of them
        fluxtwin.fleet({"0": apart["2"], "1": record[:30], "2": record[10:]}, modelled="biass", jobs=1)
    later = record[10:45].replace(time=record.time[10:45] + np.timedelta64(1, "h"))
    with pytest.raises(fluxtwin.BadInput, match="2: has the same readings as 0"):  # under other stamps
        fluxtwin.fleet({"0": record, "1": apart["1"], "2": later}, modelled="biass", jobs=1)
    with pytest.raises(fluxtwin.BadInput, match="a diagnosis has no readings to calibrate"):
        fluxtwin.plan("found.json", names="calibration")


def test_a_table_is_one_record_to_a_trend(flown: str) -> None:
    with pytest.raises(fluxtwin.BadInput, match="two"):
        fluxtwin.trend(fluxtwin.read(flown).to_pandas())


def test_effects_by_name() -> None:
    assert {effect.name for effect in fluxtwin.effects()} >= {"bias", "time_tag_offset"}
    assert [effect.name for effect in fluxtwin.effects("bias")] == ["bias"]
    with pytest.raises(fluxtwin.BadInput, match="bias"):
        fluxtwin.effects("biass")


def test_passes_of_a_packaged_scenario() -> None:
    found = fluxtwin.passes("hcmm")
    assert found and {"station", "rise", "set"} <= set(found[0])
    with pytest.raises(fluxtwin.BadInput, match="no station"):
        fluxtwin.passes("cubesat")


def test_a_map_from_a_header(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text("time,Bx_nT,By_nT,Bz_nT\n2026-03-01T00:00:00Z,20000,100,-30000\n", encoding="utf-8")
    assert "[[file]]" in fluxtwin.draft_map(str(tmp_path / "f.csv"))
    with pytest.raises(fluxtwin.BadInput, match="no file was named"):
        fluxtwin.draft_map([])


def test_an_unguarded_script_flies_an_ensemble_in_processes(tmp_path: Path) -> None:
    """The script is not run again in each process, from a file or from standard input."""
    (tmp_path / "s.toml").write_text(scenario_text(MAGNETOMETER), encoding="utf-8")
    code = "import fluxtwin; print(len(fluxtwin.ensemble('s.toml', 4, 'OUT', jobs=2, in_chunk=1).summary) > 0)"
    (tmp_path / "script.py").write_text(code.replace("OUT", "a-results"), encoding="utf-8")
    for words, fed in ((["script.py"], None), (["-"], code.replace("OUT", "b-results"))):
        done = subprocess.run(
            [sys.executable, *words], cwd=tmp_path, input=fed, capture_output=True, text=True, timeout=240, check=False
        )
        assert done.stdout == "True\n", done.stderr


@pytest.mark.parametrize(
    ("call", "wanted"),
    [
        (lambda record, fit: fluxtwin.apply(record, fit), "Wanted: the `.calibration` of a fit, or the path"),
        (lambda record, fit: fluxtwin.apply(record, np.eye(3)), "an object of type numpy ndarray was given"),
        (
            lambda record, fit: fluxtwin.calibrate(record, parameters=["b", "S"]),
            "parameters: ['b', 'S'] is not text. Wanted: text, as 'b,S'",
        ),
        (lambda record, fit: fluxtwin.simulate({"seed": 1}), "Wanted: the path of a scenario as TOML, or cubesat"),
        (lambda record, fit: fluxtwin.field("2026-03-01", [52.0, 53.0], 4.0), "[52.0, 53.0] is not one number"),
        (lambda record, fit: fluxtwin.field("2026-03-01", 52.0, "4E"), "'4E' is not one number"),
        (lambda record, fit: fluxtwin.field(2026.2, 52.0, 4.0), "2026.2 is no time"),
        (lambda record, fit: fluxtwin.field("2026-03-01", 52.0, 4.0, degree=8.5), "degree: 8.5 is not a whole number"),
        (lambda record, fit: fluxtwin.yaw(record, fit.calibration, sigma_nT="5"), "sigma_nT: '5' is not one number"),
        (lambda record, fit: fluxtwin.diagnose(record, noise_nT=[20.0] * 3), "[20.0, 20.0, 20.0] is not one number"),
        (lambda record, fit: fluxtwin.diagnose(record, attitude_sigma_deg="0.1"), "'0.1' is not one number"),
        (
            lambda record, fit: fluxtwin.repair(record.to_pandas(), "r.csv"),
            "an object of type pandas DataFrame was given",
        ),
        (lambda record, fit: fluxtwin.export("px4", fit.calibration), "to: an object of type"),
        (lambda record, fit: fluxtwin.fleet([record] * 3), "Wanted: a dict of records by the name of the vehicle"),
        (lambda record, fit: fluxtwin.calibrate(record, attitude_sigma_deg="0.1"), "attitude_sigma_deg: '0.1'"),
        (lambda record, fit: fluxtwin.check(record, onboard=fit), "Wanted: the `.calibration` of a fit"),
        (lambda record, fit: record["mag_x_nT"], "columns are in record.to_pandas()"),
        (lambda record, fit: record[["mag_x_nT"]], "['mag_x_nT'] chooses no rows"),
        (lambda record, fit: record[np.ones(5, dtype=bool)], "size of axis is 1801"),
        (lambda record, fit: record[[1, [2]]], "[1, [2]] chooses no rows"),
        (lambda record, fit: record[:, 1], "Wanted: a mask, indices or times"),
        (lambda record, fit: record.where(5), "where: 5 is not text"),
        (lambda record, fit: record.between("2027"), "start: '2027' is not a time"),
        (lambda record, fit: fluxtwin.follow(3), "an object of type int was given"),
        (lambda record, fit: fit.calibration.apply("x"), "mag_B_nT: is no array of numbers"),
        (lambda record, fit: fluxtwin.attitude(record, noise_nT="5"), "noise_nT: '5' is not one number"),
        (lambda record, fit: fluxtwin.attitude(record, noise_nT=True), "Wanted: one number [nT] or None"),
        (lambda record, fit: fluxtwin.calibrate(record, noise_nT="5"), "Wanted: one number [nT] or an array"),
        (lambda record, fit: fluxtwin.calibrate(record, weights=[[1.0], []]), "weights: [[1.0], []] is not an array"),
        (lambda record, fit: fluxtwin.calibrate(record, errors_in_variables="yes"), "'yes' is not True or False"),
        (lambda record, fit: fluxtwin.calibrate(record, driver=[5]), "driver: [5] is not a list of names"),
        (lambda record, fit: fluxtwin.calibrate(record, driver=np.ones(9)), "driver: [np.float64(1.0), "),
        (lambda record, fit: fluxtwin.calibrate(record, driver=np.array(1.0)), "Wanted: a list of names"),
        (lambda record, fit: fluxtwin.diagnose(record, modelled=np.ones(3)), "is not a list of names"),
        (lambda record, fit: fluxtwin.calibrate(record, field=3), "Wanted: text or a FieldModel"),
        (lambda record, fit: fluxtwin.calibrate(record, progress="no"), "progress: 'no' is not a function"),
        (lambda record, fit: fluxtwin.read("t.nc", where=5), "where: 5 is not text"),
        (lambda record, fit: fluxtwin.read(record.to_pandas(), max_samples=0), "max_samples: 0. Wanted: 1 or more"),
        (lambda record, fit: fluxtwin.ensemble("cubesat", 2.5, "out"), "vehicles: 2.5 is not a whole number"),
        (lambda record, fit: fluxtwin.ensemble("cubesat", 2, "out", executor=3), "Wanted: an executor or None"),
        (lambda record, fit: fluxtwin.repair("t.nc", None), "out: None is not a path. Wanted: a path"),
        (lambda record, fit: fluxtwin.repair(record, "r.csv"), "an object of type fluxtwin Telemetry was given"),
        (lambda record, fit: fluxtwin.plan(record, limits=3), "Wanted: a LimitsSection or a dict or a path"),
        (lambda record, fit: fluxtwin.close(record, scenario=None, telemetry="t.nc"), "Wanted: a Diagnosis"),
        (lambda record, fit: fit.calibration.apply(record.mag_B_nT.T), "has shape (3, 1801). Wanted: shape (N, 3)"),
    ],
)
def test_an_object_of_another_kind_is_refused_in_words(
    call: Any, wanted: str, known: tuple[fluxtwin.Telemetry, Any]
) -> None:
    with pytest.raises(fluxtwin.BadInput) as refused:
        call(*known)
    assert wanted in str(refused.value)


def test_none_is_the_default_and_numbers_of_numpy_are_numbers(known: tuple[fluxtwin.Telemetry, Any]) -> None:
    record, _ = known
    given = {"degree": np.int32(13), "errors_in_variables": np.bool_(True), "attitude_tau_s": np.float32(0.0)}
    again = fluxtwin.calibrate(record, field=None, robust=None, progress=None, magnetometer=None, **given)
    assert fluxtwin.calibrate(record, errors_in_variables=True, attitude_tau_s=0.0) == again


def test_names_may_come_as_an_array_or_an_iterator() -> None:
    def verb(names: Sequence[str] = ()) -> list[str]:
        return [*names, *names] if names else []  # looked at, and more than once

    asked = as_verb("fluxtwin", "verb", verb, {}, {})
    for given in (np.array(["a", "b"]), iter(["a", "b"]), ("a", "b")):
        assert asked(given) == ["a", "b", "a", "b"]
    assert asked("a") == ["a", "a"]


@pytest.mark.parametrize("verb", ["calibrate", "diagnose", "attitude", "plan", "trend"])
def test_a_misspelled_keyword_costs_a_hint(verb: str) -> None:
    with pytest.raises(TypeError, match=rf"^fluxtwin\.{verb}: .*attitude_sigma'; did you mean attitude_sigma_deg\?"):
        getattr(fluxtwin, verb)("t.nc", attitude_sigma=0.1)
    with pytest.raises(TypeError, match="missing a required argument"):
        getattr(fluxtwin, verb)()


def test_a_refusal_names_keywords_not_options(flown: str, tmp_path: Path) -> None:
    record = fluxtwin.read(flown)
    mine = fluxtwin.calibrate(record).calibration
    for call, said in (
        (
            lambda: fluxtwin.read(flown, start="2030-01-01", end="2029-01-01"),
            "end 2029-01-01T00:00:00Z: is not after start.",
        ),
        (lambda: fluxtwin.calibrate(record, method="mine"), "method: 'mine' is not a method"),
        (
            lambda: fluxtwin.calibrate(record, method="gyro", sun_sigma_deg=1.0),
            "method batch or iterative or recursive, or",
        ),
        (lambda: fluxtwin.apply(fluxtwin.apply(record, mine), mine), "force=True corrects them once more"),
        (lambda: fluxtwin.yaw(record), 'Wanted: calibration="FILE.toml", or a record that'),
        (
            lambda: fluxtwin.apply(record, replace(mine, magnetometer=2)),
            "Wanted: magnetometer=2, or the other calibration",
        ),
        (lambda: fluxtwin.calibrate(record[:5]), 'fewer parameters (parameters="b")'),
        (lambda: fluxtwin.calibrate(record, parameters="b,S,T"), 'the dipole columns, or parameters="b,S"'),
        (lambda: fluxtwin.Calibration(np.eye(3), np.ones(3), np.eye(3)).apply(record.mag_B_nT), "b and S"),
        (lambda: record.with_magnetometer(3), "Wanted: magnetometer 1 or 2"),
        (
            lambda: fluxtwin.diagnose(record.replace(mag_B_nT=0.1 * record.mag_B_nT), modelled="bias,torquer_coupling"),
            "modelled: torquer_coupling follows the torquer dipole, and the telemetry has none",
        ),
        (lambda: fluxtwin.trend(record, every_h=-1.0), "every_h: -1"),
        (lambda: fluxtwin.plan(record, names="biass"), "names: no effect is called"),
        (lambda: fluxtwin.draft_map(tmp_path), str(tmp_path)),
        (lambda: fluxtwin.draft_map(record), "Telemetry was given. Wanted: the path of a foreign file, or several"),
        (lambda: fluxtwin.read(flown, column_map="[[file]]\n"), "column_map: is the text of a map, not its file"),
    ):
        with pytest.raises(fluxtwin.FluxtwinError) as refused:
            call()
        assert said in str(refused.value) and "--" not in str(refused.value)


def test_an_answer_names_keywords_too_but_leaves_whole_commands(known: tuple[fluxtwin.Telemetry, Any]) -> None:
    record, _ = known
    found = fluxtwin.diagnose(record[::6], noise_nT=500.0)
    assert found.sentence.endswith("(lsb_nT, attitude_sigma_deg).")
    assert any("Correct noise_nT, or leave it out" in note for note in found.notes)
    assert "--field" not in str(fluxtwin.calibrate(record, parameters="b,S,T"))
    fit = fluxtwin.calibrate(record, parameters="b,S")
    assert 'compare with parameters="b,S,T"' in " ".join(fit.messages)
    assert "fluxtwin calibrate TELEMETRY --parameters b,S,T" in f"{fit.verdict.lines} {fit}"


def test_a_check_names_its_own_keywords_and_the_commands_of_others(
    known: tuple[fluxtwin.Telemetry, Any], tmp_path: Path
) -> None:
    record, _ = known
    two = fluxtwin.write(record.replace(mag2_B_nT=record.mag_B_nT), tmp_path / "two.nc")
    (note,) = [note.text for note in fluxtwin.check(two).notes if note.code == "two_magnetometers"]
    assert note.endswith("`magnetometer=2` checks the other one")
    mag = np.array(record.mag_B_nT)
    mag[7] += 40_000.0
    (outliers,) = fluxtwin.check(record.replace(mag_B_nT=mag)).traps
    assert outliers.text.endswith("or calibrate without them (`fluxtwin calibrate --robust tukey`)")


def test_no_verb_writes_over_what_it_has_read(flown: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    fluxtwin.convert(flown, "t.csv")
    before = Path("t.csv").read_bytes()
    part = fluxtwin.read("t.csv")[:100].replace(sunlit=None)
    for call in (
        lambda: fluxtwin.convert("t.csv", "./t.csv"),
        lambda: fluxtwin.write(part, tmp_path / "t.csv"),
        lambda: fluxtwin.repair("t.csv", "t.csv"),
    ):
        with pytest.raises(fluxtwin.BadInput, match="Wanted: another name"):
            call()
    assert Path("t.csv").read_bytes() == before
    for _ in range(2):  # another file is replaced, though it holds the same
        fluxtwin.write(fluxtwin.read("t.csv"), "copy.csv")


def test_a_warning_points_at_who_asked(known: tuple[fluxtwin.Telemetry, Any]) -> None:
    record, fit = known
    later = record.replace(time=record.time + np.timedelta64(1, "D"))
    with pytest.warns(UserWarning, match="of another time") as seen:
        fluxtwin.apply(later, fit.calibration)
    assert {one.filename for one in seen} == {__file__}


def test_a_verb_can_be_sent_to_another_process() -> None:
    for name in fluxtwin.__all__[1:]:
        assert pickle.loads(pickle.dumps(getattr(fluxtwin, name))) is getattr(fluxtwin, name)


def test_an_effect_is_not_closed_on_a_record_in_memory(tmp_path: Path) -> None:
    sections = MAGNETOMETER + "[effects.bias_step]\nb_nT = [400.0, 300.0, 300.0]\n"
    (tmp_path / "s.toml").write_text(scenario_text(sections, segment="samples = 600, step_s = 10.0"), encoding="utf-8")
    record, _ = fluxtwin.simulate(tmp_path / "s.toml")
    found = fluxtwin.diagnose(record, noise_nT=20.0, attitude_sigma_deg=0.1)
    with pytest.raises(fluxtwin.BadInput, match=r"Telemetry was given\. Wanted: a path"):
        fluxtwin.close(found, scenario=None, telemetry=record)


@pytest.mark.parametrize("zone", ["UTC", "Europe/Amsterdam", None])
def test_the_field_at_a_time_of_pandas(zone: str | None) -> None:
    when = pd.Timestamp("2026-03-01T12:00", tz="UTC").tz_convert(zone)
    assert fluxtwin.field(when, 52.0, 4.0) == fluxtwin.field("2026-03-01T12:00:00Z", 52.0, 4.0)


def test_help_says_what_a_scenario_may_be() -> None:
    assert str(inspect.signature(fluxtwin.simulate).parameters["scenario"].annotation) == "Scenario | Path | str"


def test_a_diagnosis_takes_a_loaded_field_as_the_other_verbs_do() -> None:
    record, _ = fluxtwin.simulate(parse_scenario(tumbling()))
    cut = fluxtwin.load_field("igrf14", 11)
    found, named = (
        fluxtwin.diagnose(record[:60], field=one, degree=n).gap.before_nT for one, n in ((cut, None), ("igrf14", 11))
    )
    assert found == named != fluxtwin.diagnose(record[:60]).gap.before_nT
