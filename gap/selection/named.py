"""What a search for causes hands on: the named effects, and everything later steps need of the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fluxtwin.gap.hypotheses.candidates import Candidate
from fluxtwin.gap.records.diagnosis import Detectable
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active


@dataclass(frozen=True, eq=False)
class Named:
    """One cause that is present, at its refitted parameters."""

    effect: SignalEffect
    """With its discrete settings."""
    theta: FloatArray
    """(p,) in the units of its parameters."""
    covariance: FloatArray
    """(p, p); NaN where a parameter is not estimated (not seen, or at its limit)."""
    p_value: float
    """Of the effect on top of all others, corrected for the number of tests."""
    group: tuple[str, ...]
    """Names, its own first, that these data cannot tell from it. More than three: no name can be given."""
    rivals: tuple[tuple[str, float], ...]
    """Less likely alternatives with their probabilities, most likely first."""
    probability: float
    """That this entry, or a member of its group, is present."""
    visible_nT: float
    """rms per component that it leaves after the best re-estimation of what is modelled."""
    axis_shares: tuple[float, float, float]
    """Of that, the share of each body axis (of the energy)."""
    signal_nT: FloatArray
    """(M, 3) what it leaves after the best re-estimation of what is modelled."""

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def too_many_alike(self) -> bool:
        """More than three effects would do as well."""
        return len(self.group) > 3


@dataclass(frozen=True)
class Ranked:
    """One line of the ranking before anything is named."""

    name: str
    label: str
    """The name with its settings."""
    drop: float
    """Of chi-square."""
    rank: int
    p_value: float
    """Corrected for the number of tests."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The outcome of a search; M rows, those of the problem."""

    named: tuple[Named, ...]
    """Jointly present, best supported first; empty: no gap that the catalogue explains."""
    ranking: tuple[Ranked, ...]
    """Every effect alone, best alternative, most significant first."""
    untestable: Mapping[str, str]
    isolability: Mapping[str, Mapping[str, float]]
    """Shares of 0.5 and more: {a: {b: share of a that b can imitate}}."""
    minimum_detectable: Mapping[str, Detectable]
    smallest_images_nT: FloatArray
    """(M, 3, k) image of one unit of each of them."""
    groups: Mapping[str, tuple[str, ...]]
    """From the design alone: {name: names, its own first, that imitate each other}."""
    candidates: Sequence[Candidate]
    """With their Jacobians at the fit without any named effect."""
    modelled: tuple[Active, ...]
    """What is re-estimated, refitted beside the named effects."""
    chosen: tuple[Active, ...]
    """Effects and parameters of `named`, same order."""
    modelled_alone: tuple[Active, ...]
    """What is re-estimated, refitted without any named effect."""
    residual_nT: FloatArray
    """(N, 3) reading less prediction with everything at its refitted value, all rows of the problem."""
    residual_alone_nT: FloatArray
    """(N, 3) the same without any named effect."""
    residual_white: FloatArray
    """(M, 3) whitened."""
    jacobian_white: FloatArray
    """(M, 3, c + p) whitened, what is modelled, then the named effects in the order of `chosen`."""
    residual_alone_white: FloatArray
    """(M, 3)."""
    nuisance_alone_white: FloatArray
    """(M, 3, c)."""
    chi2: Mapping[str, tuple[float, int]]
    """`nuisance`, `named`: chi-square and number of parameters seen."""
    variance: float
    """Of whitened rows about the saturated fit: 1 when the noise model is right."""
    tested: int
    """Alternatives tested: the price of the search."""

    @property
    def resembles(self) -> tuple[str, ...]:
        """Names that would do, where more than three cannot be told apart; else none."""
        return tuple(dict.fromkeys(name for one in self.named if one.too_many_alike for name in one.group))
