"""Put the question: the public verb on a telemetry file, with what a user would declare. No truth comes near here."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from withheld_cases.store import Store


def ask(root: str, identity: str) -> str:
    """Diagnose one case and keep what was said. Errors are answers too, and kept."""
    import fluxtwin

    store = Store(Path(root))
    asked = store.read("asked", identity)
    began = time.process_time()
    said: dict[str, Any]
    try:
        found = fluxtwin.diagnose(store.path("telemetry", identity), **arguments(asked))
        said = _closed(store, identity, found, asked).to_dict()
    except Exception as error:  # whatever goes wrong is a failure of the diagnosis and counted as one
        said = {"verdict": "error", "error": f"{type(error).__name__}: {error}", "effects": []}
    said["seconds"] = time.process_time() - began
    store.write("said", identity, said)
    return identity


def ask_rival(root: str, identity: str) -> str:
    """Put the same question to the rival: `rival.answer(path, **declared)` gives groups by criterion."""
    import importlib

    store = Store(Path(root))
    if store.has("rival", identity):
        return identity
    asked = store.read("asked", identity)
    rival = importlib.import_module(f"withheld_cases.{asked.get('rival', 'rival')}")
    if not rival.installed():
        return identity
    began = time.process_time()
    said: dict[str, Any]
    try:
        said = dict(rival.answer(store.path("telemetry", identity), **arguments(asked)))
    except Exception as error:
        said = {"BIC": [], "EBIC": [], "error": f"{type(error).__name__}: {error}"}
    said["seconds"] = time.process_time() - began
    store.write("rival", identity, said)
    return identity


def arguments(asked: dict[str, Any]) -> dict[str, Any]:
    """Keywords of the verb."""
    names = ("noise_nT", "lsb_nT", "attitude_sigma_deg", "modelled", "degree")
    given = {name: asked[name] for name in names if asked[name] is not None}
    if "scenario" in asked:
        from fluxtwin.sim.scenario.scenario import parse_scenario

        given["scenario"] = parse_scenario(asked["scenario"], where="the vehicle")
    return given


def _closed(store: Store, identity: str, found: Any, asked: dict[str, Any]) -> Any:
    """The answer with its transfers; beside it the scenario with what was named, as `--close` writes it."""
    try:
        from fluxtwin.diagnosing import Declared, close
        from fluxtwin.sim.scenario.scenario import save_scenario

        declared = Declared(
            asked["noise_nT"], asked["lsb_nT"], asked["attitude_sigma_deg"], None, None, asked["degree"]
        )
        path = store.path("telemetry", identity).resolve()
        closed, scene = close(found, scenario=None, telemetry=path, declared=declared)
        if scene is not None:
            save_scenario(scene, store.path("closed", identity))
        return closed
    except Exception as error:  # the answer stands without its closing
        store.path("closed", identity).with_suffix(".error").write_text(f"{type(error).__name__}: {error}\n")
        return found
