"""Do calibrations of one magnetometer agree, and where not, when did it change or how does it drift?

For K calibrations with parameters p_k and covariances C_k the weighted mean p and Cochran's statistic

    Q = sum (p_k - p)' C_k^-1 (p_k - p)

(Cochran 1954; for one parameter with C_k its variance, for all of them with the whole covariances) is chi-square with
(K - 1) times as many degrees of freedom as there are parameters, if nothing changed and the sigmas are right. A parameter
that changed is given the history that explains it best: a step between two calibrations, a line in time, a line in
temperature. Each is one parameter more, tested by the drop of Q; a step pays for the K - 1 places that were tried, the
histories for each other, and the parameters for being many (Holm 1979). Where the rest of Q is too large for chance, sigmas
are those of the scatter about the history (Birge 1932), and so is the test, from five calibrations on. A parameter that
changed without such a history is said to vary.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2, norm, t

from fluxtwin.calib.common.conventions import offset_first_from_correction
from fluxtwin.calib.common.coverage import RANK
from fluxtwin.calib.common.criterion import FALSE_ALARM
from fluxtwin.calib.common.digits import measured, plain
from fluxtwin.calib.common.records import Calibration, parameter_unit
from fluxtwin.calib.onboard.export import FIELDS_NT, AddedError, added_error
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.record import plain_text

EXPIRED_SIGMAS = 3.0
"""A drift that has moved a parameter by so many of its sigmas has made the last calibration expire."""
_LEAST_DEGC = 1.0  # between calibrations: less tells nothing about temperature
_FEWEST_LEFT = 2  # degrees of freedom: Student's t has no variance with these, so a scatter of so few tells nothing
_LEAST_OVERLAP = 0.01  # less moves no probability


@dataclass(frozen=True)
class History:
    """What one parameter did over the calibrations."""

    name: str
    values: FloatArray
    """(K,) in the parameter's unit."""
    sigmas: FloatArray
    """(K,) 1 sigma."""
    mean: float
    mean_sigma: float
    q: float
    """Cochran's Q, K - 1 degrees of freedom."""
    probability: float
    """Of a Q so large, if nothing changed."""
    kind: str
    """`constant`, `step`, `drift`, `temperature` or, where none of these describes the change, `varies`."""
    size: float
    """Of the step, in the parameter's unit; of the drift, a day; with temperature, a degC. Otherwise 0."""
    size_sigma: float
    after: int
    """Number of calibrations before the step; 0 for none."""
    explained: float
    """Corrected probability of so large a drop of Q by chance; 1 for constant and `varies`."""

    @property
    def unit(self) -> str:
        """Of values and sigmas."""
        return parameter_unit(self.name)


@dataclass(frozen=True)
class Trend(Shown):
    """The answer to: does last month's calibration still hold?"""

    time: TimeArray
    """(K,) middles of the spans, UTC."""
    temperature_degC: FloatArray | None
    """(K,) middles of the ranges; None where one is not known."""
    histories: tuple[History, ...]
    q: float
    """Cochran's Q over all parameters."""
    degrees_of_freedom: int
    probability: float
    last_q: float
    """Of the last calibration against the mean of those before, all parameters."""
    last_probability: float
    moved: AddedError
    """What the first instead of the last calibration would err by, over `FIELDS_NT` in any direction."""
    overlap_ratio: float
    """Largest share of its time that one calibration has in common with the next: its errors are then not its own."""
    last: Calibration
    """The last calibration; it `expires` when a drift has moved a parameter by `EXPIRED_SIGMAS` of its sigma."""

    @property
    def expires(self) -> np.datetime64 | None:
        """When the last calibration does; None without a drift."""
        return self.last.expires

    @property
    def holds(self) -> bool:
        """Whether nothing is seen to have changed."""
        return self.probability >= FALSE_ALARM and all(one.kind == "constant" for one in self.histories)

    @property
    def lines(self) -> tuple[str, ...]:
        """The answer in sentences."""
        count, low, high = len(self.time), FIELDS_NT[0] / 1e3, FIELDS_NT[1] / 1e3
        q = f"Q = {plain(self.q)} with {self.degrees_of_freedom} degrees of freedom, probability {chance(self.probability)}"
        size = (
            f"up to {plain(self.moved.largest_nT, 2)} nT and {plain(self.moved.largest_deg, 2)} deg over fields of "
            f"{low:.0f} to {high:.0f} uT"
        )
        common = []
        if self.overlap_ratio > _LEAST_OVERLAP:
            common = [
                f"Neighbours share up to {100 * self.overlap_ratio:.0f} % of their time, so their errors are not "
                "independent: a change shows less than these numbers say. Give stretches that do not overlap."
            ]
        if self.holds:
            within = f"The first and the last differ by {size}, as their sigmas allow."
            return (f"Holds: {count} calibrations agree within their sigmas ({q}).", within, *common)
        changed = [one for one in self.histories if one.kind != "constant"]
        said = [f"Does not hold: the calibrations differ by more than their sigmas ({q}).", *map(self._words, changed)]
        if not changed:
            said.append(
                "No single parameter has changed significantly: many did a little, or the sigmas are too small."
            )
        agrees = self.last_probability >= FALSE_ALARM
        verdict = "agrees with" if agrees else "differs from"
        said.append(
            f"The last calibration {verdict} the mean of those before it (probability {chance(self.last_probability)}). "
            f"Using the first instead of the last would cause errors of {size}."
        )
        if self.expires is not None:
            said.append(
                f"With these drifts the last calibration is off by {EXPIRED_SIGMAS:.0f} of its sigmas on "
                f"{epoch.iso(self.expires, 's')[:10]}."
            )
        return (*said, *common)

    def _words(self, one: History) -> str:
        if one.kind == "varies":
            return (
                f"{one.name} varies by more than its sigmas (probability {chance(one.probability)}), and no "
                "step or line in time or temperature stands out of its scatter."
            )
        unit = "" if one.unit == "1" else f" {one.unit}"
        size = measured(one.size, one.size_sigma)
        if one.kind == "step":
            at = (epoch.iso(self.time[k], "s") for k in (one.after - 1, one.after))
            return f"{one.name} changed by {size}{unit} between {' and '.join(at)}."
        per = "a day" if one.kind == "drift" else "a degC of the magnetometer's temperature"
        return f"{one.name} {'drifts' if one.kind == 'drift' else 'follows temperature,'} by {size}{unit} {per}."

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        return {
            "holds": self.holds,
            "lines": list(self.lines),
            "time": [epoch.iso(one, "s") for one in self.time],
            "temperature_degC": None if self.temperature_degC is None else self.temperature_degC.tolist(),
            "q": self.q,
            "degrees_of_freedom": self.degrees_of_freedom,
            "probability": self.probability,
            "last": {"q": self.last_q, "probability": self.last_probability},
            "first_instead_of_last": {"nT": self.moved.largest_nT, "deg": self.moved.largest_deg},
            "overlap_ratio": self.overlap_ratio,
            "expires": None if self.expires is None else epoch.iso(self.expires, "s"),
            "parameters": [
                {**vars(one), "unit": one.unit, "values": one.values.tolist(), "sigmas": one.sigmas.tolist()}
                for one in self.histories
            ],
        }


def chance(probability: float) -> str:
    """A probability to two digits, but for those too small to mean more than never."""
    return f"{probability:.2g}" if probability >= 1e-9 else "below 1e-9"


def trend(calibrations: Sequence[Calibration]) -> Trend:
    """Two calibrations or more of one magnetometer, in any order.

    Raises BadInput for fewer, for one without span or sigmas, and for those that cannot be compared: of another spacecraft,
    of readings corrected before, or with attitude beside those without.
    """
    known = _comparable(calibrations)
    time = np.array([_middle(one) for one in known])
    warm = [one.temperature_degC for one in known]
    temperature = None if None in warm else np.array([np.mean(pair) for pair in warm if pair is not None])
    names = _names(known)
    at = [known[0].names.index(name) for name in names]
    values = np.array([one.values[at] for one in known])
    covariances = np.array([one.covariance[np.ix_(at, at)] for one in known])
    days = (time - time[0]).astype("timedelta64[ns]").astype(np.float64) / 8.64e13
    q = _pooled(values, covariances)[2]
    before, before_covariance, _ = _pooled(values[:-1], covariances[:-1])
    apart = values[-1] - before
    last_q = float(apart @ np.linalg.solve(covariances[-1] + before_covariance, apart))
    dof = (len(known) - 1) * len(names)
    probability = float(chi2.sf(q, dof))
    sigmas = np.sqrt(np.einsum("kii->ki", covariances))
    histories = _histories(names, values, sigmas, days, temperature, differ=probability < FALSE_ALARM)
    first, last = (offset_first_from_correction(one.correction) for one in (known[0], known[-1]))
    return Trend(
        time=time,
        temperature_degC=temperature,
        histories=histories,
        q=q,
        degrees_of_freedom=dof,
        probability=probability,
        last_q=last_q,
        last_probability=float(chi2.sf(last_q, len(names))),
        moved=added_error(last, first),
        overlap_ratio=max(itertools.starmap(_overlap_ratio, itertools.pairwise(known))),
        last=replace(known[-1], expires=_expires(histories, known[-1])),
    )


def _comparable(calibrations: Sequence[Calibration]) -> list[Calibration]:
    def refuse(found: str, wanted: str) -> None:
        raise BadInput(found, where="trend", wanted=wanted)

    def alike(what: Callable[[Calibration], object], found: str, wanted: str) -> None:
        if len({what(one) for one in calibrations}) > 1:
            refuse(found, wanted)

    if len(calibrations) < 2:
        refuse(f"{len(calibrations)} calibration", "two or more, or telemetry of several days")
    if any(one.span is None or not one.sigmas.any() for one in calibrations):
        refuse("a calibration has no span or no sigmas", "calibrations made from telemetry")
    whose = {plain_text(one.spacecraft) for one in calibrations} - {""}
    if len(whose) > 1:
        refuse(f"they are of {' and '.join(sorted(whose))}", "one spacecraft")
    alike(lambda one: one.magnetometer, "they are of several magnetometers", "one magnetometer")
    digests = [one.digest for one in calibrations]
    for one in calibrations:
        if one.span is not None and digests.count(one.digest) > 1:
            span = " to ".join(map(epoch.iso, one.span))
            refuse(f"the calibration of {span} is given twice", "each of them once")
    alike(lambda one: one.residual_to, "some are of readings that had been corrected", "calibrations of the sensor")
    found = "S was estimated in some and not in others: b does not mean the same in them"
    alike(lambda one: bool(one.sigmas[:9].any()), found, "calibrations of the same parameters")
    found = "some were made without attitude: their S is symmetric and is not that of the others"
    alike(lambda one: np.array_equal(one.S, one.S.T), found, "all of them with attitude, or all without")
    found = "some were made without a field model: their scale is not that of the others"
    alike(lambda one: one.field_model == "none", found, "all of them by the method gyro, or none")
    return sorted(calibrations, key=_middle)


def _middle(one: Calibration) -> np.datetime64:
    assert one.span is not None
    middle: np.datetime64 = one.span[0] + (one.span[1] - one.span[0]) // 2
    return middle


def _overlap_ratio(one: Calibration, later: Calibration) -> float:
    """Share of the shorter of two spans that lies in the other, as far as spans tell: a record may have gaps."""
    assert one.span is not None and later.span is not None
    (a, b), (c, d) = one.span, later.span
    shorter = min(b - a, d - c)
    return max(float((min(b, d) - max(a, c)) / shorter), 0.0) if shorter > np.timedelta64(0, "ns") else 0.0


def _names(known: Sequence[Calibration]) -> tuple[str, ...]:
    """Parameters that all of them have, without those that follow from others: one half of a symmetric S, S33 of a
    trace of zero."""
    kept: list[str] = []
    for name in known[0].names:
        if any(not one.sigma.get(name) for one in known):
            continue
        at = [known[0].names.index(other) for other in (*kept, name)]
        if all(np.linalg.eigvalsh(_correlation(one.covariance[np.ix_(at, at)]))[0] > RANK for one in known):
            kept.append(name)
    if not kept:
        raise BadInput("no parameter is in all of them", where="trend", wanted="calibrations of the same parameters")
    return tuple(kept)


def _correlation(covariance: FloatArray) -> FloatArray:
    sigma = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sigma, sigma))


def _pooled(values: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Weighted mean, its covariance, and Cochran's Q of (K, P) values with (K, P, P) covariances."""
    weights = np.linalg.inv(covariances)
    covariance = np.linalg.inv(weights.sum(axis=0))
    mean = covariance @ np.einsum("kij,kj->i", weights, values)
    off = values - mean
    return mean, covariance, float(np.einsum("ki,kij,kj->", off, weights, off))


def _histories(
    names: Sequence[str],
    values: FloatArray,
    sigmas: FloatArray,
    days: FloatArray,
    temperature: FloatArray | None,
    *,
    differ: bool,
) -> tuple[History, ...]:
    """differ: whether all parameters together changed by more than their sigmas."""
    count = len(values)
    steps = [(np.arange(count) >= k).astype(np.float64) for k in range(1, count)]
    tried: list[tuple[str, FloatArray, int, int]] = [("step", step, k + 1, len(steps)) for k, step in enumerate(steps)]
    if count > 2:  # of two, a line and a step are one and the same
        if np.ptp(days) > 0:
            tried.append(("drift", days - days.mean(), 0, 1))
        if temperature is not None and np.ptp(temperature) > _LEAST_DEGC:
            tried.append(("temperature", temperature - temperature.mean(), 0, 1))
    kinds = len({kind for kind, *_ in tried})
    found = []
    for name, p, sigma in zip(names, values.T, sigmas.T, strict=True):
        w = sigma**-2.0
        mean = float((w * p).sum() / w.sum())
        q = float((w * (p - mean) ** 2).sum())
        best, least = ("constant", 0.0, 0.0, 0), 0.0
        for kind, x, after, places in tried:
            # Weighted slope of p over x beside a constant, and its sigma.
            x = x - (w * x).sum() / w.sum()
            information = float((w * x**2).sum())
            size, error = float((w * x * p).sum()) / information, information**-0.5
            left, dof = q - (size / error) ** 2, count - 2
            steady = dof <= _FEWEST_LEFT or chi2.sf(left, dof) > FALSE_ALARM
            error *= 1.0 if steady else (left / dof) ** 0.5
            # its logarithm, as beyond 38 sigma the probability itself is 0 for all of them
            by_chance = norm.logsf(abs(size / error)) if steady else t.logsf(abs(size / error), dof)
            log_chance = float(np.log(2.0 * places * kinds) + by_chance)
            if log_chance < least:
                best, least = (kind, size, error, after), log_chance
        probability, explained = float(chi2.sf(q, count - 1)), float(np.exp(least))
        found.append(History(name, p, sigma, mean, float(w.sum() ** -0.5), q, probability, *best, explained))
    # Those that are not significant beside the others are constant.
    kept: set[str] = set()
    for place, one in enumerate(sorted(found, key=lambda one: one.explained)):
        if one.explained * (len(found) - place) >= FALSE_ALARM:
            break
        kept.add(one.name)
    nothing: dict[str, Any] = {"size": 0.0, "size_sigma": 0.0, "after": 0, "explained": 1.0}
    varies = [one.name for one in found if differ and one.probability * len(found) < FALSE_ALARM]
    return tuple(
        one if one.name in kept else replace(one, kind="varies" if one.name in varies else "constant", **nothing)
        for one in found
    )


def _expires(histories: Sequence[History], last: Calibration) -> np.datetime64 | None:
    days = [
        EXPIRED_SIGMAS * float(one.sigmas[-1]) / abs(one.size) for one in histories if one.kind == "drift" and one.size
    ]
    if not days or min(days) > 36_525:
        return None
    return np.datetime64(_middle(last) + np.timedelta64(round(min(days) * 86_400), "s"))
