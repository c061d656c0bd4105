"""Calibration without attitude against its peers, on the same data: offset, size and direction.

    python benchmarks/calibration.py [--samples N] [--repeats R] [--quick] [--json FILE|-]

Three sets of readings of a magnetometer with 3 % scale errors, non-orthogonality and a bias:

  varying   a spinner on 300 x 4500 km (ST5's orbit): |B| from 130 to 450 mG, noise 2 mG
  constant  a laboratory: random directions, |B| 500 mG, noise 0.5 mG
  passes    an Earth-pointing polar orbit seen in passes: LSB 4.7 mG, field model wrong by 1.2 mG an axis and pass

Compared: the offset in the reading; the size after calibration less the true size, rms; the angle to the true field after
the best rotation, rms (no method here can know it). Methods that do not use |B| are granted the best scale. Peers:
magyc and magcal from the package registry, left out with the reason where they are absent; an algebraic ellipsoid fit
(Li & Griffiths 2004) is written here. They suppose |B| constant: `constant` is their case, the others show what comes of
using them in orbit.

Then the time of the batch for a spinner: ST5's hour (28,800 readings, 1562 sun pulses) from a blind start, compiled code
in its cache, median of the repeats.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import contextlib
import importlib
import io
import platform
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eig
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.scalar.calibrate import ScalarOptions, fit_rows
from fluxtwin.calib.spin.calibrate import SpinOptions, fit_spin
from fluxtwin.calib.spin.rows import assemble_spin
from fluxtwin.scenarios.st5 import mission
from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit

D = np.array([[0.03, 0.01, -0.005], [0.01, -0.02, 0.004], [-0.005, 0.004, 0.015]])
O_NT = np.array([2500.0, -1800.0, 1200.0])
START = np.datetime64("2006-04-15", "ns")
NT_PER_MG = 100.0

Answer = tuple[np.ndarray, np.ndarray]
"""Offset o (3,) and matrix M (3, 3): true = M (B - o), up to a rotation and a scale."""


class Set(NamedTuple):
    """One set of readings."""

    time: np.ndarray
    B_nT: np.ndarray
    true_nT: np.ndarray
    H_nT: np.ndarray
    noise_nT: float
    lsb_nT: float


def read(field_nT: np.ndarray, rng: np.random.Generator, noise_nT: float, lsb_nT: float = 0.0) -> np.ndarray:
    """The magnetometer: (I+D)^-1 field + o, noise, rounding."""
    B = field_nT @ np.linalg.inv(np.eye(3) + D) + O_NT + noise_nT * rng.standard_normal(field_nT.shape)
    return np.asarray(lsb_nT * np.rint(B / lsb_nT) if lsb_nT else B)


def varying(samples: int, rng: np.random.Generator) -> Set:
    """A spinner whose axis, in an hour, sees the field from all sides."""
    t = np.linspace(0.0, 3600.0, samples)
    time = START + (t * 1e9).astype("timedelta64[ns]")
    orbit = Orbit(
        epoch_utc=START,
        altitude_km=2400.0,
        eccentricity=0.239231,
        inclination_rad=np.radians(105.6),
        raan_rad=np.radians(113.0),
        argument_of_perigee_rad=np.radians(160.0),
        argument_of_latitude_rad=np.radians(100.0),
    )
    field_N = field_N_nT(load_field("igrf14"), time, orbit.propagate(time)[0])
    spin = Rotation.from_euler("z", -2.7227 * t[:, None]) * Rotation.from_euler("x", 0.41)
    return made(time, spin.apply(field_N), rng, 200.0)


def constant(samples: int, rng: np.random.Generator) -> Set:
    """A laboratory."""
    unit = rng.standard_normal((samples, 3))
    time = START + np.arange(samples) * np.timedelta64(1, "s")
    return made(time, 50_000.0 * unit / np.linalg.norm(unit, axis=1)[:, None], rng, 50.0)


def passes(samples: int, rng: np.random.Generator) -> Set:
    """Eleven minutes a pass, a minute a sample, eight hours apart."""
    count = max(samples // 11, 2)
    minutes = (np.arange(count)[:, None] * 480 + rng.integers(0, 90, count)[:, None] + np.arange(11)).ravel()
    time = START + minutes * np.timedelta64(60, "s")
    orbit = Orbit(epoch_utc=START, altitude_km=600.0, inclination_rad=np.radians(97.6), raan_rad=1.0)
    r, v = orbit.propagate(time)
    field_N = field_N_nT(load_field("igrf14"), time, r)
    wrong = np.repeat(120.0 * rng.standard_normal((count, 3)), 11, axis=0)
    body = frames.rotation_ON(r, v).apply(field_N)
    part = made(time, body, rng, 30.0, 470.0)
    return part._replace(H_nT=np.linalg.norm(field_N + wrong, axis=1))


def made(time: np.ndarray, body_nT: np.ndarray, rng: np.random.Generator, noise_nT: float, lsb_nT: float = 0.0) -> Set:
    """Readings of a field."""
    H = np.linalg.norm(body_nT, axis=1)
    return Set(time, read(body_nT, rng, noise_nT, lsb_nT), body_nT, H, noise_nT, lsb_nT)


def ours(data: Set, method: str) -> Answer:
    """One of our methods."""
    rows = Design(data.time, data.B_nT, data.H_nT, {}, np.arange(len(data.H_nT)), {})
    parameters = "b" if method == "center" else "b,S"
    options = ScalarOptions(
        method=method, parameters=parameters, noise_nT=data.noise_nT, lsb_nT=data.lsb_nT, robust="none"
    )
    known = fit_rows(rows, options).calibration
    M = np.eye(3) + known.S
    return -np.linalg.solve(M, known.b_nT), M


def algebraic_ellipsoid(B: np.ndarray) -> Answer:
    """Li & Griffiths (2004): least squares of an algebraic quadric held to be an ellipsoid; no |B| is used."""
    x, y, z = (B / np.abs(B).max()).T
    rows = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z, np.ones_like(x)])
    S = rows @ rows.T
    C = np.zeros((6, 6))
    C[:3, :3] = 1.0 - 2.0 * np.eye(3)
    C[3:, 3:] = -4.0 * np.eye(3)
    reduced = S[:6, :6] - S[:6, 6:] @ np.linalg.solve(S[6:, 6:], S[6:, :6])
    values, vectors = eig(np.linalg.solve(C, reduced))
    v1 = np.real(vectors[:, int(np.argmax(np.real(values)))])
    v1 = v1 * np.sign(v1[0])
    v2 = -np.linalg.solve(S[6:, 6:], S[6:, :6] @ v1)
    Q = np.array([[v1[0], v1[5], v1[4]], [v1[5], v1[1], v1[3]], [v1[4], v1[3], v1[2]]])
    offset = -np.linalg.solve(Q, v2[:3])
    size, axes = np.linalg.eigh(Q / (offset @ Q @ offset - v2[3]))
    if not (size > 0).all():
        raise ArithmeticError("the quadric is no ellipsoid")
    return offset * np.abs(B).max(), (axes * np.sqrt(size)) @ axes.T


def peer_magyc(name: str) -> Callable[[Set], Answer]:
    """A function of magyc.benchmark_methods, used as its documentation says (units: gauss)."""
    found = getattr(importlib.import_module("magyc.benchmark_methods"), name)

    def run(data: Set) -> Answer:
        B = data.B_nT * 1e-5
        if name.startswith("twostep"):
            reference = np.array([0.0, 0.0, data.H_nT.mean() * 1e-5])
            answer = found(B, reference, measurement_noise_std=data.noise_nT * 1e-5)
        else:
            answer = found(B)
        offset = np.asarray(answer[0], dtype=float).ravel() * 1e5
        soft = np.asarray(answer[1], dtype=float) if len(answer) == 3 else np.eye(3)
        return offset, np.linalg.inv(soft)

    return run


def peer_magcal(method: str) -> Callable[[Set], Answer]:
    """magcal's MagnetometerCalibrator on rows in microtesla; it wants 500 of them, so fewer are given twice or more."""
    calibrator = importlib.import_module("magcal").MagnetometerCalibrator

    def run(data: Set) -> Answer:
        tool = calibrator()
        repeats = -(-500 // len(data.B_nT))
        tool.raw_data = np.tile(data.B_nT * 1e-3, (repeats, 1)).tolist()
        found = tool.calibrate(method)
        return np.asarray(found["center"], dtype=float) * 1e3, np.asarray(found["transform_matrix"], dtype=float)

    return run


def contestants() -> tuple[dict[str, Callable[[Set], Answer]], dict[str, str]]:
    """Who runs, and who does not, with the reason."""
    runs: dict[str, Callable[[Set], Answer]] = {"nothing": lambda data: (np.zeros(3), np.eye(3))}
    for method in ("center", "twostep", "scalar"):
        runs[f"fluxtwin {method}"] = lambda data, method=method: ours(data, method)  # type: ignore[misc]
    runs["ellipsoid (Li & Griffiths)"] = lambda data: algebraic_ellipsoid(data.B_nT)
    skipped = {}
    for package, names, peer in (
        ("magyc", ("twostep_hi", "twostep_hsi", "ellipsoid_fit", "ellipsoid_fit_fang", "sphere_fit"), peer_magyc),
        ("magcal", ("ellipsoid", "sphere"), peer_magcal),
    ):
        for name in names:
            try:
                runs[f"{package} {name}"] = peer(name)
            except (ImportError, AttributeError) as reason:
                skipped[f"{package} {name}"] = f"not at hand: {reason}"
    return runs, skipped


def judge(data: Set, answer: Answer, uses_size: bool) -> dict[str, float]:
    """Offset [mG], size rms [mG], direction rms [deg]."""
    offset, M = answer
    corrected = (data.B_nT - offset) @ M.T
    size = np.linalg.norm(corrected, axis=1)
    true = np.linalg.norm(data.true_nT, axis=1)
    if not (np.isfinite(corrected).all() and size.min() > 0):
        raise ArithmeticError("the answer is not finite")
    scale = 1.0 if uses_size else float(true @ size / (size @ size))
    unit, wanted = corrected / size[:, None], data.true_nT / true[:, None]
    turned, _ = Rotation.align_vectors(wanted, unit)
    angle = np.linalg.norm(np.cross(turned.apply(unit), wanted), axis=1)
    return {
        "offset_mG": float(np.linalg.norm(offset - O_NT)) / NT_PER_MG,
        "size_rms_mG": float(np.sqrt(((scale * size - true) ** 2).mean())) / NT_PER_MG,
        "direction_rms_deg": float(np.degrees(np.sqrt((np.arcsin(np.clip(angle, 0, 1)) ** 2).mean()))),
    }


def measure(samples: int, hour: int, repeats: int) -> dict[str, Any]:
    """All contestants on all sets; the judge sees readings without noise, made anew."""
    runs, skipped = contestants()
    results: dict[str, dict[str, Any]] = {}
    for name, build in (("varying", varying), ("constant", constant), ("passes", passes)):
        rows = samples if name != "passes" else min(samples, 473)
        data = build(rows, np.random.default_rng(1975))
        clean = data._replace(B_nT=read(data.true_nT, np.random.default_rng(0), 0.0))
        for who, run in runs.items():
            results.setdefault(who, {})[name] = attempt(
                run, data, clean, uses_size=who.startswith(("fluxtwin", "nothing"))
            )
    return {
        "samples": samples,
        "results": results,
        "skipped": skipped,
        "spinner": spinner(hour, repeats),
        "machine": {"python": platform.python_version(), "numpy": np.__version__, "cpu": platform.machine()},
    }


def spinner(samples: int, repeats: int) -> dict[str, float]:
    """Median seconds of the blind start and batch together, and what they are worth."""
    segment = {"start_utc": "2006-04-15T00:00:00Z", "samples": samples, "step_s": 0.125}
    flight = mission.fly(mission.scenario().updated({"schedule.segments": [segment]}))
    rows = assemble_spin(flight.telemetry, load_field("igrf14"))
    chosen = SpinOptions(method="batch", noise_nT=200.0, lsb_nT=0.0, sun_sigma_deg=0.18)
    seconds = []
    for repeat in range(repeats + 1):  # the first round compiles, or loads what was compiled
        begin = time.perf_counter()
        fit = fit_spin(rows, chosen)
        if repeat:
            seconds.append(time.perf_counter() - begin)
    off = fit.calibration.b_nT - flight.truth.b_nT
    return {
        "readings": len(rows),
        "median_s": statistics.median(seconds),
        "bias_error_mG": float(np.abs(off).max()) / NT_PER_MG,
    }


def attempt(run: Callable[[Set], Answer], data: Set, clean: Set, *, uses_size: bool) -> dict[str, Any]:
    """One contestant on one set; a failure is an answer too."""
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return judge(clean, run(data), uses_size)
    except NoAnswer as reason:
        return {"refused": str(reason)}
    except Exception as reason:  # a peer may raise anything
        return {"failed": f"{type(reason).__name__}: {reason}"[:160]}


def show(result: dict[str, Any]) -> str:
    """A table for people."""
    lines = ["offset [mG] / size rms [mG] / direction rms [deg]"]
    lines.append(f"{'':28}" + "".join(f"{name:>26}" for name in ("varying", "constant", "passes")))
    for who, sets in result["results"].items():
        cells = []
        for one in sets.values():
            if "offset_mG" in one:
                cells.append(f"{one['offset_mG']:.3g} / {one['size_rms_mG']:.3g} / {one['direction_rms_deg']:.3g}")
            else:
                cells.append("refused" if "refused" in one else "failed")
        lines.append(f"{who:28}" + "".join(f"{cell:>26}" for cell in cells))
    lines += [f"{who}: {reason}" for who, reason in result["skipped"].items()]
    one = result["spinner"]
    lines.append(
        f"spinner, batch from a blind start: {one['readings']} readings in {one['median_s']:.2f} s, b within "
        f"{one['bias_error_mG']:.3f} mG"
    )
    return "\n".join(lines)


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=4000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="600 samples, a short spin: does it run?")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; - is standard output")
    arguments = parser.parse_args()
    if arguments.samples < 100 or arguments.repeats < 1:
        parser.error("--samples must be at least 100, --repeats at least 1")
    result = measure(600, 2400, 1) if arguments.quick else measure(arguments.samples, 28_800, arguments.repeats)
    if arguments.json == "-":
        sys.stdout.write(files.to_json(result))
    else:
        print(show(result))
        if arguments.json:
            files.write_json(arguments.json, result)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
