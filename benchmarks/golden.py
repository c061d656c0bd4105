"""Does the product still say what it said? Telemetry, calibrations, checks, diagnoses and studies on fixed seeds.

    python benchmarks/golden.py                  compare with golden.json; exit status 1 where anything differs
    python benchmarks/golden.py --write          write golden.json anew
    python benchmarks/golden.py --only PART ...  scenarios, calibrations, checks, diagnoses, studies
    python benchmarks/golden.py --quick          one of each but the studies: does it still run?

For a change of how the product is built, not of what it says. Of each answer golden.json keeps a digest and a line of
words, which shows what an answer was once it has changed. Telemetry and truth are compared bit by bit. Of a number in an
estimate six digits count (none where it is nothing beside its neighbours): the last bits of a sum depend on where in
memory its terms lie, so they differ from checkout to checkout of one commit. All of it takes twenty minutes of a core,
on one machine and with one set of versions: write the file anew at the commit before, then compare.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import hashlib
import json
import math
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import h5py
import numpy as np
import tomli_w
import traps_cases
from withheld_cases.ask import arguments
from withheld_cases.make import make
from withheld_cases.store import Store

import fluxtwin
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.effects.base import Effect
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.scenario.effect_sections import effect_tree

ROOT = Path(__file__).resolve().parent.parent
KEPT = Path(__file__).with_suffix(".json")
SHARED = Path(os.environ.get("FLUXTWIN_SHARED", ROOT.parent / "shared"))
SEED = 20260301
Tree = dict[str, Any]
Answer = tuple[str, str]
"""Digest and words."""

SPINNER: Tree = {"mode": "spin", "spin_rate_rpm": 20.0, "nutation_deg": 1.0, "reference": {}}
BODY: Tree = {"inertia_kg_m2": [[50.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, 0.0, 40.0]]}
TORQUERS: Tree = {"dipole_Am2": 5.0, "positions_m": [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]]}
POWER: Tree = {"full_sun_current_A": 4.0, "axis_B": [0.0, 1.0, 0.0], "load_A": 1.5}
THERMAL: Tree = {"sunlit_degC": 35.0, "eclipse_degC": -5.0, "time_constant_min": 20.0}
WHEELS: Tree = {"axes_B": [[0.0, 1.0, 0.0]], "inertia_kg_m2": 1e-3, "bias_rpm": [2000.0]}
SEGMENT: Tree = {"start_utc": "2026-03-01T00:00:00Z", "duration_min": 120.0, "step_s": 10.0}
WAYPOINTS = [
    {"after_s": 600.0 * k, "hold_s": 300.0, "yaw_deg": 40.0 * k, "roll_deg": 5.0 * k, "pitch_deg": 0.0}
    for k in range(6)
]
HEATED: Tree = {**THERMAL, "heater_on_below_degC": 0.0, "heater_off_above_degC": 8.0, "heater_rise_degC": 15.0}
HEADS: Tree = {"1": {"azimuth_deg": 0.0, "noise_deg": 0.1}, "2": {"azimuth_deg": 180.0, "lsb_deg": 0.5}}
REACHED: Tree = {
    "power": POWER,
    "thermal": HEATED,
    "wheels": WHEELS,
    "torquers": TORQUERS,
    "sun_sensor": HEADS,
    "horizon_scanner": {"noise_deg": 0.2},
    "drivers": {"NAME": {"pattern": "square", "high": 1.0, "period_s": 1700.0, "duty": 0.4}},
}
"""What an effect may follow."""
FREE: Tree = {"spacecraft": {"name": "free", **BODY}, "attitude": {"mode": "dynamics"}}

SCENARIOS: dict[str, Tree] = {
    "as in the README": {},
    "elliptic": {"orbit": {"eccentricity": 0.02, "argument_of_perigee_deg": 40.0}},
    "IGRF 1975": {
        "field": {"truth": "igrf1975"},
        "orbit": {"epoch_utc": "1978-07-10T00:00:00Z"},
        "schedule": {"segments": [{**SEGMENT, "start_utc": "1978-07-10T00:00:00Z"}]},
    },
    "field to degree 8": {"field": {"truth_degree": 8}},
    "inertial hold": {"attitude": {"mode": "inertial_hold", "q_NB": [0.1, 0.2, 0.3, 0.9273618495495703]}},
    "slews": {"attitude": {"mode": "slews", "waypoints": WAYPOINTS}},
    "tumble": {"spacecraft": BODY, "attitude": {"mode": "tumble", "rate_deg_s": [0.12, 0.08, 0.2]}},
    "spin": {
        "spacecraft": {"inertia_kg_m2": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]]},
        "attitude": SPINNER,
        "schedule": {"segments": [{**SEGMENT, "duration_min": 20.0, "step_s": 0.5}]},
    },
    "slit sun sensor": {
        "spacecraft": {"inertia_kg_m2": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]]},
        "attitude": SPINNER,
        "slit_sun_sensor": {"noise_deg": 0.1},
        "schedule": {"segments": [{**SEGMENT, "duration_min": 20.0, "step_s": 0.5}]},
    },
    "unknown field, full scale": {
        "magnetometer": {"range_nT": 60000.0, "unknown": {"kind": "gauss_markov", "rms_nT": 80.0, "tau_s": 900.0}}
    },
    "sun sensors, scanner, gyro": {
        "sun_sensor": HEADS,
        "horizon_scanner": {"noise_deg": 0.2, "tau_s": 60.0, "roll_bias_deg": 0.3},
        "gyro": {"bias_deg_h": [1.0, -2.0, 3.0], "noise_deg_s": 0.01, "random_walk_deg_h_per_sqrt_h": 0.1},
    },
    "attitude from sensors": {
        "sun_sensor": HEADS,
        "horizon_scanner": {"noise_deg": 0.2},
        "attitude": {"reference": {"sigma_deg": 0.0, "tau_s": 0.0, "source": "sensors", "needs_sun": True}},
    },
    "torquers": {"torquers": TORQUERS},
    "torquers on, compensated": {"torquers": {**TORQUERS, "activity": "constant", "compensation": 0.8}},
    "power, thermal, wheels": {
        "power": POWER,
        "thermal": THERMAL,
        "wheels": {**WHEELS, "momentum_amplitude_Nms": [0.0, 0.01, 0.0]},
    },
    "heater": {"thermal": HEATED},
    "free motion": FREE,
    "gravity gradient": {**FREE, "torques": {"gravity_gradient": {}}},
    "two segments": {
        "schedule": {
            "segments": [
                {**SEGMENT, "duration_min": 30.0},
                {**SEGMENT, "start_utc": "2026-03-01T06:00:00Z", "duration_min": 30.0},
            ]
        }
    },
}
CALIBRATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    f"{flight}: {' '.join(map(str, options.values())) or 'default'}": (flight, options)
    for flight, choices in {
        "as in the README": [
            {},
            {"method": "forward"},
            {"parameters": "b"},
            {"robust": "none"},
            {"covariance": "white"},
            {"attitude_sigma_deg": 0.1, "attitude_tau_s": 300.0},
            {"field_error_nT": 50.0},
            {"degree": 8},
        ],
        "torquers": [{"parameters": "b,S,T"}, {"parameters": "b,S,T", "method": "forward"}],
        "elliptic": [{}],
        "slews": [{}],
        "inertial hold": [{}],
        "IGRF 1975": [{"field": "igrf1975"}],
        "two segments": [{}],
        "tumble": [{}, *({"method": method} for method in ("scalar", "twostep", "center"))],
        "power, thermal, wheels": [{"driver": ("array_current_A",), "method": "scalar"}],
        "spin": [{"method": "scalar"}, {"method": "center"}],
        "slit sun sensor": [{"method": "batch"}, {"method": "iterative"}],
        "unknown field, full scale": [{}],
    }.items()
    for options in choices
}
DIAGNOSES = {
    "nulls": 6,
    "nulls_off": 2,
    "singles": 14,
    "faint": 3,
    "pairs": 5,
    "triples": 2,
    "shapes": 4,
    "outside": 5,
    "sensed": 3,
    "torque_nulls": 1,
    "torques": 2,
    "torque_pairs": 1,
    "nulls_undeclared": 3,
    "singles_undeclared": 3,
    "passes_only": 1,
    "short": 2,
    "coarse": 2,
    "undetermined": 1,
}
"""Cases of each population of the withheld benchmark."""
STUDIES = ("seasat", "hcmm", "st5")


def base() -> Tree:
    """The scenario that README.md shows, for two hours."""
    tree = tomllib.loads((ROOT / "README.md").read_text(encoding="utf-8").split("```toml")[1].split("```")[0])
    return merged(tree, {"seed": SEED, "schedule": {"segments": [SEGMENT]}})


def merged(tree: Tree, change: Tree) -> Tree:
    """The tree with the change laid over it; what flies in another attitude mode keeps nothing of the old one."""
    new = dict(tree)
    for key, value in change.items():
        whole = key == "attitude" and "mode" in value
        new[key] = merged(new[key], value) if isinstance(value, dict) and key in new and not whole else value
    return new


def flights() -> dict[str, Tree]:
    """Every scenario."""
    return {name: merged(base(), change) for name, change in SCENARIOS.items()} | {
        f"effect {effect.name}": merged(
            base(), {**REACHED, **(FREE if effect.stage == "dynamics" else {}), **typical(effect)}
        )
        for effect in CATALOGUE
    }


def typical(effect: Effect) -> Tree:
    """An effect at its typical size."""
    return {"effects": effect_tree(effect, [one.scale for one in effect.parameters])}


def flown(name: str, folder: Path) -> Path:
    """The telemetry of a scenario; its truth lies beside it."""
    text = folder / "scenario.toml"
    text.write_text(tomli_w.dumps(flights()[name]), encoding="utf-8")
    telemetry, truth = fluxtwin.simulate(fluxtwin.load_scenario(text))
    fluxtwin.write(telemetry, folder / "telemetry.nc")
    truth.write(folder / "truth.nc")
    return folder / "telemetry.nc"


def scenario(name: str, folder: Path) -> Answer:
    """Telemetry and truth, every array."""
    flown(name, folder)
    both = {f"{path.stem}.{key}": value for path in sorted(folder.glob("*.nc")) for key, value in arrays(path).items()}
    rows = max(value.shape[0] for value in both.values() if value.ndim)
    return digest(both), f"{rows} rows, {len(both)} arrays"


def calibration(name: str, folder: Path) -> Answer:
    """The calibration, and whether it is good."""
    flight, options = CALIBRATIONS[name]
    said = spoken(lambda: fluxtwin.calibrate(flown(flight, folder), **options).to_dict())
    return digest(said), said.get("error") or "b " + ", ".join(
        f"{value:.2f}" for value in said["calibration"]["b_nT"]
    ) + " nT"


def check(name: str, folder: Path) -> Answer:
    """The report on a record of the benchmark of the traps."""
    kind = name.rsplit(" ", 1)[0]
    model = fluxtwin.load_field("igrf14")
    case = traps_cases.fly(stream(SEED, f"traps.{name}"), model, kind)
    traps_cases.corrupt(case, kind)
    path = traps_cases.write(case, folder / "record.csv")
    said = spoken(lambda: fluxtwin.check(path).to_dict())
    return digest(said), said.get("error") or ", ".join(
        f["code"] for f in said["findings"] if f["severity"] != "note"
    ) or "clean"


def diagnosis(name: str, folder: Path) -> Answer:
    """The answer on a record of the withheld benchmark."""
    population, number = name.rsplit(" ", 1)
    store = Store(folder).prepared()
    case = make(str(folder), SEED, population, int(number), None)
    sealed = store.read("sealed", case)
    if "void" in sealed:
        return digest(sealed), "no such record"
    said = spoken(
        lambda: fluxtwin.diagnose(store.path("telemetry", case), **arguments(store.read("asked", case))).to_dict()
    )
    names = [effect["name"] for effect in said.get("effects", [])]
    return digest(said), said.get("error") or " ".join([said["verdict"], *names])


def study(name: str, folder: Path) -> Answer:
    """Its summary."""
    fluxtwin.run_study(name, folder / "results")
    summary = json.loads((folder / "results" / "summary.json").read_text())
    return digest(summary), f"{len(summary)} entries"


PARTS: dict[str, tuple[Callable[[str, Path], Answer], list[str]]] = {
    "scenarios": (scenario, list(flights())),
    "calibrations": (calibration, list(CALIBRATIONS)),
    "checks": (check, [f"{kind} 0" for kind in (*traps_cases.KINDS, traps_cases.GOOD)]),
    "diagnoses": (diagnosis, [f"{name} {number}" for name, count in DIAGNOSES.items() for number in range(count)]),
    "studies": (study, list(STUDIES)),
}


def spoken(say: Callable[[], Tree]) -> Tree:
    """What was said; a refusal is said too."""
    try:
        return say()
    except fluxtwin.FluxtwinError as error:
        return {"error": f"{type(error).__name__}: {error}".replace(gettempdir(), "").split("record.csv: ")[-1]}


def arrays(path: Path) -> dict[str, np.ndarray]:
    """Every variable of a NetCDF file."""
    with h5py.File(path) as file:
        return {name: np.asarray(value[()]) for name, value in file.items()}


def digest(said: Any) -> str:
    """Of all that was said but where its file lies, in an order that does not depend on who wrote it."""
    hashed = hashlib.sha256()
    for part in _parts(said):
        hashed.update(part)
    return hashed.hexdigest()[:16]


def _largest(values: Iterable[Any]) -> float:
    return max((abs(one) for one in values if isinstance(one, float) and math.isfinite(one)), default=0.0)


def _parts(said: Any, nothing: float = 0.0) -> Iterator[bytes]:
    if isinstance(said, dict):
        nothing = 1e-14 * _largest(said.values())
        for key in sorted(said.keys() - {"source"}):
            yield f"{key}:".encode()
            yield from _parts(said[key], nothing)
    elif isinstance(said, list | tuple):
        nothing = 1e-9 * _largest(said)
        for one in said:
            yield from _parts(one, nothing)
    elif isinstance(said, float):
        yield (f"{said:.5e}" if abs(said) > nothing else "0").encode()
    elif isinstance(said, np.ndarray):
        yield str(said.shape).encode() + (repr(said.tolist()).encode() if said.dtype.hasobject else said.tobytes())
    else:
        yield repr(said).encode()


def answered(part: str, name: str) -> Answer:
    """One of them."""
    with TemporaryDirectory() as folder:
        return PARTS[part][0](name, Path(folder))


def main() -> int:
    """Run, and compare or write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="PART", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--write", action="store_true", help="write golden.json anew")
    parser.add_argument("--quick", action="store_true", help="one of each but the studies, compared with nothing")
    given = parser.parse_args()
    work = [(part, name) for part in given.only for name in PARTS[part][1]]
    if given.quick:
        work = [(part, PARTS[part][1][0]) for part in given.only if part != "studies"]
    kept: dict[str, dict[str, list[str]]] = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    differ = 0
    with ProcessPoolExecutor(given.jobs) as pool:
        for (part, name), now in zip(work, pool.map(answered, *zip(*work, strict=True)), strict=True):
            before = kept.get(part, {}).get(name)
            if given.quick or given.write or before is None or before != list(now):
                old = f"; it was {before[1]}" if before is not None and before[1] != now[1] else ""
                print(f"{part}, {name}: {now[0]}, {now[1]}{old}", flush=True)
            differ += before != list(now)
            kept.setdefault(part, {})[name] = list(now)
    if given.quick:
        return 0
    if given.write:
        KEPT.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    print(f"{len(work)} answers, {differ} of them not as kept in {KEPT.name}")
    return int(differ > 0 and not given.write)


if __name__ == "__main__":
    sys.exit(main())
