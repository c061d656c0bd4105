"""Fly the smallest size that an answer printed, and ask again. See `limits`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.telemetry.telemetry_files import write_telemetry
from withheld_cases import limits
from withheld_cases.ask import arguments
from withheld_cases.chain import fly
from withheld_cases.draft import sign
from withheld_cases.store import Store


def again(root: str, identity: str) -> str:
    """Write what was said of the flight with the printed size; nothing of it where no size was printed.

    The perfect flight has been asked by then; its sealed answer is opened to know which effect is meant. The diagnosis
    is handed a telemetry file and the same declarations as before.
    """
    import fluxtwin

    store = Store(Path(root))
    if store.has("limit", identity) or not store.has("said", identity):
        return identity
    sealed, said = store.read("sealed", identity), store.read("said", identity)
    name, seed, number = str(sealed["label"]), int(sealed["seed"]), int(sealed["number"])
    printed = (said.get("minimum_detectable") or {}).get(name)
    if printed is None:
        store.write("limit", identity, {"printed": None, "said": None, "first": said["verdict"]})
        return identity
    _, world, key = limits.draw(seed, number)
    value = sign(np.random.default_rng([seed, number, 7])) * float(printed["value"])
    path = store.path("limit", identity).with_suffix(".csv")
    truth = limits.SIZED[name](str(printed["parameter"]), value)
    write_telemetry(fly(dataclasses.replace(world, key=key), (truth,)), path)
    result: dict[str, Any]
    try:
        result = fluxtwin.diagnose(path, **arguments(store.read("asked", identity))).to_dict()
    except Exception as error:  # a failure of the diagnosis, counted as one
        result = {"verdict": "error", "error": f"{type(error).__name__}: {error}", "effects": []}
    store.write("limit", identity, {"printed": printed, "value": value, "first": said["verdict"], "said": result})
    return identity
