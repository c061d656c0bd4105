"""A campaign as a page and as tables to read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fluxtwin.calib.common.digits import plain
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fluxtwin.campaigning import Campaign


def sentences(summary: dict[str, Any]) -> list[str]:
    """What came out, the most important first."""
    said = []
    for name, one in summary["effects"].items():
        low, high = one["interval"]
        text = (
            f"{name} was named in {one['named']} of {one['runs']} runs ({100 * low:.0f} to {100 * high:.0f} %), in "
            f"{one['nothing_else']} of them without a false name"
        )
        at = one["size_at_90_percent"]
        said.append(
            f"{text}; at {plain(at, 2)} {one['unit']} it is named in nine of ten." if at is not None else f"{text}."
        )
    bare = summary["without_effects"]
    if bare["runs"]:
        said.append(f"Runs without an effect: {bare['runs']}; answered with no gap: {bare['no_gap']}.")
    false = sum(summary["false_names"].values())
    if summary["diagnosed"]:
        said.append(f"Runs diagnosed: {summary['diagnosed']}; false names in them: {false or 'none'}.")
    nees = summary["sigmas"]["nees"]
    if nees is not None:
        low, high = summary["sigmas"]["nees_by_chance"]
        holds = min(low, 0.85) <= nees <= max(high, 1.2)
        said.append(
            f"The errors of the calibration {'agree' if holds else 'do not agree'} with its sigmas: their squares, weighted "
            f"with the full covariance, are {plain(nees, 2)} times what is stated (1 is right; so many errors give "
            f"{plain(low, 2)} to {plain(high, 2)} by chance)."
            + (" Effects in the runs, which no calibration models, add to them." if summary["effects"] else "")
        )
    for what, key in (("lost", "lost"), ("not calibrated", "not_calibrated"), ("not diagnosed", "not_diagnosed")):
        for reason, count in list(summary[key].items())[:3]:
            said.append(f"{count} runs were {what}: {reason}")
    return said


def tables(summary: dict[str, Any]) -> list[Table]:
    """Effects by size, sigmas, false names."""
    found = []
    rows: list[list[str]] = []
    for name, one in summary["effects"].items():
        for part in one["bins"]:
            low, high = part["interval"]
            rows.append(
                [
                    name,
                    f"{plain(part['from'], 2)} to {plain(part['to'], 2)} {one['unit']}",
                    str(part["named"]),
                    str(part["runs"]),
                    f"{100 * low:.0f} to {100 * high:.0f} %",
                ]
            )
    if rows:
        note = "Size: the largest parameter of the effect. The interval is Wilson's, 95 %."
        found.append(Table("How often an effect is named", ["effect", "size", "named", "of", "interval"], rows, note))
    rows = []
    for name, one in summary["sigmas"]["parameters"].items():
        low, high = one["interval"]
        share = f"{one['inside']} of {one['runs']} ({100 * low:.0f} to {100 * high:.0f} %)"
        rows.append([name, plain(one["pull_rms"], 2), share])
    if rows:
        note = "Over the calibrated runs. No calibration models the effects that were drawn, so they add to its errors."
        columns = ["parameter", "rms of error / sigma", "within 1.96 sigma (95 % expected)"]
        found.append(Table("Whether the stated sigmas hold", columns, rows, note))
    if summary["false_names"]:
        rows = [[name, str(count)] for name, count in summary["false_names"].items()]
        found.append(Table("Names of effects that were not there", ["name", "times"], rows))
    return found


def power_figure(flown: Campaign) -> Figure | None:
    """Named or not over the size of each effect; None where no run has one."""
    from fluxtwin.campaign_scores import is_named
    from fluxtwin.plots.ensemble import PowerSeries, draw_power

    series = []
    for name, one in flown.summary["effects"].items():
        asked = [run for run in flown.runs if name in run["effects"] and not run.get("diagnosis", {"why": "-"})["why"]]
        size = np.array([run["effects"][name]["size"] for run in asked])
        named = np.array([is_named(run, name) for run in asked])
        bins = [(b["from"], b["to"], b["named"] / b["runs"], *b["interval"]) for b in one["bins"]]
        series.append(PowerSeries(name, one["unit"], size, named, bins, one["logistic"]))
    return draw_power(series, title="How often an effect is named") if series else None


def campaign_page(flown: Campaign) -> Page:
    """The page of one campaign."""
    summary = flown.summary
    said = sentences(summary)
    figure = power_figure(flown)
    caption = (
        "Ticks: single runs, at the top if the effect was named. Dots: shares with 95 % intervals. Curve, where the runs "
        "determine one: a logistic function of the logarithm of the size."
    )
    return Page(
        title=f"{summary['runs']} runs of {'a scenario' if summary['name'] == 'scenario' else summary['name']}",
        verdict=said[0] if said else "Nothing was diagnosed.",
        sections=[
            PageSection("What came out", said[1:]),
            PageSection(
                "Tables", [], tables(summary), [] if figure is None else [FigureBlock("power", caption, figure)]
            ),
        ],
        next_step="if an effect is missed at a size that matters, try longer records or other manoeuvres in the scenario.",
        provenance={"seed": str(summary["seed"]), "fingerprint of the plan": flown.plan.fingerprint},
    )
