"""What is said of a law: its terms, its units, and the sentence."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from itertools import count

from fluxtwin.calib.common.digits import measured
from fluxtwin.calib.common.observability import listed
from fluxtwin.gap.records.diagnosis import Law, LawTerm, Shrinkage
from fluxtwin.sim.effects.base import Effect
from fluxtwin.sim.effects.law import FIELD, GEOMETRY, timed
from fluxtwin.sim.effects.law import Law as LawEffect

_UNITS = {
    "array_current_A": "A",
    "battery_current_A": "A",
    "temperature_degC": "K",
    "dipole": "A m2",
    "wheel": "rpm",
    "rate": "deg/s",
    "field": "uT",
    "driver": "unit",
}
_NAMES = {
    "array_current_A": "array current",
    "battery_current_A": "battery current",
    "temperature_degC": "temperature",
    "sunlit": "sunlight",
    "sun_height": "sine of the sun's height",
    "orbit_phase": "argument of latitude",
    "local_time": "local time",
}
_FRAMES = {"orbital": "the orbital frame", "inertial": "inertial axes", "earth": "Earth-fixed axes"}
_MOST_LISTED = 4


def unit(law: LawEffect) -> str:
    """Of a term's coefficients."""
    parts = _units(law.of)
    return "nT" if not parts else f"nT/{parts[0]}" if len(parts) == 1 else f"nT/({' '.join(parts)})"


def _units(of: Sequence[str]) -> list[str]:
    """Those of a product, each once with its power."""
    plain = [part for part in map(_unit, of) if part]
    return [one if plain.count(one) == 1 else f"{one}^{plain.count(one)}" for one in dict.fromkeys(plain)]


def _unit(factor: str) -> str:
    name, _, power = factor.partition("^")
    if " " in factor or ">" in factor:
        return ""
    stem = name if name in _UNITS else name.partition("_")[0]
    return _UNITS.get(stem, "") + power if stem in _UNITS else ""


def with_names(laws: Iterable[LawEffect], had: Collection[Effect] = ()) -> list[LawEffect]:
    """The terms with names of their own: what they follow, without levels and times, numbered where two follow the same.

    had: effects of the scenario, of which another law keeps its name.
    """
    found: list[LawEffect] = []
    for law in laws:
        name = "_".join(map(_short, _followed(law.of))) or "constant"
        numbered = (replace(law, term=name if number == 1 else f"{name}_{number}") for number in count(1))
        new, known = {one.name for one in found}, {one.name for one in had}
        found.append(next(one for one in numbered if one.name not in new and (one in had or one.name not in known)))
    return found


def _followed(of: Sequence[str]) -> list[str]:
    """The factors that are neither a switch in time nor the constant."""
    return [text for text in of if not timed(text) and text != "one"]


def _short(factor: str) -> str:
    """A factor in a name."""
    done, _, rest = factor.rpartition(" ")
    name, above, _ = rest.removeprefix("driver_").partition(">")
    name = name.replace("^2", "_squared").replace("^3", "_cubed")
    return re.sub(r"[^A-Za-z0-9_]", "", "_".join(filter(None, (done, name, "high" if above else ""))))


def factor(text: str) -> str:
    """One factor, to read."""
    if timed(text):
        return f"a switch at {text.partition(' ')[2]}"
    done, _, name = text.rpartition(" ")
    name, power = (name[:-2], name[-2:]) if name[-2:] in ("^2", "^3") else (name, "")
    name, above, level = name.partition(">")
    read = _NAMES.get(name, name.replace("_", " ") if name.startswith(("sun_", "rate_", "field_")) else name)
    if done == "not":
        return f"1 - {read}"
    wave = f"{done.replace('2', '(2 ', 1)}{read})" if "2" in done else f"{done}({read})" if done else read
    return f"{wave}{power}" + (f" above {level}" if above else "")


def product(of: Sequence[str]) -> str:
    """The factors of a term, to read."""
    plain = " times ".join(map(factor, _followed(of)))
    return ", ".join([plain or "a constant", *(str(gate(text)) for text in of if timed(text))])


def recorded(text: str) -> bool:
    """Whether a factor is of a recorded column."""
    if timed(text):
        return False
    name = re.split(r"[>^]", text.rpartition(" ")[2])[0]
    return name not in GEOMETRY and name not in FIELD


def gate(text: str) -> str | None:
    """A second factor that switches, to read; None where it is another one."""
    if timed(text):
        sense, _, time = text.partition(" ")
        return f"from {time} on" if sense == "since" else f"until {time}"
    plain = text.removeprefix("not ")
    if plain == "sunlit":
        return "in sunlight only" if text == plain else "in shadow only"
    if plain.startswith("flag_") or plain == "heater_on":
        return f"while {plain} is {'1' if text == plain else '0'}"
    if ">" in text:
        return f"while {factor(text)}"
    return None


def term(one: LawTerm) -> str:
    """One term in words."""
    every = one.coefficients.items()
    seen = [(axis, pair) for axis, pair in every if pair[1] is None or abs(pair[0]) > 2.0 * pair[1]]
    sizes = [f"{measured(value, sigma)} {one.unit} on {axis}" for axis, (value, sigma) in seen or every]
    frame = "" if one.axes == "body" else f" of {_FRAMES[one.axes]}"
    first = _followed(one.of)[:1]
    gates = [found for text in one.of if text not in first and (found := gate(text))]
    plain = [factor(text) for text in _followed(one.of) if text in first or gate(text) is None]
    late = [f"{one.delay_s:.3g} s late"] if one.delay_s else []
    late += [f"behind a lag of {one.lag_s:.3g} s"] if one.lag_s else []
    times = [f"times {' times '.join(plain)}"] if plain else []
    return ", ".join([f"{listed(sizes)}{frame}", *times, *late, *gates])


def made_of(terms: Sequence[LawTerm]) -> str:
    """What a law that is not kept follows, in short."""
    factors = list(dict.fromkeys(factor(text) for one in terms for text in one.of))
    more = f" and {len(factors) - _MOST_LISTED} more" if len(factors) > _MOST_LISTED else ""
    return f"{', '.join(factors[:_MOST_LISTED])}{more}"


def sentence(law: Law, named: bool, orbits: float) -> str:
    """A law in one sentence. named: whether it stands beside names; orbits: that the record lasts.

    A law of geometry alone is a function of the time in a record of an orbit or two, whatever makes the gap.
    """
    share = (
        "" if law.closed is None else f" It closes {100 * law.closed:.0f} % of the remaining gap on held-out samples."
    )
    other = ""
    if law.could_be:
        others = " or of ".join(map(product, law.could_be[:_MOST_LISTED]))
        other = f" These data cannot distinguish it from a law of {others}."
    if not any(recorded(text) for one in law.terms for text in one.of):
        other += (
            f" It contains no recorded column: over {orbits:.1f} orbits it describes the gap but does not explain it."
        )
    what, formula = "the remainder" if named else "it", "; and ".join(map(term, law.terms))
    return f"A law of recorded columns and geometry describes {what}: {formula}.{share}{other}"


def instead(law: Law) -> Law:
    """The law with the names that it does without in its sentence."""
    names = " and ".join(law.instead_of)
    said = law.sentence.replace("describes it:", "describes the gap:", 1)
    return replace(law, sentence=f"{said} It explains more than {names}, which it replaces.")


def beside_names(said: str, law: Law) -> str:
    """What is said of names, and the law: first, where it replaces them."""
    if not law.instead_of:
        return f"{said} {law.sentence}"
    return f"{law.sentence} From the catalogue alone, {said[:1].lower()}{said[1:]}"


def nothing(law: Law) -> str:
    """Where no law was found."""
    return f"No law of recorded columns and geometry was found among {law.tried:,} terms: {law.why_none}."


def too_little(gap: Shrinkage) -> str:
    """Why a law is not kept that closes less than it must."""
    if gap.prediction == "fit":
        return "cannot be tested: one part of this record does not determine it well enough to predict another"
    share = "no measurable share" if gap.closed is None else f"{100 * gap.closed:.0f} %"
    return f"closes {share} of the remaining gap on held-out samples"


def axis_label(law: LawEffect) -> str:
    """Of a figure."""
    units = " ".join(_units(law.of)).replace("K", "degC")  # as it is recorded, where a coefficient has differences
    late = f" [{units}]" if units else ""
    late += f", {law.delay_s:.3g} s late" if law.delay_s else ""
    late += f", behind {law.lag_s:.3g} s" if law.lag_s else ""
    return product(law.of) + late
