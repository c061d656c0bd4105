"""The scenario of the README as a new user flies it: the one record that the product's own simulation makes.

There is no effect in it, so that no forward model of the catalogue can come to judge itself.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.earth import epoch
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry
from withheld_cases.null_regimes import README_LABEL

README = Path(__file__).resolve().parents[2] / "README.md"


def readme(seed: int, number: int) -> tuple[Telemetry, dict[str, Any]]:
    """The telemetry, of a seed of its own, and what is sealed of it. Raises RuntimeError if the scenario has no seed."""
    (block,) = re.findall(r"```toml\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    word = int(hashlib.sha256(f"{seed}/README/{number}".encode()).hexdigest()[:8], 16) % 2**31
    text, changed = re.subn(r"(?m)^seed = \d+", f"seed = {word}", block, count=1)
    if not changed:
        raise RuntimeError("the scenario of the README has no seed")
    scene = parse_scenario(text, where="README.md")
    record, _ = simulate(scene)
    seconds = epoch.seconds_since(record.time, np.datetime64(record.time[0], "ns"))
    return record, {
        "label": README_LABEL,
        "regime": "nadir",
        "truths": [],
        "rows": len(record),
        "bursts": False,
        "step_s": float(np.median(np.diff(seconds))),
        "attitude_tau_s": scene.attitude.reference.tau_s,
        "attitude_sigma_deg": scene.attitude.reference.sigma_deg,
        "scenario_seed": word,
    }
