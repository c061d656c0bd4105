"""What the two residuals that the simulation misses may be: the angle to nadir by night, and the field strength."""

from __future__ import annotations

import numpy as np

from fluxtwin.gap.records import EffectParameter
from fluxtwin.plots import passes as pass_plots
from fluxtwin.scenarios.hcmm.horizon_study import EARTHS, SCANS, SHIFTS_DEG, HorizonStudy, Seen
from fluxtwin.scenarios.hcmm.missing_study import NUMBERS, SURE, Hypothesis, MissingStudy
from fluxtwin.scenarios.page import Cell, FigureBlock, Section, Table
from fluxtwin.sim.earth.horizon import INFRARED_SOURCE


def horizon_section(h: HorizonStudy) -> Section:
    """Whether the night's residual of the nadir-field angle is the scanner's."""
    return Section(
        "The angle to nadir by night: is it the scanner?",
        [f"Of the residual of the angle between nadir and field: {h.words}."],
        [horizon_table(h)],
        [
            FigureBlock(
                "scanner_nulls",
                "The infrared Earth taken for a sphere, its errors moved along the orbit. Left: residual of the nadir-field "
                "angle by night over that by day. Right: how the night passes are ranked, against print. At 0 and 180 deg "
                "the Earth's flattening is the same; everything else is a null.",
                pass_plots.draw_moved(
                    pass_plots.MovedErrors(
                        SHIFTS_DEG,
                        {name: np.array([one.ratio for one in seen]) for name, seen in h.shifted.items()},
                        {name: np.array([one.correlation for one in seen]) for name, seen in h.shifted.items()},
                        h.printed.ratio, h.disc.ratio, h.disc.correlation,
                    ),
                    title="The scanner's errors, where they belong and elsewhere",
                ),
            )
        ],
    )  # fmt: skip


def horizon_table(h: HorizonStudy) -> Table:
    """Scanner by scanner."""
    rows: list[list[Cell]] = [["printed", _seen(h.printed), "", ""], ["scanner of the study", _seen(h.disc), "", ""]]
    rows += [[earth.words, *(_seen(h.cases[scans, earth.words]) for scans in SCANS)] for earth in EARTHS]
    return Table(
        "The nadir-field residual and the scanner",
        ["horizon", *SCANS],
        rows,
        "Residual by night over that by day; in brackets both [deg rms], and the rank correlation of the night passes with "
        "those printed. Scans of 45 deg half-cone about body y; each scanner is calibrated by heads 2 and 3. Infrared "
        f"horizon: {INFRARED_SOURCE}",
    )


def _seen(one: Seen) -> str:
    ranked = "" if one.correlation > 0.999 else f"; {one.correlation:.2f}"
    return f"{one.ratio:.2f} ({one.night:.2f}, {one.day:.2f}{ranked})"


def missing_section(m: MissingStudy) -> Section:
    """What the missing field strength may be."""
    return Section(
        "The missing field strength: what may it be?",
        [
            "Each hypothesis is one error added to the simulation, sized by the 39 quiet passes alone; the other printed "
            f"numbers judge it. {m.words}. No samples of the flight are left, so the diagnosis cannot be asked about the "
            "flight itself. Asked about the telemetry of each hypothesis, over the three days of Table 5 and with the field "
            "as it is known today, it says what the last line tells."
        ],
        [missing_table(m)],
    )


def missing_table(m: MissingStudy) -> Table:
    """Hypothesis by hypothesis."""
    rows: list[list[Cell]] = [
        [name, f"{m.printed[k]:.2f}", *(f"{h.mean[k]:.2f} ± {h.spread[k]:.2f}" for h in m.hypotheses)]
        for k, name in enumerate(NUMBERS)
    ]
    rows.append(["excluded by", "", *(_excluded(h, m) for h in m.hypotheses)])
    rows.append(["the diagnosis says", "", *(_named(h) for h in m.hypotheses)])
    return Table(
        "Hypotheses for the missing residual of field strength",
        ["number", "printed", *(h.name for h in m.hypotheses)],
        rows,
        f"Mean of {len(m.hypotheses[0].values)} flights ± standard deviation of one. A printed number excludes a hypothesis "
        f"where a further flight would be as far away with a probability below {SURE:g} (Student's t, all numbers counted); "
        "the first number has set the size and judges nothing.",
    )


def _excluded(one: Hypothesis, m: MissingStudy) -> str:
    return "; ".join(name.split(" [")[0] for name in one.excluded_by(m.printed)) or "none"


def _named(one: Hypothesis) -> str:
    found = one.diagnosis
    if found is None:
        return "not asked"
    effects = [f"{e.name} ({', '.join(_value(*item) for item in e.parameters.items())})" for e in found.effects]
    where = f", at the stage {found.where.stage}" if found.verdict == "unknown" else ""
    return "; ".join(effects) or found.verdict.replace("_", " ") + where


def _value(name: str, parameter: EffectParameter) -> str:
    sigma = "" if parameter.sigma is None else f" ± {parameter.sigma:.2g}"
    return f"{name} {parameter.value:.3g}{sigma} {parameter.unit}"
