"""`fluxtwin simulate`: a scenario becomes telemetry."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output
from fluxtwin.scenarios.packaged import NAMES, load_scenario
from fluxtwin.sim.base.errors import amount

BRIEF = "Simulate telemetry from a scenario."


def command(
    output: Output,
    scenario: Annotated[Path, of.argument("SCENARIO.toml", f"What is simulated: a TOML file, or by name {NAMES}.")],
    out: of.OutOption,
    truth: Annotated[
        Path | None, of.option("FILE", "Write the truth to this file; telemetry never contains it.")
    ] = None,
    field: of.ScenarioFieldOption = None,
    degree: of.DegreeOption = None,
) -> None:
    """Simulate a scenario and write its telemetry (.nc, .csv or .csv.gz), and the scenario beside it."""
    with output.progress(f"reading {scenario}") as progress:
        from fluxtwin import outputs
        from fluxtwin.sim.base.files import is_stream
        from fluxtwin.sim.earth.epoch import iso
        from fluxtwin.sim.run.simulate import simulate
        from fluxtwin.sim.scenario.scenario import save_scenario
        from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

        plan = load_scenario(scenario)
        changes = {"field.truth": field, "field.truth_degree": degree}
        plan = plan.updated({key: value for key, value in changes.items() if value is not None})
        stem = Path(out.name.removesuffix(".gz")).stem
        beside = None if is_stream(out) else out.with_name(f"{stem}.scenario.toml")
        if beside is not None and beside.exists() and scenario.exists() and beside.samefile(scenario):
            beside = None  # the scenario lies there already, as its author wrote it
        targets = {
            "--out": (out, outputs.TELEMETRY),
            "--truth": (truth, outputs.TRUTH),
            "the scenario beside --out:": (beside, outputs.SCENARIO),
        }
        output.claim(targets, [scenario, field])
        # The scenario with the files it names given relative to `folder`, where its copy is going to lie.
        named = {
            "orbit.tle": plan.orbit and plan.orbit.tle,
            "replay.telemetry": plan.replay and plan.replay.telemetry,
            "replay.column_map": plan.replay and plan.replay.column_map,
        }
        moved = {key: os.path.relpath(plan.path_of(name), out.parent) for key, name in named.items() if name}
        saved = plan.updated(moved) if moved else plan
        record, real = simulate(plan, progress=progress)
        written = [write_telemetry(record, out)]
        if beside is not None:
            written.append(save_scenario(saved, beside))
        if truth is not None:
            real.write(truth)
            written.append(truth)
    span = [iso(record.time[0]), iso(record.time[-1])]
    output.say(f"{plan.name}: {amount(len(record), 'sample|samples')}, {span[0]} to {span[1]}, seed {plan.seed}")
    output.files(written)
    about = {"name": plan.name, "seed": plan.seed, "samples": len(record), "span": span}
    output.result({**about, "written": [str(path) for path in written]})
