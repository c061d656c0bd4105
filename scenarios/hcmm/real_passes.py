"""What the 43 printed residuals say by themselves: night against day, station against station.

No simulation. The residual of field strength of each pass, in its logarithm, is compared between groups of passes by
permutation. Two stations that see one overflight hear the same satellite at the same time, so overflights are what is
permuted, not passes, and only those that a question compares. Then the same is asked of what is left once the error of
IGRF 1975 along each pass, which is known today, is out (the residuals of that regression are permuted: Freedman & Lane
1983). All tests are counted (Holm 1979).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.hcmm.overflights import orders_of, overflights_of
from fluxtwin.scenarios.hcmm_orbit.record import Pass
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import BoolArray, FloatArray

ORDERS = 20_000
EAST = ("ETC", "MIL")
"""Stations of the eastern United States."""
_CERTAIN = 0.05


@dataclass(frozen=True)
class Question:
    """One comparison of two groups of passes, or of all stations."""

    name: str
    corrected: bool
    """After the error of IGRF 1975 is out."""
    passes: tuple[int, int]
    """In the first group and in the second; of all stations the number of stations and of passes."""
    ratio: float
    """Residual of the first group over that of the second (geometric means); of all stations: largest over smallest."""
    p_value: float
    """Two-sided, by itself."""
    p_counted: float
    """With all questions counted."""
    detectable: float
    """The ratio that would have been found four times in five (at 5 %, by itself); NaN for all stations together."""

    @property
    def certain(self) -> bool:
        return self.p_counted < _CERTAIN


@dataclass(frozen=True, eq=False)
class RealPasses:
    """43 passes."""

    stations: tuple[str, ...]
    night: BoolArray
    overflight: np.ndarray
    """(43,) number of the overflight."""
    printed_mG: FloatArray
    ratio: FloatArray
    """(43,) residual over what the error of IGRF 1975 along the pass lets expect."""
    slope: float
    """Of the logarithm of the residual against that of the expected one."""
    explained: float
    """Share of the variance of the logarithm that it explains."""
    questions: tuple[Question, ...]

    def question(self, name: str, *, corrected: bool) -> Question:
        """One of the questions by its name. Raises KeyError."""
        for one in self.questions:
            if one.name == name and one.corrected == corrected:
                return one
        raise KeyError(name)

    @property
    def single_stations(self) -> list[Question]:
        """Each station against the others, as printed."""
        return [one for one in self.questions if one.name.endswith("against the others") and not one.corrected]


def ask(passes: Sequence[Pass], evidence: Numbers, seed: int, orders: int = ORDERS) -> RealPasses:
    """All questions. orders: number of permutations."""
    stations = tuple(p.station for p in passes)
    night = evidence.night > 0.5
    overflight = overflights_of(passes)
    log_mG = np.log(evidence.printed_mG)
    expected = np.log(evidence.with_lsb_mG)
    slope, intercept = np.polyfit(expected, log_mG, 1)
    left = log_mG - slope * expected - intercept
    rng = stream(seed, "hcmm.real_passes")
    raw = []
    for corrected, y in ((False, log_mG), (True, left)):
        raw += [
            (name, corrected, *_answer(y, groups, overflight, rng, orders)) for name, groups in _groups(stations, night)
        ]
        raw.append(("station against station", corrected, *_stations(y, stations, orders_of(overflight, rng, orders))))
    counted = _holm(np.array([item[4] for item in raw]))
    questions = tuple(
        Question(name, corrected, counts, ratio, p, float(p_counted), detectable)
        for (name, corrected, counts, ratio, p, detectable), p_counted in zip(raw, counted, strict=True)
    )
    explained = 1.0 - float(np.var(left) / np.var(log_mG))
    return RealPasses(
        stations, night, overflight, evidence.printed_mG, np.exp(left), float(slope), explained, questions
    )


def _groups(stations: Sequence[str], night: BoolArray) -> list[tuple[str, tuple[BoolArray, BoolArray]]]:
    """Pairs of groups by name."""
    place = np.array(stations)
    east = np.isin(place, EAST)
    found = [
        ("night against day", (night, ~night)),
        ("night against day, without the eastern United States", (night & ~east, ~night & ~east)),
        ("night over the eastern United States against other nights", (night & east, night & ~east)),
        ("day over the eastern United States against other days", (~night & east, ~night & ~east)),
        ("night against day over the eastern United States", (night & east, ~night & east)),
    ]
    return found + [(f"{name} against the others", (place == name, place != name)) for name in sorted({*stations})]


def _answer(
    y: FloatArray,
    groups: tuple[BoolArray, BoolArray],
    overflight: np.ndarray,
    rng: np.random.Generator,
    count: int,
) -> tuple[tuple[int, int], float, float, float]:
    """Numbers, ratio, p-value, and the detectable ratio."""
    inside = groups[0] | groups[1]
    one, other, y = groups[0][inside], groups[1][inside], y[inside]
    orders = orders_of(overflight[inside], rng, count)
    weights = one / one.sum() - other / other.sum()
    observed = float(weights @ y)
    chance = y[orders] @ weights
    p = (1 + int(np.sum(np.abs(chance - chance.mean()) >= abs(observed - chance.mean()) - 1e-12))) / (len(orders) + 1)
    detectable = float(np.exp((1.960 + 0.842) * chance.std()))
    return (int(one.sum()), int(other.sum())), float(np.exp(observed)), float(p), detectable


def _stations(
    y: FloatArray, stations: Sequence[str], orders: np.ndarray
) -> tuple[tuple[int, int], float, float, float]:
    """All at once: the sum of squares between stations."""
    place = np.array(stations)
    names = sorted({*stations})
    means = np.stack([(place == name) / np.sum(place == name) for name in names])
    sizes = np.array([np.sum(place == name) for name in names])

    def between(values: FloatArray) -> FloatArray:
        return np.asarray(((means @ values.T - y.mean()) ** 2 * sizes[:, None]).sum(axis=0))

    observed, chance = between(y[None, :])[0], between(y[orders])
    p = (1 + int(np.sum(chance >= observed - 1e-12))) / (len(orders) + 1)
    level = means @ y
    return (len(names), y.size), float(np.exp(level.max() - level.min())), float(p), float("nan")


def _holm(p_values: FloatArray) -> FloatArray:
    """p-values with their number counted."""
    order = np.argsort(p_values)
    steps = p_values[order] * np.arange(p_values.size, 0, -1)
    counted = np.empty_like(p_values)
    counted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return counted
