"""What a campaign's runs amount to: do stated sigmas hold, how often is each effect named, what is named falsely."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from fluxtwin.sim.base.types import BoolArray, FloatArray

_NORMAL_95 = 1.959964
_BINS = 4
_LEAST = 8
"""Runs of an effect from which on a power is fitted."""
_POWER = 0.9


def summarise(name: str, seed: int, runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The summary as plain values. runs: of `campaigning.one_run`."""
    flown = [run for run in runs if not run["lost"]]
    asked = [run for run in flown if not run["diagnosis"]["why"]]
    bare = [run for run in asked if not run["effects"]]
    return {
        "name": name,
        "seed": seed,
        "runs": len(runs),
        "lost": _reasons([run["lost"] for run in runs]),
        "not_calibrated": _reasons([run["calibration"]["why"] for run in flown]),
        "not_diagnosed": _reasons([run["diagnosis"]["why"] for run in flown]),
        "sigmas": _sigmas(flown),
        "verdicts": dict(Counter(run["diagnosis"]["verdict"] for run in asked)),
        "without_effects": {"runs": len(bare), "no_gap": sum(run["diagnosis"]["verdict"] == "no_gap" for run in bare)},
        "effects": {effect: _power(effect, asked) for effect in sorted({e for run in asked for e in run["effects"]})},
        "false_names": dict(Counter(name for run in asked for name in _false_of(run)).most_common()),
        "diagnosed": len(asked),
    }


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927, J. Am. Stat. Assoc. 22, 209)."""
    from scipy.stats import binomtest

    low, high = binomtest(hits, of).proportion_ci(method="wilson") if of else (0.0, 1.0)
    return float(low), float(high)


def _reasons(words: Sequence[str]) -> dict[str, int]:
    return dict(Counter(word for word in words if word).most_common())


def _sigmas(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """By parameter: rms of error over sigma, and how many of the errors lie within 1.96 sigma; and the mean NEES per
    parameter, with its 95 % interval where all sigmas are right."""
    fits = [run["calibration"] for run in runs if not run["calibration"]["why"]]
    names = dict.fromkeys(name for fit in fits for name in fit["parameters"])
    out: dict[str, Any] = {}
    for name in names:
        pulls = np.array([np.divide(*fit["parameters"][name]) for fit in fits if name in fit["parameters"]])
        inside = int((np.abs(pulls) < _NORMAL_95).sum())
        out[name] = {
            "runs": pulls.size,
            "pull_rms": float(np.sqrt(np.mean(pulls**2))),
            "inside": inside,
            "interval": wilson(inside, pulls.size),
        }
    weighted = [fit for fit in fits if fit["nees"] is not None]
    if not weighted:
        return {"parameters": out, "nees": None, "nees_by_chance": None, "fits": len(fits)}
    from scipy.stats import chi2

    errors = sum(len(fit["parameters"]) for fit in weighted)
    return {
        "parameters": out,
        "nees": float(np.mean([fit["nees"] for fit in weighted])),
        "nees_by_chance": [float(chi2.ppf(share, errors)) / errors for share in (0.025, 0.975)],
        "fits": len(fits),
    }


def is_named(run: dict[str, Any], effect: str) -> bool:
    """Whether the answer of a run has the name, alone or in a group."""
    return any(_is(one, effect) for one in run["diagnosis"]["names"])


def _power(effect: str, runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How often an effect is named, by its size."""
    present = [run for run in runs if effect in run["effects"]]
    size = np.array([run["effects"][effect]["size"] for run in present])
    named = np.array([is_named(run, effect) for run in present])
    exact = [is_named(run, effect) and not _false_of(run) for run in present]
    order = np.argsort(size, kind="stable")
    bins = []
    for rows in np.array_split(order, min(_BINS, len(order))) if np.ptp(size) > 0 else [order]:
        hits = int(named[rows].sum())
        bins.append(
            {
                "from": float(size[rows].min()),
                "to": float(size[rows].max()),
                "runs": int(rows.size),
                "named": hits,
                "interval": wilson(hits, int(rows.size)),
            }
        )
    line = _logistic(size, named)
    return {
        "unit": present[0]["effects"][effect]["unit"],
        "runs": len(present),
        "named": int(named.sum()),
        "interval": wilson(int(named.sum()), len(present)),
        "nothing_else": int(sum(exact)),
        "bins": bins,
        "logistic": line,
        "size_at_90_percent": _size_at(line, size),
    }


def _is(one: dict[str, Any], name: str) -> bool:
    return name == one["name"] or name in one["group"]


def _logistic(size: FloatArray, named: BoolArray) -> tuple[float, float] | None:
    """Intercept and slope of the log odds over the logarithm of the size; None where the runs do not determine them.

    With Jeffreys' prior, so that the estimate stays finite where sizes separate the named from the others (Firth 1993,
    Biometrika 80, 27).
    """
    if size.size < _LEAST or named.all() or not named.any() or np.ptp(np.log(size)) < 1e-6:
        return None
    from scipy.optimize import minimize

    x = np.column_stack([np.ones(size.size), np.log(size) - np.log(size).mean()])

    def cost(p: FloatArray) -> float:
        z = x @ p
        weight = np.exp(-np.abs(z)) / (1.0 + np.exp(-np.abs(z))) ** 2
        _, volume = np.linalg.slogdet(x.T @ (x * weight[:, None]))
        return float(np.sum(np.logaddexp(0.0, np.where(named, -z, z))) - 0.5 * volume)

    best = minimize(cost, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6}).x
    return float(best[0] - best[1] * np.log(size).mean()), float(best[1])


def _size_at(line: tuple[float, float] | None, size: FloatArray) -> float | None:
    """The size that is named in 90 % of runs; None where the line falls, or meets that far beyond what was flown."""
    if line is None or line[1] <= 0:
        return None
    found = float(np.exp((np.log(_POWER / (1.0 - _POWER)) - line[0]) / line[1]))
    return found if size.min() / 2.0 <= found <= 2.0 * size.max() else None


def _false_of(run: dict[str, Any]) -> list[str]:
    """Names that were given where neither they nor any of their group are in the run."""
    return [one["name"] for one in run["diagnosis"]["names"] if not any(_is(one, effect) for effect in run["effects"])]
