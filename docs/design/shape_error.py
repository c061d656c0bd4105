"""How far nature's form is from the catalogue's: what the right name leaves of truths with another shape.

    python docs/design/shape_error.py OUT [--count N]

Records are the population `shapes` of benchmarks/withheld.py (forward models that share nothing with the catalogue) at a
seed that no frozen run has; those of which the gap is more than 1,000 units of chi-square are used, where chance adds
little. The right effect is fitted in the nonlinear chain, and what it leaves is compared with every block of columns. The
most that a block explains, less its rank and less 2 log K for the best of K blocks, over the drop of chi-square by the
effect, is the square of `SHAPE_ERROR` of gap/selection/criterion.py; divided by the rank it is `SHAPE`.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from withheld_cases.cases import identity
from withheld_cases.make import make
from withheld_cases.store import Store

import fluxtwin
from fluxtwin.gap.hypotheses.blocks import blocks
from fluxtwin.gap.hypotheses.candidates import candidates
from fluxtwin.gap.linear.projection import ProjectedResidual, orthonormal
from fluxtwin.gap.noise.choice import choose_noise, whitener_of
from fluxtwin.gap.problem.problem import Budget, pose
from fluxtwin.gap.selection.forward import begin
from fluxtwin.gap.selection.refit import Readings, settled
from fluxtwin.sim.earth.field_models import load_field

SEED = 52001
LEAST_DROP = 1000.0


def shares(store: Store, name: str) -> tuple[str, float, float, float] | None:
    """Name, drop of chi-square, largest share of a block per direction, share of all blocks together; None: too small."""
    asked = store.read("asked", name)
    sealed = json.loads(store.path("sealed", name).read_text(encoding="utf-8"))
    truth = str(sealed["truths"][0]["name"])
    degrees = asked.get("attitude_sigma_deg")
    sigma_rad = None if degrees is None else float(np.radians(degrees))
    budget = Budget(asked.get("noise_nT"), asked.get("lsb_nT"), sigma_rad)
    model = load_field("igrf14")
    modelled = [one for one in asked.get("modelled") or ("bias", "scale_misalignment") if one != truth]
    problem = settled(pose(fluxtwin.read(store.path("telemetry", name)), model, modelled=modelled, budget=budget))
    found, _ = candidates(problem)
    noise, robust = choose_noise(problem)
    problem = replace(problem, attitude_found_rad=noise.theta_rad)
    search = begin(Readings(problem, whitener_of(problem, noise, robust.weights)), found)
    mine = [number for number, one in enumerate(search.found) if one.name == truth]
    fits = [search.fit([number], search.first.estimate([number])) for number in mine]
    if not fits:
        return None
    fit = min(fits, key=lambda one: one.chi2)
    drop = search.base.chi2 - fit.chi2
    if drop < LEAST_DROP:
        return None
    flat = fit.residual.reshape(-1)
    basis = orthonormal(fit.jacobian)
    left = ProjectedResidual(
        search.channel.whitener, flat - basis @ (basis.T @ flat), basis, flat.size - basis.shape[1]
    )
    each = [one.explained() for one in [fit(block, left) for block in blocks(problem)]]
    chance = 2.0 * float(np.log(len(each)))
    beyond = [(max(gain - rank - chance, 0.0) / drop, rank) for gain, rank in each if rank]
    return truth, drop, max(part / rank for part, rank in beyond), max(part for part, _ in beyond)


def main() -> int:
    """Make the records, and print a line for each and the quantiles."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=60)
    given = parser.parse_args()
    store = Store(given.out).prepared()
    rows = []
    for number in range(given.count):
        name = identity(SEED, "shapes", number)
        if not store.has("asked", name):
            make(str(given.out), SEED, "shapes", number, None)
        try:
            row = shares(store, name)
        except Exception as error:
            print(f"{number}: {type(error).__name__}: {error}", flush=True)
            continue
        if row is not None:
            rows.append(row[1:])
            print(f"{row[0]:28s} drop {row[1]:9.0f}, a direction {row[2]:8.5f}, a block {row[3]:7.4f}", flush=True)
    table = np.array(rows)
    for quantile in (0.5, 0.75, 0.9):
        one, whole = np.quantile(table[:, 1], quantile), np.quantile(table[:, 2], quantile)
        print(
            f"{100 * quantile:.0f} % of {len(rows)}: a direction {one:.5f}, amplitude of a block {np.sqrt(whole):.3f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
