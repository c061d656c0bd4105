"""One case with its answer open: what was right about what was said."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

_APART = "apart from these rows there is no gap"
"""What is said where some readings are wild and nothing else is found."""
EQUIVALENT = {
    "bias": {"spacecraft"},
    "scale_misalignment": {"attitude"},
    "hysteresis": {"spacecraft"},
    "sensor_lag": {"time"},
    "coarse_quantization": {"telemetry"},
    "bias_step": {"spacecraft"},
    "bias_random_walk": {"spacecraft"},
    "boom_bending": {"attitude", "sensor"},
    "axis_skew": {"time"},
    "linear_drift": {"spacecraft"},
    "attitude_step": {"sensor"},
    "mounting_step": {"attitude"},
}
"""Stages that the effects table itself holds to be the same, or that have one image."""


@dataclass(frozen=True)
class Judged:
    """Truth and answer side by side."""

    sealed: dict[str, Any]
    said: dict[str, Any]
    twin: dict[str, Any] | None = None
    """What the noise-free twin says of the closing."""
    rival: dict[str, Any] | None = None
    """What the rival named: groups, by criterion."""
    loop: dict[str, Any] | None = None
    """What was said of another day with the closed scenario in force."""
    control: dict[str, Any] | None = None
    """The same with a wrong effect in it."""
    limit: dict[str, Any] | None = None
    """What was said of the printed smallest size when it was flown."""

    @property
    def population(self) -> str:
        """Name of the population."""
        return str(self.sealed["population"])

    @property
    def truths(self) -> list[str]:
        """Names that are true."""
        return [str(truth["name"]) for truth in self.sealed["truths"]]

    @property
    def visible(self) -> float:
        """The smallest visible strength of its truths."""
        return min((float(truth["visible"]) for truth in self.sealed["truths"]), default=0.0)

    @property
    def signal(self) -> bool:
        """Whether all truths are signals."""
        return all(bool(truth["signal"]) for truth in self.sealed["truths"])

    @property
    def verdict(self) -> str:
        """no_gap, effect, unknown or error."""
        return str(self.said["verdict"])

    @property
    def quiet(self) -> bool:
        """Whether no gap is said. Where readings are wild in truth: that nothing is there apart from these."""
        apart = self.sealed["label"] == "outliers" and _APART in str(self.said.get("sentence"))
        return self.verdict == "no_gap" or apart

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Named causes, best first."""
        return list(self.said.get("effects") or [])

    @property
    def first_right(self) -> bool:
        """Whether the first name, or its group, holds a truth."""
        return bool(self.effects) and self.hits(self.effects[0])

    @property
    def list_right(self) -> bool:
        """Whether the names are the truths, one to one, and nothing else is claimed."""
        if self.verdict != "effect" or len(self.effects) != len(self.truths):
            return False
        return _matched([names_of(entry) for entry in self.effects], self.truths)

    @property
    def in_group(self) -> bool:
        """Whether every truth is in some named group."""
        said = set().union(*(names_of(entry) for entry in self.effects)) if self.effects else set()
        return set(self.truths) <= said

    @property
    def extra(self) -> bool:
        """Whether a name is given that no truth stands behind."""
        return any(not self.hits(entry) for entry in self.effects)

    @property
    def stage_right(self) -> bool:
        """Whether the stage claimed is that of a truth, or one with the same image."""
        where = self.said.get("where") or {}
        claimed = {where.get("stage"), *(where.get("equivalent") or [])} - {None}
        if where.get("stage") is None:
            return False
        true = {str(truth["stage"]) for truth in self.sealed["truths"]}
        for name in self.truths:
            true |= EQUIVALENT.get(name, set())
        return bool(claimed & true)

    def hits(self, entry: dict[str, Any]) -> bool:
        """Whether an entry or its group holds a truth."""
        return bool(names_of(entry) & set(self.truths))

    def stated(self) -> list[tuple[float, bool]]:
        """Every probability that was stated of a name, and whether it came true."""
        found = []
        for entry in self.effects:
            if entry.get("probability") is not None:
                found.append((float(entry["probability"]), self.hits(entry)))
            rivals = [rival for rival in entry.get("rivals") or [] if rival.get("probability") is not None]
            found += [(float(rival["probability"]), rival["name"] in self.truths) for rival in rivals]
        return found

    def rival_right(self, criterion: str) -> bool:
        """Whether the rival's groups are the truths, one to one."""
        groups = [set(group) for group in (self.rival or {}).get(criterion, [])]
        return len(groups) == len(self.truths) and _matched(groups, self.truths)

    def rival_alarm(self, criterion: str) -> bool:
        """Whether the rival named anything."""
        return bool((self.rival or {}).get(criterion))

    def words(self) -> str:
        """What was said, on one line."""
        if self.verdict == "error":
            return f"error {self.said['error'][:160]}"
        names = "+".join("/".join(sorted(names_of(entry), key=lambda n: n != entry["name"])) for entry in self.effects)
        resembles = ",".join(self.said.get("resembles") or [])
        where = self.said.get("where") or {}
        place = where.get("stage") or "nowhere"
        return f"{self.verdict}: {names or '-'}; resembles {resembles or '-'}; {place}, {where.get('condition')}"


def names_of(entry: dict[str, Any]) -> set[str]:
    """Name and group of an entry."""
    return {str(entry["name"]), *(str(name) for name in entry.get("group") or [])}


def _matched(groups: list[set[str]], truths: list[str]) -> bool:
    """Whether groups and truths can be paired off."""
    if not truths:
        return not groups
    return any(
        truths[0] in group and _matched(groups[:k] + groups[k + 1 :], truths[1:]) for k, group in enumerate(groups)
    )
