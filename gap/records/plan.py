"""The plan of the next experiment as a record: what is open, what to fly for it, and what each answer would mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fluxtwin.gap.records.diagnosis import Inner, Kept, Name, Record, Share, Size
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.scenario.scenario import Scenario

ENOUGH = 0.95
"""Power from which a manoeuvre is said to settle a question: above the nine in ten that is wanted, as it is a prediction."""


@dataclass(frozen=True)
class Answer(Record):
    """One way in which it may come out."""

    cause: Name
    power: Share
    """Probability that a diagnosis of what is flown says so, if it is so."""
    means: str


@dataclass(frozen=True)
class Course(Record):
    """One manoeuvre for a question."""

    words: Name
    hours: Size
    """After which `power` is reached."""
    wait_days: Size
    power: Share
    """The least of its answers."""
    answers: Sequence[Answer]
    curve: Sequence[tuple[float, float]]
    """Hours flown and the power then."""
    scenario: Annotated[Scenario | None, Kept, Inner] = None
    """What `simulate` flies."""

    @property
    def settles(self) -> bool:
        """Whether it is enough."""
        return self.power >= ENOUGH


@dataclass(frozen=True)
class Question(Record):
    """What these data leave open, and what would settle it."""

    kind: str
    """tell_apart: two names or more; place: something unknown in one of several axes; show: a name at its typical size."""
    names: Sequence[Name]
    words: Name
    courses: Sequence[Course]
    """Best first; none where no manoeuvre within the limits does anything for it."""
    as_before: Course | None = None
    """More of the attitude that points at the Earth; None where the limits do not allow it."""
    instead: str = ""
    """What the catalogue says would settle it, in words."""

    @property
    def best(self) -> Course | None:
        return self.courses[0] if self.courses else None


@dataclass(frozen=True)
class Plan(Record, Shown):
    """What `fluxtwin plan --json` writes."""

    sentence: Name
    questions: Sequence[Question]
    """Most urgent first: what is named but not distinguished, what is unknown, what would not have shown."""
    limits: Mapping[str, Any]
    refused: Mapping[str, str]
    """Manoeuvres that the limits do not allow, and why."""
    notes: Sequence[str]

    @property
    def scenario(self) -> Scenario | None:
        """The first question's best manoeuvre; None where there is none."""
        return next((q.best.scenario for q in self.questions if q.best is not None), None)


@dataclass(frozen=True)
class SigmaCourse(Record):
    """One manoeuvre for a calibration."""

    words: Name
    hours: Size
    wait_days: Size
    sigma: Size
    """Of the parameter that was known worst, once record and manoeuvre are calibrated together."""
    curve: Sequence[tuple[float, float]]
    """Hours flown and its sigma then."""
    scenario: Annotated[Scenario | None, Kept, Inner] = None


@dataclass(frozen=True)
class CalibrationPlan(Record, Shown):
    """What `fluxtwin plan --for calibration --json` writes."""

    sentence: Name
    worst: Name
    sigma: Size
    """Of the record alone."""
    unit: str
    courses: Sequence[SigmaCourse]
    """Those that halve it soonest first, then the others by what they leave."""
    limits: Mapping[str, Any]
    refused: Mapping[str, str]
    notes: Sequence[str]

    @property
    def scenario(self) -> Scenario | None:
        """The first manoeuvre."""
        return self.courses[0].scenario if self.courses else None
