"""The benchmarks run, compare like with like, and say what they could not run. No speed is tested."""

from __future__ import annotations

import argparse
import ast
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytestmark = pytest.mark.property

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
Run = Callable[..., tuple[dict[str, Any], str]]


def script(name: str) -> ModuleType:
    """A benchmark as a module, not run yet."""
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", FOLDER / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """`quick("field", "--points", 300)`: the record that the benchmark writes, and what it shows."""

    def run(name: str, *options: object) -> tuple[dict[str, Any], str]:
        target = tmp_path / "record.json"
        monkeypatch.setattr("sys.argv", [name, "--quick", *map(str, options), "--json", str(target)])
        assert script(name).main() in (None, 0)
        return json.loads(target.read_text(encoding="utf-8")), capsys.readouterr().out

    return run


def test_attitude_flies_what_basilisk_flies(quick: Run) -> None:
    record, _ = quick("attitude", "--vehicles", 2)
    assert record["fluxtwin_s"] > 0 and record["ensemble"]["vehicles"] == 2
    if "Basilisk" in record["skipped"]:
        assert "pip install bsk" in record["skipped"]["Basilisk"] and "ratio_vs_basilisk" not in record
    else:
        assert record["attitude_difference_deg"] < 1e-4
        assert record["position_difference_m"] < 0.01
        assert record["field_difference_nT"] < 1.0  # its file has two decimals: the same field


def test_an_interpreter_without_basilisk_is_a_reason_and_no_crash() -> None:
    asked = argparse.Namespace(steps=1000, repeats=1, vehicles=1, basilisk="no-such-python")
    assert "no-such-python" in script("attitude").race(asked)["skipped"]["Basilisk"]


def test_ensembles_account_for_the_time(quick: Run) -> None:
    record, _ = quick("ensembles", "--jobs", 1)
    assert record["cpu_per_vehicle_over_that_of_fewer"] > 0.0
    assert record["growth"][1]["vehicles"] == 4 and record["second_start"]["imports_cpu_s"] > 0.0
    parts = record["ms_a_vehicle"]["an orbit each"]
    assert parts["torques, control, integration"] > 0.0 and parts["writing chunks"] > 0.0


def test_calibrations_without_attitude_are_as_good_as_their_data(quick: Run) -> None:
    record, shown = quick("calibration")
    results = record["results"]
    for name in ("fluxtwin twostep", "fluxtwin scalar"):
        for data, most_mG in (("varying", 1.5), ("constant", 0.2), ("passes", 12.0)):  # five sigma at this size
            assert results[name][data]["offset_mG"] < most_mG
    # Where |B| varies, a fit that supposes it constant cannot be near.
    assert results["ellipsoid (Li & Griffiths)"]["constant"]["offset_mG"] < 0.2
    assert results["ellipsoid (Li & Griffiths)"]["varying"]["offset_mG"] > 10.0
    assert all(who in shown for who in results)
    assert all(record["skipped"].values())


def test_sigmas_are_borne_out(quick: Run) -> None:
    """Six seeds a case: a mean square of pulls scatters by sqrt(2/6) at most, three of those above 1 is 2.7."""
    record, shown = quick("sigmas")
    assert [one["case"] for one in record["cases"]] == ["readme", "slow", "scalar"]
    for one in record["cases"]:
        assert one["words"] in shown
        assert one["pull_all"] ** 2 < 2.7, one
        assert one["nees"] < 2.7, one


def test_fields_are_the_same(quick: Run) -> None:
    record, shown = quick("field", "--points", 300, "--repeats", 1)
    assert {"fluxtwin", "chaosmagpy", "ppigrf", "C"} <= record["results"].keys() | record["skipped"].keys()
    for name, row in record["results"].items():
        assert name in shown
        assert row["largest_difference_nT"] < 1e-6, name  # the same field, or the ratio means nothing
    assert all(reason and reason in shown for reason in record["skipped"].values())


def test_one_command_gives_one_table(tmp_path: Path) -> None:
    """Two of its parts: a rival that is not named leaves its line open, and the page has a row for each line."""
    command = [sys.executable, "-m", "benchmarks", "--quick", "--only", "calibration", "--only", "size"]
    command += ["--page", str(tmp_path / "page.md"), "--json", "-"]
    done = subprocess.run(command, cwd=FOLDER.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = json.loads(done.stdout)
    assert [line["work"].split(",")[0] for line in lines] == [
        "linear calibration",
        "the same with all its statistics",
        "installed",
    ]
    assert all(line["bound"] for line in lines) and lines[0]["wanted"] == "15 x"
    assert "llvmlite" in lines[2]["bound"] and float(lines[2]["measured"].split()[-2]) > 100.0
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert page.count("\n| ") == 1 + len(lines) and lines[0]["measured"] in page


@pytest.fixture(scope="module")
def trust(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """A little of the parts that take seconds, in a process of its own, which forks; the sigmas given have one fault."""
    if os.name != "posix":
        pytest.skip("fork and signals of POSIX")
    folder = tmp_path_factory.mktemp("trust")
    cases = [
        {"words": word, "seeds": 300, "nees": 1.0, "pull": {"b1": pull}, "share": {"b1": 0.95}}
        for word, pull in (("good", 1.0), ("wide", 0.8))
    ]
    (folder / "sigmas.json").write_text(json.dumps({"cases": cases}), encoding="utf-8")
    parts = [
        f"--only={part}" for part in ("hostile", "commands", "bits", "bombs", "disk", "orders", "answers", "sigmas")
    ]
    given = [*parts, "--sigmas", str(folder / "sigmas.json"), "--json", str(folder / "trust.json")]
    command = [sys.executable, "-m", "benchmarks.trust", "--quick", *given]
    done = subprocess.run(command, cwd=FOLDER.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    rows: list[dict[str, Any]] = json.loads((folder / "trust.json").read_text(encoding="utf-8"))["rows"]
    return rows


def test_files_can_be_trusted(trust: list[dict[str, Any]]) -> None:
    rows = {row["name"]: row for row in trust[:-3]}
    assert [row["faults"] for row in rows.values() if row["faults"]] == []
    assert all(row["trials"] or "no right" in row["note"] for row in rows.values())
    assert rows["one bit flipped in a file of ours"]["trials"] >= 120
    readers = 22 - (importlib.util.find_spec("pyarrow") is None)
    assert f"copies of {readers} files" in rows["damaged files through their readers"]["note"]
    assert len(rows) == 1 + 1 + 1 + 1 + 6 + 1


def test_what_frozen_runs_and_sigmas_have_found_is_counted(trust: list[dict[str, Any]]) -> None:
    """The newest frozen run of each population counts; a case of the sigmas that misses a limit is a fault."""
    nulls, sizes, of_sigmas = trust[-3:]
    runs = [json.loads(line) for line in (FOLDER / "withheld.log").read_text(encoding="utf-8").splitlines()]
    for row, population in ((nulls, "nulls"), (sizes, "limits")):
        newest = [run for run in runs if population in run["counts"]][-1]
        assert row["trials"] == newest["counts"][population] and newest["commit"].startswith(row["commit"])
    assert of_sigmas["trials"] == 2 and of_sigmas["faults"] == ["wide: pull"]


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("attitude", "--vehicles=-3"),
        ("ensembles", "--vehicles=0"),
        ("calibration", "--samples=3"),
        ("field", "--points=-3"),
    ],
)
def test_a_size_that_cannot_be_is_an_error_in_one_line(
    name: str, option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", [name, option])
    with pytest.raises(SystemExit) as stopped:
        raise SystemExit(script(name).main())
    assert stopped.value.code == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said and all(line.startswith(("usage:", " ")) for line in said[:-1])


def test_a_mutant_changes_one_place() -> None:
    mutants = script("mutants")
    some = mutants.drawn(60, seed=1)
    assert len(set(some)) == 60 and len({one.change for one in some}) == 12
    for one in some:
        right = (FOLDER.parent / one.file).read_text(encoding="utf-8")
        wrong = right[: one.start] + one.wrong + right[one.end :]
        assert right[one.start : one.end] == one.right
        assert ast.dump(ast.parse(wrong)) != ast.dump(ast.parse(right)), one
