"""Files diagnosed and calibrated, and a campaign, on a real Dask scheduler; each loses one of the workers."""

from __future__ import annotations

import signal
import tomllib
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from command_line import Cli
from dask_cluster import Cluster, cluster
from worlds import scenario_text

import fluxtwin
import fluxtwin.campaigning
from fluxtwin.fleets import diagnoses

pytestmark = [
    pytest.mark.property,
    pytest.mark.filterwarnings("default"),  # of dask's own
]

with_dask = pytest.mark.skipif(
    find_spec("distributed") is None,
    reason="needs the extra `cluster`; the extra `test` has it, so CI never skips this",
)

MAGNETOMETER = "[magnetometer]\nb_nT = [1000.0, -500.0, 300.0]\nnoise_nT = 20.0\n"


@pytest.fixture(scope="module")
def far(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Three workers: two tests may kill one each."""
    with cluster(tmp_path_factory.mktemp("far"), 3) as begun:
        yield begun


def killing_one(far: Cluster, most: float) -> tuple[Callable[[str, float], None], Callable[[], bool]]:
    """A report of progress that kills a worker before that share is done; and whether it died, while another lives."""
    living = [worker for worker in far.workers if worker.poll() is None]

    def kill(words: str, share: float) -> None:
        if 0.0 < share < most and living[0].poll() is None:
            living[0].send_signal(signal.SIGKILL)

    return kill, lambda: living[0].wait() == -signal.SIGKILL and all(one.poll() is None for one in living[1:])


@with_dask
def test_the_bits_are_those_of_this_machine_and_a_lost_worker_costs_nothing(
    far: Cluster, tmp_path: Path, cli: Cli
) -> None:
    files = []
    for number in range(3):
        (tmp_path / "s.toml").write_text(
            scenario_text(
                MAGNETOMETER,
                seed=number,
                start_utc=f"2020-03-0{number + 1}T00:00:00Z",
                segment="samples = 150, step_s = 40.0",
            ),
            encoding="utf-8",
        )
        files.append(fluxtwin.write(fluxtwin.simulate(str(tmp_path / "s.toml"))[0], tmp_path / f"{number}.nc"))
    on_all = ("--scheduler", far.address, "--out", tmp_path / "far.toml")
    assert cli("calibrate", *files, *on_all).status == 0
    said = cli("diagnose", *files[:2], "--scheduler", far.address, "--json", tmp_path / "far.json")
    kill, one_died = killing_one(far, 1.0)
    records = {str(path): fluxtwin.read(path) for path in files}
    found = diagnoses(records, {}, scheduler=far.address, progress=kill)
    assert one_died()
    assert cli("calibrate", *files, "--out", tmp_path / "here.toml").status == 0
    here, there = ((tmp_path / name).read_text(encoding="utf-8") for name in ("here.toml", "far.toml"))
    assert tomllib.loads(here) == tomllib.loads(there)
    assert [one.to_dict() for one in found.values()] == [
        one.to_dict() for one in diagnoses(records, {}, jobs=1).values()
    ]
    assert said.status == 0 and said.out == cli("diagnose", *files[:2], "--jobs", 1).out
    assert said.out.count(".nc: ") == 2


@with_dask
def test_a_campaign_loses_nothing_with_a_worker(far: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four runs, a part each, so that a worker is lost while others wait; then the same runs here."""
    monkeypatch.setattr(fluxtwin.campaigning, "_IN_PART", 1)
    draws = '[draws]\n"magnetometer.b_nT" = { normal = 1500.0 }\n'
    (tmp_path / "s.toml").write_text(
        scenario_text(MAGNETOMETER + draws, segment="samples = 150, step_s = 40.0"), encoding="utf-8"
    )
    kill, one_died = killing_one(far, 0.9)
    there = fluxtwin.campaign(tmp_path / "s.toml", 4, tmp_path / "far", scheduler=far.address, progress=kill)
    assert one_died()
    here = fluxtwin.campaign(tmp_path / "s.toml", 4, tmp_path / "here", jobs=1)
    assert len(there.runs) == 4 and there.runs == here.runs and there.summary == here.summary
    names = sorted(path.name for path in (tmp_path / "here").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "far").iterdir()) and "part-00003.json" in names
    assert all((tmp_path / "here" / name).read_bytes() == (tmp_path / "far" / name).read_bytes() for name in names)


def test_what_does_not_go_together_is_said(tmp_path: Path, cli: Cli) -> None:
    for words, why in (
        (["a.nc", "--jobs", "0"], "0 processes"),
        (["a.nc", "--scheduler", "tcp://127.0.0.1:1"], "one file is no work to share"),
        (["a.nc", "b.nc", "--html", "p.html"], "one file for --follow, --html and --close"),
        (["a.nc", "--fleet", "--follow"], "one file for --follow, --html and --close"),
    ):
        done = cli("diagnose", *words)
        assert done.status == 2 and why in done.err
