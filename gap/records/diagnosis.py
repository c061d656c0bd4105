"""The diagnosis as a record: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fluxtwin.gap.records.closure import Closure
from fluxtwin.sim.base.types import FloatArray, TimeArray

VERDICTS = ("no_gap", "effect", "unknown")
STAGES = ("dynamics", "time", "orbit", "field", "attitude", "spacecraft", "sensor", "telemetry")


@dataclass(frozen=True)
class MomentumGap:
    """rms per component of the attitude against the balance of the momentum, over held-out windows [deg]."""

    before_deg: float
    after_deg: float
    floor_deg: float
    """What the noise of the balance leaves."""
    closed: float | None
    """1 - max(after^2 - floor^2, 0) / (before^2 - floor^2); None where that is not measurable."""
    interval: tuple[float, float] | None
    """90 %."""
    windows: int
    window_s: float
    noise: str
    standing_error_deg: Mapping[str, tuple[float, float | None]]
    """Attitude error that stands still in the body, by axis: value and sigma. The momentum leans with it, while the
    readings cannot tell it from a misalignment of the magnetometer."""

    def to_dict(self) -> dict[str, Any]:
        return {
            "before_deg": self.before_deg,
            "after_deg": self.after_deg,
            "floor_deg": self.floor_deg,
            "closed": self.closed,
            "interval": None if self.interval is None else list(self.interval),
            "windows": self.windows,
            "window_s": self.window_s,
            "noise": self.noise,
            "standing_error_deg": {
                axis: {"value": value, "sigma": sigma} for axis, (value, sigma) in self.standing_error_deg.items()
            },
        }


@dataclass(frozen=True)
class EffectParameter:
    """A parameter with its sigma; the unit is a word of its own because it differs from one to the next."""

    value: float
    sigma: float | None
    unit: str

    def to_dict(self) -> dict[str, Any]:
        return {"value": self.value, "sigma": self.sigma, "unit": self.unit}


@dataclass(frozen=True)
class FoundEffect:
    """One cause that is present, best supported first."""

    name: str
    group: Sequence[str]
    """Names, its own included, that these data cannot tell from it."""
    rivals: Sequence[tuple[str, float]]
    """Less likely alternatives with their probabilities."""
    probability: float
    """That this entry, or a member of its group, is present."""
    parameters: Mapping[str, EffectParameter]
    settings: Mapping[str, Any]
    """Discrete settings of the effect (a head, a degree)."""
    stage: str
    axis: str | None
    frame: str | None
    condition: str | None
    significance: float
    """p-value corrected for the number of tests."""
    visible_nT: float
    """rms per component that it leaves after the best re-estimation of what is modelled."""

    def to_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "group": list(self.group),
            "rivals": [{"name": name, "probability": probability} for name, probability in self.rivals],
            "probability": self.probability,
            "parameters": {name: value.to_dict() for name, value in self.parameters.items()},
            "settings": dict(self.settings),
            "stage": self.stage,
            "axis": self.axis,
            "frame": self.frame,
            "condition": self.condition,
            "significance": self.significance,
            "visible_nT": self.visible_nT,
        }


@dataclass(frozen=True)
class Place:
    """Where the largest part of the gap lies; each set of probabilities sums to 1 with `none`."""

    stage: str | None = None
    axis: str | None = None
    frame: str | None = None
    condition: str | None = None
    equivalent: Sequence[str] = ()
    probabilities: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        sets = {
            name: dict(self.probabilities.get(name, {"none": 1.0})) for name in ("stage", "axis", "frame", "condition")
        }
        return {
            "stage": self.stage,
            "axis": self.axis,
            "frame": self.frame,
            "condition": self.condition,
            "equivalent": list(self.equivalent),
            "probabilities": sets,
        }


@dataclass(frozen=True)
class Shrinkage:
    """How far the gap shrinks: rms per component [nT] over held-out samples, body axes."""

    before_nT: float
    after_nT: float
    floor_nT: float
    floor_with_effects_nT: float
    closed: float | None
    """1 - max(after^2 - floor_with_effects^2, 0) / (before^2 - floor^2); None where that is not measurable."""
    interval: tuple[float, float] | None
    """90 %."""
    prediction: str = "blocks"
    shape_incomplete: bool = False
    per_axis: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    worse: bool = False
    """Whether held-out samples are predicted worse with the named effects than without: they are refuted."""
    left_nT: float = 0.0
    """Left in the fit itself, all samples in it: what is to be compared with the floor."""

    def to_dict(self) -> dict[str, Any]:
        return {
            "left_nT": self.left_nT,
            "before_nT": self.before_nT,
            "after_nT": self.after_nT,
            "floor_nT": self.floor_nT,
            "floor_with_effects_nT": self.floor_with_effects_nT,
            "closed": self.closed,
            "interval": None if self.interval is None else list(self.interval),
            "prediction": self.prediction,
            "shape_incomplete": self.shape_incomplete,
            "per_axis": {axis: dict(values) for axis, values in self.per_axis.items()},
        }


@dataclass(frozen=True)
class Detectable:
    """The smallest size of an effect that this design shows (false alarm 0.2 % over all that is tested, miss 10 %)."""

    parameter: str
    value: float
    unit: str
    visible_nT: float

    def to_dict(self) -> dict[str, Any]:
        return {"parameter": self.parameter, "value": self.value, "unit": self.unit, "nT": self.visible_nT}


@dataclass(frozen=True)
class GapSeries:
    """Series for figures; N rows."""

    time: TimeArray
    before_nT: FloatArray
    """(N, 3) residual with what is modelled re-estimated."""
    after_nT: FloatArray
    """(N, 3) residual with the named effects too."""


@dataclass(frozen=True)
class Alone:
    """One line of the ranking: an effect by itself, before any is named."""

    name: str
    drop: float
    """Of chi-square, over the directions that it has."""
    directions: int
    p_value: float
    """Corrected for the number of tests."""

    def to_dict(self) -> dict[str, Any]:
        return {"name": self.name, "drop": self.drop, "directions": self.directions, "p_value": self.p_value}


@dataclass(frozen=True)
class Transfer:
    """Whether the parameters of a named effect are good enough for another design, and how unsure its signal is there."""

    effect: str
    design: str
    transfers: bool
    chance: float | None
    """That a diagnosis there would call the error a gap; None where the question does not arise."""
    uncertainty_nT: float | None
    """rms per component of the error of its signal, once what is modelled is re-estimated there."""
    floor_nT: float | None
    """rms per component of the noise there."""
    detectable_nT: float | None
    """rms per component from which such an error would be seen there; None where it is absorbed wholly."""
    why: str
    """Words, where it does not transfer or something must be known."""

    def to_dict(self) -> dict[str, Any]:
        return {
            "effect": self.effect,
            "design": self.design,
            "transfers": self.transfers,
            "chance": self.chance,
            "uncertainty_nT": self.uncertainty_nT,
            "floor_nT": self.floor_nT,
            "detectable_nT": self.detectable_nT,
            "why": self.why,
        }


@dataclass(frozen=True)
class Diagnosis:
    """The answer; `to_dict` is the JSON contract."""

    verdict: str
    effects: Sequence[FoundEffect]
    resembles: Sequence[str]
    where: Place
    gap: Shrinkage
    modelled: Sequence[str]
    untestable: Mapping[str, str]
    isolability: Mapping[str, Mapping[str, float]]
    minimum_detectable: Mapping[str, Detectable]
    samples: Mapping[str, int]
    """`used`, `cut`, `without_attitude`."""
    provenance: Mapping[str, Any]
    sentence: str
    """One sentence that a person can act on."""
    series: GapSeries | None = None
    closure: Closure | None = None
    would_settle: Mapping[str, str] = field(default_factory=dict)
    """For effects that these data cannot show at their typical size: hours of like data, or a manoeuvre."""
    ranking: Sequence[Alone] = ()
    """Every effect that was tested, each alone before any is named, most significant first."""
    transfers: Sequence[Transfer] | None = None
    """For which other designs the closed scenario is good enough; None when closing was not asked for."""
    assumed: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """The noise that the answer rests on, by name: `value`, `source` (declared, scenario or found) and `flag`."""
    momentum: MomentumGap | None = None
    """The balance of the momentum; None, and not in the JSON, where there is none."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; every key always present, but `momentum` only where it was balanced."""
        whole = {
            "verdict": self.verdict,
            "effects": [effect.to_dict() for effect in self.effects],
            "resembles": list(self.resembles),
            "where": self.where.to_dict(),
            "gap": self.gap.to_dict(),
            "modelled": list(self.modelled),
            "untestable": dict(self.untestable),
            "isolability": {name: dict(shares) for name, shares in self.isolability.items()},
            "minimum_detectable": {name: value.to_dict() for name, value in self.minimum_detectable.items()},
            "would_settle": dict(self.would_settle),
            "samples": dict(self.samples),
            "provenance": dict(self.provenance),
            "sentence": self.sentence,
            "assumed": {name: dict(one) for name, one in self.assumed.items()},
            "ranking": [line.to_dict() for line in self.ranking],
            "transfers": None if self.transfers is None else [one.to_dict() for one in self.transfers],
        }
        return whole if self.momentum is None else {**whole, "momentum": self.momentum.to_dict()}
