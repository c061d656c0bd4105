"""A watch over rows as they come: an alarm that is valid whenever one looks at it.

The first rows give the noise (as in a diagnosis) and, without a calibration, S and b with their covariance. From then on a
Kalman filter with the attitude error and the calibration's own error in its state predicts every row. Each change that is
looked for is a density of the next innovation; its ratio to that of no change is an e-value e, whose mean is at most 1 as
long as nothing changes, and the evidence is Shiryaev and Roberts' sum over all moments at which the change may have begun:

    R_t = (1 + R_t-1) e_t,     alarm where the weighted mean of R over the changes reaches 1 / alpha.

The mean run to a false alarm is then at least 1 / alpha rows (Shin, Ramdas & Rinaldo 2023, E-detectors: a nonparametric
framework for sequential change detection, New England J. Statistics in Data Science; R_t - t is a supermartingale). The
mean of e stays below 1 for every noise that is sub-Gaussian with at most the variance of the model, rounding included, for
noise that is less than stated, and where e is cut off from above, so that no single wild reading rings.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from fluxtwin.calib.common.apply import require_applicable
from fluxtwin.calib.common.conventions import of_S
from fluxtwin.calib.common.onboard import for_record
from fluxtwin.calib.common.records import Calibration
from fluxtwin.gap.noise.choice import choose_noise
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA
from fluxtwin.gap.noise.whitening import NoiseModel
from fluxtwin.gap.problem.problem import Budget, pose
from fluxtwin.gap.problem.row_axes import start_without_attitude, turn_images
from fluxtwin.gap.selection.refit import settled
from fluxtwin.sim.base.errors import BadInput, NoAnswer, amount
from fluxtwin.sim.base.types import BoolArray, FloatArray, IntArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns

RUN = 1e6
"""Mean run to a false alarm [rows], at least."""
FIRST_ROWS, FIRST_S = 600, 6000.0
"""To begin with: rows that give sigma to 2 %, and an orbit, in which the field turns through all that S and b act on."""
SIZES = 2.0 ** np.arange(-2, 4)
"""Changes of the mean [sigma of the white noise]. In steps of two the next one keeps five sixths of the information of any
size between: 2 r - r**2 at r = sqrt(2)."""
GROWTH = np.array([np.sqrt(2.0), 2.0, 4.0])
"""Of the noise: variances of two, four, sixteen times as much."""
_AXES = np.vstack([np.ones(3), np.eye(3)])
DIRECTIONS = np.vstack(
    [np.eye(4), np.array([[1, 1, 1, 0], [1, 1, -1, 0], [1, -1, 1, 0], [-1, 1, 1, 0]]) / np.sqrt(3.0)]
)
"""Of the change: a bias along an axis or a diagonal, and along the field in proportion to it."""
_USUAL_nT = 5e4
"""A field by which errors of S count in nT."""
_SURE = 2.0
"""The noise is taken for as much as the first rows allow: standard deviations of the logarithms."""


class Changed(NamedTuple):
    """What rang the alarm."""

    time: np.datetime64
    """Of the row that rang, UTC."""
    since: np.datetime64
    """Where the evidence for it began, UTC."""
    rows: int
    """Rows that were watched until then."""
    what: str
    """The change that has most of the evidence, in words."""


def _prior() -> FloatArray:
    """A third each to a bias, a scale along the field and noise that grows."""
    of_mean = [1.0 / (len(DIRECTIONS) - 1)] * len(DIRECTIONS)
    of_mean[3] = 1.0
    weights = np.concatenate([np.repeat(of_mean, 2 * SIZES.size), np.ones(len(_AXES) * GROWTH.size)])
    weights[-len(_AXES) * GROWTH.size :] *= 2.0 * SIZES.size / (len(_AXES) * GROWTH.size)
    return np.asarray(weights / weights.sum())


_PRIOR = _prior()


@dataclass(eq=False)
class Watch:
    """The state of a watch: rows go in, and the first change comes out. Made by `begin`."""

    model: FieldModel
    noise: NoiseModel
    """The most that the first rows allow."""
    found: NoiseModel
    """The likeliest there."""
    by_size: bool
    """Rows are taken by the size of the field alone: nothing bounds the attitude error, or it is large."""
    calibration: Calibration
    """As applied to the readings; its error is part of the state."""
    covariance: FloatArray
    """(n, n) of the state: the attitude error in units of its own, the parameters with S in nT at the usual field."""
    state: FloatArray = field(init=False)
    back: FloatArray = field(init=False)
    """(3, 4) from field to reading, without torquers."""
    settled: FloatArray = field(default_factory=lambda: np.zeros((3, 4)))
    evidence: FloatArray = field(default_factory=lambda: np.zeros(_PRIOR.size))
    excursion: FloatArray = field(default_factory=lambda: np.zeros(_PRIOR.size))
    since: IntArray = field(default_factory=lambda: np.zeros(_PRIOR.size, dtype=np.int64))
    wild: BoolArray = field(default_factory=lambda: np.zeros(1, dtype=np.bool_))
    """(1,) whether the last row was beyond six sigma."""
    last: np.datetime64 | None = None
    """Time of the last row."""
    rows: int = 0
    """That were watched, with those passed over because they repeat the rounding of others."""
    innovations: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """(N, 3) of the rows that were taken last, of unit variance; zero where a component was not there."""

    def __post_init__(self) -> None:
        self.state = np.zeros(len(self.covariance))
        matrix = np.linalg.inv(np.eye(3) + self.calibration.S)
        self.back = np.column_stack([matrix, -matrix @ self.calibration.b_nT])

    @property
    def level(self) -> float:
        """The evidence for any change; at `RUN` it rings."""
        return float(_PRIOR @ self.evidence)

    def take(self, telemetry: Telemetry, tested: BoolArray | None = None) -> Changed | None:
        """Take rows; those that are not later than all before are left out. What has changed, where the evidence rings.

        tested: (N,) which rows are compared with the field; the others only count. None: all.
        """
        return self.run(telemetry, armed=True, by_size=self.by_size, tested=tested)

    def run(
        self, telemetry: Telemetry, *, armed: bool, by_size: bool, tested: BoolArray | None = None
    ) -> Changed | None:
        """As `take`; not armed: to learn what the calibration is."""
        from fluxtwin.gap import watch_kernels

        corrected = self.calibration.apply(telemetry.mag_B_nT, telemetry.dipole_B_Am2, recorded_columns(telemetry))
        # One missing dipole would void all that follows.
        usable = np.isfinite(corrected).all(axis=1) & telemetry.has_position
        if self.last is not None:
            usable = usable & (telemetry.time > self.last)
        self.innovations = np.zeros((0, 3))
        compared = np.flatnonzero(usable if tested is None else usable & tested)
        count = np.cumsum(usable)
        if not compared.size:
            self.rows += int(count[-1]) if armed and count.size else 0
            return None
        used = telemetry if compared.size == len(telemetry) else telemetry.select(compared)
        rows = self._measured(used, corrected[compared], by_size)
        before = used.time[:1] if self.last is None else np.array([self.last])
        steps_s = np.diff(np.concatenate([before, used.time])) / np.timedelta64(1, "s")
        decay = np.exp(-steps_s / self.noise.tau_s) if self.noise.tau_s > 0 else np.zeros(len(used))
        self.innovations = np.empty((len(used), 3))
        changes = (DIRECTIONS, SIZES, _AXES, GROWTH, _PRIOR)
        carried = (self.state, self.covariance, self.settled, self.evidence, self.excursion, self.since, self.wild)
        # No two rows ring, whatever they read, and a single one beyond six sigma is no change.
        limits = (CUT_SIGMA, np.log(30.0), np.log(2.0), RUN)
        stamps = used.time.astype(np.int64)
        kernel: Any = watch_kernels.run_rows
        rang: int = kernel(
            *rows, decay, self.back, _USUAL_nT, *changes, *carried, stamps, armed, *limits, self.innovations
        )
        self.last = used.time[-1]
        self.rows += int(count[-1 if rang < 0 else compared[rang]]) if armed else 0
        return None if rang < 0 else self._changed(used.time[rang])

    def _measured(self, used: Telemetry, reading: FloatArray, by_size: bool) -> tuple[Any, ...]:
        """What the filter takes of rows, the reading (N, 3) corrected: y, load, white, present, faults, field; as in
        `watch_kernels.run_rows`."""
        raw, field_N = used.mag_B_nT, field_N_nT(self.model, used.time, np.asarray(used.r_N_km))
        dipole = used.dipole_B_Am2
        size, rows, n = np.linalg.norm(field_N, axis=1), len(used), len(self.state)
        matrix, sigma = np.eye(3) + self.calibration.S, self.noise.white_nT
        load, white, faults = np.zeros((rows, 3, n)), np.empty((rows, 3, 3)), np.empty((rows, 3, 4))
        white[:], faults[:, :, :3] = matrix * sigma, -matrix * sigma
        faults[:, :, 3] = -reading * (self.noise.sigma_nT / _USUAL_nT)
        y, field_B, present = np.zeros((rows, 3)), np.zeros((rows, 3)), np.ones((rows, 3), dtype=np.bool_)
        whole = np.asarray(used.has_attitude) & (not by_size)
        if whole.any():
            field_B[whole] = frames.rotation_from_q(np.asarray(used.q_NB)[whole]).apply(field_N[whole])
            y[whole] = field_B[whole] - reading[whole]
            load[whole, :, :3] = turn_images(field_B[whole]) * self.noise.theta_rad
        length = np.linalg.norm(reading, axis=1)
        along = reading / np.maximum(length, 1e-9)[:, None]
        # The size of the field in place of that of the reading, whose noise is that of y.
        raw = np.where(whole[:, None], raw, (along * size[:, None]) @ self.back[:, :3].T + self.back[:, 3])
        images = [of_S(raw / _USUAL_nT)]
        images.append(np.broadcast_to(np.eye(3), (rows, 3, 3)))
        if n > 15 and dipole is not None:
            images.append(of_S(np.nan_to_num(dipole)))
        image = np.concatenate(images, axis=2)
        load[:, :, 3 : 3 + image.shape[2]] = image
        if (one := ~whole).any():
            for columns in (load, white, faults):
                columns[one, :1] = along[one, None, :] @ columns[one]
            y[one, 0] = size[one] - length[one]
            present[one, 1:] = False
        return y, load, np.square(white), present, faults, field_B

    def _changed(self, time: np.datetime64) -> Changed:
        most = int(np.argmax(np.log(_PRIOR) + self.excursion))
        since = np.datetime64(int(self.since[most]), "ns")
        return Changed(time, since, self.rows, self._words(most))

    def _words(self, place: int) -> str:
        """Without a size: that of the change which rings first says little, and the diagnosis measures it."""
        of_mean = 2 * len(DIRECTIONS) * SIZES.size
        if place >= of_mean:
            axis = (place - of_mean) // GROWTH.size
            return f"the noise of {('axis ' + 'xyz'[axis - 1]) if axis else 'the readings'} has grown"
        direction, rest = divmod(place, 2 * SIZES.size)
        sign = 1.0 if rest % 2 else -1.0
        if direction == 3:
            return f"the readings are too {'large' if sign > 0 else 'small'} in proportion to the field"
        along = sign * DIRECTIONS[direction][:3]
        axes = " ".join(f"{'+' if a > 0 else '-'}{name}" for name, a in zip("xyz", along, strict=True) if a)
        return f"a bias of the readings towards {axes}"


def enough(first: Telemetry) -> bool:
    """Whether these rows do to begin with."""
    usable = int((first.has_reading & first.has_position).sum())
    return usable >= FIRST_ROWS and first.time[-1] - first.time[0] >= np.timedelta64(int(FIRST_S), "s")


def begin(
    first: Telemetry, model: FieldModel, budget: Budget | None = None, calibration: Calibration | None = None
) -> Watch:
    """A watch that knows the noise of the first rows; without a calibration also S and b.

    budget: what is declared of the noise, as for a diagnosis. calibration: to be watched from the first row on; its
    covariance says how well it is known. Raises BadInput and NoAnswer as a diagnosis does.
    """
    budget = budget or Budget()
    if not enough(first):
        raise NoAnswer(
            f"the record ends after {amount(len(first), 'row|rows')}: to watch for a change, at least {FIRST_ROWS} with "
            f"reading and position over {FIRST_S:.0f} s are needed first, to estimate the noise",
            evidence={"rows": len(first), "needed": FIRST_ROWS},
        )
    corrected = first
    if calibration is not None:
        late = [name for name, bias in calibration.telemetry_bias.items() if bias.delay_s or bias.lag_s]
        if late:
            raise BadInput(
                f"its field that follows {', '.join(late)} is delayed and needs earlier rows, but rows are taken one by one",
                where="--calibration",
                wanted="a calibration without delayed fields, or a diagnosis without --follow",
            )
        # How long ago it was made is no matter: whether it still holds is the question.
        calibration = for_record(replace(calibration, span=None), first)
        require_applicable(first, calibration)
        field_nT = calibration.apply(first.mag_B_nT, first.dipole_B_Am2, recorded_columns(first))
        corrected = first.replace(mag_B_nT=field_nT)
    blind = not first.has_attitude.any()
    start = start_without_attitude(corrected, model) if blind else None
    thinned = corrected.select(slice(None, None, -(-len(first) // 2_000)))  # sigma is then known to a hundredth
    problem = settled(pose(thinned, model, budget=budget, instrument=start))
    found, _ = choose_noise(problem)
    sure = _at_most(found)
    shortened_nT = sure.theta_rad**2 * float(np.median(np.linalg.norm(problem.field_B_nT, axis=1)))
    # Where attitude errors shorten the component along the field by half of that, theta x B is not all that they do.
    by_size = problem.free_attitude_error or blind or shortened_nT > 0.1 * sure.sigma_nT
    if calibration is not None:
        scale = np.concatenate([np.full(9, _USUAL_nT), np.ones(len(calibration.values) - 9)])
        known = calibration.covariance * np.outer(scale, scale)
        return Watch(model, sure, found, by_size, calibration, block_diag(np.eye(3), known))
    instrument = problem.setting.instrument
    watch = Watch(
        model,
        sure,
        found,
        by_size,
        Calibration(instrument.S, instrument.b_nT),
        block_diag(np.eye(3), np.eye(12) * 1e5**2),  # nothing is known of S and b before the first rows
    )
    watch.run(first, armed=False, by_size=blind)
    return watch


def _at_most(found: NoiseModel) -> NoiseModel:
    """The most noise that the first rows allow: of the attitude error more at every frequency, 2 theta**2 tau where it is
    slow and theta**2 / tau where it is fast, as what is below the model in its spectrum is below it in its covariance."""
    slower = float(np.exp(_SURE * found.tau_log_sd)) if found.tau_s > 0 else 1.0
    return replace(
        found,
        sigma_nT=found.sigma_nT * float(np.exp(_SURE * found.sigma_log_sd)),
        theta_rad=found.theta_rad * float(np.exp(_SURE * found.theta_log_sd) * np.sqrt(slower)),
        tau_s=found.tau_s * slower,
    )
