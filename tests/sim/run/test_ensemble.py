"""Ensembles: the same to the bit however they are flown, whole chunks only, nothing of the whole in memory at once."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from dask_cluster import cluster
from worlds import scenario_text

from fluxtwin.sim.base import workers
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.run.ensemble import chunk, run, summary
from fluxtwin.sim.run.ensemble.plan import Plan, chunk_size, make_plan
from fluxtwin.sim.run.ensemble.run import fly_ensemble
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

pytestmark = pytest.mark.property

ROOT = Path(__file__).resolve().parents[3]
VEHICLES, IN_CHUNK = 7, 2
SECTIONS = """
[attitude]
mode = "dynamics"
[dynamics]
[torques.gravity_gradient]
[torques.residual_dipole]
dipole_Am2 = [0.0, 0.0, 0.0]
[control]
attitude_sigma_deg = 0.1
[control.three_axis]
frequency_rad_s = 0.05
unloading_per_s = 1e-3
[wheels]
axes_B = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
inertia_kg_m2 = 0.01
bias_rpm = [0.0, 0.0, 0.0]
[torquers]
dipole_Am2 = 10.0
positions_m = [[0.0, 0.0, 2.0], [0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]
activity = "control"
[magnetometer]
b_nT = [0.0, 0.0, 0.0]
noise_nT = 20.0
[draws]
"spacecraft.inertia_kg_m2" = { relative_normal = 0.03 }
"dynamics.yaw_deg" = { normal = 5.0 }
"torques.residual_dipole.dipole_Am2" = { normal = 0.05 }
"magnetometer.b_nT" = { normal = 1500.0 }
"""
TEXT = 'name = "small"\n' + scenario_text(
    SECTIONS,
    seed=3,
    inertia_kg_m2=[[25.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 22.0]],
    epoch_utc="2022-01-01T00:00:00Z",
    altitude_km=600.0,
    inclination_deg=97.0,
    segment="duration_min = 10.0, step_s = 10.0",
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


@pytest.fixture(scope="module")
def straight(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ensemble flown in one go by one process."""
    folder = tmp_path_factory.mktemp("straight") / "results"
    fly_ensemble(scenario, VEHICLES, folder, jobs=1, in_chunk=IN_CHUNK)
    return folder


def content(folder: Path) -> dict[str, Any]:
    """Every byte that means something: the values of each chunk, the tables, the summary."""
    tables = ("vehicles.csv", "envelope.csv", "summary.json")
    found: dict[str, Any] = {name: (folder / name).read_bytes() for name in tables}
    for path in sorted(folder.glob("chunk-*.nc")):
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as opened:
            found[path.name] = (
                str(opened.attrs),
                {name: np.asarray(opened[name]).tobytes() for name in opened.variables},
            )
    return found


def test_another_executor_changes_no_bit(scenario: Scenario, straight: Path, tmp_path: Path) -> None:
    asked: list[str] = []

    class Pool(ThreadPoolExecutor):
        def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Any:
            asked.append(function.__name__)
            return super().submit(function, *arguments, **options)

    with Pool(1) as pool:
        fly_ensemble(scenario, VEHICLES, tmp_path / "pool", in_chunk=IN_CHUNK, executor=pool)
    assert content(tmp_path / "pool") == content(straight)
    assert asked == ["check_chunk"] * 4 + ["fly_chunk"] * 4, "the calling process draws no vehicle by itself"


@pytest.mark.filterwarnings("default")  # of dask's own
def test_a_cluster_changes_no_bit_and_loses_nothing_with_a_worker(
    scenario: Scenario, straight: Path, tmp_path: Path
) -> None:
    with cluster(tmp_path, 2) as far:

        def kill_one(text: str, share: float) -> None:
            if 0.0 < share < 0.9 and far.workers[0].poll() is None:
                far.workers[0].send_signal(signal.SIGKILL)

        options = {"in_chunk": IN_CHUNK, "scheduler": far.address}
        fly_ensemble(scenario, VEHICLES, tmp_path / "far", progress=kill_one, **options)
        assert far.workers[0].poll() is not None and far.workers[1].poll() is None
        with pytest.raises(BadInput, match="alone"):
            fly_ensemble(scenario, VEHICLES, tmp_path / "both", jobs=2, **options)
    assert content(tmp_path / "far") == content(straight)
    with pytest.raises(BadInput, match="nobody answers there"):
        fly_ensemble(scenario, 4, tmp_path / "none", in_chunk=1, scheduler="tcp://127.0.0.1:9")


def test_a_vehicle_flown_alone_is_that_of_the_ensemble(scenario: Scenario, straight: Path) -> None:
    plan = make_plan(scenario, VEHICLES, in_chunk=IN_CHUNK)
    telemetry, truth = simulate(plan.vehicle(5))
    with xr.open_dataset(straight / "chunk-00002.nc", engine="h5netcdf") as opened:
        one = opened.sel(vehicle=5)
        assert np.array_equal(one["mag_B_nT"], telemetry.mag_B_nT.astype(np.float32))
        assert np.array_equal(one["q_NB"], truth.q_NB.astype(np.float32))
        assert (one["time"].to_numpy() == telemetry.time).all()
        np.testing.assert_allclose(one["rate_B_deg_s"], truth.rate_B_rad_s * 180.0 / np.pi, rtol=1e-6)
        wheels = 0.01 * 2.0 * np.pi / 60.0 * np.asarray(telemetry.wheel_speed_rpm)  # along the axes
        body = truth.rate_B_rad_s @ np.array(plan.vehicle(5).spacecraft.inertia_kg_m2)
        np.testing.assert_allclose(one["momentum_Nms"], np.linalg.norm(body + wheels, axis=1), rtol=1e-6)


def test_figures_are_those_of_the_series(scenario: Scenario, straight: Path, close: Callable[..., None]) -> None:
    with xr.open_dataset(straight / "chunk-00001.nc", engine="h5netcdf") as opened:
        figures = dict(zip(opened["figures"].attrs["columns"].split(), opened["figures"].to_numpy().T, strict=True))
        angle = opened["pointing_deg"].to_numpy().astype(np.float64)
        squares = sum(opened[f"{name}_deg"].to_numpy().astype(np.float64) ** 2 for name in ("yaw", "roll", "pitch"))
        close(
            figures["pointing_rms_deg"],
            np.sqrt(np.mean(angle**2, axis=1)),
            atol=1e-5,
            unit="deg",
            because="float32 series",
        )
        # For small turns the angle is the root of the squares of yaw, roll and pitch.
        close(angle**2, squares, atol=0.05, unit="deg2", because="third order of ten degrees")
        duty = 10.0 * np.abs(opened["dipole_B_Am2"]).mean("time").to_numpy()
        close(figures["torquer_x_duty_percent"], duty[:, 0], atol=1e-3, unit="%", because="float32 series")
        rate = np.gradient(opened["yaw_deg"].to_numpy(), 10.0, axis=1)[:, 2:-2]
        assert (np.abs(rate) < opened["rate_error_deg_s"].to_numpy()[:, 2:-2] + 0.01).all()
    with open(straight / "vehicles.csv", encoding="utf-8", newline="") as opened_csv:
        rows = list(csv.DictReader(opened_csv))
    said = json.loads((straight / "summary.json").read_text(encoding="utf-8"))
    column = np.array([float(row["pointing_rms_deg"]) for row in rows])
    spread = said["figures"]["pointing_rms_deg"]
    assert len(rows) == VEHICLES and int(np.argmax(column)) == spread["vehicle_of_max"]
    close(spread["p95"], np.percentile(column, 95), atol=1e-12, unit="deg", because="rounding")
    plan = make_plan(scenario, VEHICLES)
    assert float(rows[4]["dynamics.yaw_deg"]) == plan.drawn(4)["dynamics.yaw_deg"]


def test_a_spread_is_that_of_the_vehicles_that_were_flown() -> None:
    """By hand, of 3, 1, 4, 1 and 5; the second vehicle was lost."""
    found = summary._spread(np.array([3.0, np.nan, 1.0, 4.0, 1.0, 5.0]))
    wanted = {"mean": 2.8, "std": np.sqrt(12.8 / 5.0), "min": 1.0, "max": 5.0, "p50": 3.0, "vehicle_of_max": 5}
    assert {name: found[name] for name in wanted} == pytest.approx(wanted)


def test_the_envelope_is_that_of_all_vehicles(
    scenario: Scenario, straight: Path, close: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = []
    for path in sorted(straight.glob("chunk-*.nc")):
        with xr.open_dataset(path, engine="h5netcdf") as opened:
            parts.append(opened["pointing_deg"].to_numpy())
    whole = np.concatenate(parts)
    table = np.genfromtxt(straight / "envelope.csv", delimiter=",", skip_header=1)[:, 1:]
    close(table[:, 3], whole.max(axis=0), atol=1e-12, unit="deg", because="the same numbers")
    close(table[:, 1], np.median(whole, axis=0), atol=1e-6, unit="deg", because="float32")
    monkeypatch.setattr(summary, "_ENVELOPE_ROWS", 4)
    thinned = summary.envelope(make_plan(scenario, VEHICLES, in_chunk=IN_CHUNK), straight)
    assert thinned is not None and len(thinned.time) == 4
    assert thinned.max_deg[[0, -1]].tolist() == whole[:, [0, -1]].max(axis=0).tolist()
    with xr.open_dataset(straight / "chunk-00000.nc", engine="h5netcdf") as opened:
        assert thinned.time[[0, -1]].tolist() == opened["time"].to_numpy()[[0, -1]].tolist()


class Interrupter:
    """A progress that presses Ctrl-C once so many vehicles have flown."""

    def __init__(self, after: int) -> None:
        self.after = after

    def __call__(self, words: str, fraction: float) -> None:
        if words.startswith("vehicle ") and int(words.split()[1]) >= self.after:
            raise KeyboardInterrupt


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_run_goes_on_without_loss(scenario: Scenario, straight: Path, tmp_path: Path, jobs: int) -> None:
    folder = tmp_path / "results"
    with pytest.raises(KeyboardInterrupt):
        fly_ensemble(scenario, VEHICLES, folder, jobs=jobs, in_chunk=IN_CHUNK, progress=Interrupter(4))
    there = {path.name: path.stat().st_mtime_ns for path in folder.glob("chunk-*.nc")}
    assert len(there) < 4 and not (folder / "summary.json").exists()
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]  # nothing half-written
    plan = make_plan(scenario, VEHICLES, in_chunk=IN_CHUNK)
    assert all(chunk.is_whole(plan, folder, int(name[6:11])) for name in there)
    fly_ensemble(scenario, VEHICLES, folder, jobs=jobs, resume=True)  # the size of the chunks is in the record
    assert content(folder) == content(straight), "the number of processes changes no bit either"
    assert len(list(straight.glob("chunk-*.nc"))) == 4
    assert all((folder / name).stat().st_mtime_ns == then for name, then in there.items()), "flown a second time"


def test_a_damaged_or_foreign_chunk_is_flown_again(scenario: Scenario, straight: Path, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    fly_ensemble(scenario, 4, folder, jobs=1, in_chunk=IN_CHUNK)
    damaged = bytearray((folder / "chunk-00000.nc").read_bytes())
    damaged[len(damaged) // 2 : len(damaged) // 2 + 4000] = bytes(4000)
    (folder / "chunk-00000.nc").write_bytes(damaged)
    fly_ensemble(scenario, VEHICLES, folder, jobs=1, resume=True)  # and more vehicles than at first
    assert content(folder) == content(straight)


def test_what_was_begun_is_not_gone_on_with_as_something_else(scenario: Scenario, straight: Path) -> None:
    def again(changed: Scenario = scenario, vehicles: int = VEHICLES, **options: Any) -> None:
        fly_ensemble(changed, vehicles, straight, jobs=1, **options)

    before = content(straight)
    with pytest.raises(BadInput, match=r"lies here already.*--resume"):
        again()
    with pytest.raises(BadInput, match="the scenario changed"):
        again(scenario.updated({"magnetometer.noise_nT": 21.0}), resume=True)
    with pytest.raises(BadInput, match=r"the seed changed.*seed 3 then, 4 now"):
        again(seed=4, resume=True)
    with pytest.raises(BadInput, match="the size of the chunks changed"):
        again(in_chunk=3, resume=True)
    with pytest.raises(BadInput, match="7 were begun"):
        again(vehicles=6, resume=True)
    assert content(straight) == before


def test_no_more_than_a_chunk_is_held(scenario: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By structure: one chunk of series alive at a time, of no more than its vehicles, and the envelope in blocks."""
    alive, most, sizes, blocks = [0], [0], [], []

    class Counted(chunk.Chunk):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            alive[0] += 1
            most[0] = max(most[0], alive[0])

        def __del__(self) -> None:
            sizes.append(self.series["q_NB"].shape[0])
            alive[0] -= 1

    read = chunk.read_series

    def watched(folder: Path, number: int, name: str, rows: np.ndarray) -> np.ndarray | None:
        blocks.append(rows.size)
        return read(folder, number, name, rows)

    monkeypatch.setattr(chunk, "Chunk", Counted)
    monkeypatch.setattr(chunk, "read_series", watched)
    monkeypatch.setattr(run.summary, "_BLOCK_VALUES", 70)
    fly_ensemble(scenario, VEHICLES, tmp_path / "results", jobs=1, in_chunk=IN_CHUNK)
    assert most[0] <= 2 and max(sizes) == IN_CHUNK  # the last one may wait for the next to be made
    assert max(blocks) == 70 // VEHICLES


def test_a_chunk_fits_a_fixed_memory_however_long_the_flights() -> None:
    for rows, vehicles in ((61, 10), (61, 100_000), (20_000, 1000), (200_000, 1000)):
        assert chunk_size(rows, vehicles) * rows * 120 <= 32_000_000
    assert chunk_size(10**7, 5) == 1 and chunk_size(61, 10) == 10 and chunk_size(61, 10_000) == 313


def test_prescribed_attitudes_have_ensembles_too(tmp_path: Path) -> None:
    sections = '[attitude]\nyaw_rms_deg = 1.0\n[draws]\n"orbit.raan_deg" = { uniform = [0.0, 360.0] }\n'
    text = scenario_text(sections, segment="duration_min = 10.0, step_s = 10.0")
    flown = fly_ensemble(parse_scenario(text), 3, tmp_path / "results", jobs=1)
    assert 0.1 < flown.summary["figures"]["yaw_rms_deg"]["mean"] < 3.0
    with xr.open_dataset(tmp_path / "results" / "chunk-00000.nc", engine="h5netcdf") as opened:
        assert np.ptp(opened["mag_B_nT"].to_numpy()[:, 0, 0]) > 100.0  # an orbit each


def test_a_vehicle_that_cannot_be_flown_is_lost_and_the_others_are_not(scenario: Scenario, tmp_path: Path) -> None:
    rates = {"dynamics.rate_deg_s": {"choice": [[0.0, 0.0, 0.0], [0.0, 0.0, 40.0]]}}
    free = {"control": None, "torquers": None, "wheels": None}
    flown = fly_ensemble(scenario.updated({**free, "draws": rates}), 12, tmp_path / "some", jobs=1)
    lost = flown.summary["lost"]
    assert 0 < lost < 12 and "the body turns by" in flown.summary["why_lost"][0]["reason"]
    with xr.open_dataset(tmp_path / "some" / "chunk-00000.nc", engine="h5netcdf") as opened:
        assert int(np.isnan(opened["figures"][:, 0]).sum()) == lost
    with pytest.raises(NoAnswer, match="all 2 vehicles were lost"):
        fly_ensemble(
            scenario.updated({**free, "draws": None, "dynamics.rate_deg_s": [0.0, 0.0, 40.0]}), 2, tmp_path / "all"
        )
    with pytest.raises(NoAnswer, match=r"all of the first 2 vehicles were lost; vehicle 0: .*the body turns by"):
        fly_ensemble(
            scenario.updated({**free, "draws": None, "dynamics.rate_deg_s": [0.0, 0.0, 40.0]}),
            4,
            tmp_path / "first",
            in_chunk=2,
            jobs=1,
        )


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no vehicles": ({"vehicles": 0}, "--vehicles"),
    "no processes": ({"jobs": 0}, "--jobs"),
    "no vehicles in a chunk": ({"in_chunk": 0}, "--chunk"),
    "a negative seed": ({"seed": -1}, "--seed"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_make_an_ensemble_is_said(name: str, scenario: Scenario, tmp_path: Path) -> None:
    options, words = WRONG[name]
    with pytest.raises(BadInput, match=words):
        fly_ensemble(scenario, **{"vehicles": 2, "out": tmp_path / "x", **options})
    assert not (tmp_path / "x").exists()


def test_a_vehicle_that_cannot_be_stops_the_ensemble_before_it_begins(scenario: Scenario, tmp_path: Path) -> None:
    bad = scenario.updated({"draws": {"magnetometer.noise_nT": {"normal": 30.0}}})
    with pytest.raises(BadInput, match=r"vehicle \d+ cannot be"):
        fly_ensemble(bad, 50, tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_an_error_in_a_process_reads_as_it_would_here(scenario: Scenario, tmp_path: Path) -> None:
    plan = Plan(scenario.updated({"field.truth": "chaos:gone.mat", "draws": None}), 1, 2, 1)
    other = get_context("spawn").Process(target=time.sleep, args=(600.0,), daemon=True)
    other.start()
    with (
        pytest.raises(BadInput, match=r"^gone\.mat: no such file\. Wanted: a CHAOS file, \.mat or \.shc$"),
        workers.processes(1) as own,
    ):
        list(workers.by_executor(own, chunk.fly_chunk, [(plan.record(), str(tmp_path), n) for n in (0, 1)]))
    other.join(timeout=0.2)
    assert other.is_alive(), "a process that somebody else began is not ended with those that began here"
    other.kill()


@pytest.mark.skipif(os.name != "posix", reason="sends an interrupt as a terminal does")
def test_the_command_interrupted_says_how_to_go_on(straight: Path, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(TEXT, encoding="utf-8")
    results = tmp_path / "results"
    words = [sys.executable, "-m", "fluxtwin", "ensemble", str(tmp_path / "s.toml"), "--vehicles", "400"]
    words += ["--out", str(results), "--jobs", "2", "--chunk", "2"]
    process = subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a suite in the background ignores it
    )
    patience = time.monotonic() + 240.0
    while not list(results.glob("chunk-*.nc")) and process.poll() is None and time.monotonic() < patience:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "whole chunks are kept" in said and "--vehicles 400" in said and "--resume" in said
    assert "Traceback" not in said
    assert not [path for path in results.iterdir() if path.name.startswith(".")]
