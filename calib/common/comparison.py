"""Methods of calibration side by side: what each errs by on rows that it has not seen, and which to take."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class MethodResult:
    """One method on one record."""

    method: str
    held_out_nT: tuple[float, ...] | None = None
    """rms on rows that were not fitted: x, y, z against the reference attitude; or of |B| alone. None: no answer."""
    along_nT: float | None = None
    """rms of |B| there."""
    angle_deg: float | None = None
    """95 % of the angles between calibrated reading and field there; None without attitude."""
    why_not: str = ""
    """Why there is no answer."""


@dataclass(frozen=True)
class Comparison:
    """All methods that a record allows, and the choice among them."""

    results: tuple[MethodResult, ...]
    chosen: str
    why: str
    """In a sentence."""

    @property
    def columns(self) -> list[str]:
        """The heads of the table."""
        three = any(one.held_out_nT is not None and len(one.held_out_nT) == 3 for one in self.results)
        return [
            "method",
            *(["x [nT]", "y [nT]", "z [nT]"] if three else []),
            "|B| [nT]",
            *(["angle [deg]"] if three else []),
            "remark",
        ]

    @property
    def rows(self) -> list[list[str]]:
        """The cells of the table, numbers to three digits."""
        from fluxtwin.calib.common.digits import plain

        rows = []
        for one in self.results:
            remark = one.why_not or ("take this one" if one.method == self.chosen else "")
            numbers: list[float | None] = [None] * (len(self.columns) - 2)
            if one.held_out_nT is not None:
                three = [*one.held_out_nT] if len(one.held_out_nT) == 3 else []
                numbers = [*three, one.along_nT, *([one.angle_deg] if three else [])]
            rows.append([one.method, *("" if x is None else plain(x) for x in numbers), remark])
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        return {"results": [asdict(one) for one in self.results], "chosen": self.chosen, "why": self.why}
