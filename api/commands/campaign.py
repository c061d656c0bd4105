"""`fluxtwin campaign`: what would we see of our own spacecraft?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Simulate, calibrate and diagnose many drawn flights: would you see an effect on your spacecraft?"


def command(
    output: Output,
    scenario: Annotated[
        Path, of.argument("SCENARIO.toml", "A scenario whose [draws] and [effects] say what is varied.")
    ],
    out: Annotated[Path, of.option("FOLDER", "Folder for the results.")],
    runs: Annotated[int, of.option("N", "How many runs.")],
    seed: of.SeedOption = None,
    workers: of.Workers = of.WORKERS,
    resume: of.ResumeOption = False,
) -> None:
    """Fly N runs with drawn parameters, calibrate and diagnose each as the ground would, and compare with the truth.

    Says how often each effect is named at each size, whether the stated sigmas hold, and which names are false.
    """
    from fluxtwin import outputs

    output.claim({"--out": (out, outputs.CAMPAIGN)}, [scenario])
    try:
        with output.progress(f"reading {scenario}") as progress:
            from fluxtwin import campaign_page, campaigning
            from fluxtwin.report import write_figures, write_page

            how = {**workers._asdict(), "resume": resume}
            flown = campaigning.campaign(scenario, runs, out, seed=seed, progress=progress, **how)
            progress("drawing", 0.99)
            page = campaign_page.campaign_page(flown)
            write_page(page, out / "report.html")
            write_figures(page, out)
    except KeyboardInterrupt:
        kept, words = len(list(out.glob("part-*.json"))), ["campaign", scenario, "--runs", runs, "--out", out]
        of.say_how_to_go_on(output, kept, f"parts are kept in {out}", words, seed, workers)
        raise
    output.prose(*campaign_page.sentences(flown.summary))
    for table in campaign_page.tables(flown.summary):
        output.say()
        output.tables([table])
    output.say(f"  {out}: report.html, runs.csv, summary.json, part-*.json ({flown.plan.chunks})")
    output.result(flown.summary)
