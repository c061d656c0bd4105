"""Judges of the claims on the passes of Table 5 and on yaw (39, 41, 44-46, 50, 53, 54)."""

from __future__ import annotations

import numpy as np

from fluxtwin.scenarios.claims import DIFFERS, NOT_TESTABLE, REPRODUCED, Verdict, agree
from fluxtwin.scenarios.hcmm.claims import Judge, Results
from fluxtwin.scenarios.hcmm.pass_study import ANOMALOUS, LIMIT_MG, printed_rms
from fluxtwin.sim.types import FloatArray


def _claim_39(r: Results) -> Verdict:
    length = r.windows.end_min - r.windows.start_min
    risen = int((r.orbit.highest_deg > 0).sum())
    return Verdict(
        f"{risen} of 43 passes rise over {len({p.station for p in r.passes.passes})} stations along the fitted "
        "orbit; the "
        f"printed sun-nadir ranges take {length.min():.1f} to {length.max():.1f} min", risen, "passes", NOT_TESTABLE,
        "that these are all data sent in those days cannot be checked",
    )  # fmt: skip


def _claim_41(r: Results) -> Verdict:
    eps = r.passes.column("eps_M_mG")
    quiet, everything = r.passes.rms("eps_M_mG", r.passes.quiet), r.passes.rms("eps_M_mG", np.ones(43, dtype=bool))
    order = [int(k) + 1 for k in np.argsort(-eps)]
    largest, deepest = set(order[:4]), 1 + max(order.index(number) for number in ANOMALOUS)
    shared = len(largest & set(ANOMALOUS))
    above = int((eps > LIMIT_MG).sum())
    e = r.evidence
    wrong, four = e.predicted_mG, [number - 1 for number in ANOMALOUS]
    night = e.night > 0.5
    rank = 1 + int((wrong[night] > wrong[four].min()).sum())
    as_wrong = ~night & (wrong > wrong[four].min()) & (e.printed_mG <= LIMIT_MG)
    lit, at_most = np.sort(wrong[as_wrong])[::-1], e.printed_mG[as_wrong].max(initial=0.0)
    printed = printed_rms([p.eps_M_mG for p, q in zip(r.passes.passes, r.passes.quiet, strict=True) if q])
    good = abs(quiet - 2.20) < 0.15 and abs(everything - 2.50) < 0.15 and largest == set(ANOMALOUS)
    return Verdict(
        f"{quiet:.2f} mG (39), {everything:.2f} mG (43), {above} above 3 mG; the four largest of ours are "
        f"{shared} of the four printed ones, and all four are among the {deepest} largest, without any field "
        f"on board: IGRF 1975 was wrong by {_listed(wrong[four])} mG there. Over all real passes the printed residual "
        f"follows that error with a rank correlation of {e.correlation:.2f}; of the ten largest {e.top_shared} are the same",
        quiet, "mG", REPRODUCED if good else DIFFERS,
        f"among the {int(night.sum())} night passes the printed four are within the {rank} largest errors of the "
        f"field model, but it does not single them out among all: {lit.size} sunlit passes have errors of {_listed(lit)} mG "
        f"and print at most {at_most:.2f} mG. Which of several nearly equal passes come first in ours hangs on how the LSB "
        f"falls and on the calibration; of the 39, ours leave {quiet:.2f} mG where {printed:.2f} was printed (claim 38)",
    )  # fmt: skip


def _claim_44(r: Results) -> Verdict:
    p, lit = r.passes, r.passes.sunlit & ~r.passes.dawn
    ours = [
        p.rms("delta_sun_field", lit), p.rms("delta_nadir_field", p.quiet),
        p.rms("delta_nadir_field", np.ones(43, dtype=bool)), p.rms("delta_sun_nadir", lit),
    ]  # fmt: skip
    rows = list(zip(p.passes, lit, p.quiet, strict=True))
    columns = [
        printed_rms([x.delta_sun_field_deg for x, y, _ in rows if y]),
        printed_rms([x.delta_nadir_field_deg for x, _, q in rows if q]),
        printed_rms([x.delta_nadir_field_deg for x, _, _ in rows]),
        printed_rms([x.delta_sun_nadir_deg for x, y, _ in rows if y]),
    ]
    good = all(abs(a - b) < 0.05 for a, b in zip(ours, (0.36, 0.51, 0.53, 0.24), strict=True))
    night = p.rms("delta_nadir_field", ~p.sunlit) / p.rms("delta_nadir_field", p.sunlit)
    return Verdict(
        f"sun-field {ours[0]:.2f}, nadir-field {ours[1]:.2f} (39) and {ours[2]:.2f} (43), sun-nadir {ours[3]:.2f} "
        "deg; the "
        "printed columns themselves give " + ", ".join(f"{v:.2f}" for v in columns), ours[0], "deg",
        REPRODUCED if good else DIFFERS,
        f"the angles with the sun agree; the flight's nadir-field residual is larger, twice by night against day where "
        f"ours is {night:.1f} times, so its scanner or its field was worse at night than the simulated ones",
    )  # fmt: skip


def _claim_45(r: Results) -> Verdict:
    found = r.passes.column("delta_nadir_field")
    printed = [p.delta_nadir_field_deg for p in r.passes.passes]
    good = abs(found.min() - 0.32) < 0.06 and abs(found.max() - 0.96) < 0.1
    return Verdict(
        f"{found.min():.2f} to {found.max():.2f} deg; the printed table itself {min(printed):.2f} to "
        f"{max(printed):.2f}",
        float(found.max()), "deg", REPRODUCED if good else DIFFERS, "as claim 44; one row of the table reads 0.28",
    )  # fmt: skip


def _claim_46(r: Results) -> Verdict:
    found = r.passes.column("delta_sun_nadir")[r.passes.dawn]
    known = found[np.isfinite(found)]
    rms = float(np.sqrt(np.mean(known**2)))
    s = r.scanner
    return Verdict(
        f"{known.min():.2f} to {known.max():.2f} deg in {known.size} of five dawn passes (in the fifth the sun rises "
        "as "
        f"the window ends), {rms:.2f} deg together; found back from sun-nadir angles: {abs(s.head_1_deg):.2f} deg of "
        f"{abs(s.head_1_truth_deg):.2f} deg", rms, "deg", agree(rms, 0.64, 0.1), "the head is turned by another angle",
    )  # fmt: skip


def _claim_50(r: Results) -> Verdict:
    rows = r.yaw.stations
    worst = max(abs(row.dipole - row.printed) for row in rows)
    wrong = min(row.dipole_printed_sigma for row in rows)
    return Verdict(
        ", ".join(f"{row.station} {row.dipole:.2f}" for row in rows) + f" deg with 0.17 deg; with the printed 1.7 deg the "
        f"least would be {wrong:.1f} "
        "deg", worst, "deg", REPRODUCED if worst < 0.015 else DIFFERS, "equation 11 gives others",
    )  # fmt: skip


def _claim_53(r: Results) -> Verdict:
    y = r.yaw
    low, high = y.sun_nadir_deg
    good = abs(low - 84) < 2 and abs(high - 121) < 1.5 and abs(y.error_bar_deg - 0.58) < 0.1
    return Verdict(
        f"rise {y.minutes_late:.1f} min after the printed time; sun-nadir {low:.0f} to {high:.0f} deg; residuals "
        f"{y.delta_sun_nadir_deg:.2f} and {y.delta_nadir_field_deg:.2f} deg; error bar {y.error_bar_deg:.2f} deg by "
        "the "
        f"papers' rule, {y.magnetometer_yaw_rms_deg:.2f} deg rms against the true yaw", y.error_bar_deg, "deg",
        REPRODUCED if good else DIFFERS, "another pass",
    )  # fmt: skip


def _claim_54(r: Results) -> Verdict:
    values = np.array([row.dipole for row in r.yaw.stations])
    ruled = int(((values > 0.495) & (values < 0.815)).sum())
    good = abs(values.min() - 0.5) < 0.05 and abs(values.max() - 1.24) < 0.02 and ruled >= 6
    actual = np.array([row.main_field for row in r.yaw.stations])
    return Verdict(
        f"{values.min():.2f} to {values.max():.2f} deg in the dipole, {ruled} of 7 stations from 0.50 to 0.80; in "
        "the field "
        f"of 1978 {actual.min():.2f} to {actual.max():.2f} deg", float(values.max()), "deg",
        REPRODUCED if good else DIFFERS, "equation 11 gives others",
    )  # fmt: skip


def _listed(values: FloatArray) -> str:
    """Numbers in words."""
    return ", ".join(f"{value:.2f}" for value in values)


JUDGES: dict[int, Judge] = {
    39: _claim_39, 41: _claim_41, 44: _claim_44, 45: _claim_45, 46: _claim_46, 50: _claim_50, 53: _claim_53, 54: _claim_54,
}  # fmt: skip
