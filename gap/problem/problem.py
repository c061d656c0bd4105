"""The problem a diagnosis works on: telemetry, the noise-free chain that predicts it, and what is re-estimated.

Everything is at the rows that have time, position and reading; body axes, nT. Rows without a reference attitude have
a pseudo attitude that fits the reading, and axes of their own in which they are compared (`without_attitude`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.gap.problem import row_axes
from fluxtwin.gap.problem.row_axes import RowAxes, turn_images
from fluxtwin.sim.attitude.recorded_motion import RecordedAttitudes, RecordedMotion
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.late import stretches
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.earth.references import triad
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active, Chain, jacobians
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns

DEFAULT_MODELLED = ("bias", "scale_misalignment")
CALIBRATION = (*DEFAULT_MODELLED, "torquer_coupling")
"""Effects that S, b and T of a magnetometer say whole."""


class Roll(NamedTuple):
    """An error of the reference attitude that is larger about one axis, as a star tracker's is about its boresight."""

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """A unit vector in body axes."""
    factor: float = 1.0
    """The error about it over that about each axis across it."""

    @property
    def turns(self) -> FloatArray:
        """(3, 3) that makes it of an error that is alike about all axes, with the same rms over the axes."""
        about = np.outer(self.axis, self.axis)
        return np.asarray((np.eye(3) + (self.factor - 1.0) * about) * np.sqrt(3.0 / (2.0 + self.factor**2)))


ALIKE = Roll()
"""About all axes."""


@dataclass(frozen=True)
class Budget:
    """The declared noise, and how far it is trusted. None where nothing was declared."""

    noise_nT: float | None = None
    """White noise of a reading, 1 sigma per axis; trusted to 10 %."""
    lsb_nT: float | None = None
    attitude_sigma_rad: float | None = None
    """Error of the reference attitude, 1 sigma per axis; trusted to a factor 1.5."""
    attitude_tau_s: float | None = None
    """Its time constant; unknown by default, white included."""
    attitude_roll: Roll | None = None
    """Unknown by default."""
    sources: Mapping[str, str] | None = None
    """Where each comes from, in words."""


@dataclass(frozen=True)
class Problem:
    """What is to be explained, N rows."""

    telemetry: Telemetry
    """The rows used."""
    chain: Chain
    """Noise-free prediction at those rows; `chain.setting` is the design."""
    frozen: tuple[Active, ...]
    """Effects that are applied as they are (from a scenario)."""
    modelled: tuple[SignalEffect, ...]
    """Effects whose parameters are re-estimated as nuisance in every test."""
    budget: Budget
    modelled_theta: tuple[FloatArray, ...] = ()
    """Parameters of the modelled effects about which everything is linear; empty: zero. See `refit.settled`."""
    axes: RowAxes | None = None
    """Where rows have no reference attitude: the axes in which each row is compared. None: all rows have one."""
    attitude_found_rad: float | None = None
    """Error of the reference attitude as found in the data, where none was declared."""
    ruled_out: Mapping[str, str] = field(default_factory=dict)
    """Names of effects that another measurement has ruled out: why."""

    @cached_property
    def modelled_active(self) -> tuple[Active, ...]:
        """The modelled effects with the parameters about which everything is linear."""
        if self.modelled_theta:
            return tuple(zip(self.modelled, self.modelled_theta, strict=True))
        return tuple((effect, np.zeros(len(effect.parameters))) for effect in self.modelled)

    @property
    def free_attitude_error(self) -> bool:
        """Whether nothing bounds the error of the reference attitude but these data."""
        return self.budget.attitude_sigma_rad is None and bool(self.noise_image_nT.any())

    @property
    def setting(self) -> Setting:
        return self.chain.setting

    @cached_property
    def design(self) -> Chain:
        """The chain along the smoothed attitude track, for images of causes (Jacobians, blocks).

        An image made with the recorded attitudes repeats their errors, which are in the residual too: the two would
        correlate, and noise look like a cause.
        """
        motion = self.setting.motion
        if not isinstance(motion, RecordedMotion) or self.setting.direction != "predict":
            return self.chain
        return Chain(replace(self.setting, motion=motion.along_track()))

    @property
    def time(self) -> TimeArray:
        """(N,) UTC."""
        return self.setting.time

    @property
    def rows(self) -> int:
        return int(self.time.size)

    @cached_property
    def residual_nT(self) -> FloatArray:
        """(N, 3) reading less prediction with the frozen and the modelled effects."""
        return self.residual_of(self.modelled_active)

    def reading_nT(self, active: Sequence[Active]) -> FloatArray:
        """(N, 3) noise-free, with these effects on beside the frozen ones."""
        return self.chain.reading_nT([*self.frozen, *active])

    def residual_of(self, active: Sequence[Active]) -> FloatArray:
        """(N, 3) reading less prediction with these effects on beside the frozen ones; without attitude, what no turn of the
        body explains."""
        signal = self.chain.signal([*self.frozen, *active])
        residual = np.asarray(self.telemetry.mag_B_nT - signal.reading)
        if np.any(signal.sample_offset_s) and isinstance(self.setting.motion, RecordedMotion):
            # A row sampled where nobody knows the attitude has no say.
            residual = np.where(self.setting.motion.reaches(signal.sample_offset_s)[:, None], residual, 0.0)
        residual = self._unshortened(residual, signal.field_B_nT)
        return residual if self.axes is None else self.axes.without_turn(residual, signal.field_B_nT)

    def _unshortened(self, residual_nT: FloatArray, field_B_nT: FloatArray) -> FloatArray:
        """The residual (N, 3) as if an attitude error theta gave theta x B alone.

        A turn also shortens the component along the field by half of theta squared: 9 nT at 1 deg, always of one sign.
        What the residual across the field says of theta is believed as far as five times the declared error, or the one
        found.
        """
        sigma_rad = self.budget.attitude_sigma_rad or self.attitude_found_rad
        if not sigma_rad:
            return residual_nT
        size_nT = np.linalg.norm(field_B_nT, axis=1)
        along = field_B_nT / np.maximum(size_nT, 1e-9)[:, None]
        across = residual_nT - np.einsum("nc,nc->n", residual_nT, along)[:, None] * along
        turn_rad = np.linalg.norm(across, axis=1) / np.maximum(size_nT, 1e-9)
        turn_rad = np.where(turn_rad < 5.0 * sigma_rad, turn_rad, 0.0)
        return np.asarray(residual_nT + (0.5 * turn_rad**2 * size_nT)[:, None] * along)

    def in_row_axes(self, columns: FloatArray) -> FloatArray:
        """(N, 3) or (N, 3, P) columns in body axes, as they are compared: in the rows' own axes, zero where unmeasured."""
        return columns if self.axes is None else self.axes.in_row_axes(columns)

    @cached_property
    def measured(self) -> BoolArray:
        """(N, 3) components that are compared."""
        return np.ones((self.rows, 3), dtype=np.bool_) if self.axes is None else self.axes.measured

    @cached_property
    def noise_field_nT(self) -> FloatArray:
        """(N, 3) field that an attitude error acts on, in the rows' own axes: what the whitening works with."""
        return self.field_B_nT if self.axes is None else self.axes.noise_field_nT(self.field_B_nT)

    @cached_property
    def sensor_image(self) -> FloatArray:
        """(3, 3) (I + S)^-1: how a change of the field reaches the reading (equation 1)."""
        return np.asarray(np.linalg.inv(self.sensor_matrix(self.modelled_active)), dtype=np.float64)

    def sensor_matrix(self, active: Sequence[Active]) -> FloatArray:
        """(3, 3) I + S with these effects on."""
        S = [theta.reshape(3, 3) for effect, theta in active if effect.name == "scale_misalignment"]
        return np.asarray(np.eye(3) + self.setting.instrument.S + sum(S, np.zeros((3, 3))))

    @cached_property
    def noise_image_nT(self) -> FloatArray:
        """(N, 3, 3) what a turn of a radian does to a row, in the row's own axes: what the whitening works with."""
        images = turn_images(self.noise_field_nT)
        known = np.ones(self.rows, dtype=np.bool_) if self.axes is None else self.axes.known
        images[known] = self.sensor_image @ images[known]
        return images

    @cached_property
    def field_B_nT(self) -> FloatArray:
        """(N, 3) predicted ambient field in reported body axes: what an attitude error theta acts on, theta x B."""
        return self.chain.signal([*self.frozen, *self.modelled_active]).field_B_nT

    @cached_property
    def nuisance(self) -> FloatArray:
        """(N, 3, C) Jacobian of all modelled effects; C may be 0."""
        return self.derivatives(self.modelled_active)

    def derivatives(self, active: Sequence[Active]) -> FloatArray:
        """(N, 3, sum of parameters) derivative of the reading by the parameters of effects, in that order, all of them and
        the frozen effects switched on."""
        return jacobians(self.design, active, self.frozen)

    @cached_property
    def segment(self) -> FloatArray:
        """(N,) number of the stretch without gaps, and, of rows without attitude, with the same sensor."""
        number = stretches(self.setting.seconds)
        if self.axes is not None and self.axes.with_nadir.any():
            number[1:] += np.cumsum(_another_sensor(self.axes))
        return number.astype(np.float64)


def pose(
    telemetry: Telemetry,
    model: FieldModel,
    *,
    modelled: Sequence[str] = DEFAULT_MODELLED,
    budget: Budget | None = None,
    instrument: Magnetometer | None = None,
    frozen: Sequence[Active] = (),
    denser: Telemetry | None = None,
) -> Problem:
    """Pose the problem for a record.

    modelled: names of effects to re-estimate. instrument: starting S, b, T (default: none). frozen: effects that the
    scenario has. denser: the record that the telemetry is thinned from. Rows without reference attitude are used too:
    linear about the reading as the instrument has it until `refit.settled`. Raises BadInput for unknown names and absent
    columns, OutOfRange for rows outside the field model, NoAnswer when no row is complete.
    """
    effects = []
    for name in modelled:
        effect = find_effect(name, where="--modelled")
        if not isinstance(effect, SignalEffect):
            raise BadInput(f"{name} has no parameters to re-estimate", where="--modelled", wanted="a signal effect")
        effects.append(effect)
    used = _usable(telemetry)
    model.pieces(used.time)
    model = model.lasting(np.timedelta64(1, "D"))  # so far beyond its ends a clock error may lead a trial
    assert used.r_N_km is not None
    r, v, known = np.array(used.r_N_km), _velocity(used), used.has_attitude
    q = np.tile([0.0, 0.0, 0.0, 1.0], (known.size, 1)) if used.q_NB is None else np.array(used.q_NB)
    q[~known] = [0.0, 0.0, 0.0, 1.0]
    motion = RecordedMotion(used.time, r, v, frames.rotation_from_q(q), used.rate_B_rad_s, denser=_attitudes(denser))
    plain = Magnetometer(np.zeros((3, 3)), np.zeros(3)) if instrument is None else instrument
    setting = Setting(used.time, motion, "predict", model, plain, recorded_columns(used))
    for effect in effects:
        why = None if effect.keyed_by is None else effect.untestable(setting)
        if why is not None:
            raise BadInput(f"{effect.name}: {why}", where="--modelled", wanted="the name of a column that changes")
    budget = budget or Budget()
    axes = None
    if not known.all():
        setting, axes = _with_pseudo_attitude(setting, used, known, budget)
    return Problem(used, Chain(setting), tuple(frozen), tuple(effects), budget, axes=axes)


def calibrated(problem: Problem, modelled: Sequence[Active]) -> Problem:
    """The problem with what was re-estimated of S, b and T in its magnetometer, and nothing left to correct there.

    The effects of a sensor act through its matrix: their parameters are those of the corrected one.
    """
    instrument = corrected(problem.setting.instrument, modelled)
    chain = Chain(replace(problem.setting, instrument=instrument))
    kept = tuple(np.zeros_like(theta) if effect.name in CALIBRATION else theta for effect, theta in modelled)
    return replace(problem, chain=chain, modelled_theta=kept)


def corrected(old: Magnetometer, modelled: Sequence[Active]) -> Magnetometer:
    """S, b, T with the re-estimated corrections: bias and scale add to b and S exactly, a coupling C is -T."""
    found = {effect.name: theta for effect, theta in modelled}
    S, b, T = np.array(old.S), np.array(old.b_nT), old.T_nT_per_Am2
    if "scale_misalignment" in found:
        S = S + found["scale_misalignment"].reshape(3, 3)
    if "bias" in found:
        b = b + found["bias"]
    if "torquer_coupling" in found:
        T = (np.zeros((3, 3)) if T is None else np.array(T)) - found["torquer_coupling"].reshape(3, 3)
    return replace(old, S=S, b_nT=b, T_nT_per_Am2=T)


def realigned(problem: Problem, beside: Sequence[Active] | None = None) -> Problem:
    """The problem with pseudo attitudes that fit the reading as it is calibrated now; itself where all are known.

    beside: all that is on beside the frozen effects, default the modelled ones as they stand.
    """
    if problem.axes is None:
        return problem
    active = [*problem.frozen, *(problem.modelled_active if beside is None else beside)]
    signal, setting, axes = problem.chain.signal(active), problem.setting, problem.axes
    residual = np.asarray(problem.telemetry.mag_B_nT - signal.reading)
    turn = Rotation.from_rotvec(axes.fitting_turn(residual, signal.field_B_nT))
    motion = replace(_motion(setting), R_BN=turn * setting.given[2])
    chain = Chain(replace(setting, motion=motion))
    field = chain.signal(active).field_B_nT
    fresh = row_axes.row_axes(axes.known, field, axes.nadir_B, problem.sensor_matrix(active), axes.nadir_error)
    return replace(problem, chain=chain, axes=fresh)


def _with_pseudo_attitude(
    setting: Setting, used: Telemetry, known: BoolArray, budget: Budget
) -> tuple[Setting, RowAxes]:
    """The setting with an attitude in every row, and the axes in which the rows are compared."""
    r_N_km, _, R_BN = setting.given
    field_N = field_N_nT(setting.model, setting.time, r_N_km, setting.R_EN)
    field_B = row_axes.calibrated(np.array(used.mag_B_nT), setting.instrument, used.dipole_B_Am2)
    nadir_N = -r_N_km / np.linalg.norm(r_N_km, axis=1)[:, None]
    nadir_B, ratio = row_axes.usable_nadir(used.nadir_B, known, R_BN, nadir_N, field_N, budget.attitude_sigma_rad)
    q = row_axes.pseudo_attitude(R_BN, known, field_N, field_B)
    if (to := np.any(nadir_B != 0.0, axis=1)).any():  # nadir exactly, and the field in its plane
        q[to] = (triad(nadir_B[to], field_B[to]).inv() * triad(nadir_N[to], field_N[to])).as_quat()
    R_BN = Rotation.from_quat(q)
    motion = replace(_motion(setting), R_BN=R_BN, attitude_known=known)
    filled = replace(setting, motion=motion, field_N_nT=field_N, attitude_known=known)
    matrix = np.eye(3) + setting.instrument.S
    return filled, row_axes.row_axes(known, R_BN.apply(field_N), nadir_B, matrix, ratio)


def _attitudes(telemetry: Telemetry | None) -> RecordedAttitudes | None:
    """What a record has of them."""
    if telemetry is None or telemetry.q_NB is None or not telemetry.has_attitude.any():
        return None
    known = telemetry.select(telemetry.has_attitude)
    assert known.q_NB is not None
    return RecordedAttitudes(known.time, frames.rotation_from_q(np.array(known.q_NB)), known.rate_B_rad_s)


def _motion(setting: Setting) -> RecordedMotion:
    assert isinstance(setting.motion, RecordedMotion)
    return setting.motion


def _another_sensor(axes: RowAxes) -> BoolArray:
    """(N - 1,) where the row after is compared by the attitude and the last one with a say was by nadir, or the reverse."""
    says = np.where(axes.known, 1, np.where(axes.with_nadir, 2, 0))
    latest = np.maximum.accumulate(np.where(says > 0, np.arange(says.size), 0))
    held = says[latest]
    return np.asarray((held[1:] != held[:-1]) & (held[:-1] > 0), dtype=np.bool_)


def _usable(telemetry: Telemetry) -> Telemetry:
    if telemetry.r_N_km is None:
        raise BadInput("the telemetry has no position", where="r_x_km r_y_km r_z_km", wanted="positions, or --tle FILE")
    needs = {"no reading": telemetry.has_reading, "no position": telemetry.has_position}
    usable, left_out = np.ones(len(telemetry), dtype=bool), {}
    for reason, present in needs.items():
        count = int((usable & ~present).sum())
        if count:
            left_out[reason] = count
        usable &= present
    if not usable.any():
        raise NoAnswer("no row has reading and position", evidence={"left_out": left_out})
    if not telemetry.mag_B_nT[usable].any():
        zero = "the magnetometer reads zero throughout: nothing can be diagnosed"
        raise NoAnswer(zero, evidence={"left_out": left_out})
    return telemetry.select(usable)


def _velocity(telemetry: Telemetry) -> FloatArray:
    """(N, 3) recorded velocity, or the slope of the positions where it is missing."""
    assert telemetry.r_N_km is not None
    r = np.array(telemetry.r_N_km)
    if len(r) < 2:
        raise NoAnswer("one row alone has no velocity and no time series", evidence={"rows": len(r)})
    slope = np.gradient(r, epoch.seconds_since(telemetry.time, telemetry.time[0]), axis=0)
    if telemetry.v_N_km_s is None:
        return np.asarray(slope)
    known = np.asarray(np.isfinite(telemetry.v_N_km_s).all(axis=1))
    return np.where(known[:, None], telemetry.v_N_km_s, slope)
