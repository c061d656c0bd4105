"""The multiplicative Kalman filter of attitude from field, horizon scanner, sun or reference attitude, without a gyro.

Where two directions are known at once, Davenport's q-method gives the attitude (Wertz 1978, section 12.2.3); from there
the filter carries it on (`filter_kernels`). The rate wanders at random; field and scanner have white noise and
slow errors. Sizes that are not declared are those that make the innovations most likely (Mehra 1970, IEEE Transactions on
Automatic Control 15, 175). S and b of the magnetometer may be part of the state, known to a covariance or unknown.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.covariance import segments
from fluxtwin.calib.common.design import complete_rows, joined
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.words import say
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry

SENSORS = ("field", "attitude", "sun")
"""Columns of `nis` and `inflated`; "attitude" is the scanner, or the reference attitude where there is no scanner."""
_LEARN_ROWS, _LEARN_PIECE = 4000, 700
"""Rows from which sizes are learned; of a longer record pieces, about a third and two thirds of each sensor's rows."""
_ROWS_A_SIZE = 10  # fewer rows for each size that is wanted show none of them
_COVERS = 0.1  # of the rows that another source has: one that has fewer does not replace it
# First fixes compared; how far from the others one may be: times their median, rad.
_VOTES, _AGREES, _AGREES_RAD = 9, 4.0, 0.02
_ALIASED_RAD = 2.5  # a turn so near half a revolution from fix to fix may as well be one the other way round
_FIX_NT, _FIX_SIGMAS_RAD = 300.0, np.array([0.01, 0.002, 0.002])  # field, nadir, sun: weights of a fix
_FIX_RAD = 0.1  # a fix less sure than that starts nothing
_RATE_S, _RATE_RAD = 60.0, 0.5  # a first rate is taken from fixes so far apart at most
_NO_COST = 1e15  # of sizes with which the filter breaks down
_WIDE = 10.0  # the first covariance over that of the fix, whose measurements the filter uses once more
_OF_WALK, _OF_NT, _OF_RAD, _OF_S = (1e-8, 1e-2), (0.3, 1e5), (1e-5, 0.1), (1.0, 2e4)
_BOUNDS = (*(_OF_WALK,) * 3, _OF_NT, _OF_NT, (60.0, 2e4), *(_OF_RAD,) * 3, _OF_S)
"""Of each of `Noises`; below the lowest nothing changes any more."""
_DURATIONS = ("slow_s", "drift_s")


class Noises(NamedTuple):
    """What the filter takes the errors to be, 1 sigma."""

    walk_x_rad_s: float = 3e-6
    """Random walk of the rate about body x in a second."""
    walk_y_rad_s: float = 3e-6
    walk_z_rad_s: float = 3e-6
    field_nT: float = 30.0
    """White, of a component."""
    slow_nT: float = 100.0
    """Slow error of the calibrated field, per body axis, lasting `slow_s`: the field model's, and the spacecraft's own."""
    slow_s: float = 600.0
    sun_rad: float = 2e-3
    """White, of a sun vector, across it."""
    white_rad: float = 1e-3
    """White, of the scanner or the reference attitude."""
    drift_rad: float = 1e-3
    """Its slow error, lasting `drift_s`."""
    drift_s: float = 100.0


class Learned(NamedTuple):
    """Sizes that were declared or found."""

    noises: Noises
    found: tuple[str, ...]
    """Names of those that the data gave."""
    at_bound: tuple[str, ...]
    """Of these, the ones that would be larger than any that was allowed."""
    settled: bool
    """Whether the search came to an end."""


@dataclass(frozen=True)
class FilterRows:
    """What the filter sees; N rows with a position and a measurement. NaN: not measured."""

    time: TimeArray
    """(N,) UTC."""
    t_s: FloatArray
    """(N,) since the first."""
    reading_nT: FloatArray
    """(N, 3) body axes."""
    coupling_nT: FloatArray
    """(N, 3) T D."""
    field_N_nT: FloatArray
    """(N, 3)."""
    nadir_B: FloatArray
    nadir_N: FloatArray
    sun_B: FloatArray
    sun_N: FloatArray
    R_BN: FloatArray
    """(N, 3, 3) reference attitude."""
    rows: np.ndarray
    """(N,) indices into the joined telemetry."""
    left_out: Mapping[str, int]
    source: str = "nadir and sun"
    """What is followed besides the field, in words."""
    set_aside: str = ""
    """What the record has besides, and is not used."""


class Run(NamedTuple):
    """One pass of the filter; N rows, NaN before the first fix of a stretch."""

    A: FloatArray
    """(N, 3, 3) N to B."""
    covariance: FloatArray
    """(N, 3, 3) of the turn about body axes [rad^2]."""
    rate: FloatArray
    """(N, 3) rad/s, body axes."""
    nis: FloatArray
    """(N, 3) squared innovation over its covariance, a component, by `SENSORS`."""
    inflated: FloatArray
    """(N, 3) 1 where the innovation stood out and its noise was inflated."""
    innovation: FloatArray
    """(N, 3) of the field, over its sigma."""
    cost: float
    """Minus twice the log likelihood."""
    p: FloatArray
    """(12,) S row by row, b [nT]."""
    p_covariance: FloatArray
    """(12, 12), or (0, 0) where they were taken as known."""


def q_method(seen_B: FloatArray, known_N: FloatArray, sigma_rad: FloatArray) -> tuple[Rotation, FloatArray]:
    """Attitude from directions known in both frames, row by row: Davenport's q-method.

    seen_B, known_N: (N, M, 3) vectors of any length, NaN where not seen; sigma_rad: (M,) or (N, M). Returns R_BN (batch of
    N) and its covariance (N, 3, 3) about body axes [rad^2]; infinite where fewer than two directions are seen.
    """
    b, n = (v / np.linalg.norm(v, axis=2)[:, :, None] for v in (np.asarray(seen_B), np.asarray(known_N)))
    weight = np.where(np.isfinite(b).all(axis=2) & np.isfinite(n).all(axis=2), np.asarray(sigma_rad) ** -2.0, 0.0)
    b, n = np.nan_to_num(b), np.nan_to_num(n)
    B = np.einsum("km,kmi,kmj->kij", weight, b, n)
    K = np.empty((len(B), 4, 4))
    trace = np.trace(B, axis1=1, axis2=2)
    z = np.stack([B[:, 1, 2] - B[:, 2, 1], B[:, 2, 0] - B[:, 0, 2], B[:, 0, 1] - B[:, 1, 0]], axis=1)
    K[:, :3, :3] = B + np.swapaxes(B, 1, 2) - trace[:, None, None] * np.eye(3)
    K[:, :3, 3] = K[:, 3, :3] = z
    K[:, 3, 3] = trace
    q = np.linalg.eigh(K)[1][:, :, 3]  # textbook quaternion of B relative to N
    information = weight.sum(axis=1)[:, None, None] * np.eye(3) - np.einsum("km,kmi,kmj->kij", weight, b, b)
    good = np.linalg.eigvalsh(information)[:, 0] > 1e-9 * np.maximum(weight.sum(axis=1), 1e-300)
    covariance = np.full((len(B), 3, 3), np.inf)
    covariance[good] = np.linalg.inv(information[good])
    return frames.rotation_from_q(q), covariance


def assemble_rows(
    records: Telemetry | Sequence[Telemetry], model: FieldModel, calibration: Calibration | None = None
) -> FilterRows:
    """Measurements and what they are of, from telemetry. The calibration's T, and fields that follow telemetry, are applied.

    Raises NoAnswer where no row has a position and a measurement, BadInput where the calibration needs a column that is
    not there.
    """
    telemetry = joined(records)
    nadir_B, sun_B = _directions(telemetry.nadir_B, len(telemetry)), _directions(telemetry.sun_B, len(telemetry))
    nadir, sun_seen = np.isfinite(nadir_B[:, 0]), np.isfinite(sun_B[:, 0])
    # What the reference attitude was made of must not count twice: it is either the sensors or the reference.
    given = int(telemetry.has_attitude.sum())
    pairs, any_seen = int((nadir & sun_seen).sum()), int((nadir | sun_seen).sum())
    by_sensors = any_seen > 0 and ((pairs > 0 and pairs >= _COVERS * given) or given < _COVERS * any_seen)
    sensors = " and ".join(name for name, seen in (("nadir", nadir), ("sun", sun_seen)) if seen.any())
    source, set_aside = sensors, "reference attitude" if given else ""
    if not by_sensors:
        source, set_aside = "reference attitude" if given else "no other sensor", sensors
        nadir_B, sun_B = np.full_like(nadir_B, np.nan), np.full_like(sun_B, np.nan)
    attitude = telemetry.has_attitude & (not by_sensors)
    measured = telemetry.has_reading | attitude | np.isfinite(nadir_B).all(axis=1) | np.isfinite(sun_B).all(axis=1)
    rows, left_out = complete_rows(
        {"no position": telemetry.has_position, "no measurement": np.asarray(measured)}, "needs position and sensors"
    )
    used = telemetry.select(rows)
    nadir_B, sun_B = nadir_B[rows], sun_B[rows]
    assert used.r_N_km is not None
    r_N_km = np.array(used.r_N_km)
    A = np.full((len(used), 3, 3), np.nan)
    if attitude.any():
        assert used.q_NB is not None
        A[attitude[rows]] = frames.rotation_from_q(used.q_NB[attitude[rows]]).as_matrix()
    reading, coupling = np.array(used.mag_B_nT), np.zeros((len(used), 3))
    if calibration is not None:
        whole = calibration.apply(reading, used.dipole_B_Am2, calibration.columns_of(telemetry, rows))
        coupling = whole - calibration.b_nT - reading @ (np.eye(3) + calibration.S).T
    return FilterRows(
        time=used.time,
        t_s=epoch.seconds_since(used.time, used.time[0]),
        reading_nT=reading,
        coupling_nT=coupling,
        field_N_nT=field_N_nT(model, used.time, r_N_km),
        nadir_B=nadir_B,
        nadir_N=-r_N_km / np.linalg.norm(r_N_km, axis=1)[:, None],
        sun_B=sun_B,
        sun_N=sun.sun_direction_N(used.time, r_N_km),
        R_BN=A,
        rows=rows,
        left_out=left_out,
        source=source,
        set_aside=set_aside,
    )


def _directions(seen_B: FloatArray | None, count: int) -> FloatArray:
    """(N, 3) unit vectors, NaN where nothing was measured or it has no length."""
    if seen_B is None:
        return np.full((count, 3), np.nan)
    length = np.linalg.norm(seen_B, axis=1)
    return np.asarray(seen_B / np.where(length > 0.0, length, np.nan)[:, None])


class FilterStart(NamedTuple):
    """Where a stretch of rows begins to be followed."""

    begin: int
    """First row; the stretch ends before `end`."""
    end: int
    A: FloatArray
    """(3, 3) N to B."""
    rate: FloatArray
    """(3,) rad/s, body axes."""
    attitude_covariance: FloatArray
    """(3, 3) rad^2, for the noises of `Noises()`."""
    rate_covariance: FloatArray
    """(3, 3) (rad/s)^2, likewise."""


def starts(rows: FilterRows, p: FloatArray | None, breaks: np.ndarray | Sequence[int] = ()) -> list[FilterStart]:
    """A start for each stretch of rows that has two fixes: by reference attitude, or by directions seen together.

    p: (12,) S row by row and b by which the field counts as a direction; None: it does not. breaks: rows at which a new
    stretch begins, besides those after gaps. Raises NoAnswer where there is no start, or the body turns by nearly half a
    revolution from fix to fix.
    """
    R, covariance = fixes(rows, p)
    edges = np.union1d(np.flatnonzero(np.diff(segments(rows.time))) + 1, breaks).astype(int)
    found = []
    for first, end in zip([0, *edges], [*edges, len(rows.t_s)], strict=True):
        sure = first + np.flatnonzero(np.einsum("kii->k", covariance[first:end]) < _FIX_RAD**2)
        sure = sure[_first_credible(rows.t_s[sure[:_VOTES]], R[sure[:_VOTES]]) :] if sure.size > 2 else sure
        if sure.size < 2:
            continue
        begin = int(sure[0])
        later = sure[1:][rows.t_s[sure[1:]] - rows.t_s[begin] <= max(_RATE_S, rows.t_s[sure[1]] - rows.t_s[begin])]
        turned = (R[later] * R[begin].inv()).as_rotvec()
        angle = np.linalg.norm(turned, axis=1)
        if angle[0] > _ALIASED_RAD:
            words = say("attitude.aliased", deg=np.degrees(angle[0]), step_s=rows.t_s[later[0]] - rows.t_s[begin])
            raise NoAnswer(words, evidence={"turn_rad": float(angle[0])})
        far = np.flatnonzero(angle > _RATE_RAD)
        k = max(int(far[0]) - 1, 0) if far.size else len(later) - 1
        h = float(rows.t_s[later[k]] - rows.t_s[begin])
        of_rate = (covariance[begin] + covariance[later[k]]) / h**2
        A = np.ascontiguousarray(R[begin].as_matrix())
        found.append(FilterStart(begin, int(end), A, -turned[k] / h, covariance[begin], of_rate))
    if not found:
        raise NoAnswer(say("attitude.no_start"), evidence={"rows": len(rows.t_s)})
    return found


def _first_credible(t_s: FloatArray, R: Rotation) -> int:
    """Which of a few fixes is the first that lies where the others say, by the steady rate that most of them share."""
    best, off = np.inf, np.zeros(len(t_s), dtype=np.float64)
    for i in range(len(t_s) - 1):
        rate = (R[i + 1] * R[i].inv()).as_rotvec() / (t_s[i + 1] - t_s[i])
        steady = Rotation.from_rotvec((t_s - t_s[i])[:, None] * rate) * R[i]
        apart = (R * steady.inv()).magnitude()
        if (typical := float(np.median(apart))) < best:
            best, off = typical, np.asarray(apart).reshape(-1)
    return int(np.argmax(off <= np.maximum(_AGREES * best, _AGREES_RAD)))


def fixes(rows: FilterRows, p: FloatArray | None) -> tuple[Rotation, FloatArray]:
    """The attitude of each row by itself and its covariance (N, 3, 3), infinite where it cannot be fixed."""
    field = np.full_like(rows.reading_nT, np.nan)
    if p is not None:
        field = rows.reading_nT + rows.reading_nT @ p[:9].reshape(3, 3).T + p[9:] + rows.coupling_nT
    seen = np.stack([field, rows.nadir_B, rows.sun_B], axis=1)
    R, covariance = q_method(seen, np.stack([rows.field_N_nT, rows.nadir_N, rows.sun_N], axis=1), _FIX_SIGMAS_RAD)
    given = np.isfinite(rows.R_BN[:, 0, 0])
    matrices = R.as_matrix()
    matrices[given] = rows.R_BN[given]
    covariance[given] = _FIX_SIGMAS_RAD[1] ** 2 * np.eye(3)
    return Rotation.from_matrix(matrices), covariance


def run(rows: FilterRows, begun: Sequence[FilterStart], noises: Noises, p: FloatArray, p_covariance: FloatArray) -> Run:
    """One pass through all stretches. p: (12,) S row by row and b; p_covariance: (12, 12), or (0, 0) where p is exact."""
    from fluxtwin.calib.attitude.filter_kernels import run_filter

    N, n = len(rows.t_s), 12 + len(p_covariance)
    out = [np.full((N, *shape), np.nan) for shape in ((3, 3), (3, 3), (3,), (3,), (3,), (3,))]
    p, C, cost = p.copy(), p_covariance.copy(), 0.0
    # A start's measurements are used once more, and may be worse than was taken for its weights.
    sizes = (noises.slow_nT / _FIX_NT, np.hypot(noises.white_rad, noises.drift_rad) / _FIX_SIGMAS_RAD[1])
    wide = _WIDE * max(1.0, *sizes, noises.sun_rad / _FIX_SIGMAS_RAD[2]) ** 2
    for one in begun:
        P = np.zeros((n, n))
        P[:3, :3], P[3:6, 3:6] = wide * one.attitude_covariance, wide * one.rate_covariance
        P[6:9, 6:9], P[9:12, 9:12] = noises.slow_nT**2 * np.eye(3), noises.drift_rad**2 * np.eye(3)
        P[12:, 12:] = C
        M0 = np.eye(3) + p[:9].reshape(3, 3)
        at = slice(one.begin, one.end)
        total, p, P = run_filter(
            rows.t_s[at],
            rows.reading_nT[at],
            rows.coupling_nT[at],
            rows.field_N_nT[at],
            rows.nadir_B[at],
            rows.nadir_N[at],
            rows.sun_B[at],
            rows.sun_N[at],
            rows.R_BN[at],
            one.A,
            one.rate,
            p,
            P,
            np.array(noises),
            noises.field_nT**2 * (M0 @ M0.T),
            np.asarray(np.linalg.inv(M0), dtype=np.float64),
            *(part[at] for part in out),
        )
        C, cost = P[12:, 12:].copy(), cost + total
    A, spread, rates, nis, outlying, innovation = out
    return Run(A, spread, rates, nis, outlying, innovation, cost, p, C)


def learned(
    rows: FilterRows,
    begun: Sequence[FilterStart],
    declared: Mapping[str, float],
    p: FloatArray,
    p_covariance: FloatArray,
    *,
    by_field: bool = True,
) -> Learned:
    """The noises that make the innovations most likely, but for those that are declared.

    by_field: whether the field helps to begin a piece of a long record. Raises NoAnswer where there are fewer rows than
    would show so many sizes.
    """
    seen = (
        np.isfinite(rows.reading_nT[:, 0]),
        np.isfinite(rows.nadir_B[:, 0]) | np.isfinite(rows.R_BN[:, 0, 0]),
        np.isfinite(rows.sun_B[:, 0]),
    )
    some, used = list(begun), np.zeros(len(rows.t_s), dtype=bool)
    if sum(one.end - one.begin for one in begun) > _LEARN_ROWS:
        some = _pieces(rows, begun, seen, p if by_field else None)
    for one in some:
        used[one.begin : one.end] = True
    of = dict(zip(("field", "slow", "white", "drift", "sun"), (0, 0, 1, 1, 2), strict=True))
    free = [
        k
        for k, name in enumerate(Noises._fields)
        if name not in declared and (name.startswith("walk") or (seen[of[name.split("_")[0]]] & used).any())
    ]
    if used.sum() < _ROWS_A_SIZE * len(free):
        few = {"rows": int(used.sum()), "sizes": len(free)}
        raise NoAnswer(say("attitude.few_rows", wanted=_ROWS_A_SIZE * len(free), **few), evidence=few)

    def cost(noises: Noises) -> float:
        value = run(rows, some, noises, p, p_covariance).cost
        return value if np.isfinite(value) else _NO_COST

    # A grid first: far from the answer the likelihood has other maxima.
    names = tuple(Noises._fields[k] for k in free)
    suns, drifts = ((2e-3, 2e-2) if name in names else (2e-3,) for name in ("sun_rad", "drift_rad"))
    grid = itertools.product((1e-6, 1e-5, 1e-4, 1e-3), (30.0, 150.0, 1000.0), (100.0, 1000.0), suns, drifts)
    noises = min(
        (
            Noises(walk, walk, walk, white, slow, sun_rad=sun_rad, drift_rad=drift)._replace(**declared)
            for walk, white, slow, sun_rad, drift in grid
        ),
        key=cost,
    )

    def at(logs: FloatArray) -> Noises:
        values = np.array(noises)
        values[free] = np.exp(logs)
        return Noises(*values.tolist())

    def cost_at(logs: FloatArray) -> float:
        return cost(at(logs))

    how: Any = {"eps": 1e-3, "maxiter": 80, "ftol": 3e-6}  # the stubs of scipy do not know eps
    bounds = np.log(np.array(_BOUNDS)[free])
    start = np.log(np.array(noises)[free])
    found = minimize(cost_at, start, method="L-BFGS-B", bounds=bounds.tolist(), options=how)
    best = at(found.x)
    highest = found.x > bounds[:, 1] - 1e-3
    above = tuple(name for name, high in zip(names, highest, strict=True) if high and name not in _DURATIONS)
    return Learned(best, names, above, bool(found.success) and found.fun < _NO_COST)


def _pieces(
    rows: FilterRows, begun: Sequence[FilterStart], seen: Sequence[np.ndarray], p: FloatArray | None
) -> list[FilterStart]:
    """Starts of a few pieces of a long record, about a third and two thirds of the rows that each sensor has."""
    used = np.zeros(len(rows.t_s), dtype=bool)
    for have in seen:
        at = np.flatnonzero(have)
        for k in (len(at) // 3, 2 * len(at) // 3) if len(at) else ():
            first = max(int(at[k]) - _LEARN_PIECE // 2, begun[0].begin)
            used[first : first + _LEARN_PIECE] = True
    edges = np.flatnonzero(np.diff(used.astype(int))) + 1
    return [one for one in starts(rows, p, edges) if used[one.begin]] or list(begun)
