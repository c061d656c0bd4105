"""What a diagnosis says, in words; and what would settle a question that these data leave open.

More of the same lowers the smallest size that shows as the square root of the time, so hours scale with the square of
size detectable over size wanted. A manoeuvre changes the geometry instead: each effect says which (`settled_by`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fluxtwin.calib.common.digits import percent, plain
from fluxtwin.calib.common.observability import listed
from fluxtwin.gap.detectors.residual_structure import Structure
from fluxtwin.gap.noise.choice import NoiseModel, NoisePrior
from fluxtwin.gap.records.diagnosis import Detectable, FoundEffect, MomentumGap, Place, Shrinkage
from fluxtwin.sim.base.errors import amount
from fluxtwin.sim.base.types import BoolArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.effects.switched_field import SwitchedField

APART_FROM_THEM = (
    "All other readings are as expected from noise and attitude error: apart from these rows there is no gap."
)
DENIED_SENSOR = "the difference between the two magnetometers does not show it"
DENIED_SHARED = "the two magnetometers differ, and a cause common to both cannot explain that"
SECOND_UNUSED = (
    "the second magnetometer is not used: too few rows have both readings, or it does not follow the field as the first "
    "does (dead, or in another unit), or it is a copy of the first"
)
FIRST = "First correct the file as fluxtwin check says"
"""Begins the answer of a diagnosis of a file that is wrong."""
_PLACES = {
    "x": "the x axis",
    "y": "the y axis",
    "z": "the z axis",
    "all": "all axes",
    "body": "body axes",
    "orbital": "orbital axes",
    "inertial": "inertial axes",
    "earth": "Earth-fixed axes",
    "sunlit": "sunlight",
    "torquer": "the torquers",
    "current": "the current",
    "orbit_phase": "the phase of the orbit",
    "field_strength": "the strength of the field",
    "rate": "the body rate",
    "after_time": "whether an instant has passed",
    "head": "the head of the sun sensor",
    "region": "the region",
}
"""Names of places that are no words of a sentence."""


def no_gap(gap: Shrinkage, attitude_would_do_rad: float | None) -> str:
    """Where nothing is found."""
    if attitude_would_do_rad is None:
        return (
            f"No gap: the residual of the fit is {gap.left_nT:.1f} nT rms per component, and {gap.floor_nT:.1f} nT "
            "is expected from noise and attitude error."
        )
    return (
        "No gap that these data can distinguish from an undeclared error of the reference attitude of "
        f"{np.degrees(attitude_would_do_rad):.2g} deg: the residual has structure across the field, where such an error "
        "acts, and none along it."
    )


def differ(between: Structure, rms_nT: float, noise_nT: float, other: int) -> str:
    """Where the one magnetometer's gap, if it has one, does not say why the other reads something else."""
    noise = (
        f"where their noise explains {noise_nT:.1f} nT"
        if rms_nT > noise_nT
        else "with structure that noise does not have"
    )
    return (
        f"The two magnetometers differ by {rms_nT:.1f} nT rms per component even after each is calibrated, {noise}:"
        f" {between.words}. To diagnose the other one, add --magnetometer {other}."
    )


def unexplained(what: str, where: Place, resembles: Sequence[str]) -> str:
    """Where something is there that nothing in the catalogue explains."""
    stages = [] if where.stage is None else dict.fromkeys([*where.likely("stage"), *where.equivalent])
    at = f"at stage {' or '.join(stages)}" if stages else "at a stage that these data leave open"
    like = f" It resembles {', '.join(resembles)}." if resembles else ""
    return f"There is a gap that the catalogue does not explain, {at}: {what}.{like}"


def located(where: Place) -> list[str]:
    """Where the gap lies, with probabilities, and which other stages can look the same: a sentence each."""
    before = {"stage": "at stage ", "axis": "on ", "frame": "in ", "condition": "depending on "}
    parts = [
        f"{begins}{' or '.join(f'{_in_words(name)} ({percent(share)})' for name, share in shares.items())}"
        for kind, begins in before.items()
        if (shares := where.likely(kind))
    ]
    said = [f"Where: {', '.join(parts) or 'no particular place'}."]
    if equal := [stage for stage in where.equivalent if stage not in where.likely("stage")]:
        said.append(f"On this orbit and attitude, a cause at stage {' or '.join(equal)} can look much the same.")
    return said


def _in_words(place: str) -> str:
    return _PLACES.get(place, place.replace(":", "_"))  # driver:NAME is the column driver_NAME


def wrong_file(traps: Sequence[str], verdict: str, sentence: str) -> str:
    """Where `fluxtwin check` finds the file wrong. traps: what it says; verdict, sentence: what was found all the same."""
    wrong = ". Also: ".join(one.removesuffix(".") for one in traps)
    rest = "A wrong file makes a gap of its own or hides one, so nothing more is said about the cause."
    if verdict == "effect":
        rest = f"As the file stands, this was found. {sentence}"
    return f"{FIRST}, then diagnose again: {wrong}. {rest}"


def several(names: int) -> str:
    """Where so many names together explain what one unknown cause would rather."""
    return f"it takes {names} causes of the catalogue together to explain it, and some other cause is more likely than these"


def any_of(causes: int) -> str:
    """Where any of so many causes leaves nothing, and none is sure."""
    some = "one cause" if causes == 1 else f"any of {causes} causes"
    return f"{some} of the catalogue would explain it, but some other cause is more likely"


def left_over(gap: Shrinkage) -> str:
    """Where the best fit explains too little: of what it has not seen, where anything was held out."""
    what = "its own residual" if gap.prediction == "fit" else "the held-out residual"
    return (
        f"the best fit from the catalogue lowers {what} from {gap.before_nT:.1f} to {gap.after_nT:.1f} nT "
        f"rms, where {gap.floor_with_effects_nT:.1f} nT are expected"
    )


def louder(noise: NoiseModel, prior: NoisePrior) -> str:
    """Where the best fit would do, with more noise than there should be."""
    beyond = []
    if noise.sigma_nT > prior.sigma_nT:
        beyond.append(f"white noise of {noise.sigma_nT:.3g} nT where {prior.sigma_nT:.3g} nT were expected")
    if prior.theta_rad and noise.theta_rad > prior.theta_rad:
        error_deg, declared_deg = np.degrees([noise.theta_rad, prior.theta_rad])
        beyond.append(f"an attitude error of {error_deg:.2g} deg where {declared_deg:.2g} deg was declared")
    return f"beside the best fit from the catalogue it takes {listed(beyond)}, and some other cause is more likely than that"


def named(
    effects: Sequence[FoundEffect],
    gap: Shrinkage,
    momentum: MomentumGap | None,
    remains: str,
    outlying: str | None = None,
) -> str:
    """Where effects are named. remains: what does, if the shape is incomplete; outlying: of the outliers."""
    likely = [one for one in effects if one.probability >= 0.5] or effects[:1]
    causes = " and ".join(_cause(effect) for effect in likely)
    others = [f"{_cause(one)} ({percent(one.probability)})" for one in effects if one not in likely]
    causes += f" and perhaps {' and '.join(others)}" if others else ""
    rest = f" The explanation is incomplete: {remains}." if gap.shape_incomplete else ""
    rest += f" In addition, {outlying}." if outlying else ""
    how = "is explained in part by" if gap.shape_incomplete else "is explained by"
    return f"The gap {how} {causes}{_closed(effects, gap, momentum)}.{rest}"


def remains(left: Structure) -> str:
    """What does beside named effects, where their shape is incomplete."""
    if left.of_named:
        return f"{left.words} remains, at a multiple or a simple fraction of the wheel's frequency"
    return "some smaller structure remains"


def not_tested(names: Sequence[str]) -> str:
    """Of effects that follow what a named one follows, and that these data cannot test; empty for none."""
    if not names:
        return ""
    which = "which follows" if len(names) == 1 else "which follow"
    return f" These data cannot test {' and '.join(names)}, {which} the same quantity and may be the cause instead."


def _cause(effect: FoundEffect) -> str:
    known = {name: one for name, one in effect.parameters.items() if one.sigma is not None} or effect.parameters
    clear = sorted(known, key=lambda name: -abs(known[name].value) / (known[name].sigma or 1.0))[:3]
    units = {name: "" if one.unit == "1" else f" {one.unit}" for name, one in known.items()}
    sizes = ", ".join(f"{name} {plain(one.value)}{units[name]}" for name, one in known.items() if name in clear)
    sizes += f" and {len(known) - 3} more" if len(known) > 3 else ""
    over = ""
    if "region_deg" in effect.settings:
        where = SwitchedField(str(effect.settings["condition"]), region_deg=tuple(effect.settings["region_deg"]))
        over = f" {where.region_words}"
    over += f" at {str(effect.settings['at'])[:19]}Z" if effect.settings.get("at") else ""
    over += f" {effect.settings['delay_s']:.3g} s late" if effect.settings.get("delay_s") else ""
    over += f" behind a lag of {effect.settings['lag_s']:.3g} s" if effect.settings.get("lag_s") else ""
    sizes += f" {effect.settings['assumed']}" if effect.settings.get("assumed") else ""
    end = at_the_end(effect)
    return f"{' or '.join(effect.group)}{over} ({sizes}{f'; {end}' if end else ''})"


def at_the_end(effect: FoundEffect) -> str:
    """Which of its parameters have reached the end of their physical range, so that the size is not credible; or nothing."""
    ranges = [] if effect.effect is None else effect.effect.parameters
    names = [one.name for one in ranges if effect.parameters[one.name].value in (one.low, one.high)]
    return f"{', '.join(names)} at the end of the physical range" if names else ""


def _closed(effects: Sequence[FoundEffect], gap: Shrinkage, momentum: MomentumGap | None) -> str:
    which, s = (", which", "s") if len(effects) == 1 else (", which together", "")
    if momentum is not None and all(effect.stage == "dynamics" for effect in effects):
        share = "" if momentum.closed is None else f" and close{s} {100 * momentum.closed:.0f} % of the gap"
        return (
            f"{which} leave{s} the readings unchanged and lower{s} the misfit of the attitude to the momentum balance from "
            f"{momentum.before_deg:.2g} to {momentum.after_deg:.2g} deg{share}"
        )
    # Wrong readings that the noise hides are not excluded, and raise what is expected.
    hidden = f"{gap.floor_with_effects_nT:.1f}" != f"{gap.floor_nT:.1f}"
    if all(effect.name == "bit_errors" for effect in effects) and not hidden:
        return "; the wrong readings are excluded from the figures before and after"
    if gap.closed is None:
        return _not_measured(effects, gap)
    share = f"close{s} {100 * gap.closed:.0f} % of the gap"
    if gap.after_nT == gap.before_nT:
        noise_nT = gap.floor_with_effects_nT
        return f"{which} raise{s} the expected rms to {noise_nT:.1f} nT, where {gap.before_nT:.1f} nT are seen, and {share}"
    return f"{which} lower{s} the residual from {gap.before_nT:.1f} to {gap.after_nT:.1f} nT rms and {share}"


def _not_measured(effects: Sequence[FoundEffect], gap: Shrinkage) -> str:
    """Why a share is not stated although an effect is sure, and what would measure it."""
    p_value = min(effect.significance for effect in effects)
    signal_nT = max(effect.visible_nT for effect in effects)
    chance = "less than 1e-12" if p_value < 1e-12 else f"{p_value:.0e}"
    # What is known by its own shape, as a line is, has no size beside the fit.
    small = f"its signal is {signal_nT:.1f} nT rms, and " if signal_nT > 0.0 else ""
    seen = "residuals of the fit" if gap.prediction == "fit" else "held-out samples"
    return (
        f"; the probability that this is chance is {chance}, but the share of the gap that it closes cannot be measured: "
        f"{small}the {seen} have {gap.before_nT:.1f} nT rms where {gap.floor_nT:.1f} nT are expected without it, "
        "a difference that may be chance; more data of the same kind would measure it"
    )


def structure(left: Structure, where: Place) -> str:
    """The structure of a residual; of frame and condition the same as `where`."""
    if left.kind != "block" or (left.condition, left.frame) == (where.condition, where.frame):
        return left.words
    follows = f"follows {where.condition.replace('_', ' ')}" if where.condition else "follows no condition"
    return f"structure that {follows}" + (f", coherent in the {where.frame} frame" if where.frame else "")


def attitude_error(noise: NoiseModel, declared_rad: float) -> str:
    """An error of the reference attitude that is larger than declared."""
    memory = "white" if noise.tau_s <= 0.0 else f"with a time constant of {float(f'{noise.tau_s:.2g}'):g} s"
    return (
        f"the error of the reported attitude is {np.degrees(noise.theta_rad):.2g} deg per axis, {memory}, where "
        f"{np.degrees(declared_rad):.2g} deg was declared"
    )


def outliers(time: TimeArray, cut: BoolArray) -> str:
    """How many readings (N, 3) were set aside, when, and whether in runs."""
    rows = np.flatnonzero(cut.any(axis=1))
    runs = 1 + int((np.diff(rows) > 1).sum())
    first, last = (epoch.iso(time[row]) for row in (rows[0], rows[-1]))
    if rows.size == 1:
        return f"1 row has an outlier of more than six sigma, at {first}, and was excluded"
    together = f" in {runs} run{'s' if runs > 1 else ''}" if rows.size > 1.5 * runs else ""
    return f"{rows.size} rows have outliers{together} of more than six sigma, from {first} to {last}, and were excluded"


def unknown_dipole(rows: int) -> str:
    """How many rows were left out for want of a torquer dipole."""
    what = "with a reading but no torquer dipole"
    return f"{amount(rows, f'row {what} was|rows {what} were')} excluded"


def assumed(values: Mapping[str, Mapping[str, Any]]) -> str:
    """What was not declared, what was taken in its place, and the flags that would settle it; empty where all was
    declared. The time constant of the attitude error is always left to the data."""
    missing = [name for name, one in values.items() if one["source"] == "found" and name != "attitude_tau_s"]
    if not missing:
        return ""
    parts = []
    if "noise_nT" in missing:
        parts.append(f"noise {values['noise_nT']['value']:.3g} nT")
    if "lsb_nT" in missing:
        step = values["lsb_nT"]["value"]
        parts.append("no rounding" if not step else f"a step of {step:.3g} nT")
    if "attitude_sigma_deg" in missing:
        size, tau = values["attitude_sigma_deg"]["value"], values["attitude_tau_s"]["value"]
        memory = f" with a time constant of {float(f'{tau:.2g}'):g} s" if tau else ", white"
        parts.append(f"an attitude error of {size:.2g} deg{memory if size else ''}")
    flags = ", ".join(values[name]["flag"] for name in missing)
    return f"Not declared, so estimated from these data: {listed(parts)} ({flags})."


def repeated_rounding(every: int) -> str:
    """Of rows left out because they hold the same rounding error."""
    return (
        f"one row in {every} is used: most readings move by less than a step of the sensor from row to row, so the rows "
        "between repeat the same rounding error"
    )


def thinned(every: int, most_rows: int) -> str:
    """Of rows left out because there are too many."""
    return (
        f"one row in {every} is used to find slow effects; fast lines, bit errors and noise are sought at the full rate, "
        f"in up to {most_rows:,} rows"
    )


def typical_size(name: str, parameter: str) -> float | None:
    """The typical size of a parameter in the catalogue, None for what is not there."""
    known = (p for effect in CATALOGUE if effect.name == name for p in effect.parameters if p.name == parameter)
    return next((one.scale for one in known), None)


def would_settle(detectable: Mapping[str, Detectable], untestable: Mapping[str, str], hours: float) -> dict[str, str]:
    """For each effect that these data do not show at its typical size: what would, in words.

    hours: of data that were used.
    """
    settled_by = {effect.name: effect.settled_by for effect in CATALOGUE}
    advice = {}
    for name, found in detectable.items():
        wanted = typical_size(name, found.parameter)
        if wanted is None or found.value <= abs(wanted):
            continue
        unit = "" if found.unit == "1" else f" {found.unit}"
        needed = hours * (found.value / wanted) ** 2
        data = "more than two weeks of such data"
        if needed <= 24.0 * 14:
            data = f"about {_plain(needed)} h of such data instead of {_plain(hours)} h"
        advice[name] = f"for {found.parameter} {abs(wanted):.3g}{unit}: {data}, or {settled_by[name]}"
    return advice | {name: settled_by[name] for name in untestable if name in settled_by}


def _plain(value: float) -> str:
    """Two digits, never as a power of ten."""
    return f"{float(f'{value:.2g}'):g}"


def hours_of(time: TimeArray) -> float:
    """Hours of data that rows at these times (N,) cover, gaps left out."""
    return float(np.median(np.diff(time)) / np.timedelta64(1, "s")) * time.size / 3600.0
