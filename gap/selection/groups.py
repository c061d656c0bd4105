"""Which causes a design can tell apart, found before the data are looked at."""

from __future__ import annotations

import numpy as np

from fluxtwin.gap.hypotheses.candidates import settings_of
from fluxtwin.gap.selection.score import Board
from fluxtwin.sim.effects.base import Effect

ALIKE = 0.98
"""Two effects that each imitate this share of the other are one group."""
WORTH_SAYING = 0.5


def shares_by_name(board: Board) -> dict[str, dict[str, float]]:
    """{a: {b: share of a that b can imitate}}, the largest over alternatives of both; effects that are seen only."""
    table, seen = board.shares, board.rank > 0
    found: dict[str, dict[str, float]] = {}
    for k, one in enumerate(board.candidates):
        for m, other in enumerate(board.candidates):
            if seen[k] and seen[m] and one.name != other.name:
                row = found.setdefault(one.name, {})
                row[other.name] = max(row.get(other.name, 0.0), float(table[k, m]))
    return found


def alike_to(board: Board, effect: Effect) -> tuple[str, ...]:
    """The effect's name, and those that have a setting which imitates 0.98 of it, and it of that one: of it in the form
    that it has here (an axis, a course), whatever the numbers among its settings."""

    def form(one: Effect) -> tuple[str, dict[str, object]]:
        return one.name, {key: value for key, value in settings_of(one).items() if isinstance(value, str)}

    table, seen = board.shares, board.rank > 0
    own = [k for k, one in enumerate(board.candidates) if seen[k] and form(one.effect) == form(effect)]
    both = np.minimum(table, table.T)[own].max(axis=0, initial=0.0)
    others = [
        one.name for one, share, there in zip(board.candidates, both, seen, strict=True) if there and share >= ALIKE
    ]
    return tuple(dict.fromkeys([effect.name, *others]))


def isolability(table: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """The shares worth saying: 0.5 and more, largest first."""
    ordered = {name: sorted(row.items(), key=lambda pair: -pair[1]) for name, row in table.items()}
    large = {name: {other: share for other, share in row if share >= WORTH_SAYING} for name, row in ordered.items()}
    return {name: row for name, row in large.items() if row}


def alike(table: dict[str, dict[str, float]]) -> dict[str, tuple[str, ...]]:
    """{name: names, its own first, that each imitate 0.98 of the other}."""
    return {
        name: (
            name,
            *(other for other, share in row.items() if share >= ALIKE and table.get(other, {}).get(name, 0.0) >= ALIKE),
        )
        for name, row in table.items()
    }
