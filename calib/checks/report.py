"""What a check found: findings with a code, a sentence with the evidence, and the rows concerned."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from fluxtwin.calib.common.words import filled, texts
from fluxtwin.sim.base.shown import Shown

_SHOWN_ROWS = 20


@dataclass(frozen=True)
class Finding:
    """One thing found in a telemetry file."""

    code: str
    """Stable name, as `magnetometer_unit`."""
    severity: Literal["trap", "note"]
    """trap: the file is not what it says. note: worth knowing, or why something could not be tested."""
    text: str
    """What was found, the evidence, and what to do."""
    rows: tuple[int, ...] = ()
    """The first rows concerned, counted from 1; empty when it concerns the file."""
    row_count: int = 0
    """How many rows are concerned."""

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "rows": list(self.rows)}


@dataclass(frozen=True)
class CheckReport(Shown):
    """All findings about one file, traps first."""

    source: str
    samples: int
    findings: tuple[Finding, ...] = field(default=())

    @property
    def traps(self) -> tuple[Finding, ...]:
        """The findings that say the file is not what it claims."""
        return tuple(finding for finding in self.findings if finding.severity == "trap")

    @property
    def notes(self) -> tuple[Finding, ...]:
        """The other findings."""
        return tuple(finding for finding in self.findings if finding.severity == "note")

    @property
    def clean(self) -> str:
        """What it means that no trap was named, in words."""
        if any(finding.code == "not_compared" for finding in self.notes):
            return (
                "no trap found, but without positions nothing was compared with the field model: add them, check again"
            )
        return "clean: no trap found"

    @property
    def exit_status(self) -> int:
        """0 clean, 1 a trap was named."""
        return 1 if self.traps else 0

    def to_dict(self) -> dict[str, Any]:
        """For JSON; no NaN."""
        return {
            "source": self.source,
            "samples": self.samples,
            "clean": not self.traps,
            "findings": [finding.to_dict() for finding in self.findings],
        }


def trap(name: str, rows: np.ndarray | None = None, /, **values: Any) -> Finding:
    """The trap of that name in `findings.toml`, as `code` or `code.variant`; rows: indices from 0, values: of its text."""
    return _finding("trap", name, rows, values)


def note(name: str, rows: np.ndarray | None = None, /, **values: Any) -> Finding:
    """The note of that name; arguments as `trap`."""
    return _finding("note", name, rows, values)


def named(code: str, text: str) -> Finding:
    """A trap whose text was put together from what is likeliest."""
    return Finding(code, "trap", text)


def report(source: str, samples: int, findings: list[Finding]) -> CheckReport:
    """The report, traps first, otherwise in the order found."""
    return CheckReport(source, samples, tuple(sorted(findings, key=lambda f: f.severity != "trap")))


def _finding(severity: Literal["trap", "note"], name: str, rows: np.ndarray | None, values: dict[str, Any]) -> Finding:
    code, _, variant = name.partition(".")
    text = texts("fluxtwin.calib.checks", "findings.toml")[severity][code]
    some = np.zeros(0, dtype=int) if rows is None else rows
    shown = tuple(int(row) + 1 for row in some[:_SHOWN_ROWS])
    return Finding(code, severity, filled(text[variant] if variant else text, values), shown, len(some))
