"""The atomic writer: whole or not at all, and no litter."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from fluxtwin.sim import files
from fluxtwin.sim.errors import BadInput


def test_an_exception_while_writing_leaves_the_old_file_and_no_litter(tmp_path):
    path = files.write_text(tmp_path / "a.txt", "old")

    def broken(temporary):
        temporary.write_text("half")
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError):
        files.write_with(path, broken)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_leftovers_of_a_killed_process_are_swept_and_those_of_a_living_one_stay(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", "pass"])
    dead.wait()
    (tmp_path / f".fluxtwin-{dead.pid}-x.txt").write_text("litter")
    (tmp_path / f".fluxtwin-{os.getppid()}-y.txt").write_text("at work")
    files.write_text(tmp_path / "a.txt", "new")
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {"a.txt", f".fluxtwin-{os.getppid()}-y.txt"}


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_json_without_nan(tmp_path, value):
    with pytest.raises(ValueError):
        files.write_json(tmp_path / "a.json", {"x": value})
    assert not list(tmp_path.iterdir())


def test_a_target_that_cannot_be_written_is_named(tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    with pytest.raises(BadInput, match=r"file/x\.txt"):
        files.write_text(blocker / "x.txt", "")
    with pytest.raises(BadInput, match="is a folder"):
        files.write_text(tmp_path, "")
    with pytest.raises(BadInput, match="is a file"):
        files.writable_folder(blocker)
