"""The linear calibration against one numpy.sum pass over its arrays: same arrays, same run, one core.

    python benchmarks/calibration_linear.py [--samples N] [--repeats R] [--quick] [--json FILE|-]

Two arrays of N x 3: the reading B and the reference field A B0, spread as along Seasat's orbits. `sum` is
numpy.sum of each array as it lies in memory, the cheapest pass there is; `sum, by column` is numpy.sum(axis=0), which
numpy does far slower on three columns. `regression` is `calib.regression.regress`: S, b, <B|B> and the residual
covariance, all that the parameters and their white covariance need. `residuals` writes the N x 3 residuals. `whole`
is `calib.linear.fit_design`: the tests of excitation, the correction for noise in the reading, the sandwich
covariance, statistics and words as well; `whole, blocks` with the covariance that allows for correlated errors.
`numpy qr` is plain Householder QR of the full design. Each
repeat runs every contestant once, in turn; medians of processor time count. The answers are compared with numpy's QR.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import platform
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.common.regression import regress, residuals
from fluxtwin.calib.linear.calibrate import fit_design
from fluxtwin.sim.base import files

WANTED_RATIO = 15.0
AGREEMENT = 1e-9


def arrays(samples: int) -> Design:
    """Random rows with the spread of four Seasat orbits and the final calibration of the papers."""
    rng = np.random.default_rng(1979)
    field = rng.normal(size=(samples, 3)) * np.array([14_700.0, 3_000.0, 29_700.0]) + np.array([0.0, 6900.0, 0.0])
    S = np.array([[0.021, -0.016, 0.004], [0.013, -0.022, -0.004], [0.007, -0.003, 0.002]])
    reading = (field - np.array([7150.0, -2810.0, -6120.0])) @ np.linalg.inv(np.eye(3) + S).T
    reading += rng.normal(size=reading.shape) * 370.0
    stamps = np.datetime64("1978-07-24", "ns") + np.arange(samples) * np.timedelta64(1, "s")
    return Design(stamps, reading, field, {}, np.arange(samples), {})


def numpy_qr(design: Design) -> np.ndarray:
    """(4, 3) slopes and intercept by numpy's QR of the full design."""
    rows = np.hstack([design.B_nT, np.ones((len(design), 1))])
    Q, R = np.linalg.qr(rows)
    return np.asarray(np.linalg.solve(R, Q.T @ design.H_nT))


def contestants(design: Design) -> dict[str, Callable[[], Any]]:
    """What is timed."""
    B, H = design.B_nT, design.H_nT
    white = LinearOptions(noise_nT=370.0, lsb_nT=0.0, covariance="white", robust="none")
    correlated = LinearOptions(noise_nT=370.0, lsb_nT=0.0, covariance="blocks", robust="none")
    return {
        "sum": lambda: (np.sum(B), np.sum(H)),
        "sum, by column": lambda: (np.sum(B, axis=0), np.sum(H, axis=0)),
        "regression": lambda: regress(H, [B]),
        "residuals": lambda: residuals(H, [B], np.eye(3), np.ones(3)),
        "whole": lambda: fit_design(design, white),
        "whole, blocks": lambda: fit_design(design, correlated),
        "numpy qr": lambda: numpy_qr(design),
    }


def measure(samples: int, repeats: int) -> dict[str, Any]:
    """Medians, ratios and the largest disagreement with QR."""
    design = arrays(samples)
    runs = contestants(design)
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for repeat in range(repeats + 1):  # the first round warms caches and is not counted
        for name, run in runs.items():
            start = time.process_time()
            run()
            if repeat:
                seconds[name].append(time.process_time() - start)
    median = {name: statistics.median(values) for name, values in seconds.items()}
    ours, witness = regress(design.H_nT, [design.B_nT]), numpy_qr(design)
    disagreement = max(
        float(np.abs(ours.M - witness[:3].T).max()), float(np.abs(ours.c - witness[3]).max() / np.abs(witness[3]).max())
    )
    return {
        "samples": samples,
        "repeats": repeats,
        "median_s": median,
        "ratio_to_sum": {name: value / median["sum"] for name, value in median.items()},
        "ratio_to_sum_by_column": {name: value / median["sum, by column"] for name, value in median.items()},
        "largest_disagreement_with_qr": disagreement,
        "wanted": {"ratio_to_sum": WANTED_RATIO, "disagreement": AGREEMENT},
        "machine": {"python": platform.python_version(), "numpy": np.__version__, "cpu": platform.machine()},
    }


def show(result: dict[str, Any]) -> str:
    """A table for people."""
    lines = [f"{result['samples']:,} samples, median of {result['repeats']} interleaved runs, one core"]
    lines.append(f"{'':16}{'ms':>10}{'x sum':>10}{'x sum by column':>18}")
    for name, value in result["median_s"].items():
        ratios = result["ratio_to_sum"][name], result["ratio_to_sum_by_column"][name]
        lines.append(f"{name:16}{value * 1e3:10.2f}{ratios[0]:10.1f}{ratios[1]:18.2f}")
    lines.append(f"agrees with numpy's QR to {result['largest_disagreement_with_qr']:.1e}")
    return "\n".join(lines)


def main() -> int:
    """Run and print; 1 when the answers disagree with QR (the ratio is printed, never judged)."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="20,000 samples, two repeats: does it run?")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; - is standard output")
    arguments = parser.parse_args()
    samples, repeats = (20_000, 2) if arguments.quick else (arguments.samples, arguments.repeats)
    result = measure(samples, repeats)
    if arguments.json == "-":
        sys.stdout.write(files.to_json(result))
    else:
        print(show(result))
        if arguments.json:
            files.write_json(arguments.json, result)
    return 0 if result["largest_disagreement_with_qr"] < AGREEMENT else 1


if __name__ == "__main__":
    raise SystemExit(main())
