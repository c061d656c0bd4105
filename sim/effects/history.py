"""Answers that depend on what came before: relaxation, what the body has seen, and the play of a hysteresis loop.

All run along the rows once, in kernels that are compiled when first used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from fluxtwin.sim.attitude.smoothed_track import RowArray
from fluxtwin.sim.base.late import restarts
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.effects.signal import Signal

_TURN_RAD = 0.3  # between two moments: cubics through values and slopes follow it to 2e-5 of the field
_MOST_PARTS = 64


def relax(seconds: FloatArray, goal: FloatArray, time_constant_s: float, *, start: float) -> FloatArray:
    """(N,) what follows `goal` (N,) with a time constant; between stamps the goal is the mean of both ends."""
    from fluxtwin.sim.base.recursion_kernels import recursion

    keep = np.exp(-np.diff(seconds, prepend=seconds[0]) / time_constant_s)
    between = 0.5 * (goal + np.concatenate([goal[:1], goal[:-1]]))
    first = np.zeros(seconds.size, dtype=np.bool_)
    first[0] = True
    followed: FloatArray = recursion(keep, ((1.0 - keep) * between)[:, None], np.full((seconds.size, 1), start), first)
    return followed[:, 0]


def play(signal: FloatArray, half_width: float, neutral: FloatArray) -> FloatArray:
    """Play operator (N, k): the output stays where it is until the input pushes it, half_width away.

    y_t = min(max(y_(t-1), x_t - w), x_t + w) (Visintin 1994, Differential Models of Hysteresis, section III.2),
    from y = neutral (k,) before the first row.
    """
    from fluxtwin.sim.base.recursion_kernels import played

    return np.asarray(played(np.ascontiguousarray(signal), half_width, np.asarray(neutral, dtype=np.float64)))


@dataclass(frozen=True, eq=False)
class FieldHistory:
    """The ambient field as the body has seen it, at M moments: the N stamps and, where it turns far in a step, between them.

    Along the smoothed track of the attitude, not the recorded one: the errors of the rows before are no motion.
    """

    time_s: FloatArray
    """(M,) since the first stamp."""
    along_B_nT: FloatArray
    """(M, 3) the field in the body axes of the track."""
    slope_B_nT_s: FloatArray
    """(M, 3) its rate of change there."""
    restart: BoolArray
    """(M,) True where nothing is known of what came before."""
    stamps: RowArray
    """(N,) which of the moments are stamps."""
    turning_B_rad_s: FloatArray
    """(N, 3) body rate at the stamps."""
    changing_B_nT_s: FloatArray
    """(N, 3) rate of change at the stamps by the way along the orbit alone."""

    def closely(self, parts: int) -> tuple[FloatArray, FloatArray, RowArray]:
        """Each step from moment to moment in so many parts: times (K,), the field (K, 3) by cubics through values and
        slopes, and which of them are stamps (N,)."""
        step = np.where(self.restart, 0.0, np.diff(self.time_s, prepend=self.time_s[0]))
        shares = np.arange(1, parts) / parts
        between = [_cubic(self.along_B_nT, self.slope_B_nT_s, step, share)[0] for share in shares]
        between = [np.where(self.restart[:, None], self.along_B_nT, one) for one in between]
        times = [self.time_s - (1.0 - share) * step for share in shares]
        field = np.stack([*between, self.along_B_nT], axis=1).reshape(-1, 3)
        return np.stack([*times, self.time_s], axis=1).reshape(-1), field, parts * (self.stamps + 1) - 1

    def steady_B_nT(self, lag_s: float) -> FloatArray:
        """(M, 3) at the stamps: what a low-pass shows if the body has turned at this rate since long ago.

        tau y' + y = x with y' = -w cross y + c has y = (1 - tau [w x])^-1 (x - tau c): late where tau w is small,
        small where it is large.
        """
        turn = lag_s * self.turning_B_rad_s
        goal = self.along_B_nT[self.stamps] - lag_s * self.changing_B_nT_s
        along = np.einsum("nc,nc->n", turn, goal)[:, None] * turn
        square = np.einsum("nc,nc->n", turn, turn)[:, None]
        found = np.zeros_like(self.along_B_nT)
        found[self.stamps] = (goal + np.cross(turn, goal) + along) / (1.0 + square)
        return found


def field_history(signal: Signal) -> FieldHistory:
    """What the body has seen, from the field stage on."""
    return signal.of_ambient("field_history", partial(_field_history, signal))


def _field_history(signal: Signal) -> FieldHistory:
    setting, track = signal.setting, signal.R_track_BN
    again = restarts(setting.seconds)
    step = np.where(again, 0.0, np.diff(setting.seconds, prepend=setting.seconds[0]))
    rate, along = setting.rates(signal.sample_offset_s)
    field = track.apply(signal.ambient_N_nT)
    changing = track.apply(along)
    slope = changing - np.cross(rate, field)
    # Into how many parts each step is cut: by the turn that all but one in a hundred steps stay below.
    turns = np.linalg.norm(rate, axis=1) * step
    parts = int(np.clip(np.ceil(np.quantile(turns, 0.99) / _TURN_RAD), 1, _MOST_PARTS))
    if parts == 1:
        stamps = np.arange(signal.rows, dtype=np.intp)
        return FieldHistory(setting.seconds, field, slope, again, stamps, rate, changing)
    turned = frames.product(track, setting.track(signal.sample_offset_s).inv())  # by effects on the attitude of the row
    moments = []
    for number, (moment_s, there, turning) in enumerate(setting.within_steps(signal.sample_offset_s, step, parts), 1):
        field_N, slope_N = _cubic(signal.ambient_N_nT, along, step, number / parts)
        R_BN = frames.product(turned, there)
        between = R_BN.apply(field_N)
        slope_B = R_BN.apply(slope_N) - np.cross(turning, between)
        moments.append((setting.seconds + moment_s - signal.sample_offset_s, between, slope_B))
    seconds = np.stack([*(one[0] for one in moments), setting.seconds], axis=1)
    known = np.ones(seconds.shape, dtype=np.bool_)
    known[again, :-1] = False
    return FieldHistory(
        seconds[known],
        np.stack([*(one[1] for one in moments), field], axis=1)[known],
        np.stack([*(one[2] for one in moments), slope], axis=1)[known],
        np.stack([*(np.zeros_like(again) for _ in moments), again], axis=1)[known],
        np.cumsum(known.sum(axis=1)) - 1,
        rate,
        changing,
    )


def _cubic(value: FloatArray, slope: FloatArray, step_s: FloatArray, share: float) -> tuple[FloatArray, FloatArray]:
    """The cubic with these values and slopes (N, 3) at both ends of the step before each row, and its slope."""
    h = step_s[:, None]
    left, left_slope = np.concatenate([value[:1], value[:-1]]), np.concatenate([slope[:1], slope[:-1]])
    rise = (value - left) / np.where(h > 0.0, h, 1.0)
    bend, twist = 3.0 * rise - 2.0 * left_slope - slope, left_slope + slope - 2.0 * rise
    found = left + h * share * (left_slope + share * (bend + share * twist))
    return found, left_slope + share * (2.0 * bend + 3.0 * share * twist)
