"""One seed a run, one stream a source, derived from the source's name.

Deriving from the name, not from the position, keeps every other stream bit-identical when a source is
switched off or a new one is added. numpy may change a Generator's stream between versions (NEP 19), so a
run repeats exactly only with the numpy version that its saved scenario records.
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, source: str) -> np.random.Generator:
    """The generator of `source` (such as "magnetometer.noise") in the run with `seed`."""
    digest = hashlib.sha256(source.encode("utf-8")).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence([seed, *words]))
