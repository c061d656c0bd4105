"""Are the stated sigmas right? Errors over sigmas of many simulated records, with the default options.

    python benchmarks/sigmas.py [--seeds N] [--case NAME ...] [--jobs N] [--quick] [--json FILE|-]

Each case is the scenario of README.md with what its name says; a seed draws noise and attitude error anew, and where in
a step of the sensor the bias lies (without noise the same orbit would be rounded alike by every seed). The fit is asked
for as a user would: no noise, no attitude error is declared unless the name says so. For each case:

  pull    standard deviation (about nought) of errors over sigmas: least and greatest over the parameters, and all;
          reach 0.9 to 1.15
  95 %    share of errors within 1.96 sigma: least, greatest, all; reach 92 to 98 %
  NEES    mean of e' C^-1 e over the number of parameters, C the whole covariance; reach 0.85 to 1.2

With 1,000 seeds a pull is known to 2.2 %, a share to 0.7 %, the NEES to 1 % or worse.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import copy
import sys
import time
import tomllib
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fluxtwin.calib.attitude.recursive import calibrate_recursive
from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.gyro.calibrate import calibrate_gyro
from fluxtwin.calib.gyro.solve import BASIS_S
from fluxtwin.calib.linear.calibrate import fit_design
from fluxtwin.calib.scalar.calibrate import ScalarOptions, fit_rows
from fluxtwin.calib.spin.calibrate import SpinOptions, fit_spin
from fluxtwin.calib.spin.rows import assemble_spin
from fluxtwin.scenarios.st5 import mission
from fluxtwin.sim.base import files
from fluxtwin.sim.base.toml_input import validate
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.frames import rotation_from_q
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

README = Path(__file__).resolve().parents[1] / "README.md"
RADIAN_S = 933.0
FIRST_SEED = 5000
"""So that no seed is one that anything was chosen with."""
Tree = dict[str, Any]


class Case(NamedTuple):
    """One row of the table."""

    words: str
    change: Callable[[Tree], None]
    """Of the scenario in README.md."""
    method: str = "linear"
    options: dict[str, Any] = {}
    drawn_tau_s: tuple[float, float] | None = None
    """Each seed draws the time constant of the attitude error, evenly in its logarithm, as the priors have it."""
    outliers: float = 0.0
    """Share of rows with an outlier of 0.5 to 5 uT."""


def attitude(sigma_deg: float, tau_s: float) -> Callable[[Tree], None]:
    """Error of the reference attitude."""

    def change(tree: Tree) -> None:
        tree["attitude"]["reference"] = {"sigma_deg": sigma_deg, "tau_s": tau_s}

    return change


def declared(sigma_deg: float, tau_s: float) -> dict[str, float]:
    """As the options of a calibration."""
    return {"attitude_sigma_deg": sigma_deg, "attitude_tau_s": tau_s}


def sensor(noise_nT: float, lsb_nT: float) -> Callable[[Tree], None]:
    """Noise and step of the reading."""

    def change(tree: Tree) -> None:
        tree["magnetometer"].update(noise_nT=noise_nT, lsb_nT=lsb_nT)

    return change


def lasting(minutes: float) -> Callable[[Tree], None]:
    """Length of the record."""

    def change(tree: Tree) -> None:
        tree["schedule"]["segments"][0]["duration_min"] = minutes

    return change


def torquers(tree: Tree) -> None:
    """Three torquers that switch at random, and what couples from them into the reading."""
    tree["magnetometer"]["T_nT_per_Am2"] = [[20.0, 3.0, -2.0], [-4.0, 15.0, 1.0], [2.0, -3.0, 25.0]]
    tree["torquers"] = {"dipole_Am2": 5.0, "positions_m": [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]]}


def tumbling(tree: Tree) -> None:
    """So that |B| alone determines S."""
    tree["spacecraft"]["inertia_kg_m2"] = [[0.05, 0.0, 0.0], [0.0, 0.06, 0.0], [0.0, 0.0, 0.04]]
    tree["attitude"] = {"mode": "tumble", "rate_deg_s": [0.12, 0.08, 0.2], "reference": tree["attitude"]["reference"]}


def without_S(tree: Tree) -> None:
    """Tumbling, for a method that estimates b alone."""
    tumbling(tree)
    tree["magnetometer"]["S"] = np.zeros((3, 3)).tolist()


def gyro(tree: Tree) -> None:
    """Just released: two degrees per second for an hour, a row every four seconds, a gyro of 0.02 deg/s."""
    tumbling(tree)
    tree["attitude"] = {"mode": "tumble", "rate_deg_s": [1.5, 0.8, -1.1]}
    tree["gyro"] = {"bias_deg_h": [30.0, -20.0, 10.0], "noise_deg_s": 0.02}
    segment = tree["schedule"]["segments"][0]
    tree["schedule"]["segments"][0] = {"start_utc": segment["start_utc"], "samples": 900, "step_s": 4.0}


def as_it_is(tree: Tree) -> None:
    """README's."""


CASES: dict[str, Case] = {
    "readme": Case("README's scenario: 0.1 deg over 300 s", as_it_is),
    "forward": Case("the same, method forward", as_it_is, "forward"),
    "torquers": Case("torquers, b,S,T", torquers, options={"parameters": "b,S,T"}),
    "lsb50": Case("step 50 nT, no noise", sensor(0.0, 50.0)),
    "lsb500": Case("step 500 nT, no noise", sensor(0.0, 500.0)),
    "outliers": Case("1 % outliers of 0.5 to 5 uT", as_it_is, outliers=0.01),
    "short": Case("30 min", lasting(30.0)),
    "short-drawn": Case(
        "30 min, time constant drawn between 10 s and 30 min", lasting(30.0), drawn_tau_s=(10.0, 1800.0)
    ),
    "orbit": Case("one orbit, 97 min", lasting(97.0)),
    "slow": Case("attitude 0.3 deg over 1500 s", attitude(0.3, 1500.0)),
    "slow-declared": Case("the same, declared", attitude(0.3, 1500.0), options=declared(0.3, 1500.0)),
    "slower": Case("attitude 0.5 deg over 6000 s", attitude(0.5, 6000.0)),
    "slower-declared": Case("the same, declared", attitude(0.5, 6000.0), options=declared(0.5, 6000.0)),
    "drawn": Case(
        "attitude 0.5 deg, time constant drawn between 10 s and 5 h", attitude(0.5, 300.0), drawn_tau_s=(10.0, 18_000.0)
    ),
    "white": Case("attitude 0.1 deg, white", attitude(0.1, 0.0)),
    "scalar": Case("tumbling, method scalar", tumbling, "scalar"),
    "twostep": Case("tumbling, method twostep", tumbling, "twostep"),
    "center": Case("tumbling, no S, method center", without_S, "center"),
    "gyro": Case("tumbling at 2 deg/s for an hour, method gyro", gyro, "gyro"),
    "recursive": Case("README's scenario, method recursive", as_it_is, "recursive"),
    "batch": Case("ST5, 15 min, method batch", as_it_is, "batch"),
    "iterative": Case("ST5, 15 min, method iterative", as_it_is, "iterative"),
}
SPINNING = ("batch", "iterative")
QUICK = ("readme", "slow", "scalar")


class Answer(NamedTuple):
    """Of one record."""

    error: np.ndarray
    """(P,)."""
    covariance: np.ndarray
    """(P, P)."""
    names: tuple[str, ...]


class Flown:
    """Records of one case, one for each seed; the orbit and the field are worked out once."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.tree = tomllib.loads(README.read_text(encoding="utf-8").split("```toml")[1].split("```")[0])
        case.change(self.tree)
        self.world: World | None = None
        if case.method in SPINNING:
            segment = {"start_utc": "2006-04-15T00:00:00Z", "samples": 7200, "step_s": 0.125}
            self.spinner = mission.scenario().updated({"schedule.segments": [segment]})
            self.world = build_world(self.spinner)

    def __call__(self, seed: int) -> Answer:
        """Simulate, calibrate, compare."""
        return self._spinning(seed) if self.case.method in SPINNING else self._flying(seed)

    def _flying(self, seed: int) -> Answer:
        tree = copy.deepcopy({**self.tree, "seed": seed})
        sensor = tree["magnetometer"]
        within = np.random.default_rng([11, seed]).uniform(-0.5, 0.5, 3) * sensor["lsb_nT"]
        sensor["b_nT"] = (np.asarray(sensor["b_nT"]) + within).tolist()
        if self.case.drawn_tau_s is not None:
            low, high = np.log(self.case.drawn_tau_s)
            tree["attitude"]["reference"]["tau_s"] = float(np.exp(np.random.default_rng([13, seed]).uniform(low, high)))
        scenario = validate(tree, Scenario, where=self.case.words)
        self.world = build_world(scenario) if self.world is None else self.world
        telemetry, truth = simulate(scenario, world=self.world)
        B_nT = with_outliers(telemetry.mag_B_nT, self.case.outliers, np.random.default_rng([7, seed]))
        M, b_nT = np.eye(3) + truth.S, truth.b_nT
        if self.case.method == "recursive":
            known = calibrate_recursive(telemetry.replace(mag_B_nT=B_nT), load_field("igrf14")).calibration
            return of_estimated(known.values - np.append(truth.S.ravel(), b_nT), known.covariance, known.names)
        if self.case.method in ("linear", "forward"):
            known = self._linear(telemetry, B_nT).calibration
            values = np.concatenate(
                [truth.S.ravel(), b_nT, *([truth.T_nT_per_Am2.ravel()] if known.T_nT_per_Am2 is not None else [])]
            )
            return of_estimated(known.values - values, known.covariance, known.names)
        if self.case.method == "gyro":
            known = calibrate_gyro(telemetry.replace(mag_B_nT=B_nT), load_field("igrf14")).calibration
            return without_scale(known, M, b_nT)
        rows = Design(
            time=telemetry.time,
            B_nT=B_nT,
            H_nT=np.linalg.norm(self.world.field_N_nT, axis=1),
            columns={},
            rows=np.arange(len(telemetry)),
            left_out={},
            radian_s=RADIAN_S,
        )
        known = fit_rows(rows, ScalarOptions(method=self.case.method, robust="tukey")).calibration
        U, s, V = np.linalg.svd(M)  # |B| does not tell the rotation: M = O P
        P, turn = V.T @ np.diag(s) @ V, U @ V
        error = np.concatenate([(known.S - (P - np.eye(3))).ravel(), known.b_nT - turn.T @ b_nT])
        once = [0, 4, 8, 1, 2, 5, 9, 10, 11]
        return of_estimated(error[once], known.covariance[np.ix_(once, once)], tuple(known.names[k] for k in once))

    def _linear(self, telemetry: Telemetry, B_nT: np.ndarray) -> Fit:
        assert self.world is not None and telemetry.q_NB is not None
        H_nT = rotation_from_q(telemetry.q_NB).apply(self.world.field_N_nT)
        options = LinearOptions(method=self.case.method, robust="tukey", **self.case.options)
        dipole = telemetry.dipole_B_Am2 if "T" in options.parameters else None
        return fit_design(Design(telemetry.time, B_nT, H_nT, {}, np.arange(len(B_nT)), {}, RADIAN_S, dipole), options)

    def _spinning(self, seed: int) -> Answer:
        flight = mission.fly(self.spinner.updated({"seed": seed}), self.world)
        known = fit_spin(
            assemble_spin(flight.telemetry, load_field("igrf14")), SpinOptions(method=self.case.method)
        ).calibration
        error = known.values - np.concatenate([flight.truth.S.ravel(), flight.truth.b_nT])
        return of_estimated(error, known.covariance, known.names)


def without_scale(known: Calibration, M: np.ndarray, b_nT: np.ndarray) -> Answer:
    """Of b, and of S along eight directions without a trace: the scale common to all axes is not observable."""
    scale = np.trace(M) / 3.0
    e = known.values - np.concatenate([(M / scale - np.eye(3)).ravel(), b_nT / scale])
    down = np.zeros((11, 12))
    down[:8, :9], down[8:, 9:] = np.linalg.pinv(BASIS_S), np.eye(3)
    names = (*(f"direction {k + 1} of S" for k in range(8)), *known.names[9:12])
    return Answer(down @ e, down @ known.covariance @ down.T, names)


def with_outliers(B_nT: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Readings of which a share is off by 0.5 to 5 uT in any direction."""
    at = np.flatnonzero(rng.uniform(size=len(B_nT)) < share)
    way = rng.normal(size=(at.size, 3))
    out = B_nT.copy()
    out[at] += way / np.linalg.norm(way, axis=1)[:, None] * rng.uniform(500.0, 5000.0, size=(at.size, 1))
    return out


def of_estimated(error: np.ndarray, covariance: np.ndarray, names: tuple[str, ...]) -> Answer:
    """Without parameters that were not estimated."""
    at = np.flatnonzero(np.diag(covariance) > 0)
    return Answer(error[at], covariance[np.ix_(at, at)], tuple(names[k] for k in at))


def score(answers: list[Answer]) -> dict[str, Any]:
    """What the table shows of a case."""
    pulls, nees = [], []
    for one in answers:
        sigma = np.sqrt(np.diag(one.covariance))
        pull = one.error / sigma
        pulls.append(pull)
        nees.append(float(pull @ np.linalg.solve(one.covariance / np.outer(sigma, sigma), pull)) / len(pull))
    square, inside = np.array(pulls) ** 2, np.abs(pulls) < 1.96
    each, share = np.sqrt(square.mean(axis=0)), inside.mean(axis=0)
    names = answers[0].names
    return {
        "seeds": len(answers),
        "pull": dict(zip(names, each.tolist(), strict=True)),
        "pull_all": float(np.sqrt(square.mean())),
        "share": dict(zip(names, share.tolist(), strict=True)),
        "share_all": float(inside.mean()),
        "largest": float(np.sqrt(square.max())),
        "nees": float(np.mean(nees)),
        "nees_median": float(np.median(nees)),
    }


def run_case(name: str, seeds: int, first: int = FIRST_SEED) -> dict[str, Any]:
    """All seeds of a case."""
    begin, fly = time.perf_counter(), Flown(CASES[name])
    found = score([fly(first + seed) for seed in range(seeds)])
    return {"case": name, "words": CASES[name].words, **found, "seconds": time.perf_counter() - begin}


def misses(one: dict[str, Any]) -> list[str]:
    """Which of the limits a case does not reach."""
    pull, share = one["pull"].values(), one["share"].values()
    reached = {
        "pull": min(pull) >= 0.9 and max(pull) <= 1.15,
        "95 %": min(share) >= 0.92 and max(share) <= 0.98,
        "NEES": 0.85 <= one["nees"] <= 1.2,
    }
    return [name for name, met in reached.items() if not met]


def show(rows: list[dict[str, Any]]) -> str:
    """The table, in Markdown."""
    lines = [
        "| case | seeds | pull: least, greatest, all | 95 %: least, greatest, all | largest pull | NEES: mean, median "
        "| misses |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in rows:
        pull, share = one["pull"].values(), one["share"].values()
        cells = (
            one["words"],
            one["seeds"],
            f"{min(pull):.2f} {max(pull):.2f} {one['pull_all']:.2f}",
            f"{100 * min(share):.1f} {100 * max(share):.1f} {100 * one['share_all']:.1f}",
            f"{one['largest']:.1f}",
            f"{one['nees']:.2f} {one['nees_median']:.2f}",
            ", ".join(misses(one)),
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--case", action="append", choices=list(CASES), help="only this one; repeatable")
    parser.add_argument("--jobs", type=int, default=1, help="cases side by side")
    parser.add_argument("--quick", action="store_true", help="six seeds of three cases: does it run?")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; - is standard output")
    arguments = parser.parse_args()
    if arguments.seeds < 2 or arguments.jobs < 1:
        parser.error("--seeds must be at least 2, --jobs at least 1")
    names, seeds = (QUICK, 6) if arguments.quick else (arguments.case or list(CASES), arguments.seeds)
    if arguments.jobs == 1:
        rows = [run_case(name, seeds) for name in names]
    else:
        with ProcessPoolExecutor(arguments.jobs) as pool:
            rows = list(pool.map(run_case, names, [seeds] * len(names)))
    if arguments.json == "-":
        sys.stdout.write(files.to_json({"seeds": seeds, "first_seed": FIRST_SEED, "cases": rows}))
        return 0
    print(f"{seeds} seeds from {FIRST_SEED}; {sum(one['seconds'] for one in rows):.0f} s\n\n{show(rows)}")
    if arguments.json:
        files.write_json(arguments.json, {"seeds": seeds, "first_seed": FIRST_SEED, "cases": rows})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
