"""Ctrl-C and SIGTERM end a command at a step: its status, its words, no traceback, nothing half-written."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from worlds import scenario_text

from fluxtwin.sim.base import processes
from fluxtwin.sim.base.progress import part_of, silent

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends signals as a terminal does")

SECTIONS = """
[attitude]
mode = "earth_pointing"
[magnetometer]
b_nT = [0.0, 0.0, 0.0]
noise_nT = 30.0
[draws]
"magnetometer.b_nT" = { normal = 1500.0 }
"""
SCENARIO = scenario_text(
    SECTIONS, seed=1, epoch_utc="2026-03-01T00:00:00Z", raan_deg=120.0, segment="duration_min = 600.0, step_s = 1.0"
)
COMMANDS = {
    # Both last longer than any of the instants below.
    "ensemble": ["ensemble", "s.toml", "--vehicles", "1000", "--out", "results", "--jobs", "2", "--chunk", "4"],
    "seasat": ["run", "seasat", "--out", "results"],
}
WITH_MAIN = "import sys; from fluxtwin.__main__ import main; {}; sys.exit(main())"


def started(code: str, words: list[str], folder: Path) -> subprocess.Popen[str]:
    """A command line of its own that has come so far that it heeds interrupts, which a suite in the background ignores."""
    ready = "import fluxtwin.__main__ as m; say = m.stop_when_asked;"
    ready += " m.stop_when_asked = lambda: (say(), print('heeds', flush=True))"
    process = subprocess.Popen(
        [sys.executable, "-c", code.format(ready), *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None and process.stdout.readline() == "heeds\n"
    return process


@pytest.mark.parametrize(
    ("verb", "number", "after_s"),
    [
        (verb, number, round(random.Random(f"{verb} {place}").uniform(0.0, 3.0), 2))
        for verb in COMMANDS
        for place, number in enumerate((signal.SIGINT, signal.SIGINT, signal.SIGTERM))
    ],
)
def test_an_interrupt_at_a_random_instant(tmp_path: Path, verb: str, number: signal.Signals, after_s: float) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO, encoding="utf-8")
    process = started(WITH_MAIN, COMMANDS[verb], tmp_path)
    time.sleep(after_s)
    process.send_signal(number)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 128 + number, said
    assert said.count("fluxtwin: interrupted; nothing half-written is left behind") == 1
    assert "Traceback" not in said and "Exception ignored" not in said
    assert not [path for path in tmp_path.rglob("*") if path.name.startswith(".")]


def test_work_that_comes_to_no_step_is_ended_too(tmp_path: Path) -> None:
    process = started("{}; import time; m.stop_when_asked(); time.sleep(100)", [], tmp_path)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130 and said == "fluxtwin: interrupted; nothing half-written is left behind\n"


def test_an_interrupt_after_the_last_step_changes_nothing(tmp_path: Path) -> None:
    code = "{}; import signal, sys; m.stop_when_asked(); m.nothing_left_to_stop(); signal.raise_signal(signal.SIGINT)"
    process = started(code, [], tmp_path)
    _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (0, "")


def test_a_file_begun_is_gone_when_the_process_is_ended(tmp_path: Path) -> None:
    code = """{}
import time
from fluxtwin.sim.base.files import write_with
m.stop_when_asked()
write_with("t.csv", lambda path: (path.write_text("half"), time.sleep(100)))"""
    process = started(code, [], tmp_path)
    while not [path for path in tmp_path.iterdir() if path.read_text(encoding="utf-8") == "half"]:
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 143 and "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_every_report_of_progress_looks_at_the_flag(monkeypatch: pytest.MonkeyPatch) -> None:
    silent("first", 0.1)
    monkeypatch.setattr(processes, "_asked", signal.SIGINT)
    monkeypatch.setattr(processes, "_answered", False)
    with pytest.raises(processes.Stopped):
        part_of(silent, 0.0, 0.5)("second", 0.2)
    assert processes.stopped_status() == 130
