"""Where a run lives on disk, and the seal on its answers.

    OUT/run.json            seed, commit, populations: what a resumed run must agree with
    OUT/asked/ID.json       what the diagnosis is given
    OUT/telemetry/ID.csv    what it is given
    OUT/said/ID.json        what it answered (and OUT/closed/ID.toml, the scenario with what it named)
    OUT/sealed/ID.json      the truth; never read before all has been said
    OUT/limit/ID.json       what was said of the printed smallest size when it was flown (and ID.csv, that flight)
    OUT/twin/ID.csv         the same flight without noise; OUT/second/ID.csv another day of it
    OUT/sealed.sha256       one number over all answers, printed when they are made

The diagnosis is handed asked and telemetry alone.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fluxtwin.sim.base import files

LOG = Path(__file__).resolve().parent.parent / "withheld.log"
FOLDERS = (
    "asked",
    "telemetry",
    "said",
    "closed",
    "sealed",
    "twin",
    "second",
    "judged",
    "loop",
    "control",
    "rival",
    "limit",
)


@dataclass(frozen=True)
class Store:
    """The folder of one run."""

    root: Path

    def prepared(self) -> Store:
        """With its folders made."""
        for name in FOLDERS:
            (self.root / name).mkdir(parents=True, exist_ok=True)
        return self

    def tidy(self) -> None:
        """Take away what is empty; the whole folder where no case was made."""
        for name in FOLDERS:
            if (self.root / name).is_dir() and not any((self.root / name).iterdir()):
                (self.root / name).rmdir()
        if self.root.is_dir() and {path.name for path in self.root.iterdir()} <= {"run.json"}:
            (self.root / "run.json").unlink(missing_ok=True)
            self.root.rmdir()

    def path(self, kind: str, identity: str) -> Path:
        """The file of one case."""
        suffix = {"telemetry": "csv", "twin": "csv", "second": "csv", "closed": "toml"}.get(kind, "json")
        return self.root / kind / f"{identity}.{suffix}"

    def has(self, kind: str, identity: str) -> bool:
        """Whether that file is there."""
        return self.path(kind, identity).exists()

    def read(self, kind: str, identity: str) -> dict[str, Any]:
        """A JSON file of one case."""
        found: dict[str, Any] = json.loads(self.path(kind, identity).read_text(encoding="utf-8"))
        return found

    def write(self, kind: str, identity: str, value: dict[str, Any]) -> None:
        """Write a JSON file of one case, whole or not at all."""
        files.write_json(self.path(kind, identity), value)

    def seal(self, identities: Iterable[str]) -> str:
        """SHA-256 over the answers in the order given; kept beside them."""
        digest = hashlib.sha256()
        for identity in identities:
            digest.update(self.path("sealed", identity).read_bytes())
        files.write_text(self.root / "sealed.sha256", digest.hexdigest() + "\n")
        return digest.hexdigest()

    def agree(self, wanted: dict[str, Any]) -> None:
        """Keep what the run is, or refuse to go on with another. Raises SystemExit."""
        target = self.root / "run.json"
        if target.exists():
            there = json.loads(target.read_text(encoding="utf-8"))
            if there != wanted:
                raise SystemExit(f"{self.root} holds another run: {there}; give another --out")
            return
        files.write_json(target, wanted)


def commit_of(root: Path) -> tuple[str, bool]:
    """Full SHA of the commit, and whether anything but the log differs from it."""

    def git(*words: str) -> str:
        command = ["git", "-c", "safe.directory=*", "-C", str(root), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.rstrip("\n")

    changed = [line for line in git("status", "--porcelain").splitlines() if line[3:] != "benchmarks/withheld.log"]
    return git("rev-parse", "HEAD"), bool(changed)


def append_log(row: dict[str, Any]) -> None:
    """One more line at the end of the log; earlier lines are never touched."""
    with LOG.open("a", encoding="utf-8") as log:
        log.write(json.dumps(row, allow_nan=False, sort_keys=True) + "\n")
