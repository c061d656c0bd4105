"""The probability that is stated of a name: how often names that the posterior was as sure of were right.

Nature is none of the hypotheses exactly, so a posterior over them is too sure. How often a name was right, by what the
posterior gave it, was counted on simulated flights with a seed of their own (`benchmarks/withheld.py --fit`; on the same
flights a few faults of the engine had been found and mended before). The table beside this module has the non-decreasing
steps that suit those counts best (isotonic regression: Zadrozny & Elkan 2002, doi 10.1145/775047.775151). It holds for
records like those flights, with as many causes outside the catalogue, and as faint.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fluxtwin.gap.records.diagnosis import FoundEffect
from fluxtwin.sim.base.types import FloatArray

TABLE = Path(__file__).parent / "stated.toml"
FIRST, FURTHER = "first", "further"
"""A name that is alone or likeliest in its answer, and one beside it, which is easily the shape error of the first."""


class Steps(NamedTuple):
    """Counts of one step each, in rising order."""

    least: FloatArray
    """Least posterior probability of the step."""
    right: FloatArray
    """Names that were right."""
    of: FloatArray

    @property
    def share(self) -> FloatArray:
        """That the next one is right, by Laplace's rule."""
        return np.maximum.accumulate((self.right + 1.0) / (self.of + 2.0))


def stated(probability: float, place: str = FIRST) -> float:
    """What is stated of a name in its place in the answer, `first` or `further`, to which the posterior gives this much; no
    more than that."""
    steps = _steps()[place]
    share = float(steps.share[max(int(np.searchsorted(steps.least, probability, side="right")) - 1, 0)])
    return min(probability, share)


def as_stated(effects: Sequence[FoundEffect]) -> list[FoundEffect]:
    """The named effects of an answer, best supported first, with the probabilities that are stated of them; what is left
    over for the rivals of each is the most they have."""
    found = []
    for number, one in enumerate(effects):
        own, rivals = stated(one.probability, FURTHER if number else FIRST), sum(share for _, share in one.rivals)
        part = min(1.0, (1.0 - own) / rivals) if rivals else 1.0
        found.append(replace(one, probability=own, rivals=tuple((name, part * share) for name, share in one.rivals)))
    return found


def likelier_unknown(effects: Sequence[FoundEffect]) -> bool:
    """Whether it is likelier that not even the first of several names is right than that all are, or the first with
    something else beside it."""
    shares = [one.probability for one in as_stated(effects)]
    return len(shares) > 1 and 1.0 - shares[0] > max(shares[0] - min(shares), min(shares))


@cache
def _steps() -> dict[str, Steps]:
    with TABLE.open("rb") as file:
        table = tomllib.load(file)
    columns = {
        place: [np.array(table[place][name], dtype=np.float64) for name in Steps._fields] for place in (FIRST, FURTHER)
    }
    return {place: Steps(*found) for place, found in columns.items()}
