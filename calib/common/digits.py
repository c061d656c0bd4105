"""Numbers as a person reads them: as many digits as are known, no exponent where none is needed."""

from __future__ import annotations

import math

_MOST_DECIMALS = 7  # beyond, zeros would have to be counted


def plain(value: float, digits: int = 3) -> str:
    """`value` with that many significant digits.

    >>> plain(15912.3), plain(0.012345), plain(50.82), plain(0.0)
    ('15900', '0.0123', '50.8', '0')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    return _fixed(value, digits - 1 - math.floor(math.log10(abs(value))))


def with_sigma(value: float, sigma: float | None) -> tuple[str, str]:
    """Value and sigma, both to the second digit of sigma; without sigma up to five digits and a blank.

    >>> with_sigma(-834.127, 15.89), with_sigma(0.0104082, 0.000411), with_sigma(62.061, 19.2), with_sigma(3.0, None)
    (('-834', '16'), ('0.01041', '0.00041'), ('62', '19'), ('3', ''))
    """
    if sigma is None or not (math.isfinite(sigma) and sigma > 0 and math.isfinite(value)):
        return (f"{value:.5g}" if abs(value) < 1e5 else plain(value, 5)), ""
    decimals = 1 - math.floor(math.log10(float(f"{sigma:.1e}")))
    return _fixed(value, decimals), _fixed(sigma, decimals)


def measured(value: float, sigma: float | None) -> str:
    """`-834 ± 16`."""
    one, other = with_sigma(value, sigma)
    return f"{one} ± {other}" if other else one


def _fixed(value: float, decimals: int) -> str:
    """`value` rounded to so many decimals, fewer than none for tens and hundreds."""
    if decimals > _MOST_DECIMALS:
        return f"{value:.1e}"
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"  # + 0.0: no minus before a zero


def percent(share: float) -> str:
    """A probability as nobody can misread it: certainty is not on offer."""
    if share > 0.99:
        return "> 99 %"
    return "< 1 %" if share < 0.01 else f"{100 * share:.0f} %"
