"""Table 5 and figure 3 to read: our 43 rows beside the printed ones, the dawn passes, and the pass over Winkfield."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.scenarios.hcmm.claims import Results
from fluxtwin.scenarios.hcmm.judges_passes import FIGURE_3
from fluxtwin.scenarios.hcmm.mission import quantity
from fluxtwin.scenarios.hcmm.pass_study import ANOMALOUS, LIMIT_MG, printed_rms
from fluxtwin.scenarios.hcmm_orbit.record import Pass, Range
from fluxtwin.scenarios.page import Cell, Table
from fluxtwin.sim.base.types import BoolArray
from fluxtwin.sim.earth import epoch


def strength_table(r: Results) -> Table:
    """Table 5, residual of field strength."""
    p = r.passes
    rows: list[list[Cell]] = [
        [
            _marked(item), "sunlit" if item.sunlit else "night", ours.samples, f"{ours.eps_M_mG:.2f}",
            f"{item.eps_M_mG:.2f}", f"{low:.1f} to {high:.1f}", f"{model:.2f}",
        ]
        for item, ours, model, (low, high) in zip(p.passes, p.rows, p.field_model_eps_mG, p.eps_range_mG, strict=True)
    ]  # fmt: skip
    for count, chosen in ((39, p.quiet), (43, np.ones(len(p.passes), dtype=bool))):
        printed = printed_rms([x.eps_M_mG for x in _of(p.passes, chosen)])
        model = float(np.sqrt(np.mean(p.field_model_eps_mG[chosen] ** 2)))
        line = _unbroken(f"rms, {count} passes")
        rows.append([line, "", "", f"{p.rms('eps_M_mG', chosen):.2f}", f"{printed:.2f}", "", f"{model:.2f}"])
        rows.append([f"{line}\u00a0(C)", "", "", "", f"{quantity(f'residual {count} passes'):.2f}", "", ""])
    return Table(
        "Table 5 (C): residual of field strength in 43 passes",
        ["pass", "light", "samples", "ours [mG]", "printed [mG]", "5 to 95 % [mG]", "error of IGRF 1975 [mG]"],
        rows,
        f"rms of measured less model field strength. * dawn pass over Orroral; ** the four printed above {LIMIT_MG:g} mG, "
        "which the 39 leave out. Ours: one simulated flight in the window that the printed sun-nadir range fixes. 5 "
        "to 95 %: "
        "of ours over calibrations made with other passes. Last column: no simulation, IGRF 1975 against what is known of "
        "the field today. Lines (C): the paper's own rms.",
    )


def angles_table(r: Results) -> Table:
    """Table 5, the three angles: range and residual, each ours and printed."""
    p, lit = r.passes, r.passes.sunlit & ~r.passes.dawn
    rows: list[list[Cell]] = [
        [
            _marked(item),
            *_range(ours.sun_field, item.sun_field), *_residual(ours.delta_sun_field, item.delta_sun_field_deg),
            *_range(ours.nadir_field, item.nadir_field_read),
            *_residual(ours.delta_nadir_field, item.delta_nadir_field_deg),
            *_range(ours.sun_nadir, item.sun_nadir), *_residual(ours.delta_sun_nadir, item.delta_sun_nadir_deg),
        ]
        for item, ours in zip(p.passes, p.rows, strict=True)
    ]  # fmt: skip
    for count, chosen in ((39, p.quiet), (43, np.ones(len(p.passes), dtype=bool))):
        line, by_sun = _unbroken(f"rms, {count} passes"), count == 39
        ours_row: list[Cell] = [line]
        paper_row: list[Cell] = [f"{line}\u00a0(C)"]
        for name, shown in (("sun_field", by_sun), ("nadir_field", True), ("sun_nadir", by_sun)):
            rows_of_it = chosen if name == "nadir_field" else lit
            printed = printed_rms([getattr(x, f"delta_{name}_deg") for x in _of(p.passes, rows_of_it)])
            ours = _residual(p.rms(f"delta_{name}", rows_of_it), printed) if shown else ("", "")
            words = f"{name.replace('_', '-')} residual" + (f" {count} passes" if name == "nadir_field" else "")
            ours_row += ["", "", *ours]
            paper_row += ["", "", "", f"{quantity(words):.2f}" if shown else ""]
        rows += [ours_row, paper_row]
    columns = ["pass"]
    for angle in ("sun-field", "nadir-field", "sun-nadir"):
        columns += [angle, "(C)", "rms", "(C)"]
    return Table(
        "Table 5 (C): angles in 43 passes [deg]",
        columns,
        rows,
        "Of each angle the lowest and highest, and the rms of measured less computed; each ours, then the printed one (C). "
        "* dawn pass over Orroral, head 1: a dash where no sample of the window sees the sun. Ranges are computed in "
        "the window that the "
        "printed sun-nadir range fixes; printed nadir-field angles as scanned. Angles with the sun: rms over the 19 other "
        "sunlit passes. Lines (C): the paper's own rms.",
    )


def dawn_table(r: Results) -> Table:
    """The residual that head 1 leaves in the dawn passes."""
    d = r.dawn
    once = dict(zip((item.label for item in r.passes.passes), r.passes.rows, strict=True))
    printed = {item.label: item.delta_sun_nadir_deg for item in r.passes.passes}
    means = d.by_label()
    rows: list[list[Cell]] = []
    for place, (label, count) in enumerate(zip(d.labels, d.samples, strict=True)):
        mean, value = means[label], once[label].delta_sun_nadir
        spread = d.residual_deg[:, place].std(ddof=1)
        rows.append(
            [label, count, "-" if value is None else f"{value:.2f}", "-" if mean is None else f"{mean:.2f} ± {spread:.2f}",
             f"{printed[label]:.2f}"]
        )  # fmt: skip
    together, spread = d.together_deg
    rows.append(["together, rms", sum(d.samples), "", f"{together:.2f} ± {spread:.2f}", ""])
    each = quantity("sun-nadir residual")
    turn = quantity("head 1 misalignment")
    return Table(
        "Sun-nadir residual of head 1 at dawn [deg]",
        ["pass", "sunlit samples", "the flight of Table 5", f"mean of {len(d.residual_deg)} flights", "printed"],
        rows,
        "± is the scatter from flight to flight, large because so little of these passes is sunlit. A head turned by "
        f"{turn:g} deg and the {each:.2f} deg of the other passes give {np.hypot(turn, each):.2f} deg.",
    )


def figure_3_table(r: Results) -> Table:
    """The pass over Winkfield, ours beside the text."""
    y = r.yaw
    ours = (*y.sun_nadir_deg, y.delta_sun_nadir_deg, y.delta_nadir_field_deg, y.error_bar_deg)
    digits = (0, 0, 2, 2, 2)
    rows: list[list[Cell]] = [["rise [UTC]", epoch.iso(y.contact.rise)[11:19], "11:35"]]
    rows += [
        [f"{name} [deg]", f"{value:.{n}f}", f"{quantity(f'figure 3 {name}'):.{n}f}"]
        for name, value, n in zip(FIGURE_3, ours, digits, strict=True)
    ]
    rows += [
        ["magnetometer against sun-sensor yaw, rms [deg]", f"{y.yaw_rms_deg:.2f}", ""],
        ["magnetometer against the true yaw, rms [deg]", f"{y.magnetometer_yaw_rms_deg:.2f}", ""],
        ["sun sensor against the true yaw, rms [deg]", f"{y.sun_yaw_rms_deg:.2f}", ""],
    ]
    return Table(
        "Figure 3 (C): the pass over Winkfield, 29 November 1978",
        ["quantity", "ours", "printed"],
        rows,
        "Error bar by the papers' rule: the mean of the nadir-field residual and Table 6 at Winkfield. Ours runs from rise "
        "to set along the fitted orbit.",
    )


def span(ends: Range) -> str:
    """As 17-31, or one number if both are the same."""
    low, high = (f"{value:.0f}" for value in ends)
    return low if low == high else f"{low}-{high}"


def _marked(item: Pass) -> str:
    return _unbroken(item.label + ("*" if item.dawn else "**" if item.number in ANOMALOUS else ""))


def _unbroken(words: str) -> str:
    """On one line however narrow the column."""
    return words.replace(" ", "\u00a0")


def _of(passes: Sequence[Pass], chosen: BoolArray) -> list[Pass]:
    return [item for item, yes in zip(passes, chosen, strict=True) if yes]


def _range(ours: Range | None, printed: Range | None) -> tuple[str, str]:
    return ("", "") if ours is None or printed is None else (span(ours), span(printed))


def _residual(ours: float | None, printed: float | None) -> tuple[str, str]:
    if ours is None and printed is None:
        return "", ""
    return "-" if ours is None else f"{ours:.2f}", "-" if printed is None else f"{printed:.2f}"
