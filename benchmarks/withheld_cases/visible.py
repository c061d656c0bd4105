"""How much of a truth is left once what is modelled has been re-estimated: `visible`, and scaling to it.

visible = rms per component of what the effect changes in reading minus prediction, after the regression of that on
the model field at the reported attitude and on 1 (whatever of the two is modelled), over the rms per component of the
noise. The chain is run without noise and without rounding, with the effect and without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from withheld_cases.chain import Clean, Truth, noise_free
from withheld_cases.worlds import World

_CLOSE_ENOUGH = 0.02


def noise_rms_nT(world: World) -> float:
    """Sensor noise, rounding and attitude error x field, rms per component."""
    budget = world.budget
    r_N_km, _ = world.where(world.time)
    square = float(np.mean(np.sum(world.real_field_N_nT(world.time, r_N_km) ** 2, axis=1)))
    attitude = 2.0 / 3.0 * budget.attitude_sigma_rad**2 * square
    return float(np.sqrt(budget.noise_nT**2 + budget.lsb_nT**2 / 12.0 + attitude))


def signature_nT(world: World, truths: Sequence[Truth], bare: Clean | None = None) -> FloatArray:
    """(N, 3) what the truths leave after the re-estimation; rows without attitude are zero."""
    bare = noise_free(world, ()) if bare is None else bare
    full = noise_free(world, truths)
    return left(world, (full.reading_nT - bare.reading_nT) - (full.predicted_nT - bare.predicted_nT), full)


def left(world: World, difference_nT: FloatArray, clean: Clean) -> FloatArray:
    """What the regression on the model field and 1 leaves of a difference, (N, 3)."""
    known = ~world.missing
    columns = [np.zeros((int(known.sum()), 0))]
    if "scale_misalignment" in world.modelled:
        columns.append(clean.predicted_nT[known] / 3e4)
    if "bias" in world.modelled:
        columns.append(np.ones((int(known.sum()), 1)))
    design = np.hstack(columns)
    remains = np.zeros_like(difference_nT)
    remains[known] = difference_nT[known]
    if design.shape[1]:
        remains[known] -= design @ np.linalg.lstsq(design, difference_nT[known], rcond=None)[0]
    return remains


def rms(world: World, remains: FloatArray) -> float:
    """Per component, over the rows with attitude."""
    return float(np.sqrt(np.mean(remains[~world.missing] ** 2)))


def visible(world: World, truths: Sequence[Truth], bare: Clean | None = None) -> float:
    """The figure, for truths that are signals."""
    return rms(world, signature_nT(world, truths, bare)) / noise_rms_nT(world)


def scaled(
    measure: Callable[[float], float], target: float, low: float, high: float, start: float
) -> tuple[float, float] | None:
    """The size at which `measure` is the target, and what it is there; None if no size from low to high does.

    measure grows with the size, at first in proportion. Secant steps in the logarithms.
    """
    size = float(np.clip(start, low, high))
    found = measure(size)
    if not np.isfinite(found) or found <= 0.0:
        return None
    slope, before = 1.0, (size, found)
    for _ in range(8):
        if abs(np.log(found / target)) < _CLOSE_ENOUGH:
            return size, found
        following = size * float(np.exp(np.clip(np.log(target / found) / slope, -3.0, 3.0)))
        if not low <= following <= high:
            return None
        before, size = (size, found), following
        found = measure(size)
        if not np.isfinite(found) or found <= 0.0:
            return None
        run = np.log(size / before[0])
        if abs(run) > 1e-6:
            slope = float(np.clip(np.log(found / before[1]) / run, 0.2, 5.0))
    return (size, found) if abs(np.log(found / target)) < 0.1 else None
