"""Shares with their intervals, and how well stated probabilities are borne out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.sim.base.types import FloatArray

_Z95 = 1.959963984540054


def wilson(right: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    p, z2 = right / of, _Z95**2
    middle = (p + z2 / (2 * of)) / (1 + z2 / of)
    half = _Z95 / (1 + z2 / of) * np.sqrt(p * (1 - p) / of + z2 / (4 * of**2))
    return float(max(0.0, middle - half)), float(min(1.0, middle + half))


def calibration_error(stated: Sequence[float], came_true: Sequence[bool], bins: int = 10) -> float:
    """Mean over bins of equal count, weighted by count, of |mean stated probability - share that came true|."""
    p, hit = np.asarray(stated, dtype=np.float64), np.asarray(came_true, dtype=np.float64)
    if p.size == 0:
        return float("nan")
    order = np.argsort(p, kind="stable")
    parts = np.array_split(order, min(bins, p.size))
    return float(sum(abs(p[part].mean() - hit[part].mean()) * part.size for part in parts) / p.size)


def reliability(stated: Sequence[float], came_true: Sequence[bool], bins: int = 10) -> list[tuple[float, float, int]]:
    """Mean stated probability, share that came true and count of each bin."""
    p, hit = np.asarray(stated, dtype=np.float64), np.asarray(came_true, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    parts = [part for part in np.array_split(order, min(bins, max(1, p.size))) if part.size]
    return [(float(p[part].mean()), float(hit[part].mean()), int(part.size)) for part in parts]


def brier(stated: Sequence[float], came_true: Sequence[bool]) -> tuple[float, float]:
    """Brier score, and that of stating the base rate always."""
    p, hit = np.asarray(stated, dtype=np.float64), np.asarray(came_true, dtype=np.float64)
    if p.size == 0:
        return float("nan"), float("nan")
    return float(np.mean((p - hit) ** 2)), float(hit.mean() * (1.0 - hit.mean()))


def median(values: Sequence[float]) -> float:
    """Median; NaN of nothing."""
    array: FloatArray = np.asarray(values, dtype=np.float64)
    return float(np.median(array)) if array.size else float("nan")
