"""What a law may be made of on a design: every recorded column and the geometry, alone, in powers, late, and in products.

Which factors a term has is a matter of this table alone; what they are worth is that of the search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import get_args

import numpy as np

from fluxtwin.gap.detectors.residual_structure import PARTS
from fluxtwin.gap.hypotheses.conditions import LEAST_SHARE
from fluxtwin.gap.hypotheses.perturbed_design import PerturbedDesign, alike
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.drivers import varies
from fluxtwin.sim.effects.law import ANGLES, FIELD, GEOMETRY, Axes, Law, timed
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.spacecraft_field import TYPICAL_NT, Driver
from fluxtwin.sim.telemetry.quantities import DIPOLE, WHEELS

AXES: tuple[Axes, ...] = get_args(Axes)
_SCALARS = ("heater_on", "array_current_A", "battery_current_A", "temperature_degC")
_LEVELS = np.arange(1, 10) / 10.0
"""Quantiles of a column beyond which something may be on."""
_PARTS = max(PARTS)
"""Of a record, at whose ends something that follows a column may go on or off: the times are then searched between them."""
_QUARTER = {"cos": "sin", "sin": "cos", "cos2": "sin2", "sin2": "cos2"}
_WAVES = tuple(_QUARTER)


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
        return [f"{wave} {name}" for name in angles for wave in _WAVES]

    def geometry(self, gates: bool = False) -> list[str]:
        """Factors that need no recorded column and do not follow the attitude's error; gates: with shadow among them."""
        plain = [name for name in GEOMETRY if name not in ANGLES]
        waves = [f"{wave} {angle}" for angle in ANGLES for wave in _WAVES]
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
        levels = np.unique(np.quantile(values, _LEVELS))
        return ("^2", "^3", *(f">{level:.6g}" for level in levels if LEAST_SHARE < np.mean(values > level) < 1.0))


def _of(factor: str) -> str:
    return factor.rpartition(" ")[2]


def _names(setting: Setting) -> Iterator[str]:
    """Quantities that are recorded."""
    yield from (name for name in setting.columns if name in _SCALARS or name.startswith(("driver_", "flag_")))
    if setting.column(DIPOLE.name) is not None:
        yield from (f"dipole_{axis}" for axis in "xyz")
    if setting.column(WHEELS.name) is not None:
        yield from (f"wheel_{number}" for number in range(1, 5))
