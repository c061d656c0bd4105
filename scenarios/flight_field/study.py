"""`fluxtwin run flight-field`: the field models against MAGSAT in 1980 and Swarm A in a storm.

Measured minus model along a track, the figures that describe it, and what it may consist of: least-squares fits of a few
simple causes, each with one number, as first-order differences of the field that the satellite reports:

* ring current: a uniform field along the geomagnetic dipole axis with its induced dipole in the Earth, sized by
  its value at the dipole equator on the ground, negative in a storm (Langel & Estes 1985, doi
  10.1029/JB090iB03p02495, for the induced share);
* time offset: the position belongs to a time that many seconds after the measurement (an error along the track);
* pitch: the measured vector is turned about the orbit normal, as by an attitude error.

An attitude error does not change the magnitude, so a time offset found in the magnitude alone is not an attitude error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from fluxtwin.plots.field_residuals import ResidualTrack
from fluxtwin.scenarios.flight_field.tracks import Track, read_kp, read_magsat, read_ring_current, read_swarm
from fluxtwin.scenarios.flights import Mission, Numbers, rms
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.recorded_files import Settings, run_on_files
from fluxtwin.scenarios.words import DIFFERS, NOT_TESTABLE, REPRODUCED, Words
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel, field_NEC_nT, load_field
from fluxtwin.sim.earth.field_external import magnetospheric_field_E_nT, read_magnetosphere
from fluxtwin.sim.effects.ambient_field import dipole_axis_E, unit_storm_E

COMPONENTS = ("N", "E", "C", "F")
"""Geocentric north, east, centre, and the magnitude."""
RING_CURRENT, TIME_OFFSET, PITCH = "ring current [nT]", "time offset [s]", "pitch [deg]"
_STEP_S = 0.5
SETTINGS = Path(__file__).parent / "flight_field.toml"
"""What the study runs with; a copy lies beside its results."""
PRINTED = Mission("fluxtwin.scenarios.flight_field")
_CHAOS = "chaos7 with external field"
Key: TypeAlias = tuple[str, str, str, str, str]
"""(track, model, selection, quantity, component) of a figure."""


def against_model(
    track: Track, model: FieldModel, words: str, time: TimeArray | np.datetime64 | None = None
) -> Numbers:
    """Residual of the track to a field model, at the stamps' own epochs or at the one given.

    Raises OutOfRange for an epoch outside the model.
    """
    return against_field(track, field_NEC_nT(model, track.time if time is None else time, track.r_E_km), words)


def against_field(track: Track, model_NEC_nT: FloatArray, words: str) -> Numbers:
    """Residual of the track, N samples, to a field (N, 3) in its own components."""
    return Numbers(
        track=track,
        # What was subtracted, in words, and (N, 3).
        model=words,
        model_NEC_nT=model_NEC_nT,
        # (N, 3) measured minus model, and (N,) the difference of the magnitudes.
        NEC_nT=track.b_NEC_nT - model_NEC_nT,
        F_nT=np.linalg.norm(track.b_NEC_nT, axis=1) - np.linalg.norm(model_NEC_nT, axis=1),
    )


def low_latitude(track: Track, limit_deg: float) -> BoolArray:
    """Rows (N,) within `limit_deg` of the equator, geodetic latitude."""
    low: BoolArray = np.abs(track.latitude_deg) < limit_deg
    return low


def statistics(residual: Numbers, rows: BoolArray) -> Mapping[tuple[str, str], float]:
    """rms and mean [nT] of N, E, C and F over the rows, by (quantity, component)."""
    parts = dict(zip(COMPONENTS, (*residual.NEC_nT[rows].T, residual.F_nT[rows]), strict=True))
    return {("rms", name): rms(part) for name, part in parts.items()} | {
        ("mean", name): float(part.mean()) for name, part in parts.items()
    }


def ring_current_NEC(model: FieldModel, residual: Numbers, induced_share: float) -> FloatArray:
    """(N, 3) field of a ring current of 1 nT at the dipole equator on the ground, induced part included."""
    track = residual.track
    external_E = unit_storm_E(dipole_axis_E(model, track.time[0]), track.r_E_km, induced_share)
    return np.asarray(frames.rotation_NEC_E(track.r_E_km).apply(external_E / (1.0 + induced_share)))


def time_offset_NEC(model: FieldModel, residual: Numbers) -> FloatArray:
    """(N, 3) change of the residual for each second by which the position runs ahead of the field [nT/s]."""
    track, velocity = residual.track, _velocity_E_km_s(residual)
    ahead, behind = (field_NEC_nT(model, track.time, track.r_E_km + s * velocity) for s in (_STEP_S, -_STEP_S))
    return -(ahead - behind) / (2.0 * _STEP_S)


def pitch_NEC(residual: Numbers) -> FloatArray:
    """(N, 3) change of the measured vector for a turn of one degree about the orbit normal [nT/deg]."""
    r_E_km = residual.track.r_E_km
    normal_E = np.cross(r_E_km, _velocity_E_km_s(residual))
    normal_NEC = frames.rotation_NEC_E(r_E_km).apply(normal_E / np.linalg.norm(normal_E, axis=1)[:, None])
    turned: FloatArray = np.cross(normal_NEC, residual.model_NEC_nT) * np.radians(1.0)
    return turned


def fit(
    residual: Numbers,
    chosen: tuple[str, BoolArray],
    columns: Mapping[str, FloatArray],
    causes: Sequence[str],
    on: str = "vector",
) -> Numbers:
    """Least squares of the named causes to the residual over the chosen rows, all components alike.

    chosen: the rows in words, and (N,). columns: field (N, 3) of each cause at size 1. on: "vector", or "magnitude".
    """
    words, rows = chosen
    if on == "vector":
        design = np.stack([columns[name][rows].ravel() for name in causes], axis=1)
        measured = residual.NEC_nT[rows].ravel()
    else:
        along = residual.model_NEC_nT / np.linalg.norm(residual.model_NEC_nT, axis=1)[:, None]
        design = np.stack([np.einsum("ij,ij->i", columns[name], along)[rows] for name in causes], axis=1)
        measured = residual.F_nT[rows]
    size = np.linalg.lstsq(design, measured, rcond=None)[0]
    return Numbers(
        track=residual.track.name.rpartition(" ")[0],
        rows=words,
        on=on,
        # Of each cause, unit in its name.
        size=dict(zip(causes, size.tolist(), strict=True)),
        rms_before_nT=rms(measured),
        rms_after_nT=rms(measured - design @ size),
        # (N, 3) what the causes add to the reported field, at every row of the track.
        fitted_NEC_nT=np.tensordot(size, np.stack([columns[name] for name in causes]), axes=1),
    )


def _velocity_E_km_s(residual: Numbers) -> FloatArray:
    """(N, 3) Earth-fixed velocity from the positions."""
    track = residual.track
    velocity: FloatArray = np.gradient(track.r_E_km, epoch.seconds_since(track.time, track.time[0]), axis=0)
    return velocity


def read_figures() -> list[Numbers]:
    """The packaged independent figures, in the form of data/README.md, each with its key."""
    return [
        Numbers(
            **{name: row[name] for name in ("id", "unit", "printed")},
            **{name: float(row[name]) for name in ("value", "last_digit")},
            key=tuple(row[name] for name in ("track", "model", "selection", "quantity", "component")),
        )
        for row in PRINTED.table("figures")
    ]


def beside(figures: Sequence[Numbers], here: Mapping[Key, float], why: Mapping[str, str]) -> list[Numbers]:
    """Ours beside each figure: reproduced within one unit of its last printed digit.

    here: what was computed, by key; a key that is missing makes the figure not testable. why: the explanation
    for a figure that differs or is not testable, by id.
    """
    compared = []
    for figure in figures:
        ours, status, shown = here.get(figure.key), NOT_TESTABLE, None
        if ours is not None:
            # a thousandth of a digit for the decimals that binary numbers cannot hold
            status = REPRODUCED if abs(ours - figure.value) <= 1.001 * figure.last_digit else DIFFERS
            # with one digit more than the printed figure
            shown = round(ours, 1 - math.floor(math.log10(figure.last_digit)))
        reason = "" if status == REPRODUCED else why.get(figure.id, "no explanation found")
        compared.append(figure.model_copy({"here": ours, "status": status, "why": reason, "shown": shown}))
    return compared


def compute(folder: Path, settings: Settings, progress: Progress) -> Numbers:
    """Read the files of the folder and compute everything. Raises BadInput for a file that cannot be used."""
    progress("reading the recorded files", 0.02)
    magsat, swarm = read_magsat(folder / settings.magsat.file), read_swarm(folder / settings.swarm.file)
    kp = read_kp(folder / settings.magsat.kp_file, magsat.time[0])
    rc = read_ring_current(folder / settings.swarm.rc_file)
    progress("IGRF-14 along the orbit of MAGSAT", 0.1)
    model = load_field(settings.magsat.model)
    one_epoch = epoch.parse_time(settings.magsat.epoch_utc, where="magsat.epoch_utc")
    fixed = against_model(magsat, model, f"IGRF-14 at {epoch.decimal_year(one_epoch)[0]:.1f}", one_epoch)
    at_stamps = against_model(magsat, model, "IGRF-14 at each stamp")
    progress("what the MAGSAT residual consists of", 0.3)
    fits, explained = _magsat_fits(at_stamps, model, settings)
    progress("CHAOS-7 along the orbit of Swarm A", 0.5)
    path = folder / settings.swarm.chaos_file
    internal = load_field(f"chaos:{path}", settings.swarm.crust_degree)
    inside = field_NEC_nT(internal, swarm.time, swarm.r_E_km)
    outside_E = magnetospheric_field_E_nT(read_magnetosphere(path), swarm.time, swarm.r_E_km, *rc.at(swarm.time))
    outside = frames.rotation_NEC_E(swarm.r_E_km).apply(outside_E)
    storm = (
        against_model(swarm, load_field(settings.swarm.model), "IGRF-14"),
        against_field(swarm, inside, "CHAOS-7, internal only"),
        against_field(swarm, inside + outside, "CHAOS-7 with external field and RC"),
    )
    ring = ring_current_NEC(load_field(settings.swarm.model), storm[0], settings.ring_current_induced_share)
    one_pass = ("one pass", low_latitude(swarm, settings.low_latitude_deg))
    fits += [fit(storm[0], one_pass, {RING_CURRENT: ring}, [RING_CURRENT], on) for on in ("vector", "magnitude")]
    along = np.add(*rc.at(swarm.time))
    row = int(np.argmin(np.abs(swarm.latitude_deg)))
    of_day = (swarm.time[row] - swarm.time[row].astype("datetime64[D]")).astype("int64") / 3600e9
    return Numbers(
        # To IGRF-14 at one epoch, at each stamp, and with the causes fitted at low latitude.
        magsat=fixed,
        magsat_at_stamps=at_stamps,
        magsat_explained=explained,
        # To IGRF-14, to the internal field of CHAOS, to the whole of CHAOS.
        swarm=storm,
        # Eight values of the day of MAGSAT.
        kp=kp,
        rc=rc,
        # Lowest and highest RC along the track of Swarm.
        rc_range_nT=(float(along.min()), float(along.max())),
        # Local time of Swarm's sample nearest to the equator.
        hours=float((of_day + swarm.longitude_deg[row] / 15.0) % 24.0),
        fits=tuple(fits),
    )


def found_figures(outcome: Numbers, settings: Settings) -> Mapping[Key, float]:
    """Every figure that can be set beside an independent one."""
    found: dict[Key, float] = {}
    plain, _, whole = outcome.swarm
    for track, model, residual in (
        ("magsat", "igrf14 at 1980.0", outcome.magsat),
        ("swarm", "igrf14", plain),
        ("swarm", _CHAOS, whole),
    ):
        low = low_latitude(residual.track, settings.low_latitude_deg)
        for selection, rows in (("all", np.ones_like(low)), ("low", low)):
            for (quantity, component), value in statistics(residual, rows).items():
                found[track, model, selection, quantity, component] = value
    remaining = found["swarm", _CHAOS, "low", "mean", "N"] / found["swarm", "igrf14", "low", "mean", "N"]
    stamps = plain.track.time
    return found | {
        ("swarm", _CHAOS, "low", "share", "N"): 1.0 - remaining,
        ("magsat", "index", "track", "kp", "first"): float(outcome.kp[0]),
        ("magsat", "index", "day", "kp", "largest"): float(outcome.kp.max()),
        ("swarm", "index", "track", "rc", "nearest hour"): outcome.rc.nearest(
            stamps[0] + (stamps[-1] - stamps[0]) // 2
        ),
    }


def _magsat_fits(residual: Numbers, model: FieldModel, settings: Settings) -> tuple[list[Numbers], Numbers]:
    """The causes at low latitude, both passes and each, and the residual that remains along the whole track."""
    track = residual.track
    columns = {
        RING_CURRENT: ring_current_NEC(model, residual, settings.ring_current_induced_share),
        TIME_OFFSET: time_offset_NEC(model, residual),
        PITCH: pitch_NEC(residual),
    }
    ring, ring_time, every = [RING_CURRENT], [RING_CURRENT, TIME_OFFSET], list(columns)
    low = low_latitude(track, settings.low_latitude_deg)
    both = ("both passes", low)
    fits = [fit(residual, both, columns, names) for names in (ring, ring_time, [RING_CURRENT, PITCH], every)]
    explained = residual.model_NEC_nT + fits[-1].fitted_NEC_nT
    fits.append(fit(residual, both, columns, ring_time, "magnitude"))
    northbound = np.gradient(track.latitude_deg) > 0.0
    for one in (("northbound pass", low & northbound), ("southbound pass", low & ~northbound)):
        fits.append(fit(residual, one, columns, every))
        fits.append(fit(residual, one, columns, ring_time, "magnitude"))
    return fits, against_field(track, explained, "IGRF-14 with ring current, time offset and pitch fitted")


def present(outcome: Numbers, settings: Settings) -> StudyResult:
    """What the study says of its outcome."""
    tracks = (outcome.magsat.track, outcome.swarm[0].track)
    provenance = {
        **{track.name: track.source for track in tracks},
        **{f"{track.name}, span": " to ".join(map(epoch.iso, track.time[[0, -1]])) for track in tracks},
        "field models": f"IGRF-14; {settings.swarm.chaos_file} to degree {settings.swarm.crust_degree}",
        "settings": "flight_field.toml beside this page",
    }
    return words().result(
        "flight-field",
        provenance,
        o=outcome,
        settings=settings.tree,
        figures=beside(read_figures(), found_figures(outcome, settings), explanations(outcome)),
    )


@cache
def words() -> Words:
    """The sections of `words.md`."""
    return Words(
        PRINTED.package,
        filters={"track": _track},
        known=(low_latitude, rms, selections, statistics),
        parts=COMPONENTS,
        ring=RING_CURRENT,
        time=TIME_OFFSET,
        pitch=PITCH,
    )


def explanations(outcome: Numbers) -> dict[str, str]:
    """Why a figure differs, by its id, with the numbers of this run: an explanation is a finding, not an excuse."""
    later = outcome.rc.nearest(outcome.swarm[0].track.time[-1] + np.timedelta64(60, "m"))
    return {"swarm-rc": words().say("why_swarm_rc", o=outcome, later=later)}


def selections(outcome: Numbers, limit_deg: float) -> list[dict[str, Any]]:
    """What `statistics` says of every residual and choice of rows."""
    words = f"|latitude| < {limit_deg:g} deg"
    found: list[dict[str, Any]] = []
    for residual in (outcome.magsat, outcome.magsat_at_stamps, outcome.magsat_explained, *outcome.swarm):
        low, good = low_latitude(residual.track, limit_deg), residual.track.attitude_good
        chosen = {"all": np.ones_like(low), words: low}
        if residual is outcome.magsat:
            chosen |= {"attitude flag 0": good, f"attitude flag 0, {words}": good & low}
        found += [
            {"track": residual.track.name, "model": residual.model, "selection": name, "samples": int(rows.sum())}
            | {f"{quantity}_{part}_nT": value for (quantity, part), value in statistics(residual, rows).items()}
            for name, rows in chosen.items()
        ]
    return found


def _track(residual: Numbers, rows: BoolArray | slice = slice(None)) -> ResidualTrack:
    """The record that the figures take; of the chosen rows only, where some are chosen."""
    track = residual.track
    place = (track.time[rows], track.latitude_deg[rows], track.longitude_deg[rows])
    return ResidualTrack(residual.model, *place, residual.NEC_nT[rows], residual.F_nT[rows])


run = partial(run_on_files, SETTINGS, compute, present)
