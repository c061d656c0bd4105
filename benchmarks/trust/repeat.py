"""The same bits: over threads, jobs and chunks, from a saved scenario, and in odd places; and text of others in reports."""

from __future__ import annotations

import hashlib
import html.parser
import json
import os
import platform
import shutil
import subprocess
import sys
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import fluxtwin
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

from . import corpus
from .harness import Row, spoken, timed

_CALLS = (
    "simulate hand.toml --out t.nc --truth truth.nc --json simulated.json",
    "check t.nc --json checked.json",
    "calibrate t.nc --out c.toml --json fitted.json --html fitted.html --figures figures",
    "apply t.nc --calibration c.toml --out corrected.csv",
    "yaw t.nc --calibration c.toml --out yaw.csv",
    "diagnose t.nc --json diagnosed.json --html diagnosed.html",
)
_QUICK_CALLS = _CALLS[:4]
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def run(folder: Path, calls: Sequence[str], changes: Mapping[str, str | None] | None = None, prefix: str = "") -> str:
    """The commands one after the other in a new folder, with changes of the environment; "" or what went wrong."""
    folder.mkdir(parents=True)
    (folder / "hand.toml").write_text(corpus.scenario(240), encoding="utf-8")
    environment = dict(os.environ)
    for name, value in (changes or {}).items():
        environment.pop(name, None)
        if value is not None:
            environment[name] = value
    for call in calls:
        command = [sys.executable, *prefix.split(), "-m", "fluxtwin", *call.split()]
        if prefix:
            command = [sys.executable, "-c", prefix, *call.split()]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False, timeout=900)
        if done.returncode not in (0, 1) or b"Traceback" in done.stderr:
            return f"{call}: status {done.returncode}: {done.stderr.decode('utf-8', 'replace')[-200:]}"
    return ""


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of all files under a folder, by name."""
    files = [one for one in sorted(folder.rglob("*")) if one.is_file()]
    return {str(one.relative_to(folder)): hashlib.sha256(one.read_bytes()).hexdigest() for one in files}


def same_bits(folder: Path, *, quick: bool) -> list[Row]:
    """Threads of BLAS, a second run, instructions of the processor; jobs and chunks of an ensemble; a saved scenario."""
    calls = _QUICK_CALLS if quick else _CALLS
    with timed(Row("two threads of BLAS, a second run: files with other bytes")) as row:
        run(folder / "one", calls, _ONE_THREAD)
        base = digests(folder / "one")
        for name, changes in {
            "two": {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"},
            "again": _ONE_THREAD,
        }.items():
            said = run(folder / name, calls, changes)
            now = digests(folder / name)
            row.trials += len(base)
            for file in base:
                if said or now.get(file) != base[file]:
                    row.fault(f"{name}: {file}: {said or 'other bytes'}")
    rows = [row, _other_processor(folder, calls)]
    with timed(Row("jobs 1 and 2, chunks of 2 and 3 vehicles: numbers that differ")) as row:
        tables = []
        for jobs, chunk in ((1, 2), (2, 2), (2, 3)):
            place = folder / f"ensemble{jobs}{chunk}"
            said = run(place, [f"ensemble hand.toml --vehicles 5 --jobs {jobs} --chunk {chunk} --out e"])
            row.trials += 1
            tables.append((place / "e" / "vehicles.csv").read_bytes() if not said else said.encode())
            if tables[-1] != tables[0]:
                row.fault(f"jobs {jobs}, chunk {chunk}: {said or 'another vehicles.csv'}")
    rows.append(row)
    with timed(Row("a run from its saved scenario: files with other bytes")) as row:
        place = folder / "saved"
        shutil.copytree(folder / "one", place)
        shutil.copy(place / "t.scenario.toml", place / "hand.toml")
        for call in calls:
            subprocess.run(
                [sys.executable, "-m", "fluxtwin", *call.split()], cwd=place, capture_output=True, check=False
            )
        now = digests(place)
        row.trials = len(base) - 1
        row.faults += [f"{file}: other bytes" for file in base if file != "hand.toml" and now.get(file) != base[file]]
    return [*rows, row]


_OLDER = {"OPENBLAS_CORETYPE": "Sandybridge", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"}
_APART = 1e-10
"""Of a number, or of the largest of its list or table: rounding, in sums of thousands."""
_NOT_COMPARED = ("sha256", "source", "mean_nT")
"""Of other digits; or a mean of residuals, which the fit makes nothing."""


def _other_processor(folder: Path, calls: Sequence[str]) -> Row:
    """What an older processor, whose sums round otherwise, makes of the calls that were made in `one` under the folder."""
    with timed(Row("an older processor: numbers that differ", reach=f"less than {_APART:g}")) as row:
        if platform.machine() not in ("x86_64", "AMD64"):
            row.note = "not tried: this is no x86 processor"
            return row
        if said := run(folder / "older", calls, {**_ONE_THREAD, **_OLDER}):
            row.fault(said)
            return row
        most = 0.0
        for file in sorted([*(folder / "one").glob("*.json"), *(folder / "one").glob("*.toml")]):
            read = json.loads if file.suffix == ".json" else tomllib.loads
            pair = (
                read((place / file.name).read_text(encoding="utf-8")) for place in (folder / "one", folder / "older")
            )
            for name, apart in _differences(*pair):
                row.trials += 1
                most = max(most, apart)
                if apart > _APART:
                    row.fault(f"{file.name}: {name}: {apart:.1e}")
        row.note = f"the largest difference is {most:.0e}"
    return row


def _differences(a: Any, b: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """How far two files are apart at each place: numbers by the largest beside them, all else nought or infinitely far."""
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        for key in (one for one in a if one not in _NOT_COMPARED):
            yield from _differences(a[key], b[key], f"{name}.{key}")
        return
    whole = [a, b] if isinstance(a, list) and isinstance(b, list) and len(a) == len(b) else [[a], [b]]
    pairs = list(zip(*whole, strict=True))
    if all(type(one) in (int, float) for pair in pairs for one in pair):
        size = max((abs(x) for x, _ in pairs), default=0.0)
        yield name, max((abs(x - y) for x, y in pairs), default=0.0) / max(size, 1e-300)
    elif whole == [[a], [b]]:
        yield name, 0.0 if a == b else float("inf")
    else:
        for place, (x, y) in enumerate(pairs):
            yield from _differences(x, y, f"{name}.{place}")


_NO_SOCKETS = """
import socket, sys
def refuse(*_, **__): raise OSError("no network here")
socket.socket.connect = refuse; socket.create_connection = refuse; socket.getaddrinfo = refuse
from fluxtwin.__main__ import main
sys.argv[0] = "fluxtwin"
sys.exit(main())
"""


def places(folder: Path, *, quick: bool) -> Row:
    """No network, no home, another language and time zone, odd letters in paths; the source tree stays as it is."""
    cases: dict[str, dict[str, str | None]] = {
        "plain": {},
        "no HOME, no cache": {"HOME": None, "XDG_CACHE_HOME": None, "NUMBA_CACHE_DIR": None},
        "HOME that is not there": {"HOME": "/nowhere", "XDG_CACHE_HOME": None},
        "LC_ALL=C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        "TZ of 45 minutes": {"TZ": "Pacific/Chatham"},
        "TZ that is none": {"TZ": "Nowhere/None"},
        "blanks and ünïcode ☄ in the path": {},
        "no network": {},
    }
    source = Path(fluxtwin.__file__).resolve().parents[1]
    before = _tree(source)
    calls = _QUICK_CALLS if quick else _CALLS[:-1]  # a diagnosis takes its time, and reads and writes no more
    with timed(Row("odd places: commands that fail or differ", reach="same bytes, source tree untouched")) as row:
        base: dict[str, str] = {}
        for name, changes in cases.items():
            place = folder / (name if "path" in name else f"place{len(base) and row.trials}")
            said = run(place, calls, changes, _NO_SOCKETS if name == "no network" else "")
            now = digests(place)
            base = base or now
            row.trials += len(calls)
            if said or now != base:
                row.fault(f"{name}: {said or sorted(file for file in base if now.get(file) != base[file])}")
        if _tree(source) != before:
            row.fault("a file in the source tree was written")
    return row


def _tree(source: Path) -> dict[str, int]:
    folders = [source / name for name in ("sim", "calib", "gap", "plots", "scenarios", "api")]
    files = [one for folder in folders for one in folder.rglob("*") if "__pycache__" not in one.parts and one.is_file()]
    return {str(one): one.stat().st_mtime_ns for one in files}


HOSTILE = [
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    '"><svg onload=alert(1)>',
    "'><b>x",
    "</title><script>x</script>",
    "</style><script>x</script>",
    "javascript:alert(1)",
    "<a href='https://evil.example'>x</a>",
    "&lt;script&gt;",
    "&#60;script&#62;",
    "{{7*7}}",
    "{% raw %}",
    "${7*7}",
    "$\\frac{$",
    "$x_{$",
    "\\input{x}",
    "%s%n%d",
    "{0.__class__}",
    "=1+1",
    "+cmd|' /C calc'!A0",
    "-2+3",
    "@SUM(A1)",
    "\t=1",
    "\r=1",
    '=HYPERLINK("https://evil.example")',
    "a,b",
    'a"b',
    "a\nb",
    "\x1b[31mred\x1b[0m",
    "\x1b]0;title\x07",
    "\x9b31m",
    "\x00",
    "\u202egnp.exe",
    "\u2066x\u2069",
    "\ufeffx",
    "[bold]x[/bold]",
    "[link=https://evil.example]x[/link]",
    "x" * 5000,
    "😀 ünïcode",
    "../../etc/passwd",
]
"""Texts that somebody may put into a name: for pages, templates, figures, tables, terminals."""


class _Page(html.parser.HTMLParser):
    """Counts what a page must not have."""

    def __init__(self) -> None:
        super().__init__()
        self.wrong: list[str] = []
        self.policy = ""
        self._script: str | None = None

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Elements that run or fetch, and handlers."""
        given = dict(attrs)
        if tag == "meta" and given.get("http-equiv", "").lower() == "content-security-policy":  # type: ignore[union-attr]
            self.policy = given.get("content") or ""
        if tag == "script" and given.get("type") != "application/json":
            self._script = ""
        if tag in ("iframe", "object", "embed", "base", "link", "form"):
            self.wrong.append(f"<{tag}>")
        for name, value in given.items():
            fetched = name in ("src", "href", "xlink:href", "action") and not (value or "").startswith(("data:", "#"))
            if name.startswith("on") or fetched:
                self.wrong.append(f"{name}={value!r:.60}")

    def handle_data(self, data: str) -> None:
        """The text of a script."""
        self._script = None if self._script is None else self._script + data

    def handle_endtag(self, tag: str) -> None:
        """A script that is not the page's own, to the letter."""
        own = (files("fluxtwin") / "templates" / "report.js").read_text(encoding="utf-8")
        if tag == "script" and self._script not in (None, own):
            self.wrong.append("<script>")
        self._script = None


def texts(folder: Path, *, quick: bool) -> Row:
    """Hostile strings as the name of the spacecraft and of the file: in calibrations, pages, JSON, tables, terminal."""
    strings = HOSTILE[::6] if quick else HOSTILE
    corpus.make(folder, 240)
    with timed(Row("hostile strings in reports, JSON, terminal, tables", 0, reach="0 unescaped")) as row:
        for number, text in enumerate(strings):
            place = folder / f"text{number}"
            place.mkdir()
            record = read_telemetry(folder / "t.nc").replace(provenance={"spacecraft": text})
            name = f"{text.replace('/', '-').replace(chr(0), '')[:60]}.nc"
            write_telemetry(record, place / name)
            write_telemetry(record, place / "named.csv")
            _look_at_table(row, text, place / "named.csv")
            out, said = _commands(place, name)
            row.trials += len(out) + 3
            for wrong in said:
                row.fault(f"{text!r:.40}: {wrong}")
            for page in place.glob("*.html"):
                seen = _Page()
                seen.feed(page.read_text(encoding="utf-8"))
                if seen.wrong or "default-src 'none'" not in seen.policy:
                    row.fault(f"{text!r:.40}: {page.name}: {seen.wrong[:3] or 'no policy'}")
                if "[nT]" not in page.read_text(encoding="utf-8"):
                    row.fault(f"{text!r:.40}: {page.name}: units are gone")
            for file in place.glob("*.json"):
                json.loads(file.read_text(encoding="utf-8"), parse_constant=lambda word: 1 / 0)
    return row


def _commands(place: Path, name: str) -> tuple[list[str], list[str]]:
    calls = [
        ["check", f"./{name}", "--json", "check.json"],
        [
            "calibrate",
            f"./{name}",
            "--method",
            "linear",
            *["--out", "c.toml", "--json", "fit.json", "--html", "fit.html"],
        ],
        ["apply", f"./{name}", "--calibration", "c.toml", "--out", "applied.csv"],
        ["info", f"./{name}"],
    ]
    wrong = []
    for call in calls:
        status, text = spoken(call, place)
        if status not in (0, 1):
            wrong.append(f"{call[0]}: status {status}: {text[-150:]}")
        active = [c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Cs") and c not in "\n\t"]
        if active:
            wrong.append(f"{call[0]}: {active[:3]!r} reach the terminal")
    return [call[0] for call in calls], wrong


def _look_at_table(row: Row, text: str, path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    width = lines[0].count(",")
    place = lines[0].split(",").index("spacecraft") if "spacecraft" in lines[0].split(",") else None
    for line in lines:
        if line.count(",") != width:
            row.fault(f"{text!r:.40}: a row of the table has other columns")
            break
    if place is not None and lines[1].split(",")[place][:1] in ("=", "+", "-", "@", "\t", "\r"):
        row.fault(f"{text!r:.40}: a cell of the table is a formula: {lines[1].split(',')[place]!r:.40}")
