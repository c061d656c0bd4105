"""The loop: the withheld truth on another day, diagnosed with the closed scenario in force. No truth comes near here."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from withheld_cases.ask import arguments
from withheld_cases.store import Store


def again(root: str, identity: str) -> str:
    """Diagnose the second day of one case with what was named on the first applied as it is."""
    import fluxtwin

    store = Store(Path(root))
    if store.has("loop", identity) or not store.has("closed", identity) or not store.has("second", identity):
        return identity
    asked = store.read("asked", identity)
    said: dict[str, Any]
    try:
        scene = store.path("closed", identity)
        found = fluxtwin.diagnose(store.path("second", identity), scenario=scene, **arguments(asked))
        said = {"verdict": found.verdict, "effects": [entry["name"] for entry in found.to_dict()["effects"]]}
    except Exception as error:
        said = {"verdict": "error", "error": f"{type(error).__name__}: {error}", "effects": []}
    said["said_not_to_transfer"] = not transfers(store, identity)
    store.write("loop", identity, said)
    return identity


def transfers(store: Store, identity: str) -> bool:
    """Whether the closed scenario says of every effect that it holds with the attitude as flown on other days."""
    tree = tomllib.loads(store.path("closed", identity).read_text(encoding="utf-8"))
    designs = tree.get("closure", {}).get("transfer", [])
    as_flown = [one for one in designs if str(one.get("design", "")).startswith("attitude as flown")]
    return all(bool(one.get("transfers", True)) for one in as_flown)
