"""The problem a diagnosis works on: telemetry, the noise-free chain that predicts it, and what is re-estimated.

Everything is at the rows that have time, position, attitude and reading; body axes, nT.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fluxtwin.sim import epoch, frames
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active, Chain, jacobian
from fluxtwin.sim.errors import BadInput, NoAnswer
from fluxtwin.sim.field_models import FieldModel
from fluxtwin.sim.motion import RecordedMotion
from fluxtwin.sim.sensors.magnetometer import Magnetometer
from fluxtwin.sim.signal import Setting
from fluxtwin.sim.telemetry import Telemetry, recorded_columns
from fluxtwin.sim.types import FloatArray, TimeArray

DEFAULT_MODELLED = ("bias", "scale_misalignment")
_GAP_FACTOR = 5.0


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
    left_out: Mapping[str, int]
    """Rows not used, by reason."""
    modelled_theta: tuple[FloatArray, ...] = ()
    """Parameters of the modelled effects about which everything is linear; empty: zero. See `refit.settled`."""

    @cached_property
    def modelled_active(self) -> tuple[Active, ...]:
        """The modelled effects with the parameters about which everything is linear."""
        if self.modelled_theta:
            return tuple(zip(self.modelled, self.modelled_theta, strict=True))
        return tuple((effect, np.zeros(len(effect.parameters))) for effect in self.modelled)

    @property
    def setting(self) -> Setting:
        return self.chain.setting

    @property
    def time(self) -> TimeArray:
        """(N,) UTC."""
        return self.setting.time

    @property
    def rows(self) -> int:
        return int(self.time.size)

    @cached_property
    def predicted_nT(self) -> FloatArray:
        """(N, 3) noise-free reading of the baseline with the frozen and the modelled effects."""
        return self.chain.reading_nT([*self.frozen, *self.modelled_active])

    @cached_property
    def residual_nT(self) -> FloatArray:
        """(N, 3) reading less prediction."""
        return np.asarray(self.telemetry.mag_B_nT - self.predicted_nT)

    @cached_property
    def field_B_nT(self) -> FloatArray:
        """(N, 3) predicted ambient field in reported body axes: what an attitude error theta acts on, theta x B."""
        return self.chain.signal([*self.frozen, *self.modelled_active]).field_B_nT

    @cached_property
    def nuisance(self) -> FloatArray:
        """(N, 3, C) Jacobian of all modelled effects; C may be 0."""
        blocks = []
        for number, (_, theta) in enumerate(self.modelled_active):
            others = [*self.frozen, *self.modelled_active[:number], *self.modelled_active[number + 1 :]]
            blocks.append(jacobian(self.chain, self.modelled[number], at=others, theta=theta))
        return np.concatenate(blocks, axis=2) if blocks else np.zeros((self.rows, 3, 0))

    @cached_property
    def segment(self) -> FloatArray:
        """(N,) number of the stretch without gaps, from 0: a gap is five times the usual spacing."""
        steps = np.diff(self.setting.seconds)
        usual = float(np.median(steps)) if steps.size else 1.0
        return np.concatenate([[0.0], np.cumsum(steps > _GAP_FACTOR * usual)])


def pose(
    telemetry: Telemetry,
    model: FieldModel,
    *,
    modelled: Sequence[str] = DEFAULT_MODELLED,
    budget: Budget | None = None,
    instrument: Magnetometer | None = None,
    frozen: Sequence[Active] = (),
) -> Problem:
    """Pose the problem for a record.

    modelled: names of effects to re-estimate. instrument: starting S, b, T (default: none). frozen: effects that the
    scenario has. Raises BadInput for unknown names and absent columns, NoAnswer when no row is complete.
    """
    effects = []
    for name in modelled:
        effect = find_effect(name, where="--modelled")
        if not isinstance(effect, SignalEffect):
            raise BadInput(f"{name} has no parameters to re-estimate", where="--modelled", wanted="a signal effect")
        effects.append(effect)
    used, left_out = _usable(telemetry)
    assert used.r_N_km is not None and used.q_NB is not None
    r, v = np.array(used.r_N_km), _velocity(used)
    motion = RecordedMotion(used.time, r, v, frames.rotation_from_q(np.array(used.q_NB)), used.rate_B_rad_s)
    plain = Magnetometer(np.zeros((3, 3)), np.zeros(3)) if instrument is None else instrument
    setting = Setting(used.time, motion, "predict", model, plain, recorded_columns(used))
    return Problem(used, Chain(setting), tuple(frozen), tuple(effects), budget or Budget(), left_out)


def _usable(telemetry: Telemetry) -> tuple[Telemetry, dict[str, int]]:
    if telemetry.r_N_km is None:
        raise BadInput("the telemetry has no position", where="r_x_km r_y_km r_z_km", wanted="positions, or --tle FILE")
    needs = {
        "no reading": telemetry.has_reading,
        "no position": telemetry.has_position,
        "no reference attitude": telemetry.has_attitude,
    }
    usable, left_out = np.ones(len(telemetry), dtype=bool), {}
    for reason, present in needs.items():
        count = int((usable & ~present).sum())
        if count:
            left_out[reason] = count
        usable &= present
    if not usable.any():
        raise NoAnswer("no row has reading, position and reference attitude", evidence={"left_out": left_out})
    return telemetry.select(usable), left_out


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
