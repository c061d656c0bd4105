"""The page of a run: the table in Markdown with its commit, and the confusions as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.plots import style
from fluxtwin.sim.base import files
from withheld_cases import beside, promises, score
from withheld_cases.judged import Judged
from withheld_cases.statistics import median

FIGURE = "withheld_confusion.png"
_HEAD = """# Withheld effects: how often the diagnosis is right

The records come from forward models that share no code with the effects of the catalogue, and the answers are
sealed before the diagnosis runs (`benchmarks/withheld.py`). The worlds have orbits of 600 to 1200 km; nadir pointing,
tumble, slews and spin; row spacings of 0.1 to 60 s; one orbit to two days; with or without housekeeping; and always a
calibration error.

- *Visible*: rms per component of what an effect leaves after the best re-estimation of `bias` and `scale_misalignment`,
  divided by the rms of the noise.
- *With a Jacobian*: effects whose signature follows from the flight. *Known by distribution*: only the statistics do
  (noise, steps, walks, bits, ...).
- *List exactly right*: every cause is named and nothing else. *False extra*: a name without a cause. *Wrongly confirmed*:
  a cause outside the catalogue was given a name. *Stage right*: the stage, or one that looks the same, is that of a cause.
- *Populations*: `nulls` are perfect flights, `singles`, `pairs` and `triples` have one to three effects, `faint` single
  effects that hardly show. `shapes` have an effect of another form than the catalogue gives it, `outside` a cause that it
  lacks. `torques` and `torque_pairs` have a wrong torque, alone or with another effect. `passes_only`, `short` and `coarse`
  are perfect flights of these kinds. With `_undeclared` nothing is declared, with `_two` there is a second magnetometer.
"""
_DETAILS = """# Withheld effects, case by case

The records of the run on the page of the [withheld effects](../withheld.md), by population. *All right* lists those of which
every answer was right, with their number; the others follow with what was said instead.
"""


def write(cases: Sequence[Judged], void: int, run: dict[str, Any], docs: Path) -> None:
    """docs/withheld.md and its figure. run: what `run.json` of the store holds."""
    _figure(score.confusion(cases), docs / "images" / FIGURE)
    files.write_text(docs / "withheld.md", page(cases, void, run))
    (docs / "design").mkdir(exist_ok=True)
    files.write_text(docs / "design" / "withheld_cases.md", details(cases))


def page(cases: Sequence[Judged], void: int, run: dict[str, Any]) -> str:
    """The Markdown."""
    counts: dict[str, int] = {}
    for case in cases:
        counts[case.population] = counts.get(case.population, 0) + 1
    listed = ", ".join(f"{name} {count}" for name, count in counts.items())
    made = f"commit `{run['commit']}`, seed {run['seed']}" if run.get("commit") else f"a tuning run, seed {run['seed']}"
    missing = f" {void} could not be made: no world showed the truth at the wanted size." if void else ""
    parts = [
        _HEAD,
        f"This run: {made}. {len(cases)} records: {listed}.{missing}",
        _contents(cases),
        "A row is met when the point estimate reaches its target (*reach*); the interval is Wilson's, 95 %. A row that is "
        "only *compared* has no target.",
        score.table([row for row in score.rows_of(cases) if row["of"]]),
        "## What was said of each effect",
        f"![What came first in the answer to each effect](images/{FIGURE})",
        "Records with one effect. Beside a bar is what came first instead; a group that contains the truth counts as right.",
        "## Stated probabilities",
        _reliability(cases),
        "## Outside the catalogue",
        promises.outside_list(cases),
        score.seconds(cases)
        + " [Every regime and every effect](design/withheld_cases.md) of this run has its own count.",
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def details(cases: Sequence[Judged]) -> str:
    """What was right, regime by regime and effect by effect."""
    parts = [
        _DETAILS,
        "## By regime",
        score.by(cases, "regime", "regime"),
        "## By effect, shape and regime",
        score.by(cases, "label", "effect or member"),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _contents(cases: Sequence[Judged]) -> str:
    """What the truths of this run have in them, as a list: field, sun and nadir, torques."""
    true = [case for case in cases if case.truths]
    rich = [float(case.sealed["richer_nT"]) for case in true if beside.is_richer(case)]
    words = [
        f"{len(rich)} of the {len(true)} records with a truth have the field of CHAOS to degree 20, which is "
        f"{median(rich):.1f} nT rms per component from the ground's model (median); it has no magnetosphere. The others, "
        "and all nulls, have the ground's own model."
        if rich
        else "The real field is that of the model used on the ground."
    ]
    own = [case for case in cases if case.population != "sensed"]
    pointing = [case for case in own if case.sealed["regime"] == "nadir"]
    words.append(
        f"{sum(map(beside.has_channel, pointing))} of {len(pointing)} records that point to the Earth contain sun and "
        "nadir as measured, with noise, rounding and faults of their own."
    )
    if len(own) < len(cases):
        words.append("The population `sensed` has each record twice, with these two vectors and without.")
    if any(case.population.startswith("torque") for case in cases):
        words.append(
            "For torques the diagnosis is also given a scenario of the vehicle (inertia, wheels, torquers, gravity "
            'gradient), and "visible" is the rotation that the torque causes within 25 minutes beyond what another '
            "initial state could cause, divided by the sigma of the attitude."
        )
    words += [text for name, text in _BESIDE.items() if any(case.population == name for case in cases)]
    return "\n".join(f"- {one}" for one in words)


_BESIDE = {
    "nulls_undeclared": "Half of `nulls_undeclared` are the scenario of the README with seeds of their own.",
    "nulls": "`nulls`, perfect flights with everything declared, goes through the regimes in turn. Passes are arcs of ten "
    "minutes, hours apart, with a sensor noise of 2 to 6 nT, an attitude error of 0.18 to 0.27 deg that wanders over 200 to "
    '4000 s, and S of 1.5 to 4 %. Outliers are 10 to 100 times the noise, and "no gap apart from these rows" is right '
    "there. `passes_only`, `short` and `coarse` have nothing declared.",
    "new_singles": "`new_singles` has effects that join the table with its next edition.",
    "outside_two": "`outside_two` and `singles_two` are the first flights of `outside` and `singles` once more, with a "
    "second magnetometer of its own S, b, noise and steps. It has 0 to 70 % of the spacecraft's fields and no fault of the "
    "first sensor.",
    "limits": "`limits` takes the smallest detectable size that the answer on a perfect flight prints for an effect, and "
    "flies it in the same world, in the parameter that is printed, with a random sign and other noise.",
    "undetermined": "`undetermined` are spins of 20 to 100 deg/s without attitude, with a body field of 1 to 2 gauss; where "
    "|B| leaves b open by more than 1,000 nT, 1 sigma, nothing may be named and the answer has to say what is missing.",
}


def _reliability(cases: Sequence[Judged]) -> str:
    pairs = [pair for case in cases for pair in case.stated()]
    lines = ["| stated (mean of bin) | came true | names |", "|---|---|---|"]
    if pairs:
        bins = score.reliability([p for p, _ in pairs], [hit for _, hit in pairs])
        lines += [f"| {stated:.3f} | {true:.3f} | {count} |" for stated, true, count in bins]
    return "\n".join(lines)


def _figure(confusion: dict[str, dict[str, int]], target: Path) -> None:
    """A bar per effect: records in which it came first, and beside them what did instead."""
    truths = sorted(confusion, reverse=True)
    made, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 1.0 + 0.2 * len(truths))
    rows = range(len(truths))
    right = np.array([confusion[truth].get(truth, 0) for truth in truths])
    wrong = np.array([sum(confusion[truth].values()) for truth in truths]) - right
    axes.barh(rows, right, color=style.BLUE, label="the effect")
    axes.barh(rows, wrong, left=right, color=style.VERMILION, hatch="///", edgecolor="white", label="something else")
    for row, truth in enumerate(truths):
        others = sorted((name, count) for name, count in confusion[truth].items() if name != truth)
        text = ", ".join(f"{_plain(name)} {count}" for name, count in others)
        axes.annotate(text, (right[row] + wrong[row], row), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(rows, [_plain(truth) for truth in truths])
    axes.set_ylim(-0.6, len(truths) - 0.4)
    axes.set_xlim(0, 1.15 * max([*(right + wrong), 1]))
    axes.grid(False, axis="y")
    axes.xaxis.get_major_locator().set_params(integer=True)
    style.label(axes, x="records with this one effect", title="What came first in the answer")
    style.legend(axes, "lower right")
    target.parent.mkdir(parents=True, exist_ok=True)
    made.savefig(target, dpi=140, metadata={"Software": None})


def _plain(name: str) -> str:
    return name.replace("_", " ")
