"""The atomic writer: whole or not at all, and no litter."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput

pytestmark = pytest.mark.property


def test_an_exception_while_writing_leaves_the_old_file_and_no_litter(tmp_path):
    path = files.write_text(tmp_path / "a.txt", "old")

    def broken(temporary):
        temporary.write_text("half", encoding="utf-8")
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError):
        files.write_with(path, broken)
    assert path.read_text(encoding="utf-8") == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_leftovers_of_a_killed_process_are_swept_and_those_of_a_living_one_stay(tmp_path):
    """A process in another container has a number that means nothing here: only the lock shows it."""
    code = (
        "import os, sys; from fluxtwin.sim.base import files\n"
        "os.getpid = lambda: 99_999_999\n"  # larger than any number here
        "def write(temporary): print(temporary.name, flush=True); sys.stdin.readline(); temporary.write_text('b')\n"
        f"files.write_with({str(tmp_path / 'b.txt')!r}, write)"
    )
    names = []
    for end in ("kill", "finish"):
        living = subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        names.append(living.stdout.readline().strip())
        files.write_text(tmp_path / "a.txt", "new")
        assert {p.name for p in tmp_path.iterdir()} == {"a.txt", names[-1]}
        if end == "kill":
            living.kill()
        living.communicate("go on\n" if end == "finish" else None)
    assert {p.name for p in tmp_path.iterdir()} == {"a.txt", "b.txt"}
    assert (tmp_path / "b.txt").read_text(encoding="utf-8") == "b"


@pytest.mark.skipif(os.name != "posix", reason="flock")
def test_where_there_are_no_locks_nothing_is_swept(tmp_path, monkeypatch):
    def unsupported(*_):
        raise OSError(95, "Operation not supported")

    leftover = ".fluxtwin-unfinished-0a1b2c3d.txt"
    (tmp_path / leftover).write_text("perhaps at work", encoding="utf-8")
    monkeypatch.setattr("fcntl.flock", unsupported)
    files.write_text(tmp_path / "a.txt", "new")
    assert {p.name for p in tmp_path.iterdir()} == {"a.txt", leftover}


def test_only_names_of_our_own_making_are_swept(tmp_path):
    mine = {".fluxtwin-notes.txt", ".fluxtwin-settings.toml", ".fluxtwin-unfinished-notes.txt"}
    for name in mine:
        (tmp_path / name).write_text("somebody's own", encoding="utf-8")
    files.write_text(tmp_path / "a.txt", "new")
    assert {p.name for p in tmp_path.iterdir()} == {"a.txt", *mine}


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_json_without_nan(tmp_path, value):
    with pytest.raises(ValueError):
        files.write_json(tmp_path / "a.json", {"x": value})
    assert not list(tmp_path.iterdir())


def test_a_target_that_cannot_be_written_is_named(tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("", encoding="utf-8")
    with pytest.raises(BadInput, match=r"file/x\.txt"):
        files.write_text(blocker / "x.txt", "")
    with pytest.raises(BadInput, match="is a folder"):
        files.write_text(tmp_path, "")
    with pytest.raises(BadInput, match="is a file"):
        files.writable_folder(blocker)
    with pytest.raises(BadInput, match="is a folder"):
        files.writable_file(tmp_path)
    with pytest.raises(BadInput, match="there is no folder"):
        files.writable_folder(tmp_path / "absent" / "results")
    with pytest.raises(BadInput, match="a name in it is not UTF-8"):
        files.write_toml(tmp_path / "a.toml", "name = '\udcff'\n")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_folder_that_takes_no_file_and_a_disk_that_is_full(tmp_path, monkeypatch):
    """Root writes into a protected folder, so that the system's refusal is put in its place."""

    def full(_):
        raise OSError(28, "No space left on device")

    with pytest.raises(BadInput, match=r"a\.txt: cannot write this file \(No space left on device\)"):
        files.write_with(tmp_path / "a.txt", full)

    def protected(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkstemp", protected)
    with pytest.raises(BadInput, match=r"a\.txt: cannot write here \(Permission denied\)"):
        files.write_text(tmp_path / "a.txt", "")
    with pytest.raises(BadInput, match="cannot write in this folder"):
        files.writable_folder(tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(
    not os.path.exists("/dev/full"), reason="this system has no /dev/full, a device that is always full"
)
def test_a_stream_is_written_to_and_not_replaced(tmp_path, capfd):
    assert files.writable_file("/dev/stdout") == files.write_text("/dev/stdout", "all of it")
    assert capfd.readouterr().out == "all of it"
    with pytest.raises(BadInput, match="/dev/full: cannot write this file"):
        files.write_text("/dev/full", "all of it")
