"""How far the named effects really close the gap: the closed scenario against the noise-free twin.

The scenario that `--close` wrote is set to replay the twin, without noise, rounding and what is known by its
distribution only. What its residual and the twin's differ by, after the re-estimation of b and S, is what is left of
the truth; what the truth left without any closing is known from its making.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import load_field
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry
from withheld_cases.cases import DISTRIBUTIONAL
from withheld_cases.store import Store


def judge(root: str, identity: str) -> str:
    """Write what the twin says of one closing: gap before, after and the share closed, or why not."""
    store = Store(Path(root))
    if store.has("judged", identity) or not store.has("closed", identity) or not store.has("twin", identity):
        return identity
    try:
        verdict = closing(store, identity)
    except Exception as error:  # a scenario that cannot be run closes nothing that can be measured
        verdict = {"closed": None, "error": f"{type(error).__name__}: {error}"}
    store.write("judged", identity, verdict)
    return identity


def closing(store: Store, identity: str) -> dict[str, Any]:
    """The figures of one case."""
    tree = tomllib.loads(store.path("closed", identity).read_text(encoding="utf-8"))
    one, other, predicted, modelled = against_twin(store, identity, tree, "judged")
    after, before = left(one - other, predicted, modelled), left(one, predicted, modelled)
    share = 1.0 - float(np.mean(after**2)) / float(np.mean(before**2))
    return {"closed": float(np.clip(share, 0.0, 1.0)), "raw": share, "before_nT": rms(before), "after_nT": rms(after)}


def against_twin(
    store: Store, identity: str, tree: dict[str, Any], folder: str
) -> tuple[FloatArray, FloatArray, FloatArray, list[str]]:
    """Residuals (N, 3) of the twin and of a scenario that replays it, the model field, and what is modelled."""
    from fluxtwin.sim.run.simulate import simulate
    from fluxtwin.sim.scenario.scenario import load_scenario

    tree["replay"]["telemetry"] = str(store.path("twin", identity).resolve())
    tree["magnetometer"] |= {"noise_nT": 0.0, "lsb_nT": 0.0}
    tree["attitude"].setdefault("reference", {})["sigma_deg"] = 0.0
    tree["effects"] = {name: e for name, e in tree.get("effects", {}).items() if name not in DISTRIBUTIONAL}
    target = store.root / folder / f"{identity}.toml"
    target.write_text(tomli_w.dumps(tree), encoding="utf-8")
    sealed = store.read("sealed", identity)
    twin, _ = simulate(load_scenario(target))
    flown = read_telemetry(store.path("twin", identity))
    flown = flown.select(np.isin(flown.time, twin.time))  # a replay has no rows without attitude
    one, predicted = residual(flown, sealed["degree"])
    other, _ = residual(twin, sealed["degree"])
    known = flown.has_attitude & twin.has_attitude
    return one[known], other[known], predicted[known], list(sealed["modelled"])


def residual(record: Telemetry, degree: int | None) -> tuple[FloatArray, FloatArray]:
    """Reading less the ground's model at the reported place and attitude, and that model; rows without are NaN."""
    known = record.has_attitude
    predicted = np.full((len(record), 3), np.nan)
    r_N_km, q_NB = np.array(record.r_N_km), np.array(record.q_NB)
    b_N_nT = field_N_nT(load_field("igrf14", degree), record.time[known], r_N_km[known])
    predicted[known] = frames.rotation_from_q(q_NB[known]).apply(b_N_nT)
    return record.mag_B_nT - predicted, predicted


def left(difference: FloatArray, predicted: FloatArray, modelled: list[str]) -> FloatArray:
    """What the re-estimation of what is modelled leaves of a difference."""
    columns = [np.zeros((len(difference), 0))]
    if "scale_misalignment" in modelled:
        columns.append(predicted / 3e4)
    if "bias" in modelled:
        columns.append(np.ones((len(difference), 1)))
    design = np.hstack(columns)
    if not design.shape[1]:
        return difference
    rest: FloatArray = difference - design @ np.linalg.lstsq(design, difference, rcond=None)[0]
    return rest


def rms(values: FloatArray) -> float:
    """Per component."""
    return float(np.sqrt(np.mean(values**2)))
