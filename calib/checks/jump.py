"""Does the clock jump within the record? Each side of the longest gap in the stamps is tested by itself.

A jump leaves a gap as long as itself, or longer. Where the two sides are best explained by different shifts, and each is
far better with its own than with the other's, no one shift mends the record.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.checks.clock import (
    BLOCKS,
    CLEAR,
    cost,
    plain_shifts_s,
    predictions,
    shift_words,
    shifts_s,
)
from fluxtwin.calib.checks.evidence import Evidence, scalar_evidence, vector_evidence
from fluxtwin.calib.checks.report import Finding, trap
from fluxtwin.calib.checks.sample import FEWEST, Sample
from fluxtwin.calib.checks.values import GAP_STEPS
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.origin import Origin


def check_jump(sample: Sample, model: FieldModel, origin: Origin) -> list[Finding]:
    """The trap `clock` with the instant of the jump; none where one clock serves both sides, or a side is too short."""
    step_s = np.diff(sample.seconds)
    first = int(np.argmax(step_s)) + 1
    if step_s[first - 1] <= GAP_STEPS * np.median(step_s) or min(first, len(sample) - first) < FEWEST:
        return []
    known, plain = shifts_s(sample), plain_shifts_s(origin)
    tried = list(dict.fromkeys((0.0, *known, *plain)))
    sides = [sample.take(np.arange(first)), sample.take(np.arange(first, len(sample)))]
    found = [_evidence(side.thinned(BLOCKS), model, origin, tried) for side in sides]
    tried = [shift for shift in tried if all(shift in one for one in found)]
    costs = np.array([cost(shift, known) if shift else 0.0 for shift in tried])
    odds = [np.array([one[shift][0] for shift in tried]) - costs for one in found]
    best = [int(np.argmax(one)) for one in odds]
    if any(one[mine] - one[other] <= CLEAR for one, mine, other in zip(odds, best, reversed(best), strict=True)):
        return []
    if tried[best[0]] and tried[best[1]] and abs(tried[best[0]] - tried[best[1]]) <= 3.0 * min(map(abs, plain)):
        return []  # neighbours in the steps that are tried
    causes = plain | known
    said = [
        f"{shift_words(shift)} too {'late' if shift > 0 else 'early'} ({causes[shift]})" if shift else "right"
        for shift in (tried[at] for at in best)
    ]
    misfit = {f"{name}_nT": one[tried[at]][1] for name, one, at in zip(("before", "after"), found, best, strict=True)}
    at = epoch.iso(sample.time[first], "s")
    return [trap("clock.jump", sample.rows[first : first + 1], at=at, first=said[0], then=said[1], **misfit)]


def _evidence(side: Sample, model: FieldModel, origin: Origin, tried: list[float]) -> dict[float, tuple[float, float]]:
    """Log evidence and misfit [nT] by shift, for the shifts that field model and elements reach."""
    fields = predictions(side, model, origin, tried)
    stack = np.stack(list(fields.values()))
    evidence: Evidence = (
        scalar_evidence(side.seconds, side.mag_nT, np.linalg.norm(stack, axis=2))
        if side.q_NB is None
        else vector_evidence(side.seconds, side.mag_nT, stack)
    )
    return dict(zip(fields, zip(evidence.log.tolist(), evidence.misfit_nT.tolist(), strict=True), strict=True))
