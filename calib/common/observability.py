"""What the data determine, and what they do not, in words.

Before the fit: a torquer axis that never fired, a dipole that never changed, a dipole in proportion to the
field, a field that does not vary in some body direction are found and named. After it: pairs of parameters
that the data hardly separate.

The test looks at the rows z = [1, B / |B|rms, D / |D|rms]. Along a unit vector v of that space the mean square
<(v.z)^2> = l says how much the data move. What the noise of the reading contributes to l is no excitation; of
the rest, N l / s^2 is the information about that combination of parameters, in units of |B|rms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.records import parameter_names
from fluxtwin.sim.base.errors import NoAnswer, amount
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG

AXES = ("X", "Y", "Z")
ROUNDING = 1e-13  # of the mean square: below this the columns are dependent to rounding
_NOISE_SHARE = 2.0  # a variation must have twice the variance that noise alone gives it
WORST_SIGMA = 0.3  # of |B|rms: a combination less certain than that is refused
PART = 0.2  # share of a parameter in a direction from which it is named
HARDLY_SEPARABLE = 0.95


@dataclass(frozen=True)
class FieldVariation:
    """Eigenvalues of <B|B>: how far the reading moves in each direction of the body."""

    rms_nT: FloatArray
    """(3,) square roots, ascending."""
    directions_B: FloatArray
    """(3, 3) unit vectors in rows, in the same order."""

    @property
    def condition_number(self) -> float:
        """Largest over smallest eigenvalue of <B|B>."""
        return float((self.rms_nT[-1] / max(float(self.rms_nT[0]), 1e-300)) ** 2)

    def words(self) -> str:
        """One line a person can read."""
        parts = (
            f"{plain(r)} nT along {direction_words(v)}" for r, v in zip(self.rms_nT, self.directions_B, strict=True)
        )
        return "the field varies by " + ", ".join(parts) + " (rms, body axes)"


def field_variation(B_nT: FloatArray, a: FloatArray | None = None) -> FieldVariation:
    """From readings (N, 3) with weights a (N,), equal where not given."""
    values, vectors = np.linalg.eigh(np.cov(B_nT, rowvar=False, bias=True, aweights=a))
    return FieldVariation(np.sqrt(np.maximum(values, 0.0)), vectors.T)


def direction_words(v: FloatArray) -> str:
    """`body Y`, or the components when no axis is within 25 deg."""
    axis = int(np.argmax(np.abs(v)))
    if abs(v[axis]) > 0.9 * float(np.linalg.norm(v)):
        return f"body {AXES[axis]}"
    v = v * np.sign(v[axis])
    return f"body direction ({v[0]:.2f}, {v[1]:.2f}, {v[2]:.2f})"


def never_fired_words(fired: np.ndarray) -> list[str]:
    """One sentence for each torquer axis that never fired."""
    return [
        f"T1{j + 1}, T2{j + 1} and T3{j + 1} are not estimated: torquer {AXES[j]} never fired in these data"
        for j in range(3)
        if j not in fired
    ]


def require_samples(rows: int, parameters: int) -> None:
    """Raises NoAnswer when there are fewer samples than parameters."""
    if rows < parameters:
        raise NoAnswer(
            f"{amount(rows, 'usable sample|usable samples')} for {parameters} parameters: at least {parameters} "
            "are needed, or fewer parameters (--parameters b)",
            evidence={"samples": rows, "parameters": parameters},
        )


def require_excitation(
    field_nT: FloatArray,
    dipole: Sequence[FloatArray],
    fired: np.ndarray,
    a: FloatArray,
    noise_variance_nT2: FloatArray | float = 0.0,
    sigma_nT: float = 0.0,
) -> None:
    """Raises NoAnswer, naming the parameters, where a combination of them is not determined.

    field_nT: B or A H (N, 3). dipole: the columns of D that fired, in a list of one, or of none; a: (N,) weights of sum 1.
    noise_variance_nT2: (3,) of the field's noise (0 for a reference). sigma_nT: of the residual.
    """
    x = np.hstack([field_nT, *dipole])
    square = (x * a[:, None]).T @ x
    field_rms_nT = float(np.sqrt(np.trace(square[:3, :3])))
    if not field_rms_nT > 0:
        raise NoAnswer("the magnetometer reads zero throughout: nothing can be calibrated")
    scale = np.concatenate([np.full(3, field_rms_nT), np.sqrt(np.diag(square)[3:])])
    gram = np.ones((scale.size + 1, scale.size + 1))
    gram[0, 1:] = gram[1:, 0] = a @ x / scale
    gram[1:, 1:] = square / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(gram)
    noise = np.zeros(len(values))
    noise[1:4] = noise_variance_nT2 / field_rms_nT**2
    dependent = values < ROUNDING
    if dependent.any():
        vectors[:, dependent] = _one_by_one(vectors[:, dependent], np.sqrt(np.diag(gram)))
    for value, v in zip(values, vectors.T, strict=True):
        from_noise = float(noise @ v**2)
        signal = value - from_noise
        relative = sigma_nT / field_rms_nT / np.sqrt(max(signal, 1e-300) * max(len(x) - len(values), 1))
        hidden = signal < (_NOISE_SHARE - 1.0) * from_noise
        if value < ROUNDING or hidden or relative > WORST_SIGMA:
            moves_nT = float(np.sqrt(max(value, 0.0)) * field_rms_nT)
            _refuse(v, fired, moves_nT, relative, within_noise=hidden and relative <= WORST_SIGMA)


def _one_by_one(v: FloatArray, rms: FloatArray) -> FloatArray:
    """(p, m) what each parameter moves, of columns of this rms (p,), in combinations of length 1 that move nothing, where v
    (p, m) spans all of these. Eigenvectors of one eigenvalue are mixed in any way, by rounding alone: so each has one of m
    parameters that the others do not have, and those of the same kind are taken together."""
    own = qr(v.T, pivoting=True, mode="r")[1][: v.shape[1]]
    apart = rms[:, None] * np.linalg.solve(v[own].T, v.T).T
    apart /= np.linalg.norm(apart, axis=0)
    kinds = [(bool(one[0]), bool(one[1:4].any()), bool(one[4:].any())) for one in np.abs(apart.T) > PART]
    alike = [place for place, kind in enumerate(kinds) if kind == kinds[0] and kind[2]]
    if len(alike) > 1:
        apart[:, 0] = np.sqrt(np.sum(apart[:, alike] ** 2, axis=1))
    return np.asarray(apart)


def _refuse(v: FloatArray, fired: np.ndarray, moves_nT: float, relative: float, *, within_noise: bool) -> None:
    of_field, of_dipole = v[1:4], v[4:]
    axes = [int(j) for j in np.flatnonzero(np.abs(of_field) > PART)]
    coils = [int(fired[j]) for j in np.flatnonzero(np.abs(of_dipole) > PART)]
    names = [f"S{i}{j + 1}" for j in axes for i in (1, 2, 3)]
    names += ["b1", "b2", "b3"] if abs(v[0]) > 0.02 else []
    names += [f"T{i}{j + 1}" for j in coils for i in (1, 2, 3)]
    where, along = " and ".join(AXES[j] for j in coils), " and ".join(f"body {AXES[j]}" for j in axes)
    if coils and axes:
        text = (
            f"the dipole of torquer {where} is in proportion to the field along {along}: "
            f"{listed(names)} are not separable in these data. Fire the torquers independently of the field, or "
            "use --parameters b,S (S then holds the effect of the torquers)"
        )
    elif coils and len(coils) > 1 and abs(v[0]) <= 0.02:
        text = (
            f"torquers {where} always fire in the same proportion: {listed(names)} are not separable in these data. "
            "Fire them one at a time, or use --parameters b,S"
        )
    elif coils:
        text = (
            f"the dipole of torquer {where} never changes: {listed(names)} are not separable in these data. Switch "
            "it on and off, or use --parameters b,S (b then holds the field of the torquer)"
        )
    else:
        text = (
            f"the field does not vary beyond the noise along {direction_words(of_field)}: {listed(names)} are not "
            "separable in these data. Add orbits, days or attitudes in which it varies, or use --parameters b"
        )
        if within_noise:
            text += (
                ", or, if the reference field varies, --method forward, which the noise of the reading does not bias"
            )
        text += ". If it should vary there, fluxtwin check names a wrong unit or a stuck axis"
    raise NoAnswer(
        text,
        evidence={
            "parameters": names,
            "direction": {"constant": float(v[0]), "field": of_field.tolist(), "dipole": of_dipole.tolist()},
            "varies_nT": moves_nT,
            "relative_sigma": float(relative) if relative < 1e6 else None,
        },
    )


def correlated_pairs(covariance: FloatArray) -> list[tuple[float, int, int]]:
    """Correlations of 0.95 or more, with the numbers of the two parameters, i < j."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0, sigma, np.inf)
    C = covariance / np.outer(scale, scale)
    return [(float(C[j, i]), int(i), int(j)) for j, i in np.argwhere(np.tril(np.abs(C) >= HARDLY_SEPARABLE, -1))]


def pair_words(covariance: FloatArray, with_T: bool, field_rms_nT: float, sigma_nT: float) -> list[str]:
    """A sentence for pairs of parameters that the data hardly separate; the worst is named.

    A pair is named when its correlation is at least 0.95 and the weaker one's sigma matters: an error of one
    sigma in S (times the rms field) or in b is larger than the residual's sigma.
    """
    names, sigma = parameter_names(with_T), np.sqrt(np.diag(covariance))
    in_nT = sigma * np.where([name[0] == "S" for name in names], field_rms_nT, 1.0)
    found = []
    for correlation, i, j in correlated_pairs(covariance[:12, :12]):
        if max(in_nT[i], in_nT[j]) > sigma_nT:
            sizes = f"sigma {_sized(names[i], sigma[i])}, {_sized(names[j], sigma[j])}"
            found.append((correlation, f"{_pair(names[i], names[j], correlation)}, {sizes}"))
    return worst_of(found)


def relative_pair_words(covariance: FloatArray, names: Sequence[str], least_sigma: float) -> list[str]:
    """As `pair_words` for parameters in parts of the field; least_sigma: from which a sigma matters."""
    sigma = np.sqrt(np.diag(covariance))
    return worst_of(
        [
            (correlation, _pair(names[i], names[j], correlation))
            for correlation, i, j in correlated_pairs(covariance)
            if max(sigma[i], sigma[j]) > least_sigma
        ]
    )


def _pair(one: str, other: str, correlation: float) -> str:
    return f"{one} and {other} are not separable in these data: correlation {correlation:.3f}"


def worst_of(found: list[tuple[float, str]]) -> list[str]:
    """One sentence of many on correlated pairs: that of the largest correlation, and how many pairs there are."""
    if not found:
        return []
    more = f"; {len(found) - 1} more pairs with a correlation of {HARDLY_SEPARABLE} or more" if len(found) > 1 else ""
    return [max((abs(correlation), words) for correlation, words in found)[1] + more]


def weak_direction_words(variation: FieldVariation, covariance: FloatArray) -> list[str]:
    """A sentence when the weakest direction of the field leaves a column of S uncertain beyond 1 %."""
    weak = variation.directions_B[0]
    of_column = np.kron(np.eye(3), weak[None, :]) @ covariance[:9, :9] @ np.kron(np.eye(3), weak[:, None])
    worst = float(np.sqrt(max(np.diag(of_column).max(), 0.0)))
    if worst < 0.01:
        return []
    axis = int(np.argmax(np.abs(weak)))
    names = f"S1{axis + 1}, S2{axis + 1}, S3{axis + 1}"
    return [
        f"the field varies by only {plain(float(variation.rms_nT[0]))} nT along {direction_words(weak)}: {names} are weak, "
        f"sigma {worst:.2g}"
    ]


def _sized(name: str, sigma: float) -> str:
    if name[0] == "S":
        return f"{name} {sigma:.2g}"
    return f"{name} {sigma:.3g} nT ({sigma / NT_PER_MG:.2g} mG)"


def listed(names: Sequence[str]) -> str:
    """`a, b and c`."""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
