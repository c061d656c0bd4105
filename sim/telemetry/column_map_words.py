"""The words a column map may use for axes and orders, and how a near miss is answered."""

from __future__ import annotations

import difflib
from functools import partial
from typing import Any

from fluxtwin.sim.telemetry.time_stamps import NAMES

FRAMES = ("GCRS", "J2000", "mean_of_date", "true_of_date", "ITRS")
POSITIONS = (*FRAMES, "geodetic", "geocentric")
REFERENCES = (*FRAMES, "NEC", "NED", "orbital")
ORDERS = ("xyzw", "wxyz", "xyz")
_OTHER_FRAMES = {
    "ECI": "GCRS",
    "ICRF": "GCRS",
    "EME2000": "J2000",
    "GEI": "true_of_date",
    "TOD": "true_of_date",
    "TEME": "true_of_date",
    "MOD": "mean_of_date",
    "ECEF": "ITRS",
    "ITRF": "ITRS",
    "WGS84": "ITRS",
}
_OTHER_REFERENCES = {**_OTHER_FRAMES, "LVLH": "orbital"}
_OTHER_ORDERS = {"scalar_last": "xyzw", "scalar_first": "wxyz"}
_LOOSE = {
    "ECI": "axes of date would differ by up to 0.4 deg, 50 arcsec for each year since 2000",
    "GEI": "axes of date; if they are those of J2000, say so",
    "TEME": "its mean equinox lies within 20 arcsec",
    "LVLH": "z nadir, y negative orbit normal",
}


def order(value: Any) -> Any:
    """The order of a quaternion's components; other words for it are replaced."""
    found = _spelled(value, ORDERS, _OTHER_ORDERS)
    return _OTHER_ORDERS.get(found, found) if isinstance(found, str) else found


def canonical(word: str) -> str:
    """The frame or reference that a word stands for."""
    return _OTHER_REFERENCES.get(word, word)


def assumption(word: str, quantity: str) -> str | None:
    """What was taken for granted where a word is another one's, None for the words of the list."""
    if word == canonical(word):
        return None
    loose = f" ({_LOOSE[word]})" if word in _LOOSE else ""
    return f"{quantity}: {word} was taken as {canonical(word)}{loose}"


def _spelled(value: Any, known: tuple[str, ...], others: dict[str, str]) -> Any:
    if not isinstance(value, str):
        return value  # pydantic says what kind is wanted
    words = {word.lower(): word for word in (*known, *others)}
    if value.lower() in words:
        return words[value.lower()]
    near = difflib.get_close_matches(value.lower(), words, n=1, cutoff=0.5)
    hint = f"did you mean {words[near[0]]}? " if near else ""
    also = ", ".join(f"{word} (= {meant})" for word, meant in others.items())
    raise ValueError(
        f"{value[:40]!r} is not known; {hint}known: {', '.join(known)}" + (f"; also {also}" if also else "")
    )


frame = partial(_spelled, known=POSITIONS, others=_OTHER_FRAMES)
"""A frame of positions, in the spelling of the list. Raises ValueError with the nearest word."""
reference = partial(_spelled, known=REFERENCES, others=_OTHER_REFERENCES)
"""A reference of attitudes, likewise."""
recipe = partial(_spelled, known=NAMES, others={})
"""A recipe for time, likewise."""
