"""Which way the attitude and the magnetometer's axes are meant, judged by the field model.

The reading is predicted with the attitude under every convention (scalar last or first, as it is or transposed,
relative to GCRS, Earth-fixed axes, north-east-centre or the orbital frame) and every mounting (48 signed
permutations of the axes), with one scale free. A constant bias of any size is free: uncompensated satellites
fly with 50,000 nT. A last look without it sees what a short arc hides behind a bias, where one simple convention
makes a large bias needless.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim import frames
from fluxtwin.sim.check_report import Finding, note, trap
from fluxtwin.sim.types import FloatArray, TimeArray

ORIENTATION_MISFIT = 0.2
"""Share of |B| left after the bias fit. Misaligned, miscaled sensors leave up to 0.17 (S of 10 % in every element); a
wrong convention leaves 0.5 to 1.5 where the field turns in body axes."""
SMALLEST_MISFIT_nT = 500.0
"""Coarse steps (440 nT) and storms alone leave this much; it matters where the field is weak."""
UNEXPLAINED = 0.5
"""Share of the reading's own variation left after the bias fit: a sensor with errors of 10 % leaves 0.2."""
SMALLEST_UNEXPLAINED_nT = 1_000.0
"""Noise, coarse steps and interference are this large; less variation tells nothing."""
LARGE_BIAS_nT = 7_500.0
"""Misfits without bias fit below this are a usual bias and errors of 10 %; above, the bias is large or the axes wrong."""
COINCIDENCE, COINCIDENCE_nT = 0.15, 4_000.0
"""A large bias that looks like one simple wrong convention to this share and size is rarer than the convention."""
FAR_BETTER = 0.5
"""An alternative is named when it leaves at most half of the misfit."""
STANDS_OUT = 1.5
"""On a short arc, the best alternative is named only if the next one leaves this much more."""
SIMPLE = 0.2
"""Cost of one single thing wrong: the order, the sense, the reference or the mounting."""


@dataclass(frozen=True)
class Sample:
    """Rows that can be compared with the model; at most a few thousand, evenly taken."""

    time: TimeArray
    r_N_km: FloatArray
    mag_nT: FloatArray
    field_N_nT: FloatArray
    q_NB: FloatArray | None
    v_N_km_s: FloatArray | None


@dataclass(frozen=True)
class _Trial:
    misfit_nT: float
    cost: float
    """Preference for the simpler explanation: shares added to the misfit before comparing."""
    convention: str
    mounting: str


def check_orientation(sample: Sample) -> list[Finding]:
    """The trap by name, a note when nothing can be told, or nothing when the attitude fits as it stands."""
    typical = _rms(sample.field_N_nT)
    predicted = [(cost, words, R_BN.apply(sample.field_N_nT)) for cost, words, R_BN in _conventions(sample)]
    biased = _trials(sample.mag_nT, predicted, with_bias=True)
    varies = _rms(sample.mag_nT - sample.mag_nT.mean(axis=0))
    evidence = f"with the attitude as it stands the reading misses the model by {biased[0].misfit_nT:.0f} nT rms"
    if biased[0].misfit_nT > max(ORIENTATION_MISFIT * typical, SMALLEST_MISFIT_nT):
        return [_judged(biased, f"{evidence} after a bias fit", typical, 1.0)]
    best = min(trial.misfit_nT * (1.0 + trial.cost) for trial in biased)
    unexplained = biased[0].misfit_nT > max(UNEXPLAINED * varies, SMALLEST_UNEXPLAINED_nT)
    if unexplained and best < FAR_BETTER * biased[0].misfit_nT:
        evidence += f" after a bias fit, and the reading itself varies by {varies:.0f} nT"
        return [_judged(biased, evidence, typical, STANDS_OUT)]
    return _without_bias(sample, predicted)


def _without_bias(sample: Sample, predicted: list[tuple[float, str, FloatArray]]) -> list[Finding]:
    """What a short arc hides behind a bias: a large bias that a simple wrong convention explains is not believed."""
    typical = _rms(sample.field_N_nT)
    plain = _trials(sample.mag_nT, predicted, with_bias=False)
    missed = plain[0].misfit_nT
    findings = []
    if missed > LARGE_BIAS_nT:
        evidence = f"with the attitude as it stands the reading misses the model by {missed:.0f} nT rms"
        limit = min(COINCIDENCE * missed, COINCIDENCE_nT)
        if any(trial.misfit_nT < limit and trial.cost <= SIMPLE for trial in plain[1:]):
            simple = [plain[0], *(trial for trial in plain[1:] if trial.cost <= SIMPLE)]
            return [_judged(simple, f"{evidence} without a bias fit", typical, STANDS_OUT)]
        findings.append(note("large_bias", f"{evidence} without a bias fit: a large bias, if the axes are right"))
    as_stated = predicted[0][2]
    if _rms(as_stated - as_stated.mean(axis=0)) < 0.15 * typical:
        text = "the field hardly changes in body axes: only gross errors of attitude and axes would show"
        findings.append(note("orientation_not_tested", text))
    return findings


def _judged(trials: list[_Trial], evidence: str, typical_nT: float, stands_out: float) -> Finding:
    ranked = sorted(trials, key=lambda trial: trial.misfit_nT * (1.0 + trial.cost))
    best, second = ranked[0], ranked[1]
    if best.misfit_nT > FAR_BETTER * trials[0].misfit_nT:
        return trap(
            "vector_mismatch",
            f"{evidence}, {100 * trials[0].misfit_nT / typical_nT:.0f} % of |B|, and no known convention does far "
            "better: another attitude, another sensor, or times that do not belong together",
        )
    if second.misfit_nT < stands_out * best.misfit_nT and stands_out > 1.0:
        listed = "; or ".join(_words(trial) for trial in ranked[:3])
        return trap("vector_mismatch", f"{evidence}; the arc is too short to tell why. Candidates: {listed}")
    code = "attitude_convention" if best.convention else "magnetometer_axes"
    advice = (
        "state it in a column map (order, sense, relative_to)" if best.convention else "turn the columns accordingly"
    )
    return trap(code, f"{evidence}, but only by {best.misfit_nT:.0f} nT if {_words(best)}: {advice}")


def _words(trial: _Trial) -> str:
    return " and ".join(part for part in (trial.convention, trial.mounting) if part) or "nothing is changed"


def _trials(mag_nT: FloatArray, predicted: list[tuple[float, str, FloatArray]], *, with_bias: bool) -> list[_Trial]:
    """Every convention and mounting with its misfit; the first is what the file says."""
    out = []
    m = mag_nT - mag_nT.mean(axis=0) if with_bias else mag_nT
    for cost, convention, field_nT in predicted:
        p = field_nT - field_nT.mean(axis=0) if with_bias else field_nT
        total, power, cross = float(np.sum(m**2)), float(np.sum(p**2)), m.T @ p
        for order, signs in _mountings():
            gain = sum(s * cross[i, j] for i, (j, s) in enumerate(zip(order, signs, strict=True)))
            left = total - (gain**2 / power if gain > 0 and power > 0 else 0.0)
            plain = order == (0, 1, 2) and min(signs) > 0
            words = "" if plain else _mounting_words(order, signs)
            misfit = float(np.sqrt(max(left, 0.0) / len(m)))
            out.append(_Trial(misfit, cost + (0.0 if plain else 0.2), convention, words))
    return out


def _mountings() -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
    """The 48 signed permutations of three axes, the plain one first."""
    return list(itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)))


def _conventions(sample: Sample) -> list[tuple[float, str, Rotation]]:
    """(cost, words, R_BN) for every way to read the quaternion; the first is as the contract says."""
    q = np.zeros((1, 4)) if sample.q_NB is None else sample.q_NB
    orders = ((0.0, "", q), (0.1, "the quaternion is scalar first", q[:, [1, 2, 3, 0]]))
    references: list[tuple[float, str, Rotation | None]] = [
        (0.0, "", None),
        (0.15, "the attitude is relative to Earth-fixed axes", frames.rotation_EN(sample.time)),
        (0.15, "the attitude is relative to north, east, centre", _nec(sample)),
    ]
    orbital = _orbital(sample)
    if orbital is not None:
        references.append((0.15, "the attitude is relative to the orbital frame", orbital))
    out = []
    for (c1, order, quaternion), conjugate in itertools.product(orders, (False, True)):
        R = frames.rotation_from_q(quaternion)
        R = R.inv() if conjugate else R
        for c3, reference, R_XN in references:
            words = [w for w in (order, "it is conjugated (transposed)" if conjugate else "", reference) if w]
            if words and words[0].startswith("it is"):
                words[0] = words[0].replace("it is", "the quaternion is")
            out.append((c1 + 0.1 * conjugate + c3, " and ".join(words), R if R_XN is None else R * R_XN))
    return out


def _orbital(sample: Sample) -> Rotation | None:
    if sample.v_N_km_s is None or not np.isfinite(sample.v_N_km_s).all():
        return None
    return frames.rotation_ON(sample.r_N_km, sample.v_N_km_s)


def _nec(sample: Sample) -> Rotation:
    R_EN = frames.rotation_EN(sample.time)
    return frames.rotation_NEC_E(R_EN.apply(sample.r_N_km)) * R_EN


def _mounting_words(order: tuple[int, ...], signs: tuple[float, ...]) -> str:
    sides = ", ".join(
        f"mag_{'xyz'[i]} is {'-' if s < 0 else '+'}{'xyz'[j]}"
        for i, (j, s) in enumerate(zip(order, signs, strict=True))
    )
    parity = np.prod(signs) * np.linalg.det(np.eye(3)[list(order)])
    return f"the axes are turned ({sides}{'; mirrored' if parity < 0 else ''})"


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
