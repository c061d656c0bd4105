"""Short arcs of free flight, compiled: many starts at once, each beside its own recorded wheels and torquers.

Unlike the flight of `kernels` an arc takes the momentum of the wheels and the dipole of the torquers as they are given,
step by step, and knows no control law. The state is the attitude matrix and the whole momentum in N.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics import kernels, layout
from fluxtwin.sim.spacecraft.dynamics.kernels import OPTIONS, PART, PARTS, torque_chain
from fluxtwin.sim.spacecraft.dynamics.layout import DIPOLE, FIELD, FIELD_N, POSITION, RATE, ROTATION, STAGE_SIZE, TORQUE

_SURROUNDINGS = layout.FIELD - layout.POSITION
_SIZE = 12
"""R_BN row by row, and the momentum in N."""


@kernel(uses=[kernels, *PARTS], nogil=True, **OPTIONS)
def fly_arcs(
    state: FloatArray,
    inverse: FloatArray,
    packed: FloatArray,
    slots: Any,
    around: FloatArray,
    wheels: FloatArray,
    dipole: FloatArray,
    step_s: FloatArray,
) -> None:
    """Lead A states (A, 12) on in place, by m rows of (2 parts + 1) instants: classical Runge-Kutta of order four.

    inverse (3, 3): of the inertia tensor. packed, slots: torques, as in `kernels.fly`. around (A, m, 2 parts + 1, 14):
    surroundings at the starts, middles and ends of all steps. wheels, dipole (m, 2 parts + 1, A, 3): momentum of the
    wheels in B [N m s] and dipole of the torquers [A m2] there. step_s (A, m): of one step.
    """
    stage, trial = np.zeros(STAGE_SIZE), np.empty(_SIZE)
    slope, total = np.empty(_SIZE), np.empty(_SIZE)
    parts = (around.shape[2] - 1) // 2
    body = inverse, packed, slots
    for a in range(state.shape[0]):
        for row in range(around.shape[1]):
            h = step_s[a, row]
            for number in range(parts):
                for k in range(_SIZE):
                    total[k], slope[k] = 0.0, 0.0
                for order in range(4):
                    reach = 0.0 if order == 0 else h if order == 3 else 0.5 * h
                    weight = 1.0 if order == 0 or order == 3 else 2.0
                    at = 2 * number + (order + 1) // 2
                    for k in range(_SIZE):
                        trial[k] = state[a, k] + reach * slope[k]
                    given = around[a, row, at], wheels[row, at, a], dipole[row, at, a]
                    _slope(trial, body, given, stage, slope)
                    for k in range(_SIZE):
                        total[k] += weight * slope[k]
                for k in range(_SIZE):
                    state[a, k] += h / 6.0 * total[k]


@part(**PART)
def _slope(state: FloatArray, body: Any, given: Any, stage: FloatArray, slope: FloatArray) -> None:
    """-[w x] R and R^T torque; J w is the momentum less that of the wheels."""
    inverse, packed, slots = body
    around, wheels, dipole = given
    for k in range(9):
        stage[ROTATION + k] = state[k]
    for k in range(_SURROUNDINGS):
        stage[POSITION + k] = around[k]
    hx = state[0] * state[9] + state[1] * state[10] + state[2] * state[11] - wheels[0]
    hy = state[3] * state[9] + state[4] * state[10] + state[5] * state[11] - wheels[1]
    hz = state[6] * state[9] + state[7] * state[10] + state[8] * state[11] - wheels[2]
    for k in range(3):
        stage[RATE + k] = inverse[k, 0] * hx + inverse[k, 1] * hy + inverse[k, 2] * hz
        stage[FIELD + k] = 0.0
        for j in range(3):
            stage[FIELD + k] += state[3 * k + j] * stage[FIELD_N + j]
        stage[DIPOLE + k] = dipole[k]
        stage[TORQUE + k] = 0.0
    torque_chain(slots, packed, stage)
    x, y, z = stage[RATE], stage[RATE + 1], stage[RATE + 2]
    for j in range(3):
        slope[j] = z * state[3 + j] - y * state[6 + j]
        slope[3 + j] = x * state[6 + j] - z * state[j]
        slope[6 + j] = y * state[j] - x * state[3 + j]
        slope[9 + j] = stage[TORQUE] * state[j] + stage[TORQUE + 1] * state[3 + j] + stage[TORQUE + 2] * state[6 + j]
