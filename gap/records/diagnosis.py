"""The diagnosis as a record: where the gap lies, which effect causes it, how far it shrinks.

Every class is described once, here: its fields are the keys of the JSON, their types and bounds the schema
(`diagnosis_schema`), and the text below a field is its description. Fields marked `Kept` stay in the program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import ConfigDict, Field, GetPydanticSchema, PlainSerializer, TypeAdapter, WithJsonSchema

from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.seals import FORMAT
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.effects.base import STAGES, Effect, SignalEffect
from fluxtwin.sim.effects.chain import Active

CONDITIONS = "|".join(
    [
        *("sunlit", "eclipse", "torquer", "latitude", "orbit_phase", "temperature", "current", "field_strength"),
        *("time", "after_time", "head", "rate", "region", "flag:.+", "driver:.+"),
    ]
)
"""Patterns of what an effect may follow."""
_SHARE = {"type": "number", "minimum": 0, "maximum": 1}
_SIZE = {"type": "number", "minimum": 0}
_COUNT = {"type": "integer", "minimum": 0}


def _enum(*values: str | None) -> WithJsonSchema:
    return WithJsonSchema({"enum": list(values)})


def _keys(**properties: object) -> WithJsonSchema:
    """A mapping with just these keys."""
    return WithJsonSchema(_object(**properties))


def _object(**properties: object) -> dict[str, Any]:
    return {"type": "object", "required": [*properties], "additionalProperties": False, "properties": properties}


def _shares(names: str) -> dict[str, Any]:
    """Probabilities by name, `none` among them."""
    closed = {"type": "object", "required": ["none"], "additionalProperties": False}
    return {**closed, "patternProperties": {f"^({names}|none)$": _SHARE}}


Kept = GetPydanticSchema(lambda _, handler: handler(Any))
Inner = Field(exclude=True)
_BY_AXIS = Field(json_schema_extra={"propertyNames": {"enum": ["x", "y", "z"]}})
Share = Annotated[float, Field(ge=0, le=1)]
Size = Annotated[float, Field(ge=0)]
Interval = tuple[Share, Share]
Name = Annotated[str, Field(min_length=1)]
Names = Annotated[Sequence[Name], Field(json_schema_extra={"uniqueItems": True})]
Stage = Annotated[str, _enum(*STAGES)]
Axis = Annotated[str | None, _enum("x", "y", "z", "all", None)]
Frame = Annotated[str | None, _enum("body", "orbital", "inertial", "earth", None)]
Condition = Annotated[str | None, WithJsonSchema({"type": ["string", "null"], "pattern": f"^({CONDITIONS})$"})]
Rivals = Annotated[
    Sequence[tuple[str, float]],
    PlainSerializer(lambda pairs: [{"name": name, "probability": share} for name, share in pairs]),
    WithJsonSchema({"type": "array", "items": _object(name={"type": "string"}, probability=_SHARE)}),
]
Estimate = Annotated[
    tuple[float, float | None],
    PlainSerializer(lambda pair: {"value": pair[0], "sigma": pair[1]}),
    _keys(value={"type": "number"}, sigma={"type": ["number", "null"], "minimum": 0}),
]


@dataclass(frozen=True)
class Record:
    """What the JSON of a diagnosis is made of."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", use_attribute_docstrings=True, json_schema_serialization_defaults_required=True
    )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; every key always present."""
        plain: dict[str, Any] = TypeAdapter(type(self)).dump_python(self, mode="json", by_alias=True)
        return plain


@dataclass(frozen=True)
class MomentumGap(Record):
    """Only where the momentum was balanced (a scenario with attitude mode dynamics, and attitude, wheel speeds and dipoles
    in the telemetry): the attitude against what the balance makes of it, rms per component over held-out windows."""

    before_deg: Size
    after_deg: Size
    floor_deg: Size
    """What the noise of the balance leaves."""
    closed: Share | None
    """1 - max(after^2 - floor^2, 0) / (before^2 - floor^2); None where that is not measurable."""
    interval: Interval | None
    """90 %."""
    windows: Annotated[int, Field(ge=2)]
    window_s: Size
    noise: str
    standing_error_deg: Annotated[Mapping[str, Estimate], _BY_AXIS]
    """Attitude error that stands still in the body, by axis: value and sigma. The momentum leans with it, while the
    readings cannot tell it from a misalignment of the magnetometer."""


@dataclass(frozen=True)
class EffectParameter(Record):
    """A parameter with its sigma; the unit is a word of its own because it differs from one to the next."""

    value: float
    sigma: Size | None
    unit: str


@dataclass(frozen=True)
class FoundEffect(Record):
    """A cause that is present: of the search, of the balance of the momentum, or known by its own shape."""

    name: str
    group: Annotated[Names, Field(min_length=1, max_length=3)]
    """Names, its own first, that these data cannot tell from it. With more than three none can be given."""
    rivals: Rivals
    """Less likely alternatives with their probabilities, most likely first."""
    probability: Share
    """That this entry, or a member of its group, is present."""
    parameters: Mapping[str, EffectParameter]
    settings: Mapping[str, Any]
    """Discrete settings of the effect (a head, a degree); `assumed`: of what its parameters are the field, where no current
    was recorded."""
    stage: Stage
    axis: Axis
    frame: Frame
    condition: Condition
    significance: Share
    """p-value of the effect on top of all others, corrected for the number of tests."""
    visible_nT: Size
    """rms per component that it leaves after the best re-estimation of what is modelled."""
    effect: Annotated[Effect | None, Kept, Inner] = field(default=None, compare=False)
    """With its discrete settings; None where another measurement names it."""
    covariance: Annotated[FloatArray | None, Kept, Inner] = field(default=None, compare=False)
    """(p, p); NaN where a parameter is not estimated (not seen, or at its limit). None: of no fit, sigmas alone."""

    @property
    def theta(self) -> FloatArray:
        """(p,) parameters of the effect, in their units."""
        return np.array([one.value for one in self.parameters.values()])

    @property
    def sigma(self) -> FloatArray:
        """(p,) of each parameter; NaN where it is not known."""
        return np.array([np.nan if one.sigma is None else one.sigma for one in self.parameters.values()])

    @property
    def too_many_alike(self) -> bool:
        """More than three effects would do as well."""
        return len(self.group) > 3


@dataclass(frozen=True)
class Place(Record):
    """Where the largest part of the gap lies; each set of probabilities sums to 1 with `none`."""

    stage: Annotated[str | None, _enum(*STAGES, None)]
    axis: Axis
    frame: Frame
    condition: Condition
    equivalent: Annotated[Sequence[Stage], Field(json_schema_extra={"uniqueItems": True})]
    probabilities: Annotated[
        Mapping[str, Mapping[str, float]],
        _keys(
            stage=_shares("|".join(STAGES)),
            axis=_shares("x|y|z|all"),
            frame=_shares("body|orbital|inertial|earth"),
            condition=_shares(CONDITIONS),
        ),
    ]

    def likely(self, kind: str) -> dict[str, float]:
        """The place of a kind (stage, axis, frame or condition) with its probability, followed by the next most likely
        ones until together they have 90 % of what is placed at all, as every interval has; empty where there is no such
        place."""
        chosen = getattr(self, kind)
        shares = {name: share for name, share in self.probabilities[kind].items() if name != "none"}
        found: dict[str, float] = {}
        for name in sorted(shares, key=lambda name: (name != chosen, -shares[name])) if chosen in shares else ():
            if sum(found.values()) < 0.9 * sum(shares.values()):
                found[name] = shares[name]
        return found


@dataclass(frozen=True)
class Shrinkage(Record):
    """How far the gap shrinks: rms per component [nT] over held-out samples, body axes."""

    before_nT: Size
    after_nT: Size
    floor_nT: Size
    floor_with_effects_nT: Size
    closed: Share | None
    """1 - max(after^2 - floor_with_effects^2, 0) / (before^2 - floor^2); None where that is not measurable."""
    interval: Interval | None
    """90 %."""
    prediction: Annotated[str, _enum("blocks", "one_step", "fit")] = "blocks"
    """Held-out blocks, one step ahead, or the fit itself where one part of the record does not determine another."""
    shape_incomplete: bool = False
    per_axis: Annotated[
        Mapping[str, Annotated[Mapping[str, float], _keys(before_nT=_SIZE, after_nT=_SIZE)]], _BY_AXIS
    ] = field(default_factory=dict)
    left_nT: Size = 0.0
    """rms per component of the residual of the fit, with every sample in it: what is to be compared with the floor."""


@dataclass(frozen=True)
class Detectable(Record):
    """The smallest size of an effect that this design shows (false alarm 0.2 % over all that is tested, miss 10 %)."""

    parameter: str
    value: Size
    unit: str
    visible_nT: Annotated[float, Field(ge=0, serialization_alias="nT")]


@dataclass(frozen=True)
class GapSeries:
    """Series for figures; N rows."""

    time: TimeArray
    before_nT: FloatArray
    """(N, 3) residual with what is modelled re-estimated."""
    after_nT: FloatArray
    """(N, 3) residual with the named effects too."""
    cut: BoolArray | None = None
    """(N,) rows that were set aside as outliers."""


@dataclass(frozen=True)
class Ranked(Record):
    """One line of the ranking: an effect by itself, by its best alternative, before any is named."""

    name: Name
    drop: Size
    """Of chi-square, over the directions that it has."""
    directions: Annotated[int, Field(ge=1)]
    p_value: Share
    """Corrected for the number of tests."""

    @property
    def order(self) -> tuple[float, float]:
        """The surest first; what only rounding tells apart is alike."""
        return float(f"{self.p_value:.8e}"), -float(f"{self.drop:.8e}")


@dataclass(frozen=True, eq=False)
class Score:
    """What one record says of one effect, with unit noise; of many records these add up."""

    label: str
    """The name with its settings."""
    effect: Effect
    score: FloatArray
    """(p,) derivative of the log likelihood by each parameter, at none of the effect."""
    information: FloatArray
    """(p, p) beside the nuisance; zero for parameters that move nothing."""
    of_errors: float = 0.0
    """What of the information of a single parameter is none, as its image is made of an attitude with errors."""


@dataclass(frozen=True)
class Transfer(Record):
    """Whether the parameters of a named effect are good enough for another design, and how unsure its signal is there."""

    __pydantic_config__ = Record.__pydantic_config__ | ConfigDict(
        json_schema_extra={
            "if": {"properties": {"transfers": {"const": False}}},
            "then": {"properties": {"why": {"minLength": 1}}},
        }
    )
    effect: Name
    design: Name
    transfers: bool
    chance: Share | None
    """That a diagnosis there would call the error a gap; None where the question does not arise."""
    uncertainty_nT: Size | None
    """rms per component of the error of its signal, once what is modelled is re-estimated there."""
    floor_nT: Size | None
    """rms per component of the noise there."""
    detectable_nT: Size | None
    """rms per component from which such an error would be seen there; None where it is absorbed wholly."""
    why: str
    """Words, where it does not transfer or something must be known."""


@dataclass(frozen=True)
class LawTerm(Record):
    """One term: a field of `coefficients` times the product of the factors, along axes of a frame."""

    name: Name
    """NAME of the section [effects.law.NAME] that --close writes."""
    of: Annotated[Names, Field(min_length=1)]
    """Factors: recorded columns and geometry, with what is done to each; the first one is late."""
    axes: Annotated[str, _enum("body", "orbital", "inertial", "earth")]
    delay_s: Size
    lag_s: Size
    unit: str
    """Of the coefficients."""
    coefficients: Annotated[Mapping[str, Estimate], _BY_AXIS]
    """By axis: value and sigma."""


@dataclass(frozen=True)
class LawLimit(Record):
    """What a quantity was looked at for, and how large its field would have had to be (as `Detectable`)."""

    quantity: Name
    value: Size
    unit: str
    visible_nT: Size


@dataclass(frozen=True, eq=False)
class LawSeries:
    """A term for a figure: what it follows (n,), and the residual without it along its direction (n,) [nT]."""

    label: str
    follows: FloatArray
    partial_nT: FloatArray
    slope: float
    """nT per unit of what it follows."""


@dataclass(frozen=True)
class Law(Record):
    """What was found to make the part of the gap that the catalogue does not explain; no terms: nothing was."""

    terms: Sequence[LawTerm]
    instead_of: Names
    """Names of the catalogue that the law does without and explains more; beside all others it stands."""
    before_nT: Size
    """rms per component on held-out samples without the law; a name that it stands beside is fitted."""
    after_nT: Size
    floor_nT: Size
    closed: Share | None
    """Of what is left, by the law, on held-out samples; None where that is not measurable, or nothing was found."""
    interval: Interval | None
    """90 %."""
    tried: Annotated[int, Field(ge=1)]
    """Terms that were truly tried, which the criterion pays for."""
    could_be: Sequence[Names]
    """Factors of other terms that these data do not tell from the first."""
    why_none: str
    """Why nothing is said, in words; empty where a law is."""
    looked_at: Sequence[LawLimit]
    """Where nothing was found: what was looked at, and the smallest size that would have shown."""
    sentence: str
    fitted: Annotated[Sequence[LawSeries], Kept, Inner] = field(default=(), compare=False)


@dataclass(frozen=True, eq=False)
class Closure:
    """The named effects and the design that they were learnt on; not part of the JSON."""

    problem: Problem
    whitener: Whitener
    modelled: tuple[Active, ...]
    """What is re-estimated, as refitted together with the named effects."""
    chosen: tuple[Active, ...]
    """Named effects of the search, with the parameters that the data give."""
    alternatives: tuple[tuple[SignalEffect, ...], ...]
    """For each of them: what might stand in its place (members of its group, rivals, other settings)."""
    stochastic: tuple[FoundEffect, ...]
    """Named effects that are known by their distribution or their own shape, not by a fit of the search."""
    variance: float
    """Of whitened rows: 1 when the noise model is right."""
    tested: int
    """Alternatives tested: for which every p-value is corrected."""
    incomplete: str | None
    """Why the named effects are not the whole gap, in words; None when they are."""

    @property
    def empty(self) -> bool:
        """Whether nothing was named."""
        return not self.chosen and not self.stochastic


def _rules(schema: dict[str, Any]) -> None:
    """What the verdict says of other keys; `momentum` and `law` are there only where there is something to say."""
    schema["required"] = [name for name in schema["required"] if name not in ("momentum", "law")]
    schema["properties"] |= {
        "fluxtwin": {"description": "Version of the program that wrote the file.", "type": "string"},
        "format": {"description": "What the keys of the file mean; raised when that changes.", "const": FORMAT},
        "sha256": {"description": "Of all other keys, as JSON with sorted keys and no blanks.", "type": "string"},
    }
    none, null = {"maxItems": 0}, {"type": "null"}
    unmeasured = {"properties": {"closed": null, "interval": null}}
    said = {
        "no_gap": {"effects": none, "resembles": none, "gap": unmeasured},
        "effect": {"effects": {"minItems": 1}, "resembles": none},
    }
    schema["allOf"] = [
        {"if": {"properties": {"verdict": {"const": verdict}}}, "then": {"properties": properties}}
        for verdict, properties in said.items()
    ]


@dataclass(frozen=True)
class Diagnosis(Record, Shown):
    """What `fluxtwin diagnose --json` writes: where the gap lies, which effect causes it, how far it shrinks."""

    __pydantic_config__ = Record.__pydantic_config__ | ConfigDict(json_schema_extra=_rules)
    verdict: Annotated[str, _enum("no_gap", "effect", "unknown")]
    effects: Sequence[FoundEffect]
    """Causes jointly present, best supported first."""
    resembles: Names
    """With verdict unknown: what the gap looks like."""
    where: Place
    gap: Shrinkage
    modelled: Names
    untestable: Mapping[str, Name]
    isolability: Mapping[str, Mapping[str, Annotated[float, Field(ge=0.5, le=1)]]]
    """Share of the first that the second can imitate here, where at least one half."""
    minimum_detectable: Mapping[str, Detectable]
    """False alarm 0.2 % over all that is tested, miss 10 %."""
    samples: Annotated[Mapping[str, int], _keys(used=_COUNT, cut=_COUNT, without_attitude=_COUNT)]
    provenance: Mapping[str, Any]
    sentence: Name
    """One sentence that a person can act on."""
    would_settle: Mapping[str, Name] = field(default_factory=dict)
    """For effects that these data cannot show at their typical size: hours of like data, or a manoeuvre."""
    ranking: Sequence[Ranked] = ()
    """Every effect that was tested, each alone before any is named, most significant first; what imitates a cause is high
    too."""
    transfers: Sequence[Transfer] | None = None
    """For which other designs each named effect, frozen as found, leaves no gap; None unless closing was asked for."""
    assumed: Mapping[
        str,
        Annotated[
            Mapping[str, Any],
            _keys(
                value={"type": ["number", "null"]},
                source={"enum": ["declared", "scenario", "found"]},
                flag={"type": "string"},
            ),
        ],
    ] = field(default_factory=dict)
    """The noise that the answer rests on: declared, from the scenario, or found in the data; and the flag that sets it."""
    momentum: MomentumGap | None = None
    """The balance of the momentum; None, and not in the JSON, where there is none."""
    law: Law | None = None
    """Of what the catalogue does not explain; None, and not in the JSON, where it explains all."""
    notes: Annotated[Sequence[str], Inner] = ()
    """What the reader must know of the record: rows that are not in it, inputs that look wrong. In the JSON a part of the
    provenance."""
    series: Annotated[GapSeries | None, Kept, Inner] = field(default=None, compare=False)
    closure: Annotated[Closure | None, Kept, Inner] = field(default=None, compare=False)
    scores: Annotated[tuple[Sequence[Score], Sequence[Score]], Kept, Inner] = ((), ())
    """What the readings say of every effect of the catalogue, and of the others beside the named ones; for fleets."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; every key always present, but `momentum` only where it was balanced, and `law` only where
        the catalogue does not explain all."""
        plain = super().to_dict()
        plain["provenance"]["notes"] = list(self.notes)
        absent = {name for name in ("momentum", "law") if getattr(self, name) is None}
        return {key: value for key, value in plain.items() if key not in absent}


@cache
def diagnosis_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) that every answer of `fluxtwin diagnose --json` keeps."""
    schema = TypeAdapter(Diagnosis).json_schema(mode="serialization")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
