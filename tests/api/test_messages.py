"""Messages: one line that says what was given and what is wanted; the rest with --verbose, or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from command_line import Cli
from worlds import scenario_text

import fluxtwin

SCENARIO = scenario_text(seed=7, epoch_utc="2012-03-01T00:00:00Z", segment="samples = 5, step_s = 60.0")
CALIBRATION = """convention = "A B0 = (I+S) B + b + T D"
S = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
b_nT = [0.0, 0.0, 0.0]
"""
MAP = """[[file]]
path = "mag-*.csv"
time = { recipe = "unix_s", columns = "t" }
[file.columns]
mag = { from = ["x", "y", "z"], unit = "nT" }
"""
TELEMETRY = "time,r_x_km,r_y_km,r_z_km,mag_x_nT,mag_y_nT,mag_z_nT\n2012-03-01T00:00:00Z,7000,0,0,1,2,3\n"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scenario, a calibration and a column map; the working directory is in it."""
    for name, text in {"s.toml": SCENARIO, "c.toml": CALIBRATION, "m.toml": MAP}.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "t.csv").write_text(TELEMETRY, encoding="utf-8")
    (tmp_path / "data").mkdir()
    for part in (0, 1):
        rows = "".join(f"{60 * part + row},{row},2,3\n" for row in range(30))
        (tmp_path / "data" / f"mag-{part}.csv").write_text(f"t,x,y,z\n{rows}99,1", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("apply t.csv --calibration s.toml --out x.nc", "s.toml: this is a scenario. Wanted: a calibration file"),
        ("apply t.csv --calibration m.toml --out x.nc", "m.toml: this is a column map. Wanted: a calibration file"),
        ("simulate c.toml --out x.nc", "c.toml: this is a calibration file. Wanted: a scenario"),
        ("simulate m.toml --out x.nc", "m.toml: this is a column map. Wanted: a scenario"),
        ("check data --map s.toml", "s.toml: this is a scenario. Wanted: a column map"),
        ("calibrate s.toml", "s.toml: is not telemetry"),
        ("info s.toml", "s.toml: is not telemetry"),
        ("map s.toml", "s.toml: is not telemetry"),
        ("diagnose t.csv --modelled bais", "no effect is called 'bais'; did you mean bias?"),
        ("diagnose t.csv --modelled bais,saturation", "did you mean bias?"),
        ("calibrate t.csv --block-s -1", "fluxtwin: --block-s: -1.0. Wanted: seconds"),
    ],
)
def test_the_wrong_kind_of_thing_costs_one_line_that_says_what_it_is(
    cli: Cli, here: Path, words: str, said: str
) -> None:
    outcome = cli(*words.split())
    assert outcome.status == 2
    assert said in outcome.err
    assert outcome.err.count("\n") == 1
    assert len(outcome.err) < 200
    assert "?." not in outcome.err


@pytest.mark.parametrize(
    ("name", "old", "new", "said", "known"),
    [
        ("s.toml", "altitude_km", "altitud_km", "did you mean altitude_km?", "inclination_deg"),
        ("s.toml", "[schedule]", "[zzz]\n[schedule]", "unknown key zzz", "magnetometer"),
        ("c.toml", "b_nT =", "cov = 1\nb_nT =", "unknown key cov", "unobservable"),
    ],
)
def test_an_unknown_key_is_one_line_and_verbose_lists_the_known(
    cli: Cli, here: Path, name: str, old: str, new: str, said: str, known: str
) -> None:
    (here / name).write_text((here / name).read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    command = ["simulate", name] if name == "s.toml" else ["apply", "t.csv", "--calibration", name]
    short = cli(*command, "--out", "x.nc")
    assert short.status == 2
    assert said in short.err and known not in short.err and "-v" in short.err
    assert short.err.count("\n") == 1
    for long in (cli(*command, "--out", "x.nc", "-v"), cli("--verbose", *command, "--out", "x.nc")):
        assert said in long.err and known in long.err
    assert known not in cli(*command, "--out", "x.nc").err, "-v is for one call"


def test_a_column_map_with_text_for_a_table_is_shown_what_it_looks_like(cli: Cli, here: Path) -> None:
    (here / "m.toml").write_text(MAP.replace('{ recipe = "unix_s", columns = "t" }', '"t"'), encoding="utf-8")
    assert 'as { recipe = "unix_ms", columns = "t" } (found \'t\')' in cli("check", "data", "--map", "m.toml").err


@pytest.mark.parametrize("key", ["epoch_utc", "start_utc"])
@pytest.mark.parametrize("stamp", ["2012-03-01T00:00:00", "2012-03-01 00:00:00"])
def test_a_time_without_its_zone_is_refused_with_what_to_write(cli: Cli, here: Path, key: str, stamp: str) -> None:
    (here / "s.toml").write_text(
        SCENARIO.replace(f'{key} = "2012-03-01T00:00:00Z"', f'{key} = "{stamp}"'), encoding="utf-8"
    )
    outcome = cli("simulate", "s.toml", "--out", "x.nc")
    assert outcome.status == 2
    assert key in outcome.err and 'write "2012-03-01T00:00:00Z"' in outcome.err


def test_notes_are_said_once_without_paths_and_not_at_all_when_quiet(cli: Cli, here: Path) -> None:
    call = ["calibrate", here / "data", "--map", "m.toml"]
    (note,) = [line for line in cli(*call).err.splitlines() if line.startswith("note: ")]
    assert "mag-0.csv, mag-1.csv: the last row has no line end" in note
    assert str(here) not in note
    for quiet in ((*call, "-q"), ("--quiet", *call)):
        outcome = cli(*quiet)
        assert "note: " not in outcome.err
        assert outcome.err.startswith("fluxtwin: "), "an error is said all the same"


FRAME = pd.DataFrame({"time": ["2012-03-01T00:00:00Z"], "mag_x_nT": [1.0]})


@pytest.mark.parametrize(
    "verb",
    [
        fluxtwin.read,
        fluxtwin.check,
        fluxtwin.calibrate,
        fluxtwin.diagnose,
        lambda given: fluxtwin.calibrate([given]),
        lambda given: fluxtwin.apply(given, "c.toml"),
    ],
)
@pytest.mark.parametrize(
    ("given", "said"),
    [
        (FRAME, ["DataFrame: column mag_y_nT is missing"]),
        (xr.Dataset({"mag_x_nT": ("time", np.zeros(3))}), ["no variable holds stamps"]),
        (3, ["int was given", "path of a file", "fluxtwin.Telemetry", "pandas DataFrame"]),
    ],
)
def test_a_verb_says_what_it_was_given_and_what_it_wants(
    verb: Callable[[object], object], given: object, said: list[str]
) -> None:
    with pytest.raises(fluxtwin.BadInput) as caught:
        verb(given)
    for words in said:
        assert words in str(caught.value)


def test_the_shell_completes_commands() -> None:
    asked = {"_FLUXTWIN_COMPLETE": "complete_bash", "COMP_WORDS": "fluxtwin cal", "COMP_CWORD": "1"}
    command = [sys.executable, "-c", "from fluxtwin.cli import main; main()"]
    done = subprocess.run(command, env={**os.environ, **asked}, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["calibrate"]
    assert done.stderr == ""
