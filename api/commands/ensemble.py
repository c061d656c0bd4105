"""`fluxtwin ensemble`: thousands of vehicles of a scenario with drawn parameters."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

if TYPE_CHECKING:
    from fluxtwin.sim.run.ensemble.run import Ensemble

BRIEF = "Simulate thousands of vehicles with drawn parameters, on all cores."


def command(
    output: Output,
    scenario: Annotated[
        Path, of.argument("SCENARIO.toml", "A scenario whose [draws] say what differs between vehicles.")
    ],
    out: Annotated[Path, of.option("FOLDER", "Folder for the results; with --extract, the FILE to write.")],
    vehicles: Annotated[int | None, of.option("N", "How many vehicles.")] = None,
    seed: of.SeedOption = None,
    workers: of.Workers = of.WORKERS,
    chunk: Annotated[int | None, of.option("V", "Number of vehicles held in memory and written at a time.")] = None,
    resume: of.ResumeOption = False,
    extract: Annotated[
        int | None, of.option("K", "Simulate nothing; write the scenario of vehicle K (from 0).")
    ] = None,
) -> None:
    """Fly N vehicles of a scenario, each with its own drawn parameters, and sum up their pointing, rates and torquers.

    Results do not depend on the number of processes or on interruptions. Each process holds one chunk in memory.
    """
    if extract is not None:
        _extract(output, scenario, out, seed, extract)
        return
    from fluxtwin import outputs
    from fluxtwin.sim.base.errors import BadInput

    if vehicles is None:
        raise BadInput("how many vehicles?", where="--vehicles", wanted="a number, as --vehicles 1000")
    output.claim({"--out": (out, outputs.ENSEMBLE)}, [scenario])
    try:
        with output.progress(f"reading {scenario}") as progress:
            from fluxtwin.scenarios.packaged import load_scenario
            from fluxtwin.sim.run.ensemble.run import fly_ensemble

            how = {**workers._asdict(), "in_chunk": chunk, "resume": resume, "progress": progress}
            flown = fly_ensemble(load_scenario(scenario), vehicles, out, seed=seed, **how)
            drawn = _draw(flown)
    except KeyboardInterrupt:
        from fluxtwin.sim.run.ensemble.run import whole_chunks

        words = ["ensemble", scenario, "--vehicles", vehicles, "--out", out]
        of.say_how_to_go_on(output, whole_chunks(out), f"whole chunks are kept in {out}", words, seed, workers)
        raise
    _show(output, flown, drawn)


def _extract(output: Output, scenario: Path, out: Path, seed: int | None, vehicle: int) -> None:
    from fluxtwin import outputs
    from fluxtwin.scenarios.packaged import load_scenario
    from fluxtwin.sim.base.errors import BadInput
    from fluxtwin.sim.run.ensemble.plan import vehicle_scenario
    from fluxtwin.sim.scenario.scenario import save_scenario

    if vehicle < 0:
        raise BadInput(f"{vehicle}", where="--extract", wanted="the number of a vehicle, from 0")
    output.claim({"--out": (out, outputs.SCENARIO)}, [scenario])
    plan = load_scenario(scenario)
    drawn = vehicle_scenario(plan, plan.seed if seed is None else seed, vehicle)
    if plan.orbit is not None and plan.orbit.tle is not None:  # as seen from where the copy is going to lie
        drawn = drawn.updated({"orbit.tle": os.path.relpath(plan.path_of(plan.orbit.tle), out.parent)})
    save_scenario(drawn, out)
    output.say(f"vehicle {vehicle} of {plan.name}, seed {drawn.seed}")
    output.say(f"  {out}")
    output.result({"name": plan.name, "vehicle": vehicle, "seed": drawn.seed, "written": [str(out)]})


def _draw(flown: Ensemble) -> list[Path]:
    """The page, and the picture of the envelope, where there is a pointing."""
    from fluxtwin.flying import ensemble_sentence, ensemble_table
    from fluxtwin.report import write_figures, write_page
    from fluxtwin.scenarios.page import FigureBlock, Page, PageSection

    found, around, blocks = flown.summary, flown.envelope, []
    if around is not None and around.time.size > 1:
        from fluxtwin.plots.ensemble import pointing_envelope

        flew = flown.plan.vehicles - found["lost"]
        parts = (around.p5_deg, around.median_deg, around.p95_deg, around.max_deg)
        drawn = pointing_envelope(around.time, parts, title=flown.plan.scenario.name, vehicles=flew)
        caption = "Pointing error at each time over the vehicles; the worst of each moment need not be one vehicle."
        blocks = [FigureBlock("envelope", caption, drawn)]
    lost = [f"lost: vehicle {one['vehicle']}: {one['reason']}" for one in found["why_lost"][:3]]
    pointing, worst = found["figures"].get("pointing_rms_deg"), "K"
    if pointing is not None and pointing["vehicle_of_max"] is not None:
        worst = str(pointing["vehicle_of_max"])
    page = Page(
        title=f"{found['vehicles']} vehicles of {found['name'] or 'a scenario'}",
        verdict=ensemble_sentence(flown),
        next_step=f"fluxtwin ensemble with --extract {worst} writes the scenario of vehicle {worst}, to fly it alone.",
        sections=[PageSection("What came out", lost, [ensemble_table(flown)], blocks)],
        provenance={"seed": str(found["seed"]), "span": " to ".join(found["span"]), "samples": str(found["samples"])},
    )
    return [*write_figures(page, flown.folder), write_page(page, flown.folder / "report.html")]


def _show(output: Output, flown: Ensemble, drawn: list[Path]) -> None:
    from fluxtwin.flying import ensemble_table

    found = flown.summary
    output.tables([ensemble_table(flown)])
    for one in found["why_lost"][:3]:
        output.say(f"lost: vehicle {one['vehicle']}: {one['reason']}")
    if found["lost"]:
        output.say(f"{found['lost']} of {found['vehicles']} vehicles were lost; the figures are of the others")
    output.say(f"{found['samples']} samples a vehicle, {found['span'][0]} to {found['span'][1]}")
    names = ["summary.json", "vehicles.csv", f"chunk-*.nc ({found['chunks']})"]
    if flown.envelope is not None:
        names.append("envelope.csv")
    names += [path.name for path in drawn]
    output.say(f"  {flown.folder}: {', '.join(names)}")
    output.result(found)
