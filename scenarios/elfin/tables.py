"""Tables and figures of the study."""

from __future__ import annotations

import math

import numpy as np

from fluxtwin.plots.elfin import Bars, Left, Response, left_figure, response_figure, zones_figure
from fluxtwin.scenarios.elfin.compute import Results, ZoneTold
from fluxtwin.scenarios.elfin.settings import Settings
from fluxtwin.scenarios.elfin.unseen import Lags, Told
from fluxtwin.scenarios.elfin.zone_fit import KINDS
from fluxtwin.scenarios.page import Cell, FigureBlock, Table

_SUNLIT = 0.999
_RANKED = 6


def zone_table(results: Results) -> Table:
    """Each zone by itself."""
    rows: list[list[Cell]] = [
        [
            told.zone.number, _light(told), round(2.0 * math.pi / told.fits["static"].rate_rad_s, 4),
            *(round(told.fits[kind].rms_nT, 1) for kind in KINDS), round(told.noise_nT, 2),
            int((~told.zone.used).sum()),
        ]
        for told in results.zones
    ]  # fmt: skip
    headings = ["static [nT]", "drifting [nT]", "drifting twice [nT]", "third harmonic too [nT]"]
    return Table(
        "Each zone by itself, with its own spin phase",
        ["zone", "light", "spin period [s]", *headings, "local noise [nT]", "rows left out"],
        rows,
        note="rms length of the residual vector. Static: twelve parameters. Drifting: all twelve linear in time; then "
        "quadratic; then a third harmonic of the spin beside. The spin phase is an angle, a rate and its drift a zone. "
        "Local noise: stretches of four spins with harmonics up to the fifth.",
    )


def slip_table(results: Results) -> Table:
    """Slips by name."""
    rows: list[list[Cell]] = [
        [
            slip.zone, slip.start_utc, slip.rows, round(1e3 * slip.stamps_late_s, 1),
            round(1e3 * float(slip.field_late_s), 1), round(slip.largest_nT),
        ]
        for slip in results.slips
    ]  # fmt: skip
    return Table(
        "Clock slips",
        ["zone", "from [UTC]", "rows", "stamps late [ms]", "by the field [ms]", "largest residual [nT]"],
        rows,
        note="Found by the spacing of the stamps alone. By the field: mean of the rows, from the spin phase of the "
        "readings against that of the 50 rows to either side. These rows are left out.",
    )


def refusal_table(results: Results) -> Table:
    """The scalar fit's answers."""
    rows: list[list[Cell]] = [[told.zone.number, told.refusal or "not refused"] for told in results.zones]
    return Table("The scalar fit of one zone", ["zone", "answer"], rows)


def unseen_table(results: Results) -> Table:
    """Zones predicted by a sensor fitted to the other eight."""
    rows: list[list[Cell]] = []
    for place, one in enumerate(results.zones):
        told = [round(way.unseen_nT[place]) for way in results.told]
        rows.append(
            [str(one.zone.number), _light(one), round(one.fits["static"].rms_nT), *told, round(one.noise_nT, 1)]
        )
    own = _whole([one.fits["static"].rms_nT for one in results.zones])
    noise = _whole([one.noise_nT for one in results.zones])
    rows.append(["all", "", round(own), *(round(way.unseen_whole_nT) for way in results.told), round(noise, 1)])
    rows.append(["of static", "", None, *(share(results, way) for way in results.told), None])
    headings = [f"unseen, {way.way.name} [nT]" for way in results.told]
    lags = ", ".join(f"{way.way.name}: {lags_words(way.lags_s)} s" for way in results.told[1:])
    return Table(
        "Unseen zones: a sensor fitted to the other eight, rms length of the residual vector",
        ["zone", "light", "its own static fit [nT]", *headings, "local noise [nT]"],
        rows,
        note="An unseen zone gives its spin phase only (angle, rate and its drift). The lags are chosen without it from a "
        f"short list; with all zones they are {lags} (+: in series).",
    )


def found_table(results: Results) -> Table:
    """Both verdicts of the diagnosis, and the causes by what each explains alone."""
    rows: list[list[Cell]] = []
    for words, found in (("all", results.diagnosis), ("begin in shadow", results.in_shadow)):
        named = ", ".join(" or ".join(effect.group) for effect in found.effects)
        ranked = ", ".join(f"{one.name} {one.drop:.3g}" for one in found.ranking[:_RANKED])
        gap = found.gap
        rows.append(
            [words, found.verdict, named, ", ".join(found.resembles), ranked, round(gap.before_nT), round(gap.after_nT)]
        )
    return Table(
        "What the gap diagnosis says",
        [
            "zones",
            "verdict",
            "named",
            "resembles",
            "alone, by what it takes off chi-square",
            "before [nT]",
            "after [nT]",
        ],
        rows,
        note="One record of the zones through the static sensor; before and after are rms a component on held-out "
        "samples. The temperature column is the day's sunlight behind the boom's lags, a swing of 20: the file has none.",
    )


def tilted_deg(results: Results, told: Told) -> float:
    """How far the sensor tilts from one moment of the zones to another, at most; its turn about the spin axis cannot be
    told from the spin phase."""
    seconds = np.concatenate([one.zone.seconds[one.zone.used][::50] for one in results.zones])
    states = np.stack([results.flight.day.lagged(seconds, *series) for series in told.lags_s], axis=1)
    tilts = (states @ told.within.sensor.turn_rad)[:, :2]
    apart = np.linalg.norm(tilts[:, None, :] - tilts[None, :, :], axis=2)
    return float(np.degrees(apart.max()))


def figures_table(results: Results, settings: Settings) -> Table:
    """The independent figures beside ours."""
    rows: list[list[Cell]] = []
    for what, theirs, ours, why in figures(results, settings):
        rows.append([what, theirs, ours, why])
    return Table("Independent figures and ours", ["what", "independent", "here", "remark"], rows)


def figures(results: Results, settings: Settings) -> list[tuple[str, str, str, str]]:
    """What, theirs, ours, remark."""
    p = settings.printed
    by = {kind: [told.fits[kind].rms_nT for told in results.zones] for kind in KINDS}
    sunny = [told for told in results.zones if told.zone.lit.mean() > _SUNLIT]
    noise = [told.noise_nT for told in results.zones]
    x = np.concatenate([abs(told.response[:, 0]) for told in results.zones])
    turn = np.degrees(np.concatenate([np.angle(told.response[:, 0]) for told in results.zones]))
    slips = [1e3 * abs(slip.stamps_late_s) for slip in results.slips]
    spoilt = [slip.largest_nT for slip in results.slips]
    starting = max(told.starting_nT for told in results.zones)
    component = "per component ours are smaller by sqrt(3)"
    return [
        ("static fit, a zone", _span(p.static_nT), _span(by["static"]), f"nT; vector rms here, {component}"),
        ("drift linear in time, median", f"{p.linear_nT:g}", f"{np.median(by['linear']):.0f}", "nT"),
        ("quadratic, median", f"{p.quadratic_nT:g}", f"{np.median(by['quadratic']):.0f}", "nT"),
        ("third harmonic, median", f"{p.harmonic_nT:g}", f"{np.median(by['harmonic']):.0f}", "nT"),
        (
            "sunlit zones, static", _span(p.sunlit_static_nT), _span([told.fits["static"].rms_nT for told in sunny]),
            f"nT; {component}",
        ),
        (
            "sunlit zones, all of it", _span(p.sunlit_last_nT), _span([told.fits["harmonic"].rms_nT for told in sunny]),
            "nT; depends on how freely the phase may bend",
        ),
        ("local noise", _span(p.noise_nT, 1), _span(noise, 1), "nT, vector, with harmonics up to the fifth here"),
        ("response of X", _span(p.response_X, 1), _span(list(100.0 * x), 1), "counts per nT"),
        ("phase X to Z, range", f"{p.turn_XZ_deg:g}", f"{np.ptp(turn):.1f}", "deg, along all zones"),
        ("clock slips", f"{1e3 * p.slip_s:g}", _span(slips, 1), f"ms; residuals up to {max(spoilt):.0f} nT"),
        (
            "largest outliers", _span(p.outliers_nT), f"{starting:.0f}",
            "nT; the largest are no slips: the readings settle for a second after each switching on",
        ),
    ]  # fmt: skip


def blocks(results: Results) -> list[FigureBlock]:
    """The three figures."""
    entry = {told.zone.number: results.flight.day.shadow_entry_s(float(told.zone.seconds[0])) for told in results.zones}
    shadow_s = _shadow_s(results)
    channels = []
    for place, name in ((0, "channel X"), (1, "channel Y")):
        lines = [
            Response(
                f"zone {told.zone.number}", told.middle_s - entry[told.zone.number], np.abs(told.response[:, place]),
                told.zone.lit.mean() > _SUNLIT,
            )
            for told in results.zones
        ]  # fmt: skip
        channels.append((name, lines))
    numbers = [told.zone.number for told in results.zones]
    bars = [Bars(f"unseen: {told.way.name}", told.unseen_nT) for told in results.told]
    bars.append(Bars("static, the zone's own", [told.fits["static"].rms_nT for told in results.zones]))
    bars.append(Bars("local noise", [told.noise_nT for told in results.zones]))
    left = [Left(f"zone {results.zones[n].zone.number}", *shown) for n, shown in results.shown.items()]
    return [
        FigureBlock(
            "responses",
            "Response of two channels to the field across the spin axis, eight spins at a time. Tinted: shadow. A sensor "
            "at rest on a straight boom would draw level lines, one for all zones.",
            response_figure(channels, shadow_s),
        ),
        FigureBlock(
            "unseen_zones",
            "Each zone predicted by a sensor fitted to the other eight. Logarithmic.",
            zones_figure(bars, numbers),
        ),
        FigureBlock(
            "unseen_residuals",
            "Two zones predicted by a sensor fitted to the other eight: static, and with what follows sun and shadow. "
            "Thinned rows, about three a spin.",
            left_figure(left),
        ),
    ]


def share(results: Results, told: Told) -> float:
    """Unseen rms over that of the static sensor."""
    return round(told.unseen_whole_nT / results.told[0].unseen_whole_nT, 3)


def lags_words(lags_s: Lags) -> str:
    """ "200 + 200": in series; "200; 400": side by side."""
    return "; ".join(" + ".join(f"{lag:g}" for lag in series) for series in lags_s)


def _light(told: ZoneTold) -> str:
    mean = float(told.zone.lit.mean())
    return "sunlit" if mean > _SUNLIT else "shadow" if mean < 1.0 - _SUNLIT else "shadow, then sun"


def _shadow_s(results: Results) -> float:
    day = results.flight.day
    at = float(results.zones[0].zone.seconds[0])
    entry = day.shadow_entry_s(at)
    after = (day.seconds > entry) & (day.lit > 0.5)
    return float(day.seconds[after][0]) - entry


def _whole(values: list[int] | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _span(values: list[float], digits: int = 0) -> str:
    return f"{min(values):.{digits}f} to {max(values):.{digits}f}"
