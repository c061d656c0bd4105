"""Closing the loop: the named effects as sections of a scenario, so that the simulation has them too.

The other way round, `without_effects` takes those that a scenario has out of telemetry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.calib.common.orbit_error import ahead
from fluxtwin.calib.common.records import Calibration
from fluxtwin.gap.hypotheses.blocks import OWN_STAGES
from fluxtwin.gap.noise.choice import reading_spacing
from fluxtwin.gap.problem.problem import CALIBRATION, calibrated, corrected, pose
from fluxtwin.gap.records.diagnosis import Closure, EffectParameter, Transfer
from fluxtwin.gap.selection.refit import Readings, covariance_of, moving, refit
from fluxtwin.gap.selection.search import parameters_of
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError
from fluxtwin.sim.scenario.effect_sections import effect_section
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.companions import ALONG_TRACK_KM
from fluxtwin.sim.telemetry.record import Telemetry


@dataclass(frozen=True, eq=False)
class Closed:
    """What the closed scenario says: eq. 1's S, b, T, and the effects in addition to them."""

    instrument: Magnetometer
    modelled: tuple[Active, ...]
    """Other effects that were re-estimated."""
    named: tuple[tuple[SignalEffect, FloatArray, FloatArray], ...]
    """Effects as pinned (nothing is taken from the record any more), parameters (p,), covariance (p, p)."""


@dataclass(frozen=True)
class Declared:
    """What was declared to the command of noise and field; None where it was found in the data, or is the default."""

    noise_nT: float | None = None
    lsb_nT: float | None = None
    attitude_sigma_deg: float | None = None
    attitude_tau_s: float | None = None
    field: str | FieldModel | None = None
    degree: int | None = None


def settle(closure: Closure) -> Closed:
    """S, b and T with what was re-estimated, and the effects refitted with the magnetometer that these make.

    The effects of a sensor act through its matrix, so a change of S by 1 % changes them by 1 %: hence the second fit, which
    is good to 1e-4.
    """
    problem, chosen, modelled = closure.problem, closure.chosen, closure.modelled
    covariances: list[FloatArray] = []
    for number in range(2):
        problem = calibrated(problem, modelled)
        modelled = problem.modelled_active
        if not chosen or number == 1:
            break
        fit = refit(Readings(problem, closure.whitener), chosen, modelled=modelled)
        chosen, modelled = fit.chosen, fit.modelled
        covariances = [fit.covariance[part, part] * max(closure.variance, 1.0) for part in fit.slices()]
    named, every = [], [*problem.frozen, *modelled, *chosen]
    for (effect, theta), covariance in zip(chosen, covariances, strict=True):
        others = [pair for pair in every if pair[0] is not effect]
        pinned = effect.pinned(problem.setting, problem.chain.reading_nT(others))
        assert isinstance(pinned, SignalEffect)
        named.append((pinned, theta, covariance))
    rest = tuple(pair for pair in modelled if pair[0].name not in CALIBRATION)
    return Closed(problem.setting.instrument, rest, tuple(named))


def closed_scenario(
    closure: Closure,
    closed: Closed,
    transfers: Sequence[Transfer],
    scenario: Scenario | None,
    telemetry: Path,
    column_map: Path | None,
    declared: Declared,
) -> Scenario:
    """The scenario with the named effects, their parameters and covariance in it, and where they hold.

    Without a scenario one is made that replays the telemetry, with the noise that was declared, else found.
    S, b and T take what was re-estimated together with the effects.
    Raises BadInput when the scenario has the same effect with other settings.
    """
    base = _replaying(closure, telemetry, column_map) if scenario is None else scenario
    frozen = {effect.name: (effect, theta) for effect, theta in closure.problem.frozen}
    changes: dict[str, Any] = _files(base)
    added: list[tuple[Effect, FloatArray, FloatArray | None]] = [(e, theta, None) for e, theta in closed.modelled]
    added += [(effect, theta, covariance) for effect, theta, covariance in closed.named]
    added += [(one.effect, one.theta, np.diag(one.sigma**2)) for one in closure.stochastic if one.effect is not None]
    for effect, theta, covariance in added:
        # A parameter that was not estimated has no finite entry.
        known = covariance if covariance is not None and np.isfinite(covariance).all() else None
        changes[f"effects.{effect.name}"] = effect_section(effect, _with_frozen(frozen, effect, theta), known)
    changes |= _calibration(closure, closed.instrument)
    if scenario is None:
        changes |= _noise(closure, declared)
    changes["closure"] = _closure_table(closure, transfers, telemetry)
    return base.updated(changes)


def calibration(closure: Closure) -> Calibration:
    """S, b and T as re-estimated beside what is named, with the covariance that the noise of the diagnosis gives.

    A parameter that these data do not see, or that is not re-estimated, has no sigma.
    """
    of = {"scale_misalignment": 0, "bias": 9, "torquer_coupling": 12}
    instrument = corrected(closure.problem.setting.instrument, closure.modelled)
    T, known = instrument.T_nT_per_Am2, _covariance(closure)
    into, start = np.zeros((12 if T is None else 21, len(known))), 0  # from the effects' parameters to eq. 1's
    for effect, theta in closure.modelled:
        if (first := of.get(effect.name)) is not None:
            sign = -1.0 if effect.name == "torquer_coupling" else 1.0
            into[first : first + len(theta), start : start + len(theta)] = sign * np.eye(len(theta))
        start += len(theta)
    return Calibration(instrument.S, instrument.b_nT, T, into @ np.nan_to_num(known) @ into.T)


def reestimated(closure: Closure) -> dict[str, dict[str, EffectParameter]]:
    """The effects that were re-estimated beside S, b and T, with their parameters, which come on top of a scenario's.

    What the data do not see has no sigma.
    """
    sigma = np.sqrt(np.diag(_covariance(closure)))
    found, start = dict[str, dict[str, EffectParameter]](), 0
    for effect, theta in closure.modelled:
        spread = sigma[start : start + len(theta)]
        start += len(theta)
        if effect.name not in CALIBRATION:
            found[effect.name] = parameters_of(effect, theta, spread, closure.problem.setting)
    return found


def _covariance(closure: Closure) -> FloatArray:
    """(p, p) of what was re-estimated and of what is named after it; not finite where the data see nothing."""
    jacobian = Readings(closure.problem, closure.whitener).jacobian([*closure.modelled, *closure.chosen])
    return np.asarray(covariance_of(jacobian, moving(jacobian))[0] * max(closure.variance, 1.0), dtype=np.float64)


def _with_frozen(frozen: Mapping[str, Active], effect: Effect, theta: FloatArray) -> FloatArray:
    """What the scenario had already and what was found in addition to it, together."""
    if effect.name not in frozen:
        return theta
    had, amount = frozen[effect.name]
    if had != effect:
        raise BadInput(
            f"the scenario has [effects.{effect.name}] with other settings than the effect that was found in addition",
            where="--close",
            wanted="a scenario without that effect",
        )
    return np.asarray(amount + theta)


def _calibration(closure: Closure, instrument: Magnetometer) -> dict[str, Any]:
    found = {effect.name for effect, _ in closure.modelled}
    changes: dict[str, Any] = {"magnetometer.b_mG": None} if "bias" in found else {}
    of = {"scale_misalignment": "S", "bias": "b_nT", "torquer_coupling": "T_nT_per_Am2"}
    known = {key: getattr(instrument, key) for name, key in of.items() if name in found}
    return changes | {f"magnetometer.{key}": np.asarray(v).tolist() for key, v in known.items() if v is not None}


def _files(base: Scenario) -> dict[str, Any]:
    """Files that the scenario names, found from any folder."""
    named = {"orbit.tle": base.orbit and base.orbit.tle}
    if base.replay is not None:
        named |= {"replay.telemetry": base.replay.telemetry, "replay.column_map": base.replay.column_map}
    return {key: str(base.path_of(name).resolve()) for key, name in named.items() if name}


def _noise(closure: Closure, declared: Declared) -> dict[str, Any]:
    """Noise, reference attitude and field of a scenario that had none of them."""
    noise, lsb_nT = closure.whitener.noise, declared.lsb_nT
    if lsb_nT is None:  # not zero: a step that a scenario does not have would be a gap
        lsb_nT = reading_spacing(np.asarray(closure.problem.telemetry.mag_B_nT)) or 0.0
    white_nT = declared.noise_nT
    if white_nT is None:
        extra = sum(float(one.theta[0]) ** 2 for one in closure.stochastic if one.name == "excess_noise")
        rest = float(np.mean(noise.white_nT**2)) - lsb_nT**2 / 12.0 - extra
        white_nT = float(np.sqrt(max(rest, 0.0)))
    sigma_deg = declared.attitude_sigma_deg
    tau_s = declared.attitude_tau_s
    changes: dict[str, Any] = {
        "magnetometer.noise_nT": white_nT,
        "magnetometer.lsb_nT": lsb_nT,
        "attitude.reference.sigma_deg": float(np.degrees(noise.theta_rad)) if sigma_deg is None else sigma_deg,
        "attitude.reference.tau_s": float(noise.tau_s) if tau_s is None else tau_s,
    }
    field, degree = declared.field, declared.degree
    if isinstance(field, FieldModel):
        degree = field.degree if degree is None else degree
        field = field.name
    kind, colon, path = (field or "").partition(":")
    field = f"{kind}:{Path(path).resolve()}" if colon else field  # a file is found from any folder
    changes |= dict.fromkeys(("field.model", "field.truth"), field)
    changes |= dict.fromkeys(("field.degree", "field.truth_degree"), degree)
    return {key: value for key, value in changes.items() if value}


def _closure_table(closure: Closure, transfers: Sequence[Transfer], telemetry: Path) -> dict[str, Any]:
    first, last = (epoch.iso(closure.problem.time[row], "ms") for row in (0, -1))
    known = [{key: value for key, value in one.to_dict().items() if value not in (None, "")} for one in transfers]
    rows = [{key: float(f"{v:.3g}") if isinstance(v, float) else v for key, v in row.items()} for row in known]
    table: dict[str, Any] = {"telemetry": telemetry.name, "from_utc": first, "to_utc": last}
    table |= {"rows": closure.problem.rows, "transfer": rows}
    return table if closure.incomplete is None else {**table, "incomplete": closure.incomplete}


def _replaying(closure: Closure, telemetry: Path, column_map: Path | None) -> Scenario:
    mapped = "" if column_map is None else f"column_map = {str(column_map.resolve())!r}\n"
    name = closure.problem.telemetry.provenance.get("spacecraft") or telemetry.stem
    base = parse_scenario(
        f'name = "closed"\nseed = 1\n[spacecraft]\nname = "x"\n'
        f"[replay]\ntelemetry = {str(telemetry.resolve())!r}\n{mapped}",
        where="closing",
    )
    return base.updated({"spacecraft.name": name})


@dataclass(frozen=True)
class TakenOut:
    """The record, the names of what was taken out of it, and of what it still has."""

    telemetry: Telemetry
    taken: tuple[str, ...]
    left: tuple[str, ...]
    """What is no error of readings or positions (clock, attitude, field), or cannot be known row by row (noise, bits)."""


def can_be_taken_out(effect: Effect) -> bool:
    """Whether `without_effects` takes it out: an error of positions, or of readings that is known row by row."""
    own = isinstance(effect, SignalEffect) and effect.stage in OWN_STAGES and not effect.after_noise
    return own or isinstance(effect, AlongTrackError)


def without_effects(
    telemetry: Telemetry, model: FieldModel, instrument: Magnetometer, active: Sequence[Active]
) -> TakenOut:
    """The record as it would be without these effects; instrument: S, b and T of equation 1, through which they act.

    Positions go where they truly were. What effects of spacecraft and sensor do is computed from field, attitude and
    housekeeping, and taken from the readings (N, 3) [nT]; rows of which that is not known are left without reading.
    Raises BadInput and NoAnswer as `pose`.
    """
    of_orbit = [one for one in active if isinstance(one[0], AlongTrackError)]
    of_readings = [one for one in active if can_be_taken_out(one[0]) and one not in of_orbit]
    setting = pose(telemetry, model, modelled=(), instrument=instrument).setting
    for effect, theta in of_orbit:
        assert isinstance(effect, AlongTrackError)
        error_km = np.broadcast_to(effect.size(replace(setting, time=telemetry.time), theta), len(telemetry))
        known = {key: text for key, text in telemetry.provenance.items() if key != ALONG_TRACK_KM}
        telemetry = ahead(telemetry, -error_km).replace(provenance=known)
    if of_readings:
        problem = pose(telemetry, model, modelled=(), instrument=instrument)
        change = problem.chain.reading_nT(of_readings) - problem.chain.reading_nT()
        for effect, _ in of_readings:
            change[effect.invented(problem.setting)] = np.nan
        rows = np.isin(telemetry.time, problem.telemetry.time)
        mag = np.full((len(telemetry), 3), np.nan)
        mag[rows] = telemetry.mag_B_nT[rows] - change
        telemetry = telemetry.replace(mag_B_nT=mag)
    taken = tuple(effect.name for effect, _ in (*of_orbit, *of_readings))
    return TakenOut(telemetry, taken, tuple(effect.name for effect, _ in active if effect.name not in taken))
