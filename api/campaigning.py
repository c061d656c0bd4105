"""The verb `campaign`: what would we see of our own spacecraft? Many drawn flights, each calibrated and diagnosed.

A run is a vehicle of an ensemble: what happens in it depends on scenario, seed and its number. The ground knows the
scenario without its effects and without what was drawn, as a mission knows its design; truth enters the scores alone.
"""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import fluxtwin
from fluxtwin.notebook import usual
from fluxtwin.outputs import JSON_MARK
from fluxtwin.scenarios.packaged import as_scenario
from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.seals import sealed_json, unsealed_json
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.workers import answers, require_workers
from fluxtwin.sim.run.ensemble.plan import Plan, flattened, make_plan, require_same, write_record
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.formats.table import extra

RECORD, RUNS, SUMMARY = "campaign.json", "runs.csv", "summary.json"
_IN_PART = 4
"""Runs of one part: seconds, so that little is lost with it."""
Run = dict[str, Any]
"""What is kept of a run: see `one_run`."""


@dataclass(frozen=True)
class Campaign(Shown):
    """A campaign that was flown; everything is in its folder as well."""

    folder: Path
    plan: Plan
    runs: list[Run]
    summary: dict[str, Any]


def campaign(
    scenario: Scenario | Path | str,
    runs: int,
    out: Path | str,
    *,
    seed: int | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    executor: Executor | None = None,
    resume: bool = False,
    progress: Progress = usual,
) -> Campaign:
    """Fly runs of a scenario with [draws], calibrate and diagnose each; a folder keeps the results.

    runs: how many, from 1. out: the path of the folder. seed: of all that is random, the scenario's own where not given;
    jobs, scheduler, executor: as for `ensemble`; resume: go on with what is in the folder. Raises BadInput as `ensemble`
    does, and NoAnswer where no run came to an end.
    """
    require_workers(jobs, scheduler)
    folder = Path(out)
    if runs < 1:
        raise BadInput(f"{runs} runs", where="--runs", wanted="1 or more")
    plan = make_plan(as_scenario(scenario), runs, seed, min(_IN_PART, runs))
    for number in range(plan.chunks):
        plan.check(number)
    files.writable_folder(folder)
    if (folder / RECORD).exists():
        if not resume:
            wanted = "--resume to go on with it, or another folder"
            raise BadInput("a campaign lies here already", where=str(folder), wanted=wanted)
        require_same(plan, folder, RECORD)
    write_record(plan, folder, RECORD)
    known = {number: rows for number in range(plan.chunks) if (rows := _kept(plan, folder, number)) is not None}
    record = plan.record()
    calls = [(record, number) for number in range(plan.chunks) if number not in known]
    begin, done = time.monotonic(), sum(map(len, known.values()))
    before = done
    for number, rows in answers(run_part, calls, jobs=jobs, scheduler=scheduler, executor=executor):
        content = {"fingerprint": plan.fingerprint, "runs": rows}
        files.write_json(folder / _part(number), sealed_json(content))
        known[number] = json.loads(files.to_json(content))["runs"]  # as a resumed campaign reads it
        done += len(rows)
        left_s = (time.monotonic() - begin) / (done - before) * (runs - done)
        progress(f"run {done} of {runs}, {_words(left_s)} left", 0.98 * done / runs)
    found = [run for number in sorted(known) for run in known[number]]
    if all(run["lost"] for run in found):
        raise NoAnswer(f"all {runs} runs were lost; the first: {found[0]['lost']}")
    from fluxtwin.campaign_scores import summarise

    summary = summarise(plan.scenario.name, plan.seed, found)
    _write_table(found, folder / RUNS)
    files.write_json(folder / SUMMARY, sealed_json({JSON_MARK: fluxtwin.__version__, **summary}))
    return Campaign(folder, plan, found, summary)


def run_part(record: Mapping[str, Any], number: int) -> tuple[int, list[Run]]:
    """The runs of one part of a recorded plan, for a process anywhere."""
    plan = Plan.from_record(record)
    known = plan.scenario.updated({"effects": None, "draws": None})
    return number, [one_run(plan.vehicle(run), known, run, plan.drawn(run)) for run in plan.members(number)]


def one_run(flown: Scenario, known: Scenario, number: int, drawn: Mapping[str, Any]) -> Run:
    """Fly one scenario, calibrate and diagnose it with what is known, and compare with the truth: plain values.

    `lost`: why there is nothing else. `effects`: the largest parameter of each effect that is in it, with its unit.
    `calibration`: errors and sigmas by parameter, or why there is none; `diagnosis`: verdict and names, or why
    there is none.
    """
    from fluxtwin.sim.run.simulate import simulate

    run: Run = {"run": number, "seed": flown.seed, "drawn": flattened(drawn), "lost": "", "effects": _present(flown)}
    try:
        telemetry, truth = simulate(flown)
    except BadInput as error:
        return {**run, "lost": str(error)}
    return {**run, "calibration": _calibrated(telemetry, truth, known), "diagnosis": _diagnosed(telemetry, known)}


def _present(flown: Scenario) -> dict[str, dict[str, Any]]:
    from fluxtwin.sim.scenario.effect_sections import active_effects

    found = {}
    for effect, theta in active_effects(flown):
        if theta.any():
            place = int(np.argmax(np.abs(theta)))
            one = effect.parameters[place]
            found[effect.name] = {"size": float(abs(theta[place])), "unit": one.unit, "parameter": one.name}
    return found


def _calibrated(telemetry: Any, truth: Any, known: Scenario) -> dict[str, Any]:
    from fluxtwin.calib.methods import ESTIMATORS
    from fluxtwin.verbs import calibrate

    try:
        coupled = known.torquers is not None and bool(telemetry.has_attitude.any())
        fit = calibrate(telemetry, parameters="b,S,T") if coupled else calibrate(telemetry)
    except (BadInput, NoAnswer) as error:
        return {"why": str(error)}
    made = fit.calibration
    verdict = "" if fit.verdict is None else fit.verdict.lines[0]
    if "attitude" not in ESTIMATORS[fit.method].needs:  # without attitude S is known up to a rotation
        return {"why": "", "verdict": verdict, "method": fit.method, "parameters": {}, "nees": None}
    parts = [truth.S.ravel(), truth.b_nT, truth.T_nT_per_Am2.ravel()]
    at = np.flatnonzero(made.sigmas > 0)
    off = (made.values - np.concatenate(parts)[: made.values.size])[at]
    sigma = made.sigmas[at]
    scaled = made.covariance[np.ix_(at, at)] / np.outer(sigma, sigma)
    pull = off / sigma
    return {
        "why": "",
        "verdict": verdict,
        "method": fit.method,
        "parameters": {made.names[k]: [float(e), float(s)] for k, e, s in zip(at, off, sigma, strict=True)},
        "nees": float(pull @ np.linalg.solve(scaled, pull)) / at.size if at.size else None,
    }


def _diagnosed(telemetry: Any, known: Scenario) -> dict[str, Any]:
    from fluxtwin.diagnosing import diagnose

    try:
        found = diagnose(telemetry, scenario=known)
    except (BadInput, NoAnswer) as error:
        return {"why": str(error)}
    names = [{"name": f.name, "group": list(f.group), "probability": f.probability} for f in found.effects]
    gap = found.gap
    return {
        "why": "",
        "verdict": found.verdict,
        "stage": found.where.stage,
        "names": names,
        "before_nT": gap.before_nT,
        "after_nT": gap.after_nT,
        "closed": gap.closed,
    }


def _part(number: int) -> str:
    return f"part-{number:05d}.json"


def _kept(plan: Plan, folder: Path, number: int) -> list[Run] | None:
    """The runs of a part that is there, whole and of this plan."""
    try:
        content = unsealed_json(
            (folder / _part(number)).read_text(encoding="utf-8"), where=_part(number), wanted="part of a campaign"
        )
        rows: list[Run] = content["runs"]
    except (OSError, ValueError, KeyError, TypeError, BadInput):
        return None
    same = content.get("fingerprint") == plan.fingerprint
    return rows if same and [row.get("run") for row in rows] == list(plan.members(number)) else None


def _words(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _write_table(runs: Sequence[Run], path: Path) -> None:
    """A row a run: what was drawn, what was in it, what was said; also as Parquet where pandas and pyarrow are there."""
    from importlib.util import find_spec

    rows = [dict(_cells(run)) for run in runs]
    text, names = io.StringIO(), list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if value != value else value for name, value in row.items()} for row in rows)
    files.write_text(path, text.getvalue())
    if find_spec("pyarrow") and find_spec("pandas"):
        table = extra("pandas", "parquet", path).DataFrame(rows)
        files.write_with(path.with_suffix(".parquet"), lambda temporary: table.to_parquet(temporary, index=False))


def _cells(run: Run) -> Iterator[tuple[str, Any]]:
    yield from ((key, run[key]) for key in ("run", "seed", "lost"))
    yield from run["drawn"].items()
    for name, one in run["effects"].items():
        yield f"size of {name} [{one['unit']}]", one["size"]
    fit, said = run.get("calibration", {}), run.get("diagnosis", {})
    for name, (error, sigma) in fit.get("parameters", {}).items():
        yield f"{name} error", error
        yield f"{name} sigma", sigma
    yield "NEES per parameter", fit.get("nees")
    yield "no calibration because", fit.get("why", "")
    yield from ((key, said.get(key)) for key in ("verdict", "stage", "before_nT", "after_nT", "closed"))
    yield "names", "; ".join(one["name"] for one in said.get("names", ()))
    yield "no diagnosis because", said.get("why", "")
