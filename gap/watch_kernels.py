"""The compiled loop of the watch: a Kalman filter's innovations, and what each says for every change that is looked for.

The state (n,) is the attitude error in units of its standard deviation, then the calibration's own error [nT at the usual
field]. The components of a row are taken one after the other, as in `gap.noise.kernels`: their innovations are independent.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import BoolArray, FloatArray, IntArray


@kernel(error_model="numpy")
def run_rows(
    y: FloatArray,
    load: FloatArray,
    white: FloatArray,
    present: BoolArray,
    faults: FloatArray,
    field: FloatArray,
    decay: FloatArray,
    back: FloatArray,
    usual: float,
    directions: FloatArray,
    sizes: FloatArray,
    axes: FloatArray,
    growth: FloatArray,
    prior: FloatArray,
    state: FloatArray,
    covariance: FloatArray,
    settled: FloatArray,
    evidence: FloatArray,
    excursion: FloatArray,
    since: IntArray,
    wild: BoolArray,
    stamps: IntArray,
    armed: bool,
    cut: float,
    most: float,
    most_alone: float,
    threshold: float,
    innovations: FloatArray,
) -> int:
    """Take rows until the evidence reaches the threshold; the number of the row that rang, or -1.

    y (N, 3) [nT]; load (N, 3, n); white (N, 3, 3): what the noise of each sensor axis adds to a component's variance;
    present (N, 3); faults (N, 3, F): what a fault of one white sigma adds to y; decay (N,): share of the attitude error that
    is left since the row before. field (N, 3): predicted, by the reported attitude, and back (3, 4): from field to reading,
    of rows in which all three components are compared; there `load` is made from what the row itself says of the attitude
    error, as the noise of the reading in it, or that of the attitude, would be correlated with y, and S drawn towards zero
    (Fuller 1987, Measurement Error Models, section 1.1). usual: a field by which S counts [nT].
    directions (D, F), sizes (Z,): changes of the mean, of either sign; axes (A, 3), growth (G,): sensor axes whose noise
    grows, by what factor; prior (2 D Z + A G,): their weights, which sum to one.
    state, covariance, settled (3, F) are carried along; so are, one for each change, evidence, excursion and since:
    Shiryaev-Roberts statistic, CUSUM and the stamp where it began; and wild (1,), whether the last row was beyond so many
    sigma as cut says, which moves no state. stamps (N,). most, most_alone: log of the most that a row may say, and that a
    wild one may after one that was not. innovations (N, 3) is filled.
    """
    n, kinds = state.size, faults.shape[2]
    shift, root, lead = np.empty((3, kinds)), np.empty(3), np.empty(n)
    kept, kept_P, before = np.empty(n), np.empty((n, n)), np.empty((3, kinds))
    for t in range(y.shape[0]):
        phi = decay[t]
        for i in range(3):
            state[i] *= phi
            for j in range(n):
                covariance[i, j] *= phi
                covariance[j, i] *= phi
            covariance[i, i] += 1.0 - phi * phi
            for f in range(kinds):
                settled[i, f] *= phi
        kept[:], kept_P[:], before[:] = state, covariance, settled
        filtered = (state, covariance, settled, lead, shift, root, innovations[t])
        worst = _update(y[t], load[t], white[t], present[t], faults[t], *filtered)
        if present[t, 1]:
            _image(load[t], field[t], back, usual, state)
            state[:], covariance[:], settled[:] = kept, kept_P, before
            worst = _update(y[t], load[t], white[t], present[t], faults[t], *filtered)
        limit = most_alone if worst > cut and not wild[0] else most
        wild[0] = worst > cut
        if wild[0]:
            state[:], covariance[:], settled[:] = kept, kept_P, before
        if not (armed and present[t].any()):
            continue
        changes = (directions, sizes, axes, growth, prior)
        seen = (innovations[t], present[t], white[t], shift, root)
        if _weigh(*seen, *changes, limit, stamps[t], evidence, excursion, since) >= threshold:
            return t
    return -1


@part(error_model="numpy")
def _update(
    y: FloatArray,
    load: FloatArray,
    white: FloatArray,
    present: BoolArray,
    faults: FloatArray,
    state: FloatArray,
    covariance: FloatArray,
    settled: FloatArray,
    lead: FloatArray,
    shift: FloatArray,
    root: FloatArray,
    innovations: FloatArray,
) -> float:
    """Take the components of a row one after the other; the largest innovation.

    shift (3, F): what a fault of one white sigma adds to each, as the attitude error lets it through; root (3,): one over
    the innovation's sigma.
    """
    n, kinds, worst = state.size, faults.shape[1], 0.0
    for i in range(3):
        innovations[i] = 0.0
        if not present[i]:
            continue
        variance, e = white[i, 0] + white[i, 1] + white[i, 2], y[i]
        for k in range(n):
            lead[k] = 0.0
            for j in range(n):
                lead[k] += covariance[k, j] * load[i, j]
            e -= load[i, k] * state[k]
        for k in range(n):
            variance += load[i, k] * lead[k]
        root[i] = 1.0 / np.sqrt(variance)
        z = e * root[i]
        innovations[i] = z
        worst = max(worst, abs(z))
        for f in range(kinds):
            m = faults[i, f]
            for k in range(3):
                m -= load[i, k] * settled[k, f]
            shift[i, f] = m * root[i]
            for k in range(3):
                settled[k, f] += lead[k] * root[i] * shift[i, f]
        for k in range(n):
            state[k] += lead[k] * root[i] * z
            for j in range(n):
                covariance[k, j] -= lead[k] * lead[j] * root[i] * root[i]
    return worst


@part(error_model="numpy")
def _image(load: FloatArray, field: FloatArray, back: FloatArray, usual: float, state: FloatArray) -> None:
    """Fill in what S does to a row, from the field as the row itself turns it."""
    true = np.empty(3)
    for j in range(3):
        true[j] = field[j]
        for k in range(3):
            true[j] -= load[j, k] * state[k]
    for j in range(3):
        m = back[j, 3]
        for k in range(3):
            m += back[j, k] * true[k]
        for i in range(3):
            load[i, 3 + 3 * i + j] = m / usual


@part(error_model="numpy")
def _weigh(
    innovations: FloatArray,
    present: BoolArray,
    white: FloatArray,
    shift: FloatArray,
    root: FloatArray,
    directions: FloatArray,
    sizes: FloatArray,
    axes: FloatArray,
    growth: FloatArray,
    prior: FloatArray,
    limit: float,
    stamp: int,
    evidence: FloatArray,
    excursion: FloatArray,
    since: IntArray,
) -> float:
    """What a row says for each change; the evidence for any."""
    place, total = 0, 0.0
    for d in range(directions.shape[0]):
        along, square = 0.0, 0.0
        for i in range(3):
            if present[i]:
                m = 0.0
                for f in range(shift.shape[1]):
                    m += directions[d, f] * shift[i, f]
                along += m * innovations[i]
                square += m * m
        for s in range(sizes.size):
            for sign in (-1.0, 1.0):
                said = sign * sizes[s] * along - 0.5 * sizes[s] ** 2 * square
                total += _take(said, limit, place, stamp, prior, evidence, excursion, since)
                place += 1
    for a in range(axes.shape[0]):
        for g in range(growth.size):
            said = 0.0
            for i in range(3):
                if present[i]:
                    more = 0.0
                    for k in range(3):
                        more += axes[a, k] * white[i, k]
                    wider = 1.0 + (growth[g] ** 2 - 1.0) * more * root[i] ** 2
                    said += 0.5 * (innovations[i] ** 2 * (1.0 - 1.0 / wider) - np.log(wider))
            total += _take(said, limit, place, stamp, prior, evidence, excursion, since)
            place += 1
    return total


@part(error_model="numpy")
def _take(
    said: float,
    limit: float,
    place: int,
    stamp: int,
    prior: FloatArray,
    evidence: FloatArray,
    excursion: FloatArray,
    since: IntArray,
) -> float:
    """Add what a row says for a change (log of an e-value); its share of the evidence."""
    evidence[place] = (1.0 + evidence[place]) * np.exp(min(said, limit))
    if excursion[place] <= 0.0:
        excursion[place], since[place] = 0.0, stamp
    excursion[place] += min(said, 4.0 * limit)  # only names the change, so it may separate more of the large ones
    share: float = prior[place] * evidence[place]
    return share
