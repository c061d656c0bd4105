"""The sun-nadir angle as a measurement of its own: it adds, confirms and rules out causes of a diagnosis.

Faults of an attitude sensor predict a change of the angle; whatever the magnetometer or the spacecraft's field does
predicts none. So the angle decides where readings cannot: a cause that predicts a change which is not there is ruled
out and the search is done again without it; a fault that the angle shows is named, whether the readings show it or not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from fluxtwin.gap.channels.sun_nadir import FALSE_ALARM, Channel, Hypothesis, SunNadir, open_channel
from fluxtwin.gap.records.diagnosis import Diagnosis, EffectParameter, FoundEffect
from fluxtwin.gap.report.verdict import place_of
from fluxtwin.gap.selection.named import axis_of
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.telemetry.record import Telemetry

SEEN = ("sun_sensor_head_misalignment", "horizon_scanner_bias")
"""Effects that the angle knows of."""
_ORBIT = "along_track_error"
_NAMED_P = 0.001
"""Below it a fault that the readings do not show is named; above it is a note."""
_FEWEST_PASSES = 4
_MOST = 0.98
"""Probability that a fault which the angle shows is present, at most: a judgement; other faults may look alike."""


def with_second_channel(investigated: Callable[..., Diagnosis], channel: Channel | None) -> Diagnosis:
    """A diagnosis, done again without what the angle rules out, and with what it shows.

    investigated: makes the diagnosis; takes `ruled_out`, names that it must not give. channel: None where there is none.
    """
    found = investigated()
    if channel is None:
        return found
    out = ruled_out(found, channel)
    return judged(investigated(ruled_out=out) if out else found, channel, out)


def channel_of(telemetry: Telemetry, frozen: Sequence[Active] = ()) -> Channel | None:
    """The channel with what the scenario's own effects do to it taken out; None where a record has no such channel."""
    if telemetry.sun_B is None or telemetry.nadir_B is None or telemetry.r_N_km is None:
        return None
    try:
        channel = open_channel(telemetry)
    except NoAnswer:
        return None
    for effect, theta in frozen:
        if effect.name in SEEN:
            values = {p.name: float(v) for p, v in zip(effect.parameters, theta, strict=True)}
            channel = channel.without(effect.name, _head(effect), values)
    return channel


def ruled_out(found: Diagnosis, channel: Channel) -> tuple[str, ...]:
    """Named effects that predict a change of the angle which is not there (t test over the passes that would show it)."""
    names = []
    channel = _as_found(found, channel)
    for effect in found.effects:
        values = {name: parameter.value for name, parameter in effect.parameters.items()}
        predicted = channel.predicted_rad(effect.name, _head_of(effect.settings), values)
        if predicted is None:
            continue
        share, sigma, passes = channel.share_of(predicted)
        if passes < _FEWEST_PASSES or not np.isfinite(sigma):
            continue
        absent = abs(share) / sigma < stats.t.isf(0.5 * FALSE_ALARM, passes - 1)
        if absent and 2.0 * stats.t.sf((1.0 - share) / sigma, passes - 1) < FALSE_ALARM:
            names.append(effect.name)
    return tuple(dict.fromkeys(names))


def judged(found: Diagnosis, channel: Channel, without: Sequence[str] = ()) -> Diagnosis:
    """The diagnosis with what the angle says: a fault it shows among the causes, and its words. without: what it has
    ruled out before."""
    weighed = _as_found(found, channel).weigh()
    record: dict[str, Any] = {**weighed.to_dict(), "ruled_out": list(without)}
    named = weighed.named
    notes = [*found.notes, *_notes(found, weighed, without)]
    found = replace(found, provenance={**found.provenance, "sun_nadir": record}, notes=notes)
    if named is None:
        return found
    effects = list(found.effects)
    for fault in (named, *weighed.rivals):  # what the readings name already goes before what the angle likes best
        for place, one in enumerate(effects):
            if _same(one, fault):
                effects[place] = _confirmed(one, _entry(weighed, fault))
                return replace(found, effects=effects)
    return _with_entry(found, weighed, named, _entry(weighed, named)) if named.p_value < _NAMED_P else found


def _as_found(found: Diagnosis, channel: Channel) -> Channel:
    """The channel beside an error along the orbit, where the readings may name one."""
    orbit = any(_ORBIT in (effect.name, *effect.group) for effect in found.effects)
    return channel.beside_along_track() if orbit else channel


def _notes(found: Diagnosis, weighed: SunNadir, without: Sequence[str]) -> list[str]:
    rotation = any("scale_misalignment" in effect.group for effect in found.effects)
    notes = [weighed.words] if weighed.named is not None or without or rotation else []
    why = "would explain the readings, but not without a change of the sun-nadir angle: ruled out"
    return [*notes, *(f"{name} {why}" for name in without)]


def _entry(weighed: SunNadir, named: Hypothesis) -> FoundEffect:
    """The fault as a cause. A parameter of which only sums with others are seen has no sigma."""
    parameters = {
        name: EffectParameter(value, sigma if name in named.seen else None, "deg")
        for name, (value, sigma) in named.parameters.items()
    }
    turn = np.array([value for value, _ in named.parameters.values()])
    return FoundEffect(
        name=named.name,
        group=tuple(dict.fromkeys([named.name, *(other.name for other in weighed.rivals)])),
        rivals=(),
        probability=_probability(named.p_value),
        parameters=parameters,
        settings={} if named.head is None else {"head": named.head},
        stage="attitude",
        axis="all" if named.head is None else axis_of(turn**2),
        frame="body" if named.head is not None else "orbital",
        condition="head" if named.head is not None else "latitude",
        significance=named.p_value,
        visible_nT=0.0,
    )


def _probability(p_value: float) -> float:
    """That it is there: the bound of Sellke, Bayarri & Berger (2001) at even odds, and a cap."""
    b = -np.e * p_value * np.log(p_value) if p_value > 0.0 else 0.0
    return float(min(_MOST, 1.0 / (1.0 + b)))


def _confirmed(one: FoundEffect, entry: FoundEffect) -> FoundEffect:
    """What readings and angle both show: names that predict no change of the angle leave its group."""
    gone = [name for name in one.group if name not in (one.name, *entry.group)]
    doubt = 1.0 - entry.probability
    rivals = [*one.rivals, *((name, doubt / len(gone)) for name in gone)]
    return replace(
        one,
        group=tuple(name for name in one.group if name not in gone),
        rivals=tuple((name, min(probability, doubt)) for name, probability in rivals),
        probability=max(one.probability, 1.0 - (1.0 - one.probability) * doubt),
        significance=min(one.significance, entry.significance),
    )


def _with_entry(found: Diagnosis, weighed: SunNadir, named: Hypothesis, entry: FoundEffect) -> Diagnosis:
    effects = [*found.effects, entry]
    size, sigma = named.amount_deg
    shown = (
        f"{named.words} ({size:.2f} ± {sigma:.2f} deg, of what the angle can see): the measured angle between sun and "
        f"nadir shows it, {weighed.rms_deg:.2f} deg rms, and {named.rms_left_deg:.2f} deg once it is taken out"
    )
    if found.verdict == "no_gap":
        sentence = (
            f"The gap is {shown}. The readings of the magnetometer show none ({found.gap.before_nT:.1f} nT are left)."
        )
        return replace(
            found,
            verdict="effect",
            effects=effects,
            where=place_of(entry, found.where.probabilities),
            sentence=sentence,
        )
    return replace(found, effects=effects, sentence=f"{found.sentence} Beside it, {shown}.")


def _same(one: FoundEffect, named: Hypothesis) -> bool:
    return one.name == named.name and _head_of(one.settings) == named.head


def _head(effect: object) -> int | None:
    return _number(getattr(effect, "head", None))


def _head_of(settings: Mapping[str, Any]) -> int | None:
    return _number(settings.get("head"))


def _number(head: object) -> int | None:
    return head if isinstance(head, int) and head > 0 else None
