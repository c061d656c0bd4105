"""The glue between files, scenarios and the diagnosis; the command and `fluxtwin.diagnose` both call it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from fluxtwin.calib.common.apply import apply_calibration, corrected_effects, require_applicable
from fluxtwin.calib.common.records import Calibration
from fluxtwin.gap.channels.momentum_arcs import Craft
from fluxtwin.gap.detectors.codes import with_frozen_noise
from fluxtwin.gap.diagnose import diagnose as investigate_record
from fluxtwin.gap.held_out import closing, transfer
from fluxtwin.gap.held_out.closing import Declared as Declared
from fluxtwin.gap.held_out.closing import TakenOut, without_effects
from fluxtwin.gap.planning.designs import base_tree
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, Budget, Roll
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.gap.report import input_warnings, words
from fluxtwin.notebook import usual
from fluxtwin.scenarios.packaged import as_scenario
from fluxtwin.sim.base.errors import BadInput, NoAnswer, names_in
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.response import Saturation
from fluxtwin.sim.run import spacecraft
from fluxtwin.sim.run.flights import vehicle_of
from fluxtwin.sim.run.world import ephemeris, schedule_times
from fluxtwin.sim.scenario.effect_sections import active_effects
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import Readable, Reading
from fluxtwin.verbs import (
    F,
    as_model,
    as_record,
    number_in,
    on_one_blas_thread,
    reading_of,
    with_keywords,
    with_reading,
)

_MOST = {"noise_nT": 1e6, "lsb_nT": 1e6, "attitude_sigma_deg": 180.0, "attitude_tau_s": 1e9}
"""What may be declared of the errors: up to ten times the Earth's field, half a turn, thirty years; beyond, nothing is said
of them."""
_CORRECTED = (
    "the readings are corrected already (by {}): the gap is what that calibration leaves, and the starting S, b and T of a "
    "scenario are not used"
)


class Assumed(TypedDict, total=False):
    """What is known of errors and field: the keywords that every verb takes which diagnoses."""

    noise_nT: float | None
    lsb_nT: float | None
    attitude_sigma_deg: float | None
    attitude_tau_s: float | None
    field: str | FieldModel | None
    degree: int | None


class AssumedAndReading(Assumed, Reading, total=False):
    """The same, and how telemetry is read."""


_ASSUMED = """\
noise_nT, lsb_nT: noise of a reading per axis, 1 sigma, and its step [nT].
attitude_sigma_deg: error of the reference attitude per axis, 1 sigma [deg].
attitude_tau_s: its time constant [s]; 0 for white.
field: the field model (igrf14, igrf1975, chaos:FILE), or one that `fluxtwin.load_field` returned.
degree: the highest degree of it that is used."""


def with_assumed(verb: F) -> F:
    """The verb with the keywords of `Assumed`."""
    return with_keywords(verb, Declared, _ASSUMED)


def declared_in(options: Mapping[str, Any]) -> Declared:
    """What is declared among the options. Raises BadInput for an error that cannot be."""
    declared = Declared(**options)
    for name, most in _MOST.items():
        value = getattr(declared, name)
        if value is not None:
            number_in(value, 0, most, f"--{name.replace('_', '-')}")
    return declared


@on_one_blas_thread
@with_reading
@with_assumed
def diagnose(
    telemetry: Readable,
    *,
    scenario: Scenario | Path | str | None = None,
    modelled: Sequence[str] | None = None,
    said: Callable[[str], None] = lambda line: None,
    progress: Progress = usual,
    **options: Unpack[AssumedAndReading],
) -> Diagnosis:
    """Where the gap between a record and its simulation lies, which effect causes it, and how much of it that closes.

    scenario: gives field model, starting S, b, T, the noise budget and effects that are applied as they are.
    modelled: names of the effects that are estimated anew in every test, these and no others; None: bias and
    scale_misalignment, and, of corrected readings, what else their calibration has estimated.
    said: takes a line for each trap of `check` that voids the answer, as soon as it is found.

    A number given below overrides the scenario's; what neither gives is found in the data. Raises BadInput and NoAnswer
    with one message each.
    """
    given = dict(options)
    reading, declared = reading_of(given), declared_in(given)
    names = None if modelled is None else tuple(names_in(modelled))
    for name in names or ():
        find_effect(name, where="--modelled")
    record = as_record(telemetry, **reading)
    if names is None:
        names = (*DEFAULT_MODELLED, *corrected_effects(record))
    config = None if scenario is None else as_scenario(scenario)
    if config is not None:
        record = _with_scenario(record, config)
    _require_something(record)
    field, degree = declared.field or "igrf14", declared.degree
    if config is not None and declared.field is None:
        field, degree = config.field.model, config.field.degree if degree is None else degree
    model = as_model(field, degree)
    known = () if config is None else frozen(config)
    budget = budget_of(config, known, declared)
    traps = input_warnings.traps(record, model)
    # What voids the answer is said while it is looked for; a range that is too small may be the answer.
    voids = [trap for trap in traps if trap.code != "saturated"]
    for trap in voids:
        said(f"{words.FIRST}: {trap.text.removesuffix('.')}. The diagnosis goes on all the same")
    codes = dict.fromkeys(trap.code for trap in voids)
    first = f"{words.FIRST} ({', '.join(codes)}): " if codes else ""
    try:
        found = investigate_record(
            record,
            model,
            modelled=names,
            budget=budget,
            instrument=None if config is None or record.corrected_by else spacecraft.magnetometer(config),
            frozen=known,
            craft=_craft(config),
            provenance={"source": record.provenance.get("source", "")},
            law=not traps,
            progress=lambda step, share: progress(first + step, share),
        )
    except (BadInput, np.linalg.LinAlgError) as error:
        if traps and getattr(error, "where", "") != "--modelled":  # no magnetometer reads like this
            wrong = input_warnings.unnamed(traps, ())
            raise NoAnswer(words.wrong_file(wrong, "unknown", ""), evidence={}) from None
        raise
    stuck = input_warnings.stuck_attitude(record, budget.attitude_sigma_rad)
    if wrong := input_warnings.unnamed(traps, [effect.name for effect in found.effects]):
        verdict = "effect" if found.verdict == "effect" else "unknown"
        found = replace(found, verdict=verdict, sentence=words.wrong_file(wrong, verdict, found.sentence), resembles=())
    notes = [
        _CORRECTED.format(record.corrected_by) if record.corrected_by else None,
        *found.notes,
        stuck if stuck is not None else input_warnings.stuck_and_misfit(record, found.gap.before_nT),
        input_warnings.far_below_budget(
            found.gap.before_nT,
            found.gap.floor_nT,
            budget.noise_nT is not None or budget.attitude_sigma_rad is not None,
        ),
    ]
    facts = dict(found.provenance)
    if found.closure is not None:
        facts["design"] = base_tree(found.closure, budget.lsb_nT, model.name)
    return replace(found, notes=[note for note in notes if note], provenance=facts)


def close(
    diagnosis: Diagnosis,
    *,
    scenario: Scenario | Path | str | None,
    telemetry: Path | str,
    column_map: Path | str | None = None,
    declared: Declared | None = None,
) -> tuple[Diagnosis, Scenario | None]:
    """The diagnosis with its transfers, and the scenario with the named effects in it; None when nothing was named.

    diagnosis: of `fluxtwin.diagnose`.
    scenario: the one that the effects are put into; None makes one that replays the telemetry.
    telemetry: the path of the file that was diagnosed.
    column_map: the path of its map.
    declared: the noise and field of that diagnosis, as a `fluxtwin.diagnosing.Declared`; None where it found them.
    """
    closure = diagnosis.closure
    if closure is None or closure.empty:
        return replace(diagnosis, transfers=[]), None
    base = None if scenario is None else as_scenario(scenario)
    found = closing.settle(closure)
    transfers = transfer.transfers(closure, found.named)
    made = closing.closed_scenario(
        closure,
        found,
        transfers,
        base,
        Path(telemetry),
        None if column_map is None else Path(column_map),
        declared or Declared(),
    )
    return replace(diagnosis, transfers=transfers), made


def apply_closed(record: Telemetry, scenario: Scenario | Path | str, *, force: bool = False) -> TakenOut:
    """The record without the effects of a closed scenario, and corrected by its S, b and T (equation 1).

    Raises BadInput as `apply_calibration`, for the time that the scenario was closed on, and NoAnswer without readings.
    """
    config = as_scenario(scenario)
    _require_something(record := _with_scenario(record, config))
    instrument = spacecraft.magnetometer(config)
    closure, span = config.closure, None
    if closure is not None and closure.from_utc is not None and closure.to_utc is not None:
        span = (epoch.parse_time(closure.from_utc), epoch.parse_time(closure.to_utc))
    known = Calibration(
        instrument.S,
        instrument.b_nT,
        instrument.T_nT_per_Am2,
        sigma_nT=config.magnetometer.white_nT or 0.0,
        span=span,
        field_model=config.field.model,
        method=f"the scenario {config.name}",
        spacecraft=record.spacecraft,
        magnetometer=record.magnetometer,
    )
    if not force:
        require_applicable(record, known)
    found = without_effects(record, load_field(config.field.model, config.field.degree), instrument, frozen(config))
    return replace(found, telemetry=apply_calibration(found.telemetry, known, force=force, sigma_is="noise"))


def _require_something(record: Telemetry) -> None:
    """Raises NoAnswer for a record without readings, BadInput for one without position."""
    if not record.has_reading.any():
        raise NoAnswer(f"all {len(record)} magnetometer readings are missing: there is nothing to diagnose")
    if record.r_N_km is None:
        raise BadInput(
            "the telemetry has no position",
            where="r_x_km r_y_km r_z_km",
            wanted="positions, --tle or a --scenario with orbit",
        )


def budget_of(config: Scenario | None, frozen: tuple[Active, ...], declared: Declared) -> Budget:
    """What is declared, the rest from the scenario."""
    known, roll = declared, None
    if config is not None:
        reference = config.attitude.reference
        stated: dict[str, Any] = {"noise_nT": config.magnetometer.white_nT, "lsb_nT": config.magnetometer.step_nT}
        if declared.attitude_sigma_deg is None and reference.source == "error_model":
            stated |= {"attitude_sigma_deg": reference.sigma_deg, "attitude_tau_s": reference.tau_s}
        tracker = config.star_tracker
        if declared.attitude_sigma_deg is None and tracker is not None and tracker.noise_arcsec > 0.0:
            stated |= {"attitude_sigma_deg": tracker.sigma_deg, "attitude_tau_s": 0.0}
            roll = Roll(tracker.unit_B, tracker.roll_noise_arcsec / tracker.noise_arcsec)
        known = replace(declared, **{name: value for name, value in stated.items() if getattr(declared, name) is None})
    sources = {} if config is None else {name: "scenario" for name in _MOST if getattr(declared, name) is None}
    sigma_rad = None if known.attitude_sigma_deg is None else float(np.radians(known.attitude_sigma_deg))
    white = with_frozen_noise(frozen, known.noise_nT, known.lsb_nT)
    return Budget(*white, sigma_rad, known.attitude_tau_s, roll, sources)


def frozen(config: Scenario) -> tuple[Active, ...]:
    """The scenario's effects, a clip counted from the scenario's own full scale as in the simulation."""
    full_scale_nT = config.magnetometer.full_scale_nT
    return tuple(
        (replace(effect, full_scale_nT=full_scale_nT), theta)
        if isinstance(effect, Saturation) and effect.full_scale_nT is None
        else (effect, theta)
        for effect, theta in active_effects(config)
    )


def _craft(config: Scenario | None) -> Craft | None:
    """The vehicle that the scenario flies; None unless torques turn it."""
    if config is None or config.attitude.mode != "dynamics":
        return None
    return Craft(vehicle_of(config), 1.0 if config.control is None else config.control.period_s)


def _with_scenario(record: Telemetry, config: Scenario) -> Telemetry:
    """The record, with the scenario's orbit where it has no position."""
    name = record.provenance.get("spacecraft", "")
    if name and name != config.spacecraft.name:
        raise BadInput(
            f"the telemetry is of {name!r}, the scenario of {config.spacecraft.name!r}",
            where="--scenario",
            wanted="telemetry and scenario of one spacecraft",
        )
    if record.r_N_km is not None:
        return record
    if config.orbit is None or config.schedule is None:
        raise BadInput("neither telemetry nor scenario has an orbit", where="--scenario", wanted="positions, or --tle")
    span, _ = schedule_times(config)
    if record.time[0] < span[0] or record.time[-1] > span[-1]:
        raise BadInput(
            f"the telemetry runs from {epoch.iso(record.time[0])} to {epoch.iso(record.time[-1])}, the scenario from "
            f"{epoch.iso(span[0])} to {epoch.iso(span[-1])}",
            where="--scenario",
            wanted="telemetry without positions inside the scenario's span",
        )
    r_N_km, v_N_km_s = ephemeris(config, record.time)
    return record.replace(r_N_km=r_N_km, v_N_km_s=v_N_km_s)
