"""The claims of the abstract beside what this run gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fluxtwin.scenarios.claims import Claim, Verdict, judged
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration_study import Hour
from fluxtwin.sim.constants import NT_PER_MG

_SETTLED_DEG = 1e-3


def judge_claims(hour: Hour) -> list[Claim]:
    """Every claim of the packaged list, in order."""
    return judged(mission.PRINTED.claims(), _JUDGES, hour)


def _inputs(hour: Hour) -> Verdict:
    """2 mG are 0.5 deg of 229 mG."""
    printed = mission.published()
    mean_mG = float(np.linalg.norm(hour.flight.truth.field_N_nT, axis=1).mean()) / NT_PER_MG
    angle = float(np.degrees(np.arctan(printed["noise_mG"] / mean_mG)))
    motion = hour.batch.fit.motion if hour.batch.fit is not None else {}
    here = (
        f"the same inputs; spin {motion['spin_rad_s'] * 30 / np.pi:.3f} rpm and nutation {motion['nutation_deg']:.3f} deg "
        f"are found again; the noise is {angle:.2f} deg of a mean field of {mean_mG:.0f} mG"
    )
    why = "the orbit is not in the abstract: 0.5 deg means 229 mG, which our arc has for a part of the hour only"
    holds = abs(angle - printed["noise_equivalent_deg"]) < 0.05
    return Verdict(here, angle, "deg", holds, why)


def _figures(hour: Hour) -> Verdict:
    """Errors before and after."""
    printed = mission.published()
    before, after = hour.before, hour.steps_alone
    rms = ", ".join(f"{v:.3f}" for v in before.rms_deg)
    here = (
        f"before {rms}, RSS {before.rss_deg:.3f} deg; after {after.rss_deg:.3f} deg by the abstract's steps, "
        f"{hour.iterative.rss_deg:.3f} deg with regression, {hour.batch.rss_deg:.4f} deg by the batch"
    )
    same = abs(before.rss_deg - printed["pre_rss_deg"]) < 0.1 and abs(after.rss_deg - printed["post_rss_deg"]) < 0.02
    why = (
        "process noise and start of the filter, weight of the sun, orbit and spin axis are not in the abstract and move "
        "both figures by more than the differences (table of settings); ours after calibration is the smaller one"
    )
    return Verdict(here, after.rss_deg, "deg", same, why)


def _loop(hour: Hour) -> Verdict:
    """The iteration settles."""
    steps = hour.iterative.fit.steps_deg if hour.iterative.fit is not None else ()
    here = f"{len(steps)} passes, turns " + ", ".join(f"{s:.2g}" for s in steps) + " deg"
    settled = bool(steps) and steps[-1] < _SETTLED_DEG
    return Verdict(here, float(len(steps)), "passes", settled, "it does not settle")


def _scan(hour: Hour) -> Verdict:
    """The brackets: the printed parts must give the printed whole."""
    printed = mission.published()
    whole = float(np.sqrt(np.sum(np.square(printed["pre_rms_deg"]))))
    agrees = abs(whole - printed["pre_rss_deg"]) < 0.001
    off_b = float(np.abs(np.subtract(printed["b_estimated_mG"], printed["b_mG"])).max())
    off_v = float(np.abs(np.subtract(printed["misalignment_estimated_deg"], printed["misalignment_deg"])).max())
    here = (
        f"with brackets: the three printed rms give RSS {whole:.4f} deg, and the printed estimates stand {off_b:.3f} mG and "
        f"{off_v:.2f} deg from the printed truth"
    )
    return Verdict(here, whole, "deg", agrees, "the parts do not give the whole")


_JUDGES: Mapping[int, Callable[[Hour], Verdict]] = {55: _inputs, 56: _figures, 57: _loop, 58: _scan}
