"""A field that is on or off by a thermostat nobody recorded: the sequence is found in the residual.

Two levels and a price for each switch (Viterbi's algorithm), in turn with the field vector (least squares in
whitened units). Any slow signal can be cut into two levels, so the sequence is only called a heater's if its dwell
times are regular, apart in sun and shadow (and more so than those of a random telegraph with as many switches), if no
place gives them, and if the field is flat between the switches and one in body axes wherever the orbit goes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln

from fluxtwin.gap.detectors.flexible import FlexibleFinding
from fluxtwin.gap.detectors.residual_structure import drift
from fluxtwin.gap.detectors.tones import Tone, tone_columns
from fluxtwin.gap.detectors.waveform_checks import (
    drivers,
    dwells,
    follows_place,
    gains,
    halves,
    irregular,
    varies,
    within_dwells,
)
from fluxtwin.gap.hypotheses.conditions import lit
from fluxtwin.gap.hypotheses.evidence import BlockFit
from fluxtwin.gap.linear.leftover import Leftover, Whitens, leftover
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.switched_field import HeaterSwitching

_ROUNDS = 8
_FEWEST_SWITCHES = 6
_LOG_CERTAIN = 10.0
_TELEGRAPHS = 400
_REGULAR_P = 0.01
_FLAT_P = 1e-3
_LEAST_BENT, _LEAST_LINE = 0.05, 0.02
"""Shares; of a sine cut into two levels the bends have 6 % or more, and the line beside the levels 4 % or more."""
_SEED = 20
_MOST_SWITCHES = 150
_SHARES = (0.25, 0.5, 0.75)
_CLIMBED = 2
_BETTER = 0.5  # in log likelihood
_MOVES = ((-1, 0), (0, 1), (-3, 0), (0, 3))  # rows about an edge
_FEW_TURNS, _DWELL_TIMES = 3.0, 4.0
_DRIFT_P = -4.0
_LONGEST = 200_000  # rows; the search walks through them one by one


def heater_sequence(
    setting: Setting,
    whitener: Whitens,
    residual_nT: FloatArray,
    fitted: FloatArray,
    rivals: Sequence[BlockFit] = (),
    tone: Tone | None = None,
) -> FlexibleFinding | None:
    """Look for a two-state sequence in a residual (N, 3), fitted columns (N, 3, q); None where there is none.

    rivals: block fits, none of which may be worth as much as the sequence after its price. tone: the strongest line,
    of which nothing may be left beside the sequence.
    """
    rows = residual_nT.shape[0]
    if not 60 <= rows <= _LONGEST:
        return None
    left = leftover(whitener, residual_nT, fitted)
    on = _polished(left, _sequence(left, whitener, residual_nT, fitted, setting, tone))
    on = ~on if on.mean() > 0.5 else on  # a bias hides which state is which: the rarer one is called on
    switches = int(np.sum(on[1:] != on[:-1]))
    if switches < _FEWEST_SWITCHES:
        return None
    columns = on.astype(float)[:, None, None] * np.eye(3)
    free, _ = left.project(columns)
    gram = free.T @ free
    field = np.linalg.pinv(gram, rcond=1e-9) @ (free.T @ left.residual)
    gain = float(field @ gram @ field)
    spare = max(left.degrees - 3 - switches, 1)
    variance = (left.energy - gain) / spare
    price = _price(rows, switches)
    worth = 0.5 * gain / variance - price - 1.5 * np.log(rows)
    if worth < _LOG_CERTAIN:
        return None
    faults = _rivals(gain, variance, price, rows, rivals)
    if _regularity(setting, on) > _REGULAR_P:
        faults.append("it switches as irregularly as a random telegraph")
    sunlit = lit(setting) > 0.5
    if abs(np.mean(on == sunlit) - 0.5) > 0.45:
        faults.append("it follows the sunlight")
    faults += _not_a_heater(setting, left, on, sunlit, tone)
    rest = leftover(whitener, residual_nT, np.concatenate([fitted, columns], axis=2))
    if drift(rest)[0] < _DRIFT_P:
        faults.append("slow structure is left beside it")
    sigma = np.sqrt(variance * np.diag(np.linalg.pinv(gram, rcond=1e-9)))
    parameters = {f"f_{a}": (float(v), float(s), "nT") for a, v, s in zip("xyz", field, sigma, strict=True)}
    words = f"a field that is on and off in turn, {switches} switches" + (
        f"; but {', '.join(faults)}" if faults else ""
    )
    instance = HeaterSwitching(tuple(int(state) for state in on))
    return FlexibleFinding("heater_switching", parameters, float(np.exp(-worth)), not faults, words, instance)


def _not_a_heater(setting: Setting, left: Leftover, on: BoolArray, sunlit: BoolArray, tone: Tone | None) -> list[str]:
    """One field in body axes, flat while on and while off; dwell times that a place does not give."""
    faults = irregular(setting.seconds, on, sunlit)
    place = follows_place(setting, on)
    if place is not None and not _predicted_by_chance(setting, on):
        faults.append(f"it can be told from {place}")
    columns = on.astype(float)[:, None, None] * np.eye(3)
    faults += varies(left, columns, {**halves(setting), **drivers(setting)})
    bends = within_dwells(on)
    both = np.concatenate([bends * on[:, None], bends * ~on[:, None]], axis=1)
    spread = (np.eye(3)[None, :, :, None] * both[:, None, None, :]).reshape(on.size, 3, -1)
    if _more(left, columns, spread, _LEAST_BENT):
        faults.append("it is not flat between the switches")
    # Two levels in turn have a strong line too, but beside the levels nothing of it is left.
    if tone is not None and _more(left, columns, tone_columns(setting.seconds, tone.frequency_Hz), _LEAST_LINE):
        faults.append("it is a line that was cut")
    return faults


def _predicted_by_chance(setting: Setting, on: BoolArray) -> bool:
    """Whether a place that foretells the state says no more than the dwell times do.

    A rule of place has a free edge for each switch of a revolution, a thermostat four dwell times. Where a revolution
    has more switches than that, regular ones fall into step with the second revolution easily; with a third they do not.
    """
    r, v, _ = setting.given
    turn_s = 2 * np.pi * float(np.median(np.sum(r**2, axis=1) / np.linalg.norm(np.cross(r, v), axis=1)))
    turns = float(np.ptp(setting.seconds)) / turn_s
    return bool(turns < _FEW_TURNS and np.sum(on[1:] != on[:-1]) > _DWELL_TIMES * turns)


def _more(left: Leftover, columns: FloatArray, others: FloatArray, least: float) -> bool:
    """Whether others certainly explain something beside the columns, and more than a share."""
    p, share = gains(left, columns, np.concatenate([columns, others], axis=2))
    return p < _FLAT_P and share > least


def _sequence(
    left: Leftover,
    whitener: Whitens,
    residual_nT: FloatArray,
    fitted: FloatArray,
    setting: Setting,
    tone: Tone | None,
) -> BoolArray:
    """(N,) the likeliest two-state sequence."""
    rows = residual_nT.shape[0]
    white = whitener.apply(np.ascontiguousarray(fitted)).reshape(3 * rows, -1)
    target = whitener.apply(residual_nT).reshape(-1)
    rest = residual_nT - fitted @ np.linalg.lstsq(white, target, rcond=1e-10)[0] if white.shape[1] else residual_nT
    lagged = sum(rest[lag:].T @ rest[: rows - lag] for lag in (1, 2, 3))
    _, vectors = np.linalg.eigh(np.asarray(lagged + np.transpose(lagged)))
    directions = list(vectors.T)
    if tone is not None and tone.frequency_Hz > 0:
        # Two levels in turn have a line along their field.
        free, _ = left.project(tone_columns(setting.seconds, tone.frequency_Hz))
        waves = np.linalg.lstsq(free, left.residual, rcond=1e-9)[0].reshape(2, 3)
        directions.append(np.linalg.svd(waves)[2][0])
    first = [_viterbi(rest @ along, None, share) for along in directions for share in _SHARES]
    distinct = sorted({on.tobytes(): on for on in first}.values(), key=lambda on: -_worth(left, on))
    return max((_climbed(left, rest, on) for on in distinct[:_CLIMBED]), key=lambda on: _worth(left, on))


def _climbed(left: Leftover, rest: FloatArray, on: BoolArray) -> BoolArray:
    """(N,) the sequence that a first one leads to, in turn with the field; rest (N, 3) [nT]."""
    for _ in range(_ROUNDS):
        if not on.any() or on.all():
            break
        free, _ = left.project(on.astype(float)[:, None, None] * np.eye(3))
        field = np.linalg.lstsq(free, left.residual, rcond=1e-9)[0]
        centre = rest - np.outer(on - on.mean(), field)
        spread = np.cov(centre.T)
        again = _viterbi(rest @ np.linalg.solve(spread, field), on)
        if np.array_equal(again, on):
            break
        on = again
    return on


def _polished(left: Leftover, on: BoolArray) -> BoolArray:
    """The sequence with runs taken out and edges moved while it gets likelier.

    The search for it works row by row, where the slow error of the attitude looks like levels; this has the whitened
    likelihood.
    """
    edges = np.flatnonzero(on[1:] != on[:-1]) + 1
    if edges.size > _MOST_SWITCHES:
        return on
    best = _worth(left, on)
    for _ in range(_ROUNDS):
        before = best
        for change in _changes(on):
            trial = on.copy()
            trial[change] = ~trial[change]
            if np.array_equal(trial, on) or trial.all() or not trial.any():
                continue
            worth = _worth(left, trial)
            if worth > best:
                on, best = trial, worth
        if best - before < _BETTER:
            break
    return on


def _changes(on: BoolArray) -> list[slice]:
    """Rows to turn round: each run, and the rows beside each edge."""
    runs = dwells(on)
    edges = [run.start for run in runs[1:]]
    beside = [slice(max(edge + low, 0), edge + high) for edge in edges for low, high in _MOVES]
    return [*runs, *beside]


def _worth(left: Leftover, on: BoolArray) -> float:
    """Log likelihood of a sequence less its price."""
    free, _ = left.project(on.astype(float)[:, None, None] * np.eye(3))
    along = free.T @ left.residual
    gain = float(along @ np.linalg.pinv(free.T @ free, rcond=1e-9) @ along)
    switches = int(np.sum(on[1:] != on[:-1]))
    variance = (left.energy - gain) / max(left.degrees - 3 - switches, 1)
    return 0.5 * gain / variance - _price(on.size, switches)


def _price(rows: int, switches: int) -> float:
    """Logarithm of the number of sequences with so many switches."""
    return float(gammaln(rows + 1) - gammaln(switches + 1) - gammaln(rows - switches + 1))


def _viterbi(z: FloatArray, start: BoolArray | None, share: float = 0.5) -> BoolArray:
    """Best cut of a series into two levels with a price of log N a switch; levels and noise re-estimated in turn.

    start: where to begin; None: with this share of the rows in the lower level.
    """
    on = z > np.quantile(z, share) if start is None else start
    scale = 1.4826 * np.median(np.abs(np.diff(z))) / np.sqrt(2)
    for _ in range(10):
        if not on.any() or on.all():
            break
        low, high = float(z[~on].mean()), float(z[on].mean())
        noise = max(float(np.std(z - np.where(on, high, low))), 1e-3 * scale, 1e-12)
        again = _path(((z - low) ** 2 - (z - high) ** 2) / (2 * noise**2), float(np.log(z.size)))
        if np.array_equal(again, on):
            break
        on = again
    return on


def _path(gain: FloatArray, price: float) -> BoolArray:
    """States that maximise the sum of `gain` while on, less the price of each switch."""
    stay_off, stay_on = 0.0, 0.0
    from_on, from_off = np.zeros(gain.size, dtype=bool), np.zeros(gain.size, dtype=bool)
    for row, value in enumerate(gain.tolist()):
        from_on[row] = stay_on - price > stay_off
        from_off[row] = stay_off - price > stay_on
        off = stay_on - price if from_on[row] else stay_off
        stay_on = (stay_off - price if from_off[row] else stay_on) + value
        stay_off = off
    on = np.zeros(gain.size, dtype=bool)
    state = stay_on > stay_off
    for row in range(gain.size - 1, -1, -1):
        on[row] = state
        state = not from_off[row] if state else bool(from_on[row])
    return on


def _rivals(gain: float, variance: float, price: float, rows: int, rivals: Sequence[BlockFit]) -> list[str]:
    mine = gain / variance - 2 * price
    faults = []
    for one in rivals:
        theirs, rank = one.explained()
        if theirs / variance - rank * np.log(rows) > mine:
            faults.append(f"{one.block.label} does as well")
            break
    return faults


def _regularity(setting: Setting, on: BoolArray) -> float:
    """p-value of dwell times as regular as these for a random telegraph with as many switches."""
    sunlit = lit(setting) > 0.5
    changes = np.flatnonzero(on[1:] != on[:-1]) + 1
    observed = _scatter(setting.seconds, sunlit, changes, bool(on[0]))
    rng = np.random.default_rng(_SEED)
    below = 0
    for _ in range(_TELEGRAPHS):
        drawn = np.sort(rng.choice(np.arange(1, on.size), changes.size, replace=False))
        below += _scatter(setting.seconds, sunlit, drawn, bool(on[0])) <= observed
    return (below + 1) / (_TELEGRAPHS + 1)


def _scatter(seconds: FloatArray, sunlit: BoolArray, changes: np.ndarray, first: bool) -> float:
    """Mean squared relative scatter of the inner dwell times within each class (state, sun or shadow)."""
    lengths = np.diff(seconds[changes])
    middle = (changes[1:] + changes[:-1]) // 2
    states = np.logical_xor(np.arange(lengths.size) % 2 == 0, first)
    kinds = 2 * states + sunlit[middle]
    total, count = 0.0, 0
    for kind in np.unique(kinds):
        mine = lengths[kinds == kind]
        if mine.size >= 2:
            total += float(np.sum((mine / mine.mean() - 1) ** 2))
            count += mine.size - 1
    return total / count if count else np.inf
