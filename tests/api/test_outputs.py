"""Where an output may go: never onto an input, never two into one file, nobody else's file without --force."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import pytest
from command_line import Cli, status_of
from worlds import scenario_text

from fluxtwin import outputs
from fluxtwin.outputs import written_by_fluxtwin
from fluxtwin.sim.base.errors import BadInput

SECTIONS = """
[attitude]
yaw_rms_deg = 5.0
roll_rms_deg = 5.0
pitch_rms_deg = 5.0
[magnetometer]
noise_nT = 20.0
"""
SCENARIO = "# the author's own words\n" + scenario_text(
    SECTIONS,
    seed=7,
    epoch_utc="2012-03-01T00:00:00Z",
    altitude_km=700.0,
    inclination_deg=98.0,
    raan_deg=40.0,
    segment="samples = 60, step_s = 60.0",
)
REPLAY = """seed = 7
[spacecraft]
name = "Replay"
[replay]
telemetry = "t.csv"
[magnetometer]
noise_nT = 20.0
"""
MAP = """tle = "e.tle"
[[file]]
path = "m*.csv"
time = { recipe = "iso", columns = "time" }
[file.columns]
mag = { from = ["mag_x_nT", "mag_y_nT", "mag_z_nT"], unit = "nT" }
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, its telemetry as .nc and .csv, and a calibration."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "s.toml").write_text(SCENARIO, encoding="utf-8")
    for name in ("t.nc", "t.csv", "t.csv.gz"):
        assert status_of("simulate", folder / "s.toml", "--out", folder / name) == 0
    assert status_of("calibrate", folder / "t.nc", "--out", folder / "c.toml") == 0
    return folder


@pytest.fixture
def here(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fresh copy, and the working directory is in it."""
    folder = tmp_path / "here"
    shutil.copytree(made, folder)
    for name, text in {
        "r.toml": REPLAY,
        "m.toml": MAP,
        "m1.csv": "time\n",
        "e.tle": "x\n",
        "stations.toml": "",
    }.items():
        (folder / name).write_text(text, encoding="utf-8")
    os.symlink("t.csv", folder / "soft.html")
    os.link(folder / "t.csv", folder / "hard.html")
    os.link(folder / "t.nc", folder / "hard.nc")
    os.symlink("t.nc", folder / "soft.json")
    monkeypatch.chdir(folder)
    return folder


def messages(text: str) -> list[str]:
    """The lines of standard error that are not progress."""
    return [line for line in text.splitlines() if not line.endswith(" ...")]


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder, temporaries too."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


ONTO_AN_INPUT = [
    "apply t.nc --calibration c.toml --out t.nc",
    "apply t.nc --calibration c.toml --out ./../here/t.nc",
    "apply t.nc --calibration c.toml --out hard.nc",
    "apply t.nc --calibration c.toml --out x.nc --json c.toml",
    "apply t.nc --calibration c.toml --out x.nc --json soft.json",
    "apply m1.csv --calibration c.toml --map m.toml --out m1.csv",
    "apply m1.csv --calibration c.toml --map m.toml --tle e.tle --out x.nc --json e.tle",
    "apply m1.csv --calibration c.toml --map m.toml --out x.nc --json e.tle",
    "calibrate t.csv --out t.csv",
    "calibrate s.toml --out s.toml",
    "calibrate t.nc --unseen t.csv --json t.csv",
    "check t.nc --json t.nc",
    "check t.csv --repair t.csv",
    "check t.csv --field chaos:t.nc --json t.nc",
    "check . --map m.toml --json m1.csv",
    "diagnose t.csv --html t.csv",
    "diagnose t.csv --html soft.html",
    "diagnose t.csv --html hard.html",
    "diagnose t.csv --scenario s.toml --close s.toml",
    "diagnose t.csv --scenario r.toml --json s.toml --html r.toml",
    "yaw t.csv --calibration c.toml --out t.csv",
    "yaw t.csv --calibration c.toml --json c.toml",
    "simulate s.toml --out a.nc --json s.toml",
    "simulate r.toml --out t.csv",
    "simulate r.toml --out a.nc --json t.csv",
    "passes s.toml --stations stations.toml --json stations.toml",
    "ensemble s.toml --extract 3 --out s.toml",
    "field --date 2020-01-01 --lat 1 --lon 1 --field chaos:t.nc --json t.nc",
]


@pytest.mark.parametrize("force", ["", " --force"])
@pytest.mark.parametrize("words", ONTO_AN_INPUT)
def test_an_input_is_never_written_over(cli: Cli, here: Path, words: str, force: str) -> None:
    before = contents(here)
    outcome = cli(*(words + force).split())
    assert outcome.status == 2
    assert "is an input of this command" in outcome.err
    assert len(messages(outcome.err)) == 1
    assert contents(here) == before


@pytest.mark.parametrize(
    "words",
    [
        "simulate s.toml --out a.nc --truth a.nc",
        "simulate s.toml --out a.nc --truth sub/../a.nc",
        "simulate s.toml --out a.nc --truth link.nc",
        "simulate s.toml --out a.nc --json a.scenario.toml",
        "apply t.nc --calibration c.toml --out a --json a",
        "diagnose t.csv --json one --html one",
    ],
)
def test_two_outputs_never_share_a_file(cli: Cli, here: Path, words: str) -> None:
    (here / "sub").mkdir()
    os.symlink("a.nc", here / "link.nc")
    before = contents(here)
    assert cli(*words.split()).status == 2
    assert contents(here) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("calibrate t.nc --out x.json", "ends in .toml"),
        ("calibrate t.nc --out x", "ends in .toml"),
        ("apply t.nc --calibration c.toml --out x.feather", "ends in .csv"),
        ("simulate s.toml --out a.nc --truth x.csv", "ends in .nc"),
        ("diagnose t.csv --html x.json", "ends in .html"),
        ("diagnose t.csv --close x.nc", "ends in .toml"),
        ("yaw t.csv --calibration c.toml --out x.nc", "ends in .csv"),
        ("check t.nc --repair x.toml", "ends in .csv"),
        ("check t.nc --json x.toml", "ends in .json"),
        ("check t.nc --json x.csv.gz", "ends in .json"),
        ("calibrate t.nc --out none/x.toml", "folder"),
        ("simulate s.toml --out none/x.nc", "folder"),
        ("check t.nc --json none/x.json", "folder"),
        ("calibrate t.nc --figures none/deeper", "folder"),
        ("run seasat --out none/deeper", "folder"),
        ("ensemble s.toml --vehicles 2 --out none/deeper", "folder"),
        ("calibrate t.nc --out t.csv/x.toml", "is a file"),
        ("check t.nc --json .", "is a folder"),
    ],
)
def test_a_wrong_ending_or_a_folder_that_is_not_there(cli: Cli, here: Path, words: str, said: str) -> None:
    before = contents(here)
    outcome = cli(*words.split())
    assert outcome.status == 2
    assert said in outcome.err
    assert len(messages(outcome.err)) == 1
    assert contents(here) == before
    assert not (here / "none").exists()


@pytest.mark.parametrize("name", ["x.tmp", "x", "x.txt", "x.json"])
def test_json_may_have_any_name_that_is_nobody_elses(cli: Cli, here: Path, name: str) -> None:
    assert cli("effects", "bias", "--json", name).status == 0
    assert json.loads((here / name).read_text(encoding="utf-8"))["effects"][0]["name"] == "bias"


FOREIGN = {
    "x.toml": b'title = "pyproject"\n',
    "x.json": b'{\n  "name": "package"\n}\n',
    "x.html": b"<!doctype html><title>mine</title>",
    "x.nc": b"\x89HDF\r\n\x1a\n" + bytes(1000),
    "x.csv": b"time,mag_x_nT,mag_y_nT,mag_z_nT\n2026-01-01 00:00:00,1,2,3\n",
    "x.csv.gz": b"\x1f\x8bno gzip at all",
    "x.png": b"\x89PNG\r\n\x1a\n" + bytes(1000),
}


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("calibrate t.nc --out {}", "x.toml"),
        ("simulate s.toml --out x.nc", "x.scenario.toml"),
        ("simulate s.toml --out {}", "x.nc"),
        ("simulate s.toml --out y.nc --truth {}", "x.nc"),
        ("apply t.nc --calibration c.toml --out {}", "x.csv"),
        ("apply t.nc --calibration c.toml --out {}", "x.csv.gz"),
        ("yaw t.nc --calibration c.toml --out {}", "x.csv"),
        ("check t.nc --json {}", "x.json"),
        ("check t.nc --repair {}", "x.csv"),
        ("calibrate t.nc --figures figures", "figures/residuals.png"),
        ("ensemble s.toml --extract 1 --out {}", "x.toml"),
    ],
)
def test_a_file_of_somebody_else_goes_only_by_force_and_ours_goes_freely(
    cli: Cli, here: Path, words: str, name: str
) -> None:
    (here / name).parent.mkdir(exist_ok=True)
    kind = "x" + "".join(Path(name).suffixes[-2:] if name.endswith(".gz") else Path(name).suffixes[-1:])
    (here / name).write_bytes(FOREIGN[kind])
    before = contents(here)
    call = words.format(name).split()
    refused = cli(*call)
    assert refused.status == 2
    assert "--force" in refused.err
    assert contents(here) == before
    assert cli(*call, "--force").status in (0, 1)
    written = (here / name).read_bytes()
    assert written != FOREIGN[kind]
    if ".csv" in name:
        assert cli(*call).status == 2, "a CSV has no mark: it may be anybody's"
    else:
        assert cli(*call).status in (0, 1), "what fluxtwin wrote may be written again"
    assert (here / name).read_bytes() == written
    (here / name).write_bytes(b"")
    assert cli(*call).status in (0, 1), "an empty file is nobody's"
    assert (here / name).read_bytes() == written


def test_telemetry_that_somebody_changed_is_theirs(here: Path) -> None:
    """Another attribute, or another number: the digest inside does not fit. A word alone is no mark."""
    import h5py

    for change in ("note", "number", "word"):
        (here / "mine.nc").write_bytes((here / "t.nc").read_bytes())
        assert written_by_fluxtwin(here / "mine.nc")
        with h5py.File(here / "mine.nc", "r+") as opened:
            if change == "number":
                opened["mag_x_nT"][0] += 7.0
            else:
                opened.attrs["note"] = "cleaned by hand"
            if change == "word":
                del opened.attrs["fluxtwin_sha256"]
                opened.attrs["comment"] = "to be fed into fluxtwin"
        assert not written_by_fluxtwin(here / "mine.nc"), change


@pytest.mark.parametrize("name", FOREIGN)
def test_what_is_not_ours_is_not_taken_for_ours(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(FOREIGN[name])
    assert not written_by_fluxtwin(tmp_path / name)


def test_a_page_of_ours_may_be_written_again(here: Path) -> None:
    from fluxtwin.report import render_report
    from fluxtwin.scenarios.page import Page
    from fluxtwin.sim.base.files import write_text

    assert written_by_fluxtwin(write_text(here / "p.html", render_report(Page("t", "v", []))))


def test_a_saved_scenario_that_was_edited_is_its_editors(cli: Cli, here: Path) -> None:
    saved = here / "t.scenario.toml"
    saved.write_text(saved.read_text(encoding="utf-8").replace("seed = 7", "seed = 8"), encoding="utf-8")
    assert cli("simulate", "s.toml", "--out", "t.nc").status == 2
    assert "seed = 8" in saved.read_text(encoding="utf-8")


def test_a_scenario_beside_its_output_keeps_its_comments(cli: Cli, here: Path) -> None:
    (here / "my.scenario.toml").write_text(SCENARIO, encoding="utf-8")
    outcome = cli("simulate", "my.scenario.toml", "--out", "my.nc")
    assert outcome.status == 0
    assert (here / "my.scenario.toml").read_text(encoding="utf-8") == SCENARIO
    assert (here / "my.nc").stat().st_size > 0


@pytest.mark.parametrize("command", ["run", "ensemble"])
def test_a_folder_of_other_things_is_no_folder_for_results(cli: Cli, here: Path, command: str) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "scenario.toml").write_text(SCENARIO, encoding="utf-8")
    arguments = ("seasat",) if command == "run" else ("s.toml", "--vehicles", "2")
    before = contents(here)
    outcome = cli(command, *arguments, "--out", "mine")
    assert outcome.status == 2
    assert "--force" in outcome.err
    assert contents(here) == before


def test_a_folder_of_a_study_may_be_written_again(cli: Cli, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fluxtwin import studies
    from fluxtwin.scenarios.page import StudyResult

    def run(out: Path, data: Path | None, progress: object) -> StudyResult:
        (out / "scenario.toml").write_text("seed = 1\n", encoding="utf-8")
        return StudyResult("s", "done", {"a": 1}, [], None, [])

    monkeypatch.setattr(studies, "find_study", lambda name: run)
    for _ in range(2):
        assert cli("run", "seasat", "--out", "new").status == 0


posix = pytest.mark.skipif(os.name != "posix", reason="links, pipes and modes as POSIX has them")


@posix
def test_links_are_followed_and_modes_kept(cli: Cli, here: Path) -> None:
    (here / "elsewhere").mkdir()
    target = here / "elsewhere" / "target.json"
    target.write_bytes(b"")
    target.chmod(0o600)
    (here / "link.json").symlink_to("elsewhere/target.json")
    (here / "new.json").symlink_to("elsewhere/made.json")
    for name in ("link.json", "new.json"):
        assert cli("effects", "bias", "--json", name).status == 0
        assert (here / name).is_symlink()
    assert json.loads(target.read_text(encoding="utf-8"))
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    assert json.loads((here / "elsewhere" / "made.json").read_text(encoding="utf-8"))


@posix
@pytest.mark.parametrize(
    "words", ["effects bias --json pipe", "apply t.nc --calibration c.toml --out pipe", "calibrate t.nc --out pipe"]
)
def test_a_pipe_gets_the_bytes_and_stays_a_pipe(cli: Cli, here: Path, words: str) -> None:
    os.mkfifo(here / "pipe")
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append((here / "pipe").read_bytes()), daemon=True)
    reader.start()
    assert cli(*words.split()).status == 0
    reader.join(20)
    assert stat.S_ISFIFO((here / "pipe").stat().st_mode)
    assert got and len(got[0]) > 100
    assert not list(here.glob(".fluxtwin-*"))


@posix
@pytest.mark.parametrize("words", ["effects bias --json {}", "calibrate t.nc --out {} --json {}"])
def test_a_device_stays_a_device(cli: Cli, here: Path, words: str) -> None:
    try:
        os.mknod(here / "null", stat.S_IFCHR | 0o666, os.makedev(1, 3))
        (here / "null").write_bytes(b"x")
    except OSError:
        pytest.skip("no device can be made here")
    assert cli(*words.format("null", "null").split()).status == 0
    assert stat.S_ISCHR((here / "null").stat().st_mode)


@posix
def test_a_full_device_is_said_and_not_replaced(cli: Cli, here: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    outcome = cli("effects", "bias", "--json", "/dev/full")
    assert outcome.status == 2
    assert "No space left" in outcome.err
    assert stat.S_ISCHR(Path("/dev/full").stat().st_mode)


@posix
@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="no /dev/stdout")
def test_standard_output_by_name_keeps_what_was_said_before(here: Path) -> None:
    with open(here / "log", "wb") as log:
        log.write(b"before\n")
        log.flush()
        command = [sys.executable, "-m", "fluxtwin", "effects", "bias", "--json", "/dev/stdout"]
        assert subprocess.run(command, stdout=log, stderr=subprocess.PIPE, check=False).returncode == 0
    first, _, rest = (here / "log").read_bytes().partition(b"\n")
    assert first == b"before"
    assert json.loads(rest)["effects"]


@posix
def test_names_that_are_not_utf_8(process: Cli, cli: Cli, here: Path) -> None:
    odd = os.fsdecode(b"t\xff.nc")
    try:
        shutil.copy(here / "t.nc", here / odd)
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    report = here / os.fsdecode(b"r\xfe.json")
    out = os.fsdecode(b"o\xff.nc")
    assert process("check", odd, "--json", os.fspath(report), cwd=here).status == 0
    assert json.loads(report.read_bytes())["fluxtwin"]
    assert cli("apply", odd, "--calibration", "c.toml", "--out", out, "--json", "a.json").status == 0
    assert json.loads((here / "a.json").read_bytes())["written"] == [out]
    assert cli("check", out).status == 0, "the digest of the file is right"


@posix
def test_a_full_disk_costs_one_line(here: Path, tmp_path: Path) -> None:
    """A limit on the size of a file stands for the full disk: the write fails in the middle of the file."""
    code = (
        "import resource, signal, sys\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from fluxtwin.cli import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "sys.exit(main(['apply', 't.nc', '--calibration', 'c.toml', '--out', 'full.nc']))\n"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=here, capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 2, done.stderr
    assert "cannot write this file" in done.stderr
    assert not (here / "full.nc").exists()
    assert not list(here.glob(".fluxtwin-*"))


def test_the_marks_do_not_hinder_reading(here: Path) -> None:
    for name in ("c.toml", "t.scenario.toml"):
        text = (here / name).read_text(encoding="utf-8")
        assert text.startswith("# Written by fluxtwin")
        assert tomllib.loads(text)
        assert written_by_fluxtwin(here / name)
    assert written_by_fluxtwin(here / "t.nc")


def test_the_number_of_a_file_that_another_process_replaced_is_not_taken_for_it(tmp_path, monkeypatch):
    """A file system gives the number of a file that is gone to the next one: here before the second output is looked at."""
    first, second = tmp_path / "a.csv", tmp_path / "b.toml"
    first.write_text("1\n", encoding="utf-8")
    kinds = {"--out": (first, outputs.TELEMETRY), "--scenario": (second, outputs.SCENARIO)}
    number, others = first.stat().st_ino, iter([True])
    found = outputs._identity

    def recycled(path):
        device, _ = found(first)
        return (device, number) if path == second and next(others, False) else found(path)

    monkeypatch.setattr(outputs, "_identity", recycled)
    outputs.claim(kinds, [], force=True)
    with pytest.raises(BadInput, match="is an input"):
        outputs.claim(kinds, [first], force=True)
