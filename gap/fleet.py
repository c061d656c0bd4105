"""Many vehicles of one design together: which effect is common to them, and which belongs to one.

Each record is diagnosed by itself; what it says of an effect is a score U and an information I, beside what is re-estimated
there and what it alone is named to have. An effect that all have in common with parameters theta explains

    D = U' M^+ U,     U = sum of U_v, M = sum of I_v

of chi-square, weighed by the one criterion with all samples; what the vehicles have of it beside that, theirs each, is
Cochran's Q = sum of D_v - D. Sizes that differ from vehicle to vehicle have a spread of their own (DerSimonian & Laird 1986,
Controlled Clinical Trials 7, 177); what each vehicle says is drawn towards their mean (Efron & Morris 1975, JASA 70, 311).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any

import numpy as np
from scipy.special import expit, softmax
from scipy.stats import chi2

from fluxtwin.calib.common.criterion import FALSE_ALARM
from fluxtwin.calib.common.digits import percent
from fluxtwin.gap.linear.projection import SHARE_LEFT, explained_in_units
from fluxtwin.gap.posterior.stated import stated
from fluxtwin.gap.records.diagnosis import Diagnosis, Score
from fluxtwin.gap.selection.criterion import LOG_FURTHER, THRESHOLD, worth
from fluxtwin.gap.selection.score import ALIKE
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect


@dataclass(frozen=True)
class CommonEffect:
    """An effect that the vehicles share."""

    name: str
    group: tuple[str, ...]
    """Names, its own first, that would explain nearly as much in all of them."""
    probability: float
    """That it, or one of its group, is common to the vehicles."""
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    mean: FloatArray
    """(p,) over the vehicles, in the units; NaN where no vehicle sees it."""
    mean_sigma: FloatArray
    spread: FloatArray
    """(p,) standard deviation from vehicle to vehicle beyond what each is unsure by; 0: none is seen."""
    each: FloatArray
    """(V, p) what is believed of each vehicle: its own estimate, drawn towards the mean."""
    each_sigma: FloatArray
    best_single_sigma: FloatArray
    """(p,) of the vehicle that knows best by itself."""


@dataclass(frozen=True)
class Fault:
    """An effect that one vehicle has and the others have not."""

    vehicle: int
    name: str
    probability: float
    odd: bool
    """It shows only beside the others, whose size of this effect it does not share; else its own diagnosis names it."""
    lacks: bool = False
    """It does not show the effect at all that the others share."""


@dataclass(frozen=True)
class Fleet(Shown):
    """What V vehicles say together."""

    vehicles: tuple[str, ...]
    diagnoses: tuple[Diagnosis, ...]
    common: CommonEffect | None
    faults: tuple[Fault, ...]
    ranking: tuple[tuple[str, float, int], ...]
    """Effects that all could have: twice the log of the Bayes factor of having it in common, and directions."""

    @property
    def lines(self) -> tuple[str, ...]:
        """The answer in sentences."""
        count = len(self.vehicles)
        if self.common is None:
            said = [f"No effect was found to be common to all {count} vehicles."]
        else:
            one = self.common
            names, lacking = " or ".join(one.group), sum(fault.lacks for fault in self.faults)
            whose = f"{count - lacking} of the {count}" if lacking else f"the {count}"
            said = [f"Common to {whose} vehicles, so a property of the design: {names} ({percent(one.probability)})."]
            said += [
                f"{name} {value:.4g} ± {sigma:.2g} {unit}"
                + (f", from vehicle to vehicle ± {spread:.2g}" if spread > 0 else ", the same in all of them")
                + f"; the best single vehicle determines it to {single:.2g}."
                for name, unit, value, sigma, spread, single in zip(
                    one.parameters, one.units, one.mean, one.mean_sigma, one.spread, one.best_single_sigma, strict=True
                )
                if np.isfinite(value) and abs(value) > 2.0 * sigma
            ]
        for fault in self.faults:
            how = "differs in it from all others" if fault.odd else "has it alone"
            how = "does not show it" if fault.lacks else how
            said.append(f"{self.vehicles[fault.vehicle]}: {fault.name} ({percent(fault.probability)}), {how}.")
        if not self.faults:
            said.append("No vehicle stands out from the others.")
        return tuple(said)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        common = self.common and {one.name: _plain(getattr(self.common, one.name)) for one in fields(self.common)}
        return {
            "vehicles": list(self.vehicles),
            "lines": list(self.lines),
            "common": common,
            "faults": [
                {"vehicle": self.vehicles[f.vehicle], "name": f.name, "probability": f.probability}
                | {"odd": f.odd, "lacks": f.lacks}
                for f in self.faults
            ],
            "ranking": [{"name": name, "worth": value, "directions": rank} for name, value, rank in self.ranking],
            "verdicts": [one.verdict for one in self.diagnoses],
            "named": [[found.name for found in one.effects] for one in self.diagnoses],
        }


def fleet(vehicles: Sequence[str], diagnoses: Sequence[Diagnosis]) -> Fleet:
    """What the diagnoses of V vehicles of one design say together. Raises BadInput for fewer than three."""
    if len(diagnoses) < 3:
        raise BadInput(
            f"{len(diagnoses)} vehicle{'s' * (len(diagnoses) != 1)}",
            where="fleet",
            wanted="three or more, because of two nothing says which one differs",
        )
    named = [{name for found in one.effects for name in found.group} for one in diagnoses]
    tables = [_table(one, names) for one, names in zip(diagnoses, named, strict=True)]
    shared = [label for label in tables[0] if all(label in table for table in tables)]
    samples = float(sum(one.samples["used"] for one in diagnoses))
    found = [(label, *_in_common([table[label] for table in tables])) for label in shared]
    seen = [one for one in found if one[2]]
    tried = float(np.log(max(len(seen), 1)))
    values = []
    for _, drop, rank, ratio in seen:
        careful = worth(drop / ratio, rank, samples, tried)
        values.append(worth(drop, rank, samples, tried) if careful > THRESHOLD else careful)
    best: dict[str, tuple[float, str, int]] = {}
    for value, (label, _, rank, _) in sorted(zip(values, seen, strict=True), key=lambda pair: -pair[0]):
        best.setdefault(tables[0][label].effect.name, (value, label, rank))
    ranked, common, compared, whose = list(best.items()), None, shared, set[str]()
    if ranked and ranked[0][1][0] > THRESHOLD:
        top = ranked[0][1][0]
        group = [name for name, (value, _, _) in ranked if top - value < LOG_FURTHER]
        group += [name for name, _ in ranked if name not in group and _imitate(diagnoses, group[0], name)]
        alike = [{*found.group} for one in diagnoses for found in one.effects if {*found.group} & {*group}]
        said = Counter(chain.from_iterable(alike))
        group += sorted(name for name, count in said.items() if 2 * count >= len(alike) and name not in group)
        weights = dict(zip([name for name, _ in ranked], softmax([0.5 * v for _, (v, _, _) in ranked]), strict=True))
        inside = float(sum(weights.get(name, 0.0) for name in group)) * float(expit(0.5 * (top - THRESHOLD)))
        # Beside a common effect only its own size is compared: the scores of others hold what it leaves in them.
        label, whose = ranked[0][1][1], set(group)
        compared = [label]
        tables = [table | {label: _as_fitted(table[label], one)} for table, one in zip(tables, diagnoses, strict=True)]
    faults = _faults(diagnoses, named, tables, compared, whose)
    if whose:
        lacking = {fault.vehicle for fault in faults if fault.lacks}
        theirs = [_blank(table[label]) if vehicle in lacking else table[label] for vehicle, table in enumerate(tables)]
        common = _sizes(theirs, tuple(group), stated(inside))
    ranking = tuple((name, value, rank) for name, (value, _, rank) in ranked)
    return Fleet(tuple(vehicles), tuple(diagnoses), common, faults, ranking)


def _table(one: Diagnosis, named: set[str]) -> dict[str, Score]:
    """What a vehicle says of each effect by its label: beside what it alone is named to have, unless that may be this
    effect itself."""
    alone, beside = ({score.label: score for score in scores} for scores in one.scores)
    return alone | {label: score for label, score in beside.items() if score.effect.name not in named}


def _as_fitted(score: Score, one: Diagnosis) -> Score:
    """A score with the estimate and covariance of the vehicle's own diagnosis, if it has fitted the effect: a step from
    nothing is wrong where the effect is many times the noise. Between effects, scores at nothing are compared."""
    for found in one.effects:
        if found.effect == score.effect and found.covariance is not None:
            seen = np.isfinite(np.diag(found.covariance))
            information = np.zeros_like(score.information)
            information[np.ix_(seen, seen)] = np.linalg.inv(found.covariance[np.ix_(seen, seen)])
            return replace(score, score=information[:, seen] @ found.theta[seen], information=information)
    return score


def _blank(score: Score) -> Score:
    """Of a vehicle that says nothing of an effect."""
    return replace(score, score=np.zeros_like(score.score), information=np.zeros_like(score.information))


def _plain(value: Any) -> Any:
    """Lists in place of arrays for JSON, None for what is not known."""
    if not isinstance(value, np.ndarray):
        return value
    return [_plain(one) if value.ndim > 1 else float(one) if np.isfinite(one) else None for one in value]


def _in_common(scores: Sequence[Score]) -> tuple[float, int, float]:
    """Drop of chi-square by one size for all vehicles, what errors in an image cost given back; its rank; and the ratio of
    Birge (1932, Physical Review 40, 207): by how much more the sizes vary than their noise, as far as that is more."""
    score = np.sum([one.score for one in scores], axis=0)
    whole = np.sum([one.information for one in scores], axis=0)
    errors = 0.0
    if score.size == 1 and whole.any():
        errors = min(sum(one.of_errors for one in scores) / float(whole.max()), 0.5)
    drop, rank = explained_in_units(whole * (1.0 - errors), score)
    alone, ranks = np.sum([explained_in_units(one.information, one.score) for one in scores], axis=0)
    return drop, rank, _birge(alone - explained_in_units(whole, score)[0], ranks - rank)


def _birge(apart: float, free: float) -> float:
    """Of chi-square by which sizes differ, and its degrees of freedom: Cochran's Q; 1 unless it says that they do."""
    return apart / free if free > 0 and chi2.sf(apart, free) < FALSE_ALARM else 1.0


def _imitate(diagnoses: Sequence[Diagnosis], one: str, other: str) -> bool:
    """Whether the designs of all vehicles hardly separate two effects."""
    pairs = ((one, other), (other, one))
    return all(each.isolability.get(a, {}).get(b, 0.0) > ALIKE for each in diagnoses for a, b in pairs)


def _estimates(scores: Sequence[Score]) -> tuple[FloatArray, FloatArray]:
    """(V, p) estimate and sigma of each vehicle by itself; NaN where it does not see a parameter."""
    values, sigmas = [], []
    for one in scores:
        scale = np.sqrt(np.maximum(np.diag(one.information), 0.0))
        seen = scale > 0
        safe = np.where(seen, scale, 1.0)
        inverse = np.linalg.pinv(one.information / np.outer(safe, safe), rcond=SHARE_LEFT, hermitian=True)
        inverse = inverse / np.outer(safe, safe)
        values.append(np.where(seen, inverse @ one.score, np.nan))
        sigmas.append(np.where(seen, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.nan))
    return np.array(values), np.array(sigmas)


def _sizes(scores: Sequence[Score], group: tuple[str, ...], probability: float) -> CommonEffect:
    """Mean, spread and each vehicle's share, parameter by parameter."""
    values, sigmas = _estimates(scores)
    effect = scores[0].effect
    count = len(effect.parameters)
    mean, mean_sigma, spread, single = (np.full(count, np.nan) for _ in range(4))
    each, each_sigma = np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    for p in range(count):
        seen = np.isfinite(values[:, p]) & (sigmas[:, p] > 0)
        if seen.sum() < 2:
            continue
        v, s2 = values[seen, p], sigmas[seen, p] ** 2
        between = _between(v, s2)
        weight = 1.0 / (s2 + between)
        mean[p], mean_sigma[p] = float(weight @ v / weight.sum()), float(weight.sum() ** -0.5)
        kept = between / (between + s2)
        each[seen, p] = mean[p] + kept * (v - mean[p])
        each_sigma[seen, p] = np.sqrt(kept * s2 + (1.0 - kept) ** 2 * mean_sigma[p] ** 2)
        spread[p], single[p] = between**0.5, float(np.sqrt(s2.min()))
    names, units = (tuple(getattr(one, what) for one in effect.parameters) for what in ("name", "unit"))
    sizes = (mean, mean_sigma, spread, each, each_sigma, single)
    return CommonEffect(effect.name, group, probability, names, units, *sizes)


def _between(values: FloatArray, variances: FloatArray) -> float:
    """Variance from vehicle to vehicle; 0 unless Cochran's Q says that there is one."""
    w = 1.0 / variances
    mean = float(w @ values / w.sum())
    free = values.size - 1
    more = _birge(float(w @ (values - mean) ** 2), free) - 1.0
    return free * more / float(w.sum() - (w**2).sum() / w.sum())


def _faults(
    diagnoses: Sequence[Diagnosis],
    named: Sequence[set[str]],
    tables: Sequence[Mapping[str, Score]],
    compared: Sequence[str],
    known: set[str],
) -> tuple[Fault, ...]:
    """What single vehicles are said to have and most others have not; and sizes that differ from those of all others: half
    of the false alarms of a fleet each."""
    count = len(diagnoses)
    level = 0.5 * FALSE_ALARM / count
    named_by = Counter(chain.from_iterable(named))
    faults = []
    for vehicle, one in enumerate(diagnoses):
        for found in one.effects:
            others = named_by[found.name] - (found.name in named[vehicle])
            alone = not known & set(found.group) and 2 * others < count - 1
            if alone and found.significance <= level:
                faults.append(Fault(vehicle, found.name, found.probability, odd=False))
    limit = level / max(len(compared), 1)
    odd: dict[int, tuple[float, str]] = {}
    for label in compared:
        scores = [table[label] for table in tables]
        effect: Effect = scores[0].effect
        for vehicle, (apart, rank) in enumerate(_apart(scores)):
            p = float(chi2.sf(apart, rank)) if rank else 1.0
            if p < limit and p < odd.get(vehicle, (1.0, ""))[0]:
                odd[vehicle] = (p, effect.name)
    spoken = {fault.vehicle for fault in faults}
    faults += [
        Fault(
            vehicle,
            name,
            stated(1.0 - p / limit * FALSE_ALARM),
            odd=True,
            lacks=bool(known) and not known & named[vehicle],
        )
        for vehicle, (p, name) in odd.items()
        if vehicle not in spoken
    ]
    return tuple(sorted(faults, key=lambda fault: (fault.vehicle, -fault.probability)))


def _apart(scores: Sequence[Score]) -> Iterator[tuple[float, int]]:
    """Chi-square by which each vehicle's size differs from that of the others together, over the ratio by which those
    differ among themselves, and its rank."""
    score, whole = (np.sum([getattr(one, of) for one in scores], axis=0) for of in ("score", "information"))
    together, _ = explained_in_units(whole, score)
    each = [explained_in_units(one.information, one.score) for one in scores]
    every, ranks = np.sum(each, axis=0)
    for one, (alone, rank) in zip(scores, each, strict=True):
        theirs, known = explained_in_units(whole - one.information, score - one.score)
        ratio = _birge(every - alone - theirs, ranks - rank - known)
        yield max(alone + theirs - together, 0.0) / ratio, rank
