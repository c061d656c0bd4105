"""A field switched by a thermostat that nobody recorded: found in the residual.

Two levels and a penalty for each switch (Viterbi's algorithm), in turn with the field vector (least squares in whitened
units). Any slow signal can be cut into two levels, so the sequence is only called a heater's if it switches more regularly
than a random telegraph, if no block of columns does as well, and if no line is left given it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import gammaln

from fluxtwin.calib.common.criterion import FALSE_ALARM
from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.gap.detectors.finding import Finding, Fitted, does_as_well, fitted, stands_out
from fluxtwin.gap.detectors.lines import Line, line_columns
from fluxtwin.gap.hypotheses.blocks import BlockFit, in_body
from fluxtwin.gap.linear.projection import ProjectedResidual
from fluxtwin.gap.selection.criterion import THRESHOLD, worth
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.drivers import lit
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.switched_field import HeaterSwitching

_ROUNDS = 8
_MOST_SWITCHES = 150


def heater_sequence(
    setting: Setting,
    left: ProjectedResidual,
    residual_nT: FloatArray,
    fitted_nT: FloatArray,
    rivals: Sequence[BlockFit],
    line: Line,
    start: BoolArray | None = None,
) -> Finding | None:
    """Look for a two-state sequence; None where there is none.

    residual_nT (N, 3), fitted_nT (N, 3, q): as they are out of each other in `left`, which is whitened. rivals: fits of the
    design's blocks. line: the strongest one, of which nothing may be left given the sequence. start (N,): one to begin
    with, where there is one.
    """
    beside = _Beside(left, residual_nT, fitted_nT)
    first = _sequence(setting, left, beside, line) if start is None else _climbed(left, beside, start)
    on = _polished(left, first)
    on = ~on if on.mean() > 0.5 else on  # a bias hides which state is which: the rarer one is called on
    found, value = _fitted(left, on), _worth(left, on)
    if value <= THRESHOLD:
        return None
    faults = does_as_well(value, found, rivals)
    if _regularity(setting, on) > FALSE_ALARM:
        faults.append("it switches as irregularly as a random telegraph")
    if stands_out(left, in_body(on.astype(float)), line_columns(setting.seconds, line.frequency_Hz)):
        faults.append("it is a line that was cut")
    faults += [] if faults else _as_recorded(setting, left, on, value, found)
    what = f"a field that switches on and off, {_switches(on).size} switches"
    effect = HeaterSwitching(tuple(int(state) for state in on))
    return Finding(effect, found.size, found.sigma, value, what, tuple(faults))


def _as_recorded(setting: Setting, left: ProjectedResidual, on: BoolArray, own: float, given: Fitted) -> list[str]:
    """Whether a recorded switch, by day, by night or at any time, and up to a dozen rows late, does as well."""
    dark = lit(setting) < 0.5
    switches: dict[str, BoolArray] = {}
    for name, column in setting.columns.items():
        if column is not None and column.ndim == 1 and np.unique(column[np.isfinite(column)]).size == 2:
            high = column > np.nanmean(column)
            switches |= {name: high, f"{name} in sunlight": high & ~dark, f"{name} in shadow": high & dark}
    trials = []
    for name, switch in switches.items():
        for rows in range(min(13, on.size)):
            moved = np.concatenate([np.repeat(switch[:1], rows), switch[: on.size - rows]])
            trials.append((max(np.mean(moved == on), np.mean(moved != on)), name, moved))
    if not trials:
        return []
    _, name, moved = max(trials, key=lambda trial: trial[0])
    one = fitted(left, in_body(moved.astype(float)))
    value = worth(one.energy / given.variance, one.rank, given.samples, float(np.log(len(trials))))
    return [f"{name} does as well"] if value >= own else []


def _switches(on: BoolArray) -> NDArray[np.intp]:
    """Rows with another state than the row before."""
    return np.flatnonzero(on[1:] != on[:-1]) + 1


def _fitted(left: ProjectedResidual, on: BoolArray) -> Fitted:
    return fitted(left, in_body(on.astype(float)), _switches(on).size)


def _worth(left: ProjectedResidual, on: BoolArray) -> float:
    """Of a sequence, of all those with so many switches."""
    return _fitted(left, on).worth(log_sequences(on))


def log_sequences(on: BoolArray) -> float:
    """Log of the number of all sequences with as many switches."""
    rows, count = on.size, _switches(on).size
    return float(gammaln(rows + 1) - gammaln(count + 1) - gammaln(rows - count + 1))


class _Beside:
    """A residual (N, 3) in nT, and what fitted columns (N, 3, q) take of it and of a signal: the mean of a heater's field
    over day and night, say, where something is fitted that follows the sunlight."""

    def __init__(self, left: ProjectedResidual, residual_nT: FloatArray, fitted_nT: FloatArray) -> None:
        self._left, self._fitted_nT = left, fitted_nT
        white = left.whitener.apply(np.ascontiguousarray(fitted_nT)).reshape(left.residual.size, -1)
        self._inverse = np.linalg.pinv(white, rcond=1e-10)
        self.rest_nT: FloatArray = residual_nT - self.of(residual_nT)

    def of(self, signal_nT: FloatArray) -> FloatArray:
        """(N, 3) what the columns take of a signal (N, 3)."""
        size = self._inverse @ self._left.whitener.apply(signal_nT).reshape(-1)
        return np.asarray(self._fitted_nT @ size)


def _sequence(setting: Setting, left: ProjectedResidual, beside: _Beside, line: Line) -> BoolArray:
    """(N,) the likeliest two-state sequence."""
    seconds, rest_nT = setting.seconds, beside.rest_nT
    lagged = sum(rest_nT[lag:].T @ rest_nT[: len(rest_nT) - lag] for lag in (1, 2, 3))
    directions = list(np.linalg.eigh(np.asarray(lagged + np.transpose(lagged)))[1].T)
    cycles = []
    if line.frequency_Hz > 0:
        # Two levels in turn have a line along their field.
        waves = fitted(left, line_columns(seconds, line.frequency_Hz)).size.reshape(2, 3)
        along = np.linalg.svd(waves)[2][0]
        directions.append(along)
        # How long they are on in each turn may follow the sun, and that part others have explained already.
        turn = max(round(1.0 / (line.frequency_Hz * float(np.median(np.diff(seconds))))), 1)
        z = rest_nT @ along
        cycle, dark = uniform_filter1d(z, max(turn // 8, 1)) > uniform_filter1d(z, turn), lit(setting) < 0.5
        cycles = [cycle, cycle & dark, cycle & ~dark]
    first = [_viterbi(rest_nT @ along, None, share) for along in directions for share in (0.25, 0.5, 0.75)]
    distinct = sorted({on.tobytes(): on for on in first}.values(), key=lambda on: -_worth(left, on))
    climbed = [_climbed(left, beside, on) for on in [*distinct[:2], *cycles]]
    return max(climbed, key=lambda on: _worth(left, on))


def _climbed(left: ProjectedResidual, beside: _Beside, on: BoolArray) -> BoolArray:
    """(N,) the sequence that a first one leads to, in turn with the field and with what was fitted before."""
    for _ in range(_ROUNDS):
        if not on.any() or on.all():
            break
        field = _fitted(left, on).size
        rest_nT = beside.rest_nT + beside.of(np.outer(on, field))
        spread = np.cov((rest_nT - np.outer(on - on.mean(), field)).T)
        again = _viterbi(rest_nT @ np.linalg.solve(spread, field), on)
        if np.array_equal(again, on):
            break
        on = again
    return on


def _polished(left: ProjectedResidual, on: BoolArray) -> BoolArray:
    """The sequence with runs taken out and edges moved while it gets likelier.

    The search for it works row by row, where the slow error of the attitude looks like levels; this has the whitened
    likelihood.
    """
    if _switches(on).size > _MOST_SWITCHES:
        return on
    best = _worth(left, on)
    for _ in range(_ROUNDS):
        before = best
        for change in _changes(on):
            trial = on.copy()
            trial[change] = ~trial[change]
            if np.array_equal(trial, on) or trial.all() or not trial.any():
                continue
            value = _worth(left, trial)
            if value > best:
                on, best = trial, value
        if best - before < 1.0:
            break
    return on


def _changes(on: BoolArray) -> list[slice]:
    """Rows to turn round: each run in one state, and the rows next to each edge."""
    edges = _switches(on).tolist()
    runs = [slice(a, b) for a, b in pairwise([0, *edges, on.size])]
    about = ((-1, 0), (0, 1), (-3, 0), (0, 3))
    return [*runs, *(slice(max(edge + low, 0), edge + high) for edge in edges for low, high in about)]


def _viterbi(z: FloatArray, start: BoolArray | None, share: float = 0.5) -> BoolArray:
    """Best cut of a series into two levels with a penalty for each switch; levels and noise re-estimated in turn.

    start: where to begin; None: with this share of the rows in the lower level. The penalty is what one switch more costs
    of all sequences with so many, so this is a local optimum: from noise it may run to a switch in every other row, which
    is worth nothing.
    """
    on = z > np.quantile(z, share) if start is None else start
    count = 1 if start is None else max(_switches(start).size, 1)
    penalty = float(np.log(max((z.size - count) / count, 1.0)))
    scale = MAD_TO_SIGMA * np.median(np.abs(np.diff(z))) / np.sqrt(2)
    for _ in range(_ROUNDS):
        if not on.any() or on.all():
            break
        low, high = float(z[~on].mean()), float(z[on].mean())
        noise = max(float(np.std(z - np.where(on, high, low))), 1e-3 * scale, 1e-12)
        again = _path(((z - low) ** 2 - (z - high) ** 2) / (2 * noise**2), penalty)
        if np.array_equal(again, on):
            break
        on = again
    return on


def _path(gain: FloatArray, penalty: float) -> BoolArray:
    """States that maximise the sum of `gain` while on, less the penalty of each switch."""
    stay_off, stay_on = 0.0, 0.0
    from_on, from_off = np.zeros(gain.size, dtype=bool), np.zeros(gain.size, dtype=bool)
    for row, value in enumerate(gain.tolist()):
        from_on[row] = stay_on - penalty > stay_off
        from_off[row] = stay_off - penalty > stay_on
        off = stay_on - penalty if from_on[row] else stay_off
        stay_on = (stay_off - penalty if from_off[row] else stay_on) + value
        stay_off = off
    on = np.zeros(gain.size, dtype=bool)
    state = stay_on > stay_off
    for row in range(gain.size - 1, -1, -1):
        on[row] = state
        state = not from_off[row] if state else bool(from_on[row])
    return on


def _regularity(setting: Setting, on: BoolArray) -> float:
    """p-value of dwell times as regular as these for a random telegraph with as many switches."""
    sunlit = lit(setting) > 0.5
    observed = _scatter(setting.seconds, sunlit, _switches(on), bool(on[0]))
    rng = np.random.default_rng(20)
    below, drawings = 0, 400
    for _ in range(drawings):
        drawn = np.sort(rng.choice(np.arange(1, on.size), _switches(on).size, replace=False))
        below += _scatter(setting.seconds, sunlit, drawn, bool(on[0])) <= observed
    return (below + 1) / (drawings + 1)


def _scatter(seconds: FloatArray, sunlit: BoolArray, changes: NDArray[np.intp], first: bool) -> float:
    """Mean squared relative scatter of the inner dwell times within each class (state, sun or shadow)."""
    lengths = np.diff(seconds[changes])
    middle = (changes[1:] + changes[:-1]) // 2
    states = np.logical_xor(np.arange(lengths.size) % 2 == 0, first)
    kinds = 2 * states + sunlit[middle]
    total, count = 0.0, 0
    for kind in np.unique(kinds):
        some = lengths[kinds == kind]
        if some.size >= 2:
            total += float(np.sum((some / some.mean() - 1) ** 2))
            count += some.size - 1
    return total / count if count else np.inf
