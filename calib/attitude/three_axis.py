"""Three-axis attitude of a record, through the night too, and whether it holds.

The filter is in `attitude.filter`. Its innovations over their predicted sigma say whether it holds: they should average 1
squared, sensor by sensor, and not repeat from row to row. Sizes that are found in the innovations make them so in many a
wrong world too; what the calibration says of its errors, and the noise along the field, where no attitude acts, are held
against them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.attitude.filter import (
    SENSORS,
    FilterRows,
    Learned,
    Noises,
    Run,
    assemble_rows,
    learned,
    run,
    starts,
)
from fluxtwin.calib.attitude.yaw import velocity_of
from fluxtwin.calib.common.design import joined
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.calib.common.words import say
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

_CONSISTENT = (0.8, 1.25)
"""Squared innovations over their predicted variance, mean of a sensor."""
_REPEATS = 0.2  # correlation of neighbouring innovations of the field
_MOST_OUTLIERS = 0.05  # share of innovations of a sensor
_EXPLAINED = 1.5  # error of the field over that which calibration and noise explain
# An error of scanner or reference that lasts so long may as well be a mounting, or the sun sensor's.
_LASTING_S = 1000.0


@dataclass(frozen=True)
class AttitudeSolution(Shown):
    """N rows that have a position, a measurement, and a first fix before them."""

    time: TimeArray
    """(N,) UTC."""
    q_NB: FloatArray
    """(N, 4) textbook quaternion of the body relative to N, scalar last, from the rows up to each."""
    sigma_rad: FloatArray
    """(N, 3) 1 sigma of the turn about body x, y, z."""
    covariance: FloatArray
    """(N, 3, 3) of that turn."""
    yaw_roll_pitch_rad: FloatArray
    """(N, 3) the 3-1-2 angles from the orbital frame; NaN where the velocity is not known."""
    rate_B_rad_s: FloatArray
    """(N, 3) of the body relative to N."""
    aided: BoolArray
    """(N,) True where the sun is seen, or the reference attitude known: what a record has by day."""
    inflated: BoolArray
    """(N,) True where a measurement stood out and was given less weight."""
    rows: np.ndarray
    """(N,) indices into the joined telemetry."""
    left_out: Mapping[str, int]
    """Rows not used, by reason."""
    noises: Noises
    """What the errors were taken to be, declared or found."""
    nis: Mapping[str, float]
    """By sensor: mean squared innovation over its predicted variance; 1 is right."""
    lag_correlation: float
    """Correlation of neighbouring innovations of the field, over all axes; 0 is right."""
    reasons: tuple[str, ...]
    """Why the attitude does not hold, in sentences; none where it does."""
    limits: tuple[str, ...] = ()
    """What speaks against it although the innovations do not, in sentences."""
    source: str = ""
    """What was followed besides the field."""
    set_aside: str = ""
    """What the record has besides, and was not used; empty where all was."""

    @property
    def holds(self) -> bool:
        """Whether the errors are what they are said to be, as far as the innovations show."""
        return not self.reasons

    @property
    def level(self) -> str:
        """`good`; `usable`, with limits; `bad`: the innovations contradict it."""
        return "bad" if self.reasons else "usable" if self.limits else "good"

    @property
    def aid(self) -> str:
        """What `aided` rows have."""
        return "reference attitude" if "reference" in self.source else "sun"

    def expected_deg(self, aided: bool) -> list[float] | None:
        """rms of the sigmas about body x, y, z by day (aided) or by night [deg]; None where there is no such row."""
        chosen = self.aided == aided
        return np.degrees(np.sqrt((self.sigma_rad[chosen] ** 2).mean(axis=0))).tolist() if chosen.any() else None

    def to_dict(self) -> dict[str, Any]:
        """Degrees and UTC text for JSON; None where a number is not known."""
        angles = np.degrees(self.yaw_roll_pitch_rad)
        return {
            "holds": self.holds,
            "level": self.level,
            "reasons": list(self.reasons),
            "limits": list(self.limits),
            "followed": self.source,
            "set_aside": self.set_aside,
            "sigma_deg": {"day": self.expected_deg(True), "night": self.expected_deg(False)},
            "nis": dict(self.nis),
            "lag_correlation": self.lag_correlation,
            "noises": self.noises._asdict(),
            "left_out": dict(self.left_out),
            "time": [epoch.iso(t, "ms") for t in self.time],
            **{f"q_{axis}": self.q_NB[:, k].tolist() for k, axis in enumerate("xyzw")},
            **{f"{name}_deg": angles[:, k].tolist() for k, name in enumerate(("yaw", "roll", "pitch"))},
            **{f"sigma_{axis}_deg": np.degrees(self.sigma_rad[:, k]).tolist() for k, axis in enumerate("xyz")},
            "aided": self.aided.astype(int).tolist(),
        }


def estimate_attitude(
    records: Telemetry | Sequence[Telemetry],
    calibration: Calibration,
    model: FieldModel,
    *,
    noise_nT: float | None = None,
    attitude_sigma_deg: float | None = None,
    attitude_tau_s: float | None = None,
    sun_sigma_deg: float | None = None,
    progress: Progress = silent,
) -> AttitudeSolution:
    """Attitude of every row from the first fix of each stretch on, by a filter that only looks back.

    The calibration's S and b are refined within their covariance, so that what it does not know is in the sigmas; errors
    of its T are not. noise_nT: white noise of a component, rounding included. attitude_sigma_deg, attitude_tau_s: error of
    the horizon scanner, or of the reference attitude in a record without scanner, and how long it lasts (0: white).
    sun_sigma_deg: white noise of the sun vector. What is None is found in the innovations.

    Raises NoAnswer where no row is complete, the attitude cannot be started, or the rows are too few for the errors that are
    not declared; BadInput for a size out of range and for a column that the calibration needs.
    """
    declared = declared_noises(noise_nT, attitude_sigma_deg, attitude_tau_s, sun_sigma_deg)
    telemetry = joined(records)
    rows = assemble_rows(telemetry, model, calibration)
    p = np.concatenate([calibration.S.ravel(), calibration.b_nT])
    covariance = np.array(calibration.covariance[:12, :12])
    begun = starts(rows, p)
    progress("finding the noise", 0.3)
    taken = learned(rows, begun, declared, p, np.zeros((0, 0)))
    progress("following the attitude", 0.8)
    done = run(rows, begun, taken.noises, p, covariance)
    known = np.flatnonzero(np.isfinite(done.A[:, 0, 0]))
    left_out = dict(rows.left_out)
    if len(known) < len(rows.t_s):
        left_out["before a first fix"] = len(rows.t_s) - len(known)
    index, R = rows.rows[known], Rotation.from_matrix(done.A[known])
    velocity = velocity_of(telemetry)[index]
    angles, moving = np.full((len(known), 3), np.nan), np.isfinite(velocity).all(axis=1)
    if moving.any():
        assert telemetry.r_N_km is not None
        R_ON = frames.rotation_ON(telemetry.r_N_km[index[moving]], velocity[moving])
        angles[moving] = np.stack(frames.yaw_roll_pitch(R[np.flatnonzero(moving)] * R_ON.inv()), axis=1)
    nis, lag_correlation, reasons = consistency(done)
    return AttitudeSolution(
        time=rows.time[known],
        q_NB=frames.q_from_rotation(R),
        covariance=done.covariance[known],
        sigma_rad=np.sqrt(np.einsum("kii->ki", done.covariance[known])),
        yaw_roll_pitch_rad=angles,
        rate_B_rad_s=done.rate[known],
        aided=np.isfinite(rows.sun_B[known, 0]) | np.isfinite(rows.R_BN[known, 0, 0]),
        inflated=np.asarray((done.inflated[known] == 1.0).any(axis=1)),
        rows=index,
        left_out=left_out,
        noises=taken.noises,
        nis=nis,
        lag_correlation=lag_correlation,
        reasons=reasons,
        limits=limits(rows, calibration, taken),
        source=rows.source,
        set_aside=rows.set_aside,
    )


def declared_noises(
    noise_nT: float | None, attitude_sigma_deg: float | None, attitude_tau_s: float | None, sun_sigma_deg: float | None
) -> dict[str, float]:
    """The fields of `Noises` that are given. Raises BadInput for a size out of range, or a time without a size."""
    for name, value, top in (
        ("noise_nT", noise_nT, 1e5),
        ("attitude_sigma_deg", attitude_sigma_deg, 90.0),
        ("sun_sigma_deg", sun_sigma_deg, 90.0),
    ):
        if value is not None and not 0.0 < value < top:
            raise BadInput(
                f"{value!r}", where=f"--{name.replace('_', '-')}", wanted=f"1 sigma, positive, below {top:g}"
            )
    found = {} if noise_nT is None else {"field_nT": float(noise_nT)}
    if sun_sigma_deg is not None:
        found["sun_rad"] = float(np.radians(sun_sigma_deg))
    if attitude_tau_s is not None and (attitude_sigma_deg is None or not 0.0 <= attitude_tau_s < np.inf):
        raise BadInput(
            f"{attitude_tau_s!r}",
            where="--attitude-tau-s",
            wanted="s, finite, not negative, together with --attitude-sigma-deg",
        )
    if attitude_sigma_deg is not None:
        sigma = float(np.radians(attitude_sigma_deg))
        if attitude_tau_s == 0.0:
            return {**found, "white_rad": sigma, "drift_rad": 1e-3 * sigma, "drift_s": 1.0}
        found |= {"white_rad": 1e-3 * sigma, "drift_rad": sigma}
        if attitude_tau_s is not None:
            found["drift_s"] = float(attitude_tau_s)
    return found


def limits(rows: FilterRows, calibration: Calibration, taken: Learned) -> tuple[str, ...]:
    """What speaks against the sizes that were found, in sentences: innovations cannot, for the sizes were fitted to them."""
    n, said = taken.noises, []
    explained_nT = _explained_nT(rows, calibration)
    found_nT = float(np.hypot(n.field_nT, n.slow_nT))
    if {"field_nT", "slow_nT"} & set(taken.found) and found_nT > _EXPLAINED * explained_nT:
        over = f" over {plain(n.slow_s, 2)} s" if n.slow_nT > n.field_nT else " from row to row"
        said.append(say("attitude.field_off", found=found_nT, over=over, explained=explained_nT))
    if "drift_s" in taken.found and n.drift_s > _LASTING_S and n.drift_rad > n.white_rad:
        said.append(say("attitude.lasting", source=rows.source, deg=np.degrees(n.drift_rad), tau_s=n.drift_s))
    C = calibration.covariance[:9, :9]
    if C.any() and np.array_equal(calibration.S, calibration.S.T) and np.allclose(C[[1, 2, 5]], C[[3, 6, 7]]):
        said.append(say("attitude.no_rotation"))
    if taken.at_bound:
        said.append(say("attitude.at_bound", names=", ".join(taken.at_bound)))
    if not taken.settled:
        said.append(say("attitude.unsettled"))
    return tuple(said)


def _explained_nT(rows: FilterRows, calibration: Calibration) -> float:
    """What a component of the field may be off by: the calibration's residual and sigma, and noise, declared or seen.

    The noise is that of the field's length from row to row, which no attitude changes.
    """
    B = rows.reading_nT
    field = B + B @ calibration.S.T + calibration.b_nT + rows.coupling_nT
    off = np.linalg.norm(field, axis=1) - np.linalg.norm(rows.field_N_nT, axis=1)
    bend = np.abs(off[2:] - 2.0 * off[1:-1] + off[:-2])
    bend = bend[np.isfinite(bend)]
    white_nT = MAD_TO_SIGMA * float(np.median(bend)) / np.sqrt(6.0) if bend.size else 0.0
    z = np.column_stack([B, np.ones(len(B))])[np.isfinite(B).all(axis=1)]
    moments = z.T @ z / max(len(z), 1)
    blocks = [[3 * i, 3 * i + 1, 3 * i + 2, 9 + i] for i in range(3)]
    spread = sum(float((calibration.covariance[np.ix_(at, at)] * moments).sum()) for at in blocks) / 3.0
    return float(np.sqrt(white_nT**2 + calibration.sigma_nT**2 + spread))


def consistency(done: Run) -> tuple[dict[str, float], float, tuple[str, ...]]:
    """Mean squared innovations by sensor, how far those of the field repeat, and what is wrong with them."""
    nis, reasons = {}, []
    for k, sensor in enumerate(SENSORS):
        seen = np.isfinite(done.nis[:, k])
        if not seen.any():
            continue
        out = done.inflated[seen, k] == 1.0
        nis[sensor] = float(done.nis[seen, k][~out].mean()) if not out.all() else float("inf")
        if out.mean() > _MOST_OUTLIERS:
            reasons.append(say("attitude.outliers", share=100 * out.mean(), sensor=sensor))
        low, high = _CONSISTENT
        if not low - 4.0 / np.sqrt(seen.sum()) < nis[sensor] < high + 4.0 / np.sqrt(seen.sum()):
            reasons.append(say("attitude.innovations", sensor=sensor, nis=nis[sensor]))
    v = done.innovation
    pair = np.isfinite(v[1:]).all(axis=1) & np.isfinite(v[:-1]).all(axis=1)
    r = np.clip(v, -5.0, 5.0)  # one outlier must not decide
    lag_correlation = float((r[1:] * r[:-1])[pair].sum() / max((r[1:][pair] ** 2).sum(), 1e-300))
    if abs(lag_correlation) > _REPEATS + 4.0 / np.sqrt(max(int(pair.sum()), 1)):
        reasons.append(say("attitude.repeats", correlation=lag_correlation))
    return nis, lag_correlation, tuple(reasons)
