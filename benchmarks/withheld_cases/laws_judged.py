"""What was right about a law, and how much of the field it closes on another day, beside an oracle that knows the form.

The oracle has the recorded columns and the right form of the law; it estimates the coefficients alone, by least squares
beside S and b on the record that was asked about. Its features are made here, not by the product.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.effects.law import FIELD, GEOMETRY
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry
from withheld_cases.cases import DISTRIBUTIONAL
from withheld_cases.judged import Judged
from withheld_cases.rows import number_row, of, share_row
from withheld_cases.statistics import median
from withheld_cases.store import Store
from withheld_cases.twins import left, residual

COMPARED = "compared"
RIVALS = {"lasso": "lasso (scikit-learn)", "sindy": "STLSQ (pysindy)"}
_TIMED = ("since ", "until ")
_DONE = ("not", "cos", "sin", "cos2", "sin2", "e")


def quantities(factors: Iterable[str]) -> set[str]:
    """Recorded columns and geometry that factors are made of."""
    plain = [factor for factor in factors if not factor.startswith(_TIMED)]
    return {name for factor in plain for name in re.findall(r"[A-Za-z]\w*", factor) if name not in _DONE}


def columns(names: Iterable[str]) -> set[str]:
    """Those of them that are columns of the user's."""
    return {name for name in names if name.startswith(("driver_", "flag_"))}


def said_columns(case: Judged) -> set[str]:
    """Columns in the answer: of the law, and of drivers that are named and that it stands beside."""
    law = case.said.get("law") or {}
    instead = set(law.get("instead_of") or [])
    found = columns(quantities(factor for term in law.get("terms") or [] for factor in term["of"]))
    named = {str(entry["name"]) for entry in case.effects} - instead
    return found | {f"driver_{name.removeprefix('driver.')}" for name in named if name.startswith("driver.")}


def has_law(case: Judged) -> bool:
    """Whether a law is given."""
    return bool((case.said.get("law") or {}).get("terms"))


def right_columns(case: Judged) -> bool:
    """A law of the right columns and no other."""
    return has_law(case) and said_columns(case) == columns(case.sealed["columns"])


def right_form(case: Judged) -> bool:
    """The right columns and geometry, and what is done to them: product, delay, power, level, waves, frame."""
    law, form = case.said.get("law") or {}, case.sealed.get("form") or {}
    terms = law.get("terms") or []
    instead = set(law.get("instead_of") or [])
    if not right_columns(case) or [e for e in case.effects if e["name"] not in (*instead, *DISTRIBUTIONAL)]:
        return False
    wanted, factors = set(case.sealed["columns"]), [factor for term in terms for factor in term["of"]]
    if _plain(case, quantities(factors)) != wanted:
        return False
    if {term["axes"] for term in terms} != {form.get("frame", "body")}:
        return False
    late, least = float(form.get("late_s", 0.0)), 1.5 * float(case.sealed["step_s"])
    mine = max(float(term["delay_s"]) + float(term["lag_s"]) for term in terms)
    if abs(mine - late) > max(least, 0.3 * late):
        return False
    return _shape(case, terms, " ".join(factor for factor in factors if "driver_" in factor))


def _shape(case: Judged, terms: Sequence[dict[str, Any]], joined: str) -> bool:
    form, label = case.sealed.get("form") or {}, str(case.sealed["label"])
    times = [factor for term in terms for factor in term["of"] if factor.startswith(_TIMED)]
    if "since" in form:  # as for levels, nothing is asked of the value: the other day asks it
        return bool(times) and all(factor.startswith("since ") for factor in times)
    if times:
        return False
    if "level" in form:
        return ">" in joined
    if "power" in form and "^2" not in joined:
        return False
    if "waves" in form:
        return "cos driver" in joined and "sin driver" in joined
    if label in ("squared", "along_the_stars"):
        return ">" not in joined
    wanted = set(case.sealed["columns"][:2])
    return any(_plain(case, quantities(term["of"])) == wanted for term in terms) and ">" not in joined


def _plain(case: Judged, names: set[str]) -> set[str]:
    """Quantities with sunlight under its own name: in some records a current is sunlight times a constant."""
    like = set(case.sealed.get("like_sunlight") or [])
    return {"sunlit" if name in like else name for name in names}


def judge(root: str, identity: str) -> str:
    """Fly what was said on the other day, and the oracle, against what happened there."""
    store = Store(Path(root))
    if store.has("judged", identity) or not store.has("second", identity) or not store.has("said", identity):
        return identity
    sealed = store.read("sealed", identity)
    with_it, without = (read_telemetry(store.path(kind, identity)) for kind in ("second", "twin"))
    truth = np.asarray(with_it.mag_B_nT - without.mag_B_nT)
    if not truth.any():  # what it waits for is never on that day: nothing to close
        return identity
    known = with_it.has_attitude
    _, predicted = residual(with_it, sealed["degree"])
    rest: dict[str, float] = {}
    for name, made in (("law", _law_nT(store, identity, with_it)), ("oracle", _oracle_nT(store, sealed, with_it))):
        both = [left(part[known], predicted[known], list(sealed["modelled"])) for part in (truth, truth - made)]
        rest[name] = float(1.0 - np.mean(both[1] ** 2) / np.mean(both[0] ** 2))
    store.write("judged", identity, {"closed_law": rest["law"], "closed_oracle": rest["oracle"]})
    return identity


def _law_nT(store: Store, identity: str, record: Telemetry) -> FloatArray:
    """(N, 3) what the closed scenario's effects make of the other day; nothing where there is none."""
    from fluxtwin.gap.problem.problem import pose
    from fluxtwin.sim.earth.field_models import load_field
    from fluxtwin.sim.effects.base import SignalEffect
    from fluxtwin.sim.scenario.effect_sections import active_effects
    from fluxtwin.sim.scenario.scenario import load_scenario

    if not store.path("closed", identity).exists():
        return np.zeros((len(record), 3))
    scene = load_scenario(store.path("closed", identity))
    active = [pair for pair in active_effects(scene) if isinstance(pair[0], SignalEffect)]
    used = record.select(record.has_attitude)
    chain = pose(used, load_field("igrf14"), modelled=()).chain
    made = np.zeros((len(record), 3))
    made[record.has_attitude] = chain.reading_nT(active) - chain.reading_nT(())
    return made


def _oracle_nT(store: Store, sealed: dict[str, Any], second: Telemetry) -> FloatArray:
    """(N, 3) by the right form, with coefficients from the record that was asked about."""
    record = read_telemetry(store.path("telemetry", sealed["case"]))
    known = record.has_attitude
    rest, predicted = residual(record, sealed["degree"])
    eye, count = np.eye(3), int(known.sum())
    scale = (eye[None, :, :, None] * (predicted[known] / 3e4)[:, None, None, :]).reshape(count, 3, 9)
    own = features(record, sealed)[known]
    design = np.concatenate([scale, np.broadcast_to(eye, (count, 3, 3)), own], axis=2)
    flat = design.reshape(-1, design.shape[2])
    size = np.linalg.norm(flat, axis=0)
    found = np.linalg.lstsq(flat / size, rest[known].reshape(-1), rcond=1e-10)[0] / size
    later: FloatArray = features(second, sealed) @ found[-own.shape[2] :]
    return later


def features(record: Telemetry, sealed: dict[str, Any]) -> FloatArray:
    """(N, 3, P) of the right form: each course times each axis of its frame."""
    label, form = sealed["label"], sealed.get("form") or {}
    values = {name: _column(record, name) for name in sealed["columns"]}
    one = values[sealed["columns"][0]]
    other = values[sealed["columns"][1]] if len(values) > 1 else np.ones(len(record))
    if form.get("late_s"):
        one = _late(record, one, float(form["late_s"]), lag=label == "filtered_product")
    affine = sealed["how"] == "through another"
    if label == "squared":
        courses = [one**2, one]
    elif label == "on_above":
        level = np.quantile(one, 1.0 - _share_on(sealed))
        courses = [(one > level).astype(float)]
    elif label == "turning":
        turn = np.radians((one - 21.0) / 4.0 if affine else one)
        courses = [np.cos(turn), np.sin(turn)]
    elif label == "along_the_stars":
        courses = [one, np.ones_like(one)] if affine else [one]
    elif label == "from_a_time_on":
        on = (record.time >= np.datetime64(form["since"])).astype(float)
        courses = [one * on, on] if affine else [one * on]
    else:
        courses = [one * other, other, *([one] if label == "two_columns" else [])] if affine else [one * other]
    if label == "two_at_once":
        third = values[sealed["columns"][2]]
        courses += [third**2, third]
    axes = np.broadcast_to(np.eye(3), (len(record), 3, 3))
    if form.get("frame") == "inertial":
        axes = _R_BN(record).as_matrix()
    return np.concatenate([course[:, None, None] * axes for course in courses], axis=2)


def _R_BN(record: Telemetry) -> Rotation:
    """(N,) attitudes; rows without one, which are not compared, have none of their own."""
    known = record.has_attitude[:, None]
    return frames.rotation_from_q(np.where(known, np.asarray(record.q_NB), [0.0, 0.0, 0.0, 1.0]))


def _share_on(sealed: dict[str, Any]) -> float:
    return float(sealed["form"]["share_on"])


def _column(record: Telemetry, name: str) -> FloatArray:
    if name == "sunlit":
        return np.asarray(record.sunlit, dtype=np.float64)
    if name.startswith("sun_"):
        r_N_km = np.asarray(record.r_N_km)
        towards = _R_BN(record).apply(sun.sun_direction_N(record.time, r_N_km))
        return np.asarray(towards[:, "xyz".index(name[-1])])
    kind, _, key = name.partition("_")
    return np.asarray((record.drivers if kind == "driver" else record.flags)[key], dtype=np.float64)


def _late(record: Telemetry, values: FloatArray, seconds: float, *, lag: bool) -> FloatArray:
    """A column later, or behind a low-pass, by its samples alone."""
    t = epoch.seconds_since(record.time, record.time[0])
    if not lag:
        return np.interp(t - seconds, t, values)
    state, out = float(values[0]), np.empty_like(values)
    for row, step in enumerate(np.diff(t, prepend=t[0])):
        state = values[row] + (state - values[row]) * float(np.exp(-step / seconds))
        out[row] = state
    return out


def rows(cases: Sequence[Judged]) -> list[dict[str, Any]]:
    """The table of the laws; none where they were not run."""
    laws, nulls, known = of(cases, "laws"), of(cases, "laws_nulls"), of(cases, "laws_catalogue")
    if not (laws or nulls or known):
        return []
    exact = [c for c in laws if c.sealed["how"] == "exact"]
    flown = [c for c in laws if c.twin is not None]
    shares = [_share(c) for c in flown]
    found = [_share(c) for c in flown if has_law(c)]
    found_rows = [
        share_row(
            "law outside the catalogue, visible >= 1: right columns, no other", ">= 85 %", laws, right_columns, 0.85
        ),
        share_row("the same: right form", ">= 70 %", laws, right_form, 0.70),
        share_row("the same: right columns, recorded exactly", COMPARED, exact, right_columns, 0.0),
        share_row("the same: right form, recorded exactly", COMPARED, exact, right_form, 0.0),
        share_row("the same: a law is given", COMPARED, laws, has_law, 0.0),
        share_row("the same: a law with a wrong column", COMPARED, laws, _wrong, 0.0),
        number_row(
            "closed on another day over an oracle's: median of all",
            ">= 0.9",
            median(shares),
            len(shares),
            median(shares) >= 0.9,
        ),
        number_row("the same: mean of all, without a law none is closed", COMPARED, _mean(shares), len(shares), None),
        number_row("the same: median of those with a law", COMPARED, median(found), len(found), None),
        share_row(
            "no law, eight columns that nothing follows: false column",
            "<= 3 %",
            nulls,
            lambda c: bool(said_columns(c)),
            0.0,
            0.03,
        ),
        share_row("cause in the catalogue, eight such columns: false column", "<= 5 %", known, _false, 0.0, 0.05),
        share_row("the same: a law of any recorded column", COMPARED, known, _of_a_column, 0.0),
        share_row("the same: any law", COMPARED, known, has_law, 0.0),
    ]
    return found_rows + _rivals(laws, nulls)


def _rivals(laws: Sequence[Judged], nulls: Sequence[Judged]) -> list[dict[str, Any]]:
    both, quiet = [c for c in laws if c.rival], [c for c in nulls if c.rival]
    found = []
    for key, word in RIVALS.items():
        if any(key in (c.rival or {}) for c in (*both, *quiet)):
            found.append(share_row(f"{word}: right columns", COMPARED, both, lambda c, key=key: _same(c, key), 0.0))
            found.append(
                share_row(
                    f"{word}: false column in nulls", COMPARED, quiet, lambda c, key=key: bool(_theirs(c, key)), 0.0
                )
            )
    return found


def _theirs(case: Judged, key: str) -> set[str]:
    return columns(quantities((case.rival or {}).get(key) or []))


def _same(case: Judged, key: str) -> bool:
    return _theirs(case, key) == columns(case.sealed["columns"])


def _wrong(case: Judged) -> bool:
    return bool(said_columns(case) - columns(case.sealed["columns"]))


def _false(case: Judged) -> bool:
    """A column that the cause has nothing to do with: any driver; the payload's flag where the truth is no such switch."""
    own = {"flag_payload"} if "switched_field" in case.truths else set()
    return bool(said_columns(case) - own)


def _of_a_column(case: Judged) -> bool:
    """Whether a law has a column in it that is recorded, the user's or housekeeping."""
    law = case.said.get("law") or {}
    names = quantities(factor for term in law.get("terms") or [] for factor in term["of"])
    return any(name not in GEOMETRY and name not in FIELD for name in names)


def _share(case: Judged) -> float:
    """Closed by the law over closed by the oracle, on the other day."""
    closed = case.twin or {}
    return float(np.clip(closed["closed_law"] / max(closed["closed_oracle"], 1e-9), 0.0, 1.2))


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
