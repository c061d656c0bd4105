"""A start is quick because it loads little: what is slow to load is loaded where it is wanted."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SLOW = (
    "xarray",
    "pandas",
    "matplotlib",
    "jinja2",
    "scipy.integrate",
    "scipy.stats",
)
EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "ensemble.toml"


def test_a_flight_and_a_vehicle_of_an_ensemble_load_nothing_slow(tmp_path: Path) -> None:
    """Together these take more than half a second of processor time; the flight takes a few hundredths."""
    code = f"""
import sys
from fluxtwin.sim.run.ensemble import chunk, plan
from fluxtwin.sim.scenario.scenario import load_scenario
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry
scenario = load_scenario({str(EXAMPLE)!r})
first = scenario.schedule.segments[0].model_dump(exclude_none=True) | {{"duration_min": 10.0}}
scenario = scenario.updated({{"schedule.segments": (first,)}})
telemetry, truth = simulate(scenario)
for name in ({str(tmp_path / "t.nc")!r}, {str(tmp_path / "t.csv")!r}):
    read_telemetry(write_telemetry(telemetry, name))
truth.write({str(tmp_path / "truth.nc")!r})
whole = plan.Plan(scenario, 1, 2, 1)
chunk.write_chunk(whole, chunk.Flyer(whole).chunk(0), __import__("pathlib").Path({str(tmp_path)!r}), 0)
print(sorted(set({SLOW!r}) & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert {path.name for path in tmp_path.iterdir()} == {"t.nc", "t.csv", "truth.nc", "chunk-00000.nc"}
