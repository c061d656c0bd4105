"""The control of the loop: a wrong effect of equal rms in the closed scenario must not be taken for a closed gap."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import tomli_w

from withheld_cases.ask import arguments
from withheld_cases.cases import CONFUSED
from withheld_cases.store import Store
from withheld_cases.twins import against_twin, left, rms

WRONG = (
    ("time_tag_offset", "offset_s", 0.1, 60.0),
    ("field_epoch", "ahead_yr", 1.0, 15.0),
    ("along_track_error", "ahead_km", 2.0, 150.0),
)
"""Name, key, a small size, the largest that makes sense."""


def wrong(root: str, identity: str) -> str:
    """Diagnose the second day of one case with a wrong effect in force."""
    import fluxtwin

    store = Store(Path(root))
    if store.has("control", identity) or not all(store.has(kind, identity) for kind in ("closed", "second", "twin")):
        return identity
    said: dict[str, Any]
    try:
        scene, facts = with_wrong(store, identity)
        found = fluxtwin.diagnose(
            store.path("second", identity), scenario=scene, **arguments(store.read("asked", identity))
        )
        said = {"verdict": found.verdict, **facts}
    except Exception as error:
        said = {"verdict": "error", "error": f"{type(error).__name__}: {error}"}
    store.write("control", identity, said)
    return identity


def with_wrong(store: Store, identity: str) -> tuple[Path, dict[str, Any]]:
    """The closed scenario with a wrong effect in place of what was named, as large as the truth after re-estimation."""
    plain = tomllib.loads(store.path("closed", identity).read_text(encoding="utf-8"))
    sealed = store.read("sealed", identity)
    truths = {truth["name"] for truth in sealed["truths"]}
    wanted = float(sealed["truths"][0]["visible"]) * float(sealed["noise_rms_nT"])
    turn = int(identity[:6], 16) % len(WRONG)
    for name, key, unit, most in (*WRONG[turn:], *WRONG[:turn]):
        if name in truths or any(name in group and group & truths for group in CONFUSED):
            continue
        tree = copy.deepcopy(plain) | {"effects": {name: {key: unit}}}
        tree.pop("closure", None)
        _, other, predicted, modelled = against_twin(store, identity, copy.deepcopy(tree), "control")
        one = rms(left(other, predicted, modelled))
        if one <= 0.0 or unit * wanted / one > most:
            continue
        tree["effects"][name][key] = unit * wanted / one
        target = store.root / "control" / f"{identity}.wrong.toml"
        target.write_text(tomli_w.dumps(tree), encoding="utf-8")
        return target, {"wrong": name, "size": unit * wanted / one}
    raise ValueError("no wrong effect of that size makes sense here")
