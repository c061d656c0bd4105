"""Four things that were wrong and nobody said so: HCMM flown with each, diagnosed from telemetry, tested on later passes.

The passes are those of the study, three days in view of the stations, but the motion is the prescribed one, in which
the coils act at random with their full dipole; `by_law` flies as the study does. The two days that follow are kept apart
and tell whether what was found holds. The field model of the diagnosis is what is known of 1978 today.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fluxtwin.gap.channels.sun_nadir import Channel, open_channel
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import Budget, Problem, pose, realigned
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.gap.selection.refit import Readings, refit, settled
from fluxtwin.scenarios.flights import Numbers, prescribed, rms
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.torquers import coupling_nT_per_Am2
from fluxtwin.sim.telemetry.record import Telemetry

GROUND = "igrf14"
FAULTS = {key: Numbers(key=key, **fault) for key, fault in mission.CASES["fault"].items()}
"""What is wrong in each case, its name in the catalogue, and what the ground models."""
REGION_DEG, FIELD_NT = (FAULTS["b"].changes["effects.switched_field"][name] for name in ("region_deg", "f_nT"))
_LATER_MIN = 2880.0
_APART_S = 300.0


def run_gallery(
    config: Scenario,
    progress: Progress = silent,
    *,
    only: Sequence[str] = tuple(FAULTS),
    by_law: bool = False,
) -> tuple[Numbers, ...]:
    """Fly and diagnose the cases of `only`, in the prescribed motion; by_law: as the scenario moves, coils by its law."""
    # The coils at random and at full dipole, which is not what the law commands: under it the coupling is still named,
    # but with sigmas of tens of nT/(A m2) along x and z, and later passes hardly gain by it.
    config = config if by_law else prescribed(config)
    # The study's record and the days after it; the first ends one step after its last stamp.
    assert config.schedule is not None
    first = config.schedule.segments[0]
    assert first.duration_min is not None
    end = epoch.add_seconds(epoch.parse_time(first.start_utc), 60.0 * first.duration_min + first.step_s)[0]
    segments = [
        {"start_utc": start, "duration_min": minutes, "step_s": first.step_s}
        for start, minutes in ((first.start_utc, first.duration_min), (epoch.iso(end), _LATER_MIN))
    ]
    plain = config.updated({"sun_sensor.1.misalignment_deg": None, "schedule.segments": segments})
    world, ground = build_world(plain), load_field(GROUND)
    chosen = [FAULTS[key] for key in only]
    answers = []
    for number, case in enumerate(chosen):
        part = part_of(progress, number / len(chosen), (number + 1) / len(chosen))
        telemetry = mission.fly(plain.updated(case.changes), world).telemetry
        used, later = telemetry.select(telemetry.time < end), telemetry.select(telemetry.time >= end)
        answers.append(_answer(config, case, used, later, ground, part))
    return tuple(answers)


def diagnosed(
    telemetry: Telemetry, ground: FieldModel, config: Scenario, modelled: Sequence[str], progress: Progress = silent
) -> Diagnosis:
    """Diagnose a record; the step of the readings is all that is declared."""
    return diagnose(
        telemetry,
        ground,
        modelled=modelled,
        budget=_budget(config),
        progress=progress,
        provenance={"source": "simulation"},
    )


def _answer(
    config: Scenario, case: Numbers, used: Telemetry, later: Telemetry, ground: FieldModel, progress: Progress
) -> Numbers:
    def titled(words: str, share: float) -> None:
        progress(f"gallery, {case.key}: {words}", share)

    found = diagnosed(used, ground, config, case.modelled, titled)
    alone = settled(pose(used, ground, modelled=case.modelled, budget=_budget(config)))
    problem, residual = _left(used, ground, alone.modelled_active, config, alone.setting.instrument)
    longitude_latitude = frames.geocentric(problem.setting.R_EN.apply(problem.setting.given[0]))[:2]
    names = [effect.name for effect in found.effects]
    return Numbers(
        case=case,
        diagnosis=found,
        # The first cause named; and whether the cause that flew is named, and nothing else.
        name=names[0] if names else None,
        right=found.verdict == "effect" and names == [case.cause],
        compared=_compared(config, case, found),
        later=_later(found, alone, later, ground, config) if names else None,
        telemetry=used,
        # (N, 3) of the passes used, without the cause: body axes; without attitude, along the field first.
        residual_nT=residual,
        # (N, 2) latitude and longitude of those rows, and whether they have an attitude.
        place_deg=np.degrees(np.stack(longitude_latitude, axis=1)),
        known=used.has_attitude,
    )


def _budget(config: Scenario) -> Budget:
    return Budget(noise_nT=0.0, lsb_nT=config.magnetometer.step_nT)


def _left(
    telemetry: Telemetry, ground: FieldModel, active: Sequence[Active], config: Scenario, instrument: Magnetometer
) -> tuple[Problem, FloatArray]:
    """The record with effects applied as they are, and its residual (N, 3) in row axes; NaN where not measured."""
    given = pose(telemetry, ground, modelled=(), budget=_budget(config), frozen=active, instrument=instrument)
    problem = realigned(given)
    return problem, np.where(problem.measured, problem.in_row_axes(problem.residual_nT), np.nan)


def _later(found: Diagnosis, alone: Problem, later: Telemetry, ground: FieldModel, config: Scenario) -> Numbers:
    """The first named cause on the passes that were not used."""
    first, closure = found.effects[0], found.closure
    if closure is None or closure.empty:
        values = {name: parameter.value for name, parameter in first.parameters.items()}
        return _later_angle(open_channel(later, fewest=1), later.time, first.name, first.settings.get("head"), values)
    searched = [(one.effect, one.theta) for one in closure.stochastic if isinstance(one.effect, SignalEffect)]
    fit = refit(Readings(closure.problem, closure.whitener), [*closure.chosen, *searched], modelled=closure.modelled)
    bare, before = _left(later, ground, alone.modelled_active, config, alone.setting.instrument)
    full, after = _left(later, ground, fit.active, config, closure.problem.setting.instrument)
    quiet = full.chain.reading_nT(fit.modelled)
    acts = np.linalg.norm(full.chain.reading_nT(fit.active) - quiet, axis=1) > 1.0
    return _by_pass(bare.time, before, after, acts, "nT", found.gap.floor_with_effects_nT)


def _later_angle(
    channel: Channel, time: TimeArray, name: str, head: int | None, parameters_deg: Mapping[str, float]
) -> Numbers:
    """The sun-nadir angle, deg."""
    after = channel.without(name, head, parameters_deg)
    acts = channel.residual_rad != after.residual_rad
    before_deg, after_deg = (np.degrees(one.residual_rad)[:, None] for one in (channel, after))
    return _by_pass(time[channel.rows], before_deg, after_deg, acts, "deg", rms(before_deg[~acts]))


def _by_pass(
    time: TimeArray, before: FloatArray, after: FloatArray, acts: BoolArray, unit: str, floor: float
) -> Numbers:
    seconds = epoch.seconds_since(time, time[0])
    number = np.concatenate([[0], np.cumsum(np.diff(seconds) > _APART_S)])
    passes = [np.flatnonzero(number == n) for n in range(int(number[-1]) + 1)]
    return Numbers(
        labels=[epoch.iso(time[rows[0]])[:16].replace("T", " ") for rows in passes],
        unit=unit,
        # (P,) rms: what is modelled taken from the passes used, without the named cause and with it.
        before=np.array([rms(before[rows]) for rows in passes]),
        after=np.array([rms(after[rows]) for rows in passes]),
        # (P,) passes in which the cause acts; both rms over the samples in which it does; the same where nothing is wrong.
        concerned=np.array([bool(acts[rows].any()) for rows in passes]),
        rms=(rms(before[acts]), rms(after[acts])),
        floor=floor,
    )


def _compared(config: Scenario, case: Numbers, found: Diagnosis) -> tuple[Numbers, ...]:
    """What was put in beside what was found, for the cause that flew; nothing if another was named."""
    if not found.effects:
        return ()
    if case.key == "a":
        return _compared_turn(case.changes["sun_sensor.1.misalignment_deg"], found)
    put_in = _put_in(config, case.key)
    return tuple(
        Numbers(name=name, put_in=put_in[name], found=one.value, sigma=one.sigma, unit=one.unit)
        for name, one in found.effects[0].parameters.items()
        if name in put_in
    )


def _put_in(config: Scenario, key: str) -> dict[str, float]:
    if key == "b":
        return dict(zip(("f_x", "f_y", "f_z"), FIELD_NT, strict=True))
    if key == "c":
        assert config.torquers is not None
        matrix, prefix = coupling_nT_per_Am2(np.array(config.torquers.positions_m)), "C"
    else:
        matrix, prefix = np.array(config.magnetometer.S), "S"
    return {f"{prefix}_{a}{b}": float(matrix[i, j]) for i, a in enumerate("xyz") for j, b in enumerate("xyz")}


def _compared_turn(turn_deg: Sequence[float], found: Diagnosis) -> tuple[Numbers, ...]:
    """The turn along what the angle sees: a head turned by theta reports the sun turned by minus theta."""
    named = found.provenance["sun_nadir"]["named"]
    if named is None or named["head"] is None:
        return ()
    vector = np.array([named["parameters"][f"turn_{a}"]["value"] for a in "xyz"])
    size = float(np.linalg.norm(vector))
    put_in = -float(np.array(turn_deg) @ vector) / size
    words, sigma = "turn of the measured sun, as far as seen", named["amount_deg"]["sigma"]
    return (Numbers(name=words, put_in=put_in, found=size, sigma=sigma, unit="deg"),)
