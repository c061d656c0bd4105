"""Damaged files through every reader and every command; bombs; flipped bits."""

from __future__ import annotations

import os
import shutil
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from fluxtwin.sim.base.errors import FluxtwinError
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

from . import corpus
from .harness import Row, command, in_child, in_children, mutated, peak_bytes, reading, timed

_BATCH = 200
COMMANDS: dict[str, str] = {
    "check {}": "foreign.csv t.csv t.nc",
    "check foreign.csv --map {}": "map.toml",
    "info {}": "t.csv t.nc t.aem t.xlsx map.toml",
    "convert {} --out o.csv": "foreign.csv t.nc t.oem",
    "map {} --out o.toml": "foreign.csv t.nc",
    "calibrate {} --out o.toml --method linear": "foreign.csv t.csv t.nc",
    "calibrate t.nc --onboard {} --method linear": "e.json e.parm e.h e.m flat.toml",
    "apply t.nc --calibration {} --out o.nc": "flat.toml c.toml",
    "export {} --to px4 --out o.params": "flat.toml c.toml",
    "trend c.toml {}": "flat.toml",
    "yaw t.nc --calibration {}": "flat.toml",
    "attitude t.nc --calibration {}": "flat.toml",
    "simulate {} --out o.nc": "hand.toml saved.toml",
    "passes hand.toml --stations {}": "stations.toml",
    "ensemble {} --vehicles 1 --jobs 1 --out ens": "hand.toml",
    "check t.nc --tle {}": "e.tle",
    "field --date 2000-06-01 --lat 0 --lon 0 --field chaos:{}": "m.mat",
    "diagnose t.nc --scenario {}": "hand.toml",
}
"""Calls by what is damaged in them."""


def readers(folder: Path, trials: int, slow_trials: int) -> list[Row]:
    """Mutants of every kind through its reader. trials: of all the fast kinds together; slow_trials: of each slow one."""
    made = corpus.make(folder)
    fast = [name for name in made if name not in corpus.SLOW]
    shares = {}
    with timed(Row("damaged files through their readers", reach="0 signals, tracebacks, hangs")) as row:
        for name, read in made.items():
            count = slow_trials if name in corpus.SLOW else -(-trials // len(fast))
            row.trials += count
            shares[name] = _refused(row, folder, name, read, count) / count
        least, most = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
        row.note = (
            f"damaged copies of {len(shares)} files were read: from {100 * shares[least]:.0f} % ({least}) to"
            f" {100 * shares[most]:.0f} % ({most}) were refused, the file named; the others could still be read"
        )
    return [row]


def _refused(row: Row, folder: Path, name: str, read: Callable[[Path], object], count: int) -> int:
    """How many of `count` mutants of a file its reader refuses; faults go into the row."""
    refused, limit_s = 0, 30.0 if name in corpus.SLOW else 5.0
    read(folder / name)  # what is damaged below is good
    good, place = (folder / name).read_bytes(), folder / "damaged" / name
    place.parent.mkdir(exist_ok=True)
    for beside in ("map.toml", "foreign.csv"):
        shutil.copy(folder / beside, place.parent)
    for first in range(0, count, _BATCH):
        numbers = range(first, min(first + _BATCH, count))
        works = [reading(read, place, mutated(good, np.random.default_rng([k, len(good)]))) for k in numbers]
        for number, answer in zip(numbers, in_children(works, seconds=limit_s), strict=True):
            refused += answer == "refused"
            if answer not in ("refused", "read"):
                row.fault(f"{name} seed {number}: {answer}")
    return refused


def commands(folder: Path, trials: int) -> Row:
    """Damaged files through every command."""
    corpus.make(folder)
    cases = [(call, name) for call, names in COMMANDS.items() for name in names.split()]
    with timed(
        Row("damaged files through every command", trials, reach="exit 0, 1 or 2, file named, no traceback")
    ) as row:
        for number in range(trials):
            call, name = cases[number % len(cases)]
            place = folder / f"run{number}"
            place.mkdir()
            for one in folder.iterdir():
                if one.is_file():
                    os.link(one, place / one.name)
            (place / name).unlink()
            content = mutated((folder / name).read_bytes(), np.random.default_rng([number, 11]))
            (place / name).write_bytes(content)
            answer = in_child(command(call.format(*[name] * call.count("{}")).split(), place, name), seconds=120.0)
            if not answer.startswith("status"):
                row.fault(f"seed {number}: {answer}")
            shutil.rmtree(place)
    return row


def bits(folder: Path, trials: int) -> Row:
    """One bit flipped in each of the kinds of file that fluxtwin writes with a digest."""
    made = corpus.make(folder)
    each = -(-trials // len(corpus.OWN))
    with timed(
        Row("one bit flipped in a file of ours", each * len(corpus.OWN), reach="0 read as something else")
    ) as row:
        refused = 0
        for name in corpus.OWN:
            good, content = made[name](folder / name), (folder / name).read_bytes()
            place = folder / "flipped" / name
            place.parent.mkdir(exist_ok=True)
            places = np.random.default_rng(each).choice(8 * len(content), each, replace=False).tolist()
            works = [_flip(made[name], place, content, bit, good) for bit in places]
            for bit, answer in zip(places, in_children(works), strict=True):
                refused += answer == "refused"
                if answer not in ("refused", "the same"):
                    row.fault(f"{name} bit {bit}: {answer}")
        row.note = f"{refused} refused, the others read with the same values"
    return row


def _flip(read: Callable[[Path], object], place: Path, content: bytes, bit: int, good: object) -> Callable[[], str]:
    def work() -> str:
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        place.write_bytes(damaged)
        try:
            return "the same" if read(place) == good else "other values"
        except FluxtwinError:
            return "refused"

    return work


def bombs(folder: Path, size: int) -> Row:
    """Small files that claim much, and what has no end. size: of the long line, in bytes."""
    corpus.make(folder)
    _claims(folder / "nothing.nc", 54)
    _claims(folder / "one.nc", 0, 10**13)
    _far_cell(folder)
    (folder / "line.csv").write_bytes(b"time," + b"x" * size)
    (folder / "rows.csv").write_bytes(b"time,mag_x_nT\n" + b"1,2\n" * (size // 4))
    (folder / "keys.toml").write_text(".".join("a" * 20_000) + " = 1", encoding="utf-8")
    (folder / "deep.toml").write_text("x = " + "[" * 100_000, encoding="utf-8")
    (folder / "digits.toml").write_text("x = " + "9" * 5_000, encoding="utf-8")
    (folder / "values.toml").write_text("x = [" + "1," * 400_000 + "]", encoding="utf-8")
    (folder / "quoted.toml").write_text(".".join(['"a b"'] * 20_000) + " = 1", encoding="utf-8")
    for name in ("zero.csv", "zero.toml", "zero.tle", "zero.aem"):
        (folder / name).symlink_to("/dev/zero")
    for name in ("pipe.csv", "pipe.toml", "pipe.nc", "pipe.xlsx"):
        os.mkfifo(folder / name)
    names = [one for one in sorted(folder.iterdir()) if one.name.split(".")[0] in _BOMBS]
    with timed(
        Row("bombs, devices, pipes", len(names), reach="refused within 2.5 s of processor time and 300 MB")
    ) as row:
        worst_s, worst_MB = 0.0, 0.0
        for path in names:
            answer = in_child(_bomb(path), seconds=20.0)
            words = answer.split()
            if words[0] != "refused":
                row.fault(f"{path.name}: {answer}")
                continue
            took_s, took_MB = float(words[1]), float(words[2])
            worst_s, worst_MB = max(worst_s, took_s), max(worst_MB, took_MB)
            if took_s > 2.5 or took_MB > 300.0:
                row.fault(f"{path.name}: {took_s:.1f} s, {took_MB:.0f} MB")
        row.note = (
            f"less than {worst_s + 0.05:.1f} s and at most {worst_MB:.0f} MB above the base; "
            "a pipe is refused after a wait of 2 s"
        )
    return row


_BOMBS = ("nothing", "one", "far", "line", "rows", "keys", "deep", "digits", "values", "quoted", "zero", "pipe")


def _bomb(path: Path) -> Callable[[], str]:
    read: Callable[[Path], object] = corpus.READERS["hand.toml" if path.suffix == ".toml" else "e.tle"]
    if path.suffix not in (".toml", ".tle"):
        read = read_telemetry

    def work() -> str:
        import openpyxl  # noqa: F401  (its import is no part of what the file costs)
        import pandas  # noqa: F401

        base, began = peak_bytes(), time.process_time()
        try:
            read(path)
        except FluxtwinError:
            return f"refused {time.process_time() - began:.2f} {(peak_bytes() - base) / 1e6:.0f}"
        return "read"

    return work


def _claims(path: Path, flags: int, rows: int = 5_000_000) -> None:
    with h5py.File(path, "w") as made:
        time_ = made.create_dataset("time", (rows,), "f8", chunks=(500_000,), compression="gzip")
        time_.attrs["units"] = "seconds since 2020-01-01"
        for name in ["mag_x_nT", "mag_y_nT", "mag_z_nT", *(f"flag_{k}" for k in range(flags))]:
            made.create_dataset(name, (rows,), "f8", chunks=(500_000,), compression="gzip")


def _far_cell(folder: Path) -> None:
    far = b'<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
    with zipfile.ZipFile(folder / "t.xlsx") as good, zipfile.ZipFile(folder / "far.xlsx", "w") as bad:
        for name in good.namelist():
            content = good.read(name)
            bad.writestr(name, content.replace(b"</sheetData>", far) if name.endswith("sheet1.xml") else content)
