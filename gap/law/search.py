"""Which terms of a grammar a residual is made of, by the one criterion and with all that was tried in it.

A term is a recorded column or the geometry, alone, in powers, late, or in products: `Grammar` says which there are on a
design, `Regression` what they are worth.

Forward, one term at a time, each from the best few of the pool with their delays, lags, frames and powers moved; then the
terms before it once more, given it. What a term leaves for its own shape is no further term (`criterion.SHAPE`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import get_args

import numpy as np

from fluxtwin.gap.detectors.residual_structure import PARTS
from fluxtwin.gap.hypotheses.blocks import LEAST_SHARE, Block, BlockFit, Carrier, Condition, Dictionary
from fluxtwin.gap.hypotheses.candidates import PerturbedDesign, alike
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.choice import Whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import LOG_FURTHER, SHAPE, THRESHOLD, worth
from fluxtwin.gap.selection.forward import RATIOS
from fluxtwin.sim.base.late import varies
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.law import ANGLES, FIELD, GEOMETRY, Axes, Law, timed
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.spacecraft_field import TYPICAL_NT, Driver
from fluxtwin.sim.telemetry.quantities import DIPOLE, WHEELS

AXES: tuple[Axes, ...] = get_args(Axes)
_PARTS = max(PARTS)
"""Of a record, at whose ends something that follows a column may go on or off: the times are then searched between them."""
_QUARTER = {"cos": "sin", "sin": "cos", "cos2": "sin2", "sin2": "cos2"}


Terms = tuple[Law, ...]
"""A term, and the terms of lower order that go with it."""


class Grammar:
    """The terms that are tried on a problem's design, along the smoothed track of the attitude."""

    def __init__(self, problem: Problem) -> None:
        self.setting = problem.design.setting
        self.field_B_nT = problem.design.signal([*problem.frozen, *problem.modelled_active]).field_B_nT
        self._perturbed = PerturbedDesign(problem)
        self._known: dict[str, bool] = {}
        self._values: dict[Law, FloatArray | None] = {}
        driver = Driver(column="any").alternatives(self.setting)
        self.late = [(one.delay_s, one.lag_s) for one in driver if one.delay_s or one.lag_s]
        self.recorded = [name for name in _names(self.setting) if self.values(Law(of=(name,))) is not None]
        self.switches = [
            name for name in self.recorded if np.unique(np.asarray(self.values(Law(of=(name,))))).size <= 2
        ]

    def values(self, law: Law) -> FloatArray | None:
        """(N,) of a term; None where it is missing, does not change, or follows the attitude's error."""
        if law not in self._values:
            found = law.values(self.setting, self.field_B_nT)
            changes = found is not None and (varies(found) or (law.axes != "body" and found.any()))
            self._values[law] = found if changes and np.mean(found != 0.0) > LEAST_SHARE else None
        return self._values[law]

    def usual(self, law: Law) -> Law:
        """With a usual size of its coefficient on this design."""
        values = self.values(law)
        swing = 0.0 if values is None else max(float(np.ptp(values)), float(np.abs(values).max()))
        return replace(law, typical_nT_per_unit=TYPICAL_NT / swing) if swing > 0.0 else law

    def with_lower(self, law: Law) -> tuple[Law, ...]:
        """A term and those of lower order that go with it, as the zero of a recorded column is its maker's choice.

        A product with such a column comes with the other factor alone, a power with the lower powers (the principle of
        marginality: Nelder 1977, J. R. Statist. Soc. A 140, 48).
        """
        found = [law]
        for number, factor in enumerate(law.of):
            wave, _, phase = factor.rpartition(" ")
            if wave in _QUARTER:  # where a phase begins is a choice as well
                found.append(replace(law, of=(*law.of[:number], f"{_QUARTER[wave]} {phase}", *law.of[number + 1 :])))
            if factor not in self.recorded or factor in self.switches:
                name, _, power = factor.rpartition("^")
                lower = [f"{name}^2", name] if power == "3" else [name] if name else []
                found += [replace(law, of=(*law.of[:number], one, *law.of[number + 1 :])) for one in lower]
                continue
            rest = (*law.of[:number], *law.of[number + 1 :])
            plain = law if number else replace(law, delay_s=0.0, lag_s=0.0)
            if rest or law.axes != "body":
                found.append(replace(plain, of=rest or ("one",)))
        return tuple(one for one in dict.fromkeys(found) if self.values(one) is not None)

    def singles(self) -> list[Law]:
        """One quantity each, in every frame; a recorded one also late, in powers, and as a switch."""
        found: list[Law] = []
        for factor in (*self.recorded, *self.turning(), *self.geometry()):
            found += [Law(of=(factor,), axes=axes) for axes in AXES]
        for name in self.recorded:
            found += [Law(of=(name,), delay_s=d, lag_s=s) for d, s in self.late]
            found += [Law(of=(f"{name}{end}",)) for end in self._shapes(name)]
            found += [Law(of=(name, *times)) for times in self._windows()]
        return found

    def products(self) -> list[Law]:
        """Two quantities each, in body axes."""
        gates = [*(f"{name}{end}" for name in self.recorded for end in self._shapes(name)), *self.recorded]
        plain = [*self.recorded, *self.turning(), *(f"not {name}" for name in self.switches)]
        pairs = [pair for pair in combinations(plain, 2) if pair[1] != f"not {pair[0]}"]
        pairs += [(name, factor) for name in plain for factor in self.geometry(gates=True)]
        pairs += [(one, other) for one in gates if one not in self.recorded for other in ("sunlit", "not sunlit")]
        pairs += [pair for pair in combinations(self.geometry(), 2) if _of(pair[0]) != _of(pair[1])]
        return [Law(of=pair) for pair in pairs]

    def variants(self, law: Law) -> list[Law]:
        """The same term with another delay or lag, in other frames, in other powers, without one of its factors."""
        found = [replace(law, axes=axes) for axes in AXES]
        if law.of[0].removeprefix("not ") in self.recorded:
            found += [replace(law, delay_s=d, lag_s=s) for d, s in ((0.0, 0.0), *self.late)]
            found += [replace(law, of=(f"{law.of[0]}{end}", *law.of[1:])) for end in self._shapes(law.of[0])]
        if len(law.of) == 2 and not timed(law.of[1]):
            found += [replace(law, of=(law.of[0],)), Law(of=(law.of[1],), axes=law.axes)]
            if law.of[1].removeprefix("not ") in self.recorded:
                swapped = replace(law, of=(law.of[1], law.of[0]))
                found += [replace(swapped, delay_s=d, lag_s=s) for d, s in self.late]
                found += [replace(law, of=(law.of[0], f"{law.of[1]}{end}")) for end in self._shapes(law.of[1])]
        return [one for one in found if one != law]

    def _timed(self, sense: str, row: int) -> str:
        return f"{sense} {epoch.iso(self.setting.time[row], 'ms')}".replace(".000Z", "Z")

    def _windows(self) -> Iterator[tuple[str, ...]]:
        """Every run of parts of the record but the whole, by its times."""
        ends = [number * self.setting.time.size // _PARTS for number in range(_PARTS + 1)]
        for first, last in combinations(range(_PARTS + 1), 2):
            since = (self._timed("since", ends[first]),) if first else ()
            until = (self._timed("until", ends[last]),) if last < _PARTS else ()
            if since or until:
                yield (*since, *until)

    def halves(self) -> list[int]:
        """Rows by which a time is moved: from half a part of the record down to one."""
        first = max(self.setting.time.size // (2 * _PARTS), 1)
        return [first >> number for number in range(first.bit_length())]

    def retimed(self, law: Law, rows: int) -> list[Law]:
        """The same term with one of its times so many rows earlier or later."""
        found: list[Law] = []
        for number, factor in enumerate(law.of):
            if switched := timed(factor):
                row = int(np.searchsorted(self.setting.time, switched[1]))
                moved = [one for one in (row - rows, row + rows) if 0 < one < self.setting.time.size]
                of = [(*law.of[:number], self._timed(switched[0], one), *law.of[number + 1 :]) for one in moved]
                found += [replace(law, of=one) for one in of]
        return found

    def turning(self) -> list[str]:
        """Waves of recorded angles."""
        angles = [name for name in self.recorded if name.endswith("_deg")]
        return [f"{wave} {name}" for name in angles for wave in _QUARTER]

    def geometry(self, gates: bool = False) -> list[str]:
        """Factors that need no recorded column and do not follow the attitude's error; gates: with shadow among them."""
        plain = [name for name in GEOMETRY if name not in ANGLES]
        waves = [f"{wave} {angle}" for angle in ANGLES for wave in _QUARTER]
        found = [*plain, *(["not sunlit"] if gates else []), *FIELD, *waves]
        return [factor for factor in found if self._steady(factor)]

    def _steady(self, factor: str) -> bool:
        if factor not in self._known:
            values = self.values(Law(of=(factor,)))
            again = self._perturbed.setting
            other = values if again is None else Law(of=(factor,)).values(again, self.field_B_nT)
            self._known[factor] = values is not None and other is not None and alike(values[:, None], other[:, None])
        return self._known[factor]

    def _shapes(self, name: str) -> Sequence[str]:
        """What may be done to a recorded column: powers, and a switch at some of its levels."""
        if name.startswith("not ") or name not in self.recorded or name in self.switches:
            return ()
        values = np.asarray(self.values(Law(of=(name,))))
        levels = np.unique(np.quantile(values, np.arange(1, 10) / 10.0))
        return ("^2", "^3", *(f">{level:.6g}" for level in levels if LEAST_SHARE < np.mean(values > level) < 1.0))


def _of(factor: str) -> str:
    return factor.rpartition(" ")[2]


def _names(setting: Setting) -> Iterator[str]:
    """Quantities that are recorded."""
    scalars = ("heater_on", "array_current_A", "battery_current_A", "temperature_degC")
    yield from (name for name in setting.columns if name in scalars or name.startswith(("driver_", "flag_")))
    if setting.column(DIPOLE.name) is not None:
        yield from (f"dipole_{axis}" for axis in "xyz")
    if setting.column(WHEELS.name) is not None:
        yield from (f"wheel_{number}" for number in range(1, 5))


@dataclass(frozen=True, eq=False)
class Trial:
    """A term, with those of lower order or alone, beside what is fitted."""

    terms: Terms
    fit: BlockFit
    drop: float
    """Of chi-square."""
    rank: int

    @property
    def law(self) -> Law:
        """The term itself."""
        return self.terms[0]


class Regression:
    """Terms against one residual."""

    def __init__(self, problem: Problem, grammar: Grammar) -> None:
        self.problem, self.grammar, self.carrier = problem, grammar, Carrier(problem)
        self.tried: dict[Terms, int] = {}
        """Terms that were tried, and how much there is to each."""
        self._by_settings = [0] * 24
        self._latest: tuple[ProjectedResidual | None, dict[Terms, Trial]] = (None, {})
        laws = dict.fromkeys((*grammar.singles(), *grammar.products()))
        self.terms = [grammar.with_lower(law) for law in laws if grammar.values(law) is not None]
        self.pool = Dictionary([self.block(terms) for terms in self.terms], problem.rows, most_bytes=400e6)

    def plain(self) -> list[Law]:
        """One quantity each, as it stands, in body axes."""
        return [terms[0] for terms in self.terms if _settings(terms) == 1]

    @property
    def log_tried(self) -> float:
        """Of the number of terms that were truly tried."""
        return float(np.log(max(len(self.tried), 1)))

    def block(self, terms: Terms) -> Block:
        """The columns of a term and those of lower order along the axes of their frame.

        Of unit rms, and the term without what is like those of lower order: the same span, but a housekeeping column whose
        mean is far from zero would otherwise hide in them.
        """

        def made() -> FloatArray:
            values = np.stack([np.asarray(self.grammar.values(law)) for law in reversed(terms)], axis=1)
            apart = np.linalg.qr(values / np.sqrt(np.mean(values**2, axis=0)))[0] * np.sqrt(len(values))
            return self.carrier.additive(Condition(None, "law", apart[:, ::-1]), terms[0].axes)

        return Block({"spacecraft": 1.0}, None, None, "law", "xyz" * len(terms), made)

    def columns(self, terms: Sequence[Law]) -> FloatArray:
        """(N, 3, 3 terms) of fields along the axes of each, nT per unit."""
        made = [np.zeros((self.problem.rows, 3, 0))]
        for law in terms:
            values = np.asarray(self.grammar.values(law), dtype=np.float64)
            made.append(self.carrier.additive(Condition(None, "law", values[:, None]), law.axes))
        return np.concatenate(made, axis=2)

    def trial(self, terms: Terms, left: ProjectedResidual) -> Trial | None:
        """Terms; None where one is missing, or all are dead."""
        return next(iter(self._trials([terms], left)), None)

    def _trials(self, every: Sequence[Terms], left: ProjectedResidual) -> list[Trial]:
        """All of these terms but those of which one is missing, or all are dead."""
        if self._latest[0] is not left:
            self._latest = (left, {})
        known = self._latest[1]  # one beam comes to the same terms from several starts
        found = [terms for terms in every if all(self.grammar.values(law) is not None for law in terms)]
        new = [terms for terms in found if terms not in known]
        self._count(new)
        fits = Dictionary([self.block(terms) for terms in new], self.problem.rows).fits(left)
        known.update({terms: Trial(terms, one, *one.explained()) for terms, one in zip(new, fits, strict=True)})
        return [known[terms] for terms in found if known[terms].rank]

    def best(self, left: ProjectedResidual, beside: Sequence[Law] = ()) -> list[Trial]:
        """The best few of the pool with their settings moved, best first: the right pair undelayed is seldom the best, but
        among the first."""
        self._count(self.terms)
        pairs = zip(self.terms, self.pool.fits(left), strict=True)
        found = [Trial(terms, one, *one.explained()) for terms, one in pairs if terms[0] not in beside]
        few = sorted((one for one in found if one.rank), key=lambda one: -self.order(one, left))[:32]
        kept: list[Trial] = []
        for one in few:  # several settings of the same factors are one place in the beam
            if len(kept) < 8 and all(set(one.law.quantities()) != set(k.law.quantities()) for k in kept):
                kept.append(one)
        every = [*(self.moved(one, left) for one in kept), *few]
        wider = 1.0 + SHAPE * max((one.drop for one in every), default=0.0)
        return sorted(every, key=lambda one: -self.order(one, left, wider))

    def moved(self, start: Trial, left: ProjectedResidual) -> Trial:
        """A term with its settings where the data want them: those of the grammar twice in turn, then between them.

        Times at which something goes on or off are searched by halves, down to a row.
        """
        best = self._better(start, [start.law], left)
        for _ in range(2):
            again = self._better(best, self.grammar.variants(best.law), left)
            if again is best:
                break
            best = again
        for ratio in RATIOS:
            for step in (ratio, 1.0 / ratio):
                law = best.law
                moved = [replace(law, delay_s=law.delay_s * step), replace(law, lag_s=law.lag_s * step)]
                best = self._better(best, [one for one in moved if one != law], left)
        for rows in self.grammar.halves():
            best = self._better(best, self.grammar.retimed(best.law, rows), left)
        return best

    def _better(self, best: Trial, laws: Sequence[Law], left: ProjectedResidual) -> Trial:
        """The best of a trial and these terms, each alone and with those of lower order."""
        every = dict.fromkeys(terms for law in laws for terms in ((law,), self.grammar.with_lower(law)) if terms)
        return max([best, *self._trials(list(every), left)], key=lambda one: self.order(one, left))

    def worth(self, one: Trial, left: ProjectedResidual, wider: float = 1.0) -> float:
        """By the criterion, where noise and shape error have so many times the variance of the noise."""
        return worth(one.drop / wider, one.rank, left.degrees / 3.0, self.log_tried)

    def order(self, one: Trial, left: ProjectedResidual, wider: float = 1.0) -> float:
        """The same for a choice between terms: a plain one was one of the plain ones that were tried, which are fewer."""
        as_plain = sum(self._by_settings[: _settings(one.terms) + 1])
        return worth(one.drop / wider, one.rank, left.degrees / 3.0, float(np.log(max(as_plain, 1))))

    def _count(self, tried: Sequence[Terms]) -> None:
        for terms in tried:
            if terms not in self.tried:
                self.tried[terms] = _settings(terms)
                self._by_settings[self.tried[terms]] += 1

    def run(self, whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray) -> tuple[list[Law], list[Law]]:
        """Terms, and terms that do as well in the place of the first.

        residual_nT (N, 3), fitted_nT (N, 3, q): as for `projected`.
        """
        chosen: list[Terms] = []
        alike: list[Law] = []
        bare = projected(whitener, residual_nT, fitted_nT)

        def beside(others: Sequence[Terms]) -> ProjectedResidual:
            if not others:
                return bare
            return projected(whitener, residual_nT, np.concatenate([fitted_nT, self.columns(_members(others))], axis=2))

        for _ in range(3):  # not counting those of lower order that go with one
            left = beside(chosen)
            wider = 1.0 + SHAPE * max(bare.energy - left.energy, 0.0)
            ranked = self.best(left, _members(chosen))
            value = self.worth(ranked[0], left, wider) - (LOG_FURTHER if chosen else 0.0) if ranked else -np.inf
            if value <= THRESHOLD:
                break
            if not chosen:
                alike = self._alike(ranked, left)
            chosen.append(ranked[0].terms)
            for number in range(len(chosen) - 1):  # the first was chosen with the others in the residual
                others = [*chosen[:number], *chosen[number + 1 :]]
                again = self.best(beside(others), _members(others))
                chosen[number] = again[0].terms if again else chosen[number]
        return self._needed(_members(chosen), bare, beside), alike

    def _needed(
        self, laws: list[Law], bare: ProjectedResidual, beside: Callable[[Sequence[Terms]], ProjectedResidual]
    ) -> list[Law]:
        """Terms without those, of lower order or overtaken by later ones, that are not worth their own parameters."""
        whole = beside([tuple(laws)])
        wider = 1.0 + SHAPE * max(bare.energy - whole.energy, 0.0)
        for law in reversed(laws):
            others = [one for one in laws if one != law]
            one = self.trial((law,), beside([tuple(others)])) if others else None
            if one is not None and worth(one.drop / wider, one.rank, whole.degrees / 3.0, 0.0) <= THRESHOLD:
                laws = others
        return laws

    def _alike(self, ranked: Sequence[Trial], left: ProjectedResidual) -> list[Law]:
        """Terms of other quantities that noise and shape error do not tell from the first."""
        first = ranked[0]
        wider = 1.0 + SHAPE * first.drop
        best = self.order(first, left, wider)
        found: list[Law] = []
        for one in ranked[1:]:
            new = all(set(one.law.quantities()) != set(k.quantities()) for k in (first.law, *found))
            if new and best - self.order(one, left, wider) < LOG_FURTHER:
                found.append(one.law)
        return found


def _members(chosen: Sequence[Terms]) -> list[Law]:
    return list(dict.fromkeys(law for terms in chosen for law in terms))


def _settings(terms: Terms) -> int:
    """How much there is to terms: factors, what is done to them, delay, lag, a frame not the body's, lower orders."""
    law = terms[0]
    done = sum(factor not in law.quantities() for factor in law.of)
    return len(law.of) + done + bool(law.delay_s) + bool(law.lag_s) + (law.axes != "body") + len(terms) - 1
