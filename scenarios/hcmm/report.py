"""The report of the HCMM study, part by part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.scenarios.claims import Claim, claims_table
from fluxtwin.scenarios.hcmm import pass_tables, tables
from fluxtwin.scenarios.hcmm.claims import Results
from fluxtwin.scenarios.hcmm.field_evidence import FieldEvidence
from fluxtwin.scenarios.hcmm.gallery_page import FILE as GALLERY_FILE
from fluxtwin.scenarios.hcmm.gallery_page import overview_table, real_passes_section
from fluxtwin.scenarios.hcmm.mission import quantity
from fluxtwin.scenarios.hcmm.pass_study import ANOMALOUS, printed_rms
from fluxtwin.scenarios.hcmm.residual_tables import horizon_section, missing_section
from fluxtwin.scenarios.hcmm_orbit.nadir_field import DIPOLE, MAIN_FIELD, NEAR_DEG, NadirField
from fluxtwin.scenarios.page import Page, Section
from fluxtwin.scenarios.study_files import provenance

ERRATA = (
    "Conference Table 5: three acquisition times have minutes above 59 (0067, 1584, 1089), four name an hour at "
    "which the "
    "satellite was not in view (0821, 1615, 1619, 1637): eights read as sixes, fives as sixes"
    " (0057) or eights, nines as eights.",
    "Conference Table 6: the text gives 1.7 deg for the angles; its numbers need 0.17 deg.",
    "Conference equation 18 prints the inequality with the wrong sense; the journal has it right.",
    "Conference Table 3: 132 + 308 samples are not 443; 135 would be.",
    "Conference, 'magnetic poles' 46 and 25 deg away: these are the poles of the dipole, not where the field is "
    "vertical.",
    "Conference text: the least nadir-field residual is 0.32 deg; its table has 0.28.",
)


def _errata(results: Results) -> tuple[str, ...]:
    """The slips of the sources, and two of their words that what is known today contradicts."""
    rms, _, largest, _ = results.errors.field_direction_deg
    quiet = len(ANOMALOUS) - len(_largest_nights(results.evidence) & {n - 1 for n in ANOMALOUS})
    return (
        *ERRATA,
        f"Both conclusions call {quantity('field-model direction maximum'):g} deg the maximum direction error of IGRF 1975: "
        f"along this orbit it is {rms:.2f} deg rms and {largest:.2f} deg at most.",
        "Both papers suspect hardware on board for four night passes; of all night passes the error of IGRF 1975 is largest "
        + ("in those." if not quiet else f"in {len(ANOMALOUS) - quiet} of those and in others."),
    )


def _largest_nights(e: FieldEvidence) -> set[int]:
    """The night passes, as many as the papers name, in which the error of IGRF 1975 is largest."""
    by_night = np.flatnonzero(e.night > 0.5)
    return set(by_night[np.argsort(-e.predicted_mG[by_night])[: len(ANOMALOUS)]].tolist())


def page(results: Results, claims: list[Claim], verdict: str) -> Page:
    """The whole page."""
    others = tables.other_figures(results)
    return Page(
        title="HCMM: calibration from station passes, checked against what flew in 1978",
        verdict=verdict,
        sections=[
            *_flight(results),
            _night_passes(results),
            Section(
                "Calibration",
                [],
                [tables.calibration_table(results), tables.sigma_table(results)],
                [tables.bias_figure(results)],
            ),
            Section("Sources of the residual", [], [tables.error_table(results)], others[:1]),
            _passes(results),
            Section("Yaw", [], [tables.yaw_table(results), pass_tables.figure_3_table(results)], others[1:]),
            Section("How it moved", [], [results.motion.table(tables.POINTING)]),
            _sensors(results),
            horizon_section(results.horizon),
            missing_section(results.missing),
            real_passes_section(results.real_passes),
            Section(
                "Four faults, found from telemetry",
                [
                    "The same satellite with four things wrong that nobody tells the ground, diagnosed: see gallery.html."
                ],
                [overview_table(results.gallery)],
            ),
            Section("Claim by claim", [], [claims_table(claims, with_why=True)]),
        ],
        errata=_errata(results),
        links={"Four faults, found from telemetry: the gallery": f"{GALLERY_FILE}.html"},
        provenance=provenance(results.scenario),
    )


def _flight(results: Results) -> list[Section]:
    """Orbit, test and open question."""
    figures, n = tables.flight_figures(results), results.nadir_field
    ideas = {idea.name: idea for idea in n.ideas}
    main, dipole = ideas[MAIN_FIELD], ideas[DIPOLE]
    part = ideas["the best part of each window"]
    residuals = np.array([p.delta_nadir_field_deg for p in n.passes])
    unexplained = [p.label for p, e in zip(n.passes, part.error_deg, strict=True) if np.abs(e).max() > NEAR_DEG]
    return [
        Section(
            "The orbit from the record",
            [
                "HCMM had no tape recorder: its data exist only while a station saw it, and no orbital elements of "
                "those days were found. What was printed of 43 passes gives the orbit: when each was acquired, and "
                "how the angle between sun and nadir ran.",
            ],
            [tables.orbit_table(results)],
        ),
        Section(
            "The test against flight",
            [
                "The angle between sun and field was printed as well, and entered nothing. It is predicted here from "
                "orbit, sun and the field that is known of 1978 today, and compared with print.",
            ],
            [tables.flight_test_table(results)],
            figures[:2],
        ),
        Section(
            "The open question",
            [
                "The printed angles between nadir and field do not agree with the field that the sun-field angles "
                "confirm. Nearest comes the dipole part of the field alone; the dipole that fits the sunlit passes "
                f"best has its pole at {n.pole_deg[0]:.0f} N, {n.pole_deg[1]:.0f} E, the field's own is at "
                f"{n.model_pole_deg[0]:.1f} N, {n.model_pole_deg[1]:.1f} E. {_dipole_fails(n)} The residuals printed "
                f"beside these ranges, {residuals.min():.2f} to {residuals.max():.2f} deg, cannot be a dipole's: it is "
                f"wrong by {n.dipole_wrong_deg:.1f} deg rms over these passes. So if the "
                "ranges are a dipole's, they were made by another program than the residuals.",
                f"Of the 86 ends the main field explains {main.explained} ({main.by_chance[0]:.0f} by chance), its "
                "dipole "
                f"{dipole.explained} ({dipole.by_chance[0]:.0f}). That the angles belong to parts of the windows "
                "only would "
                f"explain {part.explained} ({part.by_chance[0]:.0f}) with the main field, at the price of two free "
                "numbers a "
                f"pass; it cannot explain {'; '.join(unexplained)}. No idea fits all rows, and nothing here depends "
                "on that "
                "column.",
            ],
            [*tables.ideas_tables(results), tables.nadir_field_rows(results)],
            figures[2:],
        ),
    ]


def _dipole_fails(n: NadirField) -> str:
    """Where the dipole does not explain the column either, by groups of ends."""
    idea = next(idea for idea in n.ideas if idea.name == DIPOLE)
    (near, ends), (far, others) = (n.ends_explained(idea, poleward=poleward, sunlit=True) for poleward in (True, False))
    worst = int(np.argmax(np.abs(np.where(n.poleward, idea.error_deg, 0.0)).max(axis=1) * n.sunlit))
    return (
        f"The field's own dipole is no answer either: of the sunlit passes it explains {near} of {ends} poleward ends, "
        f"worst of all {n.passes[worst].label}, and {far} of {others} equatorward ones."
    )


def _passes(results: Results) -> Section:
    """Table 5 in full."""
    p = results.passes
    mG = p.rms("eps_M_mG", p.quiet)
    printed = printed_rms([item.eps_M_mG for item, quiet in zip(p.passes, p.quiet, strict=True) if quiet])
    return Section(
        "The 43 passes",
        [
            "Every pass of the paper's Table 5, flown in the simulation with the calibration of both sets and seen as the "
            f"paper saw it. The field strength fits better than it did in 1978 ({mG:.2f} mG against {printed:.2f} "
            "over the 39 "
            "quiet passes), and so does the angle to nadir; the angles with the sun agree. At dawn over Orroral "
            f"{int((np.array(results.dawn.samples) > 0).sum())} of {len(results.dawn.samples)} passes see the sun, with "
            "head 1, which is turned. Why the four night passes stand out is asked above.",
        ],
        [pass_tables.strength_table(results), pass_tables.angles_table(results), pass_tables.dawn_table(results)],
    )


def _sensors(results: Results) -> Section:
    """The closed chain, and what the second channel says."""
    s = results.scanner
    return Section(
        "Sun sensor, scanner, magnetometer",
        [
            "The angle between measured sun and measured nadir is a second channel: no attitude and no magnetometer "
            "enters "
            f"it. Of the three days it says: {s.channel.words}. Had head 1 been mounted right, with the magnetometer "
            "as "
            f"turned as it is: {s.turned_magnetometer.words}.",
        ],
        [tables.scanner_table(results)],
    )


def _night_passes(results: Results) -> Section:
    """What the error of the field model has to say of the four passes."""
    e, p = results.evidence, results.passes
    four = [(e.labels[n - 1], e.printed_mG[n - 1], *p.eps_range_mG[n - 1]) for n in ANOMALOUS]
    printed = printed_rms([item.eps_M_mG for item, quiet in zip(p.passes, p.quiet, strict=True) if quiet])
    excess = np.sqrt(printed**2 - p.rms("eps_M_mG", p.quiet) ** 2)
    missing = [np.sqrt(mG**2 - high**2 - excess**2) for _, mG, _, high in four if mG > np.hypot(high, excess)]
    largest = _largest_nights(e)
    chance = f"a share of {e.chance:.4f}" if e.chance > 0 else "none"
    return Section(
        "The four night passes",
        [
            "The papers suspect hardware on board behind the large residuals of four night passes over the eastern "
            "United States. Of all night passes the error of IGRF 1975 in field strength is largest in "
            + ("these four" if largest == {n - 1 for n in ANOMALOUS} else "others")
            + f"; {_sunlit_above(e)} sunlit passes have an error as large, with a smaller residual. Of the ten largest "
            f"printed residuals {e.top_shared} are among the ten passes with the largest predicted error. The "
            f"rank correlation over all 43 is {e.correlation:.2f} (of 20,000 random orders of the overflights {chance} "
            f"reaches it), {e.correlation_without_four:.2f} without the four, {e.correlation_night:.2f} among the "
            "night "
            f"passes and {e.correlation_sunlit:.2f} among the sunlit ones.",
            _turned(e),
            "By night the residual is larger than by day for the same error of the model, here as in print: the "
            "calibration was made with sunlit passes and took part of their error for its own. How much, hangs on the "
            "passes it was made with, which are not known: over many choices ours leave "
            + "; ".join(f"{low:.1f} to {high:.1f} mG at {label} (printed {mG:.2f})" for label, mG, low, high in four)
            + f". All flight rows have {excess:.1f} mG more than ours, added as squares. "
            + _needed(missing, len(four)),
        ],
        [],
        [tables.evidence_figure(results)],
    )


def _sunlit_above(e: FieldEvidence) -> int:
    """Sunlit passes with an error of IGRF 1975 above the least of the printed four, and a residual below theirs."""
    four = [number - 1 for number in ANOMALOUS]
    above = e.predicted_mG > e.predicted_mG[four].min()
    return int(((e.night < 0.5) & above & (e.printed_mG < e.printed_mG[four].min())).sum())


def _turned(e: FieldEvidence) -> str:
    """What a wrong map does."""
    best = e.best_turned(3)
    where = int(np.argmin(e.turned_correlation))
    return (
        "That count makes the evidence look stronger than it is. The map of errors is smooth and the passes return to the "
        "same few places, so wrong maps correlate too: turned east by "
        + ", ".join(f"{turn:.0f} deg {value:.2f}" for turn, value in best)
        + f", and {e.turned_correlation[where]:.2f} at {e.turns_deg[where]:.0f} deg. The right map has "
        f"the largest value of the {e.turns_deg.size} turns tried, {e.correlation:.2f}, but not by much."
        if e.correlation > best[0][1]
        else f"A map turned by {best[0][0]:.0f} deg does as well ({best[0][1]:.2f}): the correlation says nothing."
    )


def _needed(missing_mG: Sequence[float], count: int) -> str:
    """What the printed residuals of the passes that are not explained would need."""
    if not missing_mG:
        return f"That is enough for all {count}; no field on board is needed."
    return (
        f"Even so, {'all' if len(missing_mG) == count else len(missing_mG)} of the {count} would need "
        + ", ".join(f"{mG:.1f}" for mG in missing_mG)
        + " mG more: a field of that size on board cannot be excluded there, but none is needed to set them among the "
        "largest."
    )
