"""Writers that meet a full disk, a limit of size, a folder that is write-protected, a signal, or each other."""

from __future__ import annotations

import contextlib
import io
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from fluxtwin.sim.base import processes

from . import corpus
from .harness import Row, timed

WRITERS = {
    "simulate hand.toml --out OUT": "o.nc o.csv o.csv.gz",
    "convert t.nc --out OUT": "o.aem o.oem o.xlsx" + " o.parquet" * corpus.HAS_PARQUET,
    "calibrate t.nc --method linear --out OUT": "o.toml",
    "apply t.nc --calibration c.toml --out OUT": "p.nc",
    "calibrate t.nc --method linear --html OUT": "o.html",
    "check t.nc --json OUT": "o.json",
    "export c.toml --to c-header --out OUT": "o.h",
    "map foreign.csv --out OUT": "m.toml",
}
FAULTS = ("full disk", "limit of size", "write-protected", "kill -9", "SIGTERM", "two writers")
_NOBODY = 65534


def rows(folder: Path, trials: int) -> list[Row]:
    """A row for each fault, `trials` of them together."""
    corpus.make(folder, 400)
    count = -(-trials // len(FAULTS))
    calls = [(call, name) for call, names in WRITERS.items() for name in names.split()][:count]
    good = {name: _good(folder, call, name) for call, name in calls}
    found = []
    for fault in FAULTS:
        with timed(Row(f"{fault} while a file is written", 0)) as row:
            with _disk(folder, fault) as place:
                for number in range(count if place is not None else 0):
                    call, name = calls[number % len(calls)]
                    row.trials += 1
                    _trial(row, fault, folder, place or folder, call, name, good[name], number)
            row.note = row.note if place is not None else "not tried: no right to mount here"
        found.append(row)
    return found


def _good(folder: Path, call: str, name: str) -> tuple[bytes, float]:
    """What the command writes, and how long it takes. Here, so that a child has all imports: nobody may not read our own."""
    from fluxtwin.cli import main

    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        for _ in range(2):
            began = time.monotonic()
            status = main([*call.replace("OUT", name).split(), "--force"])
    if status not in (0, 1):
        raise RuntimeError(f"{call}: status {status}")
    return (folder / name).read_bytes(), time.monotonic() - began


def _trial(
    row: Row, fault: str, folder: Path, place: Path, call: str, name: str, good: tuple[bytes, float], number: int
) -> None:
    target = place / name
    old = b"" if number % 3 == 0 else good[0][: len(good[0]) // 2]  # no old file, an empty one, or one of somebody
    target.unlink(missing_ok=True)
    if number % 3:
        target.write_bytes(old)
    before = {one.name for one in place.iterdir()}
    words = call.replace("OUT", str(target)) + " --force"
    rng = np.random.default_rng([number, FAULTS.index(fault)])
    filler = place / "filler"
    if fault == "full disk":
        free = os.statvfs(place).f_bavail * 4096
        filler.write_bytes(bytes(max(0, free - int(rng.integers(0, max(4096, len(good[0])))))))
        before.add("filler")
    prepare = _limits(fault, int(rng.integers(0, max(1, len(good[0])))))
    children = [_begin(folder, words, prepare) for _ in range(2 if fault == "two writers" else 1)]
    if fault in ("kill -9", "SIGTERM"):
        time.sleep(float(rng.uniform(0.0, 1.1)) * good[1])
        with contextlib.suppress(ProcessLookupError):
            os.kill(children[0], signal.SIGKILL if fault == "kill -9" else signal.SIGTERM)
    statuses = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
    filler.unlink(missing_ok=True)
    _look(row, fault, f"{words} (trial {number})", target, old if number % 3 else None, good[0], statuses)
    left = {one.name for one in place.iterdir()} - before - {name, name.replace(".csv.gz", "") + ".scenario.toml"}
    left = {one for one in left if not one.endswith(".scenario.toml")}
    if fault == "kill -9":  # what a killed process leaves is swept by the next that writes there
        os.waitpid(_begin(folder, call.replace("OUT", str(target)) + " --force"), 0)
        left = {one.name for one in place.glob(".fluxtwin*")}
    if left:
        row.fault(f"{fault}: {words} left {sorted(left)}")


def _look(row: Row, fault: str, words: str, target: Path, old: bytes | None, good: bytes, statuses: list[int]) -> None:
    now = target.read_bytes() if target.exists() else None
    whole = now is not None and (now == good or (target.suffix == ".html" and now.rstrip().endswith(b"</html>")))
    if now != old and not whole:
        row.fault(f"{fault}: {words}: neither the old file nor the new one, {len(now or b'')} bytes")
    allowed = {"kill -9": (0, 1, -9), "SIGTERM": (0, 1, 143, -15), "two writers": (0, 1)}.get(fault, (0, 1, 2))
    if any(status not in allowed for status in statuses):
        row.fault(f"{fault}: {words}: exit {statuses}")
    if statuses == [2] and now != old:
        row.fault(f"{fault}: {words}: refused, and the file is another")


def _limits(fault: str, size: int) -> Callable[[], None]:
    def prepare() -> None:
        if fault == "limit of size":
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        if fault == "write-protected" and os.geteuid() == 0:
            os.setgid(_NOBODY)
            os.setuid(_NOBODY)

    return prepare


def _begin(folder: Path, words: str, prepare: Callable[[], None] = lambda: None) -> int:
    """The command line in a forked process."""
    child = os.fork()
    if child:
        return child
    status = 99
    try:
        os.chdir(folder)
        silence = os.open(os.devnull, os.O_RDWR)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        prepare()
        processes.stop_when_asked()
        from fluxtwin.cli import main

        status = main(words.split())
    finally:
        os._exit(status)


@contextlib.contextmanager
def _disk(folder: Path, fault: str) -> Iterator[Path | None]:
    """Where the outputs go: a small disk, a folder that cannot be written, or a common one. None without the right to it."""
    place = folder / fault.replace(" ", "-")
    place.mkdir()
    mounted = False
    if fault == "full disk":
        command = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(place)]
        mounted = sys.platform == "linux" and subprocess.run(command, capture_output=True, check=False).returncode == 0
    if fault == "write-protected":
        folder.chmod(0o755)  # ours alone until now; nobody has to come here
        place.chmod(0o555)
    try:
        yield place if mounted or fault != "full disk" else None
    finally:
        if mounted:
            subprocess.run(["umount", str(place)], check=True)
        place.chmod(0o755)
        shutil.rmtree(place)
