"""How often the diagnosis is right: perfect simulations, and every effect of the catalogue alone.

    python benchmarks/diagnosis.py [--nulls N] [--singles] [--quick] [--only NAME,...] [--json FILE|-]

Nulls: simulations without any effect, over four designs in turn (nadir with librations, slow tumble, slews, spin),
with random node, phase, season, calibration error (b about 1000 nT, S half a per cent with a small misalignment),
noise, LSB and attitude error. The verdict must be `no_gap` in 99 of 100; every exception is listed with its seed.

Singles: each effect is switched on in a scenario at a size that leaves `VISIBLE` times the noise after the best
re-estimation of b and S. That is measured here without the diagnosis: two noise-free simulations, their difference
regressed on a constant and the field. For effects known by their distribution a plain size is given instead.
Pull: the worst |estimate - truth| / sigma of the parameters, where the discrete settings are the injected ones.
"""

# ruff: noqa: E402  (the thread counts must be set before numpy is loaded)
from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"  # before numpy is loaded

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, Budget
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.sim.base import files
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.effects.base import DynamicsEffect, Effect, SignalEffect
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect
from fluxtwin.sim.effects.law import Law
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.effect_sections import effect_tree
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

DESIGNS = ("nadir", "tumble", "slews", "spin")
VISIBLE = 1.0
WANTED_NULLS = 0.99
UNDECLARED = "--undeclared" in sys.argv

Tree = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Single:
    """One injected effect."""

    effect: Effect
    theta: tuple[float, ...]
    """Direction of the parameters; its length too where the effect is known by its distribution only."""
    design: str = "nadir"
    visible: float | None = VISIBLE
    """Wanted size; None: theta as it stands."""
    without: tuple[str, ...] = ()
    """Sections that the scenario lacks, so that the columns are not recorded."""
    modelled: tuple[str, ...] = DEFAULT_MODELLED
    label: str = ""


def world(rng: np.random.Generator, design: str) -> Tree:
    """A scenario without effects, as a tree; everything that a design leaves open is drawn."""
    day = np.datetime64("2016-01-01", "s") + int(rng.integers(0, 8 * 365 * 86400)) * np.timedelta64(1, "s")
    start = f"{day}Z"
    tau_s = float(rng.choice([0.0, 60.0, 150.0, 300.0, 600.0]))
    inclination = float(rng.choice([51.6, 97.8, 108.0]))
    step_s = float(rng.uniform(1.0, 2.0)) if design == "spin" else 30.0
    samples = 700 if design == "spin" else 580
    skew = 0.002 * rng.standard_normal((3, 3))
    return {
        "seed": int(rng.integers(1, 2**31)),
        "spacecraft": {"name": "bench", "inertia_kg_m2": [[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]]},
        "orbit": {
            "epoch_utc": start,
            "altitude_km": float(rng.uniform(450.0, 800.0)),
            "inclination_deg": inclination,
            "raan_deg": float(rng.uniform(0, 360)),
            "argument_of_latitude_deg": float(rng.uniform(0, 360)),
        },
        "attitude": {
            **_motion(rng, design, samples * step_s),
            "reference": {"sigma_deg": float(rng.uniform(0.1, 0.15)), "tau_s": tau_s},
        },
        "magnetometer": {
            "S": (np.diag(0.005 * rng.standard_normal(3)) + skew).tolist(),
            "b_nT": (1000.0 * rng.standard_normal(3)).tolist(),
            "T_nT_per_Am2": np.zeros((3, 3)).tolist(),
            "noise_nT": float(rng.uniform(100.0, 200.0)),
            "lsb_nT": float(rng.uniform(100.0, 440.0)),
        },
        "sun_sensor": {
            "1": {"azimuth_deg": 0.0, "elevation_deg": 90.0},
            "2": {"azimuth_deg": 180.0, "elevation_deg": 20.0},
        },
        "torquers": {"dipole_Am2": 20.0, "positions_m": [[0.0, 0.0, 2.0], [0.0, 2.0, 0.0], [1.5, 0.0, 0.0]]},
        "power": {"full_sun_current_A": 8.0, "load_A": 3.0},
        "drivers": {"payload": {"pattern": "random", "high": 1.0, "duty": 0.4, "dwell_s": 300.0}},
        "thermal": {
            "sunlit_degC": 25.0,
            "eclipse_degC": -20.0,
            "time_constant_min": 20.0,
            "heater_on_below_degC": -5.0,
            "heater_off_above_degC": 0.0,
            "heater_rise_degC": 30.0,
        },
        "wheels": {"axes_B": [[0.0, 1.0, 0.0]], "inertia_kg_m2": 0.01, "bias_rpm": [2003.7]},
        "schedule": {"segments": [{"start_utc": start, "samples": samples, "step_s": step_s}]},
    }


def _motion(rng: np.random.Generator, design: str, span_s: float) -> Tree:
    if design == "nadir":
        return {"yaw_rms_deg": 4.0, "roll_rms_deg": 4.0, "pitch_rms_deg": 4.0}
    if design == "tumble":
        q, axis = rng.standard_normal(4), rng.standard_normal(3)
        rate = 0.25 * axis / np.linalg.norm(axis)
        return {"mode": "tumble", "q_NB": (q / np.linalg.norm(q)).tolist(), "rate_deg_s": rate.tolist()}
    if design == "slews":
        points = []
        for number in range(9):
            yaw, roll, pitch = (float(angle) for angle in rng.uniform(-60.0, 60.0, 3))
            point = {"after_s": number * span_s / 8.0, "yaw_deg": yaw, "roll_deg": roll, "pitch_deg": pitch}
            points.append(point | {"hold_s": 0.04 * span_s})
        return {"mode": "slews", "waypoints": points}
    axis = rng.standard_normal(3)
    return {
        "mode": "spin",
        "spin_axis_N": (axis / np.linalg.norm(axis)).tolist(),
        "spin_rate_rpm": float(rng.uniform(1.0, 2.0)),
        "nutation_deg": 3.0,
        "phase_deg": float(rng.uniform(0, 360)),
    }


def fixed_world(design: str, seed: int) -> Tree:
    """The scenario of the singles: a sun-synchronous orbit with eclipses, five hours (spin: 20 minutes)."""
    tree = world(np.random.default_rng(seed), design)
    start = "2020-03-01T00:00:00Z"
    segment = {"start_utc": start, "samples": 900, "step_s": 1.3 if design == "spin" else 20.0}
    tree["orbit"] |= {
        "epoch_utc": start,
        "altitude_km": 650.0,
        "inclination_deg": 97.9,
        "raan_deg": 10.0,
        "argument_of_latitude_deg": 0.0,
    }
    tree["schedule"] = {"segments": [segment]}
    tree["attitude"]["reference"] = {"sigma_deg": 0.1, "tau_s": 150.0}
    tree["magnetometer"] |= {"noise_nT": 100.0, "lsb_nT": 100.0}
    return tree


def as_scenario(tree: Tree) -> Scenario:
    """The tree, checked."""
    return parse_scenario(tomli_w.dumps(tree), where="benchmark")


def answer(scenario: Scenario, modelled: Sequence[str] = DEFAULT_MODELLED) -> tuple[Diagnosis, float]:
    """Simulate and diagnose with the budget of the scenario (tau undeclared); seconds of CPU of the diagnosis."""
    telemetry, _ = simulate(scenario)
    instrument = scenario.magnetometer
    sigma = float(np.radians(scenario.attitude.reference.sigma_deg))
    budget = Budget() if UNDECLARED else Budget(instrument.white_nT, instrument.step_nT, sigma, None)
    began = time.process_time()
    found = diagnose(telemetry, load_field("igrf14"), modelled=modelled, budget=budget)
    return found, time.process_time() - began


def null(number: int) -> Tree:
    """One perfect simulation; the number is seed and design."""
    design = DESIGNS[number % len(DESIGNS)]
    scenario = as_scenario(world(np.random.default_rng([7, number]), design))
    found, spent = answer(scenario)
    return {
        "design": design,
        "number": number,
        "verdict": found.verdict,
        "names": [e.name for e in found.effects],
        "words": "" if found.verdict == "no_gap" else found.sentence,
        "cpu_s": spent,
        "tau_s": scenario.attitude.reference.tau_s,
        "noise": found.provenance["noise"],
    }


def _quiet(tree: Tree) -> Tree:
    quiet = {key: dict(part) if isinstance(part, dict) else part for key, part in tree.items()}
    quiet["magnetometer"] |= {"noise_nT": 0.0, "lsb_nT": 0.0}
    quiet["attitude"] |= {"reference": {"sigma_deg": 0.0}}
    return quiet


def visible_nT(tree: Tree, section: Tree, modelled: Sequence[str]) -> float:
    """rms per component that the effect leaves beside the best S and b (those that are modelled)."""
    readings, misfits = [], []
    for effects in ({}, section):
        telemetry, _ = simulate(as_scenario(_quiet(tree) | {"effects": effects}))
        assert telemetry.q_NB is not None and telemetry.r_N_km is not None
        reference_N_nT = field_N_nT(load_field("igrf14"), telemetry.time, np.asarray(telemetry.r_N_km))
        readings.append(np.asarray(telemetry.mag_B_nT))
        misfits.append(readings[-1] - frames.rotation_from_q(np.asarray(telemetry.q_NB)).apply(reference_N_nT))
    change = misfits[1] - misfits[0]
    columns = [np.ones(len(change))[:, None]] if "bias" in modelled else []
    columns += [readings[0]] if "scale_misalignment" in modelled else []
    if columns:
        x = np.concatenate(columns, axis=1)
        change = change - x @ np.linalg.lstsq(x, change, rcond=None)[0]
    return float(np.sqrt(np.mean(change**2)))


def noise_rms_nT(tree: Tree) -> float:
    """rms per component of white noise, rounding and attitude error."""
    sensor, sigma = tree["magnetometer"], np.radians(tree["attitude"]["reference"]["sigma_deg"])
    white = sensor["noise_nT"] ** 2 + sensor["lsb_nT"] ** 2 / 12.0
    field = np.asarray(simulate(as_scenario(_quiet(tree)))[0].mag_B_nT)
    return float(np.sqrt(white + sigma**2 * 2.0 / 3.0 * np.mean(np.sum(field**2, axis=1))))


def single(case: Single, seed: int = 11) -> Tree:
    """Inject one effect, diagnose, compare."""
    tree = fixed_world(case.design, seed)
    for absent in case.without:
        tree.pop(absent)
    if case.modelled != DEFAULT_MODELLED:
        # What is not re-estimated must be right but for the effect.
        tree["magnetometer"] |= {"S": np.zeros((3, 3)).tolist(), "b_nT": [0.0, 0.0, 0.0]}
    effect, theta = case.effect, np.array(case.theta, dtype=float)
    noise = noise_rms_nT(tree)
    visible = float("nan")
    if isinstance(effect, SignalEffect) and case.visible is not None:
        for _ in range(3):  # not every effect is linear in its size
            section = effect_tree(effect, theta)
            visible = visible_nT(tree, section, case.modelled) / noise
            if not visible > 1e-6:
                return {"effect": case.label or effect.name, "design": case.design, "named": "unseen"}
            if abs(np.log(visible / case.visible)) < 0.1:
                break
            theta *= case.visible / visible
    section = effect_tree(effect, theta)
    visible = visible_nT(tree, section, case.modelled) / noise
    found, spent = answer(as_scenario(tree | {"effects": section}), case.modelled)
    first = next((e for e in found.effects if effect.name in {e.name, *e.group}), None)
    stages = {effect.stage, *effect.equivalent_stages}
    return {
        "effect": case.label or effect.name,
        "design": case.design,
        "size": _sizes(effect, theta),
        "visible": visible,
        "verdict": found.verdict,
        "named": "yes" if first is not None and first.name == effect.name else "group" if first else "no",
        "names": [e.name for e in found.effects],
        "group": list(first.group) if first else [],
        "settings": dict(first.settings) if first else {},
        "stage": found.where.stage,
        "stage_right": found.where.stage in stages,
        "pull": _pull(effect, theta, first),
        "closed": found.gap.closed,
        "resembles": list(found.resembles),
        "words": found.sentence,
        "cpu_s": spent,
        "noise": found.provenance["noise"],
    }


def _sizes(effect: Effect, theta: np.ndarray) -> str:
    live = [(p, v) for p, v in zip(effect.parameters, theta, strict=True) if v]
    words = ", ".join(f"{p.name} {v:.3g} {p.unit}" for p, v in live[:2])
    return words + (f", ... ({len(live)})" if len(live) > 2 else "")


def _pull(effect: Effect, theta: np.ndarray, found: Any) -> float | None:
    """Worst distance from the truth in sigmas; None where settings differ or nothing was named."""
    if found is None or found.name != effect.name:
        return None
    for key, value in vars(effect).items():
        if key not in ("typical_nT", "covariance") and found.settings.get(key, value) != value:
            return None
    pulls = []
    for parameter, value in zip(effect.parameters, theta, strict=True):
        known = found.parameters.get(parameter.name)
        if known is not None and known.sigma:
            pulls.append(abs(known.value - value) / known.sigma)
    return float(max(pulls)) if pulls else None


def _of(
    name: str, theta: Iterable[float], design: str = "nadir", *, settings: Tree | None = None, **more: Any
) -> Single:
    effect = dataclasses.replace(find_effect(name), **(settings or {}))
    return Single(effect, tuple(theta), design, **more)


def cases() -> list[Single]:
    """Every effect of the catalogue; some in more than one manner."""
    vector, rng = (1.0, -0.7, 0.5), np.random.default_rng(5)
    eddy, nine = (1.0, 0.4, -0.3, 0.5, -0.6), tuple(rng.standard_normal(9))
    return [
        _of("time_tag_offset", [5.0], "tumble"),
        _of("along_track_error", [20.0], "tumble"),
        _of(
            "time_tag_offset", [1.0, 20.0], "tumble", settings={"course": "linear"}, label="time_tag_offset that drifts"
        ),
        _of(
            "along_track_error",
            [20.0, 10.0],
            "tumble",
            settings={"course": "linear"},
            label="along_track_error that grows",
        ),
        _of("field_epoch", [3.0], "tumble"),
        _of("field_truncation", [1.0], settings={"degree": 6}, visible=None),
        _of("ring_current", [-150.0], "tumble"),
        _of("sun_sensor_head_misalignment", vector, settings={"head": 1}),
        _of("horizon_scanner_bias", [0.3, -0.2, 0.2, 0.3]),
        _of("yaw_drift", [0.3]),
        _of("yaw_drift", [2.0], settings={"when": "eclipse"}, label="yaw_drift in eclipse"),
        _of("attitude_step", vector, "tumble", settings={"at": "2020-03-01T03:11:40Z"}),
        _of("attitude_lag", [4.0], "tumble"),
        _of("torquer_coupling", nine),
        _of("solar_array_current", vector),
        _of("solar_array_current", vector, without=("power",), label="solar_array_current, no column"),
        _of("stray_field", nine, "tumble"),
        _of("battery_current", vector),
        _of("driver.payload", vector, settings={"delay_s": 45.0}),
        _of("heater_switching", vector),
        _of(
            "heater_switching",
            vector,
            without=("thermal",),
            settings={"sequence": _thermostat()},
            label="heater_switching, no column",
        ),
        _of("wheel_field", (1.0, -0.5, 0.2, 0.3, 0.9, -0.4)),
        _of(
            "wheel_field",
            (1.0, -0.5, 0.2, 0.3, 0.9, -0.4),
            without=("wheels",),
            settings={"frequency_Hz": 33.3947},
            label="wheel_field, no column",
        ),
        _of("eddy_current", eddy, "spin"),
        _of("switched_field", vector, "tumble", settings={"condition": "eclipse"}),
        _of("boom_bending", [0.005, -0.0035, 0.0025], "tumble"),
        _of("boom_bending", [0.005, -0.0035, 0.0025], without=("thermal",), label="boom_bending, no column"),
        _of("bias", vector, "tumble", modelled=("scale_misalignment",)),
        _of("scale_misalignment", 0.005 * rng.standard_normal(9), "tumble", modelled=("bias",)),
        _of("thermal_bias_drift", vector),
        _of("thermal_scale_drift", [1e-4, -7e-5, 5e-5], "tumble"),
        _of("common_gain_drift", [1e-3], "tumble"),
        _of("linear_drift", vector, "tumble"),
        _of(
            "linear_drift", [0.02, -0.01, 0.015], "tumble", settings={"of": "scale"}, label="linear_drift of the scale"
        ),
        _of("mounting_step", vector, "tumble", settings={"at": "2020-03-01T03:11:40Z"}),
        _of("bias_step", vector, settings={"at": "2020-03-01T03:11:40Z"}),
        _of("bias_random_walk", [5.0]),
        _of("hysteresis", vector, "tumble", settings={"width_nT": 4000.0}),
        _of("quadratic_nonlinearity", rng.standard_normal(18), "tumble"),
        _of("cubic_nonlinearity", rng.standard_normal(30), "tumble"),
        _of("sensor_lag", [2.0], "spin"),
        _of("sensor_lag", [2.0], "tumble", settings={"axis": "y"}, label="sensor_lag of y"),
        _of("axis_skew", [0.4, -0.3], "tumble"),
        _of("saturation", [3000.0], "tumble"),
        _of("coarse_quantization", [500.0]),
        _of("excess_noise", [120.0]),
        _of("excess_noise", [150.0], settings={"axis": "y"}, label="excess_noise on y"),
        _of("bit_errors", [0.01]),
        _of("bit_errors", [0.02], settings={"bit": 4}, label="bit_errors in bit 4"),
    ]


def _thermostat(rows: int = 900, step_s: float = 20.0) -> tuple[int, ...]:
    """A heater that cycles every 700 s."""
    return tuple(int((row * step_s) % 700.0 < 280.0) for row in range(rows))


def print_nulls(results: Sequence[Tree]) -> None:
    """The counts by design, and every exception."""
    for design in DESIGNS:
        mine = [r for r in results if r["design"] == design]
        good = sum(r["verdict"] == "no_gap" for r in mine)
        print(f"{design:8s} no_gap {good} of {len(mine)}")
    good = sum(r["verdict"] == "no_gap" for r in results)
    print(f"{'all':8s} no_gap {good} of {len(results)} (wanted {WANTED_NULLS:.0%})")
    for r in results:
        if r["verdict"] != "no_gap":
            print(f"  exception: {r['design']} number {r['number']} tau {r['tau_s']:g} s: {r['verdict']} {r['words']}")


def print_singles(results: Sequence[Tree]) -> None:
    """One line an effect."""
    head = ("effect", "design", "size", "visible", "verdict", "named", "stage", "pull", "closed", "answer")
    shape = "{:30s} {:7s} {:44s} {:>7s} {:8s} {:6s} {:14s} {:>5s} {:>6s} {}"
    print(shape.format(*head))
    for r in results:
        if r["named"] == "unseen":
            print(f"{r['effect']}: the design {r['design']} does not show it at all")
            continue
        stage = f"{r['stage']}{'' if r['stage_right'] else ' (wrong)'}"
        pull = "" if r["pull"] is None else f"{r['pull']:.1f}"
        closed = "" if r["closed"] is None else f"{r['closed']:.2f}"
        said = "+".join(r["names"]) or "resembles " + ",".join(r["resembles"])
        print(
            shape.format(
                r["effect"],
                r["design"],
                r["size"],
                f"{r['visible']:.2f}",
                r["verdict"],
                r["named"],
                stage,
                pull,
                closed,
                said,
            )
        )


def _all(work: Callable[[Any], Tree], items: Sequence[Any]) -> list[Tree]:
    with ProcessPoolExecutor(2) as pool:
        return list(pool.map(work, items))


def main() -> int:
    """Run what was asked for; 0 when the nulls are as wanted and every single is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nulls", type=int, default=0, help="how many perfect simulations")
    parser.add_argument("--first", type=int, default=0, help="number of the first perfect simulation")
    parser.add_argument("--singles", action="store_true", help="every effect alone")
    parser.add_argument("--only", default="", help="singles whose name begins so, comma separated")
    parser.add_argument("--undeclared", action="store_true", help="ask without any word on the noise")
    parser.add_argument("--quick", action="store_true", help="four nulls and three singles, to see that it runs")
    parser.add_argument("--json", help="write the figures to this file, or - for standard output")
    given = parser.parse_args()
    if given.quick:
        given.nulls, given.singles, given.only = 4, True, "time_tag,bias_step,excess_noise on"
    if not given.nulls and not given.singles:
        parser.error("nothing to do: give --nulls N, --singles or --quick")
    starts = tuple(given.only.split(","))
    chosen = [c for c in cases() if (c.label or c.effect.name).startswith(starts)] if given.singles else []
    nulls = _all(null, range(given.first, given.first + given.nulls))
    singles = _all(single, chosen)
    if given.json == "-":
        print(files.to_json({"nulls": nulls, "singles": singles}))
    else:
        if nulls:
            print_nulls(nulls)
        if singles:
            print_singles(singles)
        if given.json:
            files.write_json(given.json, {"nulls": nulls, "singles": singles})
    right = not nulls or np.mean([r["verdict"] == "no_gap" for r in nulls]) >= WANTED_NULLS
    return 0 if right and all(r["named"] in ("yes", "group") for r in singles) else 1


_MISSING = {effect.name for effect in CATALOGUE if not isinstance(effect, DynamicsEffect | Law)} - {
    case.effect.family for case in cases()
}  # a law is sought where no effect of the catalogue explains a gap, and never named as one
assert not _MISSING, f"no single for {_MISSING}"

if __name__ == "__main__":
    sys.exit(main())
