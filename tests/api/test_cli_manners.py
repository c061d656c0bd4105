"""The command line as a person meets it: help at once, one message for a mistake, the promised statuses."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from command_line import Cli

COMMANDS = (
    "run",
    "simulate",
    "ensemble",
    "check",
    "calibrate",
    "apply",
    "yaw",
    "attitude",
    "diagnose",
    "effects",
    "field",
)
HEAVY = (
    "numpy",
    "scipy",
    "numba",
    "matplotlib",
    "xarray",
    "pandas",
    "pydantic",
    "erfa",
    "sgp4",
    "jinja2",
    "h5py",
)
POINT = ("field", "--date", "2020-01-01", "--lat", "45", "--lon", "3", "--alt-km", "0")


def test_help_names_every_command_and_imports_nothing_heavy() -> None:
    code = (
        "import sys; from fluxtwin.cli import main; status = main(['--help']);"
        f"print(status, sorted(set({HEAVY!r}) & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 []"
    for name in COMMANDS:
        assert re.search(rf"^  {name} ", done.stdout, re.MULTILINE)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself_and_takes_json(cli: Cli, name: str) -> None:
    outcome = cli(name, "--help")
    assert outcome.status == 0
    assert "--json" in outcome.out
    assert "FILE" in outcome.out
    if name in ("check", "calibrate", "apply", "yaw", "attitude"):
        assert "--map" in outcome.out
        assert "--tle" in outcome.out
    if name not in ("run",):
        assert ("--field" in outcome.out) == ("--degree" in outcome.out)
    if name in ("field", "simulate", "check", "calibrate", "yaw", "attitude"):
        assert "--field" in outcome.out


def test_units_survive_in_the_help(cli: Cli) -> None:
    text = cli("field", "--help").out
    assert "[nT]" in text
    assert "[km]" in text


def test_the_version(cli: Cli) -> None:
    import fluxtwin

    assert cli("--version").out == f"fluxtwin {fluxtwin.__version__}\n"


def test_a_mistyped_command_or_option_is_named_with_the_nearest(cli: Cli) -> None:
    command = cli("feild")
    assert command.status == 2
    assert "field" in command.err
    option = cli(*POINT, "--degre", "8")
    assert option.status == 2
    assert "--degree" in option.err


def test_field_as_json_alone_on_standard_output(process: Cli) -> None:
    outcome = process(*POINT, "--json", "-")
    assert outcome.status == 0
    record = json.loads(outcome.out)
    assert set(record) >= {"F_nT", "north_nT", "east_nT", "down_nT", "declination_deg", "inclination_deg"}
    total = (record["north_nT"] ** 2 + record["east_nT"] ** 2 + record["down_nT"] ** 2) ** 0.5
    assert abs(record["F_nT"] - total) < 1e-6


def test_field_as_json_in_a_file(cli: Cli, tmp_path: Path) -> None:
    outcome = cli(*POINT, "--json", tmp_path / "field.json")
    assert outcome.status == 0
    assert "nT" in outcome.out
    assert json.loads((tmp_path / "field.json").read_text(encoding="utf-8"))["degree"] == 13


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("--lat", "91"), ["--lat", "91", "-90 to 90"]),
        (("--lat", "nan"), ["--lat", "-90 to 90"]),
        (("--lon", "400"), ["--lon", "-180 to 360"]),
        (("--date", "yesterday"), ["--date", "yesterday", "ISO 8601"]),
        (("--date", "1850-01-01"), ["1850", "igrf14", "1900", "2030"]),
        (("--field", "igrf15"), ["igrf15", "igrf14", "igrf1975", "chaos:FILE"]),
        (("--field", "chaos:missing.mat"), ["missing.mat"]),
        (("--degree", "40"), ["40", "1 to 13"]),
        (("--degree", "0"), ["0", "1 to 13"]),
    ],
)
def test_field_says_what_is_wrong_where_and_what_is_wanted(cli: Cli, change: tuple[str, str], words: list[str]) -> None:
    outcome = cli(*POINT, *change)
    assert outcome.status == 2
    assert outcome.out == ""
    assert outcome.err.startswith("fluxtwin: ")
    assert outcome.err.count("\n") == 1
    for word in words:
        assert word in outcome.err


def test_an_unknown_study_is_answered_with_the_nearest(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("run", "saesat", "--out", tmp_path / "out")
    assert outcome.status == 2
    assert "did you mean 'seasat'" in outcome.err
    assert not (tmp_path / "out").exists()


def test_a_data_folder_that_is_not_there(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("run", "flight-field", "--data", tmp_path / "none", "--out", tmp_path / "out")
    assert outcome.status == 2
    assert "none" in outcome.err


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 2, "memory"),
        (OSError(28, "No space left on device", "x.nc"), 2, "x.nc: No space left"),
        (ZeroDivisionError("a bug"), 70, "internal error"),
        (RecursionError("deep"), 70, "internal error"),
        (typer.Abort(), 130, "interrupted"),
    ],
)
def test_what_nobody_expects_costs_one_line(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int, words: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.delenv("FLUXTWIN_DEBUG", raising=False)
    monkeypatch.setattr("fluxtwin.verbs.field", fail)
    outcome = cli(*POINT)
    assert outcome.status == status
    assert words in outcome.err
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.err


def test_an_option_without_its_value_is_said_to_lack_it(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("calibrate", tmp_path / "x.csv", "--robust", "--out", tmp_path / "c.toml")
    assert outcome.status == 2
    assert "--robust: '--out' is no treatment of outliers" in outcome.err


@pytest.mark.parametrize("there", [True, False])
def test_an_interrupted_study_leaves_no_folder_of_its_own(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    from fluxtwin import studies

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(studies, "find_study", lambda name: interrupted)
    if there:
        (tmp_path / "results").mkdir()
    assert cli("run", "seasat", "--out", tmp_path / "results").status == 130
    assert (tmp_path / "results").exists() == there


def test_a_reader_that_goes_away_is_no_error() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    command = [sys.executable, "-m", "fluxtwin", *POINT]
    done = subprocess.run(command, stdout=write_end, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write_end)
    assert [line for line in done.stderr.splitlines() if not line.endswith(" ...")] == []
    assert done.returncode == 0


@pytest.mark.parametrize(("command", "status"), [(POINT, 0), (("check", "none.csv"), 2)])
@pytest.mark.parametrize("both", [False, True])
def test_without_a_reader_files_are_written_and_the_status_is_the_command_s(
    command: tuple[str, ...], status: int, both: bool, tmp_path: Path
) -> None:
    """Unbuffered, so that the first line meets the closed pipe; standard error may go into it, too."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    error = write_end if both else subprocess.PIPE
    asked = [sys.executable, "-u", "-m", "fluxtwin", *command, "--json", str(tmp_path / "x.json")]
    done = subprocess.run(asked, stdout=write_end, stderr=error, text=True, check=False, cwd=tmp_path)
    os.close(write_end)
    assert done.returncode == status
    assert (tmp_path / "x.json").exists() == (status == 0)
    assert both or ("Traceback" not in done.stderr and "ignored" not in done.stderr)


@pytest.mark.skipif(os.name != "posix", reason="a shell closes the stream")
def test_a_closed_standard_output_is_no_error() -> None:
    command = f"{sys.executable} -m fluxtwin {' '.join(POINT)} --json - >&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_it_works_without_a_network_a_compiler_or_a_home(tmp_path: Path) -> None:
    code = (
        "import socket, sys\n"
        "def refuse(*_, **__): raise AssertionError('the network was asked for')\n"
        "socket.socket.connect = socket.getaddrinfo = socket.create_connection = refuse\n"
        "from fluxtwin.cli import main\n"
        f"sys.exit(main({list(POINT)!r}))"
    )
    bare = {"PATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "LC_ALL": "C"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=bare)
    assert done.returncode == 0, done.stderr
    assert "F " in done.stdout
