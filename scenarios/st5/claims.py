"""The claims of the abstract beside what this run gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fluxtwin.scenarios.claims import Claim, Verdict, agree, judged
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration_study import Hour
from fluxtwin.scenarios.st5.terms import terms_of
from fluxtwin.sim.earth.constants import NT_PER_MG

_SETTLED_DEG = 1e-3
_FINISHED = 0.02
"""Of the squared innovations over noise: four sigma of the mean of 3 x 26,000."""
_BEFORE_DEG, _AFTER_DEG = 0.1, 0.02
"""Margins of the attitude errors."""


def judge_claims(hour: Hour) -> list[Claim]:
    """Every claim of the packaged list, in order."""
    return judged(mission.PRINTED.claims(), _JUDGES, hour)


def _inputs(hour: Hour) -> Verdict:
    """2 mG are 0.5 deg of 229 mG."""
    printed = mission.published()
    mean_mG = float(np.linalg.norm(hour.flight.truth.field_N_nT, axis=1).mean()) / NT_PER_MG
    angle = float(np.degrees(np.arctan(printed["noise_mG"] / mean_mG)))
    motion = hour.batch.fit.motion if hour.batch.fit is not None else {}
    spin_rpm, nutation_deg = motion["spin_rad_s"] * 30 / np.pi, motion["nutation_deg"]
    here = (
        f"the same inputs; spin {spin_rpm:.3f} rpm and nutation {nutation_deg:.3f} deg are found again; the noise is "
        f"{angle:.2f} deg of a mean field of {mean_mG:.0f} mG"
    )
    holds = (
        agree(angle, printed["noise_equivalent_deg"], 0.05)
        and agree(spin_rpm, printed["spin_rpm"], 0.001)
        and agree(nutation_deg, printed["nutation_deg"], 0.02)
    )
    remark = "the orbit is not printed; the hour's place on it was chosen for this mean field"
    return Verdict(here, angle, "deg", holds, "field or motion are not those of the abstract", remark)


def _figures(hour: Hour) -> Verdict:
    """Errors before and after: two settings chosen by what is printed of before, after is predicted."""
    printed, chosen, other = mission.published(), hour.search.by_axes, hour.search.by_rss
    rms = ", ".join(f"{v:.3f}" for v in chosen.pre_deg)
    found = terms_of(hour.alone)
    off_b, off_v = _distances(found.b_mG, found.misalignment_deg)
    after = hour.steps_alone.rss_deg
    here = (
        f"with random walk {chosen.walk_rad_s:.2g} rad/s and the sun's noise times {chosen.sun_factor:.2g}, chosen by the "
        f"three rms before: {rms}, RSS {chosen.pre_rss_deg:.3f} deg; predicted by them: after, {after:.3f} deg, estimates "
        f"within {off_b:.3f} mG and {off_v:.3f} deg of the truth"
    )
    off = np.abs(np.subtract(other.pre_deg, printed["pre_rms_deg"])).max()
    why = (
        f"two settings that are not printed were free, and the error after calibration, which had no part in their choice, "
        f"is {after / printed['post_rss_deg']:.2f} times the printed one. Both root sums of squares are met with walk "
        f"{other.walk_rad_s:.2g} rad/s and factor {other.sun_factor:.2g} ({other.pre_rss_deg:.3f} and "
        f"{other.post_rss_deg:.3f} deg), but that is two numbers by two settings, and the rms of the axes are then off by "
        f"up to {off:.2f} deg"
    )
    holds = bool(np.abs(np.subtract(chosen.pre_deg, printed["pre_rms_deg"])).max() < _BEFORE_DEG)
    return Verdict(here, after, "deg", holds and agree(after, printed["post_rss_deg"], _AFTER_DEG), why)


def _loop(hour: Hour) -> Verdict:
    """The iteration settles, and where it settles the readings leave nothing but noise."""
    steps = hour.iterative.fit.steps_deg if hour.iterative.fit is not None else ()
    left = hour.iterative.nis
    here = (
        f"{len(steps)} passes, turns " + ", ".join(f"{s:.2g}" for s in steps) + " deg; squared innovations over noise "
        f"{left:.3f} at the end"
    )
    holds = bool(steps) and steps[-1] < _SETTLED_DEG and agree(left, 1.0, _FINISHED)
    return Verdict(here, float(len(steps)), "passes", holds, "it does not settle, or not on what the readings say")


def _scan(hour: Hour) -> Verdict:
    """Brackets or digits: the reading whose truth lies near the printed estimates; the parts must give the whole."""
    printed = mission.published()
    scanned = printed["read_as_digits"]
    whole = float(np.linalg.norm(printed["pre_rms_deg"]))
    off_b, off_v = _distances(printed["b_estimated_mG"], printed["misalignment_estimated_deg"])
    far_b, far_v = _distances(printed["b_estimated_mG"], printed["misalignment_estimated_deg"], scanned)
    here = (
        f"read as brackets the printed truth stands {off_b:.3f} mG and {off_v:.2f} deg from the printed estimates, read as "
        f"digits {far_b:.1f} mG and {far_v:.1f} deg; the three printed rms give RSS {whole:.4f} deg"
    )
    holds = off_b < 0.1 * far_b and off_v < 0.1 * far_v and agree(whole, printed["pre_rss_deg"], 0.001)
    remark = "arithmetic on print; of 1.121, 3.0091 and 0.891 the last digit is below what any figure here could tell"
    return Verdict(here, off_b, "mG", holds, "the parts do not give the whole", remark)


def _distances(
    b_mG: object, misalignment_deg: object, truth: Mapping[str, object] | None = None
) -> tuple[float, float]:
    """Largest difference of b [mG] and misalignment [deg] from the abstract's truth."""
    truth = mission.published() if truth is None else truth
    pairs = ((b_mG, truth["b_mG"]), (misalignment_deg, truth["misalignment_deg"]))
    off_b, off_v = (float(np.abs(np.asarray(ours, float) - np.asarray(theirs, float)).max()) for ours, theirs in pairs)
    return off_b, off_v


_JUDGES: Mapping[int, Callable[[Hour], Verdict]] = {55: _inputs, 56: _figures, 57: _loop, 58: _scan}
