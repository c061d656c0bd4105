"""For which other designs the parameters of a closed scenario are good enough.

An effect *transfers* to a design if a later diagnosis there, of a record as long as this one, with the effect applied
as it is and everything modelled re-estimated, would mistake its error for a gap at most once in twenty times. The
error is that of the parameters (their covariance, carried through the noise-free chain of that design) and that of
the name: what might as well have caused this gap may look different there.

A day later the orbit is the recorded one with its node moved by the Earth's flattening (J2, secular), over another
ground and under another sun. What was recorded of the housekeeping repeats in time; a current or temperature that
follows the sunlight is recomputed from the sunlight of that day.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import ncx2

from fluxtwin.gap.held_out.held_out import floor_rms_nT
from fluxtwin.gap.hypotheses.candidates import settings_of
from fluxtwin.gap.linear.projection import orthonormal
from fluxtwin.gap.noise.whitening import Whitener, make_whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.records.diagnosis import Closure, FoundEffect, Transfer
from fluxtwin.gap.selection.criterion import FEWEST, samples_of, weight_of
from fluxtwin.gap.selection.detectable import Rule, visible_part
from fluxtwin.gap.selection.refit import Readings, limits, refit
from fluxtwin.gap.selection.search import WORTH_SAYING
from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.attitude.libration import draw_libration
from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.earth.orbit import orbital_rates
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active, Chain, jacobians
from fluxtwin.sim.effects.drivers import STAND_INS
from fluxtwin.sim.effects.signal import Motion, Setting

_ABSORBED = 1e-9
"""Whitened energy of an error that what is re-estimated absorbs: rounding."""
DAYS = (0.5, 90.0, 182.0)
"""Half a day turns the ground below, a quarter and half a year the sun."""
TUMBLE_DEG_S = (0.12, 0.08, 0.2)
SPIN_RPM = 1.9
"""Near 2 rpm, and no whole number of turns between samples of the usual spacings."""
INERTIA_KG_M2 = np.array([10.0, 12.0, 15.0])
"""Of a body without symmetry: only ratios matter to a torque-free tumble."""
MOST_CHANCE = 0.05
"""Of a false gap on the other design: more, and the parameters do not transfer."""


@dataclass(frozen=True, eq=False)
class Target:
    """One other design; N rows, as many as the record has with an attitude."""

    name: str
    setting: Setting
    segment: FloatArray
    """(N,) number of the stretch without gaps."""


@dataclass(frozen=True)
class PlannedMotion:
    """Motion along known positions with an attitude that is a function of time."""

    time: TimeArray
    r_N_km: FloatArray
    v_N_km_s: FloatArray
    turned: Callable[[TimeArray, FloatArray, FloatArray], Rotation]
    """R_BN at stamps, positions and velocities."""

    def at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position, velocity (N, 3) and R_BN `offset_s` after each stamp (seconds to minutes)."""
        after = np.broadcast_to(offset_s, self.time.shape)[:, None]
        pull = -GM_EARTH_KM3_S2 * self.r_N_km / np.linalg.norm(self.r_N_km, axis=1)[:, None] ** 3
        r = self.r_N_km + after * self.v_N_km_s + 0.5 * after**2 * pull
        v = self.v_N_km_s + after * pull
        seconds = epoch.seconds_since(self.time, self.time[0]) + after[:, 0]
        return r, v, self.turned(epoch.add_seconds(self.time[0], seconds), r, v)


def targets(problem: Problem, named: Sequence[SignalEffect] = ()) -> list[Target]:
    """The designs for which a closed scenario says whether its parameters are good enough.

    The attitude as flown on three other days, then nadir (if that was not flown), a tumble and a spin; these two the other
    way up, if only then all that is named has an effect. Days outside the field model's validity are left out.
    """
    known = problem.telemetry.has_attitude
    if int(known.sum()) < FEWEST:
        return []
    flown = _cut(problem.setting, known)
    segment = problem.segment[known]
    R_BO = flown.given[2] * flown.R_ON.inv()
    nadir = bool(np.median((R_BO * R_BO.mean().inv()).magnitude()) < np.radians(30.0))  # of a tumble it is above 90 deg
    tumble, spin = f"tumble of {np.linalg.norm(TUMBLE_DEG_S):.2g} deg/s", f"spin of {SPIN_RPM:g} rpm"
    recorded, regime = ("nadir", None) if nadir else ("attitude as flown", "same")
    made = [(recorded, days, regime) for days in DAYS] + ([] if nadir else [("nadir", DAYS[1], "nadir")])
    made += [(tumble, DAYS[1], "tumble"), (spin, DAYS[1], "spin")]
    found = []
    for name, days, regime in made:
        setting, model = _moved(flown, days, regime), problem.setting.model
        if regime in ("tumble", "spin") and any(effect.untestable(setting) for effect in named):
            other = _moved(flown, days, regime, over=True)
            setting = setting if any(effect.untestable(other) for effect in named) else other
        later = f"{24 * days:g} h later" if days < 1 else f"{days:g} days later"
        if model.valid_from <= setting.time[0] and setting.time[-1] <= model.valid_to:
            found.append(Target(f"{name}, {later}", setting, segment))
    return found


def _cut(setting: Setting, rows: np.ndarray) -> Setting:
    """The setting at some of its rows, with the motion as it was recorded there."""
    r, v, R_BN = setting.given
    number = np.flatnonzero(rows)
    columns = {name: column[rows] for name, column in setting.columns.items()}
    denser = setting.motion.denser if isinstance(setting.motion, RecordedMotion) else None
    gyro = columns.get("rate_B_rad_s")
    motion = RecordedMotion(setting.time[rows], r[rows], v[rows], R_BN[number], gyro, denser=denser)
    return Setting(setting.time[rows], motion, "predict", setting.model, setting.instrument, columns)


def _moved(flown: Setting, days: float, regime: str | None, *, over: bool = False) -> Setting:
    """Another day, in a regime: None the recorded motion about the orbital frame, "same" that about the stars; over: of a
    tumble or spin that begins the other way up."""
    time = epoch.add_seconds(flown.time[0], flown.seconds + 86400.0 * days)
    r, v, R_BN = flown.given
    turn = _node_turn(flown.time[0], r, v, 86400.0 * days)
    r, v = turn.apply(r), turn.apply(v)
    columns = {name: column for name, column in flown.columns.items() if name not in ("sunlit", "sun_B", "nadir_B")}
    motion: Motion
    if regime in (None, "same"):
        R = R_BN if regime == "same" else R_BN * flown.R_ON.inv() * frames.rotation_ON(r, v)
        denser = flown.motion.denser if regime == "same" and isinstance(flown.motion, RecordedMotion) else None
        if denser is not None:
            since_s = epoch.seconds_since(denser.time, flown.time[0])
            denser = dataclasses.replace(denser, time=epoch.add_seconds(time[0], since_s))
        motion = RecordedMotion(time, r, v, R, columns.get("rate_B_rad_s"), denser=denser)
    else:
        columns.pop("rate_B_rad_s", None)
        motion = PlannedMotion(time, r, v, _regime(str(regime), time[0], over))
    bare = Setting(time, motion, "predict", flown.model, flown.instrument, columns)
    return dataclasses.replace(bare, columns=columns | _driven(flown, bare))


def _node_turn(time: np.datetime64, r_N_km: FloatArray, v_N_km_s: FloatArray, later_s: float) -> Rotation:
    """The turn of the orbital plane about the pole in so many seconds, from the first row's osculating orbit."""
    pole_N = frames.rotation_TN(time).inv().apply([0.0, 0.0, 1.0]).reshape(3)
    r, v = r_N_km[0], v_N_km_s[0]
    momentum = np.cross(r, v)
    axis_km = 1.0 / (2.0 / np.linalg.norm(r) - float(v @ v) / GM_EARTH_KM3_S2)
    shape = 1.0 - float(momentum @ momentum) / (GM_EARTH_KM3_S2 * axis_km)
    tilt = np.arccos(np.clip(float(momentum @ pole_N) / np.linalg.norm(momentum), -1.0, 1.0))
    if not axis_km > 0:
        return Rotation.identity()
    rates = orbital_rates(float(axis_km), float(np.sqrt(np.clip(shape, 0.0, 0.99))), float(tilt))
    return Rotation.from_rotvec(pole_N * rates.raan_rad_s * later_s)


def _regime(name: str, start: np.datetime64, over: bool) -> Callable[[TimeArray, FloatArray, FloatArray], Rotation]:
    if name == "tumble":
        tumbling = (
            INERTIA_KG_M2,
            np.array([1.0, 0.0, 0.0, 0.0] if over else [0.0, 0.0, 0.0, 1.0]),
            np.radians(TUMBLE_DEG_S),
        )
        return lambda time, r, v: attitude.tumble(time, *tumbling, epoch=start).R_BN
    if name == "spin":
        spun = (INERTIA_KG_M2, np.array([-1.0 if over else 1.0, 0.0, 0.0]), SPIN_RPM * 2.0 * np.pi / 60.0)
        return lambda time, r, v: attitude.spin(time, *spun, nutation_rad=np.radians(5.0), epoch=start).R_BN
    # The pointing error of a nadir pointer, with periods up to that of an orbit.
    librations = draw_libration((np.radians(2.0),) * 3, 600.0, 6000.0, np.random.default_rng(0))
    return lambda time, r, v: attitude.librating(time, r, v, librations).R_BN


def _driven(flown: Setting, moved: Setting) -> dict[str, FloatArray]:
    """Recorded columns that follow the sunlight, as they follow it on the other day."""
    found = {}
    for name, choices in STAND_INS.items():
        column = flown.columns.get(name)
        if column is not None:
            made = _best_shape(column, [(one(_without(flown, name)), one(_without(moved, name))) for one in choices])
            if made is not None:
                found[name] = made
    return found


def _without(setting: Setting, name: str) -> Setting:
    return dataclasses.replace(setting, columns={key: v for key, v in setting.columns.items() if key != name})


def _best_shape(column: FloatArray, shapes: Sequence[tuple[FloatArray, FloatArray]]) -> FloatArray | None:
    """a + c shape, with a and c fitted here and the shape there; None where no shape explains the column."""
    known = np.isfinite(column)
    best, made = 0.5, None  # what explains most of the variance drives it
    for here, there in shapes:
        if known.sum() < FEWEST or np.ptp(here[known]) == 0.0 or np.ptp(column[known]) == 0.0:
            continue
        slope, level = np.polyfit(here[known], column[known], 1)
        explained = 1.0 - float(np.var(column[known] - slope * here[known] - level) / np.var(column[known]))
        if explained > best:
            best, made = explained, slope * there + level
    return made


@dataclass(frozen=True, eq=False)
class Other:
    """What might be in the place of a named effect, as refitted there."""

    weight: float
    label: str
    effect: SignalEffect
    theta: FloatArray


def transfers(closure: Closure, effects: Sequence[tuple[SignalEffect, FloatArray, FloatArray]]) -> list[Transfer]:
    """For each named effect (as pinned, parameters (p,), covariance (p, p)) and each target, whether it transfers."""
    chosen = [(effect, theta) for effect, theta, _ in effects]
    flown = targets(closure.problem, [effect for effect, _ in chosen])
    designs = [_Design(closure, target, chosen) for target in flown]
    rows = []
    for number, (effect, theta, covariance) in enumerate(effects):
        known = np.isfinite(np.diag(covariance))
        unseen = [p.name for p, seen in zip(effect.parameters, known, strict=True) if not seen]
        why = closure.incomplete or effect.bound
        if why is None and unseen:
            why = f"these data did not excite {', '.join(unseen)}"
        others = _others(closure, number) if why is None else ()
        for design in designs:
            name, lost = design.target.name, effect.untestable(design.target.setting)
            if why is not None:
                rows.append(Transfer(effect.name, name, False, None, None, design.floor_nT, None, why))
            elif lost is not None:
                lost = f"it has no effect in the one flight that was tried ({lost})"
                rows.append(Transfer(effect.name, name, True, 0.0, 0.0, design.floor_nT, None, lost))
            else:
                rows.append(_one(closure.tested, design, effect, theta, covariance, others))
    return rows + [_known(one, design.target) for one in closure.stochastic for design in designs]


class _Design:
    """A target with its chain, whitening, and what is re-estimated there."""

    def __init__(self, closure: Closure, target: Target, chosen: Sequence[Active]) -> None:
        self.target, self.chain = target, Chain(target.setting)
        self.base = [*closure.problem.frozen, *closure.modelled]
        self.chosen = list(chosen)
        field = self.chain.signal([*self.base, *chosen]).field_B_nT
        noise = closure.whitener.noise
        images = turn_images(field, closure.problem.sensor_image)
        self.whitener: Whitener = make_whitener(images, target.setting.seconds, target.segment, noise)
        self.nuisance = jacobians(self.chain, closure.modelled, [*closure.problem.frozen, *chosen])
        self.nuisance_white = self.whitener.apply(self.nuisance)
        self.basis = orthonormal(self.nuisance_white)
        self.floor_nT = floor_rms_nT(field, noise.white_rms_nT, noise.theta_rad, roll=noise.roll)

    def reading(self, old: SignalEffect, new: SignalEffect, theta: FloatArray) -> FloatArray:
        """(N, 3) noise-free reading with the effect `new` in place of `old`."""
        others = [pair for pair in self.chosen if pair[0] is not old]
        return self.chain.reading_nT([*self.base, *others, (new, theta)])

    def projected(self, signals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signals (N, 3, k) after projecting out what is re-estimated: in nT (N, 3, k), and whitened (3N, k)."""
        white = self.whitener.apply(signals)
        flat = white.reshape(-1, white.shape[2])
        visible = visible_part(signals, white, self.nuisance, self.nuisance_white)
        return visible, flat - self.basis @ (self.basis.T @ flat)


def _one(
    tested: int,
    design: _Design,
    effect: SignalEffect,
    theta: FloatArray,
    covariance: FloatArray,
    others: Sequence[Other],
) -> Transfer:
    """By the errors of the parameters, and by what else the effect may be: both as a diagnosis there would see them."""
    raw, white = design.projected(_errors(design, effect, theta, covariance))
    spread: FloatArray = np.asarray(np.linalg.eigvalsh(white.T @ white), dtype=np.float64)
    seen = spread[spread > _ABSORBED]
    rank = max(seen.size, 1)
    rule = Rule(rank, tested, samples_of(design.whitener.measured))
    bar = rule.least_drop
    unsure2, energy = float(np.sum(raw**2) / raw[:, :, 0].size), float(spread.sum())
    chance = (1.0 - sum(other.weight for other in others)) * _seen_by_chance(seen, bar)
    reading = design.reading(effect, effect, theta)
    wrong_name = ""
    for other in others:
        raw, white = design.projected((design.reading(effect, other.effect, other.theta) - reading)[:, :, None])
        own = float(np.sum(white**2))
        added = other.weight * float(ncx2.sf(bar, rank, max(own, 1e-12)))
        chance += added
        unsure2 += other.weight * float(np.mean(raw**2))
        energy += other.weight * own
        wrong_name = wrong_name or (other.label if added > MOST_CHANCE / 2 else "")
    unsure_nT = float(np.sqrt(unsure2))
    detectable = unsure_nT * float(np.sqrt(rule.noncentrality / energy)) if energy > _ABSORBED else None
    why = f"it may as well be {wrong_name} in these data, and that would differ there"
    why = why if wrong_name else "the error of its parameters would show there"
    good = chance <= MOST_CHANCE
    sizes = (chance, unsure_nT, design.floor_nT, detectable)
    return Transfer(effect.name, design.target.name, good, *sizes, "" if good else why)


def _label(effect: SignalEffect, other: SignalEffect) -> str:
    """The other name, or the settings in which it differs."""
    if other.name != effect.name:
        return other.name
    changed = {key: value for key, value in settings_of(other).items() if settings_of(effect).get(key) != value}
    words = [f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in changed.items()]
    return f"{other.name} with {', '.join(words)}" if words else other.name


def _errors(design: _Design, effect: SignalEffect, theta: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N, 3, k) what one sigma along each principal direction of the parameters changes in the reading."""
    values, vectors = np.linalg.eigh(covariance)
    low, high = limits([(effect, theta)])
    columns = []
    for step in (vectors * np.sqrt(np.maximum(values, 0.0))).T:
        up, down = (design.reading(effect, effect, np.clip(theta + by, low, high)) for by in (step, -step))
        columns.append((up - down) / 2.0)
    return np.stack(columns, axis=-1)


def _seen_by_chance(spread: FloatArray, bar: float) -> float:
    """P(sum (1 + l_i) z_i^2 > bar), z standard normal: the score of an error with covariance l over noise."""
    z2 = np.random.default_rng(0).chisquare(1.0, size=(20_000, spread.size))  # a chance of 0.05 is good to 0.0015
    return float(np.mean(z2 @ (1.0 + spread) > bar))


def _others(closure: Closure, number: int) -> tuple[Other, ...]:
    """What might be in the place of a named effect, refitted, with posterior weights exp(-BIC / 2)."""
    problem, effect = closure.problem, closure.chosen[number][0]
    readings = Readings(problem, closure.whitener)
    own = refit(readings, closure.chosen, modelled=closure.modelled)
    samples = samples_of(closure.whitener.measured)
    found: list[Other] = []
    for other in closure.alternatives[number][:8]:
        if other.name == effect.name and other.bound:
            continue  # the same error with a rate that no data ask for: what it would do elsewhere is a guess
        trial = list(closure.chosen)
        trial[number] = (other, np.zeros(len(other.parameters)))
        fit = refit(readings, trial, modelled=closure.modelled)
        worse = (fit.chi2 - own.chi2) / closure.variance + (fit.rank_chosen - own.rank_chosen) * np.log(samples)
        weight = float(weight_of(worse))
        if weight > WORTH_SAYING:
            reading = problem.reading_nT([*fit.modelled, *fit.others(number)])
            pinned = other.pinned(problem.setting, reading)
            assert isinstance(pinned, SignalEffect) and isinstance(effect, SignalEffect)
            found.append(Other(weight, _label(effect, other), pinned, fit.chosen[number][1]))
    total = 1.0 + sum(one.weight for one in found)
    return tuple(dataclasses.replace(one, weight=one.weight / total) for one in found)


def _known(one: FoundEffect, target: Target) -> Transfer:
    """An effect that is known by its distribution: a property of the instrument, or a path that never comes again."""
    bound = None if one.effect is None else one.effect.bound
    owner = "body" if one.stage == "dynamics" else "readings"
    why = bound or f"a property of the {owner}, not of the orbit: its size is carried over"
    return Transfer(one.name, target.name, bound is None, None, None, None, None, why)
