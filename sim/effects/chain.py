"""The chain with effects in it: stage by stage, in nature's order.

`Chain` remembers the baseline's signal at every stage, and the last one it computed with effects, so an effect on
the sensor costs no field evaluation; of a record that is not long, also the signal after each effect of a stage.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import accumulate

import numpy as np

from fluxtwin.sim.base.processes import stop_if_asked
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.effects.base import STAGES, DistributionEffect, Effect, SignalEffect
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.effects.signal import Setting, Signal, start

Active = tuple[Effect, FloatArray]
"""An effect and its parameters."""

_Key = tuple[tuple[int, bytes], ...]
_Step = tuple[SignalEffect, FloatArray, tuple[int, bytes]]
_STEP_BY_STEP_ROWS = 20_000
"""Records of so many rows are remembered effect by effect: some tens of signals, half a megabyte each."""

_PLACE = {effect.name: number for number, effect in enumerate(CATALOGUE)}


class Chain:
    """The noise-free chain of one setting. Not frozen: it caches, but always gives the same answer."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self._latest: dict[int, tuple[_Key, Sequence[Active], Signal]] = {}
        self._steps: dict[int, list[tuple[_Key, Sequence[Active], Signal]]] = {}

    @cached_property
    def _baseline(self) -> dict[str, Signal]:
        signal, stages = start(self.setting), {}
        for stage in STAGES:
            signal = _enter(stage, signal)
            stages[stage] = signal
        return stages

    def reading_nT(self, active: Sequence[Active] = ()) -> FloatArray:
        """(N, 3) noise-free reading with these effects on; distribution effects are passed over."""
        return self.signal(active).reading

    def signal(self, active: Sequence[Active] = ()) -> Signal:
        """The signal at the end of the chain with these signal effects on, in any order."""
        wanted = in_order([pair for pair in active if isinstance(pair[0], SignalEffect) and _on(pair[1])])
        if not wanted:
            return self._baseline["telemetry"]
        stop_if_asked()
        here: list[list[_Step]] = [[] for _ in STAGES]
        for stage in {effect.stage for effect, _ in wanted}:
            steps = _applied(self.setting, wanted, stage, None)
            here[STAGES.index(stage)] = [(effect, theta, (id(effect), theta.tobytes())) for effect, theta in steps]
        first = next(number for number, steps in enumerate(here) if steps)
        keys = list(accumulate((tuple(step[2] for step in steps) for steps in here), operator.add))
        signal, begin = self._baseline[STAGES[first]], first
        for number in range(len(STAGES) - 1, first - 1, -1):
            # The signal after a stage depends on the effects up to that stage only.
            if number in self._latest and self._latest[number][0] == keys[number]:
                signal, begin = self._latest[number][2], number + 1
                break
        for number in range(begin, len(STAGES)):
            if number > first:
                signal = _enter(STAGES[number], signal)
            signal = self._folded(signal, wanted, number, here[number], keys[number - 1] if number else ())
            self._latest[number] = (keys[number], wanted, signal)  # the effects are kept: ids stay theirs
        return signal

    def _folded(
        self, signal: Signal, active: Sequence[Active], number: int, steps: Sequence[_Step], before: _Key
    ) -> Signal:
        """The effects of a stage, from the first on that is not as it was the last time; before: key of what is upstream."""
        brief = signal.rows <= _STEP_BY_STEP_ROWS
        known, made, key = self._steps.get(number, []), [], before
        for place, (effect, theta, own) in enumerate(steps):
            key = (*key, own)
            if place < len(known) and known[place][0] == key:
                signal = known[place][2]
            else:
                known, signal = [], effect.apply(signal, theta)
            if brief:
                made.append((key, active, signal))
        self._steps[number] = [*made, *known[len(made) :]]  # what comes after is as it was
        return signal

    def simulated(self, active: Sequence[Active], seed: int, noise_nT: FloatArray | None = None) -> Signal:
        """The signal with signal effects and one draw of the distribution effects; streams by effect name.

        noise_nT: (N, 3) noise of the sensor. Given, it is added once the signal effects of the sensor have acted;
        then come the draws of its distribution effects, clipping, full scale and rounding, a coarser rounding, and
        only then the telemetry.
        """
        signal = start(self.setting)
        for stage in STAGES:
            signal = _fold(_enter(stage, signal), active, stage, after_noise=False)
            if stage == "sensor":
                signal = dataclasses.replace(signal, ideal_B_nT=signal.reading)
                if noise_nT is not None:
                    signal = signal.with_reading(signal.reading + noise_nT)
            signal = _draw(signal, active, stage, seed, after_rounding=False)
            signal = _fold(signal, active, stage, after_noise=True)
            if stage == "sensor" and noise_nT is not None:
                signal = signal.with_reading(self.setting.instrument.digitise(signal.reading))
            signal = _draw(signal, active, stage, seed, after_rounding=True)
        return signal


def jacobian(
    chain: Chain, effect: SignalEffect, at: Sequence[Active] = (), theta: FloatArray | None = None
) -> FloatArray:
    """(N, 3, p) derivative of the noise-free reading by the effect's parameters, in units per parameter unit.

    Its images as the effects after it in the chain carry them on; where one of these does not say how, central differences
    of the whole chain with the default scale as step, one-sided where the range ends at zero. at: other effects that are on;
    theta: where to differentiate (default zero: absent).
    """
    theta = np.zeros(len(effect.parameters)) if theta is None else theta
    images = _carried(chain, effect, at, theta)
    if images is not None:
        return images

    def between(up: FloatArray, down: FloatArray) -> FloatArray:
        return chain.reading_nT([*at, (effect, up)]) - chain.reading_nT([*at, (effect, down)])

    return derivative(effect, theta, between)


def _carried(chain: Chain, effect: SignalEffect, at: Sequence[Active], theta: FloatArray) -> FloatArray | None:
    """`jacobian` along the chain; None where an effect does not say what becomes of small changes."""
    acting = [pair for pair in at if isinstance(pair[0], SignalEffect) and _on(pair[1])]
    images: FloatArray | None = None
    ordered = in_order([*acting, (effect, theta)])
    first = next(number for number, pair in enumerate(ordered) if pair[1] is theta)
    for number, (one, size) in enumerate(ordered[first:], first):
        assert isinstance(one, SignalEffect)
        signal = chain.signal(ordered[:number])
        images = one.images(signal, size) if images is None else one.carried(signal, size, images)
        if images is None:
            return None
    return images


def derivative(
    effect: Effect, theta: FloatArray, between: Callable[[FloatArray, FloatArray], FloatArray]
) -> FloatArray:
    """(N, k, p) derivative by the effect's parameters at theta (p,), by the differences of `jacobian`; between: what one set
    of parameters makes less what the other does, (N, k)."""
    columns = []
    for number, parameter in enumerate(effect.parameters):
        up, down = np.array(theta, dtype=np.float64), np.array(theta, dtype=np.float64)
        up[number] = min(up[number] + parameter.scale, parameter.high)
        down[number] = max(down[number] - parameter.scale, parameter.low)
        columns.append(between(up, down) / (up[number] - down[number]))
    return np.stack(columns, axis=-1)


def jacobians(chain: Chain, wanted: Sequence[Active], at: Sequence[Active] = ()) -> FloatArray:
    """(N, 3, P) `jacobian` by the parameters of each of `wanted`, side by side, with all the others of them on as well."""
    images: dict[int, FloatArray] = {}
    for effect, theta in in_order(wanted):  # so that the chain finds what comes before already computed
        assert isinstance(effect, SignalEffect)
        others = [pair for pair in wanted if pair[0] is not effect]
        images[id(effect)] = jacobian(chain, effect, [*at, *others], theta)
    if not wanted:
        return np.zeros((chain.setting.time.size, 3, 0))
    return np.concatenate([images[id(effect)] for effect, _ in wanted], axis=2)


def in_order(active: Sequence[Active]) -> list[Active]:
    """Active effects in the order in which nature applies them: that of the catalogue."""
    return sorted(active, key=lambda pair: _PLACE.get(pair[0].family, len(_PLACE)))


def _on(theta: FloatArray) -> bool:
    """Whether any of a few parameters is not zero; numpy's `any` takes ten times as long."""
    return any(np.asarray(theta).tolist())


def _enter(stage: str, signal: Signal) -> Signal:
    """What the baseline itself does on entering a stage."""
    if stage == "field":
        setting = signal.setting
        if setting.field_N_nT is not None and signal.r_N_km is setting.given[0]:
            return dataclasses.replace(signal, field_N_nT=setting.field_N_nT)
        field = field_N_nT(setting.model, signal.sampled_time, signal.r_N_km, signal.R_EN)
        return dataclasses.replace(signal, field_N_nT=field)
    if stage == "sensor":
        dipole = signal.setting.column("dipole_B_Am2")
        return signal.with_reading(signal.setting.instrument.ideal_reading(signal.at_sensor_B_nT, dipole))
    return signal


def _fold(signal: Signal, active: Sequence[Active], stage: str, after_noise: bool) -> Signal:
    """The signal effects of a stage before or after the noise."""
    for effect, theta in _applied(signal.setting, active, stage, after_noise):
        signal = effect.apply(signal, theta)
    return signal


def _applied(
    setting: Setting, active: Sequence[Active], stage: str, after_noise: bool | None
) -> list[tuple[SignalEffect, FloatArray]]:
    """What acts in a stage, in order; before or after the noise, or all of it."""
    here = [
        (effect, np.asarray(theta, dtype=np.float64))
        for effect, theta in active
        if effect.stage == stage and isinstance(effect, SignalEffect) and _on(theta)
    ]
    if stage == "attitude" and setting.direction == "predict":
        # What was reported wrong in one order is put right in the opposite one: rotations do not commute.
        here.reverse()
    wanted = (False, True) if after_noise is None else (after_noise,)
    return [pair for late in wanted for pair in here if pair[0].after_noise == late]


def _draw(signal: Signal, active: Sequence[Active], stage: str, seed: int, after_rounding: bool) -> Signal:
    """The distribution effects of a stage, before or after the sensor's own rounding."""
    here = [pair for pair in active if pair[0].stage == stage and np.any(pair[1])]
    for effect, theta in here:
        if isinstance(effect, DistributionEffect) and effect.after_rounding == after_rounding:
            signal = effect.draw(signal, np.asarray(theta), stream(seed, f"effects.{effect.name}"))
    return signal


__all__ = ["Active", "Chain", "Setting", "in_order", "jacobian", "jacobians"]
