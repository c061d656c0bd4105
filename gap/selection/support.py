"""How well a named effect is supported: rivals refitted in its place, its group, and a probability that counts both."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.gap.linear.projection import orthonormal
from fluxtwin.gap.selection.criterion import MOST_SURE, SHAPE, penalty
from fluxtwin.gap.selection.forward import NONLINEAR, WITHIN, Search, room_for, without
from fluxtwin.gap.selection.groups import alike_to
from fluxtwin.gap.selection.named import Support
from fluxtwin.gap.selection.refit import Fit
from fluxtwin.gap.selection.score import board
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.chain import Active

IN_GROUP = 0.05
_WORTH_SAYING = 0.001


def support(search: Search[Any], fit: Fit, number: int, variance: float) -> Support:
    """Weigh effect `number` of a fit against everything that might stand in its place, and against nothing.

    Among effects: weights exp(-cost / 2), the cost being that of `Search.cost` with the shape error of what is explained
    beside the noise: of two likenesses of nature the nearer one need not be the true one. Alternatives of one effect are
    added up.
    """
    effect = fit.chosen[number][0]
    bare = without(search, fit, number)
    weights = _weights(search, fit, number, bare, variance)
    present = weights.pop(effect.name)
    total = present + sum(weights.values())
    posterior = {name: weight / total for name, weight in weights.items()}
    likeliest = sorted(posterior.items(), key=lambda pair: -pair[1])
    alike = [name for name in alike_to(search.first, effect) if name != effect.name]
    likely = [name for name, share in likeliest if share >= IN_GROUP and name not in alike]
    group = (effect.name, *alike, *likely)
    drop, rank = bare.chi2 - fit.chi2, max(fit.rank_chosen - bare.rank_chosen, 1)
    inside = present + sum(weights.get(name, 0.0) for name in group)
    rivals = [(n, float(share)) for n, share in likeliest if n not in group and share >= _WORTH_SAYING]
    p_value = min(1.0, search.tested * search.first.p_value(drop, rank))
    return Support(p_value, min(MOST_SURE, inside / total), group, tuple(rivals))


def _weights(search: Search[Any], fit: Fit, number: int, bare: Fit, variance: float) -> dict[str, float]:
    """{name: weight} of each effect in the place of effect `number`, whose own weight is near 1."""
    others = fit.others(number)
    taken = {effect.name for effect, _ in others}
    mine = fit.slices()[number]
    kept = [c for c in range(fit.jacobian.shape[2]) if not mine.start <= c < mine.stop]
    # The data with this effect's own signal put back: what the others would have to explain.
    put_back = search.channel.residual([*fit.modelled, *others])
    beside = fit.jacobian[:, :, kept]
    scored = board(search.found, search.white, put_back, beside, search.channel.measured, search.channel.share_left)
    # A large effect is not linear: what the others make up for at their own refit says how much it is worth.
    drop_own = max(scored.chi2, bare.chi2) - fit.chi2
    lost_own = chi_square_lost(search, fit.chosen[number], beside)
    price_own = float(penalty(fit.rank_chosen - bare.rank_chosen, drop_own / variance, search.samples))
    wider = 1.0 + SHAPE * drop_own / variance
    weights: dict[str, float] = {fit.chosen[number][0].name: 1.0}
    trials = []
    for place, candidate in enumerate(search.found):
        if scored.rank[place] == 0 or candidate.name in taken or candidate.effect is fit.chosen[number][0]:
            continue
        price = float(penalty(scored.rank[place], scored.statistic[place] / variance, search.samples)) - price_own
        trials.append(((drop_own - scored.statistic[place]) / variance / wider + price, place, price))
    refitted: list[str] = []
    for worse, place, price in sorted(trials):
        name = search.found[place].name
        if room_for(name, refitted) and worse < WITHIN + NONLINEAR * drop_own / variance / wider:
            refitted.append(name)
            present = search.numbers(fit)
            present[number] = place
            start = [theta for _, theta in fit.chosen]
            start[number] = scored.estimate([place])[0]
            there = search.fit(present, start)
            lost = chi_square_lost(search, there.chosen[number], beside)
            worse = (there.chi2 - lost - fit.chi2 + lost_own) / variance / wider + price
        weights[name] = weights.get(name, 0.0) + float(np.exp(-0.5 * np.clip(worse, -100.0, 1400.0)))
    return weights


def chi_square_lost(search: Search[Any], active: Active, beside: FloatArray) -> float:
    """Chi-square that a cause is expected to lose even where it is the true one, because its image is made of an attitude
    with errors (Fuller 1987, Measurement Error Models, section 1.2). beside (M, 3, c): what is refitted with it."""
    blurred = search.channel.blur(active, search.base.modelled)
    if blurred is None:
        return 0.0
    blur, image = blurred
    basis = orthonormal(np.concatenate([beside, image], axis=2))
    flat = blur.reshape(-1)
    left = flat - basis @ (basis.T @ flat)
    return float(left @ left)
