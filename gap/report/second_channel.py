"""The sun-nadir angle in the answer: it adds, confirms and rules out causes.

Faults of an attitude sensor predict a change of the angle; whatever the magnetometer or the spacecraft's field does
predicts none. So the angle decides where readings cannot: a cause that predicts a change which is not there is ruled
out and the search is done again without it; a fault that the angle shows is named, whether the readings show it or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fluxtwin.gap.channels.sun_nadir import Channel, Hypothesis, SunNadir, open_channel
from fluxtwin.gap.records.diagnosis import EffectParameter, FoundEffect
from fluxtwin.gap.selection.named import axis_of
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.telemetry.record import Telemetry

_ORBIT = "along_track_error"
NOT_THERE = "the angle between sun and nadir does not show it"


@dataclass(frozen=True)
class Angle:
    """What the angle says beside the named effects."""

    weighed: SunNadir
    ruled_out: tuple[str, ...]
    """Names that readings would accept."""
    of_rotation: bool
    """Whether a rotation in S is named, or might be."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for the provenance."""
        return {**self.weighed.to_dict(), "ruled_out": list(self.ruled_out)}

    @property
    def notes(self) -> list[str]:
        """Sentences."""
        speaks = self.weighed.named is not None or bool(self.ruled_out) or self.of_rotation
        why = "would explain the readings, but the angle between sun and nadir does not show it: ruled out"
        return [*([self.weighed.words] if speaks else []), *(f"{name} {why}" for name in self.ruled_out)]

    def beside(self, effects: Sequence[FoundEffect]) -> tuple[list[FoundEffect], FoundEffect | None]:
        """The effects with what the angle shows: one of them confirmed; or one more, apart."""
        named = self.weighed.named
        if named is None:
            return list(effects), None
        for fault in (named, *self.weighed.rivals):  # what the readings name goes before what the angle likes best
            for place, one in enumerate(effects):
                if one.name == fault.name and (one.settings.get("head") or None) == fault.head:
                    confirmed = _confirmed(one, _entry(self.weighed, fault))
                    return [*effects[:place], confirmed, *effects[place + 1 :]], None
        return list(effects), _entry(self.weighed, named)

    def said(self, others: str | None, left_nT: float) -> str:
        """What it names, in words, after those on other causes; left_nT: what the readings have where there are none."""
        named = self.weighed.named
        assert named is not None
        size, sigma = named.amount_deg
        shown = (
            f"{named.words} ({size:.2f} ± {sigma:.2f} deg in the directions that the angle can see): it lowers the error of "
            f"the angle between sun and nadir from {self.weighed.rms_deg:.2f} to {named.rms_left_deg:.2f} deg rms"
        )
        if others is None:
            return f"The gap is explained by {shown}. The magnetometer readings show no gap (residual {left_nT:.1f} nT rms)."
        return f"{others} In addition, there is {shown}."


def channel_of(telemetry: Telemetry, frozen: Sequence[Active] = ()) -> Channel | None:
    """The channel with what the scenario's own effects do to it taken out; None where a record has no such channel."""
    if telemetry.sun_B is None or telemetry.nadir_B is None or telemetry.r_N_km is None:
        return None
    try:
        channel = open_channel(telemetry)
    except NoAnswer:
        return None
    for effect, theta in frozen:
        values = {one.name: float(value) for one, value in zip(effect.parameters, theta, strict=True)}
        channel = channel.without(effect.name, getattr(effect, "head", None) or None, values)
    return channel


def ruled_out(named: Sequence[FoundEffect], channel: Channel) -> dict[str, str]:
    """{name: why} of named effects that predict a change of the angle which is not there."""
    channel, gone = _beside_orbit(named, channel), {}
    for one in named:
        values = {name: parameter.value for name, parameter in one.parameters.items()}
        change = channel.predicted_rad(one.name, one.settings.get("head") or None, values)
        if change is not None and channel.contradicts(change):
            gone[one.name] = NOT_THERE
    return gone


def weighed(named: Sequence[FoundEffect], channel: Channel, out: Sequence[str], *, unexplained: bool) -> Angle:
    """What the angle says beside the named effects, and beside those that it has ruled out. unexplained: whether readings
    have a gap that nothing named explains, which may be a wrong orbit."""
    rotation = any("scale_misalignment" in one.group for one in named)
    beside = channel.beside_orbit() if unexplained else _beside_orbit(named, channel)
    return Angle(beside.weigh(), tuple(out), rotation)


def _beside_orbit(named: Sequence[FoundEffect], channel: Channel) -> Channel:
    """The channel beside an error of the orbit, where the readings may name one."""
    return channel.beside_orbit() if any(_ORBIT in (one.name, *one.group) for one in named) else channel


def _entry(weighed: SunNadir, named: Hypothesis) -> FoundEffect:
    """The fault as a cause. A parameter of which only sums with others are seen has no sigma."""
    head = named.head is not None
    parameters = {
        name: EffectParameter(value, sigma if name in named.seen else None, "deg")
        for name, (value, sigma) in named.parameters.items()
    }
    return FoundEffect(
        name=named.name,
        group=tuple(dict.fromkeys([named.name, *(other.name for other in weighed.rivals)])),
        rivals=(),
        probability=named.probability,
        parameters=parameters,
        settings={"head": named.head} if head else {},
        stage="attitude",
        axis=axis_of(np.array([value for value, _ in named.parameters.values()]) ** 2) if head else "all",
        frame="body" if head else "orbital",
        condition="head" if head else "latitude",
        significance=named.p_value,
        visible_nT=0.0,
    )


def _confirmed(one: FoundEffect, entry: FoundEffect) -> FoundEffect:
    """What readings and angle both show: names that predict no change of the angle leave its group."""
    gone = [name for name in one.group if name not in (one.name, *entry.group)]
    doubt = 1.0 - entry.probability
    rivals = [*one.rivals, *((name, doubt / len(gone)) for name in gone)]
    return replace(
        one,
        group=tuple(name for name in one.group if name not in gone),
        rivals=tuple((name, min(probability, doubt)) for name, probability in rivals),
        probability=1.0 - (1.0 - one.probability) * doubt,
        significance=min(one.significance, entry.significance),
    )
